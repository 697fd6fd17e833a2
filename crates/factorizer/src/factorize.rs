//! Start, iterate, report: what the pipeline calls.

use lumistack_core::Task;
use lumistack_display::LayerStack;

use crate::{FactorizeError, Problem, StartKind, random_start, solver};

/// How to factorize.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Name of the solver; see [`crate::solvers`].
    pub solver: String,
    /// Number of iterations; 0 hands the start back.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// How starting patterns are made, unless a warm start is given.
    pub start: StartKind,
    /// The objective is evaluated after every so many iterations and after the last; it costs about a third of an iteration. At least 1.
    pub report_every: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { solver: "multiplicative".into(), iterations: 50, seed: 1, start: StartKind::Random, report_every: 1 }
    }
}

/// Where the run stands after some iterations.
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
}

/// Factorizes a light field. A warm start replaces the start of the settings: patterns of the same display, for example of the time before.
/// `on_iteration` sees every evaluation as it comes, that of the start included.
///
/// # Errors
/// If the problem, the settings or the warm start are unusable, or when cancelled.
pub fn factorize(
    problem: &Problem,
    settings: &Settings,
    warm: Option<&LayerStack>,
    task: Task,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, FactorizeError> {
    let solver = solver(&settings.solver)?;
    problem.check()?;
    if let Some(warm) = warm {
        warm.check(problem.display)?;
        if problem.display.frames > 1 && frames_are_equal(warm) {
            task.warn("warm start", "all frames are equal and will stay equal: more frames than one have no effect");
        }
    }
    let start = match (warm, settings.start) {
        (Some(warm), _) => warm.clone(),
        (None, StartKind::Random) => random_start(problem.display, settings.seed),
    };
    let mut run = solver.start(problem, start)?;
    if run.rays() == 0 {
        task.warn("factorize", "no ray with a weight above 0 meets all layers: the patterns stay as they start");
    }
    let mut history = Vec::new();
    task.progress.begin("factorize", u64::from(settings.iterations), "iterations");
    let mut iterate = || -> Result<(), FactorizeError> {
        for iteration in 0..=settings.iterations {
            if iteration > 0 {
                run.step(task.cancel)?;
            }
            let mut note = String::new();
            if iteration == settings.iterations || iteration % settings.report_every.max(1) == 0 {
                let objective = run.objective();
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
    result.map(|()| Factorization { stack: run.download(), history })
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
