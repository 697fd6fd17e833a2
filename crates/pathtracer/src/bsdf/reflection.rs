//! Reflection at the base: metal and dielectric together, under a thin film where there is one.

use glam::Vec3;

use super::fresnel::{Film, Fresnel, dielectric_rise, metal_rise};
use super::ggx;
use super::lobe::{Facet, Light, Lobe, Sample, Surface, mean};

/// The reflection lobe.
pub(crate) struct Reflection {
    metal: Fresnel,
    dielectric: Fresnel,
    /// The dielectric's index of refraction, on which the rise of its reflectance depends.
    ior: f32,
    film: Option<Film>,
    albedo: f32,
}

impl Reflection {
    #[inline]
    pub(crate) fn new(surface: &Surface<'_>, below: f32) -> Option<Self> {
        let layered = surface.layered(below);
        let dielectric = Fresnel { weight: layered * surface.dielectric_compensation, ..surface.dielectric };
        let mut metal = Fresnel { f0: surface.color, f90: 1.0, weight: Vec3::ZERO };
        let mut metal_albedo = Vec3::ZERO;
        if surface.metallic > 0.0 {
            let (reflected, for_compensation) =
                surface.seen(&metal, metal_rise(surface.facet.o.z), surface.table.metal);
            metal.weight = below * surface.metallic * surface.compensation(for_compensation);
            metal_albedo = reflected * metal.weight;
        }
        let albedo = mean(metal_albedo + layered * surface.dielectric_albedo);
        Some(Self { metal, dielectric, ior: surface.ior, film: surface.film, albedo })
    }

    /// Returns the sum of the weighted reflectances of metal and dielectric. `cosine` is the cosine
    /// of the angle between a direction and the microfacet normal.
    #[inline]
    fn reflectance(&self, cosine: f32) -> Vec3 {
        let metal = self.metal.reflectance(metal_rise(cosine));
        let dielectric = self.dielectric.reflectance(dielectric_rise(cosine, self.ior));
        let Some(film) = &self.film else { return self.metal.weight * metal + self.dielectric.weight * dielectric };
        let mut sum = Vec3::ZERO;
        for (lobe, bare) in [(&self.metal, metal), (&self.dielectric, dielectric)] {
            if lobe.weight != Vec3::ZERO {
                sum += lobe.weight * film.over(bare, lobe.f0, cosine);
            }
        }
        sum
    }
}

impl Lobe for Reflection {
    fn albedo(&self) -> f32 {
        self.albedo
    }

    fn is_rough(&self, facet: &Facet) -> bool {
        !facet.mirror
    }

    #[inline]
    fn evaluate(&self, facet: &Facet, light: &Light) -> (Vec3, f32) {
        match &light.reflected {
            Some(facets) => (self.reflectance(facet.o.dot(facets.normal)) * facets.specular, facets.pdf),
            None => (Vec3::ZERO, 0.0),
        }
    }

    #[inline]
    fn sample(&self, facet: &Facet, chance: f32, u: [f32; 2], _: f32) -> Option<Sample> {
        let o = facet.o;
        if facet.mirror {
            let direction = (facet.scene_from_local * Vec3::new(-o.x, -o.y, o.z)).try_normalize()?;
            return Some(Sample::Mirror {
                direction,
                up: o.z,
                weight: self.reflectance(o.z) / chance,
                refracted: false,
            });
        }
        let i = ggx::sample_reflection(o, facet.alpha, u);
        if i.z <= 0.0 {
            return None;
        }
        let direction = (facet.scene_from_local * i).try_normalize()?;
        Some(Sample::Rough { direction, up: i.z, alpha: facet.alpha.max_element() })
    }
}
