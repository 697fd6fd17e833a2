//! Cameras of a stage.

use glam::{Affine3A, DAffine3};
use lumistack_scene::{Camera, Projection};

use crate::package::CameraEntry;
use crate::placing::affine;

/// Converts a camera. The camera's name is the name of the prim, or the prim's path if other
/// cameras have the same name.
///
/// # Errors
/// The reason why the camera shows nothing, as a phrase after "it has".
pub(crate) fn camera(entry: &CameraEntry, all: &[CameraEntry], scene_from_stage: &DAffine3) -> Result<Camera, String> {
    let name = entry.place.rsplit('/').next().unwrap_or_default();
    let is_unique = all.iter().filter(|other| other.place.rsplit('/').next() == Some(name)).count() == 1;
    let positive = |value: f64, what: &str| match value.is_finite() && value > 0.0 {
        true => Ok(value as f32),
        false => Err(format!("{what} {value}")),
    };
    let [width, height] = [positive(entry.aperture[0], "the aperture")?, positive(entry.aperture[1], "the aperture")?];
    let projection = if entry.projection == "orthographic" {
        // an aperture is in tenths of the scene's unit, so the factor for its half is 0.05
        Projection::Orthographic { half_width: 0.05 * width, half_height: 0.05 * height }
    } else {
        let focal_length = positive(entry.focal_length, "the focal length")?;
        Projection::Perspective {
            vertical_fov_rad: 2.0 * (0.5 * height / focal_length).atan(),
            aspect: Some(width / height),
        }
    };
    let scene_from_camera: Affine3A = (*scene_from_stage * affine(&entry.matrix)).as_affine3a();
    let determinant = scene_from_camera.matrix3.determinant();
    if !scene_from_camera.is_finite() || determinant == 0.0 {
        return Err("a transform that is not finite or not invertible".into());
    }
    let focus = entry.focus_distance;
    Ok(Camera {
        name: if is_unique { name.to_owned() } else { entry.place.clone() },
        scene_from_camera,
        projection,
        focus_distance: (focus.is_finite() && focus > 0.0).then_some(focus as f32),
        near: entry.near.map(|near| near as f32),
    })
}
