//! Converts requests, and results of decoding (answers), to bytes and back. The bytes are
//! little-endian. Numbers outside of lists have 64 bits. The length of a list precedes the list.

use glam::{Quat, Vec3};
use gltf::json::accessor::ComponentType;
use lumistack_scene::{Cloud, Encoding, Pixels};
use lumistack_splats::read::{Axes, Found};

use super::kinds::{Attribute, Codec, Filter, Mesh, Packed, Unpacked, Unsound, Use};

const CODECS: [Codec; 3] = [Codec::Attributes, Codec::Triangles, Codec::Indices];
const FILTERS: [Filter; 5] = [Filter::None, Filter::Octahedral, Filter::Quaternion, Filter::Exponential, Filter::Color];
const COMPONENTS: [ComponentType; 6] = [
    ComponentType::I8,
    ComponentType::U8,
    ComponentType::I16,
    ComponentType::U16,
    ComponentType::U32,
    ComponentType::F32,
];

#[derive(Default)]
struct Out(Vec<u8>);

impl Out {
    fn number(&mut self, number: usize) -> &mut Self {
        self.long(number as u64)
    }

    fn long(&mut self, number: u64) -> &mut Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    /// Writes a value as its position in the list `all`.
    fn one_of<T: PartialEq>(&mut self, all: &[T], value: &T) -> &mut Self {
        self.number(all.iter().position(|other| other == value).unwrap_or(all.len()))
    }

    fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.number(bytes.len());
        self.0.extend(bytes);
        self
    }

    /// Writes values of `N` bytes each, after the number of all their bytes.
    fn values<const N: usize>(&mut self, values: impl ExactSizeIterator<Item = [u8; N]>) -> &mut Self {
        self.number(N * values.len());
        self.0.reserve(N * values.len());
        values.for_each(|value| self.0.extend(value));
        self
    }

    fn floats(&mut self, values: impl ExactSizeIterator<Item = f32>) -> &mut Self {
        self.values(values.map(f32::to_le_bytes))
    }
}

struct In<'a>(&'a [u8]);

impl<'a> In<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn long(&mut self) -> Option<u64> {
        self.take(8)?.first_chunk().copied().map(u64::from_le_bytes)
    }

    fn number(&mut self) -> Option<usize> {
        usize::try_from(self.long()?).ok()
    }

    fn one_of<T: Copy>(&mut self, all: &[T]) -> Option<T> {
        all.get(self.number()?).copied()
    }

    fn bytes(&mut self) -> Option<&'a [u8]> {
        let count = self.number()?;
        self.take(count)
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }

    fn values<const N: usize>(&mut self) -> Option<&'a [[u8; N]]> {
        Some(self.bytes()?.as_chunks().0)
    }

    fn words(&mut self) -> Option<Vec<u32>> {
        Some(self.values()?.iter().map(|&value| u32::from_le_bytes(value)).collect())
    }

    fn floats(&mut self) -> Option<Vec<f32>> {
        Some(self.values()?.iter().map(|&value| f32::from_le_bytes(value)).collect())
    }
}

impl Packed<'_> {
    /// Returns the request as bytes, for [`answer`](super::answer) in another module.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Out::default();
        match *self {
            Self::Size(usage, bytes) => out.number(0).one_of(&[Use::Texture, Use::Environment], &usage).bytes(bytes),
            Self::Picture(usage, bytes) => out.number(1).one_of(&[Use::Texture, Use::Environment], &usage).bytes(bytes),
            Self::Draco { bytes, attributes, max_bytes } => {
                let attributes = attributes.iter().map(|id| id.to_le_bytes());
                out.number(2).bytes(bytes).values(attributes).long(max_bytes)
            }
            Self::Meshopt { bytes, codec, filter, count, stride } => {
                out.number(3).bytes(bytes).one_of(&CODECS, &codec).one_of(&FILTERS, &filter);
                out.number(count).number(stride)
            }
            Self::Spz { bytes, max_bytes } => out.number(4).bytes(bytes).long(max_bytes),
            Self::Capture(bytes, ref beside) => {
                out.number(5).bytes(bytes).number(beside.len());
                for (name, bytes) in beside {
                    out.bytes(name.as_bytes()).bytes(bytes);
                }
                &mut out
            }
        };
        out.0
    }
}

/// Calls `with` with the request that the bytes hold; `None` if they hold no request.
pub(super) fn request<T>(bytes: &[u8], with: impl FnOnce(&Packed<'_>) -> T) -> Option<T> {
    let from = &mut In(bytes);
    let uses = [Use::Texture, Use::Environment];
    let attributes;
    let packed = match from.number()? {
        0 => Packed::Size(from.one_of(&uses)?, from.bytes()?),
        1 => Packed::Picture(from.one_of(&uses)?, from.bytes()?),
        2 => {
            let bytes = from.bytes()?;
            attributes = from.words()?;
            Packed::Draco { bytes, attributes: &attributes, max_bytes: from.long()? }
        }
        3 => Packed::Meshopt {
            bytes: from.bytes()?,
            codec: from.one_of(&CODECS)?,
            filter: from.one_of(&FILTERS)?,
            count: from.number()?,
            stride: from.number()?,
        },
        4 => Packed::Spz { bytes: from.bytes()?, max_bytes: from.long()? },
        5 => {
            let bytes = from.bytes()?;
            let mut beside = Vec::new();
            for _ in 0..from.number()? {
                beside.push((from.text()?, from.bytes()?));
            }
            Packed::Capture(bytes, beside)
        }
        _ => return None,
    };
    Some(with(&packed))
}

/// Returns the result of decoding as bytes.
pub(super) fn answer(answer: &Result<Unpacked, Unsound>) -> Vec<u8> {
    let mut out = Out::default();
    match answer {
        Err(Unsound { place, expected, found }) => {
            out.number(0).bytes(place.as_bytes()).bytes(expected.as_bytes()).bytes(found.as_bytes());
        }
        Ok(Unpacked::Size { width, height, texel_bytes }) => {
            out.number(1).number(*width as usize).number(*height as usize).number(*texel_bytes);
        }
        Ok(Unpacked::Pixels(Pixels::Rgba8(texels))) => {
            out.number(2).bytes(texels.as_flattened());
        }
        Ok(Unpacked::Pixels(Pixels::Rgba16(texels))) => {
            out.number(3).values(texels.as_flattened().iter().map(|value| value.to_le_bytes()));
        }
        Ok(Unpacked::Pixels(Pixels::RgbF32(texels))) => {
            out.number(4).floats(texels.as_flattened().iter().copied());
        }
        Ok(Unpacked::Mesh(mesh)) => {
            let corners = mesh.triangles.as_flattened().iter().map(|corner| corner.to_le_bytes());
            out.number(5).number(mesh.vertices).values(corners).number(mesh.attributes.len());
            mesh.attributes.iter().for_each(|one| attribute(&mut out, one.as_ref()));
        }
        Ok(Unpacked::Bytes(bytes)) => {
            out.number(6).bytes(bytes);
        }
        Ok(Unpacked::Splats(found)) => {
            splats(out.number(7), found);
        }
    }
    out.0
}

fn attribute(out: &mut Out, attribute: Option<&Attribute>) {
    let Some(Attribute { component, dimensions, elements }) = attribute else {
        out.number(0);
        return;
    };
    out.number(1);
    match component {
        Ok(component) => out.one_of(&COMPONENTS, component),
        Err(name) => out.number(COMPONENTS.len()).bytes(name.as_bytes()),
    };
    match elements {
        Ok(bytes) => out.number(*dimensions).number(1).bytes(bytes),
        Err(vertex) => out.number(*dimensions).number(0).number(*vertex as usize),
    };
}

fn splats(out: &mut Out, Found { cloud, axes, left_out }: &Found) {
    out.bytes(cloud.place.as_bytes());
    out.values(cloud.positions.iter().map(|at| triple(at.to_array())));
    out.floats(cloud.rotations.iter().flat_map(|turn| turn.to_array()).collect::<Vec<_>>().into_iter());
    out.values(cloud.scales.iter().map(|scale| triple(scale.to_array())));
    out.floats(cloud.opacities.iter().copied()).number(cloud.degree).floats(cloud.harmonics.iter().copied());
    out.one_of(&[Encoding::Srgb, Encoding::Linear], &cloud.encoding);
    out.one_of(&[Axes::RightUpBack, Axes::RightDownFront], axes).number(left_out.len());
    for text in left_out {
        out.bytes(text.as_bytes());
    }
}

fn triple(values: [f32; 3]) -> [u8; 12] {
    let mut bytes = [0; 12];
    bytes.as_chunks_mut::<4>().0.iter_mut().zip(values).for_each(|(to, value)| *to = value.to_le_bytes());
    bytes
}

/// Reads a result of decoding from bytes; `None` if the bytes do not come from
/// [`answer`](super::answer).
pub fn answered(bytes: &[u8]) -> Option<Result<Unpacked, Unsound>> {
    let from = &mut In(bytes);
    Some(Ok(match from.number()? {
        0 => {
            let mut text = || from.text().map(str::to_owned);
            return Some(Err(Unsound { place: text()?, expected: text()?, found: text()? }));
        }
        1 => {
            let mut side = || u32::try_from(from.long()?).ok();
            Unpacked::Size { width: side()?, height: side()?, texel_bytes: from.number()? }
        }
        2 => Unpacked::Pixels(Pixels::Rgba8(from.values()?.to_vec())),
        3 => {
            let code = |texel: &[u8; 8], i: usize| u16::from_le_bytes([texel[2 * i], texel[2 * i + 1]]);
            let texels = from.values()?.iter().map(|texel| std::array::from_fn(|i| code(texel, i)));
            Unpacked::Pixels(Pixels::Rgba16(texels.collect()))
        }
        4 => Unpacked::Pixels(Pixels::RgbF32(from.floats()?.as_chunks().0.to_vec())),
        5 => {
            let (vertices, triangles) = (from.number()?, from.words()?.as_chunks().0.to_vec());
            let attributes = (0..from.number()?).map(|_| attribute_of(from)).collect::<Option<_>>()?;
            Unpacked::Mesh(Mesh { vertices, triangles, attributes })
        }
        6 => Unpacked::Bytes(from.bytes()?.to_vec()),
        7 => Unpacked::Splats(splats_of(from)?),
        _ => return None,
    }))
}

fn attribute_of(from: &mut In<'_>) -> Option<Option<Attribute>> {
    if from.number()? == 0 {
        return Some(None);
    }
    let component = match COMPONENTS.get(from.number()?) {
        Some(component) => Ok(*component),
        None => Err(from.text()?.to_owned()),
    };
    let dimensions = from.number()?;
    let elements = match from.number()? {
        1 => Ok(from.bytes()?.to_vec()),
        _ => Err(u32::try_from(from.long()?).ok()?),
    };
    Some(Some(Attribute { component, dimensions, elements }))
}

fn splats_of(from: &mut In<'_>) -> Option<Found> {
    let place = from.text()?.to_owned();
    let triples = |values: Vec<f32>| values.as_chunks().0.iter().copied().map(Vec3::from_array).collect::<Vec<_>>();
    let cloud = Cloud {
        place,
        positions: triples(from.floats()?),
        rotations: from.floats()?.as_chunks().0.iter().copied().map(Quat::from_array).collect(),
        scales: triples(from.floats()?),
        opacities: from.floats()?,
        degree: from.number()?,
        harmonics: from.floats()?,
        encoding: from.one_of(&[Encoding::Srgb, Encoding::Linear])?,
    };
    let axes = from.one_of(&[Axes::RightUpBack, Axes::RightDownFront])?;
    let left_out = (0..from.number()?).map(|_| from.text().map(str::to_owned)).collect::<Option<_>>()?;
    Some(Found { cloud, axes, left_out })
}
