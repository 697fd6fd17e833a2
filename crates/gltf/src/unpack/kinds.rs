//! Packed content, and what comes out of it.

use gltf::json::accessor::ComponentType;
use lumistack_scene::Pixels;
use lumistack_splats::read::Found;

/// Packed content that a library decodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Packed<'a> {
    /// A picture of which the size alone is wanted: [`Unpacked::Size`].
    Size(Use, &'a [u8]),
    /// A picture: [`Unpacked::Pixels`].
    Picture(Use, &'a [u8]),
    /// A Draco mesh: [`Unpacked::Mesh`] with the attributes of these ids, within `max_bytes`.
    Draco {
        /// The stream.
        bytes: &'a [u8],
        /// Unique ids of the wanted attributes, none twice.
        attributes: &'a [u32],
        /// Largest number of bytes that the mesh and the wanted attributes may take.
        max_bytes: u64,
    },
    /// A meshopt stream: [`Unpacked::Bytes`].
    Meshopt {
        /// The stream.
        bytes: &'a [u8],
        /// Its codec.
        codec: Codec,
        /// The filter that is undone after decompression.
        filter: Filter,
        /// Number of elements.
        count: usize,
        /// Number of bytes of an element.
        stride: usize,
    },
    /// An SPZ stream: [`Unpacked::Splats`].
    Spz {
        /// The stream.
        bytes: &'a [u8],
        /// Largest number of bytes that the splats may take.
        max_bytes: u64,
    },
    /// A file of splats, and the files beside it by name: [`Unpacked::Splats`].
    Capture(&'a [u8], Vec<(&'a str, &'a [u8])>),
}

/// The use of a picture, which decides its formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// PNG, JPEG, WebP or KTX2.
    Texture,
    /// Radiance (`.hdr`).
    Environment,
}

/// Codecs of meshopt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// `ATTRIBUTES`
    Attributes,
    /// `TRIANGLES`
    Triangles,
    /// `INDICES`
    Indices,
}

/// Filters of meshopt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// `NONE`
    None,
    /// `OCTAHEDRAL`
    Octahedral,
    /// `QUATERNION`
    Quaternion,
    /// `EXPONENTIAL`
    Exponential,
    /// `COLOR`
    Color,
}

/// Decoded content.
#[derive(Clone, Debug, PartialEq)]
pub enum Unpacked {
    /// Size of a picture in texels, and of one of its texels in bytes.
    Size {
        /// Number of texels in a row.
        width: u32,
        /// Number of rows.
        height: u32,
        /// Number of bytes of a texel.
        texel_bytes: usize,
    },
    /// Texels, row by row.
    Pixels(Pixels),
    /// A mesh.
    Mesh(Mesh),
    /// Plain bytes.
    Bytes(Vec<u8>),
    /// Splats.
    Splats(Found),
}

/// A mesh of a Draco stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mesh {
    /// Number of vertices.
    pub vertices: usize,
    /// Vertex indices of the corners, not checked against `vertices`.
    pub triangles: Vec<[u32; 3]>,
    /// The wanted attributes; `None` for ids that the stream does not have.
    pub attributes: Vec<Option<Attribute>>,
}

/// Elements of one attribute, tightly packed, one per vertex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Type of a component, or the name of one that glTF does not have.
    pub component: Result<ComponentType, String>,
    /// Number of components of an element.
    pub dimensions: usize,
    /// The elements, or the first vertex that has none. Empty once the bytes that the mesh may take
    /// are used up.
    pub elements: Result<Vec<u8>, u32>,
}

/// Content that a decoder cannot read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unsound {
    /// Place in the content; empty if it is the content as a whole.
    pub place: String,
    /// The expected content.
    pub expected: String,
    /// The found content.
    pub found: String,
}

impl Unsound {
    pub(crate) fn new(expected: impl Into<String>, found: impl std::fmt::Display) -> Self {
        Self { place: String::new(), expected: expected.into(), found: found.to_string() }
    }
}

impl Packed<'_> {
    /// The error for content on which the decoder of a library panics, since the library does not
    /// check for this kind of defect.
    pub fn stopped(&self) -> Unsound {
        let expected = match self {
            Self::Size(..) | Self::Picture(..) => "a sound picture",
            Self::Draco { .. } => "a sound Draco mesh",
            Self::Meshopt { .. } => "a sound meshopt stream",
            Self::Spz { .. } => "a sound SPZ stream",
            Self::Capture(..) => "a sound file of splats",
        };
        Unsound::new(expected, "bytes on which its decoder stops")
    }
}
