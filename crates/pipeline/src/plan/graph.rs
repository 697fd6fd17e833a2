//! Steps of a graph: one light field, and nodes that each make the patterns of one display. An
//! output reads the patterns of a node, or the light field itself.
//!
//! ```text
//! scene or light field ─▶ target/ ─┬─▶ nodes/A/layers ─▶ outputs/A/<name>/ ...
//!                                  ├─▶ nodes/B/layers ─▶ outputs/B/<name>/ ...
//!                                  └─────────────────▶ outputs/light_field/<name>/ ...
//! ```
//!
//! `nodes/ID` has the layout of a run folder (display.toml, layers, report), without the light
//! field, which nodes share. A job without nodes has the steps of `still.rs`.

use lumistack_display::{Display, FieldGeometry};

use super::steps::{PartKind, Plan, StepKind};
use super::still::{TimeBefore, add_display, add_field_outputs, add_score};
use crate::error::PipelineError;
use crate::job::{Job, NodeJob, OutputJob};
use crate::stage::node;

/// Adds the steps that follow a part's light field: the steps of a still's display, or those of the
/// nodes and their report.
///
/// `before` returns the steps of the previous time step that made the patterns and the light field
/// of the same display. The function returns the ids of the last steps.
pub(crate) fn add_displays(
    plan: &mut Plan,
    part: usize,
    field: &str,
    before: impl Fn(Option<&NodeJob>) -> Option<TimeBefore>,
    reports: bool,
) -> Vec<String> {
    let score = if reports { add_score(plan, part, field) } else { Vec::new() };
    let (job, folder) = (plan.parts[part].job.clone(), plan.parts[part].folder.clone());
    if job.nodes.is_empty() {
        let [_, end] = add_display(plan, part, field, &score, before(None), reports);
        return vec![end];
    }
    let mut ends = add_field_outputs(plan, part, field);
    for (number, node) in job.nodes.iter().enumerate() {
        let folder = folder.join("nodes").join(&node.id);
        let of_node = plan.add_part(folder, PartKind::Node(number), job_of(&job, node), Some(part));
        let [_, end] = add_display(plan, of_node, field, &score, before(Some(node)), reports);
        ends.push(end);
    }
    if reports {
        ends = vec![plan.add_step(part, StepKind::Report, ends)];
    }
    ends
}

/// Returns the job of a node as a still, with the display, factorizer and outputs of the node.
pub(crate) fn job_of(job: &Job, node: &NodeJob) -> Job {
    Job {
        name: format!("{}: {}", job.name, node.id),
        display: node.display.clone().unwrap_or_else(|| job.display.clone()),
        factorize: node.factorize.clone().unwrap_or_else(|| job.factorize.clone()),
        outputs: job.outputs_of(&node.id).cloned().map(|output| OutputJob { from: None, ..output }).collect(),
        nodes: Vec::new(),
        ..job.clone()
    }
}

/// Returns all outputs of a job and of its nodes, each with its display for a light field of this
/// geometry. `display` is the display of the job.
///
/// # Errors
/// If the display of a node is wrong or does not match the light field.
pub(crate) fn outputs_on(
    job: &Job,
    display: &Display,
    geometry: &FieldGeometry,
) -> Result<Vec<(OutputJob, Display)>, PipelineError> {
    let own = job.outputs.iter().filter(|output| job.nodes.is_empty() || output.takes_light_field());
    let mut all: Vec<(OutputJob, Display)> = own.map(|output| (output.clone(), display.clone())).collect();
    for of_node in &job.nodes {
        let job = job_of(job, of_node);
        let (display, _) = node::display(of_node, &job.resolve_display()?, display, geometry)?;
        all.extend(job.outputs.into_iter().map(|output| (output, display.clone())));
    }
    Ok(all)
}
