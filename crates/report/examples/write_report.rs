//! Factorizes a light field in a `.npy` file and writes its report, to develop the page. The light
//! field must have as many views across as up. The command is:
//!
//! ```text
//! cargo run --release -p lumistack-report --example write_report -- \
//!     LIGHTFIELD.npy PITCH_MM FOV_DEG DISPLAY OUT_DIR [SOLVER]
//! ```
//!
//! DISPLAY is `layers:N:M` (N layers 40 mm apart, M frames), `lenslets:M` (one layer and a
//! directional backlight) or `held-out:N:M`. With `held-out`, every second view is a target, and
//! the views between the targets are held out.

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use lumistack_core::metrics::Flip;
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{Display, FieldGeometry, LightField, Projection, ViewGrid, Weights};
use lumistack_factorizer::{Problem, Settings, factorize};
use lumistack_report::{Iteration, Output, ReportInput, Stage, build};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (mut settings, given) = (Settings::default(), args.split_at_checked(5));
    let Some(([path, pitch_mm, fov_deg, kind, out], solver)) = given else {
        return Err("expected LIGHTFIELD.npy PITCH_MM FOV_DEG DISPLAY OUT_DIR [SOLVER]".into());
    };
    if let [solver] = solver {
        settings.solver.clone_from(solver);
    }
    let field = read_field(Path::new(path), pitch_mm.parse()?, fov_deg.parse()?)?;
    let (kind, counts) = kind.split_once(':').ok_or("expected DISPLAY as kind:counts")?;
    let counts = counts.split(':').map(str::parse).collect::<Result<Vec<usize>, _>>()?;
    let (target, held_out) = if kind == "held-out" { split(&field)? } else { (field, None) };
    let display = match (kind, counts.as_slice()) {
        ("layers" | "held-out", [layers, frames]) => layered(target.geometry(), fov_deg, *layers, *frames),
        ("lenslets", [frames]) => directional(target.geometry(), fov_deg, *frames),
        _ => return Err("expected DISPLAY as layers:N:M, lenslets:M or held-out:N:M".into()),
    };
    let display = Display::from_toml(&display)?;

    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
    let start = Instant::now();
    let mut convergence = Vec::new();
    let made = factorize(&problem, &settings, None, task, &mut |it| {
        let seconds = start.elapsed().as_secs_f64();
        convergence.push(Iteration {
            iteration: it.iteration,
            objective: it.objective,
            psnr_view: it.psnr_view,
            seconds,
        });
    })?;
    let stages = [
        Stage { name: "read".into(), seconds: 0.02, cached: true },
        Stage { name: "factorize".into(), seconds: start.elapsed().as_secs_f64(), cached: false },
    ];
    let settings = serde_json::json!({
        "light_field": path,
        "solver": { "name": settings.solver, "iterations": settings.iterations, "seed": settings.seed },
    });
    let report_start = Instant::now();
    let report = build(
        &ReportInput {
            title: &format!(
                "{} on {}",
                Path::new(path).file_stem().unwrap_or_default().to_string_lossy(),
                display.name
            ),
            display: &display,
            stack: &made.stack,
            target: &target,
            weights: &Weights::Uniform,
            held_out: held_out.as_ref(),
            outside: None,
            zone: None,
            pixels_per_degree: Flip::DEFAULT_PIXELS_PER_DEGREE,
            convergence: &convergence,
            solution: None,
            stages: &stages,
            settings: &settings,
            denoising: None,
            scene: None,
            depth: None,
            warnings: &warnings.take(),
            outputs: &[Output { label: "Patterns as arrays".into(), path: "layers/".into(), failed: None }],
            command: Some(&format!("write_report {}", args.join(" "))),
            version: env!("CARGO_PKG_VERSION"),
        },
        task,
    )?;
    println!("report built in {:.2} s, {:.2} MB", report_start.elapsed().as_secs_f64(), report.html.len() as f64 / 1e6);
    std::fs::create_dir_all(out)?;
    std::fs::write(Path::new(out).join("report.html"), &report.html)?;
    std::fs::write(Path::new(out).join("report.json"), serde_json::to_string_pretty(&report.json)?)?;
    println!("psnr_view {:.2} dB, psnr_raw {:.2} dB: {out}/report.html", report.psnr_view, report.psnr_raw);
    Ok(())
}

fn read_field(path: &Path, pitch_mm: f64, fov_deg: f64) -> Result<LightField, Box<dyn Error>> {
    let npy = npyz::NpyFile::new(std::io::BufReader::new(std::fs::File::open(path)?))?;
    let shape: Vec<usize> = npy.shape().iter().map(|n| *n as usize).collect();
    let shape: [usize; 5] = shape.try_into().map_err(|_| "expected axes [view_y][view_x][row][col][rgb]")?;
    let grid = ViewGrid::uniform(Projection::Oblique, [shape[1], shape[0]], [fov_deg; 2])?;
    let geometry = FieldGeometry { rows: shape[2], cols: shape[3], pitch_mm, grid };
    Ok(LightField::new(geometry, Tensor::from_vec(LightField::AXES, shape, npy.into_vec()?)?)?)
}

/// Returns every second view, and the views between them on both axes.
fn split(field: &LightField) -> Result<(LightField, Option<LightField>), Box<dyn Error>> {
    let pick = |first: usize| -> Result<LightField, Box<dyn Error>> {
        let all = field.geometry();
        let every_second = |slopes: &[f64]| slopes.iter().skip(first).step_by(2).copied().collect();
        let (slope_x, slope_y) = (every_second(&all.grid.slope_x), every_second(&all.grid.slope_y));
        let geometry = all.with_grid(ViewGrid { projection: all.grid.projection, slope_x, slope_y });
        let mut part = LightField::black(geometry.clone())?;
        for [y, x] in geometry.grid.iter() {
            part.view_mut([y, x]).copy_from_slice(field.view([first + 2 * y, first + 2 * x]));
        }
        Ok(part)
    };
    Ok((pick(0)?, Some(pick(1)?)))
}

fn header(geometry: &FieldGeometry, fov_deg: &str, name: &str, frames: usize) -> String {
    let (cols, rows, pitch_mm, [view_rows, view_cols]) =
        (geometry.cols, geometry.rows, geometry.pitch_mm, geometry.grid.views());
    format!(
        "name = \"{name}\"\nframes = {frames}\nrefresh_hz = 120.0\nbrightness = 0.2\n[field]\nresolution = [{cols}, {rows}]\npitch_mm = {pitch_mm}\n\
         views = [{view_cols}, {view_rows}]\nfov_deg = [{fov_deg}, {fov_deg}]\n"
    )
}

fn layered(geometry: &FieldGeometry, fov_deg: &str, layers: usize, frames: usize) -> String {
    let mut text = header(geometry, fov_deg, &format!("{layers} layers, {frames} frames"), frames);
    for n in 0..layers {
        let d_mm = 40.0 * (n as f64 - (layers as f64 - 1.0) / 2.0);
        text += &layer(geometry, d_mm);
    }
    text
}

fn directional(geometry: &FieldGeometry, fov_deg: &str, frames: usize) -> String {
    let [view_rows, view_cols] = geometry.grid.views();
    let (cols, rows) = ((geometry.cols as f64 / 3.4).round(), (geometry.rows as f64 / 3.4).round());
    header(geometry, fov_deg, &format!("layer and lenslets, {frames} frames"), frames)
        + &layer(geometry, 0.0)
        + &format!(
            "[backlight]\nkind = \"lenslets\"\nd_mm = -30.0\nlenslets = [{cols}, {rows}]\npitch_mm = {}\nfov_deg = [{fov_deg}, {fov_deg}]\nviews = [{view_cols}, {view_rows}]\n",
            geometry.cols as f64 * geometry.pitch_mm / cols
        )
}

fn layer(geometry: &FieldGeometry, d_mm: f64) -> String {
    let (cols, rows, pitch_mm) = (geometry.cols, geometry.rows, geometry.pitch_mm);
    format!("[[layers]]\nd_mm = {d_mm:?}\nresolution = [{cols}, {rows}]\npitch_mm = {pitch_mm}\n")
}
