//! Compares the traversal with a test of every triangle, with its scalar version, and with
//! flattened instances.

use glam::{DVec3, Mat3, Quat, Vec3};
use lumistack_core::seed::Stream;
use lumistack_simd::Backend;

use super::BEAM;
use super::tree::*;

/// Distances of the f32 test and of the f64 oracle differ by less than this. The scenes are about 2
/// units wide.
const DISTANCE_TOLERANCE: f64 = 2e-5;
/// If a ray passes an edge at less than this distance (in barycentric units), rounding in f32
/// decides whether it hits the triangle. Such rays are not compared.
const EDGE_MARGIN: f64 = 1e-4;

fn build(triangles: &[[Vec3; 3]], flags: &[u32]) -> Bvh {
    Bvh::new(&Input { triangles, flags, loose: 0..triangles.len(), shared: &[], placements: &[] })
}

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

/// Intersects all triangles by Möller, Trumbore 1997 in f64. The second result is true if the ray
/// passes an edge so closely that f32 may decide differently.
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
        let bvh = build(&triangles, &vec![0; count]);
        let mut stack = bvh.stack();
        let mut stream = Stream::new(9);
        let (mut compared, mut found) = (0, 0);
        for i in 0..400 {
            let origin = random_point(&mut stream, 4.0);
            let axis_parallel = [Vec3::X, Vec3::NEG_Y, Vec3::Z][i % 3];
            let direction = if i.is_multiple_of(10) {
                axis_parallel
            } else {
                (random_point(&mut stream, 1.0) - 0.5 * origin).normalize()
            };
            let ray = Ray { origin, direction, t_max: f32::INFINITY };
            // compare hit, side, barycentrics and occlusion with the oracle
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
    // a finely divided, bumpy sphere seen from inside: every ray must hit, also through vertices
    // and edges
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
    let bvh = build(&triangles, &vec![0; triangles.len()]);
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
    let bvh = build(&[square(1.0), square(0.0), square(-1.0)], &[ALPHA, CULL_BACK, 0]);
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
    let bvh = build(&vec![triangle; 5000], &vec![0; 5000]);
    let ray = Ray { origin: Vec3::new(0.2, 0.2, 1.0), direction: Vec3::NEG_Z, t_max: 10.0 };
    assert!(bvh.nearest(&ray, &mut bvh.stack(), |_| true).is_some());
}

/// Returns a soup of small, large, needle-like, flat and coincident triangles.
fn hostile_soup(seed: u64) -> Vec<[Vec3; 3]> {
    let mut triangles = soup(200, 0.1, seed);
    triangles.extend(soup(10, 3.0, seed + 1));
    let mut stream = Stream::new(seed + 2);
    for _ in 0..30 {
        let (a, b) = (random_point(&mut stream, 2.0), random_point(&mut stream, 2.0));
        triangles.push([a, b, a + 1e-4 * (b - a) + 1e-5 * random_point(&mut stream, 1.0)]);
        triangles.push([a, b, b]);
        triangles.push([a, a, a]);
        triangles.extend([[a, b, -a]; 2]);
        // a triangle in a plane perpendicular to an axis
        triangles.push([a, b, -b].map(|corner| corner.with_y(0.5)));
    }
    triangles
}

fn random_ray(stream: &mut Stream, i: usize) -> Ray {
    let origin = random_point(stream, 4.0);
    let axis_parallel = [Vec3::X, Vec3::NEG_Y, Vec3::Z][i % 3];
    let direction = if i.is_multiple_of(10) { axis_parallel } else { random_point(stream, 1.0) - 0.5 * origin };
    Ray { origin, direction, t_max: if i.is_multiple_of(4) { 2.0 } else { f32::INFINITY } }
}

#[test]
fn hostile_triangles_are_found_as_by_testing_each() {
    let triangles = hostile_soup(3);
    let bvh = build(&triangles, &vec![0; triangles.len()]);
    let mut stack = bvh.stack();
    let mut stream = Stream::new(4);
    let (mut compared, mut found) = (0, 0);
    for i in 0..2000 {
        let ray = random_ray(&mut stream, i);
        let (expected, doubtful) = oracle(&triangles, &ray);
        if doubtful {
            continue;
        }
        compared += 1;
        let hit = bvh.nearest(&ray, &mut stack, |_| true);
        assert_eq!(hit.is_some(), expected.is_some(), "{ray:?}");
        let open = bvh.transmittance(&ray, &mut stack, |_| Vec3::ZERO);
        assert_eq!(open == Vec3::ONE, expected.is_none());
        if let (Some(hit), Some((t, _))) = (hit, expected) {
            // If several triangles coincide, any of them is a right hit. The unit of t is the
            // direction's length, so the error of t is multiplied by that length.
            found += 1;
            let error = (f64::from(hit.t) - t).abs() * f64::from(ray.direction.length());
            assert!(error < 10.0 * DISTANCE_TOLERANCE, "{error} {ray:?}");
        }
    }
    assert!(compared > 1000 && found > 500, "{compared} rays, {found} hits");
}

#[test]
fn vectors_and_scalars_give_the_same_bits() {
    let mut triangles = hostile_soup(7);
    triangles.extend(soup(3000, 0.1, 5));
    let flags: Vec<u32> = (0..triangles.len()).map(|i| [0, CULL_BACK, ALPHA][i % 3]).collect();
    let bvh = build(&triangles, &flags);
    let portable = Bvh { backend: Backend::available()[0], ..build(&triangles, &flags) };
    let mut stack = bvh.stack();
    let mut stream = Stream::new(8);
    let mut found = 0;
    for i in 0..3000 {
        let ray = random_ray(&mut stream, i);
        let accept = |hit: &Hit| hit.triangle.is_multiple_of(2);
        let pass = |hit: &Hit| Vec3::splat(if hit.triangle.is_multiple_of(2) { 0.5 } else { 1.0 });
        let fast = bvh.nearest(&ray, &mut stack, accept);
        let slow = portable.nearest(&ray, &mut stack, accept);
        let slow_passed = portable.transmittance(&ray, &mut stack, pass);
        found += usize::from(fast.is_some());
        let bits = |hit: Option<Hit>| {
            hit.map(|h| (h.t.to_bits(), h.triangle, h.front, h.flags, h.barycentric.map(f32::to_bits)))
        };
        assert_eq!(bits(fast), bits(slow), "{ray:?}");
        assert_eq!(bvh.transmittance(&ray, &mut stack, pass), slow_passed);
    }
    assert!(found > 1000, "{found}");
}

#[test]
fn instances_are_met_where_their_copies_would_be() {
    // make loose triangles and instances of one mesh, and copies of the instances' triangles
    let mesh = soup(500, 0.3, 11);
    let mut stream = Stream::new(12);
    let mut triangles = soup(50, 0.3, 13);
    let mut flat = triangles.clone();
    let loose = 0..triangles.len();
    triangles.extend(&mesh);
    let shared = loose.end..triangles.len();
    let mut placements = Vec::new();
    for id in 0..20u32 {
        let turn = Mat3::from_quat(Quat::from_euler(glam::EulerRot::XYZ, id as f32, 0.7 * id as f32, 0.3));
        // every other instance is mirrored, all are stretched
        let stretch = Vec3::new(if id % 2 == 0 { 0.3 } else { -0.2 }, 0.25, 0.1 + 0.01 * id as f32);
        let render_from_tree = turn * Mat3::from_diagonal(stretch);
        let translation = random_point(&mut stream, 2.0);
        for corners in &mesh {
            let [a, b, c] = corners.map(|corner| render_from_tree * corner + translation);
            flat.push(if id % 2 == 0 { [a, b, c] } else { [a, c, b] });
        }
        let tree_from_render = render_from_tree.inverse();
        placements.push(Placement { shared: 0, id, render_from_tree, tree_from_render, translation });
    }
    // build a tree with instances, and a tree over the copies
    let flags = vec![CULL_BACK; flat.len()];
    let flags_shared = &flags[..triangles.len()];
    let two_level = Bvh::new(&Input {
        triangles: &triangles,
        flags: flags_shared,
        loose: loose.clone(),
        shared: std::slice::from_ref(&shared),
        placements: &placements,
    });
    let one_level = build(&flat, &flags);
    assert!(two_level.bytes() * 4 < one_level.bytes());
    let (mut stack, mut flat_stack) = (two_level.stack(), one_level.stack());
    let (mut found, mut in_instances, mut differing) = (0, 0, 0);
    // trace the same rays in both trees
    for i in 0..5000 {
        let ray = random_ray(&mut stream, i);
        let expected = one_level.nearest(&ray, &mut flat_stack, |_| true).map(|hit| {
            let instance = (hit.triangle as usize).checked_sub(loose.end).map(|at| at / mesh.len());
            let triangle = instance
                .map_or(hit.triangle as usize, |_| loose.end + (hit.triangle as usize - loose.end) % mesh.len());
            (instance.map_or(NO_INSTANCE, |i| i as u32), triangle as u32, hit.t)
        });
        let hit = two_level.nearest(&ray, &mut stack, |_| true);
        let open = two_level.transmittance(&ray, &mut stack, |_| Vec3::ZERO) == Vec3::ONE;
        assert_eq!(open, hit.is_none());
        let same = match (expected, hit) {
            (Some((instance, triangle, t)), Some(hit)) => {
                found += 1;
                in_instances += usize::from(instance != NO_INSTANCE);
                hit.front
                    && (instance, triangle) == (hit.instance, hit.triangle)
                    && (hit.t - t).abs() < 1e-4 * t.max(1.0)
            }
            (None, None) => true,
            _ => false,
        };
        differing += usize::from(!same);
    }
    // for a ray that passes an edge very closely, rounding decides whether it hits
    assert!(found > 1000 && in_instances > 500 && differing <= 3, "{found} {in_instances} {differing}");
}

#[test]
fn an_instance_alone_is_a_scene() {
    let triangles = [[Vec3::ZERO, Vec3::X, Vec3::Y]];
    let placement = Placement {
        shared: 0,
        id: 7,
        render_from_tree: Mat3::IDENTITY,
        tree_from_render: Mat3::IDENTITY,
        translation: Vec3::Z,
    };
    let bvh = Bvh::new(&Input {
        triangles: &triangles,
        flags: &[0],
        loose: 0..0,
        shared: std::slice::from_ref(&(0..1)),
        placements: &[placement],
    });
    let ray = Ray { origin: Vec3::new(0.2, 0.2, 3.0), direction: Vec3::NEG_Z, t_max: 10.0 };
    let hit = bvh.nearest(&ray, &mut bvh.stack(), |_| true).unwrap();
    assert_eq!((hit.instance, hit.triangle, hit.t), (7, 0, 2.0));
    let empty = build(&[], &[]);
    assert!(empty.nearest(&ray, &mut empty.stack(), |_| true).is_none());
    assert_eq!(empty.transmittance(&ray, &mut empty.stack(), |_| Vec3::ZERO), Vec3::ONE);
}

/// Beams of all sizes and widths, some of them parallel to an axis, return the distances of single
/// rays, bit for bit. `accept` rejects some hits of some rays. If several triangles coincide, any
/// of them is a right hit.
#[test]
fn a_beam_has_the_hits_of_its_rays() {
    let mut triangles = hostile_soup(13);
    triangles.extend(soup(3000, 0.1, 14));
    let flags: Vec<u32> = (0..triangles.len()).map(|i| [0, CULL_BACK, ALPHA][i % 3]).collect();
    let bvh = build(&triangles, &flags);
    let portable = Bvh { backend: Backend::available()[0], ..build(&triangles, &flags) };
    let mut stack = bvh.stack();
    let mut stream = Stream::new(15);
    let mut found = 0;
    for i in 0..3000 {
        // make a beam of 1 to `BEAM` rays that start and run within `width` of an axis
        let count = 1 + i % BEAM;
        let axis = Ray { t_max: f32::INFINITY, ..random_ray(&mut stream, i) };
        let width = [0.0, 1e-4, 1e-2, 0.3, 3.0][i % 5];
        let rays: Vec<Ray> = (0..count)
            .map(|_| Ray {
                origin: axis.origin + random_point(&mut stream, width),
                direction: axis.direction + random_point(&mut stream, width),
                ..axis
            })
            .collect();
        let accept = |ray: usize, hit: &Hit| !(hit.triangle as usize + ray).is_multiple_of(3);
        // trace the beam with vectors and with scalar code, and compare both with single rays
        let (mut hits, mut slow) = ([None; BEAM], [None; BEAM]);
        bvh.nearest_of_beam(&rays, &mut hits, &mut stack, accept);
        portable.nearest_of_beam(&rays, &mut slow, &mut stack, accept);
        for (index, ray) in rays.iter().enumerate() {
            let alone = bvh.nearest(ray, &mut stack, |hit| accept(index, hit));
            let t = |hit: Option<Hit>| hit.map(|hit| hit.t.to_bits());
            assert_eq!(t(hits[index]), t(alone), "{index} of {rays:?}");
            assert_eq!(t(slow[index]), t(alone), "{index} of {rays:?}");
            found += usize::from(alone.is_some());
        }
        assert!(hits[count..].iter().all(Option::is_none));
    }
    assert!(found > 5000, "{found}");
}
