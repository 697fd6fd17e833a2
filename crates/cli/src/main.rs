//! The `lumistack` program: it handles Ctrl-C and runs a command. To run a plugin of a shared
//! library, the program starts itself again, with a special first argument.

use std::process::ExitCode;

use lumistack_core::Cancel;

fn main() -> ExitCode {
    let words: Vec<_> = std::env::args_os().collect();
    #[cfg(feature = "dynamic")]
    {
        // The process of a plugin has its own process group, so Ctrl-C reaches only its parent.
        if words.get(1).is_some_and(|word| word == lumistack_cli::PLUGIN_CHILD) {
            return ExitCode::from(lumistack_cli::plugin_child(&words[2..]));
        }
        if let Some(launcher) = lumistack_cli::Launcher::this_program(lumistack_cli::PLUGIN_CHILD) {
            launcher.set_for_process();
        }
    }
    let cancel = Cancel::default();
    let flag = cancel.clone();
    // A second Ctrl-C ends the program immediately. Results are written under other names and then
    // renamed, so no result is incomplete.
    let handler = ctrlc::set_handler(move || {
        if flag.is_cancelled() {
            std::process::exit(130);
        }
        flag.cancel();
    });
    if let Err(error) = handler {
        eprintln!(
            "warning: Ctrl-C will end the program at once, without cleaning up, since the program cannot handle Ctrl-C: {error}"
        );
    }
    ExitCode::from(lumistack_cli::run(&words, &cancel))
}
