//! Computes patterns from a dropped file in small pieces, between which the page stays responsive.
//! The final patterns are those of the command.
//!
//! ```text
//! Files ──scene──▶ Scene ──subject──▶ Subject ──views──▶ light field ──work──▶ patterns
//! ```
//!
//! [`Work::advance`] computes one piece: a view, or an iteration of the solver. First it computes
//! noisy views of a few directions, and patterns for them. Then it renders all views with all their
//! samples; three times meanwhile it solves for the views that exist. The last views and patterns
//! are those that the command computes for the same job. [`patterns`] encodes patterns for the
//! viewer, and as a zip for the command.

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
