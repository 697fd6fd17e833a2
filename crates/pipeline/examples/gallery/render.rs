//! Renders the scenes by our path tracer. Window and light are automatic. The central view is
//! rendered twice, with half of the samples each.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::DQuat;
use lumistack_core::{Cancel, Collector, NoProgress, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_field_io::npy;
use lumistack_field_io::picture::{Precision, write_exr};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_pipeline::{
    ImporterJob, LightJob, PoseJob, Registry, WindowJob, automatic_tone_mapping, is_usd, load_scene, place_window,
    plugins,
};
use lumistack_scene::{Pixels, Scene, Similarity, Window};
use serde_json::{Value, json};

use crate::{Outcome, text};

/// Width of the window, mm. Only the aspect ratio has an effect here.
const WIDTH_MM: f64 = 420.0;
/// Largest number of bounces of a path: enough for glass in front of glass.
const MAX_BOUNCES: u32 = 12;

/// Options of the command line.
pub struct Options {
    size: [usize; 2],
    samples: u32,
    /// Rotation of the window about its vertical axis, degrees.
    turn_deg: f64,
}

impl Options {
    /// Parses the options after the folders.
    pub fn parse(words: &[&str]) -> Outcome<Self> {
        let mut options = Self { size: [420, 262], samples: 128, turn_deg: 0.0 };
        let mut words = words.iter();
        while let Some(&word) = words.next() {
            let value = words.next().ok_or_else(|| format!("{word}: expected a value, found none"))?;
            let wrong = || format!("{word}: expected a number, or COLSxROWS for --size, found {value}");
            match word {
                "--samples" => options.samples = value.parse().map_err(|_| wrong())?,
                "--turn" => options.turn_deg = value.parse().map_err(|_| wrong())?,
                "--size" => {
                    let (cols, rows) = value.split_once('x').ok_or_else(wrong)?;
                    options.size = [cols.parse().map_err(|_| wrong())?, rows.parse().map_err(|_| wrong())?];
                }
                _ => return Err(format!("expected --size, --samples or --turn, found {word}")),
            }
        }
        Ok(options)
    }
}

/// Renders every glTF and USD file in `scenes` and its subfolders.
pub fn all(scenes: &Path, out: &Path, options: &Options) -> Outcome {
    // Sorted files give the same order on every machine.
    let mut files = Vec::new();
    find(scenes, &mut files)?;
    files.sort();
    if files.is_empty() {
        return Err(format!("{}: expected glTF or USD files, found none", scenes.display()));
    }
    let registry = plugins(&[]).map_err(text)?;
    // If a file fails, `ours.json` has the error's message, and the next file follows.
    for file in files {
        let name = file.strip_prefix(scenes).unwrap_or(&file).to_string_lossy().replace('\\', "/");
        let folder = out.join(name.replace('/', "__"));
        std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task { progress: &NoProgress, warnings: &warnings, cancel: &cancel };
        let mut about = match one(&file, &folder, options, &registry, task) {
            Ok(about) => about,
            Err(message) => json!({ "error": message }),
        };
        about["name"] = name.clone().into();
        about["path"] = std::path::absolute(&file).map_err(text)?.display().to_string().into();
        about["warnings"] = warnings.take().iter().map(text).collect();
        let written = serde_json::to_vec_pretty(&about).map_err(text)?;
        std::fs::write(folder.join("ours.json"), written).map_err(text)?;
        println!(
            "{name}: {}",
            about["error"]
                .as_str()
                .map_or_else(|| format!("{:.1} s", about["seconds_render"].as_f64().unwrap_or_default()), String::from)
        );
    }
    Ok(())
}

fn find(folder: &Path, files: &mut Vec<PathBuf>) -> Outcome {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for entry in entries {
        let path = entry.map_err(text)?.path();
        if path.is_dir() {
            find(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") || is_usd(&path) {
            files.push(path);
        }
    }
    Ok(())
}

/// Renders a file into its folder. Returns the settings that Blender needs for the same render.
fn one(file: &Path, folder: &Path, options: &Options, registry: &Registry, task: Task<'_>) -> Outcome<Value> {
    let [cols, rows] = options.size;
    // Place the window as a job with default settings does.
    let start = Instant::now();
    let ingested =
        load_scene(file, &PoseJob::default(), &ImporterJob::default(), registry, &LightJob::default(), None, task)
            .map_err(text)?;
    let grid = ViewGrid::single(Projection::Oblique, [0.0; 2]);
    let geometry = FieldGeometry { rows, cols, pitch_mm: WIDTH_MM / cols as f64, grid };
    let window = place_window(&ingested, &WindowJob::default(), &geometry, None, task).map_err(text)?;
    let window = turned(&window, options.turn_deg);
    let scene = &ingested.scene;
    let environment = write_environment(scene, folder)?;
    let renderer = Renderer::new(scene.clone(), task).map_err(text)?.without_backdrop();
    let seconds_load = start.elapsed().as_secs_f64();

    // Two renders with different seeds have independent noise.
    let start = Instant::now();
    let mut brightest = vec![0.0; rows * cols];
    for (seed, name) in [(1, "ours-a"), (2, "ours-b")] {
        let samples = (options.samples / 2).max(1);
        let settings = Settings { samples, max_bounces: MAX_BOUNCES, seed, ..Settings::default() };
        let radiance = renderer.render_view(&window, &geometry, [0, 0], &settings, task).map_err(text)?;
        for (most, rgb) in brightest.iter_mut().zip(radiance.data().chunks_exact(3)) {
            *most += 0.5 * rgb[0].max(rgb[1]).max(rgb[2]);
        }
        let path = folder.join(name).with_extension("exr");
        write_exr(&path, options.size, radiance.data(), Precision::Float).map_err(text)?;
    }
    let seconds_render = start.elapsed().as_secs_f64();
    let mask = renderer.hit_mask(&window, &geometry, [0, 0], task).map_err(text)?;
    npy::write(&folder.join("covered-ours.npy"), &[rows, cols], mask.data()).map_err(text)?;

    // Choose exposure and tone curve from the mean of both renders, as a job does.
    let rays: Vec<(f32, bool)> = brightest.into_iter().zip(mask.data().iter().map(|&share| share > 0.5)).collect();
    let (exposure, curve) = automatic_tone_mapping(scene, &rays);

    let (map, bounds) = (window.scene_from_display, scene.bounds());
    let reach = 2.0 * f64::from(bounds.size().length()) + (bounds.centre().as_dvec3() - map.translation).length();
    Ok(json!({
        "size": options.size,
        "samples": options.samples,
        "max_bounces": MAX_BOUNCES,
        "animated": false,
        "triangles": scene.triangle_count(),
        "lights": scene.lights.len(),
        "seconds_load": seconds_load,
        "seconds_render": seconds_render,
        "environment": environment,
        "exposure": exposure,
        "curve": curve.name(),
        // No point of the scene is farther from the window than this distance, in scene units.
        "reach": reach,
        "window": {
            "centre": map.translation.to_array(),
            "rotation": map.rotation.to_array(),
            "width": map.scale * window.size_mm[0],
        },
    }))
}

/// Rotates the window about its vertical axis by `degrees`. With a positive angle, the scene looks
/// as if the viewer walked to the right.
fn turned(window: &Window, degrees: f64) -> Window {
    let map = window.scene_from_display;
    let rotation = map.rotation * DQuat::from_rotation_y(degrees.to_radians());
    Window { scene_from_display: Similarity { rotation, ..map }, ..*window }
}

/// Writes the environment as a picture whose values are multiplied by the environment's strength.
/// Returns the picture's name and the environment's rotation.
fn write_environment(scene: &Scene, folder: &Path) -> Outcome<Value> {
    let Some(environment) = scene.environment else { return Ok(Value::Null) };
    let image = &scene.images[environment.image];
    let Pixels::RgbF32(texels) = &image.pixels else {
        return Err("expected an environment with floating-point pixels, found integer pixels".into());
    };
    let rgb: Vec<f32> =
        texels.iter().flat_map(|&[r, g, b]| (environment.strength * glam::Vec3::new(r, g, b)).to_array()).collect();
    let path = folder.join("environment.exr");
    write_exr(&path, [image.width, image.height], &rgb, Precision::Float).map_err(text)?;
    Ok(json!({ "name": image.name, "rotation": environment.scene_from_environment.to_array() }))
}
