//! Other people's files, from the folder that `LUMISTACK_ASSETS` names, through the Python that `LUMISTACK_PYTHON` names; skipped without either.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_usd::{EXTENSIONS, LoadOptions, UsdError, contents, load};
use serde::Deserialize;

/// What `count.py` says of a file.
#[derive(Debug, Deserialize)]
struct Counted {
    opens: bool,
    #[serde(default)]
    prims: usize,
    #[serde(default)]
    meshes: usize,
    #[serde(default)]
    points: usize,
    /// Visible meshes of render geometry with faces.
    #[serde(default)]
    shown: usize,
}

/// All USD files below a folder of the assets, with their counts; `None` where something is missing.
fn files(folder: &str) -> Option<Vec<(PathBuf, Counted)>> {
    let (Some(assets), Some(python)) = (std::env::var_os("LUMISTACK_ASSETS"), std::env::var_os("LUMISTACK_PYTHON"))
    else {
        eprintln!("skipped: LUMISTACK_ASSETS or LUMISTACK_PYTHON is not set");
        return None;
    };
    let mut paths = Vec::new();
    let mut folders = vec![Path::new(&assets).join(folder)];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else {
            eprintln!("skipped: no folder {}", folder.display());
            continue;
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
    let mut child = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/count.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the Python that LUMISTACK_PYTHON names starts");
    let names: Vec<&str> = paths.iter().map(|path| path.to_str().unwrap()).collect();
    child.stdin.take().unwrap().write_all(names.join("\n").as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let counted: Vec<Counted> =
        String::from_utf8(output.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(counted.len(), paths.len(), "OpenUSD got through all files");
    Some(paths.into_iter().zip(counted).collect())
}

/// Runs `check` over all files, on two threads, and fails with everything that it says.
fn check_all(files: &[(PathBuf, Counted)], check: impl Fn(&Path, &Counted) -> Result<(), String> + Sync) {
    let next = AtomicUsize::new(0);
    let faults = std::sync::Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some((path, counted)) = files.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if let Err(fault) = check(path, counted) {
                        faults.lock().unwrap().push(format!("{}: {fault}", path.display()));
                    }
                }
            });
        }
    });
    let faults = faults.into_inner().unwrap();
    assert!(faults.is_empty(), "{} of {} files:\n{}", faults.len(), files.len(), faults.join("\n"));
}

/// A scene, or a reason that fits what OpenUSD says of the file.
fn opens_or_fails_by_design(path: &Path, counted: &Counted) -> Result<(), String> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    match (load(path, &LoadOptions::default(), Task::quiet(&warnings, &cancel)), counted.opens) {
        (Ok(loaded), true) if loaded.files.is_empty() => Err("no files".into()),
        (Ok(_), true) => Ok(()),
        (Ok(_), false) => Err("a scene of a file that does not open".into()),
        (Err(UsdError::Refused { .. }), false) => Ok(()),
        (Err(UsdError::Malformed { expected, .. }), true)
            if counted.shown == 0 && expected.starts_with("at least one triangle") =>
        {
            Ok(())
        }
        (Err(error), opens) => Err(format!("{error} (opens: {opens}, meshes shown: {})", counted.shown)),
    }
}

#[test]
fn every_file_opens_or_fails_by_design() {
    if let Some(files) = files("usd") {
        assert!(files.len() > 100, "{} files", files.len());
        check_all(&files, opens_or_fails_by_design);
    }
}

/// Hostile files make errors or warnings, and no crash of ours. Some hold meshes that contradict themselves.
#[test]
fn hostile_files_do_no_harm() {
    let Some(files) = files("hostile/usd") else { return };
    check_all(&files, |path, counted| match opens_or_fails_by_design(path, counted) {
        Err(text) if text.contains("at least one triangle") && counted.opens => Ok(()),
        other => other,
    });
}

#[test]
fn composed_counts_are_those_of_openusd() {
    let Some(files) = files("usd/foundation") else { return };
    check_all(&files, |path, counted| {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let found = contents(path, Task::quiet(&warnings, &cancel)).map_err(|error| error.to_string())?;
        let [ours, theirs] =
            [[found.prims, found.meshes, found.points], [counted.prims, counted.meshes, counted.points]];
        if ours == theirs { Ok(()) } else { Err(format!("{ours:?}, not {theirs:?} prims, meshes and points")) }
    });
}
