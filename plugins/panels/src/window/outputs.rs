//! Which outputs there are, whether they stay what they were, and who has the keys.
//!
//! winit's list follows Wayland, whose registry takes an output back when it goes. On X11 it stays as it was at the start: RandR's events reach winit through
//! Xlib, which drops those of extensions that it was not told about. So there a connection of our own asks the server.
//!
//! Keys on X11 go to the window that has the focus. Where it is the root window, or no window, they go to the one under the pointer, which winit does not pass on: it
//! was never told that this window has them. A window manager gives the focus to new windows. Without one nobody does; what ends before us leaves it where its
//! windows were asked to leave it (winit's for full screens: with the root window).

use winit::application::ApplicationHandler;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::monitor::MonitorHandle;
use winit::window::{Window, WindowId};

use super::WindowError;
use super::session::session;
use crate::assign::Output;

/// The outputs of this session, from left to right.
///
/// # Errors
/// Without a windowing system.
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
    EventLoop::new().map_err(session)?.run_app(&mut lister).map_err(session)?;
    Ok(lister.0)
}

/// The outputs of this session, from left to right, with what winit calls them.
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

/// Looks at the outputs while something is shown on them.
pub(super) enum Watch {
    /// As winit tells.
    Winit,
    /// As the X server tells, asked again whenever it says that something is new.
    #[cfg(all(unix, not(target_os = "macos")))]
    X11(Box<x11::Server>),
}

impl Watch {
    /// Begins to watch.
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

    /// Sees to it that an X server without a window manager sends keys to `window`: at the start, and whenever nobody has them any more. `unmanaged` is a window that
    /// no window manager cares for, either. Costs nothing where nothing changed.
    pub(super) fn keep_keys(&mut self, window: &Window, unmanaged: bool) {
        #[cfg(all(unix, not(target_os = "macos")))]
        if let Self::X11(server) = self {
            // a window that is not shown yet gets none: next time
            let _ = server.keep_keys(window, unmanaged);
        }
        #[cfg(not(all(unix, not(target_os = "macos"))))]
        let _ = (window, unmanaged);
    }

    /// Names, places and sizes of the outputs that are there now.
    pub(super) fn outputs(&mut self, event_loop: &ActiveEventLoop) -> Vec<Output> {
        #[cfg(all(unix, not(target_os = "macos")))]
        if let Self::X11(server) = self {
            match server.outputs() {
                Ok(outputs) => return outputs.to_vec(),
                // a server that does not answer takes the windows with it
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
    use x11rb::protocol::randr::{Connection as Plug, ConnectionExt as _, NotifyMask};
    use x11rb::protocol::screensaver::ConnectionExt as _;
    use x11rb::protocol::xproto::{ChangeWindowAttributesAux, ConnectionExt as _, EventMask, InputFocus};
    use x11rb::rust_connection::RustConnection;

    use crate::assign::Output;

    /// How long a server must be quiet before it is asked: it switches outputs off and on again to change them.
    const QUIET: Duration = Duration::from_millis(200);

    /// A connection of our own, and what was last heard.
    pub(in crate::window) struct Server {
        connection: RustConnection,
        root: u32,
        /// Names of the outputs with a monitor at the start.
        plugged: Vec<String>,
        outputs: Vec<Output>,
        /// When something new about outputs was last told.
        told: Option<Instant>,
        keys: Keys,
    }

    /// Who has the keys.
    #[derive(Clone, Copy, PartialEq)]
    enum Keys {
        /// Not yet a window of ours.
        Before,
        /// A window of ours, or of somebody who took them from it.
        Given,
        /// Perhaps nobody: the focus fell to the root window or to none.
        Fallen,
    }

    impl Server {
        pub(super) fn connect() -> Result<Self, Box<dyn std::error::Error>> {
            let (connection, screen) = x11rb::connect(None)?;
            let root = connection.setup().roots[screen].root;
            // the version that knows of current resources
            connection.randr_query_version(1, 3)?.reply()?;
            let all = NotifyMask::SCREEN_CHANGE | NotifyMask::CRTC_CHANGE | NotifyMask::OUTPUT_CHANGE;
            connection.randr_select_input(root, all)?.check()?;
            // a focus that falls to nobody passes the root window
            let focus = ChangeWindowAttributesAux::new().event_mask(EventMask::FOCUS_CHANGE);
            connection.change_window_attributes(root, &focus)?.check()?;
            // outputs stay awake as long as this connection lasts; without the extension they follow the server's settings
            let _ = connection.screensaver_suspend(1);
            let (plugged, outputs) = (Vec::new(), Vec::new());
            let mut server = Self { connection, root, plugged, outputs, told: None, keys: Keys::Before };
            let first = server.ask()?;
            server.plugged =
                first.iter().filter(|(_, plugged)| *plugged).map(|(output, _)| output.name.clone()).collect();
            server.outputs = first.into_iter().map(|(output, _)| output).collect();
            Ok(server)
        }

        pub(super) fn keep_keys(&mut self, window: &Window, unmanaged: bool) -> Result<(), Box<dyn std::error::Error>> {
            self.listen()?;
            if self.keys == Keys::Given {
                return Ok(());
            }
            let window = match window.window_handle()?.as_raw() {
                RawWindowHandle::Xlib(handle) => handle.window as u32,
                RawWindowHandle::Xcb(handle) => handle.window.get(),
                _ => return Ok(()),
            };
            // who redirects the root window's children is the window manager
            let redirected = self.connection.get_window_attributes(self.root)?.reply()?.all_event_masks;
            let managed = redirected.contains(EventMask::SUBSTRUCTURE_REDIRECT);
            let take = match self.keys {
                Keys::Before => unmanaged || !managed,
                // 0 is nobody, 1 whoever is under the pointer
                _ => !managed && [0, 1, self.root].contains(&self.connection.get_input_focus()?.reply()?.focus),
            };
            if take {
                self.connection.set_input_focus(InputFocus::POINTER_ROOT, window, x11rb::CURRENT_TIME)?.check()?;
            }
            self.keys = Keys::Given;
            Ok(())
        }

        /// Hears what is new, without waiting.
        fn listen(&mut self) -> Result<(), ConnectionError> {
            while let Some(event) = self.connection.poll_for_event()? {
                match event {
                    Event::FocusIn(_) if self.keys == Keys::Given => self.keys = Keys::Fallen,
                    Event::FocusIn(_) | Event::FocusOut(_) => {}
                    _ => self.told = Some(Instant::now()),
                }
            }
            Ok(())
        }

        /// Does not wait unless something is new.
        pub(super) fn outputs(&mut self) -> Result<&[Output], ReplyError> {
            self.listen()?;
            if self.told.is_some_and(|told| told.elapsed() >= QUIET) {
                // a server goes on sending after a cable was drawn; but pictures may also be sent where it never saw a monitor
                let is = |(output, plugged): &(Output, bool)| *plugged || !self.plugged.contains(&output.name);
                let there = self.ask()?.into_iter().filter(is).map(|(output, _)| output).collect();
                (self.outputs, self.told) = (there, None);
            }
            Ok(&self.outputs)
        }

        /// Every output that a picture is sent to, and whether a monitor is plugged in.
        fn ask(&self) -> Result<Vec<(Output, bool)>, ReplyError> {
            let resources = self.connection.randr_get_screen_resources_current(self.root)?.reply()?;
            let when = resources.config_timestamp;
            let asked = resources.crtcs.iter().map(|crtc| self.connection.randr_get_crtc_info(*crtc, when));
            let mut outputs = Vec::new();
            for cookie in asked.collect::<Result<Vec<_>, ConnectionError>>()? {
                let sent = cookie.reply()?;
                for output in &sent.outputs {
                    // one that went away meanwhile is none
                    let Ok(info) = self.connection.randr_get_output_info(*output, when)?.reply() else { continue };
                    let output = Output {
                        name: String::from_utf8_lossy(&info.name).into_owned(),
                        position: [i32::from(sent.x), i32::from(sent.y)],
                        size: [usize::from(sent.width), usize::from(sent.height)],
                        refresh_hz: None,
                    };
                    outputs.push((output, info.connection != Plug::DISCONNECTED));
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

/// Elsewhere windows may be placed anywhere, too.
#[cfg(not(all(unix, not(target_os = "macos"))))]
pub(super) fn is_x11(_: &ActiveEventLoop) -> bool {
    true
}

#[cfg(all(unix, not(target_os = "macos")))]
pub(super) use super::wayland::{hang_up, stay_awake};

/// Nobody waits for compositors elsewhere.
#[cfg(not(all(unix, not(target_os = "macos"))))]
pub(super) fn hang_up(_: &Window) {}

/// Elsewhere outputs follow the system's settings.
#[cfg(not(all(unix, not(target_os = "macos"))))]
pub(super) fn stay_awake<'a>(_: impl IntoIterator<Item = &'a Window>) {}
