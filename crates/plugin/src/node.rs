//! A node's input, and its reports on the solution.

use lumistack_display::{Display, LayerStack, Weights};
use lumistack_plugin_abi::{StackSink, Str};
use serde::{Deserialize, Serialize};

use crate::input::FieldInput;
use crate::time::Time;
use crate::wire::call;
use crate::{Host, PluginError};

/// The input of a node: a light field, and the display for which the node solves.
#[derive(Debug)]
pub struct NodeInput<'a> {
    pub(crate) host: Host,
    pub(crate) display: Display,
    pub(crate) time: Time,
    pub(crate) field: FieldInput<'a>,
    pub(crate) sink: &'a StackSink,
}

/// State of an iterative solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Number of completed iterations; 0 for the start.
    pub iteration: u32,
    /// The objective that the solver minimizes.
    pub objective: f64,
    /// PSNR of the emitted light field against the target, dB; NaN if unknown.
    pub psnr_view: f64,
}

/// Summary of a solution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// Name of the solver.
    pub solver: String,
    /// Name of the start, such as `random`; `warm` for a warm start.
    pub start: String,
    /// Number of coarser resolutions that were solved first. Each is half the next finer
    /// resolution.
    pub coarse_levels: u32,
    /// KKT residual. An exact update of a single value of the factors would change the emitted
    /// light field. The residual is the root mean square of these changes, over all values that may
    /// change.
    pub kkt_residual: f64,
    /// For panels of few bits, the PSNR in dB with continuous masks, with rounded masks, and with
    /// masks that are optimized again after the rounding. `None` for panels of many bits.
    pub levels: Option<[f64; 3]>,
}

impl NodeInput<'_> {
    /// Returns the host's services: messages, progress and cancellation.
    pub fn host(&self) -> &Host {
        &self.host
    }

    /// Returns the display that will show the layer stack.
    pub fn display(&self) -> &Display {
        &self.display
    }

    /// Returns the time step for which the layer stack is made.
    pub fn time(&self) -> Time {
        self.time
    }

    /// Returns the light field, which has the display's geometry.
    pub fn field(&self) -> &FieldInput<'_> {
        &self.field
    }

    /// Returns the seed for random numbers.
    pub fn seed(&self) -> u64 {
        self.field.seed()
    }

    /// Returns the weights of the light field's rays.
    ///
    /// # Errors
    /// If the host cannot lend them, or they are invalid.
    pub fn weights(&self) -> Result<Weights, PluginError> {
        self.field.weights()
    }

    /// Returns the layer stack to start from, such as the stack of the previous time step; `None`
    /// if the host gives none.
    ///
    /// # Errors
    /// If the host cannot lend it.
    pub fn start(&self) -> Result<Option<LayerStack>, PluginError> {
        self.field.start(&self.display)
    }

    /// Reports the solver's state, for the convergence plot of the report. Nodes call this function
    /// in the order of iterations, first for the start.
    ///
    /// # Errors
    /// If the host refuses the state.
    pub fn step(&self, step: Step) -> Result<(), PluginError> {
        let Step { iteration, objective, psnr_view } = step;
        // SAFETY: the context belongs to the sink, valid as long as the input.
        call(|error| unsafe { (self.sink.step)(self.sink.context, iteration, objective, psnr_view, error) })
    }

    /// Reports the summary of the solution. Nodes call this function at most once.
    ///
    /// # Errors
    /// If the host refuses the summary.
    pub fn solution(&self, solution: &Solution) -> Result<(), PluginError> {
        let json = serde_json::to_string(solution).map_err(|error| PluginError::failed("solution", error))?;
        // SAFETY: the context belongs to the sink, which is valid as long as the input; the text is
        // lent for the call.
        call(|error| unsafe { (self.sink.solution)(self.sink.context, Str::new(&json), error) })
    }
}
