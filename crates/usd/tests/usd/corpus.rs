//! Public files in the folder that `LUMISTACK_ASSETS` names, by default `../shared/scenes`. The
//! Python that `LUMISTACK_PYTHON` names reads them. Without the folder or the Python, the tests are
//! skipped.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_usd::{EXTENSIONS, LoadOptions, Package, UsdError, load, scene_from_package};
use serde::Deserialize;
use tempfile::TempDir;

use crate::common;

/// The report of the script `walk_all.py` on one file.
#[derive(Debug, Deserialize)]
struct Counted {
    opens: bool,
    #[serde(default)]
    prims: usize,
    #[serde(default)]
    meshes: usize,
    #[serde(default)]
    points: usize,
    /// Number of visible meshes of render geometry that have faces, including instances.
    #[serde(default)]
    shown: usize,
    /// The reason why the walker wrote no package; `None` if it wrote one.
    refused: Option<String>,
}

/// The files of a folder, the report on each, and the folder of the packages.
struct Walked {
    paths: Vec<PathBuf>,
    counted: Vec<Counted>,
    packages: TempDir,
}

fn assets() -> Option<PathBuf> {
    lumistack_testkit::skip::folder("LUMISTACK_ASSETS", "../shared/scenes")
}

/// Runs the walker (the Python code that reads a stage) on all USD files in a folder of the assets.
/// `None` if the folder or a Python is missing.
fn walk(folder: &str) -> Option<Walked> {
    let (assets, python) = (assets()?, common::python()?);
    let mut paths = Vec::new();
    // Find all USD files in the folder and its subfolders.
    let mut folders = vec![assets.join(folder)];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else {
            lumistack_testkit::skip::skipped(&format!("no folder {}", folder.display()));
            return None;
        };
        for path in entries.map(|entry| entry.unwrap().path()) {
            let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
            if path.is_dir() {
                folders.push(path);
            } else if EXTENSIONS.contains(&extension) {
                paths.push(path);
            }
        }
    }
    paths.sort();
    // Read all files in one process, since importing OpenUSD is slow.
    let packages = tempfile::tempdir().unwrap();
    let mut child = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/walk_all.py"))
        .arg(packages.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the Python that LUMISTACK_PYTHON names starts");
    let names: Vec<&str> = paths.iter().map(|path| path.to_str().unwrap()).collect();
    child.stdin.take().unwrap().write_all(names.join("\n").as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let counted: Vec<Counted> =
        String::from_utf8(output.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(counted.len(), paths.len(), "the walker stopped: {}", &said[said.len().saturating_sub(2000)..]);
    Some(Walked { paths, counted, packages })
}

impl Walked {
    /// Runs `check` on all files in two threads. Fails with all errors that it returns.
    fn check(&self, check: impl Fn(&str, &[u8], &Counted) -> Result<(), String> + Sync) {
        let (next, faults) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        let Some(path) = self.paths.get(number) else { break };
                        let bytes = std::fs::read(self.packages.path().join(number.to_string())).unwrap_or_default();
                        let name = path.display().to_string();
                        if let Err(fault) = check(&name, &bytes, &self.counted[number]) {
                            faults.lock().unwrap().push(format!("{name}: {fault}"));
                        }
                    }
                });
            }
        });
        let faults = faults.into_inner().unwrap();
        assert!(faults.is_empty(), "{} of {} files:\n{}", faults.len(), self.paths.len(), faults.join("\n"));
    }
}

/// Checks that the package gives a scene, or an error that agrees with OpenUSD's result for the
/// file.
fn opens_or_fails_by_design(name: &str, bytes: &[u8], counted: &Counted) -> Result<(), String> {
    if let Some(reason) = &counted.refused {
        return if counted.opens { Err(format!("refused: {reason}")) } else { Ok(()) };
    }
    let package = Package::parse(bytes)?;
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    match scene_from_package(name, &package, Task::quiet(&warnings, &cancel)) {
        Ok(_) if package.header.files.is_empty() => Err("a scene of no files".into()),
        Ok(_) => Ok(()),
        Err(UsdError::Malformed { expected, .. })
            if counted.shown == 0 && expected.starts_with("at least one triangle") =>
        {
            Ok(())
        }
        Err(error) => Err(format!("{error} ({} meshes to show)", counted.shown)),
    }
}

#[test]
fn every_file_opens_or_fails_by_design() {
    let Some(walked) = walk("usd") else { return };
    assert!(walked.paths.len() > 100, "{} files", walked.paths.len());
    walked.check(opens_or_fails_by_design);
}

/// Hostile files cause errors or warnings, but no crash. Some files contain only inconsistent
/// meshes.
#[test]
fn hostile_files_do_no_harm() {
    let Some(walked) = walk("hostile/usd") else { return };
    walked.check(|name, bytes, counted| match opens_or_fails_by_design(name, bytes, counted) {
        Err(text) if text.contains("at least one triangle") => Ok(()),
        other => other,
    });
}

#[test]
fn composed_counts_are_those_of_openusd() {
    let Some(walked) = walk("usd/foundation") else { return };
    walked.check(|_, bytes, counted| {
        let found = Package::parse(bytes)?.header.contents;
        let [ours, theirs] =
            [[found.prims, found.meshes, found.points], [counted.prims, counted.meshes, counted.points]];
        if ours == theirs { Ok(()) } else { Err(format!("{ours:?}, not {theirs:?} prims, meshes and points")) }
    });
}

/// Compares an arm that bends with the same arm whose points OpenUSD computed for every time code.
#[test]
fn posed_points_are_those_that_openusd_baked() {
    let (Some(assets), Some(_)) = (assets(), common::python()) else { return };
    let folder = Path::new(&assets).join("usd/OpenUSD-UsdSkel");
    let mut heights = Vec::new();
    // Compare at the time codes 1, 4 and 10. Between whole time codes baked points move in straight
    // lines, and posed points do not.
    for time_s in [0.0, 0.125, 0.375] {
        let [posed, baked] = ["arm.usda", "arm_baked.usda"].map(|file| {
            let (warnings, cancel) = (Collector::default(), Cancel::default());
            let options = LoadOptions { time_s: Some(time_s), ..LoadOptions::default() };
            let scene = load(&folder.join(file), &options, Task::quiet(&warnings, &cancel)).unwrap().scene;
            let map = scene.instances[0].scene_from_mesh;
            scene.meshes[0].positions.iter().map(|&p| map.transform_point3(p)).collect::<Vec<_>>()
        });
        assert_eq!(posed.len(), baked.len());
        for (a, b) in posed.iter().zip(&baked) {
            assert!((*a - *b).length() < 1e-4, "{time_s}: {a} {b}");
        }
        heights.push(posed.iter().map(|p| p.y).fold(f32::NEG_INFINITY, f32::max));
    }
    assert!(heights[0] != heights[2], "the arm moves: {heights:?}");
}
