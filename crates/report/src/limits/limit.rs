//! One limit.

use serde_json::Value;

/// One effect that limits the result.
#[derive(Clone, Debug)]
pub(crate) struct Limit {
    /// "Depth".
    pub(crate) name: &'static str,
    /// Gain of psnr_view without it, dB; `None` if one run cannot determine it.
    pub(crate) decibels: Option<f64>,
    /// The measurement as text.
    pub(crate) text: String,
    /// The numbers behind it.
    pub(crate) figures: Value,
}

/// Gain in dB when a fraction of the squared error is removed.
pub(super) fn without(share: f64) -> f64 {
    -10.0 * (1.0 - share).log10()
}
