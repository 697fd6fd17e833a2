//! The windows of a presentation: one borderless fullscreen surface per output, one surface across
//! all outputs, or an ordinary window with a preview.
//!
//! ```text
//! main thread   windows, keys, outputs that change or disappear  (winit requires this thread)
//! producer      encodes stacks, patterns and panel shifts into codes, uploads them, fills the feed
//! present loop  per refresh: one frame on every surface in one submission; takes the feed's frames
//!               at the start of a period
//! ```
//!
//! The present loop never waits for the producer, only for the outputs. Fifo surfaces are presented
//! at vertical blanks, so the slowest output sets the rate. No output is more than one refresh
//! ahead of another.
//!
//! If the platform reports presentation times (Wayland's presentation-time), late refreshes and the
//! skew between outputs are computed from these times. Otherwise late refreshes are computed from
//! the times of submission, and the skew is unknown.

#[cfg(feature = "window")]
mod app;
#[cfg(all(feature = "window", unix, not(target_os = "macos")))]
mod feedback;
#[cfg(feature = "window")]
mod gpu;
#[cfg(not(feature = "window"))]
mod none;
#[cfg(feature = "window")]
mod outputs;
#[cfg(feature = "window")]
mod present_loop;
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

/// A presentation could not start, or had to end.
#[derive(Debug, Error)]
pub enum WindowError {
    /// The outputs do not match the display.
    #[error(transparent)]
    Assign(#[from] AssignError),
    /// The pattern does not match the display.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The program was built without windows.
    #[error(
        "windows: expected a build with the feature `panels` (cargo build --release -p lumistack-cli --features panels), found a build without this feature"
    )]
    NotBuilt,
    /// There is no windowing system.
    #[error("windows: expected an X11 or Wayland session (DISPLAY or WAYLAND_DISPLAY), found: {0}")]
    Session(String),
    /// The system starts no thread for the presentation.
    #[error("windows: cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// There is no suitable graphics driver, not even in software; or the driver has failed.
    #[error(
        "graphics: expected a Vulkan or OpenGL driver that can present on {on} (Mesa's llvmpipe needs no graphics card), found {found}"
    )]
    Graphics {
        /// The name of the output, or another name of the surface, such as `the window`.
        on: String,
        /// The error of the graphics driver.
        found: String,
    },
    /// A window did not reach the size of its output.
    #[error(
        "{output}: expected a surface of {} × {} pixels, found {} × {} pixels. Set the output's scale to 1",
        expected[0], expected[1], found[0], found[1]
    )]
    Size {
        /// The name of the output.
        output: String,
        /// [columns, rows] of the output.
        expected: [usize; 2],
        /// [columns, rows] of the window.
        found: [usize; 2],
    },
    /// The platform cannot show one surface across outputs.
    #[error("span: {0}")]
    Span(String),
    /// The connection to the windowing system was lost.
    #[error("windows: the connection to the X server or the compositor was lost")]
    Lost,
    /// An output was disconnected.
    #[error(
        "output {name} was disconnected while it showed {shows}. Check that the panel is plugged in and switched on"
    )]
    Gone {
        /// The name of the output.
        name: String,
        /// The panel that the output drove.
        shows: Shows,
    },
    /// An output changed its size or position.
    #[error(
        "output {name}, which shows {shows}: expected {} × {} pixels at {},{} as at the start, found {} × {} at {},{}",
        was.size[0], was.size[1], was.position[0], was.position[1], is.size[0], is.size[1], is.position[0], is.position[1]
    )]
    Changed {
        /// The name of the output.
        name: String,
        /// The panel that the output drives.
        shows: Shows,
        /// The output's state at the start.
        was: Box<Output>,
        /// The output's state after the change.
        is: Box<Output>,
    },
}
