//! Triangles that have neither a material nor a placement in the scene.

use glam::{Vec2, Vec3, Vec4};

/// Triangles of any shape. Attributes are per vertex; an absent attribute is an empty list.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Geometry {
    pub(crate) positions: Vec<Vec3>,
    /// Unit normals of the vertices, on the side from which triangles are counter-clockwise.
    pub(crate) normals: Vec<Vec3>,
    /// Texture coordinates as in the scene: v points down (in USD v points up).
    pub(crate) uvs: [Vec<Vec2>; 2],
    /// Linear RGBA values of the vertices.
    pub(crate) colors: Vec<Vec4>,
    /// Vertex indices of the corners of each triangle.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// For each triangle, the index of the polygon, curve or point from which it was made.
    pub(crate) face_of_triangle: Vec<u32>,
}

impl Geometry {
    /// Adds a vertex and returns its index.
    pub(crate) fn vertex(&mut self, position: Vec3, normal: Vec3, uv: Vec2) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.uvs[0].push(uv);
        (self.positions.len() - 1) as u32
    }

    pub(crate) fn triangle(&mut self, corners: [u32; 3], face: u32) {
        self.triangles.push(corners);
        self.face_of_triangle.push(face);
    }

    /// Adds the quadrilateral `a b c d`, which is counter-clockwise, as two triangles. A triangle
    /// with two corners at one position is left out.
    pub(crate) fn quad(&mut self, [a, b, c, d]: [u32; 4], face: u32) {
        for corners in [[a, b, c], [a, c, d]] {
            let [p, q, r] = corners.map(|i| self.positions[i as usize]);
            if p != q && q != r && r != p {
                self.triangle(corners, face);
            }
        }
    }
}

#[cfg(test)]
impl Geometry {
    /// Returns the positions of the three corners of every triangle.
    pub(crate) fn corners(&self) -> impl Iterator<Item = [glam::DVec3; 3]> + Clone {
        self.triangles.iter().map(|triangle| triangle.map(|i| self.positions[i as usize].as_dvec3()))
    }

    /// Returns the area of all triangles together.
    pub(crate) fn area(&self) -> f64 {
        self.corners().map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum()
    }

    /// Returns the enclosed volume, by the divergence theorem. It is positive if triangles are
    /// counter-clockwise seen from outside.
    pub(crate) fn volume(&self) -> f64 {
        self.corners().map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    /// Fails if lists differ in length, indices are out of range, or normals are not unit vectors
    /// on the outer side.
    pub(crate) fn assert_sound(&self) {
        let count = self.positions.len();
        assert_eq!(self.normals.len(), count);
        for list in &self.uvs {
            assert!(list.is_empty() || list.len() == count);
        }
        assert!(self.colors.is_empty() || self.colors.len() == count);
        assert_eq!(self.triangles.len(), self.face_of_triangle.len());
        assert!(self.positions.iter().all(|p| p.is_finite()));
        assert!(self.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-5));
        for (triangle, [a, b, c]) in self.triangles.iter().zip(self.corners()) {
            let face = (b - a).cross(c - a);
            assert!(face.length() > 0.0);
            for &i in triangle {
                assert!(face.dot(self.normals[i as usize].as_dvec3()) > 0.0, "{triangle:?}");
            }
        }
    }

    /// Fails unless the surface is closed and all triangles have the same orientation. Then every
    /// edge, which is identified by the positions of its ends, has one triangle on each side.
    pub(crate) fn assert_closed(&self) {
        use std::collections::HashMap;
        let key = |i: u32| self.positions[i as usize].to_array().map(|x| (x * 1e4).round() as i64);
        let mut balance: HashMap<_, i32> = HashMap::new();
        for &[a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let (from, to) = (key(from), key(to));
                let sign = if from < to { 1 } else { -1 };
                *balance.entry((from.min(to), from.max(to))).or_default() += sign;
            }
        }
        assert!(balance.values().all(|&sum| sum == 0));
    }
}
