//! Solvers and runs as this crate sees them: on problems that are prepared once for several.

use crate::FactorizeError;
use crate::device::Updater;
use crate::prepared::Prepared;
use crate::solver::{Objective, Run, Solver};

/// A solver as this crate sees it.
pub(crate) trait Method: Solver {
    /// [`Solver::start`] on what is prepared already.
    fn begin(&self, prepared: Prepared) -> Result<Box<dyn Iterated>, FactorizeError>;
}

/// A run as this crate sees it.
pub(crate) trait Iterated: Run {
    /// The objective of the patterns that the last step met when it ended, which it found on its way. `None` where only [`Run::objective`] knows, or
    /// where the step was taken back.
    fn seen(&self) -> Option<Objective>;

    /// The patterns, where they are.
    fn finish(self: Box<Self>) -> Box<dyn Updater>;
}
