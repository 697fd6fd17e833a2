//! Formats on disk: round trips, files of other programs, invalid files. All files are one program,
//! which shares the processors. Run the tests of one file by
//! `cargo test -p lumistack-field-io --test field_io foreign::`.

mod common;
mod foreign;
mod hostile;
mod round_trips;
