//! Half floats without an instruction for them.

/// A finite half float as `f32`, without branches: shifted into place, then scaled by 2^112 for the difference of the exponents' biases, which makes
/// subnormal numbers come out right too.
#[inline(always)]
pub fn float_from_half(half: u16) -> f32 {
    let bits = u32::from(half);
    let magnitude = f32::from_bits((bits & 0x7fff) << 13) * f32::from_bits((127 + 112) << 23);
    f32::from_bits(magnitude.to_bits() | (bits & 0x8000) << 16)
}
