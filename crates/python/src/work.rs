//! Long work in another thread, without Python's lock.
//!
//! The calling thread wakes every [`POLL`]. It checks for signals (Python delivers Ctrl-C only to
//! its main thread), calls the callback with the progress, and issues warnings. An exception in the
//! calling thread cancels the work, and is raised after the work has stopped. Such an exception is
//! a `KeyboardInterrupt`, an exception of the callback, or a warning that Python's filters turn
//! into an error.

use std::any::Any;
use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use lumistack_core::{Cancel, Progress, Task, Warning, Warnings};
use lumistack_pipeline::PipelineError;
use pyo3::prelude::*;

use crate::error::{exception, in_python, raised};
use crate::own::in_package;

/// Interval of the calling thread's checks.
const POLL: Duration = Duration::from_millis(30);

/// Runs `work` and returns its result. `callback(stage, fraction)` receives the progress; without a
/// callback a terminal or a notebook shows it.
pub(crate) fn long<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Task<'_>) -> Result<T, PipelineError> + Send,
) -> PyResult<T> {
    if callback.is_some() {
        return watched(py, callback, work);
    }
    let shown = in_package(py, "_progress", "shown", (), None)?;
    if shown.is_none() {
        return watched(py, None, work);
    }
    let result = watched(py, Some(&shown), work);
    shown.call_method0("close")?;
    result
}

fn watched<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Task<'_>) -> Result<T, PipelineError> + Send,
) -> PyResult<T> {
    let cancel = Cancel::default();
    let sink = Sink::default();
    let task = Task { progress: &sink, warnings: &sink, cancel: &cancel };
    let (result, problem) = beside(
        py,
        &sink,
        || work(task),
        || {
            let result = py.check_signals().and_then(|()| sink.report(py, callback));
            result.inspect_err(|_| cancel.cancel())
        },
    );
    match (problem, result) {
        (Some(problem), _) => Err(problem),
        (None, Ok(Ok(value))) => Ok(value),
        (None, Ok(Err(error))) => Err(raised(py, &error)),
        (None, Err(panic)) => Err(panicked(py, &*panic)),
    }
}

/// Runs a command line as the program `lumistack` does: the first Ctrl-C stops the command cleanly,
/// the second ends the process immediately.
pub(crate) fn command(py: Python<'_>, words: &[OsString]) -> PyResult<u8> {
    let cancel = Cancel::default();
    let (result, _) = beside(
        py,
        &Sink::default(),
        || lumistack_cli::run(words, &cancel),
        || {
            if py.check_signals().is_err() {
                if cancel.is_cancelled() {
                    std::process::exit(130);
                }
                cancel.cancel();
            }
            Ok(())
        },
    );
    result.map_err(|panic| panicked(py, &*panic))
}

/// Runs `work` in another thread. Meanwhile calls `poll` repeatedly in this thread, until the
/// work is done or `poll` has returned an error.
fn beside<T: Send>(
    py: Python<'_>,
    sink: &Sink,
    work: impl FnOnce() -> T + Send,
    mut poll: impl FnMut() -> PyResult<()>,
) -> (std::thread::Result<T>, Option<PyErr>) {
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let result = catch_unwind(AssertUnwindSafe(work));
            sink.finish();
            result
        });
        let mut problem = None;
        loop {
            let finished = py.detach(|| sink.wait());
            if problem.is_none() {
                problem = poll().err();
            }
            if finished {
                break;
            }
        }
        let result = py.detach(|| worker.join());
        (result.and_then(|result| result), problem)
    })
}

fn panicked(py: Python<'_>, panic: &(dyn Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_string());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into());
    exception(py, "InternalError", &format!("internal error, a bug in Lumistack: {text}; please report this message"))
}

/// Progress and warnings of the work since the last check by the calling thread.
#[derive(Default)]
struct Sink {
    state: Mutex<State>,
    wake: Condvar,
}

#[derive(Default)]
struct State {
    stage: String,
    total: u64,
    done: u64,
    /// Stages and fractions for the callback: the newest fraction of the current stage, and the end
    /// of each finished stage.
    news: Vec<(String, f64)>,
    warnings: Vec<Warning>,
    seen: Vec<Warning>,
    finished: bool,
}

impl State {
    fn note(&mut self) {
        let share = if self.total == 0 { 1.0 } else { (self.done as f64 / self.total as f64).min(1.0) };
        match self.news.last_mut() {
            Some((stage, last)) if *stage == self.stage && *last < 1.0 => *last = share,
            _ => self.news.push((self.stage.clone(), share)),
        }
    }
}

impl Sink {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits at most [`POLL`] for the end of the work; returns true if it has ended.
    fn wait(&self) -> bool {
        let state = self.lock();
        let waited = self.wake.wait_timeout_while(state, POLL, |state| !state.finished);
        waited.unwrap_or_else(PoisonError::into_inner).0.finished
    }

    fn finish(&self) {
        self.lock().finished = true;
        self.wake.notify_all();
    }

    /// Reports progress and warnings to Python.
    fn report(&self, py: Python<'_>, callback: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let (news, warnings) = {
            let mut state = self.lock();
            (std::mem::take(&mut state.news), std::mem::take(&mut state.warnings))
        };
        if !warnings.is_empty() {
            let warn = py.import("warnings")?.getattr("warn")?;
            let category = py.import("lumistack._errors")?.getattr("LumistackWarning")?;
            for warning in warnings {
                warn.call1((in_python(&warning.to_string()), &category))?;
            }
        }
        if let Some(callback) = callback {
            for (stage, share) in news {
                callback.call1((stage, share))?;
            }
        }
        Ok(())
    }
}

impl Progress for Sink {
    fn begin(&self, stage: &str, total: u64, _unit: &str) {
        let mut state = self.lock();
        (state.stage, state.total, state.done) = (stage.into(), total, 0);
        if total > 0 {
            state.note();
        }
    }

    fn advance(&self, steps: u64, _note: &str) {
        let mut state = self.lock();
        state.done += steps;
        state.note();
    }

    fn end(&self) {
        let mut state = self.lock();
        if state.done < state.total || state.total == 0 {
            state.done = state.total;
            state.note();
        }
    }
}

impl Warnings for Sink {
    fn warn(&self, warning: Warning) {
        let mut state = self.lock();
        if !state.seen.contains(&warning) {
            state.seen.push(warning.clone());
            state.warnings.push(warning);
        }
    }
}
