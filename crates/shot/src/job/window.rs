//! `[window]`: where the display stands in the scene.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};

use crate::error::ShotError;

/// Where the display stands in the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WindowJob {
    /// `auto`: the first camera's plane of focus, or framed on the bounds when there is none; `camera`; `bounds`; `given`.
    pub from: WindowFrom,
    /// Name or number of the camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Azimuth and elevation from which a scene is framed, degrees: [0, 0] from the front, +z; azimuth goes to the viewer's right, elevation up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub look_from: Option<[f64; 2]>,
    /// Where what is seen begins.
    pub near: Near,
    /// Distance of the camera's plane of focus, scene units, instead of the file's.
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
    /// Whether the window is moved, or depth compressed as well, so that the scene lies in the display's depth of field.
    pub fit_depth: FitDepth,
    /// Factor on the parallax between views, and so on depth: views are traced at slopes this much smaller. The central view stays.
    pub depth_scale: f64,
}

/// How the scene is brought into the display's depth of field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FitDepth {
    /// Nothing where the scene fits. Else as [`Compress`](Self::Compress), but a window whose place somebody chose stays there and depth is compressed about it;
    /// with a depth scale that somebody chose the window moves alone.
    #[default]
    Auto,
    /// The window stays where it is, and depth as it is.
    Off,
    /// The window moves along its normal.
    Move,
    /// It moves, and depth is compressed where it still does not fit.
    Compress,
}

/// Where what is seen begins: nothing nearer to the viewer is seen, nor counts for framing or exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Near {
    /// A camera's near plane; before the four keys of a place, where the display can show next to nothing any more; else everything that is framed is seen.
    #[default]
    Auto,
    /// Everything before the window is seen.
    Off,
    /// This far before the window, scene units; below 0 behind it.
    At(f64),
}

/// How files write it.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
enum NearText {
    /// This far before the window, scene units; below 0 behind it.
    At(f64),
    /// `auto` or `off`.
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

/// How the window is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WindowFrom {
    /// A camera where the file has one, otherwise the bounds.
    #[default]
    Auto,
    /// A camera.
    Camera,
    /// The scene's bounds, seen from `look_from`, else from the front or, where that shows next to nothing, from where more is seen.
    Bounds,
    /// `centre`, `forward`, `up`, `width`.
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
    /// Checks values that no parser checks.
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
                return fail("`from` \"auto\" or \"bounds\", which frame the scene", "another".into());
            }
        }
        Ok(())
    }
}
