//! Views on the page: target, simulated view, difference and FLIP error.

use lumistack_core::metrics::Flip;
use lumistack_display::{EmittedView, FieldGeometry, Weights};

use super::names::title;
use super::score::{ViewFigures, counting, seen};
use crate::picture::{self, Embedded, Encoding, Linear};
use crate::{ReportError, ReportInput, ZoneView, format};

/// Target, simulated view, difference and FLIP error of one view.
#[derive(Clone, Debug)]
pub(crate) struct Comparison {
    /// Title, such as "Top left view".
    pub(crate) title: String,
    /// Direction, such as "−8.0° across, +8.0° up".
    pub(crate) direction: String,
    /// Scores; absent without a target.
    pub(crate) figures: Option<ViewFigures>,
    pub(crate) counted_share: f64,
    pub(crate) target: Option<Embedded>,
    pub(crate) simulated: Embedded,
    pub(crate) difference: Option<Embedded>,
    /// Factor by which the difference picture is amplified.
    pub(crate) amplification: u32,
    /// Picture of the FLIP error.
    pub(crate) flip: Option<Embedded>,
}

/// A view at full precision, before it is encoded as pictures.
pub(super) struct Shown {
    pub(super) title: String,
    pub(super) direction: String,
    /// Scores; absent without a target.
    pub(super) figures: Option<ViewFigures>,
    pub(super) counted_share: f64,
    pub(super) target: Option<Linear>,
    /// The view of the display, L̃/β.
    pub(super) simulated: Linear,
    /// Signed error of each pixel; see [`picture::signed_error`].
    pub(super) errors: Option<Vec<Option<f32>>>,
    /// FLIP error of every pixel; `None` for pixels whose rays the scores exclude.
    flip: Option<Vec<Option<f32>>>,
}

impl Shown {
    pub(super) fn new(
        input: &ReportInput,
        geometry: &FieldGeometry,
        target: &[f32],
        weights: &Weights,
        view: [usize; 2],
        figures: &ViewFigures,
        emitted: EmittedView,
    ) -> Self {
        let counts = counting(&emitted, geometry, weights, view);
        let flip = Flip::new(input.pixels_per_degree).compare(
            target,
            &seen(&emitted, target, input.stack.brightness, &counts),
            [geometry.rows, geometry.cols],
        );
        let flip = flip.values.iter().zip(&counts).map(|(flip, counts)| counts.then_some(*flip)).collect();
        let shown = Self::without_target(input, geometry, view, emitted);
        Self {
            flip: Some(flip),
            figures: Some(*figures),
            counted_share: figures.error.count as f64 / target.len() as f64,
            errors: Some(picture::signed_error(&shown.simulated.data, target, |i| counts[i])),
            target: Some(Linear::new(geometry.rows, geometry.cols, target, 1.0)),
            ..shown
        }
    }

    /// Makes the entry of a direction of the viewing zone.
    pub(super) fn of_zone(input: &ReportInput, view: &ZoneView, figures: &ViewFigures) -> Self {
        let geometry = input.target.geometry().with_grid(view.direction.clone());
        let shown = Self::new(input, &geometry, &view.target, &Weights::Uniform, [0, 0], figures, view.seen.clone());
        // Directions near the zone's border are outside of the target's outermost views, so the
        // title names no view.
        Self { title: "Seen picture".into(), ..shown }
    }

    pub(super) fn without_target(
        input: &ReportInput,
        geometry: &FieldGeometry,
        view: [usize; 2],
        emitted: EmittedView,
    ) -> Self {
        let scale = (1.0 / input.stack.brightness) as f32;
        let grid = &geometry.grid;
        let valid = emitted.valid.iter().filter(|valid| **valid).count();
        Self {
            title: title(grid, &input.target.geometry().grid, view),
            direction: format!(
                "{} across, {} up",
                format::angle(grid.slope_x[view[1]]),
                format::angle(grid.slope_y[view[0]])
            ),
            figures: None,
            counted_share: valid as f64 / emitted.valid.len() as f64,
            target: None,
            simulated: Linear::new(geometry.rows, geometry.cols, emitted.radiance.data(), scale),
            errors: None,
            flip: None,
        }
    }

    /// Encodes the pictures of one comparison, reduced by `factor`. The encoding depends on the
    /// number of pixels of `count` such comparisons.
    pub(super) fn compare(&self, amplification: u32, factor: usize, count: usize) -> Result<Comparison, ReportError> {
        let simulated = self.simulated.shrunk(factor).encoded();
        let (rows, cols) = (self.simulated.rows, self.simulated.cols);
        let encoding = Encoding::for_pixels(4 * count * simulated.rows * simulated.cols);
        let target = self.target.as_ref().map(|target| target.shrunk(factor).encoded().embedded(encoding));
        let difference = self
            .errors
            .as_ref()
            .map(|errors| picture::difference(rows, cols, errors, amplification).shrunk(factor).embedded(encoding));
        let flip = self.flip.as_ref().map(|flip| picture::flip_map(rows, cols, flip).shrunk(factor).embedded(encoding));
        Ok(Comparison {
            title: self.title.clone(),
            direction: self.direction.clone(),
            figures: self.figures,
            counted_share: self.counted_share,
            target: target.transpose()?,
            simulated: simulated.embedded(encoding)?,
            difference: difference.transpose()?,
            amplification,
            flip: flip.transpose()?,
        })
    }
}
