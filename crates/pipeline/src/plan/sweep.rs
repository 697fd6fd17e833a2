//! Sweeps: they solve many designs, and list the scores of each design. Designs differ in display,
//! layers, frames, β, gaps, fields of view or lenslets.
//!
//! ```text
//! job + [sweep] ─▶ designs ─┬─ by light field ─▶ fields/1/target ─┬─▶ designs/KEY.json
//!                           └─ ...               fields/2/target ─┘   one each, in parallel
//! designs/*.json ─▶ sweep.csv, sweep.json, plots/
//! ```
//!
//! A sweep of a sequence has a light field per time step, `fields/1/t0001/target`. The file of a
//! design is written atomically, and its name contains a key of everything that the file depends
//! on. Therefore a killed sweep continues with the finished designs. Its table then has the bytes
//! of a sweep that was not killed.
//!
//! Designs are solved in parallel, since a small design does not use all threads.

mod designs;
mod search;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use lumistack_core::Task;
use lumistack_design::table::{self, Row};
use lumistack_plot as plot;
use lumistack_plugin_host::Registry;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;

use super::execute::Executor;
use super::sequence::add_times;
use super::steps::{PartKind, Plan, StepKind};
use super::still::{Before, add_field, add_score};
use super::times::later;
use crate::error::PipelineError;
use crate::job::{Job, SearchJob, SweepJob};
use crate::stage::design::{Candidate, Shared, Solver};
use crate::store::files::write;
use crate::store::settings::write_job;
use crate::store::used;

/// Number of pixels in a plot's PNG file for each unit of length in the plot's SVG file.
const PNG_SCALE: f32 = 1.5;

/// Results of a sweep.
#[derive(Clone, Debug, Serialize)]
pub struct SweepSummary {
    /// File of the table.
    #[serde(serialize_with = "lumistack_core::path_text::told")]
    pub csv: PathBuf,
    /// Number of designs in the table.
    pub designs: usize,
    /// Number of designs that earlier runs solved.
    pub kept: usize,
    /// Plots as SVG files; each has a PNG file of the same name.
    #[serde(serialize_with = "lumistack_core::path_text::told_each")]
    pub plots: Vec<PathBuf>,
    /// Number of plots that `plots = "all"` would add.
    pub more_plots: usize,
    /// The design with the highest zone score or, without zone scores, the highest PSNR at the
    /// target views. If several are equally good, the first one.
    pub best: Option<Row>,
    /// The designs that a search proposes, best first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub proposed: Vec<Row>,
    /// File of the display that a search proposes, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(serialize_with = "lumistack_core::path_text::told_optional")]
    pub display: Option<PathBuf>,
}

/// Solves one design of a sweep, and writes its row of the table. `number` counts designs from 1.
/// The light fields of the design must be complete.
///
/// # Errors
/// If the sweep has no such design, the solver fails, or the task is cancelled.
pub(crate) fn execute_design(
    plan: &Plan,
    designs: &Designs,
    job: &Job,
    number: usize,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let step = plan.steps.iter().find(|step| step.kind == StepKind::Design(number - 1));
    let known = step.zip(designs.candidates.get(number - 1));
    let unknown = || PipelineError::value("plan", "unit", "a design of the sweep", number.to_string());
    let (step, candidate) = known.ok_or_else(unknown)?;
    let mut executor = Executor::new(plan, registry, None, task);
    executor.read_back(&step.inputs)?;
    let mut fields: Vec<Option<Shared>> = designs.fields.iter().map(|_| None).collect();
    fields[candidate.field] = shared(&mut executor, &designs.fields[candidate.field], job)?;
    let solver = Solver::new(job, fields, plan.folder.join("designs"), later(job), registry)?;
    std::fs::create_dir_all(&solver.folder).map_err(PipelineError::write(&solver.folder))?;
    solver.solve(candidate, job.factorize.iterations(), task.cancel).map(|_| ())
}

/// Takes the light fields of `parts` from an executor's memory; `None` if there are none.
fn shared(executor: &mut Executor<'_>, parts: &[usize], job: &Job) -> Result<Option<Shared>, PipelineError> {
    let states = &mut executor.context.states;
    let (mut times, mut references) = (Vec::new(), Vec::new());
    for &part in parts {
        if let Some(field) = states[part].field.take() {
            times.push(field);
            references.push(states[part].references.take());
        }
    }
    if times.is_empty() { Ok(None) } else { Shared::new(times, references, job).map(Some) }
}

/// Designs of a sweep, and the parts of the plan that make their light fields.
#[derive(Default)]
pub(crate) struct Designs {
    candidates: Vec<Candidate>,
    /// For each light field, one part of the plan per time step.
    fields: Vec<Vec<usize>>,
}

/// Adds the steps of a sweep: light fields, then designs, then the table.
///
/// # Errors
/// If the job names a graphics processor or a warm start, there are too many designs, a design is
/// invalid, or no design satisfies the constraints of a search.
pub(crate) fn add(plan: &mut Plan, job: &Job, sweep: &SweepJob) -> Result<Designs, PipelineError> {
    sweep.check()?;
    let of_nodes = job.nodes.iter().filter_map(|node| node.factorize.as_ref());
    for factorize in std::iter::once(&job.factorize).chain(of_nodes) {
        factorize.check_needs_no_device("designs of a sweep are solved")?;
        if let Some(path) = &factorize.warm_start {
            let expected = "no warm start in a sweep, since its designs have patterns of different shapes";
            return Err(PipelineError::job("factorize.warm_start", expected, path.display().to_string()));
        }
    }
    let root = plan.add_part(PathBuf::new(), PartKind::Sweep, job.clone(), None);
    let (candidates, jobs) = designs::all(job, sweep)?;
    let candidates = match &sweep.search {
        Some(search) => search::allowed(candidates, search)?,
        None => candidates,
    };
    // Only light fields that a design needs get a part.
    let (mut fields, mut inputs) = (Vec::new(), Vec::new());
    for (number, of_field) in jobs.into_iter().enumerate() {
        let (mut parts, mut ids) = (Vec::new(), Vec::new());
        if candidates.iter().any(|candidate| candidate.field == number) {
            let folder = Path::new("fields").join((number + 1).to_string());
            let is_sequence = of_field.sequence.is_some();
            let part = plan.add_part(folder, PartKind::Run, of_field, Some(root));
            ids =
                if is_sequence { add_times(plan, part, true)? } else { vec![add_field(plan, part, Before::default())] };
            let steps = plan.steps.iter().filter(|step| ids.contains(&step.id));
            parts = steps.map(|step| step.part).collect();
            // Add the steps that render the pictures for the zone score of every time step.
            let of_fields = parts.iter().copied().zip(ids.clone()).collect::<Vec<(usize, String)>>();
            ids.extend(of_fields.into_iter().flat_map(|(part, id)| add_score(plan, part, &id)));
        }
        fields.push(parts);
        inputs.push(ids);
    }
    // While a search works, it decides which designs it solves. So the search is one step.
    let ends = match sweep.search {
        Some(_) => vec![plan.add_step(root, StepKind::Search, inputs.concat())],
        None => {
            let designs = candidates.iter().enumerate();
            designs
                .map(|(number, candidate)| {
                    plan.add_step(root, StepKind::Design(number), inputs[candidate.field].clone())
                })
                .collect()
        }
    };
    plan.add_step(root, StepKind::Report, ends);
    Ok(Designs { candidates, fields })
}

/// Executes a sweep: light fields one after another, then designs in parallel, then the table.
///
/// # Errors
/// If a stage fails or the task is cancelled. Finished designs are kept, and the next run reuses
/// them.
pub(crate) fn execute(
    plan: &Plan,
    designs: &Designs,
    job: &Job,
    registry: &Registry,
    task: Task<'_>,
) -> Result<SweepSummary, PipelineError> {
    // Make the light fields before the designs, which read them from memory.
    let dir = &plan.folder;
    let mut executor = Executor::new(plan, registry, None, task);
    executor.execute()?;
    write_job(job, dir)?;
    let mut fields = Vec::new();
    for parts in &designs.fields {
        fields.push(shared(&mut executor, parts, job)?);
    }
    // Solve all designs, or the designs that the search selects.
    let solver = Solver::new(job, fields, dir.join("designs"), later(job), registry)?;
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
    // Write the table and its plots.
    let csv = dir.join("sweep.csv");
    write(&csv, table::csv(&rows).as_bytes())?;
    let all = json!({ "schema": "lumistack/sweep", "version": 1, "name": job.name, "rows": rows });
    write(&dir.join("sweep.json"), &serde_json::to_vec_pretty(&all).expect("rows serialize"))?;
    let which = job.sweep.as_ref().map(|sweep| sweep.plots).unwrap_or_default();
    let (plots, more_plots) = table::plots(&rows, which).map_err(PipelineError::Plot)?;
    let plots = write_plots(&dir.join("plots"), &plots)?;
    // Record which light fields and files of rows this sweep used. Remove all other light fields;
    // files of rows are small, so all of them stay.
    let used_fields = designs.fields.iter().enumerate().filter(|(_, parts)| !parts.is_empty());
    let used_rows = sweep.used.into_inner().unwrap_or_else(PoisonError::into_inner);
    used::keep_only_fields(dir, used_fields.map(|(number, _)| number + 1), used_rows)?;
    let best = rows.iter().rev().max_by(|a, b| a.quality_db().total_cmp(&b.quality_db())).cloned();
    let proposed = proposed.into_iter().map(|(_, row)| row).collect();
    Ok(SweepSummary { csv, designs: rows.len(), kept, plots, more_plots, best, proposed, display })
}

/// Writes plots as SVG and PNG. Returns the paths of the SVG files.
///
/// # Errors
/// If a plot cannot be drawn or written.
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

/// Solves designs in parallel.
struct Sweep<'a> {
    solver: Solver<'a>,
    /// File names of all rows that this sweep solved or reused.
    used: Mutex<BTreeSet<String>>,
    task: Task<'a>,
}

impl Sweep<'_> {
    /// Returns a row per candidate, in the order of the candidates, and the number of rows that
    /// earlier runs made.
    ///
    /// # Errors
    /// If the solver fails on a design, or the task is cancelled.
    fn solve_all(&self, candidates: &[Candidate], iterations: u32) -> Result<(Vec<Row>, usize), PipelineError> {
        let folder = &self.solver.folder;
        std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
        let progress = self.task.progress;
        progress.begin("sweep", candidates.len() as u64, "designs");
        // Some candidates take much longer than others, so each thread takes one candidate at a
        // time.
        let finished = AtomicUsize::new(0);
        let solved: Result<Vec<(Row, bool)>, PipelineError> = candidates
            .par_iter()
            .with_max_len(1)
            .map(|candidate| {
                let (row, name, kept) = self.solver.solve(candidate, iterations, self.task.cancel)?;
                self.used.lock().unwrap_or_else(PoisonError::into_inner).insert(name);
                finished.fetch_add(1, Ordering::Relaxed);
                let from_before = if kept { ", solved by an earlier sweep" } else { "" };
                progress.advance(1, &format!("{}{from_before}", row.quality_text()));
                Ok((row, kept))
            })
            .collect();
        progress.end();
        // State how many designs are finished, since the same command continues a stopped sweep.
        let solved = solved.inspect_err(|error| {
            if matches!(error, PipelineError::Cancelled) {
                let (done, all) = (finished.load(Ordering::Relaxed), candidates.len());
                let folder = folder.display();
                let message = format!(
                    "stopped; finished designs in {folder}: {done} of {all}; the same command solves the other designs"
                );
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
