//! Drawing through WebGL2: its programs and its textures.

mod display;
mod parts;

pub(crate) use display::Gpu;
