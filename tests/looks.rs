//! Tests of tone curves, of depth that is fitted to the display, and of the reported depth.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::common::{fail, files, lumistack, number, report, root, succeed};

const SMALL: [&str; 10] =
    ["--resolution", "84x52", "--frames", "3", "--samples", "4", "--iterations", "15", "--max-bounces", "3"];

fn still_life(command: &str, folder: &Path) -> Command {
    let mut command_line = lumistack();
    command_line.arg(command).arg(root().join("scenes/still-life/still-life.gltf")).arg("-o").arg(folder);
    command_line
}

fn index(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("lightfield.json")).unwrap()).unwrap()
}

fn info(folder: &Path, key: &str) -> Value {
    let index = index(folder);
    if index[key].is_null() { index["info"][key].clone() } else { index[key].clone() }
}

#[test]
fn the_tone_curve_is_reported_and_another_one_renders_nothing_again() {
    let folder = tempfile::tempdir().unwrap();
    let views = folder.path().join("views");
    let small = ["--resolution", "42x26", "--samples", "2", "--max-bounces", "2"];
    let mut pictures = Vec::new();
    let mut last_written = None;
    for tone in ["linear", "khronos-neutral", "agx"] {
        let text = succeed(still_life("render", &views).args(small).args(["--tone", tone]));
        assert!(text.contains("Depth: ") && text.contains("depth of field"), "{text}");
        assert_eq!(info(&views, "tone"), tone);
        let written = newest(&views.join("cache"));
        assert!(last_written.is_none_or(|last| last == written), "{tone}: views were traced again");
        last_written = Some(written);
        let shown = files(&views);
        assert!(pictures.iter().all(|other| other != &shown), "{tone} looks like another curve");
        pictures.push(shown);
    }
    assert!(fail(lumistack().args(["run", "nothing.gltf"])).contains("nothing.gltf"));
}

/// Returns the modification time of the newest `.exr` file in a folder and its subfolders.
fn newest(folder: &Path) -> std::time::SystemTime {
    let mut last = std::time::SystemTime::UNIX_EPOCH;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            last = last.max(newest(&path));
        } else if path.extension().is_some_and(|kind| kind == "exr") {
            last = last.max(std::fs::metadata(&path).unwrap().modified().unwrap());
        }
    }
    last
}

/// The window is far in front of the scene, so hardly any part of the scene is in the display's
/// depth of field. With `--fit-depth`, which moves the window, some parts are in it. With
/// `--fit-depth=compress` nearly all parts are in it. Each of these two steps raises the PSNR.
#[test]
fn fitted_depth_raises_the_quality() {
    let folder = tempfile::tempdir().unwrap();
    let scene = root().join("scenes/still-life/still-life.gltf");
    let job = folder.path().join("job.toml");
    // the window of the scene's camera, moved 350 mm towards the viewer
    let place = "centre = [0.0, 0.142, 0.32]\nforward = [0.0, -0.4067, -0.9135]\nup = [0.0, 1.0, 0.0]\nwidth = 0.475";
    let window = format!("from = \"given\"\n{place}");
    let text = format!(
        "scene = {scene:?}\noutputs = []\n[display]\npreset = \"paper-three-layer\"\n[window]\n{window}\n[render]\nheld_out = 0\noutside = 0\n[report]\nzone_directions = 0\n"
    );
    std::fs::write(&job, text).unwrap();
    let run = |name: &str, flags: &[&str]| {
        let run = folder.path().join(name);
        succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&run).args(SMALL).args(flags));
        report(&run)
    };
    let off = run("off", &["--fit-depth=off"]);
    let moved = run("moved", &["--fit-depth"]);
    let compressed = run("compressed", &["--fit-depth=compress"]);
    let inside = |report: &Value| number(&report["depth"], "inside");
    let psnr = |report: &Value| number(report, "psnr_view");
    for report in [&off, &moved, &compressed] {
        println!(
            "inside {:.3}, 98 % within {:.2} px, {:.2} dB, moved back {:.0} mm, depth {:.3}",
            inside(report),
            number(&report["depth"]["disparity_px"], "p98"),
            psnr(report),
            number(&report["depth"], "window_moved_back_mm"),
            number(&report["depth"], "depth_scale"),
        );
    }
    assert!(inside(&off) < 0.2 && inside(&moved) > inside(&off) + 0.1 && inside(&compressed) > 0.85);
    assert!(psnr(&moved) > psnr(&off) + 1.0 && psnr(&compressed) > psnr(&moved) + 1.0);
    assert!(number(&compressed["depth"], "depth_scale") < 0.9 && number(&moved["depth"], "depth_scale") == 1.0);
    let warned = |report: &Value| {
        let warnings = report["warnings"].as_array().unwrap();
        warnings.iter().any(|warning| warning["message"].as_str().unwrap().contains("--fit-depth"))
    };
    assert!(warned(&off) && !warned(&compressed));
}

/// `info` reports the depth of a scene without rendering it. A rendering prints the same depth
/// budget.
#[test]
fn info_reports_the_depth_of_a_scene_for_a_display() {
    let folder = tempfile::tempdir().unwrap();
    let scene = root().join("scenes/still-life/still-life.gltf");
    let job = folder.path().join("job.toml");
    let display = "[display]\npreset = \"paper-three-layer\"\nresolution = [84, 52]";
    std::fs::write(&job, format!("scene = {scene:?}\n{display}\n[render]\nsamples = 1\nmax_bounces = 0\n")).unwrap();
    let reported = |flags: &[&str]| -> Value {
        let mut info = lumistack();
        info.arg("--json").arg("info").arg(&job).args(["--display", "paper-three-layer"]).args(flags);
        serde_json::from_str::<Value>(&succeed(&mut info)).unwrap()["on the display"].clone()
    };
    let plain = reported(&[]);
    let rendered = succeed(lumistack().arg("render").arg(&job).arg("-o").arg(folder.path().join("views")));
    assert!(rendered.contains(plain["depth budget"].as_str().unwrap()), "{rendered}\n{plain}");
    let inside = |reported: &Value| number(&reported["depth"], "inside");
    assert!((0.0..=1.0).contains(&inside(&plain)) && number(&plain, "covered share of the window") > 0.25);
    let unfitted = reported(&["--fit-depth=off"]);
    assert!(inside(&plain) > inside(&unfitted).max(0.9), "depth is fitted by default");
    assert!(inside(&reported(&["--fit-depth=compress"])) > inside(&unfitted).max(0.9));
    assert!(plain["memory"]["in all"].as_str().unwrap().ends_with(" MB"));
    let text = succeed(lumistack().arg("info").arg(&scene).args(["--display", "paper-three-layer"]));
    assert!(text.contains("depth of field") && text.contains("coarser levels of images"), "{text}");
    assert!(fail(lumistack().arg("info").arg(&scene).args(["--display", "nothing"])).contains("nothing"));
    assert!(
        fail(lumistack().args(["info", "paper-three-layer", "--display", "paper-three-layer"]))
            .contains("paper-three-layer")
    );
}
