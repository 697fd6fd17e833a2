//! A program that runs a plugin in a child process of the tests.

use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    let args: Vec<OsString> = std::env::args_os().skip(1).collect();
    ExitCode::from(lumistack_plugin_host::plugin_child(&args))
}
