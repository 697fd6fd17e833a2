//! Tests of the kit's host and checks, with plugins of its own. All files are one program, which
//! shares the processors. Run the tests of one file by
//! `cargo test -p lumistack-plugin-testkit --test plugin_testkit makers::`.

mod makers;
mod outputs;
