//! Rays of a view: from the display's geometry to rays in render space.
//!
//! Light of slope s through (x, y, 0) travels along (s_x, s_y, 1) in display space. Its path is
//! traced backwards,
//!
//! ```text
//! (x, y, 0) − τ (s_x, s_y, 1),   τ from τ₀ in millimetres
//! ```
//!
//! from a start τ₀. So τ is −z in display space. In oblique views the start is in front of the
//! scene's bounds, so that objects in front of the display plane are seen too. In perspective views
//! the start is there too, or at the eye if the eye is farther along the rays. If the window has a
//! near plane, no ray starts nearer to the viewer than that plane.
//!
//! A sample has two offsets: from the centre of its pixel, and from the centre of the range of
//! slopes. The start and the direction of its ray are linear in these offsets. So a pixel's central
//! ray is computed in f64. The samples' rays follow from the central ray in f32.

use glam::{DVec3, Vec3};
use lumistack_display::{FieldGeometry, Projection};
use lumistack_scene::Window;

use crate::bvh::{BEAM, Ray};
use crate::geometry::RenderSpace;
use crate::tracer::Cone;

/// Width by which the scene's bounds are enlarged, relative to the scene's radius.
const BOUNDS_MARGIN: f64 = 1e-5;
/// Width of the texture footprint, as a fraction of the pixel's width. Samples are spread over the
/// pixel, so each needs to cover only a fraction of it. For example, each of 16 samples covers a
/// quarter of the width.
///
/// Measured: a footprint of half the pixel's width lowers the variance by up to 3 %, but blurs and
/// dims small letters. A display shows the dimmer target better (still life: 36.8 dB instead of
/// 36.2 dB). But the target has less detail: its gradients have 12 % less energy.
const FOOTPRINT_SHARE: f64 = 0.25;

/// The rays of one view.
pub(crate) struct PrimaryRays<'a> {
    geometry: &'a FieldGeometry,
    view: [usize; 2],
    /// Full width of the range of slopes per axis, 0 for a single slope.
    slope_width: [f64; 2],
    /// True if slopes fill the ellipse with these widths, false if they fill the rectangle.
    round: bool,
    /// Origin of display space, in render space.
    origin: DVec3,
    /// Vectors of one millimetre along the axes of display space, in render space.
    axes: [DVec3; 3],
    /// Length of a millimetre in render space.
    millimetre: f64,
    /// Half the size of the scene's bounds, with a margin.
    half_size: DVec3,
    /// τ at the start of all rays, in millimetres; τ is −z in display space.
    start: f64,
    /// Largest |τ| from the start to the far end of the bounds, in millimetres.
    deepest: f64,
}

/// The rays of one pixel.
#[derive(Clone, Copy)]
pub(crate) struct PixelRays {
    /// Start of the central ray.
    origin: Vec3,
    /// Direction of the central ray, not normalized.
    direction: Vec3,
    /// Vectors of one pixel to the right and one pixel up, on the plane z = 0.
    pixel: [Vec3; 2],
    /// Unit vectors to the right and up in render space. A change of slope moves the start of a ray
    /// along these vectors, in proportion to `start`.
    axes: [Vec3; 2],
    /// τ at the start of the rays, as a length in render space.
    start: f32,
    /// Change of the slope from a pixel to the next: to the right (x), and up (y).
    turn: [f32; 2],
    /// Full width of the range of slopes per axis; 0 for a single slope.
    slope_width: [f32; 2],
    round: bool,
    pub(crate) cone: Cone,
    /// False where no ray of the pixel can hit the scene.
    pub(crate) in_bounds: bool,
}

/// Maps the square −0.5..0.5 to the disc of diameter 1, equal areas to equal areas and neighbours
/// to neighbours (Shirley, Chiu 1997).
fn in_disc([x, y]: [f32; 2]) -> [f32; 2] {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    if x == 0.0 && y == 0.0 {
        return [0.0; 2];
    }
    let (radius, angle) = if x.abs() > y.abs() { (x, FRAC_PI_4 * y / x) } else { (y, FRAC_PI_2 - FRAC_PI_4 * x / y) };
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
        let origin = space.point(map.point(DVec3::ZERO));
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| space.scale * map.vector(axis));
        let millimetre = map.scale * space.scale;
        let half_size = space.half_size.as_dvec3() + BOUNDS_MARGIN * f64::from(space.radius);
        // Along a ray, τ = −z in display space, in millimetres. The corners of the bounds, whose
        // centre is the origin of render space, have τ from centre − reach to centre + reach.
        let toward = axes[2] / (millimetre * millimetre);
        let (centre, reach) = (origin.dot(toward), half_size.dot(toward.abs()));
        let start = match geometry.grid.projection {
            Projection::Oblique => centre - reach,
            Projection::Perspective { distance_mm } => (centre - reach).max(-distance_mm),
        };
        let start = window.near_mm.map_or(start, |near| start.max(-near));
        let deepest = start.abs().max((centre + reach).abs());
        Self { geometry, view, slope_width, round, origin, axes, millimetre, half_size, start, deepest }
    }

    /// Returns the rays of pixel (row, col).
    pub(crate) fn pixel(&self, row: usize, col: usize) -> PixelRays {
        let pitch = self.geometry.pitch_mm;
        let grid = &self.geometry.grid;
        let point = [self.geometry.x_mm(col), self.geometry.y_mm(row)];
        // compute the slope of the central ray, and its change across a pixel
        let slope = grid.slope_at(self.view, point);
        let beside = grid.slope_at(self.view, point.map(|p| p + pitch));
        let turn = [0, 1].map(|axis| beside[axis] - slope[axis]);
        let [x, y, z] = self.axes;
        let on_plane = self.origin + point[0] * x + point[1] * y;
        let along = -(slope[0] * x + slope[1] * y + z);
        // The width of the texture footprint is constant in parallel projections. In perspective it
        // grows with the distance from the eye.
        let (start, spread) = match grid.projection {
            Projection::Oblique => (1.0, 0.0),
            Projection::Perspective { distance_mm } => {
                (1.0 + self.start / distance_mm, pitch * self.millimetre / (distance_mm * along.length()))
            }
        };
        // Width of the region that the pixel's rays cross, at the depth where it is largest, summed
        // over both axes. A ray is at most half of this width away from the central ray.
        let spreading: f64 =
            [0, 1].map(|axis| pitch + self.deepest * (turn[axis].abs() + self.slope_width[axis])).into_iter().sum();
        let half_size = self.half_size + 0.5 * spreading * self.millimetre;
        let axes = [x, y].map(|axis| (axis / self.millimetre).as_vec3());
        PixelRays {
            origin: (on_plane + self.start * along).as_vec3(),
            direction: (along / self.millimetre).as_vec3(),
            pixel: axes.map(|axis| (pitch * self.millimetre) as f32 * axis),
            axes,
            start: (self.start * self.millimetre) as f32,
            turn: turn.map(|t| t as f32),
            slope_width: self.slope_width.map(|w| w as f32),
            round: self.round,
            cone: Cone {
                width: (FOOTPRINT_SHARE * pitch * self.millimetre * start) as f32,
                spread: (FOOTPRINT_SHARE * spread) as f32,
            },
            in_bounds: passes_through(on_plane, along, half_size),
        }
    }
}

impl PixelRays {
    /// Fills at most [`BEAM`] rays. `offsets` returns two offsets for a ray's index, x to the right
    /// and y up, in −0.5..0.5. The first is from the centre of the pixel, in pixels. The second is
    /// from the centre of the range of slopes, in widths of that range.
    #[inline]
    pub(crate) fn fill(&self, rays: &mut [Ray], mut offsets: impl FnMut(usize) -> [[f32; 2]; 2]) {
        // one array per coordinate, so that roots and quotients are computed as vectors
        let mut origins = [[0.0f32; BEAM]; 3];
        let mut directions = [[0.0f32; BEAM]; 3];
        let mut turns = [[0.0f32; BEAM]; 2];
        let mut places = [[0.0f32; BEAM]; 2];
        for index in 0..rays.len() {
            let [in_pixel, in_bin] = offsets(index);
            let in_bin = if self.round { in_disc(in_bin) } else { in_bin };
            for axis in 0..2 {
                places[axis][index] = in_pixel[axis];
                turns[axis][index] = in_pixel[axis] * self.turn[axis] + in_bin[axis] * self.slope_width[axis];
            }
        }
        for index in 0..BEAM {
            // start and direction are linear in the offsets
            let turned: [f32; 3] =
                std::array::from_fn(|axis| turns[0][index] * self.axes[0][axis] + turns[1][index] * self.axes[1][axis]);
            for axis in 0..3 {
                let aside = places[0][index] * self.pixel[0][axis] + places[1][index] * self.pixel[1][axis];
                origins[axis][index] = self.origin[axis] + (aside - self.start * turned[axis]);
                directions[axis][index] = self.direction[axis] - turned[axis];
            }
        }
        for index in 0..BEAM {
            let [x, y, z] = directions.each_ref().map(|direction| direction[index]);
            let inverse = 1.0 / (x * x + y * y + z * z).sqrt();
            directions.iter_mut().for_each(|direction| direction[index] *= inverse);
        }
        for (index, ray) in rays.iter_mut().enumerate() {
            let at = |numbers: &[[f32; BEAM]; 3]| Vec3::new(numbers[0][index], numbers[1][index], numbers[2][index]);
            *ray = Ray { origin: at(&origins), direction: at(&directions), t_max: f32::INFINITY };
        }
    }

    /// Returns the ray at two offsets, which [`fill`](Self::fill) describes.
    pub(crate) fn ray(&self, in_pixel: [f32; 2], in_bin: [f32; 2]) -> Ray {
        let mut ray = [Ray::ANY];
        self.fill(&mut ray, |_| [in_pixel, in_bin]);
        ray[0]
    }

    /// Returns the ray through the pixel's centre.
    pub(crate) fn central(&self) -> Ray {
        self.ray([0.0; 2], [0.0; 2])
    }
}

/// Returns true if a line intersects the box −`half`..`half`.
fn passes_through(origin: DVec3, direction: DVec3, half: DVec3) -> bool {
    // A line parallel to two planes of the box is between them everywhere or nowhere. This test
    // avoids 0 · ∞ for such a line.
    let across = direction.cmpeq(DVec3::ZERO);
    if (across & origin.abs().cmpgt(half)).any() {
        return false;
    }
    let inverse = direction.recip();
    let (a, b) = ((-half - origin) * inverse, (half - origin) * inverse);
    let near = DVec3::select(across, DVec3::NEG_INFINITY, a.min(b)).max_element();
    let far = DVec3::select(across, DVec3::INFINITY, a.max(b)).min_element();
    near <= far
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use lumistack_core::seed::Stream;
    use lumistack_display::ViewGrid;
    use lumistack_scene::Similarity;

    use super::*;

    /// Points that [`in_disc`] maps from an even grid fill the disc evenly. Along each axis the
    /// mean of x² is r²/4, with the radius r. Every ring holds points in proportion to its area.
    #[test]
    fn the_disc_is_filled_evenly() {
        let n = 400i16;
        let (mut square_sum, mut within) = ([0.0; 2], [0u32; 4]);
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let at = |i: i16| (f32::from(i) + 0.5) / f32::from(n) - 0.5;
            let [x, y] = in_disc([at(i), at(j)]).map(f64::from);
            let radius = x.hypot(y);
            assert!(radius <= 0.5 + 1e-7);
            square_sum[0] += x * x;
            square_sum[1] += y * y;
            (0..4).filter(|ring| radius <= 0.125 * f64::from(ring + 1)).for_each(|ring| within[ring as usize] += 1);
        }
        let count = f64::from(n).powi(2);
        for axis in 0..2 {
            assert!((square_sum[axis] / count - 0.0625).abs() < 1e-4);
        }
        for (ring, count_within) in within.into_iter().enumerate() {
            let share = ((ring + 1) as f64 / 4.0).powi(2);
            assert!((f64::from(count_within) / count - share).abs() < 4e-3, "ring {ring}");
        }
        assert_eq!(in_disc([0.0, 0.0]), [0.0, 0.0]);
    }

    /// Tests rays of random windows that are far from the scene, near it or inside it. Each ray
    /// lies on the line through its point of the display plane with its slope. Each ray starts in
    /// front of the bounds, at the eye or at the near plane. If a ray intersects the bounds, its
    /// pixel is `in_bounds`.
    #[test]
    fn rays_are_lines_of_the_display() {
        let mut stream = Stream::new(4);
        let mut next = move || f64::from(stream.next_f32()) - 0.5;
        let (mut inside, mut outside) = (0, 0);
        for round in 0..600 {
            // make a random scene, a window at one of three distances, and a grid of views
            let half_size = Vec3::new(next() as f32, next() as f32, next() as f32).abs() * 2.0 + 1e-3;
            let space = RenderSpace {
                centre: DVec3::new(next(), next(), next()) * 30.0,
                scale: 0.1 + next().abs(),
                radius: half_size.length(),
                half_size,
            };
            let far = [0.0, 1.0, 20.0][round % 3];
            let scale = 1e-3 / space.scale * (1.0 + 8.0 * next().abs());
            let map = Similarity {
                rotation: DQuat::from_euler(glam::EulerRot::XYZ, 7.0 * next(), 7.0 * next(), 7.0 * next()),
                scale,
                translation: space.centre + far / space.scale * DVec3::new(next(), next(), next()),
            };
            let distance_mm = 300.0 + 900.0 * next().abs();
            let projection = [Projection::Oblique, Projection::Perspective { distance_mm }][round % 2];
            let grid = ViewGrid { projection, slope_x: vec![next(), next()], slope_y: vec![0.3 * next()] };
            let geometry = FieldGeometry { rows: 20, cols: 30, pitch_mm: 7.0 + next(), grid };
            let near_mm = (round % 5 == 4).then(|| 400.0 * next());
            let window = Window { scene_from_display: map, size_mm: geometry.size_mm(), near_mm };
            let (view, slope_width) = ([0, 1], [[0.0; 2], [0.2, 0.1]][round / 2 % 2]);
            let rays = PrimaryRays::new(&window, &geometry, view, space, slope_width, false);
            for _ in 0..40 {
                // compute the same ray in f64 from the definitions of pixel and slope
                let (row, col) = ((20.0 * (next() + 0.5)) as usize, (30.0 * (next() + 0.5)) as usize);
                let (in_pixel, in_bin) = ([next(), next()], [next(), next()]);
                let pixel = rays.pixel(row, col);
                let ray = pixel.ray(in_pixel.map(|o| o as f32), in_bin.map(|o| o as f32));
                let pitch = geometry.pitch_mm;
                let point = [geometry.x_mm(col) + in_pixel[0] * pitch, geometry.y_mm(row) + in_pixel[1] * pitch];
                let slope = geometry.grid.slope_at(view, point);
                let [sx, sy] = [0, 1].map(|axis| slope[axis] + in_bin[axis] * slope_width[axis]);
                let on_plane = space.point(map.point(DVec3::new(point[0], point[1], 0.0)));
                let direction = -map.vector(DVec3::new(sx, sy, 1.0)).normalize();
                let (origin, along) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
                assert!((along - direction).length() < 1e-6, "{along} {direction}");
                let aside = (origin - on_plane).cross(direction).length();
                let size = origin.length() + on_plane.length();
                assert!(aside < 1e-6 * size, "{aside} of {size}");
                // compute z of the ray's start in display space
                let z = map.inverse_point(space.centre + origin / space.scale).z;
                let rounded = 1e-6 * size / (space.scale * map.scale);
                if let Projection::Perspective { distance_mm } = projection {
                    assert!(z < distance_mm + rounded, "{z} is behind the eye at {distance_mm}");
                    let width = pitch * (distance_mm - z) / distance_mm * scale * space.scale * FOOTPRINT_SHARE;
                    assert!((f64::from(pixel.cone.width) - width).abs() < 1e-5 * width + rounded, "{width}");
                }
                // compare `in_bounds` with the intersection of the line and the bounds
                let half = space.half_size.as_dvec3();
                if passes_through(on_plane, direction, half) {
                    assert!(pixel.in_bounds);
                    inside += 1;
                } else {
                    outside += usize::from(!pixel.in_bounds);
                }
                // no visible corner of the bounds may be nearer to the viewer than the start
                for corner in 0..8 {
                    let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
                    let at = space.centre + half * DVec3::new(sign(0), sign(1), sign(2)) / space.scale;
                    let eye = match projection {
                        Projection::Oblique => f64::INFINITY,
                        Projection::Perspective { distance_mm } => distance_mm,
                    };
                    let eye = window.near_mm.map_or(eye, |near| eye.min(near));
                    assert!(map.inverse_point(at).z.min(eye) < z + rounded, "a corner is before the start");
                }
            }
        }
        assert!(inside > 3000 && outside > 3000, "{inside} {outside}");
    }
}
