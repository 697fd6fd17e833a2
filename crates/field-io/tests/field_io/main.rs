//! Formats on disk: round trips, files of other programs, files that lie. One program for all
//! files, which share the processors; `cargo test -p lumistack-field-io --test field_io foreign::`
//! runs the tests of one.

mod common;
mod foreign;
mod hostile;
mod round_trips;
