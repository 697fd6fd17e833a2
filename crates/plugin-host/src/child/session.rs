//! One child: started, called, watched and ended.
//!
//! Every child has three threads here: one writes what the program sends, one reads and does what the child asks for,
//! and one passes on what the plugin prints. Who called a function of the plugin waits for its end and meanwhile looks
//! whether the user wants to stop, whether the child is still there and whether it still says something. None of the
//! three threads is waited for where a call ends, since a process that the plugin started may hold the pipes open.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use lumistack_plugin::abi::{ErrorSink, HostServices, Status};
use lumistack_plugin::wire::tell;

use super::launch::{Launcher, Limits};
use super::protocol::{Call, FromChild, Loaded, Request, ToChild, read_frame, write_frame};
use super::requests::{HOST, Lending, Lent, is_cancelled, pass_on};

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

/// Why a call did not come to its end.
pub(super) enum Stopped {
    /// The user asked to stop, and the child was ended where it did not.
    Cancelled,
    /// The child ended, or had to be ended: why.
    Died(String),
}

/// The only one who may end a session; its threads hold it, too.
pub(super) struct Owner(pub(super) Arc<Session>);

impl Owner {
    /// Starts a child and waits until it has loaded the library.
    pub(super) fn start(
        library: &Path,
        id: &str,
        launcher: &Launcher,
        limits: Limits,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<(Self, Loaded), Stopped> {
        let Launcher { program, args } = launcher;
        let mut command = Command::new(program);
        command.args(args).arg(library).arg(id);
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
            library: library.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            limits,
            child: Mutex::new(child),
            outgoing,
            state: Mutex::new(State { last_sign: Instant::now(), ..State::new() }),
            lending: Lending::default(),
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
        let owner = Self(session);
        let loaded = owner.wait(&waits, "it was loaded", limits.load, cancelled)?;
        Ok((owner, loaded))
    }
}

impl std::ops::Deref for Owner {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.0
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        // the table ends with the output; requests that use it have returned once the lock is here
        self.lending.all_mut().clear();
        self.farewell();
    }
}

/// One child and the calls that it runs.
pub(super) struct Session {
    /// Name of the library's file, for messages.
    library: String,
    limits: Limits,
    child: Mutex<Child>,
    /// `None` is the last.
    outgoing: Sender<Option<(ToChild, Vec<u8>)>>,
    state: Mutex<State>,
    /// What its running calls lend.
    lending: Lending,
    /// The end of what the plugin printed, and whether it is all.
    said: Mutex<(Vec<u8>, bool)>,
}

pub(super) struct State {
    /// Who waits for the library.
    loaded: Option<Sender<Loaded>>,
    /// Who waits for the end of a call.
    calls: HashMap<u64, Sender<(Status, String)>>,
    last_call: u64,
    last_sign: Instant,
    /// Requests that are being worked on, during which the child waits.
    requests: usize,
    /// It has ended, or must not be called any more.
    pub(super) ended: bool,
}

impl State {
    fn new() -> Self {
        Self { loaded: None, calls: HashMap::new(), last_call: 0, last_sign: Instant::now(), requests: 0, ended: false }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    /// Runs a function of the plugin to its end.
    ///
    /// # Safety
    /// All that is lent is valid until this returns, and `host` until the output is closed; `error` is null or a valid
    /// sink.
    pub(super) unsafe fn call(
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
            let mut all = self.lending.all_mut();
            all.insert(call, Lent { host, ..lent });
            all.insert(HOST, Lent { host, ..Lent::nothing() });
        }
        let _ = self.outgoing.send(Some((ToChild::Call { call, what }, Vec::new())));
        // SAFETY: the caller's promise.
        let result = self.wait(&waits, doing, limit, &|| unsafe { is_cancelled(host) });
        {
            // waits for requests that use it
            let mut all = self.lending.all_mut();
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
        let files = self.lending.files();
        let mut names: Vec<String> = files.values().take(NAMED).map(|name| format!("`{name}`")).collect();
        if files.len() > NAMED {
            names.push(format!("{} more", files.len() - NAMED));
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
                let all = self.lending.all();
                if let Some(lent) = all.get(&HOST) {
                    // SAFETY: the lock keeps the table.
                    unsafe { pass_on(&*lent.host, &say) };
                }
            }
            FromChild::Request { request, what } => {
                self.state().requests += 1;
                let session = self.clone();
                let work = move || {
                    let (answer, body) = session.lending.answer(request, what, &body);
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
}

impl Stopped {
    /// # Safety
    /// `error` is null or a valid sink.
    pub(super) unsafe fn told(self, error: *const ErrorSink) -> Status {
        let (text, status) = match self {
            Self::Cancelled => ("cancelled".to_owned(), Status::CANCELLED),
            Self::Died(cause) => (cause, Status::FAILED),
        };
        // SAFETY: the caller's promise.
        unsafe { tell(error, &text) };
        status
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
