//! A job from its input to its report. Every stage leaves its result in the run folder and a stamp in `cache/`; a rerun takes what is current.

mod input;
mod outputs;
mod patterns;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::{Collector, Task, Warning, Warnings};
use lumistack_display::{Display, FieldGeometry, LayerStack, Weights};
use lumistack_plugin_host::{OutputData, PluginKind, Port, Registry};
use lumistack_report::{DepthBudget, Iteration, Output, Report, ReportInput, Solution, Stage};
use serde::Serialize;
use serde_json::Value;

pub(crate) use self::input::Input;
pub use self::input::render_only;
pub(crate) use self::input::warn_of_depth;
pub use self::outputs::{RefusedOutput, refused_outputs};
use self::patterns::start_kind;
pub(crate) use self::patterns::{add_stack, add_weights, array_weights, eye_weights, solver_settings};
use crate::cache::Stamps;
use crate::clean;
use crate::denoise::Denoised;
use crate::error::{FailedOutput, PipelineError};
use crate::file_params;
use crate::files::{check_folder, remove_reports, write_job, write_report};
use crate::folder::{self, Work, write_display};
use crate::graph::{self, NodeSummary};
use crate::ingest::Ingested;
use crate::job::{FactorizeJob, Job, NodeJob, OutputJob};
use crate::sequence::{self, SequenceSummary};
use crate::zone::References;

/// What a run ended with.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The report.
    #[serde(serialize_with = "crate::path_text::told")]
    pub report: PathBuf,
    /// Headline: PSNR of seen pictures all over the zone, dB; where a scene was rendered.
    pub psnr_zone: Option<f64>,
    /// The same of the worst tenth of the directions, dB.
    pub psnr_zone_worst: Option<f64>,
    /// PSNR of L̃/β against L at the solver's views, dB.
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
    /// Outputs that could not be written; all others were.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub failed_outputs: Vec<FailedOutput>,
    /// Time of the whole run, seconds.
    pub seconds: f64,
}

impl Summary {
    /// Of the run in `run_dir` that began at `start`; `psnr` is the view's and the raw one.
    pub(crate) fn new(run_dir: &Path, psnr: [f64; 2], depth: Option<&DepthBudget>, start: Instant) -> Self {
        Self {
            report: run_dir.join("report.html"),
            psnr_zone: None,
            psnr_zone_worst: None,
            psnr_view: psnr[0],
            psnr_raw: psnr[1],
            psnr_held_out: None,
            psnr_outside: None,
            nodes: Vec::new(),
            depth: depth.map(DepthBudget::to_json),
            depth_sentence: depth.map(DepthBudget::sentence),
            sequence: None,
            failed_outputs: Vec::new(),
            seconds: start.elapsed().as_secs_f64(),
        }
    }
}

/// Runs a whole job into `run_dir`. An output that fails ends neither the run nor the outputs after it: the report and the summary name it.
///
/// # Errors
/// When another run works in the folder, the folder holds what is not ours, or any other stage fails or is cancelled; finished stages are kept and taken up
/// by the next run.
pub fn run(
    job: &Job,
    run_dir: &Path,
    registry: &Registry,
    command: Option<&str>,
    task: Task<'_>,
) -> Result<Summary, PipelineError> {
    if job.sweep.is_some() {
        let expected = "a job without `[sweep]`, or `lumistack sweep`, which compares its designs";
        return Err(PipelineError::value("job", "sweep", expected, "`[sweep]`"));
    }
    let job = &file_params::resolved(job, registry)?;
    let work = if job.sequence.is_some() { Work::Sequence } else { Work::Run };
    let _owned = folder::take(run_dir, work, job, registry, task)?;
    if let Some(sequence) = &job.sequence {
        return sequence::run(job, sequence, run_dir, registry, command, task);
    }
    if !job.nodes.is_empty() {
        return graph::run(job, run_dir, registry, command, task);
    }
    let start = Instant::now();
    let warnings = Tee::new(task.warnings);
    let task = Task { warnings: &warnings, ..task };
    let (mut run, made) = Run::make(job, run_dir, registry, &Moment::default(), task)?;
    let report = run.report(&made, &warnings.list.take(), command, task)?;
    clean::keep_only_views(run_dir, &made.input.views)?;
    Ok(Summary {
        psnr_zone: report.psnr_zone,
        psnr_zone_worst: report.psnr_zone_worst,
        failed_outputs: made.failed_outputs(""),
        psnr_held_out: report.held_out_psnr_view,
        psnr_outside: report.outside_psnr_view,
        ..Summary::new(run_dir, [report.psnr_view, report.psnr_raw], made.input.depth.as_ref(), start)
    })
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

impl Made {
    /// The outputs that could not be written, their paths after `prefix`.
    pub(crate) fn failed_outputs(&self, prefix: &str) -> Vec<FailedOutput> {
        failed_of(&self.outputs, prefix)
    }
}

/// Those of `outputs` that could not be written, their paths after `prefix`.
pub(crate) fn failed_of(outputs: &[Output], prefix: &str) -> Vec<FailedOutput> {
    let failed = outputs.iter().filter_map(|output| Some((output.path.clone(), output.failed.clone()?)));
    failed.map(|(path, reason)| FailedOutput { path: format!("{prefix}{path}"), reason }).collect()
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
        if let Some(source) = &job.source {
            registry.get_kind(&source.plugin, PluginKind::Source).map_err(PipelineError::Output)?;
            registry.check_params(&source.plugin, &source.params.clone().into()).map_err(PipelineError::Output)?;
        }
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
        registry.get_kind(&node.plugin, PluginKind::Node).map_err(PipelineError::Output)?;
        registry.check_params(&node.plugin, &node.params.clone().into()).map_err(PipelineError::Output)?;
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
        if job.scene.is_some() {
            // before an hour of rendering; the display of what is read is known when that is
            run.check_outputs(task)?;
        }
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
        // a preset is a design, of which report and `info` tell the rate; who has a display of his own has panels
        if let Some(message) = display.flicker_warning().filter(|_| self.job.display.file.is_some()) {
            task.warn("display", message);
        }
        if self.job.scene.is_none() && self.node.is_none() {
            // against the display that has become the light field's
            self.check_outputs(task)?;
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
            Some(node) => {
                let (stack, solved) = self.run_node(node, &display, &input.target, &weights, task)?;
                (stack, solved.map_or((Vec::new(), None), |(steps, solution)| (steps, Some(solution))))
            }
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
        let settings = self.job.to_json();
        let denoising = input.denoised.as_ref().map(Denoised::about);
        let measure = |zone: &References| zone.measure(&self.display, stack, task);
        let zone = input.zone.as_ref().map(measure).transpose()?;
        let report = lumistack_report::build(
            &ReportInput {
                title: &self.job.name,
                display: &self.display,
                stack,
                target: &input.target,
                weights,
                held_out: input.held_out.as_ref(),
                outside: input.outside.as_ref(),
                zone: zone.as_ref(),
                pixels_per_degree: self.job.report.pixels_per_degree,
                convergence: steps,
                solution: solution.as_ref(),
                stages: &self.stages,
                settings: &settings,
                denoising: denoising.as_ref(),
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

    /// A node's job stands with that of the whole run.
    pub(crate) fn write_settings(&self, display: &Display) -> Result<(), PipelineError> {
        if self.node.is_none() {
            write_job(&self.job, &self.dir)?;
        }
        write_display(&self.dir.join("display.toml"), display)
    }
}

/// Keeps warnings for the report and passes them on.
pub(crate) struct Tee<'a> {
    pub(crate) list: Collector,
    next: &'a dyn Warnings,
}

impl<'a> Tee<'a> {
    pub(crate) fn new(next: &'a dyn Warnings) -> Self {
        Self { list: Collector::default(), next }
    }
}

impl Warnings for Tee<'_> {
    fn warn(&self, warning: Warning) {
        self.list.warn(warning.clone());
        self.next.warn(warning);
    }
}
