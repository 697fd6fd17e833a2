//! Errors between a host and a plugin.

use lumistack_core::Cancelled;
use lumistack_display::Display;
use thiserror::Error;

use crate::ParamError;

/// An error that crosses the plugin interface, in either direction.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PluginError {
    /// The user cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The callee refuses parameters or data.
    #[error("{0}")]
    Refused(String),
    /// The operation failed.
    #[error("{0}")]
    Failed(String),
    /// The callee panicked, with this message.
    #[error("panicked: {0}")]
    Panicked(String),
}

impl PluginError {
    /// Makes the error of a failed operation, with the cause.
    pub fn failed(doing: &str, error: impl std::fmt::Display) -> Self {
        Self::Failed(format!("{doing}: {error}"))
    }

    /// Makes the error for a display that the plugin does not support.
    pub fn display(display: &Display, expected: impl std::fmt::Display, found: impl std::fmt::Display) -> Self {
        Self::Refused(format!("display `{}`: expected {expected}, found {found}", display.name))
    }

    /// Converts the error of a library that writes to an [`OutputFile`](crate::OutputFile). If the
    /// host caused the error, the host's own error is returned.
    pub fn from_io(doing: &str, error: std::io::Error) -> Self {
        match error.downcast::<Self>() {
            Ok(own) => own,
            Err(other) => Self::failed(doing, other),
        }
    }
}

impl From<Cancelled> for PluginError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<ParamError> for PluginError {
    fn from(error: ParamError) -> Self {
        Self::Refused(error.to_string())
    }
}
