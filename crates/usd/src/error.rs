//! Errors of USD and Blender input. An error about a value names the file, the place in it, the
//! expected and the found value.

use std::fmt::Display;

use lumistack_core::Cancelled;
use lumistack_scene::SceneError;
use thiserror::Error;

/// The reason why a USD or Blender file was not loaded, or why no Python environment was made.
#[derive(Debug, Error)]
pub enum UsdError {
    /// No Python with OpenUSD was found.
    #[error("{file}: USD files are read by the Python package usd-core, which was not found. Run `lumistack setup usd` once, or install usd-core with pip into one of the Pythons that lumistack tried: {}", tried.join("; "))]
    NoPython {
        /// The file as the caller named it.
        file: String,
        /// Every Python that was tried, with its failure.
        tried: Vec<String>,
    },
    /// The Python in `LUMISTACK_PYTHON` cannot read USD files.
    #[error(
        "LUMISTACK_PYTHON: expected a Python with the package usd-core, found {found}. Run `{python} -m pip install usd-core`, or unset LUMISTACK_PYTHON and run `lumistack setup usd`"
    )]
    GivenPython {
        /// The program that `LUMISTACK_PYTHON` names.
        python: String,
        /// The reason why this Python cannot read USD files.
        found: String,
    },
    /// No Blender was found.
    #[error("{file}: .blend files are read by Blender 4.2 or newer, which was not found. Install Blender from blender.org, or name the program of an installed Blender in LUMISTACK_BLENDER, or install bpy with pip into a Python on PATH. Programs that lumistack tried: {}", tried.join("; "))]
    NoBlender {
        /// Absolute path of the file.
        file: String,
        /// Every program that was tried, with its failure.
        tried: Vec<String>,
    },
    /// The program in `LUMISTACK_BLENDER` cannot read `.blend` files.
    #[error("LUMISTACK_BLENDER: expected Blender 4.2 or newer, or a Python with the package bpy, found {found}")]
    GivenBlender {
        /// Name of the program, and the reason why it cannot read `.blend` files.
        found: String,
    },
    /// Python or Blender ended without a scene.
    #[error(
        "{file}: expected {python} to return a scene, found {found}. Test the file in a USD viewer or in Blender, or name another program in LUMISTACK_PYTHON (USD) or LUMISTACK_BLENDER (.blend)"
    )]
    Child {
        /// Path of a USD file as the caller named it, or absolute path of a `.blend` file.
        file: String,
        /// The Python or Blender that was run.
        python: String,
        /// The status of the process with its last output, the defect of its result, or the
        /// exception in the script.
        found: String,
    },
    /// OpenUSD, the Python code that reads the stage, or Blender refuses the file.
    #[error("{}", refused(file, message))]
    Refused {
        /// Path of a USD file as the caller named it, or absolute path of a `.blend` file.
        file: String,
        /// The reason why the file is refused.
        message: String,
    },
    /// A value in the scene cannot be rendered.
    #[error("{file}: {place}: expected {expected}, found {found}")]
    Malformed {
        /// The file as the caller named it.
        file: String,
        /// Path of the prim, often with an attribute's name; or another part of the scene.
        place: String,
        /// The expected value.
        expected: String,
        /// The found value.
        found: String,
    },
    /// A file cannot be read or written.
    #[error("{place}: {source}")]
    Io {
        /// Path of the file or folder, or its purpose if the user does not know its path.
        place: String,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// Setting up a Python failed.
    #[error("setup: expected {expected}, found {found}")]
    Setup {
        /// The program, folder or step that the setup needs.
        expected: String,
        /// The reason why it is missing, or why the step failed.
        found: String,
    },
    /// The task was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Adds the file's name to a message, unless the message begins with it. OpenUSD's own messages
/// often begin with the file, line and column.
fn refused(file: &str, message: &str) -> String {
    if message.starts_with(file) { message.to_owned() } else { format!("{file}: {message}") }
}

/// A [`UsdError`] without the file's name.
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
