//! Cleans run folders. Removes left-overs of killed runs, and cached files of other settings.
//!
//! Every run cleans its folder while it holds the lock. It removes left-overs when it begins, and
//! views of other settings when it ends. `lumistack clean` cleans a folder without running its job
//! again. It can also remove all files that only save time.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use serde::Serialize;

use super::files::read_json;
use super::handover;
use super::left_overs::{entries, is_folder, left_overs, parts};
use super::lock::{OWNER, lock_known, lock_preview};
use super::names::is_ours;
use super::used::{TILES, USED, Used, all_views, unused_in, unused_views};
use crate::error::PipelineError;

/// Kinds of small files that cache the placement of the window, and the measured number of paths.
/// No other result depends on these files.
const PLACED: [&str; 5] = ["side", "window", "fit", "focus", "samples"];

/// Files that `lumistack clean` removed, or would remove.
#[derive(Clone, Debug, Serialize)]
pub struct Cleaned {
    /// The run folder.
    pub folder: PathBuf,
    /// Removed files by kind. Kinds without files are not listed.
    pub freed: Vec<Freed>,
    /// Size of the remaining cached files, bytes.
    pub kept_bytes: u64,
}

impl Cleaned {
    /// Returns the size of the removed files of all kinds, bytes.
    pub fn bytes(&self) -> u64 {
        self.freed.iter().map(|freed| freed.bytes).sum()
    }
}

/// Removed files of one kind.
#[derive(Clone, Debug, Serialize)]
pub struct Freed {
    /// Description of the kind.
    pub kind: &'static str,
    /// Number of files.
    pub files: usize,
    /// Size of the files, bytes.
    pub bytes: u64,
    /// Files and folders, relative to the run folder.
    #[serde(skip)]
    pub paths: Vec<PathBuf>,
}

/// Cleans a run folder, and the nodes, time steps and light fields in it. Left-overs of killed runs
/// and cached files of other settings are removed. With `all`, everything is removed that only
/// saves time. Results stay. With `dry_run`, nothing is removed.
///
/// # Errors
/// If the folder is not a run folder, a run uses it, or a file cannot be removed.
pub fn clean(dir: &Path, all: bool, dry_run: bool, task: Task<'_>) -> Result<Cleaned, PipelineError> {
    if !is_ours(dir) {
        let found = match std::fs::metadata(dir) {
            Err(error) => error.to_string(),
            Ok(data) if !data.is_dir() => "a file".into(),
            Ok(_) => "a folder without files of a run".into(),
        };
        return Err(PipelineError::value(
            dir,
            "folder",
            "the folder of a run, of a sequence, of a sweep or of rendered views",
            found,
        ));
    }
    let _owned = lock_known(dir, task)?;
    let mut kinds: Vec<(&'static str, Vec<PathBuf>)> = vec![("left-overs of stopped runs", left_overs(dir))];
    collect(dir, all, &mut kinds);
    // Remove an incomplete preview only if it is not locked. A lock means that a process still
    // writes the preview.
    let preview = dir.join(".preview.partial");
    if is_folder(&preview) && lock_preview(dir, task).is_ok() {
        kinds[0].1.push(preview);
    }
    // This process has written the file with the owner of the lock, so the file's size is not
    // included.
    let kept = |part: &PathBuf| {
        let all = ["cache", "designs"].iter().map(|name| size(&part.join(name))[1]).sum::<u64>();
        all - size(&part.join("cache").join(OWNER))[1]
    };
    let mut kept_bytes: u64 = nested(dir).iter().map(kept).sum();
    let mut freed: Vec<Freed> = Vec::new();
    // Count the files. Without `dry_run`, also remove them.
    for (kind, paths) in kinds {
        for path in paths {
            let [files, bytes] = size(&path);
            let relative = path.strip_prefix(dir).unwrap_or(&path).to_owned();
            if relative.iter().any(|part| part == "cache" || part == "designs") {
                kept_bytes = kept_bytes.saturating_sub(bytes);
            }
            if !dry_run {
                let removed =
                    if is_folder(&path) { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
                removed.map_err(PipelineError::write(&path))?;
            }
            let known = match freed.iter_mut().position(|freed| freed.kind == kind) {
                Some(known) => known,
                None => {
                    freed.push(Freed { kind, files: 0, bytes: 0, paths: Vec::new() });
                    freed.len() - 1
                }
            };
            freed[known].files += files as usize;
            freed[known].bytes += bytes;
            freed[known].paths.push(relative);
        }
    }
    Ok(Cleaned { folder: dir.to_owned(), freed, kept_bytes })
}

/// Returns a run folder and all run folders inside of it.
fn nested(dir: &Path) -> Vec<PathBuf> {
    std::iter::once(dir.to_owned()).chain(parts(dir).iter().flat_map(|part| nested(part))).collect()
}

fn collect(dir: &Path, all: bool, kinds: &mut Vec<(&'static str, Vec<PathBuf>)>) {
    let cache = dir.join("cache");
    let used = read_json::<Used>(&cache.join(USED));
    // A stopped run may reuse all files. A finished run without a list of used files is from an
    // older version, whose files this version cannot reuse.
    let finished = ["report.json", "lightfield.json", "sweep.json"].iter().any(|name| dir.join(name).is_file());
    let known = used.or_else(|| finished.then(Used::default));
    if all {
        kinds.push(("cached views", all_views(&cache).into_iter().map(|(_, path)| path).collect()));
    } else if let Some(used) = &known {
        kinds.push(("views of other settings", unused_views(&cache, used)));
    }
    // Unless `all` is true, placements stay, and Blender's conversions stay while they are valid.
    let of_kind = |name: &str, wanted: &[&str]| name.rsplit_once('-').is_some_and(|(kind, _)| wanted.contains(&kind));
    let kept = entries(&cache).into_iter();
    let (scenes, placed): (Vec<_>, Vec<_>) = kept
        .filter(|(name, path)| !path.is_dir() && (of_kind(name, &["blend"]) || of_kind(name, &PLACED)))
        .partition(|(name, _)| of_kind(name, &["blend"]));
    let stale = scenes.into_iter().filter(|(_, path)| all || !handover::holds(path));
    kinds.push(("scenes that Blender converted", stale.map(|(_, path)| path).collect()));
    if all {
        let placed = placed.into_iter().filter(|(name, _)| of_kind(name, &PLACED));
        kinds.push(("cached measurements of the scene", placed.map(|(_, path)| path).collect()));
        let tiles = cache.join(TILES);
        kinds.push(("patterns of tiles", if is_folder(&tiles) { vec![tiles] } else { Vec::new() }));
        let warm_up = cache.join("warm-up");
        kinds.push(("cached warm-up time steps", if is_folder(&warm_up) { vec![warm_up] } else { Vec::new() }));
    }
    // List the light fields that the last sweep did not use. List the rows that it did not use or,
    // with `all`, all rows.
    if dir.join("sweep.json").is_file()
        && let Some(used) = &known
        && !used.fields.is_empty()
    {
        kinds.push(("light fields of other settings", unused_in(&dir.join("fields"), &used.fields)));
        let rows = if all {
            entries(&dir.join("designs")).into_iter().map(|(_, path)| path).collect()
        } else {
            unused_in(&dir.join("designs"), &used.designs)
        };
        kinds.push(("cached scores of designs", rows));
    }
    // Folders that are removed as a whole need no search.
    let gone: Vec<PathBuf> = kinds.iter().flat_map(|(_, paths)| paths.clone()).collect();
    for part in parts(dir).into_iter().filter(|part| !gone.contains(part)) {
        collect(&part, all, kinds);
    }
}

/// Returns [number of files, bytes] of a file, or of all files in a folder and its subfolders.
fn size(path: &Path) -> [u64; 2] {
    let Ok(data) = std::fs::symlink_metadata(path) else { return [0, 0] };
    if !data.is_dir() {
        return [1, data.len()];
    }
    let inner = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| size(&entry.path()));
    inner.fold([0, 0], |[a, b], [c, d]| [a + c, b + d])
}
