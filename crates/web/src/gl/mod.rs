//! Drawing through WebGL2: the canvas, its programs and its textures.

mod canvas;
mod display;

pub(crate) use display::Gpu;
