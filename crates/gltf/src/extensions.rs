//! Which extensions are read, and what becomes of the others.

use crate::document::Document;
use crate::error::Fault;

/// Extensions that a file may require.
const SUPPORTED: [&str; 10] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Extensions that do not change the picture.
const WITHOUT_EFFECT: [&str; 2] = ["KHR_xmp", "KHR_xmp_json_ld"];

/// Refuses files that require an extension which is not supported; warns of those that use one.
pub(crate) fn check(document: &Document<'_>) -> Result<(), Fault> {
    let is_read = |name: &str| SUPPORTED.contains(&name) || WITHOUT_EFFECT.contains(&name);
    for (i, name) in document.root.extensions_required.iter().enumerate() {
        if !is_read(name) {
            let (place, name) = (format!("/extensionsRequired/{i}"), name.clone());
            return Err(Fault::UnsupportedExtension { place, name, supported: SUPPORTED.join(", ") });
        }
    }
    for (i, name) in document.root.extensions_used.iter().enumerate() {
        if !is_read(name) {
            document.task.warn(format!("/extensionsUsed/{i}"), format!("{name} is not supported and has no effect"));
        }
    }
    Ok(())
}
