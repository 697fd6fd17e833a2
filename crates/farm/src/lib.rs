//! Units of work as data: a plan in steps that many machines execute.
//!
//! ```text
//! plan ─▶ units ─▶ Dask                 the Python module lumistack.farm
//!               ─▶ Makefile, shell      one machine, or several that share a folder
//!               ─▶ OpenJD, Flamenco, OpenCue, Deadline
//! ```
//!
//! A unit is a command that reads from one shared folder and publishes into it. If it runs twice,
//! or again after it was killed, it publishes the same bytes. The crate contains the graph of
//! units, but no code for their work, and opens no files.

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
