//! Sorts the frames so that the mean of the first few frames is as near as possible to the mean of
//! all frames.

/// Smallest side of the boxes over which a frame's picture is summed, pixels. Frames are compared
/// by these sums, since the eye averages the noise of single pixels.
const BOX: usize = 8;
/// Largest number of boxes along a side, so that even a large frame needs little memory.
const ACROSS: usize = 64;

/// Reduces a picture to its sums over boxes of pixels. The picture is the view that one frame shows
/// to the middle of the viewing zone.
pub(crate) fn coarse(linear: &[f32], cols: usize) -> Vec<f32> {
    let rows = linear.len() / (3 * cols);
    let side = rows.max(cols).div_ceil(ACROSS).max(BOX);
    let (out_rows, out_cols) = (rows.div_ceil(side), cols.div_ceil(side));
    let mut sums = vec![0.0; 3 * out_rows * out_cols];
    for (i, pixel) in linear.chunks_exact(3).enumerate() {
        let at = 3 * (i / cols / side * out_cols + i % cols / side);
        sums[at..at + 3].iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
    }
    sums
}

/// Returns the frames in the order of loading. After each next frame, the mean of the chosen frames
/// is as near as possible to the mean of all frames.
pub(crate) fn by_importance(frames: &[Vec<f32>]) -> Vec<usize> {
    let width = frames.first().map_or(0, Vec::len);
    let whole: Vec<f64> =
        (0..width).map(|i| frames.iter().map(|f| f64::from(f[i])).sum::<f64>() / frames.len() as f64).collect();
    let mut sum = vec![0.0f64; width];
    let mut left: Vec<usize> = (0..frames.len()).collect();
    let mut order = Vec::with_capacity(frames.len());
    while !left.is_empty() {
        let count = (order.len() + 1) as f64;
        let error = |frame: usize| -> f64 {
            let values = sum.iter().zip(&frames[frame]).zip(&whole);
            values.map(|((sum, value), whole)| ((sum + f64::from(*value)) / count - whole).powi(2)).sum()
        };
        let errors: Vec<f64> = left.iter().map(|frame| error(*frame)).collect();
        let best = (0..left.len()).min_by(|a, b| errors[*a].total_cmp(&errors[*b])).unwrap_or(0);
        let frame = left.remove(best);
        sum.iter_mut().zip(&frames[frame]).for_each(|(sum, value)| *sum += f64::from(*value));
        order.push(frame);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_frame_is_the_likest_and_the_second_makes_up_for_it() {
        let frames: Vec<Vec<f32>> = [0.0, 9.0, 5.0, 4.0].map(|value| vec![value; 3]).to_vec();
        // The mean of all frames is 4.5. Frames 2 and 3 are equally near to it, so frame 2 is
        // first. Frame 3 is next, since the mean of frames 2 and 3 is 4.5.
        assert_eq!(by_importance(&frames), [2, 3, 0, 1]);
        assert_eq!(by_importance(&[]), [0; 0]);
    }

    #[test]
    fn boxes_are_summed_and_the_last_ones_are_smaller() {
        let linear: Vec<f32> = (0..3 * 9 * 10).map(|i| if i % 3 == 0 { 1.0 } else { 0.0 }).collect();
        let sums = coarse(&linear, 10);
        assert_eq!(sums, [64.0, 0.0, 0.0, 16.0, 0.0, 0.0, 8.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    }
}
