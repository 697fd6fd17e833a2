//! `KHR_draco_mesh_compression`: a primitive whose triangles and attributes are one Draco stream.
//!
//! An attribute of the stream replaces the attribute's accessor, of which only `normalized` is
//! read.

use std::collections::HashMap;

use gltf::json::accessor::ComponentType;
use serde_json::Value;

use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;
use crate::quote::quote;
use crate::unpack::{self, Packed, Unpacked};

/// Largest memory that the decoder may take for one primitive.
const MAX_PRIMITIVE_BYTES: u64 = 2 << 30;

/// A decoded primitive.
pub(crate) struct Decoded {
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) vertices: usize,
    /// Decoded attributes; the key is the attribute's name in glTF.
    pub(crate) attributes: HashMap<String, Attribute>,
}

/// Elements of one attribute, without gaps, one per vertex.
pub(crate) struct Attribute {
    pub(crate) component: ComponentType,
    pub(crate) dimensions: usize,
    pub(crate) bytes: Vec<u8>,
}

/// Decodes the primitive at `place`; `None` if it is not compressed.
pub(crate) fn decode(document: &Document<'_>, place: &str) -> Result<Option<Decoded>, Fault> {
    let Some(fields) = Fields::at(document, format!("{place}/extensions/KHR_draco_mesh_compression"))? else {
        return Ok(None);
    };
    // list the ids of the attributes that the extension names
    let listed = document.json(&fields.place("attributes"));
    let Some(list) = listed.and_then(Value::as_object) else {
        return Err(Fault::new(fields.place("attributes"), "an object of attributes", quote(listed)));
    };
    let ids = list.values().map(|id| id.as_u64().and_then(|id| u32::try_from(id).ok()));
    let ids: Vec<Option<u32>> = ids.collect();
    let mut wanted: Vec<u32> = ids.iter().copied().flatten().collect();
    wanted.sort_unstable();
    wanted.dedup();
    // decode within the memory that is left to the file
    let stream_place = fields.place("bufferView");
    let stream = document.view(fields.needed_index("bufferView")?, &stream_place)?.bytes;
    let max_bytes = document.affordable_bytes().min(MAX_PRIMITIVE_BYTES);
    let packed = Packed::Draco { bytes: stream, attributes: &wanted, max_bytes };
    let mesh = document.unpack(&stream_place, &packed, |unpacked| match unpacked {
        Unpacked::Mesh(mesh) => Some(mesh),
        _ => None,
    })?;
    let unpack::Mesh { vertices, triangles, attributes: unpacked } = mesh;
    let broken = |found: String| Fault::new(&stream_place, "a sound Draco mesh", found);
    document.spend(&stream_place, triangles.len(), size_of::<[u32; 3]>())?;
    if triangles.as_flattened().iter().any(|&corner| corner as usize >= vertices) {
        return Err(broken(format!("a corner whose index is not below {vertices}, the number of vertices")));
    }
    // check the decoded attributes, and store them by name
    let mut attributes = HashMap::new();
    for ((name, id), known) in list.iter().zip(ids) {
        let place = fields.place(&format!("attributes/{name}"));
        let source = known.and_then(|id| unpacked[wanted.binary_search(&id).ok()?].as_ref());
        let Some(unpack::Attribute { component, dimensions, elements }) = source else {
            return Err(Fault::new(place, "the id of an attribute of the Draco stream", id));
        };
        let component = component.clone().map_err(|name| Fault::new(&place, "a component type of glTF", name))?;
        document.spend(&place, vertices, dimensions * component.size())?;
        let bytes = elements.clone().map_err(|vertex| broken(format!("no value of {name} for vertex {vertex}")))?;
        let size = vertices * dimensions * component.size();
        if bytes.len() != size {
            // the decoder expands no attribute over its limit
            return Err(Fault::new(place, format!("attributes of at most {max_bytes} bytes together"), "more"));
        }
        attributes.insert(name.clone(), Attribute { component, dimensions: *dimensions, bytes });
    }
    Ok(Some(Decoded { triangles, vertices, attributes }))
}
