//! `.spz`, versions 1 to 4: quantized attributes. Each attribute is stored for all splats, and then
//! the next one follows. Version 4 stores every attribute in a separate stream.
//!
//! ```text
//! position   24-bit fixed point (version 1: half floats)
//! opacity    byte/255
//! scale      e^(byte/16 − 10)
//! colour     (byte/255 − ½)/0.15 is the constant harmonic
//! rotation   x y z as bytes (from version 3: smallest three of 10 bits)
//! harmonics  (byte − 128)/128
//! ```
//!
//! Source: the format's description, and the constants of its library (github.com/nianticlabs/spz).

use std::io::Read;

use flate2::read::MultiGzDecoder;
use glam::{Quat, Vec3};
use lumistack_scene::MAX_DEGREE;
use lumistack_simd::float_from_half;
use ruzstd::StreamingDecoder;

use super::found::{Axes, Found, ReadError, cloud, exp, from_smallest_three};

const MAGIC: u32 = 0x5053_474e;
/// Size of the header of versions 1 to 3, in bytes.
const HEADER: usize = 16;
/// Size of the header of version 4, in bytes.
const HEADER_4: usize = 32;
/// Bit of the header's flags that marks records of vendors, which are not read.
const EXTENSIONS: u8 = 2;
/// Largest number of fractional bits of a 24-bit position.
const MAX_FRACTION: u8 = 23;

struct Header {
    version: u32,
    count: usize,
    degree: usize,
    fractional_bits: u8,
    flags: u8,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, ReadError> {
        if bytes.len() < HEADER {
            return Err(ReadError::new("header", format!("at least {HEADER} bytes"), bytes.len()));
        }
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if word(0) != MAGIC {
            return Err(ReadError::new("header", "the letters NGSP", format!("{:08x}", word(0))));
        }
        let version = word(4);
        if !(1..=4).contains(&version) {
            return Err(ReadError::new("version", "1 to 4", version));
        }
        let (degree, fractional_bits) = (usize::from(bytes[12]), bytes[13]);
        if degree > 4 {
            return Err(ReadError::new("shDegree", "0 to 4", degree));
        }
        if fractional_bits > MAX_FRACTION {
            return Err(ReadError::new("fractionalBits", format!("0 to {MAX_FRACTION}"), fractional_bits));
        }
        Ok(Self { version, count: word(8) as usize, degree, fractional_bits, flags: bytes[14] })
    }

    /// Returns the number of bytes per splat of positions, opacities, colours, scales, rotations
    /// and harmonics.
    fn strides(&self) -> [usize; 6] {
        let position = if self.version == 1 { 6 } else { 9 };
        let rotation = if self.version >= 3 { 4 } else { 3 };
        [position, 1, 3, 3, rotation, 3 * ((self.degree + 1).pow(2) - 1)]
    }
}

/// Reads an `.spz` file whose decompressed size is at most `max_bytes`.
///
/// # Errors
/// If the header is not valid, or if the data are too short or not valid.
pub fn read_spz(bytes: &[u8], max_bytes: u64) -> Result<Found, ReadError> {
    // Versions 1 to 3 are one gzip stream: the header, then the attributes one after another.
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut unpacked = MultiGzDecoder::new(bytes);
        let start = read_up_to(&mut unpacked, HEADER as u64, "header")?;
        let header = Header::parse(&start)?;
        if header.version > 3 {
            return Err(ReadError::new("version", "1 to 3 in a gzip stream", header.version));
        }
        let strides = header.strides();
        let wanted = size(strides.iter().sum(), &header, max_bytes)?;
        let data = read_up_to(&mut unpacked, wanted, "gzip stream")?;
        if (data.len() as u64) < wanted {
            return Err(ReadError::new(
                "gzip stream",
                format!("{wanted} bytes for {} splats", header.count),
                data.len(),
            ));
        }
        let mut rest = data.as_slice();
        let parts = strides.map(|stride| {
            let (part, after) = rest.split_at(stride * header.count);
            rest = after;
            part
        });
        return splats(&header, parts);
    }
    // Version 4 has an uncompressed header, a table of sizes, and a Zstandard stream per attribute.
    let header = Header::parse(bytes)?;
    if header.version < 4 || bytes.len() < HEADER_4 {
        return Err(ReadError::new(
            "header",
            "version 4 in a header of 32 bytes, or a gzip stream",
            format!("version {}", header.version),
        ));
    }
    let streams = usize::from(bytes[15]);
    let table = u32::from_le_bytes([bytes[16], bytes[17], bytes[18], bytes[19]]) as usize;
    let strides = header.strides();
    let needed = if header.degree == 0 { 5 } else { 6 };
    if streams < needed {
        return Err(ReadError::new(
            "numStreams",
            format!("at least {needed} streams for degree {}", header.degree),
            streams,
        ));
    }
    let room = || ReadError::new("tocByteOffset", format!("a table of {streams} streams inside the file"), table);
    let entries = bytes.get(table..).and_then(|rest| rest.get(..16 * streams)).ok_or_else(room)?;
    let mut rest = &bytes[table + 16 * streams..];
    size(strides.iter().sum(), &header, max_bytes)?;
    // Decompress each stream to the size that the number of splats requires.
    let mut parts: Vec<Vec<u8>> = Vec::new();
    for (number, entry) in entries.chunks_exact(16).take(6).enumerate() {
        let (packed, unpacked) = entry.split_at(8);
        let long = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap_or_default());
        let place = format!("stream {number}");
        let wanted = (strides[number] * header.count) as u64;
        if long(unpacked) != wanted {
            return Err(ReadError::new(place, format!("{wanted} bytes for {} splats", header.count), long(unpacked)));
        }
        let length = usize::try_from(long(packed)).ok().filter(|length| *length <= rest.len());
        let length =
            length.ok_or_else(|| ReadError::new(&place, format!("at most {} bytes", rest.len()), long(packed)))?;
        let (stream, after) = rest.split_at(length);
        rest = after;
        if wanted == 0 {
            parts.push(Vec::new());
            continue;
        }
        let mut decoder =
            StreamingDecoder::new(stream).map_err(|error| ReadError::new(&place, "a zstd stream", error))?;
        let part = read_up_to(&mut decoder, wanted, &place)?;
        if (part.len() as u64) < wanted {
            return Err(ReadError::new(place, format!("{wanted} bytes"), part.len()));
        }
        parts.push(part);
    }
    parts.resize(6, Vec::new());
    let mut found = splats(&header, [0, 1, 2, 3, 4, 5].map(|i| parts[i].as_slice()))?;
    if header.flags & EXTENSIONS != 0 {
        found
            .left_out
            .push("the header contains records of a vendor, which are not supported; the file's axes are assumed to point right, up and back".into());
    }
    Ok(found)
}

/// Returns the size of all splats after decompression, in bytes; an error if it exceeds
/// `max_bytes`.
fn size(stride: usize, header: &Header, max_bytes: u64) -> Result<u64, ReadError> {
    let bytes = stride as u64 * header.count as u64;
    if bytes > max_bytes {
        let expected = format!("splats of at most {} MiB", max_bytes >> 20);
        return Err(ReadError::new("numPoints", expected, format!("{} ({} MiB)", header.count, bytes >> 20)));
    }
    Ok(bytes)
}

/// Reads at most `most` bytes. Memory grows with the data that exists, not with the size that a
/// header states.
fn read_up_to(from: &mut impl Read, most: u64, place: &str) -> Result<Vec<u8>, ReadError> {
    let mut bytes = Vec::new();
    from.take(most).read_to_end(&mut bytes).map_err(|error| ReadError::new(place, "packed data", error))?;
    Ok(bytes)
}

fn splats(header: &Header, parts: [&[u8]; 6]) -> Result<Found, ReadError> {
    let [positions, opacities, colours, scales, rotations, harmonics] = parts;
    let [position, _, _, _, rotation, harmonic] = header.strides();
    let degree = header.degree.min(MAX_DEGREE);
    let mut cloud = cloud("splats", header.count, degree);
    // Positions are half floats in version 1, and fixed-point numbers in later versions.
    let unit =
        1.0 / f32::from(1u8 << (header.fractional_bits % 8)) / 256f32.powi(i32::from(header.fractional_bits / 8));
    let fixed = |bytes: &[u8]| (i32::from_le_bytes([0, bytes[0], bytes[1], bytes[2]]) >> 8) as f32 * unit;
    let half = |bytes: &[u8]| float_from_half(u16::from_le_bytes([bytes[0], bytes[1]]));
    for i in 0..header.count {
        let bytes = &positions[i * position..][..position];
        let at = |axis: usize| if header.version == 1 { half(&bytes[2 * axis..]) } else { fixed(&bytes[3 * axis..]) };
        cloud.positions.push(Vec3::from([0, 1, 2].map(at)));
        cloud.opacities.push(f32::from(opacities[i]) / 255.0);
        let byte = |of: &[u8], channel: usize| f32::from(of[3 * i + channel]);
        cloud.harmonics.extend([0, 1, 2].map(|channel| (byte(colours, channel) / 255.0 - 0.5) / 0.15));
        cloud.scales.push(exp(Vec3::from([0, 1, 2].map(|axis| byte(scales, axis) / 16.0 - 10.0))));
        let bytes = &rotations[i * rotation..][..rotation];
        cloud.rotations.push(if header.version >= 3 { smallest_three(bytes) } else { first_three(bytes) });
        let own = &harmonics[i * harmonic..][..3 * ((degree + 1).pow(2) - 1)];
        cloud.harmonics.extend(own.iter().map(|byte| (f32::from(*byte) - 128.0) / 128.0));
    }
    let mut left_out = Vec::new();
    if header.degree > MAX_DEGREE {
        left_out.push(format!(
            "the harmonics have degree {}, but degree {MAX_DEGREE} is the highest that is rendered; higher degrees are left out",
            header.degree
        ));
    }
    Ok(Found { cloud, axes: Axes::RightUpBack, left_out })
}

/// Reads a rotation of 32 bits. The upper two bits are the index of the largest component. Ten bits
/// follow for each other component, with the sign first.
fn smallest_three(bytes: &[u8]) -> Quat {
    let word = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let part = |shift: u32| {
        let bits = word >> shift;
        let size = (bits & 0x1ff) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        if bits & 0x200 == 0 { size } else { -size }
    };
    Quat::from_array(from_smallest_three([part(20), part(10), part(0)], (word >> 30) as usize))
}

/// Reads a rotation of three bytes: x, y and z. The component w is positive and makes the length 1.
fn first_three(bytes: &[u8]) -> Quat {
    let rest = [0, 1, 2].map(|axis: usize| f32::from(bytes[axis]) / 127.5 - 1.0);
    Quat::from_array(from_smallest_three(rest, 3))
}
