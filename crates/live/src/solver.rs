//! Factorization that starts from the previous patterns.
//!
//! ```text
//! new content:     start = the best of: previous patterns, moved patterns, fresh patterns
//! moved patterns:  strips that content has entered ──a few updates of the strips──▶ start
//! every step:      start ──a few updates──▶ patterns, the next start
//! ```
//!
//! Moved patterns are the previous patterns, moved along with the content. Fresh patterns do not
//! depend on the previous patterns.

use std::sync::Arc;

use lumistack_core::Task;
use lumistack_display::{LayerStack, Region, Tile, TilePart, Tiling};
use lumistack_factorizer::device::Executor;
use lumistack_factorizer::{AUTO, FactorizeError, Problem, Settings, factorize_on, factorize_tile, warm_start_pays};

use crate::Target;
use crate::eyes::Rays;
use crate::motion::{Flow, Planes, moved};

/// The solver of a warm start if the settings have the solver `auto`. It does not extrapolate,
/// since with few iterations from patterns of another target an extrapolation would overshoot.
const WARM_SOLVER: &str = "block-exact";

/// A warm start with at least this PSNR, dB, is used without a comparison with a fresh start. The
/// comparison takes longer than a step.
const GOOD_DB: f64 = 20.0;

/// Width of the strips of new content that are solved before the whole display, pixels of the light
/// field.
const STRIP: usize = 16;

/// A strip is solved before the whole display if, on any layer or on the backlight, new content has
/// entered more than this fraction of its pixels.
const NEW: f64 = 0.25;

/// Number of iterations of a strip, before the whole display is solved. In a measurement, content
/// moved by 10 pixels per time step on a display of 160 columns. Four iterations gained 1 dB, and
/// eight iterations 0.4 dB more. Four iterations cost less than one iteration of the whole display.
const AHEAD: u32 = 4;

/// The patterns from which a step starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Fresh factors, which do not depend on the previous patterns.
    Fresh,
    /// The previous patterns.
    Kept,
    /// The previous patterns, moved along with the content.
    Moved,
}

/// Patterns after a step.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The patterns as a layer stack.
    pub stack: LayerStack,
    /// PSNR in dB of the emitted light field L̃/β against the target L, over the rays that were
    /// solved and have a weight above 0.
    pub psnr_view: f64,
    /// The start of the step's iterations.
    pub start: Start,
}

/// Solves targets one after another, each from the patterns of the previous one.
pub struct Solver {
    settings: Settings,
    last: Option<Last>,
}

/// The result of the previous step.
struct Last {
    target: Arc<Target>,
    /// Means of the target over the rays through each pixel of each layer.
    planes: Planes,
    stack: LayerStack,
}

impl Solver {
    /// Makes a solver. Warm starts also use `settings`, but with the solver `block-exact` instead
    /// of `auto`. The number of iterations in `settings` is ignored.
    pub fn new(settings: Settings) -> Self {
        Self { settings, last: None }
    }

    /// Replaces the settings from the next step on.
    pub fn set(&mut self, settings: Settings) {
        self.settings = settings;
    }

    /// Executes `updates` iterations towards a target, along `rays`, on an executor. The next step
    /// starts from the resulting patterns.
    ///
    /// # Errors
    /// If target, rays and settings do not match, if the executor fails, or when cancelled.
    /// After an error, the next step starts from the same patterns as this step.
    pub fn step(
        &mut self,
        executor: &dyn Executor,
        target: &Arc<Target>,
        rays: &Rays,
        updates: u32,
        task: Task<'_>,
    ) -> Result<Solved, FactorizeError> {
        let problem = rays.problem(target);
        let fresh = Settings { iterations: updates, report_every: u32::MAX, ..self.settings.clone() };
        let rule = if fresh.solver == AUTO { WARM_SOLVER.into() } else { fresh.solver.clone() };
        let warm = Settings { solver: rule, ..fresh.clone() };
        // The previous patterns can be used only if they have the shapes of the target's display.
        let last = self.last.take_if(|last| last.stack.check(&target.display).is_err());
        drop(last);
        // Choose the start. If the content is unchanged, the start is the previous patterns. For
        // new content, possible starts are compared.
        let same_content = self.last.as_ref().is_some_and(|last| last.target.content == target.content);
        let planes = match &mut self.last {
            Some(last) if same_content => last.planes.clone(),
            _ => Planes::of(&target.display, &target.field, task.cancel)?,
        };
        let (start, from) = match &self.last {
            None => (None, Start::Fresh),
            Some(last) if same_content => (Some(last.stack.clone()), Start::Kept),
            Some(last) => nearest_start(executor, &problem, [&fresh, &warm], last, &planes, task)?,
        };
        let settings = if start.is_some() { &warm } else { &fresh };
        let done = factorize_on(executor, &problem, settings, start.as_ref(), task, &mut |_| {})?;
        let psnr_view = done.history.last().map_or(f64::NAN, |end| end.psnr_view);
        self.last = Some(Last { target: target.clone(), planes, stack: done.stack.clone() });
        Ok(Solved { stack: done.stack, psnr_view, start: from })
    }
}

/// Chooses the start for new content; `None` stands for fresh patterns. The comparison with fresh
/// patterns is computed on the processor.
fn nearest_start(
    executor: &dyn Executor,
    problem: &Problem<'_>,
    [fresh, warm]: [&Settings; 2],
    last: &Last,
    planes: &Planes,
    task: Task<'_>,
) -> Result<(Option<LayerStack>, Start), FactorizeError> {
    let (mut best, mut from) = (last.stack.clone(), Start::Kept);
    let mut psnr_view = at_start(executor, problem, warm, Some(&best), task)?.1;
    if let Some(flows) = last.planes.flows_to(planes, task.cancel)? {
        let (start, _) = at_start(executor, problem, fresh, None, task)?;
        let other = moved(&best, &flows, &start);
        let ahead = at_start(executor, problem, warm, Some(&other), task)?.1;
        if ahead > psnr_view {
            let other = with_border(problem, warm, other, &flows, task)?;
            (best, from, psnr_view) = (other, Start::Moved, ahead);
        }
    }
    if psnr_view >= GOOD_DB || warm_start_pays(problem, fresh, &best, &warm.solver, task)? {
        Ok((Some(best), from))
    } else {
        Ok((None, Start::Fresh))
    }
}

/// Returns patterns before the first iteration, and their PSNR. Without `stack`, these are the
/// patterns of a fresh start.
fn at_start(
    executor: &dyn Executor,
    problem: &Problem<'_>,
    settings: &Settings,
    stack: Option<&LayerStack>,
    task: Task<'_>,
) -> Result<(LayerStack, f64), FactorizeError> {
    let settings = Settings { iterations: 0, levels: false, ..settings.clone() };
    let done = factorize_on(executor, problem, &settings, stack, task, &mut |_| {})?;
    Ok((done.stack, done.history.last().map_or(f64::NEG_INFINITY, |start| start.psnr_view)))
}

/// Solves the strips of the display that new content has entered, on the processor. At first, the
/// patterns of a strip are fresh, so they do not match the moved patterns beside the strip.
/// Iterations of the whole display would remove this mismatch only slowly. Patterns outside of the
/// strips do not change.
///
/// # Errors
/// If a strip cannot be solved, or when cancelled.
fn with_border(
    problem: &Problem<'_>,
    warm: &Settings,
    mut stack: LayerStack,
    flows: &[Flow],
    task: Task<'_>,
) -> Result<LayerStack, FactorizeError> {
    let settings = Settings { iterations: AHEAD, levels: false, ..warm.clone() };
    let geometry = problem.target.geometry();
    let strips = [[geometry.cols.div_ceil(STRIP), 1], [1, geometry.rows.div_ceil(STRIP)]];
    for tiling in strips.map(|tiles| Tiling::new(problem.display, geometry, tiles)) {
        let tiles: Vec<Tile> = (0..tiling.count()).map(|number| tiling.tile(number)).collect();
        let is_new = |tile: &&Tile| tile.parts.iter().zip(flows).any(|(part, flow)| flow.new_share(&part.own) > NEW);
        let new: Vec<&Tile> = tiles.iter().filter(is_new).collect();
        // If content has entered more than half of the strips, do not solve strips, since the
        // strips would cost as much as the whole display.
        if 2 * new.len() > tiles.len() {
            continue;
        }
        for tile in new {
            let Some(weights) = tile.weights(problem.weights) else { continue };
            let (display, target) = (tile.display(problem.display, geometry), tile.light_field(problem.target));
            let of = |region: fn(&TilePart) -> &Region| -> Vec<Region> {
                tile.parts.iter().map(|part| region(part).clone()).collect()
            };
            let (held, free) = (of(|part| &part.held), of(|part| &part.free));
            let within: Vec<Region> = free.iter().zip(&held).map(|(free, held)| free.within(held)).collect();
            let part = Problem { display: &display, target: &target, weights: &weights };
            let before = stack.cut(&held);
            match factorize_tile(&part, (tile, tiling.map()), &settings, (Some(&before), true), task, &mut |_| {}) {
                Ok(solved) => stack.paste(&whole(tile), &solved.stack.cut(&within), &free),
                Err(FactorizeError::NoRays) => {}
                Err(error) => return Err(error),
            }
        }
    }
    Ok(stack)
}

/// Returns the regions of all pixels of the whole display: one region per layer, and one for the
/// lenslets.
fn whole(tile: &Tile) -> Vec<Region> {
    tile.whole.iter().map(|&[rows, cols]| Region { rows: 0..rows, cols: 0..cols }).collect()
}
