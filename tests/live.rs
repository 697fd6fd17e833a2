//! Tests of `lumistack live` as a program: it receives commands and head positions, and returns
//! states and a run folder.

use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use serde_json::{Value, json};

use crate::common::{fail, lumistack, number, report, root, succeed, write_test_field};

/// Longest time to wait for an event.
const PATIENCE: Duration = Duration::from_secs(120);

/// A process `lumistack live`, and its events.
pub(crate) struct Live {
    process: Child,
    /// Standard input; `None` after a test has closed it.
    input: Option<ChildStdin>,
    events: Receiver<Value>,
}

impl Live {
    /// Starts a job without a browser.
    pub(crate) fn start(job: &Path, run: &Path, options: &[&str]) -> Self {
        Self::start_by(lumistack(), job, run, options)
    }

    /// Starts a job by a command that already has the environment of a windowing session.
    fn start_by(mut command: Command, job: &Path, run: &Path, options: &[&str]) -> Self {
        command.args(["--json", "live", "--no-open"]).arg(job).arg("-o").arg(run).args(options);
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (input, output) = (process.stdin.take(), process.stdout.take().unwrap());
        let (send, events) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines() {
                let _ = send.send(serde_json::from_str(&line.unwrap()).unwrap());
            }
        });
        Self { process, input, events }
    }

    pub(crate) fn command(&mut self, command: &Value) {
        writeln!(self.input.as_ref().unwrap(), "{command}").unwrap();
    }

    /// Waits for an event that satisfies a condition.
    pub(crate) fn event(&self, fits: impl Fn(&Value) -> bool) -> Value {
        let mut all = Vec::new();
        loop {
            match self.events.recv_timeout(PATIENCE) {
                Ok(event) if fits(&event) => return event,
                Ok(event) => all.push(event),
                Err(error) => panic!("{error} after {all:?}"),
            }
        }
    }

    /// Waits for a state that satisfies a condition.
    pub(crate) fn state(&self, fits: impl Fn(&Value) -> bool) -> Value {
        self.event(|event| event["event"] == "state" && fits(event))
    }

    /// Ends the display by a command. Returns the last event.
    pub(crate) fn stop(mut self) -> Value {
        self.command(&json!({"stop": true}));
        self.end()
    }

    /// Waits for the end of a display that stops. Returns the last event.
    fn end(mut self) -> Value {
        let done = self.event(|event| event["event"] == "done");
        assert!(self.process.wait().unwrap().success());
        done
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Writes a job of a small light field into a folder.
pub(crate) fn write_job(folder: &Path) -> std::path::PathBuf {
    write_test_field(&folder.join("views.npy"), [3, 3, 16, 24], 20.0, 3.0);
    let job = folder.join("job.toml");
    let text = "light_field = \"views.npy\"\n[geometry]\nfov_deg = [20, 20]\npitch_mm = 3.0\n\
        [display]\npreset = \"fig7-uniform\"\nframes = 2\n";
    std::fs::write(&job, text).unwrap();
    job
}

#[test]
fn states_follow_commands_files_and_heads_and_the_last_is_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (write_job(folder.path()), folder.path().join("run"));
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut live = Live::start(&job, &run, &["--opentrack", &port.to_string(), "--head-mm", "0,0,500"]);
    let first = live.state(|_| true);
    assert_eq!((&first["number"], &first["content"], &first["zone"]), (&json!(1), &json!(1), &json!(1.0)));

    // set a key of the job, then a key that does not exist
    live.command(&json!({"set": {"display.brightness": 0.4}}));
    let changed = live.state(|state| state["content"] == 2);
    assert!(changed["number"].as_u64() > first["number"].as_u64(), "{first} {changed}");
    live.command(&json!({"set": {"display.bright": 0.4}}));
    let refused = live.event(|event| event["event"] == "refused");
    assert!(refused["message"].as_str().unwrap().contains("did you mean `brightness`?"), "{refused}");

    // Write the light field's file again. Its length must differ, since some file systems store
    // times with a coarse resolution.
    write_test_field(&folder.path().join("views.npy"), [3, 3, 20, 24], 20.0, 3.0);
    live.state(|state| state["content"] == 3);

    // send a tracker's packet with the position of a head: six little-endian doubles, in
    // centimetres and degrees
    let tracker = UdpSocket::bind("127.0.0.1:0").unwrap();
    let packet: Vec<u8> = [5.0f64, 0.0, 10.0, 30.0, 0.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    tracker.send_to(&packet, ("127.0.0.1", port)).unwrap();
    live.state(|state| state["zone"] == 0.0);
    // if no further positions arrive, the weight of the whole viewing zone becomes 1 again
    live.state(|state| state["zone"] == 1.0);
    // a position on standard input has the same effect as a tracker's packet
    live.command(&json!({"viewers": [[50, 0, 600]]}));
    live.state(|state| state["zone"] == 0.0);

    let done = live.stop();
    assert!(done["states"].as_u64().unwrap() >= 4, "{done}");
    assert!(number(&report(&run), "psnr_view") > 10.0);
    let display = std::fs::read_to_string(run.join("display.toml")).unwrap();
    assert!(display.contains("brightness = 0.4"), "{display}");
    succeed(lumistack().arg("simulate").arg(&run).args(["--view", "2,0", "-o"]).arg(folder.path().join("view.png")));
}

/// Requests a path from the server of the display's page. Returns the whole answer.
fn get(address: &str, path: &str) -> String {
    let host = address.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = std::net::TcpStream::connect(host.replace("localhost", "127.0.0.1")).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
    let mut answer = String::new();
    std::io::Read::read_to_string(&mut stream, &mut answer).unwrap();
    answer
}

#[test]
fn a_page_moves_its_viewer_and_a_stranger_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (write_job(folder.path()), folder.path().join("run"));
    let live = Live::start(&job, &run, &[]);
    let address = live.event(|event| event["event"] == "serving")["address"].as_str().unwrap().to_owned();
    let page = get(&address, "/");
    let (_, rest) = page.split_once(".live.js?viewer=").expect("the page has its word");
    let (word, _) = rest.split_once('"').unwrap();
    for wrong in ["/.look", "/.look?x=0.1&y=0", "/.look?viewer=0&x=0.1&y=0", &format!("/.look?viewer={word}&x=a&y=0")] {
        assert!(get(&address, wrong).starts_with("HTTP/1.1 403 "), "{wrong}");
    }
    assert!(get(&address, &format!("/.look?viewer={word}&x=0.1&y=0")).starts_with("HTTP/1.1 204 "));
    live.state(|state| state["zone"] == 0.0);
    assert!(get(&address, &format!("/.look?viewer={word}")).starts_with("HTTP/1.1 204 "));
    live.state(|state| state["zone"] == 1.0);
    live.stop();

    // If a tracker sends positions, the server gives the page no secret word. Requests that move
    // the viewer need this word, so the page cannot move the viewer.
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let live = Live::start(&job, &run, &["--opentrack", &port.to_string()]);
    let address = live.event(|event| event["event"] == "serving")["address"].as_str().unwrap().to_owned();
    assert!(!get(&address, "/").contains("viewer="));
    assert!(get(&address, "/.look?viewer=&x=0.1&y=0").starts_with("HTTP/1.1 403 "));
    live.stop();
}

/// A program that starts a display may crash, so that it cannot stop the display. With
/// `stop_at_end` the end of standard input then stops the display.
#[test]
fn the_end_of_the_input_stops_it_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (write_job(folder.path()), folder.path().join("run"));
    let mut live = Live::start(&job, &run, &[]);
    live.state(|_| true);
    live.command(&json!({"stop_at_end": true}));
    live.input = None;
    live.event(|event| event["event"] == "done");
    assert!(live.process.wait().unwrap().success());
    assert!(run.join("report.html").exists());
}

#[test]
fn a_video_shows_its_time_steps_in_order_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    write_job(folder.path());
    let times = folder.path().join("times");
    std::fs::create_dir(&times).unwrap();
    for time in 0..3 {
        write_test_field(&times.join(format!("{time}.npy")), [3, 3, 16, 24], 20.0, 3.0);
    }
    let job = folder.path().join("video.toml");
    let text = std::fs::read_to_string(folder.path().join("job.toml")).unwrap().replace("views.npy", "times");
    std::fs::write(&job, text).unwrap();
    let mut live = Live::start(&job, &folder.path().join("run"), &["--times", "--rate", "50", "--most-late", "1000"]);
    for content in 1..=3 {
        live.state(|state| state["content"] == content);
    }
    let done = live.event(|event| event["event"] == "done");
    assert_eq!(done["dropped"], 0, "{done}");
    assert!(live.process.wait().unwrap().success());
}

/// Commands that change no keys of the job work while the display file is missing. For example, the
/// file may be missing while an editor saves it.
#[test]
fn commands_that_change_no_keys_need_no_files() {
    let folder = tempfile::tempdir().unwrap();
    let (job, display) = (write_job(folder.path()), folder.path().join("d.toml"));
    std::fs::copy(root().join("scenes/displays/fig7-uniform.toml"), &display).unwrap();
    let text = std::fs::read_to_string(&job).unwrap().replace("preset = \"fig7-uniform\"", "file = \"d.toml\"");
    std::fs::write(&job, text).unwrap();
    let mut live = Live::start(&job, &folder.path().join("run"), &[]);
    live.state(|_| true);
    std::fs::remove_file(&display).unwrap();
    live.command(&json!({"viewers": [[0, 0, 600]]}));
    live.stop();
}

#[test]
fn errors_of_the_start_end_it_with_one_message() {
    let folder = tempfile::tempdir().unwrap();
    let job = write_job(folder.path());
    let live = |options: &[&str]| {
        // set the variable XDG_RUNTIME_DIR, since without it Mesa's drivers print an error
        let mut command = lumistack();
        command.env("XDG_RUNTIME_DIR", folder.path());
        fail(command.args(["live", "--no-open"]).arg(&job).arg("-o").arg(folder.path().join("run")).args(options))
    };
    for (options, message) in [
        (&["--show", "span", "--mouse"][..], "`window`, since only the window has a mouse pointer"),
        (&["--head-mm", "0,0,-5"], "--head-mm: Z: expected a number above 0, found -5"),
        (&["--device", "gpu:no such adapter"], if cfg!(feature = "gpu") { "no such adapter" } else { "feature `gpu`" }),
        (&["--solver", "none"], "none"),
    ] {
        let text = live(options);
        assert!(text.contains(message), "{options:?}: {text}");
    }
}

/// With `--mouse` the pointer in the window moves a tracked head. While the pointer rests, the head
/// keeps its position, and does not time out like the head of a silent tracker.
#[cfg(feature = "panels")]
#[test]
fn the_mouse_in_the_window_acts_as_a_tracked_head() {
    use crate::common::session::{Session, XORG};

    let Some(session) = Session::xorg(&XORG) else { return };
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (write_job(folder.path()), folder.path().join("run"));
    let mut poke = crate::common::poke::Poke::new(session.x_display());
    poke.point([1300, 300]);
    let program = session.command(env!("CARGO_BIN_EXE_lumistack"));
    let live = Live::start_by(program, &job, &run, &["--show", "window", "--mouse"]);
    live.state(|state| state["zone"] == 1.0);
    // returns the last value of `zone` among the events before a pause of length `time`
    let zone_within = |time: Duration| -> Option<f64> {
        let events = std::iter::from_fn(|| live.events.recv_timeout(time).ok());
        events.filter_map(|event| event["zone"].as_f64()).last()
    };
    // Move the pointer until an event reports a tracked viewer. The window opens some time after
    // the first event, so the first moves may have no effect.
    let followed = (0..300).any(|turn| {
        poke.point([100 + 10 * (turn % 2), 100]);
        zone_within(Duration::from_millis(100)) == Some(0.0)
    });
    assert!(followed, "no state follows the pointer");
    // the pointer rests for longer than the time after which a silent tracker's head would be
    // ignored
    let rest = zone_within(Duration::from_secs(4));
    assert!(rest.is_none_or(|zone| zone == 0.0), "{rest:?}");
    live.stop();
}

/// A program that attaches to a running display.
struct Attached(BufReader<std::net::TcpStream>);

impl Attached {
    /// Connects to the socket of a run, and sends lines.
    fn connect(run: &Path, lines: &str) -> Self {
        let port = door_of(run)["port"].as_u64().unwrap();
        let mut stream = std::net::TcpStream::connect(("127.0.0.1", port as u16)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(lines.as_bytes()).unwrap();
        Self(BufReader::new(stream))
    }

    fn send(&mut self, command: &Value) {
        writeln!(self.0.get_mut(), "{command}").unwrap();
    }

    /// Returns the next event; `None` after the end.
    fn next(&mut self) -> Option<Value> {
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        (!line.is_empty()).then(|| serde_json::from_str(&line).unwrap())
    }

    #[track_caller]
    fn event(&mut self, fits: impl Fn(&Value) -> bool) -> Value {
        std::iter::from_fn(|| self.next()).find(fits).expect("an event before the end")
    }
}

fn door_of(run: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(run.join("cache/live.json")).unwrap()).unwrap()
}

#[test]
fn another_program_attaches_by_a_token_and_leaves_the_display_running() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (write_job(folder.path()), folder.path().join("run"));
    let live = Live::start(&job, &run, &[]);
    live.event(|event| event["event"] == "serving");
    let token = json!({"token": door_of(&run)["token"]});

    // without the right token, the program sends one message and closes the connection
    for wrong in ["{\"token\": \"0\"}\n", "{\"stop\": true}\n", "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", "\n"] {
        let mut stranger = Attached::connect(&run, wrong);
        let refused = stranger.next().unwrap();
        assert!(refused["message"].as_str().unwrap().starts_with("token: expected the first line"), "{refused}");
        assert_eq!(stranger.next(), None, "{wrong}");
    }

    // The attached program receives the event `serving` with the address, and the newest state. Its
    // command changes the display.
    let mut program = Attached::connect(&run, &format!("{token}\n{}\n", json!({"set": {"display.brightness": 0.4}})));
    assert_eq!(program.next().unwrap(), json!({"event": "attached"}));
    assert_eq!(program.next().unwrap()["event"], "serving");
    let first = program.event(|event| event["event"] == "state");
    assert!(first["content"].as_u64() >= Some(1), "{first}");
    program.event(|event| event["content"] == 2);
    live.state(|state| state["content"] == 2);
    program.send(&json!({"set": {"display.bright": 0.4}}));
    let refused = program.event(|event| event["event"] == "refused");
    assert!(refused["message"].as_str().unwrap().contains("did you mean `brightness`?"), "{refused}");

    // a second program is refused while the first one is attached
    let mut second = Attached::connect(&run, &format!("{token}\n"));
    let refused = second.next().unwrap();
    assert!(refused["message"].as_str().unwrap().starts_with("a program is attached already"), "{refused}");
    assert_eq!(second.next(), None);

    // after the program has gone, the display still runs, and another program may attach
    drop(program);
    let mut again = (0..100).find_map(|_| {
        let mut next = Attached::connect(&run, &format!("{token}\n"));
        std::thread::sleep(Duration::from_millis(20));
        (next.next().unwrap()["event"] == "attached").then_some(next)
    });
    let again = again.as_mut().expect("a place for the next program");
    assert_eq!(again.event(|event| event["event"] == "state")["content"], 2);
    // a program that stops the display receives the last event, too
    again.send(&json!({"stop": true}));
    let done = live.end();
    assert_eq!(again.event(|event| event["event"] == "done"), done);
    assert_eq!(again.next(), None);
    assert!(!run.join("cache/live.json").exists());
    assert!(std::fs::read_to_string(run.join("display.toml")).unwrap().contains("brightness = 0.4"));
}

#[cfg(target_os = "linux")]
#[test]
fn only_this_machine_and_this_user_can_attach() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (write_job(folder.path()), folder.path().join("run"));
    let live = Live::start(&job, &run, &[]);
    live.state(|_| true);
    // a socket on all interfaces would also answer at 127.0.0.2
    let port = door_of(&run)["port"].as_u64().unwrap() as u16;
    assert!(std::net::TcpStream::connect(("127.0.0.2", port)).is_err());
    let mode = std::fs::metadata(run.join("cache/live.json")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    live.stop();
}
