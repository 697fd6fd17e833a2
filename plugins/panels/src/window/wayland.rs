//! Requests to Wayland that winit does not offer: keep outputs on, and close the connection.

use std::net::Shutdown;
use std::os::unix::net::UnixStream;

use wayland_backend::client::{Backend, ObjectId};
use wayland_client::protocol::wl_registry::{self, WlRegistry};
use wayland_client::protocol::wl_surface::WlSurface;
use wayland_client::{Connection, Dispatch, Proxy, QueueHandle, delegate_noop};
use wayland_protocols::wp::idle_inhibit::zv1::client::zwp_idle_inhibit_manager_v1::ZwpIdleInhibitManagerV1;
use wayland_protocols::wp::idle_inhibit::zv1::client::zwp_idle_inhibitor_v1::ZwpIdleInhibitorV1;
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle, RawDisplayHandle, RawWindowHandle};
use winit::window::Window;

/// Returns the connection of a window; `None` if the session is not Wayland.
pub(super) fn connection_of(window: &Window) -> Option<Connection> {
    let RawDisplayHandle::Wayland(handle) = window.display_handle().ok()?.as_raw() else { return None };
    // SAFETY: the pointer is the connection of the windows. The connection outlives the windows and
    // all objects created here.
    let backend = unsafe { Backend::from_foreign_display(handle.display.as_ptr().cast()) };
    Some(Connection::from_backend(backend))
}

/// Returns the surface of a window that uses this connection; `None` if the session is not Wayland.
pub(super) fn surface_of(connection: &Connection, window: &Window) -> Option<WlSurface> {
    let RawWindowHandle::Wayland(handle) = window.window_handle().ok()?.as_raw() else { return None };
    // SAFETY: the pointer belongs to the surface of a live window.
    let id = unsafe { ObjectId::from_ptr(WlSurface::interface(), handle.surface.as_ptr().cast()) }.ok()?;
    WlSurface::from_id(connection, id).ok()
}

/// Closes a window's connection, which unblocks every thread that waits for the compositor.
/// Otherwise a thread may wait for ever, since a compositor sends no answers for a hidden surface.
pub(super) fn disconnect(window: &Window) {
    if let Some(connection) = connection_of(window)
        && let Ok(socket) = connection.backend().poll_fd().try_clone_to_owned()
    {
        let _ = UnixStream::from(socket).shutdown(Shutdown::Both);
    }
}

/// Keeps outputs on while they show these windows. If the compositor lacks the protocol
/// `idle-inhibit`, the session's settings apply.
pub(super) fn inhibit_idle<'a>(windows: impl IntoIterator<Item = &'a Window>) {
    let mut windows = windows.into_iter().peekable();
    let Some(connection) = windows.peek().and_then(|window| connection_of(window)) else { return };
    let mut queue = connection.new_event_queue();
    connection.display().get_registry(&queue.handle(), ());
    let mut globals = Globals(None);
    if queue.roundtrip(&mut globals).is_err() {
        return;
    }
    let Some(manager) = globals.0 else { return };
    for surface in windows.filter_map(|window| surface_of(&connection, window)) {
        // The inhibitor is never destroyed, so it lasts as long as the surface.
        manager.create_inhibitor(&surface, &queue.handle(), ());
    }
    let _ = connection.flush();
}

struct Globals(Option<ZwpIdleInhibitManagerV1>);

impl Dispatch<WlRegistry, ()> for Globals {
    fn event(
        globals: &mut Self,
        registry: &WlRegistry,
        event: wl_registry::Event,
        _: &(),
        _: &Connection,
        queue: &QueueHandle<Self>,
    ) {
        if let wl_registry::Event::Global { name, interface, .. } = event
            && interface == ZwpIdleInhibitManagerV1::interface().name
        {
            globals.0 = Some(registry.bind(name, 1, queue, ()));
        }
    }
}

delegate_noop!(Globals: ZwpIdleInhibitManagerV1);
delegate_noop!(Globals: ZwpIdleInhibitorV1);
