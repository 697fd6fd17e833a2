//! What a run begins with: the problem in the kernels' layout, and patterns.

use std::sync::Arc;

use lumistack_display::{Display, LayerStack};

use crate::engine::{Engine, Patterns};
use crate::plan::Plan;
use crate::{FactorizeError, Problem};

/// A checked problem and the patterns that a run begins with. Several may share one plan: it holds the target, which takes longest to prepare.
#[derive(Clone)]
pub(crate) struct Prepared<'a> {
    pub(crate) plan: Arc<Plan>,
    pub(crate) display: &'a Display,
    pub(crate) patterns: Patterns<'a>,
}

impl<'a> Prepared<'a> {
    /// From scratch.
    pub(crate) fn new(problem: &Problem<'a>, start: LayerStack) -> Result<Self, FactorizeError> {
        let plan = Arc::new(Plan::new(problem)?);
        start.check(problem.display)?;
        Ok(Self { plan, display: problem.display, patterns: Patterns::Stack(start) })
    }

    /// Values, now and later, stay within the hardware's box and at `floor` or above.
    pub(crate) fn engine(self, floor: f32) -> Engine {
        Engine::begin(self.plan, self.display, floor, &self.patterns)
    }
}

#[cfg(test)]
impl Engine {
    /// From scratch.
    pub(crate) fn new(problem: &Problem, start: LayerStack, floor: f32) -> Result<Self, FactorizeError> {
        Ok(Prepared::new(problem, start)?.engine(floor))
    }
}
