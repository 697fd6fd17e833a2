//! Pictures: textures' images, each read and decoded once, and the environment map.

use std::collections::HashMap;

use gltf::json;
use lumistack_scene::{Image, Pixels};

use crate::document::Document;
use crate::error::Fault;
use crate::unpack::{Packed, Unpacked, Use};

/// Images in the order of first use. Their headers are read at first use, and all pictures are
/// decoded at the end. So a scene whose pictures are too large in sum is refused before any picture
/// is decoded.
#[derive(Default)]
pub(crate) struct Images {
    /// Sizes of the images; also their pixels, after [`decode`](Self::decode).
    pub(crate) decoded: Vec<Image>,
    /// Position in `decoded` of an image; the key is the image's index in the file.
    position: HashMap<usize, usize>,
    /// Sources of the images without pixels, in the order of `decoded`.
    waiting: Vec<Waiting>,
}

/// The source of an image.
enum Waiting {
    /// The picture in `content`, at the place `place` of the file.
    Picture { content: Content, place: String, usage: Use },
    /// Roughness: 1 − `factor` · alpha. `from` is the position of the image whose alpha holds
    /// glossiness.
    Roughness { from: usize, factor: f32 },
}

/// The source of a picture's bytes.
enum Content {
    Own(Vec<u8>),
    View(json::Index<json::buffer::View>),
}

impl Images {
    /// Returns the index of an image of the file, whose header is read at first use.
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
        let size = size(document, Use::Texture, bytes, &place)?;
        self.push(name, size, Waiting::Picture { content, place, usage: Use::Texture });
        self.position.insert(number, self.decoded.len() - 1);
        Ok(self.decoded.len() - 1)
    }

    /// Reads the header of the environment map at a URI, and returns its index.
    pub(crate) fn environment(&mut self, document: &Document<'_>, uri: &str, place: &str) -> Result<usize, Fault> {
        let bytes = read(document, uri, place)?;
        let size = size(document, Use::Environment, &bytes, place)?;
        let content = Content::Own(bytes);
        let waiting = Waiting::Picture { content, place: place.to_owned(), usage: Use::Environment };
        self.push(place.to_owned(), size, waiting);
        Ok(self.decoded.len() - 1)
    }

    /// Returns the index of an image whose green channel is 1 − `factor` · alpha of the image
    /// `from`.
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
                Waiting::Picture { content, place, usage } => {
                    let bytes = content.bytes(document, &place)?;
                    document.unpack(&place, &Packed::Picture(usage, bytes), |unpacked| match unpacked {
                        Unpacked::Pixels(pixels) => Some(pixels),
                        _ => None,
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

/// Reads a file or data URI. Counts its bytes, which stay in memory until the picture is decoded.
fn read(document: &Document<'_>, uri: &str, place: &str) -> Result<Vec<u8>, Fault> {
    let bytes = document.read_uri(uri, place, document.affordable_bytes())?;
    document.spend(place, bytes.len(), 1)?;
    Ok(bytes)
}

/// Reads the size of a picture from its header, and adds the memory of its texels to the sum of all
/// pictures.
fn size(document: &Document<'_>, usage: Use, bytes: &[u8], place: &str) -> Result<[usize; 2], Fault> {
    document.task.cancel.check()?;
    let header = document.unpack(place, &Packed::Size(usage, bytes), |unpacked| match unpacked {
        Unpacked::Size { width, height, texel_bytes } => Some(([width as usize, height as usize], texel_bytes)),
        _ => None,
    });
    let (size, texel_bytes) = header?;
    spend(document, place, size, texel_bytes)?;
    Ok(size)
}

/// Adds the memory of a picture to the sum of all pictures, before the picture is decoded.
fn spend(document: &Document<'_>, place: &str, size: [usize; 2], texel_bytes: usize) -> Result<(), Fault> {
    let [width, height] = size;
    let bytes = width as u64 * height as u64 * texel_bytes as u64;
    document.spend_on_picture(place, bytes, &format!("{width} × {height} texels"))
}

/// Makes a picture whose green channel is 1 − `factor` · alpha of the picture `glossy`.
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
