//! Pictures: the images of textures, each read and decoded once, and the environment map.
//!
//! The content decides the format; names and MIME types are often wrong. Colour profiles and
//! orientation tags are ignored, as glTF requires (2.0, section 3.8.3).

use std::collections::HashMap;
use std::io::Cursor;

use gltf::json;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use lumistack_scene::{Image, Pixels};

use crate::document::Document;
use crate::error::{Fault, contained};
use crate::ktx2;
use crate::options::MAX_SIDE;

/// Memory that a decoder may take in addition to the picture itself, for rows, tables, and a copy
/// in another format.
const DECODER_BYTES: u64 = 64 << 20;

/// Images in the order of first use. Their headers are read at first use, and all pictures are
/// decoded at the end. So a scene whose pictures are too large in sum is refused before the first
/// is decoded.
#[derive(Default)]
pub(crate) struct Images {
    /// Sizes of the images; also their pixels, after [`decode`](Self::decode).
    pub(crate) decoded: Vec<Image>,
    /// Index into `decoded`, by the image's index in the file.
    position: HashMap<usize, usize>,
    /// Sources of the images without pixels, in the order of `decoded`.
    waiting: Vec<Waiting>,
}

/// The source of an image.
enum Waiting {
    /// A picture file.
    Picture { content: Content, place: String, format: Format },
    /// Roughness, 1 − `factor` · alpha of the image `from` in `decoded`, whose alpha is glossiness.
    Roughness { from: usize, factor: f32 },
}

/// The source of a picture's bytes.
enum Content {
    Own(Vec<u8>),
    View(json::Index<json::buffer::View>),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Ktx2,
    Codes,
    Hdr,
}

impl Images {
    /// Index of an image of the file, whose header is read at first use.
    pub(crate) fn texture(
        &mut self,
        document: &Document<'_>,
        index: json::Index<json::Image>,
        used_at: &str,
    ) -> Result<usize, Fault> {
        document.get(index, used_at)?;
        let number = document.first_image[index.value()];
        if let Some(&position) = self.position.get(&number) {
            return Ok(position);
        }
        let image = &document.root.images[number];
        let place = format!("/images/{number}");
        let (content, place, uri) = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let place = format!("{place}/uri");
                let bytes = read(document, uri, &place)?;
                (Content::Own(bytes), place, Some(uri).filter(|uri| !uri.starts_with("data:")))
            }
            (None, Some(view)) => (Content::View(view), format!("{place}/bufferView"), None),
            (None, None) => return Err(Fault::new(place, "a uri or a bufferView", "neither")),
        };
        let name = uri.or(image.name.as_ref());
        let name = name.map_or(format!("/images/{number}"), |name| format!("/images/{number} ({name})"));
        let bytes = content.bytes(document, &place)?;
        let (format, [width, height]) =
            contained(&place, "a sound picture", || match bytes.starts_with(ktx2::MAGIC) {
                true => Ok((Format::Ktx2, ktx2::size(document, bytes, &place)?)),
                false => Ok((Format::Codes, codes_size(document, bytes, &place)?)),
            })?;
        self.push(name, [width, height], Waiting::Picture { content, place, format });
        self.position.insert(number, self.decoded.len() - 1);
        Ok(self.decoded.len() - 1)
    }

    /// Reads the header of the environment map at a URI, and returns its index.
    pub(crate) fn environment(&mut self, document: &Document<'_>, uri: &str, place: &str) -> Result<usize, Fault> {
        let bytes = read(document, uri, place)?;
        let (_, decoder) = open(document, &bytes, place, &[ImageFormat::Hdr])?;
        let (width, height) = decoder.dimensions();
        drop(decoder);
        spend(document, place, [width as usize, height as usize], size_of::<[f32; 3]>())?;
        let waiting = Waiting::Picture { content: Content::Own(bytes), place: place.to_owned(), format: Format::Hdr };
        self.push(place.to_owned(), [width as usize, height as usize], waiting);
        Ok(self.decoded.len() - 1)
    }

    /// Index of an image whose green channel is 1 − `factor` · alpha of the image `from`.
    pub(crate) fn roughness(
        &mut self,
        document: &Document<'_>,
        from: usize,
        factor: f32,
        place: &str,
    ) -> Result<usize, Fault> {
        let Image { width, height, ref name, .. } = self.decoded[from];
        let name = format!("{name} as roughness");
        spend(document, place, [width, height], size_of::<[u8; 4]>())?;
        self.push(name, [width, height], Waiting::Roughness { from, factor });
        Ok(self.decoded.len() - 1)
    }

    fn push(&mut self, name: String, [width, height]: [usize; 2], waiting: Waiting) {
        self.decoded.push(Image { name, width, height, pixels: Pixels::Rgba8(Vec::new()) });
        self.waiting.push(waiting);
    }

    /// Decodes every image, in the order of first use.
    pub(crate) fn decode(&mut self, document: &Document<'_>) -> Result<(), Fault> {
        let first = self.decoded.len() - self.waiting.len();
        for (i, waiting) in std::mem::take(&mut self.waiting).into_iter().enumerate() {
            document.task.cancel.check()?;
            let at = first + i;
            self.decoded[at].pixels = match waiting {
                Waiting::Roughness { from, factor } => roughness(&self.decoded[from].pixels, factor),
                Waiting::Picture { content, place, format } => {
                    let bytes = content.bytes(document, &place)?;
                    contained(&place, "a sound picture", || match format {
                        Format::Ktx2 => ktx2::decode(bytes, &place),
                        Format::Codes => codes(document, bytes, &place),
                        Format::Hdr => radiance(document, bytes, &place),
                    })?
                }
            };
        }
        Ok(())
    }
}

impl Content {
    fn bytes<'a>(&'a self, document: &'a Document<'_>, place: &str) -> Result<&'a [u8], Fault> {
        match self {
            Self::Own(bytes) => Ok(bytes),
            Self::View(view) => Ok(document.view(*view, place)?.bytes),
        }
    }
}

/// The bytes of a file or data URI, which stay in memory until its picture is decoded.
fn read(document: &Document<'_>, uri: &str, place: &str) -> Result<Vec<u8>, Fault> {
    let bytes = document.read_uri(uri, place, document.affordable_bytes())?;
    document.spend(place, bytes.len(), 1)?;
    Ok(bytes)
}

/// Adds the memory of a picture to the budget before it is decoded.
fn spend(document: &Document<'_>, place: &str, size: [usize; 2], texel_bytes: usize) -> Result<(), Fault> {
    let [width, height] = size;
    let bytes = width as u64 * height as u64 * texel_bytes as u64;
    document.spend_on_picture(place, bytes, &format!("{width} × {height} texels"))
}

const TEXTURE_FORMATS: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP];

/// Opens a picture that must have one of the formats and keep within the limits.
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
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits.clone());
    let mut decoder = reader.into_decoder().map_err(|error| unreadable(place, format, error))?;
    let (width, height) = decoder.dimensions();
    if width > MAX_SIDE || height > MAX_SIDE {
        let expected = format!("at most {MAX_SIDE} texels a side");
        return Err(Fault::new(place, expected, format!("{width} × {height} texels of {:?}", decoder.color_type())));
    }
    // the picture itself was added to its budget before
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2).saturating_add(DECODER_BYTES));
    decoder.set_limits(limits).map_err(|error| unreadable(place, format, error))?;
    Ok((format, decoder))
}

fn unreadable(place: &str, format: ImageFormat, error: ImageError) -> Fault {
    Fault::new(place, format!("a readable {format:?} picture of at most {MAX_SIDE} texels a side"), error)
}

/// True if the codes of the picture have 16 bits.
fn is_deep(decoder: &impl ImageDecoder) -> bool {
    let color = decoder.color_type();
    color.bytes_per_pixel() / color.channel_count() > 1
}

/// Size of a picture of codes; its texels are added to the budget.
fn codes_size(document: &Document<'_>, bytes: &[u8], place: &str) -> Result<[usize; 2], Fault> {
    let (_, decoder) = open(document, bytes, place, &TEXTURE_FORMATS)?;
    let (width, height) = decoder.dimensions();
    let size = [width as usize, height as usize];
    spend(document, place, size, if is_deep(&decoder) { 8 } else { 4 })?;
    Ok(size)
}

/// Codes with four channels, of 16 bits if the file has them.
fn codes(document: &Document<'_>, bytes: &[u8], place: &str) -> Result<Pixels, Fault> {
    let (format, decoder) = open(document, bytes, place, &TEXTURE_FORMATS)?;
    let (width, height) = decoder.dimensions();
    let fault = |error| unreadable(place, format, error);
    if is_deep(&decoder) {
        let decoded = DynamicImage::from_decoder(decoder).map_err(fault)?;
        return Ok(Pixels::Rgba16(decoded.into_rgba16().into_raw().as_chunks::<4>().0.to_vec()));
    }
    // A large picture must not be in memory twice. So it is decoded into the end of its texels, and
    // spread from their start. The spread values never overtake the decoded ones.
    let (count, channels) = (width as usize * height as usize, usize::from(decoder.color_type().channel_count()));
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
    Ok(Pixels::Rgba8(texels))
}

/// The values of a Radiance picture.
fn radiance(document: &Document<'_>, bytes: &[u8], place: &str) -> Result<Pixels, Fault> {
    let (format, decoder) = open(document, bytes, place, &[ImageFormat::Hdr])?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(|error| unreadable(place, format, error))?;
    Ok(Pixels::RgbF32(decoded.into_rgb32f().into_raw().as_chunks::<3>().0.to_vec()))
}

/// Pixels whose green channel is 1 − `factor` · alpha.
fn roughness(glossy: &Pixels, factor: f32) -> Pixels {
    let rough = |alpha: f32| ((1.0 - factor * alpha) * 255.0).round() as u8;
    let texel = |roughness: u8| [0, roughness, 0, 255];
    let pixels = match glossy {
        Pixels::Rgba8(texels) => texels.iter().map(|&[.., alpha]| texel(rough(f32::from(alpha) / 255.0))).collect(),
        Pixels::Rgba16(texels) => texels.iter().map(|&[.., alpha]| texel(rough(f32::from(alpha) / 65535.0))).collect(),
        Pixels::RgbF32(texels) => vec![texel(rough(1.0)); texels.len()],
    };
    Pixels::Rgba8(pixels)
}
