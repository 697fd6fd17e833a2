//! The program's end: starts children, passes calls on to them, and does what they ask for.
//!
//! Every child has three threads here: one writes what the program sends, one reads and does what the child asks for,
//! and one passes on what the plugin prints. Who called a function of the plugin waits for its end and meanwhile looks
//! whether the user wants to stop, whether the child is still there and whether it still says something. None of the
//! three threads is waited for where a call ends, since a process that the plugin started may hold the pipes open.

use std::collections::{BTreeMap, HashMap};
use std::ffi::c_void;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::thread;
use std::time::{Duration, Instant};

use lumistack_plugin::abi::{
    Assets, ByteSink, Bytes, Data, ErrorSink, FieldSink, HostServices, Plane, StackSink, Status, Str, View, dtype,
    level,
};
use lumistack_plugin::serve::{Functions, Plugin};
use lumistack_plugin::{PlaneView, PluginError, abi};

use super::protocol::{self, Answer, Call, FromChild, Loaded, Request, Say, ToChild, read_frame, write_frame};
use super::{Launcher, Limits, keeping, tell};
use crate::LoadError;

/// How often who waits looks around.
const TICK: Duration = Duration::from_millis(20);
/// Time for a process to end once there is nothing more for it to do.
const FAREWELL: Duration = Duration::from_secs(2);
/// Time for the last messages of a process that has ended.
const LAST_WORDS: Duration = Duration::from_millis(300);
/// Of what a plugin prints the last bytes are kept for messages.
const SAID: usize = 16 << 10;
/// Files that a message names, at most.
const NAMED: usize = 3;

/// Loads a library in a child, and returns its plugin, whose functions start a child each.
pub(crate) fn probe(library: &Path, id: &str, launcher: Launcher, limits: Limits) -> Result<Plugin, LoadError> {
    let path = || library.to_path_buf();
    // an absolute path, since the loader looks for a bare name elsewhere
    let absolute = std::path::absolute(library).map_err(|source| LoadError::Read { path: path(), source })?;
    let remote = Remote { library: absolute, launcher, limits };
    let (_session, loaded) = match remote.start(&|| false) {
        Ok(started) => started,
        Err(Stopped::Cancelled) => unreachable!("nobody can cancel a look at a library"),
        Err(Stopped::Died(cause)) => return Err(LoadError::Ended { path: path(), cause }),
    };
    let info = match loaded {
        Loaded::Plugin(info) if info.id == id => info,
        Loaded::Plugin(info) => {
            return Err(LoadError::OtherId { path: path(), expected: id.into(), found: info.id });
        }
        Loaded::Open(reason) => return Err(LoadError::Open { path: path(), reason }),
        Loaded::NoEntry(symbol) => return Err(LoadError::NoEntry { path: path(), symbol }),
        Loaded::Descriptor(reason) => {
            return Err(LoadError::Descriptor { path: path(), reason: PluginError::Refused(reason) });
        }
        Loaded::OtherId(found) => return Err(LoadError::OtherId { path: path(), expected: id.into(), found }),
    };
    Plugin::elsewhere(info, Arc::new(remote)).map_err(|reason| LoadError::Descriptor { path: path(), reason })
}

/// A plugin's functions, in children.
struct Remote {
    library: PathBuf,
    launcher: Launcher,
    limits: Limits,
}

/// Why a call did not come to its end.
enum Stopped {
    /// The user asked to stop, and the child was ended where it did not.
    Cancelled,
    /// The child ended, or had to be ended: why.
    Died(String),
}

impl Remote {
    /// Starts a child and waits until it has loaded the library.
    fn start(&self, cancelled: &dyn Fn() -> bool) -> Result<(Owner, Loaded), Stopped> {
        let Launcher { program, args } = &self.launcher;
        let mut command = Command::new(program);
        command.args(args).arg(&self.library);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C reaches all of a terminal's foreground group, but a plugin learns of it from the host
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().map_err(|error| {
            Stopped::Died(format!("the process for it cannot be started: {}: {error}", program.display()))
        })?;
        let (input, output, errors) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(mut input), Some(mut output), Some(errors)) = (input, output, errors) else {
            unreachable!("all three are piped")
        };
        #[cfg(target_os = "linux")]
        for pipe in [std::os::fd::AsFd::as_fd(&input), std::os::fd::AsFd::as_fd(&output)] {
            // faster where the system allows it
            let _ = rustix::pipe::fcntl_setpipe_size(pipe, 1 << 20);
        }
        let (outgoing, frames) = channel::<Option<(ToChild, Vec<u8>)>>();
        let session = Arc::new(Session {
            library: self.library.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            limits: self.limits,
            child: Mutex::new(child),
            outgoing,
            state: Mutex::new(State { last_sign: Instant::now(), ..State::new() }),
            lent: RwLock::default(),
            said: Mutex::default(),
        });
        let (loaded, waits) = channel();
        session.state().loaded = Some(loaded);
        thread::spawn(move || {
            // closing the pipe, at its end, ends a child that has nothing more to do
            while let Ok(Some((head, body))) = frames.recv() {
                if write_frame(&mut input, &head, &body).is_err() {
                    break;
                }
            }
        });
        let reader = session.clone();
        thread::spawn(move || {
            while let Ok(Some((message, body))) = read_frame(&mut output) {
                reader.take(message, body);
            }
            reader.disconnected();
        });
        let listener = session.clone();
        thread::spawn(move || listener.pass_on(errors));
        let owner = Owner(session);
        let loaded = owner.wait(&waits, "it was loaded", self.limits.load, cancelled)?;
        Ok((owner, loaded))
    }

    /// Runs one function of the plugin in a child of its own.
    ///
    /// # Safety
    /// All that is lent is valid until this returns; `error` is null or a valid sink.
    unsafe fn once(
        &self,
        host: *const HostServices,
        lent: Lent,
        what: Call,
        doing: &str,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: the caller's promise.
        unsafe {
            match self.start(&|| is_cancelled(host)) {
                Ok((session, _)) => session.call(host, lent, what, doing, error),
                Err(stopped) => stopped.told(error),
            }
        }
    }
}

impl Stopped {
    /// # Safety
    /// `error` is null or a valid sink.
    unsafe fn told(self, error: *const ErrorSink) -> Status {
        let (text, status) = match self {
            Self::Cancelled => ("cancelled".to_owned(), Status::CANCELLED),
            Self::Died(cause) => (cause, Status::FAILED),
        };
        // SAFETY: the caller's promise.
        unsafe { tell(error, &text) };
        status
    }
}

/// # Safety
/// `host` is a valid table.
unsafe fn is_cancelled(host: *const HostServices) -> bool {
    // SAFETY: the caller's promise.
    unsafe { ((*host).is_cancelled)((*host).context) != 0 }
}

/// A text of the host, which is UTF-8.
///
/// # Safety
/// The text is lent for the call.
unsafe fn text(text: Str) -> String {
    // SAFETY: the caller's promise.
    String::from_utf8_lossy(unsafe { super::lent(text.ptr, text.len) }.unwrap_or_default()).into_owned()
}

/// # Safety
/// `time` is valid.
unsafe fn time_of(time: *const abi::Time) -> protocol::Time {
    // SAFETY: the caller's promise.
    unsafe { protocol::Time { index: (*time).index, seconds_bits: (*time).seconds.to_bits() } }
}

/// # Safety
/// `data` is valid.
unsafe fn data_of(data: *const Data) -> protocol::Data {
    // SAFETY: the caller's promise.
    unsafe { protocol::Data { port: (*data).port, description: text((*data).description_json) } }
}

// SAFETY: what is lent is kept in the session for as long as the call runs, and taken out before it returns; the table
// of `open` when the session ends. Whoever uses it holds the lock that takes it out.
unsafe impl Functions for Remote {
    unsafe fn import(
        &self,
        host: *const HostServices,
        params_json: Str,
        file: Str,
        assets: *const Assets,
        scene: *const ByteSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: the caller's promise, here and in the other functions.
        unsafe {
            let (params, file) = (text(params_json), text(file));
            let doing = format!("it read `{file}`");
            let lent = Lent { assets, scene, ..Lent::nothing() };
            self.once(host, lent, Call::Import { params, file }, &doing, error)
        }
    }

    unsafe fn make_field(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const abi::Time,
        field: *const FieldSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        unsafe {
            let lent = Lent { field, ..Lent::nothing() };
            let what = Call::MakeField { params: text(params_json), display: text(display_json), time: time_of(time) };
            self.once(host, lent, what, "it made a light field", error)
        }
    }

    unsafe fn make_stack(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const abi::Time,
        data: *const Data,
        stack: *const StackSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        unsafe {
            let lent = Lent { data, stack, ..Lent::nothing() };
            let (params, display) = (text(params_json), text(display_json));
            let what = Call::MakeStack { params, display, time: time_of(time), data: data_of(data) };
            self.once(host, lent, what, "it made a layer stack", error)
        }
    }

    unsafe fn open(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        instance: *mut *mut c_void,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`; the host provides the place for the handle.
        unsafe {
            let owner = match self.start(&|| is_cancelled(host)) {
                Ok((owner, _)) => owner,
                Err(stopped) => return stopped.told(error),
            };
            let what = Call::Open { params: text(params_json), display: text(display_json) };
            let status = owner.call(host, Lent::nothing(), what, "it was opened", error);
            if status == Status::OK {
                *instance = Box::into_raw(Box::new(Opened { owner, host })).cast();
            }
            status
        }
    }

    unsafe fn submit(
        &self,
        instance: *mut c_void,
        time: *const abi::Time,
        data: *const Data,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`; the handle is that of `open`.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            let lent = Lent { data, ..Lent::nothing() };
            let what = Call::Submit { time: time_of(time), data: data_of(data) };
            let doing = format!("it took time {}", (*time).index);
            opened.owner.call(opened.host, lent, what, &doing, error)
        }
    }

    unsafe fn run(&self, instance: *mut c_void, error: *const ErrorSink) -> Status {
        // SAFETY: as in `submit`.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            opened.owner.call(opened.host, Lent::nothing(), Call::Run, "it presented", error)
        }
    }

    unsafe fn finish(&self, instance: *mut c_void, error: *const ErrorSink) -> Status {
        // SAFETY: as in `submit`.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            opened.owner.call(opened.host, Lent::nothing(), Call::Finish, "it finished", error)
        }
    }

    unsafe fn close(&self, instance: *mut c_void) {
        // SAFETY: as in `submit`, and the handle is given back once.
        unsafe {
            let Opened { owner, host } = *Box::from_raw(instance.cast::<Opened>());
            // one that has died said so in the call in which it did
            if owner.0.state().ended {
                return;
            }
            let mut reason = String::new();
            let status = owner.call(host, Lent::nothing(), Call::Close, "it was closed", &keeping(&mut reason));
            if status == Status::FAILED {
                ((*host).log)((*host).context, level::WARN, Str::new(&reason));
            }
        }
    }
}

/// What an output's handle points to.
struct Opened {
    owner: Owner,
    /// Valid until `close`.
    host: *const HostServices,
}

/// The only one who may end a session; its threads hold it, too.
struct Owner(Arc<Session>);

impl std::ops::Deref for Owner {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.0
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        // the table ends with the output; requests that use it have returned once the lock is here
        self.lent.write().unwrap_or_else(PoisonError::into_inner).clear();
        self.farewell();
    }
}

/// One child and the calls that it runs.
struct Session {
    /// Name of the library's file, for messages.
    library: String,
    limits: Limits,
    child: Mutex<Child>,
    /// `None` is the last.
    outgoing: Sender<Option<(ToChild, Vec<u8>)>>,
    state: Mutex<State>,
    lent: RwLock<HashMap<u64, Lent>>,
    /// The end of what the plugin printed, and whether it is all.
    said: Mutex<(Vec<u8>, bool)>,
}

struct State {
    /// Who waits for the library.
    loaded: Option<Sender<Loaded>>,
    /// Who waits for the end of a call.
    calls: HashMap<u64, Sender<(Status, String)>>,
    last_call: u64,
    /// Files that the plugin writes, by their handles.
    files: BTreeMap<u64, String>,
    last_sign: Instant,
    /// Requests that are being worked on, during which the child waits.
    requests: usize,
    /// It has ended, or must not be called any more.
    ended: bool,
}

impl State {
    fn new() -> Self {
        Self {
            loaded: None,
            calls: HashMap::new(),
            last_call: 0,
            files: BTreeMap::new(),
            last_sign: Instant::now(),
            requests: 0,
            ended: false,
        }
    }
}

/// What one call lends; null what it does not.
#[derive(Clone, Copy)]
struct Lent {
    host: *const HostServices,
    data: *const Data,
    assets: *const Assets,
    scene: *const ByteSink,
    field: *const FieldSink,
    stack: *const StackSink,
}

impl Lent {
    const fn nothing() -> Self {
        use std::ptr::null;
        Self { host: null(), data: null(), assets: null(), scene: null(), field: null(), stack: null() }
    }
}

// SAFETY: the boundary lets all of these be used from any thread; sinks for one at a time have their own locks.
unsafe impl Send for Lent {}
// SAFETY: as above.
unsafe impl Sync for Lent {}

/// The number under which the host's table is kept between `open` and `close`, when no call need be running.
const HOST: u64 = 0;

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    /// Runs a function of the plugin to its end.
    ///
    /// # Safety
    /// All that is lent is valid until this returns, and `host` until the output is closed; `error` is null or a valid
    /// sink.
    unsafe fn call(
        &self,
        host: *const HostServices,
        lent: Lent,
        what: Call,
        doing: &str,
        error: *const ErrorSink,
    ) -> Status {
        // a presentation lasts for as long as somebody looks
        let limit = if matches!(what, Call::Run) { None } else { self.limits.silence };
        let (done, waits) = channel();
        let call = {
            let mut state = self.state();
            state.last_call += 1;
            if !state.ended {
                let call = state.last_call;
                state.calls.insert(call, done);
                state.last_sign = Instant::now();
            }
            state.last_call
        };
        {
            let mut all = self.lent.write().unwrap_or_else(PoisonError::into_inner);
            all.insert(call, Lent { host, ..lent });
            all.insert(HOST, Lent { host, ..Lent::nothing() });
        }
        let _ = self.outgoing.send(Some((ToChild::Call { call, what }, Vec::new())));
        // SAFETY: the caller's promise.
        let result = self.wait(&waits, doing, limit, &|| unsafe { is_cancelled(host) });
        {
            // waits for requests that use it
            let mut all = self.lent.write().unwrap_or_else(PoisonError::into_inner);
            all.remove(&call);
        }
        self.state().calls.remove(&call);
        // SAFETY: the caller's promise.
        unsafe {
            match result {
                Ok((status, reason)) => {
                    tell(error, &reason);
                    status
                }
                Err(stopped) => stopped.told(error),
            }
        }
    }

    /// Waits for a message of the child.
    fn wait<T>(
        &self,
        message: &Receiver<T>,
        doing: &str,
        limit: Option<Duration>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<T, Stopped> {
        let (mut asked, mut gone) = (None::<Instant>, None::<Instant>);
        loop {
            match message.recv_timeout(TICK) {
                Ok(message) => return Ok(message),
                Err(RecvTimeoutError::Disconnected) => return Err(self.died(doing)),
                Err(RecvTimeoutError::Timeout) => {}
            }
            // where a process that it started holds the pipe, only this tells that it is gone; its last messages are
            // read before
            if matches!(locked(&self.child).try_wait(), Ok(Some(_))) {
                if gone.get_or_insert_with(Instant::now).elapsed() > LAST_WORDS {
                    return Err(self.died(doing));
                }
                continue;
            }
            if cancelled() && asked.get_or_insert_with(Instant::now).elapsed() > self.limits.grace {
                self.kill();
                return Err(Stopped::Cancelled);
            }
            let silence = {
                let state = self.state();
                if state.requests > 0 { Duration::ZERO } else { state.last_sign.elapsed() }
            };
            if limit.is_some_and(|limit| silence > limit) {
                let doing = self.doing(doing);
                self.kill();
                let (seconds, said) = (silence.as_secs_f64(), self.last_said());
                return Err(Stopped::Died(format!(
                    "its process ({}) gave no sign of life for {seconds:.0} s while {doing}, and was ended{said}",
                    self.library
                )));
            }
        }
    }

    /// What the child was busy with.
    fn doing(&self, call: &str) -> String {
        let state = self.state();
        let mut names: Vec<String> = state.files.values().take(NAMED).map(|name| format!("`{name}`")).collect();
        if state.files.len() > NAMED {
            names.push(format!("{} more", state.files.len() - NAMED));
        }
        if names.is_empty() { call.into() } else { format!("it wrote {}", names.join(", ")) }
    }

    /// The cause of a child's end, which is near.
    fn died(&self, doing: &str) -> Stopped {
        let doing = self.doing(doing);
        let deadline = Instant::now() + FAREWELL;
        let status = loop {
            match locked(&self.child).try_wait() {
                Ok(Some(status)) => break Some(status),
                Ok(None) if Instant::now() < deadline => {}
                _ => break None,
            }
            thread::sleep(Duration::from_millis(1));
        };
        self.kill();
        let cause = status.map_or_else(|| "broke off its connection to the program".into(), cause_of);
        Stopped::Died(format!("its process ({}) {cause} while {doing}{}", self.library, self.last_said()))
    }

    /// The last line that the plugin printed, once all of it has been read.
    fn last_said(&self) -> String {
        let deadline = Instant::now() + LAST_WORDS;
        while !locked(&self.said).1 && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        let said = locked(&self.said);
        let said = String::from_utf8_lossy(&said.0);
        let line = said.lines().map(str::trim).rfind(|line| !line.is_empty());
        line.map_or_else(String::new, |line| format!("; the last it said: {line}"))
    }

    /// Ends the child and what it started, at once.
    fn kill(&self) {
        self.state().ended = true;
        let mut child = locked(&self.child);
        if !matches!(child.try_wait(), Ok(Some(_))) {
            #[cfg(unix)]
            if let Some(group) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
                // it may have ended in between
                let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
            }
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Lets the child end by itself, which it does when its input ends; after a while, ends it.
    fn farewell(&self) {
        let _ = self.outgoing.send(None);
        let deadline = Instant::now() + FAREWELL;
        while Instant::now() < deadline {
            if !matches!(locked(&self.child).try_wait(), Ok(None)) {
                self.state().ended = true;
                return;
            }
            thread::sleep(Duration::from_millis(1));
        }
        self.kill();
    }

    /// Nothing more comes from the child.
    fn disconnected(&self) {
        let mut state = self.state();
        state.ended = true;
        // whoever waits is woken by the end of the channel
        state.calls.clear();
        state.loaded = None;
    }

    /// Reads what the plugin prints, shows it, and keeps the end of it.
    fn pass_on(&self, mut from: impl Read) {
        let mut part = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut part) {
            let _ = std::io::stderr().write_all(&part[..count]);
            let (kept, _) = &mut *locked(&self.said);
            kept.extend_from_slice(&part[..count]);
            let surplus = kept.len().saturating_sub(SAID);
            kept.drain(..surplus);
        }
        locked(&self.said).1 = true;
    }

    /// Takes a message of the child.
    fn take(self: &Arc<Self>, message: FromChild, body: Vec<u8>) {
        self.state().last_sign = Instant::now();
        match message {
            FromChild::Loaded(loaded) => {
                if let Some(waits) = self.state().loaded.take() {
                    let _ = waits.send(loaded);
                }
            }
            FromChild::Done { call, status, text } => {
                let waits = self.state().calls.remove(&call);
                if let Some(waits) = waits {
                    let _ = waits.send((Status(status), text));
                }
            }
            FromChild::Say(say) => {
                let all = self.lent.read().unwrap_or_else(PoisonError::into_inner);
                if let Some(lent) = all.get(&HOST) {
                    // SAFETY: the lock keeps the table.
                    unsafe { pass_on(&*lent.host, &say) };
                }
            }
            FromChild::Request { request, what } => {
                self.state().requests += 1;
                let session = self.clone();
                let work = move || {
                    let (answer, body) = session.answer(request, what, &body);
                    {
                        let mut state = session.state();
                        state.requests -= 1;
                        state.last_sign = Instant::now();
                    }
                    let _ = session.outgoing.send(Some((ToChild::Answer(answer), body)));
                };
                // what takes long, or what waits for a disk, must not keep the plugin's other threads waiting
                match what {
                    Request::Simulate { .. } | Request::ReadAsset { .. } | Request::FileCommit { .. } => {
                        thread::spawn(work);
                    }
                    _ => work(),
                }
            }
        }
    }

    /// Does what a request asks for.
    fn answer(&self, request: u64, what: Request, body: &[u8]) -> (Answer, Vec<u8>) {
        let mut answer = Answer { request, ..Answer::default() };
        let mut out = Vec::new();
        let all = self.lent.read().unwrap_or_else(PoisonError::into_inner);
        let Some(lent) = all.get(&HOST) else {
            (answer.status, answer.text) = (Status::FAILED.0, "the output is already closed".into());
            return (answer, out);
        };
        // SAFETY: the lock keeps the table.
        let host = unsafe { &*lent.host };
        let mut text = String::new();
        let error = keeping(&mut text);
        // SAFETY: what is found under the number of a call is lent for as long as it is found there, which the lock
        // keeps so; the other arguments are lent for the call.
        let status = unsafe { self.serve(host, &all, what, body, &mut answer, &mut out, &error) };
        answer.cancelled = {
            // SAFETY: as above.
            unsafe { is_cancelled(host) }
        };
        (answer.status, answer.text) = (status.0, text);
        (answer, out)
    }

    /// # Safety
    /// Tables and sinks of `all` and `host` are valid, and so is `error`.
    unsafe fn serve(
        &self,
        host: &HostServices,
        all: &HashMap<u64, Lent>,
        what: Request,
        body: &[u8],
        answer: &mut Answer,
        out: &mut Vec<u8>,
        error: *const ErrorSink,
    ) -> Status {
        let nothing = Lent::nothing();
        let of = |call: u64| all.get(&call).unwrap_or(&nothing);
        // SAFETY: the caller's promise.
        let refused = |reason: &str| unsafe {
            tell(error, reason);
            Status::REFUSED
        };
        let context = host.context;
        let path = Str { ptr: body.as_ptr(), len: body.len() };
        // SAFETY: the caller's promise, here and below.
        unsafe {
            match what {
                Request::IsCancelled => Status::OK,
                Request::FileOpen => {
                    let status = (host.file_open)(context, path, &mut answer.file, error);
                    if status == Status::OK {
                        self.state().files.insert(answer.file, String::from_utf8_lossy(body).into_owned());
                    }
                    status
                }
                Request::FileAppend { file } => (host.file_append)(context, file, Bytes::new(body), error),
                Request::FileCommit { file } => {
                    let status = (host.file_commit)(context, file, error);
                    self.state().files.remove(&file);
                    status
                }
                Request::FileAbort { file } => {
                    let status = (host.file_abort)(context, file, error);
                    self.state().files.remove(&file);
                    status
                }
                Request::LayerPlane { call, layer, frame } => match of(call).data.as_ref() {
                    Some(data) => {
                        fetch(answer, out, error, |plane| (data.layer_plane)(data.context, layer, frame, plane, error))
                    }
                    None => refused(GONE),
                },
                Request::EmissionPlane { call, frame, bin_y, bin_x } => match of(call).data.as_ref() {
                    Some(data) => fetch(answer, out, error, |plane| {
                        (data.emission_plane)(data.context, frame, bin_y, bin_x, plane, error)
                    }),
                    None => refused(GONE),
                },
                Request::ViewPlane { call, view_y, view_x } => match of(call).data.as_ref() {
                    Some(data) => {
                        fetch(answer, out, error, |plane| (data.view_plane)(data.context, view_y, view_x, plane, error))
                    }
                    None => refused(GONE),
                },
                Request::Simulate { call, kind, value_bits } => match of(call).data.as_ref() {
                    Some(data) => {
                        let view = View { size: size_of::<View>(), kind, value: value_bits.map(f64::from_bits) };
                        fetch(answer, out, error, |plane| (host.simulate)(context, data, &view, plane, error))
                    }
                    None => refused(GONE),
                },
                Request::ReadAsset { call } => match of(call).assets.as_ref() {
                    Some(assets) => {
                        let sink =
                            ByteSink { size: size_of::<ByteSink>(), context: (&raw mut *out).cast(), write: add };
                        (assets.read)(assets.context, path, &sink, error)
                    }
                    None => refused(GONE),
                },
                Request::GiveScene { call } => match of(call).scene.as_ref() {
                    Some(sink) => (sink.write)(sink.context, Bytes::new(body), error),
                    None => refused(GONE),
                },
                Request::GiveGeometry { call } => match of(call).field.as_ref() {
                    Some(sink) => (sink.geometry)(sink.context, path, error),
                    None => refused(GONE),
                },
                Request::GiveView { call, view_y, view_x, shape } => match of(call).field.as_ref() {
                    Some(sink) => {
                        given(body, shape, error, |plane| (sink.view_plane)(sink.context, view_y, view_x, plane, error))
                    }
                    None => refused(GONE),
                },
                Request::GiveBrightness { call, bits } => match of(call).stack.as_ref() {
                    Some(sink) => (sink.brightness)(sink.context, f64::from_bits(bits), error),
                    None => refused(GONE),
                },
                Request::GiveLayer { call, layer, frame, shape } => match of(call).stack.as_ref() {
                    Some(sink) => {
                        given(body, shape, error, |plane| (sink.layer_plane)(sink.context, layer, frame, plane, error))
                    }
                    None => refused(GONE),
                },
                Request::GiveEmission { call, frame, bin_y, bin_x, shape } => match of(call).stack.as_ref() {
                    Some(sink) => given(body, shape, error, |plane| {
                        (sink.emission_plane)(sink.context, frame, bin_y, bin_x, plane, error)
                    }),
                    None => refused(GONE),
                },
            }
        }
    }
}

/// What a plugin is told that uses something after the call that lent it.
const GONE: &str = "that was lent to a call which has returned";

/// Passes on a message.
///
/// # Safety
/// The table is valid.
unsafe fn pass_on(host: &HostServices, say: &Say) {
    let context = host.context;
    // SAFETY: the table's own context; the texts are lent for the call.
    unsafe {
        match say {
            Say::Log { level, message } => (host.log)(context, *level, Str::new(message)),
            Say::ProgressBegin { stage, total, unit } => {
                (host.progress_begin)(context, Str::new(stage), *total, Str::new(unit));
            }
            Say::ProgressAdvance { steps, note } => (host.progress_advance)(context, *steps, Str::new(note)),
            Say::ProgressEnd => (host.progress_end)(context),
        }
    }
}

/// Copies the plane that the host lends.
///
/// # Safety
/// `error` is a valid sink, and what `lend` fills in on success is a valid plane.
unsafe fn fetch(
    answer: &mut Answer,
    out: &mut Vec<u8>,
    error: *const ErrorSink,
    lend: impl FnOnce(*mut Plane) -> Status,
) -> Status {
    let mut plane = Plane::empty();
    let status = lend(&mut plane);
    if status != Status::OK {
        return status;
    }
    // SAFETY: the caller's promise; it is given back when the view is dropped.
    let view = match unsafe { PlaneView::new(plane) } {
        Ok(view) => view,
        Err(reason) => {
            // SAFETY: the caller's promise.
            unsafe { tell(error, &reason.to_string()) };
            return Status::FAILED;
        }
    };
    answer.shape = [view.rows(), view.cols(), view.channels()];
    let values = view.values();
    // SAFETY: any bytes of an `f32` are bytes.
    out.extend_from_slice(unsafe { std::slice::from_raw_parts(values.as_ptr().cast(), size_of_val(&*values)) });
    Status::OK
}

/// Hands a plane of the child to a sink.
///
/// # Safety
/// `error` is a valid sink.
unsafe fn given(
    body: &[u8],
    [rows, cols, channels]: [usize; 3],
    error: *const ErrorSink,
    take: impl FnOnce(*const Plane) -> Status,
) -> Status {
    let element = size_of::<f32>();
    let count = rows.checked_mul(cols).and_then(|count| count.checked_mul(channels));
    if count.and_then(|count| count.checked_mul(element)) != Some(body.len()) {
        // SAFETY: the caller's promise.
        unsafe { tell(error, &format!("a plane of shape {:?} in {} bytes", [rows, cols, channels], body.len())) };
        return Status::REFUSED;
    }
    // no overflow: the products are those of a plane that is there
    let strides = [cols * channels * element, channels * element, element, 0].map(|stride| stride as isize);
    let shape = [rows, cols, channels, 1];
    take(&Plane { data: body.as_ptr().cast(), dtype: dtype::F32, ndim: 3, shape, strides, ..Plane::empty() })
}

/// [`ByteSink::write`] into a vector.
unsafe extern "C" fn add(context: *mut c_void, bytes: Bytes, error: *const ErrorSink) -> Status {
    // SAFETY: the host lends the bytes; `context` is the vector of who made the sink and waits for the call.
    unsafe {
        match super::lent(bytes.ptr, bytes.len) {
            Some(bytes) => {
                (*context.cast::<Vec<u8>>()).extend_from_slice(bytes);
                Status::OK
            }
            None => {
                tell(error, "bytes nowhere");
                Status::REFUSED
            }
        }
    }
}

/// How a process ended, in words.
fn cause_of(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        // numbers that all systems share, and those of Linux
        let name = match signal {
            2 => " (interrupt)",
            3 => " (quit)",
            4 => " (illegal instruction)",
            5 => " (trap)",
            6 => " (abort)",
            8 => " (arithmetic error)",
            9 => " (kill, as of a system without memory)",
            11 => " (segmentation fault)",
            15 => " (termination)",
            7 if cfg!(target_os = "linux") => " (bus error)",
            31 if cfg!(target_os = "linux") => " (forbidden system call)",
            _ => "",
        };
        return format!("ended by signal {signal}{name}");
    }
    status.code().map_or_else(|| format!("ended with {status}"), |code| format!("ended itself with exit code {code}"))
}
