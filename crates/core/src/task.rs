//! The handle that long work takes: where to report progress and warnings, and when to stop.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use thiserror::Error;

/// Receives progress of named stages. Calls may come from any thread.
pub trait Progress: Sync {
    /// Reports that a stage starts. `total` is the number of the stage's steps, of the kind `unit`
    /// ("views", "iterations").
    fn begin(&self, stage: &str, total: u64, unit: &str);
    /// Reports that further `steps` of the stage are done. `note` is a short text beside the
    /// progress bar, or empty.
    fn advance(&self, steps: u64, note: &str);
    /// Reports that the stage has ended.
    fn end(&self);
}

/// Ignores all progress.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn begin(&self, _stage: &str, _total: u64, _unit: &str) {}
    fn advance(&self, _steps: u64, _note: &str) {}
    fn end(&self) {}
}

/// A flag by which a caller stops running work. Clones share the flag.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Requests a stop of all work that holds this flag or a clone of it.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Returns true if a stop was requested.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Fails if a stop was requested; for use with `?` inside loops.
    ///
    /// # Errors
    /// [`Cancelled`] if a stop was requested.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}

/// The work was stopped from outside; nothing is wrong with the input.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("cancelled")]
pub struct Cancelled;

/// Something that the user should know and that does not stop the work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// The place of the problem: a file, a JSON path, a stage.
    pub place: String,
    /// The problem, and how it is handled.
    pub message: String,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

/// Receives warnings. Calls may come from any thread.
pub trait Warnings: Sync {
    /// Takes one warning.
    fn warn(&self, warning: Warning);
}

/// Keeps warnings in a list; equal ones are kept once.
#[derive(Debug, Default)]
pub struct Collector(Mutex<Vec<Warning>>);

impl Collector {
    /// Returns the warnings so far and empties the list.
    pub fn take(&self) -> Vec<Warning> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }
}

impl Warnings for Collector {
    fn warn(&self, warning: Warning) {
        let mut list = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if !list.contains(&warning) {
            list.push(warning);
        }
    }
}

/// Context of long work: progress, warnings, cancellation.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// Receives the progress of the work.
    pub progress: &'a dyn Progress,
    /// Receives the warnings of the work.
    pub warnings: &'a dyn Warnings,
    /// Flag by which a caller stops the work.
    pub cancel: &'a Cancel,
}

impl<'a> Task<'a> {
    /// Returns a task without progress display, for tests and short work.
    pub fn quiet(warnings: &'a Collector, cancel: &'a Cancel) -> Self {
        Self { progress: &NoProgress, warnings, cancel }
    }

    /// Reports a warning.
    pub fn warn(&self, place: impl Into<String>, message: impl Into<String>) {
        self.warnings.warn(Warning { place: place.into(), message: message.into() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_warning_is_kept_once() {
        let (collector, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&collector, &cancel);
        task.warn("a.gltf", "odd");
        task.warn("a.gltf", "odd");
        assert_eq!(collector.take().len(), 1);
        assert!(cancel.check().is_ok());
        cancel.clone().cancel();
        assert_eq!(cancel.check(), Err(Cancelled));
    }
}
