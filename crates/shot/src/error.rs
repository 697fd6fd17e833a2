//! What can be wrong with a scene in front of a display.

use std::path::{Path, PathBuf};

use lumistack_core::Cancelled;
use lumistack_pathtracer::RenderError;
use lumistack_scene::{SceneError, WindowError};
use thiserror::Error;

/// A shot that cannot be made, or was stopped.
#[derive(Clone, Debug, Error)]
pub enum ShotError {
    /// Somebody asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A value makes no sense.
    #[error(transparent)]
    Value(Box<BadValue>),
    /// The scene cannot be rendered.
    #[error("{name}: {source}")]
    Scene {
        /// The scene's file.
        name: String,
        /// What is wrong.
        source: SceneError,
    },
    /// The window cannot be placed.
    #[error("{name}: {source}")]
    Window {
        /// The scene's file.
        name: String,
        /// What is wrong.
        source: WindowError,
    },
    /// Rendering failed.
    #[error(transparent)]
    Render(RenderError),
}

impl ShotError {
    /// A value that makes no sense.
    pub fn value(
        place: impl Into<Place>,
        key: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        let (place, key, expected, found) = (place.into(), key.into(), expected.into(), found.into());
        Self::Value(Box::new(BadValue { place, key, expected, found }))
    }

    /// A value of the job that makes no sense.
    pub fn job(key: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::value(Place::Job, key, expected, found)
    }
}

impl From<RenderError> for ShotError {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            other => Self::Render(other),
        }
    }
}

/// A value that makes no sense: where it stands, what was needed, and what was there.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{place}: {key}: expected {expected}, found {found}")]
pub struct BadValue {
    /// Where it stands.
    pub place: Place,
    /// Its key there.
    pub key: String,
    /// A sentence about sound values.
    pub expected: String,
    /// The value as it is.
    pub found: String,
}

/// Where a value stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A job; whoever has read it knows its file.
    Job,
    /// Options of all kinds together.
    CommandLine,
    /// An option, or a variable of the environment.
    Option(&'static str),
    /// Something in memory that has a name: a scene, a light field.
    Named(String),
    /// A file or a folder.
    File(PathBuf),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Job => f.write_str("job"),
            Self::CommandLine => f.write_str("command line"),
            Self::Option(name) => f.write_str(name),
            Self::Named(name) => f.write_str(name),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

impl From<&str> for Place {
    fn from(name: &str) -> Self {
        Self::Named(name.into())
    }
}

impl From<&String> for Place {
    fn from(name: &String) -> Self {
        Self::Named(name.clone())
    }
}

impl From<&Path> for Place {
    fn from(path: &Path) -> Self {
        Self::File(path.to_owned())
    }
}

impl From<&PathBuf> for Place {
    fn from(path: &PathBuf) -> Self {
        Self::File(path.clone())
    }
}
