//! Encodes pictures as PNG and JPEG.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::paint::Picture;
use crate::{GeneratorError, SceneFile};

/// Quality of the JPEG files. It is so high that ringing is weaker than the contrast of the finest
/// pattern.
const JPEG_QUALITY: u8 = 88;

/// Channels of a picture that a PNG stores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Channels {
    /// Only the red channel, as a grey picture.
    Gray,
    /// Three channels.
    Rgb,
    /// Three channels and alpha.
    Rgba,
}

/// Encodes a picture as a PNG file.
pub(crate) fn png(file: &str, picture: &Picture, channels: Channels) -> Result<SceneFile, GeneratorError> {
    let (kept, color) = match channels {
        Channels::Gray => (1, ExtendedColorType::L8),
        Channels::Rgb => (3, ExtendedColorType::Rgb8),
        Channels::Rgba => (4, ExtendedColorType::Rgba8),
    };
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(&samples(picture, kept), picture.width, picture.height, color)
        .map_err(|source| GeneratorError::Encode { file: file.into(), source })?;
    Ok((file.into(), bytes))
}

/// Encodes a picture as a JPEG file, which is smaller for pictures with much grain.
pub(crate) fn jpeg(file: &str, picture: &Picture) -> Result<SceneFile, GeneratorError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .write_image(&samples(picture, 3), picture.width, picture.height, ExtendedColorType::Rgb8)
        .map_err(|source| GeneratorError::Encode { file: file.into(), source })?;
    Ok((file.into(), bytes))
}

fn samples(picture: &Picture, kept: usize) -> Vec<u8> {
    picture.pixels.iter().flat_map(|pixel| pixel[..kept].to_vec()).collect()
}
