//! What makes a rerun cheap: stamps beside the results of stages.
//!
//! A stamp holds the [key](super::key) of a stage. It is written last, so that a stage that was killed midway has none, and holds a hash of every file that the stage wrote: one that was
//! damaged or replaced since is no result, whatever its size and time.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::files::{read_json, write_json};
use super::key::content_hash;
use crate::error::PipelineError;

/// What a file of the cache holds, or what `make` gives, which is then kept there. Without a folder nothing is kept.
///
/// # Errors
/// Those of `make`, and when the file cannot be written.
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
    /// Each with a hash of its content.
    files: Vec<(PathBuf, String)>,
}

impl Stamps {
    /// Stamps of a run folder, kept in `cache/`.
    pub(crate) fn new(run_dir: &Path) -> Self {
        Self { run_dir: run_dir.to_owned() }
    }

    /// Whether the stage finished with this key and all its files still have the content that they had.
    pub(crate) fn is_current(&self, stage: &str, key: &str) -> bool {
        let Ok(text) = std::fs::read(self.path(stage)) else { return false };
        let Ok(stamp) = serde_json::from_slice::<Stamp>(&text) else { return false };
        let holds = |(file, hash): &(PathBuf, String)| content_hash(&self.run_dir.join(file)).is_ok_and(|h| h == *hash);
        stamp.key == key && stamp.files.par_iter().all(holds)
    }

    /// Records that the stage has finished; `files` are relative to the run folder.
    ///
    /// # Errors
    /// When a file is missing or the stamp cannot be written.
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

    /// Forgets a stage, before its files change.
    ///
    /// # Errors
    /// When the stamp cannot be removed.
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
        // of equal size, and with the time that it had
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
