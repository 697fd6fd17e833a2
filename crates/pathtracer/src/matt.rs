//! Lambert's law alone, f = c/π: what [`Bsdf`](crate::bsdf::Bsdf) is for materials that reflect and transmit nothing, at a fraction of the cost.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use lumistack_scene::Material;

use crate::bsdf::Scatter;

/// A matt point.
pub(crate) struct Matt {
    albedo: Vec3,
    /// Geometric and shading normal on the viewer's side.
    geometric: Vec3,
    shading: Vec3,
}

/// Whether a material is matt whatever its textures say.
pub(crate) fn is_matt(material: &Material) -> bool {
    let no_gloss = material.ior == 1.0 || material.specular == 0.0 && material.specular_texture.is_none();
    let no_layers = material.clearcoat.is_none() && material.sheen.is_none() && material.iridescence.is_none();
    material.metallic == 0.0 && material.transmission == 0.0 && no_gloss && no_layers
}

impl Matt {
    #[inline]
    pub(crate) fn new(albedo: Vec3, geometric: Vec3, shading: Vec3) -> Self {
        Self { albedo, geometric, shading }
    }

    /// The same point with another horizon than that of the geometric normal.
    #[inline]
    pub(crate) fn above(&self, horizon: Vec3) -> Self {
        Self { geometric: horizon, ..*self }
    }

    /// f |cos| and density.
    #[inline]
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        let density = direction.dot(self.shading) * FRAC_1_PI;
        if density > 0.0 && direction.dot(self.geometric) > 0.0 {
            (self.albedo * density, density)
        } else {
            (Vec3::ZERO, 0.0)
        }
    }

    /// A scattered direction, from one of [`cosine_direction`](crate::bsdf::cosine_direction) around the z axis; `None` when it is below the surface
    /// or nothing is reflected.
    #[inline]
    pub(crate) fn sample(&self, local: Vec3) -> Option<Scatter> {
        let (tangent, bitangent) = self.shading.any_orthonormal_pair();
        let direction = local.x * tangent + local.y * bitangent + local.z * self.shading;
        let is_above = direction.dot(self.geometric) > 0.0 && self.albedo != Vec3::ZERO;
        is_above.then_some(Scatter {
            direction,
            weight: self.albedo,
            pdf: local.z * FRAC_1_PI,
            crossed: false,
            refracted: false,
            alpha: 1.0,
        })
    }
}
