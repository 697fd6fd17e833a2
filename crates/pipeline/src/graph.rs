//! One light field, several nodes: each makes the patterns of a display, and outputs take those or the light field itself.
//!
//! ```text
//! scene or light field ─▶ target/ ─┬─▶ nodes/A/layers ─▶ outputs/A/<name>/ ...
//!                                  ├─▶ nodes/B/layers ─▶ outputs/B/<name>/ ...
//!                                  └─────────────────▶ outputs/light_field/<name>/ ...
//! ```
//!
//! `nodes/ID` has the layout of a run folder (display.toml, layers, report), without the light field that all share.

use std::path::Path;
use std::time::Instant;

use lumistack_core::{Task, Warning};
use lumistack_plugin_host::{OutputData, Registry};
use lumistack_report::{GraphInput, GraphNode};
use serde::Serialize;

use crate::error::{PipelineError, display_error};
use crate::files::{remove_reports, write_report};
use crate::job::{Job, NodeJob, OutputJob};
use crate::run::{Moment, Run, Summary, Tee};
use crate::sequence::thumbnails;

/// What one node ended with.
#[derive(Clone, Debug, Serialize)]
pub struct NodeSummary {
    /// Its name.
    pub id: String,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of L̃ against βL, dB.
    pub psnr_raw: f64,
    /// PSNR at in-between views, dB.
    pub psnr_held_out: Option<f64>,
}

/// Runs a job with nodes into `dir`.
///
/// # Errors
/// When any stage fails or is cancelled; finished stages are kept and taken up by the next run.
pub(crate) fn run(
    job: &Job,
    dir: &Path,
    registry: &Registry,
    command: Option<&str>,
    task: Task<'_>,
) -> Result<Summary, PipelineError> {
    let start = Instant::now();
    let warnings = Tee::new(task.warnings);
    let task = Task { warnings: &warnings, ..task };
    job.check()?;
    let mut run = Run::open(job, dir, registry)?;
    let jobs: Vec<Job> = job.nodes.iter().map(|node| job_of(job, node)).collect();
    let folder = |node: &NodeJob| dir.join("nodes").join(&node.id);
    // found out before an hour of rendering, not after
    for (node, job) in job.nodes.iter().zip(&jobs) {
        Run::of_node(job, node, &folder(node), registry)?;
    }

    let mut input = run.input(&Moment::default(), task)?;
    let shared: Vec<Warning> = warnings.list.take();
    run.write_settings(&run.display)?;
    remove_reports(dir)?;
    let (display, field) = (run.display.clone(), OutputData::LightField(&input.target));
    let of_field = format!("outputs/{}", OutputJob::LIGHT_FIELD);
    let field_outputs = run.write_outputs(OutputJob::LIGHT_FIELD, &of_field, &display, field, task)?;

    let mut all = shared.clone();
    let (mut nodes, mut summaries, mut wanted) = (Vec::new(), Vec::new(), None);
    for (node, node_job) in job.nodes.iter().zip(&jobs) {
        let began = Instant::now();
        let mut part = Run::of_node(node_job, node, &folder(node), registry)?;
        part.display = match node.display {
            Some(_) => {
                let adapted = part.display.adapted_to(input.target.geometry());
                let adapted = adapted.map_err(|source| display_error(source, &format!("node `{}`", node.id)))?;
                if let Some(change) = part.display.backlight_change(&adapted) {
                    task.warn(format!("node {}", node.id), change);
                }
                adapted
            }
            None => display.clone(),
        };
        part.display.check().map_err(|source| display_error(source, &format!("node `{}`", node.id)))?;
        let cache = folder(node).join("cache");
        std::fs::create_dir_all(&cache).map_err(PipelineError::write(&cache))?;
        // the stages that lead to the light field
        part.stages.clone_from(&run.stages);
        let made = part.patterns(input, None, task)?;
        let own = warnings.list.take();
        let told: Vec<Warning> = shared.iter().chain(&own).cloned().collect();
        all.extend(own);
        let report = part.report(&made, &told, command, task)?;
        let [target, shown] = thumbnails(&part, &made);
        wanted.get_or_insert(target);
        let from_root = |path: &str| path.trim_start_matches("../").to_string();
        nodes.push(GraphNode {
            id: node.id.clone(),
            plugin: node.plugin.clone(),
            display: part.display.name.clone(),
            report: format!("nodes/{}/report.html", node.id),
            psnr_view: report.psnr_view,
            psnr_raw: report.psnr_raw,
            held_out_psnr_view: report.held_out_psnr_view,
            brightness: made.stack.brightness,
            layers: made.stack.layers.len(),
            frames: made.stack.frames(),
            seconds: began.elapsed().as_secs_f64(),
            outputs: made
                .outputs
                .iter()
                .cloned()
                .map(|o| lumistack_report::Output { path: from_root(&o.path), ..o })
                .collect(),
            shown,
        });
        summaries.push(NodeSummary {
            id: node.id.clone(),
            psnr_view: report.psnr_view,
            psnr_raw: report.psnr_raw,
            psnr_held_out: report.held_out_psnr_view,
        });
        input = made.input;
    }

    let (Some(wanted), Some(first)) = (wanted, summaries.first()) else {
        return Err(PipelineError::value("job", "nodes", "at least one node", "none"));
    };
    // of the job's own display, through which the window was placed
    let depth = input.depth;
    let (psnr, psnr_held_out) = ([first.psnr_view, first.psnr_raw], first.psnr_held_out);
    let settings = job.to_json();
    let (html, json) = lumistack_report::graph(&GraphInput {
        title: &job.name,
        wanted: &wanted,
        nodes: &nodes,
        outputs: &field_outputs,
        settings: &settings,
        warnings: &all,
        command,
        version: env!("CARGO_PKG_VERSION"),
    })
    .map_err(PipelineError::Report)?;
    write_report(dir, &html, &json)?;
    Ok(Summary { psnr_held_out, nodes: summaries, ..Summary::new(dir, psnr, depth.as_ref(), start) })
}

/// The plain job that a node stands for, given the light field.
fn job_of(job: &Job, node: &NodeJob) -> Job {
    Job {
        name: format!("{}: {}", job.name, node.id),
        display: node.display.clone().unwrap_or_else(|| job.display.clone()),
        factorize: node.factorize.clone().unwrap_or_else(|| job.factorize.clone()),
        outputs: job.outputs_of(&node.id).cloned().map(|output| OutputJob { from: None, ..output }).collect(),
        nodes: Vec::new(),
        ..job.clone()
    }
}
