//! Runs jobs: makes the plan of a job and executes it in a run folder, which is locked meanwhile.

use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_plugin_host::Registry;
use lumistack_report::DepthBudget;
use serde::Serialize;
use serde_json::Value;

use crate::engine;
use crate::error::{FailedOutput, PipelineError};
use crate::job::Job;
use crate::plan::estimate;
use crate::plan::execute::context::Context;
use crate::plan::execute::{Executor, check};
use crate::plan::graph::add_displays;
use crate::plan::sequence::add_times;
use crate::plan::steps::{PartKind, Plan};
use crate::plan::still::{Before, add_field};
use crate::plan::sweep::{self, Designs, SweepSummary};
use crate::stage::ingest;
use crate::store::farm::forget;
use crate::store::folder;
use crate::store::lock::{Hold, UNIT_LIMIT, lock_for_unit};
use crate::store::names::Work;
use crate::store::plugin_files;

/// Results of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Path of the report.
    #[serde(serialize_with = "lumistack_core::path_text::told")]
    pub report: PathBuf,
    /// Zone score: PSNR of seen pictures over the viewing zone, dB. `None` for a sequence, and
    /// without reference pictures.
    pub psnr_zone: Option<f64>,
    /// PSNR of seen pictures over the worst tenth of the directions, dB. `None` if `psnr_zone` is
    /// `None`, and for a job with nodes.
    pub psnr_zone_worst: Option<f64>,
    /// PSNR of the emitted light field L̃/β against the target L, at the solver's views, dB.
    pub psnr_view: f64,
    /// PSNR of the emitted light field L̃ against the scaled target βL, dB.
    pub psnr_raw: f64,
    /// PSNR of the emitted light L̃/β against the scene's light L at held-out views, dB. `None`
    /// for a sequence, and without held-out views.
    pub psnr_held_out: Option<f64>,
    /// PSNR of the emitted light L̃/β against the scene's light L at views outside the viewing
    /// zone, dB. `None` for a sequence, for a job with nodes, and without such views.
    pub psnr_outside: Option<f64>,
    /// Results of each node, if the job has nodes. The scores above are then those of the first
    /// node, except `psnr_zone_worst` and `psnr_outside`, which are `None`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeSummary>,
    /// The scene's depth compared with the display's depth of field, as in report.json. `None` for
    /// a sequence, and without a scene.
    pub depth: Option<Value>,
    /// A sentence that describes `depth`.
    #[serde(skip)]
    pub depth_sentence: Option<String>,
    /// Sentences about the camera and the lights that the scene's file lacks, from
    /// [`lacking`](crate::lacking).
    #[serde(skip)]
    pub lacking: Vec<String>,
    /// Results of a sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sequence: Option<SequenceSummary>,
    /// Outputs that failed; all others were written.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub failed_outputs: Vec<FailedOutput>,
    /// Time of the whole run, seconds.
    pub seconds: f64,
}

/// Results of one node.
#[derive(Clone, Debug, Serialize)]
pub struct NodeSummary {
    /// Id of the node.
    pub id: String,
    /// PSNR of the emitted light field L̃/β against the target L, dB.
    pub psnr_view: f64,
    /// PSNR of the emitted light field L̃ against the scaled target βL, dB.
    pub psnr_raw: f64,
    /// PSNR of the emitted light L̃/β against the scene's light L at held-out views, dB. `None`
    /// for a sequence, and without held-out views.
    pub psnr_held_out: Option<f64>,
    /// Zone score: PSNR of seen pictures over the viewing zone, dB. `None` for a sequence, and
    /// without reference pictures.
    pub psnr_zone: Option<f64>,
}

/// Results of a sequence. For a job with nodes, the scores are those of the first node.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SequenceSummary {
    /// Number of time steps.
    pub times: usize,
    /// Flicker: PSNR of the change of the emission between time steps, against the change of the
    /// target, dB. Higher values mean less flicker. `None` for a single time step.
    pub psnr_change: Option<f64>,
    /// The same PSNR as `psnr_change`, but only over rays along which the target hardly changes.
    /// `None` if there is no such ray.
    pub psnr_still: Option<f64>,
}

/// Runs a job into `run_dir`.
///
/// A failed output does not end the run. The report and the summary contain its message.
///
/// # Errors
/// If the job is wrong, another run uses the folder, or the run would replace a file of another
/// program. Also if a stage fails or is cancelled. Finished stages are kept, and the next run
/// reuses them.
pub fn run(
    job: &Job,
    run_dir: &Path,
    registry: &Registry,
    command: Option<&str>,
    task: Task<'_>,
) -> Result<Summary, PipelineError> {
    let start = Instant::now();
    let given = &without_sweep(job, registry)?;
    let _owned = folder::lock(run_dir, work_of(given), given, registry, task)?;
    let job = &without_sweep(&settled(job, run_dir, task)?, registry)?;
    forget(run_dir);
    run_in(job, run_dir, registry, command, start, task)
}

/// Runs a job after its units of work: reuses the results of the units and makes all other results.
///
/// # Errors
/// The errors of [`run`] or [`sweep`], and an error if an output failed.
pub(crate) fn run_finished(
    job: &Job,
    run_dir: &Path,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    // A worker that is regarded as lost may still run its unit, so wait until the folder is free.
    drop(lock_for_unit(run_dir, Hold::Alone, UNIT_LIMIT, task)?);
    if job.sweep.is_some() {
        return sweep(job, run_dir, registry, task).map(|_| ());
    }
    let given = &without_sweep(job, registry)?;
    let _owned = folder::lock(run_dir, work_of(given), given, registry, task)?;
    let job = &without_sweep(&settled(job, run_dir, task)?, registry)?;
    let summary = run_in(job, run_dir, registry, None, Instant::now(), task)?;
    match summary.failed_outputs {
        failed if failed.is_empty() => Ok(()),
        failed => Err(PipelineError::Outputs { failed }),
    }
}

/// Runs a job in a folder that the caller has locked.
fn run_in(
    job: &Job,
    run_dir: &Path,
    registry: &Registry,
    command: Option<&str>,
    start: Instant,
    task: Task<'_>,
) -> Result<Summary, PipelineError> {
    let plan = of_run(job, run_dir)?;
    let mut executor = Executor::new(&plan, registry, command, task);
    executor.execute()?;
    Ok(Summary { seconds: start.elapsed().as_secs_f64(), ..summary(&mut executor.context, job) })
}

/// Executes one step of a job's plan in its run folder. Results of earlier steps are read from the
/// folder; other processes may have made them.
///
/// # Errors
/// The errors of [`run`], and an error if the plan has no such step.
pub fn run_step(
    job: &Job,
    run_dir: &Path,
    step: &str,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let given = &without_sweep(job, registry)?;
    let _owned = folder::lock(run_dir, work_of(given), given, registry, task)?;
    let job = &without_sweep(&settled(job, run_dir, task)?, registry)?;
    Executor::new(&of_run(job, run_dir)?, registry, None, task).execute_alone(step)
}

/// Solves the designs of a job with `[sweep]` into `dir`: all designs, or the designs that a search
/// selects. The resulting table has a row per design, with its scores over all time steps and the
/// scores of every node.
///
/// # Errors
/// If a design is wrong, or a stage fails or is cancelled. Finished designs are kept, and the next
/// run reuses them.
pub fn sweep(job: &Job, dir: &Path, registry: &Registry, task: Task<'_>) -> Result<SweepSummary, PipelineError> {
    let Some(table) = &job.sweep else {
        return Err(PipelineError::job("sweep", "a table `[sweep]`, or an option such as --layers 1..5", "none"));
    };
    table.check()?;
    let given = &plugin_files::resolved(job, registry)?;
    let _owned = folder::lock(dir, Work::Sweep, given, registry, task)?;
    let job = &plugin_files::resolved(&engine::settled(job, None, task)?, registry)?;
    let (plan, designs) = of_sweep(job, dir)?;
    sweep::execute(&plan, &designs, job, registry, task)
}

/// Returns the plan of a job in a run folder, with keys, cached results, and estimates of time and
/// memory. Writes nothing.
///
/// # Errors
/// If the job or a design of its sweep is wrong.
pub fn plan(job: &Job, run_dir: &Path, registry: &Registry) -> Result<Plan, PipelineError> {
    let assumes_blender = engine::is_open(job, &cache_of(run_dir));
    let job = &plugin_files::resolved(&engine::settled_by_cache(job, &cache_of(run_dir)), registry)?;
    // the run's own check, so that a plan and its run refuse the same plugins
    check::plugins(job, registry)?;
    let mut plan = if job.sweep.is_some() { of_sweep(job, run_dir)?.0 } else { of_run(job, run_dir)? };
    // Report the errors that a run would report before its first step.
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let quiet = Task::quiet(&warnings, &cancel);
    Executor::new(&plan, registry, None, quiet).check()?;
    ingest::check_scene(job, registry, quiet)?;
    estimate::fill(&mut plan, registry);
    plan.assumes_blender = assumes_blender;
    Ok(plan)
}

/// Returns the job with the engine that [`engine::settled`] chooses. Only for a still, the folder
/// `cache` of the run keeps the conversion of a `.blend` file.
fn settled(job: &Job, run_dir: &Path, task: Task<'_>) -> Result<Job, PipelineError> {
    let cache = cache_of(run_dir);
    engine::settled(job, (work_of(job) == Work::Run).then_some(&cache), task)
}

/// Returns the cache folder of a still's run.
fn cache_of(run_dir: &Path) -> PathBuf {
    run_dir.join("cache")
}

fn without_sweep(job: &Job, registry: &Registry) -> Result<Job, PipelineError> {
    if job.sweep.is_some() {
        let expected = "a job without `[sweep]`; the command `lumistack sweep` compares the designs of a sweep";
        return Err(PipelineError::job("sweep", expected, "`[sweep]`"));
    }
    plugin_files::resolved(job, registry)
}

/// Returns the kind of work that a job requires.
pub(crate) fn work_of(job: &Job) -> Work {
    match (&job.sweep, &job.sequence) {
        (Some(_), _) => Work::Sweep,
        (None, Some(_)) => Work::Sequence,
        (None, None) => Work::Run,
    }
}

pub(crate) fn of_run(job: &Job, run_dir: &Path) -> Result<Plan, PipelineError> {
    job.check()?;
    let mut plan = Plan::new(job, run_dir);
    let root = plan.add_part(PathBuf::new(), PartKind::Run, job.clone(), None);
    if job.sequence.is_some() {
        add_times(&mut plan, root, false)?;
    } else {
        let field = add_field(&mut plan, root, Before::default());
        add_displays(&mut plan, root, &field, |_| None, true);
    }
    Ok(plan)
}

pub(crate) fn of_sweep(job: &Job, dir: &Path) -> Result<(Plan, Designs), PipelineError> {
    let mut plan = Plan::new(job, dir);
    let table = job.sweep.clone().unwrap_or_default();
    let designs = sweep::add(&mut plan, job, &table)?;
    Ok((plan, designs))
}

/// Collects the results of an executed plan.
fn summary(context: &mut Context<'_>, job: &Job) -> Summary {
    let plan = context.plan;
    let mut summary = Summary {
        report: plan.folder.join("report.html"),
        psnr_zone: None,
        psnr_zone_worst: None,
        psnr_view: f64::NAN,
        psnr_raw: f64::NAN,
        psnr_held_out: None,
        psnr_outside: None,
        nodes: Vec::new(),
        depth: context.depth.as_ref().map(DepthBudget::to_json),
        depth_sentence: context.depth.as_ref().map(DepthBudget::sentence),
        lacking: std::mem::take(&mut context.lacking),
        sequence: None,
        failed_outputs: std::mem::take(&mut context.failed),
        seconds: 0.0,
    };
    // A sequence has scores over all time steps, and no held-out views.
    if let Some(report) = context.sequence.take() {
        let of_nodes = job.nodes.iter().zip(&report.series);
        summary.nodes = of_nodes
            .map(|(node, series)| NodeSummary {
                id: node.id.clone(),
                psnr_view: series.psnr_view,
                psnr_raw: series.psnr_raw,
                psnr_held_out: None,
                psnr_zone: None,
            })
            .collect();
        (summary.depth, summary.depth_sentence) = (None, None);
        if let Some(first) = report.series.first() {
            (summary.psnr_view, summary.psnr_raw) = (first.psnr_view, first.psnr_raw);
            let (psnr_change, psnr_still) = (first.psnr_change, first.psnr_still);
            summary.sequence = Some(SequenceSummary { times: first.times, psnr_change, psnr_still });
        }
        return summary;
    }
    // A still has a report for each display. The scores of the first display are the scores of the
    // run.
    let displays = if job.nodes.is_empty() { vec![0] } else { plan.within(0).collect() };
    let reports = displays.into_iter().filter_map(|part| Some((part, &context.states[part].reported.as_ref()?.report)));
    for (number, (part, report)) in reports.enumerate() {
        if number == 0 {
            (summary.psnr_view, summary.psnr_raw) = (report.psnr_view, report.psnr_raw);
            (summary.psnr_zone, summary.psnr_held_out) = (report.psnr_zone, report.held_out_psnr_view);
        }
        match plan.node(part) {
            Some(node) => summary.nodes.push(NodeSummary {
                id: node.id.clone(),
                psnr_view: report.psnr_view,
                psnr_raw: report.psnr_raw,
                psnr_held_out: report.held_out_psnr_view,
                psnr_zone: report.psnr_zone,
            }),
            None => {
                (summary.psnr_zone_worst, summary.psnr_outside) = (report.psnr_zone_worst, report.outside_psnr_view);
            }
        }
    }
    summary
}
