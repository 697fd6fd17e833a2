//! Renders views of a glTF file to PNG, and prints the time that this takes.
//!
//! ```text
//! cargo run --release -p lumistack-pathtracer --example render_gltf --
//!     SCENE [-o FOLDER] [--size COLSxROWS] [--samples N] [--views N]
//! ```
//!
//! The window comes from the file's first camera, or is framed on the scene. A scene without light
//! gets a sky that is white above and grey below. The views are an N × N grid over 20° × 20° with
//! oblique projection, on a window 474 mm wide. All views are timed. With a folder, the views at
//! the corners and in the centre are written.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use glam::{Quat, Vec3};
use lumistack_core::colour::srgb_code;
use lumistack_core::{Cancel, Collector, NoProgress, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_gltf::AssetResolver;
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::{Environment, Image, Pixels, Scene, Window};

/// Width of the window in millimetres: 420 pixels of 1.128 mm, the paper's panel at half
/// resolution.
const WIDTH_MM: f64 = 473.76;
/// Full angle of the grid of views, in degrees.
const FOV_DEG: f64 = 20.0;

/// Reads files in the folder of the scene, and no other files.
struct Folder(PathBuf);

impl AssetResolver for Folder {
    fn read(&self, uri: &str, max_bytes: u64) -> Result<Vec<u8>, String> {
        let text = |error: std::io::Error| error.to_string();
        // the canonical path has no `..` and no links, so its start shows whether it is inside
        let folder = self.0.canonicalize().map_err(text)?;
        let path = folder.join(uri).canonicalize().map_err(text)?;
        let file = path.metadata().map_err(text)?;
        if !path.starts_with(&folder) || !file.is_file() || file.len() > max_bytes {
            return Err(format!("expected a file of at most {max_bytes} bytes in {}", folder.display()));
        }
        std::fs::read(path).map_err(text)
    }
}

struct Arguments {
    scene: PathBuf,
    out: Option<PathBuf>,
    size: [usize; 2],
    samples: u32,
    views: usize,
}

fn main() -> ExitCode {
    match arguments().and_then(|arguments| render(&arguments).map_err(|error| error.to_string())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn arguments() -> Result<Arguments, String> {
    let mut parsed = Arguments { scene: PathBuf::new(), out: None, size: [420, 262], samples: 16, views: 5 };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "-o" => parsed.out = Some(value()?.into()),
            "--samples" => parsed.samples = value()?.parse().map_err(|_| "--samples needs a number")?,
            "--views" => parsed.views = value()?.parse().map_err(|_| "--views needs a number")?,
            "--size" => {
                let value = value()?;
                let (cols, rows) = value.split_once('x').ok_or("--size needs COLSxROWS")?;
                parsed.size = [cols, rows].map(|n| n.parse().unwrap_or(0));
            }
            _ => parsed.scene = word.into(),
        }
    }
    if parsed.scene.as_os_str().is_empty() { Err("expected a .gltf or .glb file".into()) } else { Ok(parsed) }
}

fn render(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    // load the scene, and place the window
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task { progress: &NoProgress, warnings: &warnings, cancel: &cancel };
    let bytes = std::fs::read(&arguments.scene)?;
    let folder = Folder(arguments.scene.parent().unwrap_or(Path::new("")).join("."));
    let name = arguments.scene.display().to_string();
    let scene = Arc::new(with_light(lumistack_gltf::load(&name, &bytes, &folder, task)?, task)?);

    let [cols, rows] = arguments.size;
    let grid = ViewGrid::uniform(Projection::Oblique, [arguments.views; 2], [FOV_DEG; 2])?;
    let geometry = FieldGeometry { rows, cols, pitch_mm: WIDTH_MM / cols as f64, grid };
    let window = match scene.cameras.first() {
        Some(camera) => Window::from_camera(camera, scene.bounds(), geometry.size_mm())?,
        None => Window::framing(scene.bounds(), geometry.size_mm())?,
    };
    let settings = Settings { samples: arguments.samples, ..Settings::default() };

    // time the preparation and the views, and write some of the pictures
    let start = Instant::now();
    let renderer = Renderer::new(scene.clone(), task)?;
    println!("{} triangles, prepared in {:.2} s", scene.triangle_count(), start.elapsed().as_secs_f64());
    let start = Instant::now();
    let last = arguments.views - 1;
    for view in geometry.grid.iter() {
        let radiance = renderer.render_view(&window, &geometry, view, &settings, task)?;
        let shown = view.iter().all(|&v| v == 0 || v == last) || view == [last / 2; 2];
        if let (Some(out), true) = (&arguments.out, shown) {
            std::fs::create_dir_all(out)?;
            write_png(&out.join(format!("view_{:02}_{:02}.png", view[0], view[1])), &radiance)?;
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    let paths = (rows * cols) as f64 * f64::from(arguments.samples) * (arguments.views * arguments.views) as f64;
    println!("{} views in {seconds:.2} s, {:.2} Msamples/s", arguments.views.pow(2), paths / seconds * 1e-6);
    let centre = [last / 2; 2];
    println!("the scene covers {:.0} % of the window", 100.0 * renderer.coverage(&window, &geometry, centre, task)?);
    for warning in warnings.take() {
        println!("warning: {warning}");
    }
    Ok(())
}

/// Adds a sky, white above and grey below, to a scene that is not [lit](Scene::is_lit).
fn with_light(scene: Scene, task: Task<'_>) -> Result<Scene, Box<dyn std::error::Error>> {
    if scene.is_lit() {
        return Ok(scene);
    }
    let mut parts = scene.into_parts();
    let rows = [1.0, 0.9, 0.3, 0.2];
    let texels = rows.iter().map(|&row| [row; 3]).collect();
    parts.images.push(Image { name: "sky".into(), width: 1, height: rows.len(), pixels: Pixels::RgbF32(texels) });
    let image = parts.images.len() - 1;
    parts.environment = Some(Environment { image, strength: Vec3::ONE, scene_from_environment: Quat::IDENTITY });
    Ok(parts.validate(task)?)
}

fn write_png(path: &Path, radiance: &Tensor<3>) -> Result<(), Box<dyn std::error::Error>> {
    let [rows, cols, _] = radiance.shape();
    let codes = radiance.data().iter().map(|&v| srgb_code(v)).collect();
    let picture = image::RgbImage::from_raw(cols as u32, rows as u32, codes).ok_or("expected 3 bytes per pixel")?;
    Ok(picture.save(path)?)
}
