//! Executes plans: one step after another, each with what the steps before it left in memory.
//!
//! A result is dropped after the last step that takes it. A step whose inputs are in no memory executes them first; their results are current in the run folder, so
//! they are read back. So any step can be executed alone, in another process.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use lumistack_core::metrics::SquaredError;
use lumistack_core::{Collector, Progress, Task, Warning, Warnings};
use lumistack_display::{Display, FieldGeometry, Weights};
use lumistack_plugin_host::{OutputData, PluginKind, Registry};
use lumistack_report::{
    DepthBudget, GraphInput, GraphNode, Output, Report, SequenceInput, SequenceReport, SequenceSeries, SequenceTime,
    Stage, Thumbnail,
};
use serde_json::json;

use super::estimate::{self, Record};
use super::graph::{job_of, outputs_on};
use super::steps::{Kind, Plan, Step, What};
use super::times::{Begun, name};
use crate::error::{FailedOutput, PipelineError, display_error};
use crate::job::{FactorizeJob, Job, NodeJob, OutputJob};
use crate::stage::expose;
use crate::stage::factorize::{self, Solve, Solved};
use crate::stage::field::{self, Field, check_geometry};
use crate::stage::fields::Shot;
use crate::stage::flicker::{Shown, TimeError};
use crate::stage::ingest::{self, Ingested};
use crate::stage::look::Look;
use crate::stage::node::Given;
use crate::stage::place::{self, Placement};
use crate::stage::report::{self, About, thumbnails};
use crate::stage::score::{self, References};
use crate::stage::trace::{self, Traced};
use crate::stage::{denoise, measure, node, output, read, source};
use crate::store::code;
use crate::store::files::{check_folder, remove_reports};
use crate::store::folder;
use crate::store::key::KeyBuilder;
use crate::store::lock::{Owned, take_known};
use crate::store::names::Work;
use crate::store::settings::{write_display, write_job};
use crate::store::stamps::Stamps;
use crate::store::used;
use crate::view_options::ViewOptions;

/// Patterns of a display, and what they were made for.
pub(crate) struct Patterns {
    pub(crate) display: Display,
    pub(crate) weights: Weights,
    pub(crate) solved: Solved,
    cached: bool,
}

/// Figures of a display, and pictures for the report of all.
pub(crate) struct Reported {
    pub(crate) report: Report,
    shown: Option<[Thumbnail; 2]>,
}

/// Results of a part's steps in memory.
#[derive(Default)]
pub(crate) struct State {
    job: Option<Arc<Job>>,
    owned: Option<Owned>,
    ingested: Option<Arc<Ingested>>,
    placement: Option<Placement>,
    traced: Option<Arc<Traced>>,
    pub(crate) field: Option<Arc<Field>>,
    /// Of the field, once it is dropped.
    look: Option<Look>,
    geometry: Option<FieldGeometry>,
    pub(crate) references: Option<Arc<References>>,
    pub(crate) patterns: Option<Arc<Patterns>>,
    brightness: f64,
    outputs: Vec<Output>,
    measured: Option<(TimeError, String)>,
    pub(crate) reported: Option<Reported>,
    pub(crate) entry: Option<SequenceTime>,
    stages: Vec<Stage>,
    /// Folders of cached views.
    views: Vec<PathBuf>,
}

/// The last steps that concern a part.
#[derive(Clone, Copy, Default)]
struct Ends {
    /// In its folder or below.
    works: usize,
    /// That take what it holds in memory.
    takes: usize,
}

impl Ends {
    fn of(plan: &Plan, ids: &HashMap<&str, usize>) -> Vec<Self> {
        let mut ends = vec![Self::default(); plan.parts.len()];
        for (index, step) in plan.steps.iter().enumerate() {
            for part in plan.around(step.part) {
                ends[part] = Self { works: index, takes: index };
            }
            // exposure and geometry of the first time are noted, and so are the figures of every time
            let is_whole = matches!(plan.parts[step.part].kind, Kind::Sequence(_)) && step.what == What::Report;
            if is_whole || matches!(step.what, What::Ingest | What::Place | What::Trace | What::Read | What::Source) {
                continue;
            }
            for input in step.inputs.iter().filter_map(|id| ids.get(id.as_str())) {
                plan.around(plan.steps[*input].part).for_each(|part| ends[part].takes = index);
            }
        }
        ends
    }
}

/// Executes the steps of a plan.
pub(crate) struct Executor<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) registry: &'a Registry,
    command: Option<&'a str>,
    pub(crate) task: Task<'a>,
    pub(crate) states: Vec<State>,
    /// Numbers of steps by their ids.
    ids: HashMap<&'a str, usize>,
    ends: Vec<Ends>,
    done: Vec<bool>,
    warned: Vec<(usize, Warning)>,
    pub(crate) failed: Vec<FailedOutput>,
    pub(crate) sequence: Option<SequenceReport>,
    /// How the scene's depth fits the job's own display.
    pub(crate) depth: Option<DepthBudget>,
    records: BTreeMap<String, Record>,
}

impl<'a> Executor<'a> {
    pub(crate) fn new(plan: &'a Plan, registry: &'a Registry, command: Option<&'a str>, task: Task<'a>) -> Self {
        let ids = plan.indices();
        Self {
            ends: Ends::of(plan, &ids),
            ids,
            plan,
            registry,
            command,
            task,
            states: plan.parts.iter().map(|_| State::default()).collect(),
            done: vec![false; plan.steps.len()],
            warned: Vec::new(),
            failed: Vec::new(),
            sequence: None,
            depth: None,
            records: BTreeMap::new(),
        }
    }

    /// Executes all steps. The caller holds the run folder.
    ///
    /// # Errors
    /// When a step fails or is cancelled; finished steps are kept and taken up by the next run.
    pub(crate) fn execute(&mut self) -> Result<(), PipelineError> {
        self.check()?;
        let is_design = |step: &Step| matches!(self.plan.parts[step.part].kind, Kind::Sweep);
        // the designs of a sweep are solved side by side by its own
        let steps = (0..self.plan.steps.len()).filter(|index| !is_design(&self.plan.steps[*index]));
        let result = steps.collect::<Vec<_>>().into_iter().try_for_each(|index| {
            self.run(index)?;
            self.release(index)
        });
        // a run that failed before it kept anything leaves nothing
        let keeps = |step: &Step| !matches!(step.what, What::Ingest | What::Place | What::Read);
        if !self.plan.steps.iter().zip(&self.done).any(|(step, done)| *done && keeps(step)) {
            return result;
        }
        // the next plan knows the steps that were finished, and their times
        let noted = estimate::note(self.plan, self.registry, std::mem::take(&mut self.records));
        result.and(noted)
    }

    /// Executes one step; the results of those before it are read back from the run folder, or made where they are not there.
    ///
    /// # Errors
    /// As [`execute`](Self::execute), and when there is no such step.
    pub(crate) fn execute_alone(&mut self, id: &str) -> Result<(), PipelineError> {
        self.check()?;
        let Some(&index) = self.ids.get(id) else {
            return Err(PipelineError::value("plan", "step", "the id of a step", format!("`{id}`")));
        };
        self.run(index)?;
        estimate::note(self.plan, self.registry, std::mem::take(&mut self.records))
    }

    fn run(&mut self, index: usize) -> Result<(), PipelineError> {
        if self.done[index] {
            return Ok(());
        }
        let plan = self.plan;
        let step = &plan.steps[index];
        for input in &step.inputs {
            // in a plan that is executed as a whole they are done
            let known = self.ids.get(input.as_str()).copied();
            let input = known.ok_or_else(|| PipelineError::value("plan", "inputs", "ids of steps", input))?;
            self.run(input)?;
        }
        self.task.cancel.check()?;
        self.enter(step.part)?;
        let warnings = Tee::new(self.task.warnings);
        let time = plan.time(step.part);
        let place = time.and_then(|(time, sequence)| match &plan.parts[sequence].kind {
            Kind::Sequence(times) => Some(format!("{}/{}", time + 1, times.count())),
            _ => None,
        });
        let progress = PlaceProgress { next: self.task.progress, place };
        let task = Task { progress: &progress, warnings: &warnings, cancel: self.task.cancel };
        let start = Instant::now();
        let cached = self.work(step, task);
        self.warned.extend(warnings.list.take().into_iter().map(|warning| (step.part, warning)));
        let (cached, seconds) = (cached?, start.elapsed().as_secs_f64());
        let info = plan.stage_of(step.part, step.what);
        if let Some(told) = info.told {
            let told = match step.what {
                What::FieldOutput(i) | What::StackOutput(i) => {
                    output::stage_name(&plan.parts[step.part].job.outputs[i])
                }
                What::Patterns => plan
                    .node(step.part)
                    .filter(|_| info.name == "node")
                    .map_or(told, |node| node.plugin.as_str())
                    .into(),
                What::Source => {
                    plan.parts[step.part].job.source.as_ref().map_or(told, |source| source.plugin.as_str()).into()
                }
                _ => told.to_owned(),
            };
            let stages = &mut self.states[step.part].stages;
            match stages.last_mut().filter(|last| last.name == told) {
                // tracing, filtering and exposing are one to people
                Some(last) => (last.seconds, last.cached) = (last.seconds + seconds, last.cached && cached),
                None => stages.push(Stage { name: told, seconds, cached }),
            }
        }
        let files = self.states[step.part].ingested.as_ref().filter(|_| step.what == What::Ingest);
        let files = files.map_or(Vec::new(), |ingested| ingested.files.clone());
        self.records.insert(step.id.clone(), Record::new(seconds, cached, files));
        self.done[index] = true;
        Ok(())
    }

    /// Folder of a part.
    fn dir(&self, part: usize) -> PathBuf {
        self.plan.folder.join(&self.plan.parts[part].folder)
    }

    pub(crate) fn stamps(&self, part: usize) -> Stamps {
        Stamps::new(&self.dir(part))
    }

    /// Where a part keeps what it placed and handed over: a sequence in the folder of its first time.
    fn cache(&self, part: usize) -> PathBuf {
        match self.plan.parts[part].kind {
            Kind::Sequence(_) => self.dir(part).join(name(0)).join("cache"),
            _ => self.dir(part).join("cache"),
        }
    }

    /// The job of a part, with what has become known of it.
    pub(crate) fn job(&mut self, part: usize) -> Arc<Job> {
        if let Some(job) = &self.states[part].job {
            return job.clone();
        }
        let plan = self.plan;
        let of_part = &plan.parts[part];
        let job = match (&of_part.kind, of_part.parent) {
            (Kind::Time(time), Some(sequence)) => match &plan.parts[sequence].kind {
                Kind::Sequence(times) => {
                    let before = time.checked_sub(1).map(|before| self.dir(sequence).join(name(before)));
                    let state = &self.states[sequence];
                    let look = plan.at_time(part, 0).and_then(|first| self.states[first].look);
                    let begun = state.placement.zip(state.ingested.as_ref());
                    let begun = begun.map(|(placement, ingested)| Begun { placement, studio: ingested.studio, look });
                    times.job(&plan.parts[sequence].job, *time, before.as_deref(), begun)
                }
                _ => of_part.job.clone(),
            },
            (Kind::Node(_), Some(parent)) => {
                let around = self.job(parent);
                plan.node(part)
                    .and_then(|node| around.nodes.iter().find(|other| other.id == node.id))
                    .map_or_else(|| of_part.job.clone(), |node| job_of(&around, node))
            }
            _ => of_part.job.clone(),
        };
        let job = Arc::new(job);
        self.states[part].job = Some(job.clone());
        job
    }

    /// Checks what can be checked without any work: found out before an hour of rendering, not after.
    fn check(&mut self) -> Result<(), PipelineError> {
        let plan = self.plan;
        for (number, part) in plan.parts.iter().enumerate() {
            let job = &part.job;
            match (&part.kind, part.parent) {
                (Kind::Time(_), _) => continue,
                (Kind::Node(_), Some(parent)) if matches!(plan.parts[parent].kind, Kind::Time(time) if time > 0) => {
                    continue;
                }
                (Kind::Sweep, _) => continue,
                (Kind::Node(_), _) => {}
                _ => job.check()?,
            }
            let display = job.resolve_display()?;
            factorize::check(&job.factorize)?;
            if let Some(source) = &job.source {
                self.registry.get_kind(&source.plugin, PluginKind::Source).map_err(PipelineError::Output)?;
                let params = source.params.clone().into();
                self.registry.check_params(&source.plugin, &params).map_err(PipelineError::Output)?;
            }
            output::check(job, self.registry)?;
            check_folder(&self.dir(number))?;
            for node in &job.nodes {
                node::check(node, self.registry)?;
            }
            if job.scene.is_some() && !matches!(part.kind, Kind::Node(_)) {
                self.open_outputs(
                    job,
                    &display,
                    &display.geometry().map_err(|source| display_error(source, "field"))?,
                )?;
            }
        }
        Ok(())
    }

    /// Opens a job's outputs, those of its nodes among them, against their displays on a light field of this geometry.
    fn open_outputs(&self, job: &Job, display: &Display, geometry: &FieldGeometry) -> Result<(), PipelineError> {
        let outputs = outputs_on(job, display, geometry)?;
        outputs.iter().try_for_each(|(output, display)| output::open(output, display, self.registry, self.task))
    }

    /// Takes the folder of a part, which somebody may run alone.
    fn enter(&mut self, part: usize) -> Result<(), PipelineError> {
        let of_part = &self.plan.parts[part];
        let Some(parent) = of_part.parent else { return Ok(()) };
        self.enter(parent)?;
        if self.states[part].owned.is_some() {
            return Ok(());
        }
        let in_sweep = matches!(self.plan.parts[0].kind, Kind::Sweep);
        let owned = match of_part.kind {
            Kind::Time(_) if !in_sweep => {
                let job = self.job(part);
                folder::take(&self.dir(part), Work::Run, &job, self.registry, self.task)?
            }
            _ => take_known(&self.dir(part), self.task)?,
        };
        self.states[part].owned = Some(owned);
        Ok(())
    }

    /// Drops what no step takes any more, and tidies folders in which the last step has worked.
    fn release(&mut self, index: usize) -> Result<(), PipelineError> {
        for part in 0..self.states.len() {
            let Ends { works, takes } = self.ends[part];
            if works == index {
                let views = std::mem::take(&mut self.states[part].views);
                if self.states[part].field.is_some() {
                    used::keep_only_views(&self.dir(part), &views)?;
                }
                self.states[part].owned = None;
            }
            if takes == index {
                let state = &mut self.states[part];
                (state.field, state.patterns, state.references, state.traced) = (None, None, None, None);
            }
        }
        Ok(())
    }

    /// A result of a part, which a step before has left.
    fn of<T>(&self, part: usize, what: &str, take: impl Fn(&State) -> Option<T>) -> Result<T, PipelineError> {
        let place = &self.plan.parts[part].folder;
        take(&self.states[part])
            .ok_or_else(|| PipelineError::value(place, "plan", format!("{what} from a step before"), "none"))
    }

    /// Does a step's work; says whether its result was there already.
    fn work(&mut self, step: &Step, task: Task<'_>) -> Result<bool, PipelineError> {
        let (plan, part) = (self.plan, step.part);
        match step.what {
            What::Ingest => {
                let job = self.job(part);
                let pose = match &plan.parts[part].kind {
                    Kind::Sequence(times) => times.first_pose(&job),
                    _ => job.pose.clone(),
                };
                let scene = job.scene.as_ref().ok_or_else(|| PipelineError::job("scene", "a scene", "none"))?;
                let cache = self.cache(part);
                let loaded =
                    ingest::load_scene(scene, &pose, &job.importer, self.registry, &job.light, Some(&cache), task)?;
                self.states[part].ingested = Some(Arc::new(loaded));
                Ok(false)
            }
            What::Place => {
                let job = self.job(part);
                let ingested = self.ingested(part)?;
                let display = job.resolve_display()?;
                let geometry = display.geometry().map_err(|source| display_error(source, "field"))?;
                let cache = self.cache(part);
                let placement = place::place(&ingested, &job.window, &display, &geometry, Some(&cache), task)?;
                self.states[part].placement = Some(placement);
                Ok(false)
            }
            What::Trace => {
                let of = self.shot(part)?;
                let views = self.dir(part).join("cache/views");
                let (traced, cached) = trace::run(of.shot(), &ViewOptions::default(), &views, task)?;
                self.states[part].traced = Some(Arc::new(traced));
                Ok(cached)
            }
            What::Denoise => {
                let (of, traced) = (self.shot(part)?, self.of(part, "views", |state| state.traced.clone())?);
                denoise::run(of.shot(), &traced.fields, task)
            }
            What::Expose => {
                let (of, traced) = (self.shot(part)?, self.of(part, "views", |state| state.traced.clone())?);
                let exposed = expose::run(of.shot(), &traced, false, task)?;
                let path = of.job.scene.clone().unwrap_or_default();
                let stamps = self.stamps(part);
                let field = Field::of_scene(&path, of.shot(), &traced, exposed, &of.display, &stamps, task)?;
                self.take_field(part, field)?;
                Ok(true)
            }
            What::Score => {
                let (of, traced) = (self.shot(part)?, self.of(part, "views", |state| state.traced.clone())?);
                let look = self.of(part, "an exposure", |state| state.look)?;
                let zone = score::zone_of(&of.job, &of.display, &of.geometry);
                let views = self.dir(part).join("cache/views");
                let made = References::render(of.shot(), &zone, (look, traced.engine), &views, task)?;
                let cached = made.as_ref().is_none_or(|references| references.cached);
                let state = &mut self.states[part];
                state.views.extend(made.as_ref().and_then(|references| references.folder()).map(Path::to_owned));
                state.references = made.map(Arc::new);
                Ok(cached)
            }
            What::Read => {
                let job = self.job(part);
                let path = job.light_field.clone().unwrap_or_default();
                let display = job.resolve_display()?;
                let (target, left_out) = read::run(&path, &job, &display, task)?;
                self.check_geometry(part, &path, target.geometry())?;
                self.states[part].references = References::left_out(target.geometry(), left_out).map(Arc::new);
                let about = json!({ "light field": path.display().to_string() });
                let field = Field::of_given(target, &path, about, &display, &self.stamps(part), task)?;
                self.open_outputs(&job, &field.display, field.target.geometry())?;
                self.take_field(part, field)?;
                Ok(false)
            }
            What::Source => {
                let job = self.job(part);
                let source = job.source.clone();
                let source = source.ok_or_else(|| PipelineError::job("scene", Job::INPUTS, "none"))?;
                let (display, stamps, path) =
                    (job.resolve_display()?, self.stamps(part), PathBuf::from(&source.plugin));
                let (target, kept, cached) = source::run(&source, &display, &stamps, self.registry, task)?;
                self.check_geometry(part, &path, target.geometry())?;
                let about = json!({ "source": source.plugin, "time (s)": source.time_s });
                let field = Field::of_given(target, &path, about, &display, &stamps, task)?;
                kept.write(&stamps)?;
                self.open_outputs(&job, &field.display, field.target.geometry())?;
                self.take_field(part, field)?;
                Ok(cached)
            }
            What::Patterns => self.patterns(part, task),
            What::FieldOutput(number) => {
                let field = self.field(part)?;
                let relative = format!("outputs/{}", OutputJob::LIGHT_FIELD);
                self.output(part, number, &relative, &field.display, OutputData::LightField(&field.target), task)
            }
            What::StackOutput(number) => {
                let field = self.field(part)?;
                let patterns = self.of(part, "patterns", |state| state.patterns.clone())?;
                let relative = match plan.node(part) {
                    Some(node) => format!("../../outputs/{}", node.id),
                    None => format!("outputs/{}", NodeJob::TENSOR_DISPLAY),
                };
                let data = OutputData::LayerStack(&patterns.solved.stack, Some(&field.target));
                self.output(part, number, &relative, &patterns.display, data, task)
            }
            What::Measure => self.measure(part, task),
            What::Report => match &plan.parts[part].kind {
                Kind::Sequence(_) => self.report_sequence(part),
                Kind::Run | Kind::Time(_) if !plan.parts[part].job.nodes.is_empty() => self.report_graph(part),
                _ => self.report(part, task),
            },
            What::Design(_) | What::Search => Ok(false),
        }
    }

    /// The scene of a part: its own, or that which all times share.
    fn ingested(&self, part: usize) -> Result<Arc<Ingested>, PipelineError> {
        let shared = |state: &State| state.ingested.clone();
        let above = self.plan.time(part).map(|(_, sequence)| sequence);
        let own = shared(&self.states[part]).or_else(|| above.and_then(|above| shared(&self.states[above])));
        own.ok_or_else(|| PipelineError::job("scene", "a scene", "none"))
    }

    fn shot(&mut self, part: usize) -> Result<OwnShot, PipelineError> {
        let (job, ingested) = (self.job(part), self.ingested(part)?);
        let placement = self.of(part, "a window", |state| state.placement)?;
        let display = job.resolve_display()?;
        let geometry = display.geometry().map_err(|source| display_error(source, "field"))?;
        Ok(OwnShot { job, ingested, placement, display, geometry })
    }

    fn field(&self, part: usize) -> Result<Arc<Field>, PipelineError> {
        self.of(self.plan.field_part(part), "a light field", |state| state.field.clone())
    }

    fn check_geometry(&self, part: usize, path: &Path, found: &FieldGeometry) -> Result<(), PipelineError> {
        let Some((time, _)) = self.plan.time(part).filter(|(time, _)| *time > 0) else { return Ok(()) };
        // all have the first one's, so the time before has it, too
        let first = self.plan.at_time(part, 0).and_then(|first| self.states[first].geometry.as_ref());
        first.map_or(Ok(()), |expected| check_geometry(path, found, expected, &self.source_of(part, time - 1)))
    }

    fn source_of(&self, part: usize, time: usize) -> String {
        let Some((_, sequence)) = self.plan.time(part) else { return String::new() };
        match &self.plan.parts[sequence].kind {
            Kind::Sequence(times) => times.source(&self.plan.parts[sequence].job, time),
            _ => String::new(),
        }
    }

    /// Keeps a light field; one that several nodes share writes its settings and takes the older report away.
    fn take_field(&mut self, part: usize, field: Field) -> Result<(), PipelineError> {
        let job = self.job(part);
        if !job.nodes.is_empty() && !matches!(self.plan.parts[0].kind, Kind::Sweep) {
            let dir = self.dir(part);
            write_job(&job, &dir)?;
            write_display(&dir.join("display.toml"), &field.display)?;
        }
        if self.plan.parts[part].parent.is_none() {
            self.depth.clone_from(&field.depth);
        }
        let state = &mut self.states[part];
        (state.look, state.geometry) = (field.look, Some(field.target.geometry().clone()));
        state.views.clone_from(&field.views);
        state.field = Some(Arc::new(field));
        Ok(())
    }

    fn patterns(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (plan, mut job, field, stamps) = (self.plan, self.job(part), self.field(part)?, self.stamps(part));
        let of_node = plan.node(part);
        let display = match of_node {
            None => field.display.clone(),
            Some(of_node) => {
                let own = job.resolve_display()?;
                let (display, change) = node::display(of_node, &own, &field.display, field.target.geometry())?;
                if let Some(change) = change {
                    task.warn(format!("node {}", of_node.id), change);
                }
                display
            }
        };
        // a preset is a design, of which report and `info` tell the rate; who has a display of his own has panels
        if let Some(message) = display.flicker_warning().filter(|_| job.display.file.is_some()) {
            task.warn("display", message);
        }
        let weights = field::weights(&job.factorize, &field.target)?;
        let target = &field.target;
        let (solved, cached) = match of_node.filter(|of_node| !node::is_factorized(Some(of_node))) {
            Some(node) => {
                let given = Given { node, seed: job.seed, display: &display, target, weights: &weights };
                node::run(given, &stamps, self.registry, task)?
            }
            None => {
                let solve = Solve { job: &job.factorize, seed: job.seed, display: &display, target, weights: &weights };
                let afresh = match self.fresh(part) {
                    Some(fresh) if factorize::prefers_fresh(solve, &fresh, &stamps, task)? => Some(fresh),
                    _ => None,
                };
                if let Some(fresh) = afresh {
                    job = self.begins_afresh(part, fresh)?;
                }
                let solve = Solve { job: &job.factorize, seed: job.seed, display: &display, target, weights: &weights };
                factorize::run(solve, &stamps, task)?
            }
        };
        // only now: a run that was stopped before has left the older settings, patterns and report together
        let dir = self.dir(part);
        if of_node.is_none() {
            write_job(&job, &dir)?;
        }
        write_display(&dir.join("display.toml"), &display)?;
        let mut above = (!cached).then_some(part);
        while let Some(part) = above {
            // of older patterns
            remove_reports(&self.dir(part))?;
            above = plan.parts[part].parent;
        }
        self.states[part].brightness = solved.stack.brightness;
        self.states[part].patterns = Some(Arc::new(Patterns { display, weights, solved, cached }));
        Ok(cached)
    }

    /// How a time is factorized for which the patterns of the time before are no start.
    fn fresh(&self, part: usize) -> Option<FactorizeJob> {
        let (time, sequence) = self.plan.time(part)?;
        match &self.plan.parts[sequence].kind {
            Kind::Sequence(times) if time > 0 => {
                let job = &self.plan.parts[sequence].job;
                let node = self.plan.node(part).and_then(|node| job.nodes.iter().find(|other| other.id == node.id));
                Some(times.fresh(job, node))
            }
            _ => None,
        }
    }

    /// Notes in the jobs of a part, and of the graph around it, that it takes no warm start.
    fn begins_afresh(&mut self, part: usize, fresh: FactorizeJob) -> Result<Arc<Job>, PipelineError> {
        let of_field = self.plan.field_part(part);
        if let Some(id) = self.plan.node(part).map(|node| node.id.clone()) {
            let mut around = Job::clone(&*self.job(of_field));
            around.nodes.iter_mut().filter(|node| node.id == id).for_each(|node| node.factorize = Some(fresh.clone()));
            write_job(&around, &self.dir(of_field))?;
            self.states[of_field].job = Some(Arc::new(around));
        }
        let job = Arc::new(Job { factorize: fresh, ..Job::clone(&*self.job(part)) });
        self.states[part].job = Some(job.clone());
        Ok(job)
    }

    fn output(
        &mut self,
        part: usize,
        number: usize,
        folder: &str,
        display: &Display,
        data: OutputData<'_>,
        task: Task<'_>,
    ) -> Result<bool, PipelineError> {
        let job = self.job(part);
        let output = &job.outputs[number];
        let relative = format!("{folder}/{}", output.name());
        let (written, cached) = output::run(output, &relative, display, data, &self.stamps(part), self.registry, task)?;
        let prefix = &self.plan.parts[self.plan.field_part(part)].folder;
        self.failed.extend(output::failed(std::slice::from_ref(&written), prefix));
        self.states[part].outputs.push(written);
        Ok(cached)
    }

    fn measure(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let plan = self.plan;
        let (field, patterns) = (self.field(part)?, self.of(part, "patterns", |state| state.patterns.clone())?);
        let Some((time, sequence)) = plan.time(part) else { return Ok(true) };
        let before = time.checked_sub(1).and_then(|time| plan.at_time(part, time));
        let before = match before {
            None => None,
            Some(before) => {
                let patterns = self.of(before, "patterns", |state| state.patterns.clone())?;
                Some((self.field(before)?, patterns))
            }
        };
        let now = Shown { stack: &patterns.solved.stack, target: &field.target };
        let then = before.as_ref().map(|(field, before)| Shown { stack: &before.solved.stack, target: &field.target });
        let stamps = self.stamps(part);
        let (found, key, cached) = measure::run(&patterns.display, &patterns.weights, now, then, &stamps, task)?;
        let reports = matches!(&plan.parts[sequence].kind, Kind::Sequence(times) if times.sequence.reports);
        let compared = |error: SquaredError| (error.count > 0).then_some(error);
        let (steps, solution) = (&patterns.solved.steps, &patterns.solved.solution);
        let [wanted, shown] = thumbnails(&patterns.display, &field, &patterns.solved);
        let place = plan.parts[part].folder.strip_prefix(&plan.parts[sequence].folder);
        let place = place.unwrap_or(Path::new("")).to_string_lossy().into_owned();
        let entry = SequenceTime {
            name: name(time),
            source: self.source_of(part, time),
            report: reports.then(|| format!("{place}/report.html")),
            error: found.error,
            change: compared(found.change),
            still: compared(found.still),
            start: solution.as_ref().map_or_else(String::new, |solution| solution.start.clone()),
            psnr_start: steps.first().map_or(f64::NAN, |step| step.psnr_view),
            iterations: steps.last().map_or(0, |step| step.iteration),
            seconds: steps.last().map_or(f64::NAN, |step| step.seconds),
            cached: patterns.cached,
            wanted,
            shown,
        };
        let state = &mut self.states[part];
        (state.entry, state.measured) = (Some(entry), Some((found, key)));
        Ok(cached)
    }

    /// Warnings of a part and of those whose results it takes, in the order in which they came.
    fn warnings(&self, concerns: impl Fn(usize) -> bool) -> Vec<Warning> {
        self.warned.iter().filter(|(part, _)| concerns(*part)).map(|(_, warning)| warning.clone()).collect()
    }

    fn report(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (plan, job, stamps) = (self.plan, self.job(part), self.stamps(part));
        let (field, of_field) = (self.field(part)?, plan.field_part(part));
        let patterns = self.of(part, "patterns", |state| state.patterns.clone())?;
        let is_time = matches!(plan.parts[part].kind, Kind::Time(_));
        let mut key = None;
        if let Some((_, measured)) = self.states[part].measured.as_ref().filter(|_| is_time) {
            let mut of_report = KeyBuilder::new("report", code::REPORTS);
            of_report.add("measure", measured.as_bytes()).add_json("job", &*job);
            let failed = output::failed(&self.states[part].outputs, Path::new(""));
            key = Some(of_report.add_json("failed outputs", &failed).finish());
        }
        if key.as_ref().is_some_and(|key| stamps.is_current("report", key)) {
            return Ok(true);
        }
        let warnings = self.warnings(|other| other == part || other == of_field);
        let mut stages = self.states[of_field].stages.clone();
        if of_field != part {
            stages.extend_from_slice(&self.states[part].stages);
        }
        let references = self.states[of_field].references.clone();
        let about = About {
            job: &job,
            display: &patterns.display,
            field: &field,
            references: references.as_deref(),
            weights: &patterns.weights,
            solved: &patterns.solved,
            outputs: &self.states[part].outputs,
            stages: &stages,
            warnings: &warnings,
            command: self.command,
        };
        if key.is_some() {
            stamps.clear("report")?;
        }
        let report = report::run(&about, &stamps, task)?;
        if let Some(key) = key {
            stamps.write("report", &key, &["report.html".into(), "report.json".into()])?;
        }
        let shown = (of_field != part).then(|| thumbnails(&patterns.display, &field, &patterns.solved));
        self.states[part].reported = Some(Reported { report, shown });
        Ok(false)
    }

    fn report_graph(&mut self, part: usize) -> Result<bool, PipelineError> {
        let (plan, job) = (self.plan, self.job(part));
        let (mut nodes, mut wanted) = (Vec::new(), None);
        for inner in plan.within(part) {
            let (Some(node), Some(patterns)) = (plan.node(inner), &self.states[inner].patterns) else { continue };
            let state = &self.states[inner];
            let Some(Reported { report, shown: Some([target, shown]) }) = &state.reported else { continue };
            wanted.get_or_insert_with(|| target.clone());
            let from_root =
                |output: &Output| Output { path: output.path.trim_start_matches("../").into(), ..output.clone() };
            nodes.push(GraphNode {
                id: node.id.clone(),
                plugin: node.plugin.clone(),
                display: patterns.display.name.clone(),
                report: format!("nodes/{}/report.html", node.id),
                psnr_view: report.psnr_view,
                psnr_raw: report.psnr_raw,
                held_out_psnr_view: report.held_out_psnr_view,
                psnr_zone: report.psnr_zone,
                brightness: patterns.solved.stack.brightness,
                layers: patterns.solved.stack.layers.len(),
                frames: patterns.solved.stack.frames(),
                seconds: state.stages.iter().map(|stage| stage.seconds).sum(),
                outputs: state.outputs.iter().map(from_root).collect(),
                shown: shown.clone(),
            });
        }
        let Some(wanted) = wanted else {
            return Err(PipelineError::job("nodes", "at least one node", "none"));
        };
        let (settings, warnings) = (job.to_json(), self.warnings(|other| plan.is_below(other, part)));
        let input = GraphInput {
            title: &job.name,
            wanted: &wanted,
            nodes: &nodes,
            outputs: &self.states[part].outputs,
            settings: &settings,
            warnings: &warnings,
            command: self.command,
            version: env!("CARGO_PKG_VERSION"),
        };
        report::graph(&input, &self.stamps(part))?;
        Ok(false)
    }

    fn report_sequence(&mut self, part: usize) -> Result<bool, PipelineError> {
        let (plan, job) = (self.plan, self.job(part));
        write_job(&job, &self.dir(part))?;
        // every display over all times: the still's, or each node's
        let ids = job.nodes.iter().map(|node| Some(node.id.clone()));
        let ids: Vec<Option<String>> = if job.nodes.is_empty() { vec![None] } else { ids.collect() };
        let all: Vec<(Option<String>, Vec<SequenceTime>, f64)> = ids
            .into_iter()
            .map(|id| {
                let of_id = |other: &usize| match &id {
                    None => true,
                    Some(id) => plan.node(*other).is_some_and(|node| node.id == *id),
                };
                let own = (0..plan.parts.len()).filter(|other| plan.is_below(*other, part) && of_id(other));
                let states: Vec<&State> = own.map(|other| &self.states[other]).filter(|s| s.entry.is_some()).collect();
                let brightness = states.last().map_or(1.0, |state| state.brightness);
                (id, states.into_iter().filter_map(|state| state.entry.clone()).collect(), brightness)
            })
            .collect();
        let series: Vec<SequenceSeries<'_>> = all
            .iter()
            .map(|(id, times, brightness)| SequenceSeries { id: id.as_deref(), times, brightness: *brightness })
            .collect();
        let (settings, warnings) = (job.to_json(), self.warnings(|other| plan.is_below(other, part)));
        let input = SequenceInput {
            title: &job.name,
            series: &series,
            settings: &settings,
            warnings: &warnings,
            command: self.command,
            version: env!("CARGO_PKG_VERSION"),
        };
        self.sequence = Some(report::sequence(&input, &self.stamps(part))?);
        Ok(false)
    }
}

/// A shot with all that it is made of.
struct OwnShot {
    job: Arc<Job>,
    ingested: Arc<Ingested>,
    placement: Placement,
    display: Display,
    geometry: FieldGeometry,
}

impl OwnShot {
    fn shot(&self) -> Shot<'_> {
        let Self { job, ingested, placement, display, geometry } = self;
        Shot { job, ingested, placement, geometry, footprint: display.angular_footprint() }
    }
}

/// Keeps warnings for the report and passes them on.
struct Tee<'a> {
    list: Collector,
    next: &'a dyn Warnings,
}

impl<'a> Tee<'a> {
    fn new(next: &'a dyn Warnings) -> Self {
        Self { list: Collector::default(), next }
    }
}

impl Warnings for Tee<'_> {
    fn warn(&self, warning: Warning) {
        self.list.warn(warning.clone());
        self.next.warn(warning);
    }
}

/// Says which time a stage belongs to.
struct PlaceProgress<'a> {
    next: &'a dyn Progress,
    place: Option<String>,
}

impl Progress for PlaceProgress<'_> {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        match &self.place {
            Some(place) => self.next.begin(&format!("{stage} {place}"), total, unit),
            None => self.next.begin(stage, total, unit),
        }
    }

    fn advance(&self, steps: u64, note: &str) {
        self.next.advance(steps, note);
    }

    fn end(&self) {
        self.next.end();
    }
}
