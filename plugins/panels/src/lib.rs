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
//! It is a library that `lumistack show` calls, not a plugin of the C boundary: a presenter takes commands, reloads, tells what it did and changes the display
//! file while it runs, which open, submit, run and finish have no words for; and the windows' libraries stay out of every other program.

pub mod assign;
pub mod calibrate;
mod feed;
pub mod fit;
mod flat;
mod keep;
mod pattern;
mod picture;
mod place;
mod tally;
#[cfg(feature = "window")]
pub mod window;

pub use feed::Feed;
pub use flat::flat_codes;
pub use keep::{KeepError, keep_panels};
pub use pattern::{Pattern, PatternError};
pub use picture::Picture;
pub use place::Place;
pub use tally::{Skew, Tally};

use lumistack_plugin::display::{Backlight, Display};

/// What one output shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Shows {
    /// The panel behind the lenslets of a directional backlight.
    Backlight,
    /// A layer; 0 is the rearmost.
    Layer(usize),
}

impl std::fmt::Display for Shows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Backlight => f.write_str("backlight"),
            Self::Layer(layer) => write!(f, "layer {layer}"),
        }
    }
}

impl Shows {
    /// All that a display needs an output for, rear to front.
    pub fn all(display: &Display) -> Vec<Self> {
        let backlight = matches!(display.backlight, Backlight::Lenslets(_)).then_some(Self::Backlight);
        backlight.into_iter().chain((0..display.layers.len()).map(Self::Layer)).collect()
    }
}
