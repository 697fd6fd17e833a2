//! Tests of the kit's host and checks, with plugins that exist only for these tests. All files
//! belong to one test program, so that their tests share the processors. Run the tests of one file
//! by `cargo test -p lumistack-plugin-testkit --test plugin_testkit makers::`.

mod makers;
mod outputs;
