//! Cuts polygons into triangles.
//!
//! A convex polygon becomes a fan. A concave quadrilateral is cut along the diagonal that is inside
//! it. Larger concave polygons are cut by ear clipping, in the plane of their Newell normal.
//! Corners at one point share a vertex if all their attributes are equal.

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};

use crate::geometry::Geometry;
use crate::polygons::{Attribute, Corner, Polygons};

/// Cuts a mesh into triangles. Holes, and faces with fewer than three corners, are left out.
pub(crate) fn triangulate(polygons: &Polygons) -> Geometry {
    let mut vertices = Vertices::new(polygons);
    let mut hole = vec![false; polygons.counts.len()];
    for &face in &polygons.holes {
        if let Some(hole) = usize::try_from(face).ok().and_then(|face| hole.get_mut(face)) {
            *hole = true;
        }
    }
    let mut cutter = Cutter::default();
    let mut first = 0;
    let mut ring = Vec::new();
    for (face, &count) in polygons.counts.iter().enumerate() {
        let corners = first..first + count as usize;
        first = corners.end;
        if count < 3 || hole[face] {
            continue;
        }
        ring.clear();
        ring.extend(corners.clone().map(|corner| polygons.corners[corner] as usize));
        for triangle in cutter.cut(&polygons.points, &ring) {
            let mut corners =
                triangle.map(|local| vertices.get(Corner { face, point: ring[local], corner: corners.start + local }));
            if polygons.left_handed {
                corners.swap(1, 2);
            }
            vertices.geometry.triangle(corners, face as u32);
        }
    }
    vertices.geometry
}

/// Returns a polygon's normal (Newell's method). Its length is twice the polygon's area.
fn newell(ring: impl Iterator<Item = DVec3> + Clone) -> DVec3 {
    let Some(origin) = ring.clone().next() else { return DVec3::ZERO };
    let next = ring.clone().skip(1).chain([origin]);
    ring.zip(next).map(|(a, b)| (a - origin).cross(b - origin)).sum()
}

/// The vertices of the triangles that were made so far. Vertices at the same point form a linked
/// list.
struct Vertices<'a> {
    polygons: &'a Polygons,
    geometry: Geometry,
    /// For every point, the first vertex of its linked list.
    first: Vec<u32>,
    /// For every vertex, the next vertex of the linked list of its point.
    next: Vec<u32>,
    /// True if the interpolations give all corners at a point equal attributes. One vertex per
    /// point is then enough.
    single: bool,
}

const NONE: u32 = u32::MAX;

impl<'a> Vertices<'a> {
    fn new(polygons: &'a Polygons) -> Self {
        let single = polygons.normals.as_ref().is_none_or(Attribute::is_smooth)
            && polygons.uvs.iter().flatten().all(Attribute::is_smooth)
            && polygons.colors.as_ref().is_none_or(Attribute::is_smooth)
            && polygons.opacities.as_ref().is_none_or(Attribute::is_smooth);
        let first = vec![NONE; polygons.points.len()];
        Self { polygons, geometry: Geometry::default(), first, next: Vec::new(), single }
    }

    /// Returns the vertex of a corner. Corners at one point share a vertex if their attributes are
    /// equal.
    fn get(&mut self, at: Corner) -> u32 {
        let polygons = self.polygons;
        if self.single && self.first[at.point] != NONE {
            return self.first[at.point];
        }
        let normal = polygons.normals.as_ref().map(|normals| Vec3::from(normals.at(at)).normalize_or(Vec3::Y));
        // v points up in USD and down in the scene
        let uvs =
            polygons.uvs.each_ref().map(|uvs| uvs.as_ref().map(|uvs| uvs.at(at)).map(|[u, v]| Vec2::new(u, 1.0 - v)));
        let color = (polygons.colors.is_some() || polygons.opacities.is_some()).then(|| {
            let color = polygons.colors.as_ref().map_or(Vec3::ONE, |colors| Vec3::from(colors.at(at)));
            let opacity = polygons.opacities.as_ref().map_or(1.0, |opacities| opacities.at(at)[0]);
            color.extend(opacity).clamp(Vec4::ZERO, Vec4::ONE)
        });
        let geometry = &mut self.geometry;
        // Search the point's list for a vertex with equal attributes.
        let mut known = self.first[at.point];
        while known != NONE {
            let i = known as usize;
            let same = normal.is_none_or(|normal| geometry.normals[i] == normal)
                && uvs.iter().zip(&geometry.uvs).all(|(uv, list)| uv.is_none_or(|uv| list[i] == uv))
                && color.is_none_or(|color| geometry.colors[i] == color);
            if same {
                return known;
            }
            known = self.next[i];
        }
        // If no vertex matches, add one at the head of the list.
        let new = geometry.positions.len() as u32;
        geometry.positions.push(Vec3::from(polygons.points[at.point]));
        geometry.normals.extend(normal);
        for (list, uv) in geometry.uvs.iter_mut().zip(uvs) {
            list.extend(uv);
        }
        geometry.colors.extend(color);
        self.next.push(std::mem::replace(&mut self.first[at.point], new));
        new
    }
}

/// Cuts polygons into triangles, with buffers that are allocated only once.
#[derive(Default)]
struct Cutter {
    earcut: earcut::Earcut<f64>,
    flat: Vec<[f64; 2]>,
    indices: Vec<u32>,
    triangles: Vec<[usize; 3]>,
}

impl Cutter {
    /// Returns the triangles of the polygon through `ring`, as indices into `ring`. The triangles
    /// have the orientation of the polygon.
    fn cut(&mut self, points: &[[f32; 3]], ring: &[usize]) -> &[[usize; 3]] {
        let count = ring.len();
        self.triangles.clear();
        if count == 3 {
            self.triangles.push([0, 1, 2]);
            return &self.triangles;
        }
        let at = |i: usize| DVec3::from(points[ring[i]].map(f64::from));
        let normal = newell((0..count).map(at));
        let turn = |i: usize| {
            let (before, here, after) = (at((i + count - 1) % count), at(i), at((i + 1) % count));
            (here - before).cross(after - here).dot(normal)
        };
        let convex = (0..count).all(|i| turn(i) >= 0.0);
        if count == 4 && !convex {
            // start the diagonal at a concave corner, so that the diagonal is inside the polygon
            let hub = if turn(1) < 0.0 || turn(3) < 0.0 { 1 } else { 0 };
            self.triangles.extend([[hub, hub + 1, hub + 2], [hub, hub + 2, (hub + 3) % 4]]);
            return &self.triangles;
        }
        // Project a concave polygon to its plane, and clip its ears in this plane.
        if !convex && normal != DVec3::ZERO {
            let (x, y) = normal.normalize().any_orthonormal_pair();
            self.flat.clear();
            let origin = at(0);
            self.flat
                .extend((0..count).map(|i| DVec2::new((at(i) - origin).dot(x), (at(i) - origin).dot(y)).to_array()));
            self.earcut.earcut_slice(&self.flat, &[], &mut self.indices);
            let area = |[a, b, c]: [usize; 3]| {
                let [a, b, c] = [a, b, c].map(|i| DVec2::from(self.flat[i]));
                (b - a).perp_dot(c - a)
            };
            let found = self.indices.as_chunks::<3>().0.iter().map(|triangle| triangle.map(|i| i as usize));
            let found = found.filter(|triangle| triangle.iter().all(|&i| i < count));
            self.triangles.extend(found.map(|[a, b, c]| if area([a, b, c]) < 0.0 { [a, c, b] } else { [a, b, c] }));
        }
        // A convex or degenerate polygon becomes a fan.
        if self.triangles.is_empty() {
            self.triangles.extend((1..count - 1).map(|i| [0, i, i + 1]));
        }
        &self.triangles
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::polygons::Interpolation;

    /// Returns a mesh with a single face, which is in the plane z = 0.
    fn face(points: &[[f32; 2]]) -> Polygons {
        Polygons {
            points: points.iter().map(|&[x, y]| [x, y, 0.0]).collect(),
            counts: vec![points.len() as i32],
            corners: (0..points.len() as i32).collect(),
            ..Polygons::default()
        }
    }

    /// Returns the area of a polygon by the shoelace formula; positive if the polygon is
    /// counter-clockwise.
    fn shoelace(points: &[[f32; 2]]) -> f64 {
        let next = points.iter().cycle().skip(1);
        0.5 * points.iter().zip(next).map(|(a, b)| f64::from(a[0] * b[1] - b[0] * a[1])).sum::<f64>()
    }

    /// Returns two sums over all triangles: of signed areas and of absolute areas. Both equal the
    /// polygon's area if the triangles cover the polygon once.
    fn areas(geometry: &Geometry) -> [f64; 2] {
        let signed: Vec<f64> = geometry.corners().map(|[a, b, c]| 0.5 * (b - a).cross(c - a).z).collect();
        [signed.iter().sum(), signed.iter().map(|area| area.abs()).sum()]
    }

    #[test]
    fn polygons_of_any_shape_are_covered_once() {
        let star: Vec<[f32; 2]> = (0..20)
            .map(|i| {
                let (angle, radius) = (i as f32 * std::f32::consts::TAU / 20.0, if i % 2 == 0 { 1.0 } else { 0.3 });
                [radius * angle.cos(), radius * angle.sin()]
            })
            .collect();
        let quads = [[0.0, 0.0], [2.0, 0.0], [0.4, 0.4], [0.0, 2.0]];
        for start in 0..4 {
            let mut dart = quads;
            dart.rotate_left(start);
            let geometry = triangulate(&face(&dart));
            let area = shoelace(&dart);
            assert_eq!(geometry.triangles.len(), 2);
            for found in areas(&geometry) {
                assert!((found - area).abs() < 1e-6, "{start}: {found} {area}");
            }
        }
        let ell = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        for polygon in [&star[..], &ell, &[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 1.5], [0.0, 1.0]]] {
            let area = shoelace(polygon);
            for found in areas(&triangulate(&face(polygon))) {
                assert!((found - area).abs() < 1e-6, "{found} {area}");
            }
            let reversed: Vec<_> = polygon.iter().rev().copied().collect();
            let [signed, _] = areas(&triangulate(&face(&reversed)));
            assert!((signed + area).abs() < 1e-6);
            let left = triangulate(&Polygons { left_handed: true, ..face(polygon) });
            assert!((areas(&left)[0] + area).abs() < 1e-6);
        }
    }

    #[test]
    fn polygons_without_area_and_without_corners_do_no_harm() {
        for points in
            [&[[0.0, 0.0]; 7][..], &[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [1.5, 0.0]], &[[1.0, 2.0]; 2]]
        {
            let geometry = triangulate(&face(points));
            assert_eq!(geometry.triangles.len(), points.len().saturating_sub(2));
        }
        let crossed = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.5, 2.0]];
        assert!(!triangulate(&face(&crossed)).triangles.is_empty());
    }

    /// Returns two unit squares next to each other, which share two points.
    fn pair() -> Polygons {
        Polygons {
            points: [[0., 0.], [1., 0.], [1., 1.], [0., 1.], [2., 0.], [2., 1.]].map(|[x, y]| [x, y, 0.0]).to_vec(),
            counts: vec![4, 4],
            corners: vec![0, 1, 2, 3, 1, 4, 5, 2],
            ..Polygons::default()
        }
    }

    #[test]
    fn every_interpolation_reaches_its_corners() {
        use Interpolation::{Constant, FaceVarying, Uniform, Varying, Vertex};
        let all = [(Constant, 1), (Uniform, 2), (Varying, 6), (Vertex, 6), (FaceVarying, 8)];
        for (interpolation, count) in all {
            for indexed in [false, true] {
                let values: Vec<[f32; 2]> = (0..count).map(|i| [i as f32, 0.5]).collect();
                // reverse the order of the indices, so that an index differs from the number of its
                // element
                let indices: Vec<u32> = (0..count as u32).rev().collect();
                let attribute = Attribute { values, interpolation, indices: indexed.then_some(indices) };
                let polygons = Polygons { uvs: [Some(attribute), None], ..pair() };
                let geometry = triangulate(&polygons);
                let mut corner_of = vec![Vec::new(); 8];
                for (triangle, &face) in geometry.triangles.iter().zip(&geometry.face_of_triangle) {
                    for &vertex in triangle {
                        let position = geometry.positions[vertex as usize].to_array();
                        let ring = &polygons.corners[4 * face as usize..][..4];
                        let local = ring.iter().position(|&point| polygons.points[point as usize] == position).unwrap();
                        corner_of[4 * face as usize + local].push(geometry.uvs[0][vertex as usize]);
                    }
                }
                for (corner, found) in corner_of.iter().enumerate() {
                    let element = match interpolation {
                        Constant => 0,
                        Uniform => corner / 4,
                        Varying | Vertex => polygons.corners[corner] as usize,
                        FaceVarying => corner,
                    };
                    let value = if indexed { count - 1 - element } else { element };
                    assert!(
                        !found.is_empty() && found.iter().all(|uv| *uv == Vec2::new(value as f32, 0.5)),
                        "{interpolation:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn corners_share_vertices_where_they_agree() {
        assert_eq!(triangulate(&pair()).positions.len(), 6);
        let agree = |values: [f32; 8]| {
            let values = values.map(|value| [value]).to_vec();
            let opacities = Attribute { values, interpolation: Interpolation::FaceVarying, indices: None };
            triangulate(&Polygons { opacities: Some(opacities), ..pair() }).positions.len()
        };
        assert_eq!(agree([0.5; 8]), 6);
        // the two faces have different values along their common edge, so the points of this edge
        // get two vertices each
        assert_eq!(agree([0., 0., 0., 0., 1., 1., 1., 1.]), 8);
    }

    #[test]
    fn holes_and_faces_of_two_corners_are_left_out() {
        let polygons = Polygons { holes: vec![0, -3, 99], ..pair() };
        assert_eq!(triangulate(&polygons).face_of_triangle, [1, 1]);
        let polygons = Polygons { counts: vec![2, 3, 3, 0], ..pair() };
        assert_eq!(triangulate(&polygons).face_of_triangle, [1, 2]);
    }
}
