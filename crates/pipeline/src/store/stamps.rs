//! Stamps of results, by which the next run finds results that are current.
//!
//! A stamp has the [key](super::key) of a stage and a hash of every file that the stage wrote. The
//! stamp is written last, so a stage that was killed has no stamp. A damaged or replaced file makes
//! the stamp invalid, even if the file's size and time are unchanged.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::files::{read_json, write_json};
use super::key::content_hash;
use crate::error::PipelineError;

/// Returns a cached value, or makes it and writes it to the cache. Without a folder nothing is
/// cached.
///
/// # Errors
/// The errors of `make`, and an error if the file cannot be written.
pub(crate) fn remembered<T: Serialize + DeserializeOwned>(
    folder: Option<&Path>,
    file: &str,
    make: impl FnOnce() -> Result<T, PipelineError>,
) -> Result<T, PipelineError> {
    let Some(folder) = folder else { return make() };
    let path = folder.join(file);
    if let Some(kept) = read_json(&path) {
        return Ok(kept);
    }
    let made = make()?;
    std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
    write_json(&path, &made)?;
    Ok(made)
}

/// The stamps of a run folder.
#[derive(Clone, Debug)]
pub(crate) struct Stamps {
    run_dir: PathBuf,
}

#[derive(Serialize, Deserialize)]
struct Stamp {
    key: String,
    /// The files of the result, each with a hash of its content.
    files: Vec<(PathBuf, String)>,
}

impl Stamps {
    /// Returns the stamps of a run folder. They are in its folder `cache`.
    pub(crate) fn new(run_dir: &Path) -> Self {
        Self { run_dir: run_dir.to_owned() }
    }

    /// Returns the run folder.
    pub(crate) fn dir(&self) -> &Path {
        &self.run_dir
    }

    /// Returns the result of a stage, and true if it was cached. If the stamp has the key and its
    /// files are unchanged, `kept` reads the result. Otherwise, or if `kept` returns `None`, `make`
    /// makes the result and returns the paths of its files.
    ///
    /// # Errors
    /// The errors of `make`, and an error if the stamp cannot be written.
    pub(crate) fn reuse_or_make<T>(
        &self,
        stage: &str,
        key: &str,
        kept: impl FnOnce() -> Option<T>,
        make: impl FnOnce() -> Result<(T, Vec<PathBuf>), PipelineError>,
    ) -> Result<(T, bool), PipelineError> {
        if self.is_current(stage, key)
            && let Some(kept) = kept()
        {
            return Ok((kept, true));
        }
        self.clear(stage)?;
        let (made, files) = make()?;
        self.write(stage, key, &files)?;
        Ok((made, false))
    }

    /// Returns true if the stage has finished with some key, and its files are unchanged.
    pub(crate) fn is_whole(&self, stage: &str) -> bool {
        self.stamp(stage).is_some_and(|stamp| self.holds(&stamp))
    }

    /// Returns true if the stage has finished with this key, and its files are unchanged.
    pub(crate) fn is_current(&self, stage: &str, key: &str) -> bool {
        self.stamp(stage).is_some_and(|stamp| stamp.key == key && self.holds(&stamp))
    }

    fn stamp(&self, stage: &str) -> Option<Stamp> {
        serde_json::from_slice(&std::fs::read(self.path(stage)).ok()?).ok()
    }

    fn holds(&self, stamp: &Stamp) -> bool {
        let holds = |(file, hash): &(PathBuf, String)| content_hash(&self.run_dir.join(file)).is_ok_and(|h| h == *hash);
        stamp.files.par_iter().all(holds)
    }

    /// Records that a stage has finished. `files` are relative to the run folder.
    ///
    /// # Errors
    /// If a file is missing, or the stamp cannot be written.
    pub(crate) fn write(&self, stage: &str, key: &str, files: &[PathBuf]) -> Result<(), PipelineError> {
        let hashed = files.par_iter().map(|file| {
            let path = self.run_dir.join(file);
            let hash = content_hash(&path).map_err(|source| PipelineError::Read { path, source })?;
            Ok((file.clone(), hash))
        });
        let stamp = Stamp { key: key.into(), files: hashed.collect::<Result<_, PipelineError>>()? };
        let text = serde_json::to_vec_pretty(&stamp).expect("stamps serialize");
        let folder = self.run_dir.join("cache");
        std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
        lumistack_field_io::atomic::write_bytes(&self.path(stage), &text).map_err(PipelineError::Field)
    }

    /// Removes the stamp of a stage. This must happen before the stage's files change.
    ///
    /// # Errors
    /// If the stamp cannot be removed.
    pub(crate) fn clear(&self, stage: &str) -> Result<(), PipelineError> {
        let path = self.path(stage);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(PipelineError::Write { path, source: error })
            }
            _ => Ok(()),
        }
    }

    fn path(&self, stage: &str) -> PathBuf {
        self.run_dir.join("cache").join(format!("{stage}.json"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::code::Code;
    use super::super::key::KeyBuilder;
    use super::*;

    #[test]
    fn keys_depend_on_every_part() {
        let key = |a: &str, b: &str| KeyBuilder::new("s", &["1"]).add(a, b.as_bytes()).finish();
        assert_ne!(key("ab", "c"), key("a", "bc"));
        let of = |code: Code| KeyBuilder::new("s", code).finish();
        assert_ne!(of(&["1"]), of(&["2"]), "the code has changed");
        assert_ne!(of(&["1"]), of(&["1", "2"]));
        assert_eq!(key("a", "b"), key("a", "b"));
    }

    #[test]
    fn a_stamp_counts_while_its_files_hold_the_same() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("cache")).unwrap();
        let file = folder.path().join("a.txt");
        std::fs::write(&file, "one").unwrap();
        let stamps = Stamps::new(folder.path());
        assert!(!stamps.is_current("s", "k"));
        stamps.write("s", "k", &["a.txt".into()]).unwrap();
        assert!(stamps.is_current("s", "k") && !stamps.is_current("s", "other"));
        // Change the content, but not the size and the time.
        let written = std::fs::metadata(&file).unwrap().modified().unwrap();
        std::fs::write(&file, "two").unwrap();
        std::fs::File::options().write(true).open(&file).unwrap().set_modified(written).unwrap();
        assert!(!stamps.is_current("s", "k"), "the file has changed");
        std::fs::write(&file, "one").unwrap();
        assert!(stamps.is_current("s", "k"));
        std::fs::remove_file(&file).unwrap();
        assert!(!stamps.is_current("s", "k"));
        stamps.clear("s").unwrap();
        stamps.clear("s").unwrap();
    }
}
