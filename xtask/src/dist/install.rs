//! Tests the installation from `target/dist`. Each way runs in its own Debian without Rust, or in
//! an empty prefix where no Debian can be made.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use crate::tools::{self, Outcome, command, output_of, run};

/// Names of the scripts in `tests/install`.
pub const WAYS: [&str; 6] = ["tarball", "deb", "wheel", "npm", "blender", "pages"];

/// Runs the scripts of some ways on the files in `dist`; without ways all of them.
pub fn test(ways: &[&str], dist: &Path) -> Outcome {
    let clean = debian().map_err(|why| println!("no clean Debian ({why}): into an empty prefix instead")).ok();
    let mut times = Vec::new();
    let mut failed = Vec::new();
    for way in WAYS.into_iter().filter(|way| ways.is_empty() || ways.contains(way)) {
        println!("\n=== {way}");
        let start = Instant::now();
        // the extension needs a Blender newer than Debian's, which the module bpy is; pages need
        // the repository
        let result = match &clean {
            Some(base) if way != "blender" && way != "pages" => in_debian(base, way, dist),
            _ => in_prefix(way, dist),
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

/// A fresh Debian stable, made once.
fn debian() -> Outcome<PathBuf> {
    let base = folder().join("debian-stable");
    if base.join("usr/bin/apt-get").is_file() {
        return Ok(base);
    }
    if output_of(command("id").arg("-u")).is_none_or(|id| id.trim() != "0") {
        return Err("only root can make one".into());
    }
    if output_of(command("debootstrap").arg("--version")).is_none() {
        tools::apt(&["debootstrap"], "make a clean Debian")?;
    }
    // the mirror of this machine's packages
    let sites = output_of(command("apt-get").args(["indextargets", "--format", "$(SITE)"])).unwrap_or_default();
    let site = sites.lines().find(|site| !site.contains("security")).ok_or("apt-get names no mirror")?.to_owned();
    let part = folder().join("debian-part");
    let _ = std::fs::remove_dir_all(&part);
    run(command("debootstrap").args(["--variant=minbase", "stable"]).arg(&part).arg(site))?;
    run(command("sh").args(["-c", "cp -r /etc/apt/apt.conf.d/. \"$1/etc/apt/apt.conf.d/\"", "sh"]).arg(&part))?;
    std::fs::rename(&part, &base).map_err(|error| format!("{}: {error}", base.display()))?;
    Ok(base)
}

/// Runs a script in a copy of the Debian.
fn in_debian(base: &Path, way: &str, dist: &Path) -> Outcome {
    let place = folder().join(way);
    let _ = std::fs::remove_dir_all(&place);
    run(command("cp").args(["-a", "--reflink=auto"]).arg(base).arg(&place))?;
    run(command("cp").arg("-r").arg(dist).arg(place.join("dist")))?;
    run(command("cp").arg("-r").arg("tests/install").arg(place.join("install")))?;
    run(command("cp").arg("-L").arg("/etc/resolv.conf").arg(place.join("etc/resolv.conf")))?;
    let mut script = command("chroot");
    script.arg(&place).args(["/usr/bin/env", "-i", "HOME=/root", "LANG=C.UTF-8", "CLEAN=1", "DIST=/dist"]);
    script.arg("PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin");
    let result = run(script.args(["sh", &format!("/install/{way}.sh")]));
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
