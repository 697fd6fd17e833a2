//! Additional channels of the views, in pictures next to the views' pictures.
//!
//! ```text
//! layers_YY_XX.exr   depth.Z  normal.X normal.Y normal.Z  albedo.R albedo.G albedo.B
//!                    variance.R variance.G variance.B  coverage.A
//! ```

use std::path::Path;

use lumistack_core::Task;
use lumistack_field_io::picture::write_exr_channels;
use serde_json::{Map, Value, json};

use crate::error::{PipelineError, field_error};
use crate::stage::fields::Shot;
use crate::stage::trace::Traced;
use crate::view_options::{ExtraChannel, ViewOptions};

/// Writes the additional channels of every rendered view. Returns their description for the index.
///
/// # Errors
/// If the scene cannot be rendered, a file cannot be written, or the task is cancelled.
pub(crate) fn write_channels(
    folder: &Path,
    shot: Shot<'_>,
    options: &ViewOptions,
    rendered: &Traced,
    task: Task<'_>,
) -> Result<Option<Value>, PipelineError> {
    if options.channels.is_empty() {
        return Ok(None);
    }
    let has = |layer| options.channels.contains(&layer);
    let Shot { ingested, placement, .. } = shot;
    let target = &rendered.fields[0];
    let (window, traced, kind) = (shot.window(), &target.traced, shot.denoise());
    let projection = target.geometry.grid.projection;
    lumistack_field_io::atomic::create_folder(folder).map_err(field_error)?;
    let renderer = ingested.renderer(task)?;
    task.progress.begin("layers", rendered.views.len() as u64, "views");
    // Collect the requested channels of one view, each `[row][col]`.
    let of_view = |view: [usize; 2]| -> Result<(), PipelineError> {
        let mut channels: Vec<(&str, Vec<f32>)> = Vec::new();
        let [rows, cols] = [traced.rows, traced.cols];
        let pixels = || (0..rows).flat_map(move |row| (0..cols).map(move |col| (row, col)));
        let guides = [ExtraChannel::Depth, ExtraChannel::Normal, ExtraChannel::Albedo].into_iter().any(has);
        let guides = guides.then(|| target.guides(view, shot, task)).transpose()?;
        if has(ExtraChannel::Depth) {
            let shown = |z: f32| projection.scaled_depth(f64::from(z), placement.depth_scale) as f32;
            let depth: Vec<f32> = match &guides {
                Some(guides) if ingested.scene.placed_clouds.is_empty() => {
                    pixels().map(|(row, col)| guides.at(row, col).central_z_mm.map_or(f32::NAN, shown)).collect()
                }
                // Guides contain only surfaces. With splats, the renderer traces the depth.
                _ => renderer.depth(window, traced, view, task)?.data().iter().map(|z| shown(*z)).collect(),
            };
            channels.push((ExtraChannel::Depth.channels()[0], depth));
        }
        for axis in 0..3 {
            let Some(guides) = &guides else { break };
            if has(ExtraChannel::Normal) {
                let values = pixels().map(|(row, col)| guides.at(row, col).normal[axis]).collect();
                channels.push((ExtraChannel::Normal.channels()[axis], values));
            }
            if has(ExtraChannel::Albedo) {
                let values = pixels().map(|(row, col)| guides.at(row, col).albedo[axis]).collect();
                channels.push((ExtraChannel::Albedo.channels()[axis], values));
            }
        }
        // Read the variance from the cache of the views. Coverage is traced if it is not cached.
        if has(ExtraChannel::Variance) {
            let variance = target.variance(view, kind)?;
            for (axis, name) in ExtraChannel::Variance.channels().iter().enumerate() {
                channels.push((name, variance.iter().skip(axis).step_by(3).copied().collect()));
            }
        }
        if has(ExtraChannel::Coverage) {
            let missed = target.missed(view, shot, task)?;
            channels.push((ExtraChannel::Coverage.channels()[0], missed.iter().map(|missed| 1.0 - missed).collect()));
        }
        // The file has the name of the view's picture, but another prefix.
        let views = target.geometry.grid.views();
        let name = lumistack_field_io::view_file_name(views, view).replacen("view_", "layers_", 1);
        let channels: Vec<(&str, &[f32])> = channels.iter().map(|(name, values)| (*name, values.as_slice())).collect();
        write_exr_channels(&folder.join(name), [traced.cols, traced.rows], &channels).map_err(field_error)?;
        task.progress.advance(1, "");
        Ok(())
    };
    let result = rendered.views.iter().try_for_each(|&view| of_view(view));
    task.progress.end();
    result?;
    // Describe the channels with units and meaning, so that a reader of the files needs no other
    // document.
    let mut about = Map::new();
    about.insert("files".into(), "layers_YY_XX.exr, next to view_YY_XX.exr".into());
    about.insert("scene_units_per_mm".into(), placement.window.scene_from_display.scale.into());
    for (name, layer) in ExtraChannel::ALL.iter().filter(|(_, layer)| has(*layer)) {
        let [unit, meaning] = layer.about();
        about.insert((*name).into(), json!({ "channels": layer.channels(), "unit": unit, "meaning": meaning }));
    }
    Ok(Some(about.into()))
}
