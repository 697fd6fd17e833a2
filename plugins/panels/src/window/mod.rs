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

mod app;
mod conductor;
#[cfg(all(unix, not(target_os = "macos")))]
mod feedback;
mod gpu;
mod outputs;
mod producer;
mod session;
#[cfg(all(unix, not(target_os = "macos")))]
mod wayland;

use std::sync::mpsc::{Receiver, Sender};
use std::time::Duration;

use lumistack_plugin::display::{Display, LayerStack};
use thiserror::Error;

use crate::assign::{AssignError, Output};
use crate::{Pattern, PatternError, Shows, Skew, Tally};

pub use app::present;
pub use outputs::outputs;

/// What is shown, and how.
#[derive(Debug)]
pub struct Settings {
    /// The display, with its panels' calibration.
    pub display: Display,
    /// What to show first.
    pub content: Content,
    /// Where.
    pub mode: Mode,
    /// Whether masks are enlarged, or made smaller, to fill the panels ([`crate::fit`]).
    pub fit: bool,
    /// A frame that stays until told otherwise.
    pub hold: Option<usize>,
    /// How long to show it; without it until somebody ends it.
    pub duration: Option<Duration>,
    /// Whether to keep what was submitted when, for [`Report::log`].
    pub log: bool,
}

/// What is shown.
#[derive(Clone, Debug)]
pub enum Content {
    /// The frames of a stack.
    Stack(LayerStack),
    /// A test pattern, on one panel alone or on all.
    Pattern {
        /// Which.
        pattern: Pattern,
        /// On which panel alone.
        only: Option<Shows>,
        /// Place of the eye for which crosses coincide, display space.
        eye_mm: [f64; 3],
    },
    /// A picture on one panel at its full resolution; the others are clear.
    Flat {
        /// The picture, sRGB codes.
        picture: image::RgbImage,
        /// The layer that shows it.
        layer: usize,
    },
    /// What the display would show from an angle, in an ordinary window.
    Rehearsal {
        /// The patterns.
        stack: LayerStack,
        /// Angles from which it is seen, degrees to the right and up.
        from_deg: [f64; 2],
    },
}

/// Where it is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// A surface per output.
    Outputs,
    /// One surface across all outputs, which then flip together.
    Span,
    /// An ordinary window.
    Window,
}

/// What a presentation is told while it runs.
#[derive(Clone, Debug)]
pub enum Command {
    /// New patterns, which replace the old ones between periods.
    Stack(LayerStack),
    /// Keep this frame.
    Hold(usize),
    /// Show all frames in turn.
    Run,
    /// The frame after the one that is kept, or before.
    Step(i64),
    /// Shift a panel's picture by [right, down] panel pixels.
    Nudge(Shows, [f64; 2]),
    /// Keep the nudges: see [`Event::Save`].
    Save,
    /// Look from these angles, degrees (rehearsal).
    Look([f64; 2]),
    /// Tell what was shown so far.
    Report,
    /// End it.
    Quit,
}

/// What a presentation tells while it runs, from any of its threads.
#[derive(Clone, Debug)]
pub enum Event {
    /// The windows are there, and this is what they show.
    Started(Vec<(Shows, Output)>),
    /// New pictures are shown since a refresh.
    Swapped {
        /// How often so far.
        times: u64,
        /// Number of the first refresh that shows them.
        refresh: u64,
    },
    /// Something that the user should know.
    Warning(String),
    /// The panel that keys now shift, and its shift.
    Selected(Shows, [f64; 2]),
    /// Somebody wants the nudges kept; this is the display with them.
    Save(Box<Display>),
    /// What was shown so far.
    Report(Box<Report>),
}

/// What was shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Refreshes that were submitted.
    pub refreshes: u64,
    /// Seconds from the first to the last.
    pub seconds: f64,
    /// Seconds between refreshes that late ones are measured against.
    pub interval_s: f64,
    /// Where `interval_s` comes from.
    pub interval_from: &'static str,
    /// By times of submission.
    pub submitted: Option<Tally>,
    /// By what the platform tells, per output: its name and counts. Empty where it tells nothing.
    pub shown: Vec<(String, Tally)>,
    /// Between outputs, as the platform tells; none where it does not or there is one surface.
    pub skew: Option<Skew>,
    /// New pictures that were taken.
    pub swaps: u64,
    /// Surfaces whose picture could not be had in time, by output.
    pub missed: u64,
    /// (refresh, place in the period, number of the pictures, seconds) of every submission, where wanted.
    pub log: Vec<(u64, usize, u64, f64)>,
}

/// A presentation that could not be, or had to end.
#[derive(Debug, Error)]
pub enum WindowError {
    /// Which output shows what cannot be said.
    #[error(transparent)]
    Assign(#[from] AssignError),
    /// The pattern does not go with the display.
    #[error(transparent)]
    Pattern(#[from] PatternError),
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

/// The two ends of what a presentation is told.
pub fn commands() -> (Sender<Command>, Receiver<Command>) {
    std::sync::mpsc::channel()
}
