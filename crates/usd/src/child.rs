//! Runs the walker (the Python code that reads a stage) in the user's Python, and reads the scene
//! package that the walker writes.
//!
//! The Python runs as a child process. Its standard output is a temporary file, which the system
//! removes even if the parent or the child dies. The request is JSON and contains the walker's
//! source. The end of standard error is kept for error messages.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::Duration;

use lumistack_core::{Cancel, Cancelled};
use memmap2::Mmap;
use serde::Serialize;

use crate::UsdError;
use crate::package::Package;
use crate::python::{Candidate, Surroundings};

/// The walker: Python modules that read a stage, in the order of their imports.
pub const MODULES: [(&str, &str); 9] = [
    ("writer", include_str!("../python/writer.py")),
    ("geometry", include_str!("../python/geometry.py")),
    ("materials", include_str!("../python/materials.py")),
    ("lights", include_str!("../python/lights.py")),
    ("shapes", include_str!("../python/shapes.py")),
    ("splats", include_str!("../python/splats.py")),
    ("mtlx", include_str!("../python/mtlx.py")),
    ("skel", include_str!("../python/skel.py")),
    ("walk", include_str!("../python/walk.py")),
];
/// The script that imports [`MODULES`] in a Python process and starts the walker.
const BOOT: &str = include_str!("../python/boot.py");
/// Time between two checks of a running child process.
const POLL: Duration = Duration::from_millis(5);
/// Largest number of bytes that are kept from the end of a child's output.
const SAID: usize = 16 << 10;

/// A request to the walker, in the form that is passed to the walker as JSON.
#[derive(Debug, Serialize)]
pub(crate) struct Request<'a> {
    pub(crate) path: &'a str,
    pub(crate) time_s: Option<f64>,
    pub(crate) variants: &'a [String],
    pub(crate) contents_only: bool,
}

/// The scene package that the walker wrote to a file, and the Python that ran the walker.
pub(crate) struct Answer {
    file: Option<Mmap>,
    /// The Python that wrote the file.
    python: String,
}

impl Answer {
    /// Parses the file that the walker wrote.
    ///
    /// # Errors
    /// If the file is not a scene package.
    pub(crate) fn package(&self, name: &str) -> Result<Package<'_>, UsdError> {
        let bytes = self.file.as_deref().unwrap_or_default();
        Package::parse(bytes).map_err(|found| UsdError::Child { file: name.into(), python: self.python.clone(), found })
    }
}

/// The failure of one Python.
enum Failed {
    /// This Python cannot read USD files. The next Python is tried, if one remains.
    Unfit(String),
    Final(UsdError),
}

/// Runs the walker in the first Python that has OpenUSD.
///
/// # Errors
/// If no Python has OpenUSD, if OpenUSD refuses the file, if the child fails, or if the request is
/// cancelled.
pub(crate) fn ask(request: &Request<'_>, cancel: &Cancel) -> Result<Answer, UsdError> {
    ask_one_of(&Surroundings::of_system().candidates(), request, cancel)
}

fn ask_one_of(candidates: &[Candidate], request: &Request<'_>, cancel: &Cancel) -> Result<Answer, UsdError> {
    let mut tried = Vec::new();
    for candidate in candidates {
        let program = candidate.program.display().to_string();
        match ask_python(&candidate.program, request, cancel) {
            Ok(answer) => return Ok(answer),
            Err(Failed::Final(error)) => return Err(error),
            Err(Failed::Unfit(found)) if candidate.given => {
                return Err(UsdError::GivenPython { found: format!("{program}: {found}"), python: program });
            }
            Err(Failed::Unfit(found)) => tried.push(match candidate.from == program {
                true => format!("{program}: {found}"),
                false => format!("{program} from {}: {found}", candidate.from),
            }),
        }
    }
    Err(UsdError::NoPython { file: request.path.into(), tried })
}

fn ask_python(program: &Path, request: &Request<'_>, cancel: &Cancel) -> Result<Answer, Failed> {
    let python = program.display().to_string();
    let io = |source| Failed::Final(UsdError::Io { place: "a temporary file".into(), source });
    let file = tempfile::tempfile().map_err(io)?;
    // Start the child. From Python 3.11 on, `PYTHONSAFEPATH` keeps the working folder out of the
    // module path; `boot.py` does this for older Pythons. `PYTHONUTF8` makes file names UTF-8.
    let mut command = Command::new(program);
    command.args(["-c", BOOT]).env("PYTHONSAFEPATH", "1").env("PYTHONUTF8", "1");
    command.stdin(Stdio::piped()).stdout(file.try_clone().map_err(io)?).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|error| Failed::Unfit(format!("cannot be started: {error}")))?;
    let said = read_end(child.stderr.take());
    if let Some(mut input) = child.stdin.take() {
        #[derive(Serialize)]
        struct WithModules<'a> {
            modules: &'a [(&'a str, &'a str)],
            #[serde(flatten)]
            request: &'a Request<'a>,
        }
        let text = serde_json::to_vec(&WithModules { modules: &MODULES, request }).expect("requests serialize");
        // Write in a thread, since the text is longer than a pipe holds. A write fails if the child
        // has ended; the child's status is checked later.
        std::thread::spawn(move || input.write_all(&text));
    }
    // Wait for the end of the child; Ctrl-C reaches the child too.
    let status = wait(&mut child, cancel, &mut || ()).map_err(|error| Failed::Final(error.into()))?;
    if is_interrupted(status) {
        return Err(Failed::Final(Cancelled.into()));
    }
    let said = said.join().unwrap_or_default();
    let failed = |found| Failed::Final(UsdError::Child { file: request.path.into(), python: python.clone(), found });
    let answer = Answer { file: map(&file).map_err(io)?, python: python.clone() };
    if answer.file.is_none() && status.code().is_some_and(|code| code != 0) {
        // The boot script did not run, or failed before it wrote output. This Python may be unable
        // to parse the script, or to import a module.
        return Err(Failed::Unfit(ended(status, &said)));
    }
    if !status.success() {
        return Err(failed(ended(status, &said)));
    }
    let package = answer.package(request.path).map_err(|error| match error {
        UsdError::Child { found, .. } => failed(format!("{found}{}", last_line(&said))),
        other => Failed::Final(other),
    })?;
    // Distinguish a Python without OpenUSD, a refused file, and an error in the walker.
    if let Some(failure) = package.header.error {
        let file = request.path.to_owned();
        return Err(match failure.kind.as_str() {
            "python" | "pxr" => Failed::Unfit(failure.message),
            "scene" => Failed::Final(UsdError::Refused { file, message: failure.message }),
            _ => failed(format!("an exception in lumistack's script: {}", failure.message.trim_end())),
        });
    }
    Ok(answer)
}

/// Returns true if Ctrl-C ended the child. A terminal sends Ctrl-C to both processes, in any order.
#[cfg(unix)]
fn is_interrupted(status: ExitStatus) -> bool {
    std::os::unix::process::ExitStatusExt::signal(&status) == Some(2)
}

/// Returns true if Ctrl-C ended the child, by `STATUS_CONTROL_C_EXIT`.
#[cfg(not(unix))]
fn is_interrupted(status: ExitStatus) -> bool {
    status.code() == Some(-1_073_741_510)
}

/// Waits for the end of a child, and kills it on cancellation. Calls `meanwhile` at every check.
pub(crate) fn wait(child: &mut Child, cancel: &Cancel, meanwhile: &mut dyn FnMut()) -> Result<ExitStatus, Cancelled> {
    loop {
        if let Ok(Some(status)) = child.try_wait() {
            return Ok(status);
        }
        if cancel.is_cancelled() {
            // a child that has just ended cannot be killed, which is no error
            let _ = child.kill();
            let _ = child.wait();
            return Err(Cancelled);
        }
        meanwhile();
        std::thread::sleep(POLL);
    }
}

/// Reads a stream to its end in a new thread. The thread returns the stream's last [`SAID`] bytes.
pub(crate) fn read_end(stream: Option<impl Read + Send + 'static>) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut kept = Vec::new();
        let mut chunk = [0; 4096];
        if let Some(mut stream) = stream {
            while let Ok(count @ 1..) = stream.read(&mut chunk) {
                kept.extend_from_slice(&chunk[..count]);
                kept.drain(..kept.len().saturating_sub(SAID));
            }
        }
        String::from_utf8_lossy(&kept).into_owned()
    })
}

fn map(file: &File) -> std::io::Result<Option<Mmap>> {
    if file.metadata()?.len() == 0 {
        return Ok(None);
    }
    // SAFETY: nothing changes the file, since no other process can open this temporary file, and
    // the child that had it open has ended
    unsafe { Mmap::map(file) }.map(Some)
}

/// Describes for a message how a process ended: its status, and its last line of output.
fn ended(status: ExitStatus, said: &str) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        return format!("signal {signal}{}", last_line(said));
    }
    format!("{status}{}", last_line(said))
}

/// Returns the last four lines of standard error, or of standard output if standard error is empty.
pub(crate) fn last_lines(said: &str, printed: &str) -> String {
    let text = if said.trim().is_empty() { printed } else { said };
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    lines[lines.len().saturating_sub(4)..].join(" ")
}

fn last_line(said: &str) -> String {
    let line = said.lines().rfind(|line| !line.trim().is_empty());
    line.map_or_else(String::new, |line| format!("; last output: {}", line.trim()))
}

/// Writes a script that tests run instead of Python or Blender.
///
/// Another process writes the file. If this process wrote it, a process that another test starts
/// meanwhile could keep the file open, and the system would refuse to run the script.
#[cfg(all(test, unix))]
pub(crate) fn fake(folder: &Path, name: &str, script: &str) -> Candidate {
    let program = folder.join(name);
    let mut shell = Command::new("sh");
    shell.args(["-c", "printf '#!/bin/sh\\n%s\\n' \"$1\" > \"$0\" && chmod 755 \"$0\""]).arg(&program).arg(script);
    assert!(shell.status().unwrap().success());
    Candidate { program, from: "PATH", given: false }
}

#[cfg(all(test, unix))]
mod tests {
    use std::path::PathBuf;
    use std::time::Instant;

    use super::*;

    const REQUEST: Request<'static> = Request { path: "scene.usda", time_s: None, variants: &[], contents_only: false };

    fn error(candidates: &[Candidate]) -> String {
        ask_one_of(candidates, &REQUEST, &Cancel::default()).err().expect("this Python gives no scene").to_string()
    }

    #[test]
    fn every_python_that_does_not_do_is_named_with_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let missing =
            Candidate { program: PathBuf::from("/no/such/python"), from: "lumistack setup usd", given: false };
        let shim = fake(folder.path(), "shim", "echo 'pyenv: python3: command not found' >&2; exit 127");
        let header = r#"{"schema": "lumistack.scene-package", "version": 1, "error": {"kind": "pxr", "message": "Python 3.9.1 without OpenUSD"}}"#;
        let length = format!("\\{:03o}\\0\\0\\0\\0\\0\\0\\0", header.len());
        let bare = fake(folder.path(), "bare", &format!("cat >/dev/null; printf 'LUMIPKG1{length}%s' '{header}'"));
        let text = error(&[missing.clone(), shim, bare]);
        assert!(text.starts_with("scene.usda: USD files are read by the Python package usd-core"), "{text}");
        for part in [
            "`lumistack setup usd`",
            "/no/such/python from lumistack setup usd: cannot be started",
            "shim from PATH: exit status: 127; last output: pyenv: python3: command not found",
            "bare from PATH: Python 3.9.1 without OpenUSD",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let text = error(&[Candidate { given: true, ..missing }]);
        assert!(
            text.starts_with("LUMISTACK_PYTHON: expected a Python with the package usd-core, found /no/such/python"),
            "{text}"
        );
    }

    #[test]
    fn a_child_that_breaks_down_is_one_message() {
        let folder = tempfile::tempdir().unwrap();
        let sound = fake(folder.path(), "sound", "exit 9");
        for (name, script, expected) in [
            ("crash", "cat >/dev/null; echo 'no memory' >&2; kill -SEGV $$", "signal 11; last output: no memory"),
            ("chatter", "cat >/dev/null; echo 'Hello from a plugin'", "data that is not a scene package"),
            (
                "cut",
                "cat >/dev/null; printf 'LUMIPKG1\\100\\0\\0\\0\\0\\0\\0\\0{'",
                "a scene package that ends too early",
            ),
            ("late", "cat >/dev/null; echo half; exit 3", "exit status: 3"),
            ("silent", "cat >/dev/null", "nothing"),
        ] {
            let text = error(&[fake(folder.path(), name, script), sound.clone()]);
            let start =
                format!("scene.usda: expected {} to return a scene, found ", folder.path().join(name).display());
            assert!(text.starts_with(&start) && text.contains(expected), "{name}: {text}");
        }
    }

    /// This test sends no signal to a child, since a shell or a test runner may make the child
    /// ignore the signal.
    #[test]
    fn ctrl_c_in_the_child_is_no_crash() {
        use std::os::unix::process::ExitStatusExt;
        assert!(is_interrupted(ExitStatus::from_raw(2)));
        assert!(![0, 11, 2 << 8, 130 << 8].map(ExitStatus::from_raw).map(is_interrupted).contains(&true));
    }

    #[test]
    fn a_cancelled_child_is_ended_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pid = folder.path().join("pid");
        let sleeper = fake(folder.path(), "sleeper", &format!("echo $$ > {}; exec sleep 100", pid.display()));
        let cancel = Cancel::default();
        let start = Instant::now();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while std::fs::read_to_string(&pid).is_ok_and(|pid| !pid.is_empty()) || start.elapsed().as_secs() < 1 {
                    if start.elapsed().as_millis() > 300 {
                        break;
                    }
                    std::thread::sleep(POLL);
                }
                cancel.cancel();
            });
            let result = ask_one_of(&[sleeper], &REQUEST, &cancel);
            assert!(matches!(result, Err(UsdError::Cancelled(_))), "{:?}", result.err());
        });
        assert!(start.elapsed().as_secs() < 20);
        let pid = std::fs::read_to_string(&pid).unwrap();
        // signal 0 tests whether a process exists
        let alive = Command::new("kill").args(["-0", pid.trim()]).stderr(Stdio::null()).status().unwrap();
        assert!(!alive.success(), "process {pid} is still there");
    }

    /// If the Python has no OpenUSD, the boot script reports this. If the Python has OpenUSD,
    /// OpenUSD refuses the file, which does not exist.
    #[test]
    fn a_real_python_answers() {
        let python = Candidate { program: "python3".into(), from: "PATH", given: false };
        match ask_one_of(std::slice::from_ref(&python), &REQUEST, &Cancel::default()) {
            Err(UsdError::NoPython { tried, .. }) => match tried[0].contains("cannot be started") {
                true => lumistack_testkit::skip::skipped("no python3 on PATH"),
                false => assert!(tried[0].contains("Python 3.") && tried[0].contains("OpenUSD"), "{tried:?}"),
            },
            Err(UsdError::Refused { message, .. }) => assert!(message.contains("scene.usda"), "{message}"),
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("there is no such file"),
        }
    }
}
