//! What is in the way: left-overs of runs that were killed, and what was kept for settings that are no longer those of the run.
//!
//! Every run sweeps both under its lock: left-overs when it begins, views of other settings when it has finished. `lumistack clean` does the same for folders
//! in which no run will come, and on demand removes all that only saves time.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use lumistack_core::Task;
use serde::{Deserialize, Serialize};

use crate::blender;
use crate::cache::KeyBuilder;
use crate::code;
use crate::error::PipelineError;
use crate::files::{read_json, write_json};
use crate::folder;

/// Below `cache`: what the last run that finished made use of.
const USED: &str = "used.json";
/// Folders of a run folder in which every file is ours, so that temporary files there belong to nobody else.
const OWN: [&str; 8] = ["cache", "target", "held-out", "outside", "layers", "designs", "plots", "outputs"];
/// Fields of views: each has folders `NAME-KEY` in the cache.
const FIELDS: [&str; 4] = ["target", "held-out", "outside", "zone"];
/// What stages leave in the cache beside their stamps, small and part of no other result.
const PLACED: [&str; 2] = ["window", "fit"];

/// What `lumistack clean` removed, or would remove.
#[derive(Clone, Debug, Serialize)]
pub struct Cleaned {
    /// The run folder.
    pub folder: PathBuf,
    /// By kind; kinds of which there was nothing are left out.
    pub freed: Vec<Freed>,
    /// What is still kept to save time at the next run, bytes.
    pub kept_bytes: u64,
}

impl Cleaned {
    /// Bytes of all kinds.
    pub fn bytes(&self) -> u64 {
        self.freed.iter().map(|freed| freed.bytes).sum()
    }
}

/// One kind of what is in the way.
#[derive(Clone, Debug, Serialize)]
pub struct Freed {
    /// What it is, for people.
    pub kind: &'static str,
    /// Number of files.
    pub files: usize,
    /// Their size.
    pub bytes: u64,
    /// Files and folders, relative to the run folder.
    #[serde(skip)]
    pub paths: Vec<PathBuf>,
}

/// What a run that finished made use of, by name.
#[derive(Default, Serialize, Deserialize)]
struct Used {
    /// Of the code that views pass through: no other program finds them.
    code: String,
    /// Folders of views.
    views: BTreeSet<String>,
    /// Of a sweep, its light fields and rows.
    fields: BTreeSet<String>,
    designs: BTreeSet<String>,
}

fn code_of_views() -> String {
    KeyBuilder::new("used", code::VIEWS).finish()
}

/// Notes which cached views the run in `dir` used and removes those of other settings.
///
/// # Errors
/// When the note cannot be written.
pub(crate) fn keep_only_views(dir: &Path, used: &[PathBuf]) -> Result<(), PipelineError> {
    let cache = dir.join("cache");
    let views = used.iter().filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned())).collect();
    let used = Used { code: code_of_views(), views, ..Used::default() };
    if !used.views.is_empty() || cache.join(USED).exists() {
        write_json(&cache.join(USED), &used)?;
    }
    remove_all(&unused_views(&cache, &used));
    Ok(())
}

/// Notes which light fields (numbers) and rows (files) the sweep in `dir` used and removes light fields of other settings. Rows are small and stay: a sweep over
/// more values takes them up.
///
/// # Errors
/// When the note cannot be written.
pub(crate) fn keep_only_fields(
    dir: &Path,
    fields: impl Iterator<Item = usize>,
    designs: BTreeSet<String>,
) -> Result<(), PipelineError> {
    let fields = fields.map(|number| number.to_string()).collect();
    let used = Used { code: code_of_views(), fields, designs, ..Used::default() };
    write_json(&dir.join("cache").join(USED), &used)?;
    remove_all(&unused_in(&dir.join("fields"), &used.fields));
    Ok(())
}

/// Removes what killed runs left in a run folder. The caller holds its lock.
pub(crate) fn sweep_left_overs(dir: &Path) {
    remove_all(&left_overs(dir));
}

/// What is removed here saves time at most, so a file that cannot be removed is no error; `clean` counts what is left.
fn remove_all(paths: &[PathBuf]) {
    for path in paths {
        let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
}

/// Entries of a folder with their names, sorted; none of one that is not there.
fn entries(folder: &Path) -> Vec<(String, PathBuf)> {
    let list = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut list: Vec<_> =
        list.filter_map(|entry| Some((entry.file_name().into_string().ok()?, entry.path()))).collect();
    list.sort();
    list
}

fn is_folder(path: &Path) -> bool {
    // not what a link leads to
    std::fs::symlink_metadata(path).is_ok_and(|data| data.is_dir())
}

/// Temporary files and folders of a run folder, of its nodes, times and light fields.
fn left_overs(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for (name, path) in entries(dir) {
        if lumistack_field_io::atomic::is_abandoned(&path) {
            found.push(path);
        } else if OWN.contains(&name.as_str()) && is_folder(&path) {
            below(&path, &mut found);
        }
    }
    found.extend(parts(dir).iter().flat_map(|part| left_overs(part)));
    found
}

/// As [`left_overs`], where everything is ours.
fn below(folder: &Path, found: &mut Vec<PathBuf>) {
    for (name, path) in entries(folder) {
        let temporary = name.starts_with(".lumistack-") && name.ends_with(".tmp");
        // where an output collects its files before they appear
        let partial = name.starts_with('.') && name.ends_with(".partial") && is_folder(&path);
        if temporary || partial {
            found.push(path);
        } else if is_folder(&path) {
            below(&path, found);
        }
    }
}

/// Run folders within a run folder: nodes, times of a sequence, light fields of a sweep.
fn parts(dir: &Path) -> Vec<PathBuf> {
    let times = entries(dir).into_iter().filter(|(name, path)| folder::is_time(name) && is_folder(path));
    let inner = ["nodes", "fields"].into_iter().flat_map(|name| entries(&dir.join(name)));
    times.chain(inner).map(|(_, path)| path).filter(|path| is_folder(path) && folder::is_ours(path)).collect()
}

/// Folders of cached views of a run (`cache/views`) or of `render` (`cache`).
fn all_views(cache: &Path) -> Vec<(String, PathBuf)> {
    let is_field =
        |name: &str| name.rsplit_once('-').is_some_and(|(field, key)| FIELDS.contains(&field) && key.len() == 16);
    let both = [cache.join("views"), cache.to_owned()];
    both.iter().flat_map(|folder| entries(folder)).filter(|(name, path)| is_field(name) && is_folder(path)).collect()
}

fn unused_views(cache: &Path, used: &Used) -> Vec<PathBuf> {
    let views = all_views(cache).into_iter();
    views.filter(|(name, _)| used.code != code_of_views() || !used.views.contains(name)).map(|(_, path)| path).collect()
}

fn unused_in(folder: &Path, used: &BTreeSet<String>) -> Vec<PathBuf> {
    entries(folder).into_iter().filter(|(name, _)| !used.contains(name)).map(|(_, path)| path).collect()
}

/// Removes what is in the way in a run folder, those of its nodes, times and light fields among it: left-overs of killed runs, and what is kept for other settings
/// than those of the last run that finished; with `all` everything that only saves time. Results stay. With `dry_run` it only looks.
///
/// # Errors
/// When it is no run folder, a run works there, or something cannot be removed.
pub fn clean(dir: &Path, all: bool, dry_run: bool, task: Task<'_>) -> Result<Cleaned, PipelineError> {
    if !folder::is_ours(dir) {
        let found = match std::fs::metadata(dir) {
            Err(error) => error.to_string(),
            Ok(data) if !data.is_dir() => "a file".into(),
            Ok(_) => "one without anything that a run leaves".into(),
        };
        return Err(PipelineError::value(dir, "folder", "a folder of a run, a sequence, a sweep or of views", found));
    }
    let _owned = folder::take_known(dir, task)?;
    let mut kinds: Vec<(&'static str, Vec<PathBuf>)> = vec![("left-overs of stopped runs", left_overs(dir))];
    collect(dir, all, &mut kinds);
    // of a preview that was stopped while it was made; not of one that is being made
    let preview = dir.join(".preview.partial");
    if is_folder(&preview) && folder::take_preview(dir, task).is_ok() {
        kinds[0].1.push(preview);
    }
    // without the note of who looks
    let kept = |part: &PathBuf| {
        let all = ["cache", "designs"].iter().map(|name| size(&part.join(name))[1]).sum::<u64>();
        all - size(&part.join("cache").join(folder::OWNER))[1]
    };
    let mut kept_bytes: u64 = nested(dir).iter().map(kept).sum();
    let mut freed: Vec<Freed> = Vec::new();
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

/// A run folder and all within it.
fn nested(dir: &Path) -> Vec<PathBuf> {
    std::iter::once(dir.to_owned()).chain(parts(dir).iter().flat_map(|part| nested(part))).collect()
}

fn collect(dir: &Path, all: bool, kinds: &mut Vec<(&'static str, Vec<PathBuf>)>) {
    let cache = dir.join("cache");
    let used = read_json::<Used>(&cache.join(USED));
    // a folder whose last run was stopped may go on from all that it has; one that finished before uses were noted is of another version
    let finished = ["report.json", "lightfield.json", "sweep.json"].iter().any(|name| dir.join(name).is_file());
    let known = used.or_else(|| finished.then(Used::default));
    if all {
        kinds.push(("cached views", all_views(&cache).into_iter().map(|(_, path)| path).collect()));
    } else if let Some(used) = &known {
        kinds.push(("views of other settings", unused_views(&cache, used)));
    }
    let of_kind = |name: &str, wanted: &[&str]| name.rsplit_once('-').is_some_and(|(kind, _)| wanted.contains(&kind));
    let kept = entries(&cache).into_iter();
    let (scenes, placed): (Vec<_>, Vec<_>) = kept
        .filter(|(name, path)| !path.is_dir() && of_kind(name, &["blend", "window", "fit"]))
        .partition(|(name, _)| of_kind(name, &["blend"]));
    let stale = scenes.into_iter().filter(|(_, path)| all || !blender::holds(path));
    kinds.push(("scenes that Blender handed over", stale.map(|(_, path)| path).collect()));
    if all {
        let placed = placed.into_iter().filter(|(name, _)| of_kind(name, &PLACED));
        kinds.push(("places of the window", placed.map(|(_, path)| path).collect()));
    }
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
        kinds.push(("rows of designs", rows));
    }
    // those that are removed as a whole need no look inside
    let gone: Vec<PathBuf> = kinds.iter().flat_map(|(_, paths)| paths.clone()).collect();
    for part in parts(dir).into_iter().filter(|part| !gone.contains(part)) {
        collect(&part, all, kinds);
    }
}

/// [files, bytes] of a file or of all below a folder.
fn size(path: &Path) -> [u64; 2] {
    let Ok(data) = std::fs::symlink_metadata(path) else { return [0, 0] };
    if !data.is_dir() {
        return [1, data.len()];
    }
    let inner = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| size(&entry.path()));
    inner.fold([0, 0], |[a, b], [c, d]| [a + c, b + d])
}
