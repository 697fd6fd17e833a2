//! Meshopt streams.

use meshoptimizer_rs::codec::{
    decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat, decode_index_buffer,
    decode_index_sequence, decode_vertex_buffer,
};
use meshoptimizer_rs::{Limits, Workspace};

use super::kinds::{Codec, Filter, Unpacked, Unsound};
use crate::options::MAX_VIEW_BYTES;

/// Decodes a stream, then undoes its filter.
pub(super) fn decode(
    bytes: &[u8],
    codec: Codec,
    filter: Filter,
    count: usize,
    stride: usize,
) -> Result<Unpacked, Unsound> {
    // Allow memory for the packed and the unpacked bytes. On 32 bits their sum exceeds the address
    // space, so the limit is the address space.
    let most_held = usize::try_from(2 * MAX_VIEW_BYTES).unwrap_or(usize::MAX);
    let mut workspace = Workspace::new(Limits { max_bytes: most_held, ..Limits::default() });
    let broken = |error| Unsound::new("a sound meshopt stream", error);
    let decode = match codec {
        Codec::Attributes => decode_vertex_buffer,
        Codec::Triangles => decode_index_buffer,
        Codec::Indices => decode_index_sequence,
    };
    let mut bytes = decode(count, stride, bytes, &mut workspace).map_err(broken)?;
    let filter = match filter {
        Filter::None => return Ok(Unpacked::Bytes(bytes)),
        Filter::Octahedral => decode_filter_oct,
        Filter::Quaternion => decode_filter_quat,
        Filter::Exponential => decode_filter_exp,
        Filter::Color => decode_filter_color,
    };
    filter(&mut bytes, count, stride, &mut workspace).map_err(broken)?;
    Ok(Unpacked::Bytes(bytes))
}
