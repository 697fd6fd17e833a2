//! Accessors: typed elements in buffer views, dense or sparse, with every bound checked before the
//! first byte is read.
//!
//! Element i starts at byte `offset + stride · i` of its view. Integers become floats of the same
//! value. With `normalized`, an unsigned integer c of n bits becomes f = c / (2ⁿ − 1). A signed one
//! becomes f = max(c / (2ⁿ⁻¹ − 1), −1) (glTF 2.0, sections 3.6.2 and 3.11).

use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;

use crate::document::Document;
use crate::draco;
use crate::error::Fault;

/// Largest number of elements of an accessor without a buffer view. Such elements are zeros and
/// take no space in the file, so a small file could require any amount of memory.
const MAX_IMPLICIT_COUNT: u64 = 1 << 24;

/// The types and component types that an accessor may have where it is used.
pub(crate) struct Format {
    pub(crate) types: &'static [Type],
    pub(crate) components: &'static [ComponentType],
    /// The allowed types and component types by their names in glTF, for messages.
    pub(crate) text: &'static str,
}

/// Returns the name of a type in glTF.
fn type_name(kind: Type) -> &'static str {
    match kind {
        Type::Scalar => "SCALAR",
        Type::Vec2 => "VEC2",
        Type::Vec3 => "VEC3",
        Type::Vec4 => "VEC4",
        Type::Mat2 => "MAT2",
        Type::Mat3 => "MAT3",
        Type::Mat4 => "MAT4",
    }
}

/// Returns the name of a component type in glTF.
fn component_name(component: ComponentType) -> &'static str {
    match component {
        ComponentType::I8 => "BYTE",
        ComponentType::U8 => "UNSIGNED_BYTE",
        ComponentType::I16 => "SHORT",
        ComponentType::U16 => "UNSIGNED_SHORT",
        ComponentType::U32 => "UNSIGNED_INT",
        ComponentType::F32 => "FLOAT",
    }
}

/// An accessor whose type, count and bounds have been checked.
pub(crate) struct Accessor<'a> {
    /// JSON pointer to the index that refers to the accessor.
    used_at: String,
    pub(crate) count: usize,
    pub(crate) dimensions: usize,
    component: ComponentType,
    normalized: bool,
    dense: Option<Elements<'a>>,
    sparse: Option<Sparse<'a>>,
}

/// The elements of an accessor that are read: all, or the elements with these indices in this
/// order.
pub(crate) enum Selection {
    All,
    Some(Vec<u32>),
}

struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

struct Sparse<'a> {
    /// Indices of the elements that `values` replaces, strictly increasing.
    indices: Vec<u32>,
    values: Elements<'a>,
}

impl<'a> Accessor<'a> {
    /// Checks the accessor that the index at `used_at` refers to.
    pub(crate) fn open(
        document: &'a Document<'_>,
        index: json::Index<json::Accessor>,
        used_at: &str,
        format: &Format,
    ) -> Result<Self, Fault> {
        // check that the accessor's type fits its use
        let accessor = document.get(index, used_at)?;
        let place = format!("/accessors/{}", index.value());
        let invalid = |field: &str| {
            let place = format!("{place}/{field}");
            let found = document.quote(&place);
            Fault::new(place, "a value that glTF 2.0 defines", found)
        };
        let Checked::Valid(component) = accessor.component_type else { return Err(invalid("componentType")) };
        let Checked::Valid(kind) = accessor.type_ else { return Err(invalid("type")) };
        let component = component.0;
        if !(format.types.contains(&kind) && format.components.contains(&component)) {
            return Err(Fault::new(
                used_at,
                format.text,
                format!("{} of {} ({place})", type_name(kind), component_name(component)),
            ));
        }
        let count = accessor.count.0;
        let most = if accessor.buffer_view.is_none() { MAX_IMPLICIT_COUNT } else { u64::from(u32::MAX) };
        if count == 0 || count > most {
            return Err(Fault::new(format!("{place}/count"), format!("a count from 1 to {most}"), count));
        }
        let count = count as usize;
        // Open the dense elements, and the sparse elements that replace some of them.
        let dimensions = kind.multiplicity();
        let size = component.size() * dimensions;
        // allow a stride only for vectors, since only vertex attributes may be interleaved
        let may_stride = matches!(kind, Type::Vec2 | Type::Vec3 | Type::Vec4);
        let offset = accessor.byte_offset.unwrap_or_default().0;
        let dense = match accessor.buffer_view {
            Some(view) => {
                let count_place = format!("{place}/count");
                Some(Elements::open(document, view, &place, &count_place, offset, count, size, may_stride)?)
            }
            None => None,
        };
        let sparse = match &accessor.sparse {
            Some(sparse) => Some(Sparse::open(document, sparse, &place, count, size)?),
            None => None,
        };
        let (used_at, normalized) = (used_at.to_owned(), accessor.normalized);
        Ok(Self { used_at, count, dimensions, component, normalized, dense, sparse })
    }

    /// Returns the elements from a Draco stream, which replace the elements of an accessor. The
    /// index at `used_at` refers to that accessor.
    pub(crate) fn decoded(
        document: &'a Document<'_>,
        index: json::Index<json::Accessor>,
        used_at: &str,
        format: &Format,
        source: &'a draco::Attribute,
    ) -> Result<Self, Fault> {
        let normalized = document.get(index, used_at)?.normalized;
        let draco::Attribute { component, dimensions, ref bytes } = *source;
        let known = format.types.iter().any(|kind| kind.multiplicity() == dimensions);
        if !(known && format.components.contains(&component)) {
            let found = format!("{dimensions} components of {} in the Draco stream", component_name(component));
            return Err(Fault::new(used_at, format.text, found));
        }
        let size = dimensions * component.size();
        let count = bytes.len() / size;
        let dense = Some(Elements { bytes, stride: size, size });
        Ok(Self { used_at: used_at.to_owned(), count, dimensions, component, normalized, dense, sparse: None })
    }

    /// Returns the elements as floats. Components that the accessor lacks are set to `fill`, and
    /// components past `N` are left out.
    pub(crate) fn floats<const N: usize>(
        &self,
        document: &Document<'_>,
        selection: &Selection,
        fill: f32,
    ) -> Result<Vec<[f32; N]>, Fault> {
        document.spend(&self.used_at, self.selected(selection), N * size_of::<f32>())?;
        let size = self.component.size();
        let mut out = Vec::with_capacity(self.selected(selection));
        self.for_each(selection, |bytes| {
            let mut element = [fill; N];
            for (value, component) in element[..N.min(self.dimensions)].iter_mut().zip(bytes.chunks_exact(size)) {
                *value = self.float(component);
            }
            out.push(element);
        });
        Ok(out)
    }

    /// Returns the same as [`floats`](Self::floats), but refuses NaN and infinity.
    pub(crate) fn finite<const N: usize>(
        &self,
        document: &Document<'_>,
        selection: &Selection,
        fill: f32,
    ) -> Result<Vec<[f32; N]>, Fault> {
        let elements = self.floats::<N>(document, selection, fill)?;
        match elements.iter().position(|element| !element.iter().all(|value| value.is_finite())) {
            None => Ok(elements),
            Some(at) => {
                let number = match selection {
                    Selection::All => at,
                    Selection::Some(indices) => indices[at] as usize,
                };
                let found = format!("{:?} in element {number}", elements[at]);
                Err(Fault::new(&self.used_at, "finite numbers", found))
            }
        }
    }

    /// Returns the elements as integers. The component type must be unsigned.
    pub(crate) fn integers<const N: usize>(
        &self,
        document: &Document<'_>,
        selection: &Selection,
    ) -> Result<Vec<[u32; N]>, Fault> {
        document.spend(&self.used_at, self.selected(selection), N * size_of::<u32>())?;
        let size = self.component.size();
        let mut out = Vec::with_capacity(self.selected(selection));
        self.for_each(selection, |bytes| {
            let mut element = [0; N];
            for (value, component) in element.iter_mut().zip(bytes.chunks_exact(size)) {
                *value = unsigned(component);
            }
            out.push(element);
        });
        Ok(out)
    }

    fn selected(&self, selection: &Selection) -> usize {
        match selection {
            Selection::All => self.count,
            Selection::Some(indices) => indices.len(),
        }
    }

    /// Calls `visit` with the bytes of every selected element, which are zeros if the accessor has
    /// no data.
    fn for_each(&self, selection: &Selection, mut visit: impl FnMut(&[u8])) {
        const ZEROS: [u8; 64] = [0; 64];
        let zeros = &ZEROS[..self.component.size() * self.dimensions];
        let element = |i: usize| {
            if let Some(sparse) = &self.sparse
                && let Ok(at) = sparse.indices.binary_search(&(i as u32))
            {
                return sparse.values.get(at);
            }
            self.dense.as_ref().map_or(zeros, |dense| dense.get(i))
        };
        match selection {
            Selection::All => (0..self.count).for_each(|i| visit(element(i))),
            Selection::Some(indices) => indices.iter().for_each(|&i| visit(element(i as usize))),
        }
    }

    fn float(&self, bytes: &[u8]) -> f32 {
        let (value, largest) = match (self.component, bytes) {
            (ComponentType::I8, &[a]) => (f32::from(a as i8), 127.0),
            (ComponentType::U8, &[a]) => (f32::from(a), 255.0),
            (ComponentType::I16, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32767.0),
            (ComponentType::U16, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65535.0),
            (ComponentType::F32, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
            _ => (unsigned(bytes) as f32, u32::MAX as f32),
        };
        if self.normalized { (value / largest).max(-1.0) } else { value }
    }

    /// Treats integers as normalized. glTF requires `normalized` for all integers for which this
    /// function is called, but some writers do not set it.
    pub(crate) fn assume_normalized(mut self) -> Self {
        self.normalized = true;
        self
    }
}

impl<'a> Elements<'a> {
    /// Opens `count` elements of `size` bytes, from byte `offset` of a view. `place` is the object
    /// with the fields `bufferView` and `byteOffset`.
    fn open(
        document: &'a Document<'_>,
        view: json::Index<json::buffer::View>,
        place: &str,
        count_place: &str,
        offset: u64,
        count: usize,
        size: usize,
        may_stride: bool,
    ) -> Result<Self, Fault> {
        let view = document.view(view, &format!("{place}/bufferView"))?;
        let length = view.bytes.len();
        // the stride is the distance from the start of one element to the start of the next
        let mut stride = view.stride.unwrap_or(size);
        if stride != size && !may_stride {
            // glTF allows no stride here. Like most readers, this reader applies a stride above the
            // element's size if the elements fit into the view. Any other stride has no effect.
            let room = (length as u64).saturating_sub(offset);
            let needed = (count as u64 - 1).saturating_mul(stride as u64).saturating_add(size as u64);
            let followed = stride > size && needed <= room;
            let message = if followed {
                format!(
                    "expected no stride, which glTF allows only for attributes of vertices, found {stride}; {place} is \
                     read with the stride {stride}"
                )
            } else {
                format!(
                    "expected no stride, which glTF allows only for attributes of vertices, found {stride}; {place} is \
                     read without a stride"
                )
            };
            document.task.warn(format!("{}/byteStride", view.place), message);
            stride = if followed { stride } else { size };
        }
        if stride < size {
            let expected = format!("at least {size} bytes, the size of an element of {place}");
            return Err(Fault::new(format!("{}/byteStride", view.place), expected, stride));
        }
        // check that all elements are within the view
        let Some(bytes) = usize::try_from(offset).ok().and_then(|offset| view.bytes.get(offset..)) else {
            let expected = format!("at most {length}, the length of {} in bytes", view.place);
            return Err(Fault::new(format!("{place}/byteOffset"), expected, offset));
        };
        let most = if bytes.len() < size { 0 } else { (bytes.len() - size) / stride + 1 };
        if count > most {
            let expected = format!("at most {most}, the number of elements for which {} has room", view.place);
            return Err(Fault::new(count_place, expected, count));
        }
        Ok(Self { bytes, stride, size })
    }

    fn get(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..][..self.size]
    }
}

impl<'a> Sparse<'a> {
    fn open(
        document: &'a Document<'_>,
        sparse: &json::accessor::sparse::Sparse,
        accessor_place: &str,
        accessor_count: usize,
        size: usize,
    ) -> Result<Self, Fault> {
        let place = format!("{accessor_place}/sparse");
        let (indices, values) = (&sparse.indices, &sparse.values);
        let Checked::Valid(component) = indices.component_type else {
            let place = format!("{place}/indices/componentType");
            return Err(Fault::new(&place, "5121, 5123 or 5125", document.quote(&place)));
        };
        let Some(count) = usize::try_from(sparse.count.0).ok().filter(|&count| count >= 1 && count <= accessor_count)
        else {
            let expected = format!("a count from 1 to {accessor_count}, the accessor's count");
            return Err(Fault::new(format!("{place}/count"), expected, sparse.count.0));
        };
        // read the indices and the new values, which are in separate views
        let elements = |view, part: &str, offset: u64, size| {
            let (part, count_place) = (format!("{place}/{part}"), format!("{place}/count"));
            Elements::open(document, view, &part, &count_place, offset, count, size, false)
        };
        let index_size = component.0.size();
        let raw = elements(indices.buffer_view, "indices", indices.byte_offset.0, index_size)?;
        let values = elements(values.buffer_view, "values", values.byte_offset.0, size)?;
        document.spend(&place, count, size_of::<u32>())?;
        // the indices must increase, so only the last one is compared with the number of elements
        let indices: Vec<u32> = (0..count).map(|i| unsigned(raw.get(i))).collect();
        let place = format!("{place}/indices");
        if let Some(at) = indices.windows(2).position(|pair| pair[0] >= pair[1]) {
            let found = format!("{} before {}", indices[at], indices[at + 1]);
            return Err(Fault::new(place, "indices that increase", found));
        }
        match indices.last() {
            Some(&last) if last as usize >= accessor_count => {
                Err(Fault::new(place, format!("indices below {accessor_count}"), last))
            }
            _ => Ok(Self { indices, values }),
        }
    }
}

/// Reads a little-endian integer of one, two or four bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, &byte| (value << 8) | u32::from(byte))
}
