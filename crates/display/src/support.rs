//! Spectral support: the frequencies that a display can show, and the range of slopes over which
//! light may be averaged without loss of these frequencies.
//!
//! Along one axis the support is the Minkowski sum of the segments ±g of the layers and lenslets
//! ([`Display::spatial_cutoff`]). This sum is a polygon that is symmetric about the origin. The
//! first axis of its plane is the spatial frequency ω_x, in cycles per millimetre. The second axis
//! is the frequency per slope ω_s, in cycles per unit of slope (the paper's ω_v with d_r = 1). The
//! polygon is a box for a lens array, a diamond for two layers, and a hexagon for three layers (the
//! paper's Figure 4).
//!
//! Let ω_s now be the highest frequency of the support on the axis ω_x = 0. It limits the spatial
//! frequency at depths z far from the display: ω(z) → ω_s/|z|. An average of light over slopes of
//! width
//!
//! ```text
//! δs = 1/(2 ω_s)
//! ```
//!
//! blurs a plane at z over |z| δs = 1/(2 ω(z)), as a pixel of pitch p = 1/(2 ω) does on the
//! display. The pixel and δs together are the prefilter of the display (section 4.1). For lens
//! arrays alone δs is the width of an angular bin.

use crate::Display;
use crate::depth::{cross, cutoff, width};

impl Display {
    /// Returns ω(z) along one axis (0: x, 1: y), in cycles per millimetre.
    /// [`spatial_cutoff`](Self::spatial_cutoff) returns the smaller value of the two axes.
    pub fn spatial_cutoff_along(&self, axis: usize, z_mm: f64) -> f64 {
        cutoff(&self.generators(axis), z_mm)
    }

    /// Returns the corners of the support along one axis (0: x, 1: y), counterclockwise: [ω_x in
    /// cycles per millimetre, ω_s in cycles per unit of slope]. There are two corners if the
    /// support is a line.
    pub fn spectral_support(&self, axis: usize) -> Vec<[f64; 2]> {
        let mut generators = self.generators(axis);
        for g in &mut generators {
            if g[1] < 0.0 || (g[1] == 0.0 && g[0] < 0.0) {
                *g = [-g[0], -g[1]];
            }
        }
        generators.sort_by(|a, b| f64::atan2(a[1], a[0]).total_cmp(&f64::atan2(b[1], b[0])));
        let mut sides: Vec<[f64; 2]> = Vec::new();
        for g in generators {
            match sides.last_mut() {
                Some(last) if cross(*last, g).abs() <= PARALLEL * norm(*last) * norm(g) => {
                    *last = [last[0] + g[0], last[1] + g[1]];
                }
                _ => sides.push(g),
            }
        }
        let sum = sides.iter().fold([0.0, 0.0], |sum, g| [sum[0] - g[0], sum[1] - g[1]]);
        let mut corners = vec![sum];
        let turns = sides.iter().chain(sides.iter()).enumerate();
        let mut at = sum;
        for (i, g) in turns.take(2 * sides.len() - 1) {
            let sign = if i < sides.len() { 2.0 } else { -2.0 };
            at = [at[0] + sign * g[0], at[1] + sign * g[1]];
            corners.push(at);
        }
        corners
    }

    /// Returns the width of slopes δs per axis (x, y) over which light may be averaged. An average
    /// over this width loses no detail that the display can show far from the display plane. The
    /// width is at most the whole field of view. It is the whole field of view for a single layer
    /// with a uniform backlight.
    pub fn angular_footprint(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            let generators = self.generators(axis);
            let extents = generators.iter().filter(|g| g[0] > 0.0).map(|&g| width(&generators, g) / g[0]);
            let extent = extents.fold(f64::INFINITY, f64::min);
            let zone = 2.0 * (0.5 * self.field.fov_deg[axis].to_radians()).tan();
            if extent > 0.0 { zone.min(0.5 / extent) } else { zone }
        })
    }
}

/// Sine of an angle up to which segments are taken as parallel.
const PARALLEL: f64 = 1e-12;

fn norm(a: [f64; 2]) -> f64 {
    a[0].hypot(a[1])
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;
    use crate::{Backlight, LensletBacklight};

    fn stack(d_mm: &[f64]) -> Display {
        Display::uniform([16, 10], 0.5, [5, 5], [20.0, 20.0], d_mm, 1)
    }

    fn assert_corners(display: &Display, expected: &[[f64; 2]]) {
        let found = display.spectral_support(0);
        assert_eq!(found.len(), expected.len(), "{found:?}");
        for corner in expected {
            let near = found.iter().any(|f| (f[0] - corner[0]).abs() < 1e-9 && (f[1] - corner[1]).abs() < 1e-9);
            assert!(near, "{corner:?} is not among {found:?}");
        }
    }

    /// The spectral supports are those of the paper's Figure 4: a diamond, a hexagon and a box. The
    /// layers' highest frequency ω0 is 1 cycle per millimetre.
    #[test]
    fn supports_have_the_papers_corners() {
        assert_corners(&stack(&[-20.0, 20.0]), &[[2.0, 0.0], [0.0, 40.0], [-2.0, 0.0], [0.0, -40.0]]);
        let hexagon = [[3.0, 0.0], [1.0, 80.0], [-1.0, 80.0], [-3.0, 0.0], [-1.0, -80.0], [1.0, -80.0]];
        assert_corners(&stack(&[-40.0, 0.0, 40.0]), &hexagon);
        let mut directional = stack(&[0.0]);
        directional.backlight = Backlight::Lenslets(LensletBacklight::new(0.0, [4, 4], 2.0, [5, 5], [20.0, 20.0]));
        let (x, s) = (0.25 + 1.0, 0.5 / (0.4 * 10f64.to_radians().tan()));
        assert_corners(&directional, &[[x, s], [-x, s], [-x, -s], [x, -s]]);
        // the support of one layer is a line
        assert_corners(&stack(&[5.0]), &[[1.0, 5.0], [-1.0, -5.0]]);
    }

    /// For random stacks, the bound ω(z) is the frequency at which the line of direction (1, z)
    /// leaves the support.
    #[test]
    fn the_bound_lies_on_the_supports_edge() {
        let mut stream = Stream::new(11);
        let mut number = |low: f64, high: f64| low + (high - low) * f64::from(stream.next_f32());
        for _ in 0..500 {
            let mut d_mm: Vec<f64> = (0..number(2.0, 6.0) as usize).map(|_| number(-60.0, 60.0)).collect();
            d_mm.sort_by(f64::total_cmp);
            let mut display = stack(&d_mm);
            display.layers.iter_mut().for_each(|layer| layer.pitch_mm = number(0.2, 1.0));
            if number(0.0, 1.0) < 0.5 {
                let lenses = LensletBacklight::new(-70.0, [9, 9], number(1.0, 4.0), [7, 7], [40.0, 40.0]);
                display.backlight = Backlight::Lenslets(lenses);
            }
            let corners = display.spectral_support(0);
            let z = number(-200.0, 200.0);
            let bound = display.spatial_cutoff_along(0, z);
            let inside = |scale: f64| {
                let p = [scale * bound, scale * bound * z];
                (0..corners.len()).all(|i| {
                    let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                    cross([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]) >= -1e-9
                })
            };
            assert!(inside(1.0 - 1e-9) && !inside(1.001), "{z} of {d_mm:?}");
        }
    }

    #[test]
    fn the_footprint_is_a_bin_of_a_lens_array_and_half_a_pixel_per_gap_of_three_layers() {
        let mut lenses = stack(&[0.0]);
        lenses.backlight = Backlight::Lenslets(LensletBacklight::new(0.0, [4, 4], 2.0, [5, 5], [20.0, 20.0]));
        let bin = 0.4 * 10f64.to_radians().tan();
        assert!(lenses.angular_footprint().iter().all(|step| (step - bin).abs() < 1e-12));
        let three = stack(&[-40.0, 0.0, 40.0]);
        assert!(three.angular_footprint().iter().all(|step| (step - 0.5 * 0.5 / 40.0).abs() < 1e-12));
        let zone = 2.0 * 10f64.to_radians().tan();
        assert_eq!(stack(&[0.0]).angular_footprint(), [zone; 2]);
    }
}
