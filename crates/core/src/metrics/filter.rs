//! Separable filters: out[i] = Σ_k weights[k] · in[i + k − radius], along rows, then along columns.
//! The radius is half of the number of weights, rounded down.
//!
//! Pictures are filtered band by band, so that a metric's many intermediate planes take little
//! memory. A band is a few rows with a halo of rows above and below. At the edges of the picture,
//! [`Border`] states which pixels fill the halo.

use std::ops::{AddAssign, Mul, Range};

/// Number of rows of a band, without its halo.
const BAND: usize = 128;

/// One quantity at every pixel of a band of rows and of its halo, `[row][col]`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plane<T> {
    pub(super) rows: usize,
    pub(super) cols: usize,
    pub(super) data: Vec<T>,
}

/// `f32` or `f64`.
pub(super) trait Real: Copy + Default + Mul<Output = Self> + AddAssign {}

impl Real for f32 {}
impl Real for f64 {}

/// Rule for the pixels that a filter reads outside of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Border {
    /// The filter repeats the outermost pixel: a a | a b c | c c.
    Nearest,
    /// The filter mirrors the picture about its edge: b a | a b c | c b.
    Mirror,
}

/// Splits a picture into bands, which are filtered one after another. A band is a range of rows.
pub(super) fn bands(rows: usize) -> impl Iterator<Item = Range<usize>> {
    (0..rows).step_by(BAND).map(move |start| start..(start + BAND).min(rows))
}

/// Returns the three channels of a band of a picture `[row][col][rgb]`, with `halo` rows above and
/// below. `change` converts each value.
pub(super) fn channels<T: Real>(
    rgb: &[f32],
    shape: [usize; 2],
    band: &Range<usize>,
    halo: usize,
    border: Border,
    change: impl Fn(f32) -> T,
) -> [Plane<T>; 3] {
    let [rows, cols] = shape;
    let count = band.len() + 2 * halo;
    let lines =
        (band.start..band.start + count).map(|row| &rgb[3 * cols * border.index(row, halo, rows)..][..3 * cols]);
    [0, 1, 2].map(|c| {
        let values = lines.clone().flat_map(|line| line.iter().skip(c).step_by(3));
        Plane { rows: count, cols, data: values.map(|value| change(*value)).collect() }
    })
}

impl<T: Real> Plane<T> {
    /// Combines this plane with another plane of the same shape, value by value.
    pub(super) fn with(&self, other: &Self, value: impl Fn(T, T) -> T) -> Self {
        Self { data: self.data.iter().zip(&other.data).map(|(a, b)| value(*a, *b)).collect(), ..*self }
    }

    /// Filters every row; `weights` has odd length.
    pub(super) fn filtered_along_rows(&self, weights: &[T], border: Border) -> Self {
        let mut data = vec![T::default(); self.data.len()];
        if self.data.is_empty() {
            return Self { data, ..*self };
        }
        let radius = weights.len() / 2;
        let source: Vec<usize> = (0..self.cols + 2 * radius).map(|i| border.index(i, radius, self.cols)).collect();
        let mut padded = vec![T::default(); self.cols + 2 * radius];
        for (line, out) in self.data.chunks_exact(self.cols).zip(data.chunks_exact_mut(self.cols)) {
            padded.iter_mut().zip(&source).for_each(|(value, &at)| *value = line[at]);
            let taps: Vec<&[T]> = (0..weights.len()).map(|k| &padded[k..k + self.cols]).collect();
            weighted_sum(&taps, weights, out);
        }
        Self { data, ..*self }
    }

    /// Filters every column of a band and removes its halo. The length of `weights` is odd and at
    /// most 2·halo + 1.
    pub(super) fn filtered_along_columns(&self, weights: &[T], halo: usize) -> Self {
        let rows = self.rows - 2 * halo;
        let mut data = vec![T::default(); rows * self.cols];
        let first = halo - weights.len() / 2;
        for row in 0..rows {
            let line = |k: usize| &self.data[(row + first + k) * self.cols..][..self.cols];
            let taps: Vec<&[T]> = (0..weights.len()).map(line).collect();
            weighted_sum(&taps, weights, &mut data[row * self.cols..(row + 1) * self.cols]);
        }
        Self { rows, data, ..*self }
    }
}

impl Border {
    /// Returns the index of the value that a filter reads at position `i` of a line, which is a row
    /// or a column. The line has `count` ≥ 1 values, at the positions from `radius` on. At other
    /// positions, the border's rule selects one of these values.
    fn index(self, i: usize, radius: usize, count: usize) -> usize {
        match self {
            Self::Nearest => i.saturating_sub(radius).min(count - 1),
            Self::Mirror => {
                // a line that is mirrored at both ends repeats after twice its length
                let period = 2 * count as isize;
                let place = (i as isize - radius as isize).rem_euclid(period) as usize;
                place.min(2 * count - 1 - place)
            }
        }
    }
}

/// Computes out[x] = Σ_k weights[k] · taps[k][x]. It works in blocks of x, whose sums stay in
/// registers.
fn weighted_sum<T: Real>(taps: &[&[T]], weights: &[T], out: &mut [T]) {
    const BLOCK: usize = 16;
    let whole = out.len() / BLOCK * BLOCK;
    for start in (0..whole).step_by(BLOCK) {
        let mut sums = [T::default(); BLOCK];
        for (tap, &weight) in taps.iter().zip(weights) {
            for (sum, &value) in sums.iter_mut().zip(&tap[start..start + BLOCK]) {
                *sum += weight * value;
            }
        }
        out[start..start + BLOCK].copy_from_slice(&sums);
    }
    for x in whole..out.len() {
        let mut sum = T::default();
        taps.iter().zip(weights).for_each(|(tap, &weight)| sum += weight * tap[x]);
        out[x] = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Stream;

    /// Largest accepted difference between a sum of a few dozen terms in f32 and the same sum in
    /// f64.
    const ROUNDING: f64 = 1e-6;

    #[test]
    fn bands_agree_with_the_sums_written_out() {
        let weights = [0.1, -0.4, 0.5, 0.9, 0.2, 0.3, -0.05];
        let mut stream = Stream::new(3);
        for (rows, cols, halo) in [(1, 1, 3), (3, 5, 5), (2, 17, 3), (33, 1, 4), (19, 40, 3), (BAND + 30, 7, 6)] {
            let rgb: Vec<f32> = (0..3 * rows * cols).map(|_| stream.next_f32()).collect();
            for border in [Border::Nearest, Border::Mirror] {
                for band in bands(rows) {
                    let [_, green, _] = channels(&rgb, [rows, cols], &band, halo, border, |value| value);
                    let along_rows = green.filtered_along_rows(&weights, border).filtered_along_columns(&[1.0], halo);
                    let along_columns = green.filtered_along_columns(&weights, halo);
                    for (i, (found_x, found_y)) in along_rows.data.iter().zip(&along_columns.data).enumerate() {
                        let (row, col) = (band.start + i / cols, i % cols);
                        let across = written_out(&weights, border, col, cols, |i| rgb[3 * (row * cols + i) + 1]);
                        let down = written_out(&weights, border, row, rows, |i| rgb[3 * (i * cols + col) + 1]);
                        let error = (f64::from(*found_x) - across).abs().max((f64::from(*found_y) - down).abs());
                        assert!(error < ROUNDING, "{rows} × {cols}, {border:?}, row {row}, column {col}");
                    }
                }
            }
        }
        assert_eq!(bands(2 * BAND).map(|band| band.len()).collect::<Vec<_>>(), [BAND, BAND]);
        assert_eq!(bands(0).count(), 0);
    }

    fn written_out(weights: &[f32], border: Border, at: usize, count: usize, value: impl Fn(usize) -> f32) -> f64 {
        let read = |mut i: i64| {
            let last = count as i64 - 1;
            if border == Border::Nearest {
                return value(i.clamp(0, last) as usize);
            }
            while i < 0 || i > last {
                i = if i < 0 { -1 - i } else { 2 * last + 1 - i };
            }
            value(i as usize)
        };
        let radius = weights.len() as i64 / 2;
        let places = weights.iter().zip(at as i64 - radius..);
        places.map(|(weight, i)| f64::from(*weight) * f64::from(read(i))).sum()
    }
}
