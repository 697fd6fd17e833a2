//! Drives the panels of a real display: every layer is shown on its own output, one frame per
//! refresh.
//!
//! ```text
//! LayerStack ─Picture::codes─▶ codes per output and refresh ─▶ Feed ─▶ present loop ─▶ outputs
//!                                (any thread)         (between periods)  (own thread, one
//!                                                                        frame per refresh)
//! ```
//!
//! A period is one cycle through all frames. The codes of [`Picture`] depend only on the display,
//! the output, the stack, the frame and the colour. Windows and the GPU (`window::present`) need
//! the feature `window`. Without this feature the crate does not depend on winit and wgpu.
//!
//! The output plugin `panels` is a presenter, which `lumistack show` runs. Layer stacks can be
//! submitted while the plugin runs. Commands and events are the JSON of [`presentation`]. In a
//! build without the feature `window`, the plugin's `run` returns an error. Calibration from
//! photographs ([`calibrate`]) needs no windows, and the plugin does not use this module.

pub mod assign;
pub mod calibrate;
mod feed;
pub mod fit;
mod flat;
mod keep;
mod pattern;
mod picture;
mod place;
mod plugin;
pub mod presentation;
mod shows;
mod tally;
pub mod window;

pub use feed::Feed;
pub use flat::flat_codes;
pub use keep::{KeepError, keep_panels};
pub use pattern::{Pattern, PatternError};
pub use picture::Picture;
pub use place::Place;
pub use plugin::{PLUGIN, Panels, PanelsParams};
pub use shows::Shows;
pub use tally::{Skew, Tally};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
