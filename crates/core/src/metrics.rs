//! Image metrics: squared error and PSNR in linear light; SSIM and FLIP, which model how an eye
//! judges pictures.
//!
//! Sums run in `f64`. Pictures are `[row][col][rgb]`, linear light, 0..1. SSIM and FLIP clamp the
//! values and convert their encoding.

mod filter;
mod flip;
mod ssim;

pub use flip::Flip;
pub use ssim::ssim;

/// A sum of squared errors, and the number of values in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SquaredError {
    /// Sum of the squared differences of all compared values.
    pub sum: f64,
    /// Number of values that were compared.
    pub count: u64,
}

impl SquaredError {
    /// Adds one pair of values.
    #[inline]
    pub fn add(&mut self, value: f64, reference: f64) {
        let difference = value - reference;
        self.sum += difference * difference;
        self.count += 1;
    }

    /// Sums the squared differences of two slices of equal length.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn between(values: &[f32], references: &[f32]) -> Self {
        assert_eq!(values.len(), references.len(), "compared slices differ in length");
        let mut error = Self::default();
        for (&value, &reference) in values.iter().zip(references) {
            error.add(f64::from(value), f64::from(reference));
        }
        error
    }

    /// Joins the errors of two disjoint sets of values.
    pub fn merged(self, other: Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count }
    }

    /// Returns the mean squared error; NaN if nothing was compared.
    pub fn mse(self) -> f64 {
        self.sum / self.count as f64
    }

    /// Returns the peak signal-to-noise ratio in dB for a peak of 1: infinite for equal images, NaN
    /// if nothing was compared.
    pub fn psnr(self) -> f64 {
        -10.0 * self.mse().log10()
    }
}

/// A mean as sum and count, so that means can be joined.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    /// Sum of the values whose mean this is.
    pub sum: f64,
    /// Number of values whose mean this is.
    pub count: u64,
}

impl Mean {
    /// Joins the means of two disjoint sets of values.
    pub fn merged(self, other: Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count }
    }

    /// Returns the mean; NaN if there are no values.
    pub fn value(self) -> f64 {
        self.sum / self.count as f64
    }
}

/// The values of a metric at every pixel of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricMap {
    /// Number of pixel rows of the picture.
    pub rows: usize,
    /// Number of pixel columns of the picture.
    pub cols: usize,
    /// The metric at every pixel, `[row][col]`.
    pub values: Vec<f32>,
    /// Width of the border that the metric's mean leaves out, pixels.
    pub margin: usize,
}

impl MetricMap {
    /// Returns the metric of the whole picture: the mean over all pixels except those of the
    /// border.
    pub fn mean(&self) -> Mean {
        self.mean_where(|_| true)
    }

    /// Returns the mean over the pixels for which `counts` returns true. The function `counts`
    /// receives a pixel's index in `values`. Pixels of the border, which is `margin` wide, are
    /// never included.
    pub fn mean_where(&self, counts: impl Fn(usize) -> bool) -> Mean {
        let mut mean = Mean::default();
        for row in self.margin..self.rows.saturating_sub(self.margin) {
            for col in self.margin..self.cols.saturating_sub(self.margin) {
                let i = row * self.cols + col;
                if counts(i) {
                    mean.sum += f64::from(self.values[i]);
                    mean.count += 1;
                }
            }
        }
        mean
    }
}

/// Returns the value below which the fraction `share` (0..1) of the values lies; 0 if there are no
/// values. Reorders the slice.
pub fn percentile(values: &mut [f32], share: f64) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let rank = (share.clamp(0.0, 1.0) * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(rank, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_of_a_tenth_is_twenty_decibels() {
        let error = SquaredError::between(&[0.5, 0.25], &[0.6, 0.35]);
        assert!((error.psnr() - 20.0).abs() < 1e-5);
        assert_eq!(SquaredError::between(&[1.0], &[1.0]).psnr(), f64::INFINITY);
        assert!(SquaredError::default().psnr().is_nan());
    }

    #[test]
    fn percentiles_are_order_statistics() {
        let mut values: Vec<f32> = (0..=100).rev().map(|i| i as f32).collect();
        assert_eq!(percentile(&mut values, 0.25), 25.0);
        assert_eq!(percentile(&mut values, 1.0), 100.0);
        assert_eq!(percentile(&mut [], 0.5), 0.0);
    }

    #[test]
    fn a_mean_leaves_the_border_and_what_does_not_count_out() {
        let map = MetricMap { rows: 3, cols: 4, values: (0..12).map(|i| i as f32).collect(), margin: 1 };
        assert_eq!(map.mean(), Mean { sum: 11.0, count: 2 });
        assert_eq!(map.mean_where(|i| i != 6).value(), 5.0);
        assert_eq!(map.mean_where(|i| i == 6).merged(map.mean_where(|i| i == 5)), map.mean());
        assert!(MetricMap { margin: 2, ..map }.mean().value().is_nan());
    }
}
