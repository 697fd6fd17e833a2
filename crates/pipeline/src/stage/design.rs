//! Solves a design of a sweep for every node, on the light fields of all time steps, and scores the
//! design.
//!
//! A score over several time steps is the score of all their rays together, as in the report of a
//! sequence. The score of the worst time step is in another column.
//!
//! A node without a display of its own has the display of the design. The scores of the other nodes
//! are baselines: they are the same for all designs with the same light field.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_core::metrics::SquaredError;
use lumistack_core::{Cancel, NoProgress, Task, Warning, Warnings};
use lumistack_design::table::{Design, MOST_DB, NodeRow, Row};
use lumistack_display::{Display, LayerStack, LightField, Weights, ZoneScore, score};
use lumistack_plugin_host::Registry;

use super::device::SolverDevice;
use super::factorize::Solve;
use super::field::{Field, add_weights, weights};
use super::node;
use super::node::NodeInput;
use super::score::References;
use crate::error::{PipelineError, display_error};
use crate::job::{FactorizeJob, Job, NodeJob};
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::{KeyBuilder, content_hash};
use crate::store::plugin_files::plugin_key;

/// A design to solve, with its display.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) design: Design,
    pub(crate) display: Display,
    /// Index of the light fields that the design needs.
    pub(crate) field: usize,
}

/// Light fields that several designs share, one per time step.
pub(crate) struct Shared {
    times: Vec<Arc<Field>>,
    /// For each time step, the scene's pictures over the viewing zone, if there are any.
    references: Vec<Option<Arc<References>>>,
    /// Hash of all light fields, weights and references.
    key: String,
}

impl Shared {
    /// Computes the hash of the light fields.
    ///
    /// # Errors
    /// If expected eye positions are invalid, or the weights do not match a light field.
    pub(crate) fn new(
        times: Vec<Arc<Field>>,
        references: Vec<Option<Arc<References>>>,
        job: &Job,
    ) -> Result<Self, PipelineError> {
        let mut key = KeyBuilder::new("sweep field", code::FIELDS);
        for time in &times {
            for field in [Some(&time.target), time.held_out.as_ref()].into_iter().flatten() {
                key.add("geometry", format!("{:?}", field.geometry()).as_bytes());
                key.add_field("radiance", field);
            }
            add_weights(&mut key, &weights(&job.factorize, time.target.geometry())?);
        }
        for references in references.iter().flatten() {
            key.add("references", references.key.as_bytes());
        }
        Ok(Self { times, references, key: key.finish() })
    }
}

/// A function that converts the settings of the first time step to those of later time steps: [with
/// a warm start, without a warm start].
pub(crate) type Later = Box<dyn Fn(&FactorizeJob) -> [FactorizeJob; 2] + Send + Sync>;

/// Solves designs and writes their rows.
pub(crate) struct Solver<'a> {
    pub(crate) job: &'a Job,
    pub(crate) fields: Vec<Option<Shared>>,
    /// Folder of the rows' files.
    pub(crate) folder: PathBuf,
    later: Later,
    registry: &'a Registry,
    /// Hash of everything about the job's nodes on which rows depend.
    nodes: String,
}

/// Returns the hash of a job's nodes: their settings, the content of their files, and the code of
/// their plugins.
fn nodes_key(job: &Job, registry: &Registry) -> Result<String, PipelineError> {
    let mut key = KeyBuilder::new("nodes", code::DESIGNS);
    for node in &job.nodes {
        key.add_json("node", node);
        if let Some(display) = &node.display {
            key.add("display", display.resolve()?.to_toml().as_bytes());
        }
        if !node::is_factorized(Some(node)) {
            key.add("plugin", plugin_key(registry, &node.plugin, &node.params)?.as_bytes());
        }
        if let Some(path) = node.factorize.as_ref().and_then(|own| own.weights.as_ref()) {
            let hash = content_hash(path).map_err(|source| PipelineError::Read { path: path.clone(), source })?;
            key.add("weights", hash.as_bytes());
        }
    }
    Ok(key.finish())
}

/// Drops warnings, since a warning for each design of a large sweep has no use.
struct Silent;

impl Warnings for Silent {
    fn warn(&self, _warning: Warning) {}
}

/// Errors of a display at one time step.
struct Errors {
    target: SquaredError,
    zone: Option<ZoneScore>,
    between: Option<SquaredError>,
    brightness: f64,
}

impl<'a> Solver<'a> {
    /// Makes a solver.
    ///
    /// # Errors
    /// If a node's display is invalid, its plugin is missing, or one of its files cannot be read.
    pub(crate) fn new(
        job: &'a Job,
        fields: Vec<Option<Shared>>,
        folder: PathBuf,
        later: Later,
        registry: &'a Registry,
    ) -> Result<Self, PipelineError> {
        Ok(Self { job, fields, folder, later, registry, nodes: nodes_key(job, registry)? })
    }

    /// Returns the row of a design, the name of the row's file, and true if the row was cached.
    ///
    /// # Errors
    /// If the design is invalid, the solver fails, the row cannot be written, or the task is
    /// cancelled.
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
        // The key contains everything that the row depends on.
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
            // Only if `iterations` is the job's number of iterations, each node has all iterations
            // of its own settings; see `times`.
            key.add("nodes", self.nodes.as_bytes()).add_json("is whole", &(iterations == job.iterations()));
        }
        let name = format!("{}.json", &key.finish()[..24]);
        let path = self.folder.join(&name);
        // Use a cached row only if it describes this design.
        if let Some(row) = read_json::<Row>(&path).filter(|row| row.design == candidate.design) {
            return Ok((row, name, true));
        }
        let row = self.row(candidate, &display, shared, iterations, cancel)?;
        write_json(&path, &row)?;
        Ok((row, name, false))
    }

    /// Returns the display of a design. If the light field is not rendered, the display is adapted
    /// to the geometry of the light field.
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
        // The design's scores are the scores of the first node.
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

    /// Solves a display for all time steps. The solver starts each time step from the patterns of
    /// the previous time step, unless a fresh start is better.
    fn times(
        &self,
        of_node: Option<&NodeJob>,
        design: &Display,
        shared: &Shared,
        iterations: u32,
        cancel: &Cancel,
    ) -> Result<Vec<Errors>, PipelineError> {
        // Designs are solved in parallel, so messages about their progress would mix.
        let task = Task { progress: &NoProgress, warnings: &Silent, cancel };
        let own = of_node.and_then(|node| node.display.as_ref()).map(|display| display.resolve()).transpose()?;
        let factorize = of_node.and_then(|node| node.factorize.as_ref()).unwrap_or(&self.job.factorize);
        // A search first solves designs with few iterations. In these solves, a node has at most
        // this number of iterations. In all other solves, a node has its own number of iterations.
        let is_whole = iterations == self.job.factorize.iterations();
        let own_iterations = factorize.iterations();
        let iterations = if is_whole { own_iterations } else { iterations.min(own_iterations) };
        let first = FactorizeJob { iterations: Some(iterations), ..factorize.clone() };
        let mut before: Option<LayerStack> = None;
        let mut all = Vec::new();
        // If a node has its own display, adapt this display to the geometry of the light field.
        for (field, references) in shared.times.iter().zip(&shared.references) {
            let target = &field.target;
            let display = match (of_node, &own) {
                (Some(of_node), Some(own)) => node::display(of_node, own, design, target.geometry())?.0,
                _ => design.clone(),
            };
            let weights = weights(factorize, target.geometry())?;
            // Make the patterns: by a node plugin, or by a solver with or without a warm start.
            let stack = match of_node.filter(|of_node| !node::is_factorized(Some(of_node))) {
                Some(node) => {
                    let given = NodeInput { node, seed: self.job.seed, display: &display, target, weights: &weights };
                    node::make(given, self.registry, task)?.0
                }
                None => {
                    let weights = &weights;
                    let solve = Solve { job: &first, seed: self.job.seed, display: &display, target, weights };
                    match &before {
                        None => solve.factorize(&SolverDevice::Processor, None, task, &mut |_| {})?.stack,
                        Some(before) => {
                            let [warm, fresh] = (self.later)(factorize);
                            let fresh = Solve { job: &fresh, ..solve };
                            match fresh.warm_start_pays(before, &warm.solver, task)? {
                                true => {
                                    Solve { job: &warm, ..solve }
                                        .factorize(&SolverDevice::Processor, Some(before), task, &mut |_| {})?
                                        .stack
                                }
                                false => fresh.factorize(&SolverDevice::Processor, None, task, &mut |_| {})?.stack,
                            }
                        }
                    }
                }
            };
            // Score the patterns at the target views, between them, and over the viewing zone.
            let error = |field: &LightField, weights: &Weights| {
                let views = score(&display, &stack, field, weights).views.into_iter();
                views.fold(SquaredError::default(), |sum, view| sum.merged(view.error))
            };
            let between = field.held_out.as_ref().map(|field| error(field, &Weights::Uniform));
            let zone = references.as_ref().map(|references| references.score(&display, &stack, task)).transpose()?;
            all.push(Errors { target: error(target, &weights), zone, between, brightness: stack.brightness });
            before = Some(stack);
        }
        Ok(all)
    }
}

fn node_row(id: &str, times: &[Errors]) -> NodeRow {
    // Without rays to score, a PSNR is NaN. Then there is no score.
    let cut = |psnr: f64| (!psnr.is_nan()).then(|| psnr.min(MOST_DB));
    let all = times.iter().fold(SquaredError::default(), |sum, time| sum.merged(time.target)).psnr();
    let brightness = times.last().map_or(1.0, |time| time.brightness);
    let between = times.iter().filter_map(|time| time.between).reduce(SquaredError::merged).map(SquaredError::psnr);
    let worst = times.iter().filter_map(|time| cut(time.target.psnr())).reduce(f64::min);
    // The directions of all time steps have the same weight.
    let directions = times.iter().filter_map(|time| time.zone.as_ref()).flat_map(|zone| &zone.directions);
    let zone = ZoneScore { directions: directions.cloned().collect() };
    NodeRow {
        id: id.into(),
        psnr_zone_db: zone.psnr().and_then(cut),
        psnr_zone_worst_tenth_db: zone.worst_tenth().and_then(cut),
        psnr_view_db: cut(all),
        psnr_raw_db: cut(all - 20.0 * brightness.log10()),
        psnr_between_db: between.and_then(cut),
        psnr_worst_db: worst.filter(|_| times.len() > 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(target: SquaredError) -> Errors {
        Errors { target, zone: None, between: Some(SquaredError::default()), brightness: 0.5 }
    }

    #[test]
    fn no_scored_ray_is_no_score() {
        let [none, some] = [SquaredError::default(), SquaredError { sum: 2.0, count: 200 }].map(errors);
        let row = node_row("a", &[none, errors(SquaredError::default())]);
        assert_eq!((row.psnr_view_db, row.psnr_raw_db, row.psnr_worst_db), (None, None, None));
        let row = node_row("a", &[errors(SquaredError::default()), some]);
        assert_eq!((row.psnr_view_db, row.psnr_worst_db, row.psnr_between_db), (Some(20.0), Some(20.0), None));
        let exact = node_row("a", &[errors(SquaredError { sum: 0.0, count: 3 })]);
        assert_eq!((exact.psnr_view_db, exact.psnr_worst_db), (Some(MOST_DB), None));
    }
}
