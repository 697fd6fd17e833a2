//! Writes NumPy archives of linear `float32` values. One mask or view at a time is in memory.

use std::io::{self, BufWriter};

use lumistack_plugin::display::Display;
use lumistack_plugin::field_io::npz::NpzWriter;
use lumistack_plugin::{Host, PlaneView, PluginError, StackInput};

use crate::views::ViewSource;

/// Writes the arrays `layer_L` `[frame][row][col][rgb]` (layer 0 is the rearmost), `d_mm` `[layer]`
/// and `brightness`. A directional backlight adds `emission`
/// `[frame][bin_y][bin_x][lenslet_row][lenslet_col][rgb]`.
pub(crate) fn write_stack(
    host: &Host,
    path: &str,
    display: &Display,
    stack: &StackInput<'_>,
) -> Result<(), PluginError> {
    write(host, path, |archive| {
        let frames = stack.frames();
        for layer in 0..stack.layer_count() {
            let [rows, cols] = stack.layer_size(layer).unwrap_or_default();
            archive.array(&format!("layer_{layer}"), &[frames, rows, cols, 3])?;
            for frame in 0..frames {
                plane(archive, host, &stack.layer(layer, frame)?)?;
            }
        }
        let d_mm: Vec<f32> = display.layers.iter().map(|layer| layer.d_mm as f32).collect();
        small(archive, "d_mm", &d_mm)?;
        if let Some([bins_y, bins_x, rows, cols]) = stack.emission_shape() {
            archive.array("emission", &[frames, bins_y, bins_x, rows, cols, 3])?;
            for frame in 0..frames {
                for (y, x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
                    plane(archive, host, &stack.emission(frame, y, x)?)?;
                }
            }
        }
        small(archive, "brightness", &[stack.brightness() as f32])
    })
}

/// Writes the arrays `radiance` `[view_y][view_x][row][col][rgb]`, `slope_x` `[view_x]` and
/// `slope_y` `[view_y]`, where y points up.
pub(crate) fn write_views(host: &Host, path: &str, source: &ViewSource<'_>) -> Result<(), PluginError> {
    let geometry = source.geometry();
    let [views_y, views_x] = geometry.grid.views();
    write(host, path, |archive| {
        archive.array("radiance", &[views_y, views_x, geometry.rows, geometry.cols, 3])?;
        for view in geometry.grid.iter() {
            host.check_cancelled()?;
            archive.values(&source.view(view)?)?;
        }
        for (name, slopes) in [("slope_x", &geometry.grid.slope_x), ("slope_y", &geometry.grid.slope_y)] {
            small(archive, name, &slopes.iter().map(|slope| *slope as f32).collect::<Vec<_>>())?;
        }
        Ok(())
    })
}

type Archive<'a> = NpzWriter<&'a mut BufWriter<lumistack_plugin::OutputFile>>;

/// An error while an archive is written: from the plugin or the host, or from the archive's writer.
enum Failure {
    Plugin(PluginError),
    Io(io::Error),
}

impl From<PluginError> for Failure {
    fn from(error: PluginError) -> Self {
        Self::Plugin(error)
    }
}

impl From<lumistack_plugin::core::Cancelled> for Failure {
    fn from(_: lumistack_plugin::core::Cancelled) -> Self {
        Self::Plugin(PluginError::Cancelled)
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

fn write(
    host: &Host,
    path: &str,
    fill: impl FnOnce(&mut Archive<'_>) -> Result<(), Failure>,
) -> Result<(), PluginError> {
    let to_error = |failure: Failure| match failure {
        Failure::Plugin(error) => error,
        Failure::Io(error) => PluginError::from_io(path, error),
    };
    let mut writer = BufWriter::new(host.create(path)?);
    let mut archive = NpzWriter::new(&mut writer);
    fill(&mut archive).map_err(to_error)?;
    archive.finish().map_err(|error| to_error(error.into()))?;
    writer.into_inner().map_err(|error| to_error(error.into_error().into()))?.commit()
}

fn plane(archive: &mut Archive<'_>, host: &Host, plane: &PlaneView<'_>) -> Result<(), Failure> {
    host.check_cancelled()?;
    Ok(archive.values(&plane.values())?)
}

fn small(archive: &mut Archive<'_>, name: &str, values: &[f32]) -> Result<(), Failure> {
    archive.array(name, &[values.len()])?;
    Ok(archive.values(values)?)
}
