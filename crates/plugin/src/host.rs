//! The host's services for a plugin: messages, progress, cancellation, and files.

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

/// The host's services. A clone uses the same services. An output's services end when the output is
/// closed; the services of an importer, source or node end when its function returns. After the
/// end, files cannot be written, messages and progress are lost, and [`Host::is_cancelled`] returns
/// true.
#[derive(Clone)]
pub struct Host(Arc<RwLock<Option<Table>>>);

/// A pointer to the host's table, valid until the services end.
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

    /// Waits until running calls of services have returned, and ends the services.
    pub(crate) fn close(&self) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Calls a service; `None` if the services have ended. The lock keeps the table valid during
    /// the call. Services never call back into the plugin, so no thread takes the lock twice.
    fn with<T>(&self, function: impl FnOnce(&HostServices) -> T) -> Option<T> {
        let guard = self.0.read().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the table is valid until `close`, which waits for the lock.
        guard.as_ref().map(|table| function(unsafe { &*table.0 }))
    }

    fn call(
        &self,
        service: impl FnOnce(&HostServices, *const crate::abi::ErrorSink) -> crate::abi::Status,
    ) -> Result<(), PluginError> {
        self.with(|table| call(|error| service(table, error))).unwrap_or_else(|| {
            Err(PluginError::Failed("the plugin called the host after the host's services had ended".into()))
        })
    }

    /// Reports a failure after which the plugin continues.
    pub fn error(&self, message: &str) {
        self.log(level::ERROR, message);
    }

    /// Reports a warning to the user.
    pub fn warn(&self, message: &str) {
        self.log(level::WARN, message);
    }

    /// Reports information to the user.
    pub fn info(&self, message: &str) {
        self.log(level::INFO, message);
    }

    /// Sends an event of a presenter, as JSON that the plugin defines, to the program that runs the
    /// presentation.
    pub fn tell(&self, event: &Value) {
        let json = event.to_string();
        // SAFETY: the context belongs to the table; texts are lent for the call.
        self.with(|table| unsafe { (table.tell)(table.context, Str::new(&json)) });
    }

    fn log(&self, level: u32, message: &str) {
        // SAFETY: the context belongs to the table; the text is lent for the call.
        self.with(|table| unsafe { (table.log)(table.context, level, Str::new(message)) });
    }

    /// Begins a stage of `total` steps of the given `unit` ("files"). The stage ends when the
    /// returned object is dropped.
    pub fn stage(&self, name: &str, total: u64, unit: &str) -> Stage {
        // SAFETY: the context belongs to the table; texts are lent for the call.
        self.with(|table| unsafe { (table.progress_begin)(table.context, Str::new(name), total, Str::new(unit)) });
        Stage(self.clone())
    }

    /// Returns the port of the data that an output will receive; `None` if the host does not know
    /// the port at `open`.
    pub fn port(&self) -> Option<Port> {
        let bit = self.with(|table| table.port)?;
        Port::ALL.into_iter().find(|port| port.bit() == bit)
    }

    /// Returns true after the user cancelled, or after the services have ended.
    pub fn is_cancelled(&self) -> bool {
        // SAFETY: the context belongs to the table.
        self.with(|table| unsafe { (table.is_cancelled)(table.context) != 0 }).unwrap_or(true)
    }

    /// Checks for cancellation. Loops call this function with `?`.
    ///
    /// # Errors
    /// If the user cancelled, or the services have ended.
    pub fn check_cancelled(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }

    /// Runs `work`, which calls libraries of this project with a [`Task`]. The task passes progress
    /// and warnings to the host, and the host's cancellation to the libraries.
    pub fn run<T>(&self, work: impl FnOnce(Task<'_>) -> T) -> T {
        let forward = Forward { host: self, stages: Mutex::default() };
        let (cancel, done) = (Cancel::default(), AtomicBool::new(false));
        let ask = || {
            if self.is_cancelled() {
                cancel.cancel();
            }
        };
        ask();
        std::thread::scope(|scope| {
            let checker = scope.spawn(|| {
                while !done.load(Ordering::SeqCst) {
                    std::thread::park_timeout(CANCEL_INTERVAL);
                    ask();
                }
            });
            // The drop of `_done` ends the checking thread, also after a panic. Otherwise the scope
            // would wait for this thread for ever.
            let _done = Done { done: &done, checker: checker.thread().clone() };
            work(Task { progress: &forward, warnings: &forward, cancel: &cancel })
        })
    }

    /// Creates a file. `path` is relative to the output's folder, with `/` between names. The file
    /// is written through [`io::Write`]. A committed file appears when the output has finished. A
    /// file that is dropped without a commit is discarded.
    ///
    /// # Errors
    /// If the path is absolute, leaves the folder, or has a name that some system refuses. Also if
    /// the file already exists in this output, the user cancelled, or the host cannot write.
    pub fn create(&self, path: &str) -> Result<OutputFile, PluginError> {
        let mut file = 0;
        // SAFETY: the context belongs to the table, and the text is lent for the call; `file` is
        // written before the call returns.
        self.call(|table, error| unsafe { (table.file_open)(table.context, Str::new(path), &mut file, error) })?;
        Ok(OutputFile { host: self.clone(), file, path: path.into(), open: true, failed: None })
    }

    /// Writes a whole file; see [`Host::create`].
    ///
    /// # Errors
    /// Those of [`Host::create`], or if the host cannot write the bytes.
    pub fn write(&self, path: &str, bytes: &[u8]) -> Result<(), PluginError> {
        let mut file = self.create(path)?;
        file.append(bytes)?;
        file.commit()
    }

    /// # Safety
    /// `data` is the argument of the running `submit`.
    pub(crate) unsafe fn simulate<'a>(&self, data: *const Data, from: ViewPoint) -> Result<PlaneView<'a>, PluginError> {
        let (kind, value) = from.to_abi();
        let view = View { size: size_of::<View>(), kind, value };
        let mut plane = Plane::empty();
        // SAFETY: guaranteed by the caller; `size` of `plane` is set.
        self.call(|table, error| unsafe { (table.simulate)(table.context, data, &view, &mut plane, error) })?;
        // SAFETY: the host filled the plane; the plugin owns a simulated plane until it is
        // released.
        unsafe { PlaneView::new(plane) }
    }
}

/// Interval at which [`Host::run`] checks for cancellation.
const CANCEL_INTERVAL: Duration = Duration::from_millis(20);

/// Guard whose drop ends the thread that checks for cancellation.
struct Done<'a> {
    done: &'a AtomicBool,
    checker: Thread,
}

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.done.store(true, Ordering::SeqCst);
        self.checker.unpark();
    }
}

/// Forwards progress and warnings of libraries to the host.
struct Forward<'a> {
    host: &'a Host,
    stages: Mutex<Vec<Stage>>,
}

impl Forward<'_> {
    fn stages(&self) -> MutexGuard<'_, Vec<Stage>> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Forward<'_> {
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

impl Warnings for Forward<'_> {
    fn warn(&self, warning: Warning) {
        self.host.warn(&warning.to_string());
    }
}

impl std::fmt::Debug for Host {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Host")
    }
}

/// Closes a host's services on drop, also after a panic in `open`. [`keep`](Self::keep) takes the
/// services, which then stay open.
pub(crate) struct CloseHost(Option<Host>);

impl CloseHost {
    /// # Safety
    /// `host` is a table of services. The table is valid until the returned value is dropped, or,
    /// after [`keep`](Self::keep), until the kept host is closed.
    pub(crate) unsafe fn checked(host: *const HostServices) -> Result<Self, PluginError> {
        // SAFETY: guaranteed by the caller; the size comes first in every version.
        needs(unsafe { (*host).size }, size_of::<HostServices>())?;
        // SAFETY: guaranteed by the caller.
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
    /// Reports that `steps` more steps are complete. `note` is a short text next to the progress
    /// bar, or empty.
    pub fn advance(&self, steps: u64, note: &str) {
        // SAFETY: the context belongs to the table; the text is lent for the call.
        self.0.with(|table| unsafe { (table.progress_advance)(table.context, steps, Str::new(note)) });
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        // SAFETY: the context belongs to the table.
        self.0.with(|table| unsafe { (table.progress_end)(table.context) });
    }
}

/// A file that is being written; see [`Host::create`]. Errors of its [`io::Write`] contain a
/// [`PluginError`], which [`PluginError::from_io`] extracts.
#[derive(Debug)]
pub struct OutputFile {
    host: Host,
    file: u64,
    path: String,
    open: bool,
    /// The error of the first bytes that the host could not write.
    failed: Option<PluginError>,
}

impl OutputFile {
    /// Appends bytes.
    ///
    /// # Errors
    /// If the host cannot write them, or could not write earlier ones.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), PluginError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        let file = self.file;
        // SAFETY: the context belongs to the table; the bytes are lent for the call.
        let written = self
            .host
            .call(|table, error| unsafe { (table.file_append)(table.context, file, Bytes::new(bytes), error) });
        self.failed = written.clone().err();
        written
    }

    /// Completes the file, which appears when the output has finished.
    ///
    /// # Errors
    /// If the host cannot complete the file, or could not write some of its bytes. Errors of
    /// earlier writes are reported again, since some encoders write their last bytes when they are
    /// dropped, and ignore errors.
    pub fn commit(mut self) -> Result<(), PluginError> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        self.open = false;
        let file = self.file;
        // SAFETY: the context belongs to the table.
        self.host.call(|table, error| unsafe { (table.file_commit)(table.context, file, error) })
    }

    /// Returns the path given to [`Host::create`].
    pub fn path(&self) -> &str {
        &self.path
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if self.open {
            let file = self.file;
            // SAFETY: the context belongs to the table. A failure is ignored: the host discards
            // open files when the output closes.
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
