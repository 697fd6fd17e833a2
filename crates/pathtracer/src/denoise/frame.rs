//! A view in the form that the filter reads, and the search for one view's pixels in another view.

use glam::{DVec2, Vec3};
use lumistack_display::{FieldGeometry, Projection};

use super::view::NoisyView;

/// Smallest reflectance by which radiance is divided. If a surface is darker, the division leaves
/// contrast of its texture, and the filter blurs this contrast too.
const LEAST_ALBEDO: f32 = 0.02;
/// Half the width of the square over which the variance of a pixel is averaged. The two halves of
/// one pixel give only a very rough variance.
const VARIANCE_RADIUS: usize = 2;

/// Number of planes in [`Frame::planes`].
pub(super) const PLANES: usize = 22;
/// First plane of the demodulated radiance of each half; a half has the planes red, green and blue.
pub(super) const HALVES: [usize; 2] = [0, 3];
/// First plane of the variance of one half of the samples, with three channels.
pub(super) const VARIANCE: usize = 6;
/// First of the three planes of the normal.
pub(super) const NORMAL: usize = 9;
/// First of the three planes of the position.
pub(super) const PLACE: usize = 12;
/// First of the three planes of the reflectance.
pub(super) const ALBEDO: usize = 15;
/// Plane of the gloss.
pub(super) const GLOSS: usize = 18;
/// Plane of α.
pub(super) const ALPHA: usize = 19;
/// Plane of the coverage.
pub(super) const COVERED: usize = 20;
/// Plane of ones. In a block of `band.rs`, it is 0 where the block has no pixel of the picture.
pub(super) const THERE: usize = 21;

/// One view, a plane per value: `[plane][row][col]`.
pub(super) struct Frame {
    pub(super) rows: usize,
    pub(super) cols: usize,
    planes: [Vec<f32>; PLANES],
    /// The number per pixel and channel by which the radiance is divided (demodulation).
    pub(super) modulation: Vec<[f32; 3]>,
    /// Slopes of the view at the centre of the field.
    slope: DVec2,
    projection: Projection,
    pitch_mm: f64,
}

impl Frame {
    pub(super) fn new(geometry: &FieldGeometry, view: [usize; 2], source: &NoisyView) -> Self {
        let (rows, cols) = (geometry.rows, geometry.cols);
        let count = rows * cols;
        let grid = &geometry.grid;
        assert_eq!(source.features.size(), [rows, cols], "expected guides of the geometry's size");
        let mut planes: [Vec<f32>; PLANES] = std::array::from_fn(|_| vec![0.0; count]);
        let mut modulation = Vec::with_capacity(count);
        for row in 0..rows {
            for col in 0..cols {
                let i = row * cols + col;
                let feature = source.features.at(row, col);
                // demodulation: divide both halves by the albedo, or by 1 where the environment
                // shows
                let shown = feature.covered * feature.albedo + Vec3::splat(1.0 - feature.covered);
                let factor = shown.max(Vec3::splat(LEAST_ALBEDO)).to_array();
                for (half, first) in source.halves.iter().zip(HALVES) {
                    let pixel = half.block([row, col]);
                    (0..3).for_each(|c| planes[first + c][i] = pixel[c] / factor[c]);
                }
                modulation.push(factor);
                // compute the position of the pixel's surface in display space, in pixels
                let point = [geometry.x_mm(col), geometry.y_mm(row)];
                let slope = grid.slope_at(view, point);
                let z = f64::from(feature.z_mm);
                let place =
                    [point[0] + slope[0] * z, point[1] + slope[1] * z, z].map(|v| (v / geometry.pitch_mm) as f32);
                for c in 0..3 {
                    planes[NORMAL + c][i] = feature.normal[c];
                    planes[PLACE + c][i] = place[c];
                    planes[ALBEDO + c][i] = feature.albedo[c];
                }
                planes[GLOSS][i] = feature.gloss;
                planes[ALPHA][i] = feature.alpha;
                planes[COVERED][i] = feature.covered;
                planes[THERE][i] = 1.0;
            }
        }
        for c in 0..3 {
            let [a, b] = HALVES.map(|first| &planes[first + c]);
            // (a − b)² has the mean 2 Var(a)
            let squares: Vec<f32> = a.iter().zip(b).map(|(a, b)| 0.5 * (a - b) * (a - b)).collect();
            // running sums may end slightly below zero
            planes[VARIANCE + c] =
                box_mean(&squares, rows, cols, VARIANCE_RADIUS).iter().map(|variance| variance.max(0.0)).collect();
        }
        let slope = DVec2::new(grid.slope_x[view[1]], grid.slope_y[view[0]]);
        Self { rows, cols, planes, modulation, slope, projection: grid.projection, pitch_mm: geometry.pitch_mm }
    }

    /// Returns the values of one plane, for all pixels.
    pub(super) fn plane(&self, plane: usize) -> &[f32] {
        &self.planes[plane]
    }

    /// Returns the length of the difference of the slopes of two views.
    pub(super) fn slope_to(&self, other: &Self) -> f32 {
        (self.slope - other.slope).length() as f32
    }

    /// Returns the index of the pixel of `other` that shows the surface of pixel (row, col). `None`
    /// if this pixel has no surface, or if `other` would show it outside of the picture.
    pub(super) fn seen_in(&self, other: &Self, row: usize, col: usize) -> Option<usize> {
        let i = row * self.cols + col;
        if self.planes[COVERED][i] <= 0.0 {
            return None;
        }
        let z_mm = f64::from(self.planes[PLACE + 2][i]) * self.pitch_mm;
        // In both views a point at (X, z) appears at the x for which x + s z = X. In a perspective
        // view, the slope s at x is the view's central slope minus x / `distance_mm`.
        let stretch = match self.projection {
            Projection::Oblique => 1.0,
            Projection::Perspective { distance_mm } => 1.0 - z_mm / distance_mm,
        };
        let shift = (self.slope - other.slope) * (z_mm / (stretch * self.pitch_mm));
        let (x, y) = ((col as f64 + shift.x).round(), (row as f64 - shift.y).round());
        (x >= 0.0 && y >= 0.0 && x < other.cols as f64 && y < other.rows as f64)
            .then(|| y as usize * other.cols + x as usize)
    }
}

/// Returns, for every pixel, the mean over a square with `radius` pixels on either side of its
/// centre. Pixels of the square that are outside of the picture are left out.
pub(super) fn box_mean(values: &[f32], rows: usize, cols: usize, radius: usize) -> Vec<f32> {
    let along = |values: &[f32], count: usize, step: usize, lines: usize, line_step: usize| {
        let mut result = vec![0.0; values.len()];
        for line in 0..lines {
            let at = |k: usize| line * line_step + k * step;
            let mut sum = 0.0f64;
            for k in 0..radius.min(count) {
                sum += f64::from(values[at(k)]);
            }
            for k in 0..count {
                if k + radius < count {
                    sum += f64::from(values[at(k + radius)]);
                }
                if k > radius {
                    sum -= f64::from(values[at(k - radius - 1)]);
                }
                let held = (k + radius).min(count - 1) + 1 - k.saturating_sub(radius);
                result[at(k)] = (sum / held as f64) as f32;
            }
        }
        result
    };
    along(&along(values, cols, 1, rows, cols), rows, cols, cols, 1)
}
