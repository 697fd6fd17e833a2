//! Textures of materials: all kinds of references that glTF has, samplers, and the transform of
//! texture coordinates.
//!
//! Source: glTF 2.0, sections 3.8 and 3.9, and KHR_texture_transform.

use std::collections::HashMap;

use glam::{Affine2, Vec2};
use gltf::json;
use gltf::json::extensions::texture::TextureTransform;
use gltf::json::validation::Checked;
use lumistack_scene::{Filter, Texture, TextureUse, Wrap};
use serde_json::Value;

use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;
use crate::images::Images;
use crate::quote::quote;

/// Adds the textures that materials use to a list, each only once.
pub(crate) struct Loader<'d, 'f> {
    pub(crate) document: &'d Document<'f>,
    pub(crate) textures: Vec<Texture>,
    pub(crate) images: Images,
    /// Position in `textures` of a texture; the key is the texture's index in the file.
    position: HashMap<usize, usize>,
    /// Index of each roughness image that was made from a glossiness image. The key is the index of
    /// the glossiness image, and the bits of the factor by which its alpha is multiplied.
    pub(crate) roughness_images: HashMap<(usize, u32), usize>,
}

/// A reference to a texture, converted from any of glTF's kinds.
pub(crate) struct Reference {
    pub(crate) index: json::Index<json::Texture>,
    pub(crate) uv_set: u32,
    pub(crate) transform: Option<TextureTransform>,
    pub(crate) place: String,
}

impl<'d, 'f> Loader<'d, 'f> {
    pub(crate) fn new(document: &'d Document<'f>) -> Self {
        let (position, roughness_images) = (HashMap::new(), HashMap::new());
        Self { document, textures: Vec::new(), images: Images::default(), position, roughness_images }
    }

    /// Returns the texture to which a member of an extension refers.
    pub(crate) fn untyped_texture(&mut self, fields: &Fields<'_>, key: &str) -> Result<Option<TextureUse>, Fault> {
        let place = fields.place(key);
        let Some(info) = Fields::at(self.document, place.clone())? else { return Ok(None) };
        let uv_set = info.count("texCoord")?.unwrap_or_default();
        let uv_set = u32::try_from(uv_set).map_err(|_| {
            Fault::new(info.place("texCoord"), "the number of a coordinate set, at most 4294967295", uv_set)
        })?;
        let transform = self.document.json(&info.place("extensions/KHR_texture_transform"));
        let transform = transform.map(|value| untyped_transform(value, &place)).transpose()?;
        self.texture_use(Some(Reference { index: info.needed_index("index")?, uv_set, transform, place }))
    }

    pub(crate) fn texture_use(&mut self, reference: Option<Reference>) -> Result<Option<TextureUse>, Fault> {
        let Some(Reference { index, uv_set, transform, place }) = reference else { return Ok(None) };
        let texture = self.texture(index, &format!("{place}/index"))?;
        let uv_set = transform.as_ref().and_then(|transform| transform.tex_coord).unwrap_or(uv_set) as usize;
        let texture_from_mesh = transform.as_ref().map_or(Affine2::IDENTITY, affine);
        Ok(Some(TextureUse { texture, uv_set, texture_from_mesh }))
    }

    /// Returns the position in `textures` of the file's texture with this index. Reads the texture
    /// and its image at their first use.
    fn texture(&mut self, index: json::Index<json::Texture>, used_at: &str) -> Result<usize, Fault> {
        let document = self.document;
        let texture = document.get(index, used_at)?;
        if let Some(&position) = self.position.get(&index.value()) {
            return Ok(position);
        }
        let place = format!("/textures/{}", index.value());
        let better = ["KHR_texture_basisu", "EXT_texture_webp"].map(|name| format!("{place}/extensions/{name}/source"));
        // use the picture that an extension names, if there is one; `source` is for readers without
        // the extension
        let image = match better.iter().find_map(|place| Some((document.json(place)?.as_u64()?, place))) {
            Some((source, place)) => self.images.texture(document, json::Index::new(source as u32), place)?,
            None => self.images.texture(document, texture.source, &format!("{place}/source"))?,
        };
        // without a sampler the texture repeats and is filtered linearly
        let sampler = match texture.sampler {
            Some(sampler) => Some((document.get(sampler, &format!("{place}/sampler"))?, sampler.value())),
            None => None,
        };
        let (wrap_u, wrap_v, filter) = match sampler {
            Some((sampler, number)) => (
                self.wrap(sampler.wrap_s, number, "wrapS")?,
                self.wrap(sampler.wrap_t, number, "wrapT")?,
                match sampler.mag_filter {
                    Some(Checked::Valid(json::texture::MagFilter::Nearest)) => Filter::Nearest,
                    Some(Checked::Invalid) => return Err(self.sampler_fault(number, "magFilter")),
                    _ => Filter::Linear,
                },
            ),
            None => Default::default(),
        };
        self.position.insert(index.value(), self.textures.len());
        self.textures.push(Texture { image, wrap_u, wrap_v, filter });
        Ok(self.textures.len() - 1)
    }

    fn wrap(&self, mode: Checked<json::texture::WrappingMode>, number: usize, field: &str) -> Result<Wrap, Fault> {
        use gltf::json::texture::WrappingMode;
        match mode {
            Checked::Valid(WrappingMode::Repeat) => Ok(Wrap::Repeat),
            Checked::Valid(WrappingMode::MirroredRepeat) => Ok(Wrap::MirroredRepeat),
            Checked::Valid(WrappingMode::ClampToEdge) => Ok(Wrap::ClampToEdge),
            Checked::Invalid => Err(self.sampler_fault(number, field)),
        }
    }

    fn sampler_fault(&self, number: usize, field: &str) -> Fault {
        let place = format!("/samplers/{number}/{field}");
        let found = self.document.quote(&place);
        Fault::new(place, "a value that glTF 2.0 defines", found)
    }
}

/// Makes a reference from a member for which the `gltf` crate has a type. The member is `slot` of
/// the object at `parent`.
pub(crate) fn plain(info: &json::texture::Info, parent: &str, slot: &str) -> Reference {
    let transform = info.extensions.as_ref().and_then(|extensions| extensions.texture_transform.clone());
    Reference { index: info.index, uv_set: info.tex_coord, transform, place: format!("{parent}/{slot}") }
}

/// Reads the transform of a texture whose extensions are read without types of the `gltf` crate: a
/// normal texture, or a texture of a material extension.
pub(crate) fn untyped_transform(value: &Value, place: &str) -> Result<TextureTransform, Fault> {
    serde_json::from_value(value.clone()).map_err(|_| {
        let place = format!("{place}/extensions/KHR_texture_transform");
        Fault::new(
            place,
            "an object of offset, rotation, scale and texCoord with the types of the extension",
            quote(Some(value)),
        )
    })
}

/// Returns the map of `KHR_texture_transform`: scale, then rotation, then offset. Positive angles
/// turn u towards −v, which is counter-clockwise on the picture, since v points down. The
/// extension's text does not define the direction of rotation, but its test scene and all common
/// viewers agree.
fn affine(transform: &TextureTransform) -> Affine2 {
    let (scale, offset) = (Vec2::from(transform.scale.0), Vec2::from(transform.offset.0));
    Affine2::from_scale_angle_translation(scale, -transform.rotation.0, offset)
}
