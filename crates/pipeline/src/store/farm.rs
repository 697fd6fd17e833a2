//! Where a run folder keeps what many machines know of it.

use std::path::{Path, PathBuf};

use super::left_overs::remove_all;

/// Below the run folder.
const FOLDER: &str = "cache/farm";

/// The plan.
pub(crate) fn plan_file(dir: &Path) -> PathBuf {
    dir.join(FOLDER).join("plan.json")
}

/// The note that a unit is done. Ids are made of names of folders and steps.
pub(crate) fn done_file(dir: &Path, id: &str) -> PathBuf {
    dir.join(FOLDER).join("done").join(format!("{id}.json"))
}

/// Forgets which units are done: other work may replace their results.
pub(crate) fn forget(dir: &Path) {
    let done = dir.join(FOLDER).join("done");
    if done.is_dir() {
        remove_all(&[done]);
    }
}
