//! Which outputs there are, and whether they stay what they were.
//!
//! winit's list follows Wayland, whose registry takes an output back when it goes. On X11 it stays as it was at the start: RandR's events reach winit through
//! Xlib, which drops those of extensions that it was not told about. So there a connection of our own asks the server.

use winit::application::ApplicationHandler;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::monitor::MonitorHandle;
use winit::window::{Window, WindowId};

use super::WindowError;
use super::app::session;
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
    /// Begins to watch. Of an X server it also asks that `window` gets the keys: `always`, or where nobody else has them, as without a window manager.
    pub(super) fn new(event_loop: &ActiveEventLoop, window: &Window, always: bool) -> Self {
        #[cfg(all(unix, not(target_os = "macos")))]
        if is_x11(event_loop)
            && let Ok(server) = x11::Server::connect()
        {
            // a window that is not shown yet gets none
            let _ = server.take_keys(window, always);
            return Self::X11(Box::new(server));
        }
        let _ = (event_loop, window, always);
        Self::Winit
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
    use x11rb::protocol::randr::{Connection as Plug, ConnectionExt as _, NotifyMask};
    use x11rb::protocol::screensaver::ConnectionExt as _;
    use x11rb::protocol::xproto::{ConnectionExt as _, InputFocus};
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
        /// When something new was last told about.
        told: Option<Instant>,
    }

    impl Server {
        pub(super) fn connect() -> Result<Self, Box<dyn std::error::Error>> {
            let (connection, screen) = x11rb::connect(None)?;
            let root = connection.setup().roots[screen].root;
            // the version that knows of current resources
            connection.randr_query_version(1, 3)?.reply()?;
            let all = NotifyMask::SCREEN_CHANGE | NotifyMask::CRTC_CHANGE | NotifyMask::OUTPUT_CHANGE;
            connection.randr_select_input(root, all)?.check()?;
            // outputs stay awake as long as this connection lasts; without the extension they follow the server's settings
            let _ = connection.screensaver_suspend(1);
            let mut server = Self { connection, root, plugged: Vec::new(), outputs: Vec::new(), told: None };
            let first = server.ask()?;
            server.plugged =
                first.iter().filter(|(_, plugged)| *plugged).map(|(output, _)| output.name.clone()).collect();
            server.outputs = first.into_iter().map(|(output, _)| output).collect();
            Ok(server)
        }

        pub(super) fn take_keys(&self, window: &Window, always: bool) -> Result<(), Box<dyn std::error::Error>> {
            let window = match window.window_handle()?.as_raw() {
                RawWindowHandle::Xlib(handle) => handle.window as u32,
                RawWindowHandle::Xcb(handle) => handle.window.get(),
                _ => return Ok(()),
            };
            // 0 is nobody, 1 whoever is under the pointer: winit hears of neither
            if always || self.connection.get_input_focus()?.reply()?.focus <= 1 {
                self.connection.set_input_focus(InputFocus::POINTER_ROOT, window, x11rb::CURRENT_TIME)?.check()?;
            }
            Ok(())
        }

        /// Does not wait unless something is new.
        pub(super) fn outputs(&mut self) -> Result<&[Output], ReplyError> {
            while self.connection.poll_for_event()?.is_some() {
                self.told = Some(Instant::now());
            }
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
