//! Materials and their textures: the metallic-roughness model, with the extensions that change the
//! shading of a path tracer.
//!
//! Source: glTF 2.0, section 3.9, and the KHR_materials_* extensions. Occlusion textures are left
//! out, since a path tracer computes occlusion.

use glam::{Vec3, Vec4};
use gltf::json;
use gltf::json::validation::Checked;
use lumistack_core::Task;
use lumistack_scene::{AlphaMode, Lamp, Material, Texture};

use crate::document::Document;
use crate::error::Fault;
use crate::images::Images;
use crate::nodes::extras;
use crate::quote::quote;
use crate::textures::{Loader, Reference, plain, untyped_transform};
use crate::{glossiness, material_extensions};

/// Materials in the file's order, with their textures and images.
pub(crate) struct Materials {
    pub(crate) materials: Vec<Material>,
    /// For each material, the texture coordinate sets of the file that become sets 0 and 1 of a
    /// mesh.
    pub(crate) uv_sets: Vec<[u32; 2]>,
    pub(crate) textures: Vec<Texture>,
    pub(crate) images: Images,
}

/// Reads the used materials of the file. The default material takes the place of each unused
/// material, which keeps the indices of the others. So a missing picture of an unused material is
/// no error.
pub(crate) fn load(document: &Document<'_>, used: &[bool]) -> Result<Materials, Fault> {
    let mut loader = Loader::new(document);
    let (mut materials, mut uv_sets) = (Vec::new(), Vec::new());
    for (i, material) in document.root.materials.iter().enumerate() {
        let (material, sets) = if used.get(i) == Some(&true) {
            loader.material(material, &format!("/materials/{i}"))?
        } else {
            (Material::default(), [0, 1])
        };
        materials.push(material);
        uv_sets.push(sets);
    }
    let Loader { textures, images, .. } = loader;
    Ok(Materials { materials, uv_sets, textures, images })
}

impl Loader<'_, '_> {
    fn material(&mut self, source: &json::Material, place: &str) -> Result<(Material, [u32; 2]), Fault> {
        let pbr = &source.pbr_metallic_roughness;
        let extensions = source.extensions.clone().unwrap_or_default();
        // read the factors of the metallic-roughness model
        let strength = extensions.emissive_strength.map_or(1.0, |strength| strength.emissive_strength.0);
        let emission = Vec3::from(source.emissive_factor.0) * strength;
        if !(emission.is_finite() && emission.min_element() >= 0.0) {
            let expected = "a factor and a strength whose product is finite and ≥ 0";
            return Err(Fault::new(format!("{place}/emissiveFactor"), expected, format!("{emission}")));
        }
        let mut material = Material {
            name: source.name.clone().unwrap_or_default(),
            base_color: Vec4::from(pbr.base_color_factor.0),
            metallic: pbr.metallic_factor.0,
            roughness: pbr.roughness_factor.0,
            emission,
            alpha_mode: self.alpha_mode(source, place)?,
            double_sided: source.double_sided,
            unlit: extensions.unlit.is_some(),
            ior: extensions.ior.map_or(1.5, |ior| ior.ior.0),
            lamp: self.lamp(place)?,
            ..Material::default()
        };
        if let Some(volume) = &extensions.volume {
            material.solid = volume.thickness_factor.0 > 0.0;
            material.attenuation_color = volume.attenuation_color.0.into();
            material.attenuation_distance = volume.attenuation_distance.0;
        }

        // read the textures of the metallic-roughness model
        let pbr_place = format!("{place}/pbrMetallicRoughness");
        let base_color = pbr.base_color_texture.as_ref().map(|info| plain(info, &pbr_place, "baseColorTexture"));
        material.base_color_texture = self.texture_use(base_color)?;
        let metallic = pbr.metallic_roughness_texture.as_ref();
        let metallic = metallic.map(|info| plain(info, &pbr_place, "metallicRoughnessTexture"));
        material.metallic_roughness_texture = self.texture_use(metallic)?;
        if let Some(normal) = &source.normal_texture {
            let place = format!("{place}/normalTexture");
            material.normal_scale = normal.scale;
            let others = normal.extensions.as_ref().map(|extensions| &extensions.others);
            let transform = others.and_then(|others| others.get("KHR_texture_transform"));
            let transform = transform.map(|value| untyped_transform(value, &place)).transpose()?;
            let reference = Reference { index: normal.index, uv_set: normal.tex_coord, transform, place };
            material.normal_texture = self.texture_use(Some(reference))?;
        }
        let emissive = source.emissive_texture.as_ref().map(|info| plain(info, place, "emissiveTexture"));
        material.emission_texture = self.texture_use(emissive)?;
        if let Some(transmission) = &extensions.transmission {
            material.transmission = transmission.transmission_factor.0;
            let place = format!("{place}/extensions/KHR_materials_transmission");
            let texture = transmission.transmission_texture.as_ref();
            let texture = texture.map(|info| plain(info, &place, "transmissionTexture"));
            material.transmission_texture = self.texture_use(texture)?;
        }
        material_extensions::read(self, &mut material, place)?;
        // KHR_materials_pbrSpecularGlossiness takes precedence, so it replaces the values of the
        // metallic-roughness model
        glossiness::convert(self, &mut material, place)?;
        let sets = fit_uv_sets(&mut material, place, self.document.task);
        Ok((material, sets))
    }

    /// Reads Lumistack's mark of a surface that represents a light source: `extras.lumistack.lamp`.
    fn lamp(&self, place: &str) -> Result<Lamp, Fault> {
        let Some(lamp) = extras(self.document, place, &["lamp"]).and_then(|extras| extras.get("lamp")) else {
            return Ok(Lamp::No);
        };
        match lamp.as_str() {
            Some("seen") => Ok(Lamp::Seen),
            Some("unseen") => Ok(Lamp::Unseen),
            _ => Err(Fault::new(format!("{place}/extras/lumistack/lamp"), "\"seen\" or \"unseen\"", quote(Some(lamp)))),
        }
    }

    fn alpha_mode(&self, source: &json::Material, place: &str) -> Result<AlphaMode, Fault> {
        use gltf::json::material::AlphaMode as Source;
        match source.alpha_mode {
            Checked::Valid(Source::Opaque) => Ok(AlphaMode::Opaque),
            Checked::Valid(Source::Mask) => Ok(AlphaMode::Mask { cutoff: source.alpha_cutoff.unwrap_or_default().0 }),
            Checked::Valid(Source::Blend) => Ok(AlphaMode::Blend),
            Checked::Invalid => {
                let place = format!("{place}/alphaMode");
                let found = self.document.quote(&place);
                Err(Fault::new(place, "OPAQUE, MASK or BLEND", found))
            }
        }
    }
}

/// Assigns the texture coordinate sets that a material uses to the two sets of a mesh. Returns the
/// file's numbers of the mesh's sets 0 and 1. They are 0 and 1 if the material uses no higher set.
fn fit_uv_sets(material: &mut Material, place: &str, task: Task<'_>) -> [u32; 2] {
    // find the coordinate sets that the textures use; without a set above 1 nothing changes
    let mut used: Vec<usize> = material.textures().map(|(_, texture)| texture.uv_set).collect();
    used.sort_unstable();
    used.dedup();
    if used.iter().all(|&set| set < 2) {
        return [0, 1];
    }
    if used.len() > 2 {
        let message = format!(
            "expected at most two sets of texture coordinates, found {} sets; textures that use another set than \
             TEXCOORD_{} and TEXCOORD_{} get TEXCOORD_{}",
            used.len(),
            used[0],
            used[1],
            used[0]
        );
        task.warn(place, message);
    }
    // replace the file's number of a coordinate set by the mesh's number, in every texture
    let coat = material.clearcoat.as_mut();
    let sheen = material.sheen.as_mut();
    let film = material.iridescence.as_mut();
    let layers = coat.map(|coat| [&mut coat.texture, &mut coat.roughness_texture, &mut coat.normal_texture]);
    let pairs = [
        sheen.map(|sheen| [&mut sheen.color_texture, &mut sheen.roughness_texture]),
        film.map(|film| [&mut film.texture, &mut film.thickness_texture]),
    ];
    let others = [
        &mut material.base_color_texture,
        &mut material.metallic_roughness_texture,
        &mut material.normal_texture,
        &mut material.emission_texture,
        &mut material.specular_texture,
        &mut material.specular_color_texture,
        &mut material.transmission_texture,
    ];
    let stretch = material.anisotropy.as_mut().map(|stretch| &mut stretch.texture);
    let layers = layers.into_iter().flatten().chain(pairs.into_iter().flatten().flatten());
    let textures = layers.chain(stretch).chain(others);
    for texture in textures.flatten() {
        texture.uv_set = used[..used.len().min(2)].iter().position(|&set| set == texture.uv_set).unwrap_or(0);
    }
    let set = |i: usize| used.get(i).map_or(0, |&set| set as u32);
    [set(0), set(1)]
}
