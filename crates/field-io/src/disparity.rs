//! Disparity between two neighbouring views: block matching along one axis.
//!
//! For each textured block of the first picture, the second picture is searched for the shift with
//! the smallest sum of absolute differences of √luminance. Blocks without a distinct minimum are
//! omitted. Percentiles of the shifts describe the scene's depth range.

use lumistack_core::colour;

/// Motion of content from the first picture to the second: percentiles of the shifts of all blocks
/// with a distinct minimum. A shift towards higher columns or rows is positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    /// 10th percentile of the shifts, pixels.
    pub(crate) low: f64,
    /// Median of the shifts, pixels.
    pub(crate) median: f64,
    /// 90th percentile of the shifts, pixels.
    pub(crate) high: f64,
}

/// Size of a matched block of pixels, across and along the motion.
const BLOCK: [usize; 2] = [12, 24];
/// Largest shift that is searched, pixels.
const REACH: usize = 64;
/// Approximate number of matched blocks per axis.
const BLOCKS_PER_AXIS: usize = 40;
/// Smallest number of blocks with a distinct minimum that gives a result.
const FEWEST_BLOCKS: usize = 12;
/// A block has texture if neighbouring pixels differ by more than this value in √luminance, on
/// average.
const TEXTURE: f32 = 0.01;
/// The smallest sum of differences is distinct if the sums at all shifts more than two pixels away
/// are larger by this factor.
const DISTINCT: f32 = 1.5;

/// Returns the motion along `axis` (0: columns, 1: rows) between two pictures `[row][col][rgb]` of
/// `size` = [columns, rows]. `None` if the pictures are too small, or if too few blocks have a
/// distinct minimum.
pub(crate) fn motion(first: &[f32], second: &[f32], size: [usize; 2], axis: usize) -> Option<Motion> {
    let (length, lines) = (size[axis], size[1 - axis]);
    let first = Lines::new(first, size, axis);
    let second = Lines::new(second, size, axis);
    let reach = REACH.min(length / 6);
    let [across, along] = BLOCK;
    if lines < across || length < along + 2 * reach || reach < 2 {
        return None;
    }
    let mut shifts = Vec::new();
    for line in (0..=lines - across).step_by((lines / BLOCKS_PER_AXIS).max(1)) {
        for start in (reach..=length - along - reach).step_by((length / BLOCKS_PER_AXIS).max(1)) {
            shifts.extend(block_shift(&first, &second, line, start, reach));
        }
    }
    if shifts.len() < FEWEST_BLOCKS {
        return None;
    }
    shifts.sort_by(f64::total_cmp);
    let percentile = |p: usize| shifts[(shifts.len() - 1) * p / 100];
    Some(Motion { low: percentile(10), median: percentile(50), high: percentile(90) })
}

/// √luminance of a picture, in lines parallel to the motion.
struct Lines {
    length: usize,
    values: Vec<f32>,
}

impl Lines {
    fn new(rgb: &[f32], [cols, rows]: [usize; 2], axis: usize) -> Self {
        let level = |row: usize, col: usize| {
            let pixel = &rgb[3 * (row * cols + col)..];
            colour::luminance([pixel[0], pixel[1], pixel[2]]).max(0.0).sqrt()
        };
        let values = if axis == 0 {
            (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))).map(|(row, col)| level(row, col)).collect()
        } else {
            (0..cols).flat_map(|col| (0..rows).map(move |row| (row, col))).map(|(row, col)| level(row, col)).collect()
        };
        Self { length: if axis == 0 { cols } else { rows }, values }
    }

    fn part(&self, line: usize, start: usize, length: usize) -> &[f32] {
        &self.values[line * self.length + start..][..length]
    }
}

fn block_shift(first: &Lines, second: &Lines, line: usize, start: usize, reach: usize) -> Option<f64> {
    let [across, along] = BLOCK;
    let lines = line..line + across;
    let texture: f32 = lines
        .clone()
        .flat_map(|line| first.part(line, start, along).windows(2))
        .map(|pair| (pair[1] - pair[0]).abs())
        .sum();
    if texture < TEXTURE * (across * (along - 1)) as f32 {
        return None;
    }
    let cost = |shift: usize| -> f32 {
        let pairs = lines.clone().map(|l| (first.part(l, start, along), second.part(l, start + shift - reach, along)));
        pairs.map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>()).sum()
    };
    let costs: Vec<f32> = (0..=2 * reach).map(cost).collect();
    let best = (1..2 * reach).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
    let elsewhere = costs.iter().enumerate().filter(|(shift, _)| shift.abs_diff(best) > 2).map(|(_, cost)| *cost);
    if elsewhere.fold(f32::INFINITY, f32::min) < DISTINCT * costs[best] {
        return None;
    }
    let [left, middle, right] = [best - 1, best, best + 1].map(|shift| f64::from(costs[shift]));
    let curvature = left - 2.0 * middle + right;
    let offset = if curvature > 0.0 { (0.5 * (left - right) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
    Some(best as f64 - reach as f64 + offset)
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;

    /// Largest accepted error of the shift that is found for a shifted copy, pixels.
    const SUBPIXEL: f64 = 0.3;

    #[test]
    fn a_shifted_picture_moves_by_its_shift() {
        let size = [120, 90];
        let mut stream = Stream::new(5);
        let wide: Vec<f32> = (0..200 * 200).map(|_| stream.next_f32()).collect();
        let picture = |dx: usize, dy: usize| -> Vec<f32> {
            (0..size[1])
                .flat_map(|row| (0..size[0]).map(move |col| (row, col)))
                .flat_map(|(row, col)| [wide[(row + 50 - dy) * 200 + col + 50 - dx]; 3])
                .collect()
        };
        for (dx, dy, axis, expected) in [(7, 0, 0, 7.0), (0, 3, 1, 3.0), (0, 0, 0, 0.0)] {
            let found = motion(&picture(0, 0), &picture(dx, dy), size, axis).unwrap();
            assert!((found.low - expected).abs() < SUBPIXEL && (found.high - expected).abs() < SUBPIXEL, "{found:?}");
            let back = motion(&picture(dx, dy), &picture(0, 0), size, axis).unwrap();
            assert!((back.median + expected).abs() < SUBPIXEL, "{back:?}");
        }
        assert_eq!(motion(&vec![0.5; 3 * 120 * 90], &vec![0.5; 3 * 120 * 90], size, 0), None);
        assert_eq!(motion(&[0.5; 3], &[0.5; 3], [1, 1], 0), None);
    }
}
