//! Measures the number of paths per pixel and view that a display needs. The measurement uses small
//! sections of the picture, before the whole picture is rendered.
//!
//! ```text
//! MSE(n) = D + V / n        D: squared error of the seen pictures of a solve without noise
//!                           V: error that the noise of one path per pixel and view adds
//! n = V / (η D)             η: fraction of the error that noise may add
//! ```
//!
//! Every section is rendered twice with one path per pixel and view, from independent seeds a and
//! b, and solved for both renders. If the views share light, pixels also have a further ray, and
//! paths are sparse. Then MSE(n) has the same form: with n = 1, 2 and 4 for
//! `scenes/still-life/job.toml`, V was 0.26, 0.27 and 0.27 · 10⁻³. S_a and S_b are the seen
//! pictures of the two solves, in directions that no solver used. R_a and R_b are renders of the
//! scene in these directions, with two more seeds:
//!
//! ```text
//! V = E[(S_a − S_b)²] / 2        D = E[(S_a − R_a)(S_b − R_b)]
//! ```
//!
//! D contains no noise, since all seeds are independent. V contains only noise that a viewer sees.
//! A pixel of a layer averages over all rays through it, so the noise in the target's views is
//! larger than V.

use std::path::Path;

use glam::{DQuat, DVec3};
use lumistack_core::pages::Array;
use lumistack_core::{NoProgress, Task, Tensor, seed};
use lumistack_display::{
    Backlight, Display, FieldGeometry, LightField, Projection, Simulator, ViewGrid, Views, Weights,
};
use lumistack_factorizer::{held_bytes, paged_bytes};
use lumistack_field_io::FieldWriter;
use lumistack_pathtracer::denoise::SharedLight;
use lumistack_pathtracer::{AngularFilter, Settings, SplitView};
use lumistack_scene::{Similarity, Window};
use lumistack_shot::{Placement, ToneMapping};
use rayon::prelude::*;

use super::device::SolverDevice;
use super::factorize::Solve;
use super::fields::Shot;
use super::paths::Samples;
use super::score;
use crate::error::{PipelineError, display_error, field_error, render_error};
use crate::job::{Background, Denoise, Engine, FactorizeJob, Job};
use crate::stage::ingest::Ingested;
use crate::store::code;
use crate::store::stamps::remembered;

/// Maximum number of sections of the picture. In this code, a section is a `Part`.
const PARTS: usize = 6;
/// Maximum fraction of the picture's area that all sections cover. A single section may cover more.
const MOST_AREA: f64 = 0.25;
/// Edge of the measured middle of a section, pixels. The margin around it is not measured, since
/// some of its rays miss the section's layers.
const MIDDLE: usize = 40;
/// Iterations of the solver. With more iterations, the ratio of noise to error changes little.
const ITERATIONS: u32 = 8;
/// Number of directions in which each section is compared.
const DIRECTIONS: usize = 4;
/// Number of paths per pixel in each of the two renders of a direction.
const REFERENCE_PATHS: u32 = 4;
/// A pixel is included if the display covers at least this fraction of its area.
const WHOLE: f32 = 0.999;
/// Maximum number of rays from which the exposure is chosen.
const MOST_RAYS: usize = 4_000_000;
/// Identifies a sequence of random numbers that no view uses.
const STREAM: u64 = 0x5a3b_0001;

/// Returns the number of paths per pixel and view that the display needs, measured once and cached
/// in a folder. `None` if the job sets the number, or the measurement does not apply.
///
/// # Errors
/// If rendering or solving fails or is cancelled, or the folder cannot be written.
pub(crate) fn measured(
    job: &Job,
    ingested: &Ingested,
    placement: &Placement,
    display: &Display,
    cache_dir: &Path,
    task: Task<'_>,
) -> Result<Option<Samples>, PipelineError> {
    let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
    let views = geometry.grid.iter().count();
    let is_ours = match job.render.engine {
        Engine::Lumistack => true,
        Engine::Blender => false,
        Engine::Auto => ingested.blend().is_none(),
    };
    // Do not measure for fixed views. A display with fixed views is correct only at its views.
    // Noise is measured between views, where it has less effect than the display's error.
    let is_chosen = !matches!(display.field.views, Views::Fixed(_));
    if !(job.render.samples_are_measured() && is_chosen && views > 1 && ingested.scene.needs_paths() && is_ours) {
        return Ok(None);
    }
    // The key contains everything that noise and error depend on.
    let shot = Shot { job, ingested, placement, geometry: &geometry, display, samples: None };
    let mut key = shot.key();
    key.add_json("settings", &(&job.render, job.seed, &job.light))
        .add("display", display.without_panels().to_toml().as_bytes())
        .add("traced", format!("{geometry:?} {}", placement.depth_scale).as_bytes())
        .add_json("solver", &code::PATTERNS);
    let file = format!("samples-{}.json", &key.finish()[..16]);
    remembered(Some(cache_dir), &file, || measure(shot, display, cache_dir, task)).map(Some)
}

/// A section of the picture: a small display, and its window in the scene.
struct Part {
    display: Display,
    geometry: FieldGeometry,
    window: Window,
    /// Centre of the section relative to the centre of the display, millimetres.
    centre_mm: [f64; 2],
    margin: usize,
}

/// One of the two renders of a section.
struct Half {
    field: LightField,
    /// For evenly spread rays: the brightest channel, and true if the ray hits a surface.
    brightest: Vec<(f32, bool)>,
}

/// Folder for light fields that are kept in files, and the largest number of bytes of each of them
/// that may be in memory. `None` keeps light fields in memory.
type Place<'a> = Option<(&'a Path, usize)>;

fn measure(shot: Shot<'_>, display: &Display, cache_dir: &Path, task: Task<'_>) -> Result<Samples, PipelineError> {
    let Shot { job, ingested, geometry, .. } = shot;
    let parts = parts(display, geometry, shot.window());
    std::fs::create_dir_all(cache_dir).map_err(PipelineError::write(cache_dir))?;
    let place: Place<'_> = (!job.render.is_held(geometry)).then(|| (cache_dir, window_bytes(job)));
    // The exposure is chosen from evenly spread rays of all sections: every n-th ray.
    let rays: usize = parts.iter().map(Part::rays).sum();
    let every = rays.div_ceil(MOST_RAYS);
    let quiet = Task { progress: &NoProgress, ..task };
    task.progress.begin("choose samples", 2 * parts.len() as u64, "parts");

    // Make both renders of every section, in linear light.
    let mut halves: Vec<[Half; 2]> = Vec::with_capacity(parts.len());
    for (number, part) in parts.iter().enumerate() {
        let [a, b] = [0, 1].map(|half| render(shot, part, [number as u64, half], every, place, quiet));
        halves.push([a?, b?]);
        task.progress.advance(1, "");
    }

    // All renders get the same exposure and tone curve, chosen as for a whole picture.
    let brightest: Vec<(f32, bool)> =
        halves.iter_mut().flat_map(|[half, _]| std::mem::take(&mut half.brightest)).collect();
    let tone_mapping = ToneMapping::choose(&job.light, &ingested.scene, &brightest);
    drop(brightest);
    for half in halves.iter_mut().flatten() {
        let exposed = FieldWriter::begin(half.field.geometry().clone(), place).map_err(field_error)?;
        half.field = by_views(exposed, |view| {
            let mut picture = half.field.view(view).to_vec();
            tone_mapping.apply_to(&mut picture);
            Ok(picture)
        })?;
    }

    // Distribute directions over the sections. The directions are generated like the directions of
    // the zone score.
    let zone = score::zone_of(job, display, geometry);
    let directions = zone.directions(parts.len() * DIRECTIONS);
    let measured = parts.par_iter().zip(&halves).enumerate().map(|(number, (part, halves))| {
        let directions: Vec<&ViewGrid> = directions.iter().skip(number).step_by(parts.len()).collect();
        let sums = compare(shot, part, halves, tone_mapping, &directions, number as u64, quiet);
        task.progress.advance(1, "");
        sums
    });
    let measured: Result<Vec<Sums>, PipelineError> = measured.collect();
    task.progress.end();
    let all = measured?.into_iter().fold(Sums::default(), Sums::merged);
    let count = all.count.max(1.0);
    Ok(Samples::new(all.noise / count, all.error / count, geometry.grid.iter().count()))
}

/// Sums of noise and error over the values of the seen pictures.
#[derive(Clone, Copy, Default)]
struct Sums {
    noise: f64,
    error: f64,
    count: f64,
}

impl Sums {
    fn merged(self, other: Self) -> Self {
        Self { noise: self.noise + other.noise, error: self.error + other.error, count: self.count + other.count }
    }
}

/// Solves for both renders of a section, and compares the two seen pictures with renders of the
/// scene and with each other.
fn compare(
    shot: Shot<'_>,
    part: &Part,
    halves: &[Half; 2],
    tone_mapping: ToneMapping,
    directions: &[&ViewGrid],
    number: u64,
    task: Task<'_>,
) -> Result<Sums, PipelineError> {
    let Shot { job, ingested, placement, .. } = shot;
    // Default settings of the solver suffice, since only the ratio of noise to error is used.
    let of_solver = FactorizeJob { iterations: Some(ITERATIONS), ..FactorizeJob::default() };
    let solve = |half: &Half| {
        let target = &half.field;
        let solve =
            Solve { job: &of_solver, seed: job.seed, display: &part.display, target, weights: &Weights::Uniform };
        solve.factorize(&SolverDevice::Processor, None, task, &mut |_| ()).map(|factorization| factorization.stack)
    };
    let stacks = [solve(&halves[0])?, solve(&halves[1])?];
    let simulators = stacks.each_ref().map(|stack| Simulator::new(&part.display, stack));
    let tracer = &ingested.renderer(task)?.tracer;

    // Sum noise and error over the middle of the section, in directions of the viewing zone.
    let mut sums = Sums::default();
    for (index, direction) in directions.iter().enumerate() {
        let geometry = part.geometry.with_grid(part.moved(direction));
        let traced = part.geometry.with_grid(part.moved(&direction.scaled(placement.depth_scale)));
        let seen = simulators.each_ref().map(|simulator| simulator.seen(&geometry, [0, 0]));
        let reference = |half: u64| {
            let settings = Settings {
                samples: REFERENCE_PATHS,
                clamp: None,
                seed: seed::derive(job.seed, &[STREAM, number, 2 + half, index as u64]),
                angular_filter: AngularFilter::Point,
                ..settings(shot)
            };
            let mut picture =
                tracer.render_view(&part.window, &traced, [0, 0], &settings, task).map_err(render_error)?;
            tone_mapping.apply_to(picture.data_mut());
            Ok::<_, PipelineError>(picture)
        };
        // Two references with independent seeds keep noise out of the error.
        let references = [reference(0)?, reference(1)?];
        for (row, col) in part.middle() {
            let pixel = row * part.geometry.cols + col;
            if seen.iter().any(|seen| seen.share[pixel] < WHOLE) {
                continue;
            }
            for value in 3 * pixel..3 * pixel + 3 {
                let shown = [0, 1].map(|i| f64::from(seen[i].radiance.data()[value]) / stacks[i].brightness);
                let wrong = [0, 1].map(|i| shown[i] - f64::from(references[i].data()[value]));
                sums.noise += 0.5 * (shown[0] - shown[1]).powi(2);
                sums.error += wrong[0] * wrong[1];
                sums.count += 1.0;
            }
        }
    }
    Ok(sums)
}

/// Renders a section with one path per pixel and view. If the job shares light between views, the
/// shared light is averaged here too.
fn render(
    shot: Shot<'_>,
    part: &Part,
    stream: [u64; 2],
    every: usize,
    place: Place<'_>,
    task: Task<'_>,
) -> Result<Half, PipelineError> {
    let Shot { job, ingested, placement, .. } = shot;
    let traced = part.geometry.with_grid(part.traced_grid(&shot.geometry.grid, placement.depth_scale));
    let seed = seed::derive(job.seed, &[STREAM, stream[0], stream[1]]);
    let settings = job.split_settings(Settings { samples: 1, seed, ..settings(shot) }, shot.display);
    let tracer = &ingested.renderer(task)?.tracer;
    let storage = place.map(|(folder, limit)| lumistack_field_io::storage(folder, limit));
    let [rows, cols] = [traced.rows, traced.cols];
    let parts = SplitView::values_of(&settings);
    let size = rows * cols * parts;
    // Light that views share has less noise. So the measurement shares light between views if the
    // job does.
    let of_file = |error| PipelineError::write(place.map_or(Path::new(""), |(folder, _)| folder))(error);
    let mut light = match &storage {
        _ if shot.denoise() != Denoise::Shared => None,
        Some(storage) => Some(SharedLight::in_storage(&traced, &settings, storage).map_err(of_file)?),
        None => Some(SharedLight::new(&traced, &settings)),
    };
    let mut splits = Array::zeros(size * traced.grid.iter().count(), storage.as_ref()).map_err(of_file)?;
    for (number, view) in traced.grid.iter().enumerate() {
        let split = tracer.render_split(&part.window, &traced, view, &settings, task).map_err(render_error)?;
        if let Some(light) = &mut light {
            light.add(&split);
        }
        let (values, window) = splits.all_mut();
        window.into_iter().for_each(|window| window.announce(size * size_of::<f32>()));
        values[number * size..][..size].copy_from_slice(split.values().data());
    }
    let light = light.map(|light| light.averaged(task)).transpose()?;
    // Write the views in order, and collect the rays for the exposure.
    let mut brightest = Vec::with_capacity(part.rays() / every + 1);
    let (mut number, view_cols) = (0, traced.grid.views()[1]);
    let writer = FieldWriter::begin(part.geometry.clone(), place).map_err(field_error)?;
    let field = by_views(writer, |[view_y, view_x]| {
        let at = view_y * view_cols + view_x;
        let values = splits.part(at * size..(at + 1) * size).to_vec();
        let values = Tensor::from_vec(["row", "col", "part"], [rows, cols, parts], values);
        let split = values.ok().and_then(SplitView::from_values);
        let split = split.ok_or_else(|| {
            PipelineError::value("samples", "view", "the values of a traced view", "values of another size")
        })?;
        let picture = light.as_ref().map_or_else(|| split.radiance(), |light| light.on(at, &split)).into_data();
        for (rgb, is_surface) in picture.as_chunks::<3>().0.iter().zip(split.surfaces()) {
            if number % every == 0 {
                brightest.push((rgb[0].max(rgb[1]).max(rgb[2]), is_surface));
            }
            number += 1;
        }
        Ok(picture)
    })?;
    Ok(Half { field, brightest })
}

/// Writes a light field. `picture` returns the views of the light field one after another.
fn by_views(
    mut writer: FieldWriter,
    mut picture: impl FnMut([usize; 2]) -> Result<Vec<f32>, PipelineError>,
) -> Result<LightField, PipelineError> {
    for view in writer.geometry().grid.iter() {
        writer.write(&picture(view)?).map_err(field_error)?;
    }
    writer.finish(Path::new("samples")).map_err(field_error)
}

/// Returns the sections of the picture that a measurement would use. Their windows have the right
/// sizes, but not the right places in the scene. Empty if the job needs no measurement.
fn sizes_of_parts(job: &Job, display: &Display, geometry: &FieldGeometry) -> Vec<Part> {
    let is_chosen = !matches!(display.field.views, Views::Fixed(_));
    if !(job.render.samples_are_measured() && is_chosen) {
        return Vec::new();
    }
    let scene_from_display = Similarity { rotation: DQuat::IDENTITY, scale: 1.0, translation: DVec3::ZERO };
    parts(display, geometry, &Window { scene_from_display, size_mm: geometry.size_mm(), near_mm: None })
}

/// Returns the number of paths of the measurement; 0 if the job needs no measurement.
pub(crate) fn paths(job: &Job, display: &Display, geometry: &FieldGeometry) -> usize {
    2 * sizes_of_parts(job, display, geometry).iter().map(Part::rays).sum::<usize>()
}

/// Returns an upper bound of the memory of the measurement, bytes; 0 if the job needs no
/// measurement.
pub(crate) fn bytes(job: &Job, display: &Display, geometry: &FieldGeometry, threads: usize) -> u64 {
    let parts = sizes_of_parts(job, display, geometry);
    let (count, at_once) = (parts.len() as u64, parts.len().min(threads) as u64);
    let Some(part) = parts.first() else { return 0 };
    let rays = part.rays() as u64;
    let exposure = 2 * size_of::<(f32, bool)>() as u64 * (count * rays).min(MOST_RAYS as u64);
    // One section is rendered at a time, but several sections are solved in parallel.
    let settings = job.split_settings(Settings { samples: 1, ..Settings::default() }, display);
    let split = (size_of::<f32>() * SplitView::values_of(&settings)) as u64;
    const FIELD: u64 = 12;
    let (rendering, solving) = if job.render.is_held(geometry) {
        let rendering = rays * (split + SharedLight::BYTES_PER_RAY) + 2 * count * rays * FIELD;
        let solving = at_once * held_bytes(&part.display, &part.geometry, threads) + (2 * count + 1) * rays * FIELD;
        (rendering, solving)
    } else {
        let (window, view) = (window_bytes(job) as u64, 4 * split * (part.geometry.rows * part.geometry.cols) as u64);
        let in_memory = |of_thread: u64| window + threads as u64 * of_thread;
        let solving = paged_bytes(&part.display, &part.geometry, threads, window) + in_memory(view);
        (4 * in_memory(view), at_once * solving)
    };
    exposure + rendering.max(solving)
}

/// Returns the number of bytes of a section's light field that may be in memory if the light field
/// is in a file. It is an eighth of the number for a whole light field, since several sections are
/// compared in parallel.
fn window_bytes(job: &Job) -> usize {
    job.render.window_bytes() / 8
}

/// Returns the settings for tracing, without the number of paths, the seed and the job's angular
/// filter.
fn settings(shot: Shot<'_>) -> Settings {
    let hide_environment = shot.job.light.background != Background::Environment;
    Settings {
        max_bounces: shot.job.render.max_bounces,
        clamp: shot.job.render.clamp,
        hide_environment,
        ..Settings::default()
    }
}

/// Places sections evenly over the picture, by the additive recurrence that also spreads
/// [directions](lumistack_display::Zone::directions).
fn parts(display: &Display, geometry: &FieldGeometry, window: &Window) -> Vec<Part> {
    let margin = margin(display, geometry);
    let edge = MIDDLE + 2 * margin;
    let [rows, cols] = [edge.min(geometry.rows), edge.min(geometry.cols)];
    let area = (geometry.rows * geometry.cols) as f64 / (rows * cols) as f64;
    let count = ((MOST_AREA * area) as usize).clamp(1, PARTS);
    // The first place is the centre, so a single section is in the middle of the picture.
    let places = spread(count);
    let [free_rows, free_cols] = [geometry.rows - rows, geometry.cols - cols].map(|free| free as f64);
    places
        .into_iter()
        .map(|[x, y]| {
            let from = |place: f64, free: f64| (place * (free + 1.0)).floor().min(free);
            let shift = |from: f64, free: f64| (from - 0.5 * free) * geometry.pitch_mm;
            let centre_mm = [shift(from(x, free_cols), free_cols), -shift(from(y, free_rows), free_rows)];
            part(display, geometry, window, [rows, cols], centre_mm, margin)
        })
        .collect()
}

/// Returns `count` points of the unit square; the first is the centre.
fn spread(count: usize) -> Vec<[f64; 2]> {
    // This is the real root of x³ = x + 1, from which Roberts' sequence R₂ is made.
    const RATIO: f64 = 1.324_717_957_244_746;
    (0..count).map(|i| [1.0, 2.0].map(|power| (0.5 + i as f64 * RATIO.powf(-power)).fract())).collect()
}

/// Returns the width of the margin, pixels. It covers the distance that a ray of the zone moves
/// sideways between the display plane and the layer farthest from this plane.
fn margin(display: &Display, geometry: &FieldGeometry) -> usize {
    let most = |slopes: &[f64]| slopes.iter().fold(0.0f64, |most, slope| most.max(slope.abs()));
    let slope = most(&geometry.grid.slope_x).max(most(&geometry.grid.slope_y));
    let of_layers = display.layers.iter().map(|layer| layer.d_mm.abs());
    let reach_mm = of_layers.fold(0.0f64, f64::max) * slope;
    // The margin is limited, since with distant layers and oblique rays it could be as wide as the
    // picture.
    ((reach_mm / geometry.pitch_mm).ceil() as usize + 1).min(MIDDLE)
}

fn part(
    display: &Display,
    geometry: &FieldGeometry,
    window: &Window,
    [rows, cols]: [usize; 2],
    centre_mm: [f64; 2],
    margin: usize,
) -> Part {
    // A section is a small display with the same layers. The resolutions of the light field and of
    // every layer are reduced in proportion to the section's size.
    let shares = [cols as f64 / geometry.cols as f64, rows as f64 / geometry.rows as f64];
    let cut =
        |resolution: [usize; 2]| [0, 1].map(|axis| ((resolution[axis] as f64 * shares[axis]).ceil() as usize).max(1));
    let mut small = display.without_panels();
    small.field.resolution = [cols, rows];
    for layer in &mut small.layers {
        layer.resolution = cut(layer.resolution);
    }
    if let Backlight::Lenslets(lenslets) = &mut small.backlight {
        lenslets.lenslets = cut(lenslets.lenslets);
    }
    // The window of the section is a piece of the window of the display.
    let map = window.scene_from_display;
    let translation = map.point(DVec3::new(centre_mm[0], centre_mm[1], 0.0));
    let size_mm = [cols, rows].map(|count| count as f64 * geometry.pitch_mm);
    let window = Window { scene_from_display: Similarity { translation, ..map }, size_mm, near_mm: window.near_mm };
    let mut part =
        Part { display: small, geometry: FieldGeometry { rows, cols, ..geometry.clone() }, window, centre_mm, margin };
    part.geometry.grid = part.moved(&geometry.grid);
    part
}

impl Part {
    /// Returns the number of rays.
    fn rays(&self) -> usize {
        self.geometry.rows * self.geometry.cols * self.geometry.grid.iter().count()
    }

    /// Returns the views with slopes relative to the section's centre. Perspective views keep their
    /// eye positions, and oblique views keep their slopes.
    fn moved(&self, grid: &ViewGrid) -> ViewGrid {
        let Projection::Perspective { distance_mm } = grid.projection else { return grid.clone() };
        let moved = |slopes: &[f64], axis: usize| {
            slopes.iter().map(|slope| slope - self.centre_mm[axis] / distance_mm).collect::<Vec<f64>>()
        };
        ViewGrid { projection: grid.projection, slope_x: moved(&grid.slope_x, 0), slope_y: moved(&grid.slope_y, 1) }
    }

    /// Returns the views of the section with the slopes at which they are traced.
    fn traced_grid(&self, grid: &ViewGrid, depth_scale: f64) -> ViewGrid {
        self.moved(&grid.scaled(depth_scale))
    }

    /// Returns the pixels that the margin surrounds. If the margin is too wide for a small section,
    /// it is reduced, so that some pixels are left.
    fn middle(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let FieldGeometry { rows, cols, .. } = self.geometry;
        let inside = |count: usize, margin: usize| {
            let margin = margin.min(count.saturating_sub(1) / 2);
            margin..count - margin
        };
        let [across, down] = [inside(cols, self.margin), inside(rows, self.margin)];
        down.flat_map(move |row| across.clone().map(move |col| (row, col)))
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn rays_of_parts_are_rays_of_the_picture() {
        let display = Display::uniform([300, 220], 1.5, [5, 5], [20.0, 20.0], &[-30.0, 0.0, 30.0], 2);
        let map =
            Similarity { rotation: DQuat::from_rotation_y(0.3), scale: 0.01, translation: DVec3::new(1.0, -2.0, 3.0) };
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 500.0 }] {
            let grid = ViewGrid::uniform(projection, [5, 3], [20.0, 10.0]).unwrap();
            let geometry = FieldGeometry { rows: 220, cols: 300, pitch_mm: 1.5, grid };
            let window = Window { scene_from_display: map, size_mm: geometry.size_mm(), near_mm: None };
            let parts = parts(&display, &geometry, &window);
            assert_eq!(parts.len(), PARTS);
            for part in &parts {
                assert!(part.middle().count() >= MIDDLE * MIDDLE);
                let (rows, cols) = (part.geometry.rows, part.geometry.cols);
                for (row, col) in [(0, 0), (rows - 1, cols - 1), (3, 7)] {
                    let own = [part.geometry.x_mm(col), part.geometry.y_mm(row)];
                    let whole = [0, 1].map(|axis| own[axis] + part.centre_mm[axis]);
                    // The position must be the centre of a pixel of the whole picture.
                    let place = (whole[0] / 1.5 + 149.5, 109.5 - whole[1] / 1.5);
                    assert!((place.0 - place.0.round()).abs() < 1e-9 && (-0.1..299.1).contains(&place.0), "{place:?}");
                    assert!((place.1 - place.1.round()).abs() < 1e-9 && (-0.1..219.1).contains(&place.1), "{place:?}");
                    let seen = part.window.scene_from_display.point(DVec3::new(own[0], own[1], 0.0));
                    assert!(seen.distance(map.point(DVec3::new(whole[0], whole[1], 0.0))) < 1e-12);
                    for view in geometry.grid.iter() {
                        let [a, b] = [part.geometry.grid.slope_at(view, own), geometry.grid.slope_at(view, whole)];
                        assert!((a[0] - b[0]).abs().max((a[1] - b[1]).abs()) < 1e-12, "{a:?} {b:?}");
                    }
                }
            }
        }
    }
}
