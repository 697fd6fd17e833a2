//! Builds the modules and pages of the browser simulator, measures them, tests them in a browser,
//! and compares them with the committed files.
//!
//! `web/dist` is committed, so that the program can write previews on machines without a
//! WebAssembly toolchain. This folder contains three hashes: of the modules' sources, of the other
//! sources, and of its own files. If a hash differs from the hash of the present files, the page
//! was not rebuilt after a change, or was changed by hand. If all hashes agree, tests use the
//! committed files, since a build of the same sources would take minutes and give the same bytes.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::tools::{self, Outcome, command, output_of, root};

/// A WebAssembly module.
struct Module {
    package: &'static str,
    /// Features of the package.
    features: &'static str,
    /// Name of the module. The names of the module's files begin with this name.
    name: &'static str,
    profile: &'static str,
    /// True if the standard library is compiled for this module without the messages of panics,
    /// which no page shows.
    bare: bool,
}

/// The viewer's module, and the modules of the page that solves (`solve.html`).
const MODULES: [Module; 5] = [
    Module { package: "lumistack-web", features: "", name: "lumistack_web", profile: "web", bare: false },
    Module {
        package: "lumistack-web-solver",
        features: "",
        name: "lumistack_web_solver",
        profile: "web-solver",
        bare: true,
    },
    Module {
        package: "lumistack-web-solver",
        features: "gpu",
        name: "lumistack_web_solver_gpu",
        profile: "web-solver",
        bare: true,
    },
    Module {
        package: "lumistack-web-decoders",
        features: "pictures",
        name: "lumistack_web_pictures",
        profile: "web-solver",
        bare: true,
    },
    Module {
        package: "lumistack-web-decoders",
        features: "",
        name: "lumistack_web_decoders",
        profile: "web-solver",
        bare: true,
    },
];
/// Folder of the modules and of the scripts that load them. It is not committed.
const PACKAGE: &str = "web/pkg";
/// Folder of the pages. It is committed.
const DIST: &str = "web/dist";
/// File with three lines: the hashes of the modules' sources, of the pages' sources, and of the
/// files of `web/dist`.
const HASH: &str = "web/dist/sources.blake3";
/// The parts of the site: name, files, and the largest compressed size of these files together,
/// bytes. Decoders are loaded only for files that need them.
const BUDGETS: [(&str, &[&str], usize); 7] = [
    ("page", &["index.html", "viewer.js", "lumistack_web_bg.wasm"], 150_000),
    ("other displays", &["bridge.js", "headset.js", "lenticular.js"], 8_000),
    ("page that solves", &["solve.html", "solve.js"], 15_000),
    ("solver", &["lumistack_web_solver_bg.wasm"], 480_000),
    ("solver with WebGPU", &["solve-gpu.js", "lumistack_web_solver_gpu_bg.wasm"], 600_000),
    ("decoders of common pictures", &["lumistack_web_pictures_bg.wasm"], 125_000),
    ("decoders", &["lumistack_web_decoders_bg.wasm"], 560_000),
];
/// Sources of the modules. The modules' hash also covers the versions of their dependencies.
const MODULE_SOURCES: [&str; 21] = [
    "crates/core/src",
    "crates/display/src",
    "crates/factorizer/src",
    "crates/factorizer-gpu/Cargo.toml",
    "crates/factorizer-gpu/src",
    "crates/field-io/src",
    "crates/files/src",
    "crates/gltf/src",
    "crates/pathtracer/src",
    "crates/scene/src",
    "crates/shot/src",
    "crates/simd/src",
    "crates/splats/src",
    "crates/web-decoders/Cargo.toml",
    "crates/web-decoders/src",
    "crates/web/Cargo.toml",
    "crates/web/src",
    "crates/web-solver/Cargo.toml",
    "crates/web-solver/src",
    "scenes/displays",
    "xtask/examples/bindgen.rs",
];
/// Sources of the pages, in addition to the modules.
const PAGE_SOURCES: [&str; 6] =
    ["scenes/dandelion", "scenes/letters", "scenes/still-life", "web/build.mjs", "web/package-lock.json", "web/src"];

/// Builds modules and pages into `web/dist`, and measures them.
pub fn build() -> Outcome {
    modules()?;
    bundle()
}

/// Builds the pages with the committed modules, which takes seconds. Fails if the modules' sources
/// have changed.
pub fn pages() -> Outcome {
    let committed = fs::read_to_string(root().join(HASH)).unwrap_or_default();
    if committed.lines().next() != Some(&module_hash()?) {
        return Err("web: the modules' sources have changed; run `cargo xtask web`".into());
    }
    for Module { name, .. } in &MODULES {
        let [built, used] = [PACKAGE, DIST].map(|folder| fs::read(root().join(folder).join(format!("{name}_bg.wasm"))));
        if !matches!((built, used), (Ok(built), Ok(used)) if built == used) {
            return Err(format!(
                "web: module {name}: expected the same file in {PACKAGE} and {DIST}, found different files or no file; run `cargo xtask web`"
            ));
        }
    }
    npm_packages()?;
    bundle()
}

fn bundle() -> Outcome {
    tools::run(command("npm").args(["run", "--silent", "build", "--prefix", "web"]))?;
    fs::write(root().join(HASH), hashes()?).map_err(|error| format!("{HASH}: {error}"))?;
    measure()
}

/// Fails if the committed pages were not made from the present sources. Then measures and tests the
/// pages.
pub fn check() -> Outcome {
    let (now, committed) = (hashes()?, fs::read_to_string(root().join(HASH)).unwrap_or_default());
    let parts = ["the modules' sources", "the pages' sources", "the files of web/dist"];
    for (i, what) in parts.into_iter().enumerate() {
        let [now, committed] = [&now, &committed].map(|hashes| hashes.lines().nth(i));
        if now != committed {
            let (now, committed) = (now.unwrap_or("none"), committed.unwrap_or("none"));
            let remedy = "run `cargo xtask web`, and commit the files in web/dist";
            return Err(format!(
                "web: {HASH}: expected {now}, the present hash of {what}, found {committed}; {remedy}"
            ));
        }
    }
    measure()?;
    fixtures()?;
    browser_tests()
}

/// Computes the content that [`HASH`] should have.
fn hashes() -> Outcome<String> {
    let mut dist = Vec::new();
    collect(&root().join(DIST), &mut dist)?;
    dist.retain(|path| *path != root().join(HASH));
    let mut pages = Vec::new();
    PAGE_SOURCES.iter().try_for_each(|source| collect(&root().join(source), &mut pages))?;
    let [pages, dist] = [hash_of(pages)?, hash_of(dist)?].map(|hash| hash.finalize().to_hex());
    Ok(format!("{}\n{pages}\n{dist}\n", module_hash()?))
}

/// Fetches the browser and the npm packages.
///
/// # Errors
/// If they cannot be installed.
pub fn fetch() -> Outcome {
    npm_packages()?;
    firefox();
    chromium().map(drop)
}

/// Builds the modules into `web/pkg`.
pub fn modules() -> Outcome {
    MODULES.iter().try_for_each(module)
}

fn module(&Module { package: name_of_package, features, name, profile, bare }: &Module) -> Outcome {
    if !tools::wasm_target() {
        return Err(
            "web: this machine cannot get the Rust target wasm32-unknown-unknown (`rustup target add` adds it)".into(),
        );
    }
    let target = target_folder()?;
    let mut flags = rustflags();
    let mut build = command("cargo");
    build.args(["build", "--quiet", "--profile", profile, "--target", WASM, "--package", name_of_package]);
    build.args(["--features", features]);
    if bare {
        // These options make the module a third smaller. The workspace's compiler calls them
        // unstable, so RUSTC_BOOTSTRAP must allow them.
        tools::rust_sources()?;
        flags.extend(["-Zunstable-options", "-Cpanic=immediate-abort"].map(str::to_owned));
        build.env("RUSTC_BOOTSTRAP", "1").arg("-Zbuild-std=std,panic_abort");
    }
    tools::run(build.args(["--config", &format!("target.{WASM}.rustflags={flags:?}")]))?;
    let built = target.join(WASM).join(profile).join(format!("{}.wasm", name_of_package.replace('-', "_")));
    let package = root().join(PACKAGE);
    fs::create_dir_all(&package).map_err(|error| format!("{}: {error}", package.display()))?;
    let mut bindgen = command("cargo");
    bindgen.args(["run", "--quiet", "--package", "xtask", "--features", "bindgen", "--example", "bindgen", "--"]);
    tools::run(bindgen.arg(&built).arg(&package).arg(name))?;
    npm_packages()?;
    let module = package.join(format!("{name}_bg.wasm"));
    let bytes = fs::read(&module).map_err(|error| format!("{}: {error}", module.display()))?;
    for folder in [".rustup", ".cargo"] {
        if bytes.windows(folder.len()).any(|part| part == folder.as_bytes()) {
            return Err(format!("web: {}: expected no path of this machine, found {folder}", module.display()));
        }
    }
    // With `-Os` the code is smaller, but its compressed form is larger: 500 kB for the solver, not
    // 464 kB. Brotli finds more repetitions in code that the optimizer changes little. It also
    // finds more if similar functions are neighbours, and the order by names makes them neighbours.
    let mut optimize = command(root().join("web/node_modules/.bin/wasm-opt"));
    optimize.args(["-O1", "--shrink-level=1", "--reorder-functions-by-name", "--strip-debug", "--strip-producers"]);
    optimize.args(FEATURES);
    tools::run(optimize.arg(&module).arg("-o").arg(&module))
}

const WASM: &str = "wasm32-unknown-unknown";
/// Returns flags of rustc. The flags enable fixed-width vectors, which every browser has had since
/// 2023, and remove paths of the build machine from messages.
fn rustflags() -> Vec<String> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| std::env::home_dir().map(|home| home.join(".cargo"))).unwrap_or_default();
    let registries = fs::read_dir(home.join("registry/src")).into_iter().flatten().flatten();
    let mut flags = vec!["-Ctarget-feature=+simd128".to_owned()];
    // If the component rust-src is installed, messages of the standard library would contain paths
    // of this machine.
    if let Some(sysroot) = output_of(command("rustc").args(["--print", "sysroot"])) {
        flags.push(format!("--remap-path-prefix={}/lib/rustlib/src/rust=std", sysroot.trim()));
    }
    flags.extend(registries.map(|folder| format!("--remap-path-prefix={}=crates", folder.path().display())));
    flags.sort();
    flags
}
/// Options of the optimizer that allow the WebAssembly instructions that the compiler uses.
const FEATURES: [&str; 8] = [
    "--enable-bulk-memory",
    // only the module with WebGPU needs exceptions, since its functions can be suspended while they
    // wait for the GPU
    "--enable-exception-handling",
    "--enable-nontrapping-float-to-int",
    "--enable-sign-ext",
    "--enable-mutable-globals",
    "--enable-simd",
    "--enable-reference-types",
    "--enable-multivalue",
];

/// Writes the previews and reference views for the browser tests.
pub fn fixtures() -> Outcome {
    let folder = root().join("web/tests/fixtures");
    tools::build_everything()?;
    tools::run(command(target_folder()?.join("debug/examples/fixtures")).arg(&folder))
}

/// Runs the tests of `web/tests` in a headless browser.
pub fn browser_tests() -> Outcome {
    let chromium = chromium()?;
    firefox();
    // build the program, since tests run `lumistack preview` and `lumistack live`
    tools::build_everything()?;
    let binary = target_folder()?.join("debug").join(format!("lumistack{}", std::env::consts::EXE_SUFFIX));
    let mut tests = command("npm");
    tests
        .args(["test", "--silent", "--prefix", "web"])
        .env("LUMISTACK_CHROMIUM", chromium)
        .env("LUMISTACK_BIN", binary);
    tools::run(tests.env("LUMISTACK_FIXTURES", root().join("web/tests/fixtures")))
}

/// Times the committed page with the preview of the main example.
pub fn bench() -> Outcome {
    npm_packages()?;
    firefox();
    let (program, folder) = (release_program()?, root().join("target/web-bench"));
    let run = folder.join("still-life");
    tools::run(command(program).arg("run").arg(root().join("scenes/still-life/job.toml")).arg("-o").arg(&run))?;
    let mut bench = command("node");
    bench
        .arg(root().join("xtask/bench/web.mjs"))
        .arg(run.join("outputs/tensor-display/preview"))
        .arg(folder.join("shots"));
    tools::run(bench.env("LUMISTACK_CHROMIUM", chromium()?))
}

/// Times the committed page that solves, with FlightHelmet and with its own scenes.
pub fn bench_solve() -> Outcome {
    npm_packages()?;
    let model = tools::assets().join("gltf/FlightHelmet/FlightHelmet.gltf");
    if !model.is_file() {
        return Err(format!("bench: expected {}, found none; LUMISTACK_ASSETS sets the folder", model.display()));
    }
    let mut bench = command("node");
    bench.arg(root().join("xtask/bench/web_solve.mjs")).arg(release_program()?);
    bench.arg(root().join("target/web-bench/solve")).arg(model);
    tools::run(bench.env("LUMISTACK_CHROMIUM", chromium()?))
}

/// Builds the command's release binary, and returns its path.
fn release_program() -> Outcome<PathBuf> {
    tools::cargo(&["build", "--release", "--package", "lumistack-cli"])?;
    Ok(target_folder()?.join("release").join(format!("lumistack{}", std::env::consts::EXE_SUFFIX)))
}

/// Finds Chromium: the program that `LUMISTACK_CHROMIUM` names, or the system's. Installs it if it
/// is missing.
fn chromium() -> Outcome<PathBuf> {
    if let Some(path) = std::env::var_os("LUMISTACK_CHROMIUM") {
        return Ok(path.into());
    }
    let found = || {
        let places = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
        places.into_iter().map(PathBuf::from).find(|path| path.is_file())
    };
    if let Some(path) = found() {
        return Ok(path);
    }
    let install = tools::apt(&["chromium"], "test the simulator's page");
    found().ok_or_else(|| {
        let error = install.err().unwrap_or_default();
        format!(
            "web: expected Chromium for the test of the page, found none. Install Chromium, or set LUMISTACK_CHROMIUM to the path of a Chromium program. {error}"
        )
    })
}

/// Installs Firefox if the test in Firefox would not find it.
fn firefox() {
    let there = || {
        std::env::var_os("LUMISTACK_FIREFOX").is_some()
            || ["/usr/bin/firefox-esr", "/usr/bin/firefox"].iter().any(|path| Path::new(path).is_file())
    };
    if !there()
        && let Err(error) = tools::apt(&["firefox-esr"], "test the page that solves")
    {
        tools::skipped("web: the page that solves in Firefox", &error);
    }
}

/// Prints the sizes of all parts: plain, compressed with gzip, and compressed with Brotli. It is an
/// error if the size with Brotli exceeds the part's budget, since static hosts send Brotli to all
/// current browsers.
fn measure() -> Outcome {
    let script = "const z = require('zlib'), b = require('fs').readFileSync(process.argv[1]); \
        console.log(b.length, z.gzipSync(b, { level: 9 }).length, z.brotliCompressSync(b).length)";
    for (part, names, budget) in BUDGETS {
        let mut total = [0; 3];
        for name in names {
            let path = root().join(DIST).join(name);
            let said = output_of(command("node").args(["-e", script]).arg(&path));
            let sizes =
                said.map(|text| text.split_whitespace().filter_map(|word| word.parse().ok()).collect::<Vec<usize>>());
            let sizes = sizes
                .filter(|sizes| sizes.len() == 3)
                .ok_or_else(|| format!("{}: expected three sizes from Node.js, found none", path.display()))?;
            println!("{name:>28} {:8} bytes, gzip {:7}, brotli {:7}", sizes[0], sizes[1], sizes[2]);
            (0..3).for_each(|i| total[i] += sizes[i]);
        }
        println!("{part:>28} {:8} bytes, gzip {:7}, brotli {:7} of {budget}", total[0], total[1], total[2]);
        if total[2] > budget {
            return Err(format!(
                "web: {part}: expected at most {budget} bytes, compressed with Brotli, found {}",
                total[2]
            ));
        }
    }
    Ok(())
}

/// Returns a hash of the names and contents of the modules' sources, of the build profile, and of
/// the versions of all crates in the modules.
fn module_hash() -> Outcome<String> {
    let mut files = Vec::new();
    for source in MODULE_SOURCES {
        collect(&root().join(source), &mut files)?;
    }
    let mut hash = hash_of(files)?;
    let manifest = fs::read_to_string(root().join("Cargo.toml")).map_err(|error| format!("Cargo.toml: {error}"))?;
    let profile = manifest.find("[profile.web]").ok_or("Cargo.toml: expected [profile.web], found none")?;
    hash.update(&manifest.as_bytes()[profile..]);
    // hash the names and versions of the dependencies, as cargo prints them
    let mut crates = Vec::new();
    for Module { package, features, .. } in &MODULES {
        let tree = ["tree", "--package", package, "--target", WASM, "--edges", "normal,build", "--prefix", "none"];
        let rest = ["--features", features, "--format", "{p}", "--locked"];
        let tree = output_of(command("cargo").args(tree).args(rest)).ok_or("cargo tree failed")?;
        crates.extend(tree.lines().map(|line| line.split(" (").next().unwrap_or(line).to_owned()));
    }
    crates.sort_unstable();
    crates.dedup();
    hash.update(crates.join("\n").as_bytes());
    Ok(hash.finalize().to_hex().to_string())
}

/// Returns a hash of the names, sizes and contents of files, in the order of their names.
fn hash_of(mut files: Vec<PathBuf>) -> Outcome<blake3::Hasher> {
    files.sort();
    let mut hash = blake3::Hasher::new();
    for path in &files {
        let name = path.strip_prefix(root()).map_err(|error| error.to_string())?.to_string_lossy().replace('\\', "/");
        let bytes = fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        hash.update(name.as_bytes()).update(&(bytes.len() as u64).to_le_bytes()).update(&bytes);
    }
    Ok(hash)
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) -> Outcome {
    if path.is_file() {
        files.push(path.to_owned());
        return Ok(());
    }
    let entries = fs::read_dir(path).map_err(|error| format!("{}: {error}", path.display()))?;
    for entry in entries {
        collect(&entry.map_err(|error| error.to_string())?.path(), files)?;
    }
    Ok(())
}

/// Returns Cargo's target folder.
pub fn target_folder() -> Outcome<PathBuf> {
    let metadata = output_of(command("cargo").args(["metadata", "--format-version", "1", "--no-deps"]))
        .and_then(|text| serde_json::from_str::<Value>(&text).ok())
        .ok_or("cargo metadata failed")?;
    let folder = metadata["target_directory"].as_str().map(PathBuf::from);
    folder.ok_or_else(|| "cargo metadata names no target folder".into())
}

/// Installs the npm packages of `web/package-lock.json` if they are missing or older than that
/// file.
fn npm_packages() -> Outcome {
    let web = root().join("web");
    let (lock, installed) = (web.join("package-lock.json"), web.join("node_modules/.package-lock.json"));
    let time = |path: &Path| fs::metadata(path).and_then(|data| data.modified()).ok();
    if time(&installed).is_some_and(|installed| time(&lock).is_some_and(|lock| lock <= installed)) {
        return Ok(());
    }
    if output_of(command("npm").arg("--version")).is_none() {
        tools::apt(&["nodejs", "npm"], "build and test the simulator's page")
            .map_err(|error| format!("web: npm does not start; install Node.js 20 or newer ({error})"))?;
    }
    println!(
        "\nfetching: the npm packages of web/package-lock.json, in web/node_modules (used only to build and test the page)"
    );
    tools::run(command("npm").args(["ci", "--no-audit", "--no-fund", "--prefix"]).arg(&web))
}
