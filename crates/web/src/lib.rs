//! The browser simulator's module: simulates layer stacks by the same forward model as all other
//! crates.
//!
//! ```text
//! preview.json + pictures ─▶ Model ─▶ Simulator of lumistack-display ─▶ bytes for a canvas  (CPU)
//!                              └────▶ AreaMap as textures ─▶ shaders with lookups only      (GPU)
//! ```
//!
//! The CPU draws in tests, and in browsers in which WebGL2 is missing or slower. It always draws
//! masks, views of the target, and error maps. The shaders compute no geometry: tables
//! of [`lumistack_display::AreaMap`] state where a ray hits a layer. All code that does not use the
//! browser's objects also compiles outside of the browser, where its tests run.

mod colour;
mod decode;
mod field;
#[cfg(target_arch = "wasm32")]
mod gl;
mod json;
mod model;
mod options;
pub mod preview;
#[cfg(target_arch = "wasm32")]
mod shell;
mod tables;
#[cfg(test)]
mod tests;

pub use field::Field;
pub use model::{Model, Slots};
pub use options::{Options, Pupil};
pub use tables::Tables;

/// An error for the user: the file, the position in it, the expected and the found value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error(String);

pub(crate) fn err(text: impl Into<String>) -> Error {
    Error(text.into())
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}
