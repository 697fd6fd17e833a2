//! Displays that follow a scene while it changes.
//!
//! ```text
//! light fields ──Mailbox──▶ Solver ──Mailbox──▶ whole states ──▶ page, panels
//!  (a thread)                (a thread)          (a thread each, which never wait for the solver)
//! ```
//!
//! A [`Mailbox`] holds only the newest value, so no thread works on an old value, and values do not
//! accumulate. A mailbox numbers its values. A [`State`] is complete and never changes. For new
//! content, a [`Solver`] starts from the best of three patterns: the previous ones, the previous
//! ones moved with the content ([`motion`]), and fresh ones. A [`Tracker`] predicts where viewers
//! will be, and [`Rays`] are the rays to their eyes. A [`Player`] schedules the time steps of a
//! video.
//!
//! The crate reads no clock and no file: times are arguments.

mod eyes;
mod mailbox;
pub mod motion;
mod solver;
mod state;
mod track;
mod video;

#[cfg(test)]
mod tests;

pub use eyes::{EyeViews, Rays, RaysError, SIGMA_MM};
pub use mailbox::Mailbox;
pub use solver::{Solved, Solver, Start};
pub use state::{State, Target};
pub use track::{Boxes, Eyes, FADE, FLOOR, HeadError, SILENCE, Tracker, head_of_packet};
pub use video::{Due, Player};
