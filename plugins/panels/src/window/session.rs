//! Errors of the session.

use super::WindowError;

/// The session refused, or went away.
pub(super) fn session(error: winit::error::EventLoopError) -> WindowError {
    let said = error.to_string();
    // winit begins with a place in its own sources
    let found =
        said.split_once(".rs:").and_then(|(_, rest)| rest.split_once(": ")).map_or(said.as_str(), |(_, found)| found);
    WindowError::Session(found.trim_end_matches('.').to_owned())
}
