//! Runs programs, and fetches the software that tests need.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use crate::compiler;

/// The result of a step; an error is one sentence.
pub type Outcome<T = ()> = Result<T, String>;

/// Returns the workspace's root folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask is a folder of the workspace").to_owned()
}

/// Returns the folder of scenes of other projects: LUMISTACK_ASSETS, or its default.
pub fn assets() -> PathBuf {
    std::env::var_os("LUMISTACK_ASSETS").map_or_else(|| root().join("../shared/scenes"), PathBuf::from)
}

/// Runs cargo in the workspace.
pub fn cargo(arguments: &[&str]) -> Outcome {
    run(command("cargo").args(arguments))
}

/// The packages and features that CI compiles, lints and documents. All steps use this selection,
/// so that nothing is compiled twice. It includes the windows of panels.
pub const EVERYTHING: [&str; 3] = ["--workspace", "--features", "lumistack-plugin-panels/window,lumistack-cli/panels"];

/// Builds all programs, the Python module and all examples into `target/debug`. The examples
/// include the libraries of plugins.
///
/// Examples may use development dependencies, as tests do. So if a build includes examples, cargo
/// selects the same features as for `cargo test`. With other features, cargo would compile a third
/// of the workspace again.
pub fn build_everything() -> Outcome {
    cargo(&[&["build", "--quiet"], &EVERYTHING[..], &["--lib", "--bins", "--examples"]].concat())
}

/// Returns a command for a program that runs in the workspace's root. If the program runs tests,
/// its skipped tests are added to the list of skipped checks.
pub fn command(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root()).env(SKIPPED, skip_list());
    compiler::set(&mut command);
    command
}

/// Environment variable with the path of the list of skipped checks, to which
/// `lumistack_testkit::skip` and the Python tests also write.
const SKIPPED: &str = "LUMISTACK_SKIPPED";

fn skip_list() -> PathBuf {
    root().join("target/skipped.txt")
}

/// Returns true on continuous integration (the variable `CI` is set), where a skipped check is a
/// failure.
fn is_ci() -> bool {
    std::env::var("CI").is_ok_and(|value| !["", "0", "false"].contains(&value.as_str()))
}

/// Reports that a check is skipped, and the reason. [`account_of_skipped`] lists all skipped checks
/// at the end.
pub fn skipped(check: &str, why: &str) {
    use std::io::Write;
    let line = format!("{check}: {}", why.replace('\n', " "));
    println!("skipped: {line}");
    let list = std::fs::OpenOptions::new().create(true).append(true).open(skip_list());
    // write the line in one call, since steps that run in parallel write to the same file
    if let Err(error) = list.and_then(|mut list| list.write_all(format!("{line}\n").as_bytes())) {
        println!("{}: {error}", skip_list().display());
    }
}

/// Empties the list of skipped checks.
pub fn forget_skipped() {
    let _ = std::fs::remove_file(skip_list());
}

/// Prints the checks that were skipped since [`forget_skipped`].
///
/// # Errors
/// On CI (`CI=true`), if a check was skipped.
pub fn account_of_skipped() -> Outcome {
    account(&std::fs::read_to_string(skip_list()).unwrap_or_default(), is_ci())
}

/// Prints a list of skipped checks, one on each line. On CI a list with any check is an error.
fn account(list: &str, is_ci: bool) -> Outcome {
    let mut lines: Vec<&str> = list.lines().collect();
    lines.sort_unstable();
    lines.dedup();
    if lines.is_empty() {
        return Ok(());
    }
    println!("\nskipped:");
    lines.iter().for_each(|line| println!("  {line}"));
    if is_ci {
        Err(format!("skipped checks: {}; every check must run, since the environment variable CI is set", lines.len()))
    } else {
        println!("  (with CI=true this is a failure)");
        Ok(())
    }
}

/// Installs Debian packages. If another program installs packages, the function waits. If the
/// package lists are missing or old, the function updates them.
///
/// # Errors
/// If the packages cannot be installed.
pub fn apt(packages: &[&str], purpose: &str) -> Outcome {
    if output_of(command("apt-get").arg("--version")).is_none() {
        return Err(format!("expected apt-get, which installs {}, found none", packages.join(", ")));
    }
    println!("\nfetching: the Debian packages {} (used only to {purpose})", packages.join(", "));
    let apt = |arguments: &[&str]| {
        let mut apt = command("apt-get");
        run(apt.args(["-o", "DPkg::Lock::Timeout=600"]).args(arguments).env("DEBIAN_FRONTEND", "noninteractive"))
    };
    let install = [&["install", "-y", "--no-install-recommends"], packages].concat();
    for turn in 0.. {
        let result = apt(&install);
        if result.is_ok() || turn + 1 == TURNS {
            return result;
        }
        // wait, since `apt-get update` fails if another program locks the package lists
        std::thread::sleep(std::time::Duration::from_secs(20 * turn));
        let _ = apt(&["update"]);
    }
    Ok(())
}

/// Returns the address of the mirror from which this machine installs Debian packages.
pub fn debian_mirror() -> Outcome<String> {
    let sites = output_of(command("apt-get").args(["indextargets", "--format", "$(SITE)"])).unwrap_or_default();
    let site = sites.lines().find(|site| !site.contains("security")).ok_or("apt-get names no mirror")?;
    Ok(site.to_owned())
}

/// Number of attempts of an installation.
const TURNS: u64 = 4;

/// Runs a program to its end, and shows its output.
pub fn run(command: &mut Command) -> Outcome {
    let name = describe(command);
    println!("\n$ {name}");
    let child = command.spawn().map_err(|error| format!("`{name}` did not start: {error}"))?;
    match within_limit(child, &name, |mut child| child.wait()) {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("`{name}` failed with {status}")),
        Err(error) => Err(format!("`{name}`: {error}")),
    }
}

/// Returns the output of a program; `None` if it fails.
pub fn output_of(command: &mut Command) -> Option<String> {
    let name = describe(command);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().ok()?;
    let output = within_limit(child, &name, Child::wait_with_output).ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

static LIMIT: OnceLock<Duration> = OnceLock::new();

/// Limits the time of each program that [`run`] and [`output_of`] start from now on. A program that
/// takes longer is listed with all programs that it started, and all of them are killed.
pub fn limit(longest: Duration) {
    let _ = LIMIT.set(longest);
}

/// Calls `finish`, which waits for the program. Kills the program at the limit.
fn within_limit<T>(child: Child, name: &str, finish: impl FnOnce(Child) -> std::io::Result<T>) -> std::io::Result<T> {
    match LIMIT.get() {
        Some(longest) => within(*longest, child, name, finish),
        None => finish(child),
    }
}

fn within<T>(
    longest: Duration,
    child: Child,
    name: &str,
    finish: impl FnOnce(Child) -> std::io::Result<T>,
) -> std::io::Result<T> {
    let (id, (ended, has_ended)) = (child.id(), channel::<()>());
    std::thread::scope(|scope| {
        scope.spawn(move || {
            if has_ended.recv_timeout(longest) == Err(RecvTimeoutError::Timeout) {
                println!(
                    "\n`{name}` has run for {} s, which is too long; these processes are killed:",
                    longest.as_secs()
                );
                kill_tree(id);
            }
        });
        let result = finish(child);
        drop(ended);
        result
    })
}

/// Prints and kills a process, and on Linux also all processes that it started.
fn kill_tree(root: u32) {
    // /proc/ID/stat: id, name in parentheses, state, parent's id, …
    let mut children: HashMap<u32, Vec<u32>> = HashMap::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let stat = std::fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        let parent = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(1)?.parse().ok());
        if let (Some(parent), Ok(id)) = (parent, entry.file_name().to_string_lossy().parse()) {
            children.entry(parent).or_default().push(id);
        }
    }
    let mut ids = vec![root];
    let mut next = 0;
    while let Some(&id) = ids.get(next) {
        let words = std::fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        println!("  {id} {}", String::from_utf8_lossy(&words).replace('\0', " "));
        ids.extend(children.get(&id).into_iter().flatten());
        next += 1;
    }
    let _ = Command::new("kill").arg("-KILL").args(ids.iter().map(u32::to_string)).status();
}

fn describe(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}

/// Reference implementations of image metrics, as packages for pip. Without these packages the test
/// that runs the implementations is skipped.
const METRICS: [&str; 3] = ["--only-binary=:all:", "scikit-image", "flip-evaluator==1.*"];

/// Readers of pictures, which check the files that Lumistack writes.
const READERS: [&str; 3] = ["--only-binary=:all:", "pillow", "OpenEXR==3.*"];

/// OpenUSD with its MaterialX plugin. Without it the tests of USD stages are skipped.
const USD: [&str; 2] = ["--only-binary=:all:", "usd-exchange==3.*"];

/// Finds or makes a Python environment with NumPy in `target/python`. It also has Pillow, OpenEXR,
/// scikit-image, flip-evaluator and OpenUSD, if these can be installed. With these packages tests
/// check Lumistack's files and metrics.
pub fn python() -> Outcome<PathBuf> {
    let folder = root().join("target/python");
    let python = folder.join("bin/python");
    let imports = |modules: &str| output_of(command(&python).args(["-c", &format!("import {modules}")])).is_some();
    if !imports("numpy") {
        make_python(&folder, "to check files that we write")?;
        install(&python, &["numpy==2.*"])?;
    }
    if !imports("numpy") {
        return Err("numpy was installed into target/python, but cannot be imported".into());
    }
    if !imports("PIL, OpenEXR") {
        println!("fetching: Pillow and OpenEXR, in target/python (used only to check pictures that we write)");
        if let Err(error) = install(&python, &READERS) {
            skipped("pictures", &format!("Pillow and OpenEXR cannot be installed into target/python: {error}"));
        }
    }
    if !imports("skimage, flip_evaluator") {
        println!("fetching: scikit-image and flip-evaluator, in target/python (used only to check our SSIM and FLIP)");
        if let Err(error) = install(&python, &METRICS) {
            skipped(
                "metrics",
                &format!("the reference tools cannot be installed, so only their recorded values are checked: {error}"),
            );
        }
    }
    if !imports("pxr") {
        println!("fetching: usd-exchange (OpenUSD), in target/python (used only to test how USD is read)");
        if let Err(error) = install(&python, &USD) {
            skipped("USD", &format!("OpenUSD cannot be installed: {error}"));
        }
    }
    Ok(python)
}

/// Installs packages; `packages` may also contain options that pip and uv share.
pub fn install(python: &Path, packages: &[&str]) -> Outcome {
    let mut install = if let Some(uv) = uv() {
        let mut install = command(uv);
        install.args(["pip", "install", "--quiet", "--python"]).arg(python);
        install
    } else {
        let mut install = command(python);
        // `--no-compile`: to compile all modules would take as long as to unpack them, and Python
        // compiles a module at its first import
        install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]);
        install
    };
    run(install.args(packages))
}

/// Makes an empty environment of this machine's Python.
pub fn make_python(folder: &Path, purpose: &str) -> Outcome {
    make_python_of(PYTHON.as_ref(), folder, purpose)
}

/// Makes an empty environment of the Python whose program is `base`.
pub fn make_python_of(base: &Path, folder: &Path, purpose: &str) -> Outcome {
    println!("\nfetching: a Python environment, in {} (used only {purpose})", folder.display());
    if let Some(uv) = uv() {
        // `--seed` installs pip, which some programs call
        return run(command(uv).args(["venv", "--quiet", "--seed", "--clear", "--python"]).arg(base).arg(folder));
    }
    venv(base, folder)
}

/// The program of this machine's Python.
pub const PYTHON: &str = "python3";

/// Finds a program of Python with this version, for example `3.11`.
pub fn python_of(version: &str) -> Option<String> {
    let test = "import sys; print('%d.%d' % sys.version_info[:2])";
    [PYTHON.to_owned(), format!("python{version}")]
        .into_iter()
        .find(|python| output_of(command(python).args(["-c", test])).is_some_and(|said| said.trim() == version))
}

fn venv(base: &Path, folder: &Path) -> Outcome {
    let make = || run(command(base).args(["-m", "venv", "--clear"]).arg(folder));
    if make().is_err() {
        apt(&["python3-venv"], "make a Python environment")
            .and_then(|()| make())
            .map_err(|error| format!("no Python environment: {error}; install Python 3 with its venv module"))?;
    }
    Ok(())
}

/// Returns the program uv in `target/uv`, which installs packages with a tenth of pip's processor
/// time. `None` if it cannot be installed; then pip installs packages.
fn uv() -> Option<&'static Path> {
    static UV: OnceLock<Option<PathBuf>> = OnceLock::new();
    UV.get_or_init(|| {
        let folder = root().join("target/uv");
        let uv = folder.join("bin/uv");
        let works = || output_of(command(&uv).arg("--version")).is_some();
        if !works() {
            println!("\nfetching: uv, in target/uv (25 MB, used only to install Python packages)");
            let python = folder.join("bin/python");
            let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:", "uv"];
            if let Err(error) = venv(PYTHON.as_ref(), &folder).and_then(|()| run(command(python).args(pip))) {
                println!("uv cannot be installed, so pip installs packages: {error}");
            }
        }
        works().then_some(uv)
    })
    .as_deref()
}

/// Installs `pdftoppm`, which rasterizes the pages of PDF files, if it is missing. Without it the
/// tests of PDF files are skipped.
pub fn poppler() {
    if output_of(command("pdftoppm").arg("-v")).is_some() {
        return;
    }
    if let Err(error) = apt(&["poppler-utils"], "check PDF files that we write") {
        skipped("PDF", &error);
    }
}

/// Returns true if rustc can compile to wasm32. If the target is missing, the function first
/// installs it by rustup.
pub fn wasm_target() -> bool {
    rust_target("wasm32-unknown-unknown").is_ok()
}

/// Installs a target of rustc by rustup if it is missing.
///
/// # Errors
/// If the target cannot be installed.
pub fn rust_target(triple: &str) -> Outcome {
    let installed = || {
        output_of(command("rustc").args(["--print", "target-libdir", "--target", triple]))
            .is_some_and(|folder| Path::new(folder.trim()).is_dir())
    };
    if installed() {
        return Ok(());
    }
    println!("\nfetching: the Rust target {triple}");
    run(command("rustup").args(["target", "add", triple]))?;
    if installed() { Ok(()) } else { Err(format!("rustup ran, but the Rust target {triple} is not installed")) }
}

/// Installs the sources of Rust's standard library by rustup if they are missing.
///
/// # Errors
/// If they cannot be installed.
pub fn rust_sources() -> Outcome {
    let installed = || {
        output_of(command("rustc").args(["--print", "sysroot"]))
            .is_some_and(|folder| Path::new(folder.trim()).join("lib/rustlib/src/rust/library").is_dir())
    };
    if installed() {
        return Ok(());
    }
    println!("\nfetching: the sources of Rust's standard library");
    run(command("rustup").args(["component", "add", "rust-src"]))?;
    if installed() { Ok(()) } else { Err("rustup ran, but the standard library's sources are not installed".into()) }
}

/// Runs an example of a package as a release build.
pub fn example(package: &str, name: &str, arguments: &[String]) -> Outcome {
    let mut words = vec!["run", "--release", "--package", package, "--example", name, "--"];
    words.extend(arguments.iter().map(String::as_str));
    cargo(&words)
}

/// Runs a benchmark of a package as a release build, in the package's folder. So paths in the
/// arguments must be absolute.
pub fn bench(package: &str, name: &str, arguments: &[String]) -> Outcome {
    let mut words = vec!["bench", "--package", package, "--bench", name, "--"];
    words.extend(arguments.iter().map(String::as_str));
    cargo(&words)
}

/// Makes a path of the user absolute. Relative paths refer to the user's current folder.
pub fn absolute(path: &str) -> String {
    std::path::absolute(path).map_or_else(|_| path.to_owned(), |path| text(&path))
}

pub fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn a_program_that_hangs_is_killed_with_all_that_it_started() {
        let file = root().join("target/xtask-hangs.txt");
        let _ = std::fs::remove_file(&file);
        let script = format!("sleep 1000 & echo $! > '{}'; wait", file.display());
        let child = Command::new("sh").arg("-c").arg(script).spawn().unwrap();
        let pause = || std::thread::sleep(Duration::from_millis(10));
        let started = || std::fs::read_to_string(&file).ok()?.trim().parse::<u32>().ok();
        while started().is_none() {
            pause();
        }
        let status = within(Duration::from_millis(50), child, "sh", |mut child| child.wait()).unwrap();
        assert!(!status.success());
        // the killed process may remain as a zombie, which has no command line
        let command_line = format!("/proc/{}/cmdline", started().unwrap());
        while std::fs::read(&command_line).is_ok_and(|words| !words.is_empty()) {
            pause();
        }
        std::fs::remove_file(&file).unwrap();
    }

    #[test]
    fn skipped_checks_fail_on_ci_alone() {
        assert_eq!(account("", true), Ok(()));
        let list = "wasm32: no target\ntest a: no files\nwasm32: no target\n";
        assert_eq!(account(list, false), Ok(()));
        assert!(account(list, true).unwrap_err().starts_with("skipped checks: 2;"));
    }
}
