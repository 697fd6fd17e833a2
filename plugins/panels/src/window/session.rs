//! Errors of the windowing system.

use super::WindowError;

/// The windowing system refused the connection, or closed it.
pub(super) fn session(error: winit::error::EventLoopError) -> WindowError {
    let said = error.to_string();
    // drop the place in its own sources that winit prepends
    let found =
        said.split_once(".rs:").and_then(|(_, rest)| rest.split_once(": ")).map_or(said.as_str(), |(_, found)| found);
    WindowError::Session(found.trim_end_matches('.').to_owned())
}
