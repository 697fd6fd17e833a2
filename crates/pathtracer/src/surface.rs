//! The first surface of a ray: the data by which views are filtered, and by which light is shared.

use glam::Vec3;

use crate::bsdf::Appearance;
use crate::lambert::Lambert;

/// Approximate reflectance of a dielectric at normal incidence.
const DIELECTRIC_SHARE: f32 = 0.04;
/// Radiance is divided by at least this reflectance, so that the light of darker surfaces does not
/// become too noisy.
const LEAST_REFLECTANCE: f32 = 0.02;

/// The first surface of a path, and the light that it scatters alike to all viewers.
#[derive(Clone, Copy, Default)]
pub(crate) struct First {
    /// True if the ray continues as a path.
    pub(crate) is_path: bool,
    /// True if the ray hits a surface.
    pub(crate) is_there: bool,
    /// Radiance that the ray itself sees: emission of the surface, or the background if there is no
    /// surface.
    pub(crate) seen: Vec3,
    /// Radiance that the surface scatters by Lambert's law.
    pub(crate) diffuse: Vec3,
    /// Reflectance of the diffuse lobe.
    pub(crate) reflectance: Vec3,
    pub(crate) gloss: Gloss,
    /// Position of the surface in render space.
    pub(crate) position: Vec3,
    /// Geometric normal of the surface on the viewer's side.
    pub(crate) normal: Vec3,
    pub(crate) guide: Guide,
}

/// The reflection of a surface that depends on the viewer's direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gloss {
    /// Approximate reflectance of the base at normal incidence.
    pub(crate) reflectance: Vec3,
    /// The smaller squared roughness of base and coat. If the viewer's direction turns by this
    /// angle, in radians, the reflection stays about the same. 0 for glass, at whose points other
    /// views see other light.
    pub(crate) alpha: f32,
}

/// Properties of a surface by which a filter recognizes where light may differ.
#[derive(Clone, Copy, Default)]
pub(crate) struct Guide {
    /// Reflectance, 0..1: base colour plus the few percent that a dielectric reflects.
    pub(crate) albedo: Vec3,
    /// Shading normal on the viewer's side, in render space.
    pub(crate) normal: Vec3,
    /// Fraction of the reflectance that depends on the viewer's direction, 0..1.
    pub(crate) gloss: f32,
    /// Squared roughness of the lobe that depends on the viewer's direction.
    pub(crate) alpha: f32,
}

impl Guide {
    pub(crate) fn new(appearance: &Appearance, normal: Vec3) -> Self {
        let Appearance { base, metallic, roughness, transmission, .. } = *appearance;
        let dielectric = 1.0 - metallic;
        Self {
            albedo: base.lerp(Vec3::ONE, DIELECTRIC_SHARE * dielectric),
            normal,
            gloss: metallic + dielectric * DIELECTRIC_SHARE.max(transmission),
            alpha: roughness * roughness,
        }
    }

    pub(crate) fn of_lambert(lambert: &Lambert) -> Self {
        Self { albedo: lambert.albedo(), normal: lambert.normal(), gloss: 0.0, alpha: 1.0 }
    }
}

impl Gloss {
    /// The gloss of a surface that only scatters by Lambert's law.
    const NONE: Self = Self { reflectance: Vec3::ZERO, alpha: 1.0 };

    pub(crate) fn new(appearance: &Appearance) -> Self {
        let Appearance { base, metallic, roughness, transmission, extras, .. } = appearance;
        let coat = extras.as_ref().and_then(|extras| extras.layers.coat).filter(|coat| coat.factor > 0.0);
        let sharpest = coat.map_or(*roughness, |coat| coat.roughness.min(*roughness));
        Self {
            reflectance: Vec3::splat(DIELECTRIC_SHARE).lerp(*base, *metallic),
            alpha: if *transmission > 0.0 { 0.0 } else { sharpest * sharpest },
        }
    }
}

impl Default for Gloss {
    fn default() -> Self {
        Self::NONE
    }
}

/// Returns the reflectance by which light is divided.
pub(crate) fn divisor(reflectance: Vec3) -> Vec3 {
    reflectance.max(Vec3::splat(LEAST_REFLECTANCE))
}
