//! Opens the connection to the windowing system, and converts its errors.

use winit::event_loop::{EventLoop, EventLoopBuilder};

use super::WindowError;

/// Makes a builder of an event loop that runs on the calling thread.
///
/// By default winit permits an event loop only on the main thread, as macOS requires. The Python
/// package runs the command on another thread, so this builder permits any thread on other systems.
pub(super) fn event_loop<T: 'static>() -> EventLoopBuilder<T> {
    #[allow(unused_mut)]
    let mut builder = EventLoop::with_user_event();
    #[cfg(all(unix, not(target_os = "macos")))]
    {
        winit::platform::wayland::EventLoopBuilderExtWayland::with_any_thread(&mut builder, true);
        winit::platform::x11::EventLoopBuilderExtX11::with_any_thread(&mut builder, true);
    }
    #[cfg(windows)]
    winit::platform::windows::EventLoopBuilderExtWindows::with_any_thread(&mut builder, true);
    builder
}

/// Makes the error for a windowing system that refused or closed the connection.
pub(super) fn session(error: winit::error::EventLoopError) -> WindowError {
    let said = error.to_string();
    // Remove the position in winit's source code, with which winit's message starts.
    let found =
        said.split_once(".rs:").and_then(|(_, rest)| rest.split_once(": ")).map_or(said.as_str(), |(_, found)| found);
    WindowError::Session(found.trim_end_matches('.').to_owned())
}
