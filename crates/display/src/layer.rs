//! One layer: its position, the range of its values, and the response of its hardware.
//!
//! A stored value f is absolute: the transmittance (or emission, or rotation in units of 90°) of a
//! mask pixel. Let `peak` be a panel's brightest value, and `black` its darkest value relative to
//! `peak`. The panel's codes give
//!
//! ```text
//! f = peak · (black + (1 − black) · decode(code / (2^bits − 1)))
//! ```
//!
//! So f lies in [black · peak, peak]. [`Layer::response`] changes the stored values, and rays read
//! the changed values.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Panel, Transfer};

/// One layer of a display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Signed distance from z = 0, millimetres; rear is negative.
    pub d_mm: f64,
    /// [columns, rows] of the mask that is optimized.
    pub resolution: [usize; 2],
    /// Mask pixel pitch, millimetres.
    pub pitch_mm: f64,
    /// [x, y] of the layer's centre, millimetres. It may include a measured misalignment, for which
    /// the solver then compensates. Fractions of a pixel need `sampling = "bilinear"`; under
    /// nearest sampling they are rounded.
    #[serde(default)]
    pub offset_mm: [f64; 2],
    /// Value of the brightest state, above 0 and at most 1: the fraction of the light that a fully
    /// open pixel transmits.
    #[serde(default = "default_peak")]
    pub peak: f64,
    /// Value of the darkest state relative to the brightest state, 0 to less than 1: one over the
    /// contrast.
    #[serde(default)]
    pub black_level: f64,
    /// Number of bits of a code value, 1 to 16: a channel has 2^bits code values. Without this key
    /// the range is continuous.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bits: Option<u32>,
    /// Transfer function from linear values to the panel's code values.
    #[serde(default)]
    pub transfer: Transfer,
    /// Standard deviation of the layer's Gaussian point spread, mask pixels, 0 to 8.
    #[serde(default)]
    pub blur_px: f64,
    /// Fraction of each mask channel (column) in each emitted channel (row): entries ≥ 0, row sums
    /// above 0 and at most 1. Without this key channels do not mix.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crosstalk: Option<[[f64; 3]; 3]>,
    /// Number of values per mask pixel: three or one.
    #[serde(default)]
    pub colour: LayerColour,
    /// Column stripes of colour filters on a `mono` layer: column j has the RGB factors
    /// `filters[j % len]`, 0..1. An empty list means clear columns.
    #[serde(default)]
    pub filters: Vec<[f64; 3]>,
    /// [columns, rows] of the physical panel, if it differs from the mask.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_resolution: Option<[usize; 2]>,
    /// Pitch of the physical panel, if it differs from the mask's, millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_pitch_mm: Option<f64>,
    /// Calibration of the physical panel; patterns do not depend on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel: Option<Panel>,
}

fn default_peak() -> f64 {
    1.0
}

/// Number of values of a mask pixel: three, or one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LayerColour {
    /// One value per colour channel.
    #[default]
    Rgb,
    /// One value: the three stored channels are equal.
    Mono,
}

impl Layer {
    /// Largest number of bits of a code value.
    pub const MAX_BITS: u32 = 16;
    /// Largest standard deviation of the point spread, mask pixels.
    pub const MAX_BLUR_PX: f64 = 8.0;

    /// Makes an ideal layer at distance `d_mm`, with [columns, rows] pixels of pitch `pitch_mm`.
    pub fn new(d_mm: f64, resolution: [usize; 2], pitch_mm: f64) -> Self {
        Self {
            d_mm,
            resolution,
            pitch_mm,
            offset_mm: [0.0; 2],
            peak: default_peak(),
            black_level: 0.0,
            bits: None,
            transfer: Transfer::default(),
            blur_px: 0.0,
            crosstalk: None,
            colour: LayerColour::default(),
            filters: Vec::new(),
            panel_resolution: None,
            panel_pitch_mm: None,
            panel: None,
        }
    }

    /// Returns the [darkest, brightest] value that a mask pixel can take. The solver keeps all
    /// values between them.
    pub fn range(&self) -> [f32; 2] {
        [(self.black_level * self.peak) as f32, self.peak as f32]
    }

    /// Returns the 2^bits values that a mask pixel can take, in rising order, from the lower to the
    /// upper end of [`range`](Self::range). Returns `None` if `bits` is not set, since the range is
    /// then continuous. The values are the same for all channels, since a layer with `bits` has one
    /// transfer function for all channels.
    pub fn levels(&self) -> Option<Vec<f32>> {
        let codes = 1u32 << self.bits?.clamp(1, Self::MAX_BITS);
        let level = |code: u32| {
            let light = f64::from(self.transfer.decode(0, (f64::from(code) / f64::from(codes - 1)) as f32));
            (self.peak * (self.black_level + (1.0 - self.black_level) * light)) as f32
        };
        Some((0..codes).map(level).collect())
    }

    /// Converts a mask value to the input of the transfer function: 0 for the panel's darkest
    /// state, 1 for its brightest. Values outside this range are clamped; NaN becomes 0.
    pub fn drive(&self, value: f32) -> f32 {
        let drive = (f64::from(value) / self.peak - self.black_level) / (1.0 - self.black_level);
        if drive.is_nan() { 0.0 } else { drive.clamp(0.0, 1.0) as f32 }
    }
}

/// Returns the entry of the rising list `levels` that is nearest to `value`; of two equally near
/// levels, the lower one. Returns `value` itself if the list is empty. NaN becomes the lowest
/// level.
pub fn quantize(value: f32, levels: &[f32]) -> f32 {
    let above = levels.partition_point(|level| *level < value);
    match (above.checked_sub(1).map(|below| levels[below]), levels.get(above)) {
        (Some(below), Some(&above)) if above - value < value - below => above,
        (Some(below), _) => below,
        (None, Some(&above)) => above,
        (None, None) => value,
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;

    /// Tolerance of f32 arithmetic on values in 0..1.
    const ROUNDING: f32 = 1e-6;

    fn limited() -> Layer {
        Layer { peak: 0.8, black_level: 0.02, ..Layer::new(0.0, [4, 3], 1.0) }
    }

    #[test]
    fn levels_rise_from_black_to_peak_through_the_transfer_function() {
        assert_eq!(limited().levels(), None);
        for transfer in [Transfer::Srgb, Transfer::Linear, Transfer::gamma(2.2), Transfer::gamma(0.5)] {
            for bits in [1, 2, 4, 8, 16] {
                let layer = Layer { bits: Some(bits), transfer: transfer.clone(), ..limited() };
                let levels = layer.levels().unwrap();
                assert_eq!(levels.len(), 1 << bits);
                // with gamma 2.2 and 16 bits, the first steps above black are smaller than the
                // spacing of f32 near black
                let rise = |pair: &[f32]| if bits < 16 { pair[0] < pair[1] } else { pair[0] <= pair[1] };
                assert!(levels.windows(2).all(rise), "{transfer:?}, {bits} bits");
                assert_eq!([levels[0], levels[levels.len() - 1]], layer.range());
            }
        }
        // Code 2 of 0 to 3 decodes to (2/3)² at gamma 2. The layer's value is then 0.8 (0.02 + 0.98
        // · (2/3)²).
        let layer = Layer { bits: Some(2), transfer: Transfer::gamma(2.0), ..limited() };
        assert!((layer.levels().unwrap()[2] - 0.364_444_44).abs() < ROUNDING);
        assert_eq!(limited().range(), [0.016, 0.8]);
    }

    #[test]
    fn values_go_to_the_nearest_level() {
        let levels = Layer { bits: Some(3), ..limited() }.levels().unwrap();
        let mut random = Stream::new(5);
        for _ in 0..1000 {
            let value = 1.2 * random.next_f32() - 0.1;
            let distance = |level: f32| (level - value).abs();
            let nearest = levels.iter().copied().min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap();
            assert_eq!(quantize(value, &levels), nearest);
        }
        assert!(levels.iter().all(|&level| quantize(level, &levels) == level));
        assert_eq!(quantize(0.5, &[0.25, 0.75]), 0.25);
        assert_eq!(quantize(f32::NAN, &levels), levels[0]);
        assert_eq!((quantize(f32::INFINITY, &levels), quantize(0.3, &[])), (levels[7], 0.3));
    }

    #[test]
    fn the_drive_of_a_level_is_its_code() {
        for transfer in [Transfer::Srgb, Transfer::Linear, Transfer::gamma(2.2)] {
            let layer = Layer { bits: Some(5), transfer: transfer.clone(), ..limited() };
            for (code, level) in layer.levels().unwrap().into_iter().enumerate() {
                let found = 31.0 * layer.transfer.encode(0, layer.drive(level));
                assert!((found - code as f32).abs() < 0.01, "{transfer:?}: {code} became {found}");
            }
        }
        assert_eq!([0.0, 0.9, f32::NAN].map(|value| limited().drive(value)), [0.0, 1.0, 0.0]);
        assert_eq!(Layer::new(0.0, [4, 3], 1.0).drive(0.3), 0.3);
    }
}
