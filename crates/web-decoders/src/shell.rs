//! The functions that JavaScript sees.

use js_sys::Uint8Array;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{LightField, Projection};
use wasm_bindgen::prelude::*;

use crate::Wanted;

/// Replaces the files that readers of light fields find.
#[wasm_bindgen]
pub fn hold(names: Vec<String>, contents: Vec<Uint8Array>) {
    lumistack_files::hold(names.into_iter().zip(contents.iter().map(Uint8Array::to_vec)));
}

/// A light field that was read, for the solver's module.
#[wasm_bindgen]
pub struct Field {
    field: LightField,
    /// Place and message of each warning, one after the other.
    warnings: Vec<String>,
}

/// Reads a light field among the held files.
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
    /// Rows of a view.
    #[wasm_bindgen(getter)]
    pub fn rows(&self) -> usize {
        self.field.geometry().rows
    }

    /// Columns of a view.
    #[wasm_bindgen(getter)]
    pub fn cols(&self) -> usize {
        self.field.geometry().cols
    }

    /// Pitch of its pixels, mm.
    #[wasm_bindgen(getter)]
    pub fn pitch_mm(&self) -> f64 {
        self.field.geometry().pitch_mm
    }

    /// Distance of perspective views, mm; nothing for parallel views.
    #[wasm_bindgen(getter)]
    pub fn distance_mm(&self) -> Option<f64> {
        match self.field.geometry().grid.projection {
            Projection::Oblique => None,
            Projection::Perspective { distance_mm } => Some(distance_mm),
        }
    }

    /// Slopes of view columns, left to right.
    #[wasm_bindgen(getter)]
    pub fn slope_x(&self) -> Vec<f64> {
        self.field.geometry().grid.slope_x.clone()
    }

    /// Slopes of view rows, top to bottom.
    #[wasm_bindgen(getter)]
    pub fn slope_y(&self) -> Vec<f64> {
        self.field.geometry().grid.slope_y.clone()
    }

    /// All values, `[view_y][view_x][row][col][rgb]`.
    #[wasm_bindgen(getter)]
    pub fn radiance(&self) -> Vec<f32> {
        self.field.radiance().data().to_vec()
    }

    /// Place and message of each warning, one after the other.
    #[wasm_bindgen(getter)]
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }
}

/// Decodes packed content that came as bytes; the answer is bytes too.
#[wasm_bindgen]
pub fn answer(request: &[u8]) -> Option<Vec<u8>> {
    crate::answer(request)
}

/// Packs files as a zip, after `display.toml` with the display that is given as JSON.
#[wasm_bindgen]
pub fn pack(display: &str, names: Vec<String>, contents: Vec<Uint8Array>) -> Result<Vec<u8>, JsError> {
    let contents: Vec<Vec<u8>> = contents.iter().map(Uint8Array::to_vec).collect();
    let files = names.iter().map(String::as_str).zip(contents.iter().map(Vec::as_slice));
    crate::pack(display, files).map_err(|error| JsError::new(&error))
}
