//! Results in memory during an execution, for each part of the plan.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_core::{Task, Warning};
use lumistack_display::{Display, FieldGeometry, Weights};
use lumistack_plugin_host::Registry;
use lumistack_report::{DepthBudget, Output, Report, SequenceReport, SequenceTime, Stage, Thumbnail};
use lumistack_shot::{Placement, ToneMapping};

use crate::error::{FailedOutput, PipelineError};
use crate::job::Job;
use crate::plan::graph::job_of;
use crate::plan::steps::{PartKind, Plan};
use crate::plan::times::{FirstTimeStep, name};
use crate::stage::factorize::Solved;
use crate::stage::field::Field;
use crate::stage::flicker::TimeError;
use crate::stage::ingest::Ingested;
use crate::stage::paths::Samples;
use crate::stage::score::References;
use crate::stage::trace::Traced;
use crate::store::lock::FolderLock;
use crate::store::stamps::Stamps;

/// Patterns of a display, and the display and the weights that they were solved for.
pub(crate) struct Patterns {
    pub(super) display: Display,
    pub(super) weights: Weights,
    pub(super) solved: Solved,
    pub(super) cached: bool,
}

/// The report of a display. For a node also two pictures, which the report of the graph shows.
pub(crate) struct Reported {
    pub(crate) report: Report,
    pub(super) shown: Option<[Thumbnail; 2]>,
}

/// Results of the steps of one part. A result is missing until its step is executed.
#[derive(Default)]
pub(crate) struct State {
    pub(super) job: Option<Arc<Job>>,
    pub(super) owned: Option<FolderLock>,
    pub(super) ingested: Option<Arc<Ingested>>,
    pub(super) placement: Option<Placement>,
    pub(super) samples: Option<Samples>,
    pub(super) traced: Option<Arc<Traced>>,
    pub(crate) field: Option<Arc<Field>>,
    /// Exposure and tone curve of the light field. They are kept after the light field is dropped.
    pub(super) tone_mapping: Option<ToneMapping>,
    pub(super) geometry: Option<FieldGeometry>,
    pub(crate) references: Option<Arc<References>>,
    pub(super) patterns: Option<Arc<Patterns>>,
    pub(super) brightness: f64,
    pub(super) outputs: Vec<Output>,
    pub(super) measured: Option<(TimeError, String)>,
    pub(crate) reported: Option<Reported>,
    pub(super) entry: Option<SequenceTime>,
    pub(super) stages: Vec<Stage>,
    /// Folders of cached views that the part used.
    pub(super) views: Vec<PathBuf>,
}

/// State of an execution: the plan, and the results of every part in memory.
pub(crate) struct Context<'a> {
    pub(crate) plan: &'a Plan,
    pub(super) registry: &'a Registry,
    pub(super) command: Option<&'a str>,
    pub(super) task: Task<'a>,
    pub(crate) states: Vec<State>,
    pub(super) warned: Vec<(usize, Warning)>,
    pub(crate) failed: Vec<FailedOutput>,
    pub(crate) sequence: Option<SequenceReport>,
    /// The scene's depth compared with the depth of field of the display in the job.
    pub(crate) depth: Option<DepthBudget>,
    /// Sentences about the camera and the lights that the scene's file lacks.
    pub(crate) lacking: Vec<String>,
}

impl<'a> Context<'a> {
    pub(super) fn new(plan: &'a Plan, registry: &'a Registry, command: Option<&'a str>, task: Task<'a>) -> Self {
        Self {
            plan,
            registry,
            command,
            task,
            states: plan.parts.iter().map(|_| State::default()).collect(),
            warned: Vec::new(),
            failed: Vec::new(),
            sequence: None,
            depth: None,
            lacking: Vec::new(),
        }
    }

    /// Returns the folder of a part.
    pub(super) fn dir(&self, part: usize) -> PathBuf {
        self.plan.folder.join(&self.plan.parts[part].folder)
    }

    pub(super) fn stamps(&self, part: usize) -> Stamps {
        Stamps::new(&self.dir(part))
    }

    /// Returns the cache folder of a part. A sequence uses the cache folder of its first time step.
    pub(super) fn cache(&self, part: usize) -> PathBuf {
        match self.plan.parts[part].kind {
            PartKind::Sequence(_) => self.dir(part).join(name(0)).join("cache"),
            _ => self.dir(part).join("cache"),
        }
    }

    /// Returns the job of a part. Values that result from earlier steps are filled in.
    pub(super) fn job(&mut self, part: usize) -> Arc<Job> {
        if let Some(job) = &self.states[part].job {
            return job.clone();
        }
        let plan = self.plan;
        let of_part = &plan.parts[part];
        // A time step gets placement and exposure from the first time step, and a warm start from
        // the previous time step.
        let job = match (&of_part.kind, of_part.parent) {
            (PartKind::Time(time), Some(sequence)) => match &plan.parts[sequence].kind {
                PartKind::Sequence(times) => {
                    let before = times.start(*time).map(|before| self.dir(sequence).join(before));
                    let state = &self.states[sequence];
                    let tone_mapping = plan.at_time(part, 0).and_then(|first| self.states[first].tone_mapping);
                    let first_step = state.placement.zip(state.ingested.as_ref());
                    let first_step = first_step.map(|(placement, ingested)| FirstTimeStep {
                        placement,
                        studio: ingested.studio,
                        tone_mapping,
                    });
                    times.job(&plan.parts[sequence].job, *time, before.as_deref(), first_step)
                }
                _ => of_part.job.clone(),
            },
            // A node takes its values from the completed job of its time step, which contains the
            // node's warm start.
            (PartKind::Node(_), Some(parent)) => {
                let around = self.job(parent);
                plan.node(part)
                    .and_then(|node| around.nodes.iter().find(|other| other.id == node.id))
                    .map_or_else(|| of_part.job.clone(), |node| job_of(&around, node))
            }
            _ => of_part.job.clone(),
        };
        let job = Arc::new(job);
        self.states[part].job = Some(job.clone());
        job
    }

    /// Returns a result that an earlier step of the part made.
    pub(super) fn of<T>(
        &self,
        part: usize,
        name_of_result: &str,
        take: impl Fn(&State) -> Option<T>,
    ) -> Result<T, PipelineError> {
        let place = &self.plan.parts[part].folder;
        take(&self.states[part])
            .ok_or_else(|| PipelineError::value(place, "plan", format!("{name_of_result} of an earlier step"), "none"))
    }

    /// Returns the scene of a part. If the part has none, returns the scene of its sequence.
    pub(super) fn ingested(&self, part: usize) -> Result<Arc<Ingested>, PipelineError> {
        let shared = |state: &State| state.ingested.clone();
        let above = self.plan.time(part).map(|(_, sequence)| sequence);
        let own = shared(&self.states[part]).or_else(|| above.and_then(|above| shared(&self.states[above])));
        own.ok_or_else(|| PipelineError::job("scene", "a scene", "none"))
    }

    pub(super) fn field(&self, part: usize) -> Result<Arc<Field>, PipelineError> {
        self.of(self.plan.field_part(part), "a light field", |state| state.field.clone())
    }

    pub(super) fn source_of(&self, part: usize, time: usize) -> String {
        let Some((_, sequence)) = self.plan.time(part) else { return String::new() };
        match &self.plan.parts[sequence].kind {
            PartKind::Sequence(times) => times.source(&self.plan.parts[sequence].job, time),
            _ => String::new(),
        }
    }

    /// Returns the warnings of all parts for which `concerns` returns true, in the order in which
    /// they occurred.
    pub(super) fn warnings(&self, concerns: impl Fn(usize) -> bool) -> Vec<Warning> {
        self.warned.iter().filter(|(part, _)| concerns(*part)).map(|(_, warning)| warning.clone()).collect()
    }
}
