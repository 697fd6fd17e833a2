//! The light source behind the layers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Lens, Panel, Transfer};

/// The light behind the layers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase", tag = "kind")]
#[allow(clippy::large_enum_variant, reason = "a display has one")]
pub enum Backlight {
    /// Unit radiance in all directions.
    #[default]
    Uniform,
    /// Lenslets in front of a panel, which emit a light field of low resolution.
    Lenslets(LensletBacklight),
}

/// A lenslet grid in front of a panel: a light field emitter of low resolution (section 3.3 of the
/// paper).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LensletBacklight {
    /// Signed distance of the lenslets from z = 0, millimetres. No layer may be behind them.
    pub d_mm: f64,
    /// [columns, rows] of lenslets.
    pub lenslets: [usize; 2],
    /// Lenslet pitch, millimetres.
    pub pitch_mm: f64,
    /// [horizontal, vertical] full angle over which the bins spread, degrees.
    pub fov_deg: [f64; 2],
    /// [horizontal, vertical] number of angular bins.
    pub views: [usize; 2],
    /// [x, y] of the grid's centre, millimetres.
    #[serde(default)]
    pub offset_mm: [f64; 2],
    /// Emission of the darkest state relative to the brightest state, 0 to less than 1: the lower
    /// bound of the optimized emission.
    #[serde(default)]
    pub black_level: f64,
    /// Value that a ray outside the bins reads.
    #[serde(default)]
    pub outside_bins: OutsideBins,
    /// Transfer function from linear values to the code values of the panel behind the lenslets.
    #[serde(default)]
    pub transfer: Transfer,
    /// [columns, rows] of the panel behind the lenslets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_resolution: Option<[usize; 2]>,
    /// Pitch of the panel behind the lenslets, millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_pitch_mm: Option<f64>,
    /// Calibration of the panel behind the lenslets; patterns do not depend on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel: Option<Panel>,
    /// Measured data of the real lens array; patterns do not depend on them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens: Option<Lens>,
}

impl LensletBacklight {
    /// Makes a centred grid of [columns, rows] lenslets of pitch `pitch_mm`, at distance `d_mm`. It
    /// has [horizontal, vertical] bins `views` over the full angles `fov_deg`, and is dark outside
    /// the bins.
    pub fn new(d_mm: f64, lenslets: [usize; 2], pitch_mm: f64, views: [usize; 2], fov_deg: [f64; 2]) -> Self {
        Self {
            d_mm,
            lenslets,
            pitch_mm,
            fov_deg,
            views,
            offset_mm: [0.0; 2],
            black_level: 0.0,
            outside_bins: OutsideBins::default(),
            transfer: Transfer::default(),
            panel_resolution: None,
            panel_pitch_mm: None,
            panel: None,
            lens: None,
        }
    }

    /// Returns the [darkest, brightest] emission that the solver may use.
    pub fn range(&self) -> [f32; 2] {
        [self.black_level as f32, 1.0]
    }

    /// Converts an emission to the input of the transfer function: 0 for the panel's darkest state,
    /// 1 for its brightest. Emission outside this range is clamped; NaN becomes 0.
    pub fn drive(&self, value: f32) -> f32 {
        let drive = (f64::from(value) - self.black_level) / (1.0 - self.black_level);
        if drive.is_nan() { 0.0 } else { drive.clamp(0.0, 1.0) as f32 }
    }
}

/// The emission that a ray reads outside of a lenslet's angular bins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OutsideBins {
    /// The ray reads 0.
    #[default]
    Dark,
    /// The ray reads a bin of the neighbouring lenslet, as behind a real lens array.
    Repeat,
}
