//! Caches the depths of the views, and compares the depths with a display's depth of field.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry};
use lumistack_report::DepthBudget;
use lumistack_scene::Window;
use lumistack_shot::{Depths, Placement, SceneRenderer};

use crate::error::{PipelineError, field_error};
use crate::store::files::{read_json, write_json};
use crate::store::key::content_hash;

/// File of the depths, in the folder of the views.
const FILE: &str = "depth.npy";
/// File with a hash of the content of [`FILE`].
const HASH: &str = "depth.json";

/// Reads cached depths of the views of a geometry; `None` if they are missing or damaged.
pub(crate) fn kept(folder: &Path, geometry: &FieldGeometry) -> Option<Depths> {
    let geometry = Depths::coarse(geometry);
    let [view_rows, view_cols] = geometry.grid.views();
    let hash: String = read_json(&folder.join(HASH))?;
    if content_hash(&folder.join(FILE)).ok()? != hash {
        return None;
    }
    let (shape, z_mm) = lumistack_field_io::npy::read(&folder.join(FILE)).ok()?;
    (shape == [view_rows, view_cols, geometry.rows, geometry.cols]).then_some(Depths { geometry, z_mm })
}

/// Traces depths and writes them into a folder.
///
/// # Errors
/// If cancelled, or the file cannot be written.
pub(crate) fn trace(
    renderer: &SceneRenderer,
    window: &Window,
    geometry: &FieldGeometry,
    folder: &Path,
    task: Task<'_>,
) -> Result<Depths, PipelineError> {
    let depths = Depths::trace(renderer, window, geometry, task)?;
    let [view_rows, view_cols] = depths.geometry.grid.views();
    let shape = [view_rows, view_cols, depths.geometry.rows, depths.geometry.cols];
    let path = folder.join(FILE);
    lumistack_field_io::npy::write(&path, &shape, &depths.z_mm).map_err(field_error)?;
    let hash = content_hash(&path).map_err(|source| PipelineError::Read { path, source })?;
    write_json(&folder.join(HASH), &hash)?;
    Ok(depths)
}

/// Compares the depths with the depth of field of a display. `shown` has the slopes at which the
/// display shows the views, and `placement` has the depth scale.
pub(crate) fn budget(depths: &Depths, display: &Display, shown: &FieldGeometry, placement: &Placement) -> DepthBudget {
    let projection = shown.grid.projection;
    let z_mm: Vec<f32> =
        depths.z_mm.iter().map(|z| projection.scaled_depth(f64::from(*z), placement.depth_scale) as f32).collect();
    let views = shown.grid.views();
    let size = depths.geometry.rows * depths.geometry.cols;
    let first = (views[0] / 2 * views[1] + views[1] / 2) * size;
    let mut budget = DepthBudget::measure(display, shown, &z_mm, &z_mm[first..first + size]);
    (budget.moved_back_mm, budget.depth_scale) = (placement.moved_back_mm, placement.depth_scale);
    budget.fitted = placement.fitted;
    budget
}
