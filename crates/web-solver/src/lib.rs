//! Computes patterns from a dropped file in small pieces of work. Between two pieces the page can
//! respond to the user.
//!
//! ```text
//! Files ──scene──▶ Scene ──light──▶ LitScene ──views──▶ light field ──work──▶ patterns
//! ```
//!
//! Each call of [`Work::advance`] computes one piece, such as a view or an iteration of the solver.
//! The first pieces compute noisy views of a few directions, and patterns for these views. The next
//! pieces do the same for all directions. Later pieces render all views with all their samples.
//! Meanwhile, up to three times, they solve for all views, although some still have few samples.
//! The last views and patterns agree with those of the command for the same job, except for small
//! differences. These exist since the command rounds views when it caches them, and the module uses
//! other instructions of the processor. Other threads may trace views: [`Work::give`] names a view,
//! a copy of the `Work` traces it ([`Work::trace`]), and [`Work::take`] receives its values.
//!
//! [`patterns`] encodes patterns for the viewer, and as a zip for the command.

mod decoders;
mod error;
mod files;
pub mod patterns;
mod settings;
#[cfg(target_arch = "wasm32")]
mod shell;
mod views;
mod work;

pub use error::Error;
pub use files::Files;
pub use settings::{Preset, Settings, presets};
pub use work::{Stage, Work};
