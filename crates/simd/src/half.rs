//! Converts half floats without special instructions.

/// Converts a finite half float to `f32`, without branches. Exponent and mantissa are shifted to
/// their places in an `f32`. The product with 2^112 then corrects the difference of the exponents'
/// biases, for subnormal numbers too.
#[inline(always)]
pub fn float_from_half(half: u16) -> f32 {
    let bits = u32::from(half);
    let magnitude = f32::from_bits((bits & 0x7fff) << 13) * f32::from_bits((127 + 112) << 23);
    f32::from_bits(magnitude.to_bits() | (bits & 0x8000) << 16)
}

/// Returns the half float nearest to a value with |value| < 65520. If two half floats are equally
/// near, the result is the half float whose last bit is 0.
#[inline(always)]
pub fn nearest_half(value: f32) -> u16 {
    let magnitude = value.to_bits() & 0x7fff_ffff;
    // The last bit of a subnormal half float is worth 2⁻²⁴, and so is the last bit of a float in
    // 0.5..1. So adding 0.5 rounds the value to a multiple of 2⁻²⁴.
    let subnormal = (f32::from_bits(magnitude) + 0.5).to_bits() & 0x7f_ffff;
    let normal = (magnitude.wrapping_sub(112 << 23) + 0xfff + (magnitude >> 13 & 1)) >> 13;
    let half = if magnitude < 113 << 23 { subnormal } else { normal };
    half as u16 | (value.to_bits() >> 16 & 0x8000) as u16
}
