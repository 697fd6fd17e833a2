//! Many designs on one light field: PSNR and brightness over layers, frames, β, distances, fields of view and lenslets.
//!
//! ```text
//! job + [sweep] ─▶ designs ─┬─ by light field ─▶ fields/1/target ─┬─▶ designs/KEY.json ─▶ sweep.csv, sweep.json, plots/
//!                           └─ ...              fields/2/target ─┘   one each, in parallel
//! ```
//!
//! A design's file is written beside and renamed, and keyed by all that it depends on, so that a sweep which was killed goes on from what it
//! has and ends with the same bytes. Designs are solved side by side: small ones do not fill a machine one by one.

mod designs;
mod search;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use lumistack_core::{NoProgress, Task, Warnings};
use lumistack_design::plot;
use lumistack_design::table::{self, Row};
use lumistack_display::{Display, LightField, Weights, score};
use lumistack_factorizer::Problem;
use lumistack_plugin_host::Registry;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;

use self::designs::Candidate;
use crate::error::{PipelineError, display_error, factorize_error};
use crate::job::Job;
use crate::run::{Moment, Run, add_weights, eye_weights, solver_settings};
use crate::store::code;
use crate::store::files::{read_json, write, write_json};
use crate::store::folder;
use crate::store::key::KeyBuilder;
use crate::store::lock::take_known;
use crate::store::names::Work;
use crate::store::plugin_files;
use crate::store::settings::write_job;
use crate::store::used;

/// Pixels per unit of plots as PNG.
const PNG_SCALE: f32 = 1.5;

/// What a sweep ended with.
#[derive(Clone, Debug, Serialize)]
pub struct SweepSummary {
    /// The table.
    #[serde(serialize_with = "crate::path_text::told")]
    pub csv: PathBuf,
    /// Designs in it.
    pub designs: usize,
    /// How many of them were there already.
    pub kept: usize,
    /// The plots, as SVG; beside each the same as PNG.
    #[serde(serialize_with = "crate::path_text::told_each")]
    pub plots: Vec<PathBuf>,
    /// Plots that `plots = "all"` would add.
    pub more_plots: usize,
    /// The design of the highest PSNR at the target views, of several the first.
    pub best: Option<Row>,
    /// Of a search, the proposed design and the next best, best first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub proposed: Vec<Row>,
    /// Of a search, the proposed display as a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(serialize_with = "crate::path_text::told_optional")]
    pub display: Option<PathBuf>,
}

/// A light field that several designs share.
pub(crate) struct Field {
    pub(crate) target: LightField,
    between: Option<LightField>,
    weights: Weights,
    /// Hash of all of it.
    key: String,
}

/// Solves every design of a job with `[sweep]` into `dir`, or those that a search finds worth it.
///
/// # Errors
/// When a design makes no sense, or any stage fails or is cancelled; finished designs are kept and taken up by the next run.
pub fn sweep(job: &Job, dir: &Path, registry: &Registry, task: Task<'_>) -> Result<SweepSummary, PipelineError> {
    let Some(sweep) = &job.sweep else {
        return Err(PipelineError::value("job", "sweep", "a table `[sweep]`, or an axis as an option", "none"));
    };
    sweep.check()?;
    if job.sequence.is_some() || !job.nodes.is_empty() {
        return Err(PipelineError::value(
            "job",
            "sweep",
            "a job without `[sequence]` and `[[nodes]]`",
            "one with them",
        ));
    }
    let job = &plugin_files::resolved(job, registry)?;
    let _owned = folder::take(dir, Work::Sweep, job, registry, task)?;
    let (candidates, geometries) = designs::all(job, sweep)?;
    let candidates = match &sweep.search {
        Some(search) => search::allowed(candidates, search)?,
        None => candidates,
    };
    let mut fields = Vec::new();
    for (number, of) in geometries.iter().enumerate() {
        let used = candidates.iter().any(|candidate| candidate.field == number);
        fields.push(if used {
            Some(field(of, &dir.join(format!("fields/{}", number + 1)), registry, task)?)
        } else {
            None
        });
    }
    write_job(job, dir)?;
    let rows_used = Mutex::default();
    let solver = Solver { job, fields: &fields, folder: dir.join("designs"), used: &rows_used, task };
    let (rows, kept, proposed) = match &sweep.search {
        None => {
            let (rows, kept) = solver.solve_all(&candidates, job.factorize.iterations)?;
            (rows, kept, Vec::new())
        }
        Some(search) => search::run(&solver, candidates, search)?,
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
    let (plots, more_plots) = table::plots(&rows, sweep.plots).map_err(PipelineError::Plot)?;
    let plots = write_plots(&dir.join("plots"), &plots)?;
    let used_fields = fields.iter().enumerate().filter(|(_, field)| field.is_some()).map(|(number, _)| number + 1);
    used::keep_only_fields(dir, used_fields, rows_used.into_inner().unwrap_or_else(PoisonError::into_inner))?;
    let best = rows.iter().rev().max_by(|a, b| a.psnr_view_db.total_cmp(&b.psnr_view_db)).cloned();
    let proposed = proposed.into_iter().map(|(_, row)| row).collect();
    Ok(SweepSummary { csv, designs: rows.len(), kept, plots, more_plots, best, proposed, display })
}

/// Writes plots as SVG and PNG; gives the SVGs.
///
/// # Errors
/// When they cannot be drawn or written.
pub(crate) fn write_plots(folder: &Path, plots: &[table::Plot]) -> Result<Vec<PathBuf>, PipelineError> {
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

/// The light field of a job, as a run would make it.
fn field(job: &Job, dir: &Path, registry: &Registry, task: Task<'_>) -> Result<Field, PipelineError> {
    job.check()?;
    let mut run = Run::open(job, dir, registry)?;
    let _owned = take_known(dir, task)?;
    let input = run.input(&Moment::default(), task)?;
    used::keep_only_views(dir, &input.views)?;
    let weights = eye_weights(&job.factorize, &input.target)?;
    let mut key = KeyBuilder::new("sweep field", code::FIELDS);
    for field in [Some(&input.target), input.held_out.as_ref()].into_iter().flatten() {
        key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_f32("radiance", field.radiance().data());
    }
    add_weights(&mut key, &weights);
    Ok(Field { target: input.target, between: input.held_out, weights, key: key.finish() })
}

/// Solves designs and keeps their rows.
pub(crate) struct Solver<'a> {
    job: &'a Job,
    fields: &'a [Option<Field>],
    folder: PathBuf,
    /// Names of the files of all rows that were asked for.
    used: &'a Mutex<BTreeSet<String>>,
    task: Task<'a>,
}

impl Solver<'_> {
    pub(crate) fn iterations(&self) -> u32 {
        self.job.factorize.iterations
    }

    /// A row for every candidate, in their order, and how many were there already.
    ///
    /// # Errors
    /// When a design cannot be solved, or when cancelled.
    pub(crate) fn solve_all(
        &self,
        candidates: &[Candidate],
        iterations: u32,
    ) -> Result<(Vec<Row>, usize), PipelineError> {
        std::fs::create_dir_all(&self.folder).map_err(PipelineError::write(&self.folder))?;
        let progress = self.task.progress;
        progress.begin("sweep", candidates.len() as u64, "designs");
        let finished = AtomicUsize::new(0);
        let solved: Result<Vec<(Row, bool)>, PipelineError> = candidates
            .par_iter()
            .with_max_len(1)
            .map(|candidate| {
                let solved = self.solve(candidate, iterations)?;
                finished.fetch_add(1, Ordering::Relaxed);
                let from_before = if solved.1 { ", from before" } else { "" };
                progress.advance(1, &format!("{:.1} dB{from_before}", solved.0.psnr_view_db));
                Ok(solved)
            })
            .collect();
        progress.end();
        let solved = solved.inspect_err(|error| {
            if matches!(error, PipelineError::Cancelled) {
                let (done, all) = (finished.load(Ordering::Relaxed), candidates.len());
                let folder = self.folder.display();
                let message =
                    format!("stopped with {done} of {all} designs in {folder}; the same command goes on from them");
                self.task.warn("sweep", message);
            }
        })?;
        let kept = solved.iter().filter(|(_, kept)| *kept).count();
        Ok((solved.into_iter().map(|(row, _)| row).collect(), kept))
    }

    fn solve(&self, candidate: &Candidate, iterations: u32) -> Result<(Row, bool), PipelineError> {
        self.task.cancel.check()?;
        let Some(field) = &self.fields[candidate.field] else {
            return Err(PipelineError::value("job", "sweep", "a light field for every design", "none"));
        };
        let display = self.display_on(candidate, field)?;
        display.check().map_err(|source| crate::error::display_error(source, &candidate.design.display))?;
        let job = &self.job.factorize;
        let mut key = KeyBuilder::new("design", code::DESIGNS);
        key.add("field", field.key.as_bytes())
            .add("name", candidate.design.display.as_bytes())
            .add("display", Display { name: String::new(), ..display.clone() }.to_toml().as_bytes())
            .add_json("settings", &(&job.solver, iterations, &job.start, self.job.seed))
            .add_json("coarse and levels", &(job.coarse_levels, job.coarse_iterations, job.levels));
        let name = format!("{}.json", &key.finish()[..24]);
        let path = self.folder.join(&name);
        self.used.lock().unwrap_or_else(PoisonError::into_inner).insert(name);
        if let Some(row) = read_json::<Row>(&path).filter(|row| row.design == candidate.design) {
            return Ok((row, true));
        }
        let row = self.row(candidate, &display, field, iterations)?;
        write_json(&path, &row)?;
        Ok((row, false))
    }

    /// What was read has a geometry of its own.
    fn display_on(&self, candidate: &Candidate, field: &Field) -> Result<Display, PipelineError> {
        match &self.job.scene {
            Some(_) => Ok(candidate.display.clone()),
            None => {
                let adapted = candidate.display.adapted_to(field.target.geometry());
                adapted.map_err(|source| display_error(source, "light field"))
            }
        }
    }

    fn row(
        &self,
        candidate: &Candidate,
        display: &Display,
        field: &Field,
        iterations: u32,
    ) -> Result<Row, PipelineError> {
        let mut settings = solver_settings(&self.job.factorize, self.job.seed)?;
        (settings.iterations, settings.report_every) = (iterations, iterations.max(1));
        let problem = Problem { display, target: &field.target, weights: &field.weights };
        // bars of many designs at once would be noise
        let quiet = Task { progress: &NoProgress, warnings: &Silent, cancel: self.task.cancel };
        let result = lumistack_factorizer::factorize(&problem, &settings, None, quiet, &mut |_| {});
        let stack = result.map_err(factorize_error)?.stack;
        let reached = score(display, &stack, &field.target, &field.weights);
        let between = field.between.as_ref().map(|field| score(display, &stack, field, &Weights::Uniform).psnr_view());
        let cut = |psnr: f64| psnr.min(table::MOST_DB);
        Ok(Row {
            design: candidate.design.clone(),
            psnr_view_db: cut(reached.psnr_view()),
            psnr_raw_db: cut(reached.psnr_raw()),
            psnr_between_db: between.filter(|psnr| !psnr.is_nan()).map(cut),
        })
    }
}

/// Warnings about one design among a hundred tell nobody anything.
struct Silent;

impl Warnings for Silent {
    fn warn(&self, _warning: lumistack_core::Warning) {}
}
