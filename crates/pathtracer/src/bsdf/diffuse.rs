//! Diffuse scattering of the base: Lambert's law around the diffuse normal, with the shadows that
//! bumps cast.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::cosine::cosine_direction;
use super::frame::local_frame;
use super::lobe::{Facet, Light, Lobe, Sample, Surface, mean};
use crate::normals::Normals;

/// The diffuse lobe.
pub(crate) struct Diffuse {
    albedo: Vec3,
    /// Mapped and smooth normal in the local frame. Without a normal map both are the z axis,
    /// unless the shading normal was bent.
    normals: Normals,
}

impl Diffuse {
    #[inline]
    pub(crate) fn new(surface: &Surface<'_>, below: f32) -> Option<Self> {
        let albedo = surface.passed(below) * (1.0 - surface.thin_share) * surface.color;
        let (frame, scene_from_local) = (surface.frame, &surface.facet.scene_from_local);
        let local =
            |normal: Vec3| if normal == frame.shading { Vec3::Z } else { scene_from_local.transpose() * normal };
        Some(Self { albedo, normals: frame.diffuse.turned(local) })
    }
}

impl Diffuse {
    /// Returns the fraction of the light that the lobe scatters, per channel.
    pub(crate) fn reflectance(&self) -> Vec3 {
        self.albedo
    }
}

impl Lobe for Diffuse {
    // Light is received above the plane of the diffuse normal. That normal is not bent, unlike the
    // shading normal of other lobes.
    const OWN_FRAME: bool = true;

    fn albedo(&self) -> f32 {
        mean(self.albedo)
    }

    fn is_rough(&self, _: &Facet) -> bool {
        true
    }

    #[inline]
    fn evaluate(&self, _: &Facet, light: &Light) -> (Vec3, f32) {
        let cosine = light.i.dot(self.normals.mapped);
        if cosine <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let density = cosine * FRAC_1_PI;
        (self.albedo * (density * self.normals.unshadowed(light.i)), density)
    }

    #[inline]
    fn sample(&self, facet: &Facet, _: f32, u: [f32; 2], _: f32) -> Option<Sample> {
        let i = cosine_direction(u);
        let normal = self.normals.mapped;
        let i = if normal == Vec3::Z { i } else { local_frame(normal, None) * i };
        let direction = (facet.scene_from_local * i).try_normalize()?;
        Some(Sample::Rough { direction, up: 1.0, alpha: 1.0 })
    }
}
