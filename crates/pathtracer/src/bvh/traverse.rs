//! Traversal: nearest hit and transmittance along a segment.
//!
//! The triangle test is the watertight one of Woop, Benthin, Wald 2013 ("Watertight ray/triangle intersection", JCGT 2(1)): shear
//! the triangle into a space where the ray is the z axis and compare edge functions with zero. Shared edges give exactly opposite
//! values, so a ray cannot pass between two triangles. The slab test is widened by the rounding bound of Ize 2013.

use glam::{Vec3, Vec4};

use super::{Bvh, CULL_BACK, EMPTY, INDEX_MASK, LEAF, WIDTH};

/// Twice the rounding bound γ₃ of the slab test, as a factor (Ize 2013).
const SLAB_WIDENING: f32 = 1.0 + 2.0 * 3.0 * 0.5 * f32::EPSILON;
/// Direction components below this are replaced by it in the slab test, so that 0 · ∞ cannot occur.
const SMALLEST_SLOPE: f32 = 1e-18;

/// A ray or segment origin + t·direction, 0 < t < `t_max`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) origin: Vec3,
    pub(crate) direction: Vec3,
    pub(crate) t_max: f32,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub(crate) t: f32,
    pub(crate) triangle: u32,
    /// Weights of the three vertices; their sum is 1.
    pub(crate) barycentric: [f32; 3],
    /// Whether the triangle winds counter-clockwise as seen from the origin.
    pub(crate) front: bool,
    /// The flags of the triangle.
    pub(crate) flags: u32,
}

/// Reusable memory for postponed children.
pub(crate) struct Stack(Vec<(u32, f32)>);

/// A ray prepared for the slab and triangle tests.
struct Prepared {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
    /// Index of the near plane per axis in [`super::Node::bounds`]; the far plane is 3 further, modulo 6.
    near: [usize; 3],
    axes: [usize; 3],
    shear: [Vec4; 3],
}

impl Bvh {
    /// Memory for traversals of this tree.
    pub(crate) fn stack(&self) -> Stack {
        Stack(vec![(EMPTY, 0.0); self.stack_depth + 1])
    }

    /// The nearest hit that `accept` agrees to. It is asked only for triangles with flags other than [`CULL_BACK`], in any order and
    /// at most once per triangle.
    pub(crate) fn nearest(&self, ray: &Ray, stack: &mut Stack, mut accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        let prepared = Prepared::new(ray);
        let mut nearest = None;
        let mut t_max = ray.t_max;
        let mut depth = 0;
        let mut current = self.root;
        loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (t_near, mut hits) = prepared.enters(&node.bounds, t_max);
                if hits != 0 {
                    let t_near = t_near.to_array();
                    let first = hits.trailing_zeros() as usize;
                    hits &= hits - 1;
                    current = node.children[first];
                    if hits != 0 {
                        // insertion into the stack with the farthest lowest
                        let base = depth;
                        let mut t_current = t_near[first];
                        while hits != 0 {
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            let mut entry = (node.children[lane], t_near[lane]);
                            if entry.1 < t_current {
                                std::mem::swap(&mut entry.0, &mut current);
                                std::mem::swap(&mut entry.1, &mut t_current);
                            }
                            let mut slot = depth;
                            while slot > base && stack.0[slot - 1].1 < entry.1 {
                                stack.0[slot] = stack.0[slot - 1];
                                slot -= 1;
                            }
                            stack.0[slot] = entry;
                            depth += 1;
                        }
                    }
                    continue;
                }
            } else if current != EMPTY {
                let block = &self.blocks[(current & !LEAF) as usize];
                let (mut hits, test) = prepared.meets(&block.vertices, t_max);
                while hits != 0 {
                    let lane = hits.trailing_zeros() as usize;
                    hits &= hits - 1;
                    let hit = test.hit(lane, block.references[lane]);
                    if hit.t < t_max && hit.is_visible() && (hit.flags & !CULL_BACK == 0 || accept(&hit)) {
                        t_max = hit.t;
                        nearest = Some(hit);
                    }
                }
            }
            loop {
                if depth == 0 {
                    return nearest;
                }
                depth -= 1;
                let (node, t) = stack.0[depth];
                if t < t_max {
                    current = node;
                    break;
                }
            }
        }
    }

    /// Product of `transmittance` over all triangles that the segment crosses; it is asked only for triangles with flags other than
    /// [`CULL_BACK`], the others are opaque. Stops at zero.
    pub(crate) fn transmittance(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        mut transmittance: impl FnMut(&Hit) -> Vec3,
    ) -> Vec3 {
        let prepared = Prepared::new(ray);
        let mut product = Vec3::ONE;
        let mut depth = 0;
        let mut current = self.root;
        loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (_, mut hits) = prepared.enters(&node.bounds, ray.t_max);
                while hits != 0 {
                    let lane = hits.trailing_zeros() as usize;
                    hits &= hits - 1;
                    stack.0[depth] = (node.children[lane], 0.0);
                    depth += 1;
                }
            } else if current != EMPTY {
                let block = &self.blocks[(current & !LEAF) as usize];
                let (mut hits, test) = prepared.meets(&block.vertices, ray.t_max);
                while hits != 0 {
                    let lane = hits.trailing_zeros() as usize;
                    hits &= hits - 1;
                    let hit = test.hit(lane, block.references[lane]);
                    if hit.is_visible() {
                        product *= if hit.flags & !CULL_BACK == 0 { Vec3::ZERO } else { transmittance(&hit) };
                        if product == Vec3::ZERO {
                            return product;
                        }
                    }
                }
            }
            if depth == 0 {
                return product;
            }
            depth -= 1;
            current = stack.0[depth].0;
        }
    }
}

impl Hit {
    fn is_visible(&self) -> bool {
        self.front || self.flags & CULL_BACK == 0
    }
}

impl Prepared {
    fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let o = ray.origin.to_array();
        let magnitude = d.map(f32::abs);
        let z = if magnitude[0] > magnitude[1] {
            if magnitude[0] > magnitude[2] { 0 } else { 2 }
        } else if magnitude[1] > magnitude[2] {
            1
        } else {
            2
        };
        // swapping x and y for negative z keeps the winding
        let (x, y) = if d[z] >= 0.0 { ((z + 1) % 3, (z + 2) % 3) } else { ((z + 2) % 3, (z + 1) % 3) };
        let inverse = d.map(|c| 1.0 / if c.abs() < SMALLEST_SLOPE { SMALLEST_SLOPE.copysign(c) } else { c });
        Self {
            origin: o.map(Vec4::splat),
            inverse: inverse.map(Vec4::splat),
            near: std::array::from_fn(|axis| if inverse[axis] < 0.0 { axis + 3 } else { axis }),
            axes: [x, y, z],
            shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]].map(Vec4::splat),
        }
    }

    /// Distances at which the ray enters four boxes, and a bit per box that it enters before `t_max`.
    #[inline(always)]
    fn enters(&self, bounds: &[Vec4; 6], t_max: f32) -> (Vec4, u32) {
        let mut near = Vec4::ZERO;
        let mut far = Vec4::splat(t_max);
        for axis in 0..3 {
            let at_near = self.near[axis];
            let at_far = if at_near < 3 { at_near + 3 } else { at_near - 3 };
            near = ((bounds[at_near] - self.origin[axis]) * self.inverse[axis]).max(near);
            far = ((bounds[at_far] - self.origin[axis]) * (self.inverse[axis] * SLAB_WIDENING)).min(far);
        }
        (near, near.cmple(far).bitmask())
    }

    /// Tests four triangles; a bit per triangle that is met at 0 < t < `t_max`.
    #[inline(always)]
    fn meets(&self, vertices: &[[Vec4; 3]; 3], t_max: f32) -> (u32, Test) {
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        let sheared = |vertex: &[Vec4; 3]| {
            let z = vertex[kz] - self.origin[kz];
            (vertex[kx] - self.origin[kx] - sx * z, vertex[ky] - self.origin[ky] - sy * z, sz * z)
        };
        let ((ax, ay, az), (bx, by, bz), (cx, cy, cz)) =
            (sheared(&vertices[0]), sheared(&vertices[1]), sheared(&vertices[2]));
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let determinant = u + v + w;
        let low = u.min(v).min(w);
        let high = u.max(v).max(w);
        let inside = (low.cmpge(Vec4::ZERO) | high.cmple(Vec4::ZERO)) & determinant.cmpne(Vec4::ZERO);
        if !inside.any() {
            return (0, Test { t: Vec4::ZERO, u, v, determinant });
        }
        let t = (u * az + v * bz + w * cz) / determinant;
        let within = t.cmpgt(Vec4::ZERO) & t.cmplt(Vec4::splat(t_max));
        ((inside & within).bitmask(), Test { t, u, v, determinant })
    }
}

/// Result of the triangle test, one lane per triangle.
struct Test {
    t: Vec4,
    u: Vec4,
    v: Vec4,
    determinant: Vec4,
}

impl Test {
    #[inline(always)]
    fn hit(&self, lane: usize, reference: u32) -> Hit {
        debug_assert!(lane < WIDTH);
        let scale = 1.0 / self.determinant[lane];
        let (u, v) = (self.u[lane] * scale, self.v[lane] * scale);
        Hit {
            t: self.t[lane],
            triangle: reference & INDEX_MASK,
            barycentric: [u, v, 1.0 - u - v],
            front: self.determinant[lane] > 0.0,
            flags: reference & !INDEX_MASK,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::ALPHA;
    use super::*;
    use glam::DVec3;
    use lumistack_core::seed::Stream;

    /// Distances of the f32 test and the f64 oracle agree to this share of the scene's size.
    const DISTANCE_TOLERANCE: f64 = 2e-5;
    /// Rays that pass an edge closer than this (in barycentric units) may go either way in f32 and are not compared.
    const EDGE_MARGIN: f64 = 1e-4;

    fn random_point(stream: &mut Stream, size: f32) -> Vec3 {
        (Vec3::new(stream.next_f32(), stream.next_f32(), stream.next_f32()) - 0.5) * size
    }

    fn soup(count: usize, edge: f32, seed: u64) -> Vec<[Vec3; 3]> {
        let mut stream = Stream::new(seed);
        (0..count)
            .map(|_| {
                let centre = random_point(&mut stream, 2.0);
                [0; 3].map(|_| centre + random_point(&mut stream, edge))
            })
            .collect()
    }

    /// Möller, Trumbore 1997 in f64 over all triangles; also returns whether any edge is so near that f32 may differ.
    fn oracle(triangles: &[[Vec3; 3]], ray: &Ray) -> (Option<(f64, u32)>, bool) {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let mut best: Option<(f64, u32)> = None;
        let mut doubtful = false;
        for (index, triangle) in triangles.iter().enumerate() {
            let [a, b, c]: [DVec3; 3] = triangle.map(|v| v.as_dvec3());
            let (e1, e2) = (b - a, c - a);
            let p = d.cross(e2);
            let determinant = e1.dot(p);
            if determinant.abs() < 1e-12 {
                continue;
            }
            let s = o - a;
            let u = s.dot(p) / determinant;
            let q = s.cross(e1);
            let v = d.dot(q) / determinant;
            let t = e2.dot(q) / determinant;
            let smallest = u.min(v).min(1.0 - u - v);
            if t > -1e-6 && t < f64::from(ray.t_max) {
                doubtful |= smallest.abs() < EDGE_MARGIN || t < 1e-6;
                if smallest >= 0.0 && t > 0.0 && best.is_none_or(|(nearest, _)| t < nearest) {
                    best = Some((t, index as u32));
                }
            }
        }
        (best, doubtful)
    }

    #[test]
    fn traversal_agrees_with_testing_every_triangle() {
        let sizes = [(1, 1.0), (2, 1.0), (4, 0.5), (5, 0.5), (9, 0.5), (100, 0.3), (3000, 0.1)];
        for (count, edge) in sizes {
            let triangles = soup(count, edge, count as u64);
            let bvh = Bvh::build(&triangles, &vec![0; count]);
            let mut stack = bvh.stack();
            let mut stream = Stream::new(9);
            let (mut compared, mut found) = (0, 0);
            for i in 0..400 {
                let origin = random_point(&mut stream, 4.0);
                let axis_parallel = [Vec3::X, Vec3::NEG_Y, Vec3::Z][i % 3];
                let direction = if i % 10 == 0 {
                    axis_parallel
                } else {
                    (random_point(&mut stream, 1.0) - 0.5 * origin).normalize()
                };
                let ray = Ray { origin, direction, t_max: f32::INFINITY };
                let (expected, doubtful) = oracle(&triangles, &ray);
                if doubtful {
                    continue;
                }
                compared += 1;
                found += usize::from(expected.is_some());
                let hit = bvh.nearest(&ray, &mut stack, |_| true);
                assert_eq!(hit.map(|h| h.triangle), expected.map(|e| e.1), "{count} triangles, {ray:?}");
                let open = bvh.transmittance(&ray, &mut stack, |_| Vec3::ZERO);
                assert_eq!(open == Vec3::ONE, expected.is_none());
                if let (Some(hit), Some((t, _))) = (hit, expected) {
                    assert!((f64::from(hit.t) - t).abs() < DISTANCE_TOLERANCE);
                    let triangle = triangles[hit.triangle as usize];
                    let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
                    assert_eq!(hit.front, normal.dot(direction) < 0.0);
                    let point: Vec3 = (0..3).map(|k| triangle[k] * hit.barycentric[k]).sum();
                    assert!(point.distance(origin + hit.t * direction) < DISTANCE_TOLERANCE as f32);
                }
            }
            assert!(compared > 300 && (count < 100 || found > 50), "{compared} rays, {found} hits");
        }
    }

    #[test]
    fn a_closed_surface_has_no_cracks() {
        // a finely divided, bumpy sphere seen from inside: every ray must hit, also through vertices and along edges
        let (rows, cols) = (40, 60);
        let point = |row: usize, col: usize| {
            let (theta, phi) = (
                std::f32::consts::PI * row as f32 / rows as f32,
                std::f32::consts::TAU * (col % cols) as f32 / cols as f32,
            );
            let radius = 1.0 + 0.1 * ((7 * row + 13 * (col % cols)) % 11) as f32 / 11.0;
            match row {
                0 => Vec3::Z,
                row if row == rows => Vec3::NEG_Z,
                _ => radius * Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()),
            }
        };
        let mut triangles = Vec::new();
        for row in 0..rows {
            for col in 0..cols {
                let (a, b) = (point(row, col), point(row, col + 1));
                let (c, d) = (point(row + 1, col), point(row + 1, col + 1));
                triangles.extend([[a, c, d], [a, d, b]]);
            }
        }
        let bvh = Bvh::build(&triangles, &vec![0; triangles.len()]);
        let mut stack = bvh.stack();
        let mut stream = Stream::new(1);
        for i in 0..200_000 {
            let origin = random_point(&mut stream, 0.5);
            let target = match i % 3 {
                0 => point(i % rows, i % cols),
                1 => 0.5 * (point(i % rows, i % cols) + point(i % rows + 1, i % cols)),
                _ => random_point(&mut stream, 2.0),
            };
            let ray = Ray { origin, direction: (target - origin).normalize(), t_max: f32::INFINITY };
            assert!(bvh.nearest(&ray, &mut stack, |_| true).is_some(), "ray {i} escapes: {ray:?}");
        }
    }

    #[test]
    fn back_faces_and_refused_hits_are_passed_through() {
        let square = |z: f32| [Vec3::new(-1.0, -1.0, z), Vec3::new(3.0, -1.0, z), Vec3::new(-1.0, 3.0, z)];
        let ray = |origin: Vec3| Ray { origin, direction: -origin.z.signum() * Vec3::Z, t_max: f32::INFINITY };
        let bvh = Bvh::build(&[square(1.0), square(0.0), square(-1.0)], &[ALPHA, CULL_BACK, 0]);
        let mut stack = bvh.stack();
        let (above, below) = (Vec3::new(0.0, 0.0, 5.0), Vec3::new(0.0, 0.0, -0.5));
        assert_eq!(bvh.nearest(&ray(above), &mut stack, |_| true).unwrap().triangle, 0);
        assert_eq!(bvh.nearest(&ray(above), &mut stack, |_| false).unwrap().triangle, 1);
        assert_eq!(bvh.nearest(&ray(below), &mut stack, |_| true).unwrap().triangle, 0, "from behind");
        let half = Vec3::splat(0.5);
        assert_eq!(bvh.transmittance(&ray(below), &mut stack, |_| half), half);
        assert_eq!(bvh.transmittance(&ray(above), &mut stack, |_| half), Vec3::ZERO);
    }

    #[test]
    fn many_equal_triangles_do_not_exhaust_the_stack() {
        let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let bvh = Bvh::build(&vec![triangle; 5000], &vec![0; 5000]);
        let ray = Ray { origin: Vec3::new(0.2, 0.2, 1.0), direction: Vec3::NEG_Z, t_max: 10.0 };
        assert!(bvh.nearest(&ray, &mut bvh.stack(), |_| true).is_some());
    }
}
