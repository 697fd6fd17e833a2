//! Runs with a denoiser: their reports, caches and resumption, sequences, and the message about a
//! missing program.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::common::{fail, files, lumistack, number, report, root, succeed};

const SMALL: [&str; 10] =
    ["--resolution", "64x40", "--frames", "2", "--samples", "4", "--iterations", "5", "--max-bounces", "3"];

fn still_life(folder: &Path, denoise: &str) -> Command {
    let mut command = lumistack();
    command.arg("run").arg(root().join("scenes/still-life/still-life.gltf")).arg("-o").arg(folder);
    command.args(SMALL).args(["--views", "5x5", "--denoise", denoise]);
    command
}

fn cached(report: &Value, name: &str) -> bool {
    let stages = report["stages"].as_array().unwrap();
    stages.iter().find(|stage| stage["name"] == name).unwrap()["cached"].as_bool().unwrap()
}

/// Returns a value of the report and its standard error, which the report states as a pair.
fn pair(value: &Value) -> [f64; 2] {
    [0, 1].map(|i| value[i].as_f64().unwrap())
}

#[test]
fn a_denoised_run_reports_its_errors_and_resumes_from_its_halves() {
    let folder = tempfile::tempdir().unwrap();
    let (plain, run) = (folder.path().join("plain"), folder.path().join("run"));
    succeed(&mut still_life(&plain, "off"));
    assert!(report(&plain)["denoising"].is_null());
    succeed(&mut still_life(&run, "guided"));
    let first = report(&run);
    let reported = &first["denoising"];
    let ([before, _], [after, after_error]) = (pair(&reported["mse_before"]), pair(&reported["mse_after"]));
    let ([change, change_error], mean) = (pair(&reported["mean_change"]), number(reported, "mean"));
    println!("{before} {after} ± {after_error}, mean {mean} {change} ± {change_error}");
    assert!(after < 0.5 * before, "{reported}");
    assert!(change.abs() < 0.02 * mean && change_error < 0.02 * mean, "{reported}");
    assert_eq!(reported["views"].as_array().unwrap().len(), 25);
    let html = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(html.contains("id=\"denoising\"") && html.contains("guided filter"));

    // a second run reuses all results
    succeed(&mut still_life(&run, "guided"));
    assert!(cached(&report(&run), "render"));
    let target = files(&run.join("target"));
    assert!(target != files(&plain.join("target")), "filtered and unfiltered views are the same");
    // if a filtered view is deleted, the run filters it again, but traces no view again
    let views = run.join("cache/views");
    let of = |suffix: &str| -> Vec<_> {
        files(&views).into_iter().filter(|(path, _)| path.to_string_lossy().ends_with(suffix)).collect()
    };
    let filtered: Vec<_> =
        of("view_02_02.exr").into_iter().filter(|(path, _)| path.to_string_lossy().contains("guided")).collect();
    let (lost, bytes) = filtered.iter().find(|(path, _)| path.starts_with(first_target(&views))).unwrap();
    std::fs::remove_file(views.join(lost)).unwrap();
    let traced = views.join(first_target(&views)).join("view_02_02-a.exr");
    let written = std::fs::metadata(&traced).unwrap().modified().unwrap();
    succeed(&mut still_life(&run, "guided"));
    assert!(!cached(&report(&run), "render"));
    assert_eq!(&std::fs::read(views.join(lost)).unwrap(), bytes);
    assert_eq!(std::fs::metadata(&traced).unwrap().modified().unwrap(), written, "the halves were traced again");
    assert!(target == files(&run.join("target")));
}

/// Returns the name of the folder with the target's views.
fn first_target(views: &Path) -> std::path::PathBuf {
    let entries = std::fs::read_dir(views).unwrap().map(|entry| entry.unwrap().file_name());
    entries.map(std::path::PathBuf::from).find(|name| name.to_string_lossy().starts_with("target-")).unwrap()
}

#[test]
fn every_time_step_of_a_sequence_is_denoised() {
    let folder = tempfile::tempdir().unwrap();
    let (run, job) = (folder.path().join("run"), folder.path().join("job.toml"));
    let scene = root().join("scenes/still-life/still-life.gltf");
    let display = "[display]\npreset = \"paper-three-layer\"\nresolution = [64, 40]\nframes = 2";
    let render = "[render]\nsamples = 4\nmax_bounces = 3\ndenoise = \"guided\"";
    let sequence = "[sequence]\ntimes = 2\nturn_deg = 4.0\niterations = 2\nreports = true";
    let factorize = "[factorize]\niterations = 5";
    std::fs::write(&job, format!("scene = {scene:?}\n{display}\n{render}\n{factorize}\n{sequence}\n")).unwrap();
    succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
    for time in ["t0001", "t0002"] {
        let reported = report(&run.join(time))["denoising"].clone();
        assert!(pair(&reported["mse_after"])[0] < 0.5 * pair(&reported["mse_before"])[0], "{time}: {reported}");
    }
}

#[test]
fn a_missing_program_is_named_before_anything_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let error = fail(still_life(&run, "oidn").env("LUMISTACK_OIDN", folder.path().join("nothing")));
    assert!(error.contains("oidnDenoise") && error.contains("nothing"), "{error}");
    let error = fail(still_life(&run, "oidn").env_remove("LUMISTACK_OIDN").env("PATH", folder.path()));
    assert!(error.contains("pyoidn") && error.contains("guided"), "{error}");
    let traced = files(&run.join("cache")).iter().any(|(path, _)| path.to_string_lossy().contains("view_"));
    assert!(!traced, "views were traced before the filter was looked for");
}

/// A test program replaces `oidnDenoise`, and returns its input unchanged. It must receive all
/// pictures, and the run must use its result.
#[cfg(unix)]
#[test]
fn the_external_denoiser_receives_pictures_and_its_result_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let (run, program) = (folder.path().join("run"), folder.path().join("oidnDenoise"));
    let script = r#"#!/bin/sh
if [ "$1" = --help ]; then echo "Open Image Denoise stand-in"; exit; fi
while [ $# -gt 0 ]; do case "$1" in --hdr) in="$2";; --alb) alb="$2";; --nrm) nrm="$2";; -o) out="$2";; esac; shift; done
test -s "$alb" && test -s "$nrm" && cp "$in" "$out"
"#;
    // If this process wrote the program, processes of other tests could keep the file open, and the
    // system would refuse to run it.
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", "printf %s \"$1\" > \"$0\" && chmod 755 \"$0\""]).arg(&program).arg(script);
    assert!(shell.status().unwrap().success());
    succeed(still_life(&run, "oidn").env("LUMISTACK_OIDN", &program));
    let reported = report(&run)["denoising"].clone();
    // the test program returns its input unchanged, so errors and mean do not change
    assert_eq!(reported["mse_before"], reported["mse_after"], "{reported}");
    assert!(
        pair(&reported["mean_change"])[0].abs() < 1e-6 && reported["name"].as_str().unwrap().contains("Open Image")
    );
    assert!(!files(&run.join("cache")).iter().any(|(path, _)| path.to_string_lossy().contains("exchange")));
}
