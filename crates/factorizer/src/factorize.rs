//! The entry points: start a solver, iterate, report the objective, quantize.

use std::sync::Arc;

use lumistack_core::{Cancel, Task};
use lumistack_display::{Display, FieldGeometry, LayerStack, RayMap, Tile};

use crate::coarse::Coarse;
use crate::device::{Executor, Updater};
use crate::engine::{Engine, Processor};
use crate::factor::Factor;
use crate::method::{Iterated, Method};
use crate::plan::{Plan, TilePlace};
use crate::prepared::{Patterns, Prepared};
use crate::quantize::{has_levels, reoptimize, round_to_levels};
use crate::solver::AUTO;
use crate::solvers::method;
use crate::start::start_patterns;
use crate::{Extrapolated, FactorizeError, Multiplicative, Objective, Problem, Solver, StartKind, unlit};

/// Number of iterations that suffices for a score over the whole viewing zone; further iterations
/// do not raise the score.
pub const ZONE_ITERATIONS: u32 = 16;

/// Settings of a factorization.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Name of the solver, see [`crate::solvers`], or [`AUTO`].
    pub solver: String,
    /// Number of iterations; 0 returns the start.
    pub iterations: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Kind of start, unless a warm start is given. With `None` the solver determines the kind.
    pub start: Option<StartKind>,
    /// Number of coarser levels at which a run begins, each at half the resolution of the next.
    /// Levels without use, for example with too few pixels, are left out. With `None` the solver
    /// determines the number. A warm start has no coarser levels.
    pub coarse_levels: Option<u32>,
    /// Number of iterations at each coarser level.
    pub coarse_iterations: u32,
    /// Number of iterations between evaluations of the objective, at least 1; the last iteration
    /// always has an evaluation.
    ///
    /// If layers attenuate without blur and crosstalk, weights are uniform and every ray reads one
    /// pixel per layer, block-exact solvers usually obtain the objective from an iteration's sums.
    /// Otherwise an evaluation costs about a third of an iteration.
    pub report_every: u32,
    /// True to re-optimize patterns of layers with few bits on the levels of their panels.
    /// Otherwise the patterns stay continuous.
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
    /// Returns `report_every` for a plot with at most 80 points. Each point costs at most about a
    /// third of an iteration.
    pub fn curve_interval(iterations: u32) -> u32 {
        (iterations / 40).max(1)
    }

    /// Replaces every automatic choice by its value.
    ///
    /// The paper's rule starts at random, since the paper leaves the start open. All other solvers
    /// begin at one coarser level, with the start [`StartKind::Content`]. On every measured light
    /// field, such runs reached each PSNR sooner than runs from other starts.
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

/// The objective after some iterations.
///
/// Before the last iteration, a solver that extrapolates may report the objective of its
/// extrapolated patterns, not of its last iterate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Number of iterations done.
    pub iteration: u32,
    /// Σ w (βL − L̃)² over all rays and channels.
    pub objective: f64,
    /// PSNR of L̃/β against L over all rays with w > 0, dB. It is NaN if no ray has w > 0, and
    /// infinite if the emission is exact.
    pub psnr_view: f64,
}

/// The result of a factorization.
#[derive(Clone, Debug, PartialEq)]
pub struct Factorization {
    /// The patterns, values in 0..1.
    pub stack: LayerStack,
    /// All evaluations of the objective; the first evaluation is of the start (iteration 0).
    pub history: Vec<Iteration>,
    /// The settings, with every automatic choice replaced by its value.
    pub settings: Settings,
    /// KKT residual before quantization; see [`crate::Run::kkt_residual`].
    pub kkt_residual: f64,
    /// PSNR with and without the restriction to few levels. `None` if no layer has few bits, or
    /// without [`Settings::levels`].
    pub levels: Option<LevelsLoss>,
}

/// PSNR (dB, `psnr_view`) of patterns for panels of few bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelsLoss {
    /// PSNR of the continuous patterns.
    pub continuous: f64,
    /// PSNR of the continuous patterns after rounding to the nearest levels.
    pub rounded: f64,
    /// PSNR of the patterns that were re-optimized on the levels. These patterns are the result.
    pub reoptimized: f64,
}

/// Factorizes a light field.
///
/// `warm` replaces the start of the settings: patterns of the same display, for example of the
/// previous time step. `on_iteration` receives every evaluation of the objective, including the
/// evaluation of the start.
///
/// # Errors
/// If the problem, the settings or the warm start are unusable, if no ray has a weight above 0, or
/// when cancelled. Also if the target is in a file, and the file for its copy cannot be written.
pub fn factorize(
    problem: &Problem,
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, FactorizeError> {
    factorize_on(&Processor, problem, settings, warm, task, on_iteration)
}

/// Runs [`factorize`] on an executor. Re-optimization for panels of few bits runs on the processor
/// for every executor.
///
/// # Errors
/// The errors of [`factorize`]; also if the device cannot solve the problem or is lost.
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

/// Factorizes a [`Tile`] of a larger problem.
///
/// `problem` has the results of [`Tile::display`], [`Tile::light_field`] and [`Tile::weights`].
/// `whole` maps the rays of the whole display. With `fixed`, the pixels of `warm` around the tile's
/// free pixels keep their values, except that black is lifted as in every warm start. Without
/// `fixed`, all pixels of the tile are solved. Without `warm`, the tile starts by the settings. The
/// noise of this start is the tile's section of the whole display's noise.
///
/// # Errors
/// The errors of [`factorize`]. [`FactorizeError::NoRays`] refers to the tile's rays alone.
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
    let plan = Plan::of_tile(problem, &tile.map(whole), TilePlace { place, free })?;
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
    // choose solver and start, and prepare the problem once for all uses of it
    let settings = &settings.resolved();
    let (plan, display) = (Arc::new(plan), problem.display);
    let mut run = start_run(executor, (problem, &plan), settings, warm, task)?;
    let prepared = |patterns| Prepared { plan: plan.clone(), display, patterns, executor };
    let (mut history, mut kkt_residual) = (Vec::new(), 0.0);
    // iterate; evaluate the objective at the requested interval
    task.progress.begin("factorize", u64::from(settings.iterations), "iterations");
    let mut iterate = || -> Result<(), FactorizeError> {
        for iteration in 0..=settings.iterations {
            if iteration > 0 {
                run.step(task.cancel)?;
            }
            // darken before the last evaluation, so that the evaluation describes the returned
            // patterns
            if iteration == settings.iterations {
                kkt_residual = if iteration > 0 { run.darken_unlit() } else { run.kkt_residual() };
                task.cancel.check()?;
            }
            let mut note = String::new();
            // The last step may already have found an objective. But after the last iteration the
            // returned patterns are evaluated anyway, since the known objective may belong to
            // extrapolated patterns.
            if iteration == settings.iterations || iteration % settings.report_every.max(1) == 0 {
                let known = run.known_objective().filter(|_| iteration < settings.iterations);
                let objective = known.unwrap_or_else(|| run.objective());
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
    // confine the values of panels of few bits to the panels' levels, and measure the loss
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
    Ok(Factorization { stack, history, settings: settings.clone(), kkt_residual, levels })
}

/// Starts a run on a plan, from `warm` patterns or by the settings.
fn start_run(
    executor: &dyn Executor,
    (problem, plan): (&Problem, &Arc<Plan>),
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
) -> Result<Box<dyn Iterated>, FactorizeError> {
    let method = method(&settings.solver)?;
    let display = problem.display;
    let run = match warm {
        // A warm start replaces the start of the settings and has no coarser levels.
        Some(warm) => {
            warm.check(display)?;
            // By the multiplicative rule, equal frames stay equal, so the user is warned. In a tile
            // with fixed pixels, equal frames may be intended.
            let keeps_equal = method.name() == Multiplicative.name();
            if keeps_equal && display.frames > 1 && plan.free(0).is_none() && frames_are_equal(warm) {
                task.warn(
                    "warm start",
                    "all frames are equal, and this solver keeps them equal, as if there were one frame",
                );
            }
            let start = if settings.iterations > 0 { unlit::lifted(warm) } else { warm.clone() };
            method.begin(Prepared { plan: plan.clone(), display, patterns: Patterns::Stack(start), executor })?
        }
        None => start_fresh(executor, method, plan, (display, problem.target.geometry()), settings, task)?,
    };
    if run.rays() == 0 {
        return Err(FactorizeError::NoRays);
    }
    Ok(run)
}

/// A factorization for callers that read the patterns between iterations.
///
/// The patterns of [`finish`](Self::finish) equal those of [`factorize`] after the same number of
/// iterations (at least one), before re-optimization on few levels.
pub struct Ongoing(Box<dyn Iterated>);

impl Ongoing {
    /// Starts as [`factorize`] does, and copies the target.
    ///
    /// # Errors
    /// The errors of [`factorize`].
    pub fn begin(
        problem: &Problem,
        settings: &Settings,
        warm: Option<&LayerStack>,
        task: Task,
    ) -> Result<Self, FactorizeError> {
        Self::begin_on(&Processor, problem, settings, warm, task)
    }

    /// Starts as [`begin`](Self::begin) does, with the patterns on an executor.
    ///
    /// # Errors
    /// The errors of [`begin`](Self::begin); also if the executor cannot solve the problem.
    pub fn begin_on(
        executor: &dyn Executor,
        problem: &Problem,
        settings: &Settings,
        warm: Option<&LayerStack>,
        task: Task,
    ) -> Result<Self, FactorizeError> {
        let plan = Arc::new(Plan::new(problem)?);
        start_run(executor, (problem, &plan), &settings.resolved(), warm, task).map(Self)
    }

    /// Checks that the patterns still exist.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if a device has lost the patterns.
    pub fn check(&self) -> Result<(), FactorizeError> {
        self.0.check()
    }

    /// Runs one iteration.
    ///
    /// # Errors
    /// When cancelled, or if a device has lost the patterns.
    pub fn step(&mut self, cancel: &Cancel) -> Result<(), FactorizeError> {
        self.0.step(cancel)
    }

    /// Returns the objective that the last step obtained from its own sums. If it obtained none,
    /// computes the objective of the current patterns.
    pub fn objective(&mut self) -> Objective {
        self.0.known_objective().unwrap_or_else(|| self.0.objective())
    }

    /// Returns the current patterns.
    pub fn patterns(&mut self) -> LayerStack {
        self.0.download()
    }

    /// Ends the run as [`factorize`] does, and returns its patterns and their objective.
    ///
    /// # Errors
    /// If the patterns cannot be read back.
    pub fn finish(mut self) -> Result<(LayerStack, Objective), FactorizeError> {
        self.0.darken_unlit();
        let objective = self.0.objective();
        Ok((self.0.finish().into_stack()?, objective))
    }
}

/// Returns true if a warm start is better than a fresh start by the settings `fresh`. The fresh
/// start includes coarser levels.
///
/// If the warm start has the lower objective, the result is true. Otherwise both starts take one
/// iteration of `warm_solver`, and the result is true if the warm start then leads by 1 dB. The
/// objectives of the starts themselves mislead: patterns of moved content have a high objective at
/// first, which falls quickly. The first case costs a fresh start, the second case also two
/// iterations.
///
/// The lead of 1 dB was tested on a plane of waves and on a striped card, which moved by 0 to 20 of
/// 64 pixels. There were 5 × 3 views and 4 frames. A start that led by 1 dB after one iteration was
/// never more than 1.4 dB behind after five.
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
    // both starts use the rule of `warm_solver`, since first steps of different rules cannot be
    // compared
    let rule = method(&Settings { solver: warm_solver.into(), ..Settings::default() }.resolved().solver)?;
    let mut from_fresh = start_fresh(&Processor, rule, &plan, (display, problem.target.geometry()), fresh, task)?;
    let mut from_warm =
        rule.begin(Prepared { plan, display, patterns: Patterns::Stack(unlit::lifted(warm)), executor: &Processor })?;
    // a warm start that has the lower objective already needs no iteration
    if from_warm.objective().value <= from_fresh.objective().value {
        return Ok(true);
    }
    // otherwise compare after one iteration of each
    from_warm.step(task.cancel)?;
    from_fresh.step(task.cancel)?;
    Ok(from_warm.objective().value * 10f64.powf(0.1 * AHEAD_DB) <= from_fresh.objective().value)
}

/// Lead in dB that a warm start must have over a fresh start after one iteration of each.
const AHEAD_DB: f64 = 1.0;

/// Starts a run without a warm start.
fn start_fresh(
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

/// Solves coarser levels, each from the result of the previous level. Returns the factors of the
/// finest of these levels, or `None` if there is no coarser level.
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
    let mut run = start_fresh(executor, method(&settings.solver)?, &coarse.plan, parts, settings, task)?;
    for _ in 0..settings.coarse_iterations {
        run.step(task.cancel)?;
    }
    Ok(Some(run.finish().into_factors()?))
}

/// Returns true if every layer and the backlight have equal masks in all frames.
fn frames_are_equal(stack: &LayerStack) -> bool {
    let frames = stack.frames();
    let equal = |data: &[f32]| {
        let (first, rest) = data.split_at(data.len() / frames);
        rest.chunks_exact(first.len()).all(|frame| frame == first)
    };
    stack.layers.iter().all(|layer| equal(layer.data())) && stack.emission.as_ref().is_none_or(|e| equal(e.data()))
}
