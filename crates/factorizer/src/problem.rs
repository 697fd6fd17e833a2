//! The problem of a factorization, its checks and its errors.

use lumistack_core::Cancelled;
use lumistack_display::{Display, DisplayError, LayerStack, LightField, StackError, WeightError, Weights};
use thiserror::Error;

use crate::bands;

/// A display, its target light field, and the weight of every ray.
///
/// The display defines brightness β, sampling, the number of frames M, and the value that a ray
/// reads if it misses a layer. The target defines the rays; its resolution and views may differ
/// from the display's.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// The display that shows the target.
    pub display: &'a Display,
    /// Target L, `[view_y][view_x][row][col][rgb]`, linear.
    pub target: &'a LightField,
    /// Weights w of the rays, w ≥ 0.
    pub weights: &'a Weights,
}

impl Problem<'_> {
    /// Checks that display, target and weights are usable together.
    ///
    /// # Errors
    /// If the display or the weights are invalid, the target has a value that is not finite, or the
    /// patterns exceed the address space.
    pub fn check(&self) -> Result<(), FactorizeError> {
        self.check_all_but_target()?;
        self.check_target()
    }

    /// Makes the checks of [`check`](Self::check) that do not read the target's values.
    pub(crate) fn check_all_but_target(&self) -> Result<(), FactorizeError> {
        self.display.check()?;
        self.weights.check(self.target.geometry())?;
        self.check_size()
    }

    /// Checks that every value of the target is finite.
    pub(crate) fn check_target(&self) -> Result<(), FactorizeError> {
        let geometry = self.target.geometry();
        // read view by view, since the target may be in a file
        for view in geometry.grid.iter() {
            let values = self.target.view(view);
            if bands::all(values, |part| part.iter().all(|value| value.is_finite())) {
                continue;
            }
            let at = values.iter().position(|value| !value.is_finite()).unwrap_or(0);
            let (pixel, channel) = (at / 3, ["red", "green", "blue"][at % 3]);
            let (row, col) = (pixel / geometry.cols, pixel % geometry.cols);
            return Err(FactorizeError::Target { view, row, col, channel, found: values[at] });
        }
        Ok(())
    }

    fn check_size(&self) -> Result<(), FactorizeError> {
        let layers = (0..self.display.layers.len()).map(|n| LayerStack::layer_shape(self.display, n).to_vec());
        let emission = LayerStack::emission_shape(self.display).map(|shape| shape.to_vec());
        let values: u128 = layers.chain(emission).map(|shape| shape.iter().map(|&n| n as u128).product::<u128>()).sum();
        // four copies must fit, with 4 bytes per value: the input, two working copies and a spare
        // copy
        let bytes = 4 * 4 * values;
        if bytes > isize::MAX as u128 { Err(FactorizeError::TooLarge { values }) } else { Ok(()) }
    }
}

/// The reason why a factorization failed, or its cancellation.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FactorizeError {
    /// The display is invalid.
    #[error("display: {0}")]
    Display(#[from] DisplayError),
    /// The weights do not fit the target, or some are negative or not finite.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The start does not fit the display.
    #[error("starting patterns: {0}")]
    Start(#[from] StackError),
    /// A target value is NaN or infinite.
    #[error("target, view [{}, {}], row {row}, column {col}, {channel}: expected a finite value, found {found}", view[0], view[1])]
    Target {
        /// View index [view_y, view_x].
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
    /// The patterns exceed the address space.
    #[error(
        "display: expected patterns that fit into the address space, found patterns of {values} values; reduce the resolution or the number of frames"
    )]
    TooLarge {
        /// Number of values over all layers, frames and channels.
        values: u128,
    },
    /// No valid ray has a weight above 0, so all patterns are equally good. A ray is valid if it
    /// hits all layers, and the grid of lenslets, if there is one. Some displays also allow rays
    /// that miss layers.
    #[error(
        "weights and layers: expected at least one ray that has a weight above 0 and hits all layers (and the grid of lenslets, if there is one), found none"
    )]
    NoRays,
    /// No solver has this name.
    #[error("solver: expected one of {expected}, found {found}")]
    UnknownSolver {
        /// All names.
        expected: String,
        /// The given name.
        found: String,
    },
    /// The solver does not fit the display.
    #[error("solver {solver}: {why}")]
    Unsuitable {
        /// Name of the solver.
        solver: &'static str,
        /// The reason.
        why: &'static str,
    },
    /// A device cannot solve this problem, or is lost.
    #[error("device {device}: {why}")]
    Device {
        /// Name of the device.
        device: String,
        /// The reason.
        why: String,
    },
    /// The target is in a file, and the file for the solver's copy of it cannot be written.
    #[error("cannot write the file with the solver's copy of the light field: {why}")]
    Storage {
        /// The system's reason.
        why: String,
    },
    /// The caller cancelled the task.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
