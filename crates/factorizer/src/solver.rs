//! What every solver offers: start on a problem, step, report the objective, hand the patterns back.

use lumistack_core::Cancel;
use lumistack_display::LayerStack;

use crate::problem::{FactorizeError, Problem};

/// Name of the choice of solver by what the benchmarks show to be best.
pub const AUTO: &str = "auto";

/// A method that improves patterns iteration by iteration.
pub trait Solver: Sync {
    /// Name by which it is chosen.
    fn name(&self) -> &'static str;

    /// One sentence for people who choose.
    fn doc(&self) -> &'static str;

    /// Prepares a run that begins at `start`; values outside the solver's box are moved into it.
    ///
    /// # Errors
    /// If the problem or the start is unusable.
    fn start<'a>(&self, problem: &Problem<'a>, start: LayerStack) -> Result<Box<dyn Run + 'a>, FactorizeError>;
}

/// A factorization under way. The patterns may live elsewhere (on a GPU) until they are downloaded.
pub trait Run {
    /// One iteration: every factor once.
    ///
    /// # Errors
    /// When cancelled, which is asked for every line of a factor (of a device: for every factor); the patterns so far remain usable. When the device is
    /// lost; the patterns are lost with it.
    fn step(&mut self, cancel: &Cancel) -> Result<(), FactorizeError>;

    /// The objective of the present patterns.
    fn objective(&mut self) -> Objective;

    /// How far the patterns are from the first-order (KKT) conditions: root mean square, over all values, of the change of the emission (root of
    /// the weighted sum of squares over the rays through the pixel, weights relative to the largest) that an exact coordinate step within the
    /// box would still make.
    fn unsettled(&mut self) -> f64;

    /// Ends a run: values that next to no light reaches, and which the objective therefore leaves open, become the darkest that the hardware can show.
    /// Else a real layer, whose black is not quite black, would leak there. Returns [`unsettled`](Self::unsettled).
    ///
    /// A value counts as unlit where the other layers pass, in its frame and over its rays, at most a ten-thousandth of the brightness (root mean
    /// square); pixels without a weighted ray keep what they have, since views between the target's may see them.
    fn settle(&mut self) -> f64;

    /// Number of rays with w > 0 that meet the display.
    fn rays(&self) -> u64;

    /// Whether the patterns are still there, and so whether the objective and the patterns last returned were theirs: a device may be lost.
    ///
    /// # Errors
    /// If they are not.
    fn check(&self) -> Result<(), FactorizeError>;

    /// The present patterns.
    fn download(&mut self) -> LayerStack;
}

/// How far patterns are from the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Objective {
    /// Σ w (βL − L̃)² over all rays and channels (eq. 27).
    pub value: f64,
    /// PSNR in dB of L̃/β against L, peak 1, over all rays with w > 0 and all channels; NaN when no ray counts.
    pub psnr_view: f64,
}
