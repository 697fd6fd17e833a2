//! FLIP: the difference that a person sees when two pictures alternate.
//!
//! ```text
//! colour    linear RGB ─▶ Y Cx Cz ─▶ contrast sensitivity filters (Gaussians) ─▶ clamped RGB
//!             ─▶ Lab, a and b times L/100 (Hunt)
//!           ΔE_c = HyAB distance ^ 0.7, mapped to 0..1:
//!             values up to 0.4 of the largest value to 0..0.95, larger values to 0.95..1
//! features  Y ─▶ first and second derivatives of a Gaussian of 0.082°/2 ─▶ edges and points,
//!             each is the length of the vector of its x and y derivatives
//!           ΔE_f = (larger difference / √2) ^ 0.5
//! FLIP      ΔE_c ^ (1 − ΔE_f), 0 (equal) to 1 (worst)
//! ```
//!
//! Filters have their size in degrees of visual angle, so the error depends on the number of pixels
//! per degree. Outside of the picture, filters read the outermost pixel. Filters are separable,
//! except the filter of Cz: a sum of two Gaussians. The two Gaussians are applied separately, and
//! their weights together sum to 1.
//!
//! Source: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference
//! Evaluator for Alternating Images", High Performance Graphics 2020 (LDR-FLIP). Checked against
//! the authors' tool. That tool reads sRGB-encoded pictures and decodes them first; this code
//! receives linear light.

use std::ops::Range;

use super::MetricMap;
use super::filter::{Border, Plane, bands, channels};

/// Pairs (a, b) of the contrast sensitivity a·√(π/b)·exp(−π² x²/b), where x is the distance from
/// the filter's centre in degrees. The sensitivity of Cz is the sum of two such Gaussians.
const SENSITIVITY_Y: (f64, f64) = (1.0, 0.0047);
const SENSITIVITY_CX: (f64, f64) = (1.0, 0.0053);
const SENSITIVITY_CZ: [(f64, f64); 2] = [(34.1, 0.04), (13.5, 0.025)];
/// Exponent to which colour distances are raised.
const COLOUR_EXPONENT: f32 = 0.7;
/// Colour distances are raised to `COLOUR_EXPONENT`. Results up to this fraction of the largest
/// result are mapped to 0..`COLOUR_KNEE_TO`, and larger results to the rest of 0..1.
const COLOUR_KNEE_FROM: f32 = 0.4;
const COLOUR_KNEE_TO: f32 = 0.95;
/// Width of the feature detectors, which is twice the Gaussian's standard deviation, degrees.
const FEATURE_WIDTH_DEG: f64 = 0.082;

/// Matrix from linear sRGB to CIE XYZ.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [10135552.0 / 24577794.0, 8788810.0 / 24577794.0, 4435075.0 / 24577794.0],
    [2613072.0 / 12288897.0, 8788810.0 / 12288897.0, 887015.0 / 12288897.0],
    [1425312.0 / 73733382.0, 8788810.0 / 73733382.0, 70074185.0 / 73733382.0],
];

/// The filters and colour conversions by which FLIP is computed, for one number of pixels per
/// degree.
#[derive(Clone, Debug)]
pub struct Flip {
    y: Vec<f32>,
    cx: Vec<f32>,
    cz: [Vec<f32>; 2],
    smooth: Vec<f32>,
    edge: Vec<f32>,
    point: Vec<f32>,
    colours: Colours,
}

/// A band of a picture after the filters of the visual system.
struct Seen {
    /// Lightness of Lab at every pixel.
    lightness: Vec<f32>,
    /// The value a of Lab at every pixel, after Hunt's effect.
    a: Vec<f32>,
    /// The value b of Lab at every pixel, after Hunt's effect.
    b: Vec<f32>,
    /// Strength of edges at every pixel, from the first derivatives of Y.
    edges: Vec<f32>,
    /// Strength of points at every pixel, from the second derivatives of Y.
    points: Vec<f32>,
}

impl Flip {
    /// The authors' setting: a screen of 3840 pixels whose width equals the viewing distance. This
    /// gives 67.02 pixels per degree.
    pub const DEFAULT_PIXELS_PER_DEGREE: f64 = 3840.0 * std::f64::consts::PI / 180.0;

    /// Makes the filters for a number of pixels per degree of visual angle, which is clamped to
    /// 1..1000. A number that is not finite counts as the default.
    pub fn new(pixels_per_degree: f64) -> Self {
        let density = if pixels_per_degree.is_finite() {
            pixels_per_degree.clamp(1.0, 1000.0)
        } else {
            Self::DEFAULT_PIXELS_PER_DEGREE
        };
        // the radius is three standard deviations of the widest Gaussian
        let pi = std::f64::consts::PI;
        let radius = (3.0 * (SENSITIVITY_CZ[0].1 / (2.0 * pi * pi)).sqrt() * density).ceil() as usize;
        let gaussian = |amplitude: f64, b: f64| -> Vec<f64> {
            let x = |i: usize| (i as f64 - radius as f64) / density;
            (0..=2 * radius).map(|i| amplitude * (-pi * pi * x(i).powi(2) / b).exp()).collect()
        };
        let unit = |b: f64| scaled(&gaussian(1.0, b), 1.0 / gaussian(1.0, b).iter().sum::<f64>());
        // A 2D Gaussian of amplitude a·√(π/b) is the product of two 1D Gaussians. The amplitude of
        // each is the square root of a·√(π/b).
        let [cz1, cz2] = SENSITIVITY_CZ.map(|(a, b)| gaussian((a * (pi / b).sqrt()).sqrt(), b));
        let total = cz1.iter().sum::<f64>().hypot(cz2.iter().sum());
        let (smooth, edge, point) = feature_filters(0.5 * FEATURE_WIDTH_DEG * density);
        Self {
            y: unit(SENSITIVITY_Y.1),
            cx: unit(SENSITIVITY_CX.1),
            cz: [scaled(&cz1, 1.0 / total), scaled(&cz2, 1.0 / total)],
            smooth,
            edge,
            point,
            colours: Colours::new(),
        }
    }

    /// Computes FLIP at every pixel of two pictures `[row][col][rgb]` of linear light; `shape` =
    /// [rows, cols].
    ///
    /// # Panics
    /// If a picture does not fill the shape.
    pub fn compare(&self, reference: &[f32], test: &[f32], shape: [usize; 2]) -> MetricMap {
        let [rows, cols] = shape;
        assert!(reference.len() == 3 * rows * cols && test.len() == reference.len(), "pictures must fill the shape");
        let mut values = Vec::with_capacity(rows * cols);
        for band in bands(rows) {
            let (reference, test) = (self.seen(reference, shape, &band), self.seen(test, shape, &band));
            let error = |i: usize| {
                let lightness = (reference.lightness[i] - test.lightness[i]).abs();
                let chroma = (reference.a[i] - test.a[i]).hypot(reference.b[i] - test.b[i]);
                let colour = self.colours.error(lightness + chroma);
                let edge = (reference.edges[i] - test.edges[i]).abs();
                let feature = edge.max((reference.points[i] - test.points[i]).abs());
                colour.powf(1.0 - (std::f32::consts::FRAC_1_SQRT_2 * feature).sqrt())
            };
            values.extend((0..band.len() * cols).map(error));
        }
        MetricMap { rows, cols, values, margin: 0 }
    }

    /// Filters a band of a picture as the visual system does.
    fn seen(&self, rgb: &[f32], shape: [usize; 2], band: &Range<usize>) -> Seen {
        let halo = self.y.len().max(self.smooth.len()) / 2;
        let clamped = |value: f32| if value > 0.0 { value.min(1.0) } else { 0.0 };
        // convert to the opponent colours Y, Cx and Cz
        let [red, green, blue] = channels(rgb, shape, band, halo, Border::Nearest, clamped);
        let opponent = |weights: [f32; 3]| {
            let [r, g, b] = weights;
            red.with(&green, |red, green| r * red + g * green).with(&blue, |sum, blue| sum + b * blue)
        };
        let [y, cx, cz] = self.colours.opponent_from_rgb.map(opponent);
        // blur each colour by the eye's contrast sensitivity, and convert the pixels to Lab
        let along_rows = |plane: &Plane<f32>, weights: &[f32]| plane.filtered_along_rows(weights, Border::Nearest);
        let blurred =
            |plane: &Plane<f32>, weights: &[f32]| along_rows(plane, weights).filtered_along_columns(weights, halo).data;
        let (blurred_y, blurred_cx) = (blurred(&y, &self.y), blurred(&cx, &self.cx));
        let (cz1, cz2) = (blurred(&cz, &self.cz[0]), blurred(&cz, &self.cz[1]));
        let pixels = blurred_y.len();
        let (mut lightness, mut a, mut b) = (vec![0.0; pixels], vec![0.0; pixels], vec![0.0; pixels]);
        for i in 0..pixels {
            [lightness[i], a[i], b[i]] = self.colours.seen([blurred_y[i], blurred_cx[i], cz1[i] + cz2[i]]);
        }
        // edges and points: the lengths of the vectors of Y's first and second derivatives
        let smooth_y = along_rows(&y, &self.smooth);
        let strength = |derivative: &[f32]| -> Vec<f32> {
            let x = along_rows(&y, derivative).filtered_along_columns(&self.smooth, halo);
            x.with(&smooth_y.filtered_along_columns(derivative, halo), |x, y| (x * x + y * y).sqrt()).data
        };
        Seen { lightness, a, b, edges: strength(&self.edge), points: strength(&self.point) }
    }
}

/// Returns the weights of a Gaussian, of its first derivative and of its second derivative. The
/// positive weights of a derivative sum to 1, the negative ones to −1.
fn feature_filters(deviation_px: f64) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let radius = (3.0 * deviation_px).ceil() as i64;
    let offsets: Vec<f64> = (-radius..=radius).map(|i| i as f64).collect();
    let gaussian = |x: f64| (-0.5 * (x / deviation_px).powi(2)).exp();
    let smooth: Vec<f64> = offsets.iter().map(|x| gaussian(*x)).collect();
    let edge: Vec<f64> = offsets.iter().map(|x| -x * gaussian(*x)).collect();
    let point: Vec<f64> = offsets.iter().map(|x| ((x / deviation_px).powi(2) - 1.0) * gaussian(*x)).collect();
    let balanced = |weights: &[f64]| {
        let positive: f64 = weights.iter().filter(|w| **w > 0.0).sum();
        let negative: f64 = -weights.iter().filter(|w| **w < 0.0).sum::<f64>();
        weights.iter().map(|w| (w / if *w > 0.0 { positive } else { negative }) as f32).collect()
    };
    let total: f64 = smooth.iter().sum();
    (scaled(&smooth, 1.0 / total), balanced(&edge), balanced(&point))
}

fn scaled(weights: &[f64], factor: f64) -> Vec<f32> {
    weights.iter().map(|weight| (weight * factor) as f32).collect()
}

/// Conversions of colour spaces, all relative to the white point: y = Y/Y_n, Cx ∝ X/X_n − Y/Y_n, Cz
/// ∝ Y/Y_n − Z/Z_n. The index n marks the white point.
#[derive(Clone, Debug)]
struct Colours {
    opponent_from_rgb: [[f32; 3]; 3],
    rgb_from_opponent: [[f32; 3]; 3],
    /// Matrix from linear RGB to (X/X_n, Y/Y_n, Z/Z_n), relative to the white point.
    relative_from_rgb: [[f32; 3]; 3],
    /// The largest colour distance, that between green and blue, raised to `COLOUR_EXPONENT`.
    largest: f32,
}

impl Colours {
    fn new() -> Self {
        // the white point is the XYZ of RGB (1, 1, 1), so each row is divided by its sum
        let relative = XYZ_FROM_RGB.map(|row| row.map(|value| value / row.iter().sum::<f64>()));
        let [x, y, z] = relative;
        let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let opponent = [y, minus(x, y), minus(y, z)];
        let narrow = |matrix: [[f64; 3]; 3]| matrix.map(|row| row.map(|value| value as f32));
        let mut colours = Self {
            opponent_from_rgb: narrow(opponent),
            rgb_from_opponent: narrow(inverse(opponent)),
            relative_from_rgb: narrow(relative),
            largest: 1.0,
        };
        let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|rgb| colours.hunt_lab(rgb));
        let distance = (green[0] - blue[0]).abs() + (green[1] - blue[1]).hypot(green[2] - blue[2]);
        colours.largest = distance.powf(COLOUR_EXPONENT);
        colours
    }

    /// Converts filtered opponent colours to Lab with Hunt's effect.
    #[inline]
    fn seen(&self, opponent: [f32; 3]) -> [f32; 3] {
        self.hunt_lab(transform(&self.rgb_from_opponent, opponent).map(|value| value.clamp(0.0, 1.0)))
    }

    /// Converts linear RGB to Lab with Hunt's effect: a and b grow with lightness.
    #[inline]
    fn hunt_lab(&self, rgb: [f32; 3]) -> [f32; 3] {
        /// δ = 6/29 of CIE Lab.
        const DELTA: f32 = 6.0 / 29.0;
        let [x, y, z] = transform(&self.relative_from_rgb, rgb)
            .map(|t| if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 });
        let lightness = 116.0 * y - 16.0;
        let hunt = 0.01 * lightness;
        [lightness, hunt * 500.0 * (x - y), hunt * 200.0 * (y - z)]
    }

    /// Maps a colour distance to the colour error 0..1.
    #[inline]
    fn error(&self, distance: f32) -> f32 {
        let power = distance.powf(COLOUR_EXPONENT);
        let knee = COLOUR_KNEE_FROM * self.largest;
        if power < knee {
            power * (COLOUR_KNEE_TO / knee)
        } else {
            COLOUR_KNEE_TO + (power - knee) / (self.largest - knee) * (1.0 - COLOUR_KNEE_TO)
        }
    }
}

#[inline]
fn transform(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Inverts a 3 × 3 matrix by cofactors.
fn inverse(m: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let cofactor = |r: usize, c: usize| {
        let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
        m[r1][c1] * m[r2][c2] - m[r1][c2] * m[r2][c1]
    };
    let determinant: f64 = (0..3).map(|c| m[0][c] * cofactor(0, c)).sum();
    std::array::from_fn(|r| std::array::from_fn(|c| cofactor(c, r) / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest accepted error of a mean FLIP. The map is in f32, and the power of 0.7 enlarges
    /// rounding errors of small distances.
    const SAME: f64 = 1e-4;

    fn flip(reference: &[f32], test: &[f32], shape: [usize; 2]) -> f64 {
        Flip::new(Flip::DEFAULT_PIXELS_PER_DEGREE).compare(reference, test, shape).mean().value()
    }

    #[test]
    fn equal_pictures_have_no_error_and_black_on_white_has_most() {
        let flat = |value: f32| vec![value; 3 * 7 * 9];
        assert_eq!(flip(&flat(0.4), &flat(0.4), [7, 9]), 0.0);
        // black has the Lab lightness 0 and white 100, so their distance is 100; flat pictures have
        // no features
        let colours = Colours::new();
        let expected = f64::from(colours.error(100.0));
        assert!((flip(&flat(0.0), &flat(1.0), [7, 9]) - expected).abs() < SAME && expected > 0.9);
        assert_eq!(flip(&flat(f32::NAN), &flat(-3.0), [7, 9]), 0.0, "NaN and negative values become 0");
        assert!(flip(&[], &[], [0, 9]).is_nan(), "nothing to compare");
    }

    #[test]
    fn green_and_blue_are_farthest_apart() {
        let colours = Colours::new();
        let flat = |rgb: [f32; 3]| rgb.repeat(25);
        assert!((flip(&flat([0.0, 1.0, 0.0]), &flat([0.0, 0.0, 1.0]), [5, 5]) - 1.0).abs() < SAME);
        assert!((colours.error(0.0), colours.largest > 30.0) == (0.0, true));
    }

    #[test]
    fn a_finer_screen_hides_the_same_noise() {
        let mut stream = crate::seed::Stream::new(1);
        let noise: Vec<f32> = (0..3 * 40 * 40).map(|_| 0.4 + 0.2 * stream.next_f32()).collect();
        let grey = vec![0.5; noise.len()];
        let at = |density: f64| Flip::new(density).compare(&grey, &noise, [40, 40]).mean().value();
        assert!(at(30.0) > at(67.0) && at(67.0) > at(150.0));
        assert_eq!(at(f64::NAN), at(Flip::DEFAULT_PIXELS_PER_DEGREE));
    }

    #[test]
    fn the_inverse_undoes_the_matrix() {
        let forth = Colours::new().opponent_from_rgb;
        let back = Colours::new().rgb_from_opponent;
        let rgb = transform(&back, transform(&forth, [0.3, 0.9, 0.1]));
        assert!(rgb.iter().zip([0.3, 0.9, 0.1]).all(|(a, b)| (a - b).abs() < 1e-5), "{rgb:?}");
    }
}
