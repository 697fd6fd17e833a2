//! Steps of a sequence: one run folder per time step. A time step has a warm start from the
//! previous time step. The first time step and a time step that begins a chunk are exceptions. A
//! time step for which a fresh start is better, for example after a cut, is another exception.
//!
//! ```text
//! job ─▶ t0001/ ─layers─▶ t0002/ ─layers─▶ t0003/ ─▶ ...      each folder holds the job of a still
//!          └──────────────── error, flicker ──────────────▶ report.html, report.json
//! ```
//!
//! A time step of a job with nodes is a graph, in folders such as t0001/nodes/ID, with a warm start
//! for each node. [`Times::job`](super::times::Times::job) makes the job of a time step.
//!
//! Chunks break the chain of warm starts, so that several machines can solve them in parallel.
//! Before the first time step of a chunk, some earlier time steps are solved again, and the chunk
//! starts from their patterns.
//!
//! Two time steps are in memory together, since flicker compares them.

use super::graph::add_displays;
use super::steps::{PartKind, Plan, StepKind};
use super::still::{Before, TimeBefore, add_field};
use super::times::{Times, name};
use crate::error::PipelineError;
use crate::job::NodeJob;
use crate::stage::node::is_factorized;

/// Adds a sequence in a part's folder: all time steps and a report or, with `fields_only`, only the
/// light fields. Returns the ids of the steps that make the light fields.
///
/// # Errors
/// If the folder of light fields cannot be read, or has too few or too many light fields.
pub(crate) fn add_times(plan: &mut Plan, part: usize, fields_only: bool) -> Result<Vec<String>, PipelineError> {
    let (job, folder) = (plan.parts[part].job.clone(), plan.parts[part].folder.clone());
    let Some(sequence) = &job.sequence else { return Ok(Vec::new()) };
    let times = Times::find(&job, sequence)?;
    plan.parts[part].kind = PartKind::Sequence(times.clone());
    // The window is placed once, for the first time step. Its motion starts at this position.
    let placed = job.scene.is_some().then(|| {
        let ingest = plan.add_step(part, StepKind::Ingest, Vec::new());
        let place = plan.add_step(part, StepKind::Place, vec![ingest.clone()]);
        [ingest, place]
    });
    // Every time step is a part with a job, and depends on earlier time steps.
    let reports = sequence.reports && !fields_only;
    let (mut fields, mut ends) = (Vec::<String>::new(), Vec::new());
    for time in 0..times.count() {
        let before = times.start(time).map(|before| plan.folder.join(&folder).join(before));
        let of_time = times.job(&job, time, before.as_deref(), None);
        let of_time = plan.add_part(folder.join(name(time)), PartKind::Time(time), of_time, Some(part));
        let before = Before {
            ingested: placed.as_ref().filter(|_| times.shares_scene()).map(|[ingest, _]| ingest.as_str()),
            placed: placed.as_ref().map(|[_, place]| place.as_str()),
            first: fields.first().map(String::as_str),
        };
        let field = add_field(plan, of_time, before);
        if !fields_only {
            let last = fields.last().cloned();
            let warm_up: Vec<String> = fields[times.warm_up(time)].to_vec();
            let before = |node: Option<&NodeJob>| {
                let place = folder.join(name(time.checked_sub(1)?));
                let place = node.map_or(place.clone(), |node| place.join("nodes").join(&node.id));
                let stage = if is_factorized(node) { "factorize" } else { "node" };
                let id: Vec<_> = place.iter().map(|part| part.to_string_lossy()).collect();
                let patterns = format!("{}/{stage}", id.join("/"));
                Some(TimeBefore { patterns, field: last.clone()?, warm_up: warm_up.clone() })
            };
            ends.extend(add_displays(plan, of_time, &field, before, reports));
        }
        fields.push(field);
    }
    if !fields_only {
        plan.add_step(part, StepKind::Report, ends);
    }
    Ok(fields)
}
