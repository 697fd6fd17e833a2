//! Commands on standard input, one JSON object per line, and head positions by UDP.

use std::io::BufRead;
use std::net::UdpSocket;

use lumistack_core::Task;
use lumistack_live::{Eyes, head_of_packet};
use serde_json::{Map, Value, json};

use super::requests::{Changes, Requests};
use crate::console::{say, tell};

/// Largest length of a line, bytes.
const LINE: usize = 1 << 20;

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
    requests.make(&changes_of(line)?)
}

/// Reads all entries of a line.
fn changes_of(line: &str) -> Result<Changes, String> {
    const EXPECTED: &str = "an object with `set`, `time`, `viewers`, `reload`, `stop` or `stop_at_end`";
    let all: Map<String, Value> = serde_json::from_str(line)
        .map_err(|error| format!("expected {EXPECTED} on one line, found a line that is no JSON object: {error}"))?;
    if all.is_empty() {
        return Err(format!("expected {EXPECTED}, found an empty object"));
    }
    let mut changes = Changes::default();
    for (name, value) in all {
        let wrong = |expected: &str, value: &Value| Err(format!("{name}: expected {expected}, found {value}"));
        match (name.as_str(), value) {
            ("set", Value::Object(keys)) => changes.keys.extend(keys),
            ("set", value) => return wrong("an object of keys of the job and their values", &value),
            ("time", value) if value.is_number() || value.is_null() => {
                changes.keys.push(("pose.time_s".into(), value));
            }
            ("time", value) => return wrong("seconds, or null for the default pose of the scene", &value),
            ("viewers", value) => match serde_json::from_value(value.clone()) {
                Ok(heads_mm) => changes.heads_mm = Some(heads_mm),
                Err(_) => return wrong("a list of positions [x, y, z] in millimetres", &value),
            },
            ("reload", Value::Bool(true)) => changes.reload = true,
            ("stop", Value::Bool(true)) => changes.stop = true,
            ("stop_at_end", Value::Bool(true)) => changes.stop_at_end = true,
            ("reload" | "stop" | "stop_at_end", value) => return wrong("true", &value),
            (name, _) => return Err(format!("expected {EXPECTED}, found `{name}`")),
        }
    }
    Ok(changes)
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
    use std::time::Duration;

    use lumistack_pipeline::{DisplayJob, Job};

    use super::super::clock::now;
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

    /// Any wrong entry of a line leaves the line's other entries without effect, before and after
    /// the wrong entry.
    #[test]
    fn a_line_with_one_wrong_entry_changes_nothing() {
        let brightness = r#""set": {"display.brightness": 0.31}"#;
        let others = r#""time": 2, "viewers": [[0, 0, 600]], "reload": true, "stop_at_end": true, "stop": true"#;
        for line in [
            format!(r#"{{{brightness}, "viewers": [[0, 0, -5]]}}"#),
            r#"{"viewers": [[0, 0, 600]], "set": {"display.brightness": 7}}"#.into(),
            format!(r#"{{{others}, "set": {{"display.bright": 1}}}}"#),
            format!(r#"{{{brightness}, {others}, "end": true}}"#),
        ] {
            let requests = requests();
            carry_out("{\"time\": 1, \"viewers\": [[5, 0, 500]]}", &requests).unwrap();
            let heads_mm = |requests: &Requests| requests.tracker().boxes(now(), Duration::ZERO).heads_mm;
            let before = (requests.job(), requests.newest.after(0).unwrap().0, heads_mm(&requests));
            assert_eq!(before.2, [[5.0, 0.0, 500.0]]);
            carry_out(&line, &requests).unwrap_err();
            requests.end_of_input();
            let after = (requests.job(), requests.newest.after(0).unwrap().0, heads_mm(&requests));
            assert_eq!((after, requests.is_stopped()), (before, false), "{line}");
        }
    }

    /// A line that is too long is refused as a whole, and later lines are executed.
    #[test]
    fn long_lines_are_refused_once() {
        let requests = requests();
        for excess in [0, 1, 2 * LINE] {
            let errors = std::cell::RefCell::new(Vec::new());
            let blanks = " ".repeat(LINE - "{\"time\": 2}\n".len() + excess);
            let lines = format!("{{\"time\": 2{blanks}}}\n{{\"time\": 1}}\n");
            carry_out("{\"time\": 0}", &requests).unwrap();
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
