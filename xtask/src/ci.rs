//! Everything that must hold before a change lands.

use std::path::PathBuf;
use std::time::Instant;

use crate::blender;
use crate::deny;
use crate::layers::{self, PORTABLE};
use crate::panels;
use crate::plugins;
use crate::python;
use crate::tools::{self, EVERYTHING, Outcome, cargo, command, output_of, run};
use crate::usd;
use crate::web;

/// The Rust version whose lints we have seen. A newer compiler may know lints that nobody has answered yet, so there they only warn.
const LINTED_WITH: &str = "1.95";

/// Runs all checks; `full` adds the slow tests. `times` receives the seconds of every step that was begun.
fn run_steps(full: bool, times: &mut Vec<(&'static str, f64)>) -> Outcome {
    let mut step = |name: &'static str, work: &mut dyn FnMut() -> Outcome| {
        println!("\n=== {name}");
        let start = Instant::now();
        let result = work();
        times.push((name, start.elapsed().as_secs_f64()));
        result
    };
    let version = output_of(command("rustc").arg("--version")).ok_or("rustc does not start")?;
    let strict = version.contains(&format!("rustc {LINTED_WITH}."));
    if !strict {
        println!("lints: {} is not {LINTED_WITH}, so new lints only warn", version.trim());
    }
    step("format", &mut || cargo(&["fmt", "--all", "--check"]))?;
    step("layers", &mut layers::check)?;
    step("dependencies", &mut deny::in_ci)?;
    step("clippy", &mut || {
        let mut arguments = [&["clippy", "--all-targets", "--quiet"], &EVERYTHING[..]].concat();
        if strict {
            arguments.extend(["--", "-D", "warnings"]);
        }
        cargo(&arguments)
    })?;
    step("docs", &mut || {
        let flags = if strict { "-D warnings" } else { "" };
        run(command("cargo").args(["doc", "--workspace", "--no-deps", "--quiet"]).env("RUSTDOCFLAGS", flags))
    })?;
    step("wasm32", &mut wasm)?;
    let mut python = PathBuf::new();
    step("fetch", &mut || {
        python = tools::python()?;
        tools::poppler();
        Ok(())
    })?;
    step("tests", &mut || {
        let mut tests = command("cargo");
        run(tests.arg("test").args(EVERYTHING).env("LUMISTACK_PYTHON", &python))
    })?;
    step("USD versions", &mut usd::check)?;
    step("plugins", &mut || plugins::run(false))?;
    step("panels", &mut || panels::check(full))?;
    step("python", &mut python::check)?;
    step("blender", &mut || blender::check(full))?;
    step("web", &mut web::check)?;
    if full {
        step("slow tests", &mut || {
            let mut tests = command("cargo");
            tests.args(["test", "--workspace", "--release", "--", "--ignored", "--nocapture", "--test-threads=1"]);
            run(tests.env("LUMISTACK_PYTHON", &python))
        })?;
    }
    Ok(())
}

/// [`run_steps`], with a table of how long each step took.
pub fn run_ci(full: bool) -> Outcome {
    let (start, mut times) = (Instant::now(), Vec::new());
    let result = run_steps(full, &mut times);
    println!("\n{:>8}  step", "seconds");
    times.iter().for_each(|(name, seconds)| println!("{seconds:8.0}  {name}"));
    println!("{:8.0}  in all", start.elapsed().as_secs_f64());
    result?;
    println!("\nci: every check that was run passed");
    Ok(())
}

/// The portable crates compile to wasm32 without threads.
fn wasm() -> Outcome {
    if !tools::wasm_target() {
        tools::skipped("wasm32", "this machine cannot get the Rust target wasm32-unknown-unknown");
        return Ok(());
    }
    let mut arguments = vec!["check", "--quiet", "--target", "wasm32-unknown-unknown", "--no-default-features"];
    for name in PORTABLE {
        arguments.extend(["--package", name]);
    }
    cargo(&arguments)?;
    // the solver's kernels have vectors of their own there
    arguments.truncate(5);
    arguments.extend(["--package", "lumistack-factorizer", "--config", SIMD128]);
    cargo(&arguments)
}

/// Fixed-width vectors of WebAssembly.
const SIMD128: &str = "target.wasm32-unknown-unknown.rustflags=['-Ctarget-feature=+simd128']";
