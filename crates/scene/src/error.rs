//! The error of a scene that is refused.

use thiserror::Error;

/// A scene that cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{place}: expected {expected}, found {found}")]
pub struct SceneError {
    /// Place in the file, or name of the object.
    pub place: String,
    /// The expected value or range.
    pub expected: String,
    /// The value found.
    pub found: String,
}

impl SceneError {
    /// Makes an error at a place in the file.
    pub fn new(place: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { place: place.into(), expected: expected.into(), found: found.into() }
    }
}
