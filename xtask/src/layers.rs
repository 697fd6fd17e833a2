//! Checks the architecture: a crate may depend only on crates of lower layers, and only certain
//! crates may have certain external dependencies.
//!
//! Each crate states its layer in `[package.metadata.lumistack] layer = n`. Development
//! dependencies may be of any layer. Build dependencies may be of the crate's own layer, since they
//! are not part of the program.
//!
//! Within a crate no two files may use each other, directly or through other files.
//!
//! Development dependencies may add no features to a crate that programs use too. CI compiles
//! programs together with development dependencies. So CI would not find code that needs a feature
//! which only development dependencies add.

use std::collections::{BTreeSet, HashMap};

use serde_json::Value;

use crate::circles;
use crate::tools::{EVERYTHING, Outcome, command, output_of};

/// External crates, and the only workspace crates that may depend on them.
const FORBIDDEN: [(&str, &[&str]); 3] = [
    ("pyo3", &["lumistack-python"]),
    ("wgpu", &["lumistack-factorizer-gpu", "lumistack-plugin-panels"]),
    ("libloading", &["lumistack-plugin-host"]),
];

/// Crates that must compile to wasm32. So they may not use a file system, a clock or a terminal.
pub const PORTABLE: [&str; 11] = [
    "lumistack-simd",
    "lumistack-core",
    "lumistack-scene",
    "lumistack-display",
    "lumistack-gltf",
    "lumistack-pathtracer",
    "lumistack-factorizer",
    "lumistack-splats",
    "lumistack-shot",
    "lumistack-web-decoders",
    "lumistack-web-solver",
];

/// Crates to which development dependencies may add features, since no program uses these features:
/// the command calls only `getrandom::fill`, and only xtask uses `proc-macro2`.
const RICHER_IN_TESTS: [&str; 2] = ["getrandom", "proc-macro2"];

/// Items of the standard library that portable crates must not use. Functions of these crates
/// receive the contents of files, and times, as arguments.
const NOT_PORTABLE: [&str; 4] = ["std::fs", "std::time::Instant", "std::time::SystemTime", "std::thread::spawn"];

/// Checks the whole workspace.
pub fn check() -> Outcome {
    let text = output_of(command("cargo").args(["metadata", "--format-version", "1", "--no-deps"]))
        .ok_or("cargo metadata failed")?;
    let metadata: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let packages = metadata["packages"].as_array().ok_or("cargo metadata lists no packages")?;
    // Read the layer of every crate, then check every dependency.
    let mut layers = HashMap::new();
    for package in packages {
        let name = package["name"].as_str().unwrap_or_default();
        let layer = package["metadata"]["lumistack"]["layer"].as_u64().ok_or_else(|| {
            format!("{name}: expected a layer, found none; add [package.metadata.lumistack] layer = n")
        })?;
        layers.insert(name, layer);
    }
    let mut problems = Vec::new();
    for package in packages {
        let name = package["name"].as_str().unwrap_or_default();
        for dependency in package["dependencies"].as_array().into_iter().flatten() {
            let to = dependency["name"].as_str().unwrap_or_default();
            if dependency["kind"].as_str() == Some("dev") {
                continue;
            }
            let at_build = dependency["kind"].as_str() == Some("build");
            if let Some(layer) = layers.get(to)
                && (*layer > layers[name] || (*layer == layers[name] && !at_build))
            {
                problems.push(format!(
                    "{name} (layer {}) depends on {to} (layer {layer}): expected a dependency in a lower layer",
                    layers[name]
                ));
            }
            for (external, allowed) in FORBIDDEN {
                if to == external && !allowed.contains(&name) {
                    problems.push(format!(
                        "{name} depends on {external}: expected this dependency only in {}",
                        allowed.join(" and ")
                    ));
                }
            }
        }
        // Check the crate for cycles of files, and a portable crate for items that wasm32 lacks.
        for target in package["targets"].as_array().into_iter().flatten() {
            let is_code = ["lib", "cdylib", "rlib", "bin"].iter().any(|kind| target["kind"][0] == **kind);
            let root = std::path::Path::new(target["src_path"].as_str().unwrap_or_default());
            if is_code {
                let found = circles::of_crate(root)?.into_iter();
                problems.extend(found.map(|[files, uses]| {
                    format!("{name}: files use each other: {}\n    {}", files.join(", "), uses.join("\n    "))
                }));
            }
        }
        if PORTABLE.contains(&name) {
            let manifest = package["manifest_path"].as_str().unwrap_or_default();
            let source = std::path::Path::new(manifest).with_file_name("src");
            check_portable(&source, &mut problems)?;
        }
    }
    let (in_programs, in_tests) = (features("normal,no-proc-macro")?, features("normal,dev,no-proc-macro")?);
    for known in in_programs.difference(&in_tests) {
        if !RICHER_IN_TESTS.iter().any(|name| known.split(' ').next() == Some(name)) {
            problems.push(format!(
                "{known}: expected no further features in tests, found more, which development dependencies add"
            ));
        }
    }
    if problems.is_empty() {
        println!(
            "layers: {} crates, no dependency on the same or a higher layer, no forbidden dependency, no cycle of files, no feature of tests alone",
            layers.len()
        );
        Ok(())
    } else {
        Err(format!("layers:\n  {}", problems.join("\n  ")))
    }
}

/// Returns the name, version and features of each crate that the workspace uses through
/// dependencies of these kinds.
fn features(kinds: &str) -> Outcome<BTreeSet<String>> {
    let mut tree = command("cargo");
    tree.arg("tree").args(EVERYTHING).args(["--edges", kinds, "--prefix", "none", "--format", "{p} [{f}]"]);
    let tree = output_of(&mut tree).ok_or("cargo tree failed")?;
    // remove cargo's mark of a crate whose dependencies were printed before
    Ok(tree.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect())
}

/// Finds the items of [`NOT_PORTABLE`] in the code before the tests of each file.
fn check_portable(folder: &std::path::Path, problems: &mut Vec<String>) -> Outcome {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for entry in entries {
        let path = entry.map_err(|error| error.to_string())?.path();
        if path.is_dir() {
            // skip src/tests: it contains test modules, which do not run on wasm32
            if path.file_name().is_some_and(|name| name != "tests") {
                check_portable(&path, problems)?;
            }
        } else if path.extension().is_some_and(|extension| extension == "rs")
            && path.file_stem().is_some_and(|stem| stem != "tests")
        {
            let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            for (number, line) in code.lines().enumerate() {
                let code = line.split("//").next().unwrap_or_default();
                if let Some(call) = NOT_PORTABLE.iter().find(|call| code.contains(*call)) {
                    problems.push(format!("{}:{}: expected portable code, found {call}", path.display(), number + 1));
                }
            }
        }
    }
    Ok(())
}
