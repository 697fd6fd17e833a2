//! Displays that follow a scene while it changes.
//!
//! ```text
//! light fields ──Mailbox──▶ Solver ──Mailbox──▶ whole states ──▶ page, panels
//!  (a thread)                (a thread)          (a thread each, which never wait for the solver)
//! ```
//!
//! A [`Mailbox`] holds the newest value alone, so nobody works on what is out of date and nothing piles up. A [`State`] is numbered, whole and never changed.
//! [`Solver`] goes on from the patterns before, moved along with the content where that is nearer ([`motion`]). [`Tracker`] makes weights of where viewers are
//! and will be; [`Player`] says which time of a video is due. Nothing here reads a clock or a file: times are arguments.

mod mailbox;
pub mod motion;
mod solver;
mod state;
mod track;
mod video;

#[cfg(test)]
mod tests;

pub use mailbox::Mailbox;
pub use solver::{Solved, Solver, Start};
pub use state::{State, Target};
pub use track::{Boxes, FADE, FLOOR, HeadError, SIGMA_MM, SILENCE, Tracker, head_of_packet};
pub use video::{Due, Player};
