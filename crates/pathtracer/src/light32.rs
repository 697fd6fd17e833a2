//! Light of three channels in 32 bits: mantissas with a common exponent.
//!
//! A code has 6 bits of exponent and mantissas of 9 bits for red and green, and 8 bits for blue, to
//! which eyes are least sensitive. The error of red and green is at most about 2⁻⁹ of the largest
//! channel, the error of blue 2⁻⁸. The largest channel reaches from 1.9e-9 to 3.4e10.

/// Bits of the three mantissas, from the lowest bits of a code.
const BITS: [u32; 3] = [9, 9, 8];
/// The bits of the code below each mantissa.
const SHIFTS: [u32; 3] = [0, 9, 18];
/// Bits of a code below its exponent.
const EXPONENT: u32 = 26;
/// Exponent of an `f32`, with its bias of 127, whose code has the exponent 0.
const LEAST: u32 = 98;
/// Largest exponent of a code.
const MOST: u32 = 63;
/// A code that no light has.
pub(crate) const NONE: u32 = u32::MAX;

/// Returns the code of the nearest light. Negative values, NaN and light that is too dark become 0.
/// Channels that are too bright are limited.
#[inline]
pub(crate) fn encode(rgb: [f32; 3]) -> u32 {
    // `max` also turns NaN into 0
    let rgb = rgb.map(|value| value.max(0.0));
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    // rounding may raise a mantissa to the next power of two, which needs the next exponent
    let exponent = ((largest * (1.0 + 1.0 / 256.0)).to_bits() >> 23).saturating_sub(LEAST).min(MOST);
    let per_scale = f32::from_bits((253 - LEAST - exponent) << 23);
    // the cast saturates
    let mantissa = |c: usize| {
        let most = (1 << BITS[c]) as f32;
        ((rgb[c] * per_scale * most + 0.5) as u32).min(most as u32 - 1) << SHIFTS[c]
    };
    (exponent << EXPONENT | mantissa(0) | mantissa(1) | mantissa(2)).min(NONE - 1)
}

/// Returns the light of a code.
#[inline]
pub(crate) fn decode(code: u32) -> [f32; 3] {
    let scale = f32::from_bits((LEAST + 1 + (code >> EXPONENT)) << 23);
    // a mantissa is converted at its place in the code; all products are exact
    const MASKS: [u32; 3] = [0x1ff, 0x1ff << 9, 0xff << 18];
    const STEPS: [f32; 3] = [1.0 / 0x200 as f32, 1.0 / 0x4_0000 as f32, 1.0 / 0x400_0000 as f32];
    [0, 1, 2].map(|c| (code & MASKS[c]) as i32 as f32 * STEPS[c] * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_rounded_to_the_nearest() {
        let mut stream = lumistack_core::seed::Stream::new(5);
        let mut sums = [0.0; 3];
        for _ in 0..100_000 {
            let most = (58.0 * stream.next_f32() - 24.0).exp2();
            let rgb = [0; 3].map(|_| most * (0.05 + 0.95 * stream.next_f32()));
            let found = decode(encode(rgb));
            let largest = rgb[0].max(rgb[1]).max(rgb[2]);
            for c in 0..3 {
                let error = f64::from((found[c] - rgb[c]) / largest);
                assert!(error.abs() <= 1.01 / f64::from(1 << BITS[c]), "{rgb:?}: {found:?}");
                sums[c] += error;
            }
            assert_eq!(encode(found), encode(decode(encode(found))));
        }
        assert!(sums.iter().all(|sum| (sum / 1e5_f64).abs() < 3e-5), "the errors have no bias: {sums:?}");
    }

    #[test]
    fn grey_and_powers_of_two_come_back() {
        for exponent in -28..=34 {
            let value = f32::from(exponent as i16).exp2();
            assert_eq!(decode(encode([value; 3])), [value; 3]);
            assert_eq!(decode(encode([value, 0.0, 0.5 * value])), [value, 0.0, 0.5 * value]);
        }
    }

    #[test]
    fn light_out_of_range_is_clamped() {
        for value in [0.0, -0.0, -3.0, f32::NAN, f32::MIN_POSITIVE, 1e-30, f32::NEG_INFINITY] {
            assert_eq!(decode(encode([value; 3])), [0.0; 3], "{value}");
        }
        for value in [4e10, f32::MAX, f32::INFINITY] {
            assert!(decode(encode([value; 3])).iter().all(|found| *found > 3.3e10), "{value}");
            assert!(encode([value; 3]) != NONE);
        }
        assert_eq!(decode(encode([f32::NAN, 1.0, -1.0])), [0.0, 1.0, 0.0]);
    }
}
