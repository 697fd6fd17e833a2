//! Drives a real stack of displays: what every output of the computer shows, and when.
//!
//! ```text
//! LayerStack ──Picture::codes──▶ code values per output and refresh ──Deck──▶ Feed ──between periods──▶ conductor ──▶ outputs
//!    ▲                              (any thread)                                                       (a thread of its own, one
//! solver, changed folder                                                                                picture per refresh)
//! ```
//!
//! The pictures are pure functions of display, stack and output ([`Picture`]); windows and graphics processor come with the feature `window`
//! (`window::present`), which alone needs winit and wgpu.
//!
//! The output plugin `panels` is a presenter, which `lumistack show` drives. Patterns are submitted, also while it runs. Commands come and
//! events go as JSON of [`presentation`]. A build without windows lists the plugin, and its `run` fails. Calibration from photographs needs
//! no windows and is a library beside the plugin.

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

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
