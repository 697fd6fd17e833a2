//! Materials with their textures looked up at a point.

use std::sync::Arc;

use glam::{Vec3, Vec4};
use lumistack_scene::{AlphaMode, Material, Scene};

use crate::bsdf::MIRROR_ALPHA;
use crate::bvh;
use crate::geometry::SurfacePoint;
use crate::texture::{Encoding, Slot, Textures};

/// Footprint of lookups that must not be filtered: alpha, whose average is not the alpha of an average once it is thresholded.
const FINEST: f32 = 0.0;

/// All materials, ready for shading.
pub(crate) struct Materials {
    scene: Arc<Scene>,
    textures: Textures,
    slots: Vec<Slots>,
}

struct Slots {
    base: Option<Slot>,
    metallic_roughness: Option<Slot>,
    normal: Option<Slot>,
    emission: Option<Slot>,
    transmission: Option<Slot>,
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
}

impl Materials {
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
                }
            })
            .collect();
        Self { scene, textures, slots }
    }

    /// Flags of a material's triangles for the tree.
    pub(crate) fn flags(&self, index: usize) -> u32 {
        let material = &self.scene.materials[index];
        let mut flags = 0;
        if !(material.double_sided || is_solid(material)) {
            flags |= bvh::CULL_BACK;
        }
        if material.alpha_mode != AlphaMode::Opaque {
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

    /// Radiance that the surface emits towards a viewer on its front or back side.
    pub(crate) fn emission(&self, index: usize, point: &SurfacePoint<'_>, width: f32, front: bool) -> Vec3 {
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
            emission += self.base(index, point, width).truncate().max(Vec3::ZERO);
        }
        emission
    }

    /// Everything but emission and normals; `width` is the footprint in render space.
    pub(crate) fn appearance(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Appearance {
        let material = &self.scene.materials[index];
        let slots = &self.slots[index];
        let base = self.base(index, point, width).truncate().clamp(Vec3::ZERO, Vec3::ONE);
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
        Appearance { base, metallic, roughness, ior: material.ior, transmission, solid: material.solid }
    }

    /// Shading normal on the front side.
    pub(crate) fn normal(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Vec3 {
        let normal = point.shading_normal();
        let Some(slot) = &self.slots[index].normal else { return normal };
        let texel = 2.0 * self.lookup(slot, point, width).truncate() - 1.0;
        let scale = self.scene.materials[index].normal_scale;
        point.mapped_normal(normal, Vec3::new(scale * texel.x, scale * texel.y, texel.z)).unwrap_or(normal)
    }

    /// Whether the surface shows its base colour and scatters nothing.
    pub(crate) fn is_unlit(&self, index: usize) -> bool {
        self.scene.materials[index].unlit
    }

    /// Colour of white light after the given distance (scene units) inside the solid.
    pub(crate) fn attenuation(&self, index: usize) -> (Vec3, f32) {
        let material = &self.scene.materials[index];
        (material.attenuation_color, material.attenuation_distance)
    }

    fn base(&self, index: usize, point: &SurfacePoint<'_>, width: f32) -> Vec4 {
        let factor = self.scene.materials[index].base_color * point.color();
        match &self.slots[index].base {
            Some(slot) => factor * self.lookup(slot, point, width),
            None => factor,
        }
    }

    fn lookup(&self, slot: &Slot, point: &SurfacePoint<'_>, width: f32) -> Vec4 {
        let set = slot.source.uv_set;
        let size = self.textures.size(slot);
        let determinant = slot.source.texture_from_mesh.matrix2.determinant() * size.x * size.y;
        let texels_wide = if width > 0.0 { width * point.uv_per_length(set, determinant) } else { 0.0 };
        self.textures.lookup(slot, point.uv(set), texels_wide)
    }
}

/// Whether light can enter a solid behind this surface.
fn is_solid(material: &Material) -> bool {
    material.solid && material.transmission > 0.0
}

/// A thin wall as smooth as a mirror: light passes straight, so light sampling may look through it.
fn is_clear_wall(material: &Material) -> bool {
    !material.solid && material.transmission > 0.0 && material.roughness * material.roughness < MIRROR_ALPHA
}
