//! Left-overs of killed runs: temporary files and folders. Every run removes them under its lock
//! when it begins.

use std::path::{Path, PathBuf};

use super::names::{is_ours, is_time};

/// Folders inside a run folder that contain only files of Lumistack. Any temporary file in them may
/// be removed.
const OWN: [&str; 8] = ["cache", "target", "held-out", "outside", "layers", "designs", "plots", "outputs"];
/// Removes left-overs of killed runs from a run folder. The caller holds the folder's lock.
pub(crate) fn remove(dir: &Path) {
    remove_all(&left_overs(dir));
}

/// Removes files and folders. No result depends on them, so a failure is not an error; `clean`
/// reports files that remain.
pub(crate) fn remove_all(paths: &[PathBuf]) {
    for path in paths {
        let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
}

/// Returns the entries of a folder with their names, sorted; empty if the folder does not exist.
pub(crate) fn entries(folder: &Path) -> Vec<(String, PathBuf)> {
    let list = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut list: Vec<_> =
        list.filter_map(|entry| Some((entry.file_name().into_string().ok()?, entry.path()))).collect();
    list.sort();
    list
}

pub(crate) fn is_folder(path: &Path) -> bool {
    // A link to a folder is not regarded as a folder, so the linked files are never removed.
    std::fs::symlink_metadata(path).is_ok_and(|data| data.is_dir())
}

/// Returns temporary files and folders in a run folder, and in its nodes, time steps and light
/// fields.
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

/// Collects left-overs like [`left_overs`], in folders that contain only files of Lumistack.
fn below(folder: &Path, found: &mut Vec<PathBuf>) {
    for (name, path) in entries(folder) {
        let temporary = name.starts_with(".lumistack-") && name.ends_with(".tmp");
        // An output writes its files into a folder `.NAME.partial` before it renames the folder.
        let partial = name.starts_with('.') && name.ends_with(".partial") && is_folder(&path);
        if temporary || partial {
            found.push(path);
        } else if is_folder(&path) {
            below(&path, found);
        }
    }
}

/// Returns the run folders inside of a run folder: nodes, time steps of a sequence, and light
/// fields of a sweep.
pub(crate) fn parts(dir: &Path) -> Vec<PathBuf> {
    let times = entries(dir).into_iter().filter(|(name, path)| is_time(name) && is_folder(path));
    let inner = ["nodes", "fields"].into_iter().flat_map(|name| entries(&dir.join(name)));
    times.chain(inner).map(|(_, path)| path).filter(|path| is_folder(path) && is_ours(path)).collect()
}
