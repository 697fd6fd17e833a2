//! Checks licences, sources, bans and security advisories of all dependencies by cargo-deny with
//! `deny.toml`.
//!
//! Advisories need the RustSec database, which is fetched if the network allows it. cargo-deny
//! takes two minutes to build, so `cargo xtask ci` uses it only if it is installed. A missing
//! database or tool is not reported as a skipped check, since CI would then fail for a reason
//! outside of this repository.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, command, output_of};

/// Checks everything; installs cargo-deny if it is missing.
pub fn check() -> Outcome {
    let program = found().map_or_else(install, Ok)?;
    let deny = |arguments: &[&str]| {
        let mut deny = command(&program);
        // cargo-deny expects the name of cargo's subcommand, `deny`, as its first argument
        deny.arg("deny").args(arguments);
        deny
    };
    tools::run(&mut deny(&["check", "licenses", "bans", "sources"]))?;
    let fetched = deny(&["fetch", "db"]).output().map_err(|error| format!("cargo-deny: {error}"))?;
    if !fetched.status.success() {
        let said = String::from_utf8_lossy(&fetched.stderr);
        let cause = said.trim().lines().last().unwrap_or("cargo-deny gave no reason");
        println!("advisories: not checked, since github.com/RustSec/advisory-db cannot be fetched: {cause}");
        return Ok(());
    }
    tools::run(&mut deny(&["--offline", "check", "advisories"]))
}

/// Runs the checks as a step of `ci`, if cargo-deny is installed already.
pub fn in_ci() -> Outcome {
    if found().is_none() {
        println!("dependencies: not checked, since cargo-deny is not installed; `cargo xtask deny` installs it");
        return Ok(());
    }
    check()
}

fn root() -> PathBuf {
    tools::root().join("target/deny-tools")
}

/// Finds an installed cargo-deny.
fn found() -> Option<PathBuf> {
    let works = |program: &Path| output_of(command(program).arg("--version")).is_some();
    [PathBuf::from("cargo-deny"), root().join("bin/cargo-deny")].into_iter().find(|program| works(program))
}

fn install() -> Result<PathBuf, String> {
    println!("\nfetching: cargo-deny, in target/deny-tools (used only to check dependencies; two minutes)");
    let mut install = command("cargo");
    tools::run(install.args(["install", "cargo-deny", "--locked", "--root"]).arg(root()))?;
    found().ok_or_else(|| "cargo-deny was installed, but does not start".into())
}
