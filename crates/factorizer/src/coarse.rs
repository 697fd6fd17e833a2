//! A problem at half the resolution, whose solution is a start for the whole problem.
//!
//! At half the resolution, low frequencies converge at a quarter of the cost. Field and layers have
//! half the number of pixels per axis. The parallax between two views, in pixels, is also halved,
//! so fewer views suffice. If the backlight is uniform, an axis with an odd number of at least
//! 9 views keeps only every second view. Lenslets, angular bins and frames stay the same.
//!
//! A coarse pixel is the area-weighted mean of the fine pixels that it covers. A coarse solution is
//! interpolated linearly at the centres of the fine pixels. All values stay in the layout of the
//! kernels.

use std::sync::Arc;

use lumistack_display::{Backlight, Display, FieldGeometry};

use crate::bands;
use crate::factor::{Factor, Layout};
use crate::plan::Plan;

/// Smallest number of pixels per axis of a coarse field and its layers. A coarser level with fewer
/// pixels would save too little time.
const SMALLEST_FIELD: usize = 48;
/// Smallest number of views on an axis for which only every second view is kept.
const MANY_VIEWS: usize = 9;

/// A coarse problem that owns its parts.
pub(crate) struct Coarse {
    pub(crate) display: Display,
    pub(crate) geometry: FieldGeometry,
    pub(crate) plan: Arc<Plan>,
}

impl Coarse {
    /// Halves the resolution of a problem.
    ///
    /// Returns `None` if a coarser level has no use: with too few pixels, with fewer than two
    /// coarse pixels per lenslet, or with colour filters.
    pub(crate) fn of(display: &Display, geometry: &FieldGeometry, fine: &Plan) -> Option<Self> {
        let layers = display.layers.iter();
        let smallest =
            layers.flat_map(|layer| layer.resolution).chain([geometry.rows, geometry.cols]).min().unwrap_or(0);
        let too_few_to_a_lenslet = match &display.backlight {
            Backlight::Lenslets(lenslets) => lenslets.pitch_mm < 4.0 * geometry.pitch_mm,
            Backlight::Uniform => false,
        };
        if smallest < 2 * SMALLEST_FIELD || too_few_to_a_lenslet || display.layers.iter().any(|l| !l.filters.is_empty())
        {
            return None;
        }
        // make a display whose field and layers have pixels of twice the pitch
        let mut display = display.clone();
        display.field.resolution = display.field.resolution.map(|n| n.div_ceil(2));
        display.field.pitch_mm *= 2.0;
        for layer in &mut display.layers {
            layer.resolution = layer.resolution.map(|n| n.div_ceil(2));
            layer.pitch_mm *= 2.0;
            layer.blur_px /= 2.0;
        }
        // Every second view of an axis is dropped only if the backlight is uniform, since angular
        // bins need all views. The axis must have an odd number of views, since otherwise the
        // remaining views would not be symmetrical.
        let thins = |count: usize| display.backlight == Backlight::Uniform && count >= MANY_VIEWS && count % 2 == 1;
        let views = geometry.grid.views().map(|count| (0..count).step_by(if thins(count) { 2 } else { 1 }));
        let mut coarse = FieldGeometry {
            rows: geometry.rows.div_ceil(2),
            cols: geometry.cols.div_ceil(2),
            pitch_mm: 2.0 * geometry.pitch_mm,
            grid: geometry.grid.clone(),
        };
        coarse.grid.slope_y = views[0].clone().map(|view| geometry.grid.slope_y[view]).collect();
        coarse.grid.slope_x = views[1].clone().map(|view| geometry.grid.slope_x[view]).collect();
        // average the target over the coarse pixels
        let views: Vec<usize> =
            views[0].clone().flat_map(|view_y| views[1].clone().map(move |view_x| fine.view(view_y, view_x))).collect();
        let pixels = [cover(geometry.rows, coarse.rows), cover(geometry.cols, coarse.cols)];
        let mut plan = Plan::with_target(&display, &coarse, fine.target.averaged(&fine.row, &views, &pixels));
        plan.tile = fine.tile.as_ref().map(|tile| tile.halved(&display));
        Some(Self { display, geometry: coarse, plan: Arc::new(plan) })
    }
}

/// Interpolates a factor of a coarse solution at the pixels of the finer `layout`, and clamps the
/// values to `low`..`high`. The values of a backlight are copied, since it has the same lenslets on
/// both levels.
pub(crate) fn refine(coarse: &Factor, layout: &Layout, [low, high]: [f32; 2]) -> Factor {
    let channels = coarse.channels();
    let mut fine = Factor::blank(layout, channels);
    let ([rows, cols], [_, fine_cols]) = (coarse.layout.size, layout.size);
    let same = coarse.layout.size == layout.size;
    let steps_x = Between::of(fine_cols, cols);
    let steps_y = Between::of(layout.size[0], rows);
    bands::for_each_chunk(
        &mut fine.values,
        layout.line_len(),
        || vec![0.0f32; 1 + cols + 1],
        |mixed, index, values| {
            let (channel, line) = (index / layout.stored_lines(), index % layout.stored_lines());
            if line == layout.lines() {
                return;
            }
            for frame in 0..layout.frames {
                let to = &mut values[frame * layout.stride + layout.pad..][..layout.cols()];
                let row = |line: usize| &coarse.row(channel, line, frame)[coarse.layout.pad..][..coarse.layout.cols()];
                if same {
                    to.copy_from_slice(row(line));
                } else {
                    let ([before, after], t) = steps_y.around(line);
                    // mix two coarse lines, repeat the mixture's first and last value, and
                    // interpolate along it
                    let (upper, lower) = (row(before.saturating_sub(1)), row((after - 1).min(rows - 1)));
                    let inner = mixed[1..=cols].iter_mut().zip(upper).zip(lower);
                    inner.for_each(|((mixed, &a), &b)| *mixed = a + t * (b - a));
                    (mixed[0], mixed[cols + 1]) = (mixed[1], mixed[cols]);
                    steps_x.interpolate(mixed, to);
                }
                to.iter_mut().for_each(|value| *value = value.max(low).min(high));
            }
        },
    );
    fine
}

/// Positions of fine pixels between coarse pixels of twice the pitch. Both grids have the same
/// centre.
///
/// In the list of coarse pixels, the first pixel and the last pixel are repeated once. Then fine
/// pixel 2k lies between entries k and k + 1, and fine pixel 2k + 1 between entries
/// k + 1 and k + 2.
struct Between {
    /// For an even and for an odd fine pixel: the pixel's position between its two entries of the
    /// list, 0..1.
    t: [f32; 2],
}

impl Between {
    fn of(fine: usize, coarse: usize) -> Self {
        Self { t: if fine == 2 * coarse { [0.75, 0.25] } else { [1.0, 0.5] } }
    }

    /// Returns the two entries of the extended list around a fine pixel, and the pixel's position
    /// between them, 0..1.
    fn around(&self, fine: usize) -> ([usize; 2], f32) {
        let first = fine / 2 + fine % 2;
        ([first, first + 1], self.t[fine % 2])
    }

    fn interpolate(&self, coarse: &[f32], fine: &mut [f32]) {
        let [even, odd] = self.t;
        let (pairs, last) = fine.as_chunks_mut::<2>();
        for (pair, around) in pairs.iter_mut().zip(coarse.windows(3)) {
            pair[0] = around[0] + even * (around[1] - around[0]);
            pair[1] = around[1] + odd * (around[2] - around[1]);
        }
        if let [last] = last {
            let k = pairs.len();
            *last = coarse[k] + even * (coarse[k + 1] - coarse[k]);
        }
    }
}

/// Returns the fine pixels under each coarse pixel of twice the pitch. Both grids have the same
/// centre.
///
/// For each coarse pixel, the result has the first fine pixel under it, and the shares of three
/// fine pixels: the first and the next two.
pub(crate) fn cover(fine: usize, coarse: usize) -> Vec<(usize, [f32; 3])> {
    (0..coarse)
        .map(|i| {
            // the left edge of the coarse pixel in fine pixels, counted from the left edge of fine
            // pixel 0
            let left = 2.0 * i as f64 - (coarse as f64 - 1.0) + fine as f64 / 2.0 - 1.0;
            let first = left.floor().max(0.0) as usize;
            let share = |k: usize| {
                let overlap = (left + 2.0).min((first + k + 1) as f64) - left.max((first + k) as f64);
                if first + k < fine { overlap.max(0.0) } else { 0.0 }
            };
            let shares = [share(0), share(1), share(2)];
            let total: f64 = shares.iter().sum();
            (first, shares.map(|share| (share / total) as f32))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarse_pixels_cover_the_field() {
        for fine in 2usize..40 {
            let coarse = fine.div_ceil(2);
            let mut seen = vec![0.0; fine];
            for (first, shares) in cover(fine, coarse) {
                assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                (0..3).filter(|&k| shares[k] > 0.0).for_each(|k| seen[first + k] += shares[k]);
            }
            assert!(seen.iter().all(|&share| share > 0.0), "{fine}: {seen:?}");
        }
        assert_eq!(cover(4, 2), [(0, [0.5, 0.5, 0.0]), (2, [0.5, 0.5, 0.0])]);
        assert_eq!(cover(5, 3)[1], (1, [0.25, 0.5, 0.25]));
    }

    #[test]
    fn a_ramp_survives_the_way_down_and_up() {
        for fine in [8usize, 9, 31] {
            let coarse = fine.div_ceil(2);
            let ramp: Vec<f32> = (0..fine).map(|i| i as f32 - (fine as f32 - 1.0) / 2.0).collect();
            let mean = |(first, shares): (usize, [f32; 3])| -> f32 {
                shares.iter().enumerate().filter(|(_, s)| **s > 0.0).map(|(k, s)| s * ramp[first + k]).sum()
            };
            let means: Vec<f32> = cover(fine, coarse).into_iter().map(mean).collect();
            let repeated = [&means[..1], &means, &means[coarse - 1..]].concat();
            let (between, mut up) = (Between::of(fine, coarse), vec![0.0; fine]);
            between.interpolate(&repeated, &mut up);
            for i in 2..fine - 2 {
                assert!((up[i] - ramp[i]).abs() < 1e-5, "{fine}, {i}: {} {}", up[i], ramp[i]);
            }
            for (i, value) in up.iter().enumerate() {
                let ([before, after], t) = between.around(i);
                assert!((value - (repeated[before] + t * (repeated[after] - repeated[before]))).abs() < 1e-6);
            }
        }
    }
}
