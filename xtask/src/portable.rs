//! Windows and macOS: the command compiles for them from any machine; what needs no other program is tested on them.

use crate::tools::{self, Outcome, cargo};

/// Systems that releases are for, beside Linux. Their own libraries are not needed to check types.
const TARGETS: [&str; 3] = ["x86_64-pc-windows-gnu", "x86_64-apple-darwin", "aarch64-apple-darwin"];

/// Crates whose tests need neither Debian's packages nor a display.
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

/// Checks the command for the other systems.
pub fn check() -> Outcome {
    for target in TARGETS {
        if let Err(error) = tools::rust_target(target) {
            tools::skipped(target, &error);
            continue;
        }
        println!("\n=== {target}");
        cargo(&["check", "--quiet", "--package", "lumistack-cli", "--features", "panels", "--target", target])?;
    }
    Ok(())
}

/// Tests, on the system that this is.
pub fn test() -> Outcome {
    let packages = TESTED.iter().flat_map(|name| ["--package", name]);
    cargo(&["test", "--lib"].into_iter().chain(packages).collect::<Vec<_>>())
}
