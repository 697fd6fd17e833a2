//! Whole runs of the binary: jobs in `tests/cases`, light fields of other projects, runs that are
//! killed and resumed, and equal bytes on any number of threads.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::common::{
    fail, files, interrupt, interruptible, light_fields, lumistack, number, python, report, root, succeed,
    write_test_field,
};

/// Largest difference between the report's PSNR and the PSNR of an independent forward model, dB.
const PSNR_AGREEMENT_DB: f64 = 0.01;

/// Largest loss of PSNR that a case may have against the PSNR in its file, dB. Other instruction
/// sets round differently, which also changes the noise.
const MAY_LOSE_DB: f64 = 0.3;
/// Largest gain of PSNR that a case may have against the PSNR in its file, dB. If the gain is
/// larger, the file must be written again, since an outdated value would hide a later loss.
const MAY_GAIN_DB: f64 = 1.0;

/// Each folder of `tests/cases` has a job and `expected.json`, which has the expected PSNR and the
/// names of files that must exist. LUMISTACK_WRITE=1 measures the values again.
#[test]
fn every_case_gives_its_expected_psnr() {
    let renew = std::env::var_os("LUMISTACK_WRITE").is_some();
    let (mut count, mut wrong) = (0, Vec::new());
    for entry in std::fs::read_dir(root().join("tests/cases")).unwrap() {
        let entry = entry.unwrap();
        let case = entry.path();
        let expected: serde_json::Value =
            serde_json::from_slice(&std::fs::read(case.join("expected.json")).unwrap()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let text = succeed(lumistack().arg("run").arg(case.join("job.toml")).arg("-o").arg(&run));
        let last = text.lines().last().unwrap_or_default();
        assert_eq!(Path::new(last), run.join("report.html"), "the last line is the report's path");
        for file in expected["files"].as_array().unwrap() {
            assert!(run.join(file.as_str().unwrap()).is_file(), "{}: {file} is missing", case.display());
        }
        let report = report(&run);
        let (psnr, wanted) = (number(&report, "psnr_view"), expected["psnr_view"].as_f64().unwrap_or(f64::NAN));
        let name = entry.file_name();
        println!("{}: {psnr:.2} dB (expected {wanted})", name.display());
        if renew {
            let names: Vec<String> =
                expected["files"].as_array().unwrap().iter().map(|name| name.to_string()).collect();
            let text = format!("{{ \"psnr_view\": {psnr:.2}, \"files\": [{}] }}\n", names.join(", "));
            std::fs::write(case.join("expected.json"), text).unwrap();
        } else if psnr > wanted + MAY_GAIN_DB {
            wrong.push(format!(
                "{}: {psnr:.2} dB is better than the expected {wanted} dB: raise `psnr_view` in expected.json",
                name.display()
            ));
        } else if psnr.is_nan() || wanted.is_nan() || psnr < wanted - MAY_LOSE_DB {
            wrong.push(format!("{}: {psnr:.2} dB, expected {wanted}", name.display()));
        }
        count += 1;
    }
    assert!(count >= 3, "the cases are found");
    let how = "LUMISTACK_WRITE=1 cargo test -p lumistack-cli --test end_to_end every_case writes the new figures";
    assert!(wrong.is_empty(), "{}\n{how}", wrong.join("\n"));
}

#[test]
fn a_numpy_forward_model_gives_the_reports_figures() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let field = folder.path().join("views.npy");
    write_test_field(&field, [3, 5, 31, 50], 20.0, 3.0);
    let run = folder.path().join("run");
    let flags = ["--grid", "oblique", "--fov", "20x20", "--pitch-mm", "3", "--frames", "3", "--iterations", "20"];
    succeed(lumistack().arg("factorize").arg(&field).arg("-o").arg(&run).args(flags));
    check_with_numpy(&python, &field, &run, ["3.0", "20", "20", "0.2"]);
    let Some(folder) = light_fields() else { return };
    let field = folder.join("main_5x5_160x100_fov20.npy");
    succeed(lumistack().arg("factorize").arg(&field).arg("-o").arg(&run).args(["--frames", "6", "--iterations", "10"]));
    check_with_numpy(&python, &field, &run, ["2.961", "20", "20", "0.2"]);
}

fn check_with_numpy(python: &Path, field: &Path, run: &Path, geometry: [&str; 4]) {
    let mut command = Command::new(python);
    command.arg(root().join("tests/forward.py")).arg(field).arg(run.join("layers")).arg("-40,0,40").args(geometry);
    let figures: Vec<f64> = succeed(&mut command).split_whitespace().map(|word| word.parse().unwrap()).collect();
    let report = report(run);
    for (figure, key) in figures.iter().zip(["psnr_view", "psnr_raw"]) {
        let ours = number(&report, key);
        assert!((figure - ours).abs() <= PSNR_AGREEMENT_DB, "{key}: numpy {figure}, report {ours}");
    }
}

/// Largest difference between the score of the NumPy model, which traces 2000 × 2000 rays per
/// pixel, and the score of our exact integration over pixels' areas, dB.
const ZONE_AGREEMENT_DB: f64 = 0.02;

/// The score psnr_zone of the report agrees with the score of a NumPy model. This holds for three
/// layers with oblique and with perspective views, and for a directional backlight.
#[test]
fn a_numpy_model_of_the_seen_picture_gives_the_reports_zone() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let preset = |name: &str| std::fs::read_to_string(root().join("scenes/displays").join(name)).unwrap();
    let three_layers = preset("paper-three-layer.toml");
    let perspective =
        three_layers.replace("projection = \"oblique\"", "projection = \"perspective\"\ndistance_mm = 900.0");
    let scene = root().join("scenes/still-life/still-life.gltf");
    for (name, display) in
        [("oblique", three_layers), ("perspective", perspective), ("directional", preset("paper-directional.toml"))]
    {
        let file = folder.path().join(format!("{name}.toml"));
        std::fs::write(&file, display).unwrap();
        let job = folder.path().join(format!("{name}-job.toml"));
        let text = format!(
            "scene = {scene:?}\noutputs = []\n[display]\nfile = {file:?}\nresolution = [56, 35]\nframes = 2\nviews = [3, 3]\n\
             [light]\ntone = \"linear\"\n[render]\nsamples = 2\nmax_bounces = 2\nheld_out = 0\noutside = 0\n\
             [factorize]\niterations = 10\n"
        );
        std::fs::write(&job, text).unwrap();
        let run = folder.path().join(name);
        succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
        let figures = succeed(Command::new(&python).arg(root().join("tests/seen.py")).arg(&run));
        let figures: Vec<f64> = figures.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let report = report(&run);
        for (figure, key) in figures.iter().zip(["psnr_zone", "psnr_zone_worst_tenth"]) {
            let ours = number(&report, key);
            println!("{name}: {key} {ours:.3} dB, NumPy {figure:.3} dB");
            assert!((figure - ours).abs() <= ZONE_AGREEMENT_DB, "{name}, {key}: numpy {figure}, report {ours}");
        }
    }
}

/// Writes an array of f32 as a `.npy` file.
fn write_array(path: &Path, shape: &[u64], values: impl IntoIterator<Item = f32>) {
    use npyz::WriterBuilder;
    let file = std::fs::File::create(path).unwrap();
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(file).begin_nd().unwrap();
    writer.extend(values).unwrap();
    writer.finish().unwrap();
}

fn messages(report: &serde_json::Value) -> Vec<String> {
    report["warnings"].as_array().unwrap().iter().map(|w| w["message"].as_str().unwrap().to_string()).collect()
}

#[test]
fn a_directional_backlight_follows_a_foreign_light_field() {
    let folder = tempfile::tempdir().unwrap();
    let field = folder.path().join("views.npy");
    write_test_field(&field, [5, 5, 50, 80], 20.0, 3.0);
    // The backlight is adapted to the views. With the backlights of the presets (3 × 3 bins, 48
    // degrees) the PSNR would only be 30.2 and 27.5 dB.
    for (display, least) in [("fig7-directional", 35.0), ("paper-directional", 32.0)] {
        let run = folder.path().join(display);
        let flags = ["--fov", "20x20", "--pitch-mm", "3", "--iterations", "30", "--display", display];
        succeed(lumistack().arg("factorize").arg(&field).arg("-o").arg(&run).args(flags));
        let report = report(&run);
        let psnr = number(&report, "psnr_view");
        println!("{display}: {psnr:.2} dB");
        assert!(psnr > least, "{display}: {psnr} dB");
        let said = messages(&report);
        assert!(
            said.iter().any(|text| text.contains("backlight is adapted to the light field")),
            "{display}: {said:?}"
        );
        let text = std::fs::read_to_string(run.join("display.toml")).unwrap();
        let backlight = text.split("[backlight]").nth(1).unwrap().split("[[").next().unwrap();
        assert!(backlight.contains("5,\n    5,") || backlight.contains("views = [5, 5]"), "{backlight}");
    }
    // no backlight can have bins for these 17 views, so the command reports an error
    let slopes: Vec<f64> = (0..17).map(|i| f64::from(i) * 1e-3).collect();
    write_array(&field, &[17, 17, 4, 6, 3], std::iter::repeat_n(0.5, 17 * 17 * 4 * 6 * 3));
    let index = serde_json::json!({"projection": "perspective", "distance_mm": 500, "pitch_mm": 60,
        "slope_x": slopes, "slope_y": slopes.iter().rev().collect::<Vec<_>>()});
    std::fs::write(field.with_extension("json"), index.to_string()).unwrap();
    let run = folder.path().join("refused");
    let mut command = lumistack();
    let error = fail(command.arg("factorize").arg(&field).arg("-o").arg(&run).args(["--display", "fig7-directional"]));
    assert!(error.contains("backlight.views") && error.contains("17 views whose slopes are 0.0010 apart"), "{error}");
}

#[test]
fn one_ray_does_not_decide_a_report_unseen() {
    let folder = tempfile::tempdir().unwrap();
    let (field, run) = (folder.path().join("views.npy"), folder.path().join("run"));
    // one ray is very bright; it is in the middle row of the middle view, where every ray hits all
    // layers
    const MIDDLE: usize = (4 * 20 + 10) * 32 * 3 + 48;
    let values = (0..3 * 3 * 20 * 32 * 3).map(|i| if i == MIDDLE { 1e4 } else { 0.3 + 0.2 * (i as f32 * 0.01).sin() });
    write_array(&field, &[3, 3, 20, 32, 3], values);
    let factorize = |more: &[&str]| {
        let flags = ["--fov", "20x20", "--pitch-mm", "3", "--iterations", "5", "--frames", "2"];
        succeed(lumistack().arg("factorize").arg(&field).arg("-o").arg(&run).args(flags).args(more));
        report(&run)
    };
    let plain = factorize(&[]);
    let (said, psnr) = (messages(&plain).join("; "), number(&plain, "psnr_view"));
    assert!(said.contains("values above 1: 1 of 17280 values; the largest value is 10000"), "{said}");
    assert!(said.contains("--exposure-ev") && said.contains("--tone linear") && psnr < -20.0, "{psnr} dB: {said}");
    for more in [["--tone", "linear"], ["--tone", "agx"], ["--exposure-ev", "-1"]] {
        let report = factorize(&more);
        let (said, psnr) = (messages(&report).join("; "), number(&report, "psnr_view"));
        assert!(!said.contains("values above 1") && psnr > 15.0, "{more:?}: {psnr} dB: {said}");
    }
}

#[test]
fn weights_of_zero_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let [field, weights, run] = ["views.npy", "weights.npy", "run"].map(|name| folder.path().join(name));
    write_test_field(&field, [3, 3, 20, 32], 20.0, 3.0);
    write_array(&weights, &[3, 3], [0.0; 9]);
    let mut command = lumistack();
    command.arg("factorize").arg(&field).arg("-o").arg(&run).args(["--fov", "20x20", "--pitch-mm", "3"]);
    let error = fail(command.arg("--weights").arg(&weights));
    assert!(error.contains("weights.npy") && error.contains("at least one weight above 0"), "{error}");
}

/// One layer can show a single view exactly. The layer's patterns must be β times the given values,
/// not β times the nearest half floats.
#[test]
fn a_view_that_one_layer_can_show_is_not_rounded() {
    let folder = tempfile::tempdir().unwrap();
    let [field, display, run] = ["view.npy", "one-layer.toml", "run"].map(|name| folder.path().join(name));
    // half floats near 0.3 are 2.4e-4 apart, so they cannot represent these values
    let values: Vec<f32> = (0..20 * 32 * 3).map(|i| 0.3 + 1.7e-5 * (i % 97) as f32).collect();
    write_array(&field, &[1, 1, 20, 32, 3], values.iter().copied());
    let mut one_layer = lumistack_display::Display::uniform([32, 20], 3.0, [1, 1], [20.0, 20.0], &[0.0], 1);
    one_layer.brightness = 0.5;
    std::fs::write(&display, one_layer.to_toml()).unwrap();
    let mut command = lumistack();
    command.arg("factorize").arg(&field).arg("-o").arg(&run).arg("--display").arg(&display);
    succeed(command.args(["--pitch-mm", "3", "--fov", "20x20", "--iterations", "3"]));
    let (_, layer) = lumistack_field_io::npy::read(&run.join("layers/layer_0.npy")).unwrap();
    for (shown, given) in layer.iter().zip(&values) {
        assert!((shown / 0.5 - given).abs() < 1e-6, "{} is shown of {given}", shown / 0.5);
    }
    let report = report(&run);
    let psnr = number(&report, "psnr_view");
    assert!(psnr > 110.0, "{psnr} dB");
}

/// Arguments of a small run. Three frames would flicker on panels. The preset has no panels, so the
/// run must not warn of flicker.
const SMALL_RUN: [&str; 10] =
    ["--resolution", "84x52", "--frames", "3", "--samples", "4", "--iterations", "10", "--max-bounces", "3"];

fn small_run(run: &Path) -> Command {
    let mut command = lumistack();
    command.arg("run").arg(root().join("scenes/still-life/still-life.gltf")).arg("-o").arg(run).args(SMALL_RUN);
    command
}

#[test]
fn the_same_bytes_on_one_and_two_threads() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["1", "2"].map(|threads| {
        let run = folder.path().join(threads);
        succeed(small_run(&run).args(["--threads", threads]));
        run
    });
    for part in ["target", "outside", "layers", "outputs"] {
        assert!(files(&one.join(part)) == files(&two.join(part)), "{part} differs");
    }
    check_views_beyond_the_zone(&report(&one));
}

/// Checks the scores of views outside of the zone. These views are one view spacing away from the
/// outermost views, on both sides.
fn check_views_beyond_the_zone(report: &serde_json::Value) {
    let slopes = |field: &str| -> Vec<f64> {
        report[field]["slope_x"].as_array().unwrap().iter().map(|slope| slope.as_f64().unwrap()).collect()
    };
    let (target, outside) = (slopes("views"), slopes("outside"));
    let step = target[1] - target[0];
    assert!(
        (outside[0] - (target[0] - step)).abs() < 1e-9 && (outside[1] - (target[target.len() - 1] + step)).abs() < 1e-9
    );
    for key in ["overall_psnr_view", "overall_ssim", "overall_flip"] {
        assert!(number(&report["outside"], key).is_finite());
    }
    assert!(number(&report["outside"], "overall_psnr_view") < number(report, "psnr_view"), "nothing constrains them");
    let warnings = report["warnings"].as_array().unwrap();
    let warned = warnings.iter().any(|warning| warning["message"].as_str().unwrap().contains("flicker"));
    assert!(!warned, "a preset is a design without panels: {warnings:?}");
}

#[test]
fn a_rerun_takes_everything_from_the_cache() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(&mut small_run(&run));
    let before = files(&run.join("layers"));
    succeed(&mut small_run(&run));
    let stages = report(&run)["stages"].clone();
    for name in ["render", "factorize", "output-images"] {
        let stage = stages.as_array().unwrap().iter().find(|stage| stage["name"] == name).unwrap();
        assert_eq!(stage["cached"], true, "{name} ran again");
    }
    assert!(before == files(&run.join("layers")));
    // a change of the factorizer's settings does not change the views, so the views are not
    // rendered again
    succeed(small_run(&run).args(["--iterations", "11"]));
    let stages = report(&run)["stages"].clone();
    let cached = |name: &str| stages.as_array().unwrap().iter().find(|s| s["name"] == name).unwrap()["cached"].clone();
    assert_eq!((cached("render"), cached("factorize")), (true.into(), false.into()));
}

#[test]
fn a_killed_run_resumes_from_its_finished_parts() {
    let folder = tempfile::tempdir().unwrap();
    let (killed, whole) = (folder.path().join("killed"), folder.path().join("whole"));
    for by_user in [false, true] {
        let mut child = interruptible(&mut small_run(&killed))
            .args(["--samples", "8", "--views", "5x5"])
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let views = || files_below(&killed.join("cache"), "exr");
        let start = Instant::now();
        let before = views();
        while views() < before + 3 && child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < Duration::from_secs(120), "no view was rendered in two minutes");
            std::thread::sleep(Duration::from_millis(5));
        }
        if by_user {
            interrupt(&child);
            assert_eq!(child.wait().unwrap().code(), Some(130));
        } else {
            child.kill().unwrap();
            child.wait().unwrap();
        }
        assert!(!killed.join("report.html").exists());
    }
    let finished = files_below(&killed.join("cache"), "exr");
    let text = succeed(small_run(&killed).args(["--samples", "8", "--views", "5x5", "--json"]));
    let begin = text.lines().find(|line| line.contains("\"begin\"") && line.contains("render")).unwrap();
    let begin: serde_json::Value = serde_json::from_str(begin).unwrap();
    let left = begin["total"].as_u64().unwrap();
    let text = succeed(small_run(&whole).args(["--samples", "8", "--views", "5x5", "--json"]));
    let begin = text.lines().find(|line| line.contains("\"begin\"") && line.contains("render")).unwrap();
    let begin: serde_json::Value = serde_json::from_str(begin).unwrap();
    let (all, views) = (begin["total"].as_u64().unwrap(), 25 + 2);
    assert_eq!(
        left * views,
        all * (views - finished),
        "{finished} views were finished, {left} of {all} tiles came again"
    );
    for part in ["target", "layers", "outputs"] {
        assert!(files(&killed.join(part)) == files(&whole.join(part)), "{part} differs from an uninterrupted run");
    }
}

fn files_below(folder: &Path, extension: &str) -> u64 {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    entries
        .flatten()
        .map(|entry| entry.path())
        .map(|path| {
            if path.is_dir() {
                files_below(&path, extension)
            } else {
                u64::from(path.extension().is_some_and(|found| found == extension))
            }
        })
        .sum()
}

#[test]
fn simulate_shows_parallax_in_the_right_direction() {
    let folder = tempfile::tempdir().unwrap();
    let (field, run) = (folder.path().join("views.npy"), folder.path().join("run"));
    write_test_field(&field, [3, 5, 31, 50], 20.0, 3.0);
    let flags = ["--fov", "20x20", "--pitch-mm", "3", "--frames", "4", "--iterations", "100"];
    succeed(lumistack().arg("factorize").arg(&field).arg("-o").arg(&run).args(flags));
    // Simulate the views of the outermost slopes, 8.03° and 6.70° off the axis. The red card is 30
    // mm in front of the display, so from the right it appears farther left.
    let centre_of_red = |angle: &str| {
        let path = folder.path().join("view.exr");
        succeed(lumistack().arg("simulate").arg(&run).args(["--view", angle]).arg("-o").arg(&path));
        let picture = lumistack_field_io::picture::Picture::read(&path).unwrap();
        let [cols, rows] = picture.size();
        let values = picture.into_linear();
        let (mut sum, mut weight) = ([0.0; 2], 0.0);
        for row in 0..rows {
            for col in 0..cols {
                let pixel = &values[3 * (row * cols + col)..][..3];
                let red = f64::from((pixel[0] - pixel[2]).max(0.0));
                sum = [sum[0] + red * col as f64, sum[1] + red * row as f64];
                weight += red;
            }
        }
        sum.map(|s| s / weight)
    };
    let (left, right) = (centre_of_red("-8.03,0"), centre_of_red("8.03,0"));
    let expected = 2.0 * 30.0 * 8.03f64.to_radians().tan() / 3.0;
    assert!((left[0] - right[0] - expected).abs() < 1.0, "moved by {} px, expected {expected}", left[0] - right[0]);
    // seen from above, the card in front of the display appears farther down, at a larger row
    let (above, below) = (centre_of_red("0,6.7"), centre_of_red("0,-6.7"));
    assert!(above[1] > below[1] + 1.0, "{above:?} {below:?}");
}

#[test]
fn one_render_feeds_two_displays_and_five_outputs() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let go = || {
        let mut command = lumistack();
        succeed(command.arg("run").arg(root().join("tests/cases/two-displays/job.toml")).arg("-o").arg(&run))
    };
    go();
    let report = report(&run);
    let nodes = report["nodes"].as_array().unwrap();
    let ids: Vec<&str> = nodes.iter().map(|node| node["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["tensor", "barrier"]);
    let outputs =
        nodes.iter().flat_map(|node| node["outputs"].as_array().unwrap()).chain(report["outputs"].as_array().unwrap());
    let outputs: Vec<&str> = outputs.map(|path| path.as_str().unwrap()).collect();
    assert_eq!(outputs.len(), 5, "{outputs:?}");
    assert!(outputs.iter().all(|path| run.join(path).join("images.json").is_file()), "{outputs:?}");
    // The brightness is 1/9: the barrier shows 3 × 3 views, and each pinhole is open in one of nine
    // frames.
    assert!((number(&nodes[1], "brightness") - 1.0 / 9.0).abs() < 1e-6);
    let views = files(&run.join("target"));
    assert_eq!(views.len(), 1 + 9, "one light field for both");
    // the folder of a node has all files that `simulate` needs
    let picture = folder.path().join("barrier.png");
    succeed(lumistack().arg("simulate").arg(run.join("nodes/barrier")).arg("-o").arg(&picture));
    let picture = image::open(&picture).unwrap().into_rgb8();
    assert!(picture.pixels().any(|pixel| pixel.0[0] > 64), "the barrier shows something");

    // a second run reuses all results of the first
    let before = std::fs::metadata(run.join("nodes/barrier/layers/layer_0.npy")).unwrap().modified().unwrap();
    go();
    assert_eq!(std::fs::metadata(run.join("nodes/barrier/layers/layer_0.npy")).unwrap().modified().unwrap(), before);
}

#[test]
fn scenes_of_other_formats_go_through_importers() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("card.obj");
    std::fs::write(folder.path().join("card.mtl"), "newmtl red\nKd 0.8 0.1 0.1\n").unwrap();
    let corners = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n";
    std::fs::write(&scene, format!("mtllib card.mtl\n{corners}usemtl red\nf 1 2 3 4\n")).unwrap();
    let info = succeed(lumistack().args(["--json", "info"]).arg(&scene));
    assert!(info.contains("\"triangles\":2") && info.contains("red"), "{info}");
    let views = folder.path().join("views");
    succeed(lumistack().arg("render").arg(&scene).arg("-o").arg(&views).args([
        "--resolution",
        "32x20",
        "--samples",
        "2",
    ]));
    assert!(views.join("lightfield.json").is_file());
}

#[test]
fn libraries_that_are_no_plugins_are_listed_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let name = format!("{}lumistack_plugin_text{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    std::fs::write(folder.path().join(&name), "not a library").unwrap();
    let text = succeed(lumistack().arg("plugins").arg("--plugin-path").arg(folder.path()));
    assert!(text.contains("images 0.1.0 (output, compiled in)"), "{text}");
    assert!(text.contains(&format!("{name}: expected a shared library, found a file of another kind")), "{text}");
    let json = succeed(lumistack().args(["--json", "plugins"]).env("LUMISTACK_PLUGIN_PATH", folder.path()));
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["failed"].as_array().unwrap().len(), 1, "{json}");
}

#[test]
fn the_small_commands_answer() {
    let folder = tempfile::tempdir().unwrap();
    assert!(succeed(lumistack().arg("plugins")).contains("images"));
    assert!(succeed(lumistack().arg("displays")).contains("paper-three-layer"));
    let mut piped = lumistack()
        .arg("displays")
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(piped.stdout.take());
    let ended = piped.wait_with_output().unwrap();
    assert!(ended.status.success() && ended.stderr.is_empty(), "a reader that has gone is no error");
    assert!(succeed(lumistack().args(["completions", "bash"])).contains("lumistack"));
    let info = succeed(lumistack().arg("info").arg(root().join("scenes/still-life/still-life.gltf")));
    assert!(info.contains("triangles"), "{info}");
    let info = succeed(lumistack().args(["info", "paper-directional"]));
    assert!(info.contains("187"), "{info}");
    let field = folder.path().join("views.npy");
    write_test_field(&field, [1, 2, 3, 4], 20.0, 3.0);
    let info = succeed(lumistack().arg("info").arg(&field));
    assert!(info.contains('4') && info.contains("views"), "{info}");
    let out = folder.path().join("views");
    let mut render = lumistack();
    render.arg("render").arg(root().join("scenes/glass/job.toml")).arg("-o").arg(&out);
    succeed(render.args(["--resolution", "42x26", "--views", "5x5", "--samples", "1"]));
    assert!(out.join("lightfield.json").is_file() && out.join("view_04_04.exr").is_file());
    assert!(succeed(lumistack().arg("info").arg(&out)).contains("42"));
    // `factorize` reads the light field that `render` wrote
    let run = folder.path().join("run");
    succeed(lumistack().arg("factorize").arg(&out).arg("-o").arg(&run).args(["--iterations", "2", "--frames", "2"]));
    let strip = folder.path().join("strip.png");
    succeed(lumistack().arg("simulate").arg(&run).args(["--sweep", "3"]).arg("-o").arg(&strip));
    assert!(strip.is_file());
}
