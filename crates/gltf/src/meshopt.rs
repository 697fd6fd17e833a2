//! `EXT_meshopt_compression` and `KHR_meshopt_compression`: buffer views that the file holds
//! compressed.
//!
//! A view's bytes are `count` elements of `byteStride` bytes, compressed by one of three codecs.
//! Attributes may also go through a filter after decompression. The view's own `buffer` is for
//! readers without the extension.

use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;
use crate::options::MAX_VIEW_BYTES;
use crate::unpack::{self, Codec, Filter, Unpacked};
use gltf::json;

const NAMES: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];

/// Largest ratio of unpacked to packed bytes. A block of 256 vertices takes at least one packed
/// byte for every four bytes of a vertex. In 256 vertices, four bytes per vertex are 1024 bytes.
const MAX_RATIO: u64 = 1024;

/// A buffer view that is compressed by meshopt.
pub(crate) struct Packed<'d> {
    fields: Fields<'d>,
    /// Size of the view after decompression: its `byteLength`.
    unpacked_bytes: u64,
    stride: Option<usize>,
}

impl<'d> Packed<'d> {
    /// Returns the compressed data of the view at `place`; `None` if the view is not compressed.
    pub(crate) fn of(
        document: &'d Document<'_>,
        view: &json::buffer::View,
        place: &str,
    ) -> Result<Option<Self>, Fault> {
        for name in NAMES {
            if let Some(fields) = Fields::at(document, format!("{place}/extensions/{name}"))? {
                let stride = view.byte_stride.map(|stride| stride.0);
                return Ok(Some(Self { fields, unpacked_bytes: view.byte_length.0, stride }));
            }
        }
        Ok(None)
    }

    pub(crate) fn unpack(&self, document: &Document<'_>) -> Result<Vec<u8>, Fault> {
        document.task.cancel.check()?;
        let fields = &self.fields;
        let number =
            |key: &str| fields.count(key)?.ok_or_else(|| Fault::new(fields.place(key), "a whole number", "nothing"));
        // check that the extension's numbers agree with the view's numbers, which bound the memory
        let (count, stride, length) = (number("count")?, number("byteStride")?, number("byteLength")?);
        let offset = fields.count("byteOffset")?.unwrap_or_default();
        let source = document.range(fields.needed_index("buffer")?, offset, length, fields.here())?;
        if count.checked_mul(stride) != Some(self.unpacked_bytes) {
            let expected = format!("count × byteStride to be {}, the view's byteLength", self.unpacked_bytes);
            return Err(Fault::new(fields.place("count"), expected, format!("{count} × {stride}")));
        }
        if let Some(own) = self.stride.filter(|&own| own as u64 != stride) {
            return Err(Fault::new(fields.place("byteStride"), format!("{own}, the view's byteStride"), stride));
        }
        let most = (length.saturating_mul(MAX_RATIO)).min(MAX_VIEW_BYTES);
        if self.unpacked_bytes > most {
            let expected = format!(
                "at most {most} unpacked bytes ({MAX_RATIO} times the {length} packed bytes, and no more than {MAX_VIEW_BYTES})"
            );
            return Err(Fault::new(fields.place("count"), expected, self.unpacked_bytes));
        }
        let (count, stride) = (count as usize, stride as usize);
        document.spend(&fields.place("count"), count, stride)?;
        // read the codec and the filter, then decompress
        let mode = fields.text("mode")?;
        let codec = match mode {
            Some("ATTRIBUTES") => Codec::Attributes,
            Some("TRIANGLES") => Codec::Triangles,
            Some("INDICES") => Codec::Indices,
            _ => {
                let place = fields.place("mode");
                let found = document.quote(&place);
                return Err(Fault::new(place, "ATTRIBUTES, TRIANGLES or INDICES", found));
            }
        };
        let filter = match fields.text("filter")? {
            None | Some("NONE") => Filter::None,
            Some("OCTAHEDRAL") => Filter::Octahedral,
            Some("QUATERNION") => Filter::Quaternion,
            Some("EXPONENTIAL") => Filter::Exponential,
            Some("COLOR") => Filter::Color,
            Some(other) => {
                let expected = "NONE, OCTAHEDRAL, QUATERNION, EXPONENTIAL or COLOR";
                return Err(Fault::new(fields.place("filter"), expected, other));
            }
        };
        if filter != Filter::None && codec != Codec::Attributes {
            return Err(Fault::new(
                fields.place("filter"),
                "no filter in the modes TRIANGLES and INDICES",
                document.quote(&fields.place("filter")),
            ));
        }
        let packed = unpack::Packed::Meshopt { bytes: source, codec, filter, count, stride };
        document.unpack(&fields.place("buffer"), &packed, |unpacked| match unpacked {
            Unpacked::Bytes(bytes) => Some(bytes),
            _ => None,
        })
    }
}
