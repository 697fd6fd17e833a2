//! Moves finished files from the staging folder into the output's folder.
//!
//! A new folder appears by a single rename. If the folder already has files, each new file is
//! renamed into it. Replaced files are kept until all new files are in place, so that the renames
//! can be undone after an error.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::HostError;

/// File in every output's folder that lists the output's files. The next output into this folder
/// removes the listed files that it does not write again.
const LISTING: &str = ".lumistack-files.json";
/// Folder in the staging folder, for the replaced files.
const REPLACED: &str = ".replaced";

#[derive(Serialize, Deserialize)]
struct Listing {
    schema: String,
    version: u32,
    plugin: String,
    files: Vec<String>,
}

/// A staging folder next to the output's folder, removed on drop.
pub(crate) struct Staging {
    out_dir: PathBuf,
    path: PathBuf,
    /// Parent folders that were created, outermost first.
    made: Vec<PathBuf>,
}

impl Staging {
    /// Creates the staging folder `.NAME.partial` next to `out_dir`. Removes a staging folder that
    /// a killed run has left.
    pub(crate) fn new(out_dir: &Path) -> Result<Self, HostError> {
        let not_a_folder = |path: &Path, found| Err(HostError::NotAFolder { path: path.into(), found });
        let out_dir = match fs::metadata(out_dir) {
            Ok(found) if !found.is_dir() => return not_a_folder(out_dir, "a file"),
            // `canonicalize` resolves `.` and links
            Ok(_) => fs::canonicalize(out_dir).map_err(HostError::io(out_dir, "read"))?,
            Err(_) => std::path::absolute(out_dir).map_err(HostError::io(out_dir, "read"))?,
        };
        let (Some(parent), Some(name)) = (out_dir.parent(), out_dir.file_name()) else {
            return not_a_folder(&out_dir, "the root of a file system");
        };
        let made: Vec<PathBuf> = parent.ancestors().take_while(|path| !path.exists()).map(Path::to_path_buf).collect();
        let first_there = made.last().and_then(|path| path.parent()).unwrap_or(parent);
        if !first_there.is_dir() {
            return not_a_folder(first_there, "a file");
        }
        let path = parent.join(format!(".{}.partial", name.to_string_lossy()));
        // From here on, a drop of `staging` removes the folders that are created.
        let staging = Self { path, made: made.into_iter().rev().collect(), out_dir: out_dir.clone() };
        fs::create_dir_all(parent).map_err(HostError::io(parent, "make the folder"))?;
        match fs::remove_dir_all(&staging.path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(HostError::io(&staging.path, "remove files of an interrupted run")(error));
            }
            _ => fs::create_dir(&staging.path).map_err(HostError::io(&staging.path, "make the folder"))?,
        }
        Ok(staging)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // Errors are ignored: the next output into the folder removes a staging folder that is
        // left. `remove_dir` removes only empty folders, so created folders with files stay.
        let _ = fs::remove_dir_all(&self.path);
        for folder in self.made.iter().rev() {
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Moves the staged `files` into the output's folder.
pub(crate) fn publish(staging: Staging, plugin: &str, files: &[String]) -> Result<(), HostError> {
    let out_dir = &staging.out_dir;
    let listing =
        Listing { schema: "lumistack/output-files".into(), version: 1, plugin: plugin.into(), files: files.to_vec() };
    let text = serde_json::to_vec_pretty(&listing)
        .map_err(io::Error::from)
        .map_err(HostError::io(out_dir, "list the files"))?;
    let listing_path = staging.path.join(LISTING);
    fs::write(&listing_path, text).map_err(HostError::io(&listing_path, "write"))?;

    // `remove_dir` removes only an empty folder. If the output's folder was empty or is missing, a
    // single rename suffices.
    match fs::remove_dir(out_dir) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => merge(&staging, files),
        removed => fs::rename(&staging.path, out_dir).map_err(|error| {
            if removed.is_ok() {
                let _ = fs::create_dir(out_dir);
            }
            HostError::io(out_dir, "move the output into place")(error)
        }),
    }
}

/// Moves the staged files one by one into the output's folder, which has other files. Removes files
/// of an earlier output that the new output does not write. After an error everything is undone.
fn merge(staging: &Staging, files: &[String]) -> Result<(), HostError> {
    let out_dir = &staging.out_dir;
    for file in files {
        let target = out_dir.join(file);
        if target.is_dir() {
            return Err(HostError::Io { path: target, doing: "replace", source: io::ErrorKind::IsADirectory.into() });
        }
    }
    let new: BTreeSet<&str> = files.iter().map(String::as_str).collect();
    let stale: Vec<String> = earlier_files(out_dir).into_iter().filter(|file| !new.contains(file.as_str())).collect();

    let mut moves = Moves::default();
    let replaced = staging.path.join(REPLACED);
    let mut replace = |file: &str, with_new: bool| -> Result<(), (PathBuf, io::Error)> {
        let target = out_dir.join(file);
        let at = |error| (target.clone(), error);
        if fs::symlink_metadata(&target).is_ok() {
            moves.rename(&target, &replaced.join(file)).map_err(at)?;
        }
        if with_new { moves.rename(&staging.path.join(file), &target).map_err(at) } else { Ok(()) }
    };
    // Remove stale files first. Some disks do not distinguish upper and lower case, so the name of
    // a stale file may be the name of a new file.
    let result = stale
        .iter()
        .try_for_each(|file| replace(file, false))
        .and_then(|()| files.iter().try_for_each(|file| replace(file, true)))
        .and_then(|()| replace(LISTING, true));
    if let Err((path, source)) = result {
        moves.undo();
        return Err(HostError::Io { path, doing: "replace", source });
    }
    // remove folders that the removed files leave empty
    for file in &stale {
        let parents = Path::new(file).ancestors().skip(1).take_while(|path| !path.as_os_str().is_empty());
        for parent in parents {
            let _ = fs::remove_dir(out_dir.join(parent));
        }
    }
    Ok(())
}

/// Returns the files that an earlier output has listed. Names that an output cannot write are
/// skipped, since the listing may have been changed.
fn earlier_files(out_dir: &Path) -> Vec<String> {
    let listing = fs::read(out_dir.join(LISTING)).ok().and_then(|text| serde_json::from_slice::<Listing>(&text).ok());
    let mut files = listing.map_or_else(Vec::new, |listing| listing.files);
    files.retain(|file| crate::serve::path_parts(file).is_ok());
    files
}

/// Renames that can be undone.
#[derive(Default)]
struct Moves {
    done: Vec<(PathBuf, PathBuf)>,
    made: Vec<PathBuf>,
}

impl Moves {
    fn rename(&mut self, from: &Path, to: &Path) -> io::Result<()> {
        if let Some(parent) = to.parent() {
            let new: Vec<PathBuf> = parent.ancestors().take_while(|p| !p.exists()).map(Path::to_path_buf).collect();
            self.made.extend(new.into_iter().rev());
            fs::create_dir_all(parent)?;
        }
        fs::rename(from, to)?;
        self.done.push((from.into(), to.into()));
        Ok(())
    }

    fn undo(self) {
        for (from, to) in self.done.into_iter().rev() {
            // This rename rarely fails, since the opposite rename has succeeded. If it does fail,
            // the other files are still restored.
            let _ = fs::rename(to, from);
        }
        for folder in self.made.into_iter().rev() {
            let _ = fs::remove_dir(folder);
        }
    }
}
