//! Computes the patterns of a small display for a glTF file: file, light, window, views, exposure,
//! patterns, and the picture that a viewer sees from straight ahead.
//!
//! ```text
//! cargo run --release -p lumistack-shot --example patterns -- MODEL FOLDER
//! ```

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use lumistack_core::colour::srgb_code;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, LightField, Simulator, Weights};
use lumistack_factorizer::{Problem, factorize};
use lumistack_gltf::AssetResolver;
use lumistack_pathtracer::Settings as Paths;
use lumistack_shot::{Brightest, Depths, LightJob, LitScene, ToneMapping, WindowJob, light, place};

/// Reads files in the folder of the model, and no other files.
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

fn main() -> ExitCode {
    let words: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let done = match &words[..] {
        [model, folder] => patterns(model, folder),
        _ => Err("expected two arguments: MODEL FOLDER".into()),
    };
    if let Err(error) = done {
        // the text of an error names file, place, expected and found
        eprintln!("error: {error}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

pub(crate) fn patterns(model: &Path, folder: &Path) -> Result<(), Box<dyn Error>> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);

    // a scene without light gets studio light
    let beside = Folder(model.parent().unwrap_or(Path::new("")).join("."));
    let bytes = std::fs::read(model).map_err(|error| format!("{}: {error}", model.display()))?;
    let scene = lumistack_gltf::load(&model.display().to_string(), &bytes, &beside, task)?;
    let job = LightJob::default();
    let (scene, _) = light::lit(scene, false, &job, task)?;
    let subject = LitScene::new(scene, task)?;

    // 160 × 100 pixels of 1.5 mm, 5 × 5 views over 20°, layers at −20, 0 and 20 mm, two frames
    let display = Display::uniform([160, 100], 1.5, [5, 5], [20.0, 20.0], &[-20.0, 0.0, 20.0], 2);
    let geometry = display.geometry()?;
    // the window that shows the scene; depth is compressed if the display cannot show all of it
    let placement = place(&subject, &WindowJob::default(), &display, &geometry, task)?;
    let traced = geometry.with_grid(geometry.grid.scaled(placement.depth_scale));

    // the views, and the brightness of their surfaces, from which one exposure for all is chosen
    let depths = Depths::trace(&subject.renderer, &placement.window, &traced, task)?;
    let brightest = Brightest::new(&traced, traced.grid.iter().count(), &depths);
    let paths = Paths { samples: 16, ..Paths::default() };
    let (mut target, mut measured) = (LightField::black(geometry)?, Vec::new());
    for (number, view) in traced.grid.iter().enumerate() {
        let radiance = subject.renderer.tracer.render_view(&placement.window, &traced, view, &paths, task)?;
        measured.extend(brightest.of_view(number, view, radiance.data()));
        target.view_mut(view).copy_from_slice(radiance.data());
    }
    ToneMapping::choose(&job, &subject.scene, &measured).apply(&mut target);

    let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
    let solved = factorize(&problem, &Default::default(), None, task, &mut |_| {})?;
    println!("{:.1} dB", solved.history.last().ok_or("no iteration")?.psnr_view);

    // one picture per layer and frame, and the view from straight ahead at the target's brightness
    std::fs::create_dir_all(folder)?;
    for (number, layer) in solved.stack.layers.iter().enumerate() {
        let [frames, rows, cols, _] = layer.shape();
        for frame in 0..frames {
            let path = folder.join(format!("layer_{number}_frame_{frame}.png"));
            write_png(&path, [rows, cols], layer.block([frame]), 1.0)?;
        }
    }
    let seen = Simulator::new(&display, &solved.stack).from_slope([0.0, 0.0]).radiance;
    let [rows, cols, _] = seen.shape();
    write_png(&folder.join("seen.png"), [rows, cols], seen.data(), 1.0 / solved.stack.brightness as f32)?;
    for warning in warnings.take() {
        eprintln!("warning: {warning}");
    }
    Ok(())
}

fn write_png(path: &Path, [rows, cols]: [usize; 2], values: &[f32], gain: f32) -> Result<(), Box<dyn Error>> {
    let codes = values.iter().map(|value| srgb_code(gain * value)).collect();
    let picture = image::RgbImage::from_raw(cols as u32, rows as u32, codes).ok_or("expected 3 bytes per pixel")?;
    Ok(picture.save(path)?)
}
