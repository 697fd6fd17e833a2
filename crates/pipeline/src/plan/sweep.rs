//! Many designs on one light field: PSNR all over the zone and brightness over layers, frames, β, distances, fields of view and lenslets.
//!
//! ```text
//! job + [sweep] ─▶ designs ─┬─ by light field ─▶ fields/1/target ─┬─▶ designs/KEY.json ─▶ sweep.csv, sweep.json, plots/
//!                           └─ ...              fields/2/target ─┘   one each, in parallel
//! ```
//!
//! Of a sequence every light field is one per time, fields/1/t0001/target. A design's file is written beside and renamed, and keyed by all that it depends on, so
//! that a sweep which was killed goes on from what it has and ends with the same bytes. Designs are solved side by side: small ones do not fill a machine one by
//! one.

mod designs;
mod search;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use lumistack_core::Task;
use lumistack_design::table::{self, Row};
use lumistack_plot as plot;
use lumistack_plugin_host::Registry;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;

use super::execute::Executor;
use super::sequence::add_times;
use super::steps::{Kind, Plan, What};
use super::still::{Before, add_field, add_score};
use super::times::later;
use crate::error::PipelineError;
use crate::job::{Job, SearchJob, SweepJob};
use crate::stage::design::{Candidate, Shared, Solver};
use crate::store::files::write;
use crate::store::settings::write_job;
use crate::store::used;

/// Pixels per unit of plots as PNG.
const PNG_SCALE: f32 = 1.5;

/// What a sweep ended with.
#[derive(Clone, Debug, Serialize)]
pub struct SweepSummary {
    /// The table.
    #[serde(serialize_with = "lumistack_core::path_text::told")]
    pub csv: PathBuf,
    /// Designs in it.
    pub designs: usize,
    /// How many of them were there already.
    pub kept: usize,
    /// The plots, as SVG; beside each the same as PNG.
    #[serde(serialize_with = "lumistack_core::path_text::told_each")]
    pub plots: Vec<PathBuf>,
    /// Plots that `plots = "all"` would add.
    pub more_plots: usize,
    /// The design of the highest PSNR all over the zone, or at the target views where that is not known; of several the first.
    pub best: Option<Row>,
    /// Of a search, the proposed design and the next best, best first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub proposed: Vec<Row>,
    /// Of a search, the proposed display as a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(serialize_with = "lumistack_core::path_text::told_optional")]
    pub display: Option<PathBuf>,
}

/// Solves one design of a sweep, by number from 1, and keeps its row. Its light fields are done.
///
/// # Errors
/// When the sweep has no such design, it cannot be solved, or when cancelled.
pub(crate) fn execute_design(
    plan: &Plan,
    designs: &Designs,
    job: &Job,
    number: usize,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let step = plan.steps.iter().find(|step| step.what == What::Design(number - 1));
    let known = step.zip(designs.candidates.get(number - 1));
    let unknown = || PipelineError::value("plan", "unit", "a design of the sweep", number.to_string());
    let (step, candidate) = known.ok_or_else(unknown)?;
    let mut executor = Executor::new(plan, registry, None, task);
    executor.read_back(&step.inputs)?;
    let mut fields: Vec<Option<Shared>> = designs.fields.iter().map(|_| None).collect();
    fields[candidate.field] = shared(&mut executor, &designs.fields[candidate.field], job)?;
    let solver = Solver { job, fields, folder: plan.folder.join("designs"), later: later(job), registry };
    std::fs::create_dir_all(&solver.folder).map_err(PipelineError::write(&solver.folder))?;
    solver.solve(candidate, job.factorize.iterations(), task.cancel).map(|_| ())
}

/// Takes the light fields of parts out of an executor's memory; `None` where there are none.
fn shared(executor: &mut Executor<'_>, parts: &[usize], job: &Job) -> Result<Option<Shared>, PipelineError> {
    let states = &mut executor.context.states;
    let times = parts.iter().filter_map(|part| states[*part].field.take()).collect::<Vec<Arc<_>>>();
    let references = parts.first().and_then(|part| states[*part].references.take());
    if times.is_empty() { Ok(None) } else { Shared::new(times, references, job).map(Some) }
}

/// Designs, and the parts that hold their light fields.
#[derive(Default)]
pub(crate) struct Designs {
    candidates: Vec<Candidate>,
    /// By number of the light field the parts of its times.
    fields: Vec<Vec<usize>>,
}

/// Adds a sweep: the light fields that its designs need, and the designs.
///
/// # Errors
/// When a design makes no sense, or the constraints of a search leave none.
pub(crate) fn add(plan: &mut Plan, job: &Job, sweep: &SweepJob) -> Result<Designs, PipelineError> {
    sweep.check()?;
    job.factorize.check_needs_no_device("designs of a sweep are solved")?;
    let root = plan.add_part(PathBuf::new(), Kind::Sweep, job.clone(), None);
    let (candidates, jobs) = designs::all(job, sweep)?;
    let candidates = match &sweep.search {
        Some(search) => search::allowed(candidates, search)?,
        None => candidates,
    };
    let (mut fields, mut inputs) = (Vec::new(), Vec::new());
    for (number, of_field) in jobs.into_iter().enumerate() {
        let (mut parts, mut ids) = (Vec::new(), Vec::new());
        if candidates.iter().any(|candidate| candidate.field == number) {
            let folder = Path::new("fields").join((number + 1).to_string());
            let is_sequence = of_field.sequence.is_some();
            let part = plan.add_part(folder, Kind::Run, of_field, Some(root));
            ids =
                if is_sequence { add_times(plan, part, true)? } else { vec![add_field(plan, part, Before::default())] };
            let steps = plan.steps.iter().filter(|step| ids.contains(&step.id));
            parts = steps.map(|step| step.part).collect();
            if !is_sequence {
                ids.extend(add_score(plan, part, &ids[0]));
            }
        }
        fields.push(parts);
        inputs.push(ids);
    }
    let ends = match sweep.search {
        Some(_) => vec![plan.add_step(root, What::Search, inputs.concat())],
        None => {
            let designs = candidates.iter().enumerate();
            designs
                .map(|(number, candidate)| plan.add_step(root, What::Design(number), inputs[candidate.field].clone()))
                .collect()
        }
    };
    plan.add_step(root, What::Report, ends);
    Ok(Designs { candidates, fields })
}

/// Executes the plan of a sweep: its light fields one after another, then designs side by side, then the table.
///
/// # Errors
/// When any stage fails or is cancelled; finished designs are kept and taken up by the next run.
pub(crate) fn execute(
    plan: &Plan,
    designs: &Designs,
    job: &Job,
    registry: &Registry,
    task: Task<'_>,
) -> Result<SweepSummary, PipelineError> {
    let dir = &plan.folder;
    let mut executor = Executor::new(plan, registry, None, task);
    executor.execute()?;
    write_job(job, dir)?;
    let mut fields = Vec::new();
    for parts in &designs.fields {
        fields.push(shared(&mut executor, parts, job)?);
    }
    let solver = Solver { job, fields, folder: dir.join("designs"), later: later(job), registry };
    let sweep = Sweep { solver, used: Mutex::default(), task };
    let (rows, kept, proposed) = match job.sweep.as_ref().and_then(|sweep| sweep.search.as_ref()) {
        None => {
            let (rows, kept) = sweep.solve_all(&designs.candidates, job.factorize.iterations())?;
            (rows, kept, Vec::new())
        }
        Some(search) => sweep.search(designs.candidates.clone(), search)?,
    };
    let display = match proposed.first() {
        None => None,
        Some((best, _)) => {
            let path = dir.join("proposed.toml");
            write(&path, best.display.to_toml().as_bytes())?;
            Some(path)
        }
    };
    let csv = dir.join("sweep.csv");
    write(&csv, table::csv(&rows).as_bytes())?;
    let all = json!({ "schema": "lumistack/sweep", "version": 1, "name": job.name, "rows": rows });
    write(&dir.join("sweep.json"), &serde_json::to_vec_pretty(&all).expect("rows serialize"))?;
    let which = job.sweep.as_ref().map(|sweep| sweep.plots).unwrap_or_default();
    let (plots, more_plots) = table::plots(&rows, which).map_err(PipelineError::Plot)?;
    let plots = write_plots(&dir.join("plots"), &plots)?;
    let used_fields = designs.fields.iter().enumerate().filter(|(_, parts)| !parts.is_empty());
    let used_rows = sweep.used.into_inner().unwrap_or_else(PoisonError::into_inner);
    used::keep_only_fields(dir, used_fields.map(|(number, _)| number + 1), used_rows)?;
    let best = rows.iter().rev().max_by(|a, b| a.quality_db().total_cmp(&b.quality_db())).cloned();
    let proposed = proposed.into_iter().map(|(_, row)| row).collect();
    Ok(SweepSummary { csv, designs: rows.len(), kept, plots, more_plots, best, proposed, display })
}

/// Writes plots as SVG and PNG; gives the SVGs.
///
/// # Errors
/// When they cannot be drawn or written.
fn write_plots(folder: &Path, plots: &[table::Plot]) -> Result<Vec<PathBuf>, PipelineError> {
    std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
    plots
        .iter()
        .map(|(stem, svg)| {
            let path = folder.join(format!("{stem}.svg"));
            write(&path, svg.as_bytes())?;
            let png = plot::png(svg, PNG_SCALE).map_err(PipelineError::Plot)?;
            write(&path.with_extension("png"), &png)?;
            Ok(path)
        })
        .collect()
}

/// Solves designs side by side.
struct Sweep<'a> {
    solver: Solver<'a>,
    /// Names of the files of all rows that were asked for.
    used: Mutex<BTreeSet<String>>,
    task: Task<'a>,
}

impl Sweep<'_> {
    /// A row for every candidate, in their order, and how many were there already.
    ///
    /// # Errors
    /// When a design cannot be solved, or when cancelled.
    fn solve_all(&self, candidates: &[Candidate], iterations: u32) -> Result<(Vec<Row>, usize), PipelineError> {
        let folder = &self.solver.folder;
        std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
        let progress = self.task.progress;
        progress.begin("sweep", candidates.len() as u64, "designs");
        let finished = AtomicUsize::new(0);
        let solved: Result<Vec<(Row, bool)>, PipelineError> = candidates
            .par_iter()
            .with_max_len(1)
            .map(|candidate| {
                let (row, name, kept) = self.solver.solve(candidate, iterations, self.task.cancel)?;
                self.used.lock().unwrap_or_else(PoisonError::into_inner).insert(name);
                finished.fetch_add(1, Ordering::Relaxed);
                let from_before = if kept { ", from before" } else { "" };
                progress.advance(1, &format!("{:.1} dB{from_before}", row.quality_db()));
                Ok((row, kept))
            })
            .collect();
        progress.end();
        let solved = solved.inspect_err(|error| {
            if matches!(error, PipelineError::Cancelled) {
                let (done, all) = (finished.load(Ordering::Relaxed), candidates.len());
                let folder = folder.display();
                let message =
                    format!("stopped with {done} of {all} designs in {folder}; the same command goes on from them");
                self.task.warn("sweep", message);
            }
        })?;
        let kept = solved.iter().filter(|(_, kept)| *kept).count();
        Ok((solved.into_iter().map(|(row, _)| row).collect(), kept))
    }

    fn search(
        &self,
        candidates: Vec<Candidate>,
        search: &SearchJob,
    ) -> Result<(Vec<Row>, usize, Vec<(Candidate, Row)>), PipelineError> {
        let mut solve_all = |candidates: &[Candidate], iterations| self.solve_all(candidates, iterations);
        search::run(&mut solve_all, self.solver.job.factorize.iterations(), candidates, search)
    }
}
