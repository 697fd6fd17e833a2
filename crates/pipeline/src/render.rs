//! Scene to light field: every view is path-traced and kept in the cache, then one exposure makes all of them display-referred.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, LightField, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::Window;

use crate::cache::KeyBuilder;
use crate::error::PipelineError;
use crate::ingest::Ingested;
use crate::job::{AngularFilter, Job};
use crate::light::automatic_exposure;

/// Changes whenever the path tracer gives other pixels.
const RENDER_VERSION: u32 = 1;

/// The rendered light fields of a run.
pub struct Rendered {
    /// What the display should show.
    pub target: LightField,
    /// In-between views that the solver does not see.
    pub held_out: Option<LightField>,
    /// Factor from scene-linear to display-referred radiance.
    pub exposure: f64,
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
    Some(ViewGrid {
        projection: grid.projection,
        slope_x: pick(&midpoints.slope_x),
        slope_y: pick(&midpoints.slope_y),
    })
}

/// Traces all views that the cache does not hold.
///
/// # Errors
/// When rendering fails or is cancelled, or a view cannot be stored.
pub fn render(
    job: &Job,
    ingested: &Ingested,
    window: &Window,
    geometry: &FieldGeometry,
    cache_dir: &Path,
    task: Task<'_>,
) -> Result<Rendered, PipelineError> {
    let settings = Settings {
        samples: job.render.samples,
        max_bounces: job.render.max_bounces,
        seed: job.seed,
        angular_filter: match job.render.angular_filter {
            AngularFilter::Point => lumistack_pathtracer::AngularFilter::Point,
            AngularFilter::Bin => lumistack_pathtracer::AngularFilter::Bin,
        },
        ..Settings::default()
    };
    let held_out_geometry =
        held_out_grid(&geometry.grid, job.render.held_out).map(|grid| geometry.with_grid(grid));
    let mut key = KeyBuilder::new("render", RENDER_VERSION);
    for (path, content) in &ingested.files {
        key.add("file", path.file_name().unwrap_or_default().as_encoded_bytes()).add("content", content.as_bytes());
    }
    key.add_json("light", &job.light).add_json("render", &(&job.render.max_bounces, job.render.samples, job.seed));
    key.add("settings", format!("{settings:?}").as_bytes()).add("window", format!("{window:?}").as_bytes());
    let mut todo = Vec::new();
    let mut fields = Vec::new();
    for (name, geometry) in
        std::iter::once(("target", geometry)).chain(held_out_geometry.iter().map(|geometry| ("held-out", geometry)))
    {
        let key = key.clone().add("geometry", format!("{geometry:?}").as_bytes()).finish();
        let folder = cache_dir.join(format!("{name}-{}", &key[..16]));
        std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
        for view in geometry.grid.iter() {
            let path = view_path(&folder, view);
            if read_view(&path, geometry).is_none() {
                todo.push((fields.len(), view, path));
            }
        }
        fields.push((geometry.clone(), folder));
    }
    let cached = todo.is_empty();
    if !cached {
        trace(&todo, &fields, ingested, window, &settings, task)?;
    }
    let mut radiance = Vec::new();
    for (geometry, folder) in &fields {
        let mut field = LightField::black(geometry.clone())?;
        for view in geometry.grid.iter() {
            let path = view_path(folder, view);
            let picture = read_view(&path, geometry).ok_or_else(|| {
                PipelineError::value(&path, "cached view", "the picture just written", "another or none")
            })?;
            field.view_mut(view).copy_from_slice(picture.data());
        }
        radiance.push(field);
    }
    let stops = 2f64.powf(job.light.exposure_ev);
    let exposure = stops * if job.light.automatic_exposure { exposure_of(&radiance[0]) } else { 1.0 };
    let mut exposed = radiance.into_iter().map(|mut field| {
        for value in field.radiance_mut().data_mut() {
            *value = (f64::from(*value) * exposure).clamp(0.0, 1.0) as f32;
        }
        lumistack_field_io::round_to_half(&mut field);
        field
    });
    let target = exposed.next().ok_or_else(|| PipelineError::value("job", "views", "at least one", "none"))?;
    Ok(Rendered { target, held_out: exposed.next(), exposure, cached })
}

fn trace(
    todo: &[(usize, [usize; 2], PathBuf)],
    fields: &[(FieldGeometry, PathBuf)],
    ingested: &Ingested,
    window: &Window,
    settings: &Settings,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let renderer = Renderer::new(&ingested.scene, task).map_err(render_error)?;
    task.progress.begin("render", todo.len() as u64, "views");
    let result = todo.iter().try_for_each(|(field, view, path)| {
        let settings = Settings { seed: lumistack_core::seed::derive(settings.seed, &[*field as u64]), ..settings.clone() };
        let quiet = Task { progress: &lumistack_core::NoProgress, ..task };
        let picture =
            renderer.render_view(window, &fields[*field].0, *view, &settings, quiet).map_err(render_error)?;
        lumistack_field_io::exr::write_rgb_f32(path, &picture).map_err(PipelineError::Field)?;
        task.progress.advance(1, "views");
        Ok(())
    });
    task.progress.end();
    result
}

fn render_error(error: lumistack_pathtracer::RenderError) -> PipelineError {
    match error {
        lumistack_pathtracer::RenderError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Render(other),
    }
}

fn view_path(folder: &Path, view: [usize; 2]) -> PathBuf {
    folder.join(format!("view_{:02}_{:02}.exr", view[0], view[1]))
}

fn read_view(path: &Path, geometry: &FieldGeometry) -> Option<Tensor<3>> {
    let picture = lumistack_field_io::exr::read_rgb(path).ok()?;
    (picture.shape() == [geometry.rows, geometry.cols, 3]).then_some(picture)
}

/// One exposure for all views, from the brightest channel of every pixel.
fn exposure_of(field: &LightField) -> f64 {
    let mut brightest: Vec<f32> =
        field.radiance().data().chunks_exact(3).map(|rgb| rgb[0].max(rgb[1]).max(rgb[2])).collect();
    automatic_exposure(&mut brightest)
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
