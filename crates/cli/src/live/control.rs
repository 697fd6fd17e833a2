//! Commands on standard input, one JSON object per line, and head positions by UDP.

use std::io::BufRead;
use std::net::UdpSocket;

use lumistack_core::Task;
use lumistack_live::{Eyes, head_of_packet};
use serde_json::{Map, Value, json};

use super::requests::Requests;
use crate::console::{say, tell};

/// Largest length of a line, bytes.
const LINE: usize = 1 << 20;

/// A command that a line contains.
#[derive(Clone, Debug, PartialEq)]
enum Command {
    Set(Vec<(String, Value)>),
    Viewers(Vec<[f64; 3]>),
    Reload,
    Stop,
    StopAtEnd,
}

/// Executes commands until standard input ends or the display stops. Wrong commands are reported
/// and change nothing.
pub(super) fn read_commands(lines: impl BufRead, requests: &Requests, json: bool) {
    follow_lines(lines, requests, |error| match json {
        true => say!("{}", json!({"event": "refused", "message": error})),
        false => tell!("warning: standard input: {error}"),
    });
    requests.end_of_input();
}

/// Executes commands until the lines end or the display stops. Passes the errors of wrong commands
/// to `refuse`.
pub(super) fn follow_lines(mut lines: impl BufRead, requests: &Requests, refuse: impl Fn(String)) {
    let mut line = Vec::new();
    while !requests.is_stopped() {
        line.clear();
        match std::io::Read::take(&mut lines, LINE as u64).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(LINE) if !line.ends_with(b"\n") => {
                refuse(format!("expected at most {LINE} bytes on one line, found a longer line"));
                if lines.skip_until(b'\n').is_err() {
                    return;
                }
                continue;
            }
            Ok(_) => {}
        }
        let text = String::from_utf8_lossy(&line);
        if text.trim().is_empty() {
            continue;
        }
        if let Err(error) = carry_out(&text, requests) {
            refuse(error);
        }
    }
}

fn carry_out(line: &str, requests: &Requests) -> Result<(), String> {
    // Parse the whole line first, so that a line which cannot be parsed changes nothing.
    for command in commands_of(line)? {
        match command {
            Command::Set(keys) => requests.set(&keys).map_err(|error| error.to_string())?,
            Command::Viewers(heads_mm) => requests.see(&heads_mm, Eyes::Two).map_err(|error| error.to_string())?,
            Command::Reload => requests.reload(),
            Command::Stop => requests.stop(),
            Command::StopAtEnd => requests.stop_at_end(),
        }
    }
    Ok(())
}

fn commands_of(line: &str) -> Result<Vec<Command>, String> {
    const EXPECTED: &str = "an object with `set`, `time`, `viewers`, `reload`, `stop` or `stop_at_end`";
    let all: Map<String, Value> = serde_json::from_str(line)
        .map_err(|error| format!("expected {EXPECTED} on one line, found a line that is no JSON object: {error}"))?;
    if all.is_empty() {
        return Err(format!("expected {EXPECTED}, found an empty object"));
    }
    let one = |(name, value): (String, Value)| {
        let wrong = |expected: &str, value: &Value| Err(format!("{name}: expected {expected}, found {value}"));
        match (name.as_str(), value) {
            ("set", Value::Object(keys)) => Ok(Command::Set(keys.into_iter().collect())),
            ("set", value) => wrong("an object of keys of the job and their values", &value),
            ("time", value) if value.is_number() || value.is_null() => {
                Ok(Command::Set(vec![("pose.time_s".into(), value)]))
            }
            ("time", value) => wrong("seconds, or null for the default pose of the scene", &value),
            ("viewers", value) => match serde_json::from_value(value.clone()) {
                Ok(heads_mm) => Ok(Command::Viewers(heads_mm)),
                Err(_) => wrong("a list of positions [x, y, z] in millimetres", &value),
            },
            ("reload", Value::Bool(true)) => Ok(Command::Reload),
            ("stop", Value::Bool(true)) => Ok(Command::Stop),
            ("stop_at_end", Value::Bool(true)) => Ok(Command::StopAtEnd),
            ("reload" | "stop" | "stop_at_end", value) => wrong("true", &value),
            (name, _) => Err(format!("expected {EXPECTED}, found `{name}`")),
        }
    };
    all.into_iter().map(one).collect()
}

/// Follows a head by OpenTrack's packets until the display stops.
pub(super) fn read_packets(socket: &UdpSocket, centre_mm: [f64; 3], requests: &Requests, task: Task<'_>) {
    let mut packet = [0; 512];
    while !(requests.is_stopped() || task.cancel.is_cancelled()) {
        // The socket has a timeout, so that the loop notices when the display stops.
        let Ok(length) = socket.recv(&mut packet) else { continue };
        let seen = head_of_packet(&packet[..length], centre_mm).and_then(|head_mm| requests.see(&[head_mm], Eyes::Two));
        if let Err(error) = seen {
            task.warn("--opentrack", error.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use lumistack_pipeline::{DisplayJob, Job};

    use super::*;

    fn requests() -> Requests {
        Requests::new(Job { scene: Some("a.glb".into()), ..Job::new(DisplayJob::by_name_or_path("fig7-uniform")) })
    }

    #[test]
    fn lines_become_requests_and_wrong_lines_change_nothing() {
        let requests = requests();
        let lines = "{\"set\": {\"display.brightness\": 0.3, \"display.frames\": 2}}\n\n{\"time\": 1.5, \"viewers\": [[10, 0, 600]]}\n\
                     {\"set\": {\"display.frames\": 4, \"display.brightness\": 7}}\n";
        read_commands(lines.as_bytes(), &requests, false);
        let (number, request) = requests.newest.after(0).unwrap();
        let display = &request.job.display;
        assert_eq!(
            (number, display.brightness, display.frames, request.job.pose.time_s),
            (2, Some(0.3), Some(2), Some(1.5))
        );
        assert_eq!(requests.job(), request.job);
        // Keys that commands have set keep their values when the job file changes.
        let mut other = self::requests().job();
        other.seed = 9;
        requests.replace(other).unwrap();
        assert_eq!((requests.job().seed, requests.job().display.frames), (9, Some(2)));
        assert!(!requests.is_stopped());
        carry_out("{\"stop\": true}", &requests).unwrap();
        assert!(requests.is_stopped());
    }

    /// A line that is too long is refused as a whole, and later lines are executed.
    #[test]
    fn long_lines_are_refused_once() {
        let requests = requests();
        for excess in [0, 1, 2 * LINE] {
            let errors = std::cell::RefCell::new(Vec::new());
            let blanks = " ".repeat(LINE - "{\"time\": 2}\n".len() + excess);
            let lines = format!("{{\"time\": 2{blanks}}}\n{{\"time\": 1}}\n");
            requests.set(&[("pose.time_s".into(), json!(0.0))]).unwrap();
            let (before, _) = requests.newest.after(0).unwrap();
            follow_lines(lines.as_bytes(), &requests, |error| errors.borrow_mut().push(error));
            let (number, request) = requests.newest.after(0).unwrap();
            let refused = usize::from(excess > 0);
            assert_eq!((number - before, request.job.pose.time_s), (2 - refused as u64, Some(1.0)));
            assert_eq!(
                errors.into_inner(),
                vec!["expected at most 1048576 bytes on one line, found a longer line"; refused]
            );
        }
    }

    #[test]
    fn the_end_of_the_input_stops_the_display_only_on_request() {
        for (lines, stops) in [("{\"time\": 1}\n", false), ("{\"stop_at_end\": true}\n{\"time\": 1}\n", true)] {
            let requests = requests();
            read_commands(lines.as_bytes(), &requests, false);
            assert_eq!((requests.is_stopped(), requests.job().pose.time_s), (stops, Some(1.0)), "{lines}");
        }
    }

    #[test]
    fn errors_state_the_expected_line() {
        for (line, message) in [
            ("[]", "expected an object with `set`, `time`, `viewers`, `reload`, `stop` or `stop_at_end` on one line"),
            ("{}", "found an empty object"),
            ("{\"sett\": {}}", "found `sett`"),
            ("{\"set\": 3}", "set: expected an object of keys"),
            ("{\"time\": \"now\"}", "time: expected seconds"),
            ("{\"viewers\": [[1, 2]]}", "viewers: expected a list of positions [x, y, z]"),
            ("{\"viewers\": [[0, 0, -5]]}", "viewer: expected three finite numbers"),
            ("{\"stop\": false}", "stop: expected true"),
            ("{\"stop_at_end\": 1}", "stop_at_end: expected true"),
            ("{\"set\": {\"display.bright\": 1}}", "did you mean `brightness`?"),
        ] {
            let error = carry_out(line, &requests()).unwrap_err();
            assert!(error.contains(message), "{line}: {error}");
        }
    }
}
