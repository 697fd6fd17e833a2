//! Interpolation of a layer's pixels along a ray.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The value that a ray reads between the centres of a layer's pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// The value of the pixel that the ray hits.
    #[default]
    Nearest,
    /// A mean of the values of the four pixels around the intersection. Nearer pixels have larger
    /// weights.
    Bilinear,
}

/// The value that a ray reads if it misses a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Missing {
    /// The ray has weight 0.
    #[default]
    Drop,
    /// The layer has no effect on the ray, which reads the value
    /// [`Formation::neutral`](crate::Formation::neutral): 1 for attenuating layers, otherwise 0.
    Clear,
}
