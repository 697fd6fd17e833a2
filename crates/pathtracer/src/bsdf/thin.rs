//! A thin wall: the reflection lobe mirrored to the far side, in the base's colour
//! (`KHR_materials_transmission`).

use glam::Vec3;

use super::ggx;
use super::lobe::{Facet, Light, Lobe, Sample, Surface, mean};

/// The transmission lobe of a thin wall.
pub(crate) struct Thin {
    color: Vec3,
    /// Factor 1/E, with the albedo E of single scattering. The factor restores the light that
    /// single scattering loses. Without compensation it is 1.
    scale: f32,
}

impl Thin {
    #[inline]
    pub(crate) fn new(surface: &Surface<'_>, below: f32) -> Option<Self> {
        let scale = if surface.compensated { 1.0 / surface.table.full } else { 1.0 };
        let color = || surface.passed(below) * surface.thin_share * surface.color;
        (surface.thin_share > 0.0).then(|| Self { color: color(), scale })
    }
}

impl Lobe for Thin {
    const TRANSMITS: bool = true;

    fn albedo(&self) -> f32 {
        mean(self.color)
    }

    fn is_rough(&self, facet: &Facet) -> bool {
        !facet.mirror
    }

    fn evaluate(&self, facet: &Facet, light: &Light) -> (Vec3, f32) {
        let (o, i) = (facet.o, Vec3::new(light.i.x, light.i.y, -light.i.z));
        if facet.mirror || i.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let Some(h) = (o + i).try_normalize() else { return (Vec3::ZERO, 0.0) };
        let (specular, pdf) = ggx::reflection(o, light.i, h, facet.alpha);
        (self.color * (self.scale * specular * i.z), pdf)
    }

    fn sample(&self, facet: &Facet, chance: f32, u: [f32; 2], _: f32) -> Option<Sample> {
        let o = facet.o;
        if facet.mirror {
            let direction = (facet.scene_from_local * -o).try_normalize()?;
            return Some(Sample::Mirror { direction, up: -o.z, weight: self.color / chance, refracted: false });
        }
        let i = ggx::sample_reflection(o, facet.alpha, u);
        if i.z <= 0.0 {
            return None;
        }
        let direction = (facet.scene_from_local * Vec3::new(i.x, i.y, -i.z)).try_normalize()?;
        Some(Sample::Rough { direction, up: -i.z, alpha: facet.alpha.max_element() })
    }

    fn straight(&self, facet: &Facet) -> Vec3 {
        if facet.mirror { self.color } else { Vec3::ZERO }
    }
}
