//! The internal interface of solvers: they start runs on prepared problems, which several runs may
//! share.

use crate::FactorizeError;
use crate::device::Updater;
use crate::prepared::Prepared;
use crate::solver::{Run, Solver};

/// A solver that can start on a prepared problem.
pub(crate) trait Method: Solver {
    /// Does the same as [`Solver::start`], on a prepared problem.
    fn begin(&self, prepared: Prepared) -> Result<Box<dyn Iterated>, FactorizeError>;
}

/// A run that can hand over its patterns.
pub(crate) trait Iterated: Run {
    /// Ends the run and returns the updater that holds its patterns.
    fn finish(self: Box<Self>) -> Box<dyn Updater>;
}
