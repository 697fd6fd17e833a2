//! Runs all checks that must pass before a change is merged.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::blender;
use crate::compiler;
use crate::deny;
use crate::layers::{self, PORTABLE};
use crate::package;
use crate::panels;
use crate::plugins;
use crate::python;
use crate::pythons;
use crate::site;
use crate::tools::{self, EVERYTHING, Outcome, cargo, command, output_of, run};
use crate::usd;
use crate::web;
use crate::words;
use crate::workflows;

/// The Rust version whose lints must pass. Another version may have lints that the code does not
/// satisfy, so with another version lints only warn.
const LINTED_WITH: &str = "1.95";

/// The finished steps, with the seconds that each took.
#[derive(Default)]
struct Steps(Mutex<Vec<(&'static str, f64)>>);

impl Steps {
    fn step(&self, name: &'static str, work: impl FnOnce() -> Outcome) -> Outcome {
        println!("\n=== {name}");
        let start = Instant::now();
        let result = work();
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((name, start.elapsed().as_secs_f64()));
        result
    }
}

/// Runs all checks; `full` adds the slow tests. Processors are the bottleneck, so steps that wait
/// for the network or other programs run in parallel with steps that compile.
fn run_steps(full: bool, steps: &Steps) -> Outcome {
    let version = output_of(command("rustc").arg("--version")).ok_or("rustc does not start")?;
    let strict = version.contains(&format!("rustc {LINTED_WITH}."));
    if !strict {
        println!("lints: expected rustc {LINTED_WITH}, found {}, so lints only warn", version.trim());
    }
    steps.step("format", || cargo(&["fmt", "--all", "--check"]))?;
    steps.step("layers", layers::check)?;
    steps.step("words", || words::check(false))?;
    let python = beside(
        || {
            let mut python = PathBuf::new();
            steps.step("fetch (beside the next steps)", || {
                python = fetch()?;
                Ok(())
            })?;
            steps.step("dependencies", deny::in_ci)?;
            steps.step("packages", package::check)?;
            Ok(python)
        },
        || {
            let target = tools::root().join("target");
            compiler::choose(&target, strict).map_err(|error| format!("{}: {error}", target.display()))?;
            steps.step("build, clippy, docs", || cargo(&[&["build", "--all-targets"], &EVERYTHING[..]].concat()))?;
            steps.step("wasm32", wasm)
        },
    )?;
    // three rows of steps run in parallel, since each step waits at times
    let web = beside(
        || {
            let web = steps.step("web (beside the next steps)", web::check);
            steps.step("USD versions", usd::check)?;
            steps.step("workflows", workflows::check)?;
            steps.step("site", site::docs)?;
            Ok(web)
        },
        || {
            beside(
                || {
                    steps.step("plugins (beside the next steps)", || plugins::run(false))?;
                    steps.step("python", || python::check(pythons::Versions::Oldest))?;
                    steps.step("blender", || blender::check(full))
                },
                || {
                    steps.step("tests", || {
                        let mut tests = command("cargo");
                        // skip the tests of presentations, which run in the step `panels`
                        run(tests
                            .arg("test")
                            .args(EVERYTHING)
                            .args(["--", "--skip", "show::"])
                            .env("LUMISTACK_PYTHON", &python))
                    })?;
                    steps.step("panels", || panels::sessions(full))
                },
            )
        },
    )?;
    // Browsers give up a page that other steps delay for too long. So if the step `web` has failed,
    // it runs again while no other step runs.
    if let Err(error) = web {
        println!("\n{error}; the tests of the page run again, alone");
        steps.step("web, alone", web::check)?;
    }
    // run this step alone, since it counts refreshes, which other steps would delay
    steps.step("stalls", || panels::stalls(full))?;
    if full {
        steps.step("slow tests", || {
            let mut tests = command("cargo");
            tests.args(["test", "--workspace", "--release", "--", "--ignored", "--nocapture", "--test-threads=1"]);
            // clippy's driver would compile slower programs
            run(tests.env("LUMISTACK_PYTHON", &python).env_remove(compiler::WRAPPER))
        })?;
    }
    Ok(())
}

/// Runs both functions in parallel. Returns the result of `waits`, or an error if one of them
/// fails.
fn beside<T: Send>(waits: impl FnOnce() -> Outcome<T> + Send, works: impl FnOnce() -> Outcome) -> Outcome<T> {
    std::thread::scope(|scope| {
        let waits = scope.spawn(waits);
        let worked = works();
        let waited = waits.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        worked.and(waited)
    })
}

/// Fetches software for the checks, and returns the Python of the tests. A step whose software is
/// missing skips its checks.
fn fetch() -> Outcome<PathBuf> {
    let python = tools::python()?;
    tools::poppler();
    for fetched in
        [python::fetch(&python), pythons::fetch(), usd::fetch(), panels::fetch(), blender::fetch(), web::fetch()]
    {
        if let Err(error) = fetched {
            println!("fetch: {error}");
        }
    }
    Ok(python)
}

/// Longest time of a program that the checks without `--full` start. The limit ends a program that
/// hangs, before CI itself ends the checks. On a slow machine, `cargo test` took 25 minutes beside
/// other steps, more than twice its time on a fast one.
const LONGEST: Duration = Duration::from_mins(45);

/// Runs all checks, and prints a table with the time of each step.
pub fn run_ci(full: bool) -> Outcome {
    if !full {
        tools::limit(LONGEST);
    }
    let (start, steps) = (Instant::now(), Steps::default());
    let result = run_steps(full, &steps);
    println!("\n{:>8}  step", "seconds");
    for (name, seconds) in steps.0.into_inner().unwrap_or_else(PoisonError::into_inner) {
        println!("{seconds:8.0}  {name}");
    }
    println!("{:8.0}  in all", start.elapsed().as_secs_f64());
    result?;
    println!("\nci: every check that was run passed");
    Ok(())
}

/// Checks that the portable crates and the viewer's crate compile to wasm32, without threads and
/// with WebAssembly's vectors, as in the modules of the pages.
fn wasm() -> Outcome {
    if !tools::wasm_target() {
        tools::skipped("wasm32", "this machine cannot get the Rust target wasm32-unknown-unknown");
        return Ok(());
    }
    let check = ["check", "--quiet", "--target", "wasm32-unknown-unknown", "--no-default-features"];
    let mut arguments = [&check[..], &["--config", SIMD128]].concat();
    for name in PORTABLE.into_iter().chain(["lumistack-web"]) {
        arguments.extend(["--package", name]);
    }
    cargo(&arguments)?;
    // only `lumistack-simd` has code that depends on vectors; it must compile without vectors, too
    cargo(&[&check[..], &["--package", "lumistack-simd"]].concat())
}

/// Flags of rustc for the fixed-width vectors of WebAssembly.
const SIMD128: &str = "target.wasm32-unknown-unknown.rustflags=['-Ctarget-feature=+simd128']";
