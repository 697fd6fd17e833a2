//! The `lumistack` command: a thin shell over the pipeline.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.

mod args;
mod commands;
mod console;
mod info;
mod preview;
mod server;

use std::process::ExitCode;

use clap::Parser;
use lumistack_core::Cancel;
use lumistack_pipeline::PipelineError;

fn main() -> ExitCode {
    let args = args::Args::parse();
    let cancel = Cancel::default();
    let flag = cancel.clone();
    // a second Ctrl-C ends the program at once: everything is written beside and renamed, so nothing is left half-written
    let handler = ctrlc::set_handler(move || {
        if flag.is_cancelled() {
            std::process::exit(130);
        }
        flag.cancel();
    });
    if let Err(error) = handler {
        eprintln!("warning: Ctrl-C will not stop cleanly: {error}");
    }
    let verbose = args.verbose;
    match commands::run(args, &cancel) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            if verbose {
                let mut source = std::error::Error::source(&error);
                while let Some(cause) = source {
                    eprintln!("  caused by: {cause}");
                    source = cause.source();
                }
            }
            if cancel.is_cancelled() || matches!(error, PipelineError::Cancelled) {
                ExitCode::from(130)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}
