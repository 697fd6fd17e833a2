//! Colour encodings. Inside Lumistack all light is linear, with sRGB (BT.709) primaries. These
//! functions convert light to the encoding of pictures that are written, and back for pictures that
//! are read.

use std::sync::LazyLock;

/// Number of equal bins into which [`SrgbCodes`] divides the range 0..1. The search for a value's
/// code starts with the code at the lower end of the value's bin.
const BINS: usize = 4096;

/// A table of the codes that [`srgb_code`] returns. Without the table, `f32::powf` would take most
/// of the time to write a picture.
pub struct SrgbCodes {
    /// The code of each bin's lower end.
    start: Vec<u8>,
    /// The smallest linear value of each code.
    least: [f32; 256],
}

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

/// Returns the table of codes, which is made at the first call.
pub fn srgb_codes() -> &'static SrgbCodes {
    static CODES: LazyLock<SrgbCodes> = LazyLock::new(SrgbCodes::new);
    &CODES
}

impl SrgbCodes {
    fn new() -> Self {
        let least = std::array::from_fn(|code| {
            // Find the smallest value with this code by bisection over the bits of floats. For
            // positive floats the bits rise with the value, and the code also rises with the value.
            let (mut low, mut high) = (0u32, 1f32.to_bits());
            while low < high {
                let middle = low + (high - low) / 2;
                if usize::from(srgb_code(f32::from_bits(middle))) >= code { high = middle } else { low = middle + 1 }
            }
            f32::from_bits(low)
        });
        Self { start: (0..BINS).map(|bin| srgb_code(bin as f32 / BINS as f32)).collect(), least }
    }

    /// Returns the same code as [`srgb_code`].
    #[inline]
    pub fn code(&self, linear: f32) -> u8 {
        if linear >= 1.0 {
            return 255;
        }
        // Start at the lower end of the bin. A cast from float to integer turns negative values and
        // NaN into 0.
        let mut code = self.start[((linear * BINS as f32) as usize).min(BINS - 1)];
        while code < 255 && linear >= self.least[usize::from(code) + 1] {
            code += 1;
        }
        code
    }
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

    #[test]
    fn the_table_gives_the_same_codes() {
        let (codes, steps) = (srgb_codes(), 200_000);
        for i in 0..=steps {
            let value = i as f32 / steps as f32 * 1.1;
            assert_eq!(codes.code(value), srgb_code(value), "{value}");
        }
        for code in 1..=255u8 {
            let least = codes.least[usize::from(code)];
            let below = f32::from_bits(least.to_bits() - 1);
            assert_eq!((codes.code(least), codes.code(below)), (code, code - 1));
            assert_eq!((srgb_code(least), srgb_code(below)), (code, code - 1));
        }
        for odd in [f32::NAN, -1.0, f32::NEG_INFINITY, f32::INFINITY] {
            assert_eq!(codes.code(odd), srgb_code(odd));
        }
    }
}
