//! Tests the Python package with the oldest Python and NumPy that it supports, and with the newest
//! Python that Debian has. With this machine's Python all tests run. With the other two only the
//! tests run that depend on the versions of Python and NumPy.
//!
//! CI leaves the newest Python out, since it changes from day to day.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, command, install, output_of, run};

/// The oldest Python that the wheel supports.
pub const OLDEST: (u32, u32) = (3, 11);

/// The tests that run with every version.
const TESTS: [&str; 4] = ["arrays", "displays", "errors", "threads"];

/// A version of Python and the packages of its environment.
struct Version {
    /// The end of the environment's folder, `target/python-NAME`.
    name: &'static str,
    numpy: &'static str,
    /// Finds or makes the program of Python.
    program: fn() -> Outcome<PathBuf>,
}

const VERSIONS: [Version; 2] = [
    Version { name: "oldest", numpy: "numpy==1.24.*", program: oldest },
    Version { name: "newest", numpy: "numpy==2.*", program: newest },
];

/// The versions that are tested.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Versions {
    Oldest,
    All,
}

impl Versions {
    fn list(self) -> &'static [Version] {
        if self == Self::All { &VERSIONS } else { &VERSIONS[..1] }
    }
}

/// Makes the environment of the oldest version.
///
/// # Errors
/// If the Python is missing or packages cannot be installed.
pub fn fetch() -> Outcome {
    Versions::Oldest.list().iter().try_for_each(|version| version.environment().map(|_| ()))
}

/// Installs a wheel into the environment of each version, and runs the tests. Skips a version with
/// a message if its environment cannot be made.
pub fn check(wheel: &Path, versions: Versions) -> Outcome {
    for version in versions.list() {
        let python = match version.environment() {
            Ok(python) => python,
            Err(error) => {
                tools::skipped(&format!("python: {}", version.name), &error);
                continue;
            }
        };
        install(&python, &["--force-reinstall", "--no-deps", &wheel.to_string_lossy()])?;
        run(command(&python)
            .args(["-c", "import numpy, sys; print('Python', sys.version, 'NumPy', numpy.__version__)"]))?;
        let tests = TESTS.map(|name| format!("crates/python/tests/test_{name}.py"));
        run(command(&python).args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]).args(tests))?;
    }
    Ok(())
}

impl Version {
    /// Finds or makes the environment; returns its Python.
    fn environment(&self) -> Outcome<PathBuf> {
        let folder = tools::root().join(format!("target/python-{}", self.name));
        let python = folder.join("bin/python");
        let has = || output_of(command(&python).args(["-c", "import numpy, pytest"])).is_some();
        if !has() {
            tools::make_python_of(&(self.program)()?, &folder, "to test the Python package")?;
            install(&python, &["--only-binary=:all:", "pytest==9.*", self.numpy])?;
        }
        if has() { Ok(python) } else { Err(format!("numpy and pytest cannot be imported in {}", folder.display())) }
    }
}

fn oldest() -> Outcome<PathBuf> {
    let version = format!("{}.{}", OLDEST.0, OLDEST.1);
    let python = tools::python_of(&version)
        .ok_or_else(|| format!("expected Python {version} as python3 or python{version}, found none"))?;
    Ok(python.into())
}

/// Makes the newest Python of Debian in `target/debian-newest`, without installing it. This Python
/// may need a newer C library than this machine has, so a script starts it with the C library that
/// is unpacked with it.
fn newest() -> Outcome<PathBuf> {
    let folder = tools::root().join("target/debian-newest");
    let python = folder.join("usr/bin/python3");
    if output_of(command(&python).arg("--version")).is_some() {
        return Ok(python);
    }
    if output_of(command("mmdebstrap").arg("--version")).is_none() {
        tools::apt(&["mmdebstrap"], "unpack the newest Python")?;
    }
    // Unpack the packages. They are fetched with the settings of this machine's apt.
    let settings = output_of(command("apt-config").arg("dump")).ok_or("apt-config does not start")?;
    let settings: Vec<&str> = settings.lines().filter(|line| line.starts_with("Acquire::")).collect();
    let file = folder.with_extension("conf");
    std::fs::write(&file, settings.join("\n")).map_err(|error| format!("{}: {error}", file.display()))?;
    // the suite with the newest packages
    let system = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    let suite = if system.lines().any(|line| line == "ID=ubuntu") { "devel" } else { "unstable" };
    println!("\nfetching: the newest Python of Debian, in {} (60 MB, used only for tests)", folder.display());
    let _ = std::fs::remove_dir_all(&folder);
    let mut unpack = command("mmdebstrap");
    unpack.args(["--quiet", "--variant=extract", "--include=base-files,python3"]);
    unpack.arg(format!("--aptopt={}", file.display())).arg(suite).arg(&folder);
    run(unpack.arg(format!("deb {} {suite} main", tools::debian_mirror()?)))?;
    // Replace the link to the program by the script.
    let failed = |error: std::io::Error| format!("{}: {error}", python.display());
    let program = std::fs::read_link(&python).map_err(failed)?;
    let libraries = folder.join(format!("usr/lib/{}-linux-gnu", std::env::consts::ARCH));
    let entries = std::fs::read_dir(&libraries).map_err(|error| format!("{}: {error}", libraries.display()))?;
    let is_loader =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("ld-linux"));
    let loader = entries.flatten().map(|entry| entry.path()).find(is_loader);
    let loader = loader.ok_or_else(|| format!("{}: expected a dynamic loader, found none", libraries.display()))?;
    let script = format!(
        "#!/bin/sh\nexec '{}' --library-path '{}' --argv0 \"$0\" '{}' \"$@\"\n",
        loader.display(),
        libraries.display(),
        python.with_file_name(program).display()
    );
    std::fs::remove_file(&python).and_then(|()| std::fs::write(&python, script)).map_err(failed)?;
    run(command("chmod").arg("+x").arg(&python))?;
    Ok(python)
}
