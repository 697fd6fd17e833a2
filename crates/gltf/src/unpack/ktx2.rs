//! `KHR_texture_basisu`: KTX2 pictures whose texels are packed by Basis Universal, as ETC1S or
//! UASTC.
//!
//! Every offset and size of the container is checked here before the decoder sees it. Only the
//! largest level is decoded; the path tracer computes smaller levels itself. Sources: KTX 2.0
//! specification, sections 3 and 5; KHR_texture_basisu, "KTX v2 Images with Basis Universal
//! Supercompression".

#[cfg(feature = "ktx2")]
use std::ops::Range;

#[cfg(feature = "ktx2")]
use basisu::{DecodeFlags, TargetFormat, Transcoder};
use lumistack_scene::Pixels;

use super::kinds::Unsound;
use crate::options::MAX_SIDE;

/// First bytes of a KTX2 file.
pub(super) const MAGIC: &[u8] = b"\xABKTX 20\xBB\r\n\x1A\n";

/// Number of bytes of the header before the list of levels.
const HEADER_BYTES: usize = 80;
/// Number of bytes of a level's entry in the list of levels.
const LEVEL_BYTES: usize = 24;
/// Range of the header's bytes that states offset and length of the key/value data.
#[cfg(feature = "ktx2")]
const NOTES: Range<usize> = 56..64;
/// Colour model of the data format descriptor for Basis Universal's codec ETC1S.
const ETC1S: u32 = 163;
/// Colour model of the data format descriptor for Basis Universal's codec UASTC.
const UASTC: u32 = 166;

/// The decoded channels from which glTF's red, green, blue and alpha are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channels {
    Rgba,
    /// Red from the decoded red; green and blue are 0.
    Red,
    /// Red from the decoded red, green from the decoded alpha; blue is 0.
    RedAndAlpha,
    /// Red and green from the decoded red and green; blue is 0.
    RedGreen,
}

struct Header {
    width: u32,
    height: u32,
    #[cfg_attr(not(feature = "ktx2"), expect(dead_code, reason = "the header is checked without a decoder, too"))]
    channels: Channels,
}

/// Returns width and height of the largest level, in texels.
pub(super) fn size(bytes: &[u8]) -> Result<[u32; 2], Unsound> {
    let Header { width, height, .. } = Header::read(bytes)?;
    Ok([width, height])
}

/// Refuses the picture, since this build has no decoder.
#[cfg(not(feature = "ktx2"))]
pub(super) fn decode(bytes: &[u8]) -> Result<Pixels, Unsound> {
    Header::read(bytes)?;
    Err(Unsound::new("a PNG, JPEG or WebP picture, since this build cannot read KTX2", "KTX2"))
}

/// Decodes the largest level of a picture.
#[cfg(feature = "ktx2")]
pub(super) fn decode(bytes: &[u8]) -> Result<Pixels, Unsound> {
    let Header { width, height, channels } = Header::read(bytes)?;
    let broken = |error| Unsound::new("a sound Basis Universal picture", format!("{error:?}"));
    // hide the key/value data: texels do not need this data, and the decoder trusts the length of
    // its last entry
    let mut noteless = bytes.to_vec();
    noteless[NOTES].fill(0);
    let transcoder = Transcoder::new(&noteless).map_err(broken)?;
    let mut texels = vec![[0u8; 4]; width as usize * height as usize];
    transcoder.transcode_into(0, TargetFormat::Rgba32, DecodeFlags::NONE, texels.as_flattened_mut()).map_err(broken)?;
    for texel in &mut texels {
        *texel = match channels {
            Channels::Rgba => *texel,
            Channels::Red => [texel[0], 0, 0, 255],
            Channels::RedAndAlpha => [texel[0], texel[3], 0, 255],
            Channels::RedGreen => [texel[0], texel[1], 0, 255],
        };
    }
    Ok(Pixels::Rgba8(texels))
}

impl Header {
    /// Reads the fields of the header that are needed, and checks every range that the header
    /// states.
    fn read(bytes: &[u8]) -> Result<Self, Unsound> {
        let fault = |expected: &str, found: String| Err(Unsound::new(format!("a KTX2 picture with {expected}"), found));
        let truncated = || Unsound::new("a whole KTX2 file", format!("a file that ends after {} bytes", bytes.len()));
        let word = |at: usize| -> Result<u32, Unsound> {
            let found = bytes.get(at..).and_then(|tail| tail.first_chunk());
            found.map(|&word| u32::from_le_bytes(word)).ok_or_else(truncated)
        };
        let long = |at: usize| -> Result<u64, Unsound> { Ok(u64::from(word(at)?) | u64::from(word(at + 4)?) << 32) };
        let inside = |offset: u64, length: u64| match offset.checked_add(length) {
            Some(end) if end <= bytes.len() as u64 => Ok(()),
            _ => Err(truncated()),
        };
        // check that the file is one picture of Basis Universal with its mip levels
        let (format, width, height, depth) = (word(12)?, word(20)?, word(24)?, word(28)?);
        let (layers, faces, levels, scheme) = (word(32)?, word(36)?, word(40)?, word(44)?);
        if format != 0 {
            return fault("texels of Basis Universal", format!("the Vulkan format {format}"));
        }
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return fault(&format!("1 to {MAX_SIDE} texels a side"), format!("{width} × {height}"));
        }
        if depth != 0 || layers > 1 || faces != 1 || !(1..=16).contains(&levels) {
            let found = format!("depth {depth}, layers: {layers}, faces: {faces}, levels: {levels}");
            return fault("depth 0, 0 or 1 layers, 1 face and 1 to 16 levels", found);
        }
        // check that offsets and lengths are within the file
        let descriptor = word(48)? as usize;
        for (offset, length) in [(word(48)?, word(52)?), (word(56)?, word(60)?)] {
            inside(offset.into(), length.into())?;
        }
        inside(long(64)?, long(72)?)?;
        // check the codec
        let model = word(descriptor + 12)? & 255;
        if !((model == ETC1S && scheme == 1) || (model == UASTC && (scheme == 0 || scheme == 2))) {
            let found = format!("colour model {model} with supercompression {scheme}");
            return fault("ETC1S in BasisLZ, or UASTC plain or in Zstandard", found);
        }
        // check that every level is within the file, and that a level of UASTC has the size that
        // its texels need
        for level in 0..levels {
            let entry = HEADER_BYTES + LEVEL_BYTES * level as usize;
            inside(long(entry)?, long(entry + 8)?)?;
            let blocks = |side: u32| u64::from((side >> level).max(1).div_ceil(4));
            let unpacked = long(entry + 16)?;
            let needed = 16 * blocks(width) * blocks(height);
            if model == UASTC && unpacked != needed {
                return fault(&format!("{needed} bytes in level {level}"), unpacked.to_string());
            }
        }
        // read the channel ids of the samples in the data format descriptor
        let sample = |at: usize| -> Result<u32, Unsound> { Ok((word(at)? >> 24) & 15) };
        let first = sample(descriptor + 28)?;
        let two_samples = word(52)? >= 60;
        let channels = match (model, first) {
            (ETC1S, 3) if two_samples && sample(descriptor + 44)? == 4 => Channels::RedAndAlpha,
            (ETC1S, 3) | (UASTC, 4) => Channels::Red,
            (UASTC, 5) => Channels::RedAndAlpha,
            (UASTC, 6) => Channels::RedGreen,
            _ => Channels::Rgba,
        };
        Ok(Self { width, height, channels })
    }
}
