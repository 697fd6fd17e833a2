//! Fuzzing of glTF ingest with cargo-fuzz, from the corpora of others as seeds.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, command, output_of};

/// Largest file that becomes a seed: small ones are mutated fastest.
const MAX_SEED_BYTES: u64 = 64 << 10;

/// Runs the fuzzer for some minutes; an input that breaks ingest is an error.
pub fn run(minutes: u64) -> Outcome {
    if output_of(command("rustup").args(["run", "nightly", "cargo", "--version"])).is_none() {
        println!("bench: nothing is fuzzed: there is no nightly compiler (`rustup toolchain install nightly`)");
        return Ok(());
    }
    let Some(cargo_fuzz) = cargo_fuzz() else {
        println!("bench: nothing is fuzzed: there is no cargo-fuzz, and it could not be installed");
        return Ok(());
    };
    let work = tools::root().join("target/fuzz");
    let (seeds, corpus, found) = (work.join("seeds"), work.join("corpus"), work.join("found"));
    let make =
        |folder: &Path| std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()));
    for folder in [&seeds, &corpus, &found] {
        make(folder)?;
    }
    let assets = std::env::var_os("LUMISTACK_ASSETS").map(PathBuf::from);
    let assets = assets.unwrap_or_else(|| tools::root().join("../shared/scenes"));
    let mut count = 0;
    for folder in [tools::root().join("crates/gltf/tests/data"), assets.join("gltf"), assets.join("hostile/gltf")] {
        count += copy_seeds(&folder, &seeds);
    }
    println!("bench: {count} seeds, {minutes} minutes");
    let mut fuzzer = command("rustup");
    // the toolchain that runs this task must not be the one that builds the fuzzer
    for variable in ["CARGO", "RUSTC", "RUSTUP_TOOLCHAIN", "RUSTFLAGS", "CARGO_TARGET_DIR"] {
        fuzzer.env_remove(variable);
    }
    // -O: the checks are those of the profile in fuzz/Cargo.toml, which excepts a library
    fuzzer
        .args(["run", "nightly"])
        .arg(cargo_fuzz)
        .args(["run", "-O", "--sanitizer", "none", "--target-dir"])
        .arg(&work);
    fuzzer.arg("load").arg(&corpus).arg(&seeds).arg("--");
    fuzzer.arg(format!("-max_total_time={}", 60 * minutes)).arg(format!("-artifact_prefix={}/", found.display()));
    // a file of this size takes milliseconds, and may take 64 MiB
    fuzzer.args(["-timeout=10", "-rss_limit_mb=1024", "-max_len=65536", "-print_final_stats=1", "-verbosity=1"]);
    tools::run(&mut fuzzer)
}

/// cargo-fuzz, installed if need be; `None` where it cannot be had.
fn cargo_fuzz() -> Option<PathBuf> {
    let works = |program: &Path| output_of(command(program).arg("--version")).is_some();
    let installed = PathBuf::from("cargo-fuzz");
    if works(&installed) {
        return Some(installed);
    }
    let root = tools::root().join("target/fuzz-tools");
    let own = root.join("bin/cargo-fuzz");
    if !works(&own) {
        println!("\nfetching: cargo-fuzz, in target/fuzz-tools (used only to fuzz glTF ingest)");
        let mut install = command("cargo");
        install.args(["install", "cargo-fuzz", "--locked", "--root"]).arg(&root);
        tools::run(&mut install).ok()?;
    }
    works(&own).then_some(own)
}

/// Copies what can be a seed, flat, and returns how many files that were.
fn copy_seeds(folder: &Path, seeds: &Path) -> usize {
    let mut count = 0;
    let mut open = vec![folder.to_owned()];
    while let Some(directory) = open.pop() {
        for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
            let path = entry.path();
            let is_small = entry.metadata().is_ok_and(|meta| meta.is_file() && meta.len() <= MAX_SEED_BYTES);
            let is_input = path.extension().is_some_and(|extension| {
                ["gltf", "glb", "ktx2", "png", "jpg", "webp", "hdr"].iter().any(|known| extension == *known)
            });
            if path.is_dir() {
                open.push(path);
            } else if is_small && is_input {
                let name = path.strip_prefix(folder).unwrap_or(&path).display().to_string().replace(['/', '\\'], "-");
                let Ok(bytes) = std::fs::read(&path) else { continue };
                // a Draco stream by itself too
                let stream = bytes.windows(5).position(|window| window == b"DRACO").map(|at| &bytes[at..]);
                for (name, bytes) in [(name.clone(), Some(&*bytes)), (format!("{name}.drc"), stream)] {
                    count += usize::from(bytes.is_some_and(|bytes| std::fs::write(seeds.join(name), bytes).is_ok()));
                }
            }
        }
    }
    count
}
