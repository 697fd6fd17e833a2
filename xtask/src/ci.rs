//! Everything that must hold before a change lands.

use std::time::Instant;

use crate::blender;
use crate::layers::{self, PORTABLE};
use crate::panels;
use crate::plugins;
use crate::python;
use crate::tools::{self, EVERYTHING, Outcome, cargo, command, output_of, run};
use crate::usd;
use crate::web;

/// The Rust version whose lints we have seen. A newer compiler may know lints that nobody has answered yet, so there they only warn.
const LINTED_WITH: &str = "1.95";

/// Runs all checks; `full` adds the slow tests.
pub fn run_steps(full: bool) -> Outcome {
    let version = output_of(command("rustc").arg("--version")).ok_or("rustc does not start")?;
    let strict = version.contains(&format!("rustc {LINTED_WITH}."));
    if !strict {
        println!("lints: {} is not {LINTED_WITH}, so new lints only warn", version.trim());
    }
    step("format", || cargo(&["fmt", "--all", "--check"]))?;
    step("layers", layers::check)?;
    step("clippy", || {
        let mut arguments = [&["clippy", "--all-targets", "--quiet"], &EVERYTHING[..]].concat();
        if strict {
            arguments.extend(["--", "-D", "warnings"]);
        }
        cargo(&arguments)
    })?;
    step("docs", || {
        let flags = if strict { "-D warnings" } else { "" };
        run(command("cargo").args(["doc", "--workspace", "--no-deps", "--quiet"]).env("RUSTDOCFLAGS", flags))
    })?;
    step("wasm32", wasm)?;
    let python = tools::python()?;
    tools::poppler();
    step("tests", || {
        let mut tests = command("cargo");
        run(tests.arg("test").args(EVERYTHING).env("LUMISTACK_PYTHON", &python))
    })?;
    step("USD versions", usd::check)?;
    step("plugins", || plugins::run(false))?;
    step("panels", || panels::check(full))?;
    step("python", python::check)?;
    step("blender", || blender::check(full))?;
    step("web", web::check)?;
    if full {
        step("slow tests", || {
            let mut tests = command("cargo");
            tests.args(["test", "--workspace", "--release", "--", "--ignored", "--nocapture", "--test-threads=1"]);
            run(tests.env("LUMISTACK_PYTHON", &python))
        })?;
    }
    Ok(())
}

/// [`run_steps`], timed as a whole.
pub fn run_ci(full: bool) -> Outcome {
    let start = Instant::now();
    run_steps(full)?;
    println!("\nci: everything passed in {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn step(name: &str, work: impl FnOnce() -> Outcome) -> Outcome {
    println!("\n=== {name}");
    let start = Instant::now();
    work()?;
    println!("=== {name}: {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// The portable crates compile to wasm32 without threads.
fn wasm() -> Outcome {
    if !tools::wasm_target() {
        println!("wasm32: skipped, this machine cannot get the target");
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
