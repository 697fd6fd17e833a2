//! Detects changed files by their length and time of modification. This works on every file system,
//! for programs that replace files and for programs that write into them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Length and time of modification of a file; `None` for a missing file.
type FileState = Option<(u64, Option<SystemTime>)>;
/// States of one file, or of all files of a folder.
type FileStates = Vec<(PathBuf, FileState)>;

/// Watched files, with their states at the last reported change.
#[derive(Default)]
pub(super) struct Watched {
    seen: BTreeMap<PathBuf, FileStates>,
    /// States of the files after a change that may still be incomplete.
    moving: Option<BTreeMap<PathBuf, FileStates>>,
}

impl Watched {
    /// Returns whether files have changed and are complete: two calls in a row must find the same
    /// states. `read` is the time at which the program began to read the files. A path that was not
    /// in `files` at the last call has changed if its file was written after `read`.
    pub(super) fn have_changed(&mut self, files: &[PathBuf], read: SystemTime) -> bool {
        let now: BTreeMap<PathBuf, FileStates> = files.iter().map(|path| (path.clone(), states(path))).collect();
        self.seen.retain(|path, _| now.contains_key(path));
        for (path, states) in &now {
            self.seen.entry(path.clone()).or_insert_with(|| states_at(states, read));
        }
        if self.seen == now {
            self.moving = None;
            return false;
        }
        // A program that replaces a file removes it for a short time, so a missing file means that
        // the change is incomplete.
        let is_whole = now.values().flatten().all(|(_, states)| states.is_some());
        if is_whole && self.moving.as_ref() == Some(&now) {
            (self.seen, self.moving) = (now, None);
            return true;
        }
        self.moving = Some(now);
        false
    }
}

/// Returns the states that files had at a given earlier time. The state is `None` for files that
/// were written later.
fn states_at(states: &FileStates, time: SystemTime) -> FileStates {
    let is_old = |modified: &Option<SystemTime>| modified.is_none_or(|modified| modified <= time);
    let at = |state: &FileState| state.filter(|(_, modified)| is_old(modified));
    states.iter().map(|(path, state)| (path.clone(), at(state))).collect()
}

fn states(path: &Path) -> FileStates {
    let of = |path: PathBuf| {
        let data = std::fs::metadata(&path).ok().map(|data| (data.len(), data.modified().ok()));
        (path, data)
    };
    let Ok(entries) = std::fs::read_dir(path) else { return vec![of(path.to_owned())] };
    let mut inside: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    inside.sort();
    inside.into_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complete_changes_are_reported_once() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["a.gltf", "views"].map(|name| folder.path().join(name));
        let [file, views] = &paths;
        std::fs::write(file, "1").unwrap();
        std::fs::create_dir(views).unwrap();
        let mut watched = Watched::default();
        let read = SystemTime::now();
        let mut look = || [0; 3].map(|_| watched.have_changed(&paths, read));
        assert_eq!(look(), [false; 3]);
        std::fs::write(file, "22").unwrap();
        assert_eq!(look(), [false, true, false]);
        // The file is missing for a short time while a program replaces it.
        std::fs::remove_file(file).unwrap();
        assert_eq!(look(), [false; 3]);
        std::fs::write(file, "333").unwrap();
        assert_eq!(look(), [false, true, false]);
        std::fs::write(views.join("view_00_00.exr"), "v").unwrap();
        assert_eq!(look(), [false, true, false]);
        // A call with fewer files than the last call reports no change.
        assert!(!watched.have_changed(&paths[..1], read) && !watched.have_changed(&paths[..1], read));
        // A file has changed if it was written after the program began to read it.
        let mut late = Watched::default();
        let before = read.checked_sub(std::time::Duration::from_secs(60)).unwrap();
        assert_eq!([0; 3].map(|_| late.have_changed(&paths, before)), [false, true, false]);
    }
}
