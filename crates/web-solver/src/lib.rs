//! From a dropped file to patterns in small pieces. The command computes the same at once; a page
//! must stay responsive.
//!
//! ```text
//! Files ──scene──▶ Scene ──subject──▶ Subject ──views──▶ light field ──work──▶ patterns
//! ```
//!
//! [`Work::advance`] computes one piece: a view, or an iteration of the solver. First come noisy
//! views of a few directions and their patterns. Then come views with all samples, and now and then
//! patterns of the views so far. The last views and patterns are those that the command computes
//! for the same job. [`patterns`] encodes them for the viewer, and as a zip for the command.

mod decoders;
mod error;
mod files;
pub mod patterns;
mod settings;
#[cfg(target_arch = "wasm32")]
mod shell;
mod subject;
mod views;
mod work;

pub use error::Error;
pub use files::Files;
pub use settings::{Preset, Settings, presets};
pub use work::{Stage, Work};
