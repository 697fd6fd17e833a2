//! Patterns for panels of few bits: confines one mask after another to the panel's levels, and lets
//! the other masks compensate for the error.
//!
//! The masks are confined frame by frame and layer by layer to the levels that the panel can show
//! ([`lumistack_display::Layer::levels`]). Each mask is confined by an update of the mask's layer:
//! every coordinate step of the mask's values goes to the level nearest to the minimum. This level
//! is the best one, since the objective, or its upper bound, is a parabola along a coordinate.
//! Frames that are not yet confined, and later layers, then reduce the error. Confined values still
//! move from level to level, so a few last iterations gain more. Once all masks are confined, the
//! objective never rises.

use lumistack_core::Task;
use lumistack_display::{Display, LayerStack};

use crate::device::Updater;
use crate::engine::{Engine, Processor};
use crate::prepared::Prepared;
use crate::step::{Freedom, Levels, Rule};
use crate::{FactorizeError, Problem};

/// Number of sweeps of coordinate steps per update.
const SWEEPS: u32 = 4;
/// Number of iterations over all factors after the last mask is confined to its levels.
const LAST_ROUNDS: u32 = 3;

/// Returns true if any layer has few levels.
pub fn has_levels(problem: &Problem) -> bool {
    problem.display.layers.iter().any(|layer| layer.bits.is_some())
}

/// Rounds every value to the nearest level of its layer. Layers without few bits keep their values.
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

/// Re-optimizes a continuous solution on the layers' levels.
///
/// # Errors
/// If the problem or the stack are unusable, or when cancelled.
pub fn reoptimize_on_levels(problem: &Problem, stack: LayerStack, task: Task) -> Result<LayerStack, FactorizeError> {
    reoptimize(Prepared::new(problem, stack, &Processor)?, task)
}

/// Does the same as [`reoptimize_on_levels`] on a prepared problem, on the processor for every
/// executor.
pub(crate) fn reoptimize(prepared: Prepared, task: Task) -> Result<LayerStack, FactorizeError> {
    let display = prepared.display;
    let (frames, layers) = (display.frames, &display.layers);
    let mut engine = Engine::begin(prepared.into_begin(0.0, false));
    engine.cancel = task.cancel.clone();
    // at first, no frame of the layers with few bits is confined
    let few: Vec<usize> = (0..layers.len()).filter(|&n| layers[n].bits.is_some()).collect();
    for &n in &few {
        let values = layers[n].levels();
        engine.levels[n] = values.map(|values| Levels { values, frames: vec![Freedom::Free; frames] });
    }
    let rule = Rule::Block { sweeps: SWEEPS };
    let steps = few.len() * frames + LAST_ROUNDS as usize * engine.plan().factor_count();
    task.progress.begin("quantize", steps as u64, "updates");
    let update = |engine: &mut Engine, n: usize| -> Result<(), FactorizeError> {
        engine.update(n, rule, None);
        task.cancel.check()?;
        task.progress.advance(1, "");
        Ok(())
    };
    // Confine the masks frame by frame, so that frames that are still free compensate for the
    // errors.
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
    // round values that no ray reads, since no step has moved them to a level
    done.map(|()| round(display, &engine.download()))
}
