//! Dims samples that are brighter than a limit, and adds up the light that is removed.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use lumistack_core::colour::luminance;

use crate::settings::Settings;

/// Removed light is added up in whole numbers, in units of the limit divided by this number. Whole
/// numbers add up to the same sum in any order.
const PARTS: f64 = 65536.0;

/// Light that a limit removed from one view.
#[derive(Default)]
pub(crate) struct Clamped {
    samples: AtomicU64,
    /// Removed luminance, in units of the limit divided by [`PARTS`].
    removed: AtomicU64,
}

impl Clamped {
    /// Returns the sample, scaled so that no channel exceeds the limit. A sample that is not finite
    /// stays as it is.
    pub(crate) fn dim(&self, radiance: Vec3, limit: f32) -> Vec3 {
        let largest = radiance.max_element();
        if largest <= limit || !radiance.is_finite() {
            return radiance;
        }
        let kept = radiance * (limit / largest);
        let removed = f64::from(luminance((radiance - kept).to_array()) / limit);
        self.samples.fetch_add(1, Ordering::Relaxed);
        self.removed.fetch_add((removed * PARTS) as u64, Ordering::Relaxed);
        kept
    }

    /// Returns the warning about one view; `None` if the limit dimmed no sample. `pixels` yields
    /// the radiance of the view's pixels after the limit.
    pub(crate) fn message(
        &self,
        settings: &Settings,
        pixels: impl ExactSizeIterator<Item = [f32; 3]>,
    ) -> Option<String> {
        let samples = self.samples.load(Ordering::Relaxed);
        let limit = settings.clamp.filter(|_| samples > 0)?;
        let removed = self.removed.load(Ordering::Relaxed) as f64 / PARTS * f64::from(limit);
        let all = pixels.len() as f64 * f64::from(settings.samples);
        let kept: f64 = pixels.map(|rgb| f64::from(luminance(rgb))).sum();
        let kept = kept * f64::from(settings.samples);
        Some(format!(
            "the limit of clamp, {limit}, dims {samples} of {all} samples, which removes {:.3} % of the light",
            100.0 * removed / (removed + kept)
        ))
    }
}
