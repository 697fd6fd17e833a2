//! Node plugin `integral_imaging`: the lens array alone shows the light field, behind open layers
//! (Lippmann 1908). This is the baseline of displays with a directional backlight.
//!
//! All layers are in their brightest state. The emission of a lenslet into an angular bin is the
//! mean of the target over the rays from the lenslet into the bin:
//!
//! ```text
//! b[bin, lenslet] = mean of L(r) over the rays r of that lenslet and bin
//! ```
//!
//! This mean is the least-squares optimum. All frames are equal, since different frames would not
//! improve the result. No light is lost by multiplexing, so β is the product of the layers' largest
//! transmittances. Each lenslet is one pixel of the seen picture.

use lumistack_plugin::core::Tensor;
use lumistack_plugin::display::{BacklightTap, LayerStack, RayMap};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{NodeInput, NodePlugin, PluginError, Schema, expects, export_plugin};

/// The plugin `integral_imaging`.
pub struct IntegralImaging;

/// The plugin has no parameters.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct IntegralParams {}

impl NodePlugin for IntegralImaging {
    const DOC: &'static str = "Shows the light field by the lenslets of a directional backlight alone, behind layers that stay open (integral imaging). This is the baseline of displays \
        with a directional backlight.";
    type Params = IntegralParams;

    fn schema() -> Schema {
        Schema::new([])
    }

    fn make(_params: IntegralParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (host, display, field) = (input.host(), input.display(), input.field());
        let lenslets = expects::lenslets(display)?;
        expects::attenuating(display)?;
        let geometry = field.geometry();
        let map = RayMap::new(display, geometry);
        let (Some(backlight), Some(shape)) = (&map.backlight, LayerStack::emission_shape(display)) else {
            return Err(PluginError::display(display, "a directional backlight", "none"));
        };
        // Open all layers, so that β is the product of their peaks.
        let [dark, bright] = lenslets.range();
        let mut stack = LayerStack::filled(display, dark);
        for (values, layer) in stack.layers.iter_mut().zip(&display.layers) {
            values.data_mut().fill(layer.range()[1]);
        }
        stack.brightness = display.layers.iter().map(|layer| layer.peak).product();

        // Average the target over the rays of each lenslet and bin.
        let [frames, bins_y, bins_x, rows, cols, _] = shape;
        let count = Tensor::<5>::element_count([bins_y, bins_x, rows, cols, 3]).ok_or_else(|| {
            PluginError::Refused(format!(
                "one frame of the backlight has too many values: {bins_y} × {bins_x} angular bins × {rows} × {cols} lenslets × 3 channels; reduce the resolution or the number of angular bins"
            ))
        })?;
        let (mut sums, mut rays) = (vec![0.0f64; count], vec![0u32; count / 3]);
        let [views_y, views_x] = geometry.grid.views();
        let stage = host.stage("integral imaging", (views_y * views_x) as u64, "views");
        for [view_y, view_x] in geometry.grid.iter() {
            host.check_cancelled()?;
            let view = field.view([view_y, view_x])?;
            for (values, tap_y) in view.iter_rows().zip(backlight.y(view_y)) {
                let &BacklightTap::Lit { lenslet: row, bin: bin_y } = tap_y else { continue };
                for (col, tap_x) in backlight.x(view_x).iter().enumerate() {
                    let &BacklightTap::Lit { lenslet, bin: bin_x } = tap_x else { continue };
                    let at =
                        ((bin_y as usize * bins_x + bin_x as usize) * rows + row as usize) * cols + lenslet as usize;
                    rays[at] += 1;
                    let rgb = &values[3 * col..][..3];
                    sums[3 * at..][..3].iter_mut().zip(rgb).for_each(|(sum, value)| *sum += f64::from(*value));
                }
            }
            stage.advance(1, "");
        }
        // All frames show the same emission.
        if let Some(emission) = &mut stack.emission {
            for frame in 0..frames {
                for (values, (sum, &rays)) in emission
                    .block_mut([frame])
                    .chunks_exact_mut(3)
                    .zip(sums.chunks_exact(3).zip(&rays))
                    .filter(|(_, (_, rays))| **rays > 0)
                {
                    let means = sum.iter().map(|sum| ((sum / f64::from(rays)) as f32).clamp(dark, bright));
                    values.iter_mut().zip(means).for_each(|(value, mean)| *value = mean);
                }
            }
        }
        Ok(stack)
    }
}

export_plugin!("integral_imaging", IntegralImaging as node);
