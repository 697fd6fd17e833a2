//! `KHR_materials_pbrSpecularGlossiness` as metallic-roughness.
//!
//! The material is a dielectric (metallic 0) of base colour `diffuse` whose reflection at normal
//! incidence is `specular`. Its index of refraction is set to 0, so that this reflection does not
//! depend on an index. Sources: KHR_materials_specular, "Conversions", and KHR_materials_ior.
//!
//! Roughness is 1 − glossiness. A texture may hold glossiness in its alpha. Then a roughness
//! texture is made, whose green channel is 1 − glossinessFactor · alpha, since no factor on a
//! texture can express this.

use glam::{Vec3, Vec4};
use lumistack_scene::{Material, Texture};

use crate::error::Fault;
use crate::fields::Fields;
use crate::textures::Loader;

pub(crate) const NAME: &str = "KHR_materials_pbrSpecularGlossiness";

/// Converts the material by the extension's parameters. Returns false if the extension is absent.
pub(crate) fn convert(loader: &mut Loader<'_, '_>, material: &mut Material, place: &str) -> Result<bool, Fault> {
    let Some(fields) = Fields::at(loader.document, format!("{place}/extensions/{NAME}"))? else { return Ok(false) };
    material.base_color = Vec4::from(fields.numbers("diffuseFactor", [1.0; 4])?);
    material.base_color_texture = loader.untyped_texture(&fields, "diffuseTexture")?;
    (material.metallic, material.ior, material.specular) = (0.0, 0.0, 1.0);
    material.specular_color = Vec3::from(fields.numbers("specularFactor", [1.0; 3])?);
    material.specular_color_texture = loader.untyped_texture(&fields, "specularGlossinessTexture")?;
    let glossiness = fields.number("glossinessFactor", 1.0)?;
    if !(0.0..=1.0).contains(&glossiness) {
        return Err(Fault::new(fields.place("glossinessFactor"), "a number in 0..1", glossiness));
    }
    match material.specular_color_texture {
        None => (material.roughness, material.metallic_roughness_texture) = (1.0 - glossiness, None),
        Some(glossy) => {
            let texture = roughness_texture(loader, glossy.texture, glossiness, place)?;
            material.roughness = 1.0;
            material.metallic_roughness_texture = Some(lumistack_scene::TextureUse { texture, ..glossy });
        }
    }
    Ok(true)
}

/// Returns the index of a roughness texture that is made from `glossy`, a texture whose alpha is
/// glossiness.
fn roughness_texture(loader: &mut Loader<'_, '_>, glossy: usize, factor: f32, place: &str) -> Result<usize, Fault> {
    let source = loader.textures[glossy];
    let key = (source.image, factor.to_bits());
    let image = match loader.roughness_images.get(&key) {
        Some(&image) => image,
        None => {
            let image = loader.images.roughness(loader.document, source.image, factor, place)?;
            loader.roughness_images.insert(key, image);
            image
        }
    };
    loader.textures.push(Texture { image, ..source });
    Ok(loader.textures.len() - 1)
}
