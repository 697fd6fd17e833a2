//! Errors of files. Every message names the file or folder, except the message of
//! [`FieldError::Cancelled`]. The message of malformed content also states the position in the
//! file, the expected value and the found value.

use std::io;
use std::path::{Path, PathBuf};

use lumistack_core::Cancelled;
use lumistack_display::{GridError, StackError};
use thiserror::Error;

/// A light field or layer stack that cannot be read or written.
#[derive(Debug, Error)]
pub enum FieldError {
    /// The operating system returned an error.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder that could not be accessed.
        path: PathBuf,
        /// The operation that failed, for example "read" or "list the folder".
        action: &'static str,
        /// The operating system's error.
        #[source]
        source: io::Error,
    },
    /// The content is malformed.
    #[error("{}: {place}: expected {expected}, found {found}", path.display())]
    Malformed {
        /// The file or folder that is malformed.
        path: PathBuf,
        /// The position in the file: a key, an axis, an index.
        place: String,
        /// The expected value.
        expected: String,
        /// The value found.
        found: String,
    },
    /// Two views of one light field differ in size.
    #[error(
        "expected views of one size, found {} with {} × {} pixels and {} with {} × {} pixels",
        first.display(), first_size[0], first_size[1], second.display(), second_size[0], second_size[1]
    )]
    ViewSizes {
        /// The first of the two views.
        first: PathBuf,
        /// [columns, rows] of the first view.
        first_size: [usize; 2],
        /// The first view with another size.
        second: PathBuf,
        /// [columns, rows] of the second view.
        second_size: [usize; 2],
    },
    /// Neither flags, files nor defaults define a value of the geometry.
    #[error("{}: {what} is unknown; state the value with {flag}", path.display())]
    MissingGeometry {
        /// Path of the light field.
        path: PathBuf,
        /// Description of the value that is missing, such as "the size of the pixels".
        what: &'static str,
        /// The flag that supplies the value, with an example.
        flag: &'static str,
    },
    /// The geometry is invalid.
    #[error("{}: {source}", path.display())]
    Geometry {
        /// Path of the light field.
        path: PathBuf,
        /// The reason why the geometry is invalid.
        #[source]
        source: GridError,
    },
    /// The stack does not match its display.
    #[error("{}: {source}", path.display())]
    Stack {
        /// The stack's folder.
        path: PathBuf,
        /// The reason why the stack does not match.
        #[source]
        source: StackError,
    },
    /// The user cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl FieldError {
    pub(crate) fn malformed(
        path: impl AsRef<Path>,
        place: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Malformed {
            path: path.as_ref().to_path_buf(),
            place: place.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }

    pub(crate) fn io(path: impl AsRef<Path>, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io { path, action, source }
    }

    pub(crate) fn geometry(path: impl AsRef<Path>) -> impl FnOnce(GridError) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Geometry { path, source }
    }
}
