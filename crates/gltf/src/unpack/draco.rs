//! Draco meshes.

use draco_core::{DataType, DecodeLimits, DecoderBuffer, MeshDecoder, PointAttribute, PointIndex};
use gltf::json::accessor::ComponentType;

use super::kinds::{Attribute, Mesh, Unpacked, Unsound};

/// Decodes a stream. The attributes with the given ids are expanded to one element per vertex.
pub(super) fn decode(bytes: &[u8], attributes: &[u32], max_bytes: u64) -> Result<Unpacked, Unsound> {
    let limits = DecodeLimits::default()
        .with_max_decoded_bytes(max_bytes)
        .with_max_points(max_bytes / 12)
        .with_max_faces(max_bytes / 12);
    let mut mesh = draco_core::Mesh::new();
    let mut buffer = DecoderBuffer::new(bytes).with_limits(limits);
    let decoded = MeshDecoder::new().decode(&mut buffer, &mut mesh);
    decoded.map_err(|error| Unsound::new("a sound Draco mesh", error))?;
    let vertices = mesh.num_points();
    let mut used = (mesh.num_faces() * size_of::<[u32; 3]>()) as u64;
    let unpack = |&id: &u32| {
        let source = mesh.attribute_by_unique_id(id)?;
        let component = component(source.data_type());
        let dimensions = usize::from(source.num_components());
        let size = component.as_ref().map_or(0, |component| component.size()) * dimensions;
        used += (vertices * size) as u64;
        // over the limit, expand no elements, so that memory is bounded
        let elements = if used > max_bytes { Ok(Vec::new()) } else { elements(source, vertices, size) };
        Some(Attribute { component, dimensions, elements })
    };
    Ok(Unpacked::Mesh(Mesh {
        vertices,
        attributes: attributes.iter().map(unpack).collect(),
        triangles: mesh.faces().iter().map(|face| face.map(|corner| corner.0)).collect(),
    }))
}

fn component(of: DataType) -> Result<ComponentType, String> {
    Ok(match of {
        DataType::Int8 => ComponentType::I8,
        DataType::Uint8 => ComponentType::U8,
        DataType::Int16 => ComponentType::I16,
        DataType::Uint16 => ComponentType::U16,
        DataType::Uint32 => ComponentType::U32,
        DataType::Float32 => ComponentType::F32,
        other => return Err(format!("{other:?}")),
    })
}

/// Returns the elements of all vertices, or the index of the first vertex without an element.
fn elements(source: &PointAttribute, vertices: usize, size: usize) -> Result<Vec<u8>, u32> {
    let stride = usize::try_from(source.byte_stride()).unwrap_or_default();
    let mut bytes = Vec::with_capacity(vertices * size);
    for vertex in 0..vertices as u32 {
        let start = (source.mapped_index(PointIndex(vertex)).0 as usize).checked_mul(stride);
        let element = start.and_then(|start| source.buffer().data().get(start..start.checked_add(size)?));
        bytes.extend_from_slice(element.ok_or(vertex)?);
    }
    Ok(bytes)
}
