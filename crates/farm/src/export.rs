//! The formats in which farm managers read a graph.

use crate::file::File;
use crate::graph::Graph;
use crate::{deadline, flamenco, makefile, opencue, openjd, shell};

/// Formats of farm managers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// GNU make.
    Makefile,
    /// A POSIX shell script.
    Shell,
    /// A job template of Open Job Description, 2023-09.
    OpenJd,
    /// Flamenco 3: a job type, and a job to post to the manager.
    Flamenco,
    /// OpenCue: a Python script for PyOutline.
    OpenCue,
    /// Deadline 10: job info and plugin info files, and a script that submits them.
    Deadline,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 6] =
        [Self::Makefile, Self::Shell, Self::OpenJd, Self::Flamenco, Self::OpenCue, Self::Deadline];

    /// Returns the name of the format on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Makefile => "makefile",
            Self::Shell => "shell",
            Self::OpenJd => "openjd",
            Self::Flamenco => "flamenco",
            Self::OpenCue => "opencue",
            Self::Deadline => "deadline",
        }
    }

    /// Converts a graph into the files of this format.
    pub fn export(self, graph: &Graph) -> Vec<File> {
        match self {
            Self::Makefile => makefile::export(graph),
            Self::Shell => shell::export(graph),
            Self::OpenJd => openjd::export(graph),
            Self::Flamenco => flamenco::export(graph),
            Self::OpenCue => opencue::export(graph),
            Self::Deadline => deadline::export(graph),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn every_format_names_every_unit() {
        let graph = sample();
        for format in Format::ALL {
            let all: String = format.export(&graph).into_iter().map(|file| file.text).collect();
            for unit in &graph.units {
                let stem = unit.id.split("/1-of").next().and_then(|id| id.split("/2-of").next()).unwrap();
                assert!(all.contains(stem), "{} lacks {stem}", format.name());
            }
            assert!(all.contains("farm"), "{}", format.name());
        }
    }
}
