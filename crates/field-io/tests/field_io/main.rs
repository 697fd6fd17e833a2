//! Formats on disk: round trips, files of other programs, invalid files. All test files are one
//! program, so that they share the processors. `cargo test -p lumistack-field-io --test field_io
//! foreign::` runs the tests of one file.

mod common;
mod foreign;
mod hostile;
mod round_trips;
