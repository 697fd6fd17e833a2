//! Materials with their textures looked up at a point.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use lumistack_scene::{AlphaMode, Lamp, Material, Scene, TextureUse};

use crate::bsdf::{self, Film, MIRROR_ALPHA, Wave};
use crate::bvh;
use crate::geometry::{SurfacePoint, bend_normal};
use crate::matt::Normals;
use crate::texture::{Encoding, Slot, Textures};

/// Footprint of lookups that must not be filtered: alpha, whose average is not the alpha of an average once it is thresholded.
const FINEST: f32 = 0.0;

/// All materials, ready for shading.
pub(crate) struct Materials {
    scene: Arc<Scene>,
    textures: Textures,
    slots: Vec<Slots>,
    compensated: bool,
}

struct Slots {
    base: Option<Slot>,
    metallic_roughness: Option<Slot>,
    normal: Option<Slot>,
    emission: Option<Slot>,
    transmission: Option<Slot>,
    /// `None` where the material has none of the [`Extras`].
    extras: Option<Box<ExtraSlots>>,
}

struct ExtraSlots {
    specular: Option<Slot>,
    specular_color: Option<Slot>,
    coat: Option<Slot>,
    coat_roughness: Option<Slot>,
    coat_normal: Option<Slot>,
    sheen_color: Option<Slot>,
    sheen_roughness: Option<Slot>,
    film: Option<Slot>,
    film_thickness: Option<Slot>,
    anisotropy: Option<Slot>,
}

/// What the scattering function needs to know about a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Appearance {
    /// Base colour, 0..1.
    pub(crate) base: Vec3,
    pub(crate) metallic: f32,
    /// Perceptual.
    pub(crate) roughness: f32,
    pub(crate) ior: f32,
    pub(crate) transmission: f32,
    /// Whether transmitted light refracts into a solid.
    pub(crate) solid: bool,
    /// Whether microfacets return what single scattering loses.
    pub(crate) compensated: bool,
    pub(crate) extras: Option<Extras>,
}

/// What most materials lack.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extras {
    pub(crate) specular: f32,
    pub(crate) specular_color: Vec3,
    /// Strength 0..1.
    pub(crate) anisotropy: f32,
    pub(crate) film: Option<Film>,
    pub(crate) sheen: Option<Fabric>,
    pub(crate) coating: Option<Coating>,
    /// 20 / Abbe number.
    pub(crate) dispersion: f32,
    /// Weight of the channels at the wavelength that a path takes on when it enters.
    pub(crate) wave_weight: Vec3,
}

/// A clear coat.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coating {
    pub(crate) factor: f32,
    /// Perceptual.
    pub(crate) roughness: f32,
}

/// Fibres that stand up from the surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fabric {
    pub(crate) color: Vec3,
    /// Perceptual.
    pub(crate) roughness: f32,
}

/// Directions at a point; normals are unit vectors on the viewer's side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) geometric: Vec3,
    /// Normal of what is reflected and refracted, bent so that a mirror shows the viewer nothing from below the surface.
    pub(crate) shading: Vec3,
    /// Normals of diffuse scattering, which are not bent.
    pub(crate) diffuse: Normals,
    /// Normal of the clear coat.
    pub(crate) coat: Vec3,
    /// Direction in which reflections are stretched.
    pub(crate) tangent: Option<Vec3>,
}

impl Frame {
    /// The same normal for everything.
    pub(crate) fn flat(geometric: Vec3, shading: Vec3) -> Self {
        Self { geometric, shading, diffuse: Normals::smooth(shading), coat: shading, tangent: None }
    }
}

impl Appearance {
    /// The appearance of dispersing glass at a wavelength, drawn from `u` for a path that has none yet; returns the wavelength.
    pub(crate) fn disperse(&mut self, path_nm: Option<f32>, u: impl FnOnce() -> f32) -> Option<f32> {
        let extras = self.extras.as_mut().filter(|extras| extras.dispersion > 0.0)?;
        let wave = match path_nm {
            Some(nanometres) => Wave { nanometres, weight: Vec3::ONE },
            None => Wave::sample(u()),
        };
        extras.wave_weight = wave.weight;
        self.ior = bsdf::index_at(self.ior, extras.dispersion, wave.nanometres);
        Some(wave.nanometres)
    }
}

impl ExtraSlots {
    fn new(material: &Material, slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>) -> Self {
        let coat = material.clearcoat.unwrap_or_default();
        let sheen = material.sheen.unwrap_or_default();
        let film = material.iridescence.unwrap_or_default();
        Self {
            specular: slot(&material.specular_texture, Encoding::Linear),
            specular_color: slot(&material.specular_color_texture, Encoding::Srgb),
            coat: slot(&coat.texture, Encoding::Linear),
            coat_roughness: slot(&coat.roughness_texture, Encoding::Linear),
            coat_normal: slot(&coat.normal_texture, Encoding::Linear),
            sheen_color: slot(&sheen.color_texture, Encoding::Srgb),
            sheen_roughness: slot(&sheen.roughness_texture, Encoding::Linear),
            film: slot(&film.texture, Encoding::Linear),
            film_thickness: slot(&film.thickness_texture, Encoding::Linear),
            anisotropy: slot(&material.anisotropy.unwrap_or_default().texture, Encoding::Linear),
        }
    }
}

impl Materials {
    /// Bytes of the textures' coarser levels.
    pub(crate) fn bytes(&self) -> usize {
        self.textures.bytes()
    }

    pub(crate) fn new(scene: Arc<Scene>) -> Self {
        let mut textures = Textures::new(scene.clone());
        let slots = scene
            .materials
            .iter()
            .map(|material| {
                let mut slot = |source: &Option<_>, encoding| source.map(|source| textures.slot(source, encoding));
                Slots {
                    base: slot(&material.base_color_texture, Encoding::Srgb),
                    metallic_roughness: slot(&material.metallic_roughness_texture, Encoding::Linear),
                    normal: slot(&material.normal_texture, Encoding::Linear),
                    emission: slot(&material.emission_texture, Encoding::Srgb),
                    transmission: slot(&material.transmission_texture, Encoding::Linear),
                    extras: has_extras(material).then(|| Box::new(ExtraSlots::new(material, &mut slot))),
                }
            })
            .collect();
        Self { scene, textures, slots, compensated: true }
    }

    /// Leaves out what microfacets return of the light that single scattering loses.
    pub(crate) fn without_compensation(&mut self) {
        self.compensated = false;
    }

    /// Flags of a material's triangles for the tree.
    pub(crate) fn flags(&self, index: usize) -> u32 {
        let material = &self.scene.materials[index];
        let mut flags = 0;
        if !(material.double_sided || is_solid(material)) {
            flags |= bvh::CULL_BACK;
        }
        // lamps that are not seen are asked about by first hits
        if material.alpha_mode != AlphaMode::Opaque || material.lamp == Lamp::Unseen {
            flags |= bvh::ALPHA;
        }
        if is_clear_wall(material) {
            flags |= bvh::TINT;
        }
        flags
    }

    /// Share of the surface that is there, 0..1.
    pub(crate) fn coverage(&self, index: usize, point: &SurfacePoint<'_>) -> f32 {
        match self.scene.materials[index].alpha_mode {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask { cutoff } => f32::from(u8::from(self.base(index, point, FINEST).w >= cutoff)),
            AlphaMode::Blend => self.base(index, point, FINEST).w.clamp(0.0, 1.0),
        }
    }

    /// Radiance that the surface emits towards a viewer on its front or back side, at a direction with this cosine to the normal.
    pub(crate) fn emission(
        &self,
        index: usize,
        point: &SurfacePoint<'_>,
        width: f32,
        front: bool,
        cosine: f32,
    ) -> Vec3 {
        let material = &self.scene.materials[index];
        if !material.is_emissive() || !(front || material.double_sided) {
            return Vec3::ZERO;
        }
        let mut emission = material.emission;
        if emission != Vec3::ZERO
            && let Some(slot) = &self.slots[index].emission
        {
            emission *= self.lookup(slot, point, width).truncate();
        }
        if material.unlit {
            return emission + self.base(index, point, width).truncate().max(Vec3::ZERO);
        }
        if let (Some(_), Some(slots)) = (&material.clearcoat, &self.slots[index].extras)
            && let Some(coating) = self.coating(material, slots, point, width)
        {
            emission *= bsdf::coat_transmittance(&coating, cosine.abs());
        }
        emission
    }

    /// Everything but emission and normals; `width` is the footprint in render space.
    pub(crate) fn appearance(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Appearance {
        let material = &self.scene.materials[index];
        let slots = &self.slots[index];
        let base = self.base_color(index, point, width);
        let (mut metallic, mut roughness) = (material.metallic, material.roughness);
        if let Some(slot) = &slots.metallic_roughness {
            let texel = self.lookup(slot, point, width);
            roughness *= texel.y.clamp(0.0, 1.0);
            metallic *= texel.z.clamp(0.0, 1.0);
        }
        let mut transmission = material.transmission;
        if transmission > 0.0
            && let Some(slot) = &slots.transmission
        {
            transmission *= self.lookup(slot, point, width).x.clamp(0.0, 1.0);
        }
        Appearance {
            base,
            metallic,
            roughness,
            ior: material.ior,
            transmission,
            solid: material.solid,
            compensated: self.compensated,
            extras: slots.extras.as_ref().map(|slots| self.extras(material, slots, point, width)),
        }
    }

    /// Base colour, 0..1.
    #[inline]
    pub(crate) fn base_color(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Vec3 {
        self.base(index, point, width).truncate().clamp(Vec3::ZERO, Vec3::ONE)
    }

    fn extras(&self, material: &Material, slots: &ExtraSlots, point: &SurfacePoint<'_>, width: f32) -> Extras {
        let texel = |slot: &Option<Slot>| slot.as_ref().map_or(Vec4::ONE, |slot| self.lookup(slot, point, width));
        let sheen = material.sheen.map(|sheen| Fabric {
            color: (sheen.color * texel(&slots.sheen_color).truncate()).clamp(Vec3::ZERO, Vec3::ONE),
            roughness: sheen.roughness * texel(&slots.sheen_roughness).w,
        });
        let film = material.iridescence.map(|film| Film {
            factor: (film.factor * texel(&slots.film).x).clamp(0.0, 1.0),
            ior: film.ior,
            thickness_nm: film.thickness_nm[0]
                + (film.thickness_nm[1] - film.thickness_nm[0]) * texel(&slots.film_thickness).y,
        });
        // the blue channel of a texture that is not there is 1 too
        let anisotropy = material.anisotropy.map_or(0.0, |stretch| stretch.strength * texel(&slots.anisotropy).z);
        Extras {
            specular: material.specular * texel(&slots.specular).w,
            specular_color: material.specular_color * texel(&slots.specular_color).truncate().max(Vec3::ZERO),
            anisotropy: anisotropy.clamp(0.0, 1.0),
            film: film.filter(|film| film.factor > 0.0 && film.thickness_nm > 0.0),
            sheen: sheen.filter(|sheen| sheen.color != Vec3::ZERO),
            coating: self.coating(material, slots, point, width),
            dispersion: if is_solid(material) { material.dispersion } else { 0.0 },
            wave_weight: Vec3::ONE,
        }
    }

    fn coating(
        &self,
        material: &Material,
        slots: &ExtraSlots,
        point: &SurfacePoint<'_>,
        width: f32,
    ) -> Option<Coating> {
        let texel = |slot: &Option<Slot>| slot.as_ref().map_or(Vec4::ONE, |slot| self.lookup(slot, point, width));
        let coat = material.clearcoat?;
        let factor = (coat.factor * texel(&slots.coat).x).clamp(0.0, 1.0);
        let roughness = (coat.roughness * texel(&slots.coat_roughness).y).clamp(0.0, 1.0);
        (factor > 0.0).then_some(Coating { factor, roughness })
    }

    /// Normals and tangent on the viewer's side, which is that of `geometric`.
    pub(crate) fn frame(
        &self,
        index: usize,
        point: &SurfacePoint<'_>,
        width: f32,
        geometric: Vec3,
        front: bool,
        to_viewer: Vec3,
    ) -> Frame {
        let material = &self.scene.materials[index];
        let slots = &self.slots[index];
        let smooth = point.shading_normal();
        let turned = |slot: &Option<Slot>, scale: f32| self.turned(slot, scale, smooth, point, width);
        let on_side = |normal: Vec3| if front { normal } else { -normal };
        let seen = |normal: Vec3| bend_normal(on_side(normal), geometric, to_viewer);
        let mapped = turned(&slots.normal, material.normal_scale);
        let diffuse = Normals::new(on_side(mapped), on_side(smooth));
        let mut frame = Frame { diffuse, ..Frame::flat(geometric, seen(mapped)) };
        if let Some(extra) = &slots.extras {
            if let Some(coat) = &material.clearcoat {
                frame.coat = seen(turned(&extra.coat_normal, coat.normal_scale));
            }
            if let Some(stretch) = &material.anisotropy {
                let direction = match &extra.anisotropy {
                    Some(slot) => 2.0 * self.lookup(slot, point, width).truncate().truncate() - 1.0,
                    None => Vec2::X,
                };
                let direction = Vec2::from_angle(stretch.rotation_rad).rotate(direction).normalize_or(Vec2::X);
                frame.tangent = point.mapped_normal(mapped, direction.extend(0.0));
            }
        }
        frame
    }

    /// [`Frame::diffuse`] alone.
    #[inline]
    pub(crate) fn diffuse_normals(
        &self,
        index: usize,
        point: &SurfacePoint<'_>,
        width: f32,
        geometric: Vec3,
        front: bool,
    ) -> Normals {
        let slot = &self.slots[index].normal;
        if slot.is_none() && point.is_flat() {
            return Normals::smooth(geometric);
        }
        let smooth = point.shading_normal();
        let scale = self.scene.materials[index].normal_scale;
        let mapped = self.turned(slot, scale, smooth, point, width);
        if front { Normals::new(mapped, smooth) } else { Normals::new(-mapped, -smooth) }
    }

    /// A normal turned by a normal map, if there is one.
    #[inline]
    fn turned(&self, slot: &Option<Slot>, scale: f32, normal: Vec3, point: &SurfacePoint<'_>, width: f32) -> Vec3 {
        let Some(slot) = slot else { return normal };
        let texel = 2.0 * self.lookup(slot, point, width).truncate() - 1.0;
        point.mapped_normal(normal, Vec3::new(scale * texel.x, scale * texel.y, texel.z)).unwrap_or(normal)
    }

    /// Colour of white light after the given distance (scene units) inside the solid.
    pub(crate) fn attenuation(&self, index: usize) -> (Vec3, f32) {
        let material = &self.scene.materials[index];
        (material.attenuation_color, material.attenuation_distance)
    }

    #[inline]
    fn base(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Vec4 {
        let factor = self.scene.materials[index].base_color * point.color();
        match &self.slots[index].base {
            Some(slot) => factor * self.lookup(slot, point, width),
            None => factor,
        }
    }

    #[inline]
    fn lookup(&self, slot: &Slot, point: &SurfacePoint<'_>, width: f32) -> Vec4 {
        let set = slot.source.uv_set;
        let texels_wide = if width > 0.0 { width * point.uv_per_length(set) * slot.texels_per_uv } else { 0.0 };
        self.textures.lookup(slot, point.uv(set), texels_wide)
    }
}

/// Whether a material has any of the [`Extras`].
fn has_extras(material: &Material) -> bool {
    material.specular != 1.0
        || material.specular_color != Vec3::ONE
        || material.specular_texture.is_some()
        || material.specular_color_texture.is_some()
        || material.clearcoat.is_some_and(|coat| coat.factor > 0.0)
        || material.sheen.is_some_and(|sheen| sheen.color != Vec3::ZERO)
        || material.iridescence.is_some_and(|film| film.factor > 0.0)
        || material.anisotropy.is_some_and(|stretch| stretch.strength > 0.0)
        || (is_solid(material) && material.dispersion > 0.0)
}

/// Whether light can enter a solid behind this surface.
fn is_solid(material: &Material) -> bool {
    material.solid && material.transmission > 0.0
}

/// A thin wall as smooth as a mirror: light passes straight, so light sampling may look through it.
fn is_clear_wall(material: &Material) -> bool {
    !material.solid && material.transmission > 0.0 && material.roughness * material.roughness < MIRROR_ALPHA
}
