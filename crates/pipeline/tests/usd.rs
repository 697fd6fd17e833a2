//! The same scene as glTF and as USD gives the same picture. Needs `LUMISTACK_PYTHON` to name a Python with usd-core, and is skipped without.

use std::path::Path;
use std::process::Command;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_pipeline::{ImporterJob, LightJob, PoseJob, Registry, load_scene};
use lumistack_scene::Window;
use lumistack_testkit::statistics::Mean;

/// Pixels of the picture, and of the square blocks whose means are compared.
const ROWS: usize = 40;
const COLS: usize = 64;
const BLOCK: usize = 8;
/// Pictures per scene, each with its own seed.
const PICTURES: u64 = 24;
/// For each block and channel. The limit is 6.5 standard errors; a difference of two means of 24 (Student's t, 46 degrees of freedom) is beyond it in 5 of
/// 10⁸ cases, and there are 240 of them: 1 false alarm in 80,000.
const RATE: f64 = 8e-11;
/// What rounding may do to the light of a block: texture coordinates are turned upside down twice.
const ROUNDING: f64 = 1e-5;

/// Means of blocks and channels over all pictures.
fn blocks(file: &str, first_seed: u64) -> Vec<Mean> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/still-life").join(file);
    let registry = Registry::built_in().unwrap();
    let (pose, importer, light) = (PoseJob::default(), ImporterJob::default(), LightJob::default());
    let scene = load_scene(&path, &pose, &importer, &registry, &light, None, task).unwrap().scene;
    let pitch_mm = 5.0;
    let geometry =
        FieldGeometry { rows: ROWS, cols: COLS, pitch_mm, grid: ViewGrid::single(Projection::Oblique, [0.0, 0.0]) };
    let window = Window::from_camera(&scene.cameras[0], scene.bounds(), geometry.size_mm()).unwrap();
    let renderer = Renderer::new(scene, task).unwrap();
    let mut sums = vec![Vec::new(); (ROWS / BLOCK) * (COLS / BLOCK) * 3];
    for seed in first_seed..first_seed + PICTURES {
        let settings = Settings { samples: 8, seed, ..Settings::default() };
        let picture = renderer.render_view(&window, &geometry, [0, 0], &settings, task).unwrap();
        let mut means = vec![0.0; sums.len()];
        for (i, &value) in picture.data().iter().enumerate() {
            let (row, col, channel) = (i / 3 / COLS, i / 3 % COLS, i % 3);
            let block = row / BLOCK * (COLS / BLOCK) + col / BLOCK;
            means[3 * block + channel] += f64::from(value) / (BLOCK * BLOCK) as f64;
        }
        sums.iter_mut().zip(means).for_each(|(sums, mean)| sums.push(mean));
    }
    assert!(warnings.take().is_empty(), "{file}");
    sums.into_iter().map(Mean::of).collect()
}

#[test]
fn gltf_and_usd_give_the_same_picture() {
    let python = std::env::var_os("LUMISTACK_PYTHON").unwrap_or_default();
    if !Command::new(python).args(["-c", "import pxr"]).output().is_ok_and(|output| output.status.success()) {
        lumistack_testkit::skip::skipped("LUMISTACK_PYTHON names no Python with usd-core");
        return;
    }
    let gltf = blocks("still-life.gltf", 1);
    assert!(gltf.iter().all(|mean| mean.value > 0.0 && mean.standard_error < 0.2 * mean.value));
    for (file, seed) in [("still-life.usda", 1001), ("still-life.usdz", 2001)] {
        for (ours, theirs) in gltf.iter().zip(blocks(file, seed)) {
            ours.assert_same(theirs, ROUNDING, RATE);
        }
    }
}
