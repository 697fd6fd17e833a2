//! A design of a sweep is solved on the light fields of all times, for every node, and scored.
//!
//! A figure over several times is that of all their rays together, as in the report of a sequence; beside it stands the worst time's. A node without a display of its
//! own takes the design's, any other keeps its own and is the same for all designs: a baseline.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_core::metrics::SquaredError;
use lumistack_core::{Cancel, NoProgress, Task, Warning, Warnings};
use lumistack_design::table::{Design, MOST_DB, NodeRow, Row};
use lumistack_display::{Display, LayerStack, LightField, Weights, ZoneScore, score};
use lumistack_plugin_host::Registry;

use super::device::Site;
use super::factorize::Solve;
use super::field::{Field, add_weights, eye_weights};
use super::node;
use super::node::Given;
use super::score::References;
use crate::error::{PipelineError, display_error};
use crate::job::{FactorizeJob, Job, NodeJob};
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::KeyBuilder;

/// A design to solve.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) design: Design,
    pub(crate) display: Display,
    /// Its light fields, by number.
    pub(crate) field: usize,
}

/// Light fields that several designs share, one per time.
pub(crate) struct Shared {
    times: Vec<Arc<Field>>,
    /// The scene's pictures all over the zone, of a still.
    references: Option<Arc<References>>,
    /// Hash of all of it.
    key: String,
}

impl Shared {
    /// # Errors
    /// When expected eyes make no sense.
    pub(crate) fn new(
        times: Vec<Arc<Field>>,
        references: Option<Arc<References>>,
        job: &Job,
    ) -> Result<Self, PipelineError> {
        let mut key = KeyBuilder::new("sweep field", code::FIELDS);
        for time in &times {
            for field in [Some(&time.target), time.held_out.as_ref()].into_iter().flatten() {
                key.add("geometry", format!("{:?}", field.geometry()).as_bytes());
                key.add_f32("radiance", field.radiance().data());
            }
            add_weights(&mut key, &eye_weights(&job.factorize, time.target.geometry())?);
        }
        if let Some(references) = &references {
            key.add("references", references.key.as_bytes());
        }
        Ok(Self { times, references, key: key.finish() })
    }
}

/// How the later times of a sequence are factorized: from patterns, and where those are no start.
pub(crate) type Later = Box<dyn Fn(&FactorizeJob) -> [FactorizeJob; 2] + Send + Sync>;

/// Solves designs and keeps their rows.
pub(crate) struct Solver<'a> {
    pub(crate) job: &'a Job,
    pub(crate) fields: Vec<Option<Shared>>,
    /// Of the rows.
    pub(crate) folder: PathBuf,
    pub(crate) later: Later,
    pub(crate) registry: &'a Registry,
}

/// Warnings about one design among a hundred tell nobody anything.
struct Silent;

impl Warnings for Silent {
    fn warn(&self, _warning: Warning) {}
}

/// Errors of a display at one time.
struct Errors {
    target: SquaredError,
    zone: Option<ZoneScore>,
    between: Option<SquaredError>,
    brightness: f64,
}

impl Solver<'_> {
    /// The row of a design, the name of its file, and whether it was there already.
    ///
    /// # Errors
    /// When the design makes no sense or cannot be solved, its row cannot be kept, or when cancelled.
    pub(crate) fn solve(
        &self,
        candidate: &Candidate,
        iterations: u32,
        cancel: &Cancel,
    ) -> Result<(Row, String, bool), PipelineError> {
        cancel.check()?;
        let Some(Some(shared)) = self.fields.get(candidate.field) else {
            return Err(PipelineError::job("sweep", "a light field for every design", "none"));
        };
        let display = self.display_on(candidate, shared)?;
        display.check().map_err(|source| display_error(source, &candidate.design.display))?;
        let job = &self.job.factorize;
        let mut key = KeyBuilder::new("design", code::DESIGNS);
        key.add("field", shared.key.as_bytes())
            .add("name", candidate.design.display.as_bytes())
            .add("display", Display { name: String::new(), ..display.clone() }.to_toml().as_bytes())
            .add_json("settings", &(&job.solver, iterations, &job.start, self.job.seed))
            .add_json("coarse and levels", &(job.coarse_levels, job.coarse_iterations, job.levels));
        if shared.times.len() > 1 {
            key.add_json("later times", &(self.later)(job));
        }
        if !self.job.nodes.is_empty() {
            key.add_json("nodes", &self.job.nodes);
        }
        let name = format!("{}.json", &key.finish()[..24]);
        let path = self.folder.join(&name);
        if let Some(row) = read_json::<Row>(&path).filter(|row| row.design == candidate.design) {
            return Ok((row, name, true));
        }
        let row = self.row(candidate, &display, shared, iterations, cancel)?;
        write_json(&path, &row)?;
        Ok((row, name, false))
    }

    /// A light field that was read has a geometry of its own, to which the display adapts.
    fn display_on(&self, candidate: &Candidate, shared: &Shared) -> Result<Display, PipelineError> {
        match (&self.job.scene, shared.times.first()) {
            (None, Some(first)) => {
                let adapted = candidate.display.adapted_to(first.target.geometry());
                adapted.map_err(|source| display_error(source, "light field"))
            }
            _ => Ok(candidate.display.clone()),
        }
    }

    fn row(
        &self,
        candidate: &Candidate,
        display: &Display,
        shared: &Shared,
        iterations: u32,
        cancel: &Cancel,
    ) -> Result<Row, PipelineError> {
        let nodes: Vec<Option<&NodeJob>> =
            if self.job.nodes.is_empty() { vec![None] } else { self.job.nodes.iter().map(Some).collect() };
        let mut rows = Vec::new();
        for node in nodes {
            let times = self.times(node, display, shared, iterations, cancel)?;
            rows.push(node_row(node.map_or("", |node| &node.id), &times));
        }
        let of_nodes = if self.job.nodes.is_empty() { Vec::new() } else { rows.clone() };
        // the figures of all are the first one's
        let first = rows.swap_remove(0);
        Ok(Row {
            design: candidate.design.clone(),
            psnr_zone_db: first.psnr_zone_db,
            psnr_zone_worst_tenth_db: first.psnr_zone_worst_tenth_db,
            psnr_view_db: first.psnr_view_db,
            psnr_raw_db: first.psnr_raw_db,
            psnr_between_db: first.psnr_between_db,
            psnr_worst_db: first.psnr_worst_db,
            nodes: of_nodes,
        })
    }

    /// The errors of a display at all times, each from the patterns of the time before.
    fn times(
        &self,
        of_node: Option<&NodeJob>,
        design: &Display,
        shared: &Shared,
        iterations: u32,
        cancel: &Cancel,
    ) -> Result<Vec<Errors>, PipelineError> {
        // bars of many designs at once would be noise
        let task = Task { progress: &NoProgress, warnings: &Silent, cancel };
        let own = of_node.and_then(|node| node.display.as_ref()).map(|display| display.resolve()).transpose()?;
        let factorize = of_node.and_then(|node| node.factorize.as_ref()).unwrap_or(&self.job.factorize);
        let first = FactorizeJob { iterations: Some(iterations), ..factorize.clone() };
        let mut before: Option<LayerStack> = None;
        let mut all = Vec::new();
        for field in &shared.times {
            let target = &field.target;
            let display = match (of_node, &own) {
                (Some(of_node), Some(own)) => node::display(of_node, own, design, target.geometry())?.0,
                _ => design.clone(),
            };
            let weights = eye_weights(factorize, target.geometry())?;
            let stack = match of_node.filter(|of_node| !node::is_factorized(Some(of_node))) {
                Some(node) => {
                    let given = Given { node, seed: self.job.seed, display: &display, target, weights: &weights };
                    node::make(given, self.registry, task)?.0
                }
                None => {
                    let weights = &weights;
                    let solve = Solve { job: &first, seed: self.job.seed, display: &display, target, weights };
                    match &before {
                        None => solve.factorize(&Site::Processor, None, task, &mut |_| {})?.stack,
                        Some(before) => {
                            let [warm, fresh] = (self.later)(factorize);
                            let fresh = Solve { job: &fresh, ..solve };
                            match fresh.warm_start_pays(before, &warm.solver, task)? {
                                true => {
                                    Solve { job: &warm, ..solve }
                                        .factorize(&Site::Processor, Some(before), task, &mut |_| {})?
                                        .stack
                                }
                                false => fresh.factorize(&Site::Processor, None, task, &mut |_| {})?.stack,
                            }
                        }
                    }
                }
            };
            let error = |field: &LightField, weights: &Weights| {
                let views = score(&display, &stack, field, weights).views.into_iter();
                views.fold(SquaredError::default(), |sum, view| sum.merged(view.error))
            };
            let between = field.held_out.as_ref().map(|field| error(field, &Weights::Uniform));
            let zone =
                shared.references.as_ref().map(|references| references.score(&display, &stack, task)).transpose()?;
            all.push(Errors { target: error(target, &weights), zone, between, brightness: stack.brightness });
            before = Some(stack);
        }
        Ok(all)
    }
}

fn node_row(id: &str, times: &[Errors]) -> NodeRow {
    let cut = |psnr: f64| psnr.min(MOST_DB);
    let all = times.iter().fold(SquaredError::default(), |sum, time| sum.merged(time.target)).psnr();
    let brightness = times.last().map_or(1.0, |time| time.brightness);
    let between = times.iter().filter_map(|time| time.between).reduce(SquaredError::merged).map(SquaredError::psnr);
    let worst = times.iter().map(|time| time.target.psnr()).fold(f64::INFINITY, f64::min);
    // of a still alone
    let zone = times.first().and_then(|time| time.zone.as_ref());
    NodeRow {
        id: id.into(),
        psnr_zone_db: zone.and_then(ZoneScore::psnr).map(cut),
        psnr_zone_worst_tenth_db: zone.and_then(ZoneScore::worst_tenth).map(cut),
        psnr_view_db: cut(all),
        psnr_raw_db: cut(all - 20.0 * brightness.log10()),
        psnr_between_db: between.filter(|psnr| !psnr.is_nan()).map(cut),
        psnr_worst_db: (times.len() > 1).then(|| cut(worst)),
    }
}
