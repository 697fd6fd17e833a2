//! The lock of a run folder: one owner at a time.
//!
//! ```text
//! cache/lumistack.lock     locked by the operating system while a run works here, so that a dead owner holds nothing; also what marks a folder as ours
//! cache/owner.json         process and host of the owner, for messages alone
//! ```

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::Duration;

use lumistack_core::Task;
use serde::{Deserialize, Serialize};

use super::files::write;
use super::names::LOCK;
use crate::error::{PipelineError, field_error};

/// Below `cache`: whom the lock belongs to.
pub(crate) const OWNER: &str = "owner.json";
/// Of a preview that is made into a run's folder, beside a run that may be at work.
const PREVIEW_LOCK: &str = "preview.lock";
/// How often the owner's name is looked for: it is written a moment after the lock is taken.
const LOOKS: u32 = 25;

/// A run folder that belongs to this process until it is dropped.
#[derive(Debug)]
pub(crate) struct Owned {
    lock: Option<File>,
    cache: PathBuf,
    file: &'static str,
    /// Folders that were not there before, outermost first.
    made: Vec<PathBuf>,
}

#[derive(Serialize, Deserialize)]
struct Owner {
    process: u32,
    host: String,
}

/// Takes a folder that is known to be a run's.
pub(crate) fn take_known(dir: &Path, task: Task<'_>) -> Result<Owned, PipelineError> {
    Owned::lock(dir, LOCK, task)
}

/// Takes the place of a run's preview, which does not disturb the run.
pub(crate) fn take_preview(dir: &Path, task: Task<'_>) -> Result<Owned, PipelineError> {
    Owned::lock(dir, PREVIEW_LOCK, task)
}

impl Owned {
    fn lock(dir: &Path, file: &'static str, task: Task<'_>) -> Result<Self, PipelineError> {
        let cache = dir.join("cache");
        let made: Vec<PathBuf> = cache.ancestors().take_while(|path| !path.exists()).map(Path::to_path_buf).collect();
        let mut owned = Self { lock: None, cache: cache.clone(), file, made: made.into_iter().rev().collect() };
        let path = cache.join(file);
        loop {
            lumistack_field_io::atomic::create_folder(&cache).map_err(field_error)?;
            let lock = File::options().read(true).write(true).create(true).truncate(false).open(&path);
            let lock = lock.map_err(PipelineError::write(&path))?;
            match lock.try_lock() {
                Ok(()) if is_at(&lock, &path) => owned.lock = Some(lock),
                // the one before removed it with its folder
                Ok(()) => continue,
                Err(TryLockError::WouldBlock) => {
                    return Err(PipelineError::InUse { folder: dir.to_owned(), owner: owned.other() });
                }
                Err(TryLockError::Error(error)) => {
                    let text =
                        format!("this file system has no locks ({error}): make sure that only one run works here");
                    task.warn(dir.display().to_string(), text);
                }
            }
            break;
        }
        if file == LOCK {
            let host = gethostname::gethostname().to_string_lossy().into_owned();
            let owner = Owner { process: std::process::id(), host };
            let owner = serde_json::to_vec(&owner).expect("a number and a text serialize");
            write(&cache.join(OWNER), &owner)?;
        }
        Ok(owned)
    }

    /// Whom the lock belongs to, for people.
    fn other(&self) -> String {
        if self.file != LOCK {
            return "another preview".into();
        }
        let read = || -> Option<Owner> { serde_json::from_slice(&std::fs::read(self.cache.join(OWNER)).ok()?).ok() };
        let owner = (0..LOOKS).find_map(|look| {
            if look > 0 {
                std::thread::sleep(Duration::from_millis(20));
            }
            read()
        });
        owner.map_or("another process".into(), |Owner { process, host }| format!("process {process} on {host}"))
    }
}

impl Drop for Owned {
    fn drop(&mut self) {
        // somebody else's, or of a file system without locks
        if self.lock.is_none() {
            return;
        }
        if self.file == LOCK {
            let _ = std::fs::remove_file(self.cache.join(OWNER));
        }
        // a run that failed before it kept anything leaves nothing; on other systems an open file cannot be removed
        if cfg!(unix) && !self.made.is_empty() {
            let others = std::fs::read_dir(&self.cache)
                .map_or(1, |list| list.flatten().filter(|e| e.file_name() != self.file).count());
            // times and nodes that are finished stay, and so does the mark that they are ours
            let beside = self.cache.parent().and_then(|dir| std::fs::read_dir(dir).ok());
            let is_alone = beside.is_some_and(|list| list.flatten().all(|e| e.path() == self.cache));
            if others == 0 && is_alone {
                let _ = std::fs::remove_file(self.cache.join(self.file));
                for folder in self.made.iter().rev() {
                    let _ = std::fs::remove_dir(folder);
                }
            }
        }
    }
}

/// Whether an open file is still the one of this name.
fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let of = |data: std::fs::Metadata| (data.dev(), data.ino());
        file.metadata().ok().map(of) == std::fs::metadata(path).ok().map(of)
    }
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}
