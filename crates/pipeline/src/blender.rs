//! Views that the engine of a `.blend` file renders, instead of our path tracer.

use std::path::Path;

use glam::DVec3;
use lumistack_core::Task;
use lumistack_display::{FieldGeometry, Projection};
use lumistack_field_io::picture::{self, Picture, Precision};
use lumistack_scene::Window;
use lumistack_usd::{BlendViews, BlendWindow};

use crate::error::{PipelineError, field_error};
use crate::ingest::is_blend;
use crate::job::Job;

/// Renders views of the job's scene, each to its file as soon as it is finished.
///
/// # Errors
/// When the scene is no `.blend` file, Blender fails, a picture cannot be kept, or when cancelled.
pub(crate) fn render(
    job: &Job,
    window: &Window,
    geometry: &FieldGeometry,
    wanted: &[([usize; 2], &Path)],
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let Some(scene) = job.scene.as_deref().filter(|scene| is_blend(scene)) else {
        let found = job.scene.as_ref().map_or_else(|| "no scene".into(), |scene| scene.display().to_string());
        return Err(PipelineError::value("job", "render.engine", "a .blend file as the scene for `blender`", found));
    };
    let map = window.scene_from_display;
    let views = BlendViews {
        window: BlendWindow {
            centre: map.translation.to_array(),
            forward: (map.rotation * DVec3::NEG_Z).to_array(),
            up: (map.rotation * DVec3::Y).to_array(),
            width: map.scale * window.size_mm[0],
        },
        size_mm: window.size_mm,
        resolution: [geometry.cols, geometry.rows],
        distance_mm: match geometry.grid.projection {
            Projection::Oblique => None,
            Projection::Perspective { distance_mm } => Some(distance_mm),
        },
        slopes: wanted.iter().map(|(view, _)| geometry.grid.slope_at(*view, [0.0, 0.0])).collect(),
    };
    let mut failed = None;
    let mut finished = |number: usize, picture: &Path| {
        if let Err(error) = keep(picture, geometry, wanted[number].1) {
            failed.get_or_insert(error);
        }
        task.progress.advance(1, "views");
    };
    task.progress.begin("render in Blender", wanted.len() as u64, "views");
    let result = lumistack_usd::render_views(scene, job.pose.time_s, &views, &mut finished, task);
    task.progress.end();
    if let Some(error) = failed {
        return Err(error);
    }
    result.map_err(PipelineError::from)
}

fn keep(picture: &Path, geometry: &FieldGeometry, path: &Path) -> Result<(), PipelineError> {
    let size = [geometry.cols, geometry.rows];
    let read = Picture::read(picture).map_err(field_error)?;
    if read.size() != size {
        let [cols, rows] = size;
        let [found_cols, found_rows] = read.size();
        let expected = format!("{cols} × {rows} pixels from Blender");
        return Err(PipelineError::value(path, "view", expected, format!("{found_cols} × {found_rows}")));
    }
    picture::write_exr(path, size, &read.into_linear(), Precision::Float).map_err(field_error)
}
