//! Builds the zip of the Blender extension, which Blender's own tool validates. The extension's
//! tests run in Blender's Python module bpy; each version of Blender has an environment with its
//! bpy.

use std::path::{Path, PathBuf};

use crate::python;
use crate::tools::{self, Outcome, command, install, output_of, run};

/// The version of Blender that runs the tests and validates the zips (`BLENDER`). With `--full` the
/// tests also run in the older versions.
const BLENDER: &str = "5.0.1";
const OLDER: [&str; 2] = ["4.5.15", "4.2.23"];
/// The version of Python that `BLENDER` and all versions in `OLDER` need.
const PYTHON: &str = "3.11";
/// Packages that build the wheel.
const TOOLS: [&str; 3] = ["--only-binary=:all:", "maturin==1.16.*", "numpy"];

/// Builds the extension for users into `target/blender`: a zip for every platform with a wheel.
/// `wheels` are the wheels of other platforms; this machine's wheel is built if it is missing.
pub fn build(wheels: &[&str]) -> Outcome {
    let python = environment(BLENDER)?;
    let mut wheels: Vec<PathBuf> = wheels.iter().map(PathBuf::from).collect();
    let mut there = platforms_of(&wheels)?;
    let own = machine()?;
    if !there.contains(&own) {
        wheels.push(wheel(&python, python::build)?);
        there = platforms_of(&wheels)?;
    }
    extension(&python, &wheels, &there).map(|_| ())
}

/// Builds the extension with the module that the workspace's tests compile, and runs its cases.
/// With `full` the cases run in all versions of Blender. Skips with a message if bpy cannot be
/// installed.
pub fn check(full: bool) -> Outcome {
    let python = match environment(BLENDER) {
        Ok(python) => python,
        Err(error) => {
            tools::skipped("blender", &error);
            return Ok(());
        }
    };
    let wheels = [wheel(&python, python::pack)?];
    program(&python, &wheels[0])?;
    let zip = extension(&python, &wheels, &platforms_of(&wheels)?)?;
    cases(&python, &zip, BLENDER, if full { "full" } else { "all" })?;
    if full {
        for version in OLDER {
            match environment(version) {
                Ok(python) => cases(&python, &zip, version, "full")?,
                Err(error) => tools::skipped(&format!("blender {version}"), &error),
            }
        }
    }
    Ok(())
}

/// Files that show that Debian's Blender and its NumPy are installed, each with the Debian package
/// that contains it. Debian 12 has Blender 3.4, which uses the system's Python.
const PROGRAM: [(&str, &str); 2] =
    [("/usr/bin/blender", "blender"), ("/usr/lib/python3/dist-packages/numpy", "python3-numpy")];

/// Fetches bpy, and Blender's program, if they are missing.
///
/// # Errors
/// If one of them cannot be installed.
pub fn fetch() -> Outcome {
    let python = environment(BLENDER)?;
    fetch_tools(&python)?;
    fetch_program()
}

fn fetch_program() -> Outcome {
    let has_blender = || output_of(command("blender").arg("--version")).is_some();
    if has_blender() {
        return Ok(());
    }
    let missing: Vec<&str> =
        PROGRAM.iter().filter(|(file, _)| !Path::new(file).exists()).map(|(_, package)| *package).collect();
    tools::apt(&missing, "test the Blender extension")?;
    if has_blender() {
        Ok(())
    } else {
        Err("blender: expected the program `blender` on PATH to start, found none that starts".into())
    }
}

/// Tests the extension's command without a window. This needs a `blender` process, since
/// `bpy.context` of the module bpy always has a window. Uses the program on `PATH`, otherwise the
/// program of Debian's package.
fn program(python: &Path, wheel: &Path) -> Outcome {
    if let Err(error) = fetch_program() {
        tools::skipped("blender's program", &error);
        return Ok(());
    }
    let folder = folder().join("program");
    let _ = std::fs::remove_dir_all(&folder);
    let place = folder.join("place");
    let extension = place.join("lumistack_extension");
    let io = |place: &Path, error: std::io::Error| format!("{}: {error}", place.display());
    std::fs::create_dir_all(&extension).map_err(|error| io(&extension, error))?;
    let from = tools::root().join("plugins/blender");
    for entry in std::fs::read_dir(&from).map_err(|error| io(&from, error))?.flatten() {
        if entry.path().extension().is_some_and(|kind| kind == "py") {
            std::fs::copy(entry.path(), extension.join(entry.file_name())).map_err(|error| io(&entry.path(), error))?;
        }
    }
    run(command(python).args(["-m", "zipfile", "-e"]).arg(wheel).arg(&place))?;
    let mut blender = command("blender");
    blender.args(["-b", "--factory-startup", "--python-exit-code", "1", "--python"]);
    run(blender.arg("plugins/blender/tests/program.py").arg("--").arg(&folder).arg(&place))
}

/// Runs the cases in `names` in one version of Blender, with the existing zip.
pub fn some(names: &str, version: &str) -> Outcome {
    let python = environment(version)?;
    let zip = zip_of(machine()?);
    if !zip.is_file() {
        return Err(format!(
            "{}: expected the extension, found none; `cargo xtask blender` makes the extension",
            zip.display()
        ));
    }
    cases(&python, &zip, version, names)
}

fn folder() -> PathBuf {
    tools::root().join("target/blender")
}

/// Finds or makes an environment with a version of bpy. Returns the environment's Python.
fn environment(version: &str) -> Outcome<PathBuf> {
    let has = |python: &Path| {
        let test = format!("import bpy, numpy, sys; sys.exit(bpy.app.version_string.split()[0] != '{version}')");
        output_of(command(python).args(["-c", &test])).is_some()
    };
    let folder = tools::root().join(format!("target/python-blender-{version}"));
    let python = folder.join("bin/python");
    if !has(&python) {
        let base = tools::python_of(PYTHON).ok_or_else(|| {
            format!(
                "expected Python {PYTHON}, which Blender's module bpy needs, as python3 or python{PYTHON}, found none"
            )
        })?;
        println!(
            "\nfetching: bpy {version} and numpy, in {} (used only to test the Blender extension)",
            folder.display()
        );
        run(command(base).args(["-m", "venv", "--clear"]).arg(&folder))?;
        install(&python, &["--no-cache-dir", "--only-binary=:all:", &format!("bpy=={version}"), "numpy"])?;
    }
    if has(&python) { Ok(python) } else { Err(format!("bpy {version} cannot be imported in {}", folder.display())) }
}

/// Makes the wheel for this machine by `make`, and returns its path.
fn wheel(python: &Path, make: fn(&Path) -> Outcome<PathBuf>) -> Outcome<PathBuf> {
    fetch_tools(python)?;
    make(python)
}

fn fetch_tools(python: &Path) -> Outcome {
    if output_of(command(python).args(["-c", "import maturin"])).is_some() { Ok(()) } else { install(python, &TOOLS) }
}

/// Builds the zips, each with the wheel of its platform. Returns the zip of this machine.
fn extension(python: &Path, wheels: &[PathBuf], platforms: &[&str]) -> Outcome<PathBuf> {
    // Collect the extension's files and the wheels.
    let (folder, source) = (folder(), tools::root().join("target/blender/lumistack"));
    let _ = std::fs::remove_dir_all(&folder);
    let io = |place: &Path, error: std::io::Error| format!("{}: {error}", place.display());
    std::fs::create_dir_all(source.join("wheels")).map_err(|error| io(&source, error))?;
    let from = tools::root().join("plugins/blender");
    for entry in std::fs::read_dir(&from).map_err(|error| io(&from, error))?.flatten() {
        if entry.path().is_file() {
            std::fs::copy(entry.path(), source.join(entry.file_name())).map_err(|error| io(&entry.path(), error))?;
        }
    }
    for wheel in wheels {
        std::fs::copy(wheel, source.join("wheels").join(name_of(wheel))).map_err(|error| io(wheel, error))?;
    }
    // Write platforms and wheels into the manifest.
    let manifest = source.join("blender_manifest.toml");
    let text = std::fs::read_to_string(&manifest).map_err(|error| io(&manifest, error))?;
    let version = env!("CARGO_PKG_VERSION");
    if !text.contains(&format!("version = \"{version}\"")) {
        return Err(format!(
            "plugins/blender/blender_manifest.toml: expected the workspace's version, {version}, found another version"
        ));
    }
    let names: Vec<String> = wheels.iter().map(|wheel| format!("./wheels/{}", name_of(wheel))).collect();
    let lines = format!("platforms = {platforms:?}\nwheels = {names:?}\n\n[permissions]");
    std::fs::write(&manifest, text.replacen("[permissions]", &lines, 1)).map_err(|error| io(&manifest, error))?;
    // Pack and validate the zips by Blender's own tool.
    let tool = "import glob, sysconfig; print(glob.glob(sysconfig.get_path('purelib') + '/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py')[0])";
    let tool = output_of(command(python).args(["-c", tool]))
        .ok_or("bpy: expected a version with Blender's tool for extensions, found a version without the tool")?;
    let tool = || {
        let mut blender = command(python);
        blender.arg(tool.trim());
        blender
    };
    let split = ["build", "--valid-tags=", "--split-platforms", "--source-dir"];
    run(tool().args(split).arg(&source).arg("--output-dir").arg(&folder))?;
    for platform in platforms {
        let zip = zip_of(platform);
        run(tool().args(["validate", "--valid-tags="]).arg(&zip))?;
        let bytes = std::fs::metadata(&zip).map_err(|error| io(&zip, error))?.len();
        println!("extension: {:.1} MB, {}", bytes as f64 / 1e6, zip.display());
    }
    Ok(zip_of(machine()?))
}

/// Returns the path of a platform's zip.
fn zip_of(platform: &str) -> PathBuf {
    folder().join(format!("lumistack-{}-{}.zip", env!("CARGO_PKG_VERSION"), platform.replace('-', "_")))
}

fn name_of(wheel: &Path) -> String {
    wheel.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns Blender's name of this machine's platform.
fn machine() -> Outcome<&'static str> {
    let (system, machine) = (std::env::consts::OS, std::env::consts::ARCH);
    PLATFORMS
        .into_iter()
        .find(|platform| (platform.system, platform.machine) == (system, machine))
        .map(|platform| platform.name)
        .ok_or_else(|| format!("expected a system for which Blender has extensions, found {system} on {machine}"))
}

/// A platform: Blender's name for it, Rust's names for its system and machine, and the beginning
/// and the end of the platform tags of its wheels.
struct Platform {
    name: &'static str,
    system: &'static str,
    machine: &'static str,
    tag: [&'static str; 2],
}

const PLATFORMS: [Platform; 6] = [
    Platform { name: "linux-x64", system: "linux", machine: "x86_64", tag: ["linux", "_x86_64"] },
    Platform { name: "linux-arm64", system: "linux", machine: "aarch64", tag: ["linux", "_aarch64"] },
    Platform { name: "macos-x64", system: "macos", machine: "x86_64", tag: ["macosx", "_x86_64"] },
    Platform { name: "macos-arm64", system: "macos", machine: "aarch64", tag: ["macosx", "_arm64"] },
    Platform { name: "windows-x64", system: "windows", machine: "x86_64", tag: ["win", "_amd64"] },
    Platform { name: "windows-arm64", system: "windows", machine: "aarch64", tag: ["win", "_arm64"] },
];

/// Returns the platforms of wheels. All wheels must be of this version, and a platform may have
/// only one wheel.
fn platforms_of(wheels: &[PathBuf]) -> Outcome<Vec<&'static str>> {
    let mut found = Vec::new();
    for wheel in wheels {
        let name = name_of(wheel);
        let expected = format!("lumistack-{}-cp311-abi3-", env!("CARGO_PKG_VERSION"));
        let tag = name.strip_prefix(&expected).and_then(|rest| rest.strip_suffix(".whl"));
        let tag = tag.ok_or_else(|| {
            format!("{}: expected a wheel {expected}PLATFORM.whl, found another name", wheel.display())
        })?;
        // a tag is for example manylinux_2_28_x86_64 or macosx_11_0_universal2
        let fits = |platform: &&Platform| {
            let [system, machine] = platform.tag;
            let is_mac_of_both = system == "macosx" && tag.ends_with("_universal2");
            tag.strip_prefix("many").unwrap_or(tag).starts_with(system) && (tag.ends_with(machine) || is_mac_of_both)
        };
        let before = found.len();
        for platform in PLATFORMS.iter().filter(fits) {
            if found.contains(&platform.name) {
                return Err(format!(
                    "{}: expected one wheel per platform, found a second wheel for {}",
                    wheel.display(),
                    platform.name
                ));
            }
            found.push(platform.name);
        }
        if found.len() == before {
            return Err(format!(
                "{}: expected the tag of a system for which Blender has extensions, found {tag}",
                wheel.display()
            ));
        }
    }
    Ok(found)
}

fn cases(python: &Path, zip: &Path, version: &str, names: &str) -> Outcome {
    println!("\nBlender {version}");
    let place = folder().join(format!("cases-{version}"));
    let mut cases = command(python);
    cases.arg("plugins/blender/tests/cases.py").arg(names).arg(zip).arg(&place);
    // this Python has OpenUSD, which the tests use to read USD if the version of Blender has none
    run(cases.env("LUMISTACK_PYTHON", tools::python()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(tags: &[&str]) -> Outcome<Vec<&'static str>> {
        let name = |tag: &&str| format!("dist/lumistack-{}-cp311-abi3-{tag}.whl", env!("CARGO_PKG_VERSION")).into();
        platforms_of(&tags.iter().map(name).collect::<Vec<_>>())
    }

    #[test]
    fn wheels_go_to_the_platforms_of_their_tags() {
        let tags = ["manylinux_2_28_x86_64", "linux_aarch64", "macosx_11_0_arm64", "win_amd64"];
        assert_eq!(of(&tags).unwrap(), ["linux-x64", "linux-arm64", "macos-arm64", "windows-x64"]);
        assert_eq!(of(&["manylinux2014_x86_64"]).unwrap(), ["linux-x64"]);
        assert_eq!(
            of(&["macosx_10_12_universal2", "win_arm64"]).unwrap(),
            ["macos-x64", "macos-arm64", "windows-arm64"]
        );
        for (tags, expected) in [
            (vec!["win32"], "found win32"),
            (vec!["manylinux_2_28_x86_64", "linux_x86_64"], "a second wheel for linux-x64"),
            (vec!["macosx_11_0_arm64", "macosx_11_0_universal2"], "a second wheel for macos-arm64"),
        ] {
            let error = of(&tags).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert!(platforms_of(&["lumistack-9.9.9-cp311-abi3-win_amd64.whl".into()]).unwrap_err().contains("expected"));
    }
}
