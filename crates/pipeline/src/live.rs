//! A job whose settings and files change while its display is shown (`lumistack live`).
//!
//! [`LiveFields`] makes the job's light fields, and repeats only stages whose input has changed.
//! [`LiveSolver`] solves the light fields on the job's device. [`LiveFolder`] writes the last state
//! as a run folder.

mod change;
mod fields;
mod folder;
mod progressive;
mod solver;

pub use fields::LiveFields;
pub use folder::LiveFolder;
pub use solver::LiveSolver;
