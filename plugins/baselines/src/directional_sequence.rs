//! Node plugin `directional_sequence`: a time-sequential directional backlight (Travis 1990). It is
//! the simplest method for a layer in front of a directional backlight.
//!
//! In every frame the backlight emits into a subset of its directions, and the layer shows the
//! target as seen from these directions. With A directions and M frames, the schedule and the
//! brightness are
//!
//! ```text
//! direction k is lit in frame ⌊k·M/A⌋        β = 1/M · Π peak of the layers
//! ```
//!
//! The product Π is over all layers, and the peak of a layer is its largest transmittance. If every
//! direction has its own frame (M = A), all views are exact. This requires one view per direction,
//! and a layer pixel for each pixel of a view. With fewer frames the display is brighter, but
//! neighbouring directions share a frame, in which the layer shows the mean of their views.

use lumistack_plugin::core::Tensor;
use lumistack_plugin::display::{BacklightTap, LayerStack, RayMap};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{NodeInput, NodePlugin, PluginError, Schema, expects, export_plugin};

/// The plugin `directional_sequence`.
pub struct DirectionalSequence;

/// The plugin has no parameters.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct SequenceParams {}

impl NodePlugin for DirectionalSequence {
    const DOC: &'static str = "Lights the directions of a directional backlight one after another: each frame lights some directions only, and the layer shows the view from these directions. \
        This is the simplest method for displays with a directional backlight.";
    type Params = SequenceParams;

    fn schema() -> Schema {
        Schema::new([])
    }

    fn make(_params: SequenceParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (host, display, field) = (input.host(), input.display(), input.field());
        let lenslets = expects::lenslets(display)?;
        expects::attenuating(display)?;
        let [bins_x, bins_y] = lenslets.views;
        let (frames, directions) = (display.frames, bins_x * bins_y);
        if frames > directions {
            let expected = format!("at most {directions} frames, one per direction of the backlight");
            return Err(PluginError::display(display, expected, frames));
        }
        if frames < directions {
            host.warn(&format!(
                "expected {directions} frames, one per direction, found {frames}, so that several directions show the same picture; set display.frames to {directions}"
            ));
        }
        // Light each direction in its frame, and open all layers to their brightest state.
        let frame_of = |bin_y: usize, bin_x: usize| (bin_y * bins_x + bin_x) * frames / directions;
        let geometry = field.geometry();
        let map = RayMap::new(display, geometry);
        let Some(backlight) = &map.backlight else {
            return Err(PluginError::display(display, "a directional backlight", "none"));
        };
        // The layer nearest to the display plane shows the views. The other layers stay open.
        let nearest = (0..display.layers.len())
            .min_by(|&a, &b| display.layers[a].d_mm.abs().total_cmp(&display.layers[b].d_mm.abs()));
        let shown = nearest.unwrap_or(0);
        let [dark, bright] = display.layers[shown].range();
        let [off, on] = lenslets.range();
        let mut stack = LayerStack::filled(display, off);
        for (values, layer) in stack.layers.iter_mut().zip(&display.layers) {
            values.data_mut().fill(layer.range()[1]);
        }
        stack.brightness = display.layers.iter().map(|layer| layer.peak).product::<f64>() / frames as f64;
        if let Some(emission) = &mut stack.emission {
            for (bin_y, bin_x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
                emission.block_mut([frame_of(bin_y, bin_x), bin_y, bin_x]).fill(on);
            }
        }

        // In every frame, a pixel of the layer `shown` gets the mean of the target over all lit
        // rays through the pixel.
        let layer = &map.layers[shown];
        let shape = [frames, layer.rows, layer.cols, 3];
        let count = Tensor::<4>::element_count(shape).ok_or_else(|| {
            PluginError::Refused(format!(
                "the layer has too many values: {frames} frames × {} × {} pixels × 3 channels; reduce the resolution",
                layer.rows, layer.cols
            ))
        })?;
        let (mut sums, mut rays) = (vec![0.0f64; count], vec![0u32; count / 3]);
        let [views_y, views_x] = geometry.grid.views();
        let stage = host.stage("directional sequence", (views_y * views_x) as u64, "views");
        for [view_y, view_x] in geometry.grid.iter() {
            host.check_cancelled()?;
            let view = field.view([view_y, view_x])?;
            let (taps_y, taps_x) = (layer.y.of_view(view_y), layer.x.of_view(view_x));
            for ((values, tap_y), lit_y) in view.iter_rows().zip(taps_y).zip(backlight.y(view_y)) {
                let (&BacklightTap::Lit { bin: bin_y, .. }, false) = (lit_y, tap_y.is_missed()) else { continue };
                for (col, (tap_x, lit_x)) in taps_x.iter().zip(backlight.x(view_x)).enumerate() {
                    let (&BacklightTap::Lit { bin: bin_x, .. }, false) = (lit_x, tap_x.is_missed()) else { continue };
                    let [row, at] = [tap_y, tap_x].map(|tap| if tap.t < 0.5 { tap.first } else { tap.second } as usize);
                    let pixel = (frame_of(bin_y as usize, bin_x as usize) * layer.rows + row) * layer.cols + at;
                    rays[pixel] += 1;
                    let rgb = &values[3 * col..][..3];
                    sums[3 * pixel..][..3].iter_mut().zip(rgb).for_each(|(sum, value)| *sum += f64::from(*value));
                }
            }
            stage.advance(1, "");
        }
        let values = stack.layers[shown].data_mut();
        for (pixel, &rays) in rays.iter().enumerate().filter(|(_, rays)| **rays > 0) {
            for channel in 3 * pixel..3 * pixel + 3 {
                values[channel] = ((sums[channel] / f64::from(rays)) as f32 * bright).clamp(dark, bright);
            }
        }
        Ok(stack)
    }
}

export_plugin!("directional_sequence", DirectionalSequence as node);
