//! Tests with requirements that a machine may lack: files of third parties, Python packages,
//! programs.
//!
//! If the environment variable `CI` is set, all requirements must be present: a test that would be
//! skipped fails.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Environment variable with the path of a file. Every skipped test adds a line to that file.
/// `cargo xtask` sets the variable.
const LIST: &str = "LUMISTACK_SKIPPED";

/// Reports that a test is skipped, and the reason.
///
/// # Panics
/// If the environment variable `CI` is set to a value other than `false`, `0` and the empty text.
#[track_caller]
pub fn skipped(why: &str) {
    let is_ci = std::env::var("CI").is_ok_and(|value| !["", "0", "false"].contains(&value.as_str()));
    let list = std::env::var_os(LIST).map(PathBuf::from);
    if let Err(message) = account(why, std::thread::current().name(), is_ci, list.as_deref()) {
        panic!("{message}");
    }
}

/// Prints that a test runs in another step of CI, `cargo xtask STEP`, which provides the test's
/// requirements.
pub fn runs_in(step: &str) {
    println!("not here: `cargo xtask {step}` runs this test");
}

/// Reports a skip of the test `test`, as [`skipped`] does. The environment provides `is_ci` and
/// `list`. Returns an error on CI.
fn account(why: &str, test: Option<&str>, is_ci: bool, list: Option<&Path>) -> Result<(), String> {
    println!("skipped: {why}");
    if let Some(list) = list {
        let line = format!("test {}: {}\n", test.unwrap_or("?"), why.replace('\n', " "));
        let file = std::fs::OpenOptions::new().create(true).append(true).open(list);
        // write the line in one call, since tests run in parallel
        if let Err(error) = file.and_then(|mut file| file.write_all(line.as_bytes())) {
            println!("{}: {error}", list.display());
        }
    }
    if is_ci { Err(format!("skipped on CI, where every test must run: {why}")) } else { Ok(()) }
}

/// Returns a folder of third-party files. The environment variable `variable` names the folder.
/// Without it the folder is `default`, a path relative to the workspace (`../shared/...`). If the
/// folder does not exist, reports the test as skipped and returns `None`.
#[track_caller]
pub fn folder(variable: &str, default: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = std::env::var_os(variable).map_or_else(|| root.join(default), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    skipped(&format!("{} is missing ({variable} names the folder)", folder.display()));
    None
}

/// Returns a Python that has all of `modules` (for example "numpy, PIL"). The candidates are the
/// Python that `LUMISTACK_PYTHON` names, and `python3`. If neither has them, reports the test as
/// skipped and returns `None`.
#[track_caller]
pub fn python_with(modules: &str) -> Option<PathBuf> {
    let candidates = [std::env::var_os("LUMISTACK_PYTHON").map(PathBuf::from), Some("python3".into())];
    let imports = |python: &PathBuf| {
        let mut check = Command::new(python);
        let status = check.args(["-c", &format!("import {modules}")]).stdout(Stdio::null()).stderr(Stdio::null());
        status.status().is_ok_and(|status| status.success())
    };
    let found = candidates.into_iter().flatten().find(imports);
    if found.is_none() {
        skipped(&format!("no Python with {modules} (`cargo xtask ci` makes one)"));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skipped_test_fails_on_ci_and_is_listed_everywhere() {
        let list = std::env::temp_dir().join(format!("lumistack-skipped-{}", std::process::id()));
        assert_eq!(account("no files", Some("a::b"), false, Some(&list)), Ok(()));
        assert!(account("no Python", Some("c"), true, Some(&list)).unwrap_err().ends_with("no Python"));
        let text = std::fs::read_to_string(&list).unwrap();
        std::fs::remove_file(&list).unwrap();
        assert_eq!(text, "test a::b: no files\ntest c: no Python\n");
    }
}
