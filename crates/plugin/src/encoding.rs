//! Panels' transfer functions: from linear transmittance or radiance to code values, and back.

use lumistack_display::Transfer;

/// The code of a linear value, both in 0..1. Values outside are clamped; NaN becomes 0.
pub fn encode(transfer: Transfer, linear: f32) -> f32 {
    transfer.encode(linear)
}

/// The linear value of a code, both in 0..1.
pub fn decode(transfer: Transfer, code: f32) -> f32 {
    transfer.decode(code)
}

/// 8-bit codes of linear values.
pub fn codes8(transfer: Transfer, linear: &[f32]) -> Vec<u8> {
    linear.iter().map(|&value| (encode(transfer, value) * 255.0 + 0.5) as u8).collect()
}

/// 16-bit codes of linear values.
pub fn codes16(transfer: Transfer, linear: &[f32]) -> Vec<u16> {
    linear.iter().map(|&value| (encode(transfer, value) * 65535.0 + 0.5) as u16).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Codes as exact as f32 arithmetic gives them, in units of 16-bit codes.
    const CODE_ERROR: f32 = 0.02;

    #[test]
    fn every_code_survives_and_the_ends_are_exact() {
        for transfer in [Transfer::Srgb, Transfer::Linear, Transfer::Gamma(2.2), Transfer::Gamma(1.0)] {
            for code in 0..=255u8 {
                assert_eq!(codes8(transfer, &[decode(transfer, f32::from(code) / 255.0)]), [code], "{transfer:?}");
            }
            for code in (0..=u16::MAX).step_by(251) {
                let back = encode(transfer, decode(transfer, f32::from(code) / 65535.0)) * 65535.0;
                assert!((back - f32::from(code)).abs() < CODE_ERROR, "{transfer:?}: {code} became {back}");
            }
            assert_eq!(codes16(transfer, &[0.0, 1.0, -1.0, 7.0, f32::NAN]), [0, 65535, 0, 65535, 0]);
        }
    }
}
