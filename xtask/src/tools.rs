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

/// What CI compiles: one selection of packages with one set of features, so that nothing is compiled twice. It has the windows of panels.
pub const EVERYTHING: [&str; 3] = ["--workspace", "--features", "lumistack-plugin-panels/window,lumistack-cli/panels"];

/// Builds all programs and examples, among them the libraries of plugins, into `target/debug`.
pub fn build_everything() -> Outcome {
    cargo(&[&["build", "--quiet"], &EVERYTHING[..], &["--bins", "--examples"]].concat())
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

/// Reference tools of image metrics, as pip takes them; tests that use them skip where they cannot be had.
const METRICS: [&str; 3] = ["--only-binary=:all:", "scikit-image", "flip-evaluator==1.*"];

/// Readers of pictures, which check files that we write.
const READERS: [&str; 3] = ["--only-binary=:all:", "pillow", "OpenEXR==3.*"];

/// OpenUSD with its MaterialX plugin; tests over USD stages skip where it cannot be had.
const USD: [&str; 2] = ["--only-binary=:all:", "usd-exchange==3.*"];

/// A Python with NumPy, in `target/python`, and where their wheels exist with Pillow and OpenEXR's bindings, scikit-image and flip-evaluator, and OpenUSD. Some tests check
/// our files and figures with other people's software, and USD is read by it.
pub fn python() -> Outcome<PathBuf> {
    let folder = root().join("target/python");
    let python = folder.join("bin/python");
    let imports = |modules: &str| output_of(command(&python).args(["-c", &format!("import {modules}")])).is_some();
    if !imports("numpy") {
        make_python(&folder, "to check files that we write")?;
        install(&python, &["numpy==2.*"])?;
    }
    if !imports("numpy") {
        return Err("numpy was installed into target/python and does not import".into());
    }
    if !imports("PIL, OpenEXR") {
        println!("fetching: Pillow and OpenEXR, in target/python (used only to check pictures that we write)");
        if let Err(error) = install(&python, &READERS) {
            println!("pictures: other people's readers are not tried: {error}");
        }
    }
    if !imports("skimage, flip_evaluator") {
        println!("fetching: scikit-image and flip-evaluator, in target/python (used only to check our SSIM and FLIP)");
        if let Err(error) = install(&python, &METRICS) {
            println!("metrics: the reference tools are not checked anew, their recorded figures are: {error}");
        }
    }
    if !imports("pxr") {
        println!("fetching: usd-exchange (OpenUSD), in target/python (used only to test how USD is read)");
        if let Err(error) = install(&python, &USD) {
            println!("USD: reading it is not tested: {error}");
        }
    }
    Ok(python)
}

/// Installs packages; `packages` may hold options of pip.
pub fn install(python: &Path, packages: &[&str]) -> Outcome {
    let mut pip = command(python);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]);
    run(pip.args(packages))
}

/// Makes an empty Python environment.
pub fn make_python(folder: &Path, purpose: &str) -> Outcome {
    println!("\nfetching: a Python environment with numpy, in {} (used only {purpose})", folder.display());
    let make = |with: &str| run(command(with).args(["-m", "venv", "--clear"]).arg(folder));
    if make("python3").is_err() {
        println!("fetching: the Debian package python3-venv, which this machine's Python needs to make an environment");
        run(command("apt-get").args(["install", "-y", "--no-install-recommends", "python3-venv"]))
            .and_then(|()| make("python3"))
            .map_err(|error| format!("no Python environment: {error}; install Python 3 with its venv module"))?;
    }
    Ok(())
}

/// `pdftoppm`, which turns the pages of our PDF files into pixels; tests that need it skip where it cannot be had.
pub fn poppler() {
    if output_of(command("pdftoppm").arg("-v")).is_some() {
        return;
    }
    println!("\nfetching: the Debian package poppler-utils (used only to check PDF files that we write)");
    if let Err(error) = run(command("apt-get").args(["install", "-y", "--no-install-recommends", "poppler-utils"])) {
        println!("PDF: pages are not checked: {error}");
    }
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
