//! Buffer views: ranges of buffers, unpacked if they are compressed.

use gltf::json;

use crate::document::Document;
use crate::error::Fault;
use crate::meshopt::Packed;

/// The bytes of a buffer view.
pub(crate) struct View<'a> {
    pub(crate) place: String,
    pub(crate) bytes: &'a [u8],
    pub(crate) stride: Option<usize>,
}

impl Document<'_> {
    /// Returns the bytes of a buffer view, after decompression if the view is compressed.
    pub(crate) fn view(&self, index: json::Index<json::buffer::View>, place: &str) -> Result<View<'_>, Fault> {
        let view = self.get(index, place)?;
        let place = format!("/bufferViews/{}", index.value());
        let stride = view.byte_stride.map(|stride| stride.0);
        let cell = &self.unpacked_views[index.value()];
        let bytes = match (cell.get(), Packed::of(self, view, &place)?) {
            (Some(bytes), _) => bytes,
            (None, Some(packed)) => {
                let bytes = packed.unpack(self)?;
                cell.get_or_init(|| bytes)
            }
            (None, None) => {
                let offset = view.byte_offset.unwrap_or_default().0;
                self.range(view.buffer, offset, view.byte_length.0, &place)?
            }
        };
        Ok(View { place, bytes, stride })
    }
}
