//! Files of a run on many machines, in the run folder.

use std::path::{Path, PathBuf};

use super::left_overs::remove_all;

/// Folder of the files, relative to the run folder.
const FOLDER: &str = "cache/farm";

/// Returns the path of the plan's file.
pub(crate) fn plan_file(dir: &Path) -> PathBuf {
    dir.join(FOLDER).join("plan.json")
}

/// Returns the path of the file that marks a unit as done. An id consists of names of folders and
/// steps with `/` between them, so it can be part of a path.
pub(crate) fn done_file(dir: &Path, id: &str) -> PathBuf {
    dir.join(FOLDER).join("done").join(format!("{id}.json"))
}

/// Removes the files that mark units as done, since other work may replace the units' results.
pub(crate) fn forget(dir: &Path) {
    let done = dir.join(FOLDER).join("done");
    if done.is_dir() {
        remove_all(&[done]);
    }
}
