//! Pictures: textures' images, each decoded once, and the environment map.
//!
//! The content decides the format; names and MIME types are often wrong. Colour profiles and orientation tags are ignored, as
//! glTF asks for (2.0, section 3.8.3).

use std::collections::HashMap;
use std::io::Cursor;

use gltf::json;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use lumistack_scene::{Image, Pixels};

use crate::document::Document;
use crate::error::{Fault, contained};
use crate::ktx2;

/// Largest side of a picture in texels.
pub(crate) const MAX_SIDE: u32 = 1 << 15;

/// Memory that decoding one picture may take.
const MAX_IMAGE_BYTES: u64 = 2 << 30;

/// Decoded images in the order of first use.
#[derive(Default)]
pub(crate) struct Images {
    pub(crate) decoded: Vec<Image>,
    /// From the file's image number to a position in `decoded`.
    position: HashMap<usize, usize>,
}

impl Images {
    /// Position of an image of the file, which is decoded on first use.
    pub(crate) fn texture(
        &mut self,
        document: &Document<'_>,
        index: json::Index<json::Image>,
        used_at: &str,
    ) -> Result<usize, Fault> {
        let image = document.get(index, used_at)?;
        if let Some(&position) = self.position.get(&index.value()) {
            return Ok(position);
        }
        let place = format!("/images/{}", index.value());
        let owned;
        let (bytes, place, uri) = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let place = format!("{place}/uri");
                owned = document.read_uri(uri, &place)?;
                (owned.as_slice(), place, Some(uri).filter(|uri| !uri.starts_with("data:")))
            }
            (None, Some(view)) => {
                let place = format!("{place}/bufferView");
                (document.view(view, &place)?.bytes, place, None)
            }
            (None, None) => return Err(Fault::new(place, "a uri or a bufferView", "neither")),
        };
        let number = index.value();
        let name = uri.or(image.name.as_ref());
        let name = name.map_or(format!("/images/{number}"), |name| format!("/images/{number} ({name})"));
        let decoded = contained(&place, "a sound picture", || match bytes.starts_with(ktx2::MAGIC) {
            true => ktx2::decode(document, bytes, &place, name),
            false => codes(document, bytes, &place, name),
        })?;
        self.position.insert(number, self.decoded.len());
        self.decoded.push(decoded);
        Ok(self.decoded.len() - 1)
    }

    /// Reads the environment map at a URI and returns its position.
    pub(crate) fn environment(&mut self, document: &Document<'_>, uri: &str, place: &str) -> Result<usize, Fault> {
        let bytes = document.read_uri(uri, place)?;
        let (format, decoder) = open(document, &bytes, place, &[ImageFormat::Hdr])?;
        let (width, height) = decoder.dimensions();
        let (width, height) = (width as usize, height as usize);
        document.spend(place, width * height, size_of::<[f32; 3]>())?;
        let decoded = DynamicImage::from_decoder(decoder).map_err(|error| unreadable(place, format, error))?;
        let values = decoded.into_rgb32f().into_raw();
        let texels = values.as_chunks::<3>().0.to_vec();
        self.decoded.push(Image { name: place.to_owned(), width, height, pixels: Pixels::RgbF32(texels) });
        Ok(self.decoded.len() - 1)
    }
}

const TEXTURE_FORMATS: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP];

/// Opens a picture of one of the formats, within the limits.
fn open<'b>(
    document: &Document<'_>,
    bytes: &'b [u8],
    place: &str,
    formats: &'static [ImageFormat],
) -> Result<(ImageFormat, impl ImageDecoder + 'b), Fault> {
    document.task.cancel.check()?;
    let names: Vec<String> = formats.iter().map(|format| format!("{format:?}")).collect();
    let expected = format!("a picture in the format {}", names.join(" or "));
    let format = match image::guess_format(bytes) {
        Ok(format) if formats.contains(&format) => format,
        Ok(format) => return Err(Fault::new(place, expected, format!("{format:?}"))),
        Err(_) => {
            let start = bytes[..bytes.len().min(12)].escape_ascii();
            return Err(Fault::new(place, expected, format!("{} bytes that start \"{start}\"", bytes.len())));
        }
    };
    let most_bytes = document.affordable_bytes().min(MAX_IMAGE_BYTES);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(most_bytes);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|error| unreadable(place, format, error))?;
    let (width, height) = decoder.dimensions();
    if decoder.total_bytes() > most_bytes || width > MAX_SIDE || height > MAX_SIDE {
        let expected = format!("at most {MAX_SIDE} texels a side and {} MiB", most_bytes >> 20);
        return Err(Fault::new(place, expected, format!("{width} × {height} texels of {:?}", decoder.color_type())));
    }
    Ok((format, decoder))
}

fn unreadable(place: &str, format: ImageFormat, error: ImageError) -> Fault {
    Fault::new(place, format!("a readable {format:?} picture of at most {MAX_SIDE} texels a side"), error)
}

/// Codes with four channels; 16 bits where the file has them.
fn codes(document: &Document<'_>, bytes: &[u8], place: &str, name: String) -> Result<Image, Fault> {
    let (format, decoder) = open(document, bytes, place, &TEXTURE_FORMATS)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    let color = decoder.color_type();
    let is_deep = color.bytes_per_pixel() / color.channel_count() > 1;
    document.spend(place, width * height, if is_deep { 8 } else { 4 })?;
    let fault = |error| unreadable(place, format, error);
    let pixels = if is_deep {
        let decoded = DynamicImage::from_decoder(decoder).map_err(fault)?;
        Pixels::Rgba16(decoded.into_rgba16().into_raw().as_chunks::<4>().0.to_vec())
    } else {
        // large pictures are not held twice: decoded at the end of their texels, then spread out from the start, which never catches up
        let (count, channels) = (width * height, usize::from(color.channel_count()));
        let mut texels = vec![[0; 4]; count];
        let start = (4 - channels) * count;
        decoder.read_image(&mut texels.as_flattened_mut()[start..]).map_err(fault)?;
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
        Pixels::Rgba8(texels)
    };
    Ok(Image { name, width, height, pixels })
}
