//! Lambert's law alone, f = c/π: what [`Bsdf`](crate::bsdf::Bsdf) is for materials that reflect and transmit nothing, at a fraction of the cost.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use lumistack_scene::Material;

use crate::bsdf::Scatter;

/// A matt point.
pub(crate) struct Matt {
    albedo: Vec3,
    /// Geometric normal on the viewer's side.
    geometric: Vec3,
    normals: Normals,
}

/// Normals of diffuse scattering, unit vectors on the viewer's side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Normals {
    /// That of the vertices, turned by a normal map.
    pub(crate) mapped: Vec3,
    /// That of the vertices.
    smooth: Vec3,
    /// α² of the bumps that the normal map stands for, 0 without one.
    alpha2: f32,
}

impl Normals {
    /// Of a point with a normal map; the bumps' α² = tan² ∠(mapped, smooth) / 8, 1 at most.
    #[inline]
    pub(crate) fn new(mapped: Vec3, smooth: Vec3) -> Self {
        if mapped == smooth {
            return Self::smooth(smooth);
        }
        let cosine2 = mapped.dot(smooth).powi(2);
        Self { mapped, smooth, alpha2: ((1.0 - cosine2) / (8.0 * cosine2).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0) }
    }

    /// Without a normal map.
    #[inline]
    pub(crate) fn smooth(normal: Vec3) -> Self {
        Self { mapped: normal, smooth: normal, alpha2: 0.0 }
    }

    /// The same in another frame.
    pub(crate) fn turned(&self, turn: impl Fn(Vec3) -> Vec3) -> Self {
        let mapped = turn(self.mapped);
        Self { mapped, smooth: if self.alpha2 == 0.0 { mapped } else { turn(self.smooth) }, alpha2: self.alpha2 }
    }

    /// Share of the light from `direction` that bumps do not keep from one another, 2 cos θ / (cos θ + √(cos² θ + α² sin² θ)) with the angle θ to the
    /// smooth normal: Smith's shadowing of a GGX surface as rough as they are (Estevez, Lecocq, Stein 2019, "A microfacet-based shadowing function to
    /// solve the bump terminator problem", Ray Tracing Gems; Cycles has it too). By the cosine to the mapped normal alone light ends in a hard edge
    /// where the smooth surface turns away, and slopes are lit through their neighbours.
    #[inline]
    pub(crate) fn unshadowed(&self, direction: Vec3) -> f32 {
        if self.alpha2 == 0.0 {
            return 1.0;
        }
        let cosine = self.smooth.dot(direction).max(0.0);
        let cosine2 = cosine * cosine;
        2.0 * cosine / (cosine + (cosine2 + self.alpha2 * (1.0 - cosine2).max(0.0)).sqrt())
    }
}

/// Whether a material is matt whatever its textures say.
pub(crate) fn is_matt(material: &Material) -> bool {
    let no_gloss = material.ior == 1.0 || material.specular == 0.0 && material.specular_texture.is_none();
    let no_layers = material.clearcoat.is_none() && material.sheen.is_none() && material.iridescence.is_none();
    material.metallic == 0.0 && material.transmission == 0.0 && no_gloss && no_layers
}

impl Matt {
    #[inline]
    pub(crate) fn new(albedo: Vec3, geometric: Vec3, normals: Normals) -> Self {
        Self { albedo, geometric, normals }
    }

    /// The same point with another horizon than that of the geometric normal.
    #[inline]
    pub(crate) fn above(&self, horizon: Vec3) -> Self {
        Self { geometric: horizon, ..*self }
    }

    /// f |cos| and density.
    #[inline]
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        let density = direction.dot(self.normals.mapped) * FRAC_1_PI;
        if density > 0.0 && direction.dot(self.geometric) > 0.0 {
            (self.albedo * (density * self.normals.unshadowed(direction)), density)
        } else {
            (Vec3::ZERO, 0.0)
        }
    }

    /// A scattered direction, from one of [`cosine_direction`](crate::bsdf::cosine_direction) around the z axis; `None` when it is below the surface
    /// or nothing is reflected.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// What bumps keep from one another: all light at the smooth surface's horizon, none from straight above, and in between more the steeper they are and
    /// the flatter it falls, without a step.
    #[test]
    fn the_shadow_of_bumps_ends_softly() {
        let from = |degrees: f32| Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
        let [mild, steep] = [20.0, 55.0].map(|degrees| Normals::new(from(degrees), Vec3::Z));
        for normals in [mild, steep] {
            assert!((normals.unshadowed(Vec3::Z) - 1.0).abs() < 1e-6);
            assert!(normals.unshadowed(from(89.99)) < 0.01 && normals.unshadowed(from(95.0)) == 0.0);
            for degrees in 0..80 {
                let step = normals.unshadowed(from(degrees as f32)) - normals.unshadowed(from(degrees as f32 + 1.0));
                assert!((0.0..0.05).contains(&step), "{degrees}: {step}");
            }
        }
        assert!(steep.unshadowed(from(70.0)) < mild.unshadowed(from(70.0)));
        // tan² = 1 makes α² = 1/8, and θ = 45°: 2 / (1 + √1.125)
        let even = Normals::new(from(45.0), Vec3::Z);
        assert!((even.unshadowed(from(45.0)) - 2.0 / (1.0 + 1.125f32.sqrt())).abs() < 1e-5);
        assert_eq!(Normals::new(Vec3::X, Vec3::X).unshadowed(Vec3::Z), 1.0, "vertex normals alone");
    }
}
