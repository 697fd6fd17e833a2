//! The lock of a run folder: one owner at a time.
//!
//! ```text
//! cache/lumistack.lock     locked by the operating system while a run works here, so that a dead owner holds nothing; also what marks a folder as ours
//! cache/owner.json         process and host of the owner, for messages alone
//! ```
//!
//! Units of work on several machines hold a folder together: each publishes files that no other writes, and a run of the whole waits until they have ended.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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

/// How often a unit of work looks whether a folder is free.
const UNIT_LOOKS: Duration = Duration::from_millis(100);

/// How long a unit of work waits for a folder.
pub(crate) const UNIT_LIMIT: Duration = Duration::from_secs(600);

/// How a unit of work holds a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hold {
    /// Beside other units.
    Shared,
    /// Alone.
    Alone,
}

/// A run folder that belongs to this process until it is dropped.
#[derive(Debug)]
pub(crate) struct Owned {
    lock: Option<File>,
    cache: PathBuf,
    file: &'static str,
    hold: Hold,
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

/// Takes a folder for a unit of work. Waits for others up to a limit: work may be done twice where a machine seemed to be gone.
///
/// # Errors
/// When others hold the folder for longer, or when cancelled.
pub(crate) fn take_for_unit(dir: &Path, hold: Hold, limit: Duration, task: Task<'_>) -> Result<Owned, PipelineError> {
    let start = Instant::now();
    loop {
        match Owned::lock_as(dir, LOCK, hold, task) {
            Err(PipelineError::InUse { .. }) if start.elapsed() < limit => {
                task.cancel.check()?;
                std::thread::sleep(UNIT_LOOKS);
            }
            taken => return taken,
        }
    }
}

/// Takes the place of a run's preview, which does not disturb the run.
pub(crate) fn take_preview(dir: &Path, task: Task<'_>) -> Result<Owned, PipelineError> {
    Owned::lock(dir, PREVIEW_LOCK, task)
}

impl Owned {
    fn lock(dir: &Path, file: &'static str, task: Task<'_>) -> Result<Self, PipelineError> {
        Self::lock_as(dir, file, Hold::Alone, task)
    }

    fn lock_as(dir: &Path, file: &'static str, hold: Hold, task: Task<'_>) -> Result<Self, PipelineError> {
        let cache = dir.join("cache");
        let made: Vec<PathBuf> = cache.ancestors().take_while(|path| !path.exists()).map(Path::to_path_buf).collect();
        // what several made together is no one's to remove
        let made = if hold == Hold::Shared { Vec::new() } else { made.into_iter().rev().collect() };
        let mut owned = Self { lock: None, cache: cache.clone(), file, hold, made };
        let path = cache.join(file);
        loop {
            lumistack_field_io::atomic::create_folder(&cache).map_err(field_error)?;
            let lock = File::options().read(true).write(true).create(true).truncate(false).open(&path);
            let lock = lock.map_err(PipelineError::write(&path))?;
            let taken = if hold == Hold::Shared { lock.try_lock_shared() } else { lock.try_lock() };
            match taken {
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
        if file == LOCK && hold == Hold::Alone {
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
        if self.lock.is_none() || self.hold == Hold::Shared {
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
