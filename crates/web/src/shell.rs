//! What JavaScript sees. Every class passes on to the tested code beside it.

use js_sys::{Float32Array, Uint8ClampedArray, Uint32Array};
use wasm_bindgen::prelude::*;
use web_sys::HtmlCanvasElement;

use crate::gl::Gpu;
use crate::{Error, Field, Model, err};

impl From<Error> for JsValue {
    fn from(error: Error) -> Self {
        js_sys::Error::new(&error.to_string()).into()
    }
}

type Thrown<T> = Result<T, JsValue>;

/// What is thrown by drawing without a canvas.
fn detached() -> Error {
    err("the viewer has no canvas: attach one before drawing")
}

fn clamped(bytes: &[u8]) -> Uint8ClampedArray {
    Uint8ClampedArray::from(bytes)
}

/// Version of the program that the module belongs to.
#[wasm_bindgen]
pub fn version() -> String {
    env!("CARGO_PKG_VERSION").into()
}

/// A preview and what it shows.
#[wasm_bindgen]
pub struct Viewer {
    model: Model,
    gpu: Option<Gpu>,
}

#[wasm_bindgen]
impl Viewer {
    /// From the text of preview.json.
    #[wasm_bindgen(constructor)]
    pub fn new(preview_json: &str) -> Thrown<Viewer> {
        Ok(Self { model: Model::new(preview_json)?, gpu: None })
    }

    /// What the page needs to know, as JSON.
    pub fn info(&self) -> String {
        self.model.info()
    }

    /// Takes the bytes of a file, in any order.
    pub fn put(&mut self, file: usize, bytes: &[u8]) -> Thrown<()> {
        let (_, completed) = self.model.put(file, bytes)?;
        if let (Some(slot), Some(gpu)) = (completed, &self.gpu) {
            gpu.upload(&self.model, self.model.complete()[slot], slot)?;
        }
        Ok(())
    }

    /// Frames of which every part has arrived; drawing uses those.
    pub fn frames_ready(&self) -> usize {
        self.model.frames_ready()
    }

    /// Views of the target that have arrived.
    pub fn targets_ready(&self) -> usize {
        self.model.targets_ready()
    }

    /// Changes the options, as JSON; keys that are left out go back to their defaults.
    pub fn set_options(&mut self, json: &str) -> Thrown<()> {
        Ok(self.model.set_options(json)?)
    }

    /// Emitted light times gain from a slope, [row][col][rgb].
    pub fn view_linear(&self, sx: f64, sy: f64) -> Float32Array {
        Float32Array::from(self.model.view_linear([sx, sy]).as_slice())
    }

    /// The same as sRGB bytes [row][col][rgba].
    pub fn render(&self, sx: f64, sy: f64) -> Uint8ClampedArray {
        clamped(&self.model.render([sx, sy]))
    }

    /// A view of the target as sRGB bytes.
    pub fn render_target(&self, view_row: usize, view_col: usize) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_target([view_row, view_col])?))
    }

    /// A layer's pattern in a frame as sRGB bytes, at its own size.
    pub fn render_layer(&self, layer: usize, frame: usize) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_layer(layer, frame)?))
    }

    /// The backlight's emission in a frame as sRGB bytes, bins side by side.
    pub fn render_backlight(&self, frame: usize) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_backlight(frame)?))
    }

    /// The error map of the target's view nearest to a slope.
    pub fn render_error(&self, sx: f64, sy: f64) -> Thrown<Uint8ClampedArray> {
        Ok(clamped(&self.model.render_error([sx, sy])?))
    }

    /// PSNR of that view in dB; undefined while it has not arrived.
    pub fn psnr(&self, sx: f64, sy: f64) -> Option<f64> {
        self.model.psnr([sx, sy])
    }

    /// [view_row, view_col] of the target's view nearest to a slope.
    pub fn nearest_view(&self, sx: f64, sy: f64) -> Uint32Array {
        let [row, col] = self.model.nearest_view([sx, sy]);
        Uint32Array::from([row as u32, col as u32].as_slice())
    }

    /// Draws to a canvas through WebGL2 from now on; throws where there is none or the preview is too large for it.
    pub fn attach(&mut self, canvas: HtmlCanvasElement) -> Thrown<()> {
        self.gpu = None;
        self.gpu = Some(Gpu::new(canvas, &self.model)?);
        Ok(())
    }

    /// Gives the canvas back, also after its context was lost.
    pub fn detach(&mut self) {
        self.gpu = None;
    }

    /// What the display shows from a slope, letterboxed to the drawing buffer.
    pub fn draw(&self, sx: f64, sy: f64) -> Thrown<()> {
        Ok(self.gpu.as_ref().ok_or_else(detached)?.draw(&self.model, [sx, sy])?)
    }

    /// A view of the target.
    pub fn draw_target(&mut self, view_row: usize, view_col: usize) -> Thrown<()> {
        Ok(self.gpu.as_mut().ok_or_else(detached)?.draw_target(&self.model, [view_row, view_col])?)
    }

    /// The error map of the target's view nearest to a slope.
    pub fn draw_error(&mut self, sx: f64, sy: f64) -> Thrown<()> {
        Ok(self.gpu.as_mut().ok_or_else(detached)?.draw_error(&self.model, [sx, sy])?)
    }

    /// A layer's pattern in a frame.
    pub fn draw_layer(&self, layer: usize, frame: usize) -> Thrown<()> {
        Ok(self.gpu.as_ref().ok_or_else(detached)?.draw_layer(&self.model, layer, frame)?)
    }

    /// The display left of `at` (0..1), the target's nearest view right of it.
    pub fn draw_split(&mut self, sx: f64, sy: f64, at: f64) -> Thrown<()> {
        Ok(self.gpu.as_mut().ok_or_else(detached)?.draw_split(&self.model, [sx, sy], at)?)
    }

    /// The layers pulled apart, with rays of a slope through them; `spread` 0 is their true distances.
    pub fn draw_exploded(&self, sx: f64, sy: f64, yaw_rad: f64, pitch_rad: f64, spread: f64) -> Thrown<()> {
        let gpu = self.gpu.as_ref().ok_or_else(detached)?;
        Ok(gpu.draw_exploded(&self.model, [sx, sy], [yaw_rad, pitch_rad, spread])?)
    }
}

/// A light field that is shown as such.
#[wasm_bindgen]
pub struct LightField(Field);

#[wasm_bindgen]
impl LightField {
    /// Views of rows × cols pixels, of which none has arrived.
    #[wasm_bindgen(constructor)]
    pub fn new(rows: usize, cols: usize, view_rows: usize, view_cols: usize) -> Thrown<LightField> {
        Ok(Self(Field::new([rows, cols], [view_rows, view_cols])?))
    }

    /// A quilt of cols × rows tiles, view 0 at the bottom left; becomes one row of views.
    pub fn from_quilt(rgba: &[u8], width: usize, height: usize, cols: usize, rows: usize) -> Thrown<LightField> {
        Ok(Self(Field::from_quilt(rgba, [width, height], [cols, rows])?))
    }

    /// Takes a view, sRGB bytes [row][col][rgba].
    pub fn put(&mut self, view_row: usize, view_col: usize, rgba: &[u8]) -> Thrown<()> {
        Ok(self.0.put([view_row, view_col], rgba.to_vec())?)
    }

    /// Pixel rows.
    pub fn rows(&self) -> usize {
        self.0.size[0]
    }

    /// Pixel columns.
    pub fn cols(&self) -> usize {
        self.0.size[1]
    }

    /// The picture at (u, v) in 0..1 across the views, from left to right and from top to bottom, as sRGB bytes.
    pub fn render(&self, u: f64, v: f64) -> Uint8ClampedArray {
        clamped(&self.0.render(u, v))
    }
}
