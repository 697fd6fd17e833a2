//! `KHR_draco_mesh_compression`: a primitive whose triangles and attributes are one Draco stream.
//!
//! Attributes of the stream take precedence over the primitive's accessors. Only the accessors'
//! `normalized` is read.

use std::collections::HashMap;

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointIndex};
use gltf::json::accessor::ComponentType;
use serde_json::Value;

use crate::document::Document;
use crate::error::{Fault, contained};
use crate::fields::Fields;
use crate::quote::quote;

/// Largest memory that the decoder may take for one primitive.
const MAX_PRIMITIVE_BYTES: u64 = 2 << 30;

/// A decoded primitive.
pub(crate) struct Decoded {
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) vertices: usize,
    /// Attributes by glTF's name.
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
    // decode within the memory that is left for the file
    let stream_place = fields.place("bufferView");
    let stream = document.view(fields.needed_index("bufferView")?, &stream_place)?.bytes;
    let most_bytes = document.affordable_bytes().min(MAX_PRIMITIVE_BYTES);
    let limits = DecodeLimits::default()
        .with_max_decoded_bytes(most_bytes)
        .with_max_points(most_bytes / 12)
        .with_max_faces(most_bytes / 12);
    let mut mesh = Mesh::new();
    let mut buffer = DecoderBuffer::new(stream).with_limits(limits);
    let broken = |found: String| Fault::new(&stream_place, "a sound Draco mesh", found);
    contained(&stream_place, "a sound Draco mesh", || {
        MeshDecoder::new().decode(&mut buffer, &mut mesh).map_err(|error| broken(error.to_string()))
    })?;

    let vertices = mesh.num_points();
    document.spend(&stream_place, mesh.num_faces(), size_of::<[u32; 3]>())?;
    let triangles: Vec<[u32; 3]> = mesh.faces().iter().map(|face| face.map(|corner| corner.0)).collect();
    if triangles.as_flattened().iter().any(|&corner| corner as usize >= vertices) {
        return Err(broken(format!("a corner past its {vertices} vertices")));
    }
    let mut attributes = HashMap::new();
    // unpack the attributes to one element per vertex, as in accessors
    let listed = document.json(&fields.place("attributes"));
    let Some(list) = listed.and_then(Value::as_object) else {
        return Err(Fault::new(fields.place("attributes"), "an object of attributes", quote(listed)));
    };
    for (name, id) in list {
        let place = fields.place(&format!("attributes/{name}"));
        let source = id.as_u64().and_then(|id| u32::try_from(id).ok()).and_then(|id| mesh.attribute_by_unique_id(id));
        let Some(source) = source else {
            return Err(Fault::new(place, "an attribute of the Draco stream", id));
        };
        let component = match source.data_type() {
            DataType::Int8 => ComponentType::I8,
            DataType::Uint8 => ComponentType::U8,
            DataType::Int16 => ComponentType::I16,
            DataType::Uint16 => ComponentType::U16,
            DataType::Uint32 => ComponentType::U32,
            DataType::Float32 => ComponentType::F32,
            other => return Err(Fault::new(place, "a component type of glTF", format!("{other:?}"))),
        };
        let dimensions = usize::from(source.num_components());
        let size = dimensions * component.size();
        let stride = usize::try_from(source.byte_stride()).unwrap_or_default();
        document.spend(&place, vertices, size)?;
        let mut bytes = Vec::with_capacity(vertices * size);
        for vertex in 0..vertices as u32 {
            let start = (source.mapped_index(PointIndex(vertex)).0 as usize).checked_mul(stride);
            let element = start.and_then(|start| source.buffer().data().get(start..start.checked_add(size)?));
            bytes.extend_from_slice(element.ok_or_else(|| broken(format!("no value of {name} for vertex {vertex}")))?);
        }
        attributes.insert(name.clone(), Attribute { component, dimensions, bytes });
    }
    Ok(Some(Decoded { triangles, vertices, attributes }))
}
