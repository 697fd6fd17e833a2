//! USD's implicit shapes as triangles: sphere, cube, cylinder, cone, capsule, plane.
//!
//! Round shapes are surfaces of revolution about +z, (r(t) cos φ, r(t) sin φ, z(t)). A cyclic
//! exchange of coordinates moves +z to the shape's axis. Vertices and normals are exact.
//!
//! Source: UsdGeom schemas. They do not define texture coordinates; here u is the longitude and v
//! runs from the top down. On caps and faces of cubes, u and v span the bounding square.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::{Vec2, Vec3};

use crate::geometry::Geometry;

/// Number of steps of a full turn. The outline of a circle is inside the exact circle by at most 1
/// − cos(π/96) = 0.05 % of its radius.
const TURN_PARTS: usize = 96;

/// The direction of the axis about which a shape is round.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Axis {
    /// +x
    X,
    /// +y
    Y,
    /// +z
    #[default]
    Z,
}

impl Axis {
    /// Rotates a vector of a shape whose axis is +z to the shape's own axis.
    fn turn(self, v: Vec3) -> Vec3 {
        match self {
            Self::X => Vec3::new(v.z, v.x, v.y),
            Self::Y => Vec3::new(v.y, v.z, v.x),
            Self::Z => v,
        }
    }

    fn apply(self, mut geometry: Geometry) -> Geometry {
        geometry.positions.iter_mut().chain(&mut geometry.normals).for_each(|v| *v = self.turn(*v));
        geometry
    }
}

/// A point of a profile that is rotated about the axis: (distance from the axis, height); normal
/// (outward, up); texture coordinate v.
type Knot = (Vec2, Vec2, f32);

/// Adds the surface of revolution of a profile. The profile runs from the top down.
fn revolve(geometry: &mut Geometry, profile: &[Knot]) {
    let first = geometry.positions.len() as u32;
    let columns = TURN_PARTS as u32 + 1;
    for (row, &(point, normal, v)) in profile.iter().enumerate() {
        // each vertex at a pole has the u and the normal of the middle of its only triangle
        let shift = match point.x {
            0.0 if row == 0 => 0.5,
            0.0 => -0.5,
            _ => 0.0,
        };
        for column in 0..columns {
            let lift = |v: Vec2, shift: f32| {
                // the positions of the last column equal the positions of the first column
                let turn = ((column % TURN_PARTS as u32) as f32 + shift) / TURN_PARTS as f32;
                let (sine, cosine) = (TAU * turn).sin_cos();
                Vec3::new(v.x * cosine, v.x * sine, v.y)
            };
            let u = (column as f32 + shift) / TURN_PARTS as f32;
            geometry.vertex(lift(point, 0.0), lift(normal, shift), Vec2::new(u, v));
        }
    }
    for row in 0..profile.len().saturating_sub(1) as u32 {
        for column in 0..columns - 1 {
            let top = first + row * columns + column;
            let bottom = top + columns;
            geometry.quad([top, bottom, bottom + 1, top + 1], 0);
        }
    }
}

/// Adds a disc at height z that faces up or down.
fn cap(geometry: &mut Geometry, radius: f32, z: f32, up: bool) {
    let side = if up { 1.0 } else { -1.0 };
    let normal = Vec3::new(0.0, 0.0, side);
    let centre = geometry.vertex(Vec3::new(0.0, 0.0, z), normal, Vec2::splat(0.5));
    let rim: Vec<u32> = (0..TURN_PARTS)
        .map(|i| {
            let (sine, cosine) = (TAU * i as f32 / TURN_PARTS as f32).sin_cos();
            let uv = Vec2::new(0.5 + 0.5 * side * cosine, 0.5 - 0.5 * sine);
            geometry.vertex(Vec3::new(radius * cosine, radius * sine, z), normal, uv)
        })
        .collect();
    if radius > 0.0 {
        for i in 0..TURN_PARTS {
            let (a, b) = (rim[i], rim[(i + 1) % TURN_PARTS]);
            geometry.triangle(if up { [centre, a, b] } else { [centre, b, a] }, 0);
        }
    }
}

/// Returns the points of an arc about (0, `z`), from polar angle `from` to polar angle `to`. The
/// texture coordinate runs from `from_v` to `to_v`.
fn arc(radius: f32, z: f32, [from, to]: [f32; 2], [from_v, to_v]: [f32; 2]) -> Vec<Knot> {
    let parts = ((to - from) / TAU * TURN_PARTS as f32).round().max(1.0) as usize;
    (0..=parts)
        .map(|i| {
            let share = i as f32 / parts as f32;
            let angle = from + (to - from) * share;
            // poles are exactly on the axis, but the sine of π is not exactly 0 in f32
            let sine = if angle == 0.0 || angle == 2.0 * FRAC_PI_2 { 0.0 } else { angle.sin() };
            let normal = Vec2::new(sine, angle.cos());
            (radius * normal + Vec2::new(0.0, z), normal, from_v + (to_v - from_v) * share)
        })
        .collect()
}

/// Makes the triangles of a `UsdGeomSphere`.
pub(crate) fn sphere(radius: f32) -> Geometry {
    let mut geometry = Geometry::default();
    revolve(&mut geometry, &arc(radius, 0.0, [0.0, 2.0 * FRAC_PI_2], [0.0, 1.0]));
    geometry
}

/// Makes a `UsdGeomCube` with the edge length `size`; in `face_of_triangle` the faces −x, +x, −y,
/// +y, −z, +z are 0 to 5.
pub(crate) fn cube(size: f32) -> Geometry {
    let mut geometry = Geometry::default();
    let half = 0.5 * size;
    for face in 0..6 {
        let axis = [Axis::X, Axis::Y, Axis::Z][face / 2];
        let side = if face % 2 == 0 { -1.0 } else { 1.0 };
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y): (f32, f32)| {
            let position = axis.turn(half * Vec3::new(side * x, y, side));
            geometry.vertex(position, axis.turn(Vec3::new(0.0, 0.0, side)), Vec2::new(0.5 + 0.5 * x, 0.5 - 0.5 * y))
        });
        geometry.quad(corners, face as u32);
    }
    geometry
}

/// Makes a `UsdGeomCylinder`, closed at both ends. The two radii differ only for
/// `UsdGeomCylinder_1`.
pub(crate) fn cylinder(top_radius: f32, bottom_radius: f32, height: f32, axis: Axis) -> Geometry {
    let mut geometry = Geometry::default();
    let half = 0.5 * height;
    let normal = Vec2::new(height, bottom_radius - top_radius).normalize_or(Vec2::X);
    let point = |radius: f32, z: f32, v: f32| (Vec2::new(radius, z), normal, v);
    revolve(&mut geometry, &[point(top_radius, half, 0.0), point(bottom_radius, -half, 1.0)]);
    cap(&mut geometry, top_radius, half, true);
    cap(&mut geometry, bottom_radius, -half, false);
    axis.apply(geometry)
}

/// Makes a `UsdGeomCone` with a closed base; the tip is at +height/2.
pub(crate) fn cone(radius: f32, height: f32, axis: Axis) -> Geometry {
    let mut geometry = Geometry::default();
    let half = 0.5 * height;
    let normal = Vec2::new(height, radius).normalize_or(Vec2::X);
    let tip = Vec2::new(0.0, half);
    let base = Vec2::new(radius, -half);
    // At the tip, each triangle has a different normal; the extra rows keep these triangles small.
    let rows = [0.0, 0.05, 0.3, 1.0];
    let profile = rows.map(|share: f32| (tip.lerp(base, share), normal, share));
    revolve(&mut geometry, &profile);
    cap(&mut geometry, radius, -half, false);
    axis.apply(geometry)
}

/// Makes a `UsdGeomCapsule`; the two radii differ only for `UsdGeomCapsule_1`. `height` does not
/// include the rounded ends.
///
/// The side is tangent to the caps, so the surface is smooth for any radii. The caps join the side
/// at the polar angle acos((bottom − top) / height), which is not at the equator if the radii
/// differ.
pub(crate) fn capsule(top_radius: f32, bottom_radius: f32, height: f32, axis: Axis) -> Geometry {
    let mut geometry = Geometry::default();
    let half = 0.5 * height;
    // if one ball contains the other, only the larger ball is visible
    let slope = (bottom_radius - top_radius) / height.max(f32::MIN_POSITIVE);
    if slope.abs() >= 1.0 {
        let (radius, z) = if slope > 0.0 { (bottom_radius, -half) } else { (top_radius, half) };
        revolve(&mut geometry, &arc(radius, z, [0.0, 2.0 * FRAC_PI_2], [0.0, 1.0]));
        return axis.apply(geometry);
    }
    let seam = slope.acos();
    // v is proportional to the arc length
    let lengths = [seam * top_radius, height * slope.acos().sin(), (2.0 * FRAC_PI_2 - seam) * bottom_radius];
    let total = lengths.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    let (first, second) = (lengths[0] / total, (lengths[0] + lengths[1]) / total);
    let mut profile = arc(top_radius, half, [0.0, seam], [0.0, first]);
    profile.extend(arc(bottom_radius, -half, [seam, 2.0 * FRAC_PI_2], [second, 1.0]));
    revolve(&mut geometry, &profile);
    axis.apply(geometry)
}

/// Makes a `UsdGeomPlane`. For the axis x, width and length are along z and y; for y, along x and
/// z; for z, along x and y.
pub(crate) fn plane(width: f32, length: f32, axis: Axis) -> Geometry {
    let mut geometry = Geometry::default();
    let (normal, along_width, along_length) = match axis {
        Axis::X => (Vec3::X, Vec3::NEG_Z, Vec3::Y),
        Axis::Y => (Vec3::Y, Vec3::X, Vec3::NEG_Z),
        Axis::Z => (Vec3::Z, Vec3::X, Vec3::Y),
    };
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y): (f32, f32)| {
        let position = 0.5 * (width * x * along_width + length * y * along_length);
        geometry.vertex(position, normal, Vec2::new(0.5 + 0.5 * x, 0.5 - 0.5 * y))
    });
    geometry.quad(corners, 0);
    geometry
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Largest relative error of a tessellated area or volume. A polygon of 96 sides has 0.07 %
    /// less area than its circle.
    const TESSELLATION: f64 = 2e-3;

    fn check(geometry: &Geometry, area: f64, volume: f64) {
        geometry.assert_sound();
        geometry.assert_closed();
        let close = |found: f64, expected: f64| {
            (found / expected - 1.0).abs() < TESSELLATION && found <= expected * (1.0 + 1e-5)
        };
        assert!(close(geometry.area(), area), "area {} of {area}", geometry.area());
        assert!(close(geometry.volume(), volume), "volume {} of {volume}", geometry.volume());
    }

    #[test]
    fn areas_and_volumes_are_those_of_the_formulas() {
        check(&sphere(1.5), 4.0 * PI * 2.25, 4.0 / 3.0 * PI * 3.375);
        check(&cube(3.0), 54.0, 27.0);
        for axis in [Axis::X, Axis::Y, Axis::Z] {
            check(&cylinder(0.5, 0.5, 3.0, axis), PI * (3.0 + 0.5), PI * 0.75);
            // a frustum has the area π(R + r)·slant + π(R² + r²) and the volume πh/3·(R² + Rr + r²)
            let slant = (1.0f64 + 9.0).sqrt();
            check(&cylinder(0.5, 1.5, 3.0, axis), PI * (2.0 * slant + 2.5), PI * (0.25 + 0.75 + 2.25));
            check(&cone(2.0, 3.0, axis), PI * 2.0 * (2.0 + 13.0f64.sqrt()), PI * 4.0);
            check(&capsule(0.5, 0.5, 2.0, axis), PI * (1.0 + 2.0), PI * (0.5 + 1.0 / 6.0));
        }
    }

    #[test]
    fn a_capsule_of_two_radii_is_the_hull_of_two_balls() {
        let (top, bottom, height) = (0.5f32, 1.0f32, 2.0f32);
        let geometry = capsule(top, bottom, height, Axis::Z);
        geometry.assert_sound();
        geometry.assert_closed();
        // measured along its normal, each vertex is as far from the centre as the farthest point of
        // the capsule's two balls
        for (&position, &normal) in geometry.positions.iter().zip(&geometry.normals) {
            let support = (top + normal.z * 0.5 * height).max(bottom - normal.z * 0.5 * height);
            assert!((position.dot(normal) - support).abs() < 1e-5, "{position} {normal}");
        }
        // if one ball of a capsule contains the other, the result is the larger ball
        let ball = capsule(0.5, 3.0, 2.0, Axis::Z);
        assert!((ball.volume() / (4.0 / 3.0 * PI * 27.0) - 1.0).abs() < TESSELLATION);
        ball.assert_closed();
    }

    #[test]
    fn spines_point_along_their_axis() {
        for (axis, direction) in [(Axis::X, Vec3::X), (Axis::Y, Vec3::Y), (Axis::Z, Vec3::Z)] {
            let geometry = cone(1.0, 4.0, axis);
            let highest = geometry.positions.iter().map(|p| p.dot(direction)).fold(f32::MIN, f32::max);
            assert_eq!(highest, 2.0);
            let at_tip = geometry.positions.iter().filter(|p| p.dot(direction) > 1.99).count();
            assert_eq!(at_tip, TURN_PARTS + 1, "one vertex a column: the tip is sharp");
        }
    }

    #[test]
    fn planes_face_their_axis() {
        for (axis, normal, size) in [
            (Axis::X, Vec3::X, Vec3::new(0.0, 3.0, 2.0)),
            (Axis::Y, Vec3::Y, Vec3::new(2.0, 0.0, 3.0)),
            (Axis::Z, Vec3::Z, Vec3::new(2.0, 3.0, 0.0)),
        ] {
            let geometry = plane(2.0, 3.0, axis);
            geometry.assert_sound();
            assert_eq!(geometry.normals, [normal; 4]);
            let extent = geometry.positions.iter().fold(Vec3::ZERO, |most, p| most.max(*p)) * 2.0;
            assert_eq!(extent, size);
        }
    }

    #[test]
    fn textures_are_upright_and_not_mirrored() {
        // Seen from outside, u points right and −v points up. So a triangle that is
        // counter-clockwise from outside has a positive area in (u, −v).
        for geometry in [
            sphere(1.0),
            cube(1.0),
            cylinder(1.0, 1.0, 2.0, Axis::Y),
            cone(1.0, 2.0, Axis::X),
            plane(1.0, 1.0, Axis::X),
        ] {
            for triangle in &geometry.triangles {
                let [a, b, c] = triangle.map(|i| geometry.uvs[0][i as usize]);
                assert!((b - a).perp_dot(c - a) < 0.0, "{triangle:?}");
            }
        }
    }

    #[test]
    fn shapes_without_size_have_no_triangles_that_break_anything() {
        for geometry in [
            sphere(0.0),
            cube(0.0),
            cylinder(0.0, 0.0, 0.0, Axis::Z),
            cone(0.0, 0.0, Axis::X),
            capsule(0.0, 0.0, 0.0, Axis::Y),
            plane(0.0, 1.0, Axis::Z),
        ] {
            assert!(geometry.positions.iter().all(|p| p.is_finite()));
            assert!(geometry.normals.iter().all(|n| n.is_finite()));
        }
        cylinder(0.0, 1.0, 1.0, Axis::Z).assert_closed();
    }
}
