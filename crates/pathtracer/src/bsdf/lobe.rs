//! Traits of lobes and layers. A lobe has an albedo and a density for sampling. A layer also
//! dims all lobes below it.

use std::fmt::Debug;

use glam::{Mat3, Vec2, Vec3, Vec4};
use lumistack_scene::{Material, TextureUse};

use super::albedo::Albedo;
use super::frame::Frame;
use super::fresnel::{Film, Fresnel};
use crate::texture::{Encoding, Slot};

/// Below this α a lobe is treated as a perfect mirror, since light sampling would hardly hit it.
/// This α corresponds to a perceptual roughness of 0.032.
pub(crate) const MIRROR_ALPHA: f32 = 1e-3;

/// A term of the scattering function, at one point for one outgoing direction.
pub(crate) trait Lobe {
    /// True if the lobe has its own frame, or its own horizon: the plane below which it receives no
    /// light. Other lobes are evaluated only for light that is on the same side of the geometric
    /// and of the shading normal. Otherwise light would leak through the surface.
    const OWN_FRAME: bool = false;
    /// True if the lobe can be evaluated for light from behind the surface.
    const TRANSMITS: bool = false;
    /// True if light that crosses the surface enters or leaves a solid.
    const REFRACTS: bool = false;

    /// Returns the approximate fraction of the light that the lobe scatters. Lobes are chosen in
    /// proportion to it.
    fn albedo(&self) -> f32;

    /// Returns true if the lobe can be evaluated; otherwise it is a mirror.
    fn is_rough(&self, facet: &Facet) -> bool;

    /// Returns f |cos| with the scattering function f, and the density with which
    /// [`sample`](Self::sample) finds the light. A mirror returns zeros.
    fn evaluate(&self, facet: &Facet, light: &Light) -> (Vec3, f32);

    /// Samples a direction by `u` in [0, 1)²; `u_fresnel` chooses between reflection and
    /// refraction. `chance` is the chance with which this lobe was chosen. Returns `None` if the
    /// light is absorbed.
    fn sample(&self, facet: &Facet, chance: f32, u: [f32; 2], u_fresnel: f32) -> Option<Sample>;

    /// Returns the fraction of the light that passes without a change of direction.
    fn straight(&self, _: &Facet) -> Vec3 {
        Vec3::ZERO
    }
}

/// A lobe of a layer above the base.
pub(crate) trait Layer: Lobe + Sized {
    /// The layer's textures.
    type Slots;
    /// The layer's parameters at a point.
    type Parameters: Copy + Debug;

    /// Returns true if the material names the layer, even if the layer has no effect.
    fn is_named(material: &Material) -> bool;

    /// Returns true if the layer has an effect somewhere.
    fn is_seen(material: &Material) -> bool;

    /// Returns the layer's textures; `slot` prepares a texture.
    fn slots(material: &Material, slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>) -> Self::Slots;

    /// Returns the parameters at a point, `None` where the layer has no effect. `texel` looks a
    /// texture up, and returns 1 if there is none.
    fn parameters(
        material: &Material,
        slots: &Self::Slots,
        texel: &impl Fn(&Option<Slot>) -> Vec4,
    ) -> Option<Self::Parameters>;

    /// Returns the fraction of the base's emitted light that passes the layer. The second argument
    /// is the cosine between the viewer's direction and the normal.
    fn passed(_: &Self::Parameters, _cosine: f32) -> f32 {
        1.0
    }

    /// Makes the lobe at a point where the layers above pass the fraction `below` of the light.
    /// Multiplies `below` by the fraction that this layer passes.
    fn new(parameters: &Self::Parameters, surface: &Surface<'_>, below: &mut f32) -> Self;
}

/// Geometry that the lobes of the base share.
pub(crate) struct Facet {
    /// Columns: tangent, bitangent, shading normal; the normal is on the viewer's side.
    pub(crate) scene_from_local: Mat3,
    pub(crate) geometric_normal: Vec3,
    /// Outgoing direction in the local frame, z > 0.
    pub(crate) o: Vec3,
    pub(crate) alpha: Vec2,
    pub(crate) mirror: bool,
}

/// Incident light of one direction.
pub(crate) struct Light {
    /// Direction to the light, in the scene (`direction`) and in the local frame (`i`).
    pub(crate) direction: Vec3,
    pub(crate) i: Vec3,
    /// The reflecting microfacets, if light comes from above a rough surface.
    pub(crate) reflected: Option<Microfacet>,
}

/// The microfacets that reflect a direction to the viewer.
pub(crate) struct Microfacet {
    pub(crate) normal: Vec3,
    /// D V |i_z|, with D and V of `ggx.rs`.
    pub(crate) specular: f32,
    /// Density of reflected directions.
    pub(crate) pdf: f32,
}

/// A direction that a lobe chose.
pub(crate) enum Sample {
    /// A direction of a rough lobe. The lobe's value for this direction is still to be evaluated.
    Rough {
        /// Direction in the scene.
        direction: Vec3,
        /// Positive if the lobe scatters to the viewer's side of the surface.
        up: f32,
        /// α of the lobe, which widens the ray's footprint; 1 for diffuse.
        alpha: f32,
    },
    /// The only direction of a mirror.
    Mirror {
        /// Direction in the scene.
        direction: Vec3,
        /// Positive if the mirror scatters to the viewer's side of the surface.
        up: f32,
        /// f |cos| / density, with the scattering function f.
        weight: Vec3,
        /// True if the direction crosses the surface into or out of a solid.
        refracted: bool,
    },
}

/// A point of a surface, from which its lobes are made.
pub(crate) struct Surface<'a> {
    pub(crate) facet: &'a Facet,
    pub(crate) frame: &'a Frame,
    pub(crate) to_viewer: Vec3,
    /// True if the viewer sees the front face.
    pub(crate) front: bool,
    pub(crate) color: Vec3,
    pub(crate) metallic: f32,
    pub(crate) ior: f32,
    /// Fraction of the dielectric that is the glass of a solid.
    pub(crate) glass_share: f32,
    /// Fraction of the remaining dielectric that is a thin wall.
    pub(crate) thin_share: f32,
    /// Perceptual roughness, 0 for a mirror.
    pub(crate) roughness: f32,
    pub(crate) is_stretched: bool,
    /// True if microfacets return the light that single scattering loses.
    pub(crate) compensated: bool,
    pub(crate) table: Albedo,
    pub(crate) film: Option<Film>,
    pub(crate) specular: f32,
    /// F₀ of glass, with the changes by `KHR_materials_specular`.
    pub(crate) glass_f0: Vec3,
    pub(crate) wave_weight: Vec3,
    /// Reflectance of the dielectric; its weight is 1.
    pub(crate) dielectric: Fresnel,
    /// Compensation of the dielectric's reflection.
    pub(crate) dielectric_compensation: Vec3,
    /// Albedo of the dielectric's compensated reflection, at most 1.
    pub(crate) dielectric_albedo: Vec3,
}

impl Surface<'_> {
    /// Returns the factor on a lobe that adds the light that single scattering loses; 1 without
    /// compensation.
    #[inline]
    pub(crate) fn compensation(&self, f0: Vec3) -> Vec3 {
        if self.compensated { self.table.compensation(f0) } else { Vec3::ONE }
    }

    /// Returns the albedo of a reflection before compensation, and the reflectance from which the
    /// compensation is computed. `rise` is s of `fresnel.rs` at the viewer's cosine, `mean_rise` is
    /// B of `albedo.rs`.
    #[inline]
    pub(crate) fn seen(&self, lobe: &Fresnel, rise: f32, mean_rise: f32) -> (Vec3, Vec3) {
        match &self.film {
            Some(film) => {
                let fresnel = film.over(lobe.reflectance(rise), lobe.f0, self.facet.o.z);
                (fresnel * self.table.full, fresnel)
            }
            None => (self.table.reflected(lobe.f0, lobe.f90, mean_rise), lobe.f0),
        }
    }

    /// Returns the fraction of the light that reaches the dielectric of the base, except its glass.
    /// `below` is the fraction that reaches the base.
    #[inline]
    pub(crate) fn layered(&self, below: f32) -> f32 {
        below * (1.0 - self.metallic) * (1.0 - self.glass_share)
    }

    /// Returns the fraction of the light that reaches the diffuse lobe: the result of
    /// [`layered`](Self::layered), less the light that the dielectric reflects.
    #[inline]
    pub(crate) fn passed(&self, below: f32) -> f32 {
        self.layered(below) * (1.0 - self.dielectric_albedo.max_element())
    }
}

/// Returns the mean of the channels.
#[inline]
pub(crate) fn mean(v: Vec3) -> f32 {
    v.element_sum() * (1.0 / 3.0)
}
