//! Runs the tests of USD with the oldest and with the newest OpenUSD for this machine's Python. The
//! other tests use the OpenUSD in `target/python`.

use std::path::{Path, PathBuf};

use crate::tools::{self, EVERYTHING, Outcome, command, install, make_python, output_of, run};

/// Versions of OpenUSD for pip. For Python 3.11 there are wheels from version 24.3 on.
const VERSIONS: [(&str, &str); 2] = [("oldest", "usd-core==24.3"), ("newest", "usd-core")];
/// Tests that use OpenUSD.
const TESTS: [&str; 5] = ["--test", "usd", "--", "stages::", "shading::"];

/// Runs the tests with each version; skips a version that cannot be installed.
pub fn check() -> Outcome {
    for (name, package) in VERSIONS {
        match environment(name, package) {
            Ok(python) => {
                let mut tests = command("cargo");
                run(tests.arg("test").args(EVERYTHING).args(TESTS).env("LUMISTACK_PYTHON", &python))?;
            }
            Err(error) => tools::skipped(&format!("USD with {package}"), &error),
        }
    }
    Ok(())
}

/// Installs both versions of OpenUSD if they are missing.
///
/// # Errors
/// If a version cannot be installed.
pub fn fetch() -> Outcome {
    let mut fetched = Ok(());
    for (name, package) in VERSIONS {
        fetched = environment(name, package).map(drop).and(fetched);
    }
    fetched
}

fn environment(name: &str, package: &str) -> Outcome<PathBuf> {
    let folder = tools::root().join(format!("target/python-usd-{name}"));
    let python = folder.join("bin/python");
    let has = |python: &Path| output_of(command(python).args(["-c", "import pxr"])).is_some();
    if !has(&python) {
        make_python(&folder, "to test how USD is read")?;
        install(&python, &["--only-binary=:all:", package])?;
    }
    if has(&python) { Ok(python) } else { Err(format!("OpenUSD cannot be imported in {}", folder.display())) }
}
