//! A job whose settings and files change while its display is shown (`lumistack live`).
//!
//! [`Studio`] makes its light fields and repeats only stages whose input changed. [`LiveSolver`]
//! solves them on the job's device. [`LiveFolder`] writes the last state as a run folder.

mod change;
mod folder;
mod progressive;
mod solver;
mod studio;

pub use folder::LiveFolder;
pub use solver::LiveSolver;
pub use studio::Studio;
