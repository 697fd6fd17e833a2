//! The services of a host as a trait, and the C table of functions that call them.

use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

use lumistack_core::Task;
use lumistack_plugin::abi::{Bytes, Data, ErrorSink, HostServices, Plane, Status, Str, View, level};
use lumistack_plugin::wire::{answer, lent_bytes, lent_lossy, lent_text};
use lumistack_plugin::{PluginError, Port};
use serde_json::Value;

use crate::serve::lend;

/// Severity of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogLevel {
    /// An operation failed, and the plugin continues without its result.
    Error,
    /// A warning for the user.
    Warn,
    /// Information for the user.
    Info,
    /// Information for the plugin's developer.
    Debug,
}

/// Services of a host for its plugins. Plugins call them from any thread.
pub trait Services: Sync {
    /// Returns the task of the plugin. The task receives the plugin's progress, and the task's
    /// cancel flag stops the plugin.
    fn task(&self) -> Task<'_>;
    /// Receives a warning for the user.
    fn warn(&self, message: &str);
    /// Receives a message. By default errors and warnings are passed to [`warn`](Self::warn), and
    /// other messages are dropped.
    fn log(&self, level: LogLevel, message: &str) {
        if matches!(level, LogLevel::Error | LogLevel::Warn) {
            self.warn(message);
        }
    }
    /// Receives an event of a presenter.
    fn tell(&self, _event: &Value) {}
    /// Opens a file at a path relative to the output's folder; returns its handle.
    ///
    /// # Errors
    /// If the path leaves the folder or the file cannot be created.
    fn file_open(&self, _path: &str) -> Result<u64, PluginError> {
        Err(self.no_files())
    }
    /// Appends bytes to an open file.
    ///
    /// # Errors
    /// If no open file has this handle, or the bytes cannot be written.
    fn file_append(&self, _file: u64, _bytes: &[u8]) -> Result<(), PluginError> {
        Err(self.no_files())
    }
    /// Completes the open file with this handle.
    ///
    /// # Errors
    /// If no open file has this handle, or the file cannot be completed.
    fn file_commit(&self, _file: u64) -> Result<(), PluginError> {
        Err(self.no_files())
    }
    /// Discards the open file with this handle.
    ///
    /// # Errors
    /// If no open file has this handle, or the file cannot be removed.
    fn file_abort(&self, _file: u64) -> Result<(), PluginError> {
        Err(self.no_files())
    }
    /// Returns the error of a host without files. A host with files implements the functions
    /// `file_…` itself.
    fn no_files(&self) -> PluginError {
        PluginError::Refused("this host accepts no files".into())
    }
    /// Returns the port (the kind of data) that an output will receive; `None` if it is unknown at
    /// `open`.
    fn port(&self) -> Option<Port> {
        None
    }
}

/// Makes the C table of a host. The table borrows the services, and its functions are compiled for
/// the type `S`.
pub(crate) fn table<S: Services>(services: &S) -> HostServices {
    HostServices {
        size: size_of::<HostServices>(),
        context: (&raw const *services).cast(),
        log: log::<S>,
        progress_begin: progress_begin::<S>,
        progress_advance: progress_advance::<S>,
        progress_end: progress_end::<S>,
        is_cancelled: is_cancelled::<S>,
        file_open: file_open::<S>,
        file_append: file_append::<S>,
        file_commit: file_commit::<S>,
        file_abort: file_abort::<S>,
        simulate,
        tell: tell::<S>,
        port: services.port().map_or(0, Port::bit),
    }
}

/// # Safety
/// `context` comes from [`table`] for the same `S`, and its services are alive.
unsafe fn services<'a, S: Services>(context: *const c_void) -> &'a S {
    // SAFETY: guaranteed by the caller.
    unsafe { &*context.cast::<S>() }
}

/// Runs a service that returns no error. Returns `None` if it panics, so that no panic crosses the
/// C interface.
fn contained<T>(function: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(function)).ok()
}

unsafe extern "C" fn log<S: Services>(context: *const c_void, level: u32, message: Str) {
    let level = match level {
        level::ERROR => LogLevel::Error,
        level::WARN => LogLevel::Warn,
        level::INFO => LogLevel::Info,
        _ => LogLevel::Debug,
    };
    // SAFETY: the plugin passes the table's context as an argument, and lends the text for the
    // call.
    contained(|| unsafe { services::<S>(context).log(level, &lent_lossy(message)) });
}

unsafe extern "C" fn progress_begin<S: Services>(context: *const c_void, stage: Str, total: u64, unit: Str) {
    // SAFETY: as in `log`.
    contained(|| unsafe { services::<S>(context).task().progress.begin(&lent_lossy(stage), total, &lent_lossy(unit)) });
}

unsafe extern "C" fn progress_advance<S: Services>(context: *const c_void, steps: u64, note: Str) {
    // SAFETY: as in `log`.
    contained(|| unsafe { services::<S>(context).task().progress.advance(steps, &lent_lossy(note)) });
}

unsafe extern "C" fn progress_end<S: Services>(context: *const c_void) {
    // SAFETY: as in `log`.
    contained(|| unsafe { services::<S>(context).task().progress.end() });
}

unsafe extern "C" fn is_cancelled<S: Services>(context: *const c_void) -> u8 {
    // SAFETY: as in `log`.
    contained(|| unsafe { services::<S>(context).task().cancel.is_cancelled() }).map_or(1, u8::from)
}

unsafe extern "C" fn file_open<S: Services>(
    context: *const c_void,
    path: Str,
    file: *mut u64,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the plugin passes the table's context, lends the text, and provides memory for the
    // handle.
    unsafe {
        answer(error, || {
            let path = lent_text(path, "file name")?;
            *file = services::<S>(context).file_open(path)?;
            Ok(())
        })
    }
}

unsafe extern "C" fn file_append<S: Services>(
    context: *const c_void,
    file: u64,
    bytes: Bytes,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the plugin passes the table's context, and lends the bytes.
    unsafe { answer(error, || services::<S>(context).file_append(file, lent_bytes(bytes, "bytes of a file")?)) }
}

unsafe extern "C" fn file_commit<S: Services>(context: *const c_void, file: u64, error: *const ErrorSink) -> Status {
    // SAFETY: as in `log`.
    unsafe { answer(error, || services::<S>(context).file_commit(file)) }
}

unsafe extern "C" fn file_abort<S: Services>(context: *const c_void, file: u64, error: *const ErrorSink) -> Status {
    // SAFETY: as in `log`.
    unsafe { answer(error, || services::<S>(context).file_abort(file)) }
}

unsafe extern "C" fn tell<S: Services>(context: *const c_void, event_json: Str) {
    // SAFETY: as in `log`.
    let (text, services) = unsafe { (lent_lossy(event_json), services::<S>(context)) };
    if let Ok(event) = serde_json::from_str(&text) {
        contained(|| services.tell(&event));
    }
}

unsafe extern "C" fn simulate(
    _context: *const c_void,
    data: *const Data,
    view: *const View,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the plugin passes the data of the running `submit`. It lends the view, and memory for
    // the plane.
    unsafe { answer(error, || lend::simulate(data, view, plane)) }
}
