//! The host of an output plugin. It writes the plugin's files to the staging folder, and passes
//! warnings and progress to the task. The task's cancellation stops the plugin.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::serve::{Services, path_parts};
use lumistack_core::Task;
use lumistack_plugin::PluginError;

/// A host that writes files to a folder.
pub(crate) struct DiskHost<'a> {
    folder: PathBuf,
    plugin: &'a str,
    task: Task<'a>,
    files: Mutex<Files>,
}

#[derive(Default)]
struct Files {
    opened: u64,
    open: BTreeMap<u64, OpenFile>,
    committed: BTreeSet<String>,
    /// Names of files that could not be committed.
    failed: BTreeSet<String>,
    /// Names of all open and committed files in lower case, since `A.png` and `a.png` are one file
    /// on some file systems.
    taken: BTreeSet<String>,
}

struct OpenFile {
    name: String,
    /// Temporary path in the staging folder, until the file is committed. The temporary name starts
    /// with a dot; the names of plugins' files must not.
    path: PathBuf,
    writer: BufWriter<File>,
}

impl<'a> DiskHost<'a> {
    pub(crate) fn new(folder: &Path, plugin: &'a str, task: Task<'a>) -> Self {
        Self { folder: folder.into(), plugin, task, files: Mutex::default() }
    }

    /// Returns the names of the committed files, sorted.
    ///
    /// # Errors
    /// The names of the files that are still open or could not be committed, if there are any.
    pub(crate) fn into_files(self) -> Result<Vec<String>, Vec<String>> {
        let files = self.files.into_inner().unwrap_or_else(PoisonError::into_inner);
        let incomplete: Vec<String> = files.open.into_values().map(|file| file.name).chain(files.failed).collect();
        if incomplete.is_empty() { Ok(files.committed.into_iter().collect()) } else { Err(incomplete) }
    }

    /// Writes the rest of a file, and moves the file to its final name.
    fn complete(&self, file: OpenFile) -> Result<(), PluginError> {
        let OpenFile { name, path, writer } = file;
        // The file is synced before the rename, so that no partial file ever has its final name.
        let written = writer.into_inner().map_err(io::IntoInnerError::into_error).and_then(|file| file.sync_all());
        written.map_err(cannot("write", &name))?;
        let target = path_parts(&name)?.iter().fold(self.folder.clone(), |path, part| path.join(part));
        if let Some(parent) = target.parent() {
            fs::create_dir_all(parent).map_err(cannot("make the folder of", &name))?;
        }
        fs::rename(&path, &target).map_err(cannot("write", &name))
    }

    fn files(&self) -> MutexGuard<'_, Files> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn not_open(file: u64) -> PluginError {
    PluginError::Refused(format!("expected the handle of an open file, found {file}"))
}

fn cannot(doing: &str, name: &str) -> impl FnOnce(io::Error) -> PluginError {
    move |error| PluginError::Failed(format!("cannot {doing} `{name}`: {error}"))
}

impl Services for DiskHost<'_> {
    fn task(&self) -> Task<'_> {
        self.task
    }

    fn warn(&self, message: &str) {
        self.task.warn(format!("output `{}`", self.plugin), message);
    }

    fn file_open(&self, path: &str) -> Result<u64, PluginError> {
        // This check stops plugins that never check for cancellation.
        self.task.cancel.check()?;
        path_parts(path)?;
        let mut files = self.files();
        if files.taken.contains(&path.to_lowercase()) {
            return Err(PluginError::Refused(format!(
                "file `{path}` was already written (names that differ only in case are one file)"
            )));
        }
        let file = files.opened;
        files.opened += 1;
        let temporary = self.folder.join(format!(".open-{file}"));
        let writer = BufWriter::new(File::create_new(&temporary).map_err(cannot("create", path))?);
        files.taken.insert(path.to_lowercase());
        files.open.insert(file, OpenFile { name: path.into(), path: temporary, writer });
        Ok(file)
    }

    fn file_append(&self, file: u64, bytes: &[u8]) -> Result<(), PluginError> {
        self.task.cancel.check()?;
        let mut files = self.files();
        let open = files.open.get_mut(&file).ok_or_else(|| not_open(file))?;
        open.writer.write_all(bytes).map_err(cannot("write", &open.name))
    }

    fn file_commit(&self, file: u64) -> Result<(), PluginError> {
        let open = self.files().open.remove(&file).ok_or_else(|| not_open(file))?;
        let (name, path) = (open.name.clone(), open.path.clone());
        let result = self.complete(open);
        let mut files = self.files();
        if result.is_ok() {
            files.failed.remove(&name);
            files.committed.insert(name);
        } else {
            // The plugin may ignore the error. Then it may write the file again, or finish.
            let _ = fs::remove_file(&path);
            files.taken.remove(&name.to_lowercase());
            files.failed.insert(name);
        }
        result
    }

    fn file_abort(&self, file: u64) -> Result<(), PluginError> {
        let mut files = self.files();
        let OpenFile { name, path, writer } = files.open.remove(&file).ok_or_else(|| not_open(file))?;
        files.taken.remove(&name.to_lowercase());
        // `into_parts` returns the buffered bytes without writing them.
        drop(writer.into_parts());
        fs::remove_file(&path).map_err(cannot("remove", &name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::{Cancel, Collector};

    #[test]
    fn a_file_that_failed_can_be_written_again() {
        let (folder, warnings, cancel) = (tempfile::tempdir().unwrap(), Collector::default(), Cancel::default());
        let staging = folder.path().join("staging");
        let host = DiskHost::new(&staging, "a", Task::quiet(&warnings, &cancel));
        // The creation fails without the folder, and the commit if a folder has the file's name.
        let created = host.file_open("a.txt");
        assert!(matches!(&created, Err(PluginError::Failed(text)) if text.starts_with("cannot create")), "{created:?}");
        fs::create_dir_all(staging.join("a.txt")).unwrap();
        let file = host.file_open("a.txt").unwrap();
        host.file_commit(file).unwrap_err();
        fs::remove_dir(staging.join("a.txt")).unwrap();
        let file = host.file_open("a.txt").unwrap();
        host.file_commit(file).unwrap();
        assert_eq!(host.into_files().unwrap(), ["a.txt"]);
        assert_eq!(fs::read_dir(&staging).unwrap().count(), 1);
    }
}
