//! `EXT_meshopt_compression` and `KHR_meshopt_compression`: buffer views that the file holds
//! compressed.
//!
//! A view's bytes are `count` elements of `byteStride` bytes, compressed by one of three codecs.
//! Attributes may also go through a filter after decompression. The view's own `buffer` is for
//! readers without the extension.

use gltf::json;
use meshoptimizer_rs::codec::{
    decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat, decode_index_buffer,
    decode_index_sequence, decode_vertex_buffer,
};
use meshoptimizer_rs::{Limits, Workspace};

use crate::document::Document;
use crate::error::Fault;
use crate::fields::Fields;

const NAMES: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];

/// Largest ratio of compression: a block of 256 vertices takes at least a byte for every four
/// columns of bytes.
const MAX_RATIO: u64 = 1024;

/// Size of the largest unpacked view, in bytes.
const MAX_VIEW_BYTES: u64 = 2 << 30;

/// A packed view.
pub(crate) struct Packed<'d> {
    fields: Fields<'d>,
    /// `byteLength` of the view.
    unpacked_bytes: u64,
    stride: Option<usize>,
}

impl<'d> Packed<'d> {
    /// The compressed data of the view at `place`; `None` if the view is not compressed.
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
        // the extension's numbers must agree with the view's, and they bound the memory
        let (count, stride, length) = (number("count")?, number("byteStride")?, number("byteLength")?);
        let offset = fields.count("byteOffset")?.unwrap_or_default();
        let source = document.range(fields.needed_index("buffer")?, offset, length, fields.here())?;
        if count.checked_mul(stride) != Some(self.unpacked_bytes) {
            let expected = format!("count × byteStride equal to the view's byteLength, {}", self.unpacked_bytes);
            return Err(Fault::new(fields.place("count"), expected, format!("{count} × {stride}")));
        }
        if self.stride.is_some_and(|own| own as u64 != stride) {
            return Err(Fault::new(fields.place("byteStride"), "the view's byteStride", stride));
        }
        let most = (length.saturating_mul(MAX_RATIO)).min(MAX_VIEW_BYTES);
        if self.unpacked_bytes > most {
            let expected = format!("at most {most} bytes, which {length} packed bytes can hold");
            return Err(Fault::new(fields.place("count"), expected, self.unpacked_bytes));
        }
        let (count, stride) = (count as usize, stride as usize);
        document.spend(&fields.place("count"), count, stride)?;
        // memory for the packed and the unpacked data; limited to the addresses of a 32-bit machine
        let most_held = usize::try_from(2 * MAX_VIEW_BYTES).unwrap_or(usize::MAX);
        let mut workspace = Workspace::new(Limits { max_bytes: most_held, ..Limits::default() });
        let broken = |error| Fault::new(fields.place("buffer"), "a sound meshopt stream", error);
        // decode, then undo the filter
        let mode = fields.text("mode")?;
        let decode = match mode {
            Some("ATTRIBUTES") => decode_vertex_buffer,
            Some("TRIANGLES") => decode_index_buffer,
            Some("INDICES") => decode_index_sequence,
            _ => {
                let place = fields.place("mode");
                let found = document.quote(&place);
                return Err(Fault::new(place, "ATTRIBUTES, TRIANGLES or INDICES", found));
            }
        };
        let mut bytes = decode(count, stride, source, &mut workspace).map_err(broken)?;
        let filter = match fields.text("filter")? {
            None | Some("NONE") => return Ok(bytes),
            Some("OCTAHEDRAL") => decode_filter_oct,
            Some("QUATERNION") => decode_filter_quat,
            Some("EXPONENTIAL") => decode_filter_exp,
            Some("COLOR") => decode_filter_color,
            Some(other) => {
                let expected = "NONE, OCTAHEDRAL, QUATERNION, EXPONENTIAL or COLOR";
                return Err(Fault::new(fields.place("filter"), expected, other));
            }
        };
        if mode != Some("ATTRIBUTES") {
            return Err(Fault::new(
                fields.place("filter"),
                "none for indices",
                document.quote(&fields.place("filter")),
            ));
        }
        filter(&mut bytes, count, stride, &mut workspace).map_err(broken)?;
        Ok(bytes)
    }
}
