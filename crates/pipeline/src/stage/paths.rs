//! Chooses the number of paths per pixel and view, from the errors that noise and the display cause
//! in seen pictures. `samples.rs` measures these errors.

use serde::{Deserialize, Serialize};

/// Largest squared error from noise, as a fraction of the display's squared error: 6 % is 0.25 dB.
const NOISE_SHARE: f64 = 0.06;
/// Squared error below which a display is regarded as exact (50 dB). With a smaller error, the
/// number of paths does not rise further.
const LEAST_ERROR: f64 = 1e-5;
/// Maximum number of paths per pixel, summed over all views. Every view has at least one path.
const MOST_PATHS: usize = 3200;
/// Allowed numbers of paths, before [`MOST_PATHS`] limits the number. They are few, so a small
/// change of the display rarely changes the number. Views with another number of paths must be
/// rendered again.
const CHOICES: [u32; 12] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64];
/// Measured errors, and the number of paths that follows from them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Samples {
    /// Paths per pixel and view, at least 1.
    pub(crate) per_view: u32,
    /// V: the mean squared error that noise causes in the seen pictures, with one path per pixel
    /// and view.
    pub(crate) noise: f64,
    /// D: mean squared error of the seen pictures without noise.
    pub(crate) error: f64,
    /// True if more paths are needed than are allowed.
    pub(crate) limited: bool,
}

impl Samples {
    /// Chooses the number of paths for `views` views. `noise` is V, the mean squared error that
    /// noise causes with one path per pixel and view.
    pub(crate) fn new(noise: f64, error: f64, views: usize) -> Self {
        let needed = noise / (NOISE_SHARE * error.max(LEAST_ERROR));
        let most = ((MOST_PATHS / views.max(1)) as u32).max(1);
        let enough = CHOICES.into_iter().find(|&choice| f64::from(choice) >= needed);
        let per_view = enough.unwrap_or(CHOICES[CHOICES.len() - 1]).min(most);
        Self { per_view, noise, error, limited: enough.is_none_or(|enough| enough > most) }
    }

    /// Explains the number of paths in the report.
    pub(crate) fn reason(&self) -> String {
        let share = 100.0 * self.noise / f64::from(self.per_view) / self.error.max(LEAST_ERROR);
        let limit = if self.limited {
            format!(
                "; more paths would exceed the limit of {} per pixel and view, or of {MOST_PATHS} per pixel over all views",
                CHOICES[CHOICES.len() - 1]
            )
        } else {
            String::new()
        };
        let base = if self.error < LEAST_ERROR {
            "the squared error at 50 dB (the display's own error is smaller)"
        } else {
            "the display's own squared error"
        };
        format!("noise adds about {share:.1} % to {base}{limit}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_follow_from_noise_and_error_within_limits() {
        let choose = |noise, error, views| Samples::new(noise, error, views);
        // Without noise one path is enough, for any error of the display.
        assert_eq!((choose(0.0, 1e-3, 169).per_view, choose(0.0, 0.0, 169).limited), (1, false));
        // The equation n = V / (η D) of `samples.rs` gives 4.9 paths, which is rounded up to the
        // next allowed number, 6.
        assert_eq!(choose(4.9 * NOISE_SHARE * 2e-3, 2e-3, 169).per_view, 6);
        // A display that is regarded as exact needs as many paths as a display with the error
        // `LEAST_ERROR`.
        assert_eq!(choose(2.9 * NOISE_SHARE * LEAST_ERROR, -1e-7, 169).per_view, 3);
        let limited = choose(1.0, 1e-3, 169);
        assert_eq!((limited.per_view, limited.limited), (18, true));
        assert_eq!(choose(1.0, 1e-3, 4000).per_view, 1);
        assert!(limited.reason().contains("3200"), "{}", limited.reason());
    }
}
