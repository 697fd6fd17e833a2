//! The vertex attributes of a primitive, from accessors or from a Draco stream.

use gltf::json;
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;

use crate::accessor::{Accessor, Format};
use crate::document::Document;
use crate::draco;
use crate::error::Fault;

/// Opens the vertex attributes of a primitive by glTF's semantics, such as `POSITION`.
pub(crate) struct Attributes<'d, 'f> {
    pub(crate) document: &'d Document<'f>,
    /// JSON pointer to the primitive, `/meshes/I/primitives/J`.
    pub(crate) place: &'d str,
    pub(crate) primitive: &'d json::mesh::Primitive,
    /// Attributes of a Draco stream, which replace the attributes that accessors hold.
    pub(crate) decoded: Option<&'d draco::Decoded>,
}

impl<'d> Attributes<'d, '_> {
    /// Opens an attribute; `None` if the primitive lacks it. If `count` is given, an accessor must
    /// have this number of elements.
    pub(crate) fn open(
        &self,
        semantic: Semantic,
        format: &Format,
        count: Option<usize>,
    ) -> Result<Option<Accessor<'d>>, Fault> {
        let name = semantic.to_string();
        let place = format!("{}/attributes/{name}", self.place);
        let Some(&index) = self.primitive.attributes.get(&Checked::Valid(semantic)) else { return Ok(None) };
        match self.decoded.and_then(|decoded| decoded.attributes.get(&name)) {
            Some(source) => Accessor::decoded(self.document, index, &place, format, source).map(Some),
            None => self.open_index(index, &place, format, count).map(Some),
        }
    }

    /// Opens the accessor that the file names at `place`. If `count` is given, the accessor must
    /// have this number of elements.
    pub(crate) fn open_index(
        &self,
        index: json::Index<json::Accessor>,
        place: &str,
        format: &Format,
        count: Option<usize>,
    ) -> Result<Accessor<'d>, Fault> {
        let accessor = Accessor::open(self.document, index, place, format)?;
        match count {
            Some(count) if count != accessor.count => {
                Err(Fault::new(place, format!("{count} elements, as POSITION has"), accessor.count))
            }
            _ => Ok(accessor),
        }
    }
}
