//! Mean and variance of the light of a pixel's paths.

use glam::Vec3;

/// Statistics of the samples of a pixel.
pub(super) struct PixelMean {
    /// Mean radiance.
    pub(super) mean: Vec3,
    /// Variance of the mean, as if samples were independent; NaN if fewer than two samples are
    /// finite numbers.
    pub(super) variance: Vec3,
    /// Number of samples that are finite numbers.
    pub(super) finite: u32,
    /// Number of samples that are not finite numbers.
    pub(super) not_finite: u32,
}

/// Sums over the light of a pixel's paths. They are in double precision, since the variance is a
/// small difference of large sums.
#[derive(Clone, Copy, Default)]
pub(super) struct LightSums {
    sum: [f64; 3],
    squares: [f64; 3],
    finite: u32,
    pub(super) not_finite: u32,
}

impl LightSums {
    /// Adds the radiance of a path, if it is a finite number; returns true if it is.
    #[inline]
    pub(super) fn add(&mut self, sample: Vec3) -> bool {
        if !sample.is_finite() {
            self.not_finite += 1;
            return false;
        }
        self.finite += 1;
        for (c, value) in sample.to_array().map(f64::from).into_iter().enumerate() {
            self.sum[c] += value;
            self.squares[c] += value * value;
        }
        true
    }

    /// Returns the sum over the paths with finite light.
    pub(super) fn sum(&self) -> Vec3 {
        Vec3::from_array(self.sum.map(|sum| sum as f32))
    }

    /// Returns the mean over the paths with finite light, and the variance of this mean.
    pub(super) fn mean(&self) -> PixelMean {
        let count = f64::from(self.finite.max(1));
        let variance = |c: usize| match self.finite {
            0 | 1 => f32::NAN,
            // for equal samples, rounding may give a difference slightly below 0
            _ => ((self.squares[c] - self.sum[c] * self.sum[c] / count).max(0.0) / (count * (count - 1.0))) as f32,
        };
        PixelMean {
            mean: Vec3::from_array(self.sum.map(|s| (s / count) as f32)),
            variance: Vec3::from_array([0, 1, 2].map(variance)),
            finite: self.finite,
            not_finite: self.not_finite,
        }
    }
}
