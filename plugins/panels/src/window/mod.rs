//! The windows: one borderless fullscreen surface per output, or one across all of them, each refresh with its picture.
//!
//! ```text
//! main thread      windows, keys, outputs that come and go             (winit wants it so)
//! producer         stacks, patterns and nudges become code values, are loaded onto the graphics processor, and wait in the feed
//! conductor        every refresh: a picture for every surface, one submission, then all are presented; at the start of a period it takes what the feed has
//! ```
//!
//! The conductor never waits for the producer. What it waits for is the display: surfaces are presented in order at vertical blanks (Fifo), so its pace is that
//! of the slowest output, and no output is ever more than one refresh from another by its doing. Where the platform tells when a picture was really shown
//! (Wayland's presentation-time), late refreshes and the skew between outputs are counted from that; elsewhere from the times of submission, and the skew
//! is unknown.

#[cfg(feature = "window")]
mod app;
#[cfg(feature = "window")]
mod conductor;
#[cfg(all(feature = "window", unix, not(target_os = "macos")))]
mod feedback;
#[cfg(feature = "window")]
mod gpu;
#[cfg(not(feature = "window"))]
mod none;
#[cfg(feature = "window")]
mod outputs;
#[cfg(feature = "window")]
mod producer;
#[cfg(feature = "window")]
mod session;
#[cfg(all(feature = "window", unix, not(target_os = "macos")))]
mod wayland;

use thiserror::Error;

use crate::PatternError;
use crate::assign::{AssignError, Output};
use crate::shows::Shows;

#[cfg(feature = "window")]
pub use app::present;
#[cfg(not(feature = "window"))]
pub use none::{outputs, present};
#[cfg(feature = "window")]
pub use outputs::outputs;

/// A presentation that could not be, or had to end.
#[derive(Debug, Error)]
pub enum WindowError {
    /// Which output shows what cannot be said.
    #[error(transparent)]
    Assign(#[from] AssignError),
    /// The pattern does not go with the display.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The program was built without windows.
    #[error(
        "windows: expected a build with the feature `panels` (cargo build --release -p lumistack-cli --features panels), found one without"
    )]
    NotBuilt,
    /// There is no windowing system.
    #[error("windows: expected an X11 or Wayland session (DISPLAY or WAYLAND_DISPLAY), found {0}")]
    Session(String),
    /// No graphics processor, not even in software.
    #[error(
        "graphics: expected a Vulkan or OpenGL driver that can present on {on} (Mesa's llvmpipe needs no graphics card), found {found}"
    )]
    Graphics {
        /// The output.
        on: String,
        /// What went wrong.
        found: String,
    },
    /// A window did not become what it should.
    #[error(
        "output {output}: expected a surface of {expected:?} pixels, found {found:?}: an output must not be scaled"
    )]
    Size {
        /// Its name.
        output: String,
        /// Columns and rows of the output.
        expected: [usize; 2],
        /// Those of the window.
        found: [usize; 2],
    },
    /// The platform cannot do it.
    #[error("span: {0}")]
    Span(String),
    /// The session ended.
    #[error("windows: the connection to the X server or the compositor was lost")]
    Lost,
    /// An output went away.
    #[error("output {name}: it is gone (unplugged, switched off?), and {shows} has nowhere to be shown")]
    Gone {
        /// Its name.
        name: String,
        /// What it showed.
        shows: Shows,
    },
    /// An output became another one.
    #[error(
        "output {name}, which shows {shows}: expected {} × {} pixels at {},{} as at the start, found {} × {} at {},{}",
        was.size[0], was.size[1], was.position[0], was.position[1], is.size[0], is.size[1], is.position[0], is.position[1]
    )]
    Changed {
        /// Its name.
        name: String,
        /// What it showed.
        shows: Shows,
        /// What it was.
        was: Box<Output>,
        /// What it is.
        is: Box<Output>,
    },
}
