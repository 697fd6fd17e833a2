//! One light field, several nodes: each makes the patterns of a display, and outputs take those or the light field itself.
//!
//! ```text
//! scene or light field ─▶ target/ ─┬─▶ nodes/A/layers ─▶ outputs/A/<name>/ ...
//!                                  ├─▶ nodes/B/layers ─▶ outputs/B/<name>/ ...
//!                                  └─────────────────▶ outputs/light_field/<name>/ ...
//! ```
//!
//! `nodes/ID` has the layout of a run folder (display.toml, layers, report), without the light field that all share. A job without nodes is a still.

use super::steps::{Kind, Plan, What};
use super::still::{add_display, add_field_outputs, add_score};
use crate::job::{Job, NodeJob, OutputJob};

/// Adds what follows a part's light field: the still's display, or those of all nodes and their report. `before` gives patterns and light field of the same display at
/// the time before. Gives the last ids.
pub(crate) fn add_displays(
    plan: &mut Plan,
    part: usize,
    field: &str,
    before: impl Fn(Option<&NodeJob>) -> Option<[String; 2]>,
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
        let of_node = plan.add_part(folder, Kind::Node(number), job_of(&job, node), Some(part));
        let [_, end] = add_display(plan, of_node, field, &score, before(Some(node)), reports);
        ends.push(end);
    }
    if reports {
        ends = vec![plan.add_step(part, What::Report, ends)];
    }
    ends
}

/// The plain job that a node stands for, given the light field.
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
