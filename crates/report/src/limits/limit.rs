//! One limit.

use serde_json::Value;

/// One thing that keeps the result from being better.
#[derive(Clone, Debug)]
pub(crate) struct Limit {
    /// "Depth".
    pub(crate) name: &'static str,
    /// How much better psnr_view would be without it; `None` where one run cannot decide.
    pub(crate) decibels: Option<f64>,
    /// The measurement, in plain words.
    pub(crate) text: String,
    /// The numbers behind it.
    pub(crate) figures: Value,
}

/// dB that taking a share of the squared error away gives.
pub(super) fn without(share: f64) -> f64 {
    -10.0 * (1.0 - share).log10()
}
