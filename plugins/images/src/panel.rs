//! The picture for the panel behind the lens array, in the panel's own pixels.

use lumistack_plugin::display::{Backlight, Display, LensletBacklight};
use lumistack_plugin::lenslets::LensletPanel;
use lumistack_plugin::{Host, PluginError, StackInput};

use crate::ImagesParams;

/// Returns the backlight and its panel behind lenses. Parameters other than 0 replace the panel
/// size, pitches and focal length of the display file. The offset parameter is added to the file's
/// offset. The rotation parameter replaces the file's rotation, even if the parameter is 0.
///
/// # Errors
/// If the backlight has no lenslets.
pub(crate) fn lenslet_panel<'a>(
    display: &'a Display,
    params: &ImagesParams,
) -> Result<(&'a LensletBacklight, LensletPanel), PluginError> {
    let Backlight::Lenslets(backlight) = &display.backlight else {
        let text =
            "parameter `lenslet_panel`: expected a display with a backlight of lenslets, found a uniform backlight";
        return Err(PluginError::Refused(text.into()));
    };
    let rear = &display.layers[0];
    let resolution = backlight.panel_resolution.or(rear.panel_resolution).unwrap_or(rear.resolution);
    let pitch_mm = backlight.panel_pitch_mm.or(rear.panel_pitch_mm).unwrap_or(rear.pitch_mm);
    let given = |value: f64, otherwise: f64| if value > 0.0 { value } else { otherwise };
    let count = |value: usize, otherwise: usize| if value > 0 { value } else { otherwise };
    let nominal = LensletPanel::new(backlight, resolution, pitch_mm);
    let panel = LensletPanel {
        resolution: [count(params.panel_columns, resolution[0]), count(params.panel_rows, resolution[1])],
        pitch_mm: given(params.panel_pitch_mm, pitch_mm),
        lens_pitch_mm: given(params.lens_pitch_mm, nominal.lens_pitch_mm),
        focal_mm: given(params.lens_focal_mm, nominal.focal_mm),
        rotation_deg: params.lens_rotation_deg,
        offset_mm: [nominal.offset_mm[0] + params.lens_offset_x_mm, nominal.offset_mm[1] + params.lens_offset_y_mm],
        ..nominal
    };
    Ok((backlight, panel))
}

/// Computes the panel's picture in one frame, `[row][col][rgb]`.
pub(crate) fn picture(
    host: &Host,
    panel: &LensletPanel,
    stack: &StackInput<'_>,
    frame: usize,
    samples: usize,
) -> Result<Vec<f32>, PluginError> {
    let [bins_x, bins_y] = panel.bins;
    let mut planes = Vec::with_capacity(bins_x * bins_y);
    for (bin_y, bin_x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
        host.check_cancelled()?;
        planes.push(stack.emission(frame, bin_y, bin_x)?.to_vec());
    }
    Ok(panel.picture(&planes, samples))
}
