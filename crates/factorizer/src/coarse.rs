//! The same problem at half the resolution, and its solution as a start for the whole one.
//!
//! Low frequencies settle at a quarter of the cost. Field and layers lose every second pixel; lenslets, angular bins, views and frames stay. Coarse
//! pixels are means over the fine ones that they cover, by area; a coarse solution is interpolated linearly where the fine pixels' centres
//! are.

use lumistack_core::Tensor;
use lumistack_display::{Backlight, Display, FieldGeometry, LayerStack, LightField, Weights};

use crate::{Problem, bands};

/// Fewest pixels per axis of a field that is worth a level of its own.
const SMALLEST_FIELD: usize = 48;

/// A problem that owns its parts.
#[derive(Clone, Debug)]
pub(crate) struct Coarse {
    display: Display,
    target: LightField,
    weights: Weights,
}

impl Coarse {
    /// The problem at half the resolution; `None` where that would be meaningless: hardly any pixels, fewer than two pixels to a lenslet, or
    /// colour filters that stand on single columns.
    pub(crate) fn of(problem: &Problem) -> Option<Self> {
        let (display, geometry) = (problem.display, problem.target.geometry());
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
        let mut display = display.clone();
        display.field.resolution = display.field.resolution.map(|n| n.div_ceil(2));
        display.field.pitch_mm *= 2.0;
        for layer in &mut display.layers {
            layer.resolution = layer.resolution.map(|n| n.div_ceil(2));
            layer.pitch_mm *= 2.0;
            layer.blur_px /= 2.0;
        }
        let coarse = FieldGeometry {
            rows: geometry.rows.div_ceil(2),
            cols: geometry.cols.div_ceil(2),
            pitch_mm: 2.0 * geometry.pitch_mm,
            grid: geometry.grid.clone(),
        };
        let rows = cover(geometry.rows, coarse.rows);
        let cols = cover(geometry.cols, coarse.cols);
        let mut target = LightField::black(coarse).ok()?;
        average::<3>(problem.target.radiance().data(), geometry.cols, &rows, &cols, target.radiance_mut().data_mut());
        let weights = match problem.weights {
            Weights::PerRay(fine) => {
                let [view_rows, view_cols, ..] = fine.shape();
                let mut coarse =
                    Tensor::zeros(["view_y", "view_x", "row", "col"], [view_rows, view_cols, rows.len(), cols.len()]);
                average::<1>(fine.data(), geometry.cols, &rows, &cols, coarse.data_mut());
                Weights::PerRay(coarse)
            }
            weights => weights.clone(),
        };
        Some(Self { display, target, weights })
    }

    pub(crate) fn problem(&self) -> Problem<'_> {
        Problem { display: &self.display, target: &self.target, weights: &self.weights }
    }

    /// A coarse solution as patterns of the fine display.
    pub(crate) fn refine(&self, coarse: &LayerStack, fine: &Display) -> LayerStack {
        let mut stack = LayerStack::filled(fine, 0.0);
        for (to, from) in stack.layers.iter_mut().zip(&coarse.layers) {
            let [_, fine_rows, fine_cols, _] = to.shape();
            let [_, rows, cols, _] = from.shape();
            let (ys, xs) = (between(fine_rows, rows), between(fine_cols, cols));
            let from = from.data();
            bands::for_each_chunk(
                to.data_mut(),
                fine_cols * 3,
                || vec![0.0f32; (cols + 1) * 3],
                |mixed, index, line| {
                    let (frame, row) = (index / fine_rows, index % fine_rows);
                    let (first, ty) = ys[row];
                    let upper = &from[(frame * rows + first) * cols * 3..][..cols * 3];
                    let lower = &from[(frame * rows + (first + 1).min(rows - 1)) * cols * 3..][..cols * 3];
                    for ((to, &a), &b) in mixed.iter_mut().zip(upper).zip(lower) {
                        *to = a + ty * (b - a);
                    }
                    // nothing follows the last column: it is mixed with itself
                    mixed.copy_within((cols - 1) * 3..cols * 3, cols * 3);
                    for (pixel, &(first, tx)) in line.chunks_exact_mut(3).zip(&xs) {
                        let (left, right) = mixed[3 * first..3 * first + 6].split_at(3);
                        for ((value, &a), &b) in pixel.iter_mut().zip(left).zip(right) {
                            *value = (a + tx * (b - a)).clamp(0.0, 1.0);
                        }
                    }
                },
            );
        }
        stack.emission.clone_from(&coarse.emission);
        stack
    }
}

/// Per coarse pixel of twice the pitch on the same centre: the first fine pixel that it covers and the shares of it and the next two.
fn cover(fine: usize, coarse: usize) -> Vec<(usize, [f32; 3])> {
    (0..coarse)
        .map(|i| {
            // in fine pixels: the coarse pixel's left edge, where the first fine pixel's left edge is 0
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

/// Means of pictures `[...][row][col][channel]` of C channels.
fn average<const C: usize>(
    fine: &[f32],
    fine_cols: usize,
    rows: &[(usize, [f32; 3])],
    cols: &[(usize, [f32; 3])],
    coarse: &mut [f32],
) {
    let pictures = coarse.len() / (rows.len() * cols.len() * C);
    let fine_rows = fine.len() / (pictures * fine_cols * C);
    bands::for_each_chunk(
        coarse,
        cols.len() * C,
        || vec![0.0f32; fine_cols * C],
        |sum, index, line| {
            let (picture, (first, shares)) = (index / rows.len(), rows[index % rows.len()]);
            sum.fill(0.0);
            for (k, &share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
                let row = &fine[(picture * fine_rows + first + k) * fine_cols * C..][..fine_cols * C];
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += share * value);
            }
            for (pixel, &(first, shares)) in line.chunks_exact_mut(C).zip(cols) {
                pixel.fill(0.0);
                for (k, &share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
                    let from = &sum[(first + k) * C..][..C];
                    pixel.iter_mut().zip(from).for_each(|(value, from)| *value += share * from);
                }
            }
        },
    );
}

/// Per fine pixel: the coarse pixel before it, and how far it lies on the way to the next.
fn between(fine: usize, coarse: usize) -> Vec<(usize, f32)> {
    (0..fine)
        .map(|i| {
            let at = (i as f64 - (fine as f64 - 1.0) / 2.0) / 2.0 + (coarse as f64 - 1.0) / 2.0;
            let at = at.clamp(0.0, coarse as f64 - 1.0);
            (at.floor() as usize, (at - at.floor()) as f32)
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
            let mut means = vec![0.0; coarse];
            average::<1>(&ramp, fine, &[(0, [1.0, 0.0, 0.0])], &cover(fine, coarse), &mut means);
            let (ups, inner) = (between(fine, coarse), 2..fine - 2);
            for i in inner {
                let (first, t) = ups[i];
                let value = means[first] + t * (means[(first + 1).min(coarse - 1)] - means[first]);
                assert!((value - ramp[i]).abs() < 1e-5, "{fine}, {i}: {value} {}", ramp[i]);
            }
        }
    }
}
