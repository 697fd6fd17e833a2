//! Units of work of a plan, which many machines execute in one run folder.
//!
//! ```text
//! place ─▶ trace 1-of-N ... ─▶ expose ─▶ factorize ─▶ results   of every time step and node
//!                                └─▶ factorize/round-1/1-of-N ... ─▶ round-2/... ─▶ factorize
//!                                                               of a still in tiles
//!     └──▶ score 1-of-N ... ────────────────────────▶ results
//! expose ─▶ designs 1-of-N ...                                  of a sweep
//! finish: all other steps, after all other units
//! ```
//!
//! Tracing is most of the work, and it writes pictures one by one. Therefore a unit that traces
//! executes only a block of a step's pictures. Short steps share a unit, since each unit must read
//! its inputs again.
//!
//! The last unit executes the whole run. It reuses all results, and makes damaged or missing
//! results again. So the bytes of results do not depend on how the plan is cut.

use std::collections::{BTreeSet, HashMap};

use lumistack_farm::{Kind as UnitKind, Unit};

use super::steps::{PartKind, Plan, Step, StepKind};
use crate::stage::node::{display as display_of_node, is_factorized};
use crate::stage::tiles::Tiles;

/// The id of the last unit.
pub(crate) const FINISH: &str = "finish";

/// Rule by which a plan is cut into units of work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockSize {
    /// Expected time of a block of pictures, seconds, above 0.
    pub block_seconds: f64,
    /// Number of blocks of each traced light field, and of its pictures for the zone score; at most
    /// the number of the target's views. Overrides `block_seconds`.
    pub blocks: Option<usize>,
}

impl Default for BlockSize {
    fn default() -> Self {
        Self { block_seconds: 20.0, blocks: None }
    }
}

/// Cuts a plan into units. The plan must have its estimates.
pub(crate) fn units(plan: &Plan, block_size: BlockSize) -> Vec<Unit> {
    let mut cutter = Cutter { plan, block_size, units: Vec::new(), made_by: HashMap::new() };
    for step in &plan.steps {
        cutter.add(step);
    }
    cutter.finish()
}

/// Time to join the tiles of a solve, as a fraction of the time of the whole solve.
const JOIN: f64 = 0.02;

/// Returns the tiles of a still's solve, and the memory of one tile in bytes. `None` if the part is
/// no still, a plugin makes its patterns, its job has no tiles, or its light field is not rendered.
fn tiles_of(plan: &Plan, part: usize) -> Option<(Tiles, u64)> {
    let field_part = plan.field_part(part);
    let (job, of_field) = (&plan.parts[part].job, &plan.parts[field_part].job);
    if !matches!(plan.parts[field_part].kind, PartKind::Run)
        || of_field.scene.is_none()
        || !is_factorized(plan.node(part))
    {
        return None;
    }
    let display = of_field.resolve_display().ok()?;
    let geometry = display.geometry().ok()?;
    let display = match plan.node(part) {
        None => display,
        Some(node) => display_of_node(node, &job.resolve_display().ok()?, &display, &geometry).ok()?.0,
    };
    let tiles = Tiles::of(&job.factorize, &display, &geometry)?;
    // A tile reads its pixels from one whole view at a time, so add the memory of a view.
    let bytes = tiles.bytes(&display, &geometry) + 12 * (geometry.rows * geometry.cols) as u64;
    Some((tiles, bytes))
}

struct Cutter<'a> {
    plan: &'a Plan,
    block_size: BlockSize,
    units: Vec<Unit>,
    /// For each step, the indices of the units that make its result.
    made_by: HashMap<&'a str, BTreeSet<usize>>,
}

impl<'a> Cutter<'a> {
    fn add(&mut self, step: &'a Step) {
        let kind = match step.kind {
            StepKind::Place if !matches!(self.plan.parts[step.part].kind, PartKind::Time(_)) => UnitKind::Place,
            StepKind::Trace => return self.add_blocks(step, UnitKind::Views, step.inputs.clone()),
            StepKind::Score => {
                // Directions of the zone score depend only on display and job, so units that render
                // the score's pictures do not wait for the light field.
                let place =
                    self.plan.steps.iter().filter(|other| other.part == step.part && other.kind == StepKind::Place);
                return self.add_blocks(step, UnitKind::Score, place.map(|step| step.id.clone()).collect());
            }
            StepKind::Read | StepKind::Source | StepKind::Expose => UnitKind::Field,
            StepKind::Patterns => {
                self.add_tiles(step);
                UnitKind::Patterns
            }
            StepKind::FieldOutput(_) | StepKind::StackOutput(_) | StepKind::Measure => return self.add_result(step),
            StepKind::Report if self.is_report_of_time(step) => return self.add_result(step),
            StepKind::Design(number) => return self.add_design(step, number),
            // Each unit that reads these results makes them again, so they get no unit of their
            // own.
            StepKind::Ingest | StepKind::Place | StepKind::Denoise => return self.pass(step),
            // The last unit makes these results, so they get no unit of their own.
            StepKind::Report | StepKind::Search => return,
        };
        let mut inputs = self.inputs(&step.inputs);
        // A solve in tiles waits for the tiles of the last round. The unit of this step then only
        // joins the tiles.
        let last = self.made_by.remove(step.id.as_str());
        inputs.extend(last.iter().flatten());
        let mut unit = self.unit(step, step.id.clone(), kind, inputs);
        if last.is_some() {
            unit.seconds *= JOIN;
        }
        for taken in self.merged_steps(step) {
            (unit.seconds, unit.memory_bytes) =
                (unit.seconds + taken.seconds, unit.memory_bytes.max(taken.memory_bytes));
        }
        self.push(step, unit);
    }

    /// Adds no unit for this step. Units that read the result of this step wait for the inputs of
    /// this step instead.
    fn pass(&mut self, step: &'a Step) {
        let inputs = self.inputs(&step.inputs);
        self.made_by.insert(&step.id, inputs);
    }

    fn unit(&self, step: &Step, id: String, kind: UnitKind, inputs: BTreeSet<usize>) -> Unit {
        Unit {
            id,
            kind,
            inputs: inputs.iter().map(|&input| self.units[input].id.clone()).collect(),
            steps: vec![step.id.clone()],
            block: None,
            round: None,
            writes: step.writes.iter().map(|name| self.place(step, name)).collect(),
            seconds: step.seconds,
            memory_bytes: step.memory_bytes,
        }
    }

    fn push(&mut self, step: &'a Step, unit: Unit) {
        self.made_by.entry(&step.id).or_default().insert(self.units.len());
        self.units.push(unit);
    }

    fn inputs(&self, steps: &[String]) -> BTreeSet<usize> {
        steps.iter().filter_map(|id| self.made_by.get(id.as_str())).flatten().copied().collect()
    }

    fn add_blocks(&mut self, step: &'a Step, kind: UnitKind, inputs: Vec<String>) {
        let inputs = self.inputs(&inputs);
        let views =
            self.plan.parts[step.part].job.resolve_display().map_or(1, |display| display.views().iter().product());
        let wanted = self.block_size.blocks.unwrap_or((step.seconds / self.block_size.block_seconds).ceil() as usize);
        let count = wanted.clamp(1, views.max(1));
        for number in 1..=count {
            let unit = self.unit(step, format!("{}/{number}-of-{count}", step.id), kind, inputs.clone());
            let seconds = step.seconds / count as f64;
            self.push(step, Unit { block: Some([number, count]), seconds, ..unit });
        }
    }

    /// Adds the tiles of a still's patterns, round by round. Adds nothing for a time step, since
    /// one unit solves all of its tiles.
    fn add_tiles(&mut self, step: &'a Step) {
        let Some((tiles, memory_bytes)) = tiles_of(self.plan, step.part) else { return };
        let (rounds, count) = (tiles.rounds(), tiles.count());
        let seconds = step.seconds / (rounds * count) as f64;
        // In a later round, a tile needs the borders of its neighbours from the previous round.
        let mut before: Vec<usize> = Vec::new();
        for round in 1..=rounds {
            let first = self.units.len();
            for number in 1..=count {
                let mut inputs = self.inputs(&step.inputs);
                if round > 1 {
                    inputs.extend(tiles.around(number - 1).into_iter().map(|other| before[other]));
                }
                let id = format!("{}/round-{round}/{number}-of-{count}", step.id);
                let unit = self.unit(step, id, UnitKind::Tile, inputs);
                let (block, round) = (Some([number, count]), Some(round));
                let writes = vec![self.place(step, "cache/tiles")];
                self.units.push(Unit { block, round, writes, seconds, memory_bytes, ..unit });
            }
            before = (first..self.units.len()).collect();
        }
        self.made_by.insert(&step.id, before.into_iter().collect());
    }

    /// Returns the path of a file that a step writes, relative to the run folder, with `/` on every
    /// system. `name` is relative to the step's folder, and may begin with `../`.
    fn place(&self, step: &Step, mut name: &str) -> String {
        let mut folder = step.folder.as_path();
        while let (Some(rest), Some(above)) = (name.strip_prefix("../"), folder.parent()) {
            (name, folder) = (rest, above);
        }
        let folder = folder.to_string_lossy().replace('\\', "/");
        if folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") }
    }

    fn add_design(&mut self, step: &'a Step, number: usize) {
        let count = self.plan.steps.iter().filter(|step| matches!(step.kind, StepKind::Design(_))).count();
        let inputs = self.inputs(&step.inputs);
        let unit = self.unit(step, format!("designs/{}-of-{count}", number + 1), UnitKind::Design, inputs);
        self.push(step, Unit { block: Some([number + 1, count]), ..unit });
    }

    /// Adds a step to the unit `results` of its part. The results of the first part, whose folder
    /// is the run folder, are left to the last unit.
    fn add_result(&mut self, step: &'a Step) {
        if step.part == 0 {
            return;
        }
        let folder = step.folder.iter().map(|part| part.to_string_lossy());
        let id = folder.chain(["results".into()]).collect::<Vec<_>>().join("/");
        let known = self.units.iter().position(|unit| unit.id == id);
        let mut inputs = self.inputs(&step.inputs);
        inputs.retain(|input| Some(*input) != known);
        let unit = self.unit(step, id, UnitKind::Results, inputs);
        // If the part has a unit `results` already, merge the step into that unit.
        let Some(known) = known else { return self.push(step, unit) };
        self.made_by.entry(&step.id).or_default().insert(known);
        let all = &mut self.units[known];
        all.steps.extend(unit.steps);
        all.seconds += unit.seconds;
        all.memory_bytes = all.memory_bytes.max(unit.memory_bytes);
        for input in unit.inputs {
            if !all.inputs.contains(&input) {
                all.inputs.push(input);
            }
        }
        for name in unit.writes {
            if !all.writes.contains(&name) {
                all.writes.push(name);
            }
        }
    }

    /// Returns true if a step is the report of a time step without nodes. No other report is
    /// cached.
    fn is_report_of_time(&self, step: &Step) -> bool {
        let part = &self.plan.parts[step.part];
        matches!(part.kind, PartKind::Time(_)) && part.job.nodes.is_empty()
    }

    /// Returns the steps that the unit of `step` executes too, since these steps have no unit of
    /// their own.
    fn merged_steps(&self, step: &Step) -> Vec<&'a Step> {
        let alike =
            |other: &&Step| other.part == step.part && step.kind == StepKind::Expose && other.kind == StepKind::Denoise;
        self.plan.steps.iter().filter(alike).collect()
    }

    fn finish(mut self) -> Vec<Unit> {
        let taken: BTreeSet<&String> = self.units.iter().flat_map(|unit| &unit.inputs).collect();
        let ends = self.units.iter().map(|unit| &unit.id).filter(|id| !taken.contains(id)).cloned().collect();
        let left = self.plan.steps.iter().filter(|step| !self.units.iter().any(|unit| unit.steps.contains(&step.id)));
        let left = left.filter(|step| step.kind != StepKind::Denoise).map(|step| (step.seconds, step.memory_bytes));
        let (seconds, memory_bytes) = left.fold((0.0, 0), |(s, m), (seconds, memory)| (s + seconds, memory.max(m)));
        let of_sweep = self.plan.steps.iter().filter(|step| {
            matches!(self.plan.parts[step.part].kind, PartKind::Sweep) && !matches!(step.kind, StepKind::Design(_))
        });
        let mut writes: Vec<String> = of_sweep.flat_map(|step| step.writes.clone()).collect();
        if writes.is_empty() {
            writes = ["job.toml", "report.html", "report.json", "outputs"].map(String::from).to_vec();
        }
        let (id, steps) = (FINISH.to_owned(), Vec::new());
        self.units.push(Unit {
            id,
            kind: UnitKind::Finish,
            inputs: ends,
            steps,
            block: None,
            round: None,
            writes,
            seconds,
            memory_bytes,
        });
        self.units
    }
}
