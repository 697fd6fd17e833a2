//! The lock of a run folder: one owner at a time.
//!
//! ```text
//! cache/lumistack.lock     locked during a run by the operating system, which unlocks the file if
//!                          the owner dies; a folder with this file is from Lumistack
//! cache/owner.json         process and host of the owner, for messages
//! ```
//!
//! Units of work on several machines share the lock of the run folder, since no two of them write
//! the same file. The last unit waits until all other units have ended. `lumistack run` does not
//! wait; it reports that the folder is in use.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lumistack_core::Task;
use serde::{Deserialize, Serialize};

use super::files::write;
use super::names::LOCK;
use crate::error::{PipelineError, field_error};

/// File with the owner's process and host, in the folder `cache`.
pub(crate) const OWNER: &str = "owner.json";
/// Lock of a preview. A preview may be written while a run uses the folder.
const PREVIEW_LOCK: &str = "preview.lock";
/// Number of attempts to read the owner's file, which is written shortly after the lock is taken.
const OWNER_ATTEMPTS: u32 = 25;

/// Interval between a unit's attempts to lock a folder.
const LOCK_INTERVAL: Duration = Duration::from_millis(100);

/// Maximum time that a unit waits for a folder.
pub(crate) const UNIT_LIMIT: Duration = Duration::from_secs(600);

/// How a unit of work locks a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hold {
    /// The lock is shared with other units.
    Shared,
    /// The lock is not shared.
    Alone,
}

/// The lock of a run folder. It is held until this value is dropped.
#[derive(Debug)]
pub(crate) struct FolderLock {
    lock: Option<File>,
    cache: PathBuf,
    file: &'static str,
    hold: Hold,
    /// Folders that the lock created, outermost first.
    made: Vec<PathBuf>,
}

#[derive(Serialize, Deserialize)]
struct Owner {
    process: u32,
    host: String,
}

/// Locks a folder that is known to be a run folder.
pub(crate) fn lock_known(dir: &Path, task: Task<'_>) -> Result<FolderLock, PipelineError> {
    FolderLock::lock(dir, LOCK, task)
}

/// Locks a folder for a unit of work. Waits up to a limit, since a machine that is regarded as lost
/// may still work.
///
/// # Errors
/// If other processes hold the lock for longer than the limit, or the task is cancelled.
pub(crate) fn lock_for_unit(
    dir: &Path,
    hold: Hold,
    limit: Duration,
    task: Task<'_>,
) -> Result<FolderLock, PipelineError> {
    let start = Instant::now();
    loop {
        match FolderLock::lock_as(dir, LOCK, hold, task) {
            Err(PipelineError::InUse { .. }) if start.elapsed() < limit => {
                task.cancel.check()?;
                std::thread::sleep(LOCK_INTERVAL);
            }
            taken => return taken,
        }
    }
}

/// Locks the preview of a run, which does not affect the lock of the run.
pub(crate) fn lock_preview(dir: &Path, task: Task<'_>) -> Result<FolderLock, PipelineError> {
    FolderLock::lock(dir, PREVIEW_LOCK, task)
}

impl FolderLock {
    fn lock(dir: &Path, file: &'static str, task: Task<'_>) -> Result<Self, PipelineError> {
        Self::lock_as(dir, file, Hold::Alone, task)
    }

    fn lock_as(dir: &Path, file: &'static str, hold: Hold, task: Task<'_>) -> Result<Self, PipelineError> {
        let cache = dir.join("cache");
        let made: Vec<PathBuf> = cache.ancestors().take_while(|path| !path.exists()).map(Path::to_path_buf).collect();
        // When the lock is dropped, it may remove the folders in `made`. So leave out folders that
        // several processes share.
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
                // The last owner removed the file and its folder, so create both again.
                Ok(()) => continue,
                Err(TryLockError::WouldBlock) => {
                    return Err(PipelineError::InUse { folder: dir.to_owned(), owner: owned.other() });
                }
                Err(TryLockError::Error(error)) => {
                    let text = format!(
                        "the file system of this folder has no locks ({error}); run only one process in this folder"
                    );
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

    /// Describes the owner of the lock, for messages.
    fn other(&self) -> String {
        if self.file != LOCK {
            return "another `lumistack preview`".into();
        }
        let read = || -> Option<Owner> { serde_json::from_slice(&std::fs::read(self.cache.join(OWNER)).ok()?).ok() };
        let owner = (0..OWNER_ATTEMPTS).find_map(|attempt| {
            if attempt > 0 {
                std::thread::sleep(Duration::from_millis(20));
            }
            read()
        });
        owner.map_or("another process".into(), |Owner { process, host }| format!("process {process} on {host}"))
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // Keep all files if another process holds the lock, units share the lock, or the file
        // system has no locks.
        if self.lock.is_none() || self.hold == Hold::Shared {
            return;
        }
        if self.file == LOCK {
            let _ = std::fs::remove_file(self.cache.join(OWNER));
        }
        // If a run fails before it keeps a file, its folder is removed.
        if !self.made.is_empty() {
            let others = std::fs::read_dir(&self.cache)
                .map_or(1, |list| list.flatten().filter(|e| e.file_name() != self.file).count());
            // If finished time steps or nodes stay, the lock file stays too, since it marks the
            // folder as a folder of Lumistack.
            let beside = self.cache.parent().and_then(|dir| std::fs::read_dir(dir).ok());
            let is_alone = beside.is_some_and(|list| list.flatten().all(|e| e.path() == self.cache));
            if others == 0 && is_alone {
                let _ = std::fs::remove_file(self.cache.join(self.file));
                // on some versions of Windows the file keeps its name while it is open
                self.lock = None;
                for folder in self.made.iter().rev() {
                    let _ = std::fs::remove_dir(folder);
                }
            }
        }
    }
}

/// Returns true if this path still names the open file.
fn is_at(file: &File, path: &Path) -> bool {
    let own = file.try_clone().and_then(same_file::Handle::from_file);
    own.and_then(|own| Ok(own == same_file::Handle::from_path(path)?)).unwrap_or(false)
}
