//! Builds programs and wheels. On Linux zig links them against an old glibc, also for processors
//! other than this machine's.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::paths;
use crate::tools::{self, Outcome, command, install, output_of, run};
use crate::wine::{self, MINGW};

/// The oldest glibc of programs and wheels: the oldest that Rust's standard library supports.
const GLIBC: &str = "2.17";

/// Linker and builders, as packages for pip.
const TOOLS: [&str; 4] = ["--only-binary=:all:", "ziglang==0.17.*", "cargo-zigbuild==0.24.*", "maturin==1.16.*"];

/// The packages of the program and of the Python module. The build of the program selects both
/// packages. So cargo chooses the same features of dependencies as in maturin's build of the
/// module, and compiles the dependencies only once.
const PACKAGES: [&str; 6] = [
    "--package",
    "lumistack-cli",
    "--package",
    "lumistack-python",
    "--features",
    "lumistack-cli/panels,lumistack-python/panels",
];

/// A kind of machine for which programs and wheels are built.
#[derive(Clone, Copy)]
pub struct Target {
    /// Rust's name of the target.
    pub triple: &'static str,
    /// Debian's name of the processor, on Linux.
    pub debian: Option<&'static str>,
}

const fn target(triple: &'static str, debian: Option<&'static str>) -> Target {
    Target { triple, debian }
}

/// All targets.
const TARGETS: [Target; 6] = [
    target("x86_64-unknown-linux-gnu", Some("amd64")),
    target("aarch64-unknown-linux-gnu", Some("arm64")),
    target("x86_64-pc-windows-msvc", None),
    target(MINGW, None),
    target("x86_64-apple-darwin", None),
    target("aarch64-apple-darwin", None),
];

impl Target {
    /// Finds a target by Rust's name.
    pub fn of(triple: &str) -> Option<Self> {
        TARGETS.into_iter().find(|target| target.triple == triple)
    }

    /// Returns the targets of a release.
    pub fn released() -> Vec<Self> {
        TARGETS.into_iter().filter(|target| target.triple != MINGW).collect()
    }

    /// Returns the targets that this machine can build.
    pub fn of_this_machine() -> Outcome<Vec<Self>> {
        let host = host()?;
        if host.is_linux() {
            return Ok(TARGETS.into_iter().filter(Self::is_linux).collect());
        }
        Ok(vec![host])
    }

    /// Returns true if the target is Windows, whose releases are zips with programs that end in
    /// `.exe`.
    pub fn is_windows(&self) -> bool {
        self.triple.contains("windows")
    }

    fn is_linux(&self) -> bool {
        self.debian.is_some()
    }

    /// Returns the name of the program's file.
    pub fn program(&self) -> &'static str {
        if self.is_windows() { "lumistack.exe" } else { "lumistack" }
    }
}

fn host() -> Outcome<Target> {
    let said = output_of(command("rustc").arg("-vV")).ok_or("rustc does not start")?;
    let triple = said.lines().find_map(|line| line.strip_prefix("host: ")).unwrap_or_default();
    Target::of(triple).ok_or_else(|| format!("expected a system for which Lumistack has releases, found {triple}"))
}

/// Finds or makes a Python with the builders.
fn builders() -> Outcome<PathBuf> {
    let folder = tools::root().join("target/python-dist");
    let bin = folder.join(if cfg!(windows) { "Scripts" } else { "bin" });
    let python = bin.join(if cfg!(windows) { "python.exe" } else { "python" });
    let has = || output_of(command(&python).args(["-c", "import ziglang, maturin"])).is_some();
    if !has() {
        tools::make_python(&folder, "to build releases")?;
        install(&python, &TOOLS)?;
    }
    if has() {
        Ok(python)
    } else {
        Err(format!(
            "{}: cannot import `ziglang` and `maturin`, although pip installed both; check the output of pip above",
            python.display()
        ))
    }
}

/// Sets up cargo, or a program that starts cargo, to link with zig against an old glibc.
///
/// Cargo compiles every dependency again if the path of the linker changes. cargo-zigbuild and
/// maturin would use linkers at different paths. So this function writes one linker file, which
/// both tools use. Macros and build scripts run on this machine, so builds for every target link
/// them by the linker file of this machine.
fn link_by_zig(builder: &mut Command, python: &Path, target: &Target) -> Outcome {
    let host = host()?;
    if host.is_linux() {
        link_for(builder, python, &host)?;
    }
    if target.is_linux() { link_for(builder, python, target) } else { Ok(()) }
}

/// Writes the linker file of a target, and sets it up.
fn link_for(builder: &mut Command, python: &Path, target: &Target) -> Outcome {
    let zigbuild = python.with_file_name("cargo-zigbuild");
    let (zigbuild, python_path) = (zigbuild.display(), python.display());
    let machine = target.triple.split('-').next().unwrap_or_default();
    let text = format!(
        "#!/bin/sh\nexport CARGO_ZIGBUILD_ZIG_COMMAND='{python_path}' CARGO_ZIGBUILD_ZIG_COMMAND_ARGS='-m ziglang'\n\
         exec '{zigbuild}' zig cc -- -g -fno-sanitize=all -target {machine}-linux-gnu.{GLIBC} \"$@\"\n"
    );
    let linker = python.with_file_name(format!("zigcc-{}", target.triple));
    let failed = |error: std::io::Error| format!("{}: {error}", linker.display());
    std::fs::write(&linker, text).map_err(failed)?;
    run(command("chmod").arg("+x").arg(&linker))?;
    let triple = target.triple.replace('-', "_");
    builder.env(format!("CARGO_TARGET_{}_LINKER", triple.to_uppercase()), &linker).env(format!("CC_{triple}"), &linker);
    Ok(())
}

/// Builds the program with the feature `panels`, which drives physical panels. Returns the path of
/// the program.
pub fn program(target: &Target) -> Outcome<PathBuf> {
    tools::rust_target(target.triple)?;
    let words = [&["--release", "--locked", "--bin", "lumistack"][..], &PACKAGES, &["--target"]].concat();
    let mut cargo = command("cargo");
    paths::replace(&mut cargo)?;
    if cfg!(target_os = "linux") {
        link_by_zig(&mut cargo, &builders()?, target)?;
    }
    if target.triple == MINGW && cfg!(target_os = "linux") {
        wine::linker()?;
    }
    run(cargo.arg("build").args(words).arg(target.triple))?;
    let path = tools::root().join("target").join(target.triple).join("release").join(target.program());
    if target.is_linux() {
        let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        check_program(&bytes, target).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(path)
}

/// Checks that a program of Linux is for the target's processor, and needs no newer glibc than
/// [`GLIBC`].
fn check_program(bytes: &[u8], target: &Target) -> Outcome {
    // `e_machine` of ELF's header: EM_X86_64 or EM_AARCH64
    let machine = if target.triple.starts_with("x86_64") { 62 } else { 183 };
    if !bytes.starts_with(b"\x7fELF") || bytes.get(18..20) != Some(&[machine, 0]) {
        return Err(format!("expected an ELF program for {}, found a file of another kind", target.triple));
    }
    // the names of versions are strings in the table of dynamic symbols
    let number = |text: &str| -> Option<(u32, u32)> {
        let (major, rest) = text.split_once('.')?;
        Some((major.parse().ok()?, rest.split('.').next()?.parse().ok()?))
    };
    let newest = bytes
        .split(|&byte| byte == 0)
        .filter_map(|text| number(std::str::from_utf8(text.strip_prefix(b"GLIBC_")?).ok()?))
        .max()
        .ok_or("expected names of versions of glibc, found none")?;
    if Some(newest) > number(GLIBC) {
        return Err(format!(
            "expected a program that needs glibc {GLIBC} or older, found a program that needs glibc {}.{}",
            newest.0, newest.1
        ));
    }
    println!("{}: needs glibc {}.{}", target.triple, newest.0, newest.1);
    Ok(())
}

/// Builds the program for this machine, which then writes the manual pages and completions for all
/// targets.
pub fn own_program() -> Outcome<PathBuf> {
    program(&host()?)
}

/// The free-threaded Python (without a lock) that has wheels of its own. The wheels for all other
/// versions use Python's stable ABI, which free-threaded versions lack before 3.15.
const FREE_THREADED: &str = "python3.14t";

/// Builds the wheels for a target: one for all versions of Python from 3.11 on, and one for
/// [`FREE_THREADED`]. Returns the path of the first wheel. For Linux maturin knows the properties
/// of the free-threaded Python. For other systems maturin needs the program of this Python, on a
/// machine of this target. Otherwise only the first wheel is built.
pub fn wheels(target: &Target, folder: &Path, licences: &str) -> Outcome<PathBuf> {
    let python = builders()?;
    let stable = wheel(target, &python, &python, folder, licences)?;
    let has_program = || output_of(command(FREE_THREADED).arg("--version")).is_some();
    if target.is_linux() || (host()?.triple == target.triple && has_program()) {
        wheel(target, &python, Path::new(FREE_THREADED), folder, licences)?;
    } else {
        println!("{}: no wheel for {FREE_THREADED}, which must run on a machine of this target", target.triple);
    }
    Ok(stable)
}

/// Builds the wheel for one Python, with the licences in it, and returns its path.
fn wheel(target: &Target, python: &Path, interpreter: &Path, folder: &Path, licences: &str) -> Outcome<PathBuf> {
    tools::rust_target(target.triple)?;
    let out = tools::root().join("target/wheels").join(target.triple);
    let _ = std::fs::remove_dir_all(&out);
    let mut maturin = command(python.with_file_name("maturin"));
    maturin.args(["build", "--release", "--locked", "--features", "panels", "--target"]);
    maturin.arg(target.triple).arg("--out").arg(&out).arg("--interpreter").arg(interpreter);
    paths::replace(&mut maturin)?;
    if cfg!(target_os = "linux") {
        link_by_zig(&mut maturin, python, target)?;
    }
    if target.triple == MINGW && cfg!(target_os = "linux") {
        wine::linker()?;
    }
    if target.is_linux() {
        maturin.args(["--compatibility", &format!("manylinux_{}", GLIBC.replace('.', "_"))]);
    }
    run(&mut maturin)?;
    let text = out.join("THIRD-PARTY.txt");
    std::fs::write(&text, licences).map_err(|error| format!("{}: {error}", text.display()))?;
    // maturin puts version and platform into the name
    let wheels = std::fs::read_dir(&out).map_err(|error| format!("{}: {error}", out.display()))?;
    let wheel =
        wheels.flatten().map(|entry| entry.path()).find(|path| path.extension().is_some_and(|end| end == "whl"));
    let wheel = wheel.ok_or_else(|| format!("{}: expected a wheel by maturin, found none", out.display()))?;
    run(command(python).arg("xtask/python/licences.py").arg(&wheel).arg(&text))?;
    paths::check_zip(&wheel)?;
    let place = folder.join(wheel.file_name().unwrap_or_default());
    std::fs::copy(&wheel, &place).map_err(|error| format!("{}: {error}", place.display()))?;
    Ok(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_for_another_processor_or_a_newer_glibc_is_refused() {
        let check = |machine: u8, versions: &str| {
            let mut bytes = b"\x7fELF".to_vec();
            bytes.resize(18, 0);
            bytes.extend([machine, 0, 0]);
            bytes.extend(versions.as_bytes());
            check_program(&bytes, &TARGETS[0])
        };
        assert_eq!(check(62, "GLIBC_2.2.5\0GLIBC_2.17\0"), Ok(()));
        assert_eq!(
            check(62, "GLIBC_2.3\0GLIBC_2.28\0").unwrap_err(),
            "expected a program that needs glibc 2.17 or older, found a program that needs glibc 2.28"
        );
        assert_eq!(check(62, "text").unwrap_err(), "expected names of versions of glibc, found none");
        assert!(check(183, "GLIBC_2.17\0").is_err());
    }
}
