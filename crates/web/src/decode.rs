//! Decodes the PNG pictures of previews, which have 8 bits each for red, green and blue.
//!
//! The crate `png` reads every kind of PNG, but it would be a sixth of the module that every
//! visitor loads. This decoder reads only the kind that previews contain; the tests compare it with
//! the crate `png`. It skips optional chunks. It does not check the checksums of the chunks, since
//! the checksum of the compressed stream covers every pixel.

use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;

use crate::preview::File;
use crate::{Error, err};

const SIGNATURE: [u8; 8] = [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n'];
/// Bytes of a pixel.
const PIXEL: usize = 3;

/// Decodes the codes `[row][col][rgb]` of a picture with 8 bits per channel.
pub(crate) fn decode(file: &File, bytes: &[u8]) -> Result<Vec<u8>, Error> {
    let error = |expected: &str, found: String| err(format!("{}: expected {expected}, found {found}", file.path));
    let damaged = |problem: &str| {
        error("a PNG picture", format!("{} bytes of a damaged file, or of another format ({problem})", bytes.len()))
    };
    // Collect the header and the compressed stream.
    let mut rest = bytes.strip_prefix(&SIGNATURE).ok_or_else(|| damaged("the file does not begin as a PNG does"))?;
    let mut stream = Vec::new();
    let mut header = None;
    loop {
        let (kind, data, after) = chunk(rest).ok_or_else(|| damaged("the file is cut short"))?;
        rest = after;
        match kind {
            b"IHDR" => header = Some(data),
            b"IDAT" => stream.extend_from_slice(data),
            b"IEND" => break,
            other if other[0].is_ascii_uppercase() => return Err(damaged("the file has an unknown chunk")),
            _ => {}
        }
    }
    let header: &[u8; 13] =
        header.and_then(|data| data.try_into().ok()).ok_or_else(|| damaged("the file has no header"))?;
    let [cols, rows] = [0, 4].map(|at| u32::from_be_bytes([0, 1, 2, 3].map(|i| header[at + i])) as usize);
    if (rows, cols) != (file.rows, file.cols) {
        return Err(error(&format!("{} × {} pixels", file.cols, file.rows), format!("{cols} × {rows}")));
    }
    // Five values follow the size: bits per channel (8), kind of colours (2 for red, green, blue),
    // compression (0), set of filters (0), and interlacing (0 for none).
    if header[8..] != [8, 2, 0, 0, 0] {
        return Err(error(
            "red, green and blue of 8 bits, not interlaced",
            format!("a PNG with the header values {:?}", &header[8..]),
        ));
    }
    // Unpack the stream and undo the filter of each row.
    let line = PIXEL * cols;
    let filtered = decompress_to_vec_zlib_with_limit(&stream, rows * (1 + line));
    let filtered = filtered.map_err(|_| damaged("the pixels cannot be decompressed"))?;
    if filtered.len() != rows * (1 + line) {
        return Err(damaged("the file has too few pixels"));
    }
    let mut codes = vec![0; rows * line];
    let zeros = vec![0; line];
    for row in 0..rows {
        let (before, here) = codes.split_at_mut(row * line);
        let above = if row == 0 { &zeros[..] } else { &before[(row - 1) * line..] };
        let (filter, coded) = filtered[row * (1 + line)..][..1 + line].split_first().expect("a line has a filter");
        if !unfilter(*filter, coded, above, &mut here[..line]) {
            return Err(damaged("a row has an unknown filter"));
        }
    }
    Ok(codes)
}

/// Splits off the first chunk: returns its kind, its data, and the bytes after it.
fn chunk(bytes: &[u8]) -> Option<(&[u8; 4], &[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (kind, rest) = rest.split_first_chunk::<4>()?;
    let (data, rest) = rest.split_at_checked(u32::from_be_bytes(*length) as usize)?;
    let (_checksum, rest) = rest.split_first_chunk::<4>()?;
    Some((kind, data, rest))
}

/// Undoes the filter of a row (PNG, section 9). The filter predicts every byte from three bytes of
/// neighbouring pixels: left, above, and above left. The prediction is added to the coded byte.
/// Returns false if no filter has this number.
fn unfilter(filter: u8, coded: &[u8], above: &[u8], line: &mut [u8]) -> bool {
    let predict: fn(u8, u8, u8) -> u8 = match filter {
        0 => |_, _, _| 0,
        1 => |left, _, _| left,
        2 => |_, above, _| above,
        3 => |left, above, _| u8::midpoint(left, above),
        4 => paeth,
        _ => return false,
    };
    for i in 0..line.len() {
        let (left, corner) = if i < PIXEL { (0, 0) } else { (line[i - PIXEL], above[i - PIXEL]) };
        line[i] = coded[i].wrapping_add(predict(left, above[i], corner));
    }
    true
}

/// Returns the value among `left`, `above` and `corner` that is nearest to left + above − corner.
fn paeth(left: u8, above: u8, corner: u8) -> u8 {
    let [l, a, c] = [left, above, corner].map(i16::from);
    let (to_left, to_above, to_corner) = ((a - c).abs(), (l - c).abs(), (l + a - 2 * c).abs());
    if to_left <= to_above && to_left <= to_corner {
        left
    } else if to_above <= to_corner {
        above
    } else {
        corner
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;
    use crate::preview::Part;

    /// Pictures of noise, slopes and constants, which the crate `png` wrote with each of its
    /// filters, are decoded to their original pixels.
    #[test]
    fn every_filter_gives_the_pixels_back() {
        let mut random = Stream::new(6);
        for (rows, cols) in [(1, 1), (1, 9), (7, 1), (13, 17)] {
            for kind in 0..3 {
                let codes: Vec<u8> = (0..3 * rows * cols)
                    .map(|i| match kind {
                        0 => (256.0 * random.next_f32()) as u8,
                        1 => (i * 7 % 251) as u8,
                        _ => 200,
                    })
                    .collect();
                for filter in [
                    png::Filter::NoFilter,
                    png::Filter::Sub,
                    png::Filter::Up,
                    png::Filter::Avg,
                    png::Filter::Paeth,
                    png::Filter::Adaptive,
                ] {
                    let mut bytes = Vec::new();
                    let mut encoder = png::Encoder::new(&mut bytes, cols as u32, rows as u32);
                    encoder.set_color(png::ColorType::Rgb);
                    encoder.set_filter(filter);
                    encoder.add_text_chunk("Comment".into(), "stepped over".into()).unwrap();
                    let mut writer = encoder.write_header().unwrap();
                    writer.write_image_data(&codes).unwrap();
                    writer.finish().unwrap();
                    let part = Part::Emission { frame: 0 };
                    let file = File { path: "a.png".into(), part, rows, cols, bytes: 0 };
                    assert_eq!(decode(&file, &bytes).unwrap(), codes, "{rows} × {cols}, {filter:?}");
                    // a file that is cut short at any byte is an error
                    for end in 0..bytes.len() {
                        assert!(decode(&file, &bytes[..end]).is_err(), "{end} of {}", bytes.len());
                    }
                }
            }
        }
    }

    /// A changed byte is an error, or it leaves the decoded pixels unchanged. The second case
    /// occurs in a chunk's checksum and in an optional chunk.
    #[test]
    fn changed_bytes_never_give_another_picture() {
        let codes: Vec<u8> = (0..3 * 40).map(|i| (i * 37 % 256) as u8).collect();
        let bytes = crate::tests::png(5, 8, &codes);
        let file = File { path: "a.png".into(), part: Part::Emission { frame: 0 }, rows: 5, cols: 8, bytes: 0 };
        for at in 0..bytes.len() {
            for flip in [1, 0x20, 0x80] {
                let mut changed = bytes.clone();
                changed[at] ^= flip;
                if let Ok(found) = decode(&file, &changed) {
                    assert_eq!(found, codes, "byte {at}");
                }
            }
        }
    }
}
