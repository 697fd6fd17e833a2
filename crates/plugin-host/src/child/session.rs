//! The session of a child process: its start, its calls, its supervision and its end.
//!
//! Every child has three threads in the program. One writes messages, one reads messages and serves
//! requests, and one forwards the plugin's prints. Requests that may take long run in threads of
//! their own. The caller of a plugin function waits for the function's end. Meanwhile the caller
//! checks for cancellation, for the child's exit, and for a child that gives no sign of life. No
//! call joins the threads, since a process started by the plugin may hold the pipes open.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use lumistack_plugin::abi::{ErrorSink, HostServices, Status};
use lumistack_plugin::wire::write_error;

use super::launch::{Launcher, Limits};
use super::protocol::{Call, FromChild, Loaded, Request, ToChild, read_frame, write_frame};
use super::requests::{HOST, Lending, Lent, forward, is_cancelled};

/// Interval of the checks during a wait.
const TICK: Duration = Duration::from_millis(20);
/// Time in which a child must end after its input was closed.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);
/// Time to read the last messages and prints of a child that has ended.
const DRAIN_TIMEOUT: Duration = Duration::from_millis(300);
/// Number of bytes kept, for error messages, from the end of the text that the plugin prints.
const KEPT_BYTES: usize = 16 << 10;
/// Largest number of files that an error message names.
const MAX_FILES: usize = 3;
/// Flag of Windows for a process that ignores the Ctrl-C of its console.
#[cfg(windows)]
const CREATE_NEW_PROCESS_GROUP: u32 = 0x200;

/// The reason why a call did not complete.
pub(super) enum Stopped {
    /// The user cancelled. The call did not end in time, so the child was killed.
    Cancelled,
    /// The child could not be started, could not load the library, ended, or was ended, for this
    /// reason.
    Died(String),
}

/// The owner of a session, which ends the session on drop. The session's threads hold references to
/// the session, not to the owner.
pub(super) struct Owner(pub(super) Arc<Session>);

impl Owner {
    /// Starts a child and waits for the result of loading the library.
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
        // Ctrl-C signals all processes of the terminal's foreground group. The plugin is cancelled
        // through the host instead, so its process gets a group of its own.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        #[cfg(windows)]
        std::os::windows::process::CommandExt::creation_flags(&mut command, CREATE_NEW_PROCESS_GROUP);
        let mut child = command.spawn().map_err(|error| {
            Stopped::Died(format!("cannot start {}, the program that runs the plugin: {error}", program.display()))
        })?;
        let (input, output, errors) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(mut input), Some(mut output), Some(errors)) = (input, output, errors) else {
            unreachable!("all three are piped")
        };
        #[cfg(target_os = "linux")]
        for pipe in [std::os::fd::AsFd::as_fd(&input), std::os::fd::AsFd::as_fd(&output)] {
            // A larger pipe is faster. If the system refuses it, the pipe keeps its size.
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
            printed: Mutex::default(),
        });
        let (loaded, waits) = channel();
        session.state().loaded = Some(loaded);
        thread::spawn(move || {
            // When this thread ends, it closes the pipe, which ends an idle child.
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
        thread::spawn(move || listener.forward_prints(errors));
        let owner = Self(session);
        let loaded = owner.wait(&waits, "the library was loaded", limits.load, cancelled)?;
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
        // From here, the plugin must not use the objects that the host has lent. `all_mut` waits
        // until no request uses these objects; then they are removed.
        self.lending.all_mut().clear();
        self.shut_down();
    }
}

/// A child and its running calls.
pub(super) struct Session {
    /// Name of the library's file, for messages.
    library: String,
    limits: Limits,
    child: Mutex<Child>,
    /// Messages for the child; `None` closes its input.
    outgoing: Sender<Option<(ToChild, Vec<u8>)>>,
    state: Mutex<State>,
    /// Objects lent to the child's running calls.
    lending: Lending,
    /// The last bytes that the plugin printed; and true once the child's standard error is closed.
    printed: Mutex<(Vec<u8>, bool)>,
}

pub(super) struct State {
    /// Channel for the result of loading the library.
    loaded: Option<Sender<Loaded>>,
    /// Channels for the results of running calls, by call number.
    calls: HashMap<u64, Sender<(Status, String)>>,
    last_call: u64,
    last_sign: Instant,
    /// Number of requests that are being served. Meanwhile the child waits, so its silence is no
    /// fault.
    requests: usize,
    /// True if the child has ended, or must not be called any more.
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
    /// All borrowed arguments are valid until this returns, and `host` until the output is closed;
    /// `error` is null or a valid sink.
    pub(super) unsafe fn call(
        &self,
        host: *const HostServices,
        lent: Lent,
        what: Call,
        doing: &str,
        error: *const ErrorSink,
    ) -> Status {
        // A presentation runs until the user closes it, so it has no time limit.
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
        // SAFETY: guaranteed by the caller.
        let result = self.wait(&waits, doing, limit, &|| unsafe { is_cancelled(host) });
        {
            // Requests that use the lent objects hold the lock, so `all_mut` waits for these
            // requests.
            let mut all = self.lending.all_mut();
            all.remove(&call);
        }
        self.state().calls.remove(&call);
        // SAFETY: guaranteed by the caller.
        unsafe {
            match result {
                Ok((status, reason)) => {
                    write_error(error, &reason);
                    status
                }
                Err(stopped) => stopped.report(error),
            }
        }
    }

    /// Waits for a message of the child. Fails if the child ends, if it gives no sign of life for
    /// `limit`, or if it must be killed after a cancellation.
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
            // A process that the child started may hold the pipe open. Then only the exit status
            // shows that the child has ended. The failure is returned after `DRAIN_TIMEOUT`, so
            // that the child's last messages are read.
            if matches!(locked(&self.child).try_wait(), Ok(Some(_))) {
                if gone.get_or_insert_with(Instant::now).elapsed() > DRAIN_TIMEOUT {
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
                let (seconds, printed) = (silence.as_secs_f64(), self.last_printed());
                return Err(Stopped::Died(format!(
                    "the plugin's process ({}) gave no sign of life for {seconds:.0} s while {doing}, and was ended{printed}",
                    self.library
                )));
            }
        }
    }

    /// Describes the child's current operation for error messages: the files that it writes, or
    /// else the call.
    fn doing(&self, call: &str) -> String {
        let files = self.lending.files();
        let mut names: Vec<String> = files.values().take(MAX_FILES).map(|name| format!("`{name}`")).collect();
        if files.len() > MAX_FILES {
            names.push(format!("{} more", files.len() - MAX_FILES));
        }
        if names.is_empty() { call.into() } else { format!("the plugin wrote {}", names.join(", ")) }
    }

    /// Waits for the exit status of a child that has ended or closed its connection, and returns
    /// the cause of the end.
    fn died(&self, doing: &str) -> Stopped {
        let doing = self.doing(doing);
        let deadline = Instant::now() + EXIT_TIMEOUT;
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
        Stopped::Died(format!("the plugin's process ({}) {cause} while {doing}{}", self.library, self.last_printed()))
    }

    /// Returns the end of an error message, with the last line that the plugin printed; empty if it
    /// printed none. Waits until all prints were read, for at most `DRAIN_TIMEOUT`.
    fn last_printed(&self) -> String {
        let deadline = Instant::now() + DRAIN_TIMEOUT;
        while !locked(&self.printed).1 && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        let printed = locked(&self.printed);
        let printed = String::from_utf8_lossy(&printed.0);
        let line = printed.lines().map(str::trim).rfind(|line| !line.is_empty());
        line.map_or_else(String::new, |line| format!("; the last line that the process printed: {line}"))
    }

    /// Kills the child, and on Unix its process group, unless the child has already ended.
    fn kill(&self) {
        self.state().ended = true;
        let mut child = locked(&self.child);
        if !matches!(child.try_wait(), Ok(Some(_))) {
            #[cfg(unix)]
            if let Some(group) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
                // Ignore the error, since the process group may have ended in the meantime.
                let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
            }
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Closes the child's input, so that the child ends itself; kills the child after a timeout.
    fn shut_down(&self) {
        let _ = self.outgoing.send(None);
        let deadline = Instant::now() + EXIT_TIMEOUT;
        while Instant::now() < deadline {
            if !matches!(locked(&self.child).try_wait(), Ok(None)) {
                self.state().ended = true;
                return;
            }
            thread::sleep(Duration::from_millis(1));
        }
        self.kill();
    }

    /// Marks the child as ended after its last message, and wakes all waiting callers.
    fn disconnected(&self) {
        let mut state = self.state();
        state.ended = true;
        // Dropping the channels wakes the callers that wait on them.
        state.calls.clear();
        state.loaded = None;
    }

    /// Reads the plugin's prints, forwards them, and keeps the last bytes.
    fn forward_prints(&self, mut from: impl Read) {
        let mut part = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut part) {
            let _ = std::io::stderr().write_all(&part[..count]);
            let (kept, _) = &mut *locked(&self.printed);
            kept.extend_from_slice(&part[..count]);
            let surplus = kept.len().saturating_sub(KEPT_BYTES);
            kept.drain(..surplus);
        }
        locked(&self.printed).1 = true;
    }

    /// Handles a message of the child.
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
                    // SAFETY: the lock keeps the table alive.
                    unsafe { forward(&*lent.host, &say) };
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
                // Simulations, and reads and commits of files, may take long. Each runs in its own
                // thread, so that other threads of the plugin proceed.
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
    pub(super) unsafe fn report(self, error: *const ErrorSink) -> Status {
        let (text, status) = match self {
            Self::Cancelled => ("cancelled".to_owned(), Status::CANCELLED),
            Self::Died(cause) => (cause, Status::FAILED),
        };
        // SAFETY: guaranteed by the caller.
        unsafe { write_error(error, &text) };
        status
    }
}

/// Describes the exit status of a process.
fn cause_of(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        // The names of the signals 7 and 31 are those of Linux. The other names hold on every Unix
        // system.
        let name = match signal {
            2 => " (interrupt)",
            3 => " (quit)",
            4 => " (illegal instruction)",
            5 => " (trap)",
            6 => " (abort)",
            8 => " (arithmetic error)",
            9 => " (kill; the system may have run out of memory)",
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
