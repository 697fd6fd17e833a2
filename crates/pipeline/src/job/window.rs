//! `[window]`: where the display stands in the scene.

use serde::{Deserialize, Serialize};

use crate::error::PipelineError;

/// Where the display stands in the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WindowJob {
    /// `auto`: the first camera's plane of focus, or framed on the bounds when there is none; `camera`; `bounds`; `given`.
    pub from: WindowFrom,
    /// Name or number of the camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitDepth {
    /// The window stays where it is.
    #[default]
    Off,
    /// The window moves along its normal.
    Move,
    /// It moves, and depth is compressed where it still does not fit.
    Compress,
}

/// How the window is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WindowFrom {
    /// A camera where the file has one, otherwise the bounds.
    #[default]
    Auto,
    /// A camera.
    Camera,
    /// The scene's bounds, seen from the front.
    Bounds,
    /// `centre`, `forward`, `up`, `width`.
    Given,
}

impl Default for WindowJob {
    fn default() -> Self {
        Self {
            from: WindowFrom::Auto,
            camera: None,
            focus_distance: None,
            centre: None,
            forward: None,
            up: None,
            width: None,
            fit_depth: FitDepth::Off,
            depth_scale: 1.0,
        }
    }
}

impl WindowJob {
    /// Checks values that no parser checks.
    pub(super) fn check(&self) -> Result<(), PipelineError> {
        if !(1e-3..=10.0).contains(&self.depth_scale) {
            let found = self.depth_scale.to_string();
            return Err(PipelineError::value("job", "window.depth_scale", "0.001 to 10", found));
        }
        Ok(())
    }
}
