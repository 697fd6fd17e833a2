//! Colour encodings. Inside Lumistack all light is linear, with sRGB (BT.709) primaries. These
//! functions convert light to the encoding of pictures that are written, and back for pictures that
//! are read.

/// Converts linear light to the sRGB encoding (IEC 61966-2-1). Values outside of 0..1 are clamped,
/// and NaN becomes 0.
pub fn srgb_encode(linear: f32) -> f32 {
    let linear = if linear.is_nan() { 0.0 } else { linear.clamp(0.0, 1.0) };
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Converts the sRGB encoding to linear light, for values in 0..1.
pub fn srgb_decode(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Converts linear light to an 8-bit sRGB code value.
pub fn srgb_code(linear: f32) -> u8 {
    (srgb_encode(linear) * 255.0 + 0.5) as u8
}

/// Returns the relative luminance of linear RGB with BT.709 primaries.
pub fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_value_survives_a_round_trip() {
        for code in 0..=255u8 {
            assert_eq!(srgb_code(srgb_decode(f32::from(code) / 255.0)), code);
        }
        assert_eq!(srgb_code(f32::NAN), 0);
    }
}
