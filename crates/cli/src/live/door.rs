//! A socket through which another program attaches to a running display.
//!
//! ```text
//! RUN/cache/live.json   {"port": PORT, "token": WORD}, readable by this user alone
//! program ──▶ {"token": WORD}, then commands in lines, as on standard input
//!         ◀── {"event": "attached"}, then events in lines, as on standard output with --json
//! ```
//!
//! The socket listens on the loopback interface. Only one program at a time can be attached. When
//! the program has sent its last line, it is detached, and the display keeps its state.

use std::io::{self, BufReader, Cursor, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use lumistack_pipeline::PipelineError;
use serde_json::{Value, json};

use super::clock::now;
use super::control::follow_lines;
use super::requests::{Requests, lock};
use crate::console::say;

/// Time limit for the first line, which has the token.
const FIRST_TIME: Duration = Duration::from_secs(1);
/// Largest length of the first line, bytes.
const FIRST: usize = 1 << 10;
/// Time limit for a program to read an event. A slower program is detached, since the solver waits
/// until the event is read.
const WRITE_TIME: Duration = Duration::from_secs(1);
/// Interval at which the socket is checked for a program.
const TICK: Duration = Duration::from_millis(20);

/// Sends events to standard output with `--json`, and to the attached program.
pub(super) struct Events {
    json: bool,
    attached: Mutex<Attached>,
}

#[derive(Default)]
struct Attached {
    program: Option<TcpStream>,
    /// Number of programs that have been attached.
    number: u64,
    /// The last events `serving` and `state`, which the next program receives after `attached`.
    last: [Option<Value>; 2],
}

impl Events {
    pub(super) fn new(json: bool) -> Self {
        Self { json, attached: Mutex::default() }
    }

    /// Sends an event to the attached program, and with `--json` also to standard output.
    pub(super) fn say(&self, event: &Value) {
        if self.json {
            say!("{event}");
        }
        self.send(event);
    }

    /// Sends an event to the attached program.
    pub(super) fn send(&self, event: &Value) {
        let mut attached = lock(&self.attached);
        if let Some(kind) = ["serving", "state"].iter().position(|kind| event["event"] == *kind) {
            attached.last[kind] = Some(event.clone());
        }
        if let Some(program) = &attached.program
            && write_line(program, event).is_err()
        {
            attached.end();
        }
    }

    /// Attaches a program and returns its number; `None` if another program is attached.
    fn attach(&self, program: &TcpStream) -> io::Result<Option<u64>> {
        let mut attached = lock(&self.attached);
        if attached.program.is_some() {
            return Ok(None);
        }
        write_line(program, &json!({"event": "attached"}))?;
        attached.last.iter().flatten().try_for_each(|event| write_line(program, event))?;
        attached.program = Some(program.try_clone()?);
        attached.number += 1;
        Ok(Some(attached.number))
    }

    /// Detaches the program. Call this function after the last event.
    pub(super) fn end(&self) {
        lock(&self.attached).end();
    }

    /// Detaches a program. Has no effect if a later program is attached.
    fn detach(&self, number: u64) {
        let mut attached = lock(&self.attached);
        if attached.number == number {
            attached.end();
        }
    }
}

impl Attached {
    fn end(&mut self) {
        if let Some(program) = self.program.take() {
            let _ = program.shutdown(Shutdown::Both);
        }
    }
}

fn write_line(mut program: &TcpStream, event: &Value) -> io::Result<()> {
    program.write_all(format!("{event}\n").as_bytes())
}

fn refused(message: &str) -> Value {
    json!({"event": "refused", "message": message})
}

/// The socket, and the file that states its port and token.
pub(super) struct Door {
    listener: TcpListener,
    token: String,
    path: PathBuf,
}

impl Door {
    /// Opens the socket, and writes its file into a folder.
    ///
    /// # Errors
    /// If the system has no free port or no random numbers, or the file cannot be written.
    pub(super) fn open(cache: &Path) -> Result<Self, PipelineError> {
        let path = cache.join("live.json");
        let token = random_word()?;
        let write = || {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
            // calls of `accept` must not block, so that the thread notices when the display stops
            listener.set_nonblocking(true)?;
            let port = listener.local_addr()?.port();
            // `tempfile` makes files that only this user can read
            let mut file = tempfile::NamedTempFile::new_in(cache)?;
            writeln!(file, "{}", json!({"port": port, "token": token}))?;
            file.persist(&path).map_err(|error| error.error)?;
            Ok(listener)
        };
        let listener = write().map_err(PipelineError::write(&path))?;
        Ok(Self { listener, token, path })
    }

    /// Attaches programs until the display stops.
    pub(super) fn attend(&self, requests: &Arc<Requests>, events: &Arc<Events>) {
        while !requests.is_stopped() {
            match self.listener.accept() {
                // an error of a connection ends this connection only
                Ok((program, _)) => drop(self.greet(&program, requests, events)),
                Err(_) => std::thread::sleep(TICK),
            }
        }
    }

    /// Attaches the program if its first line has the token and no other program is attached.
    /// Otherwise sends the program one message. If no line arrives in time, sends nothing.
    fn greet(&self, program: &TcpStream, requests: &Arc<Requests>, events: &Arc<Events>) -> io::Result<()> {
        // on some systems, a connection inherits the non-blocking mode of the listening socket
        program.set_nonblocking(false)?;
        program.set_write_timeout(Some(WRITE_TIME))?;
        program.set_nodelay(true)?;
        let (first, rest) = first_line(program)?;
        let first: Value = serde_json::from_slice(&first).unwrap_or_default();
        if first["token"] != *self.token {
            let text = format!(
                "token: expected the first line {{\"token\": TOKEN}} with the token of {}",
                self.path.display()
            );
            return write_line(program, &refused(&format!("{text}, found another line")));
        }
        let Some(number) = events.attach(program)? else {
            return write_line(program, &refused("a program is attached already; only one program can be attached"));
        };
        program.set_read_timeout(None)?;
        let lines = BufReader::new(Cursor::new(rest).chain(program.try_clone()?));
        let (requests, events) = (requests.clone(), events.clone());
        // a thread that waits for a line cannot be ended, so it is detached
        std::thread::spawn(move || {
            follow_lines(lines, &requests, |error| events.send(&refused(&error)));
            // when the display stops, the program stays attached until it has received the last
            // event
            if !requests.is_stopped() {
                events.detach(number);
            }
        });
        Ok(())
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Reads the first line that a program sends, and the bytes that arrived after this line.
fn first_line(mut program: &TcpStream) -> io::Result<(Vec<u8>, Vec<u8>)> {
    let deadline = now() + FIRST_TIME;
    let (mut line, mut part) = (Vec::new(), [0; FIRST]);
    loop {
        // after the deadline the timeout is 0, which is an error and ends this function
        program.set_read_timeout(Some(deadline.saturating_sub(now())))?;
        let count = program.read(&mut part)?;
        line.extend_from_slice(&part[..count]);
        if let Some(end) = line.iter().position(|byte| *byte == b'\n') {
            let rest = line.split_off(end + 1);
            return Ok((line, rest));
        }
        if count == 0 || line.len() > FIRST {
            return Ok((line, Vec::new()));
        }
    }
}

/// Returns a random secret of 32 characters.
///
/// # Errors
/// If the system has no random numbers.
pub(super) fn random_word() -> Result<String, PipelineError> {
    let mut random = [0; 16];
    getrandom::fill(&mut random)
        .map_err(|error| PipelineError::option("live", "page", "random numbers of the system", error.to_string()))?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use std::io::BufRead;

    use super::*;

    fn pair() -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let there = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (here, _) = listener.accept().unwrap();
        here.set_write_timeout(Some(WRITE_TIME)).unwrap();
        (here, there)
    }

    #[test]
    fn a_program_receives_the_last_state_first_and_later_ones_after_it() {
        let events = Events::new(false);
        let state = |number: u32| json!({"event": "state", "number": number});
        events.say(&state(1));
        events.say(&json!({"event": "serving", "address": "there"}));
        events.say(&state(2));
        let (here, there) = pair();
        assert_eq!(events.attach(&here).unwrap(), Some(1));
        // a second program is refused while the first one is attached
        assert_eq!(events.attach(&pair().0).unwrap(), None);
        events.say(&state(3));
        events.detach(7);
        events.say(&state(4));
        events.detach(1);
        events.say(&state(5));
        drop(here);
        let lines: Vec<Value> =
            BufReader::new(there).lines().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).collect();
        let expected = [json!({"event": "attached"}), json!({"event": "serving", "address": "there"})];
        assert_eq!(lines[..2], expected);
        assert_eq!(lines[2..], [state(2), state(3), state(4)]);
        assert_eq!(events.attach(&pair().0).unwrap(), Some(2));
    }

    #[test]
    fn a_program_that_does_not_read_is_detached_and_delays_the_display_once() {
        let events = Events::new(false);
        let (here, _there) = pair();
        events.attach(&here).unwrap();
        let begun = now();
        for _ in 0..64 {
            events.say(&json!({"event": "state", "filling": "x".repeat(1 << 20)}));
        }
        let took = now() - begun;
        assert!(took >= WRITE_TIME && took < 5 * WRITE_TIME, "{took:?}");
        assert_eq!(events.attach(&pair().0).unwrap(), Some(2));
    }
}
