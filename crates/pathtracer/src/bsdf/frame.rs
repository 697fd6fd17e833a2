//! Directions at a point, and the frame of a normal.

use glam::{Mat3, Vec3};

use crate::normals::Normals;

/// Directions at a point; normals are unit vectors on the viewer's side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) geometric: Vec3,
    /// Normal of specular reflection and refraction, bent so that a mirror never reflects the
    /// viewer into the surface.
    pub(crate) shading: Vec3,
    /// Normals of diffuse scattering, which are never bent, unlike `shading`.
    pub(crate) diffuse: Normals,
    /// Normal of the clear coat.
    pub(crate) coat: Vec3,
    /// Direction in which anisotropic reflections are stretched; `None` if any direction is right.
    pub(crate) tangent: Option<Vec3>,
}

impl Frame {
    /// Makes a frame with one normal for all lobes.
    pub(crate) fn flat(geometric: Vec3, shading: Vec3) -> Self {
        Self { geometric, shading, diffuse: Normals::smooth(shading), coat: shading, tangent: None }
    }
}

/// Returns the frame of a normal, with the columns tangent, bitangent and normal.
pub(crate) fn local_frame(normal: Vec3, tangent: Option<Vec3>) -> Mat3 {
    match tangent.and_then(|tangent| (tangent - normal * normal.dot(tangent)).try_normalize()) {
        Some(tangent) => Mat3::from_cols(tangent, normal.cross(tangent), normal),
        None => {
            let (tangent, bitangent) = normal.any_orthonormal_pair();
            Mat3::from_cols(tangent, bitangent, normal)
        }
    }
}

/// Returns the direction to the viewer in a frame, with z > 0.
pub(crate) fn local_viewer(scene_from_local: &Mat3, to_viewer: Vec3) -> Vec3 {
    let mut o = scene_from_local.transpose() * to_viewer;
    o.z = o.z.max(1e-6);
    o
}
