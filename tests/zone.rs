//! The zone score in sweeps, in comparisons, and for given light fields.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::common::{lumistack, report, root, succeed};

/// Writes a small job of the scene `letters` with 5 × 5 views, and with `rest` appended.
fn job(folder: &Path, rest: &str) -> PathBuf {
    let path = folder.join("job.toml");
    let scene = root().join("scenes/letters/letters.gltf");
    let text = format!(
        "scene = {scene:?}\n[display]\npreset = \"fig7-uniform\"\nresolution = [64, 40]\nviews = [5, 5]\n[window]\nfit_depth = \"off\"\n[render]\nsamples = 2\n\
         [factorize]\niterations = 6\nstart = \"random\"\ncoarse_levels = 0\n{rest}"
    );
    std::fs::write(&path, text).unwrap();
    path
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// A sweep, the report of a run and `compare` give the same zone score to a design. A sweep ranks
/// designs by this score.
#[test]
fn sweeps_reports_and_comparisons_give_one_score() {
    let folder = tempfile::tempdir().unwrap();
    let run = |frames: usize| {
        let text = std::fs::read_to_string(job(folder.path(), "")).unwrap();
        let path = folder.path().join(format!("run-{frames}.toml"));
        std::fs::write(&path, text.replace("[display]", &format!("[display]\nframes = {frames}"))).unwrap();
        let out = folder.path().join(format!("run-{frames}"));
        succeed(lumistack().arg("run").arg(&path).arg("-o").arg(&out));
        out
    };
    let runs = [run(1), run(4)];
    let swept = folder.path().join("swept");
    let sweep = job(folder.path(), "[sweep]\nframes = [1, 4]\n");
    let said = succeed(lumistack().arg("sweep").arg(sweep).arg("-o").arg(&swept));
    assert!(said.contains("dB over the zone"), "{said}");
    let rows: Value = serde_json::from_slice(&std::fs::read(swept.join("sweep.json")).unwrap()).unwrap();
    for (i, run) in runs.iter().enumerate() {
        let (row, own) = (&rows["rows"][i], report(run));
        for key in ["psnr_zone", "psnr_zone_worst_tenth"] {
            let (swept, own) = (number(&row[format!("{key}_db")]), number(&own[key]));
            assert!((swept - own).abs() < 0.01, "{key}: sweep {swept}, report {own}");
        }
    }
    let csv = std::fs::read_to_string(swept.join("sweep.csv")).unwrap();
    assert!(csv.lines().next().unwrap().contains(",psnr_zone_db,psnr_zone_worst_tenth_db,psnr_view_db,"), "{csv}");

    let found = succeed(lumistack().args(["--json", "compare"]).args(&runs));
    let done: Value = found
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .find(|e: &Value| e["event"] == "done")
        .unwrap();
    let compared = &done["runs"];
    assert_eq!(compared["directions"], 32);
    for (key, run) in ["first_zone", "second_zone"].iter().zip(&runs) {
        assert_eq!(compared[key]["psnr_db"], report(run)["psnr_zone"]);
    }
    assert!(number(&compared["between"]["psnr_db"]) > 10.0 && compared["between"]["ssim"] != 1.0, "{compared}");
    let said = succeed(lumistack().arg("compare").arg(&runs[0]).arg(&runs[0]));
    assert!(said.contains("Second run against the first run:          equal"), "{said}");
}

/// For a given light field, the zone score comes from held-out views. Without held-out views there
/// is no zone score.
#[test]
fn a_given_light_field_is_judged_by_the_views_that_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let views = folder.path().join("views");
    succeed(lumistack().arg("render").arg(job(folder.path(), "")).arg("-o").arg(&views));
    let factorize = |name: &str, options: &[&str]| {
        let out = folder.path().join(name);
        let display = ["--display", "fig7-uniform", "--iterations", "6", "-o"];
        let said = succeed(lumistack().arg("factorize").arg(&views).args(display).arg(&out).args(options));
        (out, said)
    };
    let (all, said) = factorize("all", &[]);
    assert_eq!(report(&all)["psnr_zone"], Value::Null);
    assert!(!said.contains("over the zone") && report(&all)["zone"].is_null(), "{said}");
    let (some, said) = factorize("some", &["--views", "3x3"]);
    let of_some = report(&some);
    assert!(said.contains("dB over the zone"), "{said}");
    assert_eq!(of_some["zone"]["directions"].as_array().unwrap().len(), 25 - 9);
    // the score uses held-out views, which lie between the views that the solver uses
    let kept = &of_some["views"]["slope_x"];
    let (low, high) = (number(&kept[0]), number(&kept[2]));
    for direction in of_some["zone"]["directions"].as_array().unwrap() {
        let [x, y] = [0, 1].map(|axis| number(&direction["slope"][axis]));
        assert!(x >= low - 1e-9 && x <= high + 1e-9, "{x}");
        let is_kept = |slope: f64, axis: &str| {
            of_some["views"][axis].as_array().unwrap().iter().any(|other| (number(other) - slope).abs() < 1e-9)
        };
        assert!(!(is_kept(x, "slope_x") && is_kept(y, "slope_y")), "{x} {y}");
    }
    assert!(number(&of_some["psnr_zone"]) < number(&of_some["psnr_view"]), "views that were solved for are shown best");
}

/// Returns the text of a display file with layers of 48 × 30 pixels of 2 mm at the distances
/// `layers`. `every_layer` has further lines for every layer, `front` for the front layer only. For
/// three layers 40 mm apart, `views = "auto"` gives 7 × 7 views.
fn display(head: &str, every_layer: &str, front: &str, backlight: &str, layers: &[f64]) -> String {
    let mut text = format!(
        "name = \"test\"\nframes = 4\nbrightness = 0.2\n{head}\n[field]\nresolution = [48, 30]\npitch_mm = 2.0\nviews = \"auto\"\nfov_deg = [20.0, 20.0]\n\
         projection = \"oblique\"\n[backlight]\n{backlight}\n"
    );
    for (n, d_mm) in layers.iter().enumerate() {
        let own = if n + 1 == layers.len() { front } else { "" };
        text += &format!("[[layers]]\nd_mm = {d_mm:.1}\nresolution = [48, 30]\npitch_mm = 2.0\n{every_layer}\n{own}\n");
    }
    text
}

/// A display is solved once for its native views (the automatic number) and once for 3 × 3 views.
/// With native views, the display's score over the viewing zone is higher. This holds for all cases
/// of hardware, brightness and number of frames that the test lists.
#[test]
fn native_views_pay_with_any_hardware() {
    let three = [-40.0, 0.0, 40.0];
    let uniform = "kind = \"uniform\"";
    let lenslets = "kind = \"lenslets\"\nd_mm = -12.0\nlenslets = [24, 15]\npitch_mm = 6.0\nfov_deg = [20.0, 20.0]\nviews = [3, 3]\noutside_bins = \"dark\"";
    let eyes = "[[factorize.eyes]]\neye_mm = [-35.0, 0.0, 700.0]\nsigma_mm = 15.0\n[[factorize.eyes]]\neye_mm = [35.0, 0.0, 700.0]\nsigma_mm = 15.0\n";
    let crosstalk = "crosstalk = [[0.9, 0.05, 0.0], [0.04, 0.9, 0.04], [0.0, 0.05, 0.9]]";
    // each case has a name, the text of the display file, and further keys of the job
    let cases = [
        ("plain", display("", "", "", uniform, &three), ""),
        ("contrast 50:1", display("", "black_level = 0.02", "", uniform, &three), ""),
        ("4 bits", display("", "bits = 4", "", uniform, &three), ""),
        ("blur", display("", "blur_px = 0.5", "", uniform, &three), ""),
        ("crosstalk", display("", crosstalk, "", uniform, &three), ""),
        ("misaligned", display("sampling = \"bilinear\"", "", "offset_mm = [0.7, -0.5]", uniform, &three), ""),
        ("eye boxes", display("", "", "", uniform, &three), eyes),
        ("one frame", display("", "", "", uniform, &three).replace("frames = 4", "frames = 1"), ""),
        ("half the light", display("", "", "", uniform, &three).replace("brightness = 0.2", "brightness = 0.5"), ""),
        ("directional", display("", "", "", lenslets, &[0.0, 24.0]), ""),
        ("additive", display("formation = \"additive\"", "peak = 0.33", "", uniform, &three), ""),
    ];
    let folder = tempfile::tempdir().unwrap();
    let scene = root().join("scenes/still-life/still-life.gltf");
    let mut lost = Vec::new();
    for (name, text, rest) in &cases {
        let file = folder.path().join("display.toml");
        std::fs::write(&file, text).unwrap();
        let zone = |views: &str, out: &str| {
            let job = folder.path().join("job.toml");
            let text = format!(
                "scene = {scene:?}\n[display]\nfile = {file:?}\n{views}\n[window]\nfit_depth = \"compress\"\n[render]\nzone_samples = 49\ndenoise = \"off\"\nmax_bounces = 3\n{rest}"
            );
            std::fs::write(&job, text).unwrap();
            let out = folder.path().join(out);
            succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&out));
            let target: Value =
                serde_json::from_slice(&std::fs::read(out.join("target/lightfield.json")).unwrap()).unwrap();
            let views = target["slope_x"].as_array().unwrap().len();
            let psnr = number(&report(&out)["psnr_zone"]);
            // All cases use the same two run folders. If two displays need the same rays, the
            // second case uses the views that the first case has cached.
            (psnr, views)
        };
        let ((native, views), (few, _)) = (zone("", "native"), zone("views = [3, 3]", "few"));
        println!("{name}: {native:.2} dB for {views} × {views} views, {few:.2} dB for 3 × 3");
        if !(native > few && views > 5) {
            lost.push(*name);
        }
    }
    assert!(lost.is_empty(), "no better for native views: {lost:?}");
}

/// Every time step of a sequence is solved for the display's native views.
#[test]
fn sequences_are_solved_for_the_whole_zone() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("display.toml");
    std::fs::write(&file, display("", "", "", "kind = \"uniform\"", &[-40.0, 0.0, 40.0])).unwrap();
    let scene = root().join("scenes/letters/letters.gltf");
    let job = folder.path().join("job.toml");
    let text = format!(
        "scene = {scene:?}\n[display]\nfile = {file:?}\n[render]\nzone_samples = 60\nmax_bounces = 2\n[sequence]\ntimes = 2\nturn_deg = 6.0\nreports = true\n"
    );
    std::fs::write(&job, text).unwrap();
    let out = folder.path().join("run");
    succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&out));
    for time in ["t0001", "t0002"] {
        let target: Value =
            serde_json::from_slice(&std::fs::read(out.join(time).join("target/lightfield.json")).unwrap()).unwrap();
        assert_eq!(target["slope_x"].as_array().unwrap().len(), 7);
        assert!(number(&report(&out.join(time))["psnr_zone"]) > 10.0);
    }
}
