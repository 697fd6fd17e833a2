//! End-to-end tests: whole runs of the binary, on the repository's own jobs and on files of other
//! projects.
//!
//! All tests are one program, so that only one is linked and its tests share the processors. `cargo
//! test -p lumistack-cli --test end_to_end store::` runs those of one file.

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
