//! The Blender extension: its zip, validated by Blender's own tool, and tested in real Blenders, each the module bpy in an environment of its own.

use std::path::{Path, PathBuf};

use crate::python;
use crate::tools::{self, Outcome, command, install, output_of, run};

/// The Blender of CI, which also validates, and those of `--full`.
const BLENDER: &str = "5.0.1";
const OLDER: [&str; 2] = ["4.5.15", "4.2.23"];
/// The Python that all of them need.
const PYTHON: &str = "3.11";
/// What builds the wheel.
const TOOLS: [&str; 3] = ["--only-binary=:all:", "maturin==1.16.*", "numpy"];

/// Builds the extension as users get it, in `target/blender`.
pub fn build() -> Outcome {
    let python = environment(BLENDER)?;
    let zip = extension(&python, "release")?;
    println!("{}", zip.display());
    Ok(())
}

/// Builds the extension from the artefacts of the workspace's tests and runs its cases; `full` in all versions of Blender. Skips with a message where bpy cannot be had.
pub fn check(full: bool) -> Outcome {
    let python = match environment(BLENDER) {
        Ok(python) => python,
        Err(error) => {
            println!("blender: skipped: {error}");
            return Ok(());
        }
    };
    let zip = extension(&python, "dev")?;
    cases(&python, &zip, BLENDER, "all")?;
    if full {
        for version in OLDER {
            match environment(version) {
                Ok(python) => cases(&python, &zip, version, "all")?,
                Err(error) => println!("blender: {version} skipped: {error}"),
            }
        }
    }
    Ok(())
}

/// Some cases alone, in one version of Blender, with the zip that is there.
pub fn some(names: &str, version: &str) -> Outcome {
    let python = environment(version)?;
    let folder = folder();
    let entries = std::fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?.flatten();
    let zip = entries.map(|entry| entry.path()).find(|path| path.extension().is_some_and(|kind| kind == "zip"));
    cases(&python, &zip.ok_or("no zip in target/blender: `cargo xtask blender` makes it")?, version, names)
}

fn folder() -> PathBuf {
    tools::root().join("target/blender")
}

/// An environment with a version of bpy.
fn environment(version: &str) -> Outcome<PathBuf> {
    let has = |python: &Path| {
        let test = format!("import bpy, numpy, sys; sys.exit(bpy.app.version_string.split()[0] != '{version}')");
        output_of(command(python).args(["-c", &test])).is_some()
    };
    let folder = tools::root().join(format!("target/python-blender-{version}"));
    let python = folder.join("bin/python");
    if !has(&python) {
        let base = python_of_blender().ok_or_else(|| {
            format!("Blender's module bpy needs Python {PYTHON}, and neither python3 nor python{PYTHON} is one")
        })?;
        println!(
            "\nfetching: bpy {version} and numpy, in {} (used only to test the Blender extension)",
            folder.display()
        );
        run(command(base).args(["-m", "venv", "--clear"]).arg(&folder))?;
        install(&python, &["--no-cache-dir", "--only-binary=:all:", &format!("bpy=={version}"), "numpy"])?;
    }
    if has(&python) { Ok(python) } else { Err(format!("bpy {version} does not import in {}", folder.display())) }
}

fn python_of_blender() -> Option<String> {
    let test = "import sys; print('%d.%d' % sys.version_info[:2])";
    ["python3".to_owned(), format!("python{PYTHON}")]
        .into_iter()
        .find(|python| output_of(command(python).args(["-c", test])).is_some_and(|said| said.trim() == PYTHON))
}

/// The zip, with the wheel for this machine in it.
fn extension(python: &Path, profile: &str) -> Outcome<PathBuf> {
    if output_of(command(python).args(["-c", "import maturin"])).is_none() {
        install(python, &TOOLS)?;
    }
    let wheel = python::build(python, profile)?;
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
    let name = wheel.file_name().unwrap_or_default().to_string_lossy().into_owned();
    std::fs::copy(&wheel, source.join("wheels").join(&name)).map_err(|error| io(&wheel, error))?;
    let platform = platform_of(&name).ok_or_else(|| format!("{name}: no platform that Blender knows"))?;
    let manifest = source.join("blender_manifest.toml");
    let text = std::fs::read_to_string(&manifest).map_err(|error| io(&manifest, error))?;
    let lines = format!("platforms = [\"{platform}\"]\nwheels = [\"./wheels/{name}\"]\n\n[permissions]");
    std::fs::write(&manifest, text.replacen("[permissions]", &lines, 1)).map_err(|error| io(&manifest, error))?;
    let tool = "import glob, sysconfig; print(glob.glob(sysconfig.get_path('purelib') + '/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py')[0])";
    let tool = output_of(command(python).args(["-c", tool])).ok_or("this bpy has no tool for extensions")?;
    let tool = || {
        let mut blender = command(python);
        blender.arg(tool.trim());
        blender
    };
    run(tool().args(["build", "--valid-tags=", "--source-dir"]).arg(&source).arg("--output-dir").arg(&folder))?;
    let version = env!("CARGO_PKG_VERSION");
    let zip = folder.join(format!("lumistack-{version}.zip"));
    if !text.contains(&format!("version = \"{version}\"")) {
        return Err(format!("plugins/blender/blender_manifest.toml: expected version {version}, the workspace's"));
    }
    run(tool().args(["validate", "--valid-tags="]).arg(&zip))?;
    let bytes = std::fs::metadata(&zip).map_err(|error| io(&zip, error))?.len();
    println!("extension: {:.1} MB, {}", bytes as f64 / 1e6, zip.display());
    Ok(zip)
}

/// A wheel's platform by Blender's names.
fn platform_of(wheel: &str) -> Option<&'static str> {
    let known = [
        ("manylinux", "x86_64", "linux-x64"),
        ("linux", "x86_64", "linux-x64"),
        ("linux", "aarch64", "linux-arm64"),
        ("macosx", "arm64", "macos-arm64"),
        ("macosx", "x86_64", "macos-x64"),
        ("win", "amd64", "windows-x64"),
        ("win", "arm64", "windows-arm64"),
    ];
    known
        .into_iter()
        .find(|(system, machine, _)| wheel.contains(system) && wheel.contains(machine))
        .map(|found| found.2)
}

fn cases(python: &Path, zip: &Path, version: &str, names: &str) -> Outcome {
    println!("\nBlender {version}");
    let place = folder().join(format!("cases-{version}"));
    run(command(python).arg("plugins/blender/tests/cases.py").arg(names).arg(zip).arg(&place))
}
