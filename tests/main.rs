//! End-to-end tests: whole runs of the binary, on the repository's own jobs and on files of other
//! projects.
//!
//! All tests are in one program, so that it is linked only once and its tests run in parallel. For
//! example, `cargo test -p lumistack-cli --test end_to_end store::` runs the tests of one file.

mod common;

mod assets;
mod calibrate;
mod compare;
mod denoise;
mod design;
mod devices;
mod directional;
mod end_to_end;
mod errors;
mod golden;
mod live;
mod looks;
mod outputs;
mod plugins;
mod seen;
mod sequence;
mod show;
mod store;
mod usd;
mod views;
mod words;
mod zone;
