//! Predicts the quality of a design before it is solved, in decibels, to rank designs.
//!
//! For a light field whose depths suit the display, three properties explain most of the quality.
//! They are degrees of freedom per ray, brightness, and the detail that the bound allows. Detail is
//! averaged up to the depth z_1, at which content shifts by one pixel between neighbouring views.
//! For pixels of pitch p and views whose slopes differ by Δs, z_1 is p/Δs. ω(z) is the bound at
//! depth z.
//!
//! ```text
//! PSNR ≈ c_0 + c_1 log2 ρ + c_2 log2 1/β + c_3 mean of min(1, ω(z) 2p) over |z| ≤ z_1
//! ρ = values of the patterns per ray
//! ```
//!
//! The constants were fitted by least squares to 80 random designs on one scene ([`COEFFICIENTS`]).
//! Another scene mainly changes c_0, so use the ranking, not the value. `cargo xtask bench design`
//! prints the rank correlation between the predicted and the solved quality of designs that the fit
//! did not use.

use lumistack_display::Display;

use crate::step::view_step;
use crate::table::Design;

/// Constants c_0 to c_3 of the prediction, dB.
pub const COEFFICIENTS: [f64; 4] = [26.1, 7.7, 0.9, 14.7];

/// Number of depths over which the bound is averaged.
const DEPTHS: usize = 65;

/// Returns the features of a display: log2 of the patterns' values per ray, log2 1/β, and the mean
/// detail that the bound allows.
pub fn features(display: &Display) -> [f64; 3] {
    let design = Design::of("", display);
    let own = 0.5 / display.field.pitch_mm;
    let step = view_step(display).into_iter().fold(0.0, f64::max);
    // A display with a single direction shows no depth, so the bound is sampled only on the display
    // plane.
    let reach = if step > 0.0 { display.field.pitch_mm / step } else { 0.0 };
    let share = |i: usize| {
        let z = reach * (2.0 * i as f64 / (DEPTHS - 1) as f64 - 1.0);
        (display.spatial_cutoff(z) / own).min(1.0)
    };
    let detail = (0..DEPTHS).map(share).sum::<f64>() / DEPTHS as f64;
    [design.values_per_ray.log2(), -display.brightness.log2(), detail]
}

/// Returns the predicted PSNR, dB.
pub fn predicted_db(display: &Display) -> f64 {
    let [c0, rest @ ..] = COEFFICIENTS;
    c0 + rest.iter().zip(features(display)).map(|(c, feature)| c * feature).sum::<f64>()
}

/// Returns Spearman's rank correlation of two lists of equal length. Equal values have the mean of
/// their ranks. NaN if a list is constant.
pub fn rank_correlation(first: &[f64], second: &[f64]) -> f64 {
    let [a, b] = [first, second].map(ranks);
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let sum = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    sum(&a, &b) / (sum(&a, &a) * sum(&b, &b)).sqrt()
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let below = |value: f64| values.iter().filter(|other| **other < value).count() as f64;
    let equal = |value: f64| values.iter().filter(|other| **other == value).count() as f64;
    values.iter().map(|&value| below(value) + 0.5 * (equal(value) - 1.0)).collect()
}

#[cfg(test)]
mod tests {
    use lumistack_display::Variation;

    use super::*;

    #[test]
    fn more_of_everything_is_predicted_to_be_better() {
        let base = Display::uniform([105, 66], 4.5, [3, 3], [20.0, 20.0], &[-40.0, 40.0], 2);
        let with = |change: Variation| predicted_db(&change.applied_to(&base).unwrap());
        let plain = with(Variation::default());
        assert!(with(Variation { frames: Some(4), ..Variation::default() }) > plain + 1.0);
        assert!(with(Variation { layers: Some(3), ..Variation::default() }) > plain + 1.0);
        assert!(with(Variation { brightness: Some(0.2), ..Variation::default() }) > plain + 1.0);
        let [freedom, dark, detail] = features(&base);
        assert!((freedom - (4.0f64 / 9.0).log2()).abs() < 1e-12 && dark == 0.0 && (0.0..=1.0).contains(&detail));
    }

    #[test]
    fn ranks_correlate_as_they_should() {
        let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found}");
        close(rank_correlation(&[1.0, 2.0, 3.0], &[10.0, 20.0, 1e9]), 1.0);
        close(rank_correlation(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), -1.0);
        // Without equal values, the correlation is 1 − 6 Σ d²/(n (n² − 1)), where d is the
        // difference of the ranks of each of n pairs.
        close(rank_correlation(&[1.0, 2.0, 3.0, 4.0], &[2.0, 1.0, 4.0, 3.0]), 1.0 - 6.0 * 4.0 / 60.0);
        close(rank_correlation(&[1.0, 1.0, 2.0], &[5.0, 5.0, 7.0]), 1.0);
        assert!(rank_correlation(&[1.0, 1.0], &[1.0, 2.0]).is_nan());
    }
}
