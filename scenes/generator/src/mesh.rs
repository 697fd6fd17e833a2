//! Triangle meshes with normals and texture coordinates, and the simple bodies of the scenes.
//!
//! Lengths are in metres, and axes are world axes (x right, y up, z to the viewer), unless a
//! function states other axes. Front faces wind counter-clockwise. Texture coordinates are 0 at an
//! image's top left corner, as in glTF.

use std::f64::consts::{PI, TAU};

use glam::{DMat4, DVec2, DVec3};

/// The ends of an edge up to this length are treated as one vertex, as at the pole of a sphere.
const COLLAPSED_EDGE_M: f64 = 1e-9;

/// An indexed triangle list; `texcoords` is empty or as long as `positions`.
#[derive(Debug, Clone, Default)]
pub(crate) struct Mesh {
    /// Vertex positions in metres.
    pub(crate) positions: Vec<DVec3>,
    /// Unit normals.
    pub(crate) normals: Vec<DVec3>,
    /// Texture coordinates.
    pub(crate) texcoords: Vec<DVec2>,
    /// Three vertex indices per triangle.
    pub(crate) indices: Vec<u32>,
}

impl Mesh {
    /// Makes a grid of (columns + 1) x (rows + 1) vertices. `vertex(u, v)` returns position and
    /// normal for u and v in 0..1.
    ///
    /// Seen from the front, `u` rises to the right and `v` downwards. A triangle without area, as
    /// at a pole, is omitted.
    pub(crate) fn grid(columns: u32, rows: u32, mut vertex: impl FnMut(f64, f64) -> (DVec3, DVec3)) -> Self {
        let mut mesh = Self::default();
        for row in 0..=rows {
            for column in 0..=columns {
                let (u, v) = (f64::from(column) / f64::from(columns), f64::from(row) / f64::from(rows));
                let (position, normal) = vertex(u, v);
                mesh.positions.push(position);
                mesh.normals.push(normal);
                mesh.texcoords.push(DVec2::new(u, v));
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let top = row * (columns + 1) + column;
                let bottom = top + columns + 1;
                mesh.push_triangle([top, bottom, top + 1]);
                mesh.push_triangle([top + 1, bottom, bottom + 1]);
            }
        }
        mesh
    }

    /// Makes a flat rectangle, given its top left corner and its edges to the right and down.
    pub(crate) fn rectangle(top_left: DVec3, right: DVec3, down: DVec3) -> Self {
        let normal = down.cross(right).normalize();
        Self::grid(1, 1, |u, v| (top_left + u * right + v * down, normal))
    }

    /// Makes a sphere about the origin. The texture is equirectangular, and its left and right ends
    /// join on the side that faces -z.
    pub(crate) fn sphere(radius: f64, columns: u32, rows: u32) -> Self {
        Self::grid(columns, rows, |u, v| {
            let (sin, cos) = (TAU * (u - 0.5)).sin_cos();
            let ring = (PI * v).sin();
            let normal = DVec3::new(ring * sin, (PI * v).cos(), ring * cos);
            (radius * normal, normal)
        })
    }

    /// Makes a body of revolution about y. `profile` has points (radius, height) from top to
    /// bottom.
    ///
    /// Every segment of the profile has its own normals, so corners are sharp. A texture goes once
    /// around the body.
    pub(crate) fn lathe(profile: &[(f64, f64)], columns: u32) -> Self {
        let mut mesh = Self::default();
        for segment in profile.windows(2) {
            let ((r0, y0), (r1, y1)) = (segment[0], segment[1]);
            let slope = DVec2::new(y0 - y1, r1 - r0).normalize();
            mesh.append(&Self::grid(columns, 1, |u, v| {
                let (sin, cos) = (TAU * u).sin_cos();
                let (radius, height) = (r0 + v * (r1 - r0), y0 + v * (y1 - y0));
                let position = DVec3::new(radius * sin, height, radius * cos);
                (position, DVec3::new(slope.x * sin, slope.y, slope.x * cos))
            }));
        }
        mesh
    }

    /// Makes an axis-aligned box between two corners. Every face has the whole texture.
    pub(crate) fn cuboid(low: DVec3, high: DVec3) -> Self {
        let size = high - low;
        let (x, y, z) = (DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z);
        let mut mesh = Self::default();
        for (top_left, right, down) in [
            (low + y + z, x, -y),
            (low + x + y, -x, -y),
            (low + x + y + z, -z, -y),
            (low + y, z, -y),
            (low + y, x, z),
            (low + z, x, -z),
        ] {
            mesh.append(&Self::rectangle(top_left, right, down));
        }
        mesh
    }

    /// Adds another mesh's triangles.
    pub(crate) fn append(&mut self, other: &Self) {
        let base = self.positions.len() as u32;
        self.positions.extend_from_slice(&other.positions);
        self.normals.extend_from_slice(&other.normals);
        self.texcoords.extend_from_slice(&other.texcoords);
        self.indices.extend(other.indices.iter().map(|index| base + index));
    }

    /// Transforms the mesh by an affine map; normals are transformed by its inverse transpose.
    pub(crate) fn transformed(mut self, world_from_mesh: DMat4) -> Self {
        let normal_map = world_from_mesh.inverse().transpose();
        for position in &mut self.positions {
            *position = world_from_mesh.transform_point3(*position);
        }
        for normal in &mut self.normals {
            *normal = normal_map.transform_vector3(*normal).normalize();
        }
        self
    }

    /// Moves the mesh by `offset`.
    pub(crate) fn translated(self, offset: DVec3) -> Self {
        self.transformed(DMat4::from_translation(offset))
    }

    /// Multiplies the texture coordinates of the mesh by `scale`.
    pub(crate) fn with_texture_scale(mut self, scale: DVec2) -> Self {
        for texcoord in &mut self.texcoords {
            *texcoord *= scale;
        }
        self
    }

    fn push_triangle(&mut self, corners: [u32; 3]) {
        let [a, b, c] = corners.map(|corner| self.positions[corner as usize]);
        if [a - b, b - c, c - a].iter().all(|edge| edge.length() > COLLAPSED_EDGE_M) {
            self.indices.extend(corners);
        }
    }
}
