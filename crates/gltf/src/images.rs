//! Pictures: textures' images, each decoded once, and the environment map.
//!
//! The content decides the format; names and MIME types are often wrong. Colour profiles and orientation tags are ignored, as
//! glTF asks for (2.0, section 3.8.3).

use std::collections::HashMap;
use std::io::Cursor;

use gltf::json;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use lumistack_scene::{Image, Pixels};

use crate::document::Document;
use crate::error::Fault;

/// Largest side of a picture in texels.
const MAX_SIDE: u32 = 1 << 15;

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
        let (decoded, name) = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let place = format!("{place}/uri");
                let name = if uri.starts_with("data:") { None } else { Some(uri) };
                (decode(document, &document.read_uri(uri, &place)?, &place, &TEXTURE_FORMATS)?, name)
            }
            (None, Some(view)) => {
                let place = format!("{place}/bufferView");
                (decode(document, document.view(view, &place)?.bytes, &place, &TEXTURE_FORMATS)?, None)
            }
            (None, None) => return Err(Fault::new(place, "a uri or a bufferView", "neither")),
        };
        let name = name.or(image.name.as_ref()).map_or(place.clone(), |name| format!("{place} ({name})"));
        self.position.insert(index.value(), self.decoded.len());
        self.decoded.push(codes(name, decoded));
        Ok(self.decoded.len() - 1)
    }

    /// Reads the environment map at a URI and returns its position.
    pub(crate) fn environment(&mut self, document: &Document<'_>, uri: &str, place: &str) -> Result<usize, Fault> {
        let decoded = decode(document, &document.read_uri(uri, place)?, place, &[ImageFormat::Hdr])?;
        let (width, height) = (decoded.width() as usize, decoded.height() as usize);
        let texels = decoded.into_rgb32f().pixels().map(|texel| texel.0).collect();
        self.decoded.push(Image { name: place.to_owned(), width, height, pixels: Pixels::RgbF32(texels) });
        Ok(self.decoded.len() - 1)
    }
}

const TEXTURE_FORMATS: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP];

fn decode(
    document: &Document<'_>,
    bytes: &[u8],
    place: &str,
    formats: &'static [ImageFormat],
) -> Result<DynamicImage, Fault> {
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
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_IMAGE_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    let fault =
        |error| Fault::new(place, format!("a readable {format:?} picture of at most {MAX_SIDE} texels a side"), error);
    let decoder = reader.into_decoder().map_err(fault)?;
    let (width, height) = decoder.dimensions();
    let total = decoder.total_bytes();
    if total > MAX_IMAGE_BYTES || width > MAX_SIDE || height > MAX_SIDE {
        let expected = format!("at most {MAX_SIDE} texels a side and {} GiB", MAX_IMAGE_BYTES >> 30);
        return Err(Fault::new(place, expected, format!("{width} × {height} texels of {:?}", decoder.color_type())));
    }
    let channel_bytes = decoder.color_type().bytes_per_pixel() / decoder.color_type().channel_count();
    let texel_bytes = 4 * usize::from(channel_bytes);
    document.spend(place, width as usize * height as usize, texel_bytes)?;
    DynamicImage::from_decoder(decoder).map_err(fault)
}

/// Codes with four channels; 16 bits where the file has them.
fn codes(name: String, decoded: DynamicImage) -> Image {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let pixels = match decoded {
        DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_) => Pixels::Rgba16(decoded.into_rgba16().pixels().map(|texel| texel.0).collect()),
        _ => Pixels::Rgba8(decoded.into_rgba8().pixels().map(|texel| texel.0).collect()),
    };
    Image { name, width, height, pixels }
}
