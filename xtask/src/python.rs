//! Builds the Python package as a wheel and installs it into `target/python`, as a user does. Tests
//! and measures the installed package.

use std::path::{Path, PathBuf};

use crate::pythons::{self, OLDEST, Versions};
use crate::tools::{self, Outcome, command, install, output_of, run};

/// Packages for pip with which this file builds and checks the Python package.
const TOOLS: [&str; 10] = [
    "--only-binary=:all:",
    "maturin==1.16.*",
    "pytest==9.*",
    "mypy==2.*",
    "distributed==2026.*",
    "openjd-cli==0.8.*",
    "opencue-pyoutline==1.*",
    "jsonschema==4.*",
    "s3fs",
    "moto[server]==5.*",
];

/// Arguments of pip: packages that are common in notebooks. Tests check that these packages accept
/// arrays and plots of `lumistack`.
const NOTEBOOKS: [&str; 4] = ["--only-binary=:all:", "matplotlib==3.*", "xarray", "pillow"];

/// Packs a wheel with the module that the workspace's tests compile, installs it, checks it and
/// measures it. If Python is too old or the tools cannot be fetched, the function skips all these
/// steps with a message.
pub fn check(versions: Versions) -> Outcome {
    let python = tools::python()?;
    if let Err(error) = fetch(&python) {
        tools::skipped("python", &error);
        return Ok(());
    }
    let wheel = pack(&python)?;
    install(&python, &["--force-reinstall", "--no-deps", &wheel.to_string_lossy()])?;
    types(&python)?;
    run(command(&python).args(["-m", "pytest", "-q", "--durations=5"]))?;
    run(command(&python).arg("examples/python/any_array.py"))?;
    pythons::check(&wheel, versions)?;
    measure(&python, &wheel)
}

/// Fetches the tools that build and check the package.
///
/// # Errors
/// If this machine's Python is too old, or the tools cannot be installed.
pub fn fetch(python: &Path) -> Outcome {
    if !is_new_enough(python) {
        return Err(format!("expected Python {}.{} or newer, found an older version", OLDEST.0, OLDEST.1));
    }
    let needed = [
        ("maturin, pytest, mypy, distributed, openjd.cli, outline, jsonschema, s3fs, moto", &TOOLS[..]),
        ("matplotlib, xarray, PIL", &NOTEBOOKS),
    ];
    for (modules, packages) in needed {
        if !can_import(python, modules) {
            println!("fetching: {modules}, in target/python (used only to build and check the Python package)");
            install(python, packages).map_err(|error| format!("{modules} cannot be installed: {error}"))?;
        }
    }
    Ok(())
}

/// Builds the release wheel into `target/wheels`, installs it and measures it.
pub fn release() -> Outcome {
    let python = tools::python()?;
    if !can_import(&python, "maturin") {
        install(&python, &TOOLS)?;
    }
    let wheel = build(&python)?;
    install(&python, &["--force-reinstall", "--no-deps", &wheel.to_string_lossy()])?;
    measure(&python, &wheel)
}

/// Returns a Python with the release wheel, and with all tools that its checks need.
///
/// # Errors
/// If the tools cannot be installed, or the package does not build.
pub fn release_environment() -> Outcome<PathBuf> {
    let python = tools::python()?;
    fetch(&python)?;
    let wheel = build(&python)?;
    install(&python, &["--force-reinstall", "--no-deps", &wheel.to_string_lossy()])?;
    Ok(python)
}

fn can_import(python: &Path, modules: &str) -> bool {
    output_of(command(python).args(["-c", &format!("import {modules}")])).is_some()
}

fn is_new_enough(python: &Path) -> bool {
    let test = format!("import sys; sys.exit(sys.version_info < ({}, {}))", OLDEST.0, OLDEST.1);
    output_of(command(python).args(["-c", &test])).is_some()
}

/// Builds the release wheel, and returns its path.
pub fn build(python: &Path) -> Outcome<PathBuf> {
    let folder = empty("target/wheels/release")?;
    let maturin = python.with_file_name("maturin");
    run(command(maturin).args(["build", "--release", "--interpreter"]).arg(python).arg("--out").arg(&folder))?;
    only_file(&folder)
}

/// Packs a wheel, and returns its path. The module is the one that the workspace's tests compile,
/// since maturin would compile it again with other features. maturin writes only the folder
/// `.dist-info`.
pub fn pack(python: &Path) -> Outcome<PathBuf> {
    tools::build_everything()?;
    let (info, folder) = (empty("target/wheels/info")?, empty("target/wheels/dev")?);
    let mut maturin = command(python.with_file_name("maturin"));
    run(maturin
        .args(["pep517", "write-dist-info", "--interpreter"])
        .arg(python)
        .arg("--metadata-directory")
        .arg(&info))?;
    let mut pack = command(python);
    pack.arg("xtask/python/pack.py").arg(only_file(&info)?).arg("crates/python/python");
    run(pack.arg("target/debug/liblumistack_python.so").arg(&folder))?;
    only_file(&folder)
}

fn empty(folder: &str) -> Outcome<PathBuf> {
    let folder = tools::root().join(folder);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    Ok(folder)
}

fn only_file(folder: &Path) -> Outcome<PathBuf> {
    let mut files = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?.flatten();
    files.next().map(|file| file.path()).ok_or_else(|| format!("{}: expected a wheel, found no file", folder.display()))
}

/// Checks the types of examples and tests by mypy, and compares the stub files with the module.
fn types(python: &Path) -> Outcome {
    run(command(python).args(["-m", "mypy", "examples/python"]))?;
    run(command(python).args(["-m", "mypy", "crates/python/tests"]))?;
    run(command(python).args([
        "-m",
        "mypy.stubtest",
        "lumistack",
        "--allowlist",
        "crates/python/tests/stubtest.txt",
        "--ignore-unused-allowlist",
    ]))
}

fn measure(python: &Path, wheel: &Path) -> Outcome {
    let bytes = std::fs::metadata(wheel).map_err(|error| error.to_string())?.len();
    println!("wheel: {:.1} MB, {}", bytes as f64 / 1e6, wheel.display());
    run(command(python).arg("crates/python/bench.py"))
}
