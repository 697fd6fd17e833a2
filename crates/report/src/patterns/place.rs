//! Selects the position of the close-ups: where masks have the finest changes between frames or, if
//! there is one frame, the finest detail.
//!
//! The energy of a mask pixel is a sum over frames and channels. Its terms are the squared
//! differences between the pixel and its right and lower neighbours. If there are several frames,
//! each frame's deviation from the mean over frames replaces the mask.
//!
//! The selected point of z = 0 maximizes a sum over the layers. A layer contributes the energy
//! within its close-up, divided by the energy of the whole layer.

use lumistack_core::Tensor;
use lumistack_display::{Display, Layer};

/// Size of the largest close-up: [columns, rows].
pub(super) const CLOSEUP: [usize; 2] = [72, 45];

/// A rectangle of pixels of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) row: usize,
    pub(crate) col: usize,
    pub(crate) rows: usize,
    pub(crate) cols: usize,
}

/// Summed-area table of a layer's energy.
struct Totals {
    rows: usize,
    cols: usize,
    sums: Vec<f64>,
}

/// Returns the windows on all layers around one point of z = 0. `None` if no layer is larger than a
/// close-up.
pub(super) fn on_layers(display: &Display, layers: &[Tensor<4>]) -> Option<Vec<Window>> {
    let larger = |layer: &Layer| layer.resolution[0] > CLOSEUP[0] || layer.resolution[1] > CLOSEUP[1];
    if !display.layers.iter().any(larger) {
        return None;
    }
    let energies: Vec<Totals> = layers.iter().map(Totals::of).collect();
    let windows = |x_mm: f64, y_mm: f64| -> Vec<Window> {
        display.layers.iter().map(|layer| Window::around(layer, x_mm, y_mm)).collect()
    };
    let field = display.field_pixels();
    let step = (field.cols.min(field.rows) / 60).max(1);
    let places = (0..field.rows).step_by(step).flat_map(|row| (0..field.cols).step_by(step).map(move |col| (row, col)));
    let found = places.map(|(row, col)| windows(field.x_mm(col), field.y_mm(row)));
    let gain = |windows: &[Window]| {
        let shares = energies.iter().zip(windows).map(|(energy, window)| energy.share(*window));
        shares.sum::<f64>()
    };
    // If several positions are equally good, take the first, so that the result is deterministic.
    found
        .map(|windows| (gain(&windows), windows))
        .reduce(|best, next| if next.0 > best.0 { next } else { best })
        .map(|(_, windows)| windows)
}

/// Returns the window of a backlight's panel. `None` if the panel is no larger than a close-up.
pub(super) fn on_panel(panel: &Tensor<4>) -> Option<Window> {
    let [_, rows, cols, _] = panel.shape();
    if cols <= CLOSEUP[0] && rows <= CLOSEUP[1] {
        return None;
    }
    let energy = Totals::of(panel);
    let (height, width) = (CLOSEUP[1].min(rows), CLOSEUP[0].min(cols));
    let corners =
        (0..=rows - height).step_by(8).flat_map(|row| (0..=cols - width).step_by(8).map(move |col| (row, col)));
    let windows = corners.map(|(row, col)| Window { row, col, rows: height, cols: width });
    windows.reduce(|best, next| if energy.share(next) > energy.share(best) { next } else { best })
}

impl Window {
    /// Returns a close-up of a layer around a point of z = 0. If necessary, it is shifted to be
    /// within the layer.
    fn around(layer: &Layer, x_mm: f64, y_mm: f64) -> Self {
        let [cols, rows] = layer.resolution;
        let start = |position_mm: f64, count: usize, size: usize| {
            let centre = position_mm / layer.pitch_mm + count as f64 / 2.0;
            ((centre - size as f64 / 2.0).round().max(0.0) as usize).min(count - size)
        };
        let (width, height) = (CLOSEUP[0].min(cols), CLOSEUP[1].min(rows));
        Self {
            row: start(layer.offset_mm[1] - y_mm, rows, height),
            col: start(x_mm - layer.offset_mm[0], cols, width),
            rows: height,
            cols: width,
        }
    }
}

impl Totals {
    fn of(patterns: &Tensor<4>) -> Self {
        let [frames, rows, cols, _] = patterns.shape();
        // If there are several frames, subtract their mean, since only changes between frames are
        // of interest.
        let line = cols * 3;
        let mut mean = vec![0.0f32; rows * line];
        if frames > 1 {
            for frame in 0..frames {
                mean.iter_mut().zip(patterns.block([frame])).for_each(|(mean, value)| *mean += value / frames as f32);
            }
        }
        // Compute the energy of the gradient of each pixel, over channels and frames.
        let mut energy = vec![0.0f64; rows * cols];
        for frame in 0..frames {
            let values = patterns.block([frame]);
            let added = |i: usize| values[i] - mean[i];
            for row in 0..rows {
                for i in 0..line {
                    let at = row * line + i;
                    let right = if i + 3 < line { added(at + 3) - added(at) } else { 0.0 };
                    let below = if row + 1 < rows { added(at + line) - added(at) } else { 0.0 };
                    energy[row * cols + i / 3] += f64::from(right * right + below * below);
                }
            }
        }
        // Make a summed-area table, from which four values give the energy of any rectangle.
        let width = cols + 1;
        let mut sums = vec![0.0; (rows + 1) * width];
        for row in 0..rows {
            let mut run = 0.0;
            for col in 0..cols {
                run += energy[row * cols + col];
                sums[(row + 1) * width + col + 1] = sums[row * width + col + 1] + run;
            }
        }
        Self { rows, cols, sums }
    }

    /// Returns the energy in a window divided by the total energy; 0 if the total is 0.
    fn share(&self, window: Window) -> f64 {
        let width = self.cols + 1;
        let sum = |row: usize, col: usize| self.sums[row * width + col];
        let (bottom, right) = (window.row + window.rows, window.col + window.cols);
        let inside =
            sum(bottom, right) - sum(window.row, right) - sum(bottom, window.col) + sum(window.row, window.col);
        let all = sum(self.rows, self.cols);
        if all > 0.0 { inside / all } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use lumistack_display::LayerStack;

    use super::*;

    #[test]
    fn the_close_up_shows_the_finest_flicker() {
        let text = "name = \"a\"\nframes = 2\n[field]\nresolution = [200, 120]\npitch_mm = 1.0\nviews = [3, 3]\nfov_deg = [20.0, 20.0]\n\
                    [[layers]]\nd_mm = 0.0\nresolution = [200, 120]\npitch_mm = 1.0\n[[layers]]\nd_mm = 5.0\nresolution = [100, 60]\npitch_mm = 2.0\noffset_mm = [10.0, 0.0]\n";
        let display = Display::from_toml(text).unwrap();
        let mut stack = LayerStack::filled(&display, 0.5);
        // The top left pattern is equal in all frames and must be ignored; the other pattern
        // changes between frames and must be found.
        for row in 0..40 {
            for col in 0..40 {
                for frame in 0..2 {
                    stack.layers[0].block_mut([frame, row, col]).fill(if (row + col) % 2 == 0 { 0.9 } else { 0.1 });
                }
                let flicker = if (row + col) % 2 == 0 { 0.6 } else { 0.4 };
                stack.layers[0].block_mut([0, 60 + row, 140 + col]).fill(flicker);
            }
        }
        let windows = on_layers(&display, &stack.layers).unwrap();
        let [first, second] = [windows[0], windows[1]];
        assert!(first.row <= 60 && first.row + first.rows >= 100, "{first:?}");
        assert!(first.col <= 140 && first.col + first.cols >= 180, "{first:?}");
        // The second layer has pixels twice as large, and is 10 mm farther to the right. Its window
        // has the same centre, unless the layer's border limits it.
        let centre_mm = first.col as f64 + 36.0 - 100.0;
        let expected = ((centre_mm - 10.0) / 2.0 + 50.0 - 36.0).round().clamp(0.0, 28.0) as usize;
        assert!(second.col.abs_diff(expected) <= 1 && second.rows == 45, "{second:?}");
        assert_eq!(
            on_panel(&stack.layers[0]),
            Some(Window { row: first.row / 8 * 8, ..on_panel(&stack.layers[0]).unwrap() })
        );
    }

    #[test]
    fn small_layers_need_no_close_up() {
        let text = "name = \"a\"\nframes = 1\n[field]\nresolution = [70, 40]\npitch_mm = 1.0\nviews = [1, 1]\nfov_deg = [0.0, 0.0]\n[[layers]]\nd_mm = 0.0\nresolution = [70, 40]\npitch_mm = 1.0\n";
        let display = Display::from_toml(text).unwrap();
        let stack = LayerStack::filled(&display, 0.5);
        assert_eq!(on_layers(&display, &stack.layers), None);
        assert_eq!(on_panel(&stack.layers[0]), None);
    }
}
