//! The effect of a filter on a view: the error, measured with samples that the filter never used,
//! and the mean bias.
//!
//! Errors are means of (F − c₁)(F − c₂) over the [checks](crate::Checks): pixels that were rendered
//! twice more, with the results c₁ and c₂. The noise of c₁, the noise of c₂ and the picture F are
//! independent. So the expectation of the product is F's squared error, for any filter. The mean of
//! F minus the mean of the unbiased picture estimates the filter's mean bias.

use lumistack_core::Tensor;

use crate::Checks;

/// Edge of the blocks in which the change of the mean is averaged, in pixels. A block is so wide
/// that the noise of two blocks is nearly independent.
const BLOCK: usize = 16;

/// A mean, with the sums from which its standard error follows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    sum: f64,
    squares: f64,
    count: f64,
}

/// The effect of the filter on one view, in scene-linear radiance, over all channels together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewFigures {
    /// Mean of the unbiased picture.
    pub mean: f64,
    /// Mean of the filtered picture minus mean of the unbiased picture. The values of the estimate
    /// are the mean differences in blocks of pixels.
    pub change: Estimate,
    /// Mean squared error of the unbiased picture.
    pub mse_before: Estimate,
    /// Mean squared error of the filtered picture.
    pub mse_after: Estimate,
}

impl Estimate {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.squares += value * value;
        self.count += 1.0;
    }

    /// Returns the mean; NaN without values.
    pub fn value(&self) -> f64 {
        self.sum / self.count
    }

    /// Returns the standard error of the mean; NaN with fewer than two values.
    pub fn error(&self) -> f64 {
        let variance = (self.squares / self.count - self.value().powi(2)).max(0.0);
        if self.count < 2.0 { f64::NAN } else { (variance / (self.count - 1.0)).sqrt() }
    }

    /// Returns the joint estimate from the values of all given estimates.
    pub fn joined(parts: impl IntoIterator<Item = Self>) -> Self {
        parts.into_iter().fold(Self::default(), |a, b| Self {
            sum: a.sum + b.sum,
            squares: a.squares + b.squares,
            count: a.count + b.count,
        })
    }

    /// Returns the estimate from the same values, each multiplied by a factor.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { sum: factor * self.sum, squares: factor * factor * self.squares, ..self }
    }

    /// Returns the sum, the sum of squares, and the number of the values, for storage.
    pub fn parts(&self) -> [f64; 3] {
        [self.sum, self.squares, self.count]
    }

    /// Returns the estimate with these [`parts`](Self::parts).
    pub fn from_parts([sum, squares, count]: [f64; 3]) -> Self {
        Self { sum, squares, count }
    }
}

/// Measures the effect of a filter on a view: the change of the mean, and the squared errors before
/// and after the filter. The errors are measured at the pixels of `checks`, which were rendered
/// again. Both pictures are `[row][col][rgb]`.
pub fn figures(filtered: &Tensor<3>, unbiased: &Tensor<3>, checks: &Checks) -> ViewFigures {
    let [rows, cols, _] = unbiased.shape();
    let mut figures = ViewFigures::default();
    // compute the change of the mean, block by block
    for top in (0..rows).step_by(BLOCK) {
        for left in (0..cols).step_by(BLOCK) {
            let (mut sum, mut count) = (0.0, 0.0);
            for row in top..(top + BLOCK).min(rows) {
                for col in left..(left + BLOCK).min(cols) {
                    for (f, u) in filtered.block([row, col]).iter().zip(unbiased.block([row, col])) {
                        sum += f64::from(*f) - f64::from(*u);
                        count += 1.0;
                        figures.mean += f64::from(*u);
                    }
                }
            }
            figures.change.add(sum / count);
        }
    }
    figures.mean /= unbiased.data().len().max(1) as f64;
    // compute the squared errors at the checks, before and after the filter
    for check in &checks.list {
        let squared = |picture: &Tensor<3>| {
            let pixel = picture.block([check.row, check.col]);
            let [first, second] = check.radiance;
            (0..3).map(|c| f64::from(pixel[c] - first[c]) * f64::from(pixel[c] - second[c])).sum::<f64>() / 3.0
        };
        let (before, after) = (squared(unbiased), squared(filtered));
        // leave out a pixel whose product is not a finite number
        if before.is_finite() && after.is_finite() {
            figures.mse_before.add(before);
            figures.mse_after.add(after);
        }
    }
    figures
}
