//! What views see besides their light, as layers of pictures beside them.
//!
//! ```text
//! layers_YY_XX.exr   depth.Z  normal.X normal.Y normal.Z  albedo.R albedo.G albedo.B  variance.R variance.G variance.B  coverage.A
//! ```

use std::path::Path;

use lumistack_core::Task;
use lumistack_field_io::picture::write_exr_channels;
use serde_json::{Map, Value, json};

use crate::error::{PipelineError, field_error};
use crate::stage::fields::Shot;
use crate::stage::trace::Traced;
use crate::view_options::{ViewLayer, ViewOptions};

/// Writes the layers of every view that was rendered beside it; returns the folder index's account of them.
///
/// # Errors
/// When the scene cannot be rendered, a file cannot be written, or when cancelled.
pub(crate) fn write_layers(
    folder: &Path,
    shot: Shot<'_>,
    options: &ViewOptions,
    rendered: &Traced,
    task: Task<'_>,
) -> Result<Option<Value>, PipelineError> {
    if options.layers.is_empty() {
        return Ok(None);
    }
    let has = |layer| options.layers.contains(&layer);
    let Shot { ingested, placement, .. } = shot;
    let target = &rendered.fields[0];
    let (window, traced, kind) = (shot.window(), &target.traced, shot.denoise());
    let projection = target.geometry.grid.projection;
    lumistack_field_io::atomic::create_folder(folder).map_err(field_error)?;
    let renderer = ingested.renderer(task)?;
    task.progress.begin("layers", rendered.views.len() as u64, "views");
    let of_view = |view: [usize; 2]| -> Result<(), PipelineError> {
        let mut channels: Vec<(&str, Vec<f32>)> = Vec::new();
        let [rows, cols] = [traced.rows, traced.cols];
        let pixels = || (0..rows).flat_map(move |row| (0..cols).map(move |col| (row, col)));
        let guides = [ViewLayer::Depth, ViewLayer::Normal, ViewLayer::Albedo].into_iter().any(has);
        let guides = guides.then(|| target.guides(view, shot, task)).transpose()?;
        if has(ViewLayer::Depth) {
            let shown = |z: f32| projection.scaled_depth(f64::from(z), placement.depth_scale) as f32;
            let depth: Vec<f32> = match &guides {
                Some(guides) if ingested.scene.placed_clouds.is_empty() => {
                    pixels().map(|(row, col)| guides.at(row, col).central_z_mm.map_or(f32::NAN, shown)).collect()
                }
                // splats have a depth of their own
                _ => renderer.depth(window, traced, view, task)?.data().iter().map(|z| shown(*z)).collect(),
            };
            channels.push((ViewLayer::Depth.channels()[0], depth));
        }
        for axis in 0..3 {
            let Some(guides) = &guides else { break };
            if has(ViewLayer::Normal) {
                let values = pixels().map(|(row, col)| guides.at(row, col).normal[axis]).collect();
                channels.push((ViewLayer::Normal.channels()[axis], values));
            }
            if has(ViewLayer::Albedo) {
                let values = pixels().map(|(row, col)| guides.at(row, col).albedo[axis]).collect();
                channels.push((ViewLayer::Albedo.channels()[axis], values));
            }
        }
        if has(ViewLayer::Variance) {
            let variance = target.variance(view, kind)?;
            for (axis, name) in ViewLayer::Variance.channels().iter().enumerate() {
                channels.push((name, variance.iter().skip(axis).step_by(3).copied().collect()));
            }
        }
        if has(ViewLayer::Coverage) {
            let missed = target.missed(view, shot, task)?;
            channels.push((ViewLayer::Coverage.channels()[0], missed.iter().map(|missed| 1.0 - missed).collect()));
        }
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
    let mut about = Map::new();
    about.insert("files".into(), "layers_YY_XX.exr, beside view_YY_XX.exr".into());
    about.insert("scene_units_per_mm".into(), placement.window.scene_from_display.scale.into());
    for (name, layer) in ViewLayer::ALL.iter().filter(|(_, layer)| has(*layer)) {
        let [unit, meaning] = layer.about();
        about.insert((*name).into(), json!({ "channels": layer.channels(), "unit": unit, "meaning": meaning }));
    }
    Ok(Some(about.into()))
}
