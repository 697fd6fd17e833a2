//! Tests every way to install the files in `target/dist`. Each way is a script, which runs in a
//! Debian of its own without Rust. If no Debian can be made, the script installs into an empty
//! prefix on this machine.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use super::build::MINGW;
use crate::tools::{self, Outcome, command, output_of, run};

/// Names of the scripts in `tests/install`.
pub const WAYS: [&str; 8] = ["tarball", "deb", "wheel", "npm", "blender", "pages", "arm", "windows"];

/// Ways to install programs for other machines. Each is tested if the user names it, or if its file
/// in `dist` exists.
const ARM: &str = "arm";
const WINDOWS: &str = "windows";

/// Folders and files of the repository that scripts read, in addition to `tests/install`.
const READ: [&str; 4] = ["README.md", "docs", "scenes", "plugins/blender/tests"];

/// Runs the scripts of the named ways on the files in `dist`; all scripts if no way is named.
pub fn test(ways: &[&str], dist: &Path) -> Outcome {
    let clean = debian()
        .map_err(|why| println!("no clean Debian ({why}): the tests install into an empty prefix instead"))
        .ok();
    let mut times = Vec::new();
    let mut failed = Vec::new();
    let has = |name: String| dist.join(format!("lumistack-{}-{name}", env!("CARGO_PKG_VERSION"))).is_file();
    // if the user names no way, leave out each way whose program is not in `dist`
    let made = |way: &str| match way {
        ARM => has("aarch64-unknown-linux-gnu.tar.gz".into()),
        WINDOWS => has(format!("{MINGW}.zip")),
        _ => true,
    };
    let wanted = |way: &&str| if ways.is_empty() { made(way) } else { ways.contains(way) };
    for way in WAYS.into_iter().filter(wanted) {
        println!("\n=== {way}");
        let start = Instant::now();
        let result = match &clean {
            Some(base) => in_debian(base, way, dist),
            None => in_prefix(way, dist),
        };
        times.push((way, start.elapsed().as_secs_f64()));
        if let Err(error) = result {
            println!("{error}");
            failed.push(way);
        }
    }
    println!("\n{:>8}  way", "seconds");
    times.iter().for_each(|(way, seconds)| println!("{seconds:8.0}  {way}"));
    if failed.is_empty() { Ok(()) } else { Err(format!("not installed or not working: {}", failed.join(", "))) }
}

fn folder() -> PathBuf {
    tools::root().join("target/install")
}

/// Returns a command that runs a program in its own namespaces of mounts and processes. When the
/// program ends, the processes that it started end too.
fn apart() -> Command {
    let mut unshare = command("unshare");
    unshare.args(["--mount", "--pid", "--fork", "--kill-child"]);
    unshare
}

/// Returns the folder of an unused Debian stable; makes it at the first call.
fn debian() -> Outcome<PathBuf> {
    if output_of(command("id").arg("-u")).is_none_or(|id| id.trim() != "0") {
        return Err("only root can make a Debian".into());
    }
    if output_of(apart().arg("true")).is_none() {
        return Err("this machine allows no mounts".into());
    }
    let base = folder().join("debian-stable");
    if base.join("usr/bin/apt-get").is_file() {
        return Ok(base);
    }
    if output_of(command("debootstrap").arg("--version")).is_none() {
        tools::apt(&["debootstrap"], "make a clean Debian")?;
    }
    let site = tools::debian_mirror()?;
    let part = folder().join("debian-part");
    let _ = std::fs::remove_dir_all(&part);
    run(command("debootstrap").args(["--variant=minbase", "stable"]).arg(&part).arg(site))?;
    run(command("sh").args(["-c", "cp -r /etc/apt/apt.conf.d/. \"$1/etc/apt/apt.conf.d/\"", "sh"]).arg(&part))?;
    std::fs::rename(&part, &base).map_err(|error| format!("{}: {error}", base.display()))?;
    Ok(base)
}

/// A shell script that mounts the file systems that programs expect and runs a program in a Debian:
/// `sh -c ENTER sh FOLDER PROGRAM...`
const ENTER: &str = "mount -t proc proc \"$1/proc\"; mkdir -p \"$1/dev/shm\" \"$1/dev/pts\"; \
     mount -t tmpfs tmpfs \"$1/dev/shm\"; mount -t devpts devpts \"$1/dev/pts\"; exec chroot \"$@\"";

/// Debian's file of certificates, and its name in the copy, where packages do not replace it.
const CERTIFICATES: [&str; 2] = ["/etc/ssl/certs/ca-certificates.crt", "/certificates.crt"];

/// Runs a script in a copy of the Debian.
fn in_debian(base: &Path, way: &str, dist: &Path) -> Outcome {
    let place = folder().join(way);
    let _ = std::fs::remove_dir_all(&place);
    run(command("cp").args(["-a", "--reflink=auto"]).arg(base).arg(&place))?;
    run(command("cp").arg("-r").arg(dist).arg(place.join("dist")))?;
    let repository = place.join("repository");
    std::fs::create_dir(&repository).map_err(|error| format!("{}: {error}", repository.display()))?;
    run(command("cp").args(["-r", "--parents", "tests/install"]).args(READ).arg(&repository))?;
    run(command("cp").arg("-L").arg("/etc/resolv.conf").arg(place.join("etc/resolv.conf")))?;
    // a machine behind a proxy has certificates of its own, with which pip must check sites
    let has_certificates = Path::new(CERTIFICATES[0]).is_file();
    if has_certificates {
        run(command("cp").arg("-L").arg(CERTIFICATES[0]).arg(place.join(CERTIFICATES[1].trim_start_matches('/'))))?;
    }
    let mut script = apart();
    script.args(["sh", "-euc", ENTER, "sh"]).arg(&place);
    script.args(["/usr/bin/env", "-i", "HOME=/root", "LANG=C.UTF-8", "CLEAN=1", "DIST=/dist"]);
    if has_certificates {
        script.arg(format!("PIP_CERT={}", CERTIFICATES[1]));
    }
    script.arg("PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin");
    let result = run(script.args(["sh", &format!("/repository/tests/install/{way}.sh")]));
    if result.is_ok() {
        let _ = std::fs::remove_dir_all(&place);
    }
    result
}

/// Runs a script with an empty home and an almost empty environment.
fn in_prefix(way: &str, dist: &Path) -> Outcome {
    let home = folder().join(format!("{way}-home"));
    let _ = std::fs::remove_dir_all(&home);
    std::fs::create_dir_all(&home).map_err(|error| format!("{}: {error}", home.display()))?;
    let mut script: Command = command("sh");
    script.env_clear().env("HOME", &home).env("LANG", "C.UTF-8").env("DIST", dist);
    script.env("PATH", "/usr/local/bin:/usr/bin:/bin");
    if way == "blender" {
        script.env("BLENDER_PYTHON", tools::root().join("target/python-blender-5.0.1/bin/python"));
    }
    run(script.arg(format!("tests/install/{way}.sh")))
}
