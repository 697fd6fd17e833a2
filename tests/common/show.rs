//! `lumistack show` as a child process that receives commands and reports events.

#![allow(dead_code, reason = "every test file uses a part of this")]

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::session::{Session, wait_for};

/// A process `lumistack show` in a session.
pub struct Show {
    pub child: Child,
    stdin: Option<ChildStdin>,
    events: Receiver<Value>,
}

impl Show {
    pub fn start(session: &Session, run: &Path, options: &[&str]) -> Self {
        let mut command = session.command(env!("CARGO_BIN_EXE_lumistack"));
        command.args(["--json", "show"]).arg(run).args(["--control"]).args(options);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (send, events) = channel();
        let lines = BufReader::new(child.stdout.take().unwrap() as ChildStdout).lines();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let _ = send.send(serde_json::from_str(&line).unwrap_or(Value::String(line)));
            }
        });
        let stdin = child.stdin.take();
        Self { child, stdin, events }
    }

    pub fn tell(&mut self, line: &str) {
        let _ = writeln!(self.stdin.as_mut().unwrap(), "{line}");
    }

    /// Waits for the next event with this name, and returns it.
    pub fn event(&mut self, name: &str) -> Value {
        let end = Instant::now() + Duration::from_secs(30);
        while Instant::now() < end {
            match self.events.recv_timeout(Duration::from_millis(100)) {
                Ok(event) if event["event"] == name => return event,
                Ok(_) => {}
                Err(_) => {
                    if let Ok(Some(status)) = self.child.try_wait() {
                        panic!("ended with {status} before `{name}`: {}", self.errors());
                    }
                }
            }
        }
        panic!("no event `{name}`");
    }

    fn errors(&mut self) -> String {
        let mut text = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            let _ = std::io::Read::read_to_string(&mut stderr, &mut text);
        }
        text
    }

    /// Waits until the program ends. Returns its exit status and its standard error.
    pub fn ended(&mut self) -> (ExitStatus, String) {
        let status = wait_for("the end", || self.child.try_wait().unwrap());
        (status, self.errors())
    }

    /// Ends the program by its command `quit`, and returns its report.
    pub fn quit(mut self) -> Value {
        self.tell("quit");
        let report = self.event("report");
        let (status, errors) = self.ended();
        assert!(status.success(), "{status}: {errors}");
        report
    }
}

impl Drop for Show {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
