//! Errors of the session.

use super::WindowError;

/// The session refused, or went away.
pub(super) fn session(error: winit::error::EventLoopError) -> WindowError {
    WindowError::Session(error.to_string())
}
