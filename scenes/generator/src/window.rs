//! The display's window, the camera whose picture is the window, and positions of objects by their
//! depth on the display.
//!
//! Display axes are x to the right, y up, z to the viewer. The window is z = 0 with its centre at
//! the origin. In a scene with a floor, the camera looks down by `pitch_rad`, so that parallel
//! views show the floor from above. `world_from_display` is the rotation by -`pitch_rad` about x.
//! World y is up.

use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};

use crate::gltf_document::{Document, rounded};

/// Width of the window in metres: 840 pixels of 0.5655 mm.
pub(crate) const WINDOW_WIDTH_M: f64 = 840.0 * 0.5655e-3;
/// Height of the window in metres: 525 pixels of 0.5655 mm.
pub(crate) const WINDOW_HEIGHT_M: f64 = 525.0 * 0.5655e-3;

/// The window's orientation in the world, and its camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    /// Downward tilt of the camera in radians, 0 for a camera that looks along world -z.
    pub(crate) pitch_rad: f64,
    /// Distance from the camera to the window in metres.
    pub(crate) focus_distance_m: f64,
}

impl Window {
    /// Returns the rotation that takes display axes to world axes.
    pub(crate) fn world_from_display(&self) -> DMat3 {
        DMat3::from_rotation_x(-self.pitch_rad)
    }

    /// Returns the world point that is `y_m` above the window's centre, `x_m` to the right of the
    /// centre, and that a display shows at the depth `depth_m`. This depth is above 0 in front of
    /// the window.
    pub(crate) fn at(&self, x_m: f64, y_m: f64, depth_m: f64) -> DVec3 {
        let (sin, cos) = self.pitch_rad.sin_cos();
        DVec3::new(x_m, y_m, (depth_m - y_m * sin) / cos)
    }

    /// Adds the camera and its node; returns the node's index.
    pub(crate) fn add_camera(&self, document: &mut Document) -> usize {
        let yfov_rad = 2.0 * (0.5 * WINDOW_HEIGHT_M / self.focus_distance_m).atan();
        let camera = document.add_camera(json!({
            "name": "window camera",
            "type": "perspective",
            "perspective": {
                "aspectRatio": rounded(WINDOW_WIDTH_M / WINDOW_HEIGHT_M),
                "yfov": rounded(yfov_rad),
                "znear": 0.05,
                "zfar": 20.0
            },
            "extras": { "lumistack": { "focus_distance": rounded(self.focus_distance_m) } }
        }));
        let eye = self.world_from_display() * DVec3::new(0.0, 0.0, self.focus_distance_m);
        let mut node = node_at("window camera", eye, DQuat::from_rotation_x(-self.pitch_rad));
        node["camera"] = json!(camera);
        document.add_node(node)
    }
}

/// Returns a node with a translation in metres and a rotation.
pub(crate) fn node_at(name: &str, translation: DVec3, rotation: DQuat) -> Value {
    let mut node = json!({ "name": name });
    if translation != DVec3::ZERO {
        node["translation"] = json!(translation.to_array().map(rounded));
    }
    if rotation != DQuat::IDENTITY {
        node["rotation"] = json!(rotation.normalize().to_array().map(rounded));
    }
    node
}

/// Returns a node's scale by the same factor on every axis.
pub(crate) fn uniform_scale(factor: f64) -> Value {
    json!([rounded(factor), rounded(factor), rounded(factor)])
}
