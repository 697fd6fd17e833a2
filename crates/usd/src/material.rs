//! Converts the materials of a scene package: the inputs of a surface shader to the slots of a
//! [`Material`].
//!
//! Supported shaders: UsdPreviewSurface (both workflows); and from MaterialX standard_surface,
//! open_pbr_surface, gltf_pbr and surface_unlit. They are mapped to metallic-roughness and its
//! extensions. One warning per material lists the inputs that have no counterpart but differ from
//! their defaults.
//!
//! Sources: UsdPreviewSurface specification 2.6, Autodesk Standard Surface 1.0.1, OpenPBR Surface
//! 1.1, glTF 2.0.

use std::collections::BTreeMap;

use lumistack_core::Task;
use lumistack_scene::Material;
use serde::Deserialize;

use crate::slots::{Builder, Input, Inputs};
use crate::texture::Textures;
use crate::{preview, uber};

/// A material, with the vertex attributes that it reads.
#[derive(Clone, Debug)]
pub(crate) struct Loaded {
    pub(crate) material: Material,
    /// Names of the primvars that become texture coordinate sets 0 and 1.
    pub(crate) uv_names: [Option<String>; 2],
    /// True if vertex colours (displayColor) multiply the base colour.
    pub(crate) reads_colors: bool,
}

/// A material of a scene package, in the form in which the walker (Python) writes it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct Entry {
    place: String,
    name: String,
    model: Option<String>,
    inputs: BTreeMap<String, Input>,
}

/// Converts an entry to a material. `None` if the entry cannot be read or the shader is unknown;
/// the display colour applies then. A texture that cannot be read is replaced by its fallback.
pub(crate) fn load<'a>(entry: &serde_json::Value, textures: &mut Textures<'a>, task: Task<'a>) -> Option<Loaded> {
    let mut entry: Entry = match serde_json::from_value(entry.clone()) {
        Ok(entry) => entry,
        Err(error) => {
            let place = entry.get("place").and_then(|place| place.as_str()).unwrap_or("/materials");
            task.warn(
                place,
                format!(
                    "expected a material in the form that lumistack's USD script writes, found data that cannot be read ({error}); the display colour is used"
                ),
            );
            return None;
        }
    };
    // Replace inputs that cannot be used: invalid inputs by their defaults, unreadable textures by
    // their fallbacks.
    let model = entry.model.take()?;
    for input in entry.inputs.values_mut() {
        let broken = input.texture.as_ref().is_some_and(|source| !source.is_sound());
        let odd = input.value.as_ref().is_some_and(|values| values.is_empty() || values.iter().any(|v| !v.is_finite()));
        if broken || odd {
            *input = Input::default();
        } else if let Some(source) = &input.texture
            && textures.picture(source.image).is_none()
        {
            *input = Input { value: Some(source.fallback.clone()), ..Input::default() };
        }
    }
    let Entry { place, name, inputs, .. } = entry;
    let inputs = Inputs::new(inputs);
    let material = Material {
        name,
        metallic: 0.0,
        roughness: 0.5,
        // USD renderers show both sides unless culling is requested
        double_sided: true,
        ..Material::default()
    };
    let mut builder = Builder { place, textures, task, uv_names: [None, None], reads_colors: false, material };
    let known = match model.as_str() {
        "UsdPreviewSurface" => preview::build(&mut builder, &inputs),
        "standard_surface" => uber::standard_surface(&mut builder, &inputs),
        "open_pbr_surface" => uber::open_pbr(&mut builder, &inputs),
        "gltf_pbr" => uber::gltf_pbr(&mut builder, &inputs),
        "surface_unlit" => uber::unlit(&mut builder, &inputs),
        _ => return None,
    };
    let ignored = inputs.ignored(known);
    if !ignored.is_empty() {
        let message = format!("{model}: inputs that cannot be shown are left out: {}", ignored.join(", "));
        task.warn(&builder.place, message);
    }
    let Builder { material, mut uv_names, reads_colors, .. } = builder;
    // normal maps and anisotropy need texture coordinates; if no texture names a primvar, `st` has
    // them
    if material.tangent_uv_set().is_some() && uv_names[0].is_none() {
        uv_names[0] = Some("st".into());
    }
    Some(Loaded { material, uv_names, reads_colors })
}
