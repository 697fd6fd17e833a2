//! The classes for JavaScript. Their methods only call the other modules of this crate, which are
//! tested without a browser.

use js_sys::Uint8ClampedArray;
use wasm_bindgen::prelude::*;
use web_sys::WebGl2RenderingContext;

use crate::colour::{HEAT_TOP, heat_stops};
use crate::gl::Gpu;
use crate::{Error, Field, Model, err};

impl From<Error> for JsValue {
    fn from(error: Error) -> Self {
        js_sys::Error::new(&error.to_string()).into()
    }
}

type Thrown<T> = Result<T, JsValue>;

/// Returns the error of a call of `draw` without a context.
fn detached() -> Error {
    err("the viewer has no graphics context; call `attach` before `draw`")
}

fn clamped(bytes: &[u8]) -> Uint8ClampedArray {
    Uint8ClampedArray::from(bytes)
}

/// Returns the version of the program.
#[wasm_bindgen]
pub fn version() -> String {
    env!("CARGO_PKG_VERSION").into()
}

/// Returns the error map's colours for evenly spaced errors, separated by commas, for a gradient in
/// a style sheet.
#[wasm_bindgen]
pub fn heat() -> String {
    heat_stops().join(",")
}

/// Returns the error that the last colour of the error map shows.
#[wasm_bindgen]
pub fn heat_top() -> f32 {
    HEAT_TOP
}

/// A preview and its simulation.
#[wasm_bindgen]
pub struct Viewer {
    model: Model,
    gpu: Option<Gpu>,
}

#[wasm_bindgen]
impl Viewer {
    /// Parses the text of preview.json.
    #[wasm_bindgen(constructor)]
    pub fn new(preview_json: &str) -> Thrown<Viewer> {
        Ok(Self { model: Model::new(preview_json)?, gpu: None })
    }

    /// Adds the bytes of a file, given by its index in the preview; files may arrive in any order.
    pub fn put(&mut self, file: usize, bytes: &[u8]) -> Thrown<()> {
        let (_, completed) = self.model.put(file, bytes)?;
        if let (Some(slot), Some(gpu)) = (completed, &self.gpu) {
            gpu.upload(&self.model, self.model.complete()[slot], slot)?;
        }
        Ok(())
    }

    /// Replaces the codes of all files, `[row][col][rgb]` each, in the preview's order.
    pub fn exchange(&mut self, codes: &[u8]) -> Thrown<()> {
        self.model.exchange(codes)?;
        if let Some(gpu) = &self.gpu {
            for (slot, &frame) in self.model.complete().iter().enumerate() {
                gpu.upload(&self.model, frame, slot)?;
            }
        }
        Ok(())
    }

    /// Changes the options, as JSON; omitted keys return to their defaults.
    pub fn set_options(&mut self, json: &str) -> Thrown<()> {
        Ok(self.model.set_options(json)?)
    }

    /// Simulates the view from a slope on the CPU; returns sRGB bytes [row][col][rgba].
    pub fn render(&self, sx: f64, sy: f64) -> Uint8ClampedArray {
        clamped(&self.model.render([sx, sy]))
    }

    /// Returns a view of the target as sRGB bytes.
    pub fn render_target(&self, view_row: usize, view_col: usize) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_target([view_row, view_col])?))
    }

    /// Returns a layer's mask in a frame as sRGB bytes, in the layer's size.
    pub fn render_layer(&self, layer: usize, frame: usize) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_layer(layer, frame)?))
    }

    /// Returns the backlight's emission in a frame as sRGB bytes, with angular bins side by side.
    pub fn render_backlight(&self, frame: usize) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_backlight(frame)?))
    }

    /// Returns the error map of the target's view nearest to a slope.
    pub fn render_error(&self, sx: f64, sy: f64) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_error([sx, sy])?))
    }

    /// Returns the PSNR against the target's view nearest to a slope, dB. It is undefined in the
    /// cases of [`Model::psnr`], for example until this view has arrived.
    pub fn psnr(&self, sx: f64, sy: f64) -> Option<f64> {
        self.model.psnr([sx, sy])
    }

    /// Sets the context for [`Self::draw`]; throws if the context is lost, or cannot draw the
    /// preview.
    pub fn attach(&mut self, context: WebGl2RenderingContext) -> Thrown<()> {
        self.gpu = None;
        self.gpu = Some(Gpu::new(context, &self.model)?);
        Ok(())
    }

    /// Releases the context, also if it is lost.
    pub fn detach(&mut self) {
        self.gpu = None;
    }

    /// Draws the view from a slope with the context of [`Self::attach`]. The context's canvas has
    /// one pixel for each pixel of the light field.
    pub fn draw(&self, sx: f64, sy: f64) -> Thrown<()> {
        Ok(self.gpu.as_ref().ok_or_else(detached)?.draw(&self.model, [sx, sy])?)
    }
}

/// A light field that is shown without a simulated display.
#[wasm_bindgen]
pub struct LightField(Field);

#[wasm_bindgen]
impl LightField {
    /// Makes a light field without views; `put` adds views. A view has rows × cols pixels.
    #[wasm_bindgen(constructor)]
    pub fn new(rows: usize, cols: usize, view_rows: usize, view_cols: usize) -> Thrown<LightField> {
        Ok(Self(Field::new([rows, cols], [view_rows, view_cols])?))
    }

    /// Reads a quilt of cols × rows tiles, view 0 at the bottom left, as one row of views.
    pub fn from_quilt(rgba: &[u8], width: usize, height: usize, cols: usize, rows: usize) -> Thrown<LightField> {
        Ok(Self(Field::from_quilt(rgba, [width, height], [cols, rows])?))
    }

    /// Adds a view, sRGB bytes [row][col][rgba].
    pub fn put(&mut self, view_row: usize, view_col: usize, rgba: &[u8]) -> Thrown<()> {
        Ok(self.0.put([view_row, view_col], rgba.to_vec())?)
    }

    /// Returns the pixel rows.
    pub fn rows(&self) -> usize {
        self.0.size[0]
    }

    /// Returns the pixel columns.
    pub fn cols(&self) -> usize {
        self.0.size[1]
    }

    /// Returns the picture at the position (u, v) between the views, as sRGB bytes. u is 0..1 from
    /// left to right, v is 0..1 from top to bottom.
    pub fn render(&self, u: f64, v: f64) -> Uint8ClampedArray {
        clamped(&self.0.render(u, v))
    }
}
