//! Decoders of packed content, by libraries in pure Rust: pictures, Draco, meshopt, splats.
//!
//! The reader of glTF passes [`Packed`] content to
//! [`AssetResolver::unpack`](crate::AssetResolver::unpack), whose default is [`unpack`] here. A web
//! page may have its decoders in a second WebAssembly module. Then
//! [`to_bytes`](Packed::to_bytes) encodes a request for that module. There, [`answer`] decodes the
//! content, and returns the result as bytes, which [`answered`] reads in the first module.

mod draco;
mod kinds;
mod ktx2;
mod meshopt;
mod pictures;
mod wire;

pub use kinds::{Attribute, Codec, Filter, Mesh, Packed, Unpacked, Unsound, Use};
pub use wire::answered;

use std::panic::AssertUnwindSafe;

use lumistack_splats::read;

/// Decodes packed content, within the limits that `packed` states.
///
/// # Errors
/// If the content is broken, not supported or too large, or if the library that decodes it panics.
pub fn unpack(packed: &Packed<'_>) -> Result<Unpacked, Unsound> {
    let decode = || match *packed {
        Packed::Size(usage, bytes) => pictures::size(pictures::all, usage, bytes),
        Packed::Picture(usage, bytes) => pictures::decode(pictures::all, usage, bytes),
        Packed::Draco { bytes, attributes, max_bytes } => draco::decode(bytes, attributes, max_bytes),
        Packed::Meshopt { bytes, codec, filter, count, stride } => meshopt::decode(bytes, codec, filter, count, stride),
        Packed::Spz { bytes, max_bytes } => splats(read::read_spz(bytes, max_bytes)),
        Packed::Capture(bytes, ref beside) => splats(read::read(bytes, &|name: &str| {
            let plain = name.strip_prefix("./").unwrap_or(name);
            let found = beside.iter().find(|(name, _)| *name == plain);
            let missing = "the file is not among the opened files; open the folder that contains the file";
            found.map(|(_, bytes)| bytes.to_vec()).ok_or_else(|| missing.to_owned())
        })),
    };
    contained(packed, decode)
}

/// Decodes common pictures ([`Packed::is_common`]) to the same results as [`unpack`]. A
/// WebAssembly module that calls only this function is small, since it contains no other decoder.
///
/// # Errors
/// The errors of [`unpack`], and an error for all content except common pictures and KTX2 pictures.
pub fn unpack_common(packed: &Packed<'_>) -> Result<Unpacked, Unsound> {
    let decode = || match *packed {
        Packed::Size(usage, bytes) => pictures::size(pictures::common, usage, bytes),
        Packed::Picture(usage, bytes) => pictures::decode(pictures::common, usage, bytes),
        _ => Err(packed.stopped()),
    };
    contained(packed, decode)
}

/// Runs the decoder of a library. If the library panics, the content is broken in a way that the
/// library does not check, so the result is an error.
fn contained<T>(packed: &Packed<'_>, decode: impl FnOnce() -> Result<T, Unsound>) -> Result<T, Unsound> {
    std::panic::catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| Err(packed.stopped()))
}

fn splats(found: Result<read::Found, read::ReadError>) -> Result<Unpacked, Unsound> {
    let unsound = |read::ReadError { place, expected, found }| Unsound { place, expected, found };
    found.map(Unpacked::Splats).map_err(unsound)
}

/// Decodes packed content from the bytes of a request. Returns the result as bytes. `None` if the
/// bytes do not come from [`Packed::to_bytes`].
pub fn answer(request: &[u8]) -> Option<Vec<u8>> {
    wire::request(request, |packed| wire::answer(&unpack(packed)))
}

/// Decodes a common picture as [`answer`] does, by [`unpack_common`].
pub fn answer_common(request: &[u8]) -> Option<Vec<u8>> {
    wire::request(request, |packed| wire::answer(&unpack_common(packed)))
}

#[cfg(test)]
mod tests {
    use image::ImageFormat;

    use super::*;

    #[test]
    fn a_decoder_that_panics_means_broken_content() {
        let packed = Packed::Size(Use::Texture, b"");
        let stopped = contained::<()>(&packed, || panic!("as a library might")).unwrap_err();
        assert_eq!((stopped.place.as_str(), stopped.expected.as_str()), ("", "a sound picture"));
        assert_eq!(stopped.found, "data at which the decoder stops");
        assert_eq!(contained(&packed, || Ok(3)), Ok(3));
    }

    #[test]
    fn bytes_that_are_no_request_have_no_answer() {
        let request = Packed::Size(Use::Texture, b"no picture").to_bytes();
        let error = answered(&answer(&request).unwrap()).unwrap().unwrap_err();
        assert_eq!(error, unpack(&Packed::Size(Use::Texture, b"no picture")).unwrap_err());
        for end in 0..request.len() {
            assert_eq!(answer(&request[..end]), None, "{end}");
        }
        assert_eq!(answered(b"\x07"), None);
    }

    /// For common pictures, `unpack_common` returns the same results as `unpack`, even if the
    /// pictures are broken or of the wrong kind. `unpack_common` refuses an SPZ stream.
    #[test]
    fn common_pictures_need_few_decoders() {
        let picture = image::RgbImage::from_fn(5, 3, |x, y| image::Rgb([40 * x as u8, 70 * y as u8, 9]));
        let encoded = |format: ImageFormat| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            let picture = image::DynamicImage::from(picture.clone());
            let picture = if format == ImageFormat::Hdr { picture.into_rgb32f().into() } else { picture };
            picture.write_to(&mut bytes, format).unwrap();
            bytes.into_inner()
        };
        for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Hdr, ImageFormat::WebP] {
            let bytes = encoded(format);
            let is_common = format != ImageFormat::WebP;
            for bytes in [&bytes[..], &bytes[..bytes.len() / 2], &bytes[..12]] {
                for usage in [Use::Texture, Use::Environment] {
                    for packed in [Packed::Size(usage, bytes), Packed::Picture(usage, bytes)] {
                        assert_eq!(packed.is_common(), is_common, "{format:?}");
                        if is_common {
                            assert_eq!(unpack_common(&packed), unpack(&packed), "{format:?}, {} bytes", bytes.len());
                            assert_eq!(answer_common(&packed.to_bytes()), answer(&packed.to_bytes()));
                        }
                    }
                }
            }
        }
        let spz = Packed::Spz { bytes: b"\x89PNG\r\n\x1a\n", max_bytes: 9 };
        assert!(!spz.is_common() && unpack_common(&spz).is_err());
    }
}
