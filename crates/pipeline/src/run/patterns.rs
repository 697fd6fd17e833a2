//! The patterns of a run: factorized, or made by a node plugin.

use std::path::{Path, PathBuf};

use lumistack_core::config::nearest;
use lumistack_core::{Task, Tensor};
use lumistack_display::{Display, LayerStack, LightField, StackError, Weights};
use lumistack_factorizer::{AUTO, Problem, StartKind};
use lumistack_plugin_host::{Made, NodeData};
use lumistack_report::{Iteration, Solution};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Run;
use crate::cache::KeyBuilder;
use crate::code;
use crate::error::{PipelineError, factorize_error, field_error, host_error};
use crate::files::{read_json, write_json};
use crate::ingest;
use crate::job::{FactorizeJob, NodeJob};

/// A point of the convergence curve, as it is kept between runs.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Step {
    iteration: u32,
    objective: f64,
    psnr_view: Option<f64>,
    seconds: f64,
}

/// How the solver came to the patterns, as it is kept between runs.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Solved {
    solver: String,
    start: String,
    coarse_levels: u32,
    unsettled: f64,
    levels: Option<[f64; 3]>,
    steps: Vec<Step>,
}

impl Solved {
    fn of(solution: lumistack_plugin_host::Solution, steps: &[(lumistack_plugin_host::Step, f64)]) -> Self {
        let lumistack_plugin_host::Solution { solver, start, coarse_levels, unsettled, levels } = solution;
        let steps = steps.iter().map(|&(at, seconds)| {
            let psnr_view = at.psnr_view.is_finite().then_some(at.psnr_view);
            Step { iteration: at.iteration, objective: at.objective, psnr_view, seconds }
        });
        Self { solver, start, coarse_levels, unsettled, levels, steps: steps.collect() }
    }

    /// For the report.
    fn told(self) -> (Vec<Iteration>, Solution) {
        let Self { solver, start, coarse_levels, unsettled, levels, steps } = self;
        (report_steps(steps), Solution { solver, start, coarse_levels, unsettled, levels })
    }
}

/// Which start a time of a sequence takes, as it is kept between runs.
#[derive(Serialize, Deserialize)]
struct Choice {
    key: String,
    warm: bool,
}

impl Run<'_> {
    pub(super) fn weights(&self, target: &LightField) -> Result<Weights, PipelineError> {
        let job = &self.job.factorize;
        let Some(path) = &job.weights else { return eye_weights(job, target) };
        if !job.eyes.is_empty() {
            return Err(PipelineError::value("job", "factorize.eyes", "either `weights` or `eyes`", "both"));
        }
        let (shape, data) = lumistack_field_io::npy::read(path).map_err(field_error)?;
        array_weights(path, &shape, data, target)
    }

    /// Takes the job's warm start away, and `fresh` instead, where a fresh start gets nearer to the target.
    pub(super) fn choose_start(
        &mut self,
        fresh: &FactorizeJob,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        task: Task<'_>,
    ) -> Result<(), PipelineError> {
        let job = &self.job.factorize;
        let Some(warm) = warm_stack(job, display)? else { return Ok(()) };
        let mut key = KeyBuilder::new("start", code::PATTERNS);
        key.add("display", display.without_panels().to_toml().as_bytes())
            .add_json("settings", &(&fresh.solver, &fresh.start, &job.solver, self.job.seed))
            .add_json("coarse", &(fresh.coarse_levels, fresh.coarse_iterations))
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data());
        add_weights(&mut key, weights);
        add_stack(&mut key, &warm);
        let key = key.finish();
        let path = self.dir.join("cache/start.json");
        let choice = match read_json(&path).filter(|choice: &Choice| choice.key == key) {
            Some(choice) => choice,
            None => {
                let settings = solver_settings(fresh, self.job.seed)?;
                let problem = Problem { display, target, weights };
                let warm = lumistack_factorizer::warm_start_pays(&problem, &settings, &warm, &job.solver, task)
                    .map_err(factorize_error)?;
                let choice = Choice { key, warm };
                write_json(&path, &choice)?;
                choice
            }
        };
        if !choice.warm {
            self.job.to_mut().factorize = fresh.clone();
        }
        Ok(())
    }

    pub(super) fn factorize(
        &mut self,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        task: Task<'_>,
    ) -> Result<(LayerStack, (Vec<Iteration>, Solution)), PipelineError> {
        let job = &self.job.factorize;
        let warm = warm_stack(job, display)?;
        let mut key = KeyBuilder::new("factorize", code::PATTERNS);
        key.add("display", display.without_panels().to_toml().as_bytes())
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data())
            .add_json("settings", &(&job.solver, job.iterations, &job.start, self.job.seed))
            .add_json("coarse and levels", &(job.coarse_levels, job.coarse_iterations, job.levels))
            .add(
                "plugin",
                lumistack_plugin_host::fingerprint_of(NodeJob::TENSOR_DISPLAY).unwrap_or_default().as_bytes(),
            );
        add_weights(&mut key, weights);
        if let Some(warm) = &warm {
            add_stack(&mut key, warm);
        }
        let key = key.finish();
        self.timed("factorize", |run| {
            let layers = run.dir.join("layers");
            let curve = run.dir.join("cache/convergence.json");
            if run.stamps.is_current("factorize", &key)
                && let Ok(stack) = lumistack_field_io::read_stack(&layers)
                && check_stack(&stack, display, &layers).is_ok()
                && let Some(solved) = read_json::<Solved>(&curve)
            {
                return Ok(((stack, solved.told()), true));
            }
            run.stamps.clear("factorize")?;
            let params = run.job.factorize.params();
            let made = run.made_by(NodeJob::TENSOR_DISPLAY, &params, display, target, weights, warm.as_ref(), task)?;
            let solution = made.solution.ok_or_else(|| {
                PipelineError::value("factorize", "solution", "how the patterns were found", "nothing")
            })?;
            let (stack, solved) = (made.stack, Solved::of(solution, &made.steps));
            let mut files = run.write_layers(display, &stack)?;
            write_json(&curve, &solved)?;
            files.push("cache/convergence.json".into());
            run.stamps.write("factorize", &key, &files)?;
            Ok(((stack, solved.told()), false))
        })
    }

    /// Writes the patterns; returns the files, relative to the run's folder.
    fn write_layers(&self, display: &Display, stack: &LayerStack) -> Result<Vec<PathBuf>, PipelineError> {
        let layers = self.dir.join("layers");
        lumistack_field_io::write_stack(&layers, display, stack).map_err(field_error)?;
        let index = lumistack_field_io::read_stack_index(&layers).map_err(field_error)?;
        let mut files: Vec<PathBuf> = vec!["layers/stack.json".into()];
        files.extend(index.layers.iter().map(|layer| Path::new("layers").join(&layer.file)));
        files.extend(index.backlight.iter().map(|backlight| Path::new("layers").join(&backlight.file)));
        Ok(files)
    }

    /// The patterns that a node plugin makes.
    pub(super) fn run_node(
        &mut self,
        node: &NodeJob,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        task: Task<'_>,
    ) -> Result<(LayerStack, Option<(Vec<Iteration>, Solution)>), PipelineError> {
        // baselines solve by the factorizer, too
        let mut key = KeyBuilder::new("node", code::PATTERNS);
        key.add("plugin", ingest::plugin_key(self.registry, &node.plugin, &node.params)?.as_bytes())
            .add("display", display.to_toml().as_bytes())
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data())
            .add_json("seed", &self.job.seed);
        add_weights(&mut key, weights);
        let key = key.finish();
        self.timed(&node.plugin, |run| {
            let layers = run.dir.join("layers");
            let curve = run.dir.join("cache/convergence.json");
            if run.stamps.is_current("node", &key)
                && let Ok(stack) = lumistack_field_io::read_stack(&layers)
                && check_stack(&stack, display, &layers).is_ok()
                && let Some(solved) = read_json::<Option<Solved>>(&curve)
            {
                return Ok(((stack, solved.map(Solved::told)), true));
            }
            run.stamps.clear("node")?;
            let params = node.params.clone().into();
            let made = run.made_by(&node.plugin, &params, display, target, weights, None, task)?;
            let solved = made.solution.map(|solution| Solved::of(solution, &made.steps));
            let mut files = run.write_layers(display, &made.stack)?;
            write_json(&curve, &solved)?;
            files.push("cache/convergence.json".into());
            run.stamps.write("node", &key, &files)?;
            Ok(((made.stack, solved.map(Solved::told)), false))
        })
    }

    /// What a node of the registry makes of a light field.
    fn made_by(
        &self,
        plugin: &str,
        params: &Value,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        warm: Option<&LayerStack>,
        task: Task<'_>,
    ) -> Result<Made, PipelineError> {
        let node = NodeData { weights, start: warm, seed: self.job.seed, ..NodeData::new(display, target) };
        lumistack_plugin_host::make_stack(self.registry, plugin, params, &node, task).map_err(host_error)
    }
}

/// The weights of expected eyes; uniform where there are none.
pub(crate) fn eye_weights(job: &FactorizeJob, target: &LightField) -> Result<Weights, PipelineError> {
    if job.eyes.is_empty() {
        return Ok(Weights::Uniform);
    }
    Weights::eye_boxes(target.geometry(), &job.eye_boxes(), job.eye_floor as f32)
        .map_err(|error| PipelineError::value("job", "factorize.eyes", error.expected, error.found))
}

/// Weights from an array that came from `path`.
pub(crate) fn array_weights(
    path: &Path,
    shape: &[usize],
    data: Vec<f32>,
    target: &LightField,
) -> Result<Weights, PipelineError> {
    let weights = match shape {
        &[y, x] => Tensor::from_vec(["view_y", "view_x"], [y, x], data).map(Weights::PerView),
        &[y, x, rows, cols] => {
            Tensor::from_vec(["view_y", "view_x", "row", "col"], [y, x, rows, cols], data).map(Weights::PerRay)
        }
        other => {
            let expected = "[view_y][view_x] or [view_y][view_x][row][col]";
            return Err(PipelineError::value(path, "shape", expected, format!("{other:?}")));
        }
    }
    .map_err(|error| PipelineError::value(path, "weights", "values that fill the shape", error.to_string()))?;
    weights.check(target.geometry()).map_err(|source| PipelineError::Weights { path: path.to_owned(), source })?;
    Ok(weights)
}

/// The patterns that a job starts from.
fn warm_stack(job: &FactorizeJob, display: &Display) -> Result<Option<LayerStack>, PipelineError> {
    let Some(path) = &job.warm_start else { return Ok(None) };
    let stack = lumistack_field_io::read_stack(path).map_err(field_error)?;
    check_stack(&stack, display, path)?;
    Ok(Some(stack))
}

pub(crate) fn solver_settings(job: &FactorizeJob, seed: u64) -> Result<lumistack_factorizer::Settings, PipelineError> {
    Ok(lumistack_factorizer::Settings {
        solver: job.solver.clone(),
        iterations: job.iterations,
        seed,
        start: start_kind(&job.start)?,
        coarse_levels: job.coarse_levels,
        coarse_iterations: job.coarse_iterations,
        report_every: lumistack_factorizer::Settings::curve_interval(job.iterations),
        levels: job.levels,
    })
}

pub(crate) fn add_weights(key: &mut KeyBuilder, weights: &Weights) {
    match weights {
        Weights::Uniform => {}
        Weights::PerView(t) => {
            key.add_f32("weights per view", t.data());
        }
        Weights::PerRay(t) => {
            key.add_f32("weights per ray", t.data());
        }
    }
}

pub(crate) fn add_stack(key: &mut KeyBuilder, stack: &LayerStack) {
    for layer in &stack.layers {
        key.add_f32("layer", layer.data());
    }
    if let Some(emission) = &stack.emission {
        key.add_f32("emission", emission.data());
    }
}

/// `None` for the choice that suits the solver.
pub(super) fn start_kind(name: &str) -> Result<Option<StartKind>, PipelineError> {
    if name == AUTO {
        return Ok(None);
    }
    StartKind::from_name(name).map(Some).ok_or_else(|| {
        let names: Vec<&str> = [AUTO].into_iter().chain(StartKind::ALL.iter().map(|(name, _)| *name)).collect();
        let hint =
            nearest(name, names.iter().copied()).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        let expected = format!("one of {}", names.join(", "));
        PipelineError::value("job", "factorize.start", expected, format!("`{name}`{hint}"))
    })
}

fn report_steps(steps: Vec<Step>) -> Vec<Iteration> {
    steps
        .into_iter()
        .map(|step| Iteration {
            iteration: step.iteration,
            objective: step.objective,
            psnr_view: step.psnr_view.unwrap_or(f64::INFINITY),
            seconds: step.seconds,
        })
        .collect()
}

fn check_stack(stack: &LayerStack, display: &Display, path: &Path) -> Result<(), PipelineError> {
    stack.check(display).map_err(|source: StackError| PipelineError::Stack { path: path.to_owned(), source })
}
