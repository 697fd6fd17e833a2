//! Plugins through the boundary, compiled in and loaded. One program for all files, which share the processors; `cargo test -p lumistack-plugin-host --test plugin_host hostile::` runs the tests of one.

mod common;
mod hostile;
mod loaded;
mod loading;
mod outputs;
mod present;
