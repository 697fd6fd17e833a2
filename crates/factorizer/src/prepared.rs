//! The input of a run: the problem in the kernels' layout, patterns, and the device.

use std::sync::Arc;

use lumistack_display::{Backlight, Display, LayerStack};

use crate::coarse;
use crate::device::{Begin, Executor, Updater};
use crate::factor::Factor;
use crate::plan::Plan;
use crate::{FactorizeError, Problem};

/// A checked problem and initial patterns. Several runs may share a plan, since it holds the
/// target, which takes longest to prepare.
#[derive(Clone)]
pub(crate) struct Prepared<'a> {
    pub(crate) plan: Arc<Plan>,
    pub(crate) display: &'a Display,
    pub(crate) patterns: Patterns<'a>,
    pub(crate) executor: &'a dyn Executor,
}

/// The source of the initial patterns.
#[derive(Clone)]
pub(crate) enum Patterns<'a> {
    Stack(LayerStack),
    /// A solution at half the resolution.
    Coarse(&'a [Factor]),
}

impl<'a> Prepared<'a> {
    /// Checks and prepares a problem.
    pub(crate) fn new(
        problem: &Problem<'a>,
        start: LayerStack,
        executor: &'a dyn Executor,
    ) -> Result<Self, FactorizeError> {
        let plan = Arc::new(Plan::new(problem)?);
        start.check(problem.display)?;
        Ok(Self { plan, display: problem.display, patterns: Patterns::Stack(start), executor })
    }

    /// Starts the run on its executor. [`Self::into_begin`] describes `floor` and `tries_local`.
    pub(crate) fn begin(self, floor: f32, tries_local: bool) -> Result<Box<dyn Updater>, FactorizeError> {
        let executor = self.executor;
        executor.begin(self.into_begin(floor, tries_local))
    }

    /// Converts the patterns to factors. All values, now and later, are at least `floor` and within
    /// the hardware's box. [`Begin::tries_local`] describes `tries_local`.
    pub(crate) fn into_begin(self, floor: f32, tries_local: bool) -> Begin {
        let Self { plan, display, patterns, .. } = self;
        let mut ranges = ranges_of(display);
        ranges.iter_mut().for_each(|[low, high]| *low = low.max(floor).min(*high));
        let layouts = plan.maps.iter().map(|map| &map.layout).zip(&ranges);
        let factors: Vec<_> = match patterns {
            Patterns::Stack(stack) => {
                let tensors = stack.layers.iter().map(|t| t.data()).chain(stack.emission.iter().map(|t| t.data()));
                layouts.zip(tensors).map(|((layout, range), values)| Factor::upload(layout, values, *range)).collect()
            }
            Patterns::Coarse(coarse) => {
                layouts.zip(coarse).map(|((layout, range), own)| coarse::refine(own, layout, *range)).collect()
            }
        };
        Begin { plan, display: display.clone(), ranges, factors, tries_local }
    }
}

/// Returns the box of each factor's values: layers, then the backlight.
pub(crate) fn ranges_of(display: &Display) -> Vec<[f32; 2]> {
    let mut ranges: Vec<[f32; 2]> = display.layers.iter().map(|layer| layer.range()).collect();
    if let Backlight::Lenslets(lenslets) = &display.backlight {
        ranges.push(lenslets.range());
    }
    ranges
}
