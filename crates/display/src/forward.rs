//! The forward model: what a display emits.
//!
//! L̃ = (1/M) Σ_m b_m(ray) Π_n f_m^(n)(ξ_n) (eqs. 7 and 18), channels independent, b = 1 for a uniform backlight.

use lumistack_core::{Cancelled, Tensor};

use crate::{BacklightTap, Display, FieldGeometry, LayerStack, Missing, Projection, RayMap, Tap, ViewGrid};

/// One emitted view.
#[derive(Clone, Debug, PartialEq)]
pub struct EmittedView {
    /// Emitted radiance L̃, `[row][col][rgb]`; divide by the stack's brightness for what an adapted viewer sees. Rays that leave the
    /// display are 0.
    pub radiance: Tensor<3>,
    /// Whether the ray counts, `[row][col]` row-major: false where it misses the display under the display's [`Missing`] rule.
    pub valid: Vec<bool>,
}

/// The view from slope (s_x, s_y): a parallel projection, as from far away.
pub fn view_from_slope(display: &Display, stack: &LayerStack, slope: [f64; 2]) -> EmittedView {
    single(display, stack, ViewGrid::single(Projection::Oblique, slope))
}

/// The view from an eye at (x, y, z) millimetres in display space, z > 0.
pub fn view_from_eye(display: &Display, stack: &LayerStack, eye_mm: [f64; 3]) -> EmittedView {
    let [x, y, z] = eye_mm;
    single(display, stack, ViewGrid::single(Projection::Perspective { distance_mm: z }, [x / z, y / z]))
}

fn single(display: &Display, stack: &LayerStack, grid: ViewGrid) -> EmittedView {
    let geometry = FieldGeometry { grid, ..display.field_pixels() };
    simulate(display, &RayMap::new(display, &geometry), stack, &geometry, [0, 0])
}

/// Every view of a grid, in row order, handed to `sink` one at a time.
///
/// # Errors
/// What `sink` returns.
pub fn simulate_all(
    display: &Display,
    stack: &LayerStack,
    geometry: &FieldGeometry,
    mut sink: impl FnMut([usize; 2], EmittedView) -> Result<(), Cancelled>,
) -> Result<(), Cancelled> {
    let map = RayMap::new(display, geometry);
    geometry.grid.iter().try_for_each(|view| sink(view, simulate(display, &map, stack, geometry, view)))
}

/// The view `view` = [view_y, view_x] of a geometry whose tables are `map`. The stack must fit the display.
pub fn simulate(
    display: &Display,
    map: &RayMap,
    stack: &LayerStack,
    geometry: &FieldGeometry,
    view: [usize; 2],
) -> EmittedView {
    let (rows, cols, frames) = (geometry.rows, geometry.cols, stack.frames());
    let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
    let mut valid = vec![true; rows * cols];
    let mut product = vec![0.0f32; cols * 3];
    let mut sum = vec![0.0f64; cols * 3];
    for row in 0..rows {
        sum.fill(0.0);
        for frame in 0..frames {
            product.fill(1.0);
            for (layer, values) in map.layers.iter().zip(&stack.layers) {
                let tap_y = layer.y.of_view(view[0])[row];
                multiply_layer(&mut product, values, frame, tap_y, layer.x.of_view(view[1]), display.missing);
            }
            if let (Some(map), Some(emission)) = (&map.backlight, &stack.emission) {
                multiply_backlight(&mut product, emission, frame, map.y(view[0])[row], map.x(view[1]));
            }
            sum.iter_mut().zip(&product).for_each(|(sum, &product)| *sum += f64::from(product));
        }
        for (value, sum) in radiance.block_mut([row]).iter_mut().zip(&sum) {
            *value = (sum / frames as f64) as f32;
        }
        for col in 0..cols {
            valid[row * cols + col] = ray_is_valid(map, display.missing, view, row, col);
        }
    }
    EmittedView { radiance, valid }
}

/// Whether a ray counts: it meets the lenslet grid and, under [`Missing::Drop`], every layer.
#[inline]
pub fn ray_is_valid(map: &RayMap, missing: Missing, view: [usize; 2], row: usize, col: usize) -> bool {
    let layers = missing == Missing::Clear
        || map
            .layers
            .iter()
            .all(|layer| !layer.y.of_view(view[0])[row].is_missed() && !layer.x.of_view(view[1])[col].is_missed());
    let backlight = map.backlight.as_ref().is_none_or(|backlight| {
        backlight.y(view[0])[row] != BacklightTap::Missed && backlight.x(view[1])[col] != BacklightTap::Missed
    });
    layers && backlight
}

/// product[col][rgb] *= layer transmittance.
fn multiply_layer(product: &mut [f32], values: &Tensor<4>, frame: usize, tap_y: Tap, taps_x: &[Tap], missing: Missing) {
    let outside = match missing {
        Missing::Drop => 0.0,
        Missing::Clear => 1.0,
    };
    if tap_y.is_missed() {
        product.iter_mut().for_each(|value| *value *= outside);
        return;
    }
    let upper = values.block([frame, tap_y.first as usize]);
    let lower = values.block([frame, tap_y.second as usize]);
    for (pixel, tap) in product.chunks_exact_mut(3).zip(taps_x) {
        if tap.is_missed() {
            pixel.iter_mut().for_each(|value| *value *= outside);
            continue;
        }
        let (left, right) = (3 * tap.first as usize, 3 * tap.second as usize);
        for c in 0..3 {
            let top = upper[left + c] + tap.t * (upper[right + c] - upper[left + c]);
            let bottom = lower[left + c] + tap.t * (lower[right + c] - lower[left + c]);
            pixel[c] *= top + tap_y.t * (bottom - top);
        }
    }
}

/// product[col][rgb] *= backlight emission.
fn multiply_backlight(
    product: &mut [f32],
    emission: &Tensor<6>,
    frame: usize,
    tap_y: BacklightTap,
    taps_x: &[BacklightTap],
) {
    for (pixel, &tap_x) in product.chunks_exact_mut(3).zip(taps_x) {
        match (tap_x, tap_y) {
            (BacklightTap::Lit { lenslet: col, bin: bin_x }, BacklightTap::Lit { lenslet: row, bin: bin_y }) => {
                let value = emission.block([frame, bin_y as usize, bin_x as usize, row as usize, col as usize]);
                pixel.iter_mut().zip(value).for_each(|(pixel, value)| *pixel *= value);
            }
            _ => pixel.fill(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::tests::small_display;

    #[test]
    fn the_emitted_mean_is_the_mean_over_frames() {
        let display = small_display();
        let mut stack = LayerStack::filled(&display, 1.0);
        for (frame, value) in [0.2, 0.6].into_iter().enumerate() {
            stack.layers[1].block_mut([frame]).fill(value);
        }
        let view = view_from_slope(&display, &stack, [0.0, 0.0]);
        assert!(view.radiance.data().iter().all(|v| (v - 0.4).abs() < 1e-6));
        assert!(view.valid.iter().all(|v| *v));
    }

    #[test]
    fn a_dot_on_the_front_layer_moves_against_the_viewer() {
        let mut display = small_display();
        display.missing = Missing::Clear;
        let mut stack = LayerStack::filled(&display, 1.0);
        let [rows, cols] = [display.field.resolution[1], display.field.resolution[0]];
        for frame in 0..display.frames {
            stack.layers[2].block_mut([frame, rows / 2, cols / 2]).fill(0.0);
        }
        let dark = |view: &EmittedView| {
            let at = view.radiance.data().iter().position(|v| *v == 0.0).unwrap() / 3;
            (at / cols, at % cols)
        };
        let straight = dark(&view_from_slope(&display, &stack, [0.0, 0.0]));
        assert_eq!(straight, (rows / 2, cols / 2));
        // an eye further right sees the front dot further left on z = 0; an eye further up sees it further down
        let right = dark(&view_from_slope(&display, &stack, [0.1, 0.0]));
        assert!(right.1 < straight.1 && right.0 == straight.0, "{right:?}");
        let up = dark(&view_from_slope(&display, &stack, [0.0, 0.1]));
        assert!(up.0 > straight.0 && up.1 == straight.1, "{up:?}");
        // a far eye on the axis sees what the parallel projection shows
        let far = view_from_eye(&display, &stack, [0.0, 0.0, 1e7]);
        assert_eq!(far, view_from_slope(&display, &stack, [0.0, 0.0]));
    }

    #[test]
    fn rays_that_leave_a_layer_are_dropped_or_clear() {
        let mut display = small_display();
        let stack = LayerStack::filled(&display, 0.5);
        let view = view_from_slope(&display, &stack, [0.14, 0.0]);
        assert!(view.valid.iter().any(|v| !v) && view.valid.iter().any(|v| *v));
        display.missing = Missing::Clear;
        let clear = view_from_slope(&display, &stack, [0.14, 0.0]);
        assert!(clear.valid.iter().all(|v| *v));
        assert!(clear.radiance.data().iter().any(|v| (*v - 0.25).abs() < 1e-6), "one layer missed");
    }
}
