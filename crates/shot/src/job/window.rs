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
    /// not lie on both sides of the display plane. Otherwise acts as [`Compress`](Self::Compress),
    /// with two differences. The window stays if the job gives its numbers (`from = "given"`), or
    /// if the job or the camera states a focus distance. The depth scale stays if the job sets it.
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
/// the viewer is also ignored for depth fitting and exposure.
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
/// the viewer is also ignored for depth fitting and exposure.
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
    /// from another side that shows clearly more.
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
    /// Checks the ranges of values, and that every key has an effect, which the parser does not
    /// check.
    pub fn check(&self) -> Result<(), ShotError> {
        if !(1e-3..=10.0).contains(&self.depth_scale) {
            let found = self.depth_scale.to_string();
            return Err(ShotError::job("window.depth_scale", "0.001 to 10", found));
        }
        if let Some(distance) = self.focus_distance
            && !(distance.is_finite() && distance > 0.0)
        {
            return Err(ShotError::job("window.focus_distance", "a finite distance above 0", distance.to_string()));
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
        self.check_use()
    }

    /// Checks that no key is set that another key makes useless.
    fn check_use(&self) -> Result<(), ShotError> {
        let from = match self.from {
            WindowFrom::Auto => "\"auto\"",
            WindowFrom::Camera => "\"camera\"",
            WindowFrom::Bounds => "\"bounds\"",
            WindowFrom::Given => "\"given\"",
        };
        let numbers = [
            ("centre", self.centre.is_some()),
            ("forward", self.forward.is_some()),
            ("up", self.up.is_some()),
            ("width", self.width.is_some()),
        ];
        if let Some((key, _)) = numbers.iter().find(|(_, is_set)| *is_set && self.from != WindowFrom::Given) {
            return Err(ShotError::job(format!("window.{key}"), "`window.from` = \"given\"", from));
        }
        let of_cameras = [("camera", self.camera.is_some()), ("focus_distance", self.focus_distance.is_some())];
        for (key, _) in of_cameras.iter().filter(|(_, is_set)| *is_set) {
            let fail = |expected: &str, found: &str| Err(ShotError::job(format!("window.{key}"), expected, found));
            if !matches!(self.from, WindowFrom::Auto | WindowFrom::Camera) {
                return fail("`window.from` = \"auto\" or \"camera\"", from);
            }
            if self.look_from.is_some() {
                return fail("no `window.look_from`, with which no camera is used", "both");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_without_effect_are_refused() {
        let base = WindowJob::default;
        let check = |job: WindowJob| job.check().map_err(|error| error.to_string());
        let given = WindowJob { from: WindowFrom::Given, centre: Some([0.0; 3]), width: Some(1.0), ..base() };
        assert_eq!(check(given.clone()), Ok(()));
        assert_eq!(check(WindowJob { from: WindowFrom::Camera, focus_distance: Some(2.0), ..base() }), Ok(()));
        for (job, message) in [
            (
                WindowJob { width: Some(1.0), ..base() },
                "window.width: expected `window.from` = \"given\", found \"auto\"",
            ),
            (
                WindowJob { from: WindowFrom::Bounds, ..given.clone() },
                "window.centre: expected `window.from` = \"given\", found \"bounds\"",
            ),
            (
                WindowJob { focus_distance: Some(2.0), ..given },
                "window.focus_distance: expected `window.from` = \"auto\" or \"camera\", found \"given\"",
            ),
            (
                WindowJob { from: WindowFrom::Bounds, camera: Some("a".into()), ..base() },
                "window.camera: expected `window.from` = \"auto\" or \"camera\", found \"bounds\"",
            ),
            (
                WindowJob { look_from: Some([0.0; 2]), focus_distance: Some(2.0), ..base() },
                "window.focus_distance: expected no `window.look_from`",
            ),
        ] {
            let error = check(job).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
        for distance in [-1.0, 0.0, f32::NAN, f32::INFINITY] {
            let error = check(WindowJob { focus_distance: Some(distance), ..base() }).unwrap_err();
            assert!(error.contains("window.focus_distance: expected a finite distance above 0, found "), "{error}");
        }
    }
}
