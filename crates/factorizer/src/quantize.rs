//! Patterns for panels of few bits: one mask at a time goes to the panel's levels, and what is left makes up for it.
//!
//! Frame by frame and layer by layer, a mask's values are confined to the levels that the panel can show ([`lumistack_display::Layer::levels`]), and
//! its layer is updated: a coordinate step between levels goes to the level nearest to the minimum, which is exact for a parabola; frames of
//! the layer that are still free, and all layers after it, move to where the error is least. Masks that are on their levels keep moving from
//! level to level, so that a last few rounds still gain. From the first fully confined state on, the objective never rises.

use lumistack_core::Task;
use lumistack_display::{Display, LayerStack};

use crate::device::Updater;
use crate::engine::{Engine, Processor};
use crate::prepared::Prepared;
use crate::step::{Freedom, Levels, Rule};
use crate::{FactorizeError, Problem};

/// Rounds of coordinate steps per update.
const SWEEPS: u32 = 4;
/// Rounds over all layers at the end.
const LAST_ROUNDS: u32 = 3;

/// Whether any layer has few levels.
pub fn has_levels(problem: &Problem) -> bool {
    problem.display.layers.iter().any(|layer| layer.bits.is_some())
}

/// Every value rounded to the nearest level of its layer.
pub fn round_to_levels(problem: &Problem, stack: &LayerStack) -> LayerStack {
    round(problem.display, stack)
}

fn round(display: &Display, stack: &LayerStack) -> LayerStack {
    let mut rounded = stack.clone();
    for (layer, tensor) in display.layers.iter().zip(&mut rounded.layers) {
        if let Some(levels) = layer.levels() {
            tensor.data_mut().iter_mut().for_each(|value| *value = lumistack_display::quantize(*value, &levels));
        }
    }
    rounded
}

/// Patterns on the layers' levels, re-optimized from a solution without them.
///
/// # Errors
/// If the problem or the stack are unusable, or when cancelled.
pub fn reoptimize_on_levels(problem: &Problem, stack: LayerStack, task: Task) -> Result<LayerStack, FactorizeError> {
    reoptimize(Prepared::new(problem, stack, &Processor)?, task)
}

/// [`reoptimize_on_levels`] on what is prepared, whatever its executor: on the processor.
pub(crate) fn reoptimize(prepared: Prepared, task: Task) -> Result<LayerStack, FactorizeError> {
    let display = prepared.display;
    let (frames, layers) = (display.frames, &display.layers);
    let mut engine = Engine::begin(prepared.into_begin(0.0, false));
    engine.cancel = task.cancel.clone();
    let few: Vec<usize> = (0..layers.len()).filter(|&n| layers[n].bits.is_some()).collect();
    for &n in &few {
        let values = layers[n].levels();
        engine.levels[n] = values.map(|values| Levels { values, frames: vec![Freedom::Free; frames] });
    }
    let rule = Rule::Block { sweeps: SWEEPS };
    let steps = few.len() * frames + LAST_ROUNDS as usize * engine.plan().factor_count();
    task.progress.begin("quantize", steps as u64, "masks");
    let update = |engine: &mut Engine, n: usize| -> Result<(), FactorizeError> {
        engine.update(n, rule, None);
        task.cancel.check()?;
        task.progress.advance(1, "");
        Ok(())
    };
    let mut confine = || -> Result<(), FactorizeError> {
        for frame in 0..frames {
            for &n in &few {
                if let Some(levels) = &mut engine.levels[n] {
                    levels.frames[frame] = Freedom::Levels;
                }
                update(&mut engine, n)?;
            }
        }
        for _ in 0..LAST_ROUNDS {
            (0..engine.plan().factor_count()).try_for_each(|n| update(&mut engine, n))?;
        }
        Ok(())
    };
    let done = confine();
    task.progress.end();
    // a value that no ray depends on moved to no level: round what is left
    done.map(|()| round(display, &engine.download()))
}
