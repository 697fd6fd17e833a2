//! The slopes at which pixels of different layers coincide, and the views at these slopes.

use crate::views::{half_width, steps_within, views_of};
use crate::{Backlight, Display, GridError, Projection, ViewGrid, Views};

/// Largest number of views per axis that [`Views::Auto`] chooses.
const MOST_AUTO: usize = 101;
/// Number of views per angular bin of a directional backlight. A bin emits the same light in all
/// its directions, so its best value is a mean over several views. On the display
/// `paper-directional`, a scene with letters has a zone score of 22.5 dB for one view per bin.
/// Three views per bin give 24.1 dB. One view that is the mean over the bin gives 22.9 dB.
const VIEWS_PER_BIN: f64 = 3.0;

/// Returns a display's native step of slopes per axis (x, y); `None` for an axis without parallax.
/// The native step is the smallest of these changes of slope:
///
/// * p / max |Δd|, where p is the pitch, and |Δd| a layer's distance from the display plane or from
///   the next layer. This change moves a layer by one pixel against the light field or the next
///   layer.
/// * The change that moves the rays by one bin of the backlight.
///
/// Suppose that all layers have one pitch, and the first change is the smallest. Then every
/// multiple of the step shifts the layer farthest from the display plane, or the two layers at the
/// largest gap against each other, by whole pixels. If every layer is in the display plane or at
/// the distance max |Δd| from it, all layers shift by whole pixels. Then the ray through a pixel's
/// centre gives the exact mean over the pixel's area. At slopes between two neighbouring multiples,
/// two neighbouring layers combine only pairs of pixels that they also combine at one of these
/// multiples.
pub fn native_step(display: &Display) -> [Option<f64>; 2] {
    let against_field = display.layers.iter().map(|layer| (layer.d_mm.abs(), layer.pitch_mm));
    let gaps =
        display.layers.windows(2).map(|pair| (pair[1].d_mm - pair[0].d_mm, pair[0].pitch_mm.min(pair[1].pitch_mm)));
    let moving = against_field.chain(gaps).filter(|(distance, _)| *distance > 0.0);
    let finest = moving.map(|(distance, pitch)| pitch / distance).reduce(f64::min);
    [0, 1].map(|axis| match (finest, bin_width(display, axis)) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    })
}

/// Returns the width in slopes of a bin of the directional backlight along an axis. `None` for a
/// uniform backlight or a single bin.
pub(crate) fn bin_width(display: &Display, axis: usize) -> Option<f64> {
    match &display.backlight {
        Backlight::Lenslets(lenslets) if lenslets.views[axis] > 1 => {
            Some(2.0 * (0.5 * lenslets.fov_deg[axis].to_radians()).tan() / lenslets.views[axis] as f64)
        }
        _ => None,
    }
}

impl Display {
    /// Returns the views of the light field for which the display is made.
    ///
    /// # Errors
    /// If an angle is outside of 0..180°, or if the viewing distance is not above 0. Also if there
    /// are no views, or if the steps give more than 65536 views along an axis.
    pub fn view_grid(&self, projection: Projection) -> Result<ViewGrid, GridError> {
        self.field.views.grid(projection, self.field.fov_deg, || self.auto_step(usize::MAX))
    }

    /// Returns the [horizontal, vertical] number of views of [`view_grid`](Self::view_grid); 0 if
    /// the display is invalid.
    pub fn views(&self) -> [usize; 2] {
        let [rows, cols] = self.view_grid(Projection::Oblique).map_or([0, 0], |grid| grid.views());
        [cols, rows]
    }

    /// Returns the step of slopes (x, y) of [`Views::Auto`]. It is the smaller of the
    /// [native](native_step) step and a third of a bin of a directional backlight. If this step
    /// gives more than `most_views` views, or more than 101 along an axis, the function returns a
    /// multiple of the step. An axis with parallax keeps at least three views, since a display that
    /// is solved for one direction is wrong in all others. So the step of such an axis is at most
    /// 0.8 of half the zone's width. The step of an axis without parallax, or without field of
    /// view, is 0.
    pub fn auto_step(&self, most_views: usize) -> [f64; 2] {
        let half = self.field.fov_deg.map(half_width);
        let mut native = native_step(self);
        for (axis, native) in native.iter_mut().enumerate() {
            *native = native.map(|native| bin_width(self, axis).map_or(native, |bin| native.min(bin / VIEWS_PER_BIN)));
        }
        let step = |every: f64| {
            [0, 1].map(|axis| match native[axis] {
                // a step of at most 0.8 half widths keeps the outer two of three views inside the
                // zone
                Some(native) if half[axis] > 0.0 => (every * native).min(0.8 * half[axis]),
                _ => 0.0,
            })
        };
        let count = |step: [f64; 2]| [0, 1].map(|axis| views_of(steps_within(half[axis], step[axis])));
        let fits = |step: [f64; 2]| {
            let [x, y] = count(step);
            x.max(y) <= MOST_AUTO && x.saturating_mul(y) <= most_views
        };
        // increase the multiple until the views fit, but keep at least three views
        let axes = [0, 1].map(|axis| native[axis].map_or(1.0, |native| half[axis] / native / (MOST_AUTO / 2) as f64));
        let mut every = axes[0].max(axes[1]).floor().max(1.0);
        while !fits(step(every)) && count(step(every)).iter().any(|count| *count > 3) {
            every += 1.0;
        }
        step(every)
    }

    /// Returns this display with [`Views::Auto`] replaced by the step of
    /// [`auto_step`](Self::auto_step) for `most_views`. Other views stay.
    #[must_use]
    pub fn with_views_chosen(mut self, most_views: usize) -> Self {
        if self.field.views == Views::Auto {
            self.field.views = Views::Step(self.auto_step(most_views));
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stack(cols: usize) -> Display {
        let pitch = 475.02 / cols as f64;
        let plain = Display::uniform([cols, cols * 5 / 8], pitch, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 6);
        let mut display = Display { missing: crate::Missing::Clear, ..plain };
        display.field.views = Views::Auto;
        display
    }

    /// The number of automatic views is the number of slopes within 20° at which layers 40 mm apart
    /// shift by whole pixels.
    #[test]
    fn a_display_takes_its_native_slopes() {
        for (cols, views) in [(280, 9), (420, 13), (840, 25)] {
            let display = stack(cols);
            assert_eq!(display.views(), [views, views], "{cols}");
            let grid = display.geometry().unwrap().grid;
            let step = native_step(&display)[0].unwrap();
            assert!((grid.slope_x[views - 1] / step - (views / 2) as f64).abs() < 1e-12);
            assert!(grid.slope_y[0] > grid.slope_y[1] && grid.slope_x[0] < grid.slope_x[1]);
        }
    }

    #[test]
    fn a_bin_of_a_backlight_has_three_views() {
        let mut display = stack(420);
        display.layers.retain(|layer| layer.d_mm == 0.0);
        display.backlight =
            crate::Backlight::Lenslets(crate::LensletBacklight::new(-8.5, [187, 117], 2.54, [5, 3], [20.0, 20.0]));
        assert_eq!(display.views(), [15, 9]);
        let grid = display.geometry().unwrap().grid;
        assert!((grid.slope_x[14] - 10f64.to_radians().tan() * 14.0 / 15.0).abs() < 1e-12);
    }

    #[test]
    fn views_are_thinned_to_a_budget() {
        let display = stack(840);
        for (most, views) in [(625, 25), (624, 13), (169, 13), (168, 9), (80, 7), (9, 3), (1, 3)] {
            assert_eq!(display.clone().with_views_chosen(most).views(), [views, views], "{most}");
        }
        let fixed = Display::uniform([16, 10], 1.0, [5, 3], [20.0, 20.0], &[-12.0, 12.0], 1);
        assert_eq!(fixed.clone().with_views_chosen(1), fixed, "a given number of views stays");
    }

    /// An axis with parallax has at least three views, even if pixels are so coarse that the native
    /// step is wider than the zone. An axis without field of view has one view. A display whose
    /// only layer is in the display plane also has one view.
    #[test]
    fn what_shows_parallax_has_three_views_and_the_rest_one() {
        let mut coarse = stack(20);
        assert_eq!(coarse.views(), [3, 3]);
        coarse.field.fov_deg[1] = 0.0;
        assert_eq!(coarse.views(), [3, 1]);
        let mut flat = stack(420);
        flat.layers.retain(|layer| layer.d_mm == 0.0);
        assert_eq!(flat.views(), [1, 1]);
        // pixels of a micrometre would need many views, but there are at most [`MOST_AUTO`]
        let fine = stack(400_000);
        assert!(fine.views()[0] <= MOST_AUTO && fine.views()[0] > MOST_AUTO / 2);
    }

    /// Between neighbouring native slopes, a layer shifts by one pixel. Three layers 40 mm apart
    /// with 420 columns have 13 native slopes within 20°.
    #[test]
    fn native_steps_are_whole_shifts() {
        let display = Display::uniform([420, 262], 1.128, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 6);
        let step = native_step(&display)[0].unwrap();
        assert!((step - 1.128 / 40.0).abs() < 1e-12);
        assert_eq!(2 * (10f64.to_radians().tan() / step).floor() as usize + 1, 13);
        // two layers around z = 0: one step moves them by one pixel against each other
        let pair = Display::uniform([4, 4], 1.0, [1, 1], [20.0, 20.0], &[-10.0, 10.0], 1);
        assert_eq!(native_step(&pair), [Some(0.05); 2]);
        let flat = Display::uniform([4, 4], 1.0, [1, 1], [20.0, 20.0], &[0.0], 1);
        assert_eq!(native_step(&flat), [None, None]);
    }
}
