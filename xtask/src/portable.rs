//! Checks the command and the Python module for Windows and macOS. Every machine can check their
//! types for these systems. Windows and macOS can also run the tests that need no other program.
//! Linux can run tests for Windows in Wine.

use std::process::Stdio;

use serde_json::Value;

use crate::tools::{self, Outcome, cargo, command, run};
use crate::wine::{self, MINGW, Program};

/// The systems with releases, except Linux. A check of types does not need the libraries of these
/// systems.
const TARGETS: [&str; 3] = [MINGW, "x86_64-apple-darwin", "aarch64-apple-darwin"];

/// Crates whose tests need neither Debian packages nor a window system.
const TESTED: [&str; 15] = [
    "lumistack-simd",
    "lumistack-core",
    "lumistack-scene",
    "lumistack-display",
    "lumistack-files",
    "lumistack-field-io",
    "lumistack-gltf",
    "lumistack-splats",
    "lumistack-pathtracer",
    "lumistack-factorizer",
    "lumistack-shot",
    "lumistack-plugin",
    "lumistack-plugin-host",
    "lumistack-pipeline",
    "lumistack-cli",
];

/// Programs of tests that run in Wine, in addition to the tests in the sources of [`TESTED`]. Each
/// has the names of its tests that make sense in Wine; an empty list stands for all tests.
const IN_WINE: [(&str, &[&str]); 4] = [
    ("field_io", &[]),
    ("streaming", &[]),
    ("plugin_host", &["interrupt::", "loaded::", "loading::", "outputs::", "present::"]),
    (
        "end_to_end",
        &[
            "end_to_end::a_killed_run_resumes_from_its_finished_parts",
            "errors::",
            "sequence::an_interrupted_sequence_resumes_after_its_finished_time_steps",
            "store::",
            "words::",
        ],
    ),
];

/// Tests that Wine or mingw cannot pass. mingw's `fmaf` rounds twice, so a quarter of its results
/// differ from those of other systems. Kernels with vectors therefore have other results than plain
/// code.
const NOT_IN_WINE: [(&str, &[&str]); 2] = [
    (
        "lumistack_pathtracer",
        &["bvh::tests::a_beam_has_the_hits_of_its_rays", "bvh::tests::vectors_and_scalars_give_the_same_bits"],
    ),
    ("lumistack_simd", &["tests::every_operation_of_every_backend_is_that_of_plain_numbers"]),
];

/// Libraries and a program that the tests of plugins load.
const EXAMPLES: [&str; 3] = ["lumistack_plugin_echo", "lumistack_plugin_faulty", "plugin_child"];

/// Checks the types of the command, with all its features, and of the Python module for every
/// system in [`TARGETS`]. The other steps of CI do not compile the command with the feature `gpu`.
pub fn check() -> Outcome {
    for target in TARGETS {
        if let Err(error) = tools::rust_target(target) {
            tools::skipped(target, &error);
            continue;
        }
        println!("\n=== {target}");
        let mut check = command("cargo");
        check.args(["check", "--quiet", "--package", "lumistack-cli", "--package", "lumistack-python"]);
        check.args(["--features", "lumistack-cli/panels,lumistack-cli/gpu", "--target", target]);
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

/// Builds tests for Windows, and runs them in Wine.
pub fn wine() -> Outcome {
    tools::rust_target(MINGW)?;
    wine::linker()?;
    let selected = |what: &str| {
        let mut cargo = command("cargo");
        cargo.arg(what).args(TESTED.iter().flat_map(|name| ["--package", name])).args(["--target", MINGW]);
        cargo
    };
    let examples = EXAMPLES.iter().flat_map(|name| ["--example", name]);
    run(selected("build").args(examples))?;
    let programs = IN_WINE.iter().flat_map(|(name, _)| ["--test", name]);
    let mut tests = selected("test");
    tests.args(["--no-run", "--lib", "--message-format", "json-render-diagnostics"]).args(programs);
    println!("\n$ {tests:?}");
    let output = tests.stderr(Stdio::inherit()).output().map_err(|error| format!("cargo does not start: {error}"))?;
    if !output.status.success() {
        return Err(format!("cargo ended with {}", output.status));
    }
    let messages = String::from_utf8_lossy(&output.stdout);
    let programs: Vec<Program> =
        messages.lines().filter_map(|line| program(&serde_json::from_str(line).ok()?)).collect();
    wine::run_all(&programs)
}

/// Returns the test program that a message of cargo names; `None` if the message names none.
fn program(message: &Value) -> Option<Program> {
    let file = message["executable"].as_str().filter(|_| message["profile"]["test"] == true)?;
    let manifest = message["manifest_path"].as_str()?;
    let target = message["target"]["name"].as_str()?;
    let of = |list: &[(&str, &'static [&'static str])]| -> &'static [&'static str] {
        list.iter().find(|(name, _)| *name == target).map_or(&[], |(_, tests)| tests)
    };
    let skipped = of(&NOT_IN_WINE).iter().flat_map(|test| ["--skip", test]);
    Some(Program {
        name: target.to_owned(),
        file: file.to_owned(),
        folder: manifest.strip_suffix("/Cargo.toml")?.to_owned(),
        words: of(&IN_WINE).iter().copied().chain(skipped).collect(),
    })
}
