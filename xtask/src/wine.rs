//! Builds for Windows on Linux, with the linker of mingw, and runs programs for Windows in Wine.

use std::path::Path;

use crate::debian;
use crate::tools::{self, Outcome, command, output_of, run};

/// The target of Windows that Linux can build. It is for tests with Wine; releases are for
/// Microsoft's target, whose linker needs Windows.
pub const MINGW: &str = "x86_64-pc-windows-gnu";

/// Finds or installs the linker that rustc uses for [`MINGW`].
pub fn linker() -> Outcome {
    if output_of(command("x86_64-w64-mingw32-gcc").arg("--version")).is_some() {
        return Ok(());
    }
    tools::apt(&["gcc-mingw-w64-x86-64"], "link programs for Windows")
}

/// A test program, and the words on its command line.
pub struct Program {
    /// Name in messages.
    pub name: String,
    /// The file.
    pub file: String,
    /// Folder of its package, in which it runs.
    pub folder: String,
    /// Names of tests to run or to skip.
    pub words: Vec<&'static str>,
}

/// Runs test programs in Wine, in a Debian stable that has Wine 9 or newer. In this Debian the
/// repository has the same path, since tests contain the paths of their packages.
pub fn run_all(programs: &[Program]) -> Outcome {
    let machine = debian::Copy::kept("debian-wine", |copy| {
        let install = "apt-get update -qq && \
             DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends wine wine64";
        run(copy.command(&[], &[]).args(["sh", "-euc", install]))
    })?;
    let lines: String = programs
        .iter()
        .map(|Program { name, file, folder, words }| format!("{name}\t{folder}\t{file}\t{}\n", words.join(" ")))
        .collect();
    let list = tools::root().join("target/wine.txt");
    std::fs::write(&list, lines).map_err(|error| format!("{}: {error}", list.display()))?;
    let root = tools::root();
    let script = root.join("xtask/wine.sh");
    let shared: [&Path; 1] = [&root];
    run(machine.command(&shared, &[]).arg("sh").arg(script).arg(list))
}
