//! A limit of the result.

use serde_json::Value;

/// One effect that limits the result.
#[derive(Clone, Debug)]
pub(crate) struct Limit {
    /// Name of the effect, such as "Depth".
    pub(crate) name: &'static str,
    /// Gain of psnr_view if the effect were absent, dB; `None` if one run cannot determine it.
    pub(crate) decibels: Option<f64>,
    /// The measurement as text.
    pub(crate) text: String,
    /// The numbers of the measurement.
    pub(crate) figures: Value,
}

/// Returns the gain in dB if a fraction of the squared error is removed.
pub(super) fn without(share: f64) -> f64 {
    -10.0 * (1.0 - share).log10()
}
