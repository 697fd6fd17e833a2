//! Errors of reading glTF. An error about the file's content names the file, the place in it, the
//! expected and the found value.

use std::fmt::Display;

use lumistack_core::Cancelled;
use lumistack_scene::SceneError;
use thiserror::Error;

/// A glTF file that could not be loaded.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum GltfError {
    /// A value in the file, or in a file to which it refers, cannot be used.
    #[error("{file}: {place}: expected {expected}, found {found}")]
    Malformed {
        /// The file as the caller named it.
        file: String,
        /// JSON pointer (RFC 6901) such as `/accessors/3/count`; or a byte or line of the file.
        place: String,
        /// The expected value or range.
        expected: String,
        /// The value found.
        found: String,
    },
    /// The file requires an extension that is not supported.
    #[error("{file}: {place}: expected extensions that can be read ({supported}), found {name}{advice}")]
    UnsupportedExtension {
        /// The file as the caller named it.
        file: String,
        /// JSON pointer to the unsupported extension's name in the file.
        place: String,
        /// Name of the unsupported extension.
        name: String,
        /// Names of all extensions that this crate reads.
        supported: String,
        /// Advice on how to replace the extension; starts with "; " or is empty.
        advice: String,
    },
    /// The caller chose an animation or a variant that the file does not have.
    #[error("{file}: expected the name or number of a {what} ({}), found {wanted}", if known.is_empty() { "there are none" } else { known.as_str() })]
    NoSuch {
        /// The file as the caller named it.
        file: String,
        /// Kind of the choice: "scene animation" or "material variant".
        what: &'static str,
        /// The name or number that the caller chose.
        wanted: String,
        /// Numbers and names of the animations or variants that the file has.
        known: String,
    },
    /// The task was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A [`GltfError`] without the file's name.
#[derive(Debug)]
pub(crate) enum Fault {
    Malformed { place: String, expected: String, found: String },
    UnsupportedExtension { place: String, name: String, supported: String, advice: String },
    NoSuch { what: &'static str, wanted: String, known: String },
    Cancelled(Cancelled),
}

impl Fault {
    pub(crate) fn new(place: impl Into<String>, expected: impl Into<String>, found: impl Display) -> Self {
        Self::Malformed { place: place.into(), expected: expected.into(), found: found.to_string() }
    }

    pub(crate) fn in_file(self, file: &str) -> GltfError {
        let file = file.to_owned();
        match self {
            Self::Malformed { place, expected, found } => GltfError::Malformed { file, place, expected, found },
            Self::UnsupportedExtension { place, name, supported, advice } => {
                GltfError::UnsupportedExtension { file, place, name, supported, advice }
            }
            Self::NoSuch { what, wanted, known } => GltfError::NoSuch { file, what, wanted, known },
            Self::Cancelled(cancelled) => GltfError::Cancelled(cancelled),
        }
    }
}

impl From<Cancelled> for Fault {
    fn from(cancelled: Cancelled) -> Self {
        Self::Cancelled(cancelled)
    }
}

impl From<SceneError> for Fault {
    fn from(SceneError { place, expected, found }: SceneError) -> Self {
        Self::Malformed { place, expected, found }
    }
}
