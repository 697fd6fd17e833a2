//! Structural similarity.
//!
//! ```text
//! SSIM = (2 μ_x μ_y + C₁)(2 σ_xy + C₂) / ((μ_x² + μ_y² + C₁)(σ_x² + σ_y² + C₂))
//! ```
//!
//! Means, variances and the covariance are taken under a Gaussian window of σ = 1.5 pixels on 11 ×
//! 11 pixels. C₁ = 0.01² and C₂ = 0.03², for a range of 1. Values are sRGB-encoded, and channels
//! are separate. The result is the mean over channels and over all pixels whose window lies inside
//! the picture.
//!
//! Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to
//! structural similarity", IEEE Transactions on Image Processing 13 (2004). scikit-image computes
//! the same, with population variances, by
//!
//! ```text
//! structural_similarity(x, y, channel_axis=-1, data_range=1, gaussian_weights=True, sigma=1.5,
//!                       use_sample_covariance=False)
//! ```
//!
//! A picture that is smaller than the window on either axis is mirrored at its edges. All its
//! pixels are included. scikit-image refuses a small picture, but computes the same with
//! `win_size=1`.

use super::MetricMap;
use super::filter::{Border, Plane, bands, channels};
use crate::colour::srgb_encode;

const SIGMA: f64 = 1.5;
const RADIUS: usize = 5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Computes SSIM at every pixel of two pictures `[row][col][rgb]` of linear light; `shape` = [rows,
/// cols]. SSIM is 1 where the pictures are equal.
///
/// # Panics
/// If a picture does not fill the shape.
pub fn ssim(first: &[f32], second: &[f32], shape: [usize; 2]) -> MetricMap {
    let [rows, cols] = shape;
    assert!(first.len() == 3 * rows * cols && second.len() == first.len(), "pictures must fill the shape");
    let weights = window();
    let mut values = vec![0.0; rows * cols];
    for band in bands(rows) {
        // compute in f64, since a variance is a small difference of squares
        let planes = [first, second]
            .map(|rgb| channels(rgb, shape, &band, RADIUS, Border::Mirror, |value| f64::from(srgb_encode(value))));
        let local = |plane: &Plane<f64>| {
            plane.filtered_along_rows(&weights, Border::Mirror).filtered_along_columns(&weights, RADIUS).data
        };
        for (x, y) in planes[0].iter().zip(&planes[1]) {
            let (mean_x, mean_y) = (local(x), local(y));
            let (squares, products) = (local(&x.with(y, |x, y| x * x + y * y)), local(&x.with(y, |x, y| x * y)));
            for (i, value) in values[band.start * cols..band.end * cols].iter_mut().enumerate() {
                let (mx, my) = (mean_x[i], mean_y[i]);
                let (covariance, variances) = (products[i] - mx * my, squares[i] - mx * mx - my * my);
                let luminance = (2.0 * mx * my + C1) / (mx * mx + my * my + C1);
                *value += (luminance * (2.0 * covariance + C2) / (variances + C2) / 3.0) as f32;
            }
        }
    }
    let margin = if rows.min(cols) > 2 * RADIUS { RADIUS } else { 0 };
    MetricMap { rows, cols, values, margin }
}

/// Returns the weights of the window along one axis; they sum to 1.
fn window() -> [f64; 2 * RADIUS + 1] {
    let weight = |i: usize| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp();
    let sum: f64 = (0..=2 * RADIUS).map(weight).sum();
    std::array::from_fn(|i| weight(i) / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour::srgb_decode;

    /// Largest accepted error of a mean SSIM: the map is rounded to f32.
    const SAME: f64 = 1e-6;

    #[test]
    fn flat_pictures_differ_in_luminance_alone() {
        let flat = |code: f32| vec![srgb_decode(code); 3 * 20 * 30];
        assert_eq!(ssim(&flat(0.3), &flat(0.3), [20, 30]).mean().value(), 1.0);
        let (x, y) = (0.25f64, 0.75f64);
        let expected = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
        let map = ssim(&flat(x as f32), &flat(y as f32), [20, 30]);
        assert!((map.mean().value() - expected).abs() < SAME, "{}", map.mean().value());
        assert_eq!(map.mean().count, 10 * 20, "only windows inside the picture count");
    }

    #[test]
    fn a_negative_is_dissimilar() {
        let stripes = |light: usize| -> Vec<f32> {
            (0..3 * 24 * 24).map(|i| if (i / 3) % 2 == light { 1.0 } else { 0.0 }).collect()
        };
        assert!(ssim(&stripes(0), &stripes(1), [24, 24]).mean().value() < -0.9);
    }
}
