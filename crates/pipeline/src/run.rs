//! A job from its input to its report. Every stage leaves its result in the run folder and a stamp in `cache/`; a rerun takes what is current.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::config::nearest;
use lumistack_core::{Collector, Task, Tensor, Warning, Warnings};
use lumistack_display::{Display, EyeBox, FieldGeometry, LayerStack, LightField, StackError, Weights};
use lumistack_factorizer::{AUTO, Factorization, FactorizeError, Problem, StartKind};
use lumistack_plugin_host::{HostError, OutputContext, OutputData, PluginKind, Port, Registry, Time};
use lumistack_report::{DepthBudget, Iteration, Output, Report, ReportInput, Solution, Stage};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::cache::{KeyBuilder, Stamps};
use crate::error::PipelineError;
use crate::fit::{self, Placement};
use crate::graph::{self, NodeSummary};
use crate::ingest::{self, Ingested};
use crate::job::{FactorizeJob, Job, NodeJob, OutputJob};
use crate::look::Look;
use crate::render;
use crate::sequence::{self, SequenceSummary};

/// Changes whenever a solver gives other patterns.
const FACTORIZE_VERSION: u32 = 2;
/// Points of the convergence curve: enough for a plot; each costs a part of an update.
const CURVE_POINTS: u32 = 40;

/// What a run ended with.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The report.
    pub report: PathBuf,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of L̃ against βL, dB.
    pub psnr_raw: f64,
    /// PSNR at in-between views, dB.
    pub psnr_held_out: Option<f64>,
    /// PSNR at views beyond the zone, dB.
    pub psnr_outside: Option<f64>,
    /// Of a job with several nodes: each. The figures above are the first one's.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeSummary>,
    /// What the scene's depth asks of the display, as in report.json; where a scene was rendered.
    pub depth: Option<Value>,
    /// The same in a line.
    #[serde(skip)]
    pub depth_sentence: Option<String>,
    /// What a sequence adds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sequence: Option<SequenceSummary>,
    /// Time of the whole run, seconds.
    pub seconds: f64,
}

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
    fn of(factorization: &Factorization, steps: Vec<Step>, warm: bool) -> Self {
        let settings = &factorization.settings;
        let start = if warm { "warm" } else { settings.start.unwrap_or_default().name() };
        Self {
            solver: settings.solver.clone(),
            start: start.into(),
            coarse_levels: if warm { 0 } else { settings.coarse_levels.unwrap_or(0) },
            unsettled: factorization.unsettled,
            levels: factorization.levels.map(|loss| [loss.continuous, loss.rounded, loss.reoptimized]),
            steps,
        }
    }

    /// For the report.
    fn told(self) -> (Vec<Iteration>, Solution) {
        let Self { solver, start, coarse_levels, unsettled, levels, steps } = self;
        (report_steps(steps), Solution { solver, start, coarse_levels, unsettled, levels })
    }
}

/// Runs a whole job into `run_dir`.
///
/// # Errors
/// When any stage fails or is cancelled; finished stages are kept and taken up by the next run.
pub fn run(
    job: &Job,
    run_dir: &Path,
    registry: &Registry,
    command: Option<&str>,
    task: Task<'_>,
) -> Result<Summary, PipelineError> {
    if let Some(sequence) = &job.sequence {
        return sequence::run(job, sequence, run_dir, registry, command, task);
    }
    if !job.nodes.is_empty() {
        return graph::run(job, run_dir, registry, command, task);
    }
    let start = Instant::now();
    let warnings = Tee { list: Collector::default(), next: task.warnings };
    let task = Task { warnings: &warnings, ..task };
    let (mut run, made) = Run::make(job, run_dir, registry, &Moment::default(), task)?;
    let report = run.report(&made, &warnings.list.take(), command, task)?;
    Ok(Summary {
        report: run_dir.join("report.html"),
        psnr_view: report.psnr_view,
        psnr_raw: report.psnr_raw,
        psnr_held_out: report.held_out_psnr_view,
        psnr_outside: report.outside_psnr_view,
        nodes: Vec::new(),
        depth: made.input.depth.as_ref().map(DepthBudget::to_json),
        depth_sentence: made.input.depth.as_ref().map(DepthBudget::sentence),
        sequence: None,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Renders the views of a job's scene into `target_dir`, without factorizing; says what their depth asks of the display.
///
/// # Errors
/// When ingest or rendering fails or is cancelled.
pub fn render_only(
    job: &Job,
    target_dir: &Path,
    registry: &Registry,
    task: Task<'_>,
) -> Result<DepthBudget, PipelineError> {
    let Some(scene) = &job.scene else {
        return Err(PipelineError::value("job", "scene", "a scene to render", "none"));
    };
    check_folder(target_dir)?;
    let display = job.resolve_display()?;
    let geometry = display.geometry().map_err(|source| display_error(source, "field"))?;
    let ingested = ingest::load_scene(scene, &job.pose, &job.importer, registry, &job.light, task)?;
    let cache = target_dir.join("cache");
    let placement = fit::place(&ingested, &job.window, &display, &geometry, &cache, task)?;
    let mut job = job.clone();
    (job.render.held_out, job.render.outside) = (0, 0);
    let rendered = render::render(&job, &ingested, &placement, &geometry, &cache, task)?;
    let budget = rendered.depths.budget(&display, &geometry, &placement);
    warn_of_depth(&budget, task);
    write_field(target_dir, &rendered.target, &field_info(&rendered, &placement))?;
    Ok(budget)
}

/// Where a run stands in a sequence; the default for a still.
#[derive(Clone, Copy, Default)]
pub(crate) struct Moment<'a> {
    /// The scene, where it is loaded already.
    pub(crate) ingested: Option<&'a Ingested>,
    /// Geometry that the light field must have, and where it comes from.
    pub(crate) geometry: Option<(&'a FieldGeometry, &'a str)>,
    /// What to do instead of a warm start, where that is farther from the target than a fresh one.
    pub(crate) fresh: Option<&'a FactorizeJob>,
}

/// What the input stage gives.
pub(crate) struct Input {
    pub(crate) target: LightField,
    held_out: Option<LightField>,
    outside: Option<LightField>,
    /// How it became display-referred, where it was rendered.
    pub(crate) look: Option<Look>,
    /// What the scene's depth asks of the display, where it was rendered.
    pub(crate) depth: Option<DepthBudget>,
    about: Option<serde_json::Value>,
}

/// Everything up to the outputs.
pub(crate) struct Made {
    pub(crate) input: Input,
    pub(crate) weights: Weights,
    pub(crate) stack: LayerStack,
    pub(crate) steps: Vec<Iteration>,
    /// How the solver came to the patterns; `None` of those that a plugin made.
    pub(crate) solution: Option<Solution>,
    pub(crate) outputs: Vec<Output>,
}

pub(crate) struct Run<'a> {
    job: Cow<'a, Job>,
    registry: &'a Registry,
    dir: PathBuf,
    /// What makes the patterns, where the job says so.
    node: Option<&'a NodeJob>,
    /// The outputs' folder, relative to `dir`.
    outputs: String,
    pub(crate) display: Display,
    pub(crate) stamps: Stamps,
    pub(crate) stages: Vec<Stage>,
}

impl<'a> Run<'a> {
    /// Checks what can be checked without any work.
    pub(crate) fn open(job: &'a Job, dir: &Path, registry: &'a Registry) -> Result<Self, PipelineError> {
        let display = job.resolve_display()?;
        start_kind(&job.factorize.start)?;
        lumistack_factorizer::solver(&job.factorize.solver).map_err(PipelineError::Factorize)?;
        // found out before an hour of rendering, not after
        for output in &job.outputs {
            let info = registry.get_kind(&output.plugin, PluginKind::Output).map_err(PipelineError::Output)?.info();
            registry.check_params(&output.plugin, &output.params.clone().into()).map_err(PipelineError::Output)?;
            let of_field = output.from.as_deref() == Some(OutputJob::LIGHT_FIELD);
            let port = if of_field { Port::LightField } else { Port::LayerStack };
            if !info.ports.contains(&port) {
                let expected = format!("a plugin that takes a {port}");
                return Err(PipelineError::value("job", "outputs", expected, format!("`{}`", output.plugin)));
            }
        }
        check_folder(dir)?;
        let outputs = format!("outputs/{}", NodeJob::TENSOR_DISPLAY);
        let (dir, stamps) = (dir.to_owned(), Stamps::new(dir));
        Ok(Self { job: Cow::Borrowed(job), registry, dir, node: None, outputs, display, stamps, stages: Vec::new() })
    }

    /// The part of a graph's run that belongs to a node, in the folder `dir` = `nodes/ID` of the run; `job` is the node's own. Checks what can be checked
    /// without any work.
    pub(crate) fn of_node(
        job: &'a Job,
        node: &'a NodeJob,
        dir: &Path,
        registry: &'a Registry,
    ) -> Result<Self, PipelineError> {
        if node.plugin != NodeJob::TENSOR_DISPLAY {
            registry.get_kind(&node.plugin, PluginKind::Node).map_err(PipelineError::Output)?;
            registry.check_params(&node.plugin, &node.params.clone().into()).map_err(PipelineError::Output)?;
        }
        let outputs = format!("../../outputs/{}", node.id);
        Ok(Self { node: Some(node), outputs, ..Self::open(job, dir, registry)? })
    }

    /// Every stage but the report.
    pub(crate) fn make(
        job: &'a Job,
        dir: &Path,
        registry: &'a Registry,
        moment: &Moment<'_>,
        task: Task<'_>,
    ) -> Result<(Self, Made), PipelineError> {
        job.check()?;
        let mut run = Self::open(job, dir, registry)?;
        let input = run.input(moment, task)?;
        let made = run.patterns(input, moment.fresh, task)?;
        Ok((run, made))
    }

    /// From the light field to the outputs; `fresh` as in [`Moment`].
    pub(crate) fn patterns(
        &mut self,
        input: Input,
        fresh: Option<&FactorizeJob>,
        task: Task<'_>,
    ) -> Result<Made, PipelineError> {
        let display = self.display.clone();
        if let Some(message) = display.flicker_warning() {
            task.warn("display", message);
        }
        let weights = self.weights(&input.target)?;
        if let Some(fresh) = fresh {
            self.choose_start(fresh, &display, &input.target, &weights, task)?;
        }
        let (stack, (steps, solution)) = match self.node.filter(|node| node.plugin != NodeJob::TENSOR_DISPLAY) {
            None => {
                let (stack, (steps, solution)) = self.factorize(&display, &input.target, &weights, task)?;
                (stack, (steps, Some(solution)))
            }
            Some(node) => (self.run_node(node, &display, &input.target, task)?, (Vec::new(), None)),
        };
        // only now: a run that was stopped before has left the older settings, patterns and report together
        self.write_settings(&display)?;
        if self.stages.last().is_some_and(|stage| !stage.cached) {
            remove_reports(&self.dir)?;
        }
        let (data, from) = (OutputData::LayerStack(&stack, Some(&input.target)), NodeJob::TENSOR_DISPLAY);
        let folder = self.outputs.clone();
        let mut outputs = self.write_outputs(from, &folder, &display, data, task)?;
        if self.node.is_none() {
            let (data, from) = (OutputData::LightField(&input.target), OutputJob::LIGHT_FIELD);
            outputs.extend(self.write_outputs(from, &format!("outputs/{from}"), &display, data, task)?);
        }
        Ok(Made { input, weights, stack, steps, solution, outputs })
    }

    /// Measures what was made and writes the report.
    pub(crate) fn report(
        &mut self,
        made: &Made,
        warnings: &[Warning],
        command: Option<&str>,
        task: Task<'_>,
    ) -> Result<Report, PipelineError> {
        let stage = Instant::now();
        let Made { input, weights, stack, steps, solution, outputs } = made;
        let settings = serde_json::to_value(&*self.job).expect("jobs serialize");
        let report = lumistack_report::build(
            &ReportInput {
                title: &self.job.name,
                display: &self.display,
                stack,
                target: &input.target,
                weights,
                held_out: input.held_out.as_ref(),
                outside: input.outside.as_ref(),
                pixels_per_degree: self.job.report.pixels_per_degree,
                convergence: steps,
                solution: solution.as_ref(),
                stages: &self.stages,
                settings: &settings,
                scene: input.about.as_ref(),
                depth: input.depth.as_ref(),
                warnings,
                outputs,
                command,
                version: env!("CARGO_PKG_VERSION"),
            },
            task,
        )
        .map_err(PipelineError::Report)?;
        write_report(&self.dir, &report.html, &report.json)?;
        self.stages.push(Stage { name: "report".into(), seconds: stage.elapsed().as_secs_f64(), cached: false });
        Ok(report)
    }

    pub(crate) fn timed<T>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<(T, bool), PipelineError>,
    ) -> Result<T, PipelineError> {
        let start = Instant::now();
        let (result, cached) = work(self)?;
        self.stages.push(Stage { name: name.into(), seconds: start.elapsed().as_secs_f64(), cached });
        Ok(result)
    }

    pub(crate) fn input(&mut self, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        match (self.job.scene.clone(), self.job.light_field.clone()) {
            (Some(scene), _) => self.render_scene(&scene, moment, task),
            (None, Some(path)) => self.read_field(&path, moment, task),
            (None, None) => Err(PipelineError::value("job", "scene", "either `scene` or `light_field`", "neither")),
        }
    }

    fn render_scene(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let (job, registry) = (&self.job.clone(), self.registry);
        let loaded;
        let ingested = match moment.ingested {
            Some(ingested) => ingested,
            None => {
                loaded = self.timed("ingest", |_| {
                    Ok((ingest::load_scene(path, &job.pose, &job.importer, registry, &job.light, task)?, false))
                })?;
                &loaded
            }
        };
        let geometry = self.display.geometry().map_err(|source| display_error(source, "field"))?;
        let placement = fit::place(ingested, &job.window, &self.display, &geometry, &self.dir.join("cache"), task)?;
        let rendered = self.timed("render", |run| {
            let cache = run.dir.join("cache/views");
            let rendered = render::render(job, ingested, &placement, &geometry, &cache, task)?;
            let cached = rendered.cached;
            Ok((rendered, cached))
        })?;
        let info = field_info(&rendered, &placement);
        write_field_if_changed(&self.stamps, &self.dir, "target", &rendered.target, &info)?;
        for (name, field) in [("held-out", &rendered.held_out), ("outside", &rendered.outside)] {
            if let Some(field) = field {
                write_field_if_changed(&self.stamps, &self.dir, name, field, &info)?;
            }
        }
        let depth = rendered.depths.budget(&self.display, &geometry, &placement);
        warn_of_depth(&depth, task);
        let about = about_scene(path, ingested, &placement, &rendered);
        let render::Rendered { target, held_out, outside, look, .. } = rendered;
        Ok(Input { target, held_out, outside, look: Some(look), depth: Some(depth), about: Some(about) })
    }

    fn read_field(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let job = &self.job.clone();
        let defaults = lumistack_field_io::GeometryDefaults {
            width_mm: Some(self.display.field_pixels().size_mm()[0]),
            fov_deg: Some(self.display.field.fov_deg),
        };
        let target = self.timed("read", |_| {
            let mut field = lumistack_field_io::open(path, &job.geometry, &defaults, task).map_err(field_error)?;
            lumistack_field_io::round_to_half(&mut field);
            Ok((field, false))
        })?;
        if let Some((geometry, place)) = moment.geometry {
            sequence::check_geometry(path, target.geometry(), geometry, place)?;
        }
        self.display = self.display.adapted_to(target.geometry());
        self.display.check().map_err(|source| display_error(source, "light field"))?;
        write_field_if_changed(&self.stamps, &self.dir, "target", &target, &Map::new())?;
        let about = json!({ "light field": path.display().to_string() });
        Ok(Input { target, held_out: None, outside: None, look: None, depth: None, about: Some(about) })
    }

    /// A node's job stands with that of the whole run.
    pub(crate) fn write_settings(&self, display: &Display) -> Result<(), PipelineError> {
        if self.node.is_none() {
            write_job(&self.job, &self.dir)?;
        }
        write(&self.dir.join("display.toml"), display.to_toml().as_bytes())
    }

    fn weights(&self, target: &LightField) -> Result<Weights, PipelineError> {
        let eyes = &self.job.factorize.eyes;
        let Some(path) = &self.job.factorize.weights else {
            if eyes.is_empty() {
                return Ok(Weights::Uniform);
            }
            let boxes: Vec<EyeBox> = eyes
                .iter()
                .map(|eye| EyeBox { eye_mm: eye.eye_mm, sigma_mm: eye.sigma_mm, weight: eye.weight })
                .collect();
            return Weights::eye_boxes(target.geometry(), &boxes, self.job.factorize.eye_floor as f32)
                .map_err(|error| PipelineError::value("job", "factorize.eyes", error.expected, error.found));
        };
        if !eyes.is_empty() {
            return Err(PipelineError::value("job", "factorize.eyes", "either `weights` or `eyes`", "both"));
        }
        let (shape, data) = lumistack_field_io::npy::read(path).map_err(field_error)?;
        let weights = match shape.as_slice() {
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
        weights.check(target.geometry()).map_err(|source| PipelineError::Weights { path: path.clone(), source })?;
        Ok(weights)
    }

    /// Takes the job's warm start away, and `fresh` instead, where a fresh start gets nearer to the target.
    fn choose_start(
        &mut self,
        fresh: &FactorizeJob,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        task: Task<'_>,
    ) -> Result<(), PipelineError> {
        let job = &self.job.factorize;
        let Some(warm) = warm_stack(job, display)? else { return Ok(()) };
        let mut key = KeyBuilder::new("start", FACTORIZE_VERSION);
        key.add("display", display.to_toml().as_bytes())
            .add_json("settings", &(&fresh.solver, &fresh.start, &job.solver, self.job.seed))
            .add_json("coarse", &(fresh.coarse_levels, fresh.coarse_iterations))
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data());
        add_weights(&mut key, weights);
        add_stack(&mut key, &warm);
        let key = key.finish();
        let path = self.dir.join("cache/start.json");
        let kept = || serde_json::from_slice::<Choice>(&std::fs::read(&path).ok()?).ok();
        let choice = match kept().filter(|choice| choice.key == key) {
            Some(choice) => choice,
            None => {
                let settings = solver_settings(fresh, self.job.seed)?;
                let problem = Problem { display, target, weights };
                let warm = lumistack_factorizer::warm_start_pays(&problem, &settings, &warm, &job.solver, task)
                    .map_err(factorize_error)?;
                let choice = Choice { key, warm };
                write(&path, &serde_json::to_vec(&choice).expect("choices serialize"))?;
                choice
            }
        };
        if !choice.warm {
            self.job.to_mut().factorize = fresh.clone();
        }
        Ok(())
    }

    fn factorize(
        &mut self,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        task: Task<'_>,
    ) -> Result<(LayerStack, (Vec<Iteration>, Solution)), PipelineError> {
        let job = &self.job.factorize;
        let warm = warm_stack(job, display)?;
        let mut key = KeyBuilder::new("factorize", FACTORIZE_VERSION);
        key.add("display", display.to_toml().as_bytes())
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data())
            .add_json("settings", &(&job.solver, job.iterations, &job.start, self.job.seed))
            .add_json("coarse and levels", &(job.coarse_levels, job.coarse_iterations, job.levels));
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
                && let Some(solved) =
                    std::fs::read(&curve).ok().and_then(|text| serde_json::from_slice::<Solved>(&text).ok())
            {
                return Ok(((stack, solved.told()), true));
            }
            run.stamps.clear("factorize")?;
            let (factorization, steps) = run.solve(display, target, weights, warm.as_ref(), task)?;
            let solved = Solved::of(&factorization, steps, warm.is_some());
            let stack = factorization.stack;
            let mut files = run.write_layers(display, &stack)?;
            write(&curve, &serde_json::to_vec(&solved).expect("solutions serialize"))?;
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
    fn run_node(
        &mut self,
        node: &NodeJob,
        display: &Display,
        target: &LightField,
        task: Task<'_>,
    ) -> Result<LayerStack, PipelineError> {
        let mut key = KeyBuilder::new("node", 1);
        key.add("plugin", ingest::plugin_key(self.registry, &node.plugin, &node.params)?.as_bytes())
            .add("display", display.to_toml().as_bytes())
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data());
        let key = key.finish();
        self.timed(&node.plugin, |run| {
            let layers = run.dir.join("layers");
            if run.stamps.is_current("node", &key)
                && let Ok(stack) = lumistack_field_io::read_stack(&layers)
                && check_stack(&stack, display, &layers).is_ok()
            {
                return Ok((stack, true));
            }
            run.stamps.clear("node")?;
            let (params, time) = (node.params.clone().into(), Time::default());
            let stack =
                lumistack_plugin_host::make_stack(run.registry, &node.plugin, &params, display, time, target, task)
                    .map_err(host_error)?;
            let files = run.write_layers(display, &stack)?;
            run.stamps.write("node", &key, &files)?;
            Ok((stack, false))
        })
    }

    fn solve(
        &self,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        warm: Option<&LayerStack>,
        task: Task<'_>,
    ) -> Result<(Factorization, Vec<Step>), PipelineError> {
        let settings = solver_settings(&self.job.factorize, self.job.seed)?;
        let problem = Problem { display, target, weights };
        let start = Instant::now();
        let mut steps = Vec::new();
        let result = lumistack_factorizer::factorize(&problem, &settings, warm, task, &mut |step| {
            let seconds = start.elapsed().as_secs_f64();
            let psnr_view = step.psnr_view.is_finite().then_some(step.psnr_view);
            steps.push(Step { iteration: step.iteration, objective: step.objective, psnr_view, seconds });
        });
        match result {
            Ok(factorization) => Ok((factorization, steps)),
            Err(error) => Err(factorize_error(error)),
        }
    }

    /// Runs the outputs of the job that take what `from` makes; `folder` is where, relative to the run's folder.
    pub(crate) fn write_outputs(
        &mut self,
        from: &str,
        folder: &str,
        display: &Display,
        data: OutputData<'_>,
        task: Task<'_>,
    ) -> Result<Vec<Output>, PipelineError> {
        let (job, registry) = (self.job.clone(), self.registry);
        let mut outputs = Vec::new();
        for output in job.outputs_of(from) {
            let relative = format!("{folder}/{}", output.name());
            let params = output.params.clone().into();
            let mut key = KeyBuilder::new(&format!("output {}", output.plugin), 3);
            key.add("plugin", ingest::plugin_key(registry, &output.plugin, &output.params)?.as_bytes())
                .add("display", display.to_toml().as_bytes());
            match data {
                OutputData::LayerStack(stack, target) => {
                    if let Some(target) = target {
                        key.add("geometry", format!("{:?}", target.geometry()).as_bytes());
                        key.add_f32("target", target.radiance().data());
                    }
                    key.add_json("brightness", &stack.brightness);
                    for layer in &stack.layers {
                        key.add_f32("layer", layer.data());
                    }
                    if let Some(emission) = &stack.emission {
                        key.add_f32("emission", emission.data());
                    }
                }
                OutputData::LightField(field) => {
                    key.add("geometry", format!("{:?}", field.geometry()).as_bytes());
                    key.add_f32("radiance", field.radiance().data());
                }
            }
            let key = key.finish();
            let stage = match from {
                OutputJob::LIGHT_FIELD => format!("output-{from}-{}", output.name()),
                _ => format!("output-{}", output.name()),
            };
            let written: Vec<PathBuf> = self.timed(&stage, |run| {
                let list = run.dir.join("cache").join(format!("{stage}-files.json"));
                if run.stamps.is_current(&stage, &key)
                    && let Some(written) = std::fs::read(&list).ok().and_then(|t| serde_json::from_slice(&t).ok())
                {
                    return Ok((written, true));
                }
                run.stamps.clear(&stage)?;
                let out_dir = &run.dir.join(&relative);
                let context = OutputContext { display, data, time: Time::default(), out_dir, task };
                let result = lumistack_plugin_host::run_output(registry, &output.plugin, &params, context);
                let mut written = result.map_err(host_error)?;
                written.iter_mut().for_each(|file| *file = Path::new(&relative).join(&*file));
                write(&list, &serde_json::to_vec(&written).expect("paths serialize"))?;
                run.stamps.write(&stage, &key, &written)?;
                Ok((written, false))
            })?;
            outputs.push(Output { label: format!("{}, {} files", output.name(), written.len()), path: relative });
        }
        Ok(outputs)
    }
}

/// An error of a plugin; being asked to stop is none.
pub(crate) fn host_error(error: HostError) -> PipelineError {
    match error {
        HostError::Cancelled => PipelineError::Cancelled,
        other => PipelineError::Output(other),
    }
}

/// Which start a time of a sequence takes, as it is kept between runs.
#[derive(Serialize, Deserialize)]
struct Choice {
    key: String,
    warm: bool,
}

/// The patterns that a job starts from.
fn warm_stack(job: &FactorizeJob, display: &Display) -> Result<Option<LayerStack>, PipelineError> {
    let Some(path) = &job.warm_start else { return Ok(None) };
    let stack = lumistack_field_io::read_stack(path).map_err(field_error)?;
    check_stack(&stack, display, path)?;
    Ok(Some(stack))
}

fn solver_settings(job: &FactorizeJob, seed: u64) -> Result<lumistack_factorizer::Settings, PipelineError> {
    Ok(lumistack_factorizer::Settings {
        solver: job.solver.clone(),
        iterations: job.iterations,
        seed,
        start: start_kind(&job.start)?,
        coarse_levels: job.coarse_levels,
        coarse_iterations: job.coarse_iterations,
        report_every: (job.iterations / CURVE_POINTS).max(1),
        levels: job.levels,
    })
}

fn factorize_error(error: FactorizeError) -> PipelineError {
    match error {
        FactorizeError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Factorize(other),
    }
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
fn start_kind(name: &str) -> Result<Option<StartKind>, PipelineError> {
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

fn warn_of_depth(budget: &DepthBudget, task: Task<'_>) {
    if let Some(advice) = budget.advice() {
        task.warn("depth", advice);
    }
}

fn about_scene(
    path: &Path,
    ingested: &Ingested,
    placement: &Placement,
    rendered: &render::Rendered,
) -> serde_json::Value {
    let scene = &ingested.scene;
    let pose = serde_json::to_value(&ingested.pose).expect("poses serialize");
    let mut values = rendered.target.radiance().data().to_vec();
    let percentile = |values: &mut [f32], share| f64::from(lumistack_core::metrics::percentile(values, share));
    let span = percentile(&mut values, 0.99) - percentile(&mut values, 0.01);
    let map = placement.window.scene_from_display;
    json!({
        "file": path.display().to_string(),
        "pose": pose,
        "triangles": scene.triangle_count(),
        "meshes": scene.meshes.len(),
        "instances": scene.instances.len(),
        "materials": scene.materials.len(),
        "textures": scene.textures.len(),
        "lights": scene.lights.len(),
        "window centre (scene units)": map.translation.to_array(),
        "scene units per millimetre": map.scale,
        "window moved back to fit (mm)": placement.moved_back_mm,
        "depth scale": placement.depth_scale,
        "exposure": rendered.look.exposure,
        "tone curve": rendered.look.curve.name(),
        // shares of the window and of the range 0..1: whether framing, light and exposure fit the scene
        "coverage": rendered.coverage,
        "target span": span,
    })
}

/// Writes `job.toml` so that it can be run from where it lies.
pub(crate) fn write_job(job: &Job, dir: &Path) -> Result<(), PipelineError> {
    let mut job = job.clone();
    for path in job.paths_mut() {
        if let Ok(absolute) = std::path::absolute(&*path) {
            *path = absolute;
        }
    }
    write(&dir.join("job.toml"), job.to_toml().as_bytes())
}

/// Removes the reports of older patterns.
pub(crate) fn remove_reports(dir: &Path) -> Result<(), PipelineError> {
    for name in ["report.html", "report.json"] {
        let path = dir.join(name);
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(PipelineError::Write { path, source });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes `report.json`, then `report.html`.
pub(crate) fn write_report(dir: &Path, html: &str, json: &serde_json::Value) -> Result<(), PipelineError> {
    write(&dir.join("report.json"), &serde_json::to_vec_pretty(json).expect("reports serialize"))?;
    write(&dir.join("report.html"), html.as_bytes())
}

fn check_stack(stack: &LayerStack, display: &Display, path: &Path) -> Result<(), PipelineError> {
    stack.check(display).map_err(|source: StackError| PipelineError::Stack { path: path.to_owned(), source })
}

fn check_folder(path: &Path) -> Result<(), PipelineError> {
    if path.is_file() { Err(PipelineError::NotAFolder { path: path.to_owned() }) } else { Ok(()) }
}

pub(crate) fn display_error(source: lumistack_display::DisplayError, place: &str) -> PipelineError {
    PipelineError::Display { path: place.into(), text: String::new(), source }
}

pub(crate) fn field_error(error: lumistack_field_io::FieldError) -> PipelineError {
    match error {
        lumistack_field_io::FieldError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Field(other),
    }
}

pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), PipelineError> {
    lumistack_field_io::atomic::write_bytes(path, bytes).map_err(field_error)
}

/// What a light field's index says of how it was made.
fn field_info(rendered: &render::Rendered, placement: &Placement) -> Map<String, Value> {
    let mut info = Map::new();
    info.insert("exposure".into(), rendered.look.exposure.into());
    info.insert("tone".into(), rendered.look.curve.name().into());
    info.insert("depth_scale".into(), placement.depth_scale.into());
    info
}

fn write_field(dir: &Path, field: &LightField, info: &Map<String, Value>) -> Result<(), PipelineError> {
    lumistack_field_io::write_field(dir, field, info).map_err(field_error)?;
    Ok(())
}

/// Writes a light-field folder unless it already holds these values.
fn write_field_if_changed(
    stamps: &Stamps,
    run_dir: &Path,
    name: &str,
    field: &LightField,
    info: &Map<String, Value>,
) -> Result<(), PipelineError> {
    let mut key = KeyBuilder::new(name, 1);
    key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_f32("radiance", field.radiance().data());
    let key = key.add_json("info", info).finish();
    if stamps.is_current(name, &key) {
        return Ok(());
    }
    stamps.clear(name)?;
    write_field(&run_dir.join(name), field, info)?;
    let mut files = vec![Path::new(name).join("lightfield.json")];
    files.extend(field.geometry().grid.iter().map(|[y, x]| Path::new(name).join(format!("view_{y:02}_{x:02}.exr"))));
    stamps.write(name, &key, &files)
}

/// Keeps warnings for the report and passes them on.
pub(crate) struct Tee<'a> {
    pub(crate) list: Collector,
    pub(crate) next: &'a dyn Warnings,
}

impl Warnings for Tee<'_> {
    fn warn(&self, warning: Warning) {
        self.list.warn(warning.clone());
        self.next.warn(warning);
    }
}
