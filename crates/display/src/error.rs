//! Errors of a display file.

use lumistack_core::config::ConfigError;
use thiserror::Error;

use crate::GridError;

/// A display file that cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DisplayError {
    /// The text of the file cannot be read as a display.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The view grid is invalid.
    #[error("field: {0}")]
    Grid(#[from] GridError),
    /// A value is invalid.
    #[error("{key}: expected {expected}, found {found}")]
    Value {
        /// The key, for example `layers[2].d_mm`.
        key: String,
        /// The expected value or range.
        expected: String,
        /// The invalid value.
        found: String,
    },
}
