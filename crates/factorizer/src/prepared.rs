//! What a run begins with: the problem in the kernels' layout, patterns, and where they shall live.

use std::sync::Arc;

use lumistack_display::{Backlight, Display, LayerStack};

use crate::coarse;
use crate::device::{Begin, Executor, Updater};
use crate::factor::Factor;
use crate::plan::Plan;
use crate::{FactorizeError, Problem};

/// A checked problem and the patterns that a run begins with. Several may share one plan: it holds the target, which takes longest to prepare.
#[derive(Clone)]
pub(crate) struct Prepared<'a> {
    pub(crate) plan: Arc<Plan>,
    pub(crate) display: &'a Display,
    pub(crate) patterns: Patterns<'a>,
    pub(crate) executor: &'a dyn Executor,
}

/// Where patterns come from.
#[derive(Clone)]
pub(crate) enum Patterns<'a> {
    Stack(LayerStack),
    /// A solution at half the resolution.
    Coarse(&'a [Factor]),
}

impl<'a> Prepared<'a> {
    /// From scratch.
    pub(crate) fn new(
        problem: &Problem<'a>,
        start: LayerStack,
        executor: &'a dyn Executor,
    ) -> Result<Self, FactorizeError> {
        let plan = Arc::new(Plan::new(problem)?);
        start.check(problem.display)?;
        Ok(Self { plan, display: problem.display, patterns: Patterns::Stack(start), executor })
    }

    /// Hands the patterns over to the executor; see [`Begin`].
    pub(crate) fn begin(self, floor: f32, bold: bool) -> Result<Box<dyn Updater>, FactorizeError> {
        let executor = self.executor;
        executor.begin(self.into_begin(floor, bold))
    }

    /// Values, now and later, stay within the hardware's box and at `floor` or above.
    pub(crate) fn into_begin(self, floor: f32, bold: bool) -> Begin {
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
        Begin { plan, display: display.clone(), ranges, factors, bold }
    }
}

/// The boxes of a display's values: layers, then the backlight.
pub(crate) fn ranges_of(display: &Display) -> Vec<[f32; 2]> {
    let mut ranges: Vec<[f32; 2]> = display.layers.iter().map(|layer| layer.range()).collect();
    if let Backlight::Lenslets(lenslets) = &display.backlight {
        ranges.push(lenslets.range());
    }
    ranges
}
