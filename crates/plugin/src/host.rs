//! The host as a plugin sees it: messages, progress, cancellation, and the only way for bytes to leave.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::thread::Thread;
use std::time::Duration;

use lumistack_core::{Cancel, Cancelled, Progress, Task, Warning, Warnings};
use lumistack_plugin_abi::{Bytes, Data, HostServices, Plane, Str, View, level};
use serde_json::Value;

use crate::wire::{call, needs};
use crate::{PlaneView, PluginError, Port, ViewPoint};

/// The host's services; clones share them. They end when the output is closed: a clone that outlives it gets errors.
#[derive(Clone)]
pub struct Host(Arc<RwLock<Option<Table>>>);

/// A pointer to the host's table, valid until the output is closed.
#[derive(Clone, Copy)]
struct Table(*const HostServices);

// SAFETY: the host allows its functions to be called from any thread.
unsafe impl Send for Table {}
// SAFETY: as above.
unsafe impl Sync for Table {}

impl Host {
    /// # Safety
    /// `table` is valid until [`Host::close`] returns.
    pub(crate) unsafe fn new(table: *const HostServices) -> Self {
        Self(Arc::new(RwLock::new(Some(Table(table)))))
    }

    /// Ends the services, once running calls have returned.
    pub(crate) fn close(&self) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Calls a service. The lock holds the table open meanwhile; services never call back into the plugin, so it is not taken twice.
    fn with<T>(&self, function: impl FnOnce(&HostServices) -> T) -> Option<T> {
        let guard = self.0.read().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: valid until `close`, which waits for the lock.
        guard.as_ref().map(|table| function(unsafe { &*table.0 }))
    }

    fn call(
        &self,
        service: impl FnOnce(&HostServices, *const crate::abi::ErrorSink) -> crate::abi::Status,
    ) -> Result<(), PluginError> {
        self.with(|table| call(|error| service(table, error)))
            .unwrap_or_else(|| Err(PluginError::Failed("the output is already closed".into())))
    }

    /// Tells the user that something failed and that the plugin goes on without it.
    pub fn error(&self, message: &str) {
        self.log(level::ERROR, message);
    }

    /// Tells the user what he should know.
    pub fn warn(&self, message: &str) {
        self.log(level::WARN, message);
    }

    /// Tells the user what he may want to know.
    pub fn info(&self, message: &str) {
        self.log(level::INFO, message);
    }

    /// For presenters: tells an event to the driver of the presentation, as JSON of the plugin's own form.
    pub fn tell(&self, event: &Value) {
        let json = event.to_string();
        // SAFETY: as in `log`.
        self.with(|table| unsafe { (table.tell)(table.context, Str::new(&json)) });
    }

    fn log(&self, level: u32, message: &str) {
        // SAFETY: the table's own context; the text is lent for the call.
        self.with(|table| unsafe { (table.log)(table.context, level, Str::new(message)) });
    }

    /// A stage of `total` steps of kind `unit` ("files") starts; it ends when the result is dropped.
    pub fn stage(&self, name: &str, total: u64, unit: &str) -> Stage {
        // SAFETY: as in `log`.
        self.with(|table| unsafe { (table.progress_begin)(table.context, Str::new(name), total, Str::new(unit)) });
        Stage(self.clone())
    }

    /// The port whose data an output will be given, where the host says so as it opens one; `None` elsewhere.
    pub fn port(&self) -> Option<Port> {
        let bit = self.with(|table| table.port)?;
        Port::ALL.into_iter().find(|port| port.bit() == bit)
    }

    /// Whether the user asked to stop. True once the output is closed.
    pub fn is_cancelled(&self) -> bool {
        // SAFETY: as in `log`.
        self.with(|table| unsafe { (table.is_cancelled)(table.context) != 0 }).unwrap_or(true)
    }

    /// # Errors
    /// When the user asked to stop, for use with `?` inside loops.
    pub fn check_cancelled(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }

    /// Runs work of the program's own libraries: their progress and warnings go to the host, and its wish to stop to them.
    pub fn run<T>(&self, work: impl FnOnce(Task<'_>) -> T) -> T {
        let told = Told { host: self, stages: Mutex::default() };
        let (cancel, done) = (Cancel::default(), AtomicBool::new(false));
        let ask = || {
            if self.is_cancelled() {
                cancel.cancel();
            }
        };
        ask();
        std::thread::scope(|scope| {
            let asks = scope.spawn(|| {
                while !done.load(Ordering::SeqCst) {
                    std::thread::park_timeout(ASKS);
                    ask();
                }
            });
            // also where the work panics, or the scope would wait for good
            let _done = Done { done: &done, asks: asks.thread().clone() };
            work(Task { progress: &told, warnings: &told, cancel: &cancel })
        })
    }

    /// Starts a file. `path` is relative to the output's folder, with `/` between its parts. The file is written through
    /// [`io::Write`] and appears once it is committed and the output has finished; a file that is dropped before leaves nothing.
    ///
    /// # Errors
    /// If the path is absolute or leaves the folder, or the host cannot write.
    pub fn create(&self, path: &str) -> Result<OutputFile, PluginError> {
        let mut file = 0;
        // SAFETY: as in `log`; `file` is written before the call returns.
        self.call(|table, error| unsafe { (table.file_open)(table.context, Str::new(path), &mut file, error) })?;
        Ok(OutputFile { host: self.clone(), file, path: path.into(), open: true })
    }

    /// Writes a whole file; see [`Host::create`].
    ///
    /// # Errors
    /// As [`Host::create`], or if the host cannot write the bytes.
    pub fn write(&self, path: &str, bytes: &[u8]) -> Result<(), PluginError> {
        let mut file = self.create(path)?;
        file.append(bytes)?;
        file.commit()
    }

    /// # Safety
    /// `data` is what the running `submit` was given.
    pub(crate) unsafe fn simulate<'a>(&self, data: *const Data, from: ViewPoint) -> Result<PlaneView<'a>, PluginError> {
        let (kind, value) = from.to_abi();
        let view = View { size: size_of::<View>(), kind, value };
        let mut plane = Plane::empty();
        // SAFETY: the caller's promise; `plane` says its own size.
        self.call(|table, error| unsafe { (table.simulate)(table.context, data, &view, &mut plane, error) })?;
        // SAFETY: the host filled the plane in; a simulated plane is the plugin's until it is released.
        unsafe { PlaneView::new(plane) }
    }
}

/// How often [`Host::run`] asks whether to stop.
const ASKS: Duration = Duration::from_millis(20);

/// Ends the thread that asks.
struct Done<'a> {
    done: &'a AtomicBool,
    asks: Thread,
}

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.done.store(true, Ordering::SeqCst);
        self.asks.unpark();
    }
}

/// Passes on what the program's libraries tell.
struct Told<'a> {
    host: &'a Host,
    stages: Mutex<Vec<Stage>>,
}

impl Told<'_> {
    fn stages(&self) -> MutexGuard<'_, Vec<Stage>> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Told<'_> {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        let stage = self.host.stage(stage, total, unit);
        self.stages().push(stage);
    }

    fn advance(&self, steps: u64, note: &str) {
        if let Some(stage) = self.stages().last() {
            stage.advance(steps, note);
        }
    }

    fn end(&self) {
        self.stages().pop();
    }
}

impl Warnings for Told<'_> {
    fn warn(&self, warning: Warning) {
        self.host.warn(&warning.to_string());
    }
}

impl std::fmt::Debug for Host {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Host")
    }
}

/// Ends a host's services unless they are kept: also on a panic in `open`.
pub(crate) struct CloseHost(Option<Host>);

impl CloseHost {
    /// # Safety
    /// `host` is a table of services that is valid until this is dropped or what it keeps is closed.
    pub(crate) unsafe fn checked(host: *const HostServices) -> Result<Self, PluginError> {
        // SAFETY: the caller's promise; the size comes first in every version.
        needs(unsafe { (*host).size }, size_of::<HostServices>())?;
        // SAFETY: the caller's promise.
        Ok(Self(Some(unsafe { Host::new(host) })))
    }

    pub(crate) fn get(&self) -> Host {
        self.0.clone().expect("not yet kept")
    }

    pub(crate) fn keep(mut self) -> Host {
        self.0.take().expect("not yet kept")
    }
}

impl Drop for CloseHost {
    fn drop(&mut self) {
        if let Some(host) = &self.0 {
            host.close();
        }
    }
}

/// A stage of progress; see [`Host::stage`].
#[derive(Debug)]
pub struct Stage(Host);

impl Stage {
    /// Some steps are done; `note` is a short figure to show beside the bar, or empty.
    pub fn advance(&self, steps: u64, note: &str) {
        // SAFETY: the table's own context; the text is lent for the call.
        self.0.with(|table| unsafe { (table.progress_advance)(table.context, steps, Str::new(note)) });
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        // SAFETY: the table's own context.
        self.0.with(|table| unsafe { (table.progress_end)(table.context) });
    }
}

/// A file that is being written; see [`Host::create`]. Errors of its [`io::Write`] hold a [`PluginError`], which
/// [`PluginError::from_io`] takes out again.
#[derive(Debug)]
pub struct OutputFile {
    host: Host,
    file: u64,
    path: String,
    open: bool,
}

impl OutputFile {
    /// Adds bytes at the end.
    ///
    /// # Errors
    /// If the host cannot write them.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), PluginError> {
        let file = self.file;
        // SAFETY: the table's own context; the bytes are lent for the call.
        self.host.call(|table, error| unsafe { (table.file_append)(table.context, file, Bytes::new(bytes), error) })
    }

    /// Declares the file whole.
    ///
    /// # Errors
    /// If the host cannot finish it.
    pub fn commit(mut self) -> Result<(), PluginError> {
        self.open = false;
        let file = self.file;
        // SAFETY: the table's own context.
        self.host.call(|table, error| unsafe { (table.file_commit)(table.context, file, error) })
    }

    /// The path that it was created with.
    pub fn path(&self) -> &str {
        &self.path
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if self.open {
            let file = self.file;
            // The host drops what is still open when the output closes, so a failure here leaves nothing either.
            // SAFETY: the table's own context.
            let _ = self.host.call(|table, error| unsafe { (table.file_abort)(table.context, file, error) });
        }
    }
}

impl io::Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.append(bytes).map_err(io::Error::other)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
