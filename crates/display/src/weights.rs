//! Weights w of the objective Σ w (βL − L̃)² (eq. 27, with real weights entering linearly).

use lumistack_core::Tensor;
use thiserror::Error;

use crate::FieldGeometry;

/// How much each ray counts; all values finite and ≥ 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Weights {
    /// Every ray 1.
    #[default]
    Uniform,
    /// One weight per view, `[view_y][view_x]`.
    PerView(Tensor<2>),
    /// One weight per ray, `[view_y][view_x][row][col]`.
    PerRay(Tensor<4>),
}

/// Weights that do not fit or are not weights.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("weights: expected {expected}, found {found}")]
pub struct WeightError {
    /// What was needed.
    pub expected: String,
    /// What was there.
    pub found: String,
}

impl Weights {
    /// Checks shape and values.
    ///
    /// # Errors
    /// If the shape is not that of the geometry, or a value is negative, infinite or NaN.
    pub fn check(&self, geometry: &FieldGeometry) -> Result<(), WeightError> {
        let [view_rows, view_cols] = geometry.grid.views();
        let (shape, expected, data) = match self {
            Self::Uniform => return Ok(()),
            Self::PerView(t) => (t.shape().to_vec(), vec![view_rows, view_cols], t.data()),
            Self::PerRay(t) => (t.shape().to_vec(), vec![view_rows, view_cols, geometry.rows, geometry.cols], t.data()),
        };
        if shape != expected {
            return Err(WeightError { expected: format!("shape {expected:?}"), found: format!("{shape:?}") });
        }
        match data.iter().find(|w| !(w.is_finite() && **w >= 0.0)) {
            Some(found) => Err(WeightError { expected: "finite values ≥ 0".into(), found: found.to_string() }),
            None => Ok(()),
        }
    }

    /// Weight of one ray; `view` = [view_y, view_x].
    #[inline]
    pub fn at(&self, view: [usize; 2], row: usize, col: usize) -> f32 {
        match self {
            Self::Uniform => 1.0,
            Self::PerView(t) => t.get(view),
            Self::PerRay(t) => t.get([view[0], view[1], row, col]),
        }
    }
}
