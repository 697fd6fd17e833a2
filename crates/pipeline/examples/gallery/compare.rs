//! Compares two renders of one view, by scores in linear light and by pictures. The pictures have
//! the exposure and tone curve that a job would choose for our render by default.
//!
//! Our render o and the other render p have two halves a and b each, with independent noise.
//! Therefore the noise cancels in the mean of the product (o_a − p_a)(o_b − p_b). This mean is the
//! squared difference of the two renders without noise.

use std::path::Path;

use image::{Rgb, RgbImage};
use lumistack_core::colour::{luminance, srgb_code};
use lumistack_core::tone::ToneCurve;
use lumistack_field_io::npy;
use lumistack_field_io::picture::Picture;

use crate::{Outcome, text};

/// Factor by which the difference picture amplifies differences.
pub const GAIN: f32 = 4.0;

/// A view rendered twice with independent noise: `[row][col][rgb]`, scene-linear.
pub struct Halves {
    size: [usize; 2],
    halves: [Vec<f32>; 2],
    /// For each pixel, true if a surface covers more than half of it.
    covered: Vec<bool>,
}

/// Scores of a pair of renders.
pub struct Figures {
    /// Mean of our render divided by the mean of Blender's render, per channel. Both means are over
    /// the pixels that a surface covers in at least one of the renders.
    pub ratio: [f64; 3],
    /// Root mean square of the difference of the two renders, with the noise removed. It is divided
    /// by the mean of Blender's render, over the same pixels as `ratio`.
    pub difference: f64,
    /// The same value as `difference`, but with the noise of both renders.
    pub with_noise: f64,
    /// Overlap of the pixels that surfaces cover, 0..1. It is the number of pixels covered in both
    /// renders, divided by the number of pixels covered in at least one render.
    pub overlap: f64,
    /// Centroid of the covered pixels of our render minus the centroid in Blender's render, pixels
    /// (right, down).
    pub shift: [f64; 2],
}

impl Halves {
    /// Reads the pictures `<stem>-a.exr` and `<stem>-b.exr` and the mask.
    pub fn read(folder: &Path, stem: &str, mask: &str) -> Outcome<Self> {
        let half = |which: &str| Picture::read(&folder.join(format!("{stem}-{which}.exr"))).map_err(text);
        let (a, b) = (half("a")?, half("b")?);
        let size = a.size();
        let (_, covered) = npy::read(&folder.join(mask)).map_err(text)?;
        let covered = covered.into_iter().map(|share| share > 0.5).collect();
        Ok(Self { size, halves: [a.into_linear(), b.into_linear()], covered })
    }

    /// Returns the mean of both halves.
    pub fn mean(&self) -> Vec<f32> {
        self.halves[0].iter().zip(&self.halves[1]).map(|(a, b)| 0.5 * (a + b)).collect()
    }

    fn display_referred(&self, tone_mapping: &ToneMapping) -> Vec<[f32; 3]> {
        let exposed = |value: f32| (f64::from(value) * tone_mapping.exposure) as f32;
        self.mean().chunks_exact(3).map(|rgb| tone_mapping.curve.apply([rgb[0], rgb[1], rgb[2]].map(exposed))).collect()
    }

    /// Returns the picture after exposure and tone curve, in sRGB codes.
    pub fn shown(&self, tone_mapping: &ToneMapping) -> RgbImage {
        let codes = self.display_referred(tone_mapping).into_iter().flatten().map(srgb_code).collect();
        RgbImage::from_raw(self.size[0] as u32, self.size[1] as u32, codes).expect("a value for every pixel")
    }
}

/// Exposure and tone curve of both pictures.
pub struct ToneMapping {
    /// Factor on radiance.
    pub exposure: f64,
    /// Tone curve, applied after the exposure.
    pub curve: ToneCurve,
}

/// Computes the scores of a pair of renders.
pub fn figures(ours: &Halves, other: &Halves) -> Figures {
    // Pixels that show only the environment in both renders are excluded from scores.
    let (o, p) = (ours.mean(), other.mean());
    let either = |i: usize| ours.covered[i] || other.covered[i];
    let pixels: Vec<usize> = (0..ours.covered.len()).filter(|&i| either(i)).collect();
    let sum = |values: &[f32], c: usize| pixels.iter().map(|&i| f64::from(values[3 * i + c])).sum::<f64>();
    let ratio = [0, 1, 2].map(|c| sum(&o, c) / sum(&p, c));
    let mean = (0..3).map(|c| sum(&p, c)).sum::<f64>() / (3 * pixels.len()).max(1) as f64;
    // The product of the halves' differences estimates the squared difference without noise.
    let (mut clean, mut noisy) = (0.0, 0.0);
    for &i in &pixels {
        for k in 3 * i..3 * i + 3 {
            let [a, b] = [0, 1].map(|h| f64::from(ours.halves[h][k] - other.halves[h][k]));
            clean += a * b;
            noisy += (0.5 * (a + b)).powi(2);
        }
    }
    let relative = |sum: f64| (sum.max(0.0) / (3 * pixels.len()).max(1) as f64).sqrt() / mean;
    let both = pixels.iter().filter(|&&i| ours.covered[i] && other.covered[i]).count();
    // Compute the centroid of each render's covered pixels. A difference shows a shift of the
    // camera.
    let centre = |covered: &[bool]| {
        let (mut at, mut count) = ([0.0; 2], 0.0);
        for i in (0..covered.len()).filter(|&i| covered[i]) {
            at[0] += (i % ours.size[0]) as f64;
            at[1] += (i / ours.size[0]) as f64;
            count += 1.0;
        }
        at.map(|sum| sum / count)
    };
    let (a, b) = (centre(&ours.covered), centre(&other.covered));
    Figures {
        ratio,
        difference: relative(clean),
        with_noise: relative(noisy),
        overlap: both as f64 / pixels.len() as f64,
        shift: [a[0] - b[0], a[1] - b[1]],
    }
}

/// Draws the difference of luminance times [`GAIN`]: orange where our render is brighter, blue
/// where it is darker.
pub fn difference(ours: &Halves, other: &Halves, tone_mapping: &ToneMapping) -> RgbImage {
    let [cols, rows] = ours.size;
    let (o, p) = (ours.display_referred(tone_mapping), other.display_referred(tone_mapping));
    RgbImage::from_fn(cols as u32, rows as u32, |x, y| {
        let i = y as usize * cols + x as usize;
        let d = GAIN * (luminance(o[i]) - luminance(p[i]));
        let tint = if d > 0.0 { [1.0, 0.45, 0.05] } else { [0.05, 0.35, 1.0] };
        Rgb(tint.map(|t| srgb_code(t * d.abs())))
    })
}
