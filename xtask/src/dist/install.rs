//! Tests every way to install the files in `target/dist`. Each way is a script, which runs in a
//! Debian of its own without Rust. If no Debian can be made, the script installs into an empty
//! prefix on this machine.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use crate::debian::{self, Copy};
use crate::tools::{self, Outcome, command, run};
use crate::wine::MINGW;

/// Names of the scripts in `tests/install`.
pub const WAYS: [&str; 8] = ["tarball", "deb", "wheel", "npm", "blender", "pages", "arm", "windows"];

/// Ways to install programs for other machines. Each is tested if the user names it, or if the user
/// names no way and the program is in `dist`.
const ARM: &str = "arm";
const WINDOWS: &str = "windows";

/// Folders and files of the repository that scripts read, in addition to `tests/install`.
const READ: [&str; 4] = ["README.md", "docs", "scenes", "plugins/blender/tests"];

/// Runs the scripts of the named ways on the files in `dist`; all scripts if no way is named.
pub fn test(ways: &[&str], dist: &Path) -> Outcome {
    let clean = debian::clean()
        .map_err(|why| {
            println!("dist test: there is no clean Debian ({why}), so the tests install into an empty folder instead")
        })
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
    if failed.is_empty() {
        Ok(())
    } else {
        Err(format!("files that cannot be installed, or do not work after the installation: {}", failed.join(", ")))
    }
}

/// Runs a script in a copy of the Debian.
fn in_debian(base: &Path, way: &str, dist: &Path) -> Outcome {
    let copy = Copy::of(base, way)?;
    run(command("cp").arg("-r").arg(dist).arg(copy.place().join("dist")))?;
    let repository = copy.place().join("repository");
    std::fs::create_dir(&repository).map_err(|error| format!("{}: {error}", repository.display()))?;
    run(command("cp").args(["-r", "--parents", "tests/install"]).args(READ).arg(&repository))?;
    let script = format!("/repository/tests/install/{way}.sh");
    run(copy.command(&[], &["DIST=/dist"]).args(["sh", &script]))?;
    copy.remove();
    Ok(())
}

/// Runs a script with an empty home and an almost empty environment.
fn in_prefix(way: &str, dist: &Path) -> Outcome {
    let home = debian::folder().join(format!("{way}-home"));
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
