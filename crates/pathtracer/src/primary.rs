//! Rays of a view: from the display's geometry to rays in render space.
//!
//! Light of slope s through (x, y, 0) travels along (s_x, s_y, 1) in display space. Its path is traced backwards, along
//! (−s_x, −s_y, −1): from before the scene's bounds in oblique views, so that what stands in front of the display plane is seen
//! too, and from the eye in perspective ones. All of this is in f64; only the final ray is f32.

use glam::DVec3;
use lumistack_display::{FieldGeometry, Projection};
use lumistack_scene::Window;

use crate::bvh::Ray;
use crate::geometry::RenderSpace;
use crate::tracer::Cone;

/// Bounds are entered this much outside themselves, relative to the radius of the scene.
const BOUNDS_MARGIN: f64 = 1e-5;
/// Width of the texture footprint over that of a pixel. Samples are spread over the pixel, so each needs to cover only a part.
const FOOTPRINT_SHARE: f64 = 0.5;

/// The rays of one view.
pub(crate) struct PrimaryRays<'a> {
    pub(crate) window: &'a Window,
    pub(crate) geometry: &'a FieldGeometry,
    pub(crate) view: [usize; 2],
    pub(crate) space: RenderSpace,
    /// Full width of the range of slopes per axis, 0 for a point.
    pub(crate) slope_width: [f64; 2],
}

/// A ray with its footprint; `in_bounds` tells whether it can meet the scene at all.
pub(crate) struct PrimaryRay {
    pub(crate) ray: Ray,
    pub(crate) cone: Cone,
    pub(crate) in_bounds: bool,
}

impl PrimaryRays<'_> {
    /// The ray at an offset from the centre of pixel (row, col), in pixels, and from the centre of the slopes, in widths; offsets
    /// are in −0.5..0.5, x to the right and y up.
    pub(crate) fn ray(&self, row: usize, col: usize, pixel_offset: [f64; 2], slope_offset: [f64; 2]) -> PrimaryRay {
        let pitch = self.geometry.pitch_mm;
        let grid = &self.geometry.grid;
        let point =
            [self.geometry.x_mm(col) + pixel_offset[0] * pitch, self.geometry.y_mm(row) + pixel_offset[1] * pitch];
        let slope_at = grid.slope_at(self.view, point);
        let slope = [0, 1].map(|axis| slope_at[axis] + slope_offset[axis] * self.slope_width[axis]);
        let map = &self.window.scene_from_display;
        let on_plane = self.space.point(map.point(DVec3::new(point[0], point[1], 0.0)));
        let along = map.vector(DVec3::new(-slope[0], -slope[1], -1.0));
        let direction = along.normalize();
        let millimetre = map.scale * self.space.scale;
        // distance from the start of the ray to the plane z = 0, and the growth of a pixel's width behind it
        let (start, spread) = match grid.projection {
            Projection::Oblique => (f64::NEG_INFINITY, 0.0),
            Projection::Perspective { distance_mm } => {
                let to_eye = distance_mm * along.length() * self.space.scale;
                (-to_eye, pitch * millimetre / to_eye)
            }
        };
        let entry = self.enter_bounds(on_plane, direction);
        let t = entry.unwrap_or(0.0).max(start);
        let t = if t.is_finite() { t } else { 0.0 };
        let width = match grid.projection {
            Projection::Oblique => pitch * millimetre,
            Projection::Perspective { .. } => spread * (t - start),
        };
        PrimaryRay {
            ray: Ray {
                origin: (on_plane + t * direction).as_vec3(),
                direction: direction.as_vec3().normalize(),
                t_max: f32::INFINITY,
            },
            cone: Cone { width: (FOOTPRINT_SHARE * width) as f32, spread: (FOOTPRINT_SHARE * spread) as f32 },
            in_bounds: entry.is_some(),
        }
    }

    /// Where the line enters the scene's bounds, measured from the display plane; `None` where it passes by.
    fn enter_bounds(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let margin = BOUNDS_MARGIN * f64::from(self.space.radius);
        let half = self.space.half_size.as_dvec3() + margin;
        let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..3 {
            if direction[axis] == 0.0 {
                if origin[axis].abs() > half[axis] {
                    return None;
                }
                continue;
            }
            let (a, b) =
                ((-half[axis] - origin[axis]) / direction[axis], (half[axis] - origin[axis]) / direction[axis]);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near <= far).then_some(near)
    }
}
