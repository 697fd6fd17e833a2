//! The model of a camera that photographs a plane: a homography and radial distortion. The
//! Levenberg-Marquardt method fits them.

use lumistack_plugin::display::Homography;

/// A camera that photographs the plane z = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Maps millimetres on the plane to the undistorted photograph. In the photograph, the origin
    /// is the centre, the unit is half the diagonal, and y points down.
    pub homography: Homography,
    /// Radial distortion k₁, k₂: a point at radius r moves to r · (1 + k₁ r² + k₂ r⁴).
    pub distortion: [f64; 2],
    centre_px: [f64; 2],
    unit_px: f64,
}

/// Largest number of iterations of the fit, which ends earlier after an iteration with nearly no
/// improvement.
const STEPS: usize = 60;
/// Number of fixed-point iterations that remove the distortion. For the distortion of real lenses,
/// each iteration at least halves the error.
const UNDISTORT: usize = 40;

impl Camera {
    /// Fits a camera to `pairs` (position on the plane, millimetres; position in the photograph,
    /// pixels) by least squares of the reprojection error. `size` is [columns, rows] of the
    /// photograph.
    pub fn fit(pairs: &[([f64; 2], [f64; 2])], size: [f64; 2]) -> Self {
        let centre_px = size.map(|count| (count - 1.0) / 2.0);
        let unit_px = 0.5 * size[0].hypot(size[1]);
        let undistorted: Vec<_> =
            pairs.iter().map(|(mm, px)| (*mm, [0, 1].map(|axis| (px[axis] - centre_px[axis]) / unit_px))).collect();
        let mut camera = Self { homography: homography(&undistorted), distortion: [0.0; 2], centre_px, unit_px };
        // Divide millimetres by the largest coordinate, so that all parameters are near 1.
        let extent = pairs.iter().flat_map(|(mm, _)| mm).fold(1e-9f64, |most, value| most.max(value.abs()));
        let mut parameters = camera.parameters(extent);
        let residuals = |parameters: &[f64; 10]| -> Vec<f64> {
            let camera = camera.with(parameters, extent);
            pairs
                .iter()
                .flat_map(|(mm, px)| {
                    let reprojected = camera.see(*mm);
                    [reprojected[0] - px[0], reprojected[1] - px[1]]
                })
                .collect()
        };
        let cost = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>();
        let mut now = residuals(&parameters);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            // Compute the Jacobian by central differences.
            let columns: Vec<Vec<f64>> = (0..10)
                .map(|k| {
                    const STEP: f64 = 1e-6;
                    let [mut up, mut down] = [parameters; 2];
                    (up[k], down[k]) = (up[k] + STEP, down[k] - STEP);
                    let (up, down) = (residuals(&up), residuals(&down));
                    up.iter().zip(down).map(|(up, down)| (up - down) / (2.0 * STEP)).collect()
                })
                .collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let mut better = false;
            // Solve the damped normal equations; raise the damping until the sum of squares falls.
            for _ in 0..8 {
                let matrix = (0..10).map(|i| {
                    let mut row: Vec<f64> = (0..10).map(|j| dot(&columns[i], &columns[j])).collect();
                    row[i] *= 1.0 + damping;
                    row.push(-dot(&columns[i], &now));
                    row
                });
                let step = solve(matrix.collect());
                let mut next = parameters;
                next.iter_mut().zip(&step).for_each(|(parameter, step)| *parameter += step);
                let then = residuals(&next);
                if cost(&then) < cost(&now) {
                    better = cost(&now) - cost(&then) > 1e-12 * cost(&now);
                    (parameters, now, damping) = (next, then, damping * 0.2);
                    break;
                }
                damping *= 8.0;
            }
            if !better {
                break;
            }
        }
        camera = camera.with(&parameters, extent);
        camera
    }

    fn parameters(&self, extent: f64) -> [f64; 10] {
        let h = &self.homography.0;
        let s = h[2][2];
        let at = |r: usize, c: usize| h[r][c] / s * if c < 2 { extent } else { 1.0 };
        [
            at(0, 0),
            at(0, 1),
            at(0, 2),
            at(1, 0),
            at(1, 1),
            at(1, 2),
            at(2, 0),
            at(2, 1),
            self.distortion[0],
            self.distortion[1],
        ]
    }

    fn with(&self, p: &[f64; 10], extent: f64) -> Self {
        let row = |i: usize, last: f64| [p[i] / extent, p[i + 1] / extent, last];
        let homography = Homography([row(0, p[2]), row(3, p[5]), row(6, 1.0)]);
        Self { homography, distortion: [p[8], p[9]], ..self.clone() }
    }

    /// Maps a point of the photographed plane, in millimetres, to its position in the photograph,
    /// in pixels.
    pub fn see(&self, mm: [f64; 2]) -> [f64; 2] {
        let u = self.homography.apply(mm);
        let factor = self.factor(u);
        [0, 1].map(|axis| self.centre_px[axis] + self.unit_px * u[axis] * factor)
    }

    fn factor(&self, u: [f64; 2]) -> f64 {
        let r2 = u[0] * u[0] + u[1] * u[1];
        1.0 + r2 * (self.distortion[0] + r2 * self.distortion[1])
    }

    /// Returns the point of the plane, in millimetres, that appears at a position in the
    /// photograph, in pixels.
    pub fn on_plane(&self, px: [f64; 2]) -> [f64; 2] {
        let distorted = [0, 1].map(|axis| (px[axis] - self.centre_px[axis]) / self.unit_px);
        let mut u = distorted;
        for _ in 0..UNDISTORT {
            let factor = self.factor(u);
            u = distorted.map(|value| value / factor);
        }
        self.homography.inverse().apply(u)
    }

    /// Returns the root mean square reprojection error of `pairs`, pixels.
    pub fn rms_px(&self, pairs: &[([f64; 2], [f64; 2])]) -> f64 {
        let sum: f64 = pairs
            .iter()
            .map(|(mm, px)| {
                let reprojected = self.see(*mm);
                (reprojected[0] - px[0]).powi(2) + (reprojected[1] - px[1]).powi(2)
            })
            .sum();
        (sum / pairs.len() as f64).sqrt()
    }
}

/// Returns the homography that maps the first point of each pair to the second, by least squares.
/// The first step is the linear solution in normalized coordinates (Hartley, 1997). Four further
/// steps with new weights then approximately minimize the geometric error.
pub fn homography(pairs: &[([f64; 2], [f64; 2])]) -> Homography {
    let from = scaling(pairs.iter().map(|(from, _)| *from));
    let to = scaling(pairs.iter().map(|(_, to)| *to));
    let scaled: Vec<_> = pairs.iter().map(|(a, b)| (from.apply(*a), to.apply(*b))).collect();
    let mut h = [0.0f64; 8];
    for round in 0..5 {
        let mut normal = vec![vec![0.0; 9]; 8];
        for ([x, y], [u, v]) in &scaled {
            let weight = if round == 0 { 1.0 } else { 1.0 / (h[6] * x + h[7] * y + 1.0).powi(2) };
            let rows = [
                ([*x, *y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], *u),
                ([0.0, 0.0, 0.0, *x, *y, 1.0, -v * x, -v * y], *v),
            ];
            for (row, right) in rows {
                for i in 0..8 {
                    (0..8).for_each(|j| normal[i][j] += weight * row[i] * row[j]);
                    normal[i][8] += weight * row[i] * right;
                }
            }
        }
        h.copy_from_slice(&solve(normal));
    }
    let scaled = Homography([[h[0], h[1], h[2]], [h[3], h[4], h[5]], [h[6], h[7], 1.0]]);
    to.inverse().after(&scaled.after(&from))
}

/// Returns the map that moves the points' centroid to the origin, and scales the points' mean
/// distance from the centroid to 1.
fn scaling(points: impl Iterator<Item = [f64; 2]> + Clone) -> Homography {
    let count = points.clone().count().max(1) as f64;
    let centre = points.clone().fold([0.0; 2], |sum, p| [sum[0] + p[0] / count, sum[1] + p[1] / count]);
    let spread = points.map(|p| (p[0] - centre[0]).hypot(p[1] - centre[1])).sum::<f64>() / count;
    let s = 1.0 / spread.max(1e-300);
    Homography([[s, 0.0, -s * centre[0]], [0.0, s, -s * centre[1]], [0.0, 0.0, 1.0]])
}

/// Solves a system of linear equations by Gaussian elimination with partial pivoting. Each row is a
/// row of the matrix, followed by the right side. A singular matrix gives values that are not
/// finite.
fn solve(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let n = rows.len();
    for i in 0..n {
        let pivot = (i..n).max_by(|a, b| rows[*a][i].abs().total_cmp(&rows[*b][i].abs())).unwrap_or(i);
        rows.swap(i, pivot);
        let top = rows[i].clone();
        for row in rows.iter_mut().skip(i + 1) {
            let factor = row[i] / top[i];
            row.iter_mut().zip(&top).skip(i).for_each(|(value, top)| *value -= factor * top);
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| rows[i][j] * x[j]).sum();
        x[i] = (rows[i][n] - known) / rows[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> impl Iterator<Item = [f64; 2]> {
        (-3..=3).flat_map(|i| (-2..=2).map(move |j| [f64::from(i) * 40.0, f64::from(j) * 40.0]))
    }

    #[test]
    fn exact_points_give_the_homography_back() {
        let map = Homography([[1.2, 0.1, 30.0], [-0.2, 0.9, -4.0], [2e-4, -1e-4, 1.0]]);
        let pairs: Vec<_> = grid().map(|p| (p, map.apply(p))).collect();
        let found = homography(&pairs);
        for (from, to) in pairs {
            let at = found.apply(from);
            assert!((at[0] - to[0]).abs() < 1e-8 && (at[1] - to[1]).abs() < 1e-8, "{at:?} {to:?}");
        }
    }

    #[test]
    fn a_camera_with_a_bent_lens_is_found() {
        for distortion in [[0.0, 0.0], [-0.12, 0.03], [0.08, -0.01]] {
            let truth = Camera {
                homography: Homography([[3e-3, 1e-4, 0.05], [-1e-4, -3e-3, -0.02], [1e-4, -5e-5, 1.0]]),
                distortion,
                centre_px: [599.5, 399.5],
                unit_px: 0.5 * 1200f64.hypot(800.0),
            };
            let pairs: Vec<_> = grid().map(|p| (p, truth.see(p))).collect();
            let found = Camera::fit(&pairs, [1200.0, 800.0]);
            assert!(found.rms_px(&pairs) < 1e-4, "{distortion:?}: {}", found.rms_px(&pairs));
            for p in grid() {
                let back = found.on_plane(truth.see(p));
                assert!((back[0] - p[0]).abs() < 1e-3 && (back[1] - p[1]).abs() < 1e-3, "{back:?} {p:?}");
            }
        }
    }
}
