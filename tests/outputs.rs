//! Tests outputs, which independent software reads. Also tests light fields from source plugins,
//! and files that parameters of plugins name.

use std::path::Path;
use std::process::Command;

use crate::common::{fail, files, lumistack, number, report, root, succeed};

/// Returns true if the result of a stage came from an earlier run.
fn cached(run: &Path, name: &str) -> bool {
    let report = report(run);
    let stages = report["stages"].as_array().unwrap();
    let stage = stages.iter().find(|stage| stage["name"] == name).unwrap_or_else(|| panic!("no stage {name}"));
    stage["cached"] == true
}

fn run_job(job: &Path, run: &Path) -> String {
    succeed(lumistack().arg("run").arg(job).arg("-o").arg(run))
}

#[test]
fn independent_software_reads_every_output() {
    let Some(python) = lumistack_testkit::skip::python_with("numpy, PIL, OpenEXR") else { return };
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    run_job(&root().join("tests/cases/all-outputs/job.toml"), &run);
    println!("{}", succeed(Command::new(&python).arg(root().join("tests/check_outputs.py")).arg(&run)));
}

const NUMBERS: &str = r#"
[source]
plugin = "test_views"
params = { pattern = "cards", depth_mm = 12 }

[display]
preset = "fig7-uniform"
resolution = [60, 40]
views = [3, 1]

[factorize]
iterations = 5
"#;

#[test]
fn a_source_makes_the_light_field_once() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (folder.path().join("job.toml"), folder.path().join("run"));
    std::fs::write(&job, NUMBERS).unwrap();
    run_job(&job, &run);
    assert!(!cached(&run, "test_views"));
    let made = files(&run.join("target"));
    assert_eq!(made.len(), 1 + 3);
    assert!(number(&report(&run), "psnr_view") > 10.0);
    run_job(&job, &run);
    assert!(cached(&run, "test_views") && cached(&run, "factorize") && cached(&run, "output-images"));
    // replace a view of the light field in the run folder by another view
    std::fs::copy(run.join("target/view_00_00.exr"), run.join("target/view_00_02.exr")).unwrap();
    run_job(&job, &run);
    assert!(!cached(&run, "test_views"));
    std::fs::write(&job, NUMBERS.replace("12 }", "6 }")).unwrap();
    run_job(&job, &run);
    assert!(!cached(&run, "test_views") && made != files(&run.join("target")));
    // the job file in the run folder describes the same run
    run_job(&run.join("job.toml"), &run);
    assert!(cached(&run, "test_views"));
}

#[test]
fn a_sequence_counts_the_times_of_a_source() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (folder.path().join("job.toml"), folder.path().join("run"));
    std::fs::write(&job, format!("{NUMBERS}[sequence]\ntimes = 2\nduration_s = 0.5\n")).unwrap();
    run_job(&job, &run);
    let second = std::fs::read_to_string(run.join("t0002/job.toml")).unwrap();
    assert!(second.contains("time = 1") && second.contains("time_s = 0.5"), "{second}");
    assert!(run.join("t0001/outputs/tensor-display/images/images.json").is_file());
    let error = |text: &str| {
        std::fs::write(&job, format!("{NUMBERS}{text}")).unwrap();
        fail(lumistack().arg("run").arg(&job).arg("-o").arg(folder.path().join("wrong")))
    };
    assert!(error("[sequence]\n").contains("sequence.times: expected the number of time steps"));
    assert!(
        error("[sequence]\ntimes = 2\nturn_deg = 3.0\n")
            .contains("a job with `scene` for the keys `turn_deg` and `shift_mm`")
    );
    assert!(error("[pose]\ntime_s = 1.0\n").contains("pose: expected a job with `scene`"));
}

#[test]
fn a_job_has_one_input() {
    let folder = tempfile::tempdir().unwrap();
    let job = folder.path().join("job.toml");
    let error = |text: &str| {
        std::fs::write(&job, text).unwrap();
        fail(lumistack().arg("run").arg(&job).arg("-o").arg(folder.path().join("run")))
    };
    let text = error(&format!("light_field = \"views.npy\"\n{NUMBERS}"));
    assert!(text.contains("found `light_field` and `source`"), "{text}");
    let text = error(&NUMBERS.replace("test_views", "images"));
    assert!(text.contains("plugin `images`: expected a source, found an output"), "{text}");
    let text = error(&NUMBERS.replace("depth_mm", "depth"));
    assert!(text.contains("unknown parameter `depth`; did you mean `depth_mm`?"), "{text}");
}

#[test]
fn files_in_parameters_are_the_jobs_own() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (folder.path().join("sub/job.toml"), folder.path().join("run"));
    std::fs::create_dir(folder.path().join("sub")).unwrap();
    let output = "[[outputs]]\nplugin = \"quilt\"\nparams = { columns = 3, rows = 1, calibration = \"screen.json\" }\n";
    std::fs::write(&job, format!("{NUMBERS}{output}")).unwrap();
    // the calibration file is missing, which is an error before any work begins
    let error = fail(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
    assert!(error.contains("outputs[0].params.calibration: expected a readable file"), "{error}");
    assert!(error.contains("screen.json") && !run.exists(), "{error}");
    let screen = |center: f64| {
        let text = format!(
            r#"{{"pitch": 50.0, "slope": -7.0, "center": {center}, "DPI": 324, "screenW": 90, "screenH": 60, "invView": 1}}"#
        );
        std::fs::write(folder.path().join("sub/screen.json"), text).unwrap();
    };
    screen(0.25);
    run_job(&job, &run);
    let native = || std::fs::read(run.join("outputs/tensor-display/quilt/quilt_native.png")).unwrap();
    let before = native();
    run_job(&job, &run);
    assert!(cached(&run, "output-quilt"));
    // the content of the calibration file changes, but neither the file's length nor its name
    screen(0.75);
    run_job(&job, &run);
    assert!(!cached(&run, "output-quilt") && cached(&run, "factorize") && before != native());
    // the job file in the run folder finds its calibration file, even if lumistack is started in
    // another working folder
    succeed(lumistack().arg("run").arg(run.join("job.toml")).arg("-o").arg(&run).current_dir(folder.path()));
    assert!(cached(&run, "output-quilt"));
}
