//! Decodes textures: PNG, JPEG, WebP, TGA, Radiance HDR and OpenEXR, from a file on disk or an
//! entry of a .usdz package.
//!
//! The first bytes determine the format. TGA has no signature, so a file name that ends with .tga
//! determines this format. The bytes are not trusted: sizes are limited before decoding, and a
//! panic in a library is an error.

use std::io::Cursor;
use std::panic::AssertUnwindSafe;

use exr::prelude::{Compression, FlatSamples, MetaData, ReadChannels, ReadLayers, read as read_exr};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

/// Largest width or height of a picture, in texels. OpenEXR pictures have no such limit.
const MOST_TEXELS_A_SIDE: u32 = 1 << 15;
/// Largest size of a picture in memory, in bytes, at 16 bytes per texel.
const MOST_BYTES: u64 = 2 << 30;
/// Smallest size of a block of compressed pixels, bytes. If the header declares more blocks than
/// fit into the file, the file is refused.
const LEAST_BYTES_PER_BLOCK: usize = 8;
/// The first bytes of every OpenEXR file.
const EXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// A decoded picture; row 0 is the top row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Picture {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) texels: Texels,
}

/// RGBA texels. Grey pictures repeat their value in red, green and blue. Without an alpha channel
/// alpha is 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Texels {
    /// 8-bit codes 0..=255 of red, green, blue and alpha.
    Codes8(Vec<[u8; 4]>),
    /// 16-bit codes 0..=65535 of red, green, blue and alpha.
    Codes16(Vec<[u16; 4]>),
    /// Linear, finite values, from HDR and OpenEXR.
    Float(Vec<[f32; 4]>),
}

impl Picture {
    /// Decodes a picture; `name` selects a format that has no signature.
    ///
    /// # Errors
    /// The reason, as a phrase after the picture's name and "is".
    pub(crate) fn decode(name: &str, bytes: &[u8]) -> Result<Self, String> {
        let decode = || if bytes.starts_with(&EXR) { exr(bytes) } else { codes(name, bytes) };
        std::panic::catch_unwind(AssertUnwindSafe(decode))
            .unwrap_or_else(|_| Err("damaged in a way that its decoder cannot handle".into()))
    }

    /// Returns red, green, blue and alpha of a texel. Integer codes are scaled to 0..1.
    pub(crate) fn texel(&self, index: usize) -> [f32; 4] {
        match &self.texels {
            Texels::Codes8(texels) => texels[index].map(|code| f32::from(code) / 255.0),
            Texels::Codes16(texels) => texels[index].map(|code| f32::from(code) / 65535.0),
            Texels::Float(texels) => texels[index],
        }
    }
}

fn codes(name: &str, bytes: &[u8]) -> Result<Picture, String> {
    use ImageFormat::{Hdr, Jpeg, Png, Tga, WebP};
    // Find the format by the signature. TGA has none, so the file's name decides.
    let format = match image::guess_format(bytes) {
        Ok(format @ (Png | Jpeg | WebP | Hdr)) => format,
        Err(_) if name.to_ascii_lowercase().ends_with(".tga") => Tga,
        Ok(other) => {
            return Err(format!(
                "in the format {}; PNG, JPEG, WebP, TGA, HDR and OpenEXR are read",
                format!("{other:?}").to_uppercase()
            ));
        }
        Err(_) => {
            let start = bytes[..bytes.len().min(12)].escape_ascii();
            return Err(format!(
                "{} bytes that start with \"{start}\"; PNG, JPEG, WebP, TGA, HDR and OpenEXR are read",
                bytes.len()
            ));
        }
    };
    // Check the size before pixels are decoded.
    let mut limits = Limits::default();
    limits.max_image_width = Some(MOST_TEXELS_A_SIDE);
    limits.max_image_height = Some(MOST_TEXELS_A_SIDE);
    limits.max_alloc = Some(MOST_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    let broken =
        |error: image::ImageError| format!("no readable {} picture ({error})", format!("{format:?}").to_uppercase());
    let decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    // a texel takes at most 16 bytes: four channels of at most four bytes
    if u64::from(width) * u64::from(height) * 16 > MOST_BYTES || width.max(height) > MOST_TEXELS_A_SIDE {
        return Err(format!(
            "{width} × {height} texels; at most 32768 are read in a row or column, and at most {} in all",
            MOST_BYTES / 16
        ));
    }
    let color = decoder.color_type();
    let deep = color.bytes_per_pixel() / color.channel_count();
    let decoded = DynamicImage::from_decoder(decoder).map_err(broken)?;
    let texels = match deep {
        1 => Texels::Codes8(decoded.into_rgba8().into_raw().as_chunks::<4>().0.to_vec()),
        2 => Texels::Codes16(decoded.into_rgba16().into_raw().as_chunks::<4>().0.to_vec()),
        _ => Texels::Float(decoded.into_rgba32f().into_raw().as_chunks::<4>().0.iter().map(|&t| finite(t)).collect()),
    };
    Ok(Picture { width: width as usize, height: height as usize, texels })
}

fn finite(texel: [f32; 4]) -> [f32; 4] {
    texel.map(|value| if value.is_finite() { value } else { 0.0 })
}

fn exr(bytes: &[u8]) -> Result<Picture, String> {
    // Check sizes in the header before pixels are decoded.
    let broken = |error: exr::error::Error| format!("no readable OpenEXR picture ({error})");
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(broken)?;
    let header = meta.headers.first().ok_or("an OpenEXR file without a layer")?;
    // Refuse deep data and DWA compression. For these the decoder allocates memory by sizes in the
    // compressed data, so a damaged file could end the program.
    if header.deep || matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        let found = if header.deep { "deep data".to_owned() } else { header.compression.to_string() };
        return Err(format!(
            "an OpenEXR picture with {found}; flat pictures are read, without compression or with RLE, ZIP, PIZ, PXR24 or B44"
        ));
    }
    let (width, height) = (header.layer_size.0, header.layer_size.1);
    let most = MOST_BYTES / 16;
    if width == 0 || height == 0 || (width as u64).saturating_mul(height as u64) > most {
        return Err(format!("an OpenEXR picture of {width} × {height} texels; a picture must have 1 to {most} texels"));
    }
    let blocks: usize = meta.headers.iter().map(|header| header.chunk_count).fold(0, usize::saturating_add);
    if blocks.saturating_mul(LEAST_BYTES_PER_BLOCK) > bytes.len() {
        return Err("an OpenEXR file that is cut short".into());
    }
    // Read the first layer, and find its channels by the last component of their names.
    let layers = read_exr().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let picture = layers.all_attributes().non_parallel().from_buffered(Cursor::new(bytes)).map_err(broken)?;
    let list = &picture.layer_data.channel_data.list;
    let find = |wanted: &str| {
        list.iter().position(|channel| {
            let name = channel.name.to_string();
            name.rsplit('.').next().is_some_and(|end| end.eq_ignore_ascii_case(wanted))
        })
    };
    let grey = find("Y");
    let colors = [find("R").or(grey), find("G").or(grey), find("B").or(grey)];
    let lone = (list.len() == 1).then_some(0);
    let sources = [colors[0].or(lone), colors[1].or(lone), colors[2].or(lone), find("A")];
    // Copy each channel to its component; a single channel is grey.
    let mut texels = vec![[0.0, 0.0, 0.0, 1.0]; width * height];
    for (channel, source) in sources.into_iter().enumerate() {
        let Some(source) = source else { continue };
        let samples = &list[source].sample_data;
        if samples.len() != texels.len() {
            return Err(format!(
                "an OpenEXR picture with a subsampled channel, {}, which is not supported",
                list[source].name
            ));
        }
        let targets = texels.iter_mut().map(|texel| &mut texel[channel]);
        match samples {
            FlatSamples::F16(values) => targets.zip(values).for_each(|(target, value)| *target = value.to_f32()),
            FlatSamples::F32(values) => targets.zip(values).for_each(|(target, value)| *target = *value),
            FlatSamples::U32(values) => targets.zip(values).for_each(|(target, value)| *target = *value as f32),
        }
    }
    texels.iter_mut().for_each(|texel| *texel = finite(*texel));
    Ok(Picture { width, height, texels: Texels::Float(texels) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_follow_from_the_content() {
        let mut png = Vec::new();
        let picture = DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(2, 1, vec![0u16, 65535]).unwrap());
        picture.write_to(&mut Cursor::new(&mut png), ImageFormat::Png).unwrap();
        let decoded = Picture::decode("anything.jpg", &png).unwrap();
        assert_eq!(decoded.texels, Texels::Codes16(vec![[0, 0, 0, 65535], [65535; 4]]));
        // this TGA is uncompressed and has one blue texel, stored from the top left
        let mut tga = vec![0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 24, 0x20];
        tga.extend([255, 0, 0]);
        assert_eq!(Picture::decode("a.TGA", &tga).unwrap().texels, Texels::Codes8(vec![[0, 0, 255, 255]]));
        assert!(Picture::decode("a.png", &tga).unwrap_err().contains("PNG, JPEG"));
        assert!(Picture::decode("a.png", &[]).is_err());
    }

    #[test]
    fn openexr_keeps_values_above_one_and_reads_grey() {
        let write = |channels: &[(&str, f32)]| {
            let list = channels
                .iter()
                .map(|&(name, value)| exr::prelude::AnyChannel::new(name, FlatSamples::F32(vec![value, 2.0 * value])));
            let layer = exr::prelude::Layer::new(
                (2, 1),
                exr::prelude::LayerAttributes::default(),
                exr::prelude::Encoding::SMALL_LOSSLESS,
                exr::prelude::AnyChannels::sort(list.collect()),
            );
            let mut bytes = Vec::new();
            use exr::prelude::WritableImage;
            exr::prelude::Image::from_layer(layer).write().to_buffered(Cursor::new(&mut bytes)).unwrap();
            bytes
        };
        let bytes = write(&[("R", 3.0), ("G", f32::NAN), ("B", 0.5)]);
        let texels = |bytes: &[u8]| match Picture::decode("e", bytes).unwrap().texels {
            Texels::Float(texels) => texels,
            other => panic!("{other:?}"),
        };
        assert_eq!(texels(&bytes), [[3.0, 0.0, 0.5, 1.0], [6.0, 0.0, 1.0, 1.0]]);
        assert_eq!(texels(&write(&[("Y", 0.25)]))[0], [0.25, 0.25, 0.25, 1.0]);
        for cut in [4, 100, bytes.len() - 5] {
            assert!(Picture::decode("e", &bytes[..cut]).is_err());
        }
    }
}
