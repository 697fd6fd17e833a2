//! SOG, versions 1 and 2: attributes as pictures, one pixel per splat, described by `meta.json`.
//!
//! ```text
//! means    n in 16 bits of two pictures, from min to max; position = sign(n) (e^|n| − 1)
//! scales   logarithms, from min to max or by a codebook
//! quats    three smallest components as bytes; alpha − 252 is the index of the largest
//! sh0      constant harmonics; alpha is the opacity (version 1: its logit)
//! shN      index of 16 bits into a picture of harmonics
//! ```

use std::io::{Cursor, Read};

use glam::{Quat, Vec3};
use serde::Deserialize;

use super::found::{Axes, Found, MAX_BYTES, ReadError, cloud, degree_of, exp, from_smallest_three, sigmoid};

/// Largest size of a file in a `.sog` archive, in bytes.
const MAX_PICTURE: u64 = 1 << 30;
/// Number of palette entries in a row of the picture of harmonics.
const PER_ROW: usize = 64;

#[derive(Deserialize)]
struct Meta {
    #[serde(default)]
    version: u32,
    #[serde(default)]
    count: Option<usize>,
    means: Part,
    scales: Part,
    quats: Part,
    sh0: Part,
    #[serde(rename = "shN", default)]
    shn: Option<Part>,
}

#[derive(Deserialize)]
struct Part {
    #[serde(default)]
    shape: Vec<usize>,
    #[serde(default)]
    mins: Numbers,
    #[serde(default)]
    maxs: Numbers,
    #[serde(default, deserialize_with = "codebook")]
    codebook: Vec<f32>,
    files: Vec<String>,
}

/// Reads a codebook. Some files have null as the first number c₀. Then c₀ lies about one mean
/// step below c₁: c₀ = c₁ + (c₁ − c₂₅₅) / 255, as in the engine PlayCanvas.
fn codebook<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<f32>, D::Error> {
    let mut book = Vec::<Option<f32>>::deserialize(deserializer)?;
    if let [first @ None, Some(next), .., Some(last)] = book.as_mut_slice() {
        *first = Some(*next + (*next - *last) / 255.0);
    }
    let number = |value: Option<f32>| value.ok_or_else(|| serde::de::Error::custom("expected a number, found null"));
    book.into_iter().map(number).collect()
}

/// Bounds: one number for all channels, or one number per channel.
#[derive(Default, Deserialize)]
#[serde(untagged)]
enum Numbers {
    #[default]
    None,
    One(f32),
    Each(Vec<f32>),
}

impl Numbers {
    fn get(&self, channel: usize) -> Option<f32> {
        match self {
            Self::None => None,
            Self::One(value) => Some(*value),
            Self::Each(values) => values.get(channel).copied(),
        }
    }
}

/// A decoded picture: `[row][col][rgba]`.
struct Texels {
    width: usize,
    rgba: Vec<u8>,
}

impl Texels {
    fn at(&self, i: usize) -> [u8; 4] {
        let texel = &self.rgba[4 * i..4 * i + 4];
        [texel[0], texel[1], texel[2], texel[3]]
    }
}

/// Maps a channel's bytes to values, linearly between two bounds or by a codebook.
enum Values<'a> {
    Range(f32, f32),
    Book(&'a [f32]),
}

impl Values<'_> {
    fn of(&self, byte: u8) -> f32 {
        match self {
            Self::Range(low, high) => low + f32::from(byte) / 255.0 * (high - low),
            Self::Book(book) => book[usize::from(byte)],
        }
    }
}

impl Part {
    fn values(&self, name: &str, channel: usize) -> Result<Values<'_>, ReadError> {
        if !self.codebook.is_empty() {
            if self.codebook.len() < 256 {
                return Err(ReadError::new(format!("/{name}/codebook"), "256 numbers", self.codebook.len()));
            }
            return Ok(Values::Book(&self.codebook));
        }
        let missing = || ReadError::new(format!("/{name}"), "mins and maxs, or a codebook", "neither");
        Ok(Values::Range(self.mins.get(channel).ok_or_else(missing)?, self.maxs.get(channel).ok_or_else(missing)?))
    }

    fn picture(
        &self,
        name: &str,
        number: usize,
        beside: &dyn Fn(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Texels, ReadError> {
        let place = format!("/{name}/files/{number}");
        let file = self.files.get(number).ok_or_else(|| ReadError::new(&place, "the name of a picture", "none"))?;
        let bytes =
            beside(file).map_err(|error| ReadError::new(&place, "a readable file", format!("{file}: {error}")))?;
        let broken = |error: image::ImageError| ReadError::new(&place, "a picture", format!("{file}: {error}"));
        let mut reader = image::ImageReader::new(Cursor::new(bytes.as_slice()));
        reader = reader.with_guessed_format().map_err(|error| ReadError::new(&place, "a picture", error))?;
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(2 * MAX_PICTURE);
        reader.limits(limits);
        let picture = reader.decode().map_err(broken)?.into_rgba8();
        Ok(Texels { width: picture.width() as usize, rgba: picture.into_raw() })
    }
}

/// Reads a `.sog` file, which is a zip archive of `meta.json` and its pictures.
pub(super) fn read_bundle(bytes: &[u8]) -> Result<Found, ReadError> {
    let open = || zip::ZipArchive::new(Cursor::new(bytes));
    open().map_err(|error| ReadError::new("zip", "an archive", error))?;
    let file = |name: &str| -> Result<Vec<u8>, String> {
        let mut archive = open().map_err(|error| error.to_string())?;
        let mut file = archive.by_name(name).map_err(|error| error.to_string())?;
        let mut bytes = Vec::new();
        file.by_ref().take(MAX_PICTURE).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
        Ok(bytes)
    };
    let meta = file("meta.json").map_err(|error| ReadError::new("zip", "a file meta.json", error))?;
    read(&meta, &file)
}

/// Reads `meta.json` and the pictures that it names.
pub(super) fn read(meta: &[u8], beside: &dyn Fn(&str) -> Result<Vec<u8>, String>) -> Result<Found, ReadError> {
    // The number of splats determines the memory of the cloud, so it is checked first.
    let meta: Meta =
        serde_json::from_slice(meta).map_err(|error| ReadError::new("meta.json", "the description of a SOG", error))?;
    let count = meta.count.or(meta.means.shape.first().copied());
    let count = count.ok_or_else(|| ReadError::new("/count", "the number of splats", "none"))?;
    if count as u64 * 64 > MAX_BYTES {
        return Err(ReadError::new("/count", format!("at most {} splats", MAX_BYTES / 64), count));
    }
    // Decode the pictures; each must have a pixel per splat.
    let enough = |texels: Texels, name: &str| {
        if texels.rgba.len() / 4 < count {
            return Err(ReadError::new(format!("/{name}"), format!("{count} pixels"), texels.rgba.len() / 4));
        }
        Ok(texels)
    };
    let low = enough(meta.means.picture("means", 0, beside)?, "means")?;
    let high = enough(meta.means.picture("means", 1, beside)?, "means")?;
    let scales = enough(meta.scales.picture("scales", 0, beside)?, "scales")?;
    let quats = enough(meta.quats.picture("quats", 0, beside)?, "quats")?;
    let sh0 = enough(meta.sh0.picture("sh0", 0, beside)?, "sh0")?;
    // Bounds and codebooks convert bytes to values.
    let three = |part: &'_ Part, name: &str| -> Result<Vec<(f32, f32)>, ReadError> {
        let missing = || ReadError::new(format!("/{name}"), "mins and maxs of three axes", "fewer axes");
        (0..3).map(|axis| Some((part.mins.get(axis)?, part.maxs.get(axis)?))).collect::<Option<_>>().ok_or_else(missing)
    };
    let means = three(&meta.means, "means")?;
    let of_scales =
        [meta.scales.values("scales", 0)?, meta.scales.values("scales", 1)?, meta.scales.values("scales", 2)?];
    let of_sh0 = [meta.sh0.values("sh0", 0)?, meta.sh0.values("sh0", 1)?, meta.sh0.values("sh0", 2)?];
    let of_opacity = if meta.version < 2 { Some(meta.sh0.values("sh0", 3)?) } else { None };
    let palette = meta.shn.as_ref().map(|part| Palette::read(part, count, beside)).transpose()?;
    let degree = palette.as_ref().map_or(0, |palette| palette.degree);
    let mut cloud = cloud("splats", count, degree);
    for i in 0..count {
        // positions are logarithmic, so they are finer near the origin
        let (l, h) = (low.at(i), high.at(i));
        cloud.positions.push(Vec3::from([0, 1, 2].map(|axis: usize| {
            let n = f32::from(u16::from_le_bytes([l[axis], h[axis]])) / 65535.0;
            let n = means[axis].0 + n * (means[axis].1 - means[axis].0);
            n.signum() * n.abs().exp_m1()
        })));
        let bytes = scales.at(i);
        cloud.scales.push(exp(Vec3::from([0, 1, 2].map(|axis: usize| of_scales[axis].of(bytes[axis])))));
        let [a, b, c, largest] = quats.at(i);
        // Alpha states the largest component, whose value follows from the other three.
        let Some(largest) = largest.checked_sub(252) else {
            return Err(ReadError::new(format!("/quats, splat {i}"), "alpha from 252 to 255", largest));
        };
        let rest = [a, b, c].map(|byte| (f32::from(byte) / 255.0 - 0.5) * std::f32::consts::SQRT_2);
        let [w, x, y, z] = from_smallest_three(rest, usize::from(largest));
        cloud.rotations.push(Quat::from_xyzw(x, y, z, w));
        let bytes = sh0.at(i);
        cloud.harmonics.extend([0, 1, 2].map(|channel: usize| of_sh0[channel].of(bytes[channel])));
        cloud.opacities.push(match &of_opacity {
            Some(logit) => sigmoid(logit.of(bytes[3])),
            None => f32::from(bytes[3]) / 255.0,
        });
        if let Some(palette) = &palette {
            palette.extend(&mut cloud.harmonics, i);
        }
    }
    Ok(Found { cloud, axes: Axes::RightDownFront, left_out: Vec::new() })
}

/// Harmonics above degree 0, in a palette. Each splat has a label, which is the index of its entry
/// in the palette.
struct Palette<'a> {
    degree: usize,
    coefficients: usize,
    centroids: Texels,
    labels: Texels,
    values: [Values<'a>; 3],
}

impl<'a> Palette<'a> {
    fn read(part: &'a Part, count: usize, beside: &dyn Fn(&str) -> Result<Vec<u8>, String>) -> Result<Self, ReadError> {
        let (centroids, labels) = (part.picture("shN", 0, beside)?, part.picture("shN", 1, beside)?);
        let coefficients = centroids.width / PER_ROW;
        let degree = centroids.width.is_multiple_of(PER_ROW).then(|| degree_of(coefficients)).flatten();
        let degree = degree
            .ok_or_else(|| ReadError::new("/shN/files/0", "a picture 192, 512 or 960 pixels wide", centroids.width))?;
        let values = [part.values("shN", 0)?, part.values("shN", 1)?, part.values("shN", 2)?];
        if labels.rgba.len() / 4 < count {
            return Err(ReadError::new("/shN/files/1", format!("{count} pixels"), labels.rgba.len() / 4));
        }
        let palette = Self { degree, coefficients, centroids, labels, values };
        // labels are checked here, so that `extend` can use them as indices
        let entries = palette.centroids.rgba.len() / 4 / coefficients.max(1);
        match (0..count).map(|i| palette.label(i)).find(|label| *label >= entries) {
            Some(label) => Err(ReadError::new("/shN/files/1", format!("labels below {entries}"), label)),
            None => Ok(palette),
        }
    }

    fn label(&self, i: usize) -> usize {
        let [low, high, ..] = self.labels.at(i);
        usize::from(u16::from_le_bytes([low, high]))
    }

    fn extend(&self, harmonics: &mut Vec<f32>, i: usize) {
        let label = self.label(i);
        let first = label / PER_ROW * self.centroids.width + label % PER_ROW * self.coefficients;
        for coefficient in 0..self.coefficients {
            let bytes = self.centroids.at(first + coefficient);
            harmonics.extend([0, 1, 2].map(|channel: usize| self.values[channel].of(bytes[channel])));
        }
    }
}
