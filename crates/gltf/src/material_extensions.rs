//! Material extensions that are read without types of the `gltf` crate.
//!
//! Source: the texts of KHR_materials_specular, _clearcoat, _sheen, _iridescence, _anisotropy and
//! _dispersion. Factors out of range are clamped by the scene's validator.

use lumistack_scene::{Anisotropy, Clearcoat, Iridescence, Material, Sheen};

use crate::error::Fault;
use crate::fields::Fields;
use crate::textures::Loader;

/// Reads the extensions that the head of this file lists, for the material at `place`.
pub(crate) fn read(loader: &mut Loader<'_, '_>, material: &mut Material, place: &str) -> Result<(), Fault> {
    let document = loader.document;
    let extension = |name: &str| Fields::at(document, format!("{place}/extensions/KHR_materials_{name}"));
    if let Some(fields) = extension("specular")? {
        material.specular = fields.number("specularFactor", 1.0)?;
        material.specular_texture = loader.untyped_texture(&fields, "specularTexture")?;
        material.specular_color = fields.numbers("specularColorFactor", [1.0; 3])?.into();
        material.specular_color_texture = loader.untyped_texture(&fields, "specularColorTexture")?;
    }
    if let Some(fields) = extension("dispersion")? {
        material.dispersion = fields.number("dispersion", 0.0)?;
    }
    if let Some(fields) = extension("clearcoat")? {
        material.clearcoat = Some(Clearcoat {
            factor: fields.number("clearcoatFactor", 0.0)?,
            texture: loader.untyped_texture(&fields, "clearcoatTexture")?,
            roughness: fields.number("clearcoatRoughnessFactor", 0.0)?,
            roughness_texture: loader.untyped_texture(&fields, "clearcoatRoughnessTexture")?,
            normal_texture: loader.untyped_texture(&fields, "clearcoatNormalTexture")?,
            normal_scale: match Fields::at(document, fields.place("clearcoatNormalTexture"))? {
                Some(texture) => texture.number("scale", 1.0)?,
                None => 1.0,
            },
        });
    }
    if let Some(fields) = extension("sheen")? {
        material.sheen = Some(Sheen {
            color: fields.numbers("sheenColorFactor", [0.0; 3])?.into(),
            color_texture: loader.untyped_texture(&fields, "sheenColorTexture")?,
            roughness: fields.number("sheenRoughnessFactor", 0.0)?,
            roughness_texture: loader.untyped_texture(&fields, "sheenRoughnessTexture")?,
        });
    }
    if let Some(fields) = extension("iridescence")? {
        let default = Iridescence::default();
        let [thin, thick] = default.thickness_nm;
        material.iridescence = Some(Iridescence {
            factor: fields.number("iridescenceFactor", 0.0)?,
            texture: loader.untyped_texture(&fields, "iridescenceTexture")?,
            ior: fields.number("iridescenceIor", default.ior)?,
            thickness_nm: [
                fields.number("iridescenceThicknessMinimum", thin)?,
                fields.number("iridescenceThicknessMaximum", thick)?,
            ],
            thickness_texture: loader.untyped_texture(&fields, "iridescenceThicknessTexture")?,
        });
    }
    if let Some(fields) = extension("anisotropy")? {
        material.anisotropy = Some(Anisotropy {
            strength: fields.number("anisotropyStrength", 0.0)?,
            rotation_rad: fields.number("anisotropyRotation", 0.0)?,
            texture: loader.untyped_texture(&fields, "anisotropyTexture")?,
        });
    }
    Ok(())
}
