//! Steps that write reports of a display, of a graph or of a sequence.

use std::path::Path;

use lumistack_core::Task;
use lumistack_report::{GraphInput, GraphNode, Output, SequenceInput, SequenceSeries, SequenceTime};

use super::context::{Context, Reported, State};
use crate::error::PipelineError;
use crate::plan::steps::PartKind;
use crate::stage::output;
use crate::stage::report::{self, ReportContent, thumbnails};
use crate::store::code;
use crate::store::key::KeyBuilder;
use crate::store::settings::write_job;

impl Context<'_> {
    pub(super) fn report(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (plan, job, stamps) = (self.plan, self.job(part), self.stamps(part));
        let (field, of_field) = (self.field(part)?, plan.field_part(part));
        let patterns = self.of(part, "patterns", |state| state.patterns.clone())?;
        let is_time = matches!(plan.parts[part].kind, PartKind::Time(_));
        // The report of a time step has a key, and is reused if the key is current. Other reports
        // are always written, since they contain the duration of this run's stages.
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
        // The report of a node includes the stages of the light field.
        let warnings = self.warnings(|other| other == part || other == of_field);
        let mut stages = self.states[of_field].stages.clone();
        if of_field != part {
            stages.extend_from_slice(&self.states[part].stages);
        }
        let references = self.states[of_field].references.clone();
        let about = ReportContent {
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
        // The stamp is written last. If a run is killed before it writes the stamp, the next run
        // writes the report again.
        if let Some(key) = key {
            stamps.write("report", &key, &["report.html".into(), "report.json".into()])?;
        }
        let shown = (of_field != part).then(|| thumbnails(&patterns.display, &field, &patterns.solved));
        self.states[part].reported = Some(Reported { report, shown });
        Ok(false)
    }

    pub(super) fn report_graph(&mut self, part: usize) -> Result<bool, PipelineError> {
        let (plan, job) = (self.plan, self.job(part));
        // Make one row per node, with paths relative to the run folder.
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
        // The report of the graph compares all nodes with the same target.
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

    pub(super) fn report_sequence(&mut self, part: usize) -> Result<bool, PipelineError> {
        let (plan, job) = (self.plan, self.job(part));
        write_job(&job, &self.dir(part))?;
        // Make one series of time steps per display: one series without nodes, or one for each
        // node.
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
        // The report of the sequence shows all series over the time steps.
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
