//! Runs the `lumistack` binary and reads its files.

#[cfg(feature = "panels")]
pub mod poke;
#[cfg(feature = "panels")]
pub mod session;
#[cfg(feature = "panels")]
pub mod show;
pub mod triangle;

pub use lumistack_testkit::console::{interrupt, interruptible};

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A test that interrupts a program, or reads a program's screen, starts a second process of this
/// test program. That process runs only this function.
#[cfg(windows)]
#[test]
fn helps() {
    lumistack_testkit::console::help();
}

/// Returns the repository's root folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Returns the binary under test.
pub fn lumistack() -> Command {
    Command::new(env!("CARGO_BIN_EXE_lumistack"))
}

/// Runs a command line that must succeed, and returns its standard output. If the command fails,
/// the function panics with the command's messages.
pub fn succeed(command: &mut Command) -> String {
    let output = command.output().expect("lumistack starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{command:?}\n{text}\n{}", String::from_utf8_lossy(&output.stderr));
    text
}

/// Runs a command line that must end with exit code 1 and one error. Returns its standard error.
pub fn fail(command: &mut Command) -> String {
    let Output { status, stderr, .. } = command.output().expect("lumistack starts");
    let text = String::from_utf8_lossy(&stderr).into_owned();
    assert_eq!(status.code(), Some(1), "{command:?}\n{text}");
    assert_eq!(text.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{text}");
    assert!(!text.contains("panicked"), "{text}");
    text
}

/// Starts `lumistack preview`, waits until it serves, and ends it. Returns its events up to then.
pub fn serve_preview(run: &Path) -> Vec<serde_json::Value> {
    let mut command = lumistack();
    let mut child =
        command.args(["--json", "preview", "--no-open"]).arg(run).stdout(Stdio::piped()).spawn().expect("it starts");
    let lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    let mut events: Vec<serde_json::Value> = Vec::new();
    for line in lines {
        events.push(serde_json::from_str(&line.expect("a line")).expect("JSON"));
        if events.last().is_some_and(|event| event["event"] == "serving") {
            break;
        }
    }
    child.kill().expect("it still runs");
    child.wait().expect("it ends");
    assert!(events.last().is_some_and(|event| event["event"] == "serving"), "{events:?}");
    events
}

/// Returns `report.json` of a run folder.
pub fn report(run_dir: &Path) -> serde_json::Value {
    let text = std::fs::read(run_dir.join("report.json")).expect("the run has a report");
    serde_json::from_slice(&text).expect("report.json is JSON")
}

/// Returns true if a stage of a run used results of an earlier run.
pub fn cached(run_dir: &Path, stage: &str) -> bool {
    let report = report(run_dir);
    let stage =
        report["stages"].as_array().expect("the report lists stages").iter().find(|found| found["name"] == stage);
    stage.expect("the report lists the stage")["cached"].as_bool().expect("cached is true or false")
}

/// Returns the number with this key in a part of `report.json`.
pub fn number(value: &serde_json::Value, key: &str) -> f64 {
    value[key].as_f64().or_else(|| value[key].as_str()?.parse().ok()).unwrap_or_else(|| panic!("{key} of {value}"))
}

/// Returns all files of a folder and its subfolders with their bytes, sorted by path, without the
/// folder `cache`.
pub fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    fn walk(folder: &Path, base: &Path, list: &mut Vec<(PathBuf, Vec<u8>)>) {
        for entry in std::fs::read_dir(folder).expect("the folder is there") {
            let path = entry.expect("the entry is readable").path();
            if path.is_dir() {
                walk(&path, base, list);
            } else {
                let name = path.strip_prefix(base).expect("files lie below their folder").to_owned();
                list.push((name, std::fs::read(&path).expect("the file is readable")));
            }
        }
    }
    let mut list = Vec::new();
    walk(folder, folder, &mut list);
    list.sort();
    list
}

/// Returns the third-party scenes; `None`, with a message, if they are missing.
pub fn assets() -> Option<PathBuf> {
    lumistack_testkit::skip::folder("LUMISTACK_ASSETS", "../shared/scenes")
}

/// Returns the reference light fields; `None`, with a message, if they are missing.
pub fn light_fields() -> Option<PathBuf> {
    lumistack_testkit::skip::folder("LUMISTACK_LIGHTFIELDS", "../shared/lightfields")
}

/// Finds a Python with NumPy: the Python that `LUMISTACK_PYTHON` names, or else `python3`.
pub fn python() -> Option<PathBuf> {
    lumistack_testkit::skip::python_with("numpy")
}

/// Writes a light field `[view_y][view_x][row][col][rgb]` as `.npy`. The light field shows a
/// textured plane behind the display, and a bright card in front of the display.
pub fn write_test_field(path: &Path, [views_y, views_x, rows, cols]: [usize; 4], fov_deg: f64, pitch_mm: f64) {
    use npyz::WriterBuilder;
    let half_width = (fov_deg / 2.0).to_radians().tan();
    let slope =
        |view: usize, count: usize| (view as f64 - (count as f64 - 1.0) / 2.0) * 2.0 / count as f64 * half_width;
    let mut values = Vec::new();
    for view_y in 0..views_y {
        for view_x in 0..views_x {
            let (s_x, s_y) = (slope(view_x, views_x), -slope(view_y, views_y));
            for row in 0..rows {
                for col in 0..cols {
                    let x = (col as f64 - (cols as f64 - 1.0) / 2.0) * pitch_mm;
                    let y = ((rows as f64 - 1.0) / 2.0 - row as f64) * pitch_mm;
                    let (near_x, near_y) = (x + 30.0 * s_x, y + 30.0 * s_y);
                    let (far_x, far_y) = (x - 40.0 * s_x, y - 40.0 * s_y);
                    let card =
                        near_x.abs() < 0.12 * cols as f64 * pitch_mm && near_y.abs() < 0.2 * rows as f64 * pitch_mm;
                    let wave = 0.5 + 0.35 * (far_x / (3.0 * pitch_mm)).sin() * (far_y / (4.0 * pitch_mm)).cos();
                    let rgb = if card { [0.9, 0.3, 0.1] } else { [0.2 * wave, 0.6 * wave, wave] };
                    values.extend(rgb.map(|v| v as f32));
                }
            }
        }
    }
    let file = std::fs::File::create(path).expect("the test's folder is writable");
    let shape = [views_y, views_x, rows, cols, 3].map(|n| n as u64);
    let mut writer =
        npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd().expect("npy header");
    writer.extend(values).expect("npy values");
    writer.finish().expect("npy end");
}
