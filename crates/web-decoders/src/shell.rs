//! The functions and classes that JavaScript can call.

use js_sys::Uint8Array;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{LightField, Projection};
use wasm_bindgen::prelude::*;

use crate::Wanted;

/// Replaces the files in memory that the readers of light fields read.
#[wasm_bindgen]
pub fn hold(names: Vec<String>, contents: Vec<Uint8Array>) {
    lumistack_files::hold(names.into_iter().zip(contents.iter().map(Uint8Array::to_vec)));
}

/// A light field. The solver's module reads it through the getters below.
#[wasm_bindgen]
pub struct Field {
    field: LightField,
    /// Texts of the warnings: the place of the first warning, its message, the place of the second
    /// warning, and so on.
    warnings: Vec<String>,
}

/// Reads a light field from the files that [`hold`] received. `width_mm`, `fov_x_deg` and
/// `fov_y_deg` are used if these files do not state the geometry. Views with more than `cols`
/// columns are reduced to `cols` columns.
#[wasm_bindgen]
pub fn field(path: &str, width_mm: f64, fov_x_deg: f64, fov_y_deg: f64, cols: usize) -> Result<Field, JsError> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let wanted = Wanted { width_mm, fov_deg: [fov_x_deg, fov_y_deg], cols };
    let field = crate::field(path, &wanted, Task::quiet(&warnings, &cancel))?;
    let warnings = warnings.take().into_iter().flat_map(|warning| [warning.place, warning.message]);
    Ok(Field { field, warnings: warnings.collect() })
}

#[wasm_bindgen]
impl Field {
    /// Pixel rows of a view.
    #[wasm_bindgen(getter)]
    pub fn rows(&self) -> usize {
        self.field.geometry().rows
    }

    /// Pixel columns of a view.
    #[wasm_bindgen(getter)]
    pub fn cols(&self) -> usize {
        self.field.geometry().cols
    }

    /// Pitch of the pixels on the display plane, mm.
    #[wasm_bindgen(getter)]
    pub fn pitch_mm(&self) -> f64 {
        self.field.geometry().pitch_mm
    }

    /// Viewing distance of perspective views, mm; `undefined` for oblique views.
    #[wasm_bindgen(getter)]
    pub fn distance_mm(&self) -> Option<f64> {
        match self.field.geometry().grid.projection {
            Projection::Oblique => None,
            Projection::Perspective { distance_mm } => Some(distance_mm),
        }
    }

    /// Slopes of the columns of views, from left to right.
    #[wasm_bindgen(getter)]
    pub fn slope_x(&self) -> Vec<f64> {
        self.field.geometry().grid.slope_x.clone()
    }

    /// Slopes of the rows of views, from top to bottom.
    #[wasm_bindgen(getter)]
    pub fn slope_y(&self) -> Vec<f64> {
        self.field.geometry().grid.slope_y.clone()
    }

    /// Linear values of all views, `[view_y][view_x][row][col][rgb]`.
    #[wasm_bindgen(getter)]
    pub fn radiance(&self) -> Vec<f32> {
        self.field.radiance().data().to_vec()
    }

    /// Texts of the reader's warnings: the place of the first warning, its message, the place of
    /// the second warning, and so on.
    #[wasm_bindgen(getter)]
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }
}

/// Decodes packed content. Request and answer have the byte format of
/// `lumistack_gltf::unpack::Packed`; the result is `undefined` if the request is malformed.
#[wasm_bindgen]
pub fn answer(request: &[u8]) -> Option<Vec<u8>> {
    crate::answer(request)
}

/// Packs `display.toml` and files, in this order, as a zip. `display` is the display as JSON.
#[wasm_bindgen]
pub fn pack(display: &str, names: Vec<String>, contents: Vec<Uint8Array>) -> Result<Vec<u8>, JsError> {
    let contents: Vec<Vec<u8>> = contents.iter().map(Uint8Array::to_vec).collect();
    let files = names.iter().map(String::as_str).zip(contents.iter().map(Vec::as_slice));
    crate::pack(display, files).map_err(|error| JsError::new(&error))
}
