//! Sample points: (0,2)-sequences, padded to any dimension, decorrelated between views, pixels and
//! pairs of dimensions.
//!
//! Each pair of dimensions takes the first two dimensions of Sobol's sequence. Owen's nested
//! uniform scrambling permutes the sequence's values and their order (Owen 1995; shuffling as in
//! Burley 2020, "Practical Hash-based Owen Scrambling").
//!
//! Scrambling at every draw costs more than tracing, so each view makes a bank of [`PATTERNS`]
//! scrambled sequences once. Each draw picks a pattern and flips bits of the sample's index and of
//! the values, by a hash of (pixel, pair). So a draw costs one hash and one load. Flipping keeps
//! every sequence's stratification (Kollig, Keller 2002) and makes each point uniform. Hence the
//! estimate is unbiased.

use lumistack_core::seed;

use crate::bvh::BEAM;

/// Number of scrambled sequences in the bank. Two pairs of dimensions use different sequences if
/// their indices differ by less than this number.
const PATTERNS: usize = 64;
/// Length of the longest sequence in the bank; further samples use the sequence again with another
/// hash.
const LONGEST: u32 = 4096;
/// Odd step between the hash inputs of successive pairs (2⁶⁴ / golden ratio).
const PAIR_STEP: u64 = 0x9e37_79b9_7f4a_7c15;
/// Fixed seed of the bank. The job's seed changes the hashes of the pixels instead.
const BANK_SEED: u64 = 0x5eed_ba17;

/// The bank of scrambled sequences for one number of samples per pixel.
pub(crate) struct SampleBank {
    points: Vec<[u32; 2]>,
    length: u32,
    parts: u32,
}

/// Draws the random numbers of the rays of a beam, by pairs of dimensions. Each ray is a sample of
/// a pixel.
#[derive(Clone, Copy)]
pub(crate) struct Draws<'a> {
    bank: &'a SampleBank,
    /// For each ray, the hash of its pixel, and its index in the bank's sequences.
    rays: [(u64, u32); BEAM],
}

/// One pair of dimensions of the rays of a beam.
#[derive(Clone, Copy)]
pub(crate) struct Pair<'a> {
    draws: &'a Draws<'a>,
    pair: u64,
    /// Data of the pixel whose ray was drawn last. They serve all rays of that pixel.
    last: PixelPair<'a>,
}

/// One pair of dimensions of the samples of a pixel.
#[derive(Clone, Copy)]
struct PixelPair<'a> {
    pixel: u64,
    points: &'a [[u32; 2]],
    /// Bits that are flipped in a sample's index (`flip`) and in its two values (`flips`).
    flip: u32,
    flips: [u32; 2],
}

impl SampleBank {
    /// Makes a bank for `samples` points per pixel.
    #[cfg(test)]
    pub(crate) fn new(samples: u32) -> Self {
        Self::with_more(samples, samples)
    }

    /// Makes a bank with the larger of `points` and `samples` points per pixel, rounded up to a
    /// power of two, but at most [`LONGEST`]. [`Draws::parts`] depends only on `samples`, since the
    /// first points of a scrambled sequence are stratified, as the whole sequence is.
    pub(crate) fn with_more(samples: u32, points: u32) -> Self {
        let length = points.max(samples).clamp(1, LONGEST).next_power_of_two();
        let parts = 1 << samples.clamp(1, LONGEST).ilog2();
        let mut points = Vec::with_capacity(PATTERNS * length as usize);
        for pattern in 0..PATTERNS as u64 {
            let key = |what: u64| seed::derive(BANK_SEED, &[pattern, what]);
            // nested uniform scrambling of the index requires the index in the high bits
            let order = |i: u32| {
                let bits = length.trailing_zeros();
                if bits == 0 { 0 } else { owen_scramble(i << (32 - bits), key(0)) >> (32 - bits) }
            };
            points.extend((0..length).map(|i| {
                let i = order(i);
                [owen_scramble(i.reverse_bits(), key(1)), owen_scramble(sobol_second(i), key(2))]
            }));
        }
        Self { points, length, parts }
    }

    /// Returns the random numbers of the samples `first` to `first` + `each` − 1 of each pixel, in
    /// the order of the pixels. A pixel is given by its hash. There may be at most [`BEAM`] samples
    /// of all pixels together.
    #[inline]
    pub(crate) fn draws(&self, pixels: &[u64], first: u32, each: u32) -> Draws<'_> {
        let mut draws = Draws { bank: self, rays: [(0, 0); BEAM] };
        for (&pixel, rays) in pixels.iter().zip(draws.rays.chunks_exact_mut(each as usize)) {
            rays.iter_mut().zip(first..).for_each(|(ray, sample)| *ray = (pixel, sample));
        }
        if first + each > self.length {
            // further samples use the sequence again with another hash
            for (pixel, sample) in &mut draws.rays {
                if *sample >= self.length {
                    *pixel = seed::derive(*pixel, &[u64::from(*sample / self.length)]);
                    *sample &= self.length - 1;
                }
            }
        }
        draws
    }
}

impl Draws<'_> {
    /// Returns the number of equal parts into which a pixel's samples stratify [0, 1), at most
    /// [`LONGEST`]. If a pixel has at most [`LONGEST`] samples, each part holds the numbers of one
    /// or two samples, in both dimensions of every pair. If the number of samples is a power of
    /// two, each part holds the number of one sample.
    #[inline]
    pub(crate) fn parts(&self) -> u32 {
        self.bank.parts
    }

    /// Returns the pair of dimensions with this index.
    #[inline]
    pub(crate) fn pair(&self, pair: u64) -> Pair<'_> {
        Pair { draws: self, pair, last: self.bank.pair_of(self.rays[0].0, pair) }
    }

    /// Returns the two numbers of a ray in the pair of dimensions with this index, each in [0, 1).
    #[inline]
    pub(crate) fn numbers(&self, pair: u64, ray: usize) -> [f32; 2] {
        let (pixel, sample) = self.rays[ray];
        self.bank.pair_of(pixel, pair).of(sample)
    }
}

impl Pair<'_> {
    /// Returns the two numbers of a ray, each in [0, 1).
    #[inline(always)]
    pub(crate) fn of(&mut self, ray: usize) -> [f32; 2] {
        let (pixel, sample) = self.draws.rays[ray];
        if pixel != self.last.pixel {
            self.last = self.draws.bank.pair_of(pixel, self.pair);
        }
        self.last.of(sample)
    }
}

impl SampleBank {
    #[inline]
    fn pair_of(&self, pixel: u64, pair: u64) -> PixelPair<'_> {
        let hash = seed::mix(pixel.wrapping_add(pair.wrapping_mul(PAIR_STEP)));
        // any 64 successive pairs use all 64 patterns; the pixel's hash selects the first
        let pattern = (pixel.wrapping_add(pair.wrapping_mul(37)) as usize) % PATTERNS;
        let length = self.length as usize;
        let flip = (hash ^ (hash >> 27)) as u32;
        let points = &self.points[pattern * length..(pattern + 1) * length];
        PixelPair { pixel, points, flip, flips: [(hash >> 32) as u32, hash as u32] }
    }
}

impl PixelPair<'_> {
    #[inline]
    fn of(&self, sample: u32) -> [f32; 2] {
        // the length of the sequence is a power of two, so the mask keeps the index in range
        let [x, y] = self.points[(sample ^ self.flip) as usize & (self.points.len() - 1)];
        [unit(x ^ self.flips[0]), unit(y ^ self.flips[1])]
    }
}

/// Returns the 24 high bits as a number in [0, 1).
#[inline]
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / (1u32 << 24) as f32)
}

/// Returns the second dimension of Sobol's sequence: the bit-reversed index times Pascal's matrix
/// modulo 2.
fn sobol_second(mut index: u32) -> u32 {
    let mut result = 0;
    let mut column = 1u32 << 31;
    while index != 0 {
        if index & 1 != 0 {
            result ^= column;
        }
        column ^= column >> 1;
        index >>= 1;
    }
    result
}

/// Applies Owen's nested uniform scrambling: each bit is flipped by a hash of the bits above it.
/// This function is slow and exact, and only the bank uses it.
fn owen_scramble(value: u32, key: u64) -> u32 {
    let mut result = value;
    for bit in 0..32 {
        let above = if bit == 0 { 0 } else { value >> (32 - bit) };
        let flip = seed::derive(key, &[bit, u64::from(above)]) >> 63;
        result ^= (flip as u32) << (31 - bit);
    }
    result
}

#[cfg(test)]
mod tests {
    use lumistack_testkit::statistics::{FALSE_ALARM_RATE, assert_counts};

    use super::*;

    #[test]
    fn every_pair_of_a_power_of_two_is_stratified_in_all_elementary_boxes() {
        let samples = 64;
        let bank = SampleBank::new(samples);
        for pixel in 0..20 {
            let mut points = vec![Vec::new(); 5];
            for index in 0..samples {
                let draws = bank.draws(&[seed::derive(3, &[pixel])], index & !15, 16);
                points
                    .iter_mut()
                    .zip(0..)
                    .for_each(|(points, pair)| points.push(draws.pair(pair).of(index as usize & 15)));
            }
            for pair in &points {
                for log_x in 0..=6 {
                    let (nx, ny) = ((1 << log_x) as f32, (64 >> log_x) as f32);
                    let mut seen = [false; 64];
                    for [x, y] in pair {
                        let cell = (x * nx) as usize + (y * ny) as usize * nx as usize;
                        assert!(!std::mem::replace(&mut seen[cell], true), "two points in one of {nx} × {ny} boxes");
                    }
                }
            }
        }
    }

    /// Over all pixels, every sample of every pair is uniform over its square, and the numbers of
    /// different pairs are independent. Chi-square over 12 × 12 cells, with the false-alarm rate
    /// [`FALSE_ALARM_RATE`] for each of 36 tests.
    #[test]
    fn numbers_are_uniform_over_pixels() {
        const EDGE: usize = 12;
        let pixels = 40_000u64;
        for samples in [1, 48] {
            let bank = SampleBank::new(samples);
            for index in [0, samples / 2, samples - 1] {
                for pairs in [[0, 0], [2, 2], [4, 4], [1 << 62, 1 << 62], [0, 3], [3, 67]] {
                    let mut counts = vec![0u64; EDGE * EDGE];
                    for pixel in 0..pixels {
                        let draws = bank.draws(&[seed::derive(11, &[pixel])], index, 1);
                        let (x, y) = (draws.pair(pairs[0]).of(0)[0], draws.pair(pairs[1]).of(0)[1]);
                        counts[(x * EDGE as f32) as usize + (y * EDGE as f32) as usize * EDGE] += 1;
                    }
                    let expected = vec![pixels as f64 / (EDGE * EDGE) as f64; EDGE * EDGE];
                    assert_counts(&counts, &expected, FALSE_ALARM_RATE);
                }
            }
        }
    }

    /// Each of the two numbers of a pair is stratified by itself. If n, the number of samples, is a
    /// power of two, each of n equal parts of [0, 1) holds one sample. For another n, the number of
    /// parts is the next smaller power of two, and each part holds one or two samples.
    #[test]
    fn every_number_is_stratified() {
        for samples in [16u32, 48, 64] {
            let bank = SampleBank::new(samples);
            let parts = if samples.is_power_of_two() { samples } else { samples.next_power_of_two() / 2 };
            for pixel in 0..50 {
                for pair in [0, 1, 5, 30, 1 << 62] {
                    for side in 0..2 {
                        let mut seen = vec![0; parts as usize];
                        for index in 0..samples {
                            let number = bank.draws(&[seed::derive(12, &[pixel])], index, 1).pair(pair).of(0)[side];
                            seen[(number * parts as f32) as usize] += 1;
                        }
                        let most = if samples == parts { 1 } else { 2 };
                        assert!(seen.iter().all(|&count| (1..=most).contains(&count)), "{samples} {pair}: {seen:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn pairs_and_pixels_are_independent() {
        // The first three sums, of products of centred numbers, give correlations: within a pair,
        // between pairs, and between pixels. The last sum gives the mean of a number.
        let bank = SampleBank::new(16);
        let pixels = 20_000u64;
        let mut sums = [0.0f64; 4];
        for pixel in 0..pixels {
            let draw = |pixel: u64, index: u32, pair: u64| {
                bank.draws(&[seed::derive(1, &[pixel])], index, 1).pair(pair).of(0).map(|v| f64::from(v) - 0.5)
            };
            let a = draw(pixel, 3, 2);
            sums[0] += a[0] * a[1];
            sums[1] += a[0] * draw(pixel, 3, 3)[0];
            sums[2] += a[0] * draw(pixel + 1, 3, 2)[0];
            sums[3] += a[1];
        }
        // The bound is five standard errors. A product of two numbers in ±0.5 has the standard
        // deviation 1/12, and one such number has the standard deviation 0.289.
        let bound = 5.0 / (pixels as f64).sqrt();
        for (sum, deviation) in sums.iter().zip([1.0 / 12.0, 1.0 / 12.0, 1.0 / 12.0, 0.289]) {
            assert!((sum / pixels as f64).abs() < bound * deviation, "{sums:?}");
        }
    }

    #[test]
    fn a_smooth_integral_converges_faster_than_random() {
        // The integral is the area π/4 of a quarter disc of radius 1. With n random points the
        // standard deviation of the estimate is 0.41/√n.
        let samples = 256;
        let bank = SampleBank::new(samples);
        let mean_square: f64 = (0..200)
            .map(|pixel| {
                let inside = (0..samples)
                    .filter(|&i| {
                        let [x, y] = bank.draws(&[seed::derive(5, &[pixel])], i, 1).pair(0).of(0);
                        x * x + y * y < 1.0
                    })
                    .count();
                (inside as f64 / f64::from(samples) - std::f64::consts::FRAC_PI_4).powi(2)
            })
            .sum::<f64>()
            / 200.0;
        let random = 0.41f64.powi(2) / f64::from(samples);
        assert!(mean_square < random / 10.0, "{mean_square} against {random}");
    }

    /// The numbers of a sample do not depend on the samples and pixels that are drawn with it.
    #[test]
    fn samples_are_the_same_in_any_company() {
        for samples in [1, 16, 48, LONGEST + 40] {
            let bank = SampleBank::new(samples);
            for index in [0, 7, 15, 17, 40, LONGEST - 1, LONGEST, LONGEST + 37] {
                let index = index.min(samples - 1);
                let together = bank.draws(&[9], index & !15, 16).pair(3).of(index as usize & 15);
                assert_eq!(together, bank.draws(&[9], index, 1).pair(3).of(0), "{index} of {samples}");
                let pixels = bank.draws(&[7, 9, 8], index & !3, 4);
                let ray = 4 + (index as usize & 3);
                assert_eq!(together, pixels.pair(3).of(ray), "{index} of {samples}, beside other pixels");
                assert_eq!(together, pixels.numbers(3, ray), "{index} of {samples}, alone");
            }
        }
    }

    #[test]
    fn more_samples_than_the_longest_sequence_go_on() {
        let bank = SampleBank::new(LONGEST + 5);
        assert_ne!(bank.draws(&[1], 0, 1).pair(0).of(0), bank.draws(&[1], LONGEST, 1).pair(0).of(0));
        assert_eq!(SampleBank::new(1).points.len(), PATTERNS);
    }
}
