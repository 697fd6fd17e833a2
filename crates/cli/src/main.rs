//! The `lumistack` program: Ctrl-C, then the commands; or, started by itself, the process of one plugin.

use std::process::ExitCode;

use lumistack_core::Cancel;

fn main() -> ExitCode {
    let words: Vec<_> = std::env::args_os().collect();
    #[cfg(feature = "dynamic")]
    {
        // Ctrl-C is for the program that started it
        if words.get(1).is_some_and(|word| word == lumistack_cli::PLUGIN_CHILD) {
            return ExitCode::from(lumistack_cli::plugin_child(&words[2..]));
        }
        if let Some(launcher) = lumistack_cli::Launcher::this_program(lumistack_cli::PLUGIN_CHILD) {
            launcher.set_for_process();
        }
    }
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
    ExitCode::from(lumistack_cli::run(&words, &cancel))
}
