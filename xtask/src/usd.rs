//! How USD is read by the oldest and the newest OpenUSD that this machine's Python can have; the tests themselves take the one in `target/python`.

use std::path::{Path, PathBuf};

use crate::tools::{self, EVERYTHING, Outcome, command, install, make_python, output_of, run};

/// Versions as pip takes them. Python 3.11 has wheels from 24.3 on.
const VERSIONS: [(&str, &str); 2] = [("oldest", "usd-core==24.3"), ("newest", "usd-core")];
/// Tests that ask OpenUSD.
const TESTS: [&str; 5] = ["--test", "usd", "--", "stages::", "shading::"];

/// Runs the tests with each version; skips one that cannot be had.
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

/// Fetches the versions that can be had.
///
/// # Errors
/// When one of them cannot.
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
    if has(&python) { Ok(python) } else { Err(format!("it does not import in {}", folder.display())) }
}
