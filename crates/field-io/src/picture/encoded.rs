//! PNG, JPEG, WebP and Radiance HDR through the `image` crate.

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use image::{DynamicImage, ImageFormat, ImageReader};

use super::samples::{PIXEL_LIMIT, Picture, Samples};
use crate::FieldError;

/// Number of bytes at the end of a JPEG that must contain its end marker. Cameras append small
/// amounts of data after the marker.
const JPEG_TAIL: u64 = 1 << 16;
/// Largest memory that a decoder may take, bytes.
const DECODER_BYTES: u64 = 3 << 30;
/// Largest memory that a pixel takes while its picture is read: 8 bytes of decoded samples (four of
/// 16 bits), 12 of linear light, and 4 of a decoder.
const BYTES_PER_PIXEL: u64 = 24;

pub(super) fn size(path: &Path) -> Result<[usize; 2], FieldError> {
    let (cols, rows) = reader(path)?.into_dimensions().map_err(|error| damaged(path, &error))?;
    checked(path, [cols as usize, rows as usize])
}

/// Returns an upper bound of the memory that [`read`] takes, bytes.
pub(super) fn bytes(path: &Path) -> Result<u64, FieldError> {
    size(path).map(|[cols, rows]| BYTES_PER_PIXEL * (cols * rows) as u64)
}

pub(super) fn read(path: &Path) -> Result<Picture, FieldError> {
    size(path)?;
    let mut reader = reader(path)?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(DECODER_BYTES);
    reader.limits(limits);
    if reader.format() == Some(ImageFormat::Jpeg) {
        check_jpeg_end(path)?;
    }
    let decoded = reader.decode().map_err(|error| damaged(path, &error))?;
    Ok(from_decoded(decoded))
}

fn reader(path: &Path) -> Result<ImageReader<BufReader<lumistack_files::File>>, FieldError> {
    let file = lumistack_files::open(path).map_err(FieldError::io(path, "read"))?;
    let mut reader = ImageReader::new(BufReader::new(file));
    // set the format by the extension, which decides for files without a signature
    if let Ok(format) = ImageFormat::from_path(path) {
        reader.set_format(format);
    }
    reader.with_guessed_format().map_err(FieldError::io(path, "read"))
}

/// Refuses a JPEG that is cut short. The decoder fills missing pixels with grey, which would become
/// a part of the light field without notice.
fn check_jpeg_end(path: &Path) -> Result<(), FieldError> {
    let tail = || {
        let mut file = lumistack_files::open(path)?;
        let length = lumistack_files::length(&file)?;
        file.seek(SeekFrom::Start(length.saturating_sub(JPEG_TAIL)))?;
        let mut tail = Vec::new();
        file.read_to_end(&mut tail)?;
        std::io::Result::Ok(tail)
    };
    let tail = tail().map_err(FieldError::io(path, "read"))?;
    if tail.windows(2).any(|pair| pair == [0xff, 0xd9]) {
        Ok(())
    } else {
        Err(FieldError::malformed(path, "end of file", "a JPEG's end marker", "none: the file is cut short"))
    }
}

fn checked(path: &Path, size: [usize; 2]) -> Result<[usize; 2], FieldError> {
    if size[0].saturating_mul(size[1]) > PIXEL_LIMIT || size.contains(&0) {
        let expected = format!("1 to {PIXEL_LIMIT} pixels");
        return Err(FieldError::malformed(path, "size", expected, format!("{} × {}", size[0], size[1])));
    }
    Ok(size)
}

fn damaged(path: &Path, error: &image::ImageError) -> FieldError {
    FieldError::malformed(path, "content", "a complete PNG, JPEG, WebP or HDR picture", error.to_string())
}

fn from_decoded(decoded: DynamicImage) -> Picture {
    let (cols, rows) = (decoded.width() as usize, decoded.height() as usize);
    // Opaque pictures with an alpha channel, such as screenshots, keep their code values.
    let has_alpha = decoded.color().has_alpha() && !is_opaque(&decoded);
    let samples = match decoded {
        DynamicImage::ImageRgb32F(picture) => Samples::Linear(picture.into_raw()),
        DynamicImage::ImageRgba32F(picture) => Samples::Linear(over_black(picture.as_raw(), |v| v, 1.0)),
        wide @ (DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_)) => {
            if has_alpha {
                Samples::Linear(over_black(wide.into_rgba16().as_raw(), decode_over(65535.0), 65535.0))
            } else {
                Samples::Srgb16(wide.into_rgb16().into_raw())
            }
        }
        narrow if has_alpha => Samples::Linear(over_black(narrow.into_rgba8().as_raw(), decode_over(255.0), 255.0)),
        narrow => Samples::Srgb8(narrow.into_rgb8().into_raw()),
    };
    Picture { cols, rows, samples }
}

fn is_opaque(picture: &DynamicImage) -> bool {
    match picture {
        DynamicImage::ImageLumaA8(picture) => picture.pixels().all(|pixel| pixel.0[1] == u8::MAX),
        DynamicImage::ImageRgba8(picture) => picture.pixels().all(|pixel| pixel.0[3] == u8::MAX),
        DynamicImage::ImageLumaA16(picture) => picture.pixels().all(|pixel| pixel.0[1] == u16::MAX),
        DynamicImage::ImageRgba16(picture) => picture.pixels().all(|pixel| pixel.0[3] == u16::MAX),
        _ => false,
    }
}

fn decode_over(top: f32) -> impl Fn(f32) -> f32 {
    move |code| lumistack_core::colour::srgb_decode(code / top)
}

fn over_black<T: Copy + Into<f32>>(rgba: &[T], decode: impl Fn(f32) -> f32, opaque: f32) -> Vec<f32> {
    let colour = |p: &[T]| [0, 1, 2].map(|channel| decode(p[channel].into()) * (p[3].into() / opaque));
    rgba.chunks_exact(4).flat_map(colour).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_transparent_white_is_half_the_light() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        image::RgbaImage::from_raw(2, 1, vec![255, 255, 255, 51, 255, 0, 255, 255]).unwrap().save(&path).unwrap();
        let picture = Picture::read(&path).unwrap();
        assert_eq!(picture.size(), [2, 1]);
        assert_eq!(picture.into_linear(), [0.2, 0.2, 0.2, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn opaque_pictures_with_alpha_keep_their_codes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let read = |picture: DynamicImage| {
            picture.save(&path).unwrap();
            Picture::read(&path).unwrap()
        };
        let narrow = |alpha| image::RgbaImage::from_raw(1, 1, vec![9, 128, 255, alpha]).unwrap().into();
        let plain = image::RgbImage::from_raw(1, 1, vec![9, 128, 255]).unwrap().into();
        assert!(read(narrow(255)).is_encoded());
        assert!(!read(narrow(254)).is_encoded());
        assert_eq!(read(narrow(255)).into_linear(), read(plain).into_linear());
        let wide = |alpha| DynamicImage::ImageLumaA16(image::ImageBuffer::from_raw(1, 1, vec![40_000, alpha]).unwrap());
        assert!(read(wide(u16::MAX)).is_encoded());
        assert!(!read(wide(0)).is_encoded());
    }

    #[test]
    fn sixteen_bits_are_not_rounded_to_eight() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let code = 30_001u16;
        image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(1, 1, vec![code, 0, u16::MAX]).unwrap().save(&path).unwrap();
        let expected = lumistack_core::colour::srgb_decode(f32::from(code) / 65535.0);
        assert_eq!(Picture::read(&path).unwrap().into_linear(), [expected, 0.0, 1.0]);
    }
}
