//! Running programs, and fetching the few that the tests need.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A failed step, as one sentence.
pub type Outcome<T = ()> = Result<T, String>;

/// The workspace's root folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace").to_owned()
}

/// Runs cargo in the workspace.
pub fn cargo(arguments: &[&str]) -> Outcome {
    run(command("cargo").args(arguments))
}

/// A program that runs in the workspace's root.
pub fn command(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// Runs a program to its end, showing what it prints.
pub fn run(command: &mut Command) -> Outcome {
    let name = describe(command);
    println!("\n$ {name}");
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("`{name}` ended with {status}")),
        Err(error) => Err(format!("`{name}` did not start: {error}")),
    }
}

/// What a program prints; `None` when it fails.
pub fn output_of(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

fn describe(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}

/// A Python with NumPy, in `target/python`. Some tests check our files with other people's software.
pub fn python() -> Outcome<PathBuf> {
    let folder = root().join("target/python");
    let python = folder.join("bin/python");
    let works = |python: &Path| output_of(command(python).args(["-c", "import numpy"])).is_some();
    if works(&python) {
        return Ok(python);
    }
    println!("\nfetching: a Python environment with numpy, in target/python (used only to check files that we write)");
    let make = |with: &str| run(command(with).args(["-m", "venv", "--clear"]).arg(&folder));
    if make("python3").is_err() {
        println!("fetching: the Debian package python3-venv, which this machine's Python needs to make an environment");
        run(command("apt-get").args(["install", "-y", "--no-install-recommends", "python3-venv"]))
            .and_then(|()| make("python3"))
            .map_err(|error| format!("no Python environment: {error}; install Python 3 with its venv module"))?;
    }
    run(command(&python).args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "numpy==2.*"]))?;
    if works(&python) { Ok(python) } else { Err("numpy was installed into target/python and does not import".into()) }
}

/// Whether rustc can compile to wasm32; asks rustup for the target where it cannot.
pub fn wasm_target() -> bool {
    let installed = || {
        output_of(command("rustc").args(["--print", "target-libdir", "--target", "wasm32-unknown-unknown"]))
            .is_some_and(|folder| Path::new(folder.trim()).is_dir())
    };
    if installed() {
        return true;
    }
    println!("\nfetching: the Rust target wasm32-unknown-unknown");
    run(command("rustup").args(["target", "add", "wasm32-unknown-unknown"])).is_ok() && installed()
}
