//! Tests of plugins through the plugin interface, compiled in and loaded from libraries. All files
//! belong to one test program, so that their tests share the processors. Run the tests of one file
//! by `cargo test -p lumistack-plugin-host --test plugin_host hostile::`.

mod common;
mod hostile;
mod interrupt;
mod loaded;
mod loading;
#[cfg(unix)]
mod old;
mod outputs;
mod present;
