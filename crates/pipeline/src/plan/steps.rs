//! A plan as data: steps, and the folders in which they work.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::times::Times;
use crate::job::{Job, NodeJob};
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
    /// In an order in which they can be executed.
    pub steps: Vec<Step>,
    #[serde(skip)]
    pub(crate) parts: Vec<Part>,
}

/// One step of a plan: a stage in a folder.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    /// Unique in the plan: the folder and the stage.
    pub id: String,
    /// Name of the stage.
    pub stage: &'static str,
    /// Relative to the run folder.
    #[serde(serialize_with = "lumistack_core::path_text::told")]
    pub folder: PathBuf,
    /// Ids of the steps whose results it takes.
    pub inputs: Vec<String>,
    /// Files and folders that it leaves in its folder.
    pub writes: &'static [&'static str],
    /// Hash of all that the result depends on, as far as it is known before the work: equal keys make equal results. `None` before the first run has told which
    /// files the scene is made of.
    pub key: Option<String>,
    /// Whether the run folder holds the result; `None` where nobody can say before the work.
    pub cached: Option<bool>,
    /// Memory that it holds, bytes: estimated from the sizes of arrays.
    pub memory_bytes: u64,
    /// How long it takes here, seconds: estimated, 0 where it is cached.
    pub seconds: f64,
    #[serde(skip)]
    pub(crate) part: usize,
    #[serde(skip)]
    pub(crate) what: What,
}

/// The work of a step in its part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum What {
    Ingest,
    Place,
    Trace,
    Denoise,
    Expose,
    Score,
    Read,
    Source,
    /// An output of the light field itself, by number in the part's job.
    FieldOutput(usize),
    /// By the factorizer or by a node plugin.
    Patterns,
    /// An output of the patterns.
    StackOutput(usize),
    /// Error and flicker of a time.
    Measure,
    /// Of a display, of a graph, of a sequence or of a sweep: what the part is.
    Report,
    /// A design of a sweep, by number.
    Design(usize),
    /// All designs of a search, of which some are solved to the end.
    Search,
}

/// A folder in which steps work.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Relative to the run folder.
    pub(crate) folder: PathBuf,
    pub(crate) kind: Kind,
    /// The plain job of the folder, as far as it is known before the work.
    pub(crate) job: Job,
    /// The folder around it.
    pub(crate) parent: Option<usize>,
}

/// Kinds of folders.
#[derive(Clone, Debug)]
pub(crate) enum Kind {
    /// A still, or a light field with several nodes.
    Run,
    /// Node of the folder around it, by number.
    Node(usize),
    /// A sequence, whose times stand within.
    Sequence(Times),
    /// Time of a sequence, from 0 on.
    Time(usize),
    /// A sweep, whose light fields stand within.
    Sweep,
}

impl Plan {
    pub(crate) fn new(job: &Job, folder: &Path) -> Self {
        Self { name: job.name.clone(), folder: folder.to_owned(), steps: Vec::new(), parts: Vec::new() }
    }

    pub(crate) fn add_part(&mut self, folder: PathBuf, kind: Kind, job: Job, parent: Option<usize>) -> usize {
        self.parts.push(Part { folder, kind, job, parent });
        self.parts.len() - 1
    }

    /// Adds a step after its inputs; gives its id.
    pub(crate) fn add_step(&mut self, part: usize, what: What, inputs: Vec<String>) -> String {
        let Part { folder, job, .. } = &self.parts[part];
        let info = self.stage_of(part, what);
        let (stage, writes) = (info.name, info.writes);
        let name = match what {
            What::FieldOutput(i) | What::StackOutput(i) => stage_name(&job.outputs[i]),
            What::Design(i) => format!("design-{:05}", i + 1),
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
            what,
        });
        id
    }

    /// The row of the table of stages to which a step belongs.
    pub(crate) fn stage_of(&self, part: usize, what: What) -> &'static StageInfo {
        match what {
            What::Ingest => &stage::INGEST,
            What::Place => &stage::PLACE,
            What::Trace => &stage::TRACE,
            What::Denoise => &stage::DENOISE,
            What::Expose => &stage::EXPOSE,
            What::Score => &stage::SCORE,
            What::Read => &stage::READ,
            What::Source => &stage::SOURCE,
            What::FieldOutput(_) | What::StackOutput(_) => &stage::OUTPUT,
            What::Patterns if is_factorized(self.node(part)) => &stage::FACTORIZE,
            What::Patterns => &stage::NODE,
            What::Measure => &stage::MEASURE,
            What::Report => &stage::REPORT,
            What::Design(_) | What::Search => &stage::DESIGN,
        }
    }

    /// Numbers of the steps by their ids.
    pub(crate) fn indices(&self) -> HashMap<&str, usize> {
        self.steps.iter().enumerate().map(|(index, step)| (step.id.as_str(), index)).collect()
    }

    /// A part and those around it, from the inside out.
    pub(crate) fn around(&self, part: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(part), |part| self.parts[*part].parent)
    }

    /// The node whose folder a part is.
    pub(crate) fn node(&self, part: usize) -> Option<&NodeJob> {
        match (&self.parts[part].kind, self.parts[part].parent) {
            (Kind::Node(number), Some(parent)) => self.parts[parent].job.nodes.get(*number),
            _ => None,
        }
    }

    /// The part whose light field a part takes: its own, or that of the graph around it.
    pub(crate) fn field_part(&self, part: usize) -> usize {
        match (&self.parts[part].kind, self.parts[part].parent) {
            (Kind::Node(_), Some(parent)) => parent,
            _ => part,
        }
    }

    /// The time of a sequence to which a part belongs, and the part of the sequence.
    pub(crate) fn time(&self, part: usize) -> Option<(usize, usize)> {
        let of_field = self.field_part(part);
        match (&self.parts[of_field].kind, self.parts[of_field].parent) {
            (Kind::Time(time), Some(sequence)) => Some((*time, sequence)),
            _ => None,
        }
    }

    /// The same part at another time of its sequence: the time itself, or the same node there.
    pub(crate) fn at_time(&self, part: usize, time: usize) -> Option<usize> {
        let (_, sequence) = self.time(part)?;
        let is_time = |other: &Part| matches!(other.kind, Kind::Time(t) if t == time) && other.parent == Some(sequence);
        let of_field = self.parts.iter().position(is_time)?;
        match self.parts[part].kind {
            Kind::Node(number) => self
                .parts
                .iter()
                .position(|other| matches!(other.kind, Kind::Node(n) if n == number) && other.parent == Some(of_field)),
            _ => Some(of_field),
        }
    }

    /// The parts within a part.
    pub(crate) fn within(&self, part: usize) -> impl Iterator<Item = usize> + '_ {
        self.parts.iter().enumerate().filter(move |(_, inner)| inner.parent == Some(part)).map(|(number, _)| number)
    }

    /// Whether a part is another or lies below it.
    pub(crate) fn is_below(&self, part: usize, above: usize) -> bool {
        self.around(part).any(|part| part == above)
    }
}
