//! Encodes linear pictures as sRGB by tables, and colours errors.

use std::sync::LazyLock;

use lumistack_core::colour::{srgb_codes, srgb_decode};

/// The linear value of each sRGB code.
pub(crate) static DECODED: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| srgb_decode(code as f32 / 255.0)));

/// Converts linear values `[.., rgb]` to opaque sRGB bytes `[.., rgba]`.
pub(crate) fn to_rgba(linear: &[f32]) -> Vec<u8> {
    let codes = srgb_codes();
    linear.chunks_exact(3).flat_map(|p| [codes.code(p[0]), codes.code(p[1]), codes.code(p[2]), 255]).collect()
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
    fn heat_rises_in_lightness() {
        let light = |e: f32| heat(e).iter().map(|v| u32::from(*v)).sum::<u32>();
        assert!((0..25).all(|i| light(0.01 * i as f32) < light(0.01 * (i + 1) as f32)));
        assert_eq!((heat(0.0), heat(9.0)), ([0, 0, 8], [252, 255, 214]));
    }
}
