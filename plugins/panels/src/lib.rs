//! Drives a real layer stack: every layer is shown on its own output, one frame per refresh.
//!
//! ```text
//! LayerStack ─Picture::codes─▶ codes per output and refresh ─▶ Feed ─▶ present loop ─▶ outputs
//!                                (any thread)         (between periods)  (own thread, one
//!                                                                        frame per refresh)
//! ```
//!
//! [`Picture`] is a pure function of display, stack and output. Windows and the GPU need the
//! feature `window`, which alone depends on winit and wgpu (`window::present`).
//!
//! The output plugin `panels` is a presenter; `lumistack show` drives it. Layer stacks can be
//! submitted while it runs. Commands and events are the JSON of [`presentation`]. A build without
//! windows lists the plugin, and its `run` returns an error. Calibration from photographs needs no
//! windows; it is a part of this library that the plugin does not use.

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
