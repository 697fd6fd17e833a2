//! Formation of an image from the layers of one frame.
//!
//! Let v_n be the value of layer n in frame m of M, at the ray's intersection. Let b_m be the value
//! of the backlight:
//!
//! ```text
//! attenuating    L̃ = (1/M) Σ_m b_m Π_n v_n               (eqs. 7 and 18)
//! additive       L̃ = (1/M) Σ_m (b_m + Σ_n v_n)           b_m = 0 for a uniform backlight
//! polarization   L̃ = (1/M) Σ_m b_m sin²(π/2 · Σ_n v_n)
//!                (Lanman et al., "Polarization Fields", SIGGRAPH Asia 2011)
//! ```

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The way in which the layers of one frame form an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Formation {
    /// Layers absorb light: a ray's value is the product of their transmittances.
    #[default]
    Attenuating,
    /// Layers emit light and are clear: a ray's value is the sum of their emissions. A uniform
    /// backlight adds nothing; a directional backlight adds its emission.
    Additive,
    /// Layers between one pair of crossed polarizers rotate the polarization: a ray's value is sin²
    /// of the sum of their rotations. A layer value of 1 is a rotation by 90°.
    Polarization,
}

impl Formation {
    /// Returns the value of a layer that has no effect on light: 1 if layers absorb, otherwise 0.
    #[inline]
    pub fn neutral(self) -> f32 {
        match self {
            Self::Attenuating => 1.0,
            Self::Additive | Self::Polarization => 0.0,
        }
    }
}
