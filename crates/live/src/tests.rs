//! Tests of the crate on light fields in closed form.

mod fields;
mod mailbox;
mod motion;
mod solver;
mod track;
mod video;
