//! What is to be factorized, and what can be wrong with it.

use lumistack_core::Cancelled;
use lumistack_display::{Display, DisplayError, LayerStack, LightField, StackError, WeightError, Weights};
use thiserror::Error;

use crate::bands;

/// A display, the light field that it shall show, and how much each ray counts.
///
/// Brightness β, sampling, frames M and what rays read beside a layer come from the display; where rays are comes from the target, whose
/// resolution and views need not be the display's own.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// The display.
    pub display: &'a Display,
    /// Target L, `[view_y][view_x][row][col][rgb]`, linear.
    pub target: &'a LightField,
    /// Weights w of the rays.
    pub weights: &'a Weights,
}

impl Problem<'_> {
    /// Checks that everything is usable and fits together.
    ///
    /// # Errors
    /// If the display or the weights are wrong, the target holds a value that is not finite, or the patterns do not fit into memory addresses.
    pub fn check(&self) -> Result<(), FactorizeError> {
        self.check_all_but_target()?;
        self.check_target()
    }

    /// [`check`](Self::check) without a look at every value of the target.
    pub(crate) fn check_all_but_target(&self) -> Result<(), FactorizeError> {
        self.display.check()?;
        self.weights.check(self.target.geometry())?;
        self.check_size()
    }

    /// The target's part of [`check`](Self::check).
    pub(crate) fn check_target(&self) -> Result<(), FactorizeError> {
        let radiance = self.target.radiance();
        if bands::all(radiance.data(), |part| part.iter().all(|value| value.is_finite())) {
            return Ok(());
        }
        let at = radiance.data().iter().position(|value| !value.is_finite()).unwrap_or(0);
        let [_, view_cols, rows, cols, channels] = radiance.shape();
        let (pixel, channel) = (at / channels, at % channels);
        let view = pixel / (rows * cols);
        Err(FactorizeError::Target {
            view: [view / view_cols, view % view_cols],
            row: pixel / cols % rows,
            col: pixel % cols,
            channel: ["red", "green", "blue"][channel],
            found: radiance.data()[at],
        })
    }

    fn check_size(&self) -> Result<(), FactorizeError> {
        let layers = (0..self.display.layers.len()).map(|n| LayerStack::layer_shape(self.display, n).to_vec());
        let emission = LayerStack::emission_shape(self.display).map(|shape| shape.to_vec());
        let values: u128 = layers.chain(emission).map(|shape| shape.iter().map(|&n| n as u128).product::<u128>()).sum();
        // patterns as handed over, padded working copies and one spare
        let bytes = 4 * 4 * values;
        if bytes > isize::MAX as u128 { Err(FactorizeError::TooLarge { values }) } else { Ok(()) }
    }
}

/// A factorization that cannot be done, or was stopped.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FactorizeError {
    /// The display makes no sense.
    #[error("display: {0}")]
    Display(#[from] DisplayError),
    /// The weights do not fit the target or are not weights.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The starting patterns do not fit the display.
    #[error("starting patterns: {0}")]
    Start(#[from] StackError),
    /// A target value is not a number, or infinite.
    #[error("target, view [{}, {}], row {row}, column {col}, {channel}: expected a finite value, found {found}", view[0], view[1])]
    Target {
        /// [view_y, view_x].
        view: [usize; 2],
        /// Pixel row.
        row: usize,
        /// Pixel column.
        col: usize,
        /// Colour channel.
        channel: &'static str,
        /// The value.
        found: f32,
    },
    /// The patterns exceed what this machine can address.
    #[error("the display's patterns have {values} values: more than fit into memory")]
    TooLarge {
        /// Number of values over all layers, frames and channels.
        values: u128,
    },
    /// No ray counts: the patterns could show anything.
    #[error(
        "no ray with a weight above 0 meets all layers: expected layers and weights through which the display shows something of the target"
    )]
    NoRays,
    /// No solver has this name.
    #[error("solver: expected one of {expected}, found {found}")]
    UnknownSolver {
        /// All names.
        expected: String,
        /// The name.
        found: String,
    },
    /// The solver does not fit the display.
    #[error("solver {solver}: {why}")]
    Unsuitable {
        /// Its name.
        solver: &'static str,
        /// The reason.
        why: &'static str,
    },
    /// A device cannot do this solve, or no longer answers.
    #[error("device {device}: {why}")]
    Device {
        /// Its name.
        device: String,
        /// The reason.
        why: String,
    },
    /// Somebody asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
