//! Errors of placing, lighting and rendering a scene in front of a display.

use std::path::{Path, PathBuf};

use lumistack_core::Cancelled;
use lumistack_pathtracer::RenderError;
use lumistack_scene::{SceneError, WindowError};
use thiserror::Error;

/// An error of placing, lighting or rendering, or the cancellation of this work.
#[derive(Clone, Debug, Error)]
pub enum ShotError {
    /// The user cancelled the work.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A value is out of range or contradicts another.
    #[error(transparent)]
    Value(Box<BadValue>),
    /// The scene cannot be rendered.
    #[error("{name}: {source}")]
    Scene {
        /// Name of the scene's file.
        name: String,
        /// The reason why the scene cannot be rendered.
        source: SceneError,
    },
    /// The window cannot be placed.
    #[error("{name}: {source}")]
    Window {
        /// Name of the scene's file.
        name: String,
        /// The reason why the window cannot be placed.
        source: WindowError,
    },
    /// Rendering failed.
    #[error(transparent)]
    Render(RenderError),
}

impl ShotError {
    /// Makes an error about a value.
    pub fn value(
        place: impl Into<Place>,
        key: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        let (place, key, expected, found) = (place.into(), key.into(), expected.into(), found.into());
        Self::Value(Box::new(BadValue { place, key, expected, found }))
    }

    /// Makes an error about a value of the job.
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

/// An error about a value: its place and key, the expected and the found value.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{place}: {key}: expected {expected}, found {found}")]
pub struct BadValue {
    /// File, option or object that holds the value.
    pub place: Place,
    /// Key of the value in the file, or its name in the object.
    pub key: String,
    /// Description of the values that are allowed for the key.
    pub expected: String,
    /// The value that was found, as text.
    pub found: String,
}

/// File, option or object that holds a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The value is in a job. The caller can add the name of the job's file.
    Job,
    /// The value results from several options together.
    CommandLine,
    /// The value is in an option, or in an environment variable.
    Option(&'static str),
    /// The value is in a named object in memory: a scene, a light field.
    Named(String),
    /// The value is in a file or a folder.
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
