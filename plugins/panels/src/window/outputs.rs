//! Lists outputs, detects their changes, and keeps the keyboard focus on X11.
//!
//! On Wayland winit updates its list of outputs. On X11 winit's list never changes: RandR's events
//! reach winit through Xlib, and Xlib drops events of extensions that it did not initialize.
//! Therefore a second connection queries the X server.
//!
//! X11 sends keys to the focused window. If the focus is the root window, X11 sends keys to the
//! window under the pointer, and winit drops these keys. If no window has the focus, X11 drops all
//! keys. A window manager focuses new windows. Without a window manager no client sets the focus.
//! When a client exits, the focus reverts to the window that the client requested. For winit's
//! fullscreen windows this is the root window.

use winit::application::ApplicationHandler;
use winit::event::WindowEvent;
use winit::event_loop::ActiveEventLoop;
use winit::monitor::MonitorHandle;
use winit::window::{Window, WindowId};

use super::WindowError;
use super::session::{event_loop, session};
use crate::assign::Output;

/// Returns the outputs of this session, from left to right.
///
/// # Errors
/// If there is no windowing system.
pub fn outputs() -> Result<Vec<Output>, WindowError> {
    struct Lister(Vec<Output>);
    impl ApplicationHandler for Lister {
        fn resumed(&mut self, event_loop: &ActiveEventLoop) {
            self.0 = outputs_of(event_loop).into_iter().map(|(output, _)| output).collect();
            event_loop.exit();
        }
        fn window_event(&mut self, _: &ActiveEventLoop, _: WindowId, _: WindowEvent) {}
    }
    let mut lister = Lister(Vec::new());
    event_loop::<()>().build().map_err(session)?.run_app(&mut lister).map_err(session)?;
    Ok(lister.0)
}

/// Returns the outputs of this session, from left to right, with winit's handles.
pub(super) fn outputs_of(event_loop: &ActiveEventLoop) -> Vec<(Output, MonitorHandle)> {
    let monitors = event_loop.available_monitors().enumerate().map(|(i, monitor)| {
        let (position, size) = (monitor.position(), monitor.size());
        let refresh = monitor.refresh_rate_millihertz().filter(|rate| *rate > 0);
        let output = Output {
            name: monitor.name().unwrap_or_else(|| format!("output {i}")),
            position: [position.x, position.y],
            size: [size.width as usize, size.height as usize],
            refresh_hz: refresh.map(|rate| f64::from(rate) / 1000.0),
        };
        (output, monitor)
    });
    let mut outputs: Vec<_> = monitors.filter(|(output, _)| output.size[0] > 0 && output.size[1] > 0).collect();
    outputs.sort_by(|(a, _), (b, _)| (a.position, &a.name).cmp(&(b.position, &b.name)));
    outputs
}

/// Detects changes of outputs during a presentation.
pub(super) enum Watch {
    /// Compares winit's lists of outputs.
    Winit,
    /// Queries the X server after each event that reports a change.
    #[cfg(all(unix, not(target_os = "macos")))]
    X11(Box<x11::Server>),
}

impl Watch {
    /// Connects to the X server if the session is X11. Otherwise uses winit's list.
    pub(super) fn new(event_loop: &ActiveEventLoop) -> Self {
        #[cfg(all(unix, not(target_os = "macos")))]
        if is_x11(event_loop)
            && let Ok(server) = x11::Server::connect()
        {
            return Self::X11(Box::new(server));
        }
        let _ = event_loop;
        Self::Winit
    }

    /// Sets the keyboard focus to `window` on an X server without a window manager. The first call
    /// sets the focus. A later call sets the focus again if neither `window` nor another
    /// window has the focus. `unmanaged` states that window managers ignore this window. Then the
    /// first call sets the focus even if there is a window manager.
    pub(super) fn keep_focus(&mut self, window: &Window, unmanaged: bool) {
        #[cfg(all(unix, not(target_os = "macos")))]
        if let Self::X11(server) = self {
            // The call fails while the window is not mapped. The next call tries again.
            let _ = server.keep_focus(window, unmanaged);
        }
        #[cfg(not(all(unix, not(target_os = "macos"))))]
        let _ = (window, unmanaged);
    }

    /// Returns the names, positions and sizes of the outputs at this time.
    pub(super) fn outputs(&mut self, event_loop: &ActiveEventLoop) -> Vec<Output> {
        #[cfg(all(unix, not(target_os = "macos")))]
        if let Self::X11(server) = self {
            match server.outputs() {
                Ok(outputs) => return outputs.to_vec(),
                // An error means that the X server has ended. The windows close with it, so winit's
                // list suffices.
                Err(_) => *self = Self::Winit,
            }
        }
        outputs_of(event_loop).into_iter().map(|(output, _)| output).collect()
    }
}

#[cfg(all(unix, not(target_os = "macos")))]
mod x11 {
    use std::time::{Duration, Instant};

    use winit::raw_window_handle::{HasWindowHandle, RawWindowHandle};
    use winit::window::Window;
    use x11rb::connection::Connection;
    use x11rb::errors::{ConnectionError, ReplyError};
    use x11rb::protocol::Event;
    use x11rb::protocol::randr::{Connection as PlugState, ConnectionExt as _, NotifyMask};
    use x11rb::protocol::screensaver::ConnectionExt as _;
    use x11rb::protocol::xproto::{ChangeWindowAttributesAux, ConnectionExt as _, EventMask, InputFocus};
    use x11rb::rust_connection::RustConnection;

    use crate::assign::Output;

    /// Time without change events before the server is queried. The server switches outputs off and
    /// on to change them, so an earlier query might miss an output.
    const SETTLE_TIME: Duration = Duration::from_millis(200);

    /// A second connection to the X server, and the state of its events.
    pub(in crate::window) struct Server {
        connection: RustConnection,
        root: u32,
        /// Names of the outputs that had a monitor at the start.
        plugged: Vec<String>,
        outputs: Vec<Output>,
        /// Time of the last change event; `None` after a query has read the changes.
        changed_at: Option<Instant>,
        focus_state: Focus,
    }

    /// State of the keyboard focus.
    #[derive(Clone, Copy, PartialEq)]
    enum Focus {
        /// The focus is not set yet.
        NotSet,
        /// The focus was set to our window. Another client may have moved the focus since.
        Set,
        /// The focus may have reverted to the root window or to no window, which a query must show.
        Reverted,
    }

    impl Server {
        pub(super) fn connect() -> Result<Self, Box<dyn std::error::Error>> {
            let (connection, screen) = x11rb::connect(None)?;
            let root = connection.setup().roots[screen].root;
            // Version 1.3 of RandR is the first with GetScreenResourcesCurrent.
            connection.randr_query_version(1, 3)?.reply()?;
            let all = NotifyMask::SCREEN_CHANGE | NotifyMask::CRTC_CHANGE | NotifyMask::OUTPUT_CHANGE;
            connection.randr_select_input(root, all)?.check()?;
            // If the focus reverts, the server sends events on the root window.
            let focus = ChangeWindowAttributesAux::new().event_mask(EventMask::FOCUS_CHANGE);
            connection.change_window_attributes(root, &focus)?.check()?;
            // Keep outputs on while this connection is open. Without the extension, the server's
            // settings apply.
            let _ = connection.screensaver_suspend(1);
            let (plugged, outputs) = (Vec::new(), Vec::new());
            let mut server = Self { connection, root, plugged, outputs, changed_at: None, focus_state: Focus::NotSet };
            let first = server.query()?;
            server.plugged =
                first.iter().filter(|(_, plugged)| *plugged).map(|(output, _)| output.name.clone()).collect();
            server.outputs = first.into_iter().map(|(output, _)| output).collect();
            Ok(server)
        }

        pub(super) fn keep_focus(
            &mut self,
            window: &Window,
            unmanaged: bool,
        ) -> Result<(), Box<dyn std::error::Error>> {
            self.poll_events()?;
            if self.focus_state == Focus::Set {
                return Ok(());
            }
            let window = match window.window_handle()?.as_raw() {
                RawWindowHandle::Xlib(handle) => handle.window as u32,
                RawWindowHandle::Xcb(handle) => handle.window.get(),
                _ => return Ok(()),
            };
            // There is a window manager if a client selects SubstructureRedirect on the root
            // window.
            let redirected = self.connection.get_window_attributes(self.root)?.reply()?.all_event_masks;
            let managed = redirected.contains(EventMask::SUBSTRUCTURE_REDIRECT);
            let take = match self.focus_state {
                Focus::NotSet => unmanaged || !managed,
                // The focus 0 means no window, and 1 means the window under the pointer.
                _ => !managed && [0, 1, self.root].contains(&self.connection.get_input_focus()?.reply()?.focus),
            };
            if take {
                self.connection.set_input_focus(InputFocus::POINTER_ROOT, window, x11rb::CURRENT_TIME)?.check()?;
            }
            self.focus_state = Focus::Set;
            Ok(())
        }

        /// Reads the events that have arrived, without blocking.
        fn poll_events(&mut self) -> Result<(), ConnectionError> {
            while let Some(event) = self.connection.poll_for_event()? {
                match event {
                    Event::FocusIn(_) if self.focus_state == Focus::Set => self.focus_state = Focus::Reverted,
                    Event::FocusIn(_) | Event::FocusOut(_) => {}
                    _ => self.changed_at = Some(Instant::now()),
                }
            }
            Ok(())
        }

        /// Returns the outputs. Queries the server only after a change event, and otherwise returns
        /// the outputs of the last query.
        pub(super) fn outputs(&mut self) -> Result<&[Output], ReplyError> {
            self.poll_events()?;
            if self.changed_at.is_some_and(|changed_at| changed_at.elapsed() >= SETTLE_TIME) {
                // The server still lists an output after its monitor was unplugged, so drop such
                // outputs. Keep outputs that had no monitor at the start.
                let is = |(output, plugged): &(Output, bool)| *plugged || !self.plugged.contains(&output.name);
                let there = self.query()?.into_iter().filter(is).map(|(output, _)| output).collect();
                (self.outputs, self.changed_at) = (there, None);
            }
            Ok(&self.outputs)
        }

        /// Returns every active output (every output with a CRTC), and true if a monitor is
        /// connected to it.
        fn query(&self) -> Result<Vec<(Output, bool)>, ReplyError> {
            let resources = self.connection.randr_get_screen_resources_current(self.root)?.reply()?;
            let when = resources.config_timestamp;
            let requests = resources.crtcs.iter().map(|crtc| self.connection.randr_get_crtc_info(*crtc, when));
            let mut outputs = Vec::new();
            for cookie in requests.collect::<Result<Vec<_>, ConnectionError>>()? {
                let sent = cookie.reply()?;
                for output in &sent.outputs {
                    // Skip an output that has disappeared since the list was read.
                    let Ok(info) = self.connection.randr_get_output_info(*output, when)?.reply() else { continue };
                    let output = Output {
                        name: String::from_utf8_lossy(&info.name).into_owned(),
                        position: [i32::from(sent.x), i32::from(sent.y)],
                        size: [usize::from(sent.width), usize::from(sent.height)],
                        refresh_hz: None,
                    };
                    outputs.push((output, info.connection != PlugState::DISCONNECTED));
                }
            }
            Ok(outputs)
        }
    }
}

#[cfg(all(unix, not(target_os = "macos")))]
pub(super) fn is_x11(event_loop: &ActiveEventLoop) -> bool {
    use winit::platform::x11::ActiveEventLoopExtX11;
    event_loop.is_x11()
}

/// Returns true, since other platforms let windows choose their position, as X11 does.
#[cfg(not(all(unix, not(target_os = "macos"))))]
pub(super) fn is_x11(_: &ActiveEventLoop) -> bool {
    true
}

#[cfg(all(unix, not(target_os = "macos")))]
pub(super) use super::wayland::{disconnect, inhibit_idle};

/// Does nothing, since only Wayland surfaces block on a compositor.
#[cfg(not(all(unix, not(target_os = "macos"))))]
pub(super) fn disconnect(_: &Window) {}

/// Does nothing on other platforms, where the system's settings apply.
#[cfg(not(all(unix, not(target_os = "macos"))))]
pub(super) fn inhibit_idle<'a>(_: impl IntoIterator<Item = &'a Window>) {}
