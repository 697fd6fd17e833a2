//! The newest requests: the positions of the viewers, and the job with all changes by files,
//! command line and commands.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use lumistack_core::Cancel;
use lumistack_live::{Eyes, Mailbox, Tracker};
use lumistack_pipeline::{Job, PipelineError};
use serde_json::Value;

use super::clock::now;

/// A requested job.
#[derive(Clone, Debug)]
pub(super) struct Request {
    pub(super) job: Job,
    /// Number of requests to read the job's files again.
    pub(super) edition: u64,
}

/// Changes that are requested together: all of them take effect, or none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Changes {
    /// Keys of the job and their new values. The last value of a key counts.
    pub(super) keys: Vec<(String, Value)>,
    /// Positions of all viewers' heads, display space, mm; `None` if they are unchanged.
    pub(super) heads_mm: Option<Vec<[f64; 3]>>,
    /// True if the job's files are to be read again.
    pub(super) reload: bool,
    /// True if the display is to stop.
    pub(super) stop: bool,
    /// True if the end of standard input is to stop the display.
    pub(super) stop_at_end: bool,
}

/// Receives requests from any thread.
pub(super) struct Requests {
    request: Mutex<Kept>,
    /// The newest request.
    pub(super) newest: Mailbox<Request>,
    tracker: Mutex<Tracker>,
    /// The cancel flag of the running pass, whose light field is useless after a newer request.
    pass: Mutex<Option<Cancel>>,
    stopped: AtomicBool,
    /// True if the end of standard input also stops the display. So the display also ends if the
    /// program that started it crashes.
    stops_at_end: AtomicBool,
}

struct Kept {
    request: Request,
    /// Keys that commands have set; they are set again after the job file has changed.
    set: Vec<(String, Value)>,
}

impl Requests {
    pub(super) fn new(job: Job) -> Self {
        let kept = Kept { request: Request { job, edition: 0 }, set: Vec::new() };
        Self {
            request: Mutex::new(kept),
            newest: Mailbox::default(),
            tracker: Mutex::default(),
            pass: Mutex::default(),
            stopped: AtomicBool::new(false),
            stops_at_end: AtomicBool::new(false),
        }
    }

    /// Returns the current job.
    pub(super) fn job(&self) -> Job {
        lock(&self.request).request.job.clone()
    }

    /// Makes changes.
    ///
    /// # Errors
    /// If a key, a value or a position is wrong. Then nothing changes.
    pub(super) fn make(&self, changes: &Changes) -> Result<(), String> {
        // The lock is held from the checks to the changes, so that no other thread changes the job
        // between them.
        let mut kept = lock(&self.request);
        // Only keys change the job. Other changes must work while a file of the job cannot be read.
        let job = match changes.keys.as_slice() {
            [] => None,
            keys => Some(with_keys(&kept.request.job, keys).map_err(|error| error.to_string())?),
        };
        // `see` stores the positions if they are valid. It is the last check, so nothing can fail
        // after it.
        if let Some(heads_mm) = &changes.heads_mm {
            self.see(heads_mm, Eyes::Two).map_err(|error| error.to_string())?;
        }
        if let Some(job) = job {
            kept.request.job = job;
        }
        for (key, value) in &changes.keys {
            kept.set.retain(|(other, _)| other != key);
            kept.set.push((key.clone(), value.clone()));
        }
        kept.request.edition += u64::from(changes.reload);
        if changes.reload || !changes.keys.is_empty() {
            self.post(&kept);
        }
        if changes.stop_at_end {
            self.stops_at_end.store(true, Ordering::SeqCst);
        }
        if changes.stop {
            self.stop();
        }
        Ok(())
    }

    /// Replaces the job by a changed job file, and sets the keys of earlier commands again.
    pub(super) fn replace(&self, job: Job) -> Result<(), PipelineError> {
        let mut kept = lock(&self.request);
        kept.request.job = with_keys(&job, &kept.set)?;
        self.post(&kept);
        Ok(())
    }

    /// Requests that the job's files are read again.
    pub(super) fn reload(&self) {
        let mut kept = lock(&self.request);
        kept.request.edition += 1;
        self.post(&kept);
    }

    fn post(&self, kept: &Kept) {
        self.newest.post(kept.request.clone());
        self.cancel_pass();
    }

    /// Stores the positions of all viewers.
    pub(super) fn see(&self, heads_mm: &[[f64; 3]], eyes: Eyes) -> Result<(), lumistack_live::HeadError> {
        lock(&self.tracker).see(heads_mm, eyes, now())
    }

    pub(super) fn tracker(&self) -> Tracker {
        lock(&self.tracker).clone()
    }

    /// Returns the cancel flag of a new pass. The next request sets this flag.
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

    pub(super) fn end_of_input(&self) {
        if self.stops_at_end.load(Ordering::SeqCst) {
            self.stop();
        }
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::SeqCst)
    }
}

fn with_keys(job: &Job, keys: &[(String, Value)]) -> Result<Job, PipelineError> {
    job.with_all(keys.iter().map(|(key, value)| (key.as_str(), value.clone())))
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
