//! A host that keeps files and messages in memory, and can fail or cancel at a chosen append.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use lumistack_core::{Cancel, Progress, Task, Warning, Warnings};
use lumistack_plugin::PluginError;
use lumistack_plugin_host::serve::{LogLevel, Services, path_parts};

/// A host that keeps files and messages in memory.
#[derive(Debug, Default)]
pub struct MemoryHost {
    state: Mutex<State>,
    cancel: Cancel,
    /// The number of the append that fails, counted from 0 over all files.
    fail_at_append: Option<usize>,
    /// The number of the append during which the user cancels, counted from 0 over all files.
    cancel_at_append: Option<usize>,
}

#[derive(Debug, Default)]
struct State {
    committed: BTreeMap<String, Vec<u8>>,
    open: BTreeMap<u64, (String, Vec<u8>)>,
    opened: u64,
    appends: usize,
    opened_after_cancel: usize,
    messages: Vec<(LogLevel, String)>,
    stages: Vec<String>,
    depth: i64,
}

impl MemoryHost {
    /// Makes a host that never fails.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes a host whose disk is full at append number `append`, counted from 0.
    pub fn failing_at(append: usize) -> Self {
        Self { fail_at_append: Some(append), ..Self::default() }
    }

    /// Makes a host whose user cancels during append number `append`, counted from 0.
    pub fn cancelled_at(append: usize) -> Self {
        Self { cancel_at_append: Some(append), ..Self::default() }
    }

    /// Cancels the plugin's task.
    pub fn cancel(&self) {
        self.cancel.cancel();
    }

    /// Returns the bytes of the committed files, by path.
    pub fn files(&self) -> BTreeMap<String, Vec<u8>> {
        self.state().committed.clone()
    }

    /// Returns the paths of files that are neither committed nor aborted.
    pub fn open_files(&self) -> Vec<String> {
        self.state().open.values().map(|(path, _)| path.clone()).collect()
    }

    /// Returns the number of appends so far.
    pub fn appends(&self) -> usize {
        self.state().appends
    }

    /// Returns the number of files that were opened after cancellation.
    pub fn opened_after_cancel(&self) -> usize {
        self.state().opened_after_cancel
    }

    /// Returns all messages that the plugin has reported so far.
    pub fn messages(&self) -> Vec<(LogLevel, String)> {
        self.state().messages.clone()
    }

    /// Returns the names of all stages that have begun, and the number of stages that have not
    /// ended.
    pub fn stages(&self) -> (Vec<String>, i64) {
        let state = self.state();
        (state.stages.clone(), state.depth)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn not_open(file: u64) -> PluginError {
    PluginError::Refused(format!("expected the handle of an open file, found {file}"))
}

impl Progress for MemoryHost {
    fn begin(&self, stage: &str, _total: u64, _unit: &str) {
        let mut state = self.state();
        state.stages.push(stage.into());
        state.depth += 1;
    }

    fn advance(&self, _steps: u64, _note: &str) {}

    fn end(&self) {
        self.state().depth -= 1;
    }
}

impl Warnings for MemoryHost {
    fn warn(&self, warning: Warning) {
        Services::warn(self, &warning.message);
    }
}

impl Services for MemoryHost {
    fn task(&self) -> Task<'_> {
        Task { progress: self, warnings: self, cancel: &self.cancel }
    }

    fn warn(&self, message: &str) {
        self.log(LogLevel::Warn, message);
    }

    fn log(&self, level: LogLevel, message: &str) {
        self.state().messages.push((level, message.into()));
    }

    fn file_open(&self, path: &str) -> Result<u64, PluginError> {
        path_parts(path)?;
        let mut state = self.state();
        // Some disks do not distinguish upper and lower case, so no host does.
        let same = |written: &String| written.to_lowercase() == path.to_lowercase();
        if state.committed.keys().chain(state.open.values().map(|(open, _)| open)).any(same) {
            return Err(PluginError::Refused(format!(
                "file `{path}` was already written (names that differ only in case are one file)"
            )));
        }
        if self.cancel.is_cancelled() {
            state.opened_after_cancel += 1;
        }
        state.opened += 1;
        let file = state.opened;
        state.open.insert(file, (path.into(), Vec::new()));
        Ok(file)
    }

    fn file_append(&self, file: u64, bytes: &[u8]) -> Result<(), PluginError> {
        let mut state = self.state();
        let append = state.appends;
        state.appends += 1;
        if self.cancel_at_append == Some(append) {
            self.cancel.cancel();
        }
        if self.fail_at_append == Some(append) {
            return Err(PluginError::Failed("no space left on device".into()));
        }
        state.open.get_mut(&file).ok_or_else(|| not_open(file))?.1.extend_from_slice(bytes);
        Ok(())
    }

    fn file_commit(&self, file: u64) -> Result<(), PluginError> {
        let mut state = self.state();
        let (path, bytes) = state.open.remove(&file).ok_or_else(|| not_open(file))?;
        state.committed.insert(path, bytes);
        Ok(())
    }

    fn file_abort(&self, file: u64) -> Result<(), PluginError> {
        self.state().open.remove(&file).map(drop).ok_or_else(|| not_open(file))
    }
}
