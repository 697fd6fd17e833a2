//! Executes plans step by step. Each step finds the results of its inputs in memory.
//!
//! A result is dropped from memory after the last step that reads it. If an input is not in memory,
//! the step that makes this input is executed first. That step only reads its result from the run
//! folder, if the result there is current. So a process can execute any single step.

pub(crate) mod check;
pub(crate) mod context;
mod fields;
mod listen;
mod measure;
mod outputs;
mod patterns;
mod report;

use std::collections::{BTreeMap, HashMap};
use std::time::Instant;

use lumistack_core::Task;
use lumistack_plugin_host::Registry;
use lumistack_report::Stage;

use self::context::Context;
use self::listen::{Tee, TimeStepProgress};
use super::estimate::{self, Record};
use super::steps::{PartKind, Plan, Step, StepKind};
use crate::error::PipelineError;
use crate::stage::fields::Block;
use crate::stage::output;
use crate::store::folder;
use crate::store::lock::{Hold, UNIT_LIMIT, lock_for_unit, lock_known};
use crate::store::names::Work;
use crate::store::used;

/// Executes the steps of a plan.
pub(crate) struct Executor<'a> {
    pub(crate) context: Context<'a>,
    /// Indices of steps by their ids.
    ids: HashMap<&'a str, usize>,
    ends: Vec<LastSteps>,
    done: Vec<bool>,
    records: BTreeMap<String, Record>,
    /// The part in which a unit of work is executed, and how the unit locks the part's folder.
    /// `None` if the executor executes a whole plan or a single step.
    unit: Option<(usize, Hold)>,
}

impl<'a> Executor<'a> {
    pub(crate) fn new(plan: &'a Plan, registry: &'a Registry, command: Option<&'a str>, task: Task<'a>) -> Self {
        let ids = plan.indices();
        Self {
            context: Context::new(plan, registry, command, task),
            ends: LastSteps::of(plan, &ids),
            ids,
            done: vec![false; plan.steps.len()],
            records: BTreeMap::new(),
            unit: None,
        }
    }

    /// Executes all steps, except the designs and the table of a sweep. The caller has locked the
    /// run folder.
    ///
    /// # Errors
    /// If a step fails or is cancelled. Finished steps are kept, and the next run reuses them.
    pub(crate) fn execute(&mut self) -> Result<(), PipelineError> {
        self.context.check()?;
        let is_design = |step: &Step| matches!(self.context.plan.parts[step.part].kind, PartKind::Sweep);
        // Skip the designs and the table of a sweep. `plan/sweep.rs` makes them, and solves designs
        // in parallel.
        let steps = (0..self.context.plan.steps.len()).filter(|index| !is_design(&self.context.plan.steps[*index]));
        let result = steps.collect::<Vec<_>>().into_iter().try_for_each(|index| {
            self.run(index)?;
            self.release(index)
        });
        // If the run failed before it kept a result, write no file of records.
        let keeps = |step: &Step| !matches!(step.kind, StepKind::Ingest | StepKind::Place | StepKind::Read);
        if !self.context.plan.steps.iter().zip(&self.done).any(|(step, done)| *done && keeps(step)) {
            return result;
        }
        // The next plan reads times and keys of the finished steps, also after an error.
        let noted = estimate::note(self.context.plan, self.context.registry, std::mem::take(&mut self.records));
        result.and(noted)
    }

    /// Executes one step. Results of earlier steps are read from the run folder; missing results
    /// are made first.
    ///
    /// # Errors
    /// The errors of [`execute`](Self::execute), and an error if there is no such step.
    pub(crate) fn execute_alone(&mut self, id: &str) -> Result<(), PipelineError> {
        self.context.check()?;
        let index = self.index(id)?;
        self.run(index)?;
        estimate::note(self.context.plan, self.context.registry, std::mem::take(&mut self.records))
    }

    /// Executes steps of one part as a unit of work, while other processes execute other units. The
    /// caller shares the lock of the run folder with these processes. All input units must be done.
    ///
    /// # Errors
    /// The errors of [`execute`](Self::execute), and an error if there is no such step.
    pub(crate) fn execute_unit(
        &mut self,
        steps: &[String],
        block: Option<Block>,
        round: Option<usize>,
    ) -> Result<(), PipelineError> {
        self.context.check()?;
        let hold = if block.is_some() { Hold::Shared } else { Hold::Alone };
        for id in steps {
            let index = self.index(id)?;
            self.unit = Some((self.context.plan.steps[index].part, hold));
            match block {
                Some(block) => self.run_block(index, block, round)?,
                None => self.run(index)?,
            }
        }
        Ok(())
    }

    /// Reads the results of finished units into memory, while other processes work.
    ///
    /// # Errors
    /// The errors of [`execute_unit`](Self::execute_unit).
    pub(crate) fn read_back(&mut self, steps: &[String]) -> Result<(), PipelineError> {
        self.unit = Some((0, Hold::Shared));
        steps.iter().try_for_each(|id| {
            let index = self.index(id)?;
            self.run(index)
        })
    }

    /// Checks jobs, displays, settings and outputs of all parts.
    ///
    /// # Errors
    /// The first invalid value.
    pub(crate) fn check(&mut self) -> Result<(), PipelineError> {
        self.context.check()
    }

    /// Executes one block of a step: solves one tile of the patterns in a round, or traces some
    /// pictures. Tracing needs only the scene and the placed window.
    fn run_block(&mut self, index: usize, block: Block, round: Option<usize>) -> Result<(), PipelineError> {
        let plan = self.context.plan;
        let step = &plan.steps[index];
        self.enter(step.part)?;
        if let (StepKind::Patterns, Some(round)) = (step.kind, round.and_then(|round| round.checked_sub(1))) {
            return self.context.patterns_tile(step.part, round, block, self.context.task);
        }
        let place = plan.steps.iter().position(|other| other.part == step.part && other.kind == StepKind::Place);
        place.map_or(Ok(()), |place| self.run(place))?;
        let task = self.context.task;
        match step.kind {
            StepKind::Trace => self.context.trace_block(step.part, block, task),
            StepKind::Score => self.context.score_block(step.part, block, task),
            _ => Err(PipelineError::value("plan", "unit", "a block of pictures to trace", &step.id)),
        }
        .map(|_| ())
    }

    fn index(&self, id: &str) -> Result<usize, PipelineError> {
        let known = self.ids.get(id).copied();
        known.ok_or_else(|| PipelineError::value("plan", "step", "the id of a step of the plan", format!("`{id}`")))
    }

    fn run(&mut self, index: usize) -> Result<(), PipelineError> {
        if self.done[index] {
            return Ok(());
        }
        let plan = self.context.plan;
        let step = &plan.steps[index];
        for input in &step.inputs {
            // Execute the step that makes the input, unless this step is done. In an execution of a
            // whole plan, this step is always done. A unit of work reads the patterns of a warm
            // start from their files, so it does not execute the step that makes these patterns.
            let input = self.index(input)?;
            let of_file = self.unit.is_some() && [step.kind, plan.steps[input].kind] == [StepKind::Patterns; 2];
            if !of_file {
                self.run(input)?;
            }
        }
        self.context.task.cancel.check()?;
        self.enter(step.part)?;
        // Collect the step's warnings for the report of its part, and show the time step in
        // progress.
        let warnings = Tee::new(self.context.task.warnings);
        let time = plan.time(step.part);
        let place = time.and_then(|(time, sequence)| match &plan.parts[sequence].kind {
            PartKind::Sequence(times) => Some(format!("{}/{}", time + 1, times.count())),
            _ => None,
        });
        let progress = TimeStepProgress { next: self.context.task.progress, place };
        let task = Task { progress: &progress, warnings: &warnings, cancel: self.context.task.cancel };
        let start = Instant::now();
        let cached = self.work(step, task);
        self.context.warned.extend(warnings.list.take().into_iter().map(|warning| (step.part, warning)));
        let (cached, seconds) = (cached?, start.elapsed().as_secs_f64());
        if let Some(label) = label(plan, step) {
            let stages = &mut self.context.states[step.part].stages;
            match stages.last_mut().filter(|last| last.name == label) {
                // Reports show tracing, denoising and exposing as one stage.
                Some(last) => (last.seconds, last.cached) = (last.seconds + seconds, last.cached && cached),
                None => stages.push(Stage { name: label, seconds, cached }),
            }
        }
        let files = self.context.states[step.part].ingested.as_ref().filter(|_| step.kind == StepKind::Ingest);
        let files = files.map_or(Vec::new(), |ingested| ingested.files.clone());
        self.records.insert(step.id.clone(), Record::new(seconds, cached, files));
        self.done[index] = true;
        Ok(())
    }

    /// Locks the folder of a part and the folders that contain it, since another process may run
    /// the job of any of these folders. The caller has locked the run folder.
    fn enter(&mut self, part: usize) -> Result<(), PipelineError> {
        let of_part = &self.context.plan.parts[part];
        let Some(parent) = of_part.parent else { return Ok(()) };
        self.enter(parent)?;
        if self.context.states[part].owned.is_some() {
            return Ok(());
        }
        if let Some((own, hold)) = self.unit {
            // A unit of work writes only into its own part, and reads the finished results of other
            // parts.
            if self.context.plan.is_below(own, part) {
                let hold = if own == part { hold } else { Hold::Shared };
                let owned = lock_for_unit(&self.context.dir(part), hold, UNIT_LIMIT, self.context.task)?;
                self.context.states[part].owned = Some(owned);
            }
            return Ok(());
        }
        // The folder of a time step may also be used as a run folder, so check it as a run folder.
        let in_sweep = matches!(self.context.plan.parts[0].kind, PartKind::Sweep);
        let owned = match of_part.kind {
            PartKind::Time(_) if !in_sweep => {
                let job = self.context.job(part);
                folder::lock(&self.context.dir(part), Work::Run, &job, self.context.registry, self.context.task)?
            }
            _ => lock_known(&self.context.dir(part), self.context.task)?,
        };
        self.context.states[part].owned = Some(owned);
        Ok(())
    }

    /// Drops results that no later step reads. If no later step works in a folder, removes its
    /// unused views and its lock.
    fn release(&mut self, index: usize) -> Result<(), PipelineError> {
        for part in 0..self.context.states.len() {
            let LastSteps { in_folder, in_memory } = self.ends[part];
            if in_folder == index {
                let views = std::mem::take(&mut self.context.states[part].views);
                match self.context.states[part].field {
                    Some(_) => used::keep_only_views(&self.context.dir(part), &views)?,
                    None => used::remove_tiles(&self.context.dir(part)),
                }
                self.context.states[part].owned = None;
            }
            if in_memory == index {
                let state = &mut self.context.states[part];
                (state.field, state.patterns, state.references, state.traced) = (None, None, None, None);
            }
        }
        Ok(())
    }

    /// Executes a step. Returns true if its result was cached.
    fn work(&mut self, step: &Step, task: Task<'_>) -> Result<bool, PipelineError> {
        let (context, part) = (&mut self.context, step.part);
        match step.kind {
            StepKind::Ingest => context.ingest(part, task),
            StepKind::Place => context.place(part, task),
            StepKind::Trace => context.trace(part, task),
            StepKind::Denoise => context.denoise(part, task),
            StepKind::Expose => context.expose(part, task),
            StepKind::Score => context.score(part, task),
            StepKind::Read => context.read(part, task),
            StepKind::Source => context.source(part, task),
            StepKind::Patterns => context.patterns(part, task),
            StepKind::FieldOutput(number) => context.field_output(part, number, task),
            StepKind::StackOutput(number) => context.stack_output(part, number, task),
            StepKind::Measure => context.measure(part, task),
            StepKind::Report => match &context.plan.parts[part].kind {
                PartKind::Sequence(_) => context.report_sequence(part),
                PartKind::Run | PartKind::Time(_) if !context.plan.parts[part].job.nodes.is_empty() => {
                    context.report_graph(part)
                }
                _ => context.report(part, task),
            },
            // `plan/sweep.rs` solves the designs and the search.
            StepKind::Design(_) | StepKind::Search => Ok(false),
        }
    }
}

/// Returns the name of a step in reports; `None` for steps that reports do not list.
fn label(plan: &Plan, step: &Step) -> Option<String> {
    let info = plan.stage_of(step.part, step.kind);
    let (label, job) = (info.label?, &plan.parts[step.part].job);
    Some(match step.kind {
        StepKind::FieldOutput(i) | StepKind::StackOutput(i) => output::stage_name(&job.outputs[i]),
        StepKind::Patterns => {
            plan.node(step.part).filter(|_| info.name == "node").map_or(label, |node| node.plugin.as_str()).into()
        }
        StepKind::Source => job.source.as_ref().map_or(label, |source| source.plugin.as_str()).into(),
        _ => label.to_owned(),
    })
}

/// Indices of the last steps that use a part, in memory or in its folder.
#[derive(Clone, Copy, Default)]
struct LastSteps {
    /// The last step that works in the part's folder or in one of its subfolders.
    in_folder: usize,
    /// The last step that reads the results of the part in memory.
    in_memory: usize,
}

impl LastSteps {
    fn of(plan: &Plan, ids: &HashMap<&str, usize>) -> Vec<Self> {
        let mut ends = vec![Self::default(); plan.parts.len()];
        for (index, step) in plan.steps.iter().enumerate() {
            for part in plan.around(step.part) {
                ends[part] = Self { in_folder: index, in_memory: index };
            }
            // Two kinds of steps read only exposure, geometry and scores of other parts: the report
            // of a sequence, and the steps that make light fields. Exposure, geometry and scores
            // are kept separately, so these steps do not extend the life of light fields.
            let is_whole = matches!(plan.parts[step.part].kind, PartKind::Sequence(_)) && step.kind == StepKind::Report;
            if is_whole
                || matches!(
                    step.kind,
                    StepKind::Ingest
                        | StepKind::Place
                        | StepKind::Trace
                        | StepKind::Expose
                        | StepKind::Read
                        | StepKind::Source
                )
            {
                continue;
            }
            for input in step.inputs.iter().filter_map(|id| ids.get(id.as_str())) {
                plan.around(plan.steps[*input].part).for_each(|part| ends[part].in_memory = index);
            }
        }
        ends
    }
}
