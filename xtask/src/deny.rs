//! Licences, sources, bans and security advisories of all dependencies, by cargo-deny and `deny.toml`.
//!
//! Advisories need the RustSec database, which is fetched where the network allows it. cargo-deny takes two minutes to build, so `ci`
//! checks with it only where it is installed already. Neither is a check of this tree alone, so that none of the two counts as skipped, which is a failure on CI.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, command, output_of};

/// Checks everything, with a cargo-deny that is installed if need be.
pub fn check() -> Outcome {
    let program = found().map_or_else(install, Ok)?;
    let deny = |arguments: &[&str]| {
        let mut deny = command(&program);
        // by itself it is a subcommand of cargo, whose name comes first
        deny.arg("deny").args(arguments);
        deny
    };
    tools::run(&mut deny(&["check", "licenses", "bans", "sources"]))?;
    let fetched = deny(&["fetch", "db"]).output().map_err(|error| format!("cargo-deny: {error}"))?;
    if !fetched.status.success() {
        let told = String::from_utf8_lossy(&fetched.stderr);
        let cause = told.trim().lines().last().unwrap_or("no reason was told");
        println!("advisories: not checked: the database (github.com/RustSec/advisory-db) cannot be fetched: {cause}");
        return Ok(());
    }
    tools::run(&mut deny(&["--offline", "check", "advisories"]))
}

/// [`check`] as a step of `ci`, which has no two minutes to spare for the tool itself.
pub fn in_ci() -> Outcome {
    if found().is_none() {
        println!("dependencies: not checked here, there is no cargo-deny; `cargo xtask deny` installs it");
        return Ok(());
    }
    check()
}

fn root() -> PathBuf {
    tools::root().join("target/deny-tools")
}

/// An installed cargo-deny.
fn found() -> Option<PathBuf> {
    let works = |program: &Path| output_of(command(program).arg("--version")).is_some();
    [PathBuf::from("cargo-deny"), root().join("bin/cargo-deny")].into_iter().find(|program| works(program))
}

fn install() -> Result<PathBuf, String> {
    println!("\nfetching: cargo-deny, in target/deny-tools (used only to check dependencies; two minutes)");
    let mut install = command("cargo");
    tools::run(install.args(["install", "cargo-deny", "--locked", "--root"]).arg(root()))?;
    found().ok_or_else(|| "cargo-deny was installed and does not start".into())
}
