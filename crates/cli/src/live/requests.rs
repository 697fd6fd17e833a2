//! Where wishes meet: the job as files, command line and commands leave it, and the viewers.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use lumistack_core::{Cancel, Warning, Warnings};
use lumistack_live::{Mailbox, Tracker};
use lumistack_pipeline::{Job, PipelineError};
use serde_json::Value;

use super::clock::now;

/// A job to show.
#[derive(Clone, Debug)]
pub(super) struct Wish {
    pub(super) job: Job,
    /// Raised when files have changed.
    pub(super) edition: u64,
}

/// Takes wishes from any thread.
pub(super) struct Desk {
    wish: Mutex<Kept>,
    /// The newest wish.
    pub(super) wishes: Mailbox<Wish>,
    tracker: Mutex<Tracker>,
    /// Of the work that a new wish makes needless.
    pass: Mutex<Option<Cancel>>,
    stopped: AtomicBool,
}

struct Kept {
    wish: Wish,
    /// Keys that were set by commands; they outlive a job file that is written anew.
    set: Vec<(String, Value)>,
}

impl Desk {
    pub(super) fn new(job: Job) -> Self {
        let kept = Kept { wish: Wish { job, edition: 0 }, set: Vec::new() };
        Self {
            wish: Mutex::new(kept),
            wishes: Mailbox::default(),
            tracker: Mutex::default(),
            pass: Mutex::default(),
            stopped: AtomicBool::new(false),
        }
    }

    /// The job as it stands.
    pub(super) fn job(&self) -> Job {
        lock(&self.wish).wish.job.clone()
    }

    /// Sets keys of the job: all of them, or after an error none.
    pub(super) fn set(&self, keys: &[(String, Value)]) -> Result<(), PipelineError> {
        let mut kept = lock(&self.wish);
        kept.wish.job = with_keys(kept.wish.job.clone(), keys)?;
        for (key, value) in keys {
            kept.set.retain(|(other, _)| other != key);
            kept.set.push((key.clone(), value.clone()));
        }
        self.post(&kept);
        Ok(())
    }

    /// Takes a job file that was written anew, with the keys that commands have set.
    pub(super) fn replace(&self, job: Job) -> Result<(), PipelineError> {
        let mut kept = lock(&self.wish);
        kept.wish.job = with_keys(job, &kept.set)?;
        self.post(&kept);
        Ok(())
    }

    /// Has files read anew.
    pub(super) fn reload(&self) {
        let mut kept = lock(&self.wish);
        kept.wish.edition += 1;
        self.post(&kept);
    }

    fn post(&self, kept: &Kept) {
        self.wishes.post(kept.wish.clone());
        self.cancel_pass();
    }

    /// Takes positions of viewers.
    pub(super) fn see(&self, heads_mm: &[[f64; 3]]) -> Result<(), lumistack_live::HeadError> {
        lock(&self.tracker).see(heads_mm, now())
    }

    pub(super) fn tracker(&self) -> Tracker {
        lock(&self.tracker).clone()
    }

    /// A flag for work that the next wish makes needless.
    pub(super) fn pass(&self) -> Cancel {
        let cancel = Cancel::default();
        *lock(&self.pass) = Some(cancel.clone());
        cancel
    }

    pub(super) fn cancel_pass(&self) {
        if let Some(cancel) = &*lock(&self.pass) {
            cancel.cancel();
        }
    }

    pub(super) fn stop(&self) {
        self.stopped.store(true, Ordering::SeqCst);
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::SeqCst)
    }
}

fn with_keys(job: Job, keys: &[(String, Value)]) -> Result<Job, PipelineError> {
    keys.iter().try_fold(job, |job, (key, value)| job.with(key, value.clone()))
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Passes each warning on once: a scene is rendered again and again.
pub(super) struct Once<'a> {
    to: &'a dyn Warnings,
    told: Mutex<HashSet<String>>,
}

/// Warnings that are remembered, at most.
const MOST_TOLD: usize = 1000;

impl<'a> Once<'a> {
    pub(super) fn new(to: &'a dyn Warnings) -> Self {
        Self { to, told: Mutex::default() }
    }
}

impl Warnings for Once<'_> {
    fn warn(&self, warning: Warning) {
        let mut told = lock(&self.told);
        if told.len() >= MOST_TOLD {
            told.clear();
        }
        if told.insert(warning.to_string()) {
            drop(told);
            self.to.warn(warning);
        }
    }
}
