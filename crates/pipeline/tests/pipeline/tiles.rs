//! Solves in tiles: seams are invisible, units that solve tiles give the bytes of a run, and a
//! stopped solve continues.

use std::path::Path;
use std::time::Duration;

use lumistack_core::{Cancel, Collector, Progress, Task};
use lumistack_display::{Display, LightField, RayMap, Simulator, Tiling};
use lumistack_field_io::{read_field_folder, read_stack};
use lumistack_pipeline::{BlockSize, Job, Registry, farm_plan, farm_unit, run};

use crate::compose::{json, results, with_task};

/// Maximum loss of PSNR near seams (borders between tiles) against a solve without tiles, dB.
const SEAM_DB: f64 = 0.1;
/// Distance from a seam up to which a pixel is near the seam, pixels of the light field.
const BAND: usize = 4;
const CUT: BlockSize = BlockSize { block_seconds: 1.0, blocks: Some(1) };

fn still_life(folder: &Path, name: &str, tiles: &str) -> Job {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/still-life/still-life.gltf");
    let path = folder.join(format!("{name}.toml"));
    let text = format!(
        "scene = {:?}\n[display]\npreset = \"paper-three-layer\"\nresolution = [84, 52]\nviews = [5, 5]\nframes = 3\n\
         [render]\nsamples = 2\nheld_out = 0\noutside = 0\n[report]\nzone_directions = 0\n[factorize]\niterations = 16\n{tiles}\n",
        scene.canonicalize().unwrap().to_str().unwrap()
    );
    std::fs::write(&path, format!("{text}[[outputs]]\nplugin = \"images\"\n")).unwrap();
    Job::load(&path).unwrap()
}

/// Returns two PSNR values: over the pixels for which `near` is true, and over the other pixels.
fn figures(dir: &Path, target: &LightField, display: &Display, near: &dyn Fn(usize, usize) -> bool) -> [f64; 2] {
    let (stack, geometry) = (read_stack(&dir.join("layers")).unwrap(), target.geometry());
    let (simulator, map) = (Simulator::new(display, &stack), RayMap::new(display, geometry));
    let mut errors = [(0.0, 0usize); 2];
    for view in geometry.grid.iter() {
        let emitted = simulator.view(&map, geometry, view);
        let pairs = emitted.radiance.data().chunks_exact(3).zip(target.view(view).chunks_exact(3));
        for (i, ((shown, wanted), _)) in pairs.zip(&emitted.valid).enumerate().filter(|(_, (_, valid))| **valid) {
            let sum = &mut errors[usize::from(!near(i / geometry.cols, i % geometry.cols))];
            for (shown, wanted) in shown.iter().zip(wanted) {
                sum.0 += f64::from(shown / display.brightness as f32 - wanted).powi(2);
                sum.1 += 1;
            }
        }
    }
    errors.map(|(sum, count)| -10.0 * (sum / count as f64).log10())
}

#[test]
fn seams_are_not_to_be_seen_and_units_of_tiles_give_the_bytes_of_a_run() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let (whole, tiled) = (still_life(folder.path(), "whole", ""), still_life(folder.path(), "tiled", "tiles = [2, 2]"));
    let [of_whole, of_tiles, farm] = ["whole", "tiles", "farm"].map(|name| folder.path().join(name));
    with_task(|task| run(&whole, &of_whole, &registry, None, task)).unwrap();

    // Stop the tiled run in the middle of its solve, and run it again. The second run must
    // continue.
    std::fs::create_dir_all(&of_tiles).unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let stops = StopsAt { stage: "factorize", after: 5, seen: Default::default(), cancel: &cancel };
    let task = Task { progress: &stops, warnings: &warnings, cancel: &cancel };
    run(&tiled, &of_tiles, &registry, None, task).unwrap_err();
    let kept = |name: &str| of_tiles.join("cache/tiles").join(name).join("layers/stack.json").is_file();
    assert!(kept("round-1/tile-4") && kept("round-2/tile-1") && !kept("round-4/tile-1"));
    with_task(|task| run(&tiled, &of_tiles, &registry, None, task)).unwrap();
    assert!(!of_tiles.join("cache/tiles").exists(), "a finished run does not need the results of tiles");

    let display = tiled.resolve_display().unwrap();
    let (target, _) = read_field_folder(&of_tiles.join("target")).unwrap();
    let geometry = target.geometry();
    let tiling = Tiling::new(&display, geometry, [2, 2]);
    assert_eq!(tiling.tiles(), [2, 2]);
    let near =
        |row: usize, col: usize| row.abs_diff(geometry.rows / 2) < BAND || col.abs_diff(geometry.cols / 2) < BAND;
    let [without, elsewhere] = figures(&of_whole, &target, &display, &near);
    let [seam, rest] = figures(&of_tiles, &target, &display, &near);
    println!("around seams {seam:.2} dB, without tiles {without:.2}; elsewhere {rest:.2} and {elsewhere:.2}");
    assert!(seam > without - SEAM_DB && rest > elsewhere - SEAM_DB);

    // Execute every unit alone, including each tile of each round.
    let plan = with_task(|task| farm_plan(&tiled, &farm, &registry, CUT, task)).unwrap();
    let of = |id: &str| plan.units.iter().find(|unit| unit.id == id).unwrap();
    assert!(of("factorize/round-1/1-of-4").inputs.iter().all(|input| input == "expose"));
    assert!(of("factorize/round-2/1-of-4").inputs.contains(&"factorize/round-1/4-of-4".to_owned()));
    assert!(of("factorize").inputs.contains(&"factorize/round-4/3-of-4".to_owned()));
    let written =
        || std::fs::metadata(farm.join("cache/tiles/round-1/tile-1/layers/stack.json")).unwrap().modified().unwrap();
    for unit in &plan.units {
        let before = (unit.id == "factorize").then(written);
        with_task(|task| farm_unit(&farm, &unit.id, &[], Duration::ZERO, &registry, task)).unwrap();
        assert!(before.is_none_or(|before| before == written()), "the run reuses the tiles that units solved");
    }
    assert!(results(&of_tiles) == results(&farm));
    assert!(std::fs::read_to_string(of_tiles.join("report.json")).unwrap().contains("\"psnr_view\""));
}

/// Cancels the work after a number of steps of a stage.
struct StopsAt<'a> {
    stage: &'static str,
    after: u64,
    seen: std::sync::Mutex<(bool, u64)>,
    cancel: &'a Cancel,
}

impl Progress for StopsAt<'_> {
    fn begin(&self, stage: &str, _: u64, _: &str) {
        self.seen.lock().unwrap().0 = stage == self.stage;
    }

    fn advance(&self, steps: u64, _: &str) {
        let mut seen = self.seen.lock().unwrap();
        if seen.0 {
            seen.1 += steps;
            if seen.1 >= self.after {
                self.cancel.cancel();
            }
        }
    }

    fn end(&self) {}
}

/// A black light field has exact patterns, whose PSNR is infinite. A second run must reuse such
/// patterns of layers with few bits, also if they were solved in tiles. After the runs, no results
/// of tiles are left.
#[test]
fn exact_patterns_with_few_bits_are_kept() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let at = |name: &str| folder.path().join(name);
    let preset = std::fs::read_to_string(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/displays/fig4-two-layer.toml"),
    );
    let display = preset.unwrap().replace("transfer = \"srgb\"", "transfer = \"srgb\"\nbits = 6");
    std::fs::write(at("d.toml"), display).unwrap();
    let values = [3usize, 3, 16, 24, 3];
    let header = format!("{:<117}\n", format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {values:?}, }}"));
    let header = header.replace('[', "(").replace(']', ")");
    let black = [&b"\x93NUMPY\x01\x00v\x00"[..], header.as_bytes(), &vec![0; 4 * values.iter().product::<usize>()]];
    std::fs::write(at("black.npy"), black.concat()).unwrap();
    let job = |name: &str, factorize: &str| {
        let text = format!(
            "light_field = \"black.npy\"\n[display]\nfile = \"d.toml\"\nframes = 2\n[geometry]\nfov_deg = [20, 20]\n\
             [factorize]\niterations = 4\n{factorize}\n[[nodes]]\nid = \"a\"\n"
        );
        std::fs::write(at(name), text).unwrap();
        Job::load(&at(name)).unwrap()
    };
    for (name, factorize) in [("whole.toml", ""), ("tiles.toml", "tiles = [2, 1]")] {
        let (job, dir) = (job(name, factorize), at(name).with_extension("run"));
        with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
        with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
        let report = json(&dir.join("nodes/a/report.json"));
        assert_eq!(report["solution"]["levels"]["rounded"], "Infinity", "{}", report["solution"]);
        let stages = report["stages"].as_array().unwrap();
        let factorize = stages.iter().find(|stage| stage["name"] == "factorize").unwrap();
        assert_eq!(factorize["cached"], true, "{name}");
        assert!(!dir.join("nodes/a/cache/tiles").exists());
    }
}
