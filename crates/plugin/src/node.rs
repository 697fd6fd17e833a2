//! What a node is given, and what it tells about how it made the patterns.

use lumistack_display::{Display, LayerStack, Weights};
use lumistack_plugin_abi::{StackSink, Str};
use serde::{Deserialize, Serialize};

use crate::input::FieldInput;
use crate::time::Time;
use crate::wire::call;
use crate::{Host, PluginError};

/// One light field of which a node makes the patterns of a display.
#[derive(Debug)]
pub struct NodeInput<'a> {
    pub(crate) host: Host,
    pub(crate) display: Display,
    pub(crate) time: Time,
    pub(crate) field: FieldInput<'a>,
    pub(crate) sink: &'a StackSink,
}

/// Where an iterative method stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Iterations done; 0 at the start.
    pub iteration: u32,
    /// What the method makes small.
    pub objective: f64,
    /// PSNR of what is shown against the target, dB; NaN where it is not known.
    pub psnr_view: f64,
}

/// How an iterative method came to the patterns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// Name of the method.
    pub solver: String,
    /// Where it began, a word.
    pub start: String,
    /// Levels of half the resolution each that came before the first iteration.
    pub coarse_levels: u32,
    /// Root mean square of the change of the emission that a further exact step would make.
    pub unsettled: f64,
    /// PSNR in dB for panels of few bits: of continuous, rounded and re-optimized patterns. `None` where panels have many.
    pub levels: Option<[f64; 3]>,
}

impl NodeInput<'_> {
    /// Messages, progress and cancellation.
    pub fn host(&self) -> &Host {
        &self.host
    }

    /// The display.
    pub fn display(&self) -> &Display {
        &self.display
    }

    /// Place in a sequence.
    pub fn time(&self) -> Time {
        self.time
    }

    /// The light field, of the display's own geometry.
    pub fn field(&self) -> &FieldInput<'_> {
        &self.field
    }

    /// Seed of everything random.
    pub fn seed(&self) -> u64 {
        self.field.seed()
    }

    /// How much each ray of the light field counts.
    ///
    /// # Errors
    /// If the host cannot lend them, or they are no weights.
    pub fn weights(&self) -> Result<Weights, PluginError> {
        self.field.weights()
    }

    /// Patterns from which to begin, such as those of the time before; `None` where there are none.
    ///
    /// # Errors
    /// If the host cannot lend them.
    pub fn start(&self) -> Result<Option<LayerStack>, PluginError> {
        self.field.start(&self.display)
    }

    /// Reports where an iterative method stands, for the curve of convergence in reports. In order, the start first.
    ///
    /// # Errors
    /// If the host does not take it.
    pub fn step(&self, step: Step) -> Result<(), PluginError> {
        let Step { iteration, objective, psnr_view } = step;
        // SAFETY: the sink's own context, valid for as long as the input is lent.
        call(|error| unsafe { (self.sink.step)(self.sink.context, iteration, objective, psnr_view, error) })
    }

    /// Reports how the patterns were found; once.
    ///
    /// # Errors
    /// If the host does not take it.
    pub fn solution(&self, solution: &Solution) -> Result<(), PluginError> {
        let json = serde_json::to_string(solution).map_err(|error| PluginError::failed("solution", error))?;
        // SAFETY: as in `step`; the text is lent for the call.
        call(|error| unsafe { (self.sink.solution)(self.sink.context, Str::new(&json), error) })
    }
}
