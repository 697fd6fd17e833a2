//! Area averaging in linear light: an output pixel is the mean of the source over the rectangle
//! that the output pixel covers.
//!
//! [`area`] shifts, crops and reduces a picture in one step. If a rectangle starts within a pixel,
//! each output value mixes neighbouring pixels, which shifts the picture by a fraction of a pixel.

/// A rectangle of a source picture in pixels; (0, 0) is the outer corner of the first pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rect {
    pub(crate) corner: [f64; 2],
    pub(crate) size: [f64; 2],
}

/// The source pixels along one axis that an output pixel covers, and their weights.
struct Cover {
    first: usize,
    weights: Vec<f32>,
}

/// Averages the rectangle of `source` (`[row][col][rgb]`, `size` = [columns, rows]) into `out_size`
/// pixels.
pub(crate) fn area(source: &[f32], size: [usize; 2], rect: Rect, out_size: [usize; 2], out: &mut [f32]) {
    let whole = Rect { corner: [0.0; 2], size: size.map(|n| n as f64) };
    if rect == whole && out_size == size {
        return out.copy_from_slice(source);
    }
    let [across, down] = [0, 1].map(|axis| covers(rect.corner[axis], rect.size[axis], out_size[axis], size[axis]));
    let mut line = vec![0f32; 3 * size[0]];
    for (cover, out_row) in down.iter().zip(out.chunks_exact_mut(3 * out_size[0])) {
        line.fill(0.0);
        for (row, &weight) in (cover.first..).zip(&cover.weights) {
            let source_row = &source[3 * size[0] * row..][..3 * size[0]];
            line.iter_mut().zip(source_row).for_each(|(sum, value)| *sum += weight * value);
        }
        for (cover, pixel) in across.iter().zip(out_row.chunks_exact_mut(3)) {
            pixel.fill(0.0);
            for (col, &weight) in (cover.first..).zip(&cover.weights) {
                for channel in 0..3 {
                    pixel[channel] += weight * line[3 * col + channel];
                }
            }
        }
    }
}

fn covers(start: f64, length: f64, count: usize, limit: usize) -> Vec<Cover> {
    let step = length / count as f64;
    // rectangles lie within the source; an edge that a rounding error puts outside is clamped
    let inside = |edge: f64| edge.clamp(0.0, limit as f64);
    let cover = |index: usize| {
        let from = inside(start + index as f64 * step);
        let to = inside(start + (index + 1) as f64 * step);
        let first = (from.floor() as usize).min(limit - 1);
        let last = (to.ceil() as usize).clamp(first + 1, limit);
        let overlap = |pixel: usize| (to.min((pixel + 1) as f64) - from.max(pixel as f64)).max(0.0);
        let total: f64 = (first..last).map(overlap).sum();
        let weights =
            if total > 0.0 { (first..last).map(|pixel| (overlap(pixel) / total) as f32).collect() } else { vec![1.0] };
        Cover { first, weights }
    };
    (0..count).map(cover).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest accepted error of a sum of a few weights in single precision.
    const ROUNDING: f32 = 1e-6;

    fn averaged(values: &[f32], size: [usize; 2], corner: [f64; 2], span: [f64; 2], out: [usize; 2]) -> Vec<f32> {
        let rgb: Vec<f32> = values.iter().flat_map(|v| [*v; 3]).collect();
        let mut result = vec![0.0; 3 * out[0] * out[1]];
        area(&rgb, size, Rect { corner, size: span }, out, &mut result);
        result.into_iter().step_by(3).collect()
    }

    #[test]
    fn pixels_are_means_over_their_areas() {
        let row = [0.0, 1.0, 2.0, 3.0];
        for (corner, span, count, expected) in [
            (0.0, 4.0, 2, vec![0.5, 2.5]),
            (1.0, 2.0, 2, vec![1.0, 2.0]),
            (0.25, 3.0, 3, vec![0.25, 1.25, 2.25]),
            (0.0, 3.0, 2, vec![1.0 / 3.0, 5.0 / 3.0]),
            (0.0, 4.0, 1, vec![1.5]),
        ] {
            let across = averaged(&row, [4, 1], [corner, 0.0], [span, 1.0], [count, 1]);
            let down = averaged(&row, [1, 4], [0.0, corner], [1.0, span], [1, count]);
            assert_eq!(across, down);
            assert!(across.iter().zip(&expected).all(|(a, b)| (a - b).abs() < ROUNDING), "{across:?}");
        }
    }

    #[test]
    fn the_mean_stays() {
        let values: Vec<f32> = (0..77).map(|i| ((i * 37) % 19) as f32).collect();
        let mean = values.iter().sum::<f32>() / 77.0;
        for out in [[11, 7], [1, 1], [5, 3], [10, 6]] {
            let result = averaged(&values, [11, 7], [0.0; 2], [11.0, 7.0], out);
            assert!((result.iter().sum::<f32>() / result.len() as f32 - mean).abs() < 19.0 * ROUNDING);
        }
    }
}
