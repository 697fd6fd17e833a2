//! The `lumistack` program: Ctrl-C, then the commands.

use std::process::ExitCode;

use lumistack_core::Cancel;

fn main() -> ExitCode {
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
    let words: Vec<_> = std::env::args_os().collect();
    ExitCode::from(lumistack_cli::run(&words, &cancel))
}
