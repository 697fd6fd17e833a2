//! Start, iterate, report: what the pipeline calls.

use std::sync::Arc;

use lumistack_core::{Cancel, Task};
use lumistack_display::{Display, FieldGeometry, LayerStack, RayMap, Tile};

use crate::coarse::Coarse;
use crate::device::{Executor, Updater};
use crate::engine::{Engine, Processor};
use crate::factor::Factor;
use crate::method::{Iterated, Method};
use crate::plan::{Cut, Plan};
use crate::prepared::{Patterns, Prepared};
use crate::quantize::{has_levels, reoptimize, round_to_levels};
use crate::solver::AUTO;
use crate::solvers::method;
use crate::start::start_patterns;
use crate::{Extrapolated, FactorizeError, Multiplicative, Objective, Problem, Solver, StartKind, unlit};

/// Iterations that serve a light field all over the zone: its score stands still before that.
pub const ZONE_ITERATIONS: u32 = 16;

/// How to factorize.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Name of the solver, see [`crate::solvers`], or [`AUTO`].
    pub solver: String,
    /// Number of iterations; 0 hands the start back.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// How starting patterns are made, unless a warm start is given; `None` for what suits the solver.
    pub start: Option<StartKind>,
    /// Coarser levels at which to begin, each at half the resolution of the next; fewer where the problem gets too small. `None` for what suits the
    /// solver. Not for warm starts.
    pub coarse_levels: Option<u32>,
    /// Iterations at each coarser level.
    pub coarse_iterations: u32,
    /// The objective is evaluated after every so many iterations and after the last. Block-exact solvers find it on their way where all rays count alike
    /// and read one pixel per layer; else it costs about a third of an iteration. At least 1.
    pub report_every: u32,
    /// Whether patterns for layers of few bits are re-optimized on the panels' levels; otherwise they stay continuous.
    pub levels: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            solver: AUTO.into(),
            iterations: 50,
            seed: 1,
            start: None,
            coarse_levels: None,
            coarse_iterations: 3,
            report_every: 1,
            levels: true,
        }
    }
}

impl Settings {
    /// `report_every` for a curve of convergence with some 40 points: enough for a plot; each costs a part of an update.
    pub fn curve_interval(iterations: u32) -> u32 {
        (iterations / 40).max(1)
    }

    /// The same with every choice made. The paper's rule begins as the paper leaves open, at random; all else begins near the content, at half the
    /// resolution. On every light field measured that reached any quality first.
    pub fn resolved(&self) -> Self {
        let paper = self.solver == Multiplicative.name();
        let solver = if self.solver == AUTO { Extrapolated.name().into() } else { self.solver.clone() };
        Self {
            solver,
            start: Some(self.start.unwrap_or(if paper { StartKind::Random } else { StartKind::Content })),
            coarse_levels: Some(self.coarse_levels.unwrap_or(u32::from(!paper))),
            ..self.clone()
        }
    }
}

/// Where the run stands after some iterations. Before the last, a solver that extrapolates may report the point that its last step met, not the one it
/// would hand back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Iterations done.
    pub iteration: u32,
    /// Σ w (βL − L̃)² over all rays and channels.
    pub objective: f64,
    /// PSNR in dB of L̃/β against L over all rays with w > 0; NaN when no ray counts, infinite when exact.
    pub psnr_view: f64,
}

/// Patterns and how the run came to them.
#[derive(Clone, Debug, PartialEq)]
pub struct Factorization {
    /// The patterns, all values in 0..1.
    pub stack: LayerStack,
    /// Every evaluation of the objective; the first is that of the start (iteration 0).
    pub history: Vec<Iteration>,
    /// The settings with every choice made.
    pub settings: Settings,
    /// How far the patterns are from the first-order (KKT) conditions, before quantization; see [`crate::Run::unsettled`].
    pub unsettled: f64,
    /// What few levels cost, where layers have few.
    pub levels: Option<LevelsLoss>,
}

/// PSNR (dB, `psnr_view`) of patterns for panels of few bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelsLoss {
    /// Of the continuous patterns.
    pub continuous: f64,
    /// Of their values rounded to the nearest levels.
    pub rounded: f64,
    /// Of the patterns that were re-optimized on the levels; those are handed back.
    pub reoptimized: f64,
}

/// Factorizes a light field. A warm start replaces the start of the settings: patterns of the same display, for example of the time before.
/// `on_iteration` sees every evaluation as it comes, that of the start included.
///
/// # Errors
/// If the problem, the settings or the warm start are unusable, no ray counts, or when cancelled.
pub fn factorize(
    problem: &Problem,
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, FactorizeError> {
    factorize_on(&Processor, problem, settings, warm, task, on_iteration)
}

/// [`factorize`] by another executor. Patterns for panels of few bits are re-optimized on the processor.
///
/// # Errors
/// As [`factorize`], and where the device cannot do this or is lost.
pub fn factorize_on(
    executor: &dyn Executor,
    problem: &Problem,
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, FactorizeError> {
    solve(executor, (problem, Plan::new(problem)?), settings, warm, task, on_iteration)
}

/// Factorizes a [`Tile`] of a larger problem: `problem` is that of the tile, [`Tile::display`] and [`Tile::light_field`], and `whole` is where the rays of all meet
/// the display. With `fixed` border patterns, those of `warm` around the tile's free pixels stay as they are, their black
/// lifted as that of every warm start; else all that the tile holds is solved. A start of the settings is that of the whole display, as far as the tile holds it.
///
/// # Errors
/// As [`factorize`], and [`FactorizeError::NoRays`] where no ray of the tile counts.
pub fn factorize_tile(
    problem: &Problem,
    (tile, whole): (&Tile, &RayMap),
    settings: &Settings,
    (warm, fixed): (Option<&LayerStack>, bool),
    task: Task,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, FactorizeError> {
    let place = tile.parts.iter().zip(&tile.whole);
    let place = place.map(|(part, whole)| [[part.held.rows.start, part.held.cols.start], *whole]).collect();
    let free = fixed.then(|| tile.parts.iter().map(|part| part.free.within(&part.held)).collect());
    let plan = Plan::of_tile(problem, &tile.map(whole), Cut { place, free })?;
    solve(&Processor, (problem, plan), settings, warm, task, on_iteration)
}

fn solve(
    executor: &dyn Executor,
    (problem, plan): (&Problem, Plan),
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, FactorizeError> {
    let settings = &settings.resolved();
    let (plan, display) = (Arc::new(plan), problem.display);
    let mut run = begun(executor, (problem, &plan), settings, warm, task)?;
    let prepared = |patterns| Prepared { plan: plan.clone(), display, patterns, executor };
    let (mut history, mut unsettled) = (Vec::new(), 0.0);
    task.progress.begin("factorize", u64::from(settings.iterations), "iterations");
    let mut iterate = || -> Result<(), FactorizeError> {
        for iteration in 0..=settings.iterations {
            if iteration > 0 {
                run.step(task.cancel)?;
            }
            // before the last evaluation, which is that of what is handed back
            if iteration == settings.iterations {
                unsettled = if iteration > 0 { run.settle() } else { run.unsettled() };
                task.cancel.check()?;
            }
            let mut note = String::new();
            if iteration == settings.iterations || iteration % settings.report_every.max(1) == 0 {
                let seen = run.seen().filter(|_| iteration < settings.iterations);
                let objective = seen.unwrap_or_else(|| run.objective());
                run.check()?;
                let entry = Iteration { iteration, objective: objective.value, psnr_view: objective.psnr_view };
                note = format!("{:.2} dB", entry.psnr_view);
                on_iteration(&entry);
                history.push(entry);
            }
            if iteration > 0 {
                task.progress.advance(1, &note);
            }
        }
        Ok(())
    };
    let result = iterate();
    task.progress.end();
    result?;
    let (mut stack, mut levels) = (run.finish().into_stack()?, None);
    if settings.levels && has_levels(problem) {
        let psnr_view = |stack: &LayerStack| {
            let patterns = Patterns::Stack(stack.clone());
            Engine::begin(prepared(patterns).into_begin(0.0, false)).objective().psnr_view
        };
        let continuous = psnr_view(&stack);
        let rounded = psnr_view(&round_to_levels(problem, &stack));
        stack = reoptimize(prepared(Patterns::Stack(stack)), task)?;
        levels = Some(LevelsLoss { continuous, rounded, reoptimized: psnr_view(&stack) });
    }
    Ok(Factorization { stack, history, settings: settings.clone(), unsettled, levels })
}

/// A run on the plan of a problem, begun at `warm` patterns or at what the settings choose.
fn begun(
    executor: &dyn Executor,
    (problem, plan): (&Problem, &Arc<Plan>),
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
) -> Result<Box<dyn Iterated>, FactorizeError> {
    let method = method(&settings.solver)?;
    let display = problem.display;
    let run = match warm {
        Some(warm) => {
            warm.check(display)?;
            // a part of patterns that others go on with may be the same in all frames
            if display.frames > 1 && plan.free(0).is_none() && frames_are_equal(warm) {
                let message = "all frames are equal and will stay equal: more frames than one have no effect";
                task.warn("warm start", message);
            }
            let start = if settings.iterations > 0 { unlit::lifted(warm) } else { warm.clone() };
            method.begin(Prepared { plan: plan.clone(), display, patterns: Patterns::Stack(start), executor })?
        }
        None => begin(executor, method, plan, (display, problem.target.geometry()), settings, task)?,
    };
    if run.rays() == 0 {
        return Err(FactorizeError::NoRays);
    }
    Ok(run)
}

/// A factorization under way, for callers that look at the patterns between iterations: after as many iterations its patterns are those of
/// [`factorize`], before layers of few bits are re-optimized.
pub struct Ongoing(Box<dyn Iterated>);

impl Ongoing {
    /// Begins as [`factorize`] does. The target is copied.
    ///
    /// # Errors
    /// As [`factorize`].
    pub fn begin(
        problem: &Problem,
        settings: &Settings,
        warm: Option<&LayerStack>,
        task: Task,
    ) -> Result<Self, FactorizeError> {
        let plan = Arc::new(Plan::new(problem)?);
        begun(&Processor, (problem, &plan), &settings.resolved(), warm, task).map(Self)
    }

    /// One iteration.
    ///
    /// # Errors
    /// When cancelled.
    pub fn step(&mut self, cancel: &Cancel) -> Result<(), FactorizeError> {
        self.0.step(cancel)
    }

    /// The objective: of the patterns that the last step met, where the solver found it on its way, else of the present ones.
    pub fn objective(&mut self) -> Objective {
        self.0.seen().unwrap_or_else(|| self.0.objective())
    }

    /// The present patterns.
    pub fn patterns(&mut self) -> LayerStack {
        self.0.download()
    }

    /// Ends the run as [`factorize`] does, and returns its patterns and their objective.
    ///
    /// # Errors
    /// When the patterns cannot be read back.
    pub fn finish(mut self) -> Result<(LayerStack, Objective), FactorizeError> {
        self.0.settle();
        let objective = self.0.objective();
        Ok((self.0.finish().into_stack()?, objective))
    }
}

/// Whether a warm start gets nearer to the target than the start that `fresh` makes, coarse levels included. Where it is nearer already, that says so; else
/// what an iteration of `warm_solver` makes of either: the objectives of the starts themselves mislead, since patterns of moved content
/// are far off at first and quickly put right. The warm start must then be ahead by 1 dB. Costs a fresh start, and two iterations where it comes to
/// that.
///
/// Measured on a plane of waves and on a striped card (64 × 40 pixels, 5 × 3 views, 4 frames), moved by 0 to 20 pixels: whichever was ahead by so much after
/// one iteration was not behind by more than 1.4 dB after five.
///
/// # Errors
/// If the problem, the settings or the warm start are unusable, or when cancelled.
pub fn warm_start_pays(
    problem: &Problem,
    fresh: &Settings,
    warm: &LayerStack,
    warm_solver: &str,
    task: Task,
) -> Result<bool, FactorizeError> {
    let fresh = &fresh.resolved();
    let (plan, display) = (Arc::new(Plan::new(problem)?), problem.display);
    warm.check(display)?;
    // the same rule for both: the first steps of different rules do not compare
    let rule = method(&Settings { solver: warm_solver.into(), ..Settings::default() }.resolved().solver)?;
    let mut from_fresh = begin(&Processor, rule, &plan, (display, problem.target.geometry()), fresh, task)?;
    let mut from_warm =
        rule.begin(Prepared { plan, display, patterns: Patterns::Stack(unlit::lifted(warm)), executor: &Processor })?;
    if from_warm.objective().value <= from_fresh.objective().value {
        return Ok(true);
    }
    from_warm.step(task.cancel)?;
    from_fresh.step(task.cancel)?;
    Ok(from_warm.objective().value * 10f64.powf(0.1 * AHEAD_DB) <= from_fresh.objective().value)
}

/// By how much a warm start must be ahead of a fresh one after an iteration, dB.
const AHEAD_DB: f64 = 1.0;

/// Begins a run without a warm start.
fn begin(
    executor: &dyn Executor,
    method: &dyn Method,
    plan: &Arc<Plan>,
    (display, geometry): (&Display, &FieldGeometry),
    settings: &Settings,
    task: Task,
) -> Result<Box<dyn Iterated>, FactorizeError> {
    let coarse =
        solve_coarse(executor, plan, (display, geometry), settings, settings.coarse_levels.unwrap_or(0), task)?;
    let patterns = match &coarse {
        Some(factors) => Patterns::Coarse(factors),
        None => Patterns::Stack(start_patterns(plan, display, settings.start.unwrap_or_default(), settings.seed)),
    };
    method.begin(Prepared { plan: plan.clone(), display, patterns, executor })
}

/// What a few iterations reach at half the resolution, begun at a quarter, and so on for every level; `None` where there is no level left.
fn solve_coarse(
    executor: &dyn Executor,
    plan: &Plan,
    (display, geometry): (&Display, &FieldGeometry),
    settings: &Settings,
    levels: u32,
    task: Task,
) -> Result<Option<Vec<Factor>>, FactorizeError> {
    let Some(coarse) = (levels > 0).then(|| Coarse::of(display, geometry, plan)).flatten() else { return Ok(None) };
    let settings = &Settings { coarse_levels: Some(levels - 1), ..settings.clone() };
    let parts = (&coarse.display, &coarse.geometry);
    let mut run = begin(executor, method(&settings.solver)?, &coarse.plan, parts, settings, task)?;
    for _ in 0..settings.coarse_iterations {
        run.step(task.cancel)?;
    }
    Ok(Some(run.finish().into_factors()?))
}

/// Whether every layer and the backlight show the same in all frames.
fn frames_are_equal(stack: &LayerStack) -> bool {
    let frames = stack.frames();
    let equal = |data: &[f32]| {
        let (first, rest) = data.split_at(data.len() / frames);
        rest.chunks_exact(first.len()).all(|frame| frame == first)
    };
    stack.layers.iter().all(|layer| equal(layer.data())) && stack.emission.as_ref().is_none_or(|e| equal(e.data()))
}
