//! The choice of a number of paths per pixel and view, by the errors that noise and display cause
//! in seen pictures. `samples.rs` measures both.

use serde::{Deserialize, Serialize};

/// Share of a display's squared error that noise may add: 0.25 dB.
const NOISE_SHARE: f64 = 0.06;
/// Squared errors below this one need no more paths: 50 dB.
const LEAST_ERROR: f64 = 1e-5;
/// Maximum number of paths per pixel, of all views together.
const MOST_PATHS: usize = 3200;
/// Numbers of paths to choose from. Few choices keep rendered views valid if a display changes a
/// little.
const CHOICES: [u32; 12] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64];
/// Measured errors, and the number of paths that follows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Samples {
    /// Paths per pixel and view, ≥ 1.
    pub(crate) per_view: u32,
    /// V: mean squared error in the seen pictures from the noise of one path per pixel and view.
    pub(crate) noise: f64,
    /// D: mean squared error of the seen pictures without noise.
    pub(crate) error: f64,
    /// True if more paths were needed than are allowed.
    pub(crate) limited: bool,
}

impl Samples {
    pub(crate) fn new(noise: f64, error: f64, views: usize) -> Self {
        let needed = noise / (NOISE_SHARE * error.max(LEAST_ERROR));
        let most = ((MOST_PATHS / views.max(1)) as u32).max(1);
        let enough = CHOICES.into_iter().find(|&choice| f64::from(choice) >= needed);
        let choice = enough.unwrap_or(CHOICES[CHOICES.len() - 1]);
        Self { per_view: choice.min(most), noise, error, limited: enough.is_none_or(|enough| enough > most) }
    }

    /// Explains the number in the report.
    pub(crate) fn reason(&self) -> String {
        let share = 100.0 * self.noise / f64::from(self.per_view) / self.error.max(LEAST_ERROR);
        let limit = if self.limited {
            format!("; all views together take at most {MOST_PATHS} paths per pixel")
        } else {
            String::new()
        };
        format!("noise adds about {share:.1} % to the display's own squared error{limit}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_follow_from_noise_and_error_within_limits() {
        let choose = |noise, error, views| Samples::new(noise, error, views);
        // without noise one path is enough, however good the display is
        assert_eq!((choose(0.0, 1e-3, 169).per_view, choose(0.0, 0.0, 169).limited), (1, false));
        // n = V / (η D) = 5, and the next choice
        assert_eq!(choose(4.9 * NOISE_SHARE * 2e-3, 2e-3, 169).per_view, 6);
        // invisible errors need no paths
        assert_eq!(choose(2.9 * NOISE_SHARE * LEAST_ERROR, -1e-7, 169).per_view, 3);
        let limited = choose(1.0, 1e-3, 169);
        assert_eq!((limited.per_view, limited.limited), (18, true));
        assert_eq!(choose(1.0, 1e-3, 4000).per_view, 1);
        assert!(limited.reason().contains("3200"), "{}", limited.reason());
    }
}
