//! Tests of Monte Carlo results. Each takes its false-alarm rate: the probability that it fails
//! although the code is right.
//!
//! Two-sided z-test of a mean: z = (x̄ − μ) / (s/√n), rejected if P(|Z| > |z|) < false_alarm_rate.
//! Pearson's chi-square test: X² = Σ (O − E)²/E over cells, rejected if
//! P(χ²_(cells−1) > X²) < false_alarm_rate.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

/// The usual false-alarm rate: with 300 such tests, about one seed in 300 makes a test fail. Seeds
/// are fixed, so a test that passed keeps passing until the code changes.
pub const FALSE_ALARM_RATE: f64 = 1e-5;

/// Cells of a chi-square test with a smaller expected count are pooled: with small counts the
/// statistic does not follow the chi-square distribution.
const LEAST_EXPECTED: f64 = 8.0;

/// Mean and standard error of independent samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Mean x̄ of the samples.
    pub value: f64,
    /// Standard error s/√n of the mean; 0 for a single sample.
    pub standard_error: f64,
}

impl Mean {
    /// Returns the mean of independent samples.
    pub fn of(samples: impl IntoIterator<Item = f64>) -> Self {
        // Welford's recurrence sums the squares without loss of precision
        let (mut count, mut mean, mut squares) = (0.0, 0.0, 0.0);
        for sample in samples {
            count += 1.0;
            let before = sample - mean;
            mean += before / count;
            squares += before * (sample - mean);
        }
        let standard_error = if count > 1.0 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
        Self { value: mean, standard_error }
    }

    /// Returns the statistic z of the hypothesis that the mean is `expected`. An absolute
    /// systematic error of the code (rounding, an interpolated table) is allowed, so it is first
    /// subtracted from the difference.
    pub fn z(self, expected: f64, systematic_error: f64) -> f64 {
        let excess = ((self.value - expected).abs() - systematic_error).max(0.0);
        if excess == 0.0 { 0.0 } else { excess / self.standard_error }
    }

    /// Asserts that the mean is `expected`.
    ///
    /// # Panics
    /// If the mean differs from `expected` by more than the systematic error and chance at this
    /// false-alarm rate, or is not a number.
    #[track_caller]
    pub fn assert_is(self, expected: f64, systematic_error: f64, false_alarm_rate: f64) {
        let (z, limit) = (self.z(expected, systematic_error), z_limit(false_alarm_rate));
        assert!(
            self.value.is_finite() && z <= limit,
            "mean {} ± {} is not {expected} ± {systematic_error}: z = {z:.2}, limit {limit:.2}",
            self.value,
            self.standard_error
        );
    }

    /// Asserts that two independent means estimate the same value.
    ///
    /// # Panics
    /// As [`assert_is`](Self::assert_is).
    #[track_caller]
    pub fn assert_same(self, other: Self, systematic_error: f64, false_alarm_rate: f64) {
        let difference =
            Self { value: self.value - other.value, standard_error: self.standard_error.hypot(other.standard_error) };
        difference.assert_is(0.0, systematic_error, false_alarm_rate);
    }
}

/// Returns the |z| that chance alone exceeds with the probability `false_alarm_rate`.
pub fn z_limit(false_alarm_rate: f64) -> f64 {
    Normal::standard().inverse_cdf(1.0 - 0.5 * false_alarm_rate)
}

/// Returns the probability that chance alone moves counts at least as far from `expected` as
/// `observed` is. Both lists should have the same sum. Cells with small expected counts are pooled.
///
/// # Panics
/// If the lengths differ or fewer than two cells are left after pooling.
pub fn chi_square_p(observed: &[u64], expected: &[f64]) -> f64 {
    assert_eq!(observed.len(), expected.len(), "one expectation per cell");
    let (mut statistic, mut cells) = (0.0, 0);
    let (mut pooled_observed, mut pooled_expected) = (0.0, 0.0);
    let mut add = |observed: f64, expected: f64| {
        statistic += (observed - expected) * (observed - expected) / expected;
        cells += 1;
    };
    for (&observed, &expected) in observed.iter().zip(expected) {
        if expected >= LEAST_EXPECTED {
            add(observed as f64, expected);
        } else {
            pooled_observed += observed as f64;
            pooled_expected += expected;
        }
    }
    if pooled_expected >= LEAST_EXPECTED {
        add(pooled_observed, pooled_expected);
    } else if pooled_observed > 0.0 {
        // The pooled cells expect too few samples for a separate term. The same number is added to
        // the observed and the expected count, so that an excess of samples is still detected.
        add(pooled_observed + LEAST_EXPECTED, pooled_expected + LEAST_EXPECTED);
    }
    assert!(cells >= 2, "expected at least two cells after pooling, found {cells}");
    ChiSquared::new(f64::from(cells - 1)).map_or(f64::NAN, |distribution| distribution.sf(statistic))
}

/// Asserts that counts follow their expectation.
///
/// # Panics
/// If [`chi_square_p`] is below the false-alarm rate.
#[track_caller]
pub fn assert_counts(observed: &[u64], expected: &[f64], false_alarm_rate: f64) {
    let p = chi_square_p(observed, expected);
    assert!(p >= false_alarm_rate, "counts do not follow the density: p = {p:e} is below {false_alarm_rate:e}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::seed::Stream;

    #[test]
    fn a_true_mean_passes_and_a_false_one_fails() {
        let mut stream = Stream::new(1);
        let mean = Mean::of((0..10_000).map(|_| f64::from(stream.next_f32())));
        mean.assert_is(0.5, 0.0, FALSE_ALARM_RATE);
        assert!((mean.standard_error - 0.2887 / 100.0).abs() < 1e-4);
        assert!(mean.z(0.52, 0.0) > z_limit(FALSE_ALARM_RATE));
        assert!(mean.z(0.52, 0.02) < z_limit(FALSE_ALARM_RATE));
        assert!((z_limit(0.05) - 1.96).abs() < 1e-3);
    }

    #[test]
    fn uniform_counts_pass_and_bent_ones_fail() {
        let mut stream = Stream::new(2);
        let (mut even, mut bent) = ([0; 10], [0; 10]);
        for _ in 0..20_000 {
            let u = stream.next_f32();
            even[(u * 10.0) as usize] += 1;
            bent[(u.powf(1.05) * 10.0) as usize] += 1;
        }
        let expected = [2000.0; 10];
        assert_counts(&even, &expected, FALSE_ALARM_RATE);
        assert!(chi_square_p(&bent, &expected) < FALSE_ALARM_RATE);
        assert!(chi_square_p(&[100, 300], &[100.0, 0.0]) < FALSE_ALARM_RATE, "samples where none can be");
    }
}
