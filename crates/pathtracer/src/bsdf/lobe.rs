//! Interfaces of lobes and layers: a share of the light, a density to sample, and for layers a
//! shadow on all below.

use std::fmt::Debug;

use glam::{Mat3, Vec2, Vec3, Vec4};
use lumistack_scene::{Material, TextureUse};

use super::albedo::Albedo;
use super::frame::Frame;
use super::fresnel::{Film, Fresnel};
use crate::texture::{Encoding, Slot};

/// Below this α a lobe is a perfect mirror (perceptual roughness 0.032): light sampling could not
/// find it.
pub(crate) const MIRROR_ALPHA: f32 = 1e-3;

/// A part of the scattering function, at one point for one outgoing direction.
pub(crate) trait Lobe {
    /// True if the lobe has a frame or a horizon of its own. The others are evaluated only for
    /// light on whose side geometric and shading normal agree: otherwise it would leak through the
    /// surface.
    const OWN_FRAME: bool = false;
    /// True if light from behind can be evaluated.
    const TRANSMITS: bool = false;
    /// True if light from behind crosses into a solid.
    const REFRACTS: bool = false;

    /// Share of the light that it scatters, about: lobes are chosen in proportion to it.
    fn albedo(&self) -> f32;

    /// True if the lobe can be evaluated; otherwise it is a mirror.
    fn is_rough(&self, facet: &Facet) -> bool;

    /// f |cos|, and the density with which [`sample`](Self::sample) finds the light. Mirrors count
    /// as zero.
    fn evaluate(&self, facet: &Facet, light: &Light) -> (Vec3, f32);

    /// A direction for `u` in [0, 1)²; `u_fresnel` chooses between reflection and refraction,
    /// `chance` is that of the lobe. `None` when light is absorbed.
    fn sample(&self, facet: &Facet, chance: f32, u: [f32; 2], u_fresnel: f32) -> Option<Sample>;

    /// Share of light that passes on its straight way.
    fn straight(&self, _: &Facet) -> Vec3 {
        Vec3::ZERO
    }
}

/// A lobe of a layer above the base, by its parameters.
pub(crate) trait Layer: Lobe + Sized {
    /// Textures.
    type Slots;
    /// Parameters at a point.
    type Parameters: Copy + Debug;

    /// True if the material names the layer, even without effect.
    fn is_named(material: &Material) -> bool;

    /// True if the layer has an effect somewhere.
    fn is_seen(material: &Material) -> bool;

    /// The layer's textures; `slot` prepares one.
    fn slots(material: &Material, slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>) -> Self::Slots;

    /// The parameters at a point, `None` where the layer has no effect. `texel` looks a texture up,
    /// and is 1 where there is none.
    fn parameters(
        material: &Material,
        slots: &Self::Slots,
        texel: &impl Fn(&Option<Slot>) -> Vec4,
    ) -> Option<Self::Parameters>;

    /// Share of the light from below that passes towards a viewer at this cosine, for light that
    /// the base emits.
    fn passed(_: &Self::Parameters, _cosine: f32) -> f32 {
        1.0
    }

    /// The lobe below others that leave the share `below`, which becomes the share that this one
    /// leaves.
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

/// Light that arrives.
pub(crate) struct Light {
    /// Towards it, in the scene and in the local frame.
    pub(crate) direction: Vec3,
    pub(crate) i: Vec3,
    /// The reflecting microfacets, if light comes from above a rough surface.
    pub(crate) reflected: Option<Microfacet>,
}

/// The microfacets that reflect a direction to the viewer.
pub(crate) struct Microfacet {
    pub(crate) normal: Vec3,
    /// D V |i_z|.
    pub(crate) specular: f32,
    /// Density of reflected directions.
    pub(crate) pdf: f32,
}

/// A direction that a lobe chose.
pub(crate) enum Sample {
    /// To be evaluated.
    Rough {
        /// In the scene.
        direction: Vec3,
        /// Positive where the lobe means the viewer's side of the surface.
        up: f32,
        /// Widens the ray's footprint; 1 for diffuse.
        alpha: f32,
    },
    /// The only direction of a mirror.
    Mirror {
        /// In the scene.
        direction: Vec3,
        /// As above.
        up: f32,
        /// f |cos| / density.
        weight: Vec3,
        /// True if the surface was crossed into or out of a solid.
        refracted: bool,
    },
}

/// A point before its lobes are known.
pub(crate) struct Surface<'a> {
    pub(crate) facet: &'a Facet,
    pub(crate) frame: &'a Frame,
    pub(crate) to_viewer: Vec3,
    /// True if the viewer sees the front face.
    pub(crate) front: bool,
    pub(crate) color: Vec3,
    pub(crate) metallic: f32,
    pub(crate) ior: f32,
    /// Share of the dielectric that is a solid's glass, and share of the rest that is a thin wall.
    pub(crate) glass_share: f32,
    pub(crate) thin_share: f32,
    /// Perceptual, 0 for a mirror.
    pub(crate) roughness: f32,
    pub(crate) is_stretched: bool,
    /// True if microfacets return the light that single scattering loses.
    pub(crate) compensated: bool,
    pub(crate) table: Albedo,
    pub(crate) film: Option<Film>,
    pub(crate) specular: f32,
    /// F₀ of glass; another index may bend the light.
    pub(crate) glass_f0: Vec3,
    pub(crate) wave_weight: Vec3,
    /// Fresnel's term of the dielectric, without its weight.
    pub(crate) dielectric: Fresnel,
    /// The compensation of its reflection, and its albedo with that, 1 at most.
    pub(crate) dielectric_compensation: Vec3,
    pub(crate) dielectric_albedo: Vec3,
}

impl Surface<'_> {
    /// The factor on a lobe that returns the light that single scattering loses.
    #[inline]
    pub(crate) fn compensation(&self, f0: Vec3) -> Vec3 {
        if self.compensated { self.table.compensation(f0) } else { Vec3::ONE }
    }

    /// Albedo of a reflection before compensation, and the reflectance for that; `rise` is s at the
    /// viewer and `mean_rise` that of the table.
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

    /// Share of the surface that is a dielectric with something below its reflection.
    #[inline]
    pub(crate) fn layered(&self, below: f32) -> f32 {
        below * (1.0 - self.metallic) * (1.0 - self.glass_share)
    }

    /// Share of that which its reflection lets through.
    #[inline]
    pub(crate) fn passed(&self, below: f32) -> f32 {
        self.layered(below) * (1.0 - self.dielectric_albedo.max_element())
    }
}

/// Mean of the channels.
#[inline]
pub(crate) fn mean(v: Vec3) -> f32 {
    v.element_sum() * (1.0 / 3.0)
}
