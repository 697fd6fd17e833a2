//! A presentation: its content, its commands and its events. A period is one cycle through all
//! frames, and in a colour sequence through all colours of each frame.

use std::collections::BTreeMap;
use std::time::Duration;

use lumistack_plugin::display::{Display, LayerStack};
use lumistack_plugin::serde::{Deserialize, Serialize};

use crate::pattern::Pattern;
use crate::shows::Shows;
use crate::tally::Tally;

/// Settings of a presentation.
#[derive(Debug)]
pub struct Settings {
    /// The display, with its panels' calibration.
    pub display: Display,
    /// The content that is shown first.
    pub content: Content,
    /// The surfaces to open.
    pub mode: Mode,
    /// True if masks are scaled to fill the panels ([`crate::fit`]).
    pub fit: bool,
    /// The frame that all refreshes show until a command selects another; `None` shows all frames
    /// one after another.
    pub hold: Option<usize>,
    /// Duration of the presentation; `None` for a presentation that runs until the user closes it.
    pub duration: Option<Duration>,
    /// True if [`Report::log`] records the time of every refresh.
    pub log: bool,
}

/// The content of a presentation.
#[derive(Clone, Debug)]
pub enum Content {
    /// The frames of a stack.
    Stack(LayerStack),
    /// A test pattern.
    Pattern {
        /// The pattern.
        pattern: Pattern,
        /// The panel that alone shows the pattern; `None` for all panels.
        only: Option<Shows>,
        /// Eye position for which the crosses coincide, in display space, millimetres.
        eye_mm: [f64; 3],
    },
    /// A picture on one panel, at the panel's full resolution; the other panels are clear.
    Flat {
        /// The picture, sRGB codes.
        picture: image::RgbImage,
        /// The layer that shows the picture.
        layer: usize,
    },
    /// A preview of the display from one angle, in an ordinary window.
    Preview {
        /// The layer stack that the preview simulates.
        stack: LayerStack,
        /// Direction of the viewer, degrees to the right and up from the display's axis.
        from_deg: [f64; 2],
    },
}

/// The surfaces that a presentation opens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "snake_case")]
pub enum Mode {
    /// One surface per output.
    Outputs,
    /// One surface across all outputs, so that all outputs change their frames together.
    Span,
    /// One ordinary window.
    Window,
}

/// A command to a running presentation. JSON: `{"hold": 1}`, `"run"`,
/// `{"nudge": ["layer 0", [1.0, -2.0]]}`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "snake_case")]
pub enum Command {
    /// A new layer stack, which replaces the old stack between two periods. Plugin hosts submit the
    /// stack as data, so this command has no JSON.
    #[serde(skip)]
    Stack(LayerStack),
    /// Show only this frame; in a colour sequence, show only the frame's first colour.
    Hold(usize),
    /// Show all frames one after another.
    Run,
    /// Show a later (positive) or earlier (negative) frame, relative to the frame that is held. If
    /// no frame is held, count from frame 0.
    Step(i64),
    /// Shift a panel's picture by [right, down] panel pixels.
    Nudge(Shows, [f64; 2]),
    /// Emit [`Event::Save`], with which the program saves the panels' shifts.
    Save,
    /// Set the direction of the preview's viewer, degrees to the right and up.
    Look([f64; 2]),
    /// Emit [`Event::Report`] with the statistics so far.
    Report,
    /// End the presentation.
    Quit,
}

/// An event of a presentation, emitted by any of its threads.
/// JSON: `{"event": "swapped", "times": 1, "refresh": 0}`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// An output drives a panel.
    Shows {
        /// The panel, named by its layer or the backlight.
        panel: Shows,
        /// The name of the output.
        output: String,
        /// The output's upper left corner in the layout of all outputs, pixels.
        position: [i32; 2],
        /// The output's [columns, rows].
        size: [usize; 2],
        /// The output's refresh rate, hertz; `None` if the platform does not report it.
        refresh_hz: Option<f64>,
    },
    /// The windows are open.
    Started,
    /// New frames are shown: the first frames, or frames after a change of the layer stack, of a
    /// panel's shift, or of the preview's viewer or window.
    Swapped {
        /// Number of these events so far.
        times: u64,
        /// Number of the first refresh that shows the new frames.
        refresh: u64,
    },
    /// A warning for the user. Plugin hosts log warnings, so this event has no JSON.
    #[serde(skip)]
    Warning(String),
    /// The user has shifted a panel, or has selected another panel for shifts.
    Nudged {
        /// The panel, named by its layer or the backlight.
        panel: Shows,
        /// The panel's shift to the right and down, panel pixels.
        nudge_px: [f64; 2],
    },
    /// The direction of the preview's viewer has changed.
    Looked {
        /// Viewing angles to the right and up, degrees.
        from_deg: [f64; 2],
    },
    /// A request to save the nudges.
    Save {
        /// The display, with the nudges.
        display: Box<Display>,
    },
    /// Statistics so far; the last event has the statistics of the whole presentation.
    Report(Box<Report>),
}

/// Statistics of a presentation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct Report {
    /// Number of refreshes submitted.
    pub refreshes: u64,
    /// Seconds from the first to the last refresh.
    pub seconds: f64,
    /// Refreshes per second.
    pub rate_hz: f64,
    /// The expected interval between refreshes, seconds, by which late refreshes are recognized.
    pub interval_s: f64,
    /// The source of `interval_s`.
    pub interval_from: String,
    /// Number of [`Event::Swapped`] events.
    pub swaps: u64,
    /// Number of surface images that could not be acquired, summed over all surfaces.
    pub missed: u64,
    /// Statistics from the times at which refreshes were submitted; `None` if the present loop has
    /// not started.
    pub submitted: Option<Tally>,
    /// Statistics from the platform's presentation times, per surface. Empty if the platform
    /// reports none.
    pub presented: BTreeMap<String, Tally>,
    /// Mean skew, seconds: the time from the presentation of a refresh on the first output to its
    /// presentation on the last output. `None` without the platform's presentation times, and with
    /// only one surface.
    pub skew_mean_s: Option<f64>,
    /// Largest skew of a refresh, seconds. `None` in the same cases as the mean skew.
    pub skew_largest_s: Option<f64>,
    /// (refresh number, position in the period, number of the frame set, seconds) of each of the
    /// first 2^20 refreshes, if requested. A new layer stack makes a new frame set, and so does any
    /// other change of the frames.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub log: Vec<(u64, usize, u64, f64)>,
}
