//! Units of work: a plan cut into pieces that many machines execute, as data.
//!
//! ```text
//! plan ─▶ units ─▶ Dask                 the Python module lumistack.farm
//!               ─▶ Makefile, shell      one machine, or any that share a folder
//!               ─▶ OpenJD, Flamenco, OpenCue, Deadline
//! ```
//!
//! A unit is a command that reads from and publishes into one shared folder. Executing it twice, or again after it was killed, gives the same bytes. This crate
//! knows graphs of units and nothing of the work itself; it touches no files.

mod deadline;
mod export;
mod file;
mod flamenco;
mod graph;
mod makefile;
mod opencue;
mod openjd;
mod schedule;
mod shell;

pub use export::Format;
pub use file::File;
pub use graph::{Graph, Kind, Unit};
pub use schedule::{Prediction, paths, predict};
