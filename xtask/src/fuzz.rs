//! Fuzzes every reader by cargo-fuzz. Seeds are files of the repository and of other projects'
//! corpora.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, command, output_of};

/// Largest size of a seed, bytes. The fuzzer is faster with small files.
const MAX_SEED_BYTES: u64 = 64 << 10;

/// A target in `fuzz/fuzz_targets`. Its seeds are the files in `fuzz/seeds/NAME`, and files with
/// the given `extensions` in folders of the repository (`own`) and of the assets.
struct Target {
    name: &'static str,
    own: &'static [&'static str],
    assets: &'static [&'static str],
    extensions: &'static [&'static str],
}

const TARGETS: [Target; 11] = [
    Target {
        name: "load",
        own: &["crates/gltf/tests/data"],
        assets: &["gltf", "hostile/gltf"],
        extensions: &["gltf", "glb", "ktx2", "png", "jpg", "webp", "hdr"],
    },
    Target { name: "light_field", own: &[], assets: &[], extensions: &[] },
    Target { name: "quilt", own: &[], assets: &[], extensions: &[] },
    Target { name: "npy", own: &[], assets: &[], extensions: &[] },
    Target {
        name: "picture",
        own: &["scenes"],
        assets: &["gltf", "usd"],
        extensions: &["png", "jpg", "webp", "hdr", "exr"],
    },
    Target { name: "obj", own: &[], assets: &[], extensions: &["obj"] },
    Target { name: "splats", own: &[], assets: &[], extensions: &[] },
    Target { name: "display", own: &["scenes/displays"], assets: &[], extensions: &["toml"] },
    Target { name: "job", own: &["scenes", "tests/cases"], assets: &[], extensions: &["toml"] },
    Target { name: "stack", own: &[], assets: &[], extensions: &[] },
    Target { name: "calibration", own: &[], assets: &[], extensions: &[] },
];

/// Fuzzes every target, or only the target `only`, for `minutes` each. If inputs break a reader,
/// returns an error after all targets.
pub fn run(minutes: f64, only: Option<&str>) -> Outcome {
    let targets: Vec<&Target> = TARGETS.iter().filter(|target| only.is_none_or(|only| target.name == only)).collect();
    if targets.is_empty() {
        let known = TARGETS.each_ref().map(|target| target.name).join(", ");
        return Err(format!("expected a target ({known}), found {}", only.unwrap_or_default()));
    }
    let nightly = output_of(command("rustup").args(["run", "nightly", "cargo", "--version"])).is_some();
    if !nightly {
        println!("bench: without a nightly compiler, the installed compiler measures coverage (RUSTC_BOOTSTRAP=1)");
    }
    let Some(cargo_fuzz) = cargo_fuzz() else {
        println!("bench: nothing is fuzzed, since cargo-fuzz is missing and cannot be installed");
        return Ok(());
    };
    let mut broken = Vec::new();
    for target in targets {
        if let Err(error) = fuzz(target, minutes, &cargo_fuzz, nightly) {
            println!("bench: {}: {error}", target.name);
            broken.push(target.name);
        }
    }
    if broken.is_empty() {
        Ok(())
    } else {
        Err(format!("inputs that make readers fail ({}) are in target/fuzz", broken.join(", ")))
    }
}

fn fuzz(target: &Target, minutes: f64, cargo_fuzz: &Path, nightly: bool) -> Outcome {
    let build = tools::root().join("target/fuzz");
    let work = build.join("targets").join(target.name);
    let (seeds, corpus, found) = (work.join("seeds"), work.join("corpus"), work.join("found"));
    let make =
        |folder: &Path| std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()));
    for folder in [&seeds, &corpus, &found] {
        make(folder)?;
    }
    // Collect the seeds.
    let assets = tools::assets();
    let own = target.own.iter().map(|folder| tools::root().join(folder));
    let folders = own.chain(target.assets.iter().map(|folder| assets.join(folder)));
    let mut count: usize = folders.map(|folder| copy_seeds(&folder, &seeds, target.extensions)).sum();
    count += copy_seeds(&tools::root().join("fuzz/seeds").join(target.name), &seeds, &["seed"]);
    println!("bench: {}: {count} seeds, {minutes} minutes", target.name);
    // Start the fuzzer in a clean environment.
    let mut fuzzer = if nightly { command("rustup") } else { command(cargo_fuzz) };
    // remove the variables that cargo has set for xtask, which would select xtask's toolchain
    for variable in ["CARGO", "RUSTC", "RUSTUP_TOOLCHAIN", "RUSTFLAGS", "CARGO_TARGET_DIR"] {
        fuzzer.env_remove(variable);
    }
    if nightly {
        fuzzer.args(["run", "nightly"]).arg(cargo_fuzz);
    } else {
        fuzzer.env("RUSTC_BOOTSTRAP", "1");
    }
    // -O builds with the release profile, to which fuzz/Cargo.toml adds debug assertions and
    // overflow checks.
    fuzzer.args(["run", "-O", "--sanitizer", "none", "--target-dir"]).arg(&build);
    fuzzer.arg(target.name).arg(&corpus).arg(&seeds).arg("--");
    let seconds = (60.0 * minutes).ceil().max(1.0);
    fuzzer.arg(format!("-max_total_time={seconds}")).arg(format!("-artifact_prefix={}/", found.display()));
    // Set limits of time, size and memory. A reader needs milliseconds for an input of this size.
    // The target `load` limits a scene to 64 MiB. In other targets the size in a picture's header
    // may demand much memory, up to the limits of the readers.
    let memory_mib = if target.name == "load" { 1024 } else { 8192 };
    fuzzer.args(["-timeout=25", "-max_len=65536", "-print_final_stats=1", "-verbosity=1"]);
    fuzzer.arg(format!("-rss_limit_mb={memory_mib}"));
    tools::run(&mut fuzzer)
}

/// Finds or installs cargo-fuzz; `None` if that fails.
fn cargo_fuzz() -> Option<PathBuf> {
    let works = |program: &Path| output_of(command(program).arg("--version")).is_some();
    let installed = PathBuf::from("cargo-fuzz");
    if works(&installed) {
        return Some(installed);
    }
    let root = tools::root().join("target/fuzz-tools");
    let own = root.join("bin/cargo-fuzz");
    if !works(&own) {
        println!("\nfetching: cargo-fuzz, in target/fuzz-tools (used only to fuzz readers)");
        let mut install = command("cargo");
        install.args(["install", "cargo-fuzz", "--locked", "--root"]).arg(&root);
        tools::run(&mut install).ok()?;
    }
    works(&own).then_some(own)
}

/// Copies the seeds of a folder into one flat folder, and returns their number.
fn copy_seeds(folder: &Path, seeds: &Path, extensions: &[&str]) -> usize {
    let mut count = 0;
    let mut open = vec![folder.to_owned()];
    while let Some(directory) = open.pop() {
        for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
            let path = entry.path();
            let is_small = entry.metadata().is_ok_and(|meta| meta.is_file() && meta.len() <= MAX_SEED_BYTES);
            let is_input = path.extension().is_some_and(|found| extensions.iter().any(|known| found == *known));
            if path.is_dir() {
                open.push(path);
            } else if is_small && is_input {
                let name = path.strip_prefix(folder).unwrap_or(&path).display().to_string().replace(['/', '\\'], "-");
                let Ok(bytes) = std::fs::read(&path) else { continue };
                // a Draco stream in the file becomes a seed of its own
                let stream = bytes.windows(5).position(|window| window == b"DRACO").map(|at| &bytes[at..]);
                for (name, bytes) in [(name.clone(), Some(&*bytes)), (format!("{name}.drc"), stream)] {
                    count += usize::from(bytes.is_some_and(|bytes| std::fs::write(seeds.join(name), bytes).is_ok()));
                }
            }
        }
    }
    count
}
