//! Node plugin `parallax_barrier`: a time-multiplexed parallax barrier (Ives 1903). This is the
//! baseline of tensor displays with two layers. A barrier of slits has horizontal parallax, and a
//! barrier of pinholes also has vertical parallax.
//!
//! The front layer is a mask of slits (or pinholes), one pixel wide, with a period of P_x × P_y
//! mask pixels. The slits move from frame to frame. The rear layer shows the picture behind the
//! slits. In frame m of M, the mask is open at the pixels (col, row) with
//!
//! ```text
//! (col, row) ≡ (k mod P_x, k div P_x)  (mod P_x, P_y),   k = ⌊m·P/M⌋,  P = P_x·P_y
//! ```
//!
//! The value of a rear pixel is the mean of the target over all rays through the rear pixel and an
//! open mask pixel. This mean is the least-squares optimum for a mask of zeros and ones. Suppose
//! that the period is at least the number of views, and that the rays of neighbouring views through
//! a slit hit neighbouring rear pixels. Then the display shows every ray through an open mask pixel
//! exactly.
//! With M = P frames every mask pixel is open in exactly one frame, so the display emits β times
//! the target along every ray. The brightness β is the product of both layers' largest
//! transmittances, divided by P. With fewer frames some mask pixels are never open. The display
//! then emits β times the target only in the mean over a period.

use lumistack_plugin::core::Tensor;
use lumistack_plugin::display::{LayerMap, LayerStack, RayMap};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{NodeInput, NodePlugin, Param, PluginError, Schema, expects, export_plugin};

/// The plugin `parallax_barrier`.
pub struct ParallaxBarrier;

/// Parameters; see [`ParallaxBarrier::schema`](NodePlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct BarrierParams {
    period_x: usize,
    period_y: usize,
}

impl NodePlugin for ParallaxBarrier {
    const DOC: &'static str = "Shows a time-multiplexed parallax barrier on displays of two layers. The front layer shows slits that move from \
        frame to frame, and the rear layer shows the picture behind the slits. This is the baseline of tensor displays.";
    type Params = BarrierParams;

    fn schema() -> Schema {
        Schema::new([
            Param::int("period_x", 0, 0..=256, "Distance between neighbouring slits; 0 for the number of views per row.")
                .unit("mask pixels"),
            Param::int(
                "period_y",
                0,
                0..=256,
                "Distance between neighbouring pinholes along columns; 1 for slits from top to bottom, 0 for the number of views per column.",
            )
            .unit("mask pixels"),
        ])
    }

    fn make(params: BarrierParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (host, display, field) = (input.host(), input.display(), input.field());
        // The method needs one layer for the picture and one for the mask.
        expects::layers(display, 2)?;
        expects::attenuating(display)?;
        expects::uniform_backlight(display)?;
        let geometry = field.geometry();
        let [views_y, views_x] = geometry.grid.views();
        let or = |period: usize, views: usize| if period == 0 { views } else { period };
        let period = [or(params.period_y, views_y), or(params.period_x, views_x)];
        if period[1] < views_x || period[0] < views_y {
            host.warn(&format!(
                "period_x, period_y: expected at least {views_x} × {views_y} mask pixels, one per view, found {} × {}, so that several views share a pixel of the rear layer",
                period[1], period[0]
            ));
        }
        let positions = period[0] * period[1];
        if display.frames < positions {
            host.warn(&format!(
                "frames: expected {positions}, one for each position of the slits, found {}, so that the picture shows gaps between the slits. Set `frames = {positions}`, \
                 or reduce `views`, or period_x and period_y",
                display.frames
            ));
        }
        let map = RayMap::new(display, geometry);
        let [rear, front] = [&map.layers[0], &map.layers[1]];
        let [[rear_dark, rear_bright], [shut, open]] = [display.layers[0].range(), display.layers[1].range()];
        let mut stack = LayerStack::filled(display, rear_dark);
        stack.brightness = f64::from(open) * f64::from(rear_bright) / positions as f64;
        stack.layers[1].data_mut().fill(shut);

        let shape = [display.frames, rear.rows, rear.cols, 3];
        let count = Tensor::<4>::element_count(shape).ok_or_else(|| {
            PluginError::Refused(format!(
                "the rear layer has too many values: {} frames × {} × {} pixels × 3 channels; reduce the resolution",
                display.frames, rear.rows, rear.cols
            ))
        })?;
        // For each rear pixel, sum the target over the rays that also pass through an open mask
        // pixel, and count these rays.
        let (mut sums, mut rays) = (vec![0.0f32; count], vec![0u32; count / 3]);
        let stage = host.stage("parallax barrier", (views_y * views_x) as u64, "views");
        for [view_y, view_x] in geometry.grid.iter() {
            host.check_cancelled()?;
            let view = field.view([view_y, view_x])?;
            for (row, values) in view.iter_rows().enumerate() {
                let Some([rear_row, front_row]) = taps(rear, front, view_y, row, true) else { continue };
                for col in 0..geometry.cols {
                    let Some([rear_col, front_col]) = taps(rear, front, view_x, col, false) else { continue };
                    let rgb = &values[3 * col..][..3];
                    for frame in
                        (0..display.frames).filter(|&m| is_open([front_row, front_col], m, display.frames, period))
                    {
                        let pixel = (frame * rear.rows + rear_row) * rear.cols + rear_col;
                        rays[pixel] += 1;
                        sums[3 * pixel..][..3].iter_mut().zip(rgb).for_each(|(sum, value)| *sum += value);
                    }
                }
            }
            stage.advance(1, "");
        }
        // The rear layer shows the means. A rear pixel stays dark if no ray through it passes
        // through an open mask pixel.
        for (pixel, &rays) in rays.iter().enumerate().filter(|(_, rays)| **rays > 0) {
            for channel in 3 * pixel..3 * pixel + 3 {
                let mean = rear_bright * sums[channel] / rays as f32;
                stack.layers[0].data_mut()[channel] = mean.clamp(rear_dark, rear_bright);
            }
        }
        // The front layer opens the mask pixels of each frame.
        for frame in 0..display.frames {
            for (row, col) in (0..front.rows).flat_map(|row| (0..front.cols).map(move |col| (row, col))) {
                if is_open([row, col], frame, display.frames, period) {
                    (0..3).for_each(|channel| *stack.layers[1].at_mut([frame, row, col, channel]) = open);
                }
            }
        }
        Ok(stack)
    }
}

/// Returns true if the mask is open at the front pixel `pixel` = [row, col] in a frame. `period` is
/// [rows, columns].
fn is_open(pixel: [usize; 2], frame: usize, frames: usize, period: [usize; 2]) -> bool {
    let k = frame * period[0] * period[1] / frames;
    pixel[1] % period[1] == k % period[1] && pixel[0] % period[0] == k / period[1] % period[0]
}

/// Returns the rows (if `along_y`) or columns of the rear pixel and the front pixel that a ray
/// hits. `None` if the ray misses a layer.
fn taps(rear: &LayerMap, front: &LayerMap, view: usize, ray: usize, along_y: bool) -> Option<[usize; 2]> {
    let axis = |layer: &LayerMap| {
        let tap = if along_y { layer.y.of_view(view)[ray] } else { layer.x.of_view(view)[ray] };
        (!tap.is_missed()).then_some(if tap.t < 0.5 { tap.first } else { tap.second } as usize)
    };
    Some([axis(rear)?, axis(front)?])
}

export_plugin!("parallax_barrier", ParallaxBarrier as node);
