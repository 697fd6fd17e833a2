//! The test kit's host and checks against plugins of its own. One program for all files, which share the processors; `cargo test -p lumistack-plugin-testkit --test plugin_testkit makers::` runs the tests of one.

mod makers;
mod outputs;
