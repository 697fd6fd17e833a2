//! A job from its input to its report. Every stage leaves its result in the run folder and a stamp in `cache/`; a rerun takes what is current.

use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::config::nearest;
use lumistack_core::{Collector, Task, Tensor, Warning, Warnings};
use lumistack_display::{Display, EyeBox, FieldGeometry, LayerStack, LightField, StackError, Weights};
use lumistack_factorizer::{AUTO, Factorization, FactorizeError, Problem, StartKind};
use lumistack_plugin_host::{HostError, OutputContext, OutputData, Registry, Time};
use lumistack_report::{Iteration, Output, Report, ReportInput, Solution, Stage};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::cache::{KeyBuilder, Stamps};
use crate::error::PipelineError;
use crate::ingest::{self, Ingested};
use crate::job::Job;
use crate::render;
use crate::sequence::{self, SequenceSummary};

/// Changes whenever a solver gives other patterns.
const FACTORIZE_VERSION: u32 = 2;
/// Points of the convergence curve: enough for a plot; each costs a part of an update.
const CURVE_POINTS: u32 = 40;
/// Name of the one node of a plain job.
const NODE: &str = "tensor-display";

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
pub fn run(job: &Job, run_dir: &Path, command: Option<&str>, task: Task<'_>) -> Result<Summary, PipelineError> {
    if let Some(sequence) = &job.sequence {
        return sequence::run(job, sequence, run_dir, command, task);
    }
    let start = Instant::now();
    let warnings = Tee { list: Collector::default(), next: task.warnings };
    let task = Task { warnings: &warnings, ..task };
    let (mut run, made) = Run::make(job, run_dir, &Moment::default(), task)?;
    let report = run.report(&made, &warnings.list.take(), command, task)?;
    Ok(Summary {
        report: run_dir.join("report.html"),
        psnr_view: report.psnr_view,
        psnr_raw: report.psnr_raw,
        psnr_held_out: report.held_out_psnr_view,
        psnr_outside: report.outside_psnr_view,
        sequence: None,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Renders the views of a job's scene into `target_dir`, without factorizing.
///
/// # Errors
/// When ingest or rendering fails or is cancelled.
pub fn render_only(job: &Job, target_dir: &Path, task: Task<'_>) -> Result<(), PipelineError> {
    let Some(scene) = &job.scene else {
        return Err(PipelineError::value("job", "scene", "a scene to render", "none"));
    };
    check_folder(target_dir)?;
    let display = job.resolve_display()?;
    let geometry = display.geometry().map_err(|source| display_error(source, "field"))?;
    let ingested = ingest::load_scene(scene, &job.light, task)?;
    let window = ingest::place_window(&ingested, &job.window, &geometry, &target_dir.join("cache"), task)?;
    let mut job = job.clone();
    (job.render.held_out, job.render.outside) = (0, 0);
    let rendered = render::render(&job, &ingested, &window, &geometry, &target_dir.join("cache"), task)?;
    write_field(target_dir, &rendered.target, Some(rendered.exposure))
}

/// Where a run stands in a sequence; the default for a still.
#[derive(Clone, Copy, Default)]
pub(crate) struct Moment<'a> {
    /// The scene, where it is loaded already.
    pub(crate) ingested: Option<&'a Ingested>,
    /// Geometry that the light field must have, and where it comes from.
    pub(crate) geometry: Option<(&'a FieldGeometry, &'a str)>,
}

/// What the input stage gives.
pub(crate) struct Input {
    pub(crate) target: LightField,
    held_out: Option<LightField>,
    outside: Option<LightField>,
    /// Factor from scene-linear to display-referred radiance, where it was rendered.
    pub(crate) exposure: Option<f64>,
    about: Option<serde_json::Value>,
}

/// Everything up to the outputs.
pub(crate) struct Made {
    pub(crate) input: Input,
    pub(crate) weights: Weights,
    pub(crate) stack: LayerStack,
    pub(crate) steps: Vec<Iteration>,
    pub(crate) solution: Solution,
    outputs: Vec<Output>,
}

pub(crate) struct Run<'a> {
    job: &'a Job,
    dir: PathBuf,
    pub(crate) display: Display,
    pub(crate) stamps: Stamps,
    pub(crate) stages: Vec<Stage>,
}

impl<'a> Run<'a> {
    /// Checks what can be checked without any work.
    pub(crate) fn open(job: &'a Job, dir: &Path) -> Result<Self, PipelineError> {
        let display = job.resolve_display()?;
        start_kind(&job.factorize.start)?;
        lumistack_factorizer::solver(&job.factorize.solver).map_err(PipelineError::Factorize)?;
        let registry = Registry::built_in().map_err(PipelineError::Output)?;
        for output in &job.outputs {
            // found out before an hour of rendering, not after
            registry.check_params(&output.plugin, &output.params.clone().into()).map_err(PipelineError::Output)?;
        }
        check_folder(dir)?;
        Ok(Self { job, dir: dir.to_owned(), display, stamps: Stamps::new(dir), stages: Vec::new() })
    }

    /// Every stage but the report.
    pub(crate) fn make(
        job: &'a Job,
        dir: &Path,
        moment: &Moment<'_>,
        task: Task<'_>,
    ) -> Result<(Self, Made), PipelineError> {
        job.check()?;
        let mut run = Self::open(job, dir)?;
        let input = run.input(moment, task)?;
        let display = run.display.clone();
        if let Some(message) = display.flicker_warning() {
            task.warn("display", message);
        }
        let weights = run.weights(&input.target)?;
        let (stack, (steps, solution)) = run.factorize(&display, &input.target, &weights, task)?;
        // only now: a run that was stopped before has left the older settings, patterns and report together
        run.write_settings(&display)?;
        if run.stages.last().is_some_and(|stage| !stage.cached) {
            remove_reports(dir)?;
        }
        let outputs = run.outputs(&display, &stack, &input.target, task)?;
        Ok((run, Made { input, weights, stack, steps, solution, outputs }))
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
        let settings = serde_json::to_value(self.job).expect("jobs serialize");
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
                solution: Some(solution),
                stages: &self.stages,
                settings: &settings,
                scene: input.about.as_ref(),
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

    fn input(&mut self, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        match (&self.job.scene, &self.job.light_field) {
            (Some(scene), _) => self.render_scene(scene, moment, task),
            (None, Some(path)) => self.read_field(path, moment, task),
            (None, None) => Err(PipelineError::value("job", "scene", "either `scene` or `light_field`", "neither")),
        }
    }

    fn render_scene(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let job = self.job;
        let loaded;
        let ingested = match moment.ingested {
            Some(ingested) => ingested,
            None => {
                loaded = self.timed("ingest", |_| Ok((ingest::load_scene(path, &job.light, task)?, false)))?;
                &loaded
            }
        };
        let geometry = self.display.geometry().map_err(|source| display_error(source, "field"))?;
        let window = ingest::place_window(ingested, &job.window, &geometry, &self.dir.join("cache"), task)?;
        let rendered = self.timed("render", |run| {
            let cache = run.dir.join("cache/views");
            let rendered = render::render(job, ingested, &window, &geometry, &cache, task)?;
            let cached = rendered.cached;
            Ok((rendered, cached))
        })?;
        write_field_if_changed(&self.stamps, &self.dir, "target", &rendered.target, Some(rendered.exposure))?;
        for (name, field) in [("held-out", &rendered.held_out), ("outside", &rendered.outside)] {
            if let Some(field) = field {
                write_field_if_changed(&self.stamps, &self.dir, name, field, Some(rendered.exposure))?;
            }
        }
        let about = about_scene(path, ingested, &window, &rendered);
        let render::Rendered { target, held_out, outside, exposure, .. } = rendered;
        Ok(Input { target, held_out, outside, exposure: Some(exposure), about: Some(about) })
    }

    fn read_field(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let job = self.job;
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
        write_field_if_changed(&self.stamps, &self.dir, "target", &target, None)?;
        let about = json!({ "light field": path.display().to_string() });
        Ok(Input { target, held_out: None, outside: None, exposure: None, about: Some(about) })
    }

    fn write_settings(&self, display: &Display) -> Result<(), PipelineError> {
        write_job(self.job, &self.dir)?;
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

    fn factorize(
        &mut self,
        display: &Display,
        target: &LightField,
        weights: &Weights,
        task: Task<'_>,
    ) -> Result<(LayerStack, (Vec<Iteration>, Solution)), PipelineError> {
        let job = &self.job.factorize;
        let warm = match &job.warm_start {
            Some(path) => {
                let stack = lumistack_field_io::read_stack(path).map_err(field_error)?;
                check_stack(&stack, display, path)?;
                Some(stack)
            }
            None => None,
        };
        let mut key = KeyBuilder::new("factorize", FACTORIZE_VERSION);
        key.add("display", display.to_toml().as_bytes())
            .add("geometry", format!("{:?}", target.geometry()).as_bytes())
            .add_f32("target", target.radiance().data())
            .add_json("settings", &(&job.solver, job.iterations, &job.start, self.job.seed))
            .add_json("coarse and levels", &(job.coarse_levels, job.coarse_iterations, job.levels));
        match weights {
            Weights::Uniform => {}
            Weights::PerView(t) => {
                key.add_f32("weights per view", t.data());
            }
            Weights::PerRay(t) => {
                key.add_f32("weights per ray", t.data());
            }
        }
        for layer in warm.iter().flat_map(|stack| &stack.layers) {
            key.add_f32("warm layer", layer.data());
        }
        if let Some(emission) = warm.as_ref().and_then(|stack| stack.emission.as_ref()) {
            key.add_f32("warm emission", emission.data());
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
            lumistack_field_io::write_stack(&layers, display, &stack).map_err(field_error)?;
            write(&curve, &serde_json::to_vec(&solved).expect("solutions serialize"))?;
            let index = lumistack_field_io::read_stack_index(&layers).map_err(field_error)?;
            let mut files: Vec<PathBuf> = vec!["layers/stack.json".into(), "cache/convergence.json".into()];
            files.extend(index.layers.iter().map(|layer| Path::new("layers").join(&layer.file)));
            files.extend(index.backlight.iter().map(|backlight| Path::new("layers").join(&backlight.file)));
            run.stamps.write("factorize", &key, &files)?;
            Ok(((stack, solved.told()), false))
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
        let job = &self.job.factorize;
        let settings = lumistack_factorizer::Settings {
            solver: job.solver.clone(),
            iterations: job.iterations,
            seed: self.job.seed,
            start: start_kind(&job.start)?,
            coarse_levels: job.coarse_levels,
            coarse_iterations: job.coarse_iterations,
            report_every: (job.iterations / CURVE_POINTS).max(1),
            levels: job.levels,
        };
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
            Err(FactorizeError::Cancelled(_)) => Err(PipelineError::Cancelled),
            Err(other) => Err(PipelineError::Factorize(other)),
        }
    }

    fn outputs(
        &mut self,
        display: &Display,
        stack: &LayerStack,
        target: &LightField,
        task: Task<'_>,
    ) -> Result<Vec<Output>, PipelineError> {
        let registry = Registry::built_in().map_err(PipelineError::Output)?;
        let mut files = Vec::new();
        for output in &self.job.outputs {
            let relative = Path::new("outputs").join(NODE).join(&output.plugin);
            let params = output.params.clone().into();
            let mut key = KeyBuilder::new(&format!("output {}", output.plugin), 1);
            key.add("plugin", registry.get(&output.plugin).map_err(PipelineError::Output)?.info().version.as_bytes())
                .add("display", display.to_toml().as_bytes())
                .add_json("params", &params)
                .add("geometry", format!("{:?}", target.geometry()).as_bytes());
            for layer in &stack.layers {
                key.add_f32("layer", layer.data());
            }
            if let Some(emission) = &stack.emission {
                key.add_f32("emission", emission.data());
            }
            let key = key.finish();
            let stage = format!("output-{}", output.plugin);
            let written = self.timed(&stage, |run| {
                let list = run.dir.join("cache").join(format!("{stage}-files.json"));
                if run.stamps.is_current(&stage, &key)
                    && let Some(written) = std::fs::read(&list).ok().and_then(|t| serde_json::from_slice(&t).ok())
                {
                    return Ok((written, true));
                }
                run.stamps.clear(&stage)?;
                let context = OutputContext {
                    display,
                    data: OutputData::LayerStack(stack, Some(target.geometry())),
                    time: Time::default(),
                    out_dir: &run.dir.join(&relative),
                    task,
                };
                let result = lumistack_plugin_host::run_output(&registry, &output.plugin, &params, context);
                let mut written = result.map_err(|error| match error {
                    HostError::Cancelled => PipelineError::Cancelled,
                    other => PipelineError::Output(other),
                })?;
                written.iter_mut().for_each(|file| *file = relative.join(&*file));
                write(&list, &serde_json::to_vec(&written).expect("paths serialize"))?;
                run.stamps.write(&stage, &key, &written)?;
                Ok((written, false))
            })?;
            let written: Vec<PathBuf> = written;
            files.push(Output {
                label: format!("{}, {} files", output.plugin, written.len()),
                path: relative
                    .components()
                    .map(|part| part.as_os_str().to_string_lossy())
                    .collect::<Vec<_>>()
                    .join("/"),
            });
        }
        Ok(files)
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

fn about_scene(
    path: &Path,
    ingested: &Ingested,
    window: &lumistack_scene::Window,
    rendered: &render::Rendered,
) -> serde_json::Value {
    let scene = &ingested.scene;
    let mut values = rendered.target.radiance().data().to_vec();
    let percentile = |values: &mut [f32], share| f64::from(lumistack_core::metrics::percentile(values, share));
    let span = percentile(&mut values, 0.99) - percentile(&mut values, 0.01);
    let map = window.scene_from_display;
    json!({
        "file": path.display().to_string(),
        "triangles": scene.triangle_count(),
        "meshes": scene.meshes.len(),
        "instances": scene.instances.len(),
        "materials": scene.materials.len(),
        "textures": scene.textures.len(),
        "lights": scene.lights.len(),
        "window centre (scene units)": map.translation.to_array(),
        "scene units per millimetre": map.scale,
        "exposure": rendered.exposure,
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

fn write_field(dir: &Path, field: &LightField, exposure: Option<f64>) -> Result<(), PipelineError> {
    let mut info = serde_json::Map::new();
    if let Some(exposure) = exposure {
        info.insert("exposure".into(), exposure.into());
    }
    lumistack_field_io::write_field(dir, field, &info).map_err(field_error)?;
    Ok(())
}

/// Writes a light-field folder unless it already holds these values.
fn write_field_if_changed(
    stamps: &Stamps,
    run_dir: &Path,
    name: &str,
    field: &LightField,
    exposure: Option<f64>,
) -> Result<(), PipelineError> {
    let mut key = KeyBuilder::new(name, 1);
    key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_f32("radiance", field.radiance().data());
    let key = key.finish();
    if stamps.is_current(name, &key) {
        return Ok(());
    }
    stamps.clear(name)?;
    write_field(&run_dir.join(name), field, exposure)?;
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
