//! `KHR_materials_variants`: one file with several sets of materials.

use gltf::json;
use serde_json::Value;

use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;
use crate::quote::quote;

/// Returns the names of the variants, in the file's order.
pub(crate) fn names<'d>(document: &'d Document<'_>) -> Vec<Option<&'d str>> {
    let list = document.json("/extensions/KHR_materials_variants/variants").and_then(Value::as_array);
    list.into_iter().flatten().map(|variant| variant.get("name").and_then(Value::as_str)).collect()
}

/// Returns the material of the primitive at `place` in the chosen variant. It is the primitive's
/// default material if no variant is chosen, or if the primitive has no mapping for the chosen
/// variant.
pub(crate) fn material(
    document: &Document<'_>,
    primitive: &json::mesh::Primitive,
    place: &str,
) -> Result<Option<json::Index<json::Material>>, Fault> {
    let mapped = match document.variant {
        Some(variant) => mapped(document, place, variant)?,
        None => None,
    };
    let (material, used_at) = match mapped {
        Some((material, used_at)) => (Some(material), used_at),
        None => (primitive.material, format!("{place}/material")),
    };
    if let Some(material) = material {
        document.get(material, &used_at)?;
    }
    Ok(material)
}

fn mapped(
    document: &Document<'_>,
    place: &str,
    variant: usize,
) -> Result<Option<(json::Index<json::Material>, String)>, Fault> {
    let Some(extension) = Fields::at(document, format!("{place}/extensions/KHR_materials_variants"))? else {
        return Ok(None);
    };
    for i in 0..extension.list("mappings")? {
        let place = extension.place(&format!("mappings/{i}"));
        let Some(mapping) = Fields::at(document, place.clone())? else { continue };
        let variants = document.json(&mapping.place("variants"));
        let Some(list) = variants.and_then(Value::as_array) else {
            return Err(Fault::new(mapping.place("variants"), "a list of variants", quote(variants)));
        };
        if list.iter().any(|entry| entry.as_u64() == Some(variant as u64)) {
            return Ok(Some((mapping.needed_index("material")?, mapping.place("material"))));
        }
    }
    Ok(None)
}
