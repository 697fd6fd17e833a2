//! `analyze` and `sweep` on the command line.

use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::common::{fail, lumistack, number, report, root, succeed};

/// Returns the job of a sweep of 18 small designs on a light field that needs no rendering.
fn small_sweep(folder: &Path) -> std::path::PathBuf {
    let job = folder.join("small.toml");
    let text = "[source]\nplugin = \"test_views\"\nparams = { pattern = \"cards\", depth_mm = 120.0 }\n\n[display]\npreset = \"fig7-uniform\"\nresolution = [64, 40]\n\n\
        [factorize]\niterations = 40\n\n[sweep]\nlayers = [1, 2, 3]\nframes = [1, 2, 3]\nbrightness = [0.2, 0.6]\ngap_mm = [120.0]\n";
    std::fs::write(&job, text).unwrap();
    job
}

fn rows(folder: &Path) -> Vec<Value> {
    let text = std::fs::read(folder.join("sweep.json")).unwrap();
    serde_json::from_slice::<Value>(&text).unwrap()["rows"].as_array().unwrap().clone()
}

#[test]
fn a_killed_sweep_resumes_and_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let job = small_sweep(folder.path());
    let (whole, killed) = (folder.path().join("whole"), folder.path().join("killed"));
    let sweep = |out: &Path, threads: &str| {
        let mut command = lumistack();
        command.args(["--threads", threads, "--json", "sweep"]).arg(&job).arg("-o").arg(out);
        command
    };
    succeed(&mut sweep(&whole, "2"));
    let all = rows(&whole).len();
    assert_eq!(all, 18);

    let mut child = sweep(&killed, "1").stdout(std::process::Stdio::null()).spawn().unwrap();
    let done = || {
        let designs = std::fs::read_dir(killed.join("designs"));
        designs.map_or(0, |entries| {
            entries.flatten().filter(|e| e.path().extension().is_some_and(|e| e == "json")).count()
        })
    };
    let start = Instant::now();
    while done() < 3 && start.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(1));
    }
    // kill the process by SIGKILL, which leaves it no time to clean up
    child.kill().unwrap();
    child.wait().unwrap();
    let finished = done();
    assert!((3..all).contains(&finished) && !killed.join("sweep.csv").exists(), "{finished} designs were finished");

    let text = succeed(&mut sweep(&killed, "2"));
    let event: Value =
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).find(|e: &Value| e["event"] == "done").unwrap();
    assert!(event["kept"].as_u64().unwrap() >= finished as u64 && event["designs"] == all, "{event}");
    for name in ["sweep.csv", "sweep.json"] {
        assert_eq!(std::fs::read(whole.join(name)).unwrap(), std::fs::read(killed.join(name)).unwrap(), "{name}");
    }
    for plot in std::fs::read_dir(whole.join("plots")).unwrap().flatten() {
        let other = killed.join("plots").join(plot.file_name());
        assert_eq!(std::fs::read(plot.path()).unwrap(), std::fs::read(other).unwrap(), "{:?}", plot.file_name());
    }

    // the table must show the paper's trends
    let found = rows(&whole);
    let psnr = |layers: u64, frames: u64, brightness: f64| {
        let is = |row: &&Value| {
            let d = &row["design"];
            d["layers"] == layers && d["frames"] == frames && d["brightness"] == brightness
        };
        found.iter().find(is).unwrap()["psnr_view_db"].as_f64().unwrap()
    };
    for (layers, frames) in [(2, 2), (2, 3), (3, 2), (3, 3)] {
        assert!(
            psnr(layers, frames, 0.2) > psnr(1, frames, 0.2),
            "{layers} layers, {frames} frames: layers are worth something"
        );
        assert!(
            psnr(layers, frames, 0.2) > psnr(layers, frames - 1, 0.2),
            "{layers} layers: frame {frames} is worth something"
        );
        assert!(
            psnr(layers, frames, 0.2) > psnr(layers, frames, 0.6),
            "{layers} layers, {frames} frames: light costs something"
        );
    }
}

#[test]
fn a_search_proposes_a_design_within_the_constraints() {
    let folder = tempfile::tempdir().unwrap();
    let (job, out) = (small_sweep(folder.path()), folder.path().join("search"));
    let constraints = ["--max-refresh-hz", "120", "--max-panels", "2", "--min-brightness", "0.5"];
    let text = succeed(lumistack().args(["--json", "sweep"]).arg(&job).args(constraints).arg("-o").arg(&out));
    let event: Value =
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).find(|e: &Value| e["event"] == "done").unwrap();
    let best = &event["proposed"][0]["design"];
    assert_eq!((&best["layers"], &best["frames"], &best["brightness"]), (&2.into(), &2.into(), &0.6.into()), "{event}");
    let display = event["display"].as_str().unwrap();
    let printed = succeed(lumistack().args(["analyze", display]));
    assert!(printed.contains("2 layers, uniform backlight, 2 frames"), "{printed}");
    let text = fail(lumistack().arg("sweep").arg(&job).args(["--max-panels", "0", "-o"]).arg(&out));
    assert!(text.contains("sweep.search: expected constraints that at least one design satisfies"), "{text}");
}

#[test]
fn a_job_with_a_sweep_is_not_run() {
    let folder = tempfile::tempdir().unwrap();
    let job = small_sweep(folder.path());
    let text = fail(lumistack().arg("run").arg(&job).arg("-o").arg(folder.path().join("out")));
    assert!(text.contains("lumistack sweep"), "{text}");
}

#[test]
fn analyze_reports_draws_and_refuses() {
    let folder = tempfile::tempdir().unwrap();
    let names = [
        "paper-three-layer:layers=2",
        "paper-three-layer",
        "paper-directional",
        "paper-directional:layers=2,gap_mm=8.5",
    ];
    let printed = succeed(lumistack().arg("analyze").args(names).arg("-o").arg(folder.path()));
    assert!(
        printed.contains("eq. 24")
            && printed.contains("eq. 25")
            && printed.contains("eq. 26")
            && printed.contains("eq. 23"),
        "{printed}"
    );
    for name in ["depth-of-field", "spectral-support", "depth-of-field-vertical", "spectral-support-vertical"] {
        let svg = std::fs::read_to_string(folder.path().join(format!("{name}.svg"))).unwrap();
        assert!(svg.contains("<svg") && svg.contains("prototype"), "{name}");
        assert!(image::open(folder.path().join(format!("{name}.png"))).unwrap().width() > 1000);
    }
    let analysis: Value = serde_json::from_slice(&std::fs::read(folder.path().join("analysis.json")).unwrap()).unwrap();
    let closed = &analysis["displays"][2]["axes"][0]["closed"];
    assert_eq!(closed["equation"], 26);
    assert!(closed["difference_far"].as_f64().unwrap() > 0.5, "{closed}");
    let scene = root().join("scenes/letters/letters.gltf");
    let printed = succeed(lumistack().args(["analyze", "fig7-uniform", "--scene"]).arg(scene));
    assert!(printed.contains("of the visible surfaces lie in the depth of field"), "{printed}");
    let text = fail(lumistack().args(["analyze", "fig7-uniforn"]));
    assert!(text.contains("did you mean `fig7-uniform`?"), "{text}");
}
/// Renders views with `angular_filter = "display"`. These views must be nearer to dense views that
/// `--prefilter` has averaged than to views of single slopes.
#[test]
fn a_displays_prefilter_is_rendered_as_it_is_averaged() {
    let folder = tempfile::tempdir().unwrap();
    // The backlight has three bins of slopes. The light field has one view per bin, or five views
    // per bin.
    let job = |name: &str, views: usize, filter: &str, samples: u32| {
        let display = format!("{name}-display.toml");
        let text = format!(
            "name = \"bins\"\nframes = 1\n[field]\nresolution = [96, 60]\npitch_mm = 4.95\nviews = [{views}, 1]\nfov_deg = [20.0, 0.0]\n\
             [backlight]\nkind = \"lenslets\"\nd_mm = -8.5\nlenslets = [96, 60]\npitch_mm = 4.95\nfov_deg = [20.0, 1.0]\nviews = [3, 1]\n\
             [[layers]]\nd_mm = 0.0\nresolution = [96, 60]\npitch_mm = 4.95\n"
        );
        std::fs::write(folder.path().join(&display), text).unwrap();
        let scene = root().canonicalize().unwrap().join("scenes/letters/letters.gltf");
        let text = format!(
            "scene = {scene:?}\n[display]\nfile = \"{display}\"\n[window]\nfit_depth = \"off\"\n[light]\nautomatic_exposure = false\ntone = \"linear\"\n\
             [render]\nsamples = {samples}\nmax_bounces = 2\nangular_filter = \"{filter}\"\n"
        );
        let path = folder.path().join(format!("{name}.toml"));
        std::fs::write(&path, text).unwrap();
        succeed(lumistack().arg("render").arg(&path).arg("-o").arg(folder.path().join(name)));
    };
    job("dense", 15, "point", 16);
    job("point", 3, "point", 64);
    job("display", 3, "display", 64);
    let out = folder.path().join("averaged");
    let display = folder.path().join("display-display.toml");
    let thinned = ["--views", "3x1", "--prefilter", "--iterations", "1", "--display"];
    succeed(
        lumistack().arg("factorize").arg(folder.path().join("dense")).args(thinned).arg(&display).arg("-o").arg(&out),
    );
    let middle = |name: &str| {
        let (field, _) = lumistack_field_io::read_field_folder(&folder.path().join(name)).unwrap();
        assert_eq!((field.geometry().grid.slope_x.len(), field.geometry().grid.slope_x[1].abs() < 1e-9), (3, true));
        field.view([0, 1]).to_vec()
    };
    let [averaged, point, display] = ["averaged/target", "point", "display"].map(middle);
    let rms = |a: &[f32], b: &[f32]| {
        let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.min(1.0) - b.min(1.0)).powi(2)).sum();
        (sum / a.len() as f64).sqrt()
    };
    let (same, other) = (rms(&averaged, &display), rms(&point, &display));
    println!("averaged against rendered: {same:.4}, single slopes against that: {other:.4}");
    // `same` compares views with `angular_filter = "display"` with averaged views. `other` compares
    // the same filtered views with views of single slopes. The noise of 64 paths contributes 0.028
    // to each difference. If the filter did not average, or if the paths were not spread over
    // slopes, `same` would be larger than `other`.
    assert!(same < 0.75 * other && other > 0.03, "{same} {other}");
}

/// The committed tables of the paper's figures must show the paper's trends. `lumistack sweep
/// scenes/sweeps/figure-7.toml` and `figure-8.toml` make these tables.
#[test]
fn the_committed_tables_show_the_papers_trends() {
    let table = |name: &str| -> Vec<(String, f64, f64, f64, f64)> {
        let text = std::fs::read_to_string(root().join("docs/design").join(name)).unwrap();
        let row = |line: &str| {
            let cells: Vec<&str> = line.split(',').collect();
            let number = |i: usize| cells[i].parse::<f64>().unwrap();
            (cells[0].to_string(), number(1), number(2), number(3), number(13))
        };
        text.lines().skip(1).map(row).collect()
    };
    let figure_7 = table("figure-7.csv");
    let at = |display: &str, layers: f64, frames: f64| {
        let found = figure_7.iter().find(|row| row.0 == display && row.1 == layers && row.2 == frames);
        found.unwrap_or_else(|| panic!("{display}, {layers} layers, {frames} frames")).4
    };
    // largest random variation of the PSNR after 50 iterations from random patterns, dB
    const CHANCE: f64 = 0.5;
    let frames = [1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0];
    for display in ["fig7-uniform", "fig7-directional"] {
        for layers in 1..=8 {
            let layers = f64::from(layers);
            // a single layer in front of a uniform backlight shows the same picture in all
            // directions, so more frames do not help
            if display == "fig7-directional" || layers > 1.0 {
                for pair in frames.windows(2).filter(|pair| at(display, layers, pair[0]) < 40.0) {
                    assert!(
                        at(display, layers, pair[1]) > at(display, layers, pair[0]) - CHANCE,
                        "{display} {layers} {pair:?}"
                    );
                }
                assert!(at(display, layers, 12.0) > at(display, layers, 1.0) + 4.0, "{display} {layers}");
            }
            // With static layers, the paper's teapot stays below 30 dB for up to eight layers. Our
            // scene stays below 30 dB for up to four layers, and below 40 dB for more.
            let most = if layers <= 4.0 { 30.0 } else { 40.0 };
            assert!(at(display, layers, 1.0) < most, "a static stack of {layers} layers");
        }
        for frames in [2.0, 3.0] {
            assert!(at(display, 8.0, frames) > at(display, 2.0, frames) + 3.0, "{display}, {frames} frames");
        }
    }
    let figure_8 = table("figure-8.csv");
    for display in ["fig7-uniform", "fig7-directional"] {
        for frames in [4.0, 8.0, 12.0] {
            let psnr = |brightness: f64| {
                let is =
                    |row: &&(String, f64, f64, f64, f64)| row.0 == display && row.2 == frames && row.3 == brightness;
                figure_8.iter().find(is).unwrap().4
            };
            assert!(psnr(0.2) > psnr(0.5) && psnr(0.5) > psnr(1.0), "{display}, {frames} frames: light costs quality");
        }
    }
}

/// Writes weights of 3 × 3 views. The weight of the middle view is 1, and all others are 0.
fn one_view(path: &Path) {
    let header = format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 3), }");
    let mut bytes = [b"\x93NUMPY\x01\x00v\x00", header.as_bytes()].concat();
    bytes.extend((0..9).flat_map(|view| f32::from(u8::from(view == 4)).to_le_bytes()));
    std::fs::write(path, bytes).unwrap();
}

/// A row of a sweep has the score of a run of the same job, with the job's weights. If the display
/// file of a node changes, the sweep solves again. A sweep refuses a warm start.
#[test]
fn a_sweep_solves_as_a_run_does() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    one_view(&at("w.npy"));
    let base = "[source]\nplugin = \"test_views\"\nparams = { pattern = \"cards\", depth_mm = 60.0 }\n\n[display]\npreset = \"fig7-uniform\"\nresolution = [32, 20]\nviews = [3, 3]\n\n";
    let write = |name: &str, text: &str| std::fs::write(at(name), format!("{base}{text}")).unwrap();
    let factorize = "[factorize]\niterations = 20\nweights = \"w.npy\"\n\n";
    write("run.toml", factorize);
    write("sweep.toml", &format!("{factorize}[sweep]\nframes = [3]\n"));
    succeed(lumistack().arg("run").arg(at("run.toml")).args(["--frames", "3", "-o"]).arg(at("run")));
    succeed(lumistack().arg("sweep").arg(at("sweep.toml")).arg("-o").arg(at("sweep")));
    let (run, row) = (number(&report(&at("run")), "psnr_view"), number(&rows(&at("sweep"))[0], "psnr_view_db"));
    assert!((run - row).abs() < 1e-6 && run > 40.0, "{run} and {row} dB");

    // a changed display of a node gives other scores
    let node = "[factorize]\niterations = 5\n\n[[nodes]]\nid = \"a\"\ndisplay = { file = \"d.toml\" }\n\n[sweep]\nframes = [3]\n";
    write("nodes.toml", node);
    let preset = std::fs::read_to_string(root().join("scenes/displays/fig7-uniform.toml")).unwrap();
    let sweep = |gap: &str| {
        std::fs::write(at("d.toml"), preset.replace("d_mm = 40.0", gap)).unwrap();
        succeed(lumistack().arg("sweep").arg(at("nodes.toml")).arg("-o").arg(at("nodes")));
        number(&rows(&at("nodes"))[0], "psnr_view_db")
    };
    let (near, far) = (sweep("d_mm = 40.0"), sweep("d_mm = 400.0"));
    assert!((near - far).abs() > 0.1, "{near} and {far} dB");

    write("warm.toml", "[factorize]\nwarm_start = \"run/layers\"\n\n[sweep]\nframes = [3]\n");
    let text = fail(lumistack().arg("sweep").arg(at("warm.toml")).arg("-o").arg(at("warm")));
    assert!(text.contains("factorize.warm_start: expected no warm start in a sweep"), "{text}");
}

/// The job file that a sweep writes gives the same sweep from another folder.
#[test]
fn the_job_file_of_a_sweep_can_be_run_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::copy(root().join("scenes/displays/fig4-two-layer.toml"), at("d.toml")).unwrap();
    let text = "[source]\nplugin = \"test_views\"\n\n[display]\npreset = \"fig7-uniform\"\nresolution = [16, 10]\nviews = [3, 3]\n\n[factorize]\niterations = 1\n\n[sweep]\ndisplays = [\"d.toml\", \"fig7-uniform\"]\nframes = [2]\n";
    std::fs::write(at("s.toml"), text).unwrap();
    succeed(lumistack().arg("sweep").arg(at("s.toml")).arg("-o").arg(at("first")));
    succeed(lumistack().arg("sweep").arg(at("first").join("job.toml")).arg("-o").arg(at("again")));
    assert_eq!(rows(&at("first")), rows(&at("again")));
}
