//! The `lumistack` command, a thin layer on top of the pipeline. The program and the Python package
//! both call [`run`].
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.

mod analyze;
mod args;
mod commands;
mod compare;
mod console;
mod devices;
mod display;
mod doctor;
mod farm;
mod groups;
mod info;
mod live;
mod new;
mod plan;
mod preview;
mod program;
mod questions;
mod server;
mod show;
mod solve_page;
mod sweep;
mod usage;
mod values;

use std::ffi::OsString;

use clap::{CommandFactory, FromArgMatches};
use lumistack_core::Cancel;
use lumistack_pipeline::PipelineError;

use crate::console::tell;

pub use groups::DEFAULT_DISPLAY;
pub use info::describe_path;
#[cfg(feature = "dynamic")]
pub use lumistack_pipeline::{Launcher, plugin_child};

/// True in a build with the feature `panels`, which can open windows.
pub const HAS_PANELS: bool = cfg!(feature = "panels");

/// First argument of a child process that runs a plugin of a shared library.
pub const PLUGIN_CHILD: &str = "__plugin";

/// Runs a command line and returns its exit code. The first word is the program's name. Results go
/// to standard output. Errors, and without `--json` also progress and warnings, go to standard
/// error. When `cancel` is set, the command stops cleanly.
pub fn run(words: &[OsString], cancel: &Cancel) -> u8 {
    program::remember(words.first().map(OsString::as_os_str));
    let matches = args::Args::command().bin_name(program::name()).try_get_matches_from(words);
    let args = match matches.and_then(|matches| args::Args::from_arg_matches(&matches)) {
        Ok(args) => args,
        Err(error) => {
            usage::print(&error);
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    let verbose = args.verbose;
    let words: Vec<_> = words.iter().skip(1).map(|word| word.to_string_lossy()).collect();
    match commands::run(args, &format!("lumistack {}", words.join(" ")), cancel) {
        Ok(()) => 0,
        Err(error) => {
            tell!("error: {}", program::hinted(&error.to_string()));
            if verbose {
                let mut source = std::error::Error::source(&error);
                while let Some(cause) = source {
                    tell!("  caused by: {cause}");
                    source = cause.source();
                }
            }
            if cancel.is_cancelled() || matches!(error, PipelineError::Cancelled) { 130 } else { 1 }
        }
    }
}
