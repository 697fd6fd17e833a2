//! `[window]`: the place of the display in the scene.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};

use crate::error::ShotError;

/// The place of the display in the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WindowJob {
    /// `camera`: the plane of focus of the camera that `camera` names, or of the first camera.
    /// `bounds`: the framed scene. `given`: `centre`, `forward`, `up` and `width`. `auto`: as
    /// `camera` if the job names a camera, or if the file has one and `look_from` is not set;
    /// otherwise as `bounds`.
    pub from: WindowFrom,
    /// Name of the camera, or its number from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Azimuth and elevation of the viewer for whom the scene is framed, degrees. [0, 0] is the
    /// front, +z; azimuth goes to the viewer's right, elevation up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub look_from: Option<[f64; 2]>,
    /// Largest distance in front of the window at which content is visible.
    pub near: Near,
    /// Distance of the camera's plane of focus, scene units; it replaces the file's value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_distance: Option<f32>,
    /// `given`: centre in the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centre: Option<[f64; 3]>,
    /// `given`: viewing direction, into the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forward: Option<[f64; 3]>,
    /// `given`: upward direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// `given`: width in scene units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<f64>,
    /// Move the window, or also compress depth, so that the scene lies in the display's depth of
    /// field.
    pub fit_depth: FitDepth,
    /// Factor on the parallax between views, and thereby on depth: views are traced at scaled
    /// slopes. The central view stays unchanged.
    pub depth_scale: f64,
}

/// The ways to bring the scene into the display's depth of field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FitDepth {
    /// Changes nothing in three cases: in a sweep; if the scene fits; if the depth of field does
    /// not lie on both sides of the display. Otherwise acts as [`Compress`](Self::Compress), with
    /// two differences. The window stays if numbers or a focus distance of its camera place it.
    /// The depth scale stays if the job sets it.
    #[default]
    Auto,
    /// Neither window nor depth changes.
    Off,
    /// The window moves along its normal.
    Move,
    /// The window moves. If the scene still does not fit, depth is compressed.
    Compress,
}

/// Largest distance in front of the window at which content is visible. Content that is nearer to
/// the viewer is also ignored for framing and exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Near {
    /// If a camera determines the window, the camera's near plane. If numbers determine the window
    /// (`given`), the distance at which the display shows hardly any detail. Otherwise the whole
    /// framed scene is visible.
    #[default]
    Auto,
    /// All content in front of the window is visible.
    Off,
    /// Distance in front of the window, scene units; below 0 behind the window.
    At(f64),
}

/// Largest distance in front of the window at which content is visible. Content that is nearer to
/// the viewer is also ignored for framing and exposure.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
enum NearText {
    /// Distance in front of the window, scene units; below 0 behind the window.
    At(f64),
    /// `off`: all content in front of the window is visible. `auto`: if a camera determines the
    /// window, the camera's near plane. For a `given` window, the distance at which the display
    /// shows hardly any detail. Otherwise as `off`.
    #[schemars(extend("enum" = ["auto", "off"]))]
    Word(String),
}

impl JsonSchema for Near {
    fn schema_name() -> Cow<'static, str> {
        "Near".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        NearText::json_schema(generator)
    }
}

impl std::str::FromStr for Near {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse::<f64>()) {
            ("auto", _) => Ok(Self::Auto),
            ("off", _) => Ok(Self::Off),
            (_, Ok(near)) if near.is_finite() => Ok(Self::At(near)),
            _ => Err(format!("expected auto, off or a distance in scene units, found {text}")),
        }
    }
}

impl Serialize for Near {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => NearText::Word("auto".into()),
            Self::Off => NearText::Word("off".into()),
            Self::At(near) => NearText::At(*near),
        }
        .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Near {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match NearText::deserialize(deserializer) {
            Ok(NearText::At(near)) => Ok(Self::At(near)),
            Ok(NearText::Word(word)) => word.parse().map_err(serde::de::Error::custom),
            Err(_) => Err(serde::de::Error::custom("expected \"auto\", \"off\" or a distance in scene units")),
        }
    }
}

/// Source of the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WindowFrom {
    /// As `camera` if the job names a camera, or if the file has one and `look_from` is not set.
    /// Otherwise as `bounds`.
    #[default]
    Auto,
    /// The camera that the key `camera` names, or the first camera.
    Camera,
    /// The scene's bounds, seen from `look_from`. Without that key they are seen from the front, or
    /// from another side if the front shows hardly anything.
    Bounds,
    /// The keys `centre`, `forward`, `up` and `width`.
    Given,
}

impl Default for WindowJob {
    fn default() -> Self {
        Self {
            from: WindowFrom::Auto,
            camera: None,
            look_from: None,
            near: Near::Auto,
            focus_distance: None,
            centre: None,
            forward: None,
            up: None,
            width: None,
            fit_depth: FitDepth::Auto,
            depth_scale: 1.0,
        }
    }
}

impl WindowJob {
    /// Checks the ranges of values, which the parser does not check.
    pub fn check(&self) -> Result<(), ShotError> {
        if !(1e-3..=10.0).contains(&self.depth_scale) {
            let found = self.depth_scale.to_string();
            return Err(ShotError::job("window.depth_scale", "0.001 to 10", found));
        }
        if let Near::At(near) = self.near
            && !near.is_finite()
        {
            return Err(ShotError::job("window.near", "a finite distance", near.to_string()));
        }
        if let Some([azimuth, elevation]) = self.look_from {
            let fail = |expected: &str, found: String| Err(ShotError::job("window.look_from", expected, found));
            if !((-360.0..=360.0).contains(&azimuth) && (-90.0..=90.0).contains(&elevation)) {
                let expected = "an azimuth of -360 to 360 and an elevation of -90 to 90 degrees";
                return fail(expected, format!("{azimuth} and {elevation}"));
            }
            if self.camera.is_some() {
                return fail("either `look_from` or `camera`", "both".into());
            }
            if !matches!(self.from, WindowFrom::Auto | WindowFrom::Bounds) {
                let found = if self.from == WindowFrom::Given { "\"given\"" } else { "\"camera\"" };
                return fail("`window.from` = \"auto\" or \"bounds\"", found.into());
            }
        }
        Ok(())
    }
}
