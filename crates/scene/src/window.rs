//! The window: the display plane as a rectangle in the scene.
//!
//! Display space is right-handed, in millimetres. Its origin is the centre of the light field's
//! rectangle. x is right, y is up, and z is towards the viewer.

use glam::{DMat3, DQuat, DVec3, Vec3};
use thiserror::Error;

use crate::{Bounds, Camera, Projection};

/// A map x ↦ translation + scale · rotation · x without reflection: scale > 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Rotation as a unit quaternion.
    pub rotation: DQuat,
    /// Scale factor, > 0.
    pub scale: f64,
    /// The point to which the map moves the origin.
    pub translation: DVec3,
}

impl Similarity {
    /// Maps a point.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.translation + self.scale * (self.rotation * point)
    }

    /// Maps a vector: rotates and scales it.
    pub fn vector(&self, vector: DVec3) -> DVec3 {
        self.scale * (self.rotation * vector)
    }

    /// Applies the inverse of [`point`](Self::point).
    pub fn inverse_point(&self, point: DVec3) -> DVec3 {
        (self.rotation.inverse() * (point - self.translation)) / self.scale
    }
}

/// The position and size of the display in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Map from display space, in millimetres, to the scene.
    pub scene_from_display: Similarity,
    /// Width and height of the light field's rectangle in millimetres, both > 0.
    pub size_mm: [f64; 2],
    /// Near plane: z in display space, in millimetres, at which camera rays start, so that objects
    /// in front of this plane are not seen. With `None`, no plane hides objects in front of the
    /// window.
    pub near_mm: Option<f64>,
}

/// A window that cannot be placed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum WindowError {
    /// The camera defines no plane of finite size.
    #[error(
        "camera {name}: expected a focus distance and a field of view that make a window of finite size, found {found}"
    )]
    Camera {
        /// Name of the camera.
        name: String,
        /// Distance and width of the camera's window, in scene units.
        found: String,
    },
    /// The given numbers define no rectangle.
    #[error("window: expected {expected}, found {found}")]
    Given {
        /// The expected value or range.
        expected: &'static str,
        /// The value found.
        found: String,
    },
}

/// Difference between the sizes of a framed window and of the scene's bounds, as a fraction of the
/// size of the bounds.
const FRAMING_MARGIN: f64 = 0.02;

impl Window {
    /// Returns the window in the camera's plane of focus, as wide as the camera's frustum in this
    /// plane. Without a focus distance the plane passes through the centre of the scene's bounds.
    /// Objects in front of the camera's near plane are not seen.
    ///
    /// # Errors
    /// If the rectangle is empty, infinite or behind the camera.
    pub fn from_camera(camera: &Camera, bounds: Bounds, size_mm: [f64; 2]) -> Result<Self, WindowError> {
        let position = camera.scene_from_camera.translation.as_dvec3();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(
            camera.scene_from_camera.matrix3.x_axis.as_dvec3().normalize(),
            camera.scene_from_camera.matrix3.y_axis.as_dvec3().normalize(),
            camera.scene_from_camera.matrix3.z_axis.as_dvec3().normalize(),
        ));
        let forward = rotation * DVec3::NEG_Z;
        let distance = match camera.focus_distance {
            Some(distance) => f64::from(distance),
            None => (bounds.centre().as_dvec3() - position).dot(forward),
        };
        let width = match camera.projection {
            Projection::Perspective { vertical_fov_rad, aspect } => {
                let aspect = aspect.map_or(size_mm[0] / size_mm[1], f64::from);
                2.0 * distance * (0.5 * f64::from(vertical_fov_rad)).tan() * aspect
            }
            Projection::Orthographic { half_width, .. } => 2.0 * f64::from(half_width),
        };
        let scale = width / size_mm[0];
        if !(scale.is_finite() && scale > 0.0 && distance.is_finite() && distance > 0.0) {
            return Err(WindowError::Camera {
                name: camera.name.clone(),
                found: format!("a window of width {width} at distance {distance}"),
            });
        }
        let translation = position + distance * forward;
        let near_mm = camera.near.map(|near| (distance - f64::from(near)) / scale);
        Ok(Self { scene_from_display: Similarity { rotation, scale, translation }, size_mm, near_mm })
    }

    /// Returns a window with its centre at `centre`, seen along `forward` with `up` upwards, and
    /// `width` scene units wide.
    ///
    /// # Errors
    /// If the centre is not finite, if the directions are zero or parallel, or if the width is not
    /// a positive number.
    pub fn given(centre: DVec3, forward: DVec3, up: DVec3, width: f64, size_mm: [f64; 2]) -> Result<Self, WindowError> {
        let z = -forward.normalize_or_zero();
        let x = up.cross(z).normalize_or_zero();
        if x == DVec3::ZERO || !centre.is_finite() {
            return Err(WindowError::Given {
                expected: "a finite centre, and directions forward and up that are neither zero nor parallel",
                found: format!("centre {centre}, forward {forward}, up {up}"),
            });
        }
        if !(width.is_finite() && width > 0.0) {
            return Err(WindowError::Given { expected: "a width above 0", found: width.to_string() });
        }
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z));
        Ok(Self {
            scene_from_display: Similarity { rotation, scale: width / size_mm[0], translation: centre },
            size_mm,
            near_mm: None,
        })
    }

    /// Returns a window in the same plane. Its centre is the point `point_mm` = (x, y) of this
    /// window, in millimetres. Its size in the scene is this window's size times `factor`.
    #[must_use]
    pub fn scaled_about(&self, point_mm: [f64; 2], factor: f64) -> Self {
        let map = self.scene_from_display;
        let translation = map.point(DVec3::new(point_mm[0], point_mm[1], 0.0));
        let scene_from_display = Similarity { scale: map.scale * factor, translation, ..map };
        Self { scene_from_display, size_mm: self.size_mm, near_mm: self.near_mm.map(|near| near / factor) }
    }

    /// Returns the window, moved back along its normal by `by_mm`, so that depth −`by_mm` becomes
    /// its plane. The view from straight ahead stays the same. For parallel projections the window
    /// keeps its size. For an eye at distance `eye_mm` the window grows with the distance, and eye
    /// and frustum stay the same.
    #[must_use]
    pub fn moved_back(&self, by_mm: f64, eye_mm: Option<f64>) -> Self {
        let map = self.scene_from_display;
        let factor = eye_mm.map_or(1.0, |eye| (eye + by_mm) / eye);
        let translation = map.point(DVec3::new(0.0, 0.0, -by_mm));
        let scene_from_display = Similarity { scale: map.scale * factor, translation, ..map };
        // the near plane keeps its position in the scene
        Self { scene_from_display, size_mm: self.size_mm, near_mm: self.near_mm.map(|near| (near + by_mm) / factor) }
    }

    /// Frames points as seen along `forward`. The plane passes through the centre of their extents,
    /// and the window holds their width and height with a small margin.
    ///
    /// # Errors
    /// If there are no points, if all points are equal, or if the directions are zero or parallel.
    pub fn framing_points(
        points: impl Iterator<Item = DVec3>,
        forward: DVec3,
        up: DVec3,
        size_mm: [f64; 2],
    ) -> Result<Self, WindowError> {
        let turned = Self::given(DVec3::ZERO, forward, up, 1.0, size_mm)?.scene_from_display.rotation;
        let back = turned.inverse();
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for point in points {
            let point = back * point;
            (min, max) = (min.min(point), max.max(point));
        }
        let size = if min.cmple(max).all() { max - min } else { DVec3::ZERO };
        let fit = (size.x / size_mm[0]).max(size.y / size_mm[1]) * (1.0 + FRAMING_MARGIN);
        let scale = if fit > 0.0 { fit } else { size.z / size_mm[0] };
        Self::given(turned * (0.5 * (min + max)), forward, up, scale * size_mm[0], size_mm)
    }

    /// Frames the bounds from the front, seen along −z (glTF assets face +z). The plane passes
    /// through their centre, and the window holds their width and height with a small margin.
    ///
    /// # Errors
    /// If the bounds are empty or a single point.
    pub fn framing(bounds: Bounds, size_mm: [f64; 2]) -> Result<Self, WindowError> {
        let size = if bounds.is_empty() { Vec3::ZERO } else { bounds.size() }.as_dvec3();
        let fit = (size.x / size_mm[0]).max(size.y / size_mm[1]) * (1.0 + FRAMING_MARGIN);
        // a scene without width and height, such as a line towards the viewer, gets a window too
        let scale = if fit > 0.0 { fit } else { size.z / size_mm[0] };
        Self::given(bounds.centre().as_dvec3(), DVec3::NEG_Z, DVec3::Y, scale * size_mm[0], size_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Quat};

    const SIZE_MM: [f64; 2] = [400.0, 250.0];

    #[test]
    fn a_camera_window_is_as_wide_as_its_frustum() {
        let camera = Camera {
            name: "c".into(),
            scene_from_camera: Affine3A::from_rotation_translation(
                Quat::from_rotation_y(std::f32::consts::FRAC_PI_2),
                Vec3::new(3.0, 1.0, 0.0),
            ),
            projection: Projection::Perspective { vertical_fov_rad: std::f32::consts::FRAC_PI_2, aspect: Some(1.6) },
            focus_distance: Some(2.0),
            near: Some(0.5),
        };
        let window = Window::from_camera(&camera, Bounds::EMPTY, SIZE_MM).unwrap();
        let map = window.scene_from_display;
        // the camera at (3, 1, 0) looks along −x, and half the width of its frustum at distance 2
        // is 3.2
        assert!((map.point(DVec3::ZERO) - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-6);
        assert!((map.point(DVec3::new(200.0, 0.0, 0.0)) - DVec3::new(1.0, 1.0, -3.2)).length() < 1e-6);
        assert!((map.point(DVec3::new(0.0, 0.0, 1.0)) - DVec3::new(1.016, 1.0, 0.0)).length() < 1e-6);
        // The window is 2 units away from the camera, and the near plane 0.5 units. So the near
        // plane is 1.5 units nearer to the viewer than the window. A millimetre is 0.016 units.
        assert!((window.near_mm.unwrap() - 1.5 / 0.016).abs() < 1e-3);
        assert!(
            (map.inverse_point(map.point(DVec3::new(1.0, -2.0, 3.0))) - DVec3::new(1.0, -2.0, 3.0)).length() < 1e-9
        );
    }

    #[test]
    fn a_window_that_moves_back_shows_the_same_straight_on() {
        let mut window = Window::given(DVec3::new(1.0, 2.0, 3.0), DVec3::X, DVec3::Y, 4.0, SIZE_MM).unwrap();
        window.near_mm = Some(120.0);
        let (map, corner) = (window.scene_from_display, DVec3::new(80.0, -50.0, 0.0));
        let oblique = window.moved_back(30.0, None).scene_from_display;
        assert!((oblique.point(corner) - map.point(corner - 30.0 * DVec3::Z)).length() < 1e-12);
        let perspective = window.moved_back(30.0, Some(600.0)).scene_from_display;
        let eye = DVec3::new(0.0, 0.0, 600.0);
        assert!((perspective.point(eye) - map.point(eye)).length() < 1e-12, "the eye stays");
        // a corner of the window moves along its line of sight
        let along = (map.point(corner) - map.point(eye)).normalize();
        assert!((perspective.point(corner) - map.point(eye)).normalize().distance(along) < 1e-12);
        assert!((perspective.inverse_point(map.point(-30.0 * DVec3::Z))).length() < 1e-9);
        // the near plane keeps its position in the scene
        let near = map.point(120.0 * DVec3::Z);
        for moved in
            [window.moved_back(30.0, None), window.moved_back(30.0, Some(600.0)), window.scaled_about([0.0; 2], 0.5)]
        {
            let kept = moved.scene_from_display.point(moved.near_mm.unwrap() * DVec3::Z);
            assert!((kept - near).length() < 1e-9, "{kept} {near}");
        }
    }

    #[test]
    fn framing_keeps_orientation_and_holds_the_bounds() {
        let bounds = Bounds { min: Vec3::new(-1.0, 0.0, -5.0), max: Vec3::new(1.0, 4.0, 5.0) };
        let window = Window::framing(bounds, SIZE_MM).unwrap();
        let top = window.scene_from_display.inverse_point(DVec3::new(0.0, 4.0, 0.0));
        assert!(top.y > 0.95 * 125.0 && top.y < 125.0, "{top}");
        assert!(Window::framing(Bounds::EMPTY, SIZE_MM).is_err());
        // the corners of the bounds, framed from the front, give the same window
        let corners = || bounds.corners().into_iter().map(|corner| corner.as_dvec3());
        let framed = Window::framing_points(corners(), DVec3::NEG_Z, DVec3::Y, SIZE_MM).unwrap();
        assert!((framed.scene_from_display.scale / window.scene_from_display.scale - 1.0).abs() < 1e-6);
        assert!((framed.scene_from_display.translation - window.scene_from_display.translation).length() < 1e-6);
        // seen from above, the scene's depth of 10 units is vertical in the window
        let above = Window::framing_points(corners(), DVec3::NEG_Y, DVec3::NEG_Z, SIZE_MM).unwrap();
        let edge = above.scene_from_display.inverse_point(DVec3::new(1.0, 4.0, -5.0));
        assert!((edge.y - 125.0 / 1.02).abs() < 1e-6 && edge.x > 0.0 && edge.z > 0.0, "{edge}");
        assert!(Window::framing_points(std::iter::empty(), DVec3::NEG_Z, DVec3::Y, SIZE_MM).is_err());
        assert!(Window::given(DVec3::ZERO, DVec3::Y, DVec3::Y, 1.0, SIZE_MM).is_err());
    }
}
