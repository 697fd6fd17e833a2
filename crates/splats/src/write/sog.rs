//! Writer of SOG, version 2: pictures whose bytes are indices into codebooks.

use std::io::{Cursor, Error, ErrorKind, Result};

use image::{ImageFormat, Rgba, RgbaImage};
use lumistack_scene::Cloud;
use serde_json::json;

/// Largest number of entries of the palette of harmonics.
const MOST: usize = 1 << 16;
/// Number of entries per row of the palette's picture.
const PER_ROW: usize = 64;

/// Returns the files of a SOG of version 2, with their names; `meta.json` is the first.
///
/// All colours share 256 values, and so do all scales. Positions have 2¹⁶ values per axis.
///
/// # Errors
/// If the cloud is empty, if it has harmonics above degree 0 and more than 65,536 splats, or if the
/// compressor fails.
pub fn sog(cloud: &Cloud) -> Result<Vec<(String, Vec<u8>)>> {
    if cloud.is_empty() || (cloud.degree > 0 && cloud.len() > MOST) {
        let expected = format!(
            "SOG: expected at least one splat, and at most {MOST} if harmonics exceed degree 0, found {}",
            cloud.len()
        );
        return Err(Error::new(ErrorKind::InvalidInput, expected));
    }
    let side = (cloud.len() as f64).sqrt().ceil() as u32;
    let picture = |texel: &dyn Fn(usize) -> [u8; 4]| {
        encoded(&RgbaImage::from_fn(side, side, |x, y| {
            let i = (y * side + x) as usize;
            Rgba(if i < cloud.len() { texel(i) } else { [0; 4] })
        }))
    };
    // Store positions in a logarithmic scale, which is finer near the origin, in 16 bits between
    // their bounds.
    let places: Vec<[f32; 3]> =
        cloud.positions.iter().map(|at| at.to_array().map(|x| x.signum() * x.abs().ln_1p())).collect();
    let ends = [0, 1, 2].map(|axis: usize| {
        let along = places.iter().map(|place| place[axis]);
        (along.clone().fold(f32::INFINITY, f32::min), along.fold(f32::NEG_INFINITY, f32::max))
    });
    let steps = |i: usize| {
        [0, 1, 2].map(|axis: usize| {
            let (low, high) = ends[axis];
            let share = (places[i][axis] - low) / (high - low).max(f32::MIN_POSITIVE);
            ((65535.0 * share).round() as u16).to_le_bytes()
        })
    };
    // Scales and colours are indices into codebooks.
    let byte = |value: f32| (255.0 * value).round().clamp(0.0, 255.0) as u8;
    let values = 3 * cloud.coefficients();
    let logs = |i: usize| cloud.scales[i].to_array().map(f32::ln);
    let of_scales = Book::of((0..cloud.len()).flat_map(logs));
    let of_colours = Book::of((0..cloud.len()).flat_map(|i| cloud.harmonics[values * i..][..3].iter().copied()));
    let mut meta = json!({
        "version": 2,
        "count": cloud.len(),
        "means": {"mins": ends.map(|end| end.0), "maxs": ends.map(|end| end.1), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": of_scales.0, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": of_colours.0, "files": ["sh0.webp"]},
    });
    // Make a picture per attribute, and two for positions, one for each byte.
    let part = |half: usize| move |i: usize| steps(i).map(|step| step[half]);
    let opaque = |[x, y, z]: [u8; 3]| [x, y, z, 255];
    let colour = |i: usize| {
        let [r, g, b] = [0, 1, 2].map(|c: usize| of_colours.byte(cloud.harmonics[values * i + c]));
        [r, g, b, byte(cloud.opacities[i])]
    };
    let mut files = vec![
        ("means_l.webp", picture(&|i| opaque(part(0)(i)))?),
        ("means_u.webp", picture(&|i| opaque(part(1)(i)))?),
        ("scales.webp", picture(&|i| opaque(logs(i).map(|log| of_scales.byte(log))))?),
        ("quats.webp", picture(&|i| smallest_three(cloud.rotations[i]))?),
        ("sh0.webp", picture(&colour)?),
    ];
    // Harmonics above degree 0 become a palette, and each splat has the label of its entry.
    if cloud.degree > 0 {
        let own = |i: usize| &cloud.harmonics[values * i + 3..values * (i + 1)];
        let book = Book::of((0..cloud.len()).flat_map(|i| own(i).iter().copied()));
        let coefficients = cloud.coefficients() - 1;
        let size = [(PER_ROW * coefficients) as u32, cloud.len().div_ceil(PER_ROW) as u32];
        let centroids = RgbaImage::from_fn(size[0], size[1], |x, y| {
            let (label, k) = (y as usize * PER_ROW + x as usize / coefficients, x as usize % coefficients);
            let texel = |c: usize| if label < cloud.len() { book.byte(own(label)[3 * k + c]) } else { 0 };
            Rgba(opaque([0, 1, 2].map(texel)))
        });
        meta["shN"] = json!({"count": cloud.len(), "bands": cloud.degree, "codebook": book.0, "files": ["shN_centroids.webp", "shN_labels.webp"]});
        files.push(("shN_centroids.webp", encoded(&centroids)?));
        files.push(("shN_labels.webp", picture(&|i| [i as u8, (i >> 8) as u8, 0, 255])?));
    }
    let named = files.into_iter().map(|(name, bytes)| (name.to_owned(), bytes));
    Ok(std::iter::once(("meta.json".to_owned(), meta.to_string().into_bytes())).chain(named).collect())
}

/// A codebook: 256 values in increasing order, one for each value of a byte. The last value may
/// repeat.
struct Book(Vec<f32>);

impl Book {
    /// Makes a codebook of the given values. If more than 256 of them differ, the codebook has even
    /// steps between the bounds.
    fn of(values: impl Iterator<Item = f32>) -> Self {
        let mut all: Vec<f32> = values.collect();
        all.sort_unstable_by(f32::total_cmp);
        all.dedup();
        let (low, high) = (all[0], all[all.len() - 1]);
        if all.len() <= 256 {
            all.resize(256, high);
            return Self(all);
        }
        Self((0..256).map(|i| low + (high - low) * i as f32 / 255.0).collect())
    }

    /// Returns the index of the codebook's value that is nearest to `value`.
    fn byte(&self, value: f32) -> u8 {
        let above = self.0.partition_point(|known| *known < value).min(255);
        let below = above.saturating_sub(1);
        if value - self.0[below] < self.0[above] - value { below as u8 } else { above as u8 }
    }
}

/// Packs a rotation: a byte for each of w, x, y and z except the largest, and 252 plus the index of
/// the largest.
fn smallest_three(rotation: glam::Quat) -> [u8; 4] {
    let [x, y, z, w] = rotation.normalize().to_array();
    let parts = [w, x, y, z];
    let largest = (0..4).fold(0, |best, k| if parts[k].abs() > parts[best].abs() { k } else { best });
    let mut bytes = [0, 0, 0, 252 + largest as u8];
    for (to, k) in (0..4).filter(|k| *k != largest).enumerate() {
        let part = parts[k] * parts[largest].signum() / std::f32::consts::SQRT_2 + 0.5;
        bytes[to] = (255.0 * part).round().clamp(0.0, 255.0) as u8;
    }
    bytes
}

fn encoded(picture: &RgbaImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::WebP).map_err(Error::other)?;
    Ok(bytes.into_inner())
}
