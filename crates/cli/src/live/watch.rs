//! Files that are written while the display is shown, found by their length and time: that works on every file system, and for programs that
//! replace files as well as for those that write into them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A file's length and time, or those of all that lies in a folder; `None` of what is not there.
type Looks = Vec<(PathBuf, Option<(u64, Option<SystemTime>)>)>;

/// Files, as they were when they were taken up.
#[derive(Default)]
pub(super) struct Watched {
    seen: BTreeMap<PathBuf, Looks>,
    /// A change that may not be whole yet.
    moving: Option<BTreeMap<PathBuf, Looks>>,
}

impl Watched {
    /// Whether files have changed and have come to rest: they look the same at two looks one after another. Files that were not among those of the last look are
    /// taken as they are.
    pub(super) fn have_changed(&mut self, files: &[PathBuf]) -> bool {
        let now: BTreeMap<PathBuf, Looks> = files.iter().map(|path| (path.clone(), looks(path))).collect();
        self.seen.retain(|path, _| now.contains_key(path));
        for (path, looks) in &now {
            self.seen.entry(path.clone()).or_insert_with(|| looks.clone());
        }
        if self.seen == now {
            self.moving = None;
            return false;
        }
        // a file that is replaced is gone for a moment
        let is_whole = now.values().flatten().all(|(_, looks)| looks.is_some());
        if is_whole && self.moving.as_ref() == Some(&now) {
            (self.seen, self.moving) = (now, None);
            return true;
        }
        self.moving = Some(now);
        false
    }
}

fn looks(path: &Path) -> Looks {
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
    fn files_that_were_written_and_have_come_to_rest_are_told_once() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["a.gltf", "views"].map(|name| folder.path().join(name));
        let [file, views] = &paths;
        std::fs::write(file, "1").unwrap();
        std::fs::create_dir(views).unwrap();
        let mut watched = Watched::default();
        let mut look = || [0; 3].map(|_| watched.have_changed(&paths));
        assert_eq!(look(), [false; 3]);
        std::fs::write(file, "22").unwrap();
        assert_eq!(look(), [false, true, false]);
        // replaced: gone for a moment
        std::fs::remove_file(file).unwrap();
        assert_eq!(look(), [false; 3]);
        std::fs::write(file, "333").unwrap();
        assert_eq!(look(), [false, true, false]);
        std::fs::write(views.join("view_00_00.exr"), "v").unwrap();
        assert_eq!(look(), [false, true, false]);
        // other files to watch are no change
        assert!(!watched.have_changed(&paths[..1]) && !watched.have_changed(&paths[..1]));
    }
}
