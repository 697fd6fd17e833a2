//! `[light]`: light, exposure and tone curve.

use std::path::PathBuf;

use lumistack_core::path_text::PathText;
use lumistack_core::tone::ToneCurve;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::background::Background;
use crate::error::ShotError;

/// Light, exposure and tone curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LightJob {
    /// Environment map, a Radiance HDR or EXR file, that replaces the scene's environment.
    #[serde(skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub environment: Option<PathBuf>,
    /// Factor on the environment's radiance.
    pub environment_strength: f32,
    /// Rotation of the environment about the scene's up axis, degrees. A positive angle turns the
    /// environment to the left, as seen by a viewer who looks straight ahead.
    pub environment_rotation_deg: f64,
    /// Background where a ray misses every surface: `environment`, or a colour, which does not
    /// light surfaces.
    pub background: Background,
    /// Illuminate the meshes with the scene's splats instead of an environment.
    pub from_splats: bool,
    /// Add the studio light to a scene with meshes, if the scene has no light, or if its lamps
    /// leave the visible surfaces dark.
    pub automatic: bool,
    /// Show the scene file's light sources that have a surface. Without this key the scene file
    /// decides. If the file does not decide, these light sources are invisible.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visible: Option<bool>,
    /// Exposure in stops. It is added to the automatic exposure, or applied to scene radiance if
    /// `automatic_exposure` is off.
    pub exposure_ev: f64,
    /// Choose the exposure from the brightness of all views together.
    pub automatic_exposure: bool,
    /// Curve from exposed radiance to shown values, the same for all views.
    pub tone: Tone,
}

/// Tone curve of all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Tone {
    /// `linear` if almost nothing is brighter than white, or if the scene has splats. Otherwise
    /// `khronos-neutral`.
    #[default]
    Auto,
    /// Clips values above white.
    Linear,
    /// Khronos PBR Neutral.
    KhronosNeutral,
    /// AgX without a creative grade.
    Agx,
}

impl From<ToneCurve> for Tone {
    fn from(curve: ToneCurve) -> Self {
        match curve {
            ToneCurve::Linear => Self::Linear,
            ToneCurve::KhronosNeutral => Self::KhronosNeutral,
            ToneCurve::Agx => Self::Agx,
        }
    }
}

impl Default for LightJob {
    fn default() -> Self {
        Self {
            environment: None,
            environment_strength: 1.0,
            environment_rotation_deg: 0.0,
            background: Background::default(),
            from_splats: false,
            automatic: true,
            visible: None,
            exposure_ev: 0.0,
            automatic_exposure: true,
            tone: Tone::Auto,
        }
    }
}

impl LightJob {
    /// Checks the ranges of values, which the parser does not check.
    pub fn check(&self) -> Result<(), ShotError> {
        let fail = |key: &str, expected: &str, found: String| Err(ShotError::job(key, expected, found));
        if !(self.exposure_ev.is_finite() && self.exposure_ev.abs() <= 100.0) {
            return fail("light.exposure_ev", "-100 to 100", self.exposure_ev.to_string());
        }
        if !(self.environment_strength.is_finite() && self.environment_strength >= 0.0) {
            return fail("light.environment_strength", "a number ≥ 0", self.environment_strength.to_string());
        }
        if !(self.environment_rotation_deg.is_finite() && self.environment_rotation_deg.abs() <= 360.0) {
            let found = self.environment_rotation_deg.to_string();
            return fail("light.environment_rotation_deg", "-360 to 360", found);
        }
        if self.from_splats && self.environment.is_some() {
            return fail(
                "light.from_splats",
                "false, or no `light.environment`",
                "true with `light.environment`".into(),
            );
        }
        Ok(())
    }
}
