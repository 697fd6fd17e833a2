//! The compiler of `cargo xtask ci`: while cargo builds everything, this program checks each crate
//! of the workspace with clippy and rustdoc.
//!
//! `cargo clippy` and `cargo doc` would compile every dependency a second time, without machine
//! code. Clippy's driver is rustc with more lints, so one call lints and compiles a crate.
//!
//! Cargo starts this program through `RUSTC_WORKSPACE_WRAPPER`, with the path of rustc and the
//! arguments of rustc. Cargo keeps the results of each wrapper apart. So this program also receives
//! crates that were compiled earlier without the wrapper, and checks them.

use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::OnceLock;

/// Environment variable of cargo with the program that compiles the crates of the workspace.
pub const WRAPPER: &str = "RUSTC_WORKSPACE_WRAPPER";
/// Environment variable. If it is set, a warning is an error.
const STRICT: &str = "LUMISTACK_STRICT";

/// Crates whose unit tests compute little. Optimizing these tests takes longer than running them
/// without optimization.
const PLAIN_TESTS: [&str; 9] = [
    "lumistack_field_io",
    "lumistack_gltf",
    "lumistack_plugin",
    "lumistack_plugin_images",
    "lumistack_plugin_panels",
    "lumistack_plugin_quilt",
    "lumistack_scene",
    "lumistack_shot",
    "lumistack_usd",
];

/// The path of the compiler, and true if warnings are errors. Set by [`choose`].
static CHOSEN: OnceLock<(PathBuf, bool)> = OnceLock::new();

/// Copies this program to a folder. All later calls of cargo use the copy as their compiler. With
/// `strict` a warning is an error.
///
/// # Errors
/// If the program cannot be copied.
pub fn choose(folder: &Path, strict: bool) -> io::Result<()> {
    // make a copy, since cargo replaces the original program while it builds the workspace
    let (copy, new) = (folder.join("compiler"), folder.join("compiler.new"));
    std::fs::create_dir_all(folder)?;
    std::fs::copy(std::env::current_exe()?, &new)?;
    std::fs::rename(&new, &copy)?;
    CHOSEN.get_or_init(|| (copy, strict));
    Ok(())
}

/// Makes a call of cargo by `command` use this compiler, if [`choose`] was called.
pub fn set(command: &mut Command) {
    if let Some((compiler, strict)) = CHOSEN.get() {
        command.env(WRAPPER, compiler);
        if *strict {
            command.env(STRICT, "1");
        }
    }
}

/// Returns true if cargo started this program as its compiler.
pub fn is_called(arguments: &[&str]) -> bool {
    arguments.first().is_some_and(|program| Path::new(program).file_stem().is_some_and(|name| name == "rustc"))
}

/// Compiles a crate, and checks the crate and its documentation. The arguments are the path of
/// rustc and the arguments of rustc.
pub fn compile(arguments: &[&str]) -> ExitCode {
    let (rustc, arguments) = (Path::new(arguments[0]), &arguments[1..]);
    let value = |option: &str| arguments.iter().skip_while(|word| **word != option).nth(1).copied();
    let source = arguments.iter().find(|word| word.ends_with(".rs"));
    let (Some(name), Some(source)) = (value("--crate-name"), source) else {
        // this call requests the compiler's version
        return run(Command::new(rustc).args(arguments));
    };
    let within = |folder: &str| Path::new(source).components().any(|part| part.as_os_str() == folder);
    let strict: &[&str] = if std::env::var_os(STRICT).is_some() { &["-D", "warnings"] } else { &[] };
    // no step of CI runs benchmarks, so they are checked without machine code
    let is_plain = arguments.contains(&"--test") && PLAIN_TESTS.contains(&name);
    let own = |word: &&str| match word.split_once('=') {
        Some(("--emit", kinds)) if within("benches") => format!("--emit={}", kinds.replace("link", "metadata")),
        Some(("opt-level", _)) if is_plain => "opt-level=0".to_owned(),
        _ => (*word).to_owned(),
    };
    let mut clippy = Command::new(rustc.with_file_name("clippy-driver"));
    let compiled = run(clippy.arg(rustc).args(arguments.iter().map(own)).args(strict));
    // check the pages that `cargo doc` would write
    let is_check = !arguments.iter().any(|word| word.starts_with("--emit=") && word.contains("link"));
    let has_no_page =
        arguments.contains(&"--test") || name.starts_with("build_script_") || within("benches") || within("examples");
    if compiled != ExitCode::SUCCESS || is_check || has_no_page {
        return compiled;
    }
    let mut rustdoc = Command::new(rustc.with_file_name("rustdoc"));
    if value("--crate-type") == Some("bin") {
        rustdoc.arg("--document-private-items");
    }
    // rustdoc's option `--check` writes no page. This option is unstable, so RUSTC_BOOTSTRAP must
    // allow it.
    rustdoc.env("RUSTC_BOOTSTRAP", "1").args(["-Zunstable-options", "--check"]);
    run(rustdoc.args(without_output(arguments)).args(strict))
}

/// Returns the arguments of rustc without those that state its output.
fn without_output<'a>(arguments: &[&'a str]) -> Vec<&'a str> {
    let mut kept = Vec::new();
    let mut words = arguments.iter();
    while let Some(word) = words.next() {
        match *word {
            "--out-dir" => drop(words.next()),
            word if word.starts_with("--emit=") || word.starts_with("--json=") => {}
            word => kept.push(word),
        }
    }
    kept
}

fn run(command: &mut Command) -> ExitCode {
    match command.status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{}: {error}", command.get_program().to_string_lossy());
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rustdoc_receives_the_arguments_of_rustc_without_its_output() {
        let arguments =
            ["--crate-name", "a", "a.rs", "--json=artifacts", "--emit=link", "--out-dir", "deps", "-L", "deps"];
        assert_eq!(without_output(&arguments), ["--crate-name", "a", "a.rs", "-L", "deps"]);
        assert!(is_called(&["/bin/rustc", "-vV"]) && !is_called(&["ci"]) && !is_called(&[]));
    }
}
