//! Depth of field: the highest spatial frequency that a display shows at each depth, and the shift
//! of content between views.
//!
//! In coordinates of spatial frequency and frequency per slope, a diffuse plane at z occupies the
//! line of direction u = (1, z). N layers and a backlight cover the Minkowski sum of segments ±g
//! (the paper's spectral support; this one form covers eqs. 21 to 26). So the highest spatial
//! frequency at depth z, in cycles per millimetre, is
//!
//! ```text
//! ω(z) = min over i with g_i × u ≠ 0 of  Σ_j |g_i × g_j| / |g_i × u|,
//!        a × c = a_1 c_2 − a_2 c_1
//! layer n:    g = (1, d_n)/(2 p_n)
//! lenslets:   g = (1, d_b)/(2 Δx)  and  g = (0, 1)/(2 Δs),   Δs = (2/A) tan(α/2)
//! ```
//!
//! Layer n has the distance d_n and the pitch p_n. The lenslets have the distance d_b, the pitch
//! Δx, and A bins over the angle α.
//!
//! The paper's bounds (23) to (26) are special cases of ω(z) with d_b = 0. Like these bounds, ω(z)
//! assumes continuous, band-limited layers and many frames, so it is a guide and not a strict
//! limit.

use crate::{Backlight, Display, FieldGeometry};

/// Relative tolerance of a frequency bound, so that rounding does not exclude a depth exactly at
/// the bound.
const ROUNDING: f64 = 1e-12;

impl Display {
    /// Returns the highest spatial frequency that the display can show on a plane at `z_mm`, in
    /// cycles per millimetre. This is the smaller ω(z) of the two axes.
    pub fn spatial_cutoff(&self, z_mm: f64) -> f64 {
        [0, 1].map(|axis| cutoff(&self.generators(axis), z_mm)).into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Returns the depths, [low, high] in millimetres, at which frequencies up to `cutoff` (cycles
    /// per millimetre) can be shown; `None` if there are none. A single layer without directional
    /// backlight shows these frequencies only in its own plane, so low = high.
    pub fn depths_shown(&self, cutoff: f64) -> Option<[f64; 2]> {
        let [x, y] = [0, 1].map(|axis| range(&self.generators(axis), cutoff));
        let ([x_low, x_high], [y_low, y_high]) = (x?, y?);
        let (low, high) = (x_low.max(y_low), x_high.min(y_high));
        (low <= high).then_some([low, high])
    }

    /// Returns the depths, [low, high] in millimetres, at which the display shows the finest detail
    /// of pixels of pitch `pitch_mm`. This detail has the frequency 1/(2 pitch). Returns `None` if
    /// there are no such depths.
    pub fn depth_of_field(&self, pitch_mm: f64) -> Option<[f64; 2]> {
        self.depths_shown(0.5 / pitch_mm)
    }

    /// Returns the segments g_i of the layers and the lenslets along one axis; see the head of the
    /// file.
    pub(crate) fn generators(&self, axis: usize) -> Vec<[f64; 2]> {
        let mut generators: Vec<[f64; 2]> = self
            .layers
            .iter()
            .map(|layer| {
                let cutoff = 0.5 / layer.pitch_mm;
                [cutoff, cutoff * layer.d_mm]
            })
            .collect();
        if let Backlight::Lenslets(backlight) = &self.backlight {
            let cutoff = 0.5 / backlight.pitch_mm;
            let step = 2.0 / backlight.views[axis] as f64 * (0.5 * backlight.fov_deg[axis].to_radians()).tan();
            generators.push([cutoff, cutoff * backlight.d_mm]);
            if step > 0.0 {
                generators.push([0.0, 0.5 / step]);
            }
        }
        generators
    }
}

pub(crate) fn cross(a: [f64; 2], c: [f64; 2]) -> f64 {
    a[0] * c[1] - a[1] * c[0]
}

/// Returns Σ_j |g × g_j| over all segments g_j.
pub(crate) fn width(generators: &[[f64; 2]], g: [f64; 2]) -> f64 {
    generators.iter().map(|other| cross(g, *other).abs()).sum()
}

pub(crate) fn cutoff(generators: &[[f64; 2]], z_mm: f64) -> f64 {
    // If all segments are parallel to u = (1, z), the bound is the sum of their spatial
    // frequencies.
    let along = || generators.iter().map(|g| g[0]).sum();
    let bounds = generators.iter().map(|&g| (width(generators, g), cross(g, [1.0, z_mm]).abs()));
    let bounds = bounds.filter(|(_, across)| *across > 0.0).map(|(width, across)| width / across);
    bounds.reduce(f64::min).unwrap_or_else(along)
}

/// Returns the interval of depths z with ω(z) ≥ `least`. The segment of a layer, or of the
/// lenslets, limits the distance |z − d| from its plane, so the depths are an interval.
fn range(generators: &[[f64; 2]], least: f64) -> Option<[f64; 2]> {
    let least = least * (1.0 - ROUNDING);
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for &g in generators {
        let width = width(generators, g);
        if g[0] == 0.0 {
            if width / g[1] < least {
                return None;
            }
            continue;
        }
        // For u = (1, z) and g = g_1 (1, d), |g × u| is g_1 |z − d|.
        let (d, reach) = (g[1] / g[0], width / (g[0] * least));
        (low, high) = (low.max(d - reach), high.min(d + reach));
    }
    let parallel = generators.iter().all(|&g| width(generators, g) == 0.0);
    if parallel && generators.iter().map(|g| g[0]).sum::<f64>() < least {
        return None;
    }
    (low <= high && low.is_finite()).then_some([low, high])
}

impl FieldGeometry {
    /// Returns the shift of content at depth `z_mm` between two views whose slopes differ by
    /// `step`, in field pixels on z = 0. A positive shift is opposite to the step. In perspective
    /// views the shift is infinite at the distance of the eyes. With Δs = `step` and pixel pitch p:
    ///
    /// ```text
    /// parallel projections        z·Δs/p
    /// pinholes at distance D      z·Δs/((1 − z/D) p)
    /// ```
    pub fn disparity_px(&self, z_mm: f64, step: f64) -> f64 {
        let seen = match self.grid.projection {
            crate::Projection::Oblique => z_mm,
            crate::Projection::Perspective { distance_mm } => z_mm / (1.0 - z_mm / distance_mm),
        };
        seen * step / self.pitch_mm
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;
    use crate::{LensletBacklight, Projection, ViewGrid};

    fn stack(d_mm: &[f64]) -> Display {
        Display::uniform([16, 10], 0.5, [5, 5], [20.0, 20.0], d_mm, 1)
    }

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1.0), "{found} instead of {expected}");
    }

    /// Two and three layers have the bounds of the paper's equations (24) and (25). The pitch of
    /// 0.5 mm gives ω0 = 1 cycle per millimetre.
    #[test]
    fn two_and_three_layers_have_the_papers_bounds() {
        let gap = 40.0;
        let (two, three) = (stack(&[-0.5 * gap, 0.5 * gap]), stack(&[-gap, 0.0, gap]));
        for z in [0.0, 0.5 * gap, gap, 1.5 * gap, 2.0 * gap, 4.0 * gap, -3.0 * gap, 7.3] {
            let far = f64::abs(z);
            close(two.spatial_cutoff(z), 2.0 * gap / (gap + 2.0 * far));
            let hexagon = if far <= 2.0 * gap { 3.0 * gap / (gap + far) } else { 2.0 * gap / far };
            close(three.spatial_cutoff(z), hexagon);
        }
        let [low, high] = three.depth_of_field(0.5).unwrap();
        close(low, -2.0 * gap);
        close(high, 2.0 * gap);
        let [low, high] = two.depth_of_field(0.5).unwrap();
        close(low, -0.5 * gap);
        close(high, 0.5 * gap);
        assert!(two.depth_of_field(0.2).is_none(), "a pitch of 0.2 mm is finer than two layers together can show");
    }

    /// The bounds of a lens array at z = 0 are equations (23) and (26) of the paper.
    #[test]
    fn a_directional_backlight_has_the_papers_bounds() {
        let (lenslet, views, fov) = (2.5, 5, 48.0f64);
        let step = 2.0 / views as f64 * (0.5 * fov.to_radians()).tan();
        let mut display = stack(&[0.0]);
        let backlight = LensletBacklight::new(0.0, [16, 10], lenslet, [views, views], [fov, fov]);
        display.backlight = Backlight::Lenslets(backlight);
        let (barrier, own) = (0.5 / lenslet, 1.0);
        for z in [0.0, 1.0, 2.0, 5.0, 40.0, -300.0] {
            let near = f64::abs(z) <= lenslet / (step + 2.0 * lenslet * step * own);
            close(display.spatial_cutoff(z), if near { barrier + own } else { 0.5 / (f64::abs(z) * step) });
        }
        // The depth of field of pixels of pitch 0.5 mm ends where content shifts by one pixel per
        // view. This shift is half a cycle of the finest detail.
        let [low, high] = display.depth_of_field(0.5).unwrap();
        close(high, 0.5 / step);
        close(low, -0.5 / step);
    }

    #[test]
    fn a_single_layer_shows_detail_on_itself_alone() {
        let display = stack(&[7.0]);
        assert_eq!(display.depth_of_field(0.5), Some([7.0, 7.0]));
        assert!(display.depth_of_field(0.4).is_none());
        close(display.spatial_cutoff(7.0), 1.0);
        close(display.spatial_cutoff(8.0), 0.0);
    }

    /// For random stacks, a depth is inside the returned interval exactly if the bound there
    /// reaches the requested frequency.
    #[test]
    fn the_range_is_where_the_bound_reaches() {
        let mut stream = Stream::new(3);
        for _ in 0..2000 {
            let mut d_mm: Vec<f64> = (0..1 + (3.9 * stream.next_f32()) as usize)
                .map(|_| 100.0 * f64::from(stream.next_f32()) - 50.0)
                .collect();
            d_mm.sort_by(f64::total_cmp);
            let mut display = stack(&d_mm);
            display.layers.iter_mut().for_each(|layer| layer.pitch_mm = 0.2 + f64::from(stream.next_f32()));
            if stream.next_f32() < 0.5 {
                display.backlight =
                    Backlight::Lenslets(LensletBacklight::new(-60.0, [9, 9], 2.0, [5, 3], [30.0, 20.0]));
            }
            let least = 0.2 + 2.0 * f64::from(stream.next_f32());
            let found = display.depths_shown(least);
            for _ in 0..50 {
                let z = 400.0 * f64::from(stream.next_f32()) - 200.0;
                let inside = found.is_some_and(|[low, high]| (low..=high).contains(&z));
                assert_eq!(inside, display.spatial_cutoff(z) >= least, "{z} in {found:?} of {d_mm:?} at {least}");
            }
        }
    }

    #[test]
    fn disparity_is_the_shift_of_a_point() {
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 500.0 }] {
            let grid = ViewGrid { projection, slope_x: vec![-0.05, 0.02], slope_y: vec![0.0] };
            let geometry = FieldGeometry { rows: 3, cols: 9, pitch_mm: 0.8, grid };
            for z in [-70.0, 0.0, 30.0] {
                // The view's ray through the point (10, z) crosses z = 0 at the x that solves x + z
                // s(x) = 10.
                let crossing = |view: usize| match projection {
                    Projection::Oblique => 10.0 - z * geometry.grid.slope_x[view],
                    Projection::Perspective { distance_mm } => {
                        (10.0 - z * geometry.grid.slope_x[view]) / (1.0 - z / distance_mm)
                    }
                };
                let moved = (crossing(0) - crossing(1)) / geometry.pitch_mm;
                close(geometry.disparity_px(z, 0.07), moved);
            }
        }
    }
}
