//! Materials with their textures looked up at a point.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use lumistack_scene::{AlphaMode, Lamp, Material, Scene, TextureUse};

use crate::bsdf::{Appearance, Extras, Film, Frame, LayerSlots, Layers, MIRROR_ALPHA};
use crate::bvh;
use crate::geometry::{SurfacePoint, bend_normal};
use crate::normals::Normals;
use crate::texture::{Encoding, Slot, Textures};

/// Footprint for textures that must not be filtered, such as alpha. Alpha is compared with a
/// threshold, and a mean of alphas would change the result.
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
    /// Textures of the [`Extras`]; `None` for a material without any of them.
    extras: Option<Box<ExtraSlots>>,
}

struct ExtraSlots {
    specular: Option<Slot>,
    specular_color: Option<Slot>,
    layers: LayerSlots,
    film: Option<Slot>,
    film_thickness: Option<Slot>,
    anisotropy: Option<Slot>,
}

impl ExtraSlots {
    fn new(material: &Material, slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>) -> Self {
        let film = material.iridescence.unwrap_or_default();
        Self {
            specular: slot(&material.specular_texture, Encoding::Linear),
            specular_color: slot(&material.specular_color_texture, Encoding::Srgb),
            layers: LayerSlots::new(material, slot),
            film: slot(&film.texture, Encoding::Linear),
            film_thickness: slot(&film.thickness_texture, Encoding::Linear),
            anisotropy: slot(&material.anisotropy.unwrap_or_default().texture, Encoding::Linear),
        }
    }
}

impl Materials {
    /// Returns the bytes of the textures' coarser levels.
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

    /// Turns the compensation for multiple scattering off. Surfaces then lose the light that
    /// microfacets scatter more than once.
    pub(crate) fn without_compensation(&mut self) {
        self.compensated = false;
    }

    /// Returns the flags of a material's triangles for the tree.
    pub(crate) fn flags(&self, index: usize) -> u32 {
        let material = &self.scene.materials[index];
        let mut flags = 0;
        if !(material.double_sided || is_solid(material)) {
            flags |= bvh::CULL_BACK;
        }
        // unseen lamps get this flag too, so that camera rays can pass through them
        if material.alpha_mode != AlphaMode::Opaque || material.lamp == Lamp::Unseen {
            flags |= bvh::ALPHA;
        }
        if is_clear_wall(material) {
            flags |= bvh::TINT;
        }
        flags
    }

    /// Returns the opaque fraction of the surface, 0..1, which follows from the alpha at the point.
    pub(crate) fn coverage(&self, index: usize, point: &SurfacePoint<'_>) -> f32 {
        match self.scene.materials[index].alpha_mode {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask { cutoff } => f32::from(u8::from(self.base(index, point, FINEST).w >= cutoff)),
            AlphaMode::Blend => self.base(index, point, FINEST).w.clamp(0.0, 1.0),
        }
    }

    /// Returns the radiance that the surface emits towards a viewer. `front` is true if the viewer
    /// is on the front side. `cosine` is the cosine between the viewer's ray and the normal, of
    /// either sign.
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
        if let Some(slots) = &self.slots[index].extras
            && Layers::are_seen(material)
        {
            emission *= self.layers(material, slots, point, width).passed(cosine.abs());
        }
        emission
    }

    /// Returns all properties of a surface except emission and normals; `width` is the footprint in
    /// render space.
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

    /// Returns the base colour, 0..1.
    #[inline]
    pub(crate) fn base_color(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Vec3 {
        self.base(index, point, width).truncate().clamp(Vec3::ZERO, Vec3::ONE)
    }

    fn extras(&self, material: &Material, slots: &ExtraSlots, point: &SurfacePoint<'_>, width: f32) -> Extras {
        let texel = |slot: &Option<Slot>| slot.as_ref().map_or(Vec4::ONE, |slot| self.lookup(slot, point, width));
        let film = material.iridescence.map(|film| Film {
            factor: (film.factor * texel(&slots.film).x).clamp(0.0, 1.0),
            ior: film.ior,
            thickness_nm: film.thickness_nm[0]
                + (film.thickness_nm[1] - film.thickness_nm[0]) * texel(&slots.film_thickness).y,
        });
        // without a texture, `texel` returns 1 in the blue channel too
        let anisotropy = material.anisotropy.map_or(0.0, |stretch| stretch.strength * texel(&slots.anisotropy).z);
        Extras {
            specular: material.specular * texel(&slots.specular).w,
            specular_color: material.specular_color * texel(&slots.specular_color).truncate().max(Vec3::ZERO),
            anisotropy: anisotropy.clamp(0.0, 1.0),
            film: film.filter(|film| film.factor > 0.0 && film.thickness_nm > 0.0),
            layers: self.layers(material, slots, point, width),
            dispersion: if is_solid(material) { material.dispersion } else { 0.0 },
            wave_weight: Vec3::ONE,
        }
    }

    fn layers(&self, material: &Material, slots: &ExtraSlots, point: &SurfacePoint<'_>, width: f32) -> Layers {
        let texel = |slot: &Option<Slot>| slot.as_ref().map_or(Vec4::ONE, |slot| self.lookup(slot, point, width));
        Layers::new(material, &slots.layers, texel)
    }

    /// Returns the normals and tangent at a point, on the viewer's side. `geometric` must be on the
    /// viewer's side.
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
                frame.coat = seen(turned(&extra.layers.coat.normal, coat.normal_scale));
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

    /// Returns the normals of [`Frame::diffuse`] alone.
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

    /// Returns `normal`, turned by the normal map of `slot` if there is one.
    #[inline]
    fn turned(&self, slot: &Option<Slot>, scale: f32, normal: Vec3, point: &SurfacePoint<'_>, width: f32) -> Vec3 {
        let Some(slot) = slot else { return normal };
        let texel = 2.0 * self.lookup(slot, point, width).truncate() - 1.0;
        point.mapped_normal(normal, Vec3::new(scale * texel.x, scale * texel.y, texel.z)).unwrap_or(normal)
    }

    /// Returns the colour that white light has after a certain distance inside the solid, and that
    /// distance in scene units.
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

/// Returns true if the material has any of the [`Extras`].
fn has_extras(material: &Material) -> bool {
    material.specular != 1.0
        || material.specular_color != Vec3::ONE
        || material.specular_texture.is_some()
        || material.specular_color_texture.is_some()
        || Layers::are_seen(material)
        || material.iridescence.is_some_and(|film| film.factor > 0.0)
        || material.anisotropy.is_some_and(|stretch| stretch.strength > 0.0)
        || (is_solid(material) && material.dispersion > 0.0)
}

/// Returns true if light can enter a solid behind the surface.
fn is_solid(material: &Material) -> bool {
    material.solid && material.transmission > 0.0
}

/// Returns true for a thin wall as smooth as a mirror. Light passes it without a change of
/// direction, so light sampling may look through it.
fn is_clear_wall(material: &Material) -> bool {
    !material.solid && material.transmission > 0.0 && material.roughness * material.roughness < MIRROR_ALPHA
}
