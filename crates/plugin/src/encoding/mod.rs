//! Converts linear values into panel codes: transfer functions, quantization and dithering.

mod blue_noise;
mod dither;

use lumistack_display::Transfer;

pub use blue_noise::{BLUE_NOISE_SIDE, blue_noise};
pub use dither::{Dither, panel_codes};

/// Returns the code, 0..1, of a linear value in one channel (0 red, 1 green, 2 blue). Linear values
/// are clamped to 0..1; NaN becomes 0.
pub fn encode(transfer: &Transfer, channel: usize, linear: f32) -> f32 {
    transfer.encode(channel, linear)
}

/// Returns the linear value, 0..1, of a code, 0..1, in one channel.
pub fn decode(transfer: &Transfer, channel: usize, code: f32) -> f32 {
    transfer.decode(channel, code)
}

/// Returns the 8-bit codes of linear values `[..][rgb]`.
pub fn codes8(transfer: &Transfer, linear: &[f32]) -> Vec<u8> {
    linear.iter().enumerate().map(|(i, &value)| (encode(transfer, i % 3, value) * 255.0 + 0.5) as u8).collect()
}

/// Returns the 16-bit codes of linear values `[..][rgb]`.
pub fn codes16(transfer: &Transfer, linear: &[f32]) -> Vec<u16> {
    linear.iter().enumerate().map(|(i, &value)| (encode(transfer, i % 3, value) * 65535.0 + 0.5) as u16).collect()
}

#[cfg(test)]
mod tests {
    use lumistack_display::Channels;

    use super::*;

    /// Rounding error of f32 arithmetic, in units of 16-bit codes.
    const CODE_ERROR: f32 = 0.03;

    #[test]
    fn every_code_survives_and_the_ends_are_exact() {
        let per_channel = Transfer::Gamma(Channels::Rgb([1.8, 2.2, 2.4]));
        for transfer in [Transfer::Srgb, Transfer::Linear, Transfer::gamma(2.2), Transfer::gamma(1.0), per_channel] {
            for code in 0..=255u8 {
                let linear = [0, 1, 2].map(|channel| decode(&transfer, channel, f32::from(code) / 255.0));
                assert_eq!(codes8(&transfer, &linear), [code; 3], "{transfer:?}");
            }
            for code in (0..=u16::MAX).step_by(251) {
                let back = encode(&transfer, 1, decode(&transfer, 1, f32::from(code) / 65535.0)) * 65535.0;
                assert!((back - f32::from(code)).abs() < CODE_ERROR, "{transfer:?}: {code} became {back}");
            }
            assert_eq!(codes16(&transfer, &[0.0, 1.0, -1.0, 7.0, f32::NAN]), [0, 65535, 0, 65535, 0]);
        }
    }
}
