//! What runs that were killed left: temporary files and folders, which every run sweeps under its lock when it begins.

use std::path::{Path, PathBuf};

use super::names::{is_ours, is_time};

/// Folders of a run folder in which every file is ours, so that temporary files there belong to nobody else.
const OWN: [&str; 8] = ["cache", "target", "held-out", "outside", "layers", "designs", "plots", "outputs"];
/// Removes what killed runs left in a run folder. The caller holds its lock.
pub(crate) fn sweep(dir: &Path) {
    remove_all(&left_overs(dir));
}

/// What is removed here saves time at most, so a file that cannot be removed is no error; `clean` counts what is left.
pub(crate) fn remove_all(paths: &[PathBuf]) {
    for path in paths {
        let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
}

/// Entries of a folder with their names, sorted; none of one that is not there.
pub(crate) fn entries(folder: &Path) -> Vec<(String, PathBuf)> {
    let list = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut list: Vec<_> =
        list.filter_map(|entry| Some((entry.file_name().into_string().ok()?, entry.path()))).collect();
    list.sort();
    list
}

pub(crate) fn is_folder(path: &Path) -> bool {
    // not what a link leads to
    std::fs::symlink_metadata(path).is_ok_and(|data| data.is_dir())
}

/// Temporary files and folders of a run folder, of its nodes, times and light fields.
pub(crate) fn left_overs(dir: &Path) -> Vec<PathBuf> {
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
pub(crate) fn parts(dir: &Path) -> Vec<PathBuf> {
    let times = entries(dir).into_iter().filter(|(name, path)| is_time(name) && is_folder(path));
    let inner = ["nodes", "fields"].into_iter().flat_map(|name| entries(&dir.join(name)));
    times.chain(inner).map(|(_, path)| path).filter(|path| is_folder(path) && is_ours(path)).collect()
}
