//! The child process. It loads one library, runs the plugin's functions for the program, and
//! forwards the plugin's requests to the program.

use std::collections::HashMap;
use std::ffi::{OsString, c_void};
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use lumistack_plugin::PlaneView;
use lumistack_plugin::abi::{
    Assets, ByteSink, Bytes, Data, ErrorSink, FieldSink, HostServices, Plane, StackSink, Status, Str, Time, View, dtype,
};
use lumistack_plugin::wire::{keeping, lent_bytes, lent_lossy, write_error};

use super::protocol::{self, Answer, Call, FromChild, Loaded, PART, Request, Say, ToChild, read_frame, write_frame};
use crate::LoadError;
use crate::dynamic;
use crate::serve::Functions;

/// Every answer of the program states whether the user has cancelled. For this time after an
/// answer, this statement is used without a new request.
const CANCEL_VALIDITY: Duration = Duration::from_millis(2);
/// Stack size of a thread that runs `submit` or `command`, bytes. Stacks of main threads usually
/// have this size.
const STACK: usize = 8 << 20;
/// Longest time in which the destructors of the library's statics may run before this process ends
/// itself. If the program still runs, it kills this process earlier.
const EXIT_TIMEOUT: Duration = Duration::from_secs(5);

/// The main function of a process that runs a plugin for another process. `args` are the two
/// arguments that [`Launcher`](crate::Launcher) appends: the library's path and the plugin's id.
/// Call this function from the main thread, before any use of standard input and output. End the
/// process with the returned code.
///
/// Standard output belongs to the program. On Unix, the library's standard output is therefore
/// redirected to standard error. On Windows the library must not print to standard output.
pub fn plugin_child(args: &[OsString]) -> u8 {
    let [library, id] = args else {
        eprintln!(
            "error: expected the path of a library and the id of a plugin, found other arguments; only lumistack itself uses this command"
        );
        return 2;
    };
    match serve(Path::new(library), &id.to_string_lossy()) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: {}: no connection to the program that started this process: {error}", library.display());
            1
        }
    }
}

fn serve(library: &Path, id: &str) -> io::Result<()> {
    let (mut from, to) = take_over()?;
    let (calls, waiting) = channel();
    let link: &'static Link = Box::leak(Box::new(Link {
        to: Mutex::new(to),
        waiting: Mutex::default(),
        requests: AtomicU64::new(0),
        active: AtomicUsize::new(1),
        asked: Mutex::default(),
        functions: OnceLock::new(),
        instance: Mutex::default(),
    }));
    // A thread reads the program's messages. It passes calls to the main thread, and answers to the
    // threads that wait for them.
    thread::spawn(move || {
        while let Ok(Some((message, body))) = read_frame(&mut from) {
            match message {
                ToChild::Call { call, what } => {
                    link.active.fetch_add(1, Ordering::SeqCst);
                    // `run` may occupy the main thread, so `submit` and `command` get other threads
                    if matches!(what, Call::Submit { .. } | Call::Command { .. }) {
                        link.beside(call, what);
                    } else if calls.send((call, what)).is_err() {
                        break;
                    }
                }
                ToChild::Answer(answer) => {
                    let waits = locked(&link.waiting).remove(&answer.request);
                    if let Some(waits) = waits {
                        let _ = waits.send((answer, body));
                    }
                }
            }
        }
        // The program sends no more calls. If a call is running, its result is not needed.
        if link.active.load(Ordering::SeqCst) > 0 {
            end_now();
        }
        drop(calls);
        thread::sleep(EXIT_TIMEOUT);
        end_now();
    });

    // Load the library, and report its plugin or the error.
    let loaded = match dynamic::open(library, id) {
        Ok(plugin) => {
            let info = plugin.info().clone();
            let _ = link.functions.set(plugin.functions().clone());
            Loaded::Plugin(info)
        }
        Err(LoadError::NoEntry { symbol, .. }) => Loaded::NoEntry(symbol),
        Err(LoadError::Descriptor { reason, .. }) => Loaded::Descriptor(reason.to_string()),
        Err(LoadError::OtherId { found, .. }) => Loaded::OtherId(found),
        Err(LoadError::Open { reason, .. }) => Loaded::Open(reason),
        Err(other) => Loaded::Open(other.to_string()),
    };
    link.send(&FromChild::Loaded(loaded), &[])?;
    link.active.fetch_sub(1, Ordering::SeqCst);

    // Run calls on the main thread until the program closes the connection.
    let host: &'static HostServices = Box::leak(Box::new(link.services()));
    for (call, what) in waiting {
        link.run(host, call, what);
    }
    Ok(())
}

/// Reserves standard input and output for messages. Afterwards the library reads an empty standard
/// input, and its prints go to standard error.
#[cfg(unix)]
fn take_over() -> io::Result<(File, File)> {
    use std::os::fd::AsFd;
    let from = File::from(io::stdin().as_fd().try_clone_to_owned()?);
    let to = File::from(io::stdout().as_fd().try_clone_to_owned()?);
    rustix::stdio::dup2_stdin(File::open("/dev/null")?)?;
    rustix::stdio::dup2_stdout(io::stderr().as_fd())?;
    Ok((from, to))
}

/// Reserves standard input and output for messages. On Windows standard output is not redirected,
/// so the library must not print to it.
#[cfg(windows)]
fn take_over() -> io::Result<(File, File)> {
    use std::os::windows::io::AsHandle;
    let from = File::from(io::stdin().as_handle().try_clone_to_owned()?);
    let to = File::from(io::stdout().as_handle().try_clone_to_owned()?);
    Ok((from, to))
}

/// Ends this process without running destructors of the library.
fn end_now() -> ! {
    #[cfg(unix)]
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    std::process::abort()
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The connection to the program.
struct Link {
    to: Mutex<File>,
    /// Plugin threads that wait for answers, by request number.
    waiting: Mutex<HashMap<u64, Sender<(Answer, Vec<u8>)>>>,
    requests: AtomicU64,
    /// Number of running calls. Loading the library counts as one call.
    active: AtomicUsize,
    /// Time of the program's last answer, and true if this answer stated a cancellation.
    asked: Mutex<(Option<Instant>, bool)>,
    /// The plugin's functions. The cell is empty if loading failed; the program then sends no
    /// calls.
    functions: OnceLock<Arc<dyn Functions>>,
    instance: Mutex<Instance>,
}

impl Link {
    fn send(&self, message: &FromChild, body: &[u8]) -> io::Result<()> {
        write_frame(&mut *locked(&self.to), message, body)
    }

    /// Sends a request to the program and waits for the answer. If the program is gone, this
    /// process ends.
    fn ask(&self, what: Request, body: &[u8]) -> (Answer, Vec<u8>) {
        let request = self.requests.fetch_add(1, Ordering::Relaxed);
        let (answers, answer) = channel();
        locked(&self.waiting).insert(request, answers);
        let sent = self.send(&FromChild::Request { request, what }, body);
        match sent.ok().and_then(|()| answer.recv().ok()) {
            Some((answer, body)) => {
                *locked(&self.asked) = (Some(Instant::now()), answer.cancelled);
                (answer, body)
            }
            None => end_now(),
        }
    }

    /// Sends a request as [`ask`](Self::ask) does, and passes the status and the reason of the
    /// answer to the plugin.
    ///
    /// # Safety
    /// `error` is null or a valid sink.
    unsafe fn status(&self, what: Request, body: &[u8], error: *const ErrorSink) -> Status {
        let (answer, _) = self.ask(what, body);
        // SAFETY: guaranteed by the caller.
        unsafe { write_error(error, &answer.text) };
        Status(answer.status)
    }

    fn say(&self, say: Say) {
        if self.send(&FromChild::Say(say), &[]).is_err() {
            end_now();
        }
    }

    fn is_cancelled(&self) -> bool {
        let (when, cancelled) = *locked(&self.asked);
        if cancelled || when.is_some_and(|when| when.elapsed() < CANCEL_VALIDITY) {
            return cancelled;
        }
        let (answer, _) = self.ask(Request::IsCancelled, &[]);
        // A failed request is treated as a cancellation, so that the plugin stops.
        answer.cancelled || answer.status != Status::OK.0
    }

    /// Makes the table of host services that the plugin receives. Its functions forward requests to
    /// the program.
    fn services(&'static self) -> HostServices {
        HostServices {
            size: size_of::<HostServices>(),
            context: (&raw const *self).cast(),
            log,
            progress_begin,
            progress_advance,
            progress_end,
            is_cancelled,
            file_open,
            file_append,
            file_commit,
            file_abort,
            simulate,
            tell: tell_program,
            port: 0,
        }
    }
}

/// # Safety
/// `context` is the pointer that [`Link::services`] put into the host's table.
unsafe fn link_of(context: *const c_void) -> &'static Link {
    // SAFETY: guaranteed by the caller; a link lives as long as the process.
    unsafe { &*context.cast::<Link>() }
}

/// Copies a text that the plugin lends; replaces invalid UTF-8.
///
/// # Safety
/// The plugin lends the text for the call.
unsafe fn text(text: Str) -> String {
    // SAFETY: guaranteed by the caller.
    unsafe { lent_lossy(text) }.into_owned()
}

/// Returns the bytes that the plugin lends. If they are invalid, reports the reason and returns the
/// status [`Status::REFUSED`].
///
/// # Safety
/// The plugin lends the bytes for the call; `error` is null or a valid sink.
unsafe fn bytes<'a>(ptr: *const u8, len: usize, what: &str, error: *const ErrorSink) -> Result<&'a [u8], Status> {
    // SAFETY: guaranteed by the caller.
    unsafe {
        lent_bytes(Bytes { ptr, len }, what).map_err(|refused| {
            write_error(error, &refused.to_string());
            Status::REFUSED
        })
    }
}

// SAFETY of all functions below: the plugin passes the context of the struct that contains the
// function. The plugin lends texts and bytes for the call, and passes null or a valid sink for
// errors.

unsafe extern "C" fn log(context: *const c_void, level: u32, message: Str) {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).say(Say::Log { level, message: text(message) }) };
}

unsafe extern "C" fn progress_begin(context: *const c_void, stage: Str, total: u64, unit: Str) {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).say(Say::ProgressBegin { stage: text(stage), total, unit: text(unit) }) };
}

unsafe extern "C" fn progress_advance(context: *const c_void, steps: u64, note: Str) {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).say(Say::ProgressAdvance { steps, note: text(note) }) };
}

unsafe extern "C" fn progress_end(context: *const c_void) {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).say(Say::ProgressEnd) };
}

unsafe extern "C" fn is_cancelled(context: *const c_void) -> u8 {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).is_cancelled().into() }
}

unsafe extern "C" fn file_open(context: *const c_void, path: Str, file: *mut u64, error: *const ErrorSink) -> Status {
    // SAFETY: the comment before `log` has the rules; the plugin provides memory for the handle.
    unsafe {
        match bytes(path.ptr, path.len, "file name", error) {
            Ok(path) => {
                let (answer, _) = link_of(context).ask(Request::FileOpen, path);
                write_error(error, &answer.text);
                if answer.status == Status::OK.0 {
                    *file = answer.file;
                }
                Status(answer.status)
            }
            Err(refused) => refused,
        }
    }
}

unsafe extern "C" fn file_append(context: *const c_void, file: u64, content: Bytes, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe {
        match bytes(content.ptr, content.len, "bytes of a file", error) {
            Ok(content) => in_parts(content, |part| link_of(context).status(Request::FileAppend { file }, part, error)),
            Err(refused) => refused,
        }
    }
}

/// Sends bytes in pieces of at most [`PART`](protocol::PART) bytes. Without bytes it sends one
/// empty piece.
fn in_parts(bytes: &[u8], mut send: impl FnMut(&[u8]) -> Status) -> Status {
    if bytes.is_empty() {
        return send(bytes);
    }
    bytes.chunks(PART).map(&mut send).find(|status| *status != Status::OK).unwrap_or(Status::OK)
}

unsafe extern "C" fn file_commit(context: *const c_void, file: u64, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).status(Request::FileCommit { file }, &[], error) }
}

unsafe extern "C" fn file_abort(context: *const c_void, file: u64, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).status(Request::FileAbort { file }, &[], error) }
}

unsafe extern "C" fn simulate(
    _context: *const c_void,
    data: *const Data,
    view: *const View,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the comment before `log` has the rules; the data belong to the running call.
    unsafe {
        let (kind, value_bits) = ((*view).kind, (*view).value.map(f64::to_bits));
        fetch((*data).context, |call| Request::Simulate { call, kind, value_bits }, plane, error)
    }
}

unsafe extern "C" fn tell_program(context: *const c_void, event_json: Str) {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { link_of(context).say(Say::Tell { json: text(event_json) }) };
}

/// Identifies a running call. In the C structs of the call's data and sinks, the member `context`
/// points to this struct.
struct Running {
    link: &'static Link,
    call: u64,
}

/// # Safety
/// `context` belongs to the data or a sink of a running call.
unsafe fn running<'a>(context: *const c_void) -> &'a Running {
    // SAFETY: guaranteed by the caller.
    unsafe { &*context.cast::<Running>() }
}

unsafe extern "C" fn layer_plane(
    context: *const c_void,
    layer: usize,
    frame: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { fetch(context, |call| Request::LayerPlane { call, layer, frame }, plane, error) }
}

unsafe extern "C" fn emission_plane(
    context: *const c_void,
    frame: usize,
    bin_y: usize,
    bin_x: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { fetch(context, |call| Request::EmissionPlane { call, frame, bin_y, bin_x }, plane, error) }
}

unsafe extern "C" fn view_plane(
    context: *const c_void,
    view_y: usize,
    view_x: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { fetch(context, |call| Request::ViewPlane { call, view_y, view_x }, plane, error) }
}

unsafe extern "C" fn weight_plane(
    context: *const c_void,
    view_y: usize,
    view_x: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { fetch(context, |call| Request::WeightPlane { call, view_y, view_x }, plane, error) }
}

/// Fetches a plane. The plugin owns the plane until it releases the plane.
///
/// # Safety
/// `context` belongs to the data of a running call; `plane` is memory for a plane whose `size` is
/// set; `error` is null or a valid sink.
unsafe fn fetch(
    context: *const c_void,
    what: impl FnOnce(u64) -> Request,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the caller.
    let (Running { link, call }, size) = unsafe { (running(context), (*plane).size) };
    if size < size_of::<Plane>() {
        // SAFETY: guaranteed by the caller.
        unsafe {
            write_error(
                error,
                &format!("the plane's `size`: expected at least {} bytes, found {size}", size_of::<Plane>()),
            )
        };
        return Status::REFUSED;
    }
    let (answer, body) = link.ask(what(*call), &[]);
    // SAFETY: guaranteed by the caller.
    unsafe { write_error(error, &answer.text) };
    if answer.status != Status::OK.0 {
        return Status(answer.status);
    }
    let [rows, cols, channels] = answer.shape;
    let element = size_of::<f32>() as isize;
    let owner = Box::new(body);
    let filled = Plane {
        size,
        data: owner.as_ptr().cast(),
        dtype: dtype::F32,
        ndim: 3,
        shape: [rows, cols, channels, 1],
        strides: [(cols * channels) as isize * element, channels as isize * element, element, 0],
        owner: Box::into_raw(owner).cast(),
        release: Some(release),
    };
    // SAFETY: guaranteed by the caller. A newer plugin's `Plane` is longer; the bytes after this
    // version's members stay unchanged.
    unsafe { *plane = filled };
    Status::OK
}

unsafe extern "C" fn release(owner: *mut c_void) {
    // SAFETY: `owner` is the vector that `fetch` boxed, and a plane is released once.
    drop(unsafe { Box::from_raw(owner.cast::<Vec<u8>>()) });
}

unsafe extern "C" fn read_asset(
    context: *const c_void,
    path: Str,
    sink: *const ByteSink,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the comment before `log` has the rules; the plugin lends the sink.
    unsafe {
        let Running { link, call } = running(context);
        let path = match bytes(path.ptr, path.len, "file name", error) {
            Ok(path) => path,
            Err(refused) => return refused,
        };
        let (answer, content) = link.ask(Request::ReadAsset { call: *call }, path);
        write_error(error, &answer.text);
        if answer.status != Status::OK.0 {
            return Status(answer.status);
        }
        ((*sink).write)((*sink).context, Bytes::new(&content), error)
    }
}

unsafe extern "C" fn give_scene(context: *mut c_void, content: Bytes, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe {
        let Running { link, call } = running(context);
        match bytes(content.ptr, content.len, "bytes", error) {
            Ok(content) => in_parts(content, |part| link.status(Request::GiveScene { call: *call }, part, error)),
            Err(refused) => refused,
        }
    }
}

unsafe extern "C" fn give_geometry(context: *mut c_void, geometry_json: Str, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe {
        let Running { link, call } = running(context);
        match bytes(geometry_json.ptr, geometry_json.len, "geometry", error) {
            Ok(geometry) => link.status(Request::GiveGeometry { call: *call }, geometry, error),
            Err(refused) => refused,
        }
    }
}

unsafe extern "C" fn give_view(
    context: *mut c_void,
    view_y: usize,
    view_x: usize,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { give(context, |call, shape| Request::GiveView { call, view_y, view_x, shape }, plane, error) }
}

unsafe extern "C" fn give_brightness(context: *mut c_void, brightness: f64, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe {
        let Running { link, call } = running(context);
        link.status(Request::GiveBrightness { call: *call, bits: brightness.to_bits() }, &[], error)
    }
}

unsafe extern "C" fn give_layer(
    context: *mut c_void,
    layer: usize,
    frame: usize,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { give(context, |call, shape| Request::GiveLayer { call, layer, frame, shape }, plane, error) }
}

unsafe extern "C" fn give_emission(
    context: *mut c_void,
    frame: usize,
    bin_y: usize,
    bin_x: usize,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe { give(context, |call, shape| Request::GiveEmission { call, frame, bin_y, bin_x, shape }, plane, error) }
}

unsafe extern "C" fn give_step(
    context: *mut c_void,
    iteration: u32,
    objective: f64,
    psnr_view: f64,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe {
        let Running { link, call } = running(context);
        let [objective_bits, psnr_bits] = [objective, psnr_view].map(f64::to_bits);
        link.status(Request::GiveStep { call: *call, iteration, objective_bits, psnr_bits }, &[], error)
    }
}

unsafe extern "C" fn give_solution(context: *mut c_void, solution_json: Str, error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the plugin, as the comment before `log` states.
    unsafe {
        let Running { link, call } = running(context);
        match bytes(solution_json.ptr, solution_json.len, "solution", error) {
            Ok(solution) => link.status(Request::GiveSolution { call: *call }, solution, error),
            Err(refused) => refused,
        }
    }
}

/// Sends a plane lent by the plugin.
///
/// # Safety
/// `context` belongs to a sink of a running call; the plugin lends a plane whose `size` is set;
/// `error` is null or a valid sink.
unsafe fn give(
    context: *mut c_void,
    what: impl FnOnce(u64, [usize; 3]) -> Request,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: guaranteed by the caller.
    let (Running { link, call }, size) = unsafe { (running(context), (*plane).size) };
    if size < size_of::<Plane>() {
        // SAFETY: guaranteed by the caller.
        unsafe {
            write_error(
                error,
                &format!("the plane's `size`: expected at least {} bytes, found {size}", size_of::<Plane>()),
            )
        };
        return Status::REFUSED;
    }
    // SAFETY: guaranteed by the caller; the plugin keeps ownership, so nothing is released.
    let view = match unsafe { PlaneView::new(Plane { release: None, ..*plane }) } {
        Ok(view) => view,
        Err(reason) => {
            // SAFETY: guaranteed by the caller.
            unsafe { write_error(error, &reason.to_string()) };
            return Status::FAILED;
        }
    };
    let shape = [view.rows(), view.cols(), view.channels()];
    let values = view.values();
    // SAFETY: the bytes of `f32` values are initialized.
    let body = unsafe { std::slice::from_raw_parts(values.as_ptr().cast(), size_of_val(&*values)) };
    // SAFETY: guaranteed by the caller.
    unsafe { link.status(what(*call, shape), body, error) }
}

/// The handle of an open output.
#[derive(Clone, Copy)]
struct Instance(*mut c_void);

// SAFETY: the interface allows calls of an output's functions from any thread.
unsafe impl Send for Instance {}

impl Default for Instance {
    fn default() -> Self {
        Self(std::ptr::null_mut())
    }
}

impl Link {
    /// Runs a `submit` or a `command` in a new thread, since they may arrive during other calls.
    fn beside(&'static self, call: u64, what: Call) {
        let Some(functions) = self.functions.get() else { return };
        let instance = *locked(&self.instance);
        let work = move || {
            // This binding captures the whole `Instance`, which is `Send`. Without it the closure
            // would capture the pointer alone.
            let Instance(handle) = { instance };
            // SAFETY: the handle comes from `open`, and the program closes it later; the other
            // arguments are lent for the call.
            done(self, call, |error| unsafe {
                match &what {
                    Call::Submit { time, data } => {
                        with_data(self, call, data, |data| functions.submit(handle, &time_of(*time), data, error))
                    }
                    Call::Command { json } => functions.command(handle, Str::new(json), error),
                    _ => unreachable!("runs on the main thread"),
                }
            });
        };
        if let Err(reason) = thread::Builder::new().stack_size(STACK).spawn(work) {
            let text = format!("no thread can be started: {reason}");
            let _ = self.send(&FromChild::Done { call, status: Status::FAILED.0, text }, &[]);
            self.active.fetch_sub(1, Ordering::SeqCst);
        }
    }

    /// Runs a call other than `submit` and `command`, on the main thread.
    fn run(&'static self, host: &'static HostServices, call: u64, what: Call) {
        let Some(functions) = self.functions.get() else { return };
        let (link, instance) = (self, *locked(&self.instance));
        let host: *const HostServices = match &what {
            // the plugin keeps a pointer to the table until this process ends
            Call::Open { port, .. } => Box::leak(Box::new(HostServices { port: *port, ..*host })),
            _ => host,
        };
        // Call the function with sinks that forward the plugin's results to the program.
        let running = Running { link, call };
        let context = (&raw const running).cast::<c_void>();
        let Instance(handle) = instance;
        // SAFETY: all arguments are lent for the call, and the table until the process ends;
        // handles come from `open`.
        done(link, call, |error| unsafe {
            match &what {
                Call::Import { params, file } => {
                    let assets = Assets { size: size_of::<Assets>(), context, read: read_asset };
                    let scene =
                        ByteSink { size: size_of::<ByteSink>(), context: context.cast_mut(), write: give_scene };
                    functions.import(host, Str::new(params), Str::new(file), &assets, &scene, error)
                }
                Call::MakeField { params, display, time } => {
                    let field = FieldSink {
                        size: size_of::<FieldSink>(),
                        context: context.cast_mut(),
                        geometry: give_geometry,
                        view_plane: give_view,
                    };
                    functions.make_field(host, Str::new(params), Str::new(display), &time_of(*time), &field, error)
                }
                Call::MakeStack { params, display, time, data } => {
                    let stack = StackSink {
                        size: size_of::<StackSink>(),
                        context: context.cast_mut(),
                        brightness: give_brightness,
                        layer_plane: give_layer,
                        emission_plane: give_emission,
                        step: give_step,
                        solution: give_solution,
                    };
                    let (params, display) = (Str::new(params), Str::new(display));
                    with_data(link, call, data, |data| {
                        functions.make_stack(host, params, display, &time_of(*time), data, &stack, error)
                    })
                }
                Call::Open { params, display, .. } => {
                    let mut handle = std::ptr::null_mut();
                    let status = functions.open(host, Str::new(params), Str::new(display), &mut handle, error);
                    *locked(&self.instance) = Instance(handle);
                    status
                }
                Call::Run => functions.run(handle, error),
                Call::Finish => functions.finish(handle, error),
                Call::Close => {
                    functions.close(handle);
                    Status::OK
                }
                Call::Submit { .. } | Call::Command { .. } => unreachable!("have threads of their own"),
            }
        });
    }
}

fn time_of(time: protocol::Time) -> Time {
    Time { size: size_of::<Time>(), index: time.index, seconds: f64::from_bits(time.seconds_bits) }
}

/// Makes the C struct of a call's data, and lends it to a function.
fn with_data(
    link: &'static Link,
    call: u64,
    data: &protocol::Data,
    function: impl FnOnce(*const Data) -> Status,
) -> Status {
    let running = Running { link, call };
    let data = Data {
        size: size_of::<Data>(),
        port: data.port,
        context: (&raw const running).cast(),
        description_json: Str::new(&data.description),
        layer_plane,
        emission_plane,
        view_plane,
        weight_plane,
    };
    function(&data)
}

/// Runs a function of the plugin and sends its result.
fn done(link: &Link, call: u64, function: impl FnOnce(*const ErrorSink) -> Status) {
    let mut text = String::new();
    let status = function(&keeping(&mut text));
    // Only a status other than OK has a reason, so a text that was written with the status OK is
    // ignored.
    let text = if status == Status::OK { String::new() } else { text };
    link.active.fetch_sub(1, Ordering::SeqCst);
    if link.send(&FromChild::Done { call, status: status.0, text }, &[]).is_err() {
        end_now();
    }
}
