//! Limit positions and normals of a refined mesh's vertices.
//!
//! Weights apply to the control points of a level at which all faces are quadrilaterals (triangles
//! for Loop). A vertex v has n neighbours e and n opposite corners f. In Loop's scheme, w is the
//! weight of a neighbour in the refinement of v.
//!
//! ```text
//! Catmull–Clark   position  (n v + Σ (4 e + f)/n) / (n + 5)
//!                 tangents  Σ A cos(2πi/n) e_i + (cos(2πi/n) + cos(2π(i + 1)/n)) f_i; also sin
//!                           A = 1 + cos(2π/n) + cos(π/n) √(2 (9 + cos(2π/n)))
//! Loop            position  (3/(8w) v + Σ e) / (3/(8w) + n)
//!                 tangents  Σ cos(2πi/n) e_i; also sin
//! creases, boundaries       (e₀ + 4 v + e₁)/6
//! ```
//!
//! The second tangent has sines instead of cosines. Sharpness that remains at the last level is
//! treated as infinite.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use super::scheme::Scheme;
use super::stencils::{Stencils, loop_weight, other_end};
use super::topology::{Edge, Fan, Rule, Topology};

/// Returns stencils that project a level's vertices to the limit surface.
pub(super) fn positions(topology: &Topology, scheme: Scheme) -> Stencils {
    let mut stencils = Stencils::with_capacity(topology.vertex_count);
    for vertex in 0..topology.vertex_count as u32 {
        match topology.rule(vertex, 0.0) {
            Rule::Corner => stencils.add(vertex, 1.0),
            Rule::Crease(ends) => {
                stencils.add(vertex, 4.0 / 6.0);
                ends.into_iter().for_each(|end| stencils.add(end, 1.0 / 6.0));
            }
            Rule::Smooth => {
                let n = topology.edges_at(vertex).count() as f64;
                let (own, at_edge, at_face) = if scheme == Scheme::Loop {
                    let own = 0.375 / loop_weight(n as usize);
                    (own / (own + n), 1.0 / (own + n), 0.0)
                } else {
                    (n / (n + 5.0), 4.0 / (n * (n + 5.0)), 1.0 / (n * (n + 5.0)))
                };
                stencils.add(vertex, own);
                topology.edges_at(vertex).for_each(|edge| stencils.add(other_end(edge, vertex), at_edge));
                if at_face > 0.0 {
                    topology
                        .corners_at(vertex)
                        .iter()
                        .for_each(|&corner| stencils.add(opposite(topology, corner), at_face));
                }
            }
        }
        stencils.end();
    }
    stencils
}

/// Returns the vertex of a quadrilateral that is opposite to a corner.
fn opposite(topology: &Topology, corner: u32) -> u32 {
    topology.corners[topology.next(topology.next(corner)) as usize]
}

/// Returns unit normals, and the index of the normal of each corner. `control` are the level's
/// points, and `surface` their limit positions. At level 0, at corners and on bilinear surfaces the
/// formulas for tangents at the top of this file do not apply. In these cases a normal is the mean
/// of the faces' normals, weighted by angle.
pub(super) fn normals(
    topology: &Topology,
    scheme: Scheme,
    level: u32,
    control: &[Vec3],
    surface: &[Vec3],
) -> (Vec<Vec3>, Vec<u32>) {
    let (mut values, mut indices) = (Vec::new(), vec![0; topology.corners.len()]);
    let masks_hold = level > 0 && scheme != Scheme::Bilinear;
    for vertex in 0..topology.vertex_count as u32 {
        let rule = topology.rule(vertex, 0.0);
        // a vertex at which a crease ends has the rule `Smooth`, so the crease does not split the
        // surface
        let splits = |edge: &Edge| scheme == Scheme::Bilinear || (edge.sharpness > 0.0 && rule != Rule::Smooth);
        for fan in topology.fans(vertex, splits) {
            let at = |vertex: u32| control[vertex as usize].as_dvec3();
            let normal = match rule {
                Rule::Smooth if masks_hold && fan.closed => smooth_normal(topology, scheme, &fan, at),
                Rule::Crease(_) if masks_hold && !fan.closed => match scheme {
                    Scheme::Loop => triangle_crease_normal(topology, vertex, &fan, at),
                    _ => crease_normal(topology, vertex, &fan, at),
                },
                _ => DVec3::ZERO,
            };
            let normal = normal.try_normalize().or_else(|| mean_normal(topology, &fan, surface));
            fan.corners.iter().for_each(|&corner| indices[corner as usize] = values.len() as u32);
            values.push(normal.unwrap_or(DVec3::Z).as_vec3());
        }
    }
    (values, indices)
}

/// Returns the neighbours along the edges of a fan, counter-clockwise. An open fan has one
/// neighbour more than it has corners.
fn spokes(topology: &Topology, fan: &Fan) -> Vec<u32> {
    let end = |corner: u32| topology.corners[topology.next(corner) as usize];
    let mut spokes: Vec<u32> = fan.corners.iter().map(|&corner| end(corner)).collect();
    if let (false, Some(&last)) = (fan.closed, fan.corners.last()) {
        spokes.push(topology.corners[topology.previous(last) as usize]);
    }
    spokes
}

fn smooth_normal(topology: &Topology, scheme: Scheme, fan: &Fan, at: impl Fn(u32) -> DVec3) -> DVec3 {
    let n = fan.corners.len() as f64;
    let step = TAU / n;
    let edge_weight = 1.0 + step.cos() + (0.5 * step).cos() * (2.0 * (9.0 + step.cos())).sqrt();
    let (mut along_cos, mut along_sin) = (DVec3::ZERO, DVec3::ZERO);
    for (i, (&corner, spoke)) in fan.corners.iter().zip(spokes(topology, fan)).enumerate() {
        let ((sin, cos), (next_sin, next_cos)) = ((step * i as f64).sin_cos(), (step * (i + 1) as f64).sin_cos());
        if scheme == Scheme::Loop {
            along_cos += cos * at(spoke);
            along_sin += sin * at(spoke);
        } else {
            let diagonal = at(opposite(topology, corner));
            along_cos += edge_weight * cos * at(spoke) + (cos + next_cos) * diagonal;
            along_sin += edge_weight * sin * at(spoke) + (sin + next_sin) * diagonal;
        }
    }
    along_cos.cross(along_sin)
}

/// Returns the normal of a vertex v on one side of a crease, from two tangents. The side has k ≥ 2
/// faces. Its edges at v end at e₀ to e_k, and f_i is the corner of face i opposite to v. With θ =
/// π/k and R = (1 + cos θ)/sin θ:
///
/// ```text
/// along    e₀ − e_k
/// across   4 R (cos θ − 1) v − R (1 + 2 cos θ)(e₀ + e_k)
///          + Σ 4 sin iθ e_i + (sin iθ + sin (i + 1)θ) f_i
/// ```
fn crease_normal(topology: &Topology, vertex: u32, fan: &Fan, at: impl Fn(u32) -> DVec3) -> DVec3 {
    let spokes = spokes(topology, fan);
    let k = fan.corners.len();
    let (Some(&first), Some(&last), true) = (spokes.first(), spokes.last(), k >= 2) else { return DVec3::ZERO };
    let step = PI / k as f64;
    let ratio = (1.0 + step.cos()) / step.sin();
    let mut across = 4.0 * ratio * (step.cos() - 1.0) * at(vertex);
    across -= ratio * (1.0 + 2.0 * step.cos()) * (at(first) + at(last));
    for (i, &corner) in fan.corners.iter().enumerate() {
        let (sin, next_sin) = ((step * i as f64).sin(), (step * (i + 1) as f64).sin());
        let next_sin = if i + 1 == k { 0.0 } else { next_sin };
        if i > 0 {
            across += 4.0 * sin * at(spokes[i]);
        }
        across += (sin + next_sin) * at(opposite(topology, corner));
    }
    (at(first) - at(last)).cross(across)
}

/// Returns the normal on one side of a crease of triangles (Hoppe et al. 1994). The side has k
/// faces, and its edges end at e₀ to e_k; θ is π/k. The tangent across the crease is −sin θ (e₀ +
/// e_k) + (2 − 2 cos θ) Σ sin iθ e_i. If the side has fewer than four faces, other weights apply.
fn triangle_crease_normal(topology: &Topology, vertex: u32, fan: &Fan, at: impl Fn(u32) -> DVec3) -> DVec3 {
    let points: Vec<DVec3> = spokes(topology, fan).into_iter().map(&at).collect();
    let here = at(vertex);
    let across = match *points.as_slice() {
        [first, last] => first + last - 2.0 * here,
        [_, middle, _] => middle - here,
        [first, left, right, last] => 2.0 * (left + right - here) - first - last,
        [first, ref inner @ .., last] => {
            let step = PI / (inner.len() + 1) as f64;
            let sum: DVec3 = (1..).zip(inner).map(|(i, &point)| (step * f64::from(i)).sin() * point).sum();
            (2.0 - 2.0 * step.cos()) * sum - step.sin() * (first + last)
        }
        _ => DVec3::ZERO,
    };
    match points.as_slice() {
        [first, .., last] => (first - last).cross(across),
        _ => DVec3::ZERO,
    }
}

/// Returns the mean of the normals at a fan's corners, weighted by the corners' angles.
fn mean_normal(topology: &Topology, fan: &Fan, surface: &[Vec3]) -> Option<DVec3> {
    let at = |corner: u32| surface[topology.corners[corner as usize] as usize].as_dvec3();
    let weighted = fan.corners.iter().filter_map(|&corner| {
        let here = at(corner);
        let (a, b) = (at(topology.next(corner)) - here, at(topology.previous(corner)) - here);
        let normal = a.cross(b);
        Some(normal.try_normalize()? * a.angle_between(b))
    });
    weighted.sum::<DVec3>().try_normalize()
}
