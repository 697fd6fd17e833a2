//! The crate's error type.

use lumistack_core::Cancelled;
use lumistack_display::{DisplayError, GridError};
use lumistack_factorizer::FactorizeError;
use lumistack_gltf::GltfError;
use lumistack_pathtracer::RenderError;
use lumistack_shot::ShotError;

/// A message for the user: the file, the place in it, the expected and the found value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error(pub(crate) String);

impl Error {
    /// Makes an error about a value.
    pub(crate) fn value(place: &str, expected: &str, found: impl std::fmt::Display) -> Self {
        Self(format!("{place}: expected {expected}, found {found}"))
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

macro_rules! says {
    ($($kind:ty),* $(,)?) => {
        $(impl From<$kind> for Error {
            fn from(error: $kind) -> Self {
                Self(error.to_string())
            }
        })*
    };
}

says!(Cancelled, DisplayError, FactorizeError, GltfError, GridError, RenderError, ShotError);
