//! Builds the files of a release, which users download, into `target/dist`, and tests their
//! installation.

mod archive;
mod build;
mod install;
mod licences;
mod paths;
mod tree;

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use self::build::Target;
use crate::blender;
use crate::tools::{self, Outcome, command, run};

/// Help of `cargo xtask dist --help`.
pub const USAGE: &str = "\
cargo xtask dist [PART...] [--target TRIPLE]...
cargo xtask dist blender sbom --downloaded
cargo xtask dist test [WAY...]
cargo xtask dist sums

  tarball   the program with manual pages, completions, documents and the first scene; a zip for Windows
  deb       the same files as a Debian package
  wheel     the Python package: for any Python from 3.11 on, and for the free-threaded Python 3.14
  npm       the viewer for web pages
  blender   the extension of Blender, a zip for every wheel
  sbom      all dependencies with their licences: a bill of materials (CycloneDX), and a text
  test      installs the parts in a clean Debian, or into an empty prefix if there is none, and runs the first job;
            WAY is tarball, deb, wheel, npm, blender, pages (every command of the first pages), arm (in qemu) or windows (in Wine)
  sums      computes the checksums again

Without a PART it makes all parts. On Linux they are for x86-64 and ARM with a glibc from 2.17 on (zig links); elsewhere for this machine.
On Linux `tarball wheel --target x86_64-pc-windows-gnu` makes a zip with a program for Windows and a wheel (mingw links), which Wine can test.
With --downloaded the zips contain the wheels that are in target/dist, which other machines made: one for every system of a release.
Every part contains the licences of all dependencies. SHA256SUMS has the checksums of target/dist.
";

/// The parts of a release, in the order in which they are made. The extension comes after the
/// wheels that it contains.
const PARTS: [&str; 6] = ["tarball", "deb", "wheel", "npm", "blender", "sbom"];

/// The parts that cover all machines of a release. `--downloaded` can make only these parts.
const DOWNLOADED: [&str; 2] = ["blender", "sbom"];

/// Makes the parts that the arguments select; `None` if an argument is wrong.
pub fn dist(words: &[&str]) -> Option<Outcome> {
    if let ["test", ways @ ..] = words {
        return ways.iter().all(|way| install::WAYS.contains(way)).then(|| install::test(ways, &folder()));
    }
    if words == ["sums"] {
        return Some(sums(&folder()));
    }
    if let [parts @ .., "--downloaded"] = words {
        let fits = !parts.is_empty() && parts.iter().all(|part| DOWNLOADED.contains(part));
        return fits.then(|| make(parts, Target::released(), true));
    }
    let (mut parts, mut targets) = (Vec::new(), Vec::new());
    let mut words = words.iter();
    while let Some(word) = words.next() {
        match *word {
            "--target" => targets.push(Target::of(words.next()?)?),
            part if PARTS.contains(&part) => parts.push(part),
            _ => return None,
        }
    }
    if targets.is_empty() {
        targets = match Target::of_this_machine() {
            Ok(targets) => targets,
            Err(error) => return Some(Err(error)),
        };
    }
    Some(make(&parts, targets, false))
}

fn folder() -> PathBuf {
    tools::root().join("target/dist")
}

/// Makes parts for some targets. With `downloaded`, no wheel is built: the zips for Blender contain
/// the wheels that are in `target/dist` already.
fn make(parts: &[&str], targets: Vec<Target>, downloaded: bool) -> Outcome {
    // Collect the files that the packages of all targets share, then make the parts. The extension
    // of Blender needs the wheels.
    let wanted = |part: &str| parts.is_empty() || parts.contains(&part);
    let dist = folder();
    std::fs::create_dir_all(&dist).map_err(|error| format!("{}: {error}", dist.display()))?;
    let licences = licences::collect(&targets)?;
    if wanted("tarball") || wanted("deb") {
        let shared = tree::shared(&build::own_program()?, &licences.text())?;
        for target in &targets {
            let files = tree::with_program(&shared, &build::program(target)?, target)?;
            paths::check(files.iter().map(|file| (file.path.as_str(), file.bytes.as_slice())))?;
            if wanted("tarball") {
                let name = format!("lumistack-{VERSION}-{}", target.triple);
                if target.is_windows() {
                    write(&dist, &format!("{name}.zip"), &archive::zip(&name, &files)?)?;
                } else {
                    write(&dist, &format!("{name}.tar.gz"), &archive::tarball(&name, &files)?)?;
                }
            }
            if let (true, Some(architecture)) = (wanted("deb"), target.debian) {
                let name = format!("lumistack_{VERSION}_{architecture}.deb");
                write(&dist, &name, &archive::deb(architecture, &files)?)?;
            }
        }
    }
    if wanted("wheel") || wanted("blender") {
        let wheels = if downloaded {
            downloaded_wheels(files_of(&dist, ".whl")?, &targets)?
        } else {
            targets.iter().map(|target| build::wheels(target, &dist, &licences.text())).collect::<Outcome<Vec<_>>>()?
        };
        if wanted("blender") {
            let wheels: Vec<&str> = wheels.iter().filter_map(|wheel| wheel.to_str()).collect();
            blender::build(&wheels)?;
            for zip in files_of(&tools::root().join("target/blender"), ".zip")? {
                paths::check_zip(&zip)?;
                let name =
                    zip.file_name().unwrap_or_default().to_string_lossy().replacen("lumistack", "lumistack-blender", 1);
                std::fs::copy(&zip, dist.join(name)).map_err(|error| format!("{}: {error}", zip.display()))?;
            }
        }
    }
    if wanted("npm") {
        let package = tree::viewer(&licences::of_viewer()?.text())?;
        run(command("npm").args(["pack", "--pack-destination"]).arg(&dist).arg(&package))?;
    }
    if wanted("sbom") {
        let text = serde_json::to_string_pretty(&licences.sbom()).expect("JSON");
        write(&dist, &format!("lumistack-{VERSION}.cdx.json"), format!("{text}\n").as_bytes())?;
        write(&dist, "THIRD-PARTY.txt", licences.text().as_bytes())?;
    }
    sums(&dist)
}

/// Selects the wheels for all versions of Python, which the zips for Blender contain.
///
/// # Errors
/// If the number of wheels differs from the number of targets. `blender` checks that the wheels
/// are for different systems.
fn downloaded_wheels(mut wheels: Vec<PathBuf>, targets: &[Target]) -> Outcome<Vec<PathBuf>> {
    wheels.retain(|wheel| wheel.to_string_lossy().contains("-abi3-"));
    if wheels.len() == targets.len() {
        return Ok(wheels);
    }
    let triples: Vec<&str> = targets.iter().map(|target| target.triple).collect();
    Err(format!(
        "target/dist: expected a wheel `-abi3-` for each of {}, found {} wheels ({}); download the files of all machines",
        triples.join(", "),
        wheels.len(),
        wheels.iter().map(|wheel| wheel.display().to_string()).collect::<Vec<_>>().join(", ")
    ))
}

/// The workspace's version.
const VERSION: &str = env!("CARGO_PKG_VERSION");

fn write(folder: &Path, name: &str, bytes: &[u8]) -> Outcome {
    let path = folder.join(name);
    std::fs::write(&path, bytes).map_err(|error| format!("{}: {error}", path.display()))?;
    println!("{:8.1} MB  {}", bytes.len() as f64 / 1e6, path.display());
    Ok(())
}

/// Returns the files of a folder whose names end with `ending`, sorted by name.
fn files_of(folder: &Path, ending: &str) -> Outcome<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_file()).collect();
    files.retain(|path| path.to_string_lossy().ends_with(ending));
    files.sort();
    Ok(files)
}

/// Writes the checksums of all files, for `sha256sum --check`.
fn sums(folder: &Path) -> Outcome {
    let mut lines = String::new();
    for path in files_of(folder, "")?.iter().filter(|path| !path.ends_with(SUMS)) {
        let bytes = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let sum: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        lines += &format!("{sum}  {}\n", path.file_name().unwrap_or_default().to_string_lossy());
    }
    std::fs::write(folder.join(SUMS), &lines).map_err(|error| format!("{SUMS}: {error}"))?;
    print!("\n{lines}");
    Ok(())
}

const SUMS: &str = "SHA256SUMS";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_release_needs_a_wheel_for_every_system() {
        let targets = Target::released();
        assert!(targets.len() == 5 && targets.iter().all(|target| target.triple != crate::wine::MINGW));
        let tags = ["manylinux_2_17_x86_64", "manylinux_2_17_aarch64", "win_amd64", "macosx_10_12_x86_64"];
        let wheel = |tag: &str| PathBuf::from(format!("target/dist/lumistack-{VERSION}-cp311-abi3-{tag}.whl"));
        let mut wheels: Vec<PathBuf> = tags.iter().map(|tag| wheel(tag)).collect();
        wheels.push("target/dist/lumistack-0.1.0-cp314-cp314t-win_amd64.whl".into());
        assert!(downloaded_wheels(wheels.clone(), &targets).unwrap_err().contains("found 4"));
        wheels.push(wheel("macosx_11_0_arm64"));
        assert_eq!(downloaded_wheels(wheels, &targets).unwrap().len(), 5);
    }
}
