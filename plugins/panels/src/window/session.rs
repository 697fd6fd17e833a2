//! The connection to the windowing system, and its errors.

use winit::event_loop::{EventLoop, EventLoopBuilder};

use super::WindowError;

/// A builder of an event loop for the calling thread.
///
/// winit permits the main thread alone, for the sake of macOS. The Python package executes the
/// command on another thread, and only macOS forbids that.
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

/// The windowing system refused the connection, or closed it.
pub(super) fn session(error: winit::error::EventLoopError) -> WindowError {
    let said = error.to_string();
    // remove the position in winit's sources, which winit puts at the start
    let found =
        said.split_once(".rs:").and_then(|(_, rest)| rest.split_once(": ")).map_or(said.as_str(), |(_, found)| found);
    WindowError::Session(found.trim_end_matches('.').to_owned())
}
