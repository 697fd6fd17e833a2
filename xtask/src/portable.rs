//! Checks the command and the Python module for Windows and macOS. On every machine it checks their
//! types for these systems. On Windows or macOS itself it can also run the tests that need no other
//! program.

use crate::tools::{self, Outcome, cargo, command, run};

/// The systems with releases, except Linux. A check of types does not need the libraries of these
/// systems.
const TARGETS: [&str; 3] = ["x86_64-pc-windows-gnu", "x86_64-apple-darwin", "aarch64-apple-darwin"];

/// Crates whose tests need neither Debian packages nor a window system.
const TESTED: [&str; 10] = [
    "lumistack-core",
    "lumistack-scene",
    "lumistack-display",
    "lumistack-files",
    "lumistack-field-io",
    "lumistack-gltf",
    "lumistack-splats",
    "lumistack-pathtracer",
    "lumistack-factorizer",
    "lumistack-cli",
];

/// Checks the types of the command and of the Python module for every system in [`TARGETS`].
pub fn check() -> Outcome {
    for target in TARGETS {
        if let Err(error) = tools::rust_target(target) {
            tools::skipped(target, &error);
            continue;
        }
        println!("\n=== {target}");
        let mut check = command("cargo");
        check.args(["check", "--quiet", "--package", "lumistack-cli", "--package", "lumistack-python"]);
        check.args(["--features", "lumistack-cli/panels", "--target", target]);
        // A dependency assembles a file for the target, which a compiler for Linux cannot do. A
        // check of types needs no object files, so the program `true` replaces compiler and
        // archiver.
        if cfg!(target_os = "linux") {
            for tool in ["CC", "AR"] {
                check.env(format!("{tool}_{}", target.replace('-', "_")), "true");
            }
        }
        run(&mut check)?;
    }
    Ok(())
}

/// Runs tests on this system.
pub fn test() -> Outcome {
    let packages = TESTED.iter().flat_map(|name| ["--package", name]);
    cargo(&["test", "--lib"].into_iter().chain(packages).collect::<Vec<_>>())
}
