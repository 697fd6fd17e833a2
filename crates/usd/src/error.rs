//! Errors of USD ingest: each names the file, the place in it, what was needed and what was there.

use std::fmt::Display;

use lumistack_core::Cancelled;
use lumistack_scene::SceneError;
use thiserror::Error;

/// A USD file that could not be loaded.
#[derive(Debug, Error)]
pub enum UsdError {
    /// No Python with OpenUSD was found.
    #[error("{file}: USD files are read by the Python package usd-core, which was not found. Type `lumistack setup usd` once, or `pip install usd-core` into a Python that lumistack finds ({})", tried.join("; "))]
    NoPython {
        /// The file as the caller named it.
        file: String,
        /// Every Python that was tried, and why it does not do.
        tried: Vec<String>,
    },
    /// The Python in `LUMISTACK_PYTHON` does not do.
    #[error(
        "LUMISTACK_PYTHON: expected a Python with the package usd-core, found {found}. Type `{python} -m pip install usd-core`, or unset the variable and type `lumistack setup usd`"
    )]
    GivenPython {
        /// Its value.
        python: String,
        /// Why it does not do.
        found: String,
    },
    /// No Blender was found.
    #[error("{file}: .blend files are read by Blender 4.2 or newer, which was not found. Install it from blender.org, name its program in LUMISTACK_BLENDER, or `pip install bpy` into a Python that lumistack finds ({})", tried.join("; "))]
    NoBlender {
        /// The file as the caller named it.
        file: String,
        /// Every program that was tried, and why it does not do.
        tried: Vec<String>,
    },
    /// The program in `LUMISTACK_BLENDER` does not do.
    #[error("LUMISTACK_BLENDER: expected Blender 4.2 or newer, or a Python with the package bpy, found {found}")]
    GivenBlender {
        /// Its name, and why it does not do.
        found: String,
    },
    /// Python or Blender ended without a scene.
    #[error("{file}: expected a scene from {python}, found {found}")]
    Child {
        /// The file as the caller named it.
        file: String,
        /// The interpreter.
        python: String,
        /// How it ended, and the last that it said.
        found: String,
    },
    /// OpenUSD, or the walker, refuses the file.
    #[error("{}", refused(file, message))]
    Refused {
        /// The file as the caller named it.
        file: String,
        /// The reason.
        message: String,
    },
    /// The scene holds something that cannot be rendered.
    #[error("{file}: {place}: expected {expected}, found {found}")]
    Malformed {
        /// The file as the caller named it.
        file: String,
        /// Prim path, and what it is about.
        place: String,
        /// What was needed.
        expected: String,
        /// What was there.
        found: String,
    },
    /// A file that the work needs cannot be read or written.
    #[error("{place}: {source}")]
    Io {
        /// The file or folder, or what it is for.
        place: String,
        /// The system's answer.
        source: std::io::Error,
    },
    /// Setting up a Python failed.
    #[error("setup: expected {expected}, found {found}")]
    Setup {
        /// What was to happen.
        expected: String,
        /// What happened.
        found: String,
    },
    /// The task was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// OpenUSD's own message often begins with the file, its line and column.
fn refused(file: &str, message: &str) -> String {
    if message.starts_with(file) { message.to_owned() } else { format!("{file}: {message}") }
}

/// [`UsdError`] before it knows the file's name.
#[derive(Debug)]
pub(crate) enum Fault {
    Malformed { place: String, expected: String, found: String },
    Cancelled(Cancelled),
}

impl Fault {
    pub(crate) fn new(place: impl Into<String>, expected: impl Into<String>, found: impl Display) -> Self {
        Self::Malformed { place: place.into(), expected: expected.into(), found: found.to_string() }
    }

    pub(crate) fn in_file(self, file: &str) -> UsdError {
        match self {
            Self::Malformed { place, expected, found } => {
                UsdError::Malformed { file: file.to_owned(), place, expected, found }
            }
            Self::Cancelled(cancelled) => UsdError::Cancelled(cancelled),
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
