//! The clear coat, which has its own normal and frame (`KHR_materials_clearcoat`).

use glam::{Mat3, Vec2, Vec3, Vec4};
use lumistack_scene::{Material, TextureUse};

use super::albedo::{COMMON_IOR, albedo};
use super::frame::{local_frame, local_viewer};
use super::lobe::{Facet, Layer, Light, Lobe, MIRROR_ALPHA, Sample, Surface};
use super::{fresnel, ggx};
use crate::texture::{Encoding, Slot};

/// Reflectance at normal incidence, for the index [`COMMON_IOR`].
const COAT_F0: f32 = 0.04;

/// Parameters of a clear coat.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coating {
    pub(crate) factor: f32,
    /// Perceptual roughness.
    pub(crate) roughness: f32,
}

/// Textures of a clear coat.
pub(crate) struct CoatingSlots {
    factor: Option<Slot>,
    roughness: Option<Slot>,
    pub(crate) normal: Option<Slot>,
}

/// The lobe of a clear coat at a point.
pub(crate) struct Coat {
    scene_from_local: Mat3,
    o: Vec3,
    alpha: Vec2,
    mirror: bool,
    /// Factor of the coat, times the compensation of its lobe, times the fraction of light that
    /// reaches the coat.
    weight: f32,
    albedo: f32,
}

impl Coat {
    fn reflectance(&self, cosine: f32) -> f32 {
        self.weight * fresnel::dielectric(cosine, COMMON_IOR).0
    }
}

impl Layer for Coat {
    type Slots = CoatingSlots;
    type Parameters = Coating;

    fn is_named(material: &Material) -> bool {
        material.clearcoat.is_some()
    }

    fn is_seen(material: &Material) -> bool {
        material.clearcoat.is_some_and(|coat| coat.factor > 0.0)
    }

    fn slots(
        material: &Material,
        slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>,
    ) -> CoatingSlots {
        let coat = material.clearcoat.unwrap_or_default();
        CoatingSlots {
            factor: slot(&coat.texture, Encoding::Linear),
            roughness: slot(&coat.roughness_texture, Encoding::Linear),
            normal: slot(&coat.normal_texture, Encoding::Linear),
        }
    }

    fn parameters(
        material: &Material,
        slots: &CoatingSlots,
        texel: &impl Fn(&Option<Slot>) -> Vec4,
    ) -> Option<Coating> {
        let coat = material.clearcoat?;
        let factor = (coat.factor * texel(&slots.factor).x).clamp(0.0, 1.0);
        let roughness = (coat.roughness * texel(&slots.roughness).y).clamp(0.0, 1.0);
        (factor > 0.0).then_some(Coating { factor, roughness })
    }

    fn passed(coating: &Coating, cosine: f32) -> f32 {
        let table = albedo(cosine, coating.roughness);
        let f0 = Vec3::splat(COAT_F0);
        1.0 - coating.factor * table.reflected(f0, 1.0, table.dielectric).x * table.compensation(f0).x
    }

    fn new(coating: &Coating, surface: &Surface<'_>, below: &mut f32) -> Self {
        let scene_from_local = local_frame(surface.frame.coat, None);
        let o = local_viewer(&scene_from_local, surface.to_viewer);
        let alpha = coating.roughness * coating.roughness;
        let mirror = alpha < MIRROR_ALPHA;
        let table = albedo(o.z, if mirror { 0.0 } else { coating.roughness });
        let compensation = if surface.compensated { table.compensation(Vec3::splat(COAT_F0)).x } else { 1.0 };
        let weight = *below * coating.factor * compensation;
        let albedo = weight * table.reflected(Vec3::splat(COAT_F0), 1.0, table.dielectric).x;
        *below *= 1.0 - albedo / *below;
        Self { scene_from_local, o, alpha: Vec2::splat(alpha.max(MIRROR_ALPHA)), mirror, weight, albedo }
    }
}

impl Lobe for Coat {
    const OWN_FRAME: bool = true;

    fn albedo(&self) -> f32 {
        self.albedo
    }

    fn is_rough(&self, _: &Facet) -> bool {
        !self.mirror
    }

    fn evaluate(&self, _: &Facet, light: &Light) -> (Vec3, f32) {
        let i = self.scene_from_local.transpose() * light.direction;
        if self.mirror || i.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let Some(h) = (self.o + i).try_normalize() else { return (Vec3::ZERO, 0.0) };
        let (specular, pdf) = ggx::reflection(self.o, i, h, self.alpha);
        (Vec3::splat(self.reflectance(self.o.dot(h)) * specular * i.z), pdf)
    }

    fn sample(&self, _: &Facet, chance: f32, u: [f32; 2], _: f32) -> Option<Sample> {
        let i = if self.mirror { ggx::reflect(self.o, Vec3::Z) } else { ggx::sample_reflection(self.o, self.alpha, u) };
        let direction = (self.scene_from_local * i).try_normalize()?;
        if i.z <= 0.0 {
            return None;
        }
        Some(if self.mirror {
            let weight = Vec3::splat(self.reflectance(self.o.z) / chance);
            Sample::Mirror { direction, up: 1.0, weight, refracted: false }
        } else {
            Sample::Rough { direction, up: 1.0, alpha: self.alpha.x }
        })
    }
}
