//! Encodes linear pictures as sRGB by tables. The formula's `f32::powf` for every pixel would take
//! most of the time of a picture.

use std::sync::LazyLock;

use lumistack_core::colour::{srgb_code, srgb_decode};

/// Number of equal bins into which the range 0..1 is divided. The search for a value's code starts
/// with the code of the lower end of the value's bin.
const BINS: usize = 4096;

/// Converts linear values to sRGB codes, with the results of [`srgb_code`].
pub(crate) struct Encoder {
    /// The code of each bin's lower end.
    start: Vec<u8>,
    /// The smallest linear value of each code.
    least: [f32; 256],
}

pub(crate) static ENCODER: LazyLock<Encoder> = LazyLock::new(|| {
    let least = std::array::from_fn(|code| {
        // Find the smallest value with this code by bisection over the bits of floats. For positive
        // floats the bits rise with the value, and the code also rises with the value.
        let (mut low, mut high) = (0u32, 1f32.to_bits());
        while low < high {
            let middle = low + (high - low) / 2;
            if usize::from(srgb_code(f32::from_bits(middle))) >= code { high = middle } else { low = middle + 1 }
        }
        f32::from_bits(low)
    });
    Encoder { start: (0..BINS).map(|bin| srgb_code(bin as f32 / BINS as f32)).collect(), least }
});

impl Encoder {
    /// Returns the sRGB code of a linear value; values outside 0..1 are clipped.
    #[inline]
    pub(crate) fn code(&self, linear: f32) -> u8 {
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

/// The linear value of each sRGB code.
pub(crate) static DECODED: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| srgb_decode(code as f32 / 255.0)));

/// Converts linear values `[.., rgb]` to opaque sRGB bytes `[.., rgba]`.
pub(crate) fn to_rgba(linear: &[f32]) -> Vec<u8> {
    let encoder = &*ENCODER;
    linear.chunks_exact(3).flat_map(|p| [encoder.code(p[0]), encoder.code(p[1]), encoder.code(p[2]), 255]).collect()
}

/// The error that the last colour of the error map shows. Larger errors have the last colour, too.
pub(crate) const HEAT_TOP: f32 = 0.25;

/// Colours of the error map, as sRGB codes, for evenly spaced errors from 0 to [`HEAT_TOP`]. A
/// larger error has a lighter colour.
const HEAT: [[f32; 3]; 6] = [
    [0.0, 0.0, 8.0],
    [66.0, 10.0, 104.0],
    [147.0, 38.0, 103.0],
    [221.0, 81.0, 58.0],
    [252.0, 165.0, 10.0],
    [252.0, 255.0, 214.0],
];

/// Returns the error map's colours as `#rrggbb`, for evenly spaced errors from 0 to [`HEAT_TOP`].
#[cfg(target_arch = "wasm32")]
pub(crate) fn heat_stops() -> [String; HEAT.len()] {
    HEAT.map(|[r, g, b]| format!("#{:02x}{:02x}{:02x}", r as u8, g as u8, b as u8))
}

/// Returns the colour of an error, interpolated between the colours of the map.
pub(crate) fn heat(error: f32) -> [u8; 3] {
    let place = (error / HEAT_TOP).clamp(0.0, 1.0) * (HEAT.len() - 1) as f32;
    let first = (place as usize).min(HEAT.len() - 2);
    let t = place - first as f32;
    std::array::from_fn(|c| (HEAT[first][c] + t * (HEAT[first + 1][c] - HEAT[first][c]) + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_gives_the_same_codes() {
        let steps = 200_000;
        for i in 0..=steps {
            let value = i as f32 / steps as f32 * 1.1;
            assert_eq!(ENCODER.code(value), srgb_code(value), "{value}");
        }
        for code in 1..=255u8 {
            let least = ENCODER.least[usize::from(code)];
            let below = f32::from_bits(least.to_bits() - 1);
            assert_eq!((ENCODER.code(least), ENCODER.code(below)), (code, code - 1));
            assert_eq!((srgb_code(least), srgb_code(below)), (code, code - 1));
        }
        for odd in [f32::NAN, -1.0, f32::NEG_INFINITY, f32::INFINITY] {
            assert_eq!(ENCODER.code(odd), srgb_code(odd));
        }
    }

    #[test]
    fn heat_rises_in_lightness() {
        let light = |e: f32| heat(e).iter().map(|v| u32::from(*v)).sum::<u32>();
        assert!((0..25).all(|i| light(0.01 * i as f32) < light(0.01 * (i + 1) as f32)));
        assert_eq!((heat(0.0), heat(9.0)), ([0, 0, 8], [252, 255, 214]));
    }
}
