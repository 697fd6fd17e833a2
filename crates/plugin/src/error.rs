//! What can go wrong between a host and a plugin.

use lumistack_core::Cancelled;
use lumistack_display::Display;
use thiserror::Error;

use crate::ParamError;

/// An error that crosses the boundary, in either direction.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PluginError {
    /// The user asked to stop; nothing is wrong with the input.
    #[error("cancelled")]
    Cancelled,
    /// Parameters or data that the callee does not take.
    #[error("{0}")]
    Refused(String),
    /// The work failed.
    #[error("{0}")]
    Failed(String),
    /// The callee panicked, with this message.
    #[error("panicked: {0}")]
    Panicked(String),
}

impl PluginError {
    /// The work failed for a reason that another error gives, after what was being done.
    pub fn failed(doing: &str, error: impl std::fmt::Display) -> Self {
        Self::Failed(format!("{doing}: {error}"))
    }

    /// A display that the plugin does not serve.
    pub fn display(display: &Display, expected: impl std::fmt::Display, found: impl std::fmt::Display) -> Self {
        Self::Refused(format!("display `{}`: expected {expected}, found {found}", display.name))
    }

    /// Writing through a library failed. What the host itself said (see [`OutputFile`](crate::OutputFile)) comes back as it was.
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
