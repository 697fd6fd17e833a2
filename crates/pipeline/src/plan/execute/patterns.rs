//! The step that makes the patterns of a display from a light field, by the solver or a node
//! plugin.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, Region, Tile};

use super::context::{Context, Patterns};
use crate::error::{PipelineError, display_error, field_error};
use crate::job::{FactorizeJob, Job};
use crate::plan::steps::PartKind;
use crate::plan::times::{WARM_UP, name};
use crate::stage::factorize::Solve;
use crate::stage::fields::Block;
use crate::stage::node::NodeInput;
use crate::stage::tiles::CutSolve;
use crate::stage::{field, node, tiles};
use crate::store::files::remove_reports;
use crate::store::settings::{write_display, write_job};
use crate::store::stamps::Stamps;

impl Context<'_> {
    pub(super) fn patterns(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (plan, mut job, field, stamps) = (self.plan, self.job(part), self.field(part)?, self.stamps(part));
        let of_node = plan.node(part);
        let display = self.display(part, &field.display, field.target.geometry(), task)?;
        // Warn only for a display file, since it describes real panels, which may flicker. A preset
        // is a design, and its report states the required refresh rate.
        if let Some(message) = display.flicker_warning().filter(|_| job.display.file.is_some()) {
            task.warn("display", message);
        }
        let weights = field::weights(&job.factorize, field.target.geometry())?;
        let target = &field.target;
        // Solve, or read the cached patterns. If the content changes too much between two time
        // steps, the solver does not start from the previous patterns.
        let (solved, cached) = match of_node.filter(|of_node| !node::is_factorized(Some(of_node))) {
            Some(node) => {
                let given = NodeInput { node, seed: job.seed, display: &display, target, weights: &weights };
                node::run(given, &stamps, self.registry, task)?
            }
            None => {
                self.warm_up(part, &display, task)?;
                let solve = Solve { job: &job.factorize, seed: job.seed, display: &display, target, weights: &weights };
                let fresh_start = match self.fresh(part) {
                    Some(fresh) if tiles::prefers_fresh_start(solve, &fresh, &stamps, task)? => Some(fresh),
                    _ => None,
                };
                if let Some(fresh) = fresh_start {
                    job = self.drop_warm_start(part, fresh)?;
                }
                let solve = Solve { job: &job.factorize, seed: job.seed, display: &display, target, weights: &weights };
                tiles::run(solve, &stamps, task)?
            }
        };
        // Write the settings only after the solve. If this run stops earlier, the folder keeps the
        // settings, patterns and report of the previous run, which match each other.
        let dir = self.dir(part);
        if of_node.is_none() {
            write_job(&job, &dir)?;
        }
        write_display(&dir.join("display.toml"), &display)?;
        let mut above = (!cached).then_some(part);
        while let Some(part) = above {
            // Remove the reports of the part and of its ancestors, since these reports describe
            // older patterns.
            remove_reports(&self.dir(part))?;
            above = plan.parts[part].parent;
        }
        self.states[part].brightness = solved.stack.brightness;
        self.states[part].patterns = Some(Arc::new(Patterns { display, weights, solved, cached }));
        Ok(cached)
    }

    /// Solves a tile of a still's patterns in one round. Tiles exchange their borders between
    /// rounds.
    pub(super) fn patterns_tile(
        &mut self,
        part: usize,
        round: usize,
        block: Block,
        task: Task<'_>,
    ) -> Result<(), PipelineError> {
        let (job, stamps, of_field) = (self.job(part), self.stamps(part), self.plan.field_part(part));
        let shared = self.job(of_field).resolve_display()?;
        let geometry = shared.geometry().map_err(|source| display_error(source, "display"))?;
        let display = self.display(part, &shared, &geometry, task)?;
        let weights = field::weights(&job.factorize, &geometry)?;
        // An earlier unit wrote the light field; read only the region that the tile needs.
        let target = self.dir(of_field).join("target");
        let crop = |tile: &Tile| {
            let Region { rows, cols } = tile.field.clone();
            lumistack_field_io::read_field_region(&target, tile.geometry(&geometry), rows, cols).map_err(field_error)
        };
        let (job, seed) = (&job.factorize, job.seed);
        let cut = CutSolve { job, seed, display: &display, geometry: &geometry, weights: &weights, crop: &crop };
        tiles::run_tile(cut, [round, block.number(), block.count()], &stamps, task)
    }

    /// Returns the display of a part. If the part is a node with its own display, this is the
    /// node's display, adapted to the light field. Otherwise it is `shared`, the display of the
    /// job.
    fn display(
        &mut self,
        part: usize,
        shared: &Display,
        geometry: &FieldGeometry,
        task: Task<'_>,
    ) -> Result<Display, PipelineError> {
        let job = self.job(part);
        let Some(node) = self.plan.node(part) else { return Ok(shared.clone()) };
        let (display, change) = node::display(node, &job.resolve_display()?, shared, geometry)?;
        if let Some(change) = change {
            task.warn(format!("node {}", node.id), change);
        }
        Ok(display)
    }

    /// Solves the time steps before a chunk again; the first of them has no warm start. The results
    /// are kept in files like other patterns.
    fn warm_up(&mut self, part: usize, display: &Display, task: Task<'_>) -> Result<(), PipelineError> {
        let plan = self.plan;
        let Some((time, sequence)) = plan.time(part) else { return Ok(()) };
        let PartKind::Sequence(times) = &plan.parts[sequence].kind else { return Ok(()) };
        let (of_field, node) = (plan.field_part(part), plan.node(part));
        let all = &plan.parts[sequence].job;
        let of_node = node.and_then(|node| all.nodes.iter().find(|other| other.id == node.id)?.factorize.as_ref());
        let first = FactorizeJob { warm_start: None, ..of_node.unwrap_or(&all.factorize).clone() };
        // Each time step starts from the patterns of the previous one.
        let mut before: Option<PathBuf> = None;
        for earlier in times.warm_up(time) {
            let of_earlier = plan.at_time(of_field, earlier).unwrap_or(of_field);
            let target = &self.field(of_earlier)?.target;
            let job = match before {
                None => first.clone(),
                Some(before) => times.warm(&first, Some(before.join("layers"))),
            };
            let place = self.dir(sequence).join(WARM_UP).join(name(time)).join(name(earlier));
            let place = node.map_or(place.clone(), |node| place.join("nodes").join(&node.id));
            std::fs::create_dir_all(place.join("cache")).map_err(PipelineError::write(&place))?;
            let weights = field::weights(&job, target.geometry())?;
            let solve = Solve { job: &job, seed: all.seed, display, target, weights: &weights };
            tiles::run(solve, &Stamps::new(&place), task)?;
            before = Some(place);
        }
        Ok(())
    }

    /// Returns the settings with which a time step is solved without a warm start. `None` for the
    /// first time step, and outside of a sequence.
    fn fresh(&self, part: usize) -> Option<FactorizeJob> {
        let (time, sequence) = self.plan.time(part)?;
        match &self.plan.parts[sequence].kind {
            PartKind::Sequence(times) if time > 0 => {
                let job = &self.plan.parts[sequence].job;
                let node = self.plan.node(part).and_then(|node| job.nodes.iter().find(|other| other.id == node.id));
                Some(times.fresh(job, node))
            }
            _ => None,
        }
    }

    /// Removes the warm start from the job of a part and, for a node, from the job that has the
    /// node.
    fn drop_warm_start(&mut self, part: usize, fresh: FactorizeJob) -> Result<Arc<Job>, PipelineError> {
        let of_field = self.plan.field_part(part);
        if let Some(id) = self.plan.node(part).map(|node| node.id.clone()) {
            let mut around = Job::clone(&*self.job(of_field));
            around.nodes.iter_mut().filter(|node| node.id == id).for_each(|node| node.factorize = Some(fresh.clone()));
            write_job(&around, &self.dir(of_field))?;
            self.states[of_field].job = Some(Arc::new(around));
        }
        let job = Arc::new(Job { factorize: fresh, ..Job::clone(&*self.job(part)) });
        self.states[part].job = Some(job.clone());
        Ok(job)
    }
}
