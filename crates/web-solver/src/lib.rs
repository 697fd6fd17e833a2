//! From a dropped file to patterns, a little at a time: what the command does in one go, for a page that must stay awake.
//!
//! ```text
//! Files ──scene──▶ Scene ──subject──▶ Subject ──views──▶ light field ──work──▶ patterns ──▶ codes for the viewer, a zip for the command
//! ```
//!
//! [`Work::advance`] does one piece: a view, or an iteration of the solver. Rough views of a few directions come first and patterns of them; then views with
//! all their samples, from time to time patterns of what is there; at last the views and the patterns that the command makes for the same job.

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
pub use settings::Settings;
pub use work::{Stage, Work};
