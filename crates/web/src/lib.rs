//! The browser simulator's module: what a stack shows, computed by the same forward model as everywhere else.
//!
//! ```text
//! preview.json + pictures ──▶ Model ──▶ Simulator of lumistack-display ──▶ bytes for a canvas      (CPU: tests, machines without WebGL2)
//!                               └─────▶ AreaMap as textures ──▶ shaders that only look things up  (GPU)
//! ```
//!
//! The shaders hold no geometry: where a ray meets a layer is read from tables that [`lumistack_display::AreaMap`] made. Everything but the thin shell
//! around the browser's objects compiles for any machine and is tested there.

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

/// What went wrong, for people: the file, the place in it, what was expected and what was found.
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
