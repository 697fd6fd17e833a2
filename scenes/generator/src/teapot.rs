//! The Utah teapot, tessellated from its Bézier patches.
//!
//! A bicubic patch is P(u, v) = Σ_i Σ_j B_i(v) B_j(u) p_ij. The p_ij are control points, and the
//! B are the Bernstein polynomials of degree three. The normal is ∂P/∂u × ∂P/∂v, which points
//! outwards on every patch of this data set.
//!
//! If all control points of a row coincide (a pole: the lid's knob, the middle of the bottom),
//! ∂P/∂u and the cross product are zero there. Then the normal has the direction of its limit,
//! ∂²P/∂u∂v × ∂P/∂v.
//!
//! Source: see `teapot_data`; bicubic patches as in Farin, "Curves and Surfaces for CAGD".

use glam::DVec3;

use crate::mesh::Mesh;
use crate::teapot_data::{CONTROL_POINTS, PATCHES};

/// Derivatives shorter than this, in units of the data set, are treated as zero.
const DEGENERATE_LENGTH: f64 = 1e-9;

/// Indices of the rim's and the lid's patches, between which a ring of added faces closes the gap.
/// In `RIM_PATCHES` the first row of control points is the rim's inner edge. In `LID_EDGE_PATCHES`
/// the last row is the lid's outer edge.
const RIM_PATCHES: std::ops::Range<usize> = 0..4;
const LID_EDGE_PATCHES: std::ops::Range<usize> = 24..28;

/// Makes the teapot. The centre of its foot is the origin, y points up, and the spout points to +x.
/// `scale` is in metres per unit of the data set, in which the pot is 3.15 high and 6.4 long. Each
/// patch has `divisions` x `divisions` cells.
///
/// In the data set a ring between lid and rim is open. Here it is closed, so that the inside is not
/// visible. Texture coordinates are 0..1 on every patch.
pub(crate) fn teapot(divisions: u32, scale: f64) -> Mesh {
    let mut mesh = Mesh::default();
    // Seen from outside of the pot, u of a patch rises to the left, but u of a grid rises to the
    // right. So reverse u.
    for patch in &PATCHES {
        let points = control_points(patch);
        mesh.append(&Mesh::grid(divisions, divisions, |u, v| {
            let (position, normal) = evaluate(&points, 1.0 - u, v);
            (scale * y_up(position), y_up(normal))
        }));
    }
    for (lid, rim) in LID_EDGE_PATCHES.zip(RIM_PATCHES) {
        let (lid, rim) = (control_points(&PATCHES[lid]), control_points(&PATCHES[rim]));
        mesh.append(&Mesh::grid(divisions, 1, |u, v| {
            let lid_edge = evaluate(&lid, 1.0 - u, 1.0).0;
            let rim_edge = evaluate(&rim, 1.0 - u, 0.0).0;
            (scale * y_up(lid_edge.lerp(rim_edge, v)), DVec3::Y)
        }));
    }
    mesh
}

fn control_points(patch: &[u16; 16]) -> [DVec3; 16] {
    patch.map(|index| DVec3::from_array(CONTROL_POINTS[usize::from(index)]))
}

/// Rotates the data set's axes (z up) to the scene's axes (y up). A rotation keeps the handedness.
fn y_up(point: DVec3) -> DVec3 {
    DVec3::new(point.x, point.z, -point.y)
}

/// Returns the position and the unit normal of a patch at (u, v).
fn evaluate(points: &[DVec3; 16], u: f64, v: f64) -> (DVec3, DVec3) {
    let blend = |along_u: [f64; 4], along_v: [f64; 4]| -> DVec3 {
        (0..16).map(|k| along_v[k / 4] * along_u[k % 4] * points[k]).sum()
    };
    let (bu, bv) = (bernstein(u), bernstein(v));
    let (du, dv) = (bernstein_derivative(u), bernstein_derivative(v));
    let position = blend(bu, bv);
    let mut along_u = blend(du, bv);
    if along_u.length() < DEGENERATE_LENGTH {
        // At a pole use the limit: next to it ∂P/∂u ≈ (v - v_pole) ∂²P/∂u∂v. No patch has its pole
        // at v = 1, so the factor is positive, and the two vectors have the same direction.
        along_u = blend(du, dv);
    }
    (position, along_u.cross(blend(bu, dv)).normalize())
}

fn bernstein(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t]
}

fn bernstein_derivative(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [-3.0 * s * s, 3.0 * s * (s - 2.0 * t), 3.0 * t * (2.0 * s - t), 3.0 * t * t]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vertices of neighbouring patches count as one point if their distance is less than this, in
    /// units of the data set.
    const WELD_DISTANCE: f64 = 1e-6;
    /// Smallest cosine between a vertex normal and the normal of a face at that vertex.
    /// Neighbouring faces of 12 x 12 cells differ by less than 60 degrees, even at the tight ends
    /// of handle and lip.
    const FACE_NORMAL_COSINE: f64 = 0.5;

    #[test]
    fn bounds_are_those_of_the_published_pot() {
        let mesh = teapot(12, 1.0);
        let low = mesh.positions.iter().copied().reduce(DVec3::min).expect("the mesh has vertices");
        let high = mesh.positions.iter().copied().reduce(DVec3::max).expect("the mesh has vertices");
        assert!(low.y.abs() < 1e-12 && (high.y - 3.15).abs() < 1e-12, "{low} {high}");
        assert!((low.x + 3.0).abs() < 0.02 && (high.x - 3.43).abs() < 0.03, "{low} {high}");
        assert!((low.z + high.z).abs() < 1e-12 && (high.z - 2.0).abs() < 0.02, "{low} {high}");
    }

    #[test]
    fn faces_wind_with_their_unit_normals() {
        let mesh = teapot(12, 1.0);
        for normal in &mesh.normals {
            assert!((normal.length() - 1.0).abs() < 1e-12, "{normal}");
        }
        for corners in mesh.indices.chunks_exact(3) {
            let corner = |k: usize| corners[k] as usize;
            let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[corner(k)]);
            let face = (b - a).cross(c - a).normalize();
            for k in 0..3 {
                let cosine = face.dot(mesh.normals[corner(k)]);
                assert!(cosine > FACE_NORMAL_COSINE, "cosine {cosine} at {}", mesh.positions[corner(k)]);
            }
        }
    }

    #[test]
    fn normals_point_away_from_the_axis_of_the_body_and_down_below() {
        let mesh = teapot(8, 1.0);
        let per_patch = 81;
        for (k, (position, normal)) in mesh.positions.iter().zip(&mesh.normals).enumerate() {
            match k / per_patch {
                4..=11 => assert!(normal.dot(DVec3::new(position.x, 0.0, position.z)) > 0.0, "{position}"),
                28..=31 => assert!(normal.y < 0.1, "{position} {normal}"),
                _ => {}
            }
        }
    }

    #[test]
    fn poles_have_vertical_normals() {
        let mesh = teapot(6, 1.0);
        let on_axis = |height: f64, up: f64| {
            let at_pole: Vec<_> = mesh
                .positions
                .iter()
                .zip(&mesh.normals)
                .filter(|(p, _)| (**p - DVec3::Y * height).length() < WELD_DISTANCE)
                .collect();
            assert!(!at_pole.is_empty());
            for (_, normal) in at_pole {
                assert!((*normal - DVec3::Y * up).length() < 1e-6, "{normal}");
            }
        };
        on_axis(3.15, 1.0);
        on_axis(0.0, -1.0);
    }

    #[test]
    fn body_rim_lid_and_bottom_are_closed() {
        // If coinciding vertices count as one, two triangles share every edge of these patches. So
        // the outer body has no holes.
        let mesh = teapot(5, 1.0);
        let per_patch = 36;
        let weld = |index: u32| (mesh.positions[index as usize] / WELD_DISTANCE).round().to_array().map(|x| x as i64);
        let mut edges = std::collections::HashMap::new();
        for corners in mesh.indices.chunks_exact(3) {
            if (12..20).contains(&(corners[0] / per_patch)) {
                continue; // handle and spout intersect the body, and share no edges with it
            }
            for k in 0..3 {
                let (a, b) = (weld(corners[k]), weld(corners[(k + 1) % 3]));
                *edges.entry((a.min(b), a.max(b))).or_insert(0) += if a < b { 1 } else { -1 };
            }
        }
        let open: Vec<_> = edges.iter().filter(|(_, balance)| **balance != 0).collect();
        assert!(open.is_empty(), "{} edges belong to one face only", open.len());
    }
}
