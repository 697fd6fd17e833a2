//! The interface of all solvers: start on a problem, step, report the objective, return the
//! patterns.

use lumistack_core::Cancel;
use lumistack_display::{Display, LayerStack};

use crate::problem::{FactorizeError, Problem};

/// Name that selects the solver with the best results in the benchmarks.
pub const AUTO: &str = "auto";

/// An algorithm that finds patterns iteration by iteration.
pub trait Solver: Sync {
    /// Returns the name that selects the solver.
    fn name(&self) -> &'static str;

    /// Returns a short text that helps users choose.
    fn doc(&self) -> &'static str;

    /// Checks that the solver can find patterns for a display, before there is a target.
    ///
    /// # Errors
    /// [`FactorizeError::Unsuitable`], with the reason.
    fn suits(&self, _display: &Display) -> Result<(), FactorizeError> {
        Ok(())
    }

    /// Prepares a run from the patterns `start`; clamps their values to the solver's box.
    ///
    /// # Errors
    /// If the problem or the start is unusable, or if the file for a copy of the target cannot be
    /// written.
    fn start<'a>(&self, problem: &Problem<'a>, start: LayerStack) -> Result<Box<dyn Run + 'a>, FactorizeError>;
}

/// A factorization in progress. Its patterns may be on a device (a GPU) until they are downloaded.
pub trait Run {
    /// Runs one iteration: updates every factor once.
    ///
    /// Fails when cancelled; the patterns so far remain usable. Cancellation is checked
    /// before every line of a factor, on a device before every factor. The iteration also fails if
    /// the device, and with it the patterns, are lost.
    fn step(&mut self, cancel: &Cancel) -> Result<(), FactorizeError>;

    /// Computes the objective of the current patterns.
    fn objective(&mut self) -> Objective;

    /// Returns the objective that the last step obtained from its own sums. This may be the
    /// objective of the extrapolated patterns instead of the last iterate.
    ///
    /// Returns `None` before the first step, after a restart, or if the sums do not contain the
    /// objective. [`Self::objective`] computes the objective in any case.
    fn known_objective(&self) -> Option<Objective>;

    /// Computes the KKT residual: the distance of the patterns from the first-order conditions.
    ///
    /// For every value, an exact coordinate step within the box would change the emission by
    /// √Σ w ΔL̃², summed over the rays through the pixel. The residual is the root mean square of
    /// these changes over all values that may change. The weights w are relative to the largest
    /// weight.
    fn kkt_residual(&mut self) -> f64;

    /// Ends a run: sets unlit values to the darkest value that the hardware shows. Returns the KKT
    /// residual, see [`kkt_residual`](Self::kkt_residual).
    ///
    /// Almost no light reaches an unlit value, so the objective does not determine it. On real
    /// hardware the other layers are not quite black, so a bright unlit value would leak light. The
    /// light of a value is the light that the other layers transmit to its pixel in its frame. A
    /// value is unlit if the root mean square of its light over its rays is at most 10⁻⁴ of the
    /// brightness. Pixels without a weighted ray keep their values, since views between the
    /// target's views may see them.
    fn darken_unlit(&mut self) -> f64;

    /// Returns the number of rays with w > 0 that hit all layers, and the grid of lenslets, if
    /// there is one. If the display allows rays that miss layers, these rays count too.
    fn rays(&self) -> u64;

    /// Checks that the patterns still exist; a lost device loses them. The results of
    /// [`objective`](Self::objective), [`kkt_residual`](Self::kkt_residual) and
    /// [`darken_unlit`](Self::darken_unlit) are valid only if a check after them succeeds.
    ///
    /// # Errors
    /// If the patterns are lost.
    fn check(&self) -> Result<(), FactorizeError>;

    /// Returns the current patterns.
    fn download(&mut self) -> LayerStack;
}

/// Distance of patterns from the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Objective {
    /// Σ w (βL − L̃)² over all rays and channels (eq. 27).
    pub value: f64,
    /// PSNR of L̃/β against L with a peak of 1, dB. It covers all rays with w > 0 and all channels,
    /// and is NaN if no ray has w > 0.
    pub psnr_view: f64,
}
