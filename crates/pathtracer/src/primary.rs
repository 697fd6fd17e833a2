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
    geometry: &'a FieldGeometry,
    view: [usize; 2],
    /// Full width of the range of slopes per axis, 0 for a point.
    slope_width: [f64; 2],
    /// Whether the range is the ellipse of those widths instead of the rectangle.
    round: bool,
    /// Display space in render space: the origin and one millimetre along each axis.
    origin: DVec3,
    axes: [DVec3; 3],
    millimetre: f64,
    /// Half the size of the scene's bounds with a margin.
    half_size: DVec3,
}

/// A ray with its footprint; `in_bounds` tells whether it can meet the scene at all.
pub(crate) struct PrimaryRay {
    pub(crate) ray: Ray,
    pub(crate) cone: Cone,
    pub(crate) in_bounds: bool,
}

/// The square −0.5..0.5 to the disc of diameter 1, equal areas to equal areas and neighbours to neighbours (Shirley, Chiu 1997).
fn in_disc([x, y]: [f64; 2]) -> [f64; 2] {
    if x == 0.0 && y == 0.0 {
        return [0.0; 2];
    }
    let (radius, angle) = if x.abs() > y.abs() {
        (x, std::f64::consts::FRAC_PI_4 * y / x)
    } else {
        (y, std::f64::consts::FRAC_PI_2 - std::f64::consts::FRAC_PI_4 * x / y)
    };
    [radius * angle.cos(), radius * angle.sin()]
}

impl<'a> PrimaryRays<'a> {
    pub(crate) fn new(
        window: &Window,
        geometry: &'a FieldGeometry,
        view: [usize; 2],
        space: RenderSpace,
        slope_width: [f64; 2],
        round: bool,
    ) -> Self {
        let map = &window.scene_from_display;
        Self {
            geometry,
            view,
            slope_width,
            round,
            origin: space.point(map.point(DVec3::ZERO)),
            axes: [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| space.scale * map.vector(axis)),
            millimetre: map.scale * space.scale,
            half_size: space.half_size.as_dvec3() + BOUNDS_MARGIN * f64::from(space.radius),
        }
    }

    /// The ray at an offset from the centre of pixel (row, col), in pixels, and from the centre of the slopes, in widths; offsets
    /// are in −0.5..0.5, x to the right and y up.
    pub(crate) fn ray(&self, row: usize, col: usize, pixel_offset: [f64; 2], slope_offset: [f64; 2]) -> PrimaryRay {
        let pitch = self.geometry.pitch_mm;
        let grid = &self.geometry.grid;
        let point =
            [self.geometry.x_mm(col) + pixel_offset[0] * pitch, self.geometry.y_mm(row) + pixel_offset[1] * pitch];
        let slope_at = grid.slope_at(self.view, point);
        let slope_offset = if self.round { in_disc(slope_offset) } else { slope_offset };
        let slope = [0, 1].map(|axis| slope_at[axis] + slope_offset[axis] * self.slope_width[axis]);
        let [x, y, z] = self.axes;
        let on_plane = self.origin + point[0] * x + point[1] * y;
        let along = -(slope[0] * x + slope[1] * y + z);
        let length = along.length();
        let direction = along * length.recip();
        // distance from the start of the ray to the plane z = 0, and the growth of a pixel's width behind it
        let (start, spread) = match grid.projection {
            Projection::Oblique => (f64::NEG_INFINITY, 0.0),
            Projection::Perspective { distance_mm } => {
                let to_eye = distance_mm * length;
                (-to_eye, pitch * self.millimetre / to_eye)
            }
        };
        let entry = self.enter_bounds(on_plane, direction);
        let t = entry.unwrap_or(0.0).max(start);
        let t = if t.is_finite() { t } else { 0.0 };
        let width = match grid.projection {
            Projection::Oblique => pitch * self.millimetre,
            Projection::Perspective { .. } => spread * (t - start),
        };
        PrimaryRay {
            ray: Ray {
                origin: (on_plane + t * direction).as_vec3(),
                direction: direction.as_vec3(),
                t_max: f32::INFINITY,
            },
            cone: Cone { width: (FOOTPRINT_SHARE * width) as f32, spread: (FOOTPRINT_SHARE * spread) as f32 },
            in_bounds: entry.is_some(),
        }
    }

    /// Where the line enters the scene's bounds, measured from the display plane; `None` where it passes by.
    #[inline]
    fn enter_bounds(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let half = self.half_size;
        // no 0 · ∞: along an axis that the line runs across, it is inside all the way or never
        let across = direction.cmpeq(DVec3::ZERO);
        if (across & origin.abs().cmpgt(half)).any() {
            return None;
        }
        let inverse = direction.recip();
        let (a, b) = ((-half - origin) * inverse, (half - origin) * inverse);
        let near = DVec3::select(across, DVec3::NEG_INFINITY, a.min(b)).max_element();
        let far = DVec3::select(across, DVec3::INFINITY, a.max(b)).min_element();
        (near <= far).then_some(near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Along each axis the disc has ⟨x²⟩ = r²/4; every ring holds its share of the area.
    #[test]
    fn the_disc_is_filled_evenly() {
        let n = 400;
        let (mut square_sum, mut within) = ([0.0; 2], [0u32; 4]);
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let at = |i: i32| (f64::from(i) + 0.5) / f64::from(n) - 0.5;
            let [x, y] = in_disc([at(i), at(j)]);
            let radius = x.hypot(y);
            assert!(radius <= 0.5 + 1e-12);
            square_sum[0] += x * x;
            square_sum[1] += y * y;
            (0..4).filter(|ring| radius <= 0.125 * f64::from(ring + 1)).for_each(|ring| within[ring as usize] += 1);
        }
        let count = f64::from(n * n);
        for axis in 0..2 {
            assert!((square_sum[axis] / count - 0.0625).abs() < 1e-4);
        }
        for (ring, count_within) in within.into_iter().enumerate() {
            let share = ((ring + 1) as f64 / 4.0).powi(2);
            assert!((f64::from(count_within) / count - share).abs() < 4e-3, "ring {ring}");
        }
        assert_eq!(in_disc([0.0, 0.0]), [0.0, 0.0]);
    }
}
