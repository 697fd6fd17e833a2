//! Packed content, and the results of decoding it.

use gltf::json::accessor::ComponentType;
use lumistack_scene::Pixels;
use lumistack_splats::read::Found;

/// Packed content that a library decodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Packed<'a> {
    /// A picture; only its size is read, from its header. The result is [`Unpacked::Size`].
    Size(Use, &'a [u8]),
    /// A picture, all of whose texels are decoded. The result is [`Unpacked::Pixels`].
    Picture(Use, &'a [u8]),
    /// A Draco mesh, which is decoded to [`Unpacked::Mesh`].
    Draco {
        /// The bytes of the Draco stream.
        bytes: &'a [u8],
        /// Draco's unique ids of the attributes that are decoded, without duplicates.
        attributes: &'a [u32],
        /// Largest number of bytes that the mesh and these attributes may take.
        max_bytes: u64,
    },
    /// A meshopt stream, which is decoded to [`Unpacked::Bytes`].
    Meshopt {
        /// The bytes of the meshopt stream.
        bytes: &'a [u8],
        /// The codec by which the stream was compressed.
        codec: Codec,
        /// The filter that is undone after decompression.
        filter: Filter,
        /// Number of elements of the decoded view.
        count: usize,
        /// Number of bytes of an element of the decoded view.
        stride: usize,
    },
    /// An SPZ stream, which is decoded to [`Unpacked::Splats`].
    Spz {
        /// The bytes of the SPZ stream.
        bytes: &'a [u8],
        /// Largest number of bytes that the splats may take.
        max_bytes: u64,
    },
    /// A file of splats, and the names and contents of the files beside it. The result is
    /// [`Unpacked::Splats`].
    Capture(&'a [u8], Vec<(&'a str, &'a [u8])>),
}

/// The use of a picture, which decides the allowed formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// A texture, which may be PNG, JPEG, WebP or KTX2.
    Texture,
    /// An environment map, which is Radiance (`.hdr`).
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
    /// Size of a picture in texels, and size of a texel in bytes.
    Size {
        /// Number of texels in a row of the picture.
        width: u32,
        /// Number of rows of the picture.
        height: u32,
        /// Number of bytes of a texel after decoding.
        texel_bytes: usize,
    },
    /// Texels of a picture, row by row.
    Pixels(Pixels),
    /// Mesh of a Draco stream.
    Mesh(Mesh),
    /// Decoded bytes of a meshopt stream.
    Bytes(Vec<u8>),
    /// Splats of an SPZ stream or of a file of splats.
    Splats(Found),
}

/// A mesh of a Draco stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mesh {
    /// Number of vertices of the mesh.
    pub vertices: usize,
    /// Vertex indices of the corners, not checked against `vertices`.
    pub triangles: Vec<[u32; 3]>,
    /// One attribute for each requested id; `None` if the stream does not have the id.
    pub attributes: Vec<Option<Attribute>>,
}

/// Elements of one attribute, tightly packed, one per vertex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Type of a component, or Draco's name of a type that glTF does not have.
    pub component: Result<ComponentType, String>,
    /// Number of components of an element, such as 3 for a position.
    pub dimensions: usize,
    /// The elements, or the index of the first vertex that has none. The list is empty if glTF does
    /// not have the type of the components, or if the mesh would exceed its limit of bytes.
    pub elements: Result<Vec<u8>, u32>,
}

/// Content that a decoder cannot read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unsound {
    /// Place in the content; empty for the content as a whole.
    pub place: String,
    /// The expected content.
    pub expected: String,
    /// The content that was found instead.
    pub found: String,
}

impl Unsound {
    pub(crate) fn new(expected: impl Into<String>, found: impl std::fmt::Display) -> Self {
        Self { place: String::new(), expected: expected.into(), found: found.to_string() }
    }
}

impl Packed<'_> {
    /// Returns true for the pictures that most scenes have: PNG, JPEG and Radiance. The content
    /// decides the format.
    pub fn is_common(&self) -> bool {
        let (Self::Size(_, bytes) | Self::Picture(_, bytes)) = self else { return false };
        let starts = [&b"\x89PNG\r\n\x1a\n"[..], b"\xff\xd8\xff", b"#?RADIANCE"];
        starts.iter().any(|start| bytes.starts_with(start))
    }

    /// Returns the error for content without a usable result: the decoder panics, is missing, or
    /// returns a result of another kind.
    pub fn stopped(&self) -> Unsound {
        let expected = match self {
            Self::Size(..) | Self::Picture(..) => "a sound picture",
            Self::Draco { .. } => "a sound Draco mesh",
            Self::Meshopt { .. } => "a sound meshopt stream",
            Self::Spz { .. } => "a sound SPZ stream",
            Self::Capture(..) => "a sound file of splats",
        };
        Unsound::new(expected, "data at which the decoder stops")
    }
}
