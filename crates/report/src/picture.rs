//! Pictures of the page. Converts linear light to 8-bit sRGB, draws maps of signed differences,
//! reduces pictures, and makes data URIs.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageResult};
use lumistack_core::colour::srgb_code;

/// Linear RGB, `[row][col][rgb]`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Linear {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) data: Vec<f32>,
}

/// 8-bit RGB, ready to encode.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Picture {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) rgb: Vec<u8>,
}

/// A picture as text for an `<img>`.
#[derive(Clone, Debug)]
pub(crate) struct Embedded {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) uri: String,
}

/// File format of an embedded picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Encoding {
    /// Lossless; used for small groups of pictures.
    Png,
    /// Lossy, without chroma subsampling; used for large pictures.
    Jpeg,
}

/// At this JPEG quality, block artefacts are far smaller than the errors of a display.
const JPEG_QUALITY: u8 = 90;

/// A group of pictures with at most this many pixels in total is encoded without loss. Pictures of
/// noise compress worst: a group of this size takes 4 MB of the report's text.
const LOSSLESS_PIXELS: usize = 1_000_000;

impl Encoding {
    /// Returns the encoding of a group of pictures with this total number of pixels.
    pub(crate) fn for_pixels(pixels: usize) -> Self {
        if pixels <= LOSSLESS_PIXELS { Self::Png } else { Self::Jpeg }
    }
}

impl Linear {
    /// Makes a picture of the given shape, whose values are `data` times `scale`.
    pub(crate) fn new(rows: usize, cols: usize, data: &[f32], scale: f32) -> Self {
        Self { rows, cols, data: data.iter().map(|value| value * scale).collect() }
    }

    /// Replaces every block of `factor` × `factor` pixels by its mean, in linear light. Blocks at
    /// the right and bottom borders may be smaller.
    pub(crate) fn shrunk(&self, factor: usize) -> Self {
        if factor <= 1 {
            return self.clone();
        }
        let (rows, cols) = (self.rows.div_ceil(factor), self.cols.div_ceil(factor));
        let mut data = Vec::with_capacity(rows * cols * 3);
        for row in 0..rows {
            let block_rows = row * factor..((row + 1) * factor).min(self.rows);
            for col in 0..cols {
                let block_cols = col * factor..((col + 1) * factor).min(self.cols);
                let mut sum = [0.0f32; 3];
                for r in block_rows.clone() {
                    for pixel in
                        self.data[(r * self.cols + block_cols.start) * 3..][..block_cols.len() * 3].chunks_exact(3)
                    {
                        (0..3).for_each(|c| sum[c] += pixel[c]);
                    }
                }
                data.extend(sum.map(|sum| sum / (block_rows.len() * block_cols.len()) as f32));
            }
        }
        Self { rows, cols, data }
    }

    /// Returns the section that begins at (row, col). It has at most `rows` × `cols` pixels.
    pub(crate) fn cropped(&self, row: usize, col: usize, rows: usize, cols: usize) -> Self {
        let (rows, cols) = (rows.min(self.rows - row), cols.min(self.cols - col));
        let lines = (row..row + rows).flat_map(|r| &self.data[(r * self.cols + col) * 3..][..cols * 3]);
        Self { rows, cols, data: lines.copied().collect() }
    }

    /// Returns the green channel as grey.
    pub(crate) fn green(&self) -> Self {
        Self { data: self.data.chunks_exact(3).flat_map(|rgb| [rgb[1]; 3]).collect(), ..*self }
    }

    /// Maps `low` to 0 and `high` to 1, where `low` < `high`.
    pub(crate) fn stretched(&self, [low, high]: [f32; 2]) -> Self {
        Self { data: self.data.iter().map(|value| (value - low) / (high - low)).collect(), ..*self }
    }

    /// Clamps the picture to 0..1 and encodes it as sRGB.
    pub(crate) fn encoded(&self) -> Picture {
        Picture { rows: self.rows, cols: self.cols, rgb: self.data.iter().map(|value| srgb_code(*value)).collect() }
    }
}

/// Returns the signed error of every pixel in linear light: simulated minus target, in the channel
/// with the largest error. `None` for rays that scores exclude.
pub(crate) fn signed_error(simulated: &[f32], target: &[f32], counts: impl Fn(usize) -> bool) -> Vec<Option<f32>> {
    let pixels = simulated.chunks_exact(3).zip(target.chunks_exact(3)).enumerate();
    pixels
        .map(|(i, (simulated, target))| {
            let errors = (0..3).map(|c| simulated[c] - target[c]);
            counts(i).then(|| errors.fold(0.0, |worst: f32, e| if e.abs() > worst.abs() { e } else { worst }))
        })
        .collect()
}

/// Returns the largest amplification of 1, 2, 5, 10, ... for which 99 of 100 errors stay within the
/// range of the colours. Returns 1 if there is none.
pub(crate) fn amplification<'a>(errors: impl Iterator<Item = &'a Option<f32>>) -> u32 {
    /// If the errors are smaller than this value, they are amplified as if they had this value, so
    /// that noise does not fill the picture.
    const SMALLEST: f32 = 1e-4;
    let mut sizes: Vec<f32> = errors.flatten().map(|e| e.abs()).filter(|e| e.is_finite()).collect();
    if sizes.is_empty() {
        return 1;
    }
    let index = (sizes.len() - 1) * 99 / 100;
    let (_, percentile, _) = sizes.select_nth_unstable_by(index, f32::total_cmp);
    let room = 1.0 / percentile.max(SMALLEST);
    let steps = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
    steps.into_iter().rev().find(|step| *step as f32 <= room).unwrap_or(1)
}

/// Colours of [`difference`], from −1 (too dark) through 0 to +1 (too bright). They can be
/// distinguished without red-green vision.
pub(crate) const DIVERGING: [[u8; 3]; 5] =
    [[20, 64, 140], [103, 163, 214], [247, 247, 244], [240, 146, 88], [158, 22, 34]];

/// Colours of a map of scores, from low to high: dark violet to yellow, with rising lightness.
pub(crate) const SEQUENTIAL: [[u8; 3]; 5] =
    [[60, 16, 88], [62, 78, 140], [38, 140, 140], [96, 196, 100], [250, 228, 60]];

/// Colours of a FLIP map, from no difference to the largest one. They are matplotlib's magma at
/// equal steps, as in the FLIP paper.
pub(crate) const MAGMA: [[u8; 3]; 9] = [
    [0, 0, 4],
    [28, 16, 68],
    [79, 18, 123],
    [129, 37, 129],
    [181, 54, 122],
    [229, 80, 100],
    [251, 135, 97],
    [254, 194, 135],
    [252, 253, 191],
];

/// Returns a colour of a map. `t` is clamped to 0..1, and NaN gives the middle colour.
pub(crate) fn map_colour(anchors: &[[u8; 3]], t: f32) -> [u8; 3] {
    let steps = anchors.len() - 1;
    let position = if t.is_nan() { 0.5 } else { t.clamp(0.0, 1.0) } * steps as f32;
    let first = (position as usize).min(steps - 1);
    let part = position - first as f32;
    [0, 1, 2].map(|c| {
        let (a, b) = (f32::from(anchors[first][c]), f32::from(anchors[first + 1][c]));
        (a + part * (b - a) + 0.5) as u8
    })
}

/// Draws [`signed_error`] times `amplification`.
pub(crate) fn difference(rows: usize, cols: usize, errors: &[Option<f32>], amplification: u32) -> Picture {
    mapped(rows, cols, errors, &DIVERGING, |error| 0.5 + 0.5 * error * amplification as f32)
}

/// Draws FLIP errors, 0..1.
pub(crate) fn flip_map(rows: usize, cols: usize, errors: &[Option<f32>]) -> Picture {
    mapped(rows, cols, errors, &MAGMA, |error| error)
}

/// Draws values in the colours of a map. Rays that scores exclude become a grey checkerboard.
fn mapped(
    rows: usize,
    cols: usize,
    values: &[Option<f32>],
    anchors: &[[u8; 3]],
    place: impl Fn(f32) -> f32,
) -> Picture {
    let rgb = values.iter().enumerate().flat_map(|(i, value)| match value {
        Some(value) => map_colour(anchors, place(*value)),
        None => [if (i / cols / 2 + i % cols / 2).is_multiple_of(2) { 128 } else { 148 }; 3],
    });
    Picture { rows, cols, rgb: rgb.collect() }
}

impl Picture {
    /// Replaces every block of `factor` × `factor` code values by its mean. This is for pictures
    /// that are maps of colours.
    pub(crate) fn shrunk(&self, factor: usize) -> Self {
        if factor <= 1 {
            return self.clone();
        }
        let codes = Linear { rows: self.rows, cols: self.cols, data: self.rgb.iter().map(|&v| f32::from(v)).collect() };
        let Linear { rows, cols, data } = codes.shrunk(factor);
        Self { rows, cols, rgb: data.into_iter().map(|value| (value + 0.5) as u8).collect() }
    }

    /// Encodes the picture as a data URI for a page.
    ///
    /// # Errors
    /// If the encoder refuses the size.
    pub(crate) fn embedded(&self, encoding: Encoding) -> ImageResult<Embedded> {
        let (width, height, mut bytes) = (self.cols as u32, self.rows as u32, Vec::new());
        // JPEG stores width and height in 16 bits, so a larger picture is a PNG.
        let encoding = if width.max(height) > 65_500 { Encoding::Png } else { encoding };
        let mime =
            match encoding {
                Encoding::Png => {
                    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
                        .write_image(&self.rgb, width, height, ExtendedColorType::Rgb8)?;
                    "image/png"
                }
                Encoding::Jpeg => {
                    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).write_image(
                        &self.rgb,
                        width,
                        height,
                        ExtendedColorType::Rgb8,
                    )?;
                    "image/jpeg"
                }
            };
        let uri = format!("data:{mime};base64,{}", STANDARD.encode(bytes));
        Ok(Embedded { rows: self.rows, cols: self.cols, uri })
    }
}

/// Returns the smallest factor by which pictures of these sizes must be reduced to have at most
/// `budget` pixels in total.
pub(crate) fn shrink_factor(sizes: &[(usize, usize)], budget: usize) -> usize {
    let longest = sizes.iter().map(|(rows, cols)| *rows.max(cols)).max().unwrap_or(1);
    let total = |factor: usize| -> usize {
        sizes.iter().map(|(rows, cols)| rows.div_ceil(factor) * cols.div_ceil(factor)).sum()
    };
    (1..longest).find(|factor| total(*factor) <= budget).unwrap_or(longest).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_keeps_the_mean_of_every_block() {
        let picture = Linear { rows: 3, cols: 3, data: (0..9).flat_map(|i| [i as f32; 3]).collect() };
        let small = picture.shrunk(2);
        assert_eq!((small.rows, small.cols), (2, 2));
        assert_eq!(small.data.iter().step_by(3).copied().collect::<Vec<_>>(), [2.0, 3.5, 6.5, 8.0]);
    }

    #[test]
    fn the_difference_says_which_side_is_brighter() {
        let errors = signed_error(
            &[0.5, 0.5, 0.7, 0.1, 0.1, 0.1, 0.0, 0.0, 0.0],
            &[0.5, 0.6, 0.5, 0.4, 0.1, 0.1, 1.0, 1.0, 1.0],
            |i| i < 2,
        );
        assert_eq!(errors.len(), 3);
        assert!((errors[0].unwrap() - 0.2).abs() < 1e-6 && (errors[1].unwrap() + 0.3).abs() < 1e-6);
        assert_eq!(errors[2], None);
        let picture = difference(1, 3, &errors, 2);
        assert!(picture.rgb[0] > picture.rgb[2], "too bright is red");
        assert!(picture.rgb[3] < picture.rgb[5], "too dark is blue");
        assert_eq!(difference(1, 1, &[Some(0.0)], 5).rgb, DIVERGING[2]);
    }

    #[test]
    fn a_flip_map_gets_lighter_with_the_error() {
        let errors: Vec<_> = (0..=100).map(|i| Some(i as f32 / 100.0)).chain([None]).collect();
        let map = flip_map(1, errors.len(), &errors);
        let light = |i: usize| map.rgb[3 * i..3 * i + 3].iter().map(|v| u32::from(*v)).sum::<u32>();
        assert!((1..=100).all(|i| light(i) + 2 >= light(i - 1)) && light(100) > light(0) + 600);
        assert_eq!((map.rgb[..3].to_vec(), map.rgb[300..303].to_vec()), (MAGMA[0].to_vec(), MAGMA[8].to_vec()));
        assert_eq!(map.rgb[303], map.rgb[305], "a ray that does not count is grey");
    }

    #[test]
    fn amplification_is_a_round_number_that_fits() {
        let errors: Vec<_> = (0..1000).map(|i| Some(i as f32 * 1e-4)).collect();
        assert_eq!(amplification(errors.iter()), 10);
        assert_eq!(amplification([Some(0.0)].iter()), 5000);
        assert_eq!(amplification([None].iter()), 1);
        assert_eq!(amplification([Some(3.0), Some(f32::NAN)].iter()), 1);
    }

    #[test]
    fn embedded_pictures_decode_to_the_same_pixels() {
        let picture = Picture { rows: 1, cols: 2, rgb: vec![255, 0, 3, 10, 200, 30] };
        let embedded = picture.embedded(Encoding::Png).unwrap();
        let bytes = STANDARD.decode(embedded.uri.strip_prefix("data:image/png;base64,").unwrap()).unwrap();
        assert_eq!(image::load_from_memory(&bytes).unwrap().to_rgb8().into_raw(), picture.rgb);
    }

    #[test]
    fn the_shrink_factor_meets_the_budget() {
        assert_eq!(shrink_factor(&[(100, 160); 3], 48_000), 1);
        assert_eq!(shrink_factor(&[(525, 840); 39], 2_500_000), 3);
        assert_eq!(shrink_factor(&[(1, 1); 9], 3), 1);
    }
}
