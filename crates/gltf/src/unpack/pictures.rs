//! Decodes pictures. PNG, JPEG, WebP and KTX2 hold codes, and Radiance holds linear values.
//!
//! The content decides the format; names and MIME types are often wrong. Colour profiles and
//! orientation tags are ignored, as glTF requires (2.0, section 3.8.3).

use std::io::Cursor;

use image::codecs::hdr::HdrDecoder;
use image::codecs::jpeg::JpegDecoder;
use image::codecs::png::PngDecoder;
use image::{ImageDecoder, ImageError, ImageFormat, ImageReader, ImageResult, Limits};
use lumistack_scene::Pixels;

use super::kinds::{Unpacked, Unsound, Use};
use super::ktx2;
use crate::options::MAX_SIDE;

/// Memory that a decoder may take besides two copies of the picture, for rows and tables.
const DECODER_BYTES: u64 = 64 << 20;

const TEXTURES: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP];
const ENVIRONMENTS: [ImageFormat; 1] = [ImageFormat::Hdr];

/// A function that makes the decoder of a picture.
pub(super) type Opener = for<'a> fn(ImageFormat, &'a [u8], Limits) -> ImageResult<Box<dyn ImageDecoder + 'a>>;

/// Makes the decoder of a picture of any format.
pub(super) fn all(format: ImageFormat, bytes: &[u8], limits: Limits) -> ImageResult<Box<dyn ImageDecoder + '_>> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    Ok(Box::new(reader.into_decoder()?))
}

/// Makes the decoder of a common picture ([`Packed::is_common`](super::Packed::is_common)). Code
/// that calls only this function contains no other decoder.
pub(super) fn common(format: ImageFormat, bytes: &[u8], limits: Limits) -> ImageResult<Box<dyn ImageDecoder + '_>> {
    let bytes = Cursor::new(bytes);
    let mut decoder: Box<dyn ImageDecoder + '_> = match format {
        ImageFormat::Png => Box::new(PngDecoder::with_limits(bytes, limits.clone())?),
        ImageFormat::Jpeg => Box::new(JpegDecoder::new(bytes)?),
        ImageFormat::Hdr => Box::new(HdrDecoder::new(bytes)?),
        other => return Err(ImageError::Unsupported(image::error::ImageFormatHint::Exact(other).into())),
    };
    decoder.set_limits(limits)?;
    Ok(decoder)
}

/// Reads a picture's size from its header.
pub(super) fn size(opener: Opener, usage: Use, bytes: &[u8]) -> Result<Unpacked, Unsound> {
    if usage == Use::Texture && bytes.starts_with(ktx2::MAGIC) {
        let [width, height] = ktx2::size(bytes)?;
        return Ok(Unpacked::Size { width, height, texel_bytes: 4 });
    }
    let (_, decoder) = open(opener, usage, bytes)?;
    let (width, height) = decoder.dimensions();
    let texel_bytes = match usage {
        Use::Environment => size_of::<[f32; 3]>(),
        Use::Texture if is_deep(&decoder) => size_of::<[u16; 4]>(),
        Use::Texture => size_of::<[u8; 4]>(),
    };
    Ok(Unpacked::Size { width, height, texel_bytes })
}

/// Decodes a picture.
pub(super) fn decode(opener: Opener, usage: Use, bytes: &[u8]) -> Result<Unpacked, Unsound> {
    let pixels = match usage {
        Use::Texture if bytes.starts_with(ktx2::MAGIC) => ktx2::decode(bytes),
        Use::Texture => codes(opener, bytes),
        Use::Environment => radiance(opener, bytes),
    };
    pixels.map(Unpacked::Pixels)
}

/// Opens a picture of a format that the use allows, with limits on size and memory.
fn open(opener: Opener, usage: Use, bytes: &[u8]) -> Result<(ImageFormat, Box<dyn ImageDecoder + '_>), Unsound> {
    let formats = match usage {
        Use::Texture => &TEXTURES[..],
        Use::Environment => &ENVIRONMENTS[..],
    };
    let expected = match usage {
        Use::Texture => "a PNG, JPEG, WebP or KTX2 picture",
        Use::Environment => "a Radiance HDR picture",
    };
    let format = match image::guess_format(bytes) {
        Ok(format) if formats.contains(&format) => format,
        Ok(format) => return Err(Unsound::new(expected, name(format))),
        Err(_) => {
            let start = bytes[..bytes.len().min(12)].escape_ascii();
            return Err(Unsound::new(expected, format!("{} bytes that start \"{start}\"", bytes.len())));
        }
    };
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    let mut decoder = opener(format, bytes, limits.clone()).map_err(|error| unreadable(format, error))?;
    let (width, height) = decoder.dimensions();
    if width > MAX_SIDE || height > MAX_SIDE {
        let expected = format!("at most {MAX_SIDE} texels a side");
        return Err(Unsound::new(expected, format!("{width} × {height} texels")));
    }
    // the caller has counted the texels; the decoder may hold them twice, besides rows and tables
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2).saturating_add(DECODER_BYTES));
    decoder.set_limits(limits).map_err(|error| unreadable(format, error))?;
    Ok((format, decoder))
}

/// Returns the name of a format, for messages.
fn name(format: ImageFormat) -> String {
    match format {
        ImageFormat::Hdr => "Radiance HDR".to_owned(),
        ImageFormat::WebP => "WebP".to_owned(),
        other => format!("{other:?}").to_uppercase(),
    }
}

fn unreadable(format: ImageFormat, error: ImageError) -> Unsound {
    Unsound::new(format!("a readable {} picture of at most {MAX_SIDE} texels a side", name(format)), error)
}

/// Returns true if the codes have 16 bits.
fn is_deep(decoder: &impl ImageDecoder) -> bool {
    let color = decoder.color_type();
    color.bytes_per_pixel() / color.channel_count() > 1
}

/// Decodes a picture of codes to four channels, with 16 bits if the file has 16 bits.
///
/// `DynamicImage` also converts pixels. But its code, which also converts between colour spaces,
/// would double the size of the small module of decoders.
fn codes(opener: Opener, bytes: &[u8]) -> Result<Pixels, Unsound> {
    let (format, decoder) = open(opener, Use::Texture, bytes)?;
    let (width, height) = decoder.dimensions();
    let count = width as usize * height as usize;
    let channels = usize::from(decoder.color_type().channel_count());
    let unsound = |error| unreadable(format, error);
    if is_deep(&decoder) {
        let mut values = vec![0; 2 * channels * count];
        decoder.read_image(&mut values).map_err(unsound)?;
        let values: Vec<u16> = values.as_chunks().0.iter().map(|&value| u16::from_ne_bytes(value)).collect();
        return Ok(Pixels::Rgba16(values.chunks_exact(channels).filter_map(|values| rgba(values, u16::MAX)).collect()));
    }
    // A large picture is not held twice. The decoder writes its values into the end of the memory
    // for four-channel texels. Then the values are spread out from the start, and never overwrite a
    // value that is still needed.
    let mut texels = vec![[0; 4]; count];
    let start = (4 - channels) * count;
    decoder.read_image(&mut texels.as_flattened_mut()[start..]).map_err(unsound)?;
    let values = texels.as_flattened_mut();
    for texel in 0..count {
        let at = start + channels * texel;
        let Some(rgba) = rgba(&values[at..at + channels], 255) else { break };
        values[4 * texel..][..4].copy_from_slice(&rgba);
    }
    Ok(Pixels::Rgba8(texels))
}

/// Converts one to four channels to a texel of four channels. Returns `None` for other numbers of
/// channels.
#[inline]
fn rgba<T: Copy>(values: &[T], opaque: T) -> Option<[T; 4]> {
    match *values {
        [grey] => Some([grey, grey, grey, opaque]),
        [grey, alpha] => Some([grey, grey, grey, alpha]),
        [r, g, b] => Some([r, g, b, opaque]),
        [r, g, b, a] => Some([r, g, b, a]),
        _ => None,
    }
}

/// Decodes a Radiance picture to linear values.
fn radiance(opener: Opener, bytes: &[u8]) -> Result<Pixels, Unsound> {
    let (format, decoder) = open(opener, Use::Environment, bytes)?;
    let mut values = vec![0; usize::try_from(decoder.total_bytes()).unwrap_or(usize::MAX)];
    decoder.read_image(&mut values).map_err(|error| unreadable(format, error))?;
    let texel = |texel: &[[u8; 4]; 3]| texel.map(f32::from_ne_bytes);
    Ok(Pixels::RgbF32(values.as_chunks::<4>().0.as_chunks::<3>().0.iter().map(texel).collect()))
}
