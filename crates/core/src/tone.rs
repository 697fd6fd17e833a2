//! Tone curves map exposed scene-linear radiance to the range of a display, 0..1. Radiance and
//! result are linear light.
//!
//! One curve is applied to all views of a light field. It depends only on a ray's radiance, so a
//! point of the scene keeps its colour from view to view.
//!
//! * [`ToneCurve::Linear`]: min(x, 1), channel by channel.
//! * [`ToneCurve::KhronosNeutral`]: Khronos PBR Neutral (Khronos Group, 2024, specification and
//!   sample in `KhronosGroup/ToneMapping`). It maps a channel c of (R, G, B) with K_s = 0.8 − F,
//!   K_d = 0.15 and F = 0.04. F is the reflection that a dielectric adds to its base colour.
//!
//! ```text
//! x = min(R, G, B),   f = x − x²/4F for x ≤ 2F, else F
//! p = max(R, G, B) − f;   for p ≤ K_s: c − f, else
//! p_n = 1 − (1 − K_s)²/(p + 1 − 2K_s),   g = 1/(K_d (p − p_n) + 1):
//!       (c − f) p_n/p · g + p_n (1 − g)
//! ```
//!
//! * [`ToneCurve::Agx`]: AgX without a creative grade (Troy Sobotka; matrices and curve as in Eary
//!   Chow's `AgX_LUT_Gen`, from which Blender's table is made). The steps are in Rec. 2020. An
//!   inset matrix draws colours together. A sigmoid of log₂ exposure maps the range from −10 to
//!   +6.5 stops around middle grey, 0.18, to 0..1. The hue is then turned back by 60 % of its
//!   change in the sigmoid. An outset matrix spreads the colours again. Values below 0 in BT.709
//!   are raised to 0 at equal luminance. The result is within 0.03 of Blender's table, which
//!   treats colours outside the gamut more elaborately.

use crate::colour::luminance;

/// A tone curve. One curve is applied to all views of a light field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ToneCurve {
    /// Clips at 1.
    #[default]
    Linear,
    /// Khronos PBR Neutral: base colours stay as they are, highlights are compressed.
    KhronosNeutral,
    /// AgX: soft contrast, bright colours turn to white.
    Agx,
}

/// Reflectance of a dielectric at normal incidence, which the Khronos curve subtracts. The curve's
/// specification calls this value F90.
const F90: f32 = 0.04;
/// Value at which the compression of the Khronos curve starts.
const START: f32 = 0.8 - F90;
/// Rate at which highlights lose colour in the Khronos curve.
const DESATURATION: f32 = 0.15;

/// Exposed value of middle grey, which AgX does not change.
const MIDDLE_GREY: f32 = 0.18;
/// Lowest and highest input of AgX's sigmoid, in stops from middle grey.
const STOPS: [f32; 2] = [-10.0, 6.5];
/// Slope of AgX's sigmoid at middle grey.
const SLOPE: f32 = 2.4;
/// Exponent of the toe and shoulder of AgX's sigmoid.
const POWER: f32 = 1.5;
/// Exponent that converts values of AgX's sigmoid to linear light.
const GAMMA: f32 = 2.4;
/// The result mixes two hues. This is the weight of the hue after the sigmoid; the hue before the
/// sigmoid has the remaining weight.
const HUE_AFTER: f32 = 0.4;

type Matrix = [[f32; 3]; 3];

/// Matrix from BT.709 to BT.2020 primaries (ITU-R BT.2087).
const REC2020_FROM_BT709: Matrix =
    [[0.627_404, 0.329_283, 0.043_313], [0.069_097, 0.919_54, 0.011_362], [0.016_391, 0.088_013, 0.895_595]];
/// Matrix from BT.2020 to BT.709 primaries.
const BT709_FROM_REC2020: Matrix =
    [[1.660_491, -0.587_641, -0.072_85], [-0.124_55, 1.132_9, -0.008_349], [-0.018_151, -0.100_579, 1.118_73]];
/// AgX's inset matrix, which draws colours together.
const INSET: Matrix = [
    [0.856_627_15, 0.095_121_24, 0.048_251_606],
    [0.137_318_97, 0.761_242, 0.101_439_04],
    [0.111_898_21, 0.076_799_42, 0.811_302_4],
];
/// AgX's outset matrix, which spreads colours again. It is not the inverse of [`INSET`], but of
/// another inset matrix.
const OUTSET: Matrix = [
    [1.127_100_6, -0.110_606_64, -0.016_493_94],
    [-0.141_329_76, 1.157_823_7, -0.016_493_94],
    [-0.141_329_76, -0.110_606_64, 1.251_936_4],
];

impl ToneCurve {
    /// Every curve with its name in job files.
    pub const ALL: [(&'static str, Self); 3] =
        [("linear", Self::Linear), ("khronos-neutral", Self::KhronosNeutral), ("agx", Self::Agx)];

    /// Returns the curve's name in job files.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, curve)| *curve == self).map_or("", |(name, _)| name)
    }

    /// Maps exposed radiance `rgb` to the linear value that the display shows. Negative values and
    /// NaN are treated as 0, values above 10⁶ as 10⁶.
    pub fn apply(self, rgb: [f32; 3]) -> [f32; 3] {
        let rgb = rgb.map(|value| if value.is_nan() { 0.0 } else { value.clamp(0.0, 1e6) });
        let shown = match self {
            Self::Linear => rgb,
            Self::KhronosNeutral => khronos_neutral(rgb),
            Self::Agx => agx(rgb),
        };
        shown.map(|value| value.clamp(0.0, 1.0))
    }

    /// Returns the exposed radiance of the grey that is shown as `level`, 0 < `level` < 1.
    pub fn grey_shown_as(self, level: f32) -> f32 {
        let (mut low, mut high) = (0.0f32, 1e4f32);
        // bisection finds the level, since the curves are monotone on greys
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if self.apply([middle; 3])[1] < level { low = middle } else { high = middle }
        }
        high
    }
}

fn khronos_neutral(rgb: [f32; 3]) -> [f32; 3] {
    let least = rgb[0].min(rgb[1]).min(rgb[2]);
    let offset = if least <= 2.0 * F90 { least - least * least / (4.0 * F90) } else { F90 };
    let rgb = rgb.map(|value| value - offset);
    let peak = rgb[0].max(rgb[1]).max(rgb[2]);
    if peak <= START {
        return rgb;
    }
    let room = 1.0 - START;
    let new_peak = 1.0 - room * room / (peak + room - START);
    let colour = 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    rgb.map(|value| value * (new_peak / peak) * colour + new_peak * (1.0 - colour))
}

fn agx(rgb: [f32; 3]) -> [f32; 3] {
    let inset = times(&INSET, times(&REC2020_FROM_BT709, rgb));
    let formed = inset.map(|value| sigmoid(stops(value)).max(0.0).powf(GAMMA));
    let formed = with_hue_of(formed, inset);
    let shown = times(&BT709_FROM_REC2020, times(&OUTSET, formed));
    raised(shown)
}

fn times(matrix: &Matrix, [r, g, b]: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * r + row[1] * g + row[2] * b)
}

/// Returns the position of a value in AgX's range of stops, 0..1.
fn stops(value: f32) -> f32 {
    (((value.max(1e-10) / MIDDLE_GREY).log2() - STOPS[0]) / (STOPS[1] - STOPS[0])).clamp(0.0, 1.0)
}

/// Computes AgX's sigmoid at `x`, a position in the range of stops, 0..1. The slope at middle grey
/// (x₀, y₀) is SLOPE. The scale s has two values. Below x₀, its value makes the result 0 at x = 0.
/// Above x₀, its value makes the result 1 at x = 1:
///
/// ```text
/// s·h(SLOPE (x − x₀)/s) + y₀,   h(t) = t/(1 + |t|^POWER)^(1/POWER)
/// ```
fn sigmoid(x: f32) -> f32 {
    let (x0, y0) = (-STOPS[0] / (STOPS[1] - STOPS[0]), MIDDLE_GREY.powf(1.0 / GAMMA));
    let (run, rise) = if x < x0 { (x0, y0) } else { (1.0 - x0, 1.0 - y0) };
    let scale = ((rise.powf(-POWER)) - (SLOPE * run).powf(-POWER)).powf(-1.0 / POWER);
    let t = SLOPE * (x - x0) / scale;
    scale * t / (1.0 + t.abs().powf(POWER)).powf(1.0 / POWER) + y0
}

/// Turns the hue of `rgb`, in the hexcone of HSV, towards the hue of the colour `before`. The angle
/// of the turn is (1 − [`HUE_AFTER`]) times the difference of the two hues.
fn with_hue_of(rgb: [f32; 3], before: [f32; 3]) -> [f32; 3] {
    let (low, high) = (rgb[0].min(rgb[1]).min(rgb[2]), rgb[0].max(rgb[1]).max(rgb[2]));
    let (Some(after), Some(before)) = (hue(rgb), hue(before)) else { return rgb };
    // the turn goes the shorter way round the circle of hues
    let turn = (before - after + 9.0).rem_euclid(6.0) - 3.0;
    let hue = (after + (1.0 - HUE_AFTER) * turn).rem_euclid(6.0);
    // a channel has the value `high` up to 1 sextant from its own hue; it falls to `low` from 1 to
    // 2 sextants
    [0.0, 2.0, 4.0].map(|own: f32| {
        let distance = ((hue - own + 9.0).rem_euclid(6.0) - 3.0).abs();
        low + (high - low) * (2.0 - distance).clamp(0.0, 1.0)
    })
}

/// Returns the hue in sextants, 0..6 from red through green and blue; `None` for a grey.
fn hue([r, g, b]: [f32; 3]) -> Option<f32> {
    let (low, high) = (r.min(g).min(b), r.max(g).max(b));
    let range = high - low;
    if range <= 1e-7 * high || range <= 0.0 {
        return None;
    }
    let hue = if high == r {
        (g - b) / range
    } else if high == g {
        2.0 + (b - r) / range
    } else {
        4.0 + (r - g) / range
    };
    Some(hue.rem_euclid(6.0))
}

/// Raises all channels equally until none is below 0, then scales them to the luminance of `rgb`.
fn raised(rgb: [f32; 3]) -> [f32; 3] {
    let least = rgb[0].min(rgb[1]).min(rgb[2]);
    if least >= 0.0 {
        return rgb;
    }
    let lifted = rgb.map(|value| value - least);
    let scale = luminance(rgb).max(0.0) / luminance(lifted);
    lifted.map(|value| value * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Stream;

    /// Tolerance against reference values of 4 decimals.
    const ROUNDED: f32 = 1e-4;
    /// Tolerances of the equations against Blender's table. Greys differ only by the table's
    /// interpolation, colours also by the table's treatment of the gamut.
    const TABLE_GREY: f32 = 1e-3;
    const TABLE_COLOUR: f32 = 0.03;

    /// Exposed colours, and their values by OpenColorIO 2 with the colour configuration of Blender
    /// 4.5, display sRGB, view AgX, decoded to linear light.
    const BLENDER_AGX: [([f32; 3], [f32; 3]); 22] = [
        ([0.001; 3], [0.0003; 3]),
        ([0.01; 3], [0.0063; 3]),
        ([0.05; 3], [0.0422; 3]),
        ([0.18; 3], [0.18; 3]),
        ([0.5; 3], [0.4; 3]),
        ([1.0; 3], [0.5558; 3]),
        ([2.0; 3], [0.6953; 3]),
        ([5.0; 3], [0.8493; 3]),
        ([12.0; 3], [0.9655; 3]),
        ([0.5, 0.1, 0.1], [0.438, 0.1106, 0.1012]),
        ([0.1, 0.5, 0.1], [0.1475, 0.3889, 0.1175]),
        ([0.1, 0.1, 0.5], [0.098, 0.1357, 0.4299]),
        ([1.0, 0.0, 0.0], [0.7069, 0.0411, 0.0152]),
        ([0.0, 1.0, 0.0], [0.1568, 0.5585, 0.0827]),
        ([0.0, 0.0, 1.0], [0.0071, 0.0932, 0.6408]),
        ([4.0, 0.2, 0.2], [0.9671, 0.3909, 0.3557]),
        ([0.2, 4.0, 0.2], [0.5177, 0.8206, 0.4528]),
        ([0.2, 0.2, 4.0], [0.3427, 0.4242, 0.9071]),
        ([1.0, 0.8, 0.2], [0.5686, 0.4863, 0.2681]),
        ([3.0, 2.0, 0.1], [0.8015, 0.6625, 0.3875]),
        ([0.8, 0.45, 0.3], [0.5201, 0.3695, 0.2988]),
        ([0.05, 0.2, 0.35], [0.0508, 0.2068, 0.3289]),
    ];

    #[test]
    fn agx_is_what_blender_shows() {
        for (exposed, expected) in BLENDER_AGX {
            let shown = ToneCurve::Agx.apply(exposed);
            let tolerance =
                if exposed[0] == exposed[1] && exposed[1] == exposed[2] { TABLE_GREY } else { TABLE_COLOUR };
            for c in 0..3 {
                assert!((shown[c] - expected[c]).abs() <= tolerance, "{exposed:?}: {shown:?}, Blender {expected:?}");
            }
        }
    }

    /// Expected values were computed by hand from the specification, for at least one colour of
    /// each branch.
    #[test]
    fn khronos_neutral_follows_its_specification() {
        let cases = [
            // the least channel x is 0.02, so f = 0.02 − 0.0025 is subtracted from every channel
            ([0.02, 0.5, 0.3], [0.0025, 0.4825, 0.2825]),
            ([0.2, 0.5, 0.3], [0.16, 0.46, 0.26]),
            // The largest channel p = 1.96 is compressed to p_n = 1 − 0.0576/1.44 = 0.96, with g =
            // 1/1.15. A channel becomes (c − f) · 0.48979592 · 0.86956522 + 0.96 · 0.13043478.
            ([2.0, 1.0, 0.5], [0.96, 0.534_086_6, 0.321_135_8]),
            // a compressed grey stays grey: p = 3.96 becomes p_n = 1 − 0.0576/3.44
            ([4.0; 3], [0.983_256; 3]),
        ];
        for (exposed, expected) in cases {
            let shown = ToneCurve::KhronosNeutral.apply(exposed);
            for c in 0..3 {
                assert!((shown[c] - expected[c]).abs() < ROUNDED, "{exposed:?}: {shown:?} instead of {expected:?}");
            }
        }
    }

    #[test]
    fn brighter_greys_are_shown_brighter_and_without_steps() {
        for (name, curve) in ToneCurve::ALL {
            let mut last = curve.apply([0.0; 3]);
            assert_eq!(last, [0.0; 3], "{name}: black stays black");
            for i in 1..=60_000 {
                let exposed = i as f32 / 10_000.0;
                let shown = curve.apply([exposed; 3]);
                // exposures are 1e-4 apart and the slope of a curve is at most 2, so neighbouring
                // values differ by at most 2e-4, apart from rounding
                let step = shown[1] - last[1];
                assert!((-1e-6..=2.1e-4).contains(&step), "{name}: from {last:?} to {shown:?} at {exposed}");
                assert!(shown.iter().all(|v| (v - shown[1]).abs() < 2e-3), "{name}: a grey stays grey: {shown:?}");
                last = shown;
            }
            assert!(curve.apply([100.0; 3])[1] > 0.98);
            let grey = curve.grey_shown_as(0.5);
            assert!((curve.apply([grey; 3])[1] - 0.5).abs() < 1e-4, "{name}: {grey}");
        }
    }

    #[test]
    fn colours_change_without_steps_and_stay_in_range() {
        let mut stream = Stream::new(5);
        for (name, curve) in ToneCurve::ALL {
            for _ in 0..20_000 {
                let exposed = [0; 3].map(|_| 3.0 * stream.next_f32().powi(3));
                let near = exposed.map(|value| value * 1.001 + 1e-4);
                let (shown, moved) = (curve.apply(exposed), curve.apply(near));
                for c in 0..3 {
                    assert!((0.0..=1.0).contains(&shown[c]));
                    assert!((shown[c] - moved[c]).abs() < 0.02, "{name}: {exposed:?} {shown:?}, beside it {moved:?}");
                }
            }
            for exposed in [[f32::NAN; 3], [f32::INFINITY, 0.0, 1.0], [-1.0, 0.2, 0.1], [1e30; 3], [1e-30; 3]] {
                assert!(curve.apply(exposed).iter().all(|value| (0.0..=1.0).contains(value)), "{name}: {exposed:?}");
            }
        }
    }

    /// The neutral curve keeps the hue of the hexcone, since it only scales colours and mixes them
    /// with grey. AgX changes the hue by at most 45°.
    #[test]
    fn hues_stay() {
        let mut stream = Stream::new(6);
        for (curve, most) in [(ToneCurve::KhronosNeutral, 0.1), (ToneCurve::Agx, 45.0)] {
            for _ in 0..20_000 {
                let exposed = [0; 3].map(|_| 4.0 * stream.next_f32());
                let shown = curve.apply(exposed);
                let range =
                    shown.iter().copied().fold(f32::MIN, f32::max) - shown.iter().copied().fold(f32::MAX, f32::min);
                if let (Some(before), Some(after)) = (hue(exposed), hue(shown))
                    && range > 0.02
                {
                    let turn = 60.0 * ((after - before + 9.0).rem_euclid(6.0) - 3.0).abs();
                    assert!(turn <= most, "{curve:?}: {exposed:?} {shown:?} turns by {turn}°");
                }
            }
        }
        // values below the compression only lose 0.04, the reflection that a dielectric's surface
        // adds
        let [r, g, b] = ToneCurve::KhronosNeutral.apply([0.64, 0.24, 0.14]);
        assert!((r - 0.6).abs() < ROUNDED && (g - 0.2).abs() < ROUNDED && (b - 0.1).abs() < ROUNDED);
    }
}
