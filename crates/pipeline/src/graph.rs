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
use lumistack_display::{Display, FieldGeometry};
use lumistack_plugin_host::{OutputData, Registry};
use lumistack_report::{GraphInput, GraphNode};
use serde::Serialize;

use crate::error::{FailedOutput, PipelineError, display_error};
use crate::job::{Job, NodeJob, OutputJob};
use crate::run::{Moment, Run, Summary, Tee, failed_of};
use crate::sequence::thumbnails;
use crate::store::files::{remove_reports, write_report};
use crate::store::lock::take_known;
use crate::store::used;

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
    /// PSNR of seen pictures all over the zone, dB.
    pub psnr_zone: Option<f64>,
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
    let folder_of = |node: &NodeJob| dir.join("nodes").join(&node.id);
    // the part of every node, its outputs opened against its display on this light field
    let parts = |run: &Run<'_>, geometry: &FieldGeometry| -> Result<(), PipelineError> {
        run.check_outputs(task)?;
        for (node, job) in job.nodes.iter().zip(&jobs) {
            let mut part = Run::of_node(job, node, &folder_of(node), registry)?;
            part.take_display(node, &run.display, geometry)?;
            part.check_outputs(task)?;
        }
        Ok(())
    };
    if job.scene.is_some() {
        // found out before an hour of rendering, not after
        let geometry = run.display.geometry().map_err(|source| display_error(source, "field"))?;
        parts(&run, &geometry)?;
    } else {
        for (node, job) in job.nodes.iter().zip(&jobs) {
            Run::of_node(job, node, &folder_of(node), registry)?;
        }
    }

    let mut input = run.input(&Moment::default(), task)?;
    if job.scene.is_none() {
        parts(&run, input.target.geometry())?;
    }
    run.write_settings(&run.display)?;
    remove_reports(dir)?;
    let (display, field) = (run.display.clone(), OutputData::LightField(&input.target));
    let of_field = format!("outputs/{}", OutputJob::LIGHT_FIELD);
    let field_outputs = run.write_outputs(OutputJob::LIGHT_FIELD, &of_field, &display, field, task)?;
    let mut failed = failed_of(&field_outputs, "");
    let shared: Vec<Warning> = warnings.list.take();

    let mut all = shared.clone();
    let (mut nodes, mut summaries, mut wanted) = (Vec::new(), Vec::new(), None);
    for (node, node_job) in job.nodes.iter().zip(&jobs) {
        let began = Instant::now();
        let mut part = Run::of_node(node_job, node, &folder_of(node), registry)?;
        let _owned = take_known(&folder_of(node), task)?;
        if let Some(change) = part.take_display(node, &display, input.target.geometry())? {
            task.warn(format!("node {}", node.id), change);
        }
        // the stages that lead to the light field
        part.stages.clone_from(&run.stages);
        let made = part.patterns(input, None, task)?;
        let own = warnings.list.take();
        let told: Vec<Warning> = shared.iter().chain(&own).cloned().collect();
        all.extend(own);
        let report = part.report(&made, &told, command, task)?;
        failed.extend(
            failed_of(&made.outputs, "")
                .into_iter()
                .map(|output| FailedOutput { path: output.path.trim_start_matches("../").into(), ..output }),
        );
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
            psnr_zone: report.psnr_zone,
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
            psnr_zone: report.psnr_zone,
        });
        input = made.input;
    }

    let (Some(wanted), Some(first)) = (wanted, summaries.first()) else {
        return Err(PipelineError::value("job", "nodes", "at least one node", "none"));
    };
    // of the job's own display, through which the window was placed
    let depth = &input.depth;
    let (psnr, psnr_held_out, psnr_zone) = ([first.psnr_view, first.psnr_raw], first.psnr_held_out, first.psnr_zone);
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
    used::keep_only_views(dir, &input.views)?;
    Ok(Summary {
        failed_outputs: failed,
        psnr_held_out,
        psnr_zone,
        nodes: summaries,
        ..Summary::new(dir, psnr, depth.as_ref(), start)
    })
}

impl Run<'_> {
    /// Gives the part of a node its display on a light field of this geometry: its own, or else the job's, `shared`. Returns how its backlight had to change.
    fn take_display(
        &mut self,
        node: &NodeJob,
        shared: &Display,
        geometry: &FieldGeometry,
    ) -> Result<Option<String>, PipelineError> {
        let mut change = None;
        self.display = match node.display {
            Some(_) => {
                let adapted = self.display.adapted_to(geometry);
                let adapted = adapted.map_err(|source| display_error(source, &format!("node `{}`", node.id)))?;
                change = self.display.backlight_change(&adapted);
                adapted
            }
            None => shared.clone(),
        };
        self.display.check().map_err(|source| display_error(source, &format!("node `{}`", node.id)))?;
        Ok(change)
    }
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
