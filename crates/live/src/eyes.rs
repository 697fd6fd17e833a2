//! Rays to the eyes of tracked viewers.
//!
//! ```text
//! x   = head ± e/2 ± σ      positions for which patterns are solved, along the horizontal axis
//! L_x = Σ w_v L_v           radiance of a ray to x
//! ```
//!
//! `e` is the distance between the eyes, and σ is the uncertainty of an eye's predicted position.
//! For each eye, the two positions are the nodes of Gauss' quadrature for a normal distribution
//! around the eye. The light field has views L_v at other positions. So the radiance of a ray is
//! the mean of the four views around the ray, with the bilinear weights w_v.
//!
//! Between two native slopes of the display (see `display/src/native.rs`), an eye sees weighted
//! means of several products of pixels' transmittances. Larger weights of the light field's own
//! views would constrain these products, but not their means. Views from the eyes constrain the
//! means, if the layers are sampled [bilinearly](Sampling::Bilinear). The gain at the eyes over
//! patterns for the whole zone was measured in the test with recorded heads. Views from the eyes
//! gained 14 dB. Larger weights gained 1 to 2 dB.

use lumistack_core::Tensor;
use lumistack_display::{Display, GridError, LightField, Projection, Sampling, ViewGrid, WeightError, Weights};
use lumistack_factorizer::Problem;
use rayon::prelude::*;
use thiserror::Error;

use crate::Target;
use crate::track::{Boxes, Eyes};

/// Distance between the eyes of a viewer, mm: the mean of adults.
const BETWEEN_EYES_MM: f64 = 63.0;
/// Default uncertainty σ of an eye's predicted position, mm.
pub const SIGMA_MM: f64 = 10.0;
/// Largest number of viewers whose eyes have views. A grid of views is separable, so the number of
/// views grows with the square of the number of viewers. If there are more viewers, rays near them
/// get larger weights in the light field's own views instead.
const MOST_VIEWERS: usize = 4;

/// The rays for which patterns are solved.
#[derive(Clone, Debug)]
pub enum Rays {
    /// The rays of the target's views, with weights.
    Views(Weights),
    /// Rays to the eyes of viewers.
    Eyes(Box<EyeViews>),
}

/// Views of a target from the eyes of viewers.
#[derive(Clone, Debug)]
pub struct EyeViews {
    /// The target's display, whose layers are sampled bilinearly.
    display: Display,
    field: LightField,
    weights: Weights,
}

/// The rays of a target cannot be computed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RaysError {
    /// Weights cannot be computed.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// A viewer's views are not valid.
    #[error("viewer: {0}")]
    Views(#[from] GridError),
}

impl Boxes {
    /// Returns the rays for which a target is solved. While one to four viewers are tracked, these
    /// are rays to their eyes. Otherwise, and while the tracker is silent, these are the rays of
    /// all views, with weights.
    ///
    /// `sigma_mm` is the uncertainty of an eye's predicted position (standard deviation), mm, > 0.
    ///
    /// # Errors
    /// If the target's geometry is invalid, or a viewer is so near that a slope is not finite.
    pub fn rays(&self, target: &Target, sigma_mm: f64) -> Result<Rays, RaysError> {
        if self.zone > 0.0 || !(1..=MOST_VIEWERS).contains(&self.heads_mm.len()) {
            return Ok(Rays::Views(self.weights(target.field.geometry(), &target.weights)?));
        }
        let (grid, weights) = self.grid(target.field.geometry().grid.projection, sigma_mm);
        let display = Display { sampling: Sampling::Bilinear, ..(*target.display).clone() };
        let field = seen_from(&target.field, grid, &weights)?;
        Ok(Rays::Eyes(Box::new(EyeViews { display, field, weights })))
    }

    /// Returns two views per eye, `sigma_mm` to its left and right, and the weights of all views. A
    /// grid is separable, so it also has views in the columns of one viewer and the row of another;
    /// their weight is 0.
    fn grid(&self, own: Projection, sigma_mm: f64) -> (ViewGrid, Weights) {
        let half_mm = match self.eyes {
            Eyes::Two => 0.5 * BETWEEN_EYES_MM,
            Eyes::Picture => 0.0,
        };
        let (mut columns, mut rows) = (Vec::new(), Vec::new());
        for (head, &[x, y, z]) in self.heads_mm.iter().enumerate() {
            let mut offsets = vec![half_mm - sigma_mm, half_mm + sigma_mm];
            if half_mm > 0.0 {
                offsets.extend([-half_mm - sigma_mm, -half_mm + sigma_mm]);
            }
            columns.extend(offsets.iter().map(|offset| ((x + offset) / z, head)));
            rows.push((y / z, head));
        }
        columns.sort_by(|a, b| a.0.total_cmp(&b.0));
        rows.sort_by(|a, b| b.0.total_cmp(&a.0));
        // A grid has one distance. For several viewers, this is the harmonic mean of their
        // distances.
        let projection = match self.eyes {
            Eyes::Two => Projection::Perspective {
                distance_mm: self.heads_mm.len() as f64 / self.heads_mm.iter().map(|head| 1.0 / head[2]).sum::<f64>(),
            },
            Eyes::Picture => own,
        };
        let mut weights = Tensor::zeros(["view_y", "view_x"], [rows.len(), columns.len()]);
        for (y, (_, of_row)) in rows.iter().enumerate() {
            for (x, (_, of_column)) in columns.iter().enumerate() {
                weights.block_mut([y])[x] = if of_row == of_column { 1.0 } else { 0.0 };
            }
        }
        let slopes = |nodes: &[(f64, usize)]| nodes.iter().map(|(slope, _)| *slope).collect();
        (ViewGrid { projection, slope_x: slopes(&columns), slope_y: slopes(&rows) }, Weights::PerView(weights))
    }
}

impl EyeViews {
    /// Returns the target's display, whose layers are sampled bilinearly.
    pub fn display(&self) -> &Display {
        &self.display
    }

    /// Returns the light field. It has a row of views for each viewer, and two columns of views for
    /// each eye. With [`Eyes::Picture`], a viewer has one eye. Views of weight 0 are black.
    pub fn field(&self) -> &LightField {
        &self.field
    }

    /// Returns the weights of the views: 1 in the row and the columns of the same viewer, 0
    /// elsewhere.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }
}

impl Rays {
    /// Returns the problem whose solution shows `target` along these rays.
    pub(crate) fn problem<'a>(&'a self, target: &'a Target) -> Problem<'a> {
        match self {
            Self::Views(weights) => Problem { display: &target.display, target: &target.field, weights },
            Self::Eyes(eyes) => Problem { display: &eyes.display, target: &eyes.field, weights: &eyes.weights },
        }
    }
}

/// Two neighbouring views along one axis, whose slopes are on the two sides of a ray's slope.
#[derive(Clone, Copy, Debug)]
struct Between {
    views: [usize; 2],
    /// Weight of the second view, 0..1.
    share: f32,
}

impl Between {
    /// Finds the views on the two sides of a slope. If the slope is outside the range of the views,
    /// the nearest view is returned twice.
    fn of(slopes: &[f64], slope: f64) -> Self {
        let below = (0..slopes.len()).filter(|&i| slopes[i] <= slope).max_by(|&a, &b| slopes[a].total_cmp(&slopes[b]));
        let above = (0..slopes.len()).filter(|&i| slopes[i] >= slope).min_by(|&a, &b| slopes[a].total_cmp(&slopes[b]));
        let views = [below.or(above).unwrap_or(0), above.or(below).unwrap_or(0)];
        let step = slopes[views[1]] - slopes[views[0]];
        let share = if step > 0.0 { ((slope - slopes[views[0]]) / step) as f32 } else { 0.0 };
        Self { views, share }
    }
}

/// Returns, for every view of `to` along one axis and every pixel position in `at_mm`, the two
/// views of `from` around the ray.
fn between(from: (Projection, &[f64]), to: (Projection, &[f64]), at_mm: &[f64]) -> Vec<Vec<Between>> {
    let ((own, slopes), (new, wanted)) = (from, to);
    // the view of `from` whose ray through x has the slope of the new ray
    let of_ray = |slope: f64, x_mm: f64| Between::of(slopes, new.slope(slope, x_mm) - own.slope(0.0, x_mm));
    wanted.iter().map(|&slope| at_mm.iter().map(|&x_mm| of_ray(slope, x_mm)).collect()).collect()
}

/// Returns a light field in other views. Each ray is a mixture of the rays of the four views around
/// it, through the same point of the display plane. Views of weight 0 stay black. The rows of all
/// views are computed in parallel.
fn seen_from(field: &LightField, grid: ViewGrid, weights: &Weights) -> Result<LightField, GridError> {
    let from = field.geometry();
    let mut seen = LightField::black(from.with_grid(grid))?;
    let to = seen.geometry().grid.clone();
    let (x_mm, y_mm): (Vec<f64>, Vec<f64>) =
        ((0..from.cols).map(|col| from.x_mm(col)).collect(), (0..from.rows).map(|row| from.y_mm(row)).collect());
    let columns = between((from.grid.projection, &from.grid.slope_x), (to.projection, &to.slope_x), &x_mm);
    let rows = between((from.grid.projection, &from.grid.slope_y), (to.projection, &to.slope_y), &y_mm);
    let sources: Vec<&[f32]> = from.grid.iter().map(|view| field.view(view)).collect();
    let views: Vec<[usize; 2]> = to.iter().collect();
    let width = 3 * from.cols;
    seen.radiance_mut().data_mut().par_chunks_exact_mut(width).enumerate().for_each(|(line, mixed)| {
        let (view, row) = (views[line / from.rows], line % from.rows);
        if weights.at(view, row, 0) == 0.0 {
            return;
        }
        let y = &rows[view[0]][row];
        for (col, (rgb, x)) in mixed.chunks_exact_mut(3).zip(&columns[view[1]]).enumerate() {
            let at = row * width + 3 * col;
            for (view_row, weight_y) in y.views.into_iter().zip([1.0 - y.share, y.share]) {
                for (view_col, weight_x) in x.views.into_iter().zip([1.0 - x.share, x.share]) {
                    let source = &sources[view_row * from.grid.slope_x.len() + view_col][at..at + 3];
                    let weight = weight_y * weight_x;
                    rgb.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    });
    Ok(seen)
}
