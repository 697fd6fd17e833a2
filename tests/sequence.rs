//! Sequences: warm starts, flicker, runs that are resumed, and the error for light fields whose
//! geometries differ.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::common::{
    fail, files, interrupt, interruptible, lumistack, number, report, root, serve_preview, succeed, write_test_field,
};

/// Largest difference, dB, by which the PSNR after 5 iterations from a warm start may be below the
/// PSNR after 30 iterations from a fresh start. This applies to the solver `multiplicative`.
const WARM_LOSS_DB: f64 = 1.0;
/// Smallest difference, dB, by which the PSNR after 5 iterations from a warm start must exceed the
/// PSNR after 5 iterations from a fresh start. This applies to all solvers.
const WARM_GAIN_DB: f64 = 1.0;
/// Largest relative difference between the exposures of the time steps of a sequence.
const SAME_EXPOSURE: f64 = 1e-9;

const FLAGS: [&str; 6] = ["--fov", "20x20", "--pitch-mm", "3", "--frames", "4"];
const VIEWS: [usize; 2] = [3, 5];
const SIZE: [usize; 2] = [40, 64];

/// Writes a light field as `.npy`. It shows a textured plane 30 mm behind the display, shifted by
/// `shift` pixels to the right.
fn write_moving_field(path: &Path, shift: f64, [rows, cols]: [usize; 2]) {
    use npyz::WriterBuilder;
    let [views_y, views_x] = VIEWS;
    let slope = |view: usize, count: usize| {
        (view as f64 - (count as f64 - 1.0) / 2.0) * 2.0 / count as f64 * 10f64.to_radians().tan()
    };
    let mut values: Vec<f32> = Vec::new();
    for (view_y, view_x) in (0..views_y).flat_map(|y| (0..views_x).map(move |x| (y, x))) {
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let x = col as f64 - shift - 10.0 * slope(view_x, views_x);
            let y = row as f64 - 10.0 * slope(view_y, views_y);
            let wave = |k: f64, phase: f64| {
                (0.16 * k * x + phase).sin() * (0.14 * k * y - phase).cos()
                    + 0.5 * (0.35 * x - 0.23 * k * y + phase).sin()
            };
            values.extend([1.0, 1.3, 1.7].map(|k| (0.45 + 0.25 * wave(k, 2.0 * k)) as f32));
        }
    }
    let shape = [views_y, views_x, rows, cols, 3].map(|n| n as u64);
    let file = std::fs::File::create(path).unwrap();
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd().unwrap();
    writer.extend(values).unwrap();
    writer.finish().unwrap();
}

/// Writes `count` time steps, between which the plane moves by `step` pixels.
fn moving(folder: &Path, count: usize, step: f64) -> PathBuf {
    let times = folder.join("times");
    std::fs::create_dir(&times).unwrap();
    // the names f8, f9, f10 test the order: alphabetically f10 would come first
    (0..count).for_each(|time| write_moving_field(&times.join(format!("f{}.npy", time + 8)), step * time as f64, SIZE));
    times
}

fn factorize(input: &Path, run: &Path) -> Command {
    let mut command = lumistack();
    command.arg("factorize").arg(input).arg("-o").arg(run).args(FLAGS);
    command
}

fn times(run: &Path) -> Vec<Value> {
    report(run)["times"].as_array().unwrap().clone()
}

/// The simulator's page shows one time step, so `preview` shows the first one of a sequence. The
/// last lines of the run and a warning of `preview` name the folder of the last time step.
#[test]
fn a_sequence_is_watched_by_its_time_steps() {
    let folder = tempfile::tempdir().unwrap();
    let input = moving(folder.path(), 2, 1.0);
    let run = folder.path().join("run");
    let text = succeed(factorize(&input, &run).args(["--sequence", "--iterations", "2"]));
    let last = format!("preview {}", run.join("t0002").display());
    assert!(text.contains(&format!("preview {}\n", run.display())) && text.contains(&last), "{text}");
    let text = succeed(lumistack().arg("info").arg(&run));
    assert!(text.contains("time steps: 2") && text.contains("name: t0002"), "{text}");
    let events = serve_preview(&run);
    let event = |kind: &str| events.iter().find(|event| event["event"] == kind).unwrap_or_else(|| panic!("{events:?}"));
    assert_eq!(event("serving")["preview"], run.join("t0001/preview").to_str().unwrap());
    assert!(event("warning")["message"].as_str().unwrap().contains(&last), "{events:?}");
    assert!(run.join("t0001/preview/stack/preview.json").is_file());
}

#[test]
fn a_warm_start_saves_iterations() {
    let folder = tempfile::tempdir().unwrap();
    let input = moving(folder.path(), 4, 2.0);
    let run = folder.path().join("run");
    for solver in ["multiplicative", "auto"] {
        let sequence = ["--sequence", "--solver", solver, "--iterations", "30"];
        let text = succeed(factorize(&input, &run).args(sequence));
        assert!(text.contains("views of 4 time steps; flicker"), "{text}");
        let times = times(&run);
        assert_eq!(times.iter().map(|t| t["iterations"].as_u64().unwrap()).collect::<Vec<_>>(), [30, 5, 5, 5]);
        let warm = number(&times[3], "psnr_view");
        let [few, many] = ["5", "30"].map(|iterations| {
            let still = folder.path().join("still");
            let flags = ["--solver", solver, "--iterations", iterations];
            succeed(factorize(&input.join("f11.npy"), &still).args(flags));
            number(&report(&still), "psnr_view")
        });
        println!("{solver}: 5 warm {warm:.2} dB, 5 from nothing {few:.2} dB, 30 from nothing {many:.2} dB");
        assert!(warm > few + WARM_GAIN_DB, "{solver}: {warm} dB, from nothing {few} dB");
        if solver == "multiplicative" {
            assert!(warm > many - WARM_LOSS_DB, "{warm} dB, 30 from nothing {many} dB");
        }
        // Every time step after the first starts from the result of the previous time step. The
        // PSNR of this start is below the PSNR of the time step's own result.
        assert!(times[1..].iter().all(|time| number(time, "psnr_start") < number(time, "psnr_view")));
    }
}

/// In the middle of the sequence the content is replaced by other content (a cut). At the cut the
/// patterns of the previous time step are a bad start, so the time step has a fresh start.
#[test]
fn a_cut_starts_fresh() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("times");
    std::fs::create_dir(&input).unwrap();
    let shot = |time: usize| input.join(format!("f{time}.npy"));
    (0..2).for_each(|time| write_moving_field(&shot(time), time as f64, SIZE));
    (2..4).for_each(|time| write_test_field(&shot(time), [VIEWS[0], VIEWS[1], SIZE[0], SIZE[1]], 20.0, 3.0));
    let run = folder.path().join("run");
    succeed(factorize(&input, &run).args(["--sequence", "--iterations", "30"]));
    let times = times(&run);
    let starts: Vec<&str> = times.iter().map(|time| time["start"].as_str().unwrap()).collect();
    assert_eq!(starts, ["content", "warm", "content", "warm"]);
    let alone = folder.path().join("alone");
    succeed(factorize(&shot(2), &alone).args(["--iterations", "5"]));
    let (cut, fresh) = (number(&times[2], "psnr_view"), number(&report(&alone), "psnr_view"));
    assert!(cut > fresh - 1e-6, "{cut} dB at the cut, {fresh} dB from a fresh start");
    // The job file of a time step states whether it starts warm or fresh. So a run of this file
    // alone gives the same patterns.
    let patterns = files(&run.join("t0003/layers"));
    let again = folder.path().join("again");
    succeed(lumistack().arg("run").arg(run.join("t0003/job.toml")).arg("-o").arg(&again));
    assert!(files(&again.join("layers")) == patterns);
}

#[test]
fn static_content_does_not_flicker() {
    let folder = tempfile::tempdir().unwrap();
    let input = moving(folder.path(), 3, 0.0);
    let run = folder.path().join("run");
    let flags = ["--sequence", "--iterations", "30", "--sequence-iterations"];
    succeed(factorize(&input, &run).args(flags).arg("0"));
    let frozen = times(&run);
    assert_eq!((&frozen[0]["psnr_change"], &frozen[1]["psnr_change"]), (&Value::Null, &"Infinity".into()));
    assert_eq!((number(&frozen[2], "still_share"), number(&frozen[2], "psnr_still")), (1.0, f64::INFINITY));
    assert!(files(&run.join("t0001/layers")) == files(&run.join("t0003/layers")));
    // The content stands still. So with warm starts the patterns change little, and less with each
    // time step.
    succeed(factorize(&input, &run).args(flags).arg("5"));
    let settling = times(&run);
    let change = [1, 2].map(|time| number(&settling[time], "psnr_change"));
    assert!(
        change[0] > number(&settling[0], "psnr_view") && change[1] > change[0] && change[1].is_finite(),
        "{change:?}"
    );
    // if the content moves, flicker is larger and the score is lower
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    succeed(factorize(&moving(&other, 3, 2.0), &run).args(flags).arg("5"));
    let moving = times(&run);
    assert!(number(&moving[2], "psnr_change") < change[1] && number(&moving[2], "still_share") < 0.5);
}

#[test]
fn a_mismatched_light_field_stops_a_sequence_and_finished_time_steps_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let input = moving(folder.path(), 4, 2.0);
    let run = folder.path().join("run");
    let odd = input.join("f10.npy");
    write_moving_field(&odd, 4.0, [SIZE[0], SIZE[1] - 1]);
    let error = fail(factorize(&input, &run).arg("--sequence"));
    for part in [
        "f10.npy: geometry: expected the same rays as in",
        "f9.npy",
        "5 × 3 views of 64 × 40",
        "found 5 × 3 views of 63 × 40",
    ] {
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
    assert!(!run.join("report.html").exists() && !run.join("t0003/layers").exists());
    let before = ["t0001", "t0002"].map(|time| written(&run.join(time)));
    write_moving_field(&odd, 4.0, SIZE);
    succeed(factorize(&input, &run).arg("--sequence"));
    let cached = |run: &Path| times(run).iter().map(|time| time["cached"].as_bool().unwrap()).collect::<Vec<_>>();
    assert_eq!(cached(&run), [true, true, false, false]);
    let parts = |list: &[(PathBuf, std::time::SystemTime)]| {
        // omit job.toml and display.toml, which every run writes again
        list.iter().filter(|(path, _)| path.extension().is_none_or(|e| e != "toml")).cloned().collect::<Vec<_>>()
    };
    for (time, before) in ["t0001", "t0002"].iter().zip(&before) {
        assert!(parts(before) == parts(&written(&run.join(time))), "{time} was done again");
    }
}

/// Returns all files in a folder and its subfolders with their modification times.
fn written(folder: &Path) -> Vec<(PathBuf, std::time::SystemTime)> {
    let mut list = Vec::new();
    for (path, _) in files(folder) {
        let modified = std::fs::metadata(folder.join(&path)).unwrap().modified().unwrap();
        list.push((path, modified));
    }
    list
}

#[test]
fn an_interrupted_sequence_resumes_after_its_finished_time_steps() {
    let folder = tempfile::tempdir().unwrap();
    let input = moving(folder.path(), 6, 2.0);
    let (stopped, whole) = (folder.path().join("stopped"), folder.path().join("whole"));
    let flags = ["--sequence", "--iterations", "60", "--sequence-iterations", "60"];
    let mut child = interruptible(&mut factorize(&input, &stopped))
        .args(flags)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !stopped.join("t0002/cache/measure.json").exists() && child.try_wait().unwrap().is_none() {
        assert!(start.elapsed() < Duration::from_secs(120), "two time steps were not finished in two minutes");
        std::thread::sleep(Duration::from_millis(2));
    }
    interrupt(&child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(!stopped.join("report.html").exists());
    succeed(factorize(&input, &stopped).args(flags));
    succeed(factorize(&input, &whole).args(flags));
    let cached: Vec<bool> = times(&stopped).iter().map(|time| time["cached"].as_bool().unwrap()).collect();
    assert!(cached.starts_with(&[true, true]) && cached.ends_with(&[false]), "{cached:?}");
    for time in 1..=6 {
        for part in ["target", "layers", "outputs"] {
            let part = Path::new(&format!("t{time:04}")).join(part);
            assert!(files(&stopped.join(&part)) == files(&whole.join(&part)), "{} differs", part.display());
        }
    }
}

#[test]
fn a_window_moves_through_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let scene = root().join("scenes/still-life/still-life.gltf");
    let small = ["--resolution", "42x26", "--frames", "2", "--samples", "1", "--iterations", "5", "--max-bounces", "2"];
    let motion = ["--times", "3", "--turn-deg", "30", "--shift-mm", "20,0,0"];
    succeed(lumistack().arg("run").arg(&scene).arg("-o").arg(&run).args(small).args(motion));
    let exposure = |time: &str| {
        let text = std::fs::read(run.join(time).join("target/lightfield.json")).unwrap();
        let index: Value = serde_json::from_slice(&text).unwrap();
        index["exposure"].as_f64().or_else(|| index["info"]["exposure"].as_f64()).expect("the exposure is noted")
    };
    assert!((exposure("t0003") / exposure("t0001") - 1.0).abs() < SAME_EXPOSURE);
    assert!(files(&run.join("t0001/target")) != files(&run.join("t0002/target")));
    assert!(times(&run)[1]["source"].as_str().unwrap().contains("turned by 15.0° and moved by (10.0, 0.0, 0.0) mm"));
    assert!(!run.join("t0002/report.html").exists());
    // every time step has its own job; a run of this job uses the cached results
    let patterns = files(&run.join("t0002/layers"));
    succeed(lumistack().arg("run").arg(run.join("t0002/job.toml")).arg("-o").arg(run.join("t0002")));
    let stages = report(&run.join("t0002"))["stages"].clone();
    let factorize = stages.as_array().unwrap().iter().find(|stage| stage["name"] == "factorize").unwrap();
    assert_eq!(factorize["cached"], true);
    assert!(patterns == files(&run.join("t0002/layers")));
}

/// Writes a scene of a red square in front of a grey one. The material variant `Blue` makes the red
/// square blue. In one second the red square moves by half of its width.
fn write_gliding_square(path: &Path) {
    use base64::Engine;
    let mut bin: Vec<u8> = Vec::new();
    let corners = [-1.0f32, -1.0, 0.0, 1.0, -1.0, 0.0, -1.0, 1.0, 0.0, 1.0, 1.0, 0.0];
    let (keys, places) = ([0.0f32, 1.0], [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0]);
    bin.extend(corners.iter().chain(&keys).chain(&places).flat_map(|value| value.to_le_bytes()));
    let data = base64::engine::general_purpose::STANDARD.encode(&bin);
    let view =
        |offset: usize, length: usize| serde_json::json!({"buffer": 0, "byteOffset": offset, "byteLength": length});
    let accessor = |view: usize, kind: &str, count: usize| serde_json::json!({"bufferView": view, "componentType": 5126, "type": kind, "count": count});
    let colour = |rgb: [f32; 3]| {
        serde_json::json!({"emissiveFactor": rgb, "extensions": {"KHR_materials_unlit": {}}, "doubleSided": true,
        "pbrMetallicRoughness": {"baseColorFactor": [rgb[0], rgb[1], rgb[2], 1.0]}})
    };
    let gltf = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"mesh": 1, "translation": [0, 0, -0.2], "scale": [3, 3, 1]}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "mode": 5, "material": 0,
                "extensions": {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}}}]},
            {"primitives": [{"attributes": {"POSITION": 0}, "mode": 5, "material": 2}]}],
        "materials": [colour([0.9, 0.1, 0.1]), colour([0.1, 0.1, 0.9]), colour([0.3, 0.3, 0.3])],
        "extensions": {"KHR_materials_variants": {"variants": [{"name": "Blue"}]}},
        "buffers": [{"byteLength": bin.len(), "uri": format!("data:application/octet-stream;base64,{data}")}],
        "bufferViews": [view(0, 48), view(48, 8), view(56, 24)],
        "accessors": [accessor(0, "VEC3", 4), accessor(1, "SCALAR", 2), accessor(2, "VEC3", 2)],
        "animations": [{"name": "Glide", "samplers": [{"input": 1, "output": 2}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}],
    });
    std::fs::write(path, gltf.to_string()).unwrap();
}

#[test]
fn an_animated_scene_plays() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("square.gltf");
    write_gliding_square(&scene);
    let info = succeed(lumistack().arg("info").arg(&scene));
    assert!(info.contains("Glide (1.00 s)") && info.contains("Blue"), "{info}");

    let small = ["--resolution", "42x26", "--frames", "2", "--samples", "1", "--iterations", "5", "--max-bounces", "1"];
    let run = folder.path().join("run");
    let play = ["--times", "3", "--duration-s", "0.5", "--time", "0.25"];
    succeed(lumistack().arg("run").arg(&scene).arg("-o").arg(&run).args(small).args(play));
    let source = |time: usize| times(&run)[time]["source"].as_str().unwrap().to_owned();
    assert!(source(0).starts_with("at 0.250 s") && source(2).starts_with("at 0.750 s"), "{}", source(2));
    let target = |run: &Path| files(&run.join("target"));
    assert!(target(&run.join("t0001")) != target(&run.join("t0002")));
    assert!(target(&run.join("t0002")) != target(&run.join("t0003")));
    // The last time step has its own job, which states its pose. If this job runs with another pose
    // in the folder of the time step, it must not use cached results.
    let last = run.join("t0003");
    let before = target(&last);
    succeed(lumistack().arg("run").arg(last.join("job.toml")).arg("-o").arg(&last));
    assert!(target(&last) == before);
    succeed(lumistack().arg("run").arg(last.join("job.toml")).arg("-o").arg(&last).args(["--time", "0"]));
    assert!(target(&last) != before);
    let moved = target(&last);
    succeed(lumistack().arg("run").arg(last.join("job.toml")).arg("-o").arg(&last).args([
        "--time",
        "0",
        "--variant",
        "Blue",
    ]));
    assert!(target(&last) != moved);
    let error =
        fail(lumistack().arg("run").arg(last.join("job.toml")).arg("-o").arg(&last).args(["--variant", "Green"]));
    assert!(error.contains("0 (Blue)") && error.contains("found Green"), "{error}");
    let error = fail(lumistack().arg("run").arg(&scene).arg("-o").arg(&last).args(["--animation", "Crawl"]));
    assert!(error.contains("0 (Glide)") && error.contains("found Crawl"), "{error}");
}

#[test]
fn jobs() {
    let folder = tempfile::tempdir().unwrap();
    let (job, run) = (folder.path().join("job.toml"), folder.path().join("run"));
    let input = moving(folder.path(), 2, 1.0);
    let scene = root().join("scenes/glass/glass.gltf");
    let check = |input: &Path, keys: &str, parts: &[&str]| {
        let kind = if input == scene.as_path() { "scene" } else { "light_field" };
        let text = format!("{kind} = {input:?}\n[display]\npreset = \"fig7-uniform\"\n[sequence]\n{keys}\n");
        std::fs::write(&job, text).unwrap();
        let error = fail(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
        for part in parts {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
        assert!(!run.exists(), "nothing is written");
    };
    check(&scene, "iterations = 3", &["sequence.times", "nothing"]);
    check(&scene, "times = 0", &["sequence.times", "1 to 9999", "0"]);
    check(&scene, "times = 2\nturn = 3", &["line 6", "turn", "turn_deg"]);
    check(&input, "turn_deg = 3.0", &["sequence", "a job without `scene`"]);
    check(&input, "duration_s = 3.0", &["sequence", "duration_s", "light fields"]);
    check(&scene, "times = 2\nduration_s = inf", &["sequence.duration_s", "finite"]);
    check(&input, "[pose]\ntime_s = 1.0", &["pose", "only scenes have poses"]);
    check(&scene, "times = 2\n[pose]\ntime_s = nan", &["pose.time_s", "a finite number of seconds"]);
    check(&input, "times = 3", &["times", "at least 3 light fields", "found 2"]);
    check(&input.join("f8.npy"), "", &["f8.npy", "readable"]);
}
