//! Interpolation of a layer's pixels along a ray.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a ray reads a layer between pixel centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// The pixel at the intersection: floor(ξ + ½).
    #[default]
    Nearest,
    /// A mixture of the four pixels around the intersection.
    Bilinear,
}

/// The value that a ray reads if it misses a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Missing {
    /// The ray has weight 0.
    #[default]
    Drop,
    /// The ray reads the value of a missing layer:
    /// [`Formation::neutral`](crate::Formation::neutral).
    Clear,
}
