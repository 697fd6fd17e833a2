//! A presentation: its content, the commands that it takes, the events that it tells.

use std::collections::BTreeMap;
use std::time::Duration;

use lumistack_plugin::display::{Display, LayerStack};
use lumistack_plugin::serde::{Deserialize, Serialize};

use crate::pattern::Pattern;
use crate::shows::Shows;
use crate::tally::Tally;

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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "snake_case")]
pub enum Mode {
    /// A surface per output.
    Outputs,
    /// One surface across all outputs, which then flip together.
    Span,
    /// An ordinary window.
    Window,
}

/// A command to a running presentation. JSON: `{"hold": 1}`, `"run"`, `{"nudge": ["layer 0", [1.0, -2.0]]}`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "snake_case")]
pub enum Command {
    /// New patterns, which replace the old ones between periods. At the boundary of plugins they are submitted, so they have no JSON.
    #[serde(skip)]
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

/// An event of a presentation, told from any of its threads. JSON: `{"event": "swapped", "times": 1, "refresh": 0}`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// An output shows a panel.
    Shows {
        /// The panel.
        panel: Shows,
        /// The output's name.
        output: String,
        /// Its left upper corner in the layout of all outputs, pixels.
        position: [i32; 2],
        /// Its columns and rows.
        size: [usize; 2],
        /// Its refresh rate, where it is known.
        refresh_hz: Option<f64>,
    },
    /// The windows are there.
    Started,
    /// New pictures are shown since a refresh.
    Swapped {
        /// How often so far.
        times: u64,
        /// Number of the first refresh that shows them.
        refresh: u64,
    },
    /// Something that the user should know. At the boundary of plugins it is logged, so it has no JSON.
    #[serde(skip)]
    Warning(String),
    /// The panel that keys now shift.
    Nudged {
        /// The panel.
        panel: Shows,
        /// Its shift to the right and down, panel pixels.
        nudge_px: [f64; 2],
    },
    /// Somebody wants the nudges kept.
    Save {
        /// The display with them.
        display: Box<Display>,
    },
    /// Counts so far; the last event has those of the whole presentation.
    Report(Box<Report>),
}

/// Counts of a presentation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct Report {
    /// Refreshes that were submitted.
    pub refreshes: u64,
    /// Seconds from the first to the last.
    pub seconds: f64,
    /// Refreshes per second.
    pub rate_hz: f64,
    /// Seconds between refreshes that late ones are measured against.
    pub interval_s: f64,
    /// Where `interval_s` comes from.
    pub interval_from: String,
    /// New pictures that were taken.
    pub swaps: u64,
    /// Surfaces whose picture could not be had in time, by output.
    pub missed: u64,
    /// By times of submission; none before the first.
    pub submitted: Option<Tally>,
    /// By what the platform tells, for each output. Empty where it tells nothing.
    pub presented: BTreeMap<String, Tally>,
    /// Mean time between the outputs that show the same refresh first and last, as the platform tells. None where it does not, or there is one surface.
    pub skew_mean_s: Option<f64>,
    /// The longest such time.
    pub skew_largest_s: Option<f64>,
    /// (refresh, place in the period, number of the pictures, seconds) of every submission, where wanted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub log: Vec<(u64, usize, u64, f64)>,
}
