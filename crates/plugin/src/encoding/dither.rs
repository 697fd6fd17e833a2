//! Computes the codes of a panel of b bits, with optional dithering.
//!
//! Let two neighbouring codes emit the light l₀ and l₁, and a value v lie between them: l₀ ≤ v <
//! l₁. Then the fraction t = (v − l₀)/(l₁ − l₀) of the pixels with this value gets the brighter
//! code. So the mean *light* is exact for any transfer function. These pixels are selected by a
//! threshold map, or by error diffusion in linear light (Floyd and Steinberg, 1976; serpentine
//! rows).

use lumistack_display::Transfer;
use serde::Deserialize;

use super::{BLUE_NOISE_SIDE, blue_noise};

/// Dithering of values that lie between two codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dither {
    /// Every value gets the nearest code.
    None,
    /// An 8 × 8 Bayer threshold map selects the pixels with the brighter code.
    Ordered,
    /// A 64 × 64 blue-noise threshold map selects the pixels with the brighter code.
    BlueNoise,
    /// Each pixel's error is carried to neighbouring pixels.
    Diffusion,
}

/// Returns the codes 0..2^bits − 1 of linear values in 0..1, `[row][col][rgb]`. `size` is [rows,
/// cols], `bits` is 1 to 16. The shift of a threshold map depends on the number `pattern` and on
/// the channel, so that the dots of different layers and frames are uncorrelated.
///
/// # Panics
/// If the length of `rgb` does not match `size`, or `bits` is out of range.
pub fn panel_codes(
    transfer: &Transfer,
    bits: u32,
    dither: Dither,
    [rows, cols]: [usize; 2],
    rgb: &[f32],
    pattern: usize,
) -> Vec<u16> {
    assert!(
        (1..=16).contains(&bits) && rgb.len() == 3 * rows * cols,
        "expected 1 to 16 bits, and three values per pixel"
    );
    let top = (1u32 << bits) - 1;
    let nearest = |channel: usize, value: f32| (transfer.encode(channel, value) * top as f32 + 0.5) as u16;
    if dither == Dither::None {
        return rgb.iter().enumerate().map(|(i, &value)| nearest(i % 3, value)).collect();
    }
    // Dithering must be exact in light, so compute the light of every code.
    let light: [Vec<f32>; 3] =
        [0, 1, 2].map(|channel| (0..=top).map(|code| transfer.decode(channel, code as f32 / top as f32)).collect());
    if dither == Dither::Diffusion {
        return diffuse(&light, [rows, cols], rgb);
    }
    // Shift the threshold map differently for every channel and pattern, so that the dots of layers
    // and frames are uncorrelated.
    let map = ThresholdMap::of(dither);
    let mut codes = vec![0; rgb.len()];
    for channel in 0..3 {
        let shift = map.shift(3 * pattern + channel);
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let i = 3 * (row * cols + col) + channel;
            let (code, share) = between(&light[channel], rgb[i]);
            codes[i] = code + u16::from(share > map.at(row + shift[0], col + shift[1]));
        }
    }
    codes
}

/// Returns the brightest code whose light is at most `value`, but never the last code, which has no
/// next code. Also returns the value's position t, 0..1, between the light of the returned code and
/// the light of the next code. `light` has the light of every code.
fn between(light: &[f32], value: f32) -> (u16, f32) {
    let value = if value.is_nan() { 0.0 } else { value.clamp(0.0, 1.0) };
    let above = light.partition_point(|&l| l <= value).clamp(1, light.len() - 1);
    let (low, high) = (light[above - 1], light[above]);
    let share = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
    (above as u16 - 1, share)
}

struct ThresholdMap {
    side: usize,
    thresholds: Vec<f32>,
}

impl ThresholdMap {
    fn of(dither: Dither) -> Self {
        if dither == Dither::Ordered {
            // A rank interleaves the bits of x ^ y and of y, in reverse order: the lowest bits
            // become the highest bits of the rank.
            let rank = |x: usize, y: usize| {
                (0..3).fold(0, |rank, bit| {
                    let pair = 2 * ((x ^ y) >> bit & 1) + (y >> bit & 1);
                    rank | pair << (2 * (2 - bit))
                })
            };
            let thresholds = (0..64).map(|i| (rank(i % 8, i / 8) as f32 + 0.5) / 64.0).collect();
            return Self { side: 8, thresholds };
        }
        Self { side: BLUE_NOISE_SIDE, thresholds: blue_noise().to_vec() }
    }

    /// Returns the shift of the map, [rows, columns]. Every channel of a pattern has its own number
    /// `n`. For a Bayer map, the shifts for n and n + 1 differ by 3 rows and 2 columns. So pixels
    /// with the lower half of the thresholds for n have the upper half for n + 1. For a blue-noise
    /// map, the shifts are spread evenly over the map.
    fn shift(&self, n: usize) -> [usize; 2] {
        if self.side < BLUE_NOISE_SIDE {
            return [3 * n, 2 * n];
        }
        // These constants are 1/g and 1/g², where g is the real root of g³ = g + 1. The fractional
        // parts of n/g and n/g² are evenly spread.
        [0.754_877_666_246_692_7, 0.569_840_290_998_053_2]
            .map(|step: f64| ((n as f64 * step).fract() * self.side as f64) as usize)
    }

    fn at(&self, row: usize, col: usize) -> f32 {
        self.thresholds[row % self.side * self.side + col % self.side]
    }
}

fn diffuse(light: &[Vec<f32>; 3], [rows, cols]: [usize; 2], rgb: &[f32]) -> Vec<u16> {
    let mut codes = vec![0; rgb.len()];
    for channel in 0..3 {
        // Hold the errors that are carried to this row and to the next row. One more column at
        // either end takes the errors that leave the picture.
        let (mut here, mut below) = (vec![0.0; cols + 2], vec![0.0; cols + 2]);
        for row in 0..rows {
            let reverse = row % 2 == 1;
            for step in 0..cols {
                let col = if reverse { cols - 1 - step } else { step };
                let i = 3 * (row * cols + col) + channel;
                let value = if rgb[i].is_nan() { 0.0 } else { rgb[i].clamp(0.0, 1.0) } + here[col + 1];
                let (low, share) = between(&light[channel], value);
                let code = low + u16::from(share > 0.5);
                codes[i] = code;
                let error = value - light[channel][usize::from(code)];
                let (ahead, behind) = if reverse { (col, col + 2) } else { (col + 2, col) };
                here[ahead] += error * 7.0 / 16.0;
                below[behind] += error * 3.0 / 16.0;
                below[col + 1] += error * 5.0 / 16.0;
                below[ahead] += error * 1.0 / 16.0;
            }
            std::mem::swap(&mut here, &mut below);
            below.fill(0.0);
        }
    }
    codes
}

#[cfg(test)]
mod tests {
    use lumistack_display::Channels;

    use super::*;

    const ALL: [Dither; 3] = [Dither::Ordered, Dither::BlueNoise, Dither::Diffusion];
    const SIZE: [usize; 2] = [64, 128];

    fn flat(value: f32) -> Vec<f32> {
        vec![value; 3 * SIZE[0] * SIZE[1]]
    }

    fn mean_light(transfer: &Transfer, bits: u32, codes: &[u16], channel: usize) -> f64 {
        let top = ((1u32 << bits) - 1) as f32;
        let sum: f64 =
            codes.chunks_exact(3).map(|rgb| f64::from(transfer.decode(channel, f32::from(rgb[channel]) / top))).sum();
        sum / (codes.len() / 3) as f64
    }

    #[test]
    fn the_mean_light_of_an_even_area_is_right() {
        let per_channel = Transfer::Gamma(Channels::Rgb([1.8, 2.2, 2.6]));
        for transfer in [Transfer::Srgb, Transfer::Linear, per_channel] {
            for (dither, bits) in ALL.into_iter().flat_map(|dither| [1, 2, 4, 6].map(|bits| (dither, bits))) {
                for value in [0.03, 0.18, 0.5, 0.77] {
                    let codes = panel_codes(&transfer, bits, dither, SIZE, &flat(value), 3);
                    for channel in 0..3 {
                        let mean = mean_light(&transfer, bits, &codes, channel);
                        // With 64 thresholds the error is at most half of 1/64 of the step between
                        // two codes. No step is larger than the one between the two brightest
                        // codes.
                        let top = ((1u32 << bits) - 1) as f32;
                        let step = 1.0 - transfer.decode(channel, (top - 1.0) / top);
                        let allowed = f64::from(step) / 100.0;
                        assert!(
                            (mean - f64::from(value)).abs() < allowed,
                            "{dither:?} {bits} bits: {mean} for {value}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn codes_that_exist_are_kept_and_nothing_lies_outside() {
        for dither in [Dither::None].into_iter().chain(ALL) {
            for code in 0..16u16 {
                let value = Transfer::gamma(2.2).decode(0, f32::from(code) / 15.0);
                let codes = panel_codes(&Transfer::gamma(2.2), 4, dither, SIZE, &flat(value), 0);
                assert!(codes.iter().all(|&found| found == code), "{dither:?} {code}");
            }
            for (value, code) in [(-1.0, 0), (2.0, 7), (f32::NAN, 0)] {
                let codes = panel_codes(&Transfer::Srgb, 3, dither, SIZE, &flat(value), 0);
                assert!(codes.iter().all(|&found| found == code), "{dither:?} {value}");
            }
            assert_eq!(panel_codes(&Transfer::Srgb, 16, dither, [1, 1], &[1.0, 0.0, 0.5], 0)[..2], [65535, 0]);
        }
    }

    #[test]
    fn channels_and_patterns_do_not_line_up() {
        for dither in [Dither::Ordered, Dither::BlueNoise] {
            let [a, b] = [0, 1].map(|pattern| panel_codes(&Transfer::Linear, 1, dither, SIZE, &flat(0.3), pattern));
            let agree = |pairs: &mut dyn Iterator<Item = bool>| pairs.filter(|same| *same).count();
            let between_patterns = agree(&mut a.iter().zip(&b).map(|(x, y)| x == y));
            let between_channels = agree(&mut a.chunks_exact(3).map(|rgb| rgb[0] == rgb[1]));
            assert!(between_patterns < a.len() * 9 / 10 && between_channels < a.len() / 3 * 9 / 10, "{dither:?}");
        }
    }

    #[test]
    fn the_ordered_map_is_bayer_s() {
        let map = ThresholdMap::of(Dither::Ordered);
        let rank = |row, col| (map.at(row, col) * 64.0) as usize;
        assert_eq!([0, 1, 2, 3].map(|col| rank(0, col)), [0, 32, 8, 40]);
        assert_eq!([0, 1, 2, 3].map(|col| rank(1, col)), [48, 16, 56, 24]);
        let mut all: Vec<usize> = (0..64).map(|i| rank(i / 8, i % 8)).collect();
        all.sort_unstable();
        assert_eq!(all, (0..64).collect::<Vec<_>>());
    }
}
