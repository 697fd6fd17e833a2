//! Decodes pictures. PNG, JPEG, WebP and KTX2 hold codes, and Radiance holds linear values.
//!
//! The content decides the format; names and MIME types are often wrong. Colour profiles and
//! orientation tags are ignored, as glTF requires (2.0, section 3.8.3).

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use lumistack_scene::Pixels;

use super::kinds::{Unpacked, Unsound, Use};
use super::ktx2;
use crate::options::MAX_SIDE;

/// Memory that a decoder may take besides the picture itself: rows, tables, and a copy in another
/// format.
const DECODER_BYTES: u64 = 64 << 20;

const TEXTURES: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP];
const ENVIRONMENTS: [ImageFormat; 1] = [ImageFormat::Hdr];

/// Reads a picture's size from its header.
pub(super) fn size(usage: Use, bytes: &[u8]) -> Result<Unpacked, Unsound> {
    if usage == Use::Texture && bytes.starts_with(ktx2::MAGIC) {
        let [width, height] = ktx2::size(bytes)?;
        return Ok(Unpacked::Size { width, height, texel_bytes: 4 });
    }
    let (_, decoder) = open(usage, bytes)?;
    let (width, height) = decoder.dimensions();
    let texel_bytes = match usage {
        Use::Environment => size_of::<[f32; 3]>(),
        Use::Texture if is_deep(&decoder) => size_of::<[u16; 4]>(),
        Use::Texture => size_of::<[u8; 4]>(),
    };
    Ok(Unpacked::Size { width, height, texel_bytes })
}

/// Decodes a picture.
pub(super) fn decode(usage: Use, bytes: &[u8]) -> Result<Unpacked, Unsound> {
    let pixels = match usage {
        Use::Texture if bytes.starts_with(ktx2::MAGIC) => ktx2::decode(bytes),
        Use::Texture => codes(bytes),
        Use::Environment => radiance(bytes),
    };
    pixels.map(Unpacked::Pixels)
}

/// Opens a picture of a format that the use allows, with limits on size and memory.
fn open(usage: Use, bytes: &[u8]) -> Result<(ImageFormat, impl ImageDecoder + '_), Unsound> {
    let formats = match usage {
        Use::Texture => &TEXTURES[..],
        Use::Environment => &ENVIRONMENTS[..],
    };
    let names: Vec<String> = formats.iter().map(|format| format!("{format:?}")).collect();
    let expected = format!("a picture in the format {}", names.join(" or "));
    let format = match image::guess_format(bytes) {
        Ok(format) if formats.contains(&format) => format,
        Ok(format) => return Err(Unsound::new(expected, format!("{format:?}"))),
        Err(_) => {
            let start = bytes[..bytes.len().min(12)].escape_ascii();
            return Err(Unsound::new(expected, format!("{} bytes that start \"{start}\"", bytes.len())));
        }
    };
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits.clone());
    let mut decoder = reader.into_decoder().map_err(|error| unreadable(format, error))?;
    let (width, height) = decoder.dimensions();
    if width > MAX_SIDE || height > MAX_SIDE {
        let expected = format!("at most {MAX_SIDE} texels a side");
        return Err(Unsound::new(expected, format!("{width} × {height} texels of {:?}", decoder.color_type())));
    }
    // the caller has counted the texels; the decoder may hold them twice, besides rows and tables
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2).saturating_add(DECODER_BYTES));
    decoder.set_limits(limits).map_err(|error| unreadable(format, error))?;
    Ok((format, decoder))
}

fn unreadable(format: ImageFormat, error: ImageError) -> Unsound {
    Unsound::new(format!("a readable {format:?} picture of at most {MAX_SIDE} texels a side"), error)
}

/// Returns true if the codes have 16 bits.
fn is_deep(decoder: &impl ImageDecoder) -> bool {
    let color = decoder.color_type();
    color.bytes_per_pixel() / color.channel_count() > 1
}

/// Decodes a picture of codes to four channels, with 16 bits if the file has 16 bits.
fn codes(bytes: &[u8]) -> Result<Pixels, Unsound> {
    let (format, decoder) = open(Use::Texture, bytes)?;
    let (width, height) = decoder.dimensions();
    let unsound = |error| unreadable(format, error);
    if is_deep(&decoder) {
        let decoded = DynamicImage::from_decoder(decoder).map_err(unsound)?;
        return Ok(Pixels::Rgba16(decoded.into_rgba16().into_raw().as_chunks::<4>().0.to_vec()));
    }
    // A large picture is not held twice. The decoder writes its values into the end of the memory
    // for four-channel texels. Then the values are spread out from the start, and never overwrite a
    // value that is still needed.
    let (count, channels) = (width as usize * height as usize, usize::from(decoder.color_type().channel_count()));
    let mut texels = vec![[0; 4]; count];
    let start = (4 - channels) * count;
    decoder.read_image(&mut texels.as_flattened_mut()[start..]).map_err(unsound)?;
    let values = texels.as_flattened_mut();
    for texel in 0..count {
        let at = start + channels * texel;
        let rgba = match values[at..at + channels] {
            [grey] => [grey, grey, grey, 255],
            [grey, alpha] => [grey, grey, grey, alpha],
            [r, g, b] => [r, g, b, 255],
            _ => break,
        };
        values[4 * texel..][..4].copy_from_slice(&rgba);
    }
    Ok(Pixels::Rgba8(texels))
}

/// Decodes a Radiance picture to linear values.
fn radiance(bytes: &[u8]) -> Result<Pixels, Unsound> {
    let (format, decoder) = open(Use::Environment, bytes)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(|error| unreadable(format, error))?;
    Ok(Pixels::RgbF32(decoded.into_rgb32f().into_raw().as_chunks::<3>().0.to_vec()))
}
