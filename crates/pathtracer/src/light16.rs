//! Light in 16 bits: floating-point numbers without a sign.
//!
//! A code has 6 bits of exponent and 10 bits of mantissa. So the relative error of a value is at
//! most 2⁻¹¹, as that of a half float. The values reach from 4.7e-10 to 8.6e9, while half floats
//! end at 65504. In physical units, the radiance of suns and of visible lamps exceeds 65504.

/// Number of bits of an `f32` below the mantissa of a code.
const DROPPED: u32 = 13;
/// Difference between the upper bits of an `f32` and its code. The exponents 96 to 159 of an `f32`
/// are the exponents 0 to 63 of codes.
const OFFSET: u32 = 96 << 10;

/// Returns the code of the nearest value. Negative values, NaN and too small values become 0. Too
/// large values become the largest value.
#[inline]
pub(crate) fn encode(value: f32) -> u16 {
    let bits = if value > 0.0 { value.to_bits() } else { 0 };
    let code = ((bits + (1 << (DROPPED - 1))) >> DROPPED).saturating_sub(OFFSET);
    code.min(u32::from(u16::MAX)) as u16
}

/// Returns the value of a code.
#[inline]
pub(crate) fn decode(code: u16) -> f32 {
    if code == 0 { 0.0 } else { f32::from_bits((u32::from(code) + OFFSET) << DROPPED) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_comes_back() {
        assert!((0..=u16::MAX).all(|code| encode(decode(code)) == code));
        assert!((1..=u16::MAX).all(|code| decode(code) > decode(code - 1)), "codes are in the order of their values");
        let [least, most] = [decode(1), decode(u16::MAX)];
        assert!(least < 4.7e-10 && most > 8.5e9, "{least} {most}");
    }

    #[test]
    fn values_are_rounded_to_the_nearest() {
        let mut stream = lumistack_core::seed::Stream::new(5);
        let mut sum = 0.0;
        for _ in 0..100_000 {
            let value = (60.0 * stream.next_f32() - 29.0).exp2();
            let error = f64::from(decode(encode(value)) / value) - 1.0;
            assert!(error.abs() <= 1.0 / 2048.0, "{value}: {error}");
            sum += error;
        }
        assert!((sum / 1e5_f64).abs() < 5e-6, "the errors have no bias: {sum}");
    }

    #[test]
    fn values_out_of_range_are_clamped() {
        for value in [0.0, -0.0, -3.0, f32::NAN, f32::MIN_POSITIVE, 1e-30, f32::NEG_INFINITY] {
            assert_eq!(decode(encode(value)), 0.0, "{value}");
        }
        for value in [9e9, f32::MAX, f32::INFINITY] {
            assert_eq!(encode(value), u16::MAX, "{value}");
        }
    }
}
