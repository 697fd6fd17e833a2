//! Scene to light field: every view is path-traced and kept in the cache, then one exposure makes all of them display-referred.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, LightField, ViewGrid};
use lumistack_field_io::picture::{self, Picture, Precision};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::Window;

use crate::cache::KeyBuilder;
use crate::depth::Depths;
use crate::error::PipelineError;
use crate::fit::Placement;
use crate::ingest::Ingested;
use crate::job::{AngularFilter, Job};
use crate::look::Look;
use crate::run::field_error;

/// Rays that decide about exposure and tone curve, at most.
const MOST_RAYS: usize = 4_000_000;
/// Changes whenever the path tracer gives other pixels.
const RENDER_VERSION: u32 = 3;

/// The rendered light fields of a run.
pub struct Rendered {
    /// What the display should show.
    pub target: LightField,
    /// In-between views that the solver does not see.
    pub held_out: Option<LightField>,
    /// Views beyond the outermost ones, which it does not see either.
    pub outside: Option<LightField>,
    /// How scene-linear radiance became display-referred.
    pub(crate) look: Look,
    /// What the target's views see how deep, as traced.
    pub(crate) depths: Depths,
    /// Share of the window where the middle view sees a surface, 0..1.
    pub coverage: f64,
    /// Whether no view had to be traced.
    pub cached: bool,
}

/// Evenly spread in-between views: at most `per_axis` of the midpoints on each axis.
pub fn held_out_grid(grid: &ViewGrid, per_axis: usize) -> Option<ViewGrid> {
    if per_axis == 0 || grid.views() == [1, 1] {
        return None;
    }
    let midpoints = grid.in_between();
    let pick = |slopes: &[f64]| {
        let count = per_axis.min(slopes.len());
        (0..count).map(|i| slopes[(2 * i + 1) * slopes.len() / (2 * count)]).collect()
    };
    Some(ViewGrid { projection: grid.projection, slope_x: pick(&midpoints.slope_x), slope_y: pick(&midpoints.slope_y) })
}

/// Traces all views that the cache does not hold. With a depth scale they are traced at slopes that much smaller than those of `geometry`.
///
/// # Errors
/// When rendering fails or is cancelled, or a view cannot be stored.
pub(crate) fn render(
    job: &Job,
    ingested: &Ingested,
    placement: &Placement,
    geometry: &FieldGeometry,
    cache_dir: &Path,
    task: Task<'_>,
) -> Result<Rendered, PipelineError> {
    let window = &placement.window;
    let traced = |geometry: &FieldGeometry| geometry.with_grid(geometry.grid.scaled(placement.depth_scale));
    let settings = Settings {
        samples: job.render.samples,
        max_bounces: job.render.max_bounces,
        seed: job.seed,
        clamp: job.render.clamp,
        angular_filter: match job.render.angular_filter {
            _ if job.render.lens_deg > 0.0 => {
                let diameter = 2.0 * (0.5 * job.render.lens_deg.to_radians()).tan();
                lumistack_pathtracer::AngularFilter::Lens(placement.depth_scale * diameter)
            }
            AngularFilter::Point => lumistack_pathtracer::AngularFilter::Point,
            AngularFilter::Bin => lumistack_pathtracer::AngularFilter::Bin,
        },
        ..Settings::default()
    };
    // views for the report only average over directions as the target's do, however far apart they stand
    let settings_of_others = Settings {
        angular_filter: match settings.angular_filter {
            lumistack_pathtracer::AngularFilter::Bin => {
                lumistack_pathtracer::AngularFilter::Width(traced(geometry).grid.bin_width())
            }
            other => other,
        },
        ..settings
    };
    let others = [
        ("held-out", 1, held_out_grid(&geometry.grid, job.render.held_out)),
        ("outside", 2, geometry.grid.outside(job.render.outside)),
    ];
    let others = others.map(|(name, stream, grid)| {
        let geometry = geometry.with_grid(grid?);
        let (traced, folder) = (traced(&geometry), PathBuf::new());
        Some(FieldJob { name, stream, geometry, traced, settings: settings_of_others, folder })
    });
    let folder = PathBuf::new();
    let target =
        FieldJob { name: "target", stream: 0, geometry: geometry.clone(), traced: traced(geometry), settings, folder };
    let mut fields: Vec<FieldJob> = std::iter::once(Some(target)).chain(others).flatten().collect();
    let mut key = KeyBuilder::new("render", RENDER_VERSION);
    ingested.add_to(&mut key);
    // what a view is before it is exposed
    key.add_json("light", &(job.light.environment_strength, job.light.automatic))
        .add_json("render", &(&job.render.max_bounces, job.render.samples, job.seed));
    key.add("settings", format!("{settings:?}").as_bytes()).add("window", format!("{window:?}").as_bytes());
    let mut todo = Vec::new();
    for (i, field) in fields.iter_mut().enumerate() {
        let mut key = key.clone();
        key.add("geometry", format!("{:?}", field.traced).as_bytes());
        if field.settings != settings {
            key.add("filter", format!("{:?}", field.settings.angular_filter).as_bytes());
        }
        field.folder = cache_dir.join(format!("{}-{}", field.name, &key.finish()[..16]));
        std::fs::create_dir_all(&field.folder).map_err(PipelineError::write(&field.folder))?;
        for view in field.geometry.grid.iter() {
            let path = view_path(&field.folder, view);
            if read_view(&path, &field.geometry).is_none() {
                todo.push((i, view, path));
            }
        }
    }
    let kept = Depths::read(&fields[0].folder, &fields[0].traced);
    let cached = todo.is_empty() && kept.is_some();
    let depths = match kept {
        Some(depths) => depths,
        None => Depths::trace(ingested.renderer(task)?, window, &fields[0].traced, &fields[0].folder, task)?,
    };
    if !todo.is_empty() {
        trace(ingested.renderer(task)?, &todo, &fields, window, task)?;
    }
    let coverage = depths.coverage(geometry.grid.views().map(|count| count / 2));
    let mut radiance = Vec::new();
    for FieldJob { geometry, folder, .. } in &fields {
        let mut field = LightField::black(geometry.clone())?;
        for view in geometry.grid.iter() {
            let path = view_path(folder, view);
            let picture = read_view(&path, geometry).ok_or_else(|| {
                PipelineError::value(&path, "cached view", "the picture just written", "another or none")
            })?;
            field.view_mut(view).copy_from_slice(&picture);
        }
        radiance.push(field);
    }
    let look = Look::choose(&job.light, &ingested.scene, &brightest(&radiance[0], &depths));
    let mut exposed = radiance.into_iter().map(|mut field| {
        look.apply(&mut field);
        lumistack_field_io::round_to_half(&mut field);
        field
    });
    let target = exposed.next().ok_or_else(|| PipelineError::value("job", "views", "at least one", "none"))?;
    let mut other = |name| if fields.iter().any(|field| field.name == name) { exposed.next() } else { None };
    Ok(Rendered { target, held_out: other("held-out"), outside: other("outside"), look, depths, coverage, cached })
}

/// One light field to render.
struct FieldJob {
    name: &'static str,
    /// Of random numbers.
    stream: u64,
    /// Of the display.
    geometry: FieldGeometry,
    /// The same in the scene: with the slopes at which it is traced.
    traced: FieldGeometry,
    settings: Settings,
    /// Where its finished views lie.
    folder: PathBuf,
}

fn trace(
    renderer: &Renderer,
    todo: &[(usize, [usize; 2], PathBuf)],
    fields: &[FieldJob],
    window: &Window,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let steps: u64 = todo.iter().map(|(field, ..)| Renderer::steps_per_view(&fields[*field].geometry)).sum();
    task.progress.begin("render", steps, "tiles");
    let result = todo.iter().enumerate().try_for_each(|(number, (field, view, path))| {
        let FieldJob { stream, traced, settings, .. } = &fields[*field];
        let settings = Settings { seed: lumistack_core::seed::derive(settings.seed, &[*stream]), ..*settings };
        let picture = renderer.render_view(window, traced, *view, &settings, task).map_err(render_error)?;
        let [rows, cols, _] = picture.shape();
        picture::write_exr(path, [cols, rows], picture.data(), Precision::Float).map_err(field_error)?;
        task.progress.advance(0, &format!("tiles, view {} of {}", number + 1, todo.len()));
        Ok(())
    });
    task.progress.end();
    result
}

pub(crate) fn render_error(error: lumistack_pathtracer::RenderError) -> PipelineError {
    match error {
        lumistack_pathtracer::RenderError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Render(other),
    }
}

fn view_path(folder: &Path, view: [usize; 2]) -> PathBuf {
    folder.join(format!("view_{:02}_{:02}.exr", view[0], view[1]))
}

fn read_view(path: &Path, geometry: &FieldGeometry) -> Option<Vec<f32>> {
    let picture = Picture::read(path).ok()?;
    (picture.size() == [geometry.cols, geometry.rows]).then(|| picture.into_linear())
}

/// The brightest channel of evenly spread rays of all views, and whether they meet a surface.
fn brightest(field: &LightField, depths: &Depths) -> Vec<(f32, bool)> {
    let geometry = field.geometry();
    let all = field.radiance().data().len() / 3;
    let every = all.div_ceil(MOST_RAYS).max(1);
    let size = geometry.rows * geometry.cols;
    let mut rays = Vec::with_capacity(all / every + 1);
    for (number, view) in geometry.grid.iter().enumerate() {
        // goes on in the next view where it left off
        let first = (every - number * size % every) % every;
        rays.extend(field.view(view).chunks_exact(3).enumerate().skip(first).step_by(every).map(|(i, rgb)| {
            let surface = depths.is_surface(view, i / geometry.cols, i % geometry.cols, geometry);
            (rgb[0].max(rgb[1]).max(rgb[2]), surface)
        }));
    }
    rays
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_display::Projection;

    #[test]
    fn held_out_views_lie_between_target_views() {
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 1], [20.0, 20.0]).unwrap();
        let held_out = held_out_grid(&grid, 2).unwrap();
        assert_eq!(held_out.views(), [1, 2]);
        for slope in &held_out.slope_x {
            assert!(grid.slope_x.iter().all(|target| (target - slope).abs() > 0.01));
        }
        assert!(held_out_grid(&grid, 0).is_none());
        let one = ViewGrid::single(Projection::Oblique, [0.0, 0.0]);
        assert!(held_out_grid(&one, 2).is_none());
    }
}
