//! Factorizes a light field into the patterns of a tensor display.

use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::Task;
use lumistack_core::config::nearest;
use lumistack_display::{Display, FieldGeometry, LayerStack, LightField, StackError, Weights};
use lumistack_factorizer::{AUTO, Factorization, FactorizeError, Problem, StartKind};
use lumistack_field_io::npy::NpyFile;
use lumistack_report::{Iteration, Solution};
use serde::{Deserialize, Serialize};

use super::device::{self, SolverDevice, on_device};
use super::field::add_weights;
use crate::error::{PipelineError, factorize_error, field_error};
use crate::job::FactorizeJob;
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::KeyBuilder;
use crate::store::stamps::Stamps;

/// Patterns of a display, and the convergence of the solver that made them.
pub(crate) struct Solved {
    pub(crate) stack: LayerStack,
    pub(crate) steps: Vec<Iteration>,
    /// The solver's settings and the quality of its result; `None` if a node plugin does not report
    /// them.
    pub(crate) solution: Option<Solution>,
}

/// The input of a solver.
#[derive(Clone, Copy)]
pub(crate) struct Solve<'a> {
    pub(crate) job: &'a FactorizeJob,
    pub(crate) seed: u64,
    pub(crate) display: &'a Display,
    pub(crate) target: &'a LightField,
    pub(crate) weights: &'a Weights,
}

impl Solve<'_> {
    /// Returns a key of everything that the patterns depend on; the caller finishes it.
    pub(crate) fn key(&self, warm: Option<&LayerStack>, site: &SolverDevice) -> KeyBuilder {
        let Self { job, seed, display, target, weights } = *self;
        let mut key = KeyBuilder::new("factorize", code::PATTERNS);
        key.add("display", display.without_panels().to_toml().as_bytes())
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_field("target", target)
            .add_json("settings", &(&job.solver, job.iterations(), &job.start, seed))
            .add_json("coarse and levels", &(job.coarse_levels, job.coarse_iterations, job.levels));
        add_weights(&mut key, weights);
        if let Some(warm) = warm {
            add_stack(&mut key, warm);
        }
        site.add_to(&mut key);
        key
    }

    /// Factorizes the light field, with a warm start if patterns are given. `on_iteration` is
    /// called whenever the objective is evaluated.
    ///
    /// # Errors
    /// If the settings are invalid, the solver fails, or the task is cancelled.
    pub(crate) fn factorize(
        &self,
        site: &SolverDevice,
        warm: Option<&LayerStack>,
        task: Task<'_>,
        on_iteration: &mut dyn FnMut(&lumistack_factorizer::Iteration),
    ) -> Result<Factorization, PipelineError> {
        let settings = solver_settings(self.job, self.seed)?;
        let problem = Problem { display: self.display, target: self.target, weights: self.weights };
        lumistack_factorizer::factorize_on(site.executor(), &problem, &settings, warm, task, on_iteration)
            .map_err(factorize_error)
    }

    /// Returns true if the patterns `warm` are a better start for `solver` than a fresh start, by
    /// the rule of [`lumistack_factorizer::warm_start_pays`]. The processor computes the objectives
    /// for every device, so all machines make the same choice.
    ///
    /// # Errors
    /// The errors of [`factorize`](Self::factorize).
    pub(crate) fn warm_start_pays(
        &self,
        warm: &LayerStack,
        solver: &str,
        task: Task<'_>,
    ) -> Result<bool, PipelineError> {
        let settings = solver_settings(self.job, self.seed)?;
        let problem = Problem { display: self.display, target: self.target, weights: self.weights };
        lumistack_factorizer::warm_start_pays(&problem, &settings, warm, solver, task).map_err(factorize_error)
    }
}

/// Settings and convergence of a solve, in the form of their JSON file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Convergence {
    pub(crate) solver: String,
    pub(crate) start: String,
    pub(crate) coarse_levels: u32,
    pub(crate) kkt_residual: f64,
    /// PSNR of the continuous, rounded and reoptimized patterns, dB. A value is `None` if the
    /// patterns are exact, since JSON has no infinity.
    pub(crate) levels: Option<[Option<f64>; 3]>,
    pub(crate) steps: Vec<Step>,
}

/// Returns a PSNR in the form of the JSON file.
fn finite(psnr: f64) -> Option<f64> {
    psnr.is_finite().then_some(psnr)
}

/// A point of the convergence curve, in the form of the JSON file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Step {
    pub(crate) iteration: u32,
    pub(crate) objective: f64,
    /// PSNR of the emitted light field L̃/β against the target L, dB. `None` if the patterns are
    /// exact.
    pub(crate) psnr_view: Option<f64>,
    pub(crate) seconds: f64,
}

impl Step {
    pub(crate) fn of(step: &lumistack_factorizer::Iteration, seconds: f64) -> Self {
        let psnr_view = finite(step.psnr_view);
        Self { iteration: step.iteration, objective: step.objective, psnr_view, seconds }
    }
}

impl Convergence {
    /// Converts the settings and the convergence that a node plugin reports.
    pub(crate) fn of_node(
        solution: lumistack_plugin_host::Solution,
        steps: &[(lumistack_plugin_host::Step, f64)],
    ) -> Self {
        let lumistack_plugin_host::Solution { solver, start, coarse_levels, kkt_residual, levels } = solution;
        let steps = steps.iter().map(|&(at, seconds)| {
            let psnr_view = finite(at.psnr_view);
            Step { iteration: at.iteration, objective: at.objective, psnr_view, seconds }
        });
        let levels = levels.map(|levels| levels.map(finite));
        Self { solver, start, coarse_levels, kkt_residual, levels, steps: steps.collect() }
    }

    pub(crate) fn of(factorization: &Factorization, steps: Vec<Step>, warm: bool) -> Self {
        let settings = &factorization.settings;
        let start = if warm { "warm" } else { settings.start.unwrap_or_default().name() };
        Self {
            solver: settings.solver.clone(),
            start: start.into(),
            coarse_levels: if warm { 0 } else { settings.coarse_levels.unwrap_or(0) },
            kkt_residual: factorization.kkt_residual,
            levels: factorization.levels.map(|loss| [loss.continuous, loss.rounded, loss.reoptimized].map(finite)),
            steps,
        }
    }

    /// Returns the input of the report: this convergence, and the patterns.
    pub(crate) fn into_solved(self, stack: LayerStack) -> Solved {
        let Self { solver, start, coarse_levels, kkt_residual, levels, steps } = self;
        let steps = steps.into_iter().map(|step| Iteration {
            iteration: step.iteration,
            objective: step.objective,
            psnr_view: step.psnr_view.unwrap_or(f64::INFINITY),
            seconds: step.seconds,
        });
        let steps = steps.collect();
        let levels = levels.map(|levels| levels.map(|psnr| psnr.unwrap_or(f64::INFINITY)));
        Solved { stack, steps, solution: Some(Solution { solver, start, coarse_levels, kkt_residual, levels }) }
    }
}

/// Returns the patterns in `layers/`, and true if they were cached. If they are not current,
/// factorizes first.
///
/// # Errors
/// If the settings are invalid, the solver fails, a file cannot be written, or the task is
/// cancelled.
pub(crate) fn run_whole(solve: Solve<'_>, stamps: &Stamps, task: Task<'_>) -> Result<(Solved, bool), PipelineError> {
    let warm = warm_stack(solve.job, solve.display)?;
    on_device(&solve.job.device, task, |site| {
        reuse_or_make("factorize", &solve.key(warm.as_ref(), site).finish(), solve.display, stamps, || {
            let (start, mut steps) = (Instant::now(), Vec::new());
            let factorization = solve.factorize(site, warm.as_ref(), task, &mut |step| {
                steps.push(Step::of(step, start.elapsed().as_secs_f64()));
            })?;
            let kept = Convergence::of(&factorization, steps, warm.is_some());
            Ok((factorization.stack, Some(kept)))
        })
    })
}

/// Returns the patterns of a stage in `layers/` with their convergence, and true if they were
/// cached. If not, `make` makes them.
///
/// # Errors
/// The errors of `make`, and an error if a file cannot be written.
pub(crate) fn reuse_or_make(
    stage: &str,
    key: &str,
    display: &Display,
    stamps: &Stamps,
    make: impl FnOnce() -> Result<(LayerStack, Option<Convergence>), PipelineError>,
) -> Result<(Solved, bool), PipelineError> {
    reuse_or_write(stage, key, display, stamps, || {
        let (stack, kept) = make()?;
        lumistack_field_io::write_stack(&stamps.dir().join("layers"), display, &stack).map_err(field_error)?;
        Ok((stack, kept))
    })
}

/// Does the same as [`reuse_or_make`], for a `make` that writes `layers/` itself.
///
/// # Errors
/// The errors of [`reuse_or_make`].
pub(crate) fn reuse_or_write(
    stage: &str,
    key: &str,
    display: &Display,
    stamps: &Stamps,
    make: impl FnOnce() -> Result<(LayerStack, Option<Convergence>), PipelineError>,
) -> Result<(Solved, bool), PipelineError> {
    let layers = stamps.dir().join("layers");
    let curve = stamps.dir().join("cache/convergence.json");
    let solved = |kept: Option<Convergence>, stack| match kept {
        Some(kept) => kept.into_solved(stack),
        None => Solved { stack, steps: Vec::new(), solution: None },
    };
    // Cached patterns are used only if they match the display.
    let kept = || {
        let stack = lumistack_field_io::read_stack(&layers).ok()?;
        check_stack(&stack, display, &layers).ok()?;
        Some(solved(read_json::<Option<Convergence>>(&curve)?, stack))
    };
    let make = || {
        let (stack, kept) = make()?;
        let mut files = files_of(&layers)?;
        write_json(&curve, &kept)?;
        files.push("cache/convergence.json".into());
        Ok((solved(kept, stack), files))
    };
    stamps.reuse_or_make(stage, key, kept, make)
}

/// The choice between a warm start and a fresh start of a time step, in the form of its JSON file.
#[derive(Serialize, Deserialize)]
struct Choice {
    key: String,
    warm: bool,
}

/// Returns true if a fresh start with the settings `fresh` is better than a start from the patterns
/// `warm`. The warm start is better if its objective is lower than that of the fresh start. It is
/// also better if it leads by 1 dB after one iteration from each start
/// ([`Solve::warm_start_pays`]). The choice is cached.
///
/// # Errors
/// If the settings are invalid, the solver fails, the choice cannot be written, or the task is
/// cancelled.
pub(crate) fn prefers_fresh(
    solve: Solve<'_>,
    fresh: &FactorizeJob,
    warm: &LayerStack,
    stamps: &Stamps,
    task: Task<'_>,
) -> Result<bool, PipelineError> {
    let Solve { job, seed, display, target, weights } = solve;
    let mut key = KeyBuilder::new("start", code::PATTERNS);
    key.add("display", display.without_panels().to_toml().as_bytes())
        .add_json("settings", &(&fresh.solver, &fresh.start, &job.solver, seed))
        .add_json("coarse", &(fresh.coarse_levels, fresh.coarse_iterations))
        .add("geometry", format!("{:?}", target.geometry()).as_bytes())
        .add_field("target", target);
    add_weights(&mut key, weights);
    add_stack(&mut key, warm);
    let key = key.finish();
    let path = stamps.dir().join("cache/start.json");
    if let Some(choice) = read_json(&path).filter(|choice: &Choice| choice.key == key) {
        return Ok(!choice.warm);
    }
    let warm = Solve { job: fresh, ..solve }.warm_start_pays(warm, &job.solver, task)?;
    write_json(&path, &Choice { key, warm })?;
    Ok(!warm)
}

/// Returns the files of patterns, relative to the run folder.
///
/// # Errors
/// If the index of the patterns is missing or wrong.
fn files_of(layers: &Path) -> Result<Vec<PathBuf>, PipelineError> {
    let index = lumistack_field_io::read_stack_index(layers).map_err(field_error)?;
    let mut files: Vec<PathBuf> = vec!["layers/stack.json".into()];
    files.extend(index.layers.iter().map(|layer| Path::new("layers").join(&layer.file)));
    files.extend(index.backlight.iter().map(|backlight| Path::new("layers").join(&backlight.file)));
    Ok(files)
}

/// Reads the patterns that a job names as its warm start; `None` if it names none.
pub(crate) fn warm_stack(job: &FactorizeJob, display: &Display) -> Result<Option<LayerStack>, PipelineError> {
    let Some(path) = &job.warm_start else { return Ok(None) };
    let stack = lumistack_field_io::read_stack(path).map_err(field_error)?;
    check_stack(&stack, display, path)?;
    Ok(Some(stack))
}

/// Checks that rays of the views hit the layers, and that weights and warm start have the shapes of
/// the display and its views.
///
/// # Errors
/// If no ray hits all layers, a shape differs, or a file cannot be read.
pub(crate) fn check_shapes(
    job: &FactorizeJob,
    display: &Display,
    geometry: &FieldGeometry,
) -> Result<(), PipelineError> {
    let expected = "at least one ray of the views that hits all layers (and the grid of lenslets, if there is one)";
    lumistack_factorizer::check_rays(display, geometry)
        .map_err(|_| PipelineError::job("display.layers", expected, "none"))?;
    if let Some(path) = &job.weights {
        let file = NpyFile::open(path).map_err(field_error)?;
        let [view_rows, view_cols] = geometry.grid.views();
        let (per_view, per_ray) = ([view_rows, view_cols], [view_rows, view_cols, geometry.rows, geometry.cols]);
        if file.shape() != per_view && file.shape() != per_ray {
            let expected = format!("shape {per_view:?} or {per_ray:?}, as the views");
            return Err(PipelineError::value(path, "weights", expected, format!("{:?}", file.shape())));
        }
    }
    warm_stack(job, display).map(drop)
}

/// Checks names, numbers and files of a job's table `[factorize]`, without any work. Reads only the
/// header of the weights and the index of the warm start.
///
/// # Errors
/// If a solver, start, device or file does not exist, or tiles or expected eyes are invalid.
pub(crate) fn check(job: &FactorizeJob) -> Result<(), PipelineError> {
    start_kind(&job.start)?;
    device::check(&job.device)?;
    job.check_tiles()?;
    job.check_eyes()?;
    if let Some(path) = &job.weights {
        NpyFile::open(path).map_err(field_error)?;
    }
    if let Some(path) = &job.warm_start {
        lumistack_field_io::read_stack_index(path).map_err(field_error)?;
    }
    match lumistack_factorizer::solver(&job.solver) {
        Ok(_) => Ok(()),
        Err(FactorizeError::UnknownSolver { expected, found }) => {
            Err(PipelineError::job("factorize.solver", format!("one of {expected}"), found))
        }
        Err(error) => Err(PipelineError::Factorize(error)),
    }
}

/// Checks that the solver of a job can find patterns for its display.
///
/// # Errors
/// If the solver does not exist, or does not suit the display.
pub(crate) fn check_solver(job: &FactorizeJob, display: &Display) -> Result<(), PipelineError> {
    lumistack_factorizer::solver(&job.solver).and_then(|solver| solver.suits(display)).map_err(PipelineError::Factorize)
}

pub(crate) fn solver_settings(job: &FactorizeJob, seed: u64) -> Result<lumistack_factorizer::Settings, PipelineError> {
    Ok(lumistack_factorizer::Settings {
        solver: job.solver.clone(),
        iterations: job.iterations(),
        seed,
        start: start_kind(&job.start)?,
        coarse_levels: job.coarse_levels,
        coarse_iterations: job.coarse_iterations,
        report_every: lumistack_factorizer::Settings::curve_interval(job.iterations()),
        levels: job.levels,
    })
}

/// Returns the start with this name; `None` stands for the default of the solver.
fn start_kind(name: &str) -> Result<Option<StartKind>, PipelineError> {
    if name == AUTO {
        return Ok(None);
    }
    StartKind::from_name(name).map(Some).ok_or_else(|| {
        let names: Vec<&str> = StartKind::names().collect();
        let hint =
            nearest(name, names.iter().copied()).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        let expected = format!("one of {}", names.join(", "));
        PipelineError::job("factorize.start", expected, format!("`{name}`{hint}"))
    })
}

/// Adds patterns to a key.
pub(crate) fn add_stack(key: &mut KeyBuilder, stack: &LayerStack) {
    for layer in &stack.layers {
        key.add_f32("layer", layer.data());
    }
    if let Some(emission) = &stack.emission {
        key.add_f32("emission", emission.data());
    }
}

/// Checks that patterns match a display.
///
/// # Errors
/// If their shapes differ, or if the brightness or a value is out of range.
pub(crate) fn check_stack(stack: &LayerStack, display: &Display, path: &Path) -> Result<(), PipelineError> {
    stack.check(display).map_err(|source: StackError| PipelineError::Stack { path: path.to_owned(), source })
}
