//! Data of a plan: steps, and the folders that they write.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::times::Times;
use crate::job::{Job, NodeJob, SweepJob};
use crate::stage::node::is_factorized;
use crate::stage::output::stage_name;
use crate::stage::{self, StageInfo};

/// The steps of a job.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// The job's name.
    pub name: String,
    /// The run folder.
    #[serde(serialize_with = "lumistack_core::path_text::told")]
    pub folder: PathBuf,
    /// The steps; each comes after its inputs.
    pub steps: Vec<Step>,
    /// Estimate of the disk space of all light fields and of the pictures for the zone score, with
    /// the temporary files of one step, bytes. Patterns, outputs and reports, which are usually
    /// much smaller, are not included.
    pub disk_bytes: u64,
    /// True if only the run will choose the renderer of a `.blend` file. The plan then assumes
    /// Blender, which renders fewer views.
    pub assumes_blender: bool,
    #[serde(skip)]
    pub(crate) parts: Vec<Part>,
}

/// One step of a plan: a stage in a folder.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    /// Id, unique in the plan: folder and stage of the step.
    pub id: String,
    /// Name of the stage.
    pub stage: &'static str,
    /// Folder of the step, relative to the run folder.
    #[serde(serialize_with = "lumistack_core::path_text::told")]
    pub folder: PathBuf,
    /// Ids of the steps whose results this step reads.
    pub inputs: Vec<String>,
    /// Files and folders that this step writes, relative to its folder.
    pub writes: Vec<String>,
    /// Hash of everything that the result depends on: equal keys give equal results. `None` if an
    /// input is not known yet or cannot be read. For example, only a run finds the scene's files.
    pub key: Option<String>,
    /// True if the run folder has the current result; `None` if only a run can find out.
    pub cached: Option<bool>,
    /// Upper bound of the memory, bytes, computed from the sizes of arrays. A light field larger
    /// than the job's `render.field_mib` is kept in files. The bound then includes only the part
    /// that is in memory.
    pub memory_bytes: u64,
    /// Estimated time on this machine, seconds; 0 if cached.
    pub seconds: f64,
    #[serde(skip)]
    pub(crate) part: usize,
    #[serde(skip)]
    pub(crate) kind: StepKind,
}

/// The work of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StepKind {
    Ingest,
    Place,
    Trace,
    Denoise,
    Expose,
    Score,
    Read,
    Source,
    /// An output whose input is the light field. The value is the output's number in the part's
    /// job, from 0.
    FieldOutput(usize),
    /// Patterns that the factorizer or a node plugin makes.
    Patterns,
    /// An output whose input is the patterns. The value is the output's number in the part's job,
    /// from 0.
    StackOutput(usize),
    /// Error and flicker of a time step.
    Measure,
    /// Report of the part, which is a display, a graph, a sequence or a sweep.
    Report,
    /// A design of a sweep, by its number from 0.
    Design(usize),
    /// All designs of a search. The search solves only some of them to the last iteration.
    Search,
}

/// A folder in which steps work, and its job.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// The folder, relative to the run folder.
    pub(crate) folder: PathBuf,
    pub(crate) kind: PartKind,
    /// The job of the folder. Values that only an execution finds are not filled in.
    pub(crate) job: Job,
    /// The part whose folder contains this part's folder.
    pub(crate) parent: Option<usize>,
}

/// Kinds of parts.
#[derive(Clone, Debug)]
pub(crate) enum PartKind {
    /// A still, several nodes with one light field, or a light field of a sweep.
    Run,
    /// A node of the parent part, by its number from 0.
    Node(usize),
    /// A sequence; its time steps are parts within it.
    Sequence(Times),
    /// A time step of a sequence, counted from 0.
    Time(usize),
    /// A sweep; its light fields are parts within it.
    Sweep,
}

impl Plan {
    pub(crate) fn new(job: &Job, folder: &Path) -> Self {
        let (name, folder) = (job.name.clone(), folder.to_owned());
        Self { name, folder, steps: Vec::new(), disk_bytes: 0, assumes_blender: false, parts: Vec::new() }
    }

    pub(crate) fn add_part(&mut self, folder: PathBuf, kind: PartKind, job: Job, parent: Option<usize>) -> usize {
        self.parts.push(Part { folder, kind, job, parent });
        self.parts.len() - 1
    }

    /// Adds a step, whose inputs the plan must already have. Returns the id of the step.
    pub(crate) fn add_step(&mut self, part: usize, kind: StepKind, inputs: Vec<String>) -> String {
        let Part { folder, job, .. } = &self.parts[part];
        let (stage, writes) = (self.stage_of(part, kind).name, self.writes_of(part, kind));
        let name = match kind {
            StepKind::FieldOutput(i) | StepKind::StackOutput(i) => stage_name(&job.outputs[i]),
            StepKind::Design(i) => format!("design-{:05}", i + 1),
            _ => stage.to_owned(),
        };
        let place = folder.iter().map(|part| part.to_string_lossy());
        let id = place.chain([name.into()]).collect::<Vec<_>>().join("/");
        let folder = folder.clone();
        let (key, cached, memory_bytes, seconds) = (None, None, 0, 0.0);
        self.steps.push(Step {
            id: id.clone(),
            stage,
            folder,
            inputs,
            writes,
            key,
            cached,
            memory_bytes,
            seconds,
            part,
            kind,
        });
        id
    }

    /// Returns the files and folders that a step writes, relative to its folder.
    fn writes_of(&self, part: usize, kind: StepKind) -> Vec<String> {
        let of_stage = match (kind, &self.parts[part].kind) {
            // Outputs of a node are in the folder that contains the node's folder.
            (StepKind::StackOutput(_), PartKind::Node(_)) => {
                return self.node(part).map(|node| format!("../../outputs/{}", node.id)).into_iter().collect();
            }
            (StepKind::Report, PartKind::Sweep) => match &self.parts[part].job.sweep {
                Some(SweepJob { search: Some(_), .. }) => stage::SEARCH_FILES,
                _ => stage::SWEEP_FILES,
            },
            _ => self.stage_of(part, kind).writes,
        };
        of_stage.iter().map(|name| (*name).to_owned()).collect()
    }

    /// Returns the stage of a step.
    pub(crate) fn stage_of(&self, part: usize, kind: StepKind) -> &'static StageInfo {
        match kind {
            StepKind::Ingest => &stage::INGEST,
            StepKind::Place => &stage::PLACE,
            StepKind::Trace => &stage::TRACE,
            StepKind::Denoise => &stage::DENOISE,
            StepKind::Expose => &stage::EXPOSE,
            StepKind::Score => &stage::SCORE,
            StepKind::Read => &stage::READ,
            StepKind::Source => &stage::SOURCE,
            StepKind::FieldOutput(_) | StepKind::StackOutput(_) => &stage::OUTPUT,
            StepKind::Patterns if is_factorized(self.node(part)) => &stage::FACTORIZE,
            StepKind::Patterns => &stage::NODE,
            StepKind::Measure => &stage::MEASURE,
            StepKind::Report => &stage::REPORT,
            StepKind::Design(_) | StepKind::Search => &stage::DESIGN,
        }
    }

    /// Returns the indices of the steps by their ids.
    pub(crate) fn indices(&self) -> HashMap<&str, usize> {
        self.steps.iter().enumerate().map(|(index, step)| (step.id.as_str(), index)).collect()
    }

    /// Returns a part and its ancestors, from the part outwards.
    pub(crate) fn around(&self, part: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(part), |part| self.parts[*part].parent)
    }

    /// Returns the node of a part, if the part is a node.
    pub(crate) fn node(&self, part: usize) -> Option<&NodeJob> {
        match (&self.parts[part].kind, self.parts[part].parent) {
            (PartKind::Node(number), Some(parent)) => self.parts[parent].job.nodes.get(*number),
            _ => None,
        }
    }

    /// Returns the index of the part whose light field a part uses: the parent of a node, otherwise
    /// the part itself.
    pub(crate) fn field_part(&self, part: usize) -> usize {
        match (&self.parts[part].kind, self.parts[part].parent) {
            (PartKind::Node(_), Some(parent)) => parent,
            _ => part,
        }
    }

    /// Returns the number of the time step that a part belongs to, and the index of the sequence's
    /// part. `None` if the part belongs to no sequence.
    pub(crate) fn time(&self, part: usize) -> Option<(usize, usize)> {
        let of_field = self.field_part(part);
        match (&self.parts[of_field].kind, self.parts[of_field].parent) {
            (PartKind::Time(time), Some(sequence)) => Some((*time, sequence)),
            _ => None,
        }
    }

    /// Returns the index of the same part at another time step of its sequence. For a node, this is
    /// the node with the same number. `None` if the part belongs to no sequence, or the sequence
    /// has no such time step.
    pub(crate) fn at_time(&self, part: usize, time: usize) -> Option<usize> {
        let (_, sequence) = self.time(part)?;
        let is_time =
            |other: &Part| matches!(other.kind, PartKind::Time(t) if t == time) && other.parent == Some(sequence);
        let of_field = self.parts.iter().position(is_time)?;
        match self.parts[part].kind {
            PartKind::Node(number) => self.parts.iter().position(|other| {
                matches!(other.kind, PartKind::Node(n) if n == number) && other.parent == Some(of_field)
            }),
            _ => Some(of_field),
        }
    }

    /// Returns the indices of the parts whose parent is this part.
    pub(crate) fn within(&self, part: usize) -> impl Iterator<Item = usize> + '_ {
        self.parts.iter().enumerate().filter(move |(_, inner)| inner.parent == Some(part)).map(|(number, _)| number)
    }

    /// Returns true if a part is `above` or one of its descendants.
    pub(crate) fn is_below(&self, part: usize, above: usize) -> bool {
        self.around(part).any(|part| part == above)
    }
}
