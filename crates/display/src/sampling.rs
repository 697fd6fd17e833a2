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
    /// A mixture of the four around it.
    Bilinear,
}

/// The transmittance that a ray reads where it leaves a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Missing {
    /// The ray has weight 0.
    #[default]
    Drop,
    /// The value of a layer that is not there: [`Formation::neutral`](crate::Formation::neutral).
    Clear,
}
