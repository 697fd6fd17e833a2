//! Measures the memory of whole runs, and compares it with the bound that their plans print.
//!
//! Every run is a separate process, which is this program with only the test [`child`]. After the
//! run, the process reads its peak of memory from the system.

use std::path::{Path, PathBuf};
use std::process::Command;

use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_field_io::{npy, write_index, write_view};
use lumistack_pipeline::{Job, Registry, plan, run, run_step};

use crate::compose::{results, with_task};

/// Environment variable that names the last step of a child. Without it, the child executes the
/// whole run.
const STEP: &str = "LUMISTACK_TEST_MEMORY_STEP";
/// Environment variable that names the job file of a child. The run folder is beside this file.
const JOB: &str = "LUMISTACK_TEST_MEMORY_JOB";
/// Columns, rows, and views per axis, of the given light field and of the jobs with fixed views.
const SIZE: [usize; 3] = [208, 140, 17];

/// Peak of the memory of a run, and the bound that its plan states for this memory, bytes.
#[derive(Clone, Copy, Debug)]
struct Peak {
    found: u64,
    said: u64,
}

/// Runs the job that the environment variable [`JOB`] names. Without this variable, the test does
/// nothing.
#[test]
fn child() {
    let Some(path) = std::env::var_os(JOB).map(PathBuf::from) else { return };
    let (job, registry) = (Job::load(&path).unwrap(), Registry::built_in().unwrap());
    let dir = path.with_extension("");
    let said = plan(&job, &dir, &registry).unwrap().steps.iter().map(|step| step.memory_bytes).max().unwrap();
    match std::env::var(STEP) {
        Ok(step) => with_task(|task| run_step(&job, &dir, &step, &registry, task)).unwrap(),
        Err(_) => with_task(|task| run(&job, &dir, &registry, None, task)).map(drop).unwrap(),
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    let kib: u64 = line.split_whitespace().nth(1).unwrap().parse().unwrap();
    println!("\npeak {} of {said}", kib << 10);
}

/// Runs a job with the tables `tables` in a separate process, up to `step` or to the end. The job
/// may keep `mib` MiB of a light field in memory. Returns the run folder and the peak.
fn peak_of(folder: &Path, name: &str, mib: u64, tables: &str, step: Option<&str>) -> (PathBuf, Peak) {
    let path = folder.join(format!("{name}.toml"));
    let render = tables.replace("[render]\n", &format!("[render]\nfield_mib = {mib}\n"));
    std::fs::write(&path, format!("name = \"memory\"\n{render}[factorize]\niterations = 2\n")).unwrap();
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["memory::child", "--exact", "--nocapture"]).env(JOB, &path).env("RAYON_NUM_THREADS", "2");
    command.envs(step.map(|step| (STEP, step)));
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{name}: {said}{}", String::from_utf8_lossy(&output.stderr));
    let line = said.lines().find_map(|line| line.strip_prefix("peak ")).unwrap_or_else(|| panic!("{name}: {said}"));
    let mut numbers = line.split(" of ").map(|number| number.parse::<u64>().unwrap());
    let peak = Peak { found: numbers.next().unwrap(), said: numbers.next().unwrap() };
    (path.with_extension(""), peak)
}

/// Checks a run that may keep only `mib` MiB of a light field in memory. It must have the results
/// of a run that keeps everything, and use less memory.
fn check(tables: &str, mib: u64, step: Option<&str>) {
    let folder = tempfile::tempdir().unwrap();
    let (held_dir, held) = peak_of(folder.path(), "held", 4096, tables, step);
    let (dir, streamed) = peak_of(folder.path(), "streamed", mib, tables, step);
    println!("held {held:?}, within {mib} MiB {streamed:?}");
    for peak in [held, streamed] {
        assert!(peak.found <= peak.said, "more than the plan said: {peak:?}");
    }
    // The test is useful only if a run with the whole light field in memory exceeds the bound of
    // the run that streams the light field.
    assert!(held.found > streamed.said, "held {held:?}, streamed {streamed:?}");
    let (expected, found) = (results(&held_dir), results(&dir));
    assert!(expected.len() > 3 && expected.keys().eq(found.keys()), "{:?}", found.keys());
    for (path, bytes) in &expected {
        assert!(*bytes == found[path], "{}", path.display());
    }
}

fn display([cols, rows]: [usize; 2], views: &str) -> String {
    format!("[display]\npreset = \"paper-three-layer\"\nresolution = [{cols}, {rows}]\nframes = 2\n{views}")
}

/// Returns value `i` of a light field of the size [`SIZE`], which shows squares that shift from
/// view to view.
fn value(i: usize) -> f32 {
    let [cols, rows, views] = SIZE;
    let (channel, pixel) = (i % 3, i / 3);
    let (x, y, view) = (pixel % cols, pixel / cols % rows, pixel / (cols * rows));
    let (x, y) = (x + view % views, y + view / views);
    if (x / 16 + y / 12 + channel).is_multiple_of(2) { 0.25 } else { 0.625 }
}

#[test]
fn a_given_light_field_is_read_and_solved_within_its_bound() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npy");
    let [cols, rows, views] = SIZE;
    let data: Vec<f32> = (0..views * views * rows * cols * 3).map(value).collect();
    npy::write(&path, &[views, views, rows, cols, 3], &data).unwrap();
    drop(data);
    let geometry = "[geometry]\ngrid = \"oblique\"\nfov_deg = [10.0, 10.0]\npitch_mm = 1.0\n";
    check(&format!("light_field = {path:?}\n{}{geometry}[render]\n", display([cols, rows], "")), 24, None);
}

/// A folder of views has one file per view, so a run reads them one by one.
#[test]
fn a_folder_of_views_is_read_and_solved_within_its_bound() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("views");
    std::fs::create_dir(&path).unwrap();
    let [cols, rows, views] = SIZE;
    let grid = ViewGrid::uniform(Projection::Oblique, [views, views], [10.0, 10.0]).unwrap();
    let geometry = FieldGeometry { rows, cols, pitch_mm: 1.0, grid };
    for (number, view) in geometry.grid.iter().enumerate() {
        let size = rows * cols * 3;
        let rgb: Vec<f32> = (number * size..(number + 1) * size).map(value).collect();
        write_view(&path, &geometry, view, &rgb).unwrap();
    }
    write_index(&path, &geometry, &serde_json::Map::new()).unwrap();
    check(&format!("light_field = {path:?}\n{}[render]\n", display([cols, rows], "")), 24, Some("factorize"));
}

fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/letters/letters.gltf")
}

#[test]
fn fixed_views_are_rendered_and_solved_within_their_bound() {
    let render = "[render]\nsamples = 1\nmax_bounces = 0\n";
    let [cols, rows, views] = SIZE;
    let views = format!("views = [{views}, {views}]\n");
    check(&format!("scene = {:?}\n{}{render}", scene(), display([cols, rows], &views)), 24, Some("factorize"));
}

/// Fixed views that share light also get further paths.
#[test]
fn fixed_views_that_share_light_are_rendered_within_their_bound() {
    let render = "[render]\nsamples = 1\nmax_bounces = 1\ndenoise = \"shared\"\n";
    let [cols, rows, views] = SIZE;
    let views = format!("views = [{views}, {views}]\n");
    check(&format!("scene = {:?}\n{}{render}", scene(), display([cols, rows], &views)), 24, Some("factorize"));
}

#[test]
fn chosen_views_are_rendered_and_solved_within_their_bound() {
    // A number of samples is given, since measuring it would take most of the time.
    let render = "[render]\nzone_samples = 100\nmax_bounces = 0\n";
    check(&format!("scene = {:?}\n{}{render}", scene(), display([400, 160], "")), 24, Some("factorize"));
}
