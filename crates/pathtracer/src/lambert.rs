//! Lambert's law alone, f = c/π. It replaces [`Bsdf`](crate::bsdf::Bsdf) for materials without
//! specular reflection and transmission, at a fraction of the cost.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use lumistack_scene::Material;

use crate::bsdf::{Layers, Scatter};
use crate::normals::Normals;

/// A point that scatters by Lambert's law alone.
pub(crate) struct Lambert {
    albedo: Vec3,
    /// Geometric normal on the viewer's side.
    geometric: Vec3,
    normals: Normals,
}

/// Returns true if a material scatters by Lambert's law alone, for all texels of its textures.
pub(crate) fn is_lambertian(material: &Material) -> bool {
    let no_gloss = material.ior == 1.0 || material.specular == 0.0 && material.specular_texture.is_none();
    let no_layers = !Layers::are_named(material) && material.iridescence.is_none();
    material.metallic == 0.0 && material.transmission == 0.0 && no_gloss && no_layers
}

impl Lambert {
    #[inline]
    pub(crate) fn new(albedo: Vec3, geometric: Vec3, normals: Normals) -> Self {
        Self { albedo, geometric, normals }
    }

    /// Returns the surface's reflectance.
    #[inline]
    pub(crate) fn albedo(&self) -> Vec3 {
        self.albedo
    }

    /// Returns the shading normal on the viewer's side.
    #[inline]
    pub(crate) fn normal(&self) -> Vec3 {
        self.normals.mapped
    }

    /// Returns the same point, with the normal `horizon` instead of its geometric normal.
    #[inline]
    pub(crate) fn above(&self, horizon: Vec3) -> Self {
        Self { geometric: horizon, ..*self }
    }

    /// Returns f |cos|, and the density with which [`sample`](Self::sample) finds the direction.
    #[inline]
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        let density = direction.dot(self.normals.mapped) * FRAC_1_PI;
        if density > 0.0 && direction.dot(self.geometric) > 0.0 {
            (self.albedo * (density * self.normals.unshadowed(direction)), density)
        } else {
            (Vec3::ZERO, 0.0)
        }
    }

    /// Turns `local`, a direction around the z axis from
    /// [`cosine_directions`](crate::bsdf::cosine_directions), into a direction around the normal.
    /// `None` if that direction is below the surface, or if nothing is reflected.
    #[inline]
    pub(crate) fn sample(&self, local: Vec3) -> Option<Scatter> {
        let (tangent, bitangent) = self.normals.mapped.any_orthonormal_pair();
        let direction = local.x * tangent + local.y * bitangent + local.z * self.normals.mapped;
        let is_above = direction.dot(self.geometric) > 0.0 && self.albedo != Vec3::ZERO;
        is_above.then_some(Scatter {
            direction,
            weight: self.albedo * self.normals.unshadowed(direction),
            pdf: local.z * FRAC_1_PI,
            crossed: false,
            refracted: false,
            alpha: 1.0,
        })
    }
}
