//! The main thread of a presentation. It handles windows, keys, commands, and outputs that
//! change or disappear.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lumistack_plugin::display::ColourSequence;
use winit::application::ApplicationHandler;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::keyboard::{Key, ModifiersState, NamedKey};
use winit::window::{Fullscreen, Window, WindowId};

use super::WindowError;
use super::gpu::{self, Viewport};
use super::outputs::{self, Watch, is_x11, outputs_of};
use super::present_loop::{PresentLoop, SharedState};
use super::producer::{Producer, Work};
use super::session::{event_loop, session};
use crate::assign::{Change, Output, assign, bounds, change};
use crate::fit::{fitted, misfits};
use crate::presentation::{Command, Content, Event, Mode, Report, Settings};
use crate::{Feed, Picture, Shows};

/// Interval of the checks for changed outputs, for the end of the duration, and for cancellation.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Time in which every window must reach the size of its output.
const RESIZE_TIMEOUT: Duration = Duration::from_secs(5);
/// Time in which a thread must end. After this time the connection to the windowing system is
/// closed, since a hidden surface can block the present loop for ever.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(2);
/// Delay before a graphics failure is reported. The failure's cause may be a lost output or
/// session. Such a loss is detected within this delay, and is then reported instead.
const FAILURE_DELAY: Duration = Duration::from_millis(500);
/// Time without a refresh after which the user gets a warning.
const STALL_TIMEOUT: Duration = Duration::from_secs(2);
/// Title of the surface across all outputs, by which sway's rule finds the window.
const SPAN_TITLE: &str = "lumistack panels: span";
/// Angle of the viewer when the pointer is at the edge of the preview window, in units of half the
/// field of view.
const REACH: f64 = 1.2;

/// Runs a presentation until a key, a command, a closed window, `cancelled` or the duration ends
/// it. `emit` receives events from any thread. Call this function once per process. On macOS it
/// must run on the main thread.
///
/// # Errors
/// If there is no windowing system or graphics driver, or if the outputs do not match the display.
/// Also if a window does not reach the size of its output, or if an output is disconnected or
/// changes.
pub fn present(
    settings: Settings,
    commands: Receiver<Command>,
    cancelled: &dyn Fn() -> bool,
    emit: Arc<dyn Fn(Event) + Send + Sync>,
) -> Result<(), WindowError> {
    let event_loop = event_loop::<Command>().build().map_err(session)?;
    let proxy = event_loop.create_proxy();
    std::thread::spawn(move || {
        // This loop ends when the sender of commands is dropped, or at the first command after the
        // event loop has exited.
        for command in commands {
            if proxy.send_event(command).is_err() {
                break;
            }
        }
    });
    let mut app = App {
        settings: Some(settings),
        cancelled,
        emit,
        running: None,
        viewports: Vec::new(),
        windows: Vec::new(),
        watch: None,
        begun: Instant::now(),
        shown_since: None,
        progress: (0, Instant::now(), false),
        pointer: None,
        modifiers: ModifiersState::empty(),
        selected: 0,
        unsaved: false,
        result: None,
    };
    let ran = event_loop.run_app(&mut app).map_err(session);
    // Prefer the recorded reason for the end. An error of the event loop may only be a consequence.
    app.result.unwrap_or(ran)
}

struct App<'a> {
    /// The settings; `None` after the threads have started, since the threads take them.
    settings: Option<Settings>,
    cancelled: &'a dyn Fn() -> bool,
    emit: Arc<dyn Fn(Event) + Send + Sync>,
    running: Option<Running>,
    viewports: Vec<Viewport>,
    windows: Vec<(Arc<Window>, String, Option<[usize; 2]>)>,
    watch: Option<Watch>,
    begun: Instant,
    shown_since: Option<Instant>,
    /// The last progress count, the time of its last change, and whether the stall since then was
    /// reported.
    progress: (u64, Instant, bool),
    /// The last position of the pointer.
    pointer: Option<PhysicalPosition<f64>>,
    modifiers: ModifiersState,
    selected: usize,
    /// True if shifts of panels (nudges) have changed and are not saved.
    unsaved: bool,
    result: Option<Result<(), WindowError>>,
}

/// The running threads and their channels.
struct Running {
    shared: Arc<SharedState>,
    work: Sender<Work>,
    report: Receiver<Report>,
    /// The channel, which disconnects when the producer has ended.
    produced: Receiver<()>,
    /// The present loop's thread, and the thread that forwards replaced frame sets to the producer.
    presenting: [JoinHandle<()>; 2],
    producing: JoinHandle<()>,
    failure: Arc<OnceLock<(Instant, String)>>,
    mode: Mode,
    fields: i64,
    half_fov_deg: [f64; 2],
    from_deg: [f64; 2],
    duration: Option<Duration>,
}

impl ApplicationHandler<Command> for App<'_> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.windows.is_empty()
            && let Err(error) = self.open_windows(event_loop)
        {
            self.end(event_loop, Err(error));
        }
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, command: Command) {
        self.apply(event_loop, command);
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, id: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => self.apply(event_loop, Command::Quit),
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            WindowEvent::KeyboardInput {
                event: KeyEvent { logical_key, state: ElementState::Pressed, .. }, ..
            } => {
                self.key(event_loop, &logical_key);
            }
            WindowEvent::Resized(size) => {
                let Some(running) = &self.running else { return };
                running.shared.resized.store(true, Ordering::Relaxed);
                if running.mode == Mode::Window {
                    let _ = running.work.send(Work::Resized([size.width as usize, size.height as usize]));
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                // Compositors also report a pointer at rest, which must not change the view.
                if self.pointer.replace(position).is_none_or(|before| before == position) {
                    return;
                }
                let size =
                    self.windows.iter().find(|(window, ..)| window.id() == id).map(|(window, ..)| window.inner_size());
                if let (Some(running), Some(size)) = (&self.running, size)
                    && running.mode == Mode::Window
                {
                    let share = [
                        2.0 * position.x / f64::from(size.width.max(1)) - 1.0,
                        1.0 - 2.0 * position.y / f64::from(size.height.max(1)),
                    ];
                    let from = [0, 1].map(|axis| share[axis] * REACH * running.half_fov_deg[axis]);
                    self.apply(event_loop, Command::Look(from));
                }
            }
            _ => {}
        }
    }

    fn exiting(&mut self, event_loop: &ActiveEventLoop) {
        // If the presentation has already ended, `end` has no effect. Otherwise the event loop
        // exits because the connection was lost.
        self.end(event_loop, Err(WindowError::Lost));
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + POLL_INTERVAL));
        if self.result.is_some() || event_loop.exiting() {
            return;
        }
        if (self.cancelled)() {
            return self.apply(event_loop, Command::Quit);
        }
        let Some(running) = &self.running else {
            if let Err(error) = self.start_when_ready(event_loop) {
                self.end(event_loop, Err(error));
            }
            return;
        };
        let over = running.duration.zip(self.shown_since).is_some_and(|(duration, since)| since.elapsed() >= duration);
        if over {
            return self.apply(event_loop, Command::Quit);
        }
        // Wait before the report of a graphics failure, since a lost output may be the cause. Then
        // the error about the output is reported instead.
        if let Some((_, found)) = running.failure.get().filter(|(when, _)| when.elapsed() >= FAILURE_DELAY) {
            let error = WindowError::Graphics { on: "the outputs".into(), found: found.trim().into() };
            return self.end(event_loop, Err(error));
        }
        let watch = self.watch.get_or_insert_with(|| Watch::new(event_loop));
        watch.keep_focus(&self.windows[0].0, running.mode == Mode::Span);
        if running.mode != Mode::Window {
            let placed = running.mode == Mode::Span || is_x11(event_loop);
            let now = watch.outputs(event_loop);
            let mut changes =
                self.viewports.iter().filter_map(|viewport| Some((viewport, change(&viewport.output, &now, placed)?)));
            if let Some((Viewport { shows, output, .. }, change)) = changes.next() {
                let (name, shows) = (output.name.clone(), *shows);
                let error = match change {
                    Change::Gone => WindowError::Gone { name, shows },
                    Change::Other(is) => {
                        WindowError::Changed { name, shows, was: Box::new(output.clone()), is: Box::new(is) }
                    }
                };
                return self.end(event_loop, Err(error));
            }
        }
        self.warn_if_stalled();
    }
}

impl App<'_> {
    fn open_windows(&mut self, event_loop: &ActiveEventLoop) -> Result<(), WindowError> {
        let settings = self.settings.as_ref().expect("not yet started");
        let display = &settings.display;
        let outputs = outputs_of(event_loop);
        let plain = || Window::default_attributes().with_title(format!("lumistack: {}", display.name));
        let mut open = |attributes, name: &str, size| {
            let window = event_loop
                .create_window(attributes)
                .map_err(|error| WindowError::Graphics { on: name.into(), found: error.to_string() })?;
            self.windows.push((Arc::new(window), name.to_string(), size));
            Ok::<_, WindowError>(())
        };
        // A preview needs one ordinary window, whose size is a whole multiple of the light field's
        // resolution.
        if settings.mode == Mode::Window {
            let [cols, rows] = display.field.resolution;
            let scale = (960 / cols.max(1)).clamp(1, 8);
            let size = PhysicalSize::new((cols * scale) as u32, (rows * scale) as u32);
            return open(plain().with_inner_size(size), "the window", None);
        }
        // Assign outputs to panels. Each output gets a viewport, which is its area of a surface.
        let all: Vec<Output> = outputs.iter().map(|(output, _)| output.clone()).collect();
        let assigned = assign(display, &all)?;
        let viewport = |screen: usize, origin: [u32; 2], (shows, output): (Shows, Output)| {
            let extent = Some(output.size.map(|count| count as u32));
            Viewport { shows, output, screen, origin, extent }
        };
        if settings.mode == Mode::Span {
            let is_x11 = is_x11(event_loop);
            if !is_x11 {
                add_span_rule()?;
            }
            // On Wayland a surface across outputs always covers all outputs. On X11 a window may
            // have any position and size, so it covers only the assigned outputs.
            let (corner, size) = if is_x11 { bounds(assigned.iter().map(|(_, output)| output)) } else { bounds(&all) };
            let attributes = span_attributes(plain().with_title(SPAN_TITLE), corner, size);
            open(attributes, "the surface across all outputs", Some(size))?;
            self.viewports = assigned
                .into_iter()
                .map(|(shows, output)| {
                    let origin = [0, 1].map(|axis| (output.position[axis] - corner[axis]) as u32);
                    viewport(0, origin, (shows, output))
                })
                .collect();
            return Ok(());
        }
        // Open one borderless fullscreen window per output.
        for (_, output) in &assigned {
            let monitor =
                outputs.iter().find(|(other, _)| other.name == output.name).map(|(_, monitor)| monitor.clone());
            let attributes = plain()
                .with_title(format!("lumistack: {}", output.name))
                .with_decorations(false)
                .with_position(PhysicalPosition::new(output.position[0], output.position[1]))
                .with_inner_size(PhysicalSize::new(output.size[0] as u32, output.size[1] as u32))
                .with_fullscreen(Some(Fullscreen::Borderless(monitor)));
            open(attributes, &output.name, Some(output.size))?;
        }
        self.windows.iter().for_each(|(window, ..)| window.set_cursor_visible(false));
        self.viewports = assigned.into_iter().enumerate().map(|(i, assigned)| viewport(i, [0, 0], assigned)).collect();
        Ok(())
    }

    /// Starts the threads once every window has the size of its output.
    fn start_when_ready(&mut self, event_loop: &ActiveEventLoop) -> Result<(), WindowError> {
        let mut sizes = self.windows.iter().map(|(window, name, expected)| {
            let size = window.inner_size();
            (name, *expected, [size.width as usize, size.height as usize])
        });
        let wrong = sizes.find(|(_, expected, found)| expected.is_some_and(|size| size != *found));
        if let Some((output, Some(expected), found)) = wrong {
            if self.begun.elapsed() < RESIZE_TIMEOUT {
                return Ok(());
            }
            return Err(WindowError::Size { output: output.clone(), expected, found });
        }
        let Settings { mut display, content, mode, fit, hold, duration, log } =
            self.settings.take().expect("not yet started");
        let windows = self.windows.iter().map(|(window, name, _)| (window.clone(), name.clone())).collect();
        // Open the GPU. In a preview, use the window as the only output.
        let (gpu, screens) = gpu::open(event_loop, windows)?;
        if mode == Mode::Window {
            let size = self.windows[0].0.inner_size();
            // A new window may not be on an output yet. Then the first output's refresh rate is
            // used.
            let monitor =
                self.windows[0].0.current_monitor().or_else(|| Some(outputs_of(event_loop).into_iter().next()?.1));
            let refresh_hz = monitor.and_then(|monitor| monitor.refresh_rate_millihertz()).filter(|rate| *rate > 0);
            let output = Output {
                name: "window".into(),
                position: [0, 0],
                size: [size.width as usize, size.height as usize],
                refresh_hz: refresh_hz.map(|rate| f64::from(rate) / 1000.0),
            };
            self.viewports = vec![Viewport { shows: Shows::Layer(0), output, screen: 0, origin: [0, 0], extent: None }];
        }
        // Scale masks if requested, and report mismatches.
        if mode != Mode::Window {
            let assigned: Vec<_> =
                self.viewports.iter().map(|viewport| (viewport.shows, viewport.output.clone())).collect();
            if fit {
                let (fits, pitch_mm) = fitted(&display, &assigned);
                display = fits;
                (self.emit)(Event::Warning(format!(
                    "fit: the masks are scaled as if the pixels of all panels had a pitch of {pitch_mm:.4} mm. For correct parallax, multiply the distances between the panels by the true pitch of their pixels, divided by {pitch_mm:.4} mm"
                )));
            }
            misfits(&display, &assigned).into_iter().for_each(|text| (self.emit)(Event::Warning(text)));
        }
        // All panels show new frames at the rate of the slowest output.
        let reported = self.viewports.iter().filter_map(|viewport| viewport.output.refresh_hz).reduce(f64::min);
        let (refresh_hz, interval_from) = match reported {
            Some(reported) => (reported, "the platform"),
            None => (display.refresh_hz, "the display file, since the platform does not report it"),
        };
        if matches!(content, Content::Stack(_)) {
            display.refresh_hz = refresh_hz;
            if let Some(warning) = display.flicker_warning() {
                (self.emit)(Event::Warning(warning));
            }
        }
        let fields = if display.colour_sequence == ColourSequence::Field { 3 } else { 1 };
        // Create the state that the threads share.
        let shared = Arc::new(SharedState {
            stop: AtomicBool::new(false),
            hold: AtomicI64::new(hold.map_or(-1, |frame| frame as i64 * fields)),
            places: AtomicU64::new(1),
            report: AtomicBool::new(false),
            resized: AtomicBool::new(false),
            progress: AtomicU64::new(0),
            blocked_screen: AtomicUsize::new(0),
            feed: Feed::default(),
        });
        let gpu = Arc::new(gpu);
        let failure = gpu.failure.clone();
        // Forward replaced frame sets to the producer, which frees them outside the present loop.
        let (work, works) = channel();
        let (retire, retired) = channel();
        let forward = work.clone();
        let passing = std::thread::spawn(move || {
            for frame_set in retired {
                if forward.send(Work::Retired(frame_set)).is_err() {
                    break;
                }
            }
        });
        // Start the producer and the present loop.
        #[cfg(all(unix, not(target_os = "macos")))]
        let feedback = super::feedback::Feedback::new(&screens, 1.0 / refresh_hz);
        let present_loop = PresentLoop {
            gpu: gpu.clone(),
            screens,
            viewports: self.viewports.clone(),
            shared: shared.clone(),
            retired: retire,
            interval_s: 1.0 / refresh_hz,
            interval_from,
            log,
            #[cfg(all(unix, not(target_os = "macos")))]
            feedback,
        };
        let half_fov_deg = display.field.fov_deg.map(|fov| 0.5 * fov);
        let from_deg = if let Content::Preview { from_deg, .. } = content { from_deg } else { [0.0; 2] };
        let pictures = match mode {
            Mode::Window => Vec::new(),
            _ => self
                .viewports
                .iter()
                .map(|viewport| Picture::new(&display, viewport.shows, viewport.output.size))
                .collect(),
        };
        let producer = Producer {
            display,
            content,
            viewports: self.viewports.clone(),
            gpu,
            shared: shared.clone(),
            work: works,
            pictures,
            number: 0,
        };
        let emit = self.emit.clone();
        let (ends, produced) = channel::<()>();
        let producing = std::thread::Builder::new()
            .name("panels: producer".into())
            .spawn(move || {
                producer.run(&*emit);
                drop(ends);
            })
            .map_err(WindowError::Thread)?;
        let (done, report) = channel();
        let emit = self.emit.clone();
        let presenting = std::thread::Builder::new()
            .name("panels: present loop".into())
            .spawn(move || {
                let _ = done.send(present_loop.run(&*emit));
            })
            .map_err(WindowError::Thread)?;
        if mode != Mode::Window {
            outputs::inhibit_idle(self.windows.iter().map(|(window, ..)| &**window));
        }
        self.running = Some(Running {
            shared,
            work,
            report,
            produced,
            presenting: [presenting, passing],
            producing,
            failure,
            mode,
            fields,
            half_fov_deg,
            from_deg,
            duration,
        });
        self.shown_since = Some(Instant::now());
        // Take the keyboard focus before `Started`, since a user may press keys as soon as this
        // event is emitted.
        self.watch.insert(Watch::new(event_loop)).keep_focus(&self.windows[0].0, mode == Mode::Span);
        if mode != Mode::Window {
            for Viewport { shows: panel, output, .. } in &self.viewports {
                let Output { name, position, size, refresh_hz } = output.clone();
                (self.emit)(Event::Shows { panel: *panel, output: name, position, size, refresh_hz });
            }
        }
        (self.emit)(Event::Started);
        Ok(())
    }

    /// Warns if refreshes stop. The warning names the surface that is blocked, for which all
    /// outputs wait.
    fn warn_if_stalled(&mut self) {
        let Some(running) = self.running.as_ref().filter(|running| running.mode != Mode::Window) else { return };
        let now = running.shared.progress.load(Ordering::Relaxed);
        let (last, since, reported) = self.progress;
        if now != last {
            self.progress = (now, Instant::now(), false);
        } else if now > 0 && !reported && since.elapsed() >= STALL_TIMEOUT {
            self.progress.2 = true;
            let (_, name, _) = &self.windows[running.shared.blocked_screen.load(Ordering::Relaxed)];
            let what = if running.mode == Mode::Span { "the surface across all outputs" } else { name };
            (self.emit)(Event::Warning(format!(
                "{what}: no refresh for {} s (the output may be asleep, or may show another workspace); all panels wait for this output",
                STALL_TIMEOUT.as_secs()
            )));
        }
    }

    fn apply(&mut self, event_loop: &ActiveEventLoop, command: Command) {
        if matches!(command, Command::Quit) {
            return self.end(event_loop, Ok(()));
        }
        let Some(running) = &mut self.running else { return };
        let hold = &running.shared.hold;
        match command {
            Command::Stack(stack) => drop(running.work.send(Work::Stack(stack))),
            Command::Hold(frame) => hold.store(frame as i64 * running.fields, Ordering::Relaxed),
            Command::Run => hold.store(-1, Ordering::Relaxed),
            Command::Step(by) => {
                let places = running.shared.places.load(Ordering::Relaxed).max(1) as i64;
                let next = (hold.load(Ordering::Relaxed).max(0) + by * running.fields).rem_euclid(places);
                hold.store(next, Ordering::Relaxed);
            }
            Command::Nudge(shows, by) => {
                self.unsaved |= by != [0.0; 2];
                let _ = running.work.send(Work::Nudge(shows, by));
            }
            Command::Save => {
                self.unsaved = false;
                let _ = running.work.send(Work::Save);
            }
            Command::Look(from) => {
                running.from_deg = from.map(|angle| angle.clamp(-80.0, 80.0));
                let _ = running.work.send(Work::ViewAngle(running.from_deg));
            }
            Command::Report => running.shared.report.store(true, Ordering::Relaxed),
            Command::Quit => {}
        }
    }

    /// Executes the command of a key. Escape or q ends the presentation. Space holds frame 0, or
    /// resumes. Comma and full stop show the previous and the next frame. Tab selects a panel. An
    /// arrow shifts this panel by a pixel (with Shift by 10 pixels, with Control by 0.1 pixels). In
    /// a preview, an arrow turns the view by one degree (10 or 0.1 degrees). The key s saves the
    /// shifts, and the key r requests a report.
    fn key(&mut self, event_loop: &ActiveEventLoop, key: &Key) {
        let Some(running) = &self.running else { return };
        let step = match (self.modifiers.shift_key(), self.modifiers.control_key()) {
            (true, _) => 10.0,
            (_, true) => 0.1,
            _ => 1.0,
        };
        // In a preview arrows turn the view. Otherwise they shift the selected panel.
        let arrow = match key {
            Key::Named(NamedKey::ArrowLeft) => Some([-step, 0.0]),
            Key::Named(NamedKey::ArrowRight) => Some([step, 0.0]),
            Key::Named(NamedKey::ArrowUp) => Some([0.0, -step]),
            Key::Named(NamedKey::ArrowDown) => Some([0.0, step]),
            _ => None,
        };
        let command = match (key, arrow) {
            (_, Some([right, down])) if running.mode == Mode::Window => {
                Command::Look([running.from_deg[0] + right, running.from_deg[1] - down])
            }
            (_, Some(shift)) => Command::Nudge(self.viewports[self.selected].shows, shift),
            (Key::Named(NamedKey::Escape), _) => Command::Quit,
            (Key::Named(NamedKey::Space), _) if running.shared.hold.load(Ordering::Relaxed) >= 0 => Command::Run,
            (Key::Named(NamedKey::Space), _) => Command::Hold(0),
            (Key::Named(NamedKey::Tab), _) => {
                self.selected = (self.selected + 1) % self.viewports.len().max(1);
                Command::Nudge(self.viewports[self.selected].shows, [0.0, 0.0])
            }
            (Key::Character(text), _) => match text.as_str() {
                "q" => Command::Quit,
                "s" => Command::Save,
                "r" => Command::Report,
                "." => Command::Step(1),
                "," => Command::Step(-1),
                _ => return,
            },
            _ => return,
        };
        self.apply(event_loop, command);
    }

    /// Stops all threads and emits the report. `reason` becomes the result of the presentation,
    /// unless an earlier call has set one.
    fn end(&mut self, event_loop: &ActiveEventLoop, reason: Result<(), WindowError>) {
        event_loop.exit();
        if self.result.is_some() {
            return;
        }
        let report = match self.running.take() {
            None => Report::default(),
            Some(running) => {
                running.shared.stop.store(true, Ordering::Relaxed);
                let report = running.report.recv_timeout(SHUTDOWN_TIMEOUT).or_else(|waits| {
                    self.windows.iter().take(1).for_each(|(window, ..)| outputs::disconnect(window));
                    // Without a connection the present loop is no longer blocked, so it sends its
                    // report.
                    running.report.recv_timeout(SHUTDOWN_TIMEOUT).map_err(|_| waits)
                });
                // Join all threads that use the GPU, since drivers crash if the process exits
                // before these threads. The present loop may still free resources after it has sent
                // its report.
                if report.is_ok() {
                    running.presenting.into_iter().for_each(|thread| drop(thread.join()));
                }
                drop(running.work);
                drop(running.shared);
                if running.produced.recv_timeout(SHUTDOWN_TIMEOUT) == Err(RecvTimeoutError::Disconnected) {
                    let _ = running.producing.join();
                }
                report.unwrap_or_default()
            }
        };
        self.windows.clear();
        if self.unsaved {
            (self.emit)(Event::Warning(
                "the panels' nudges were not saved; the key s or the command `save` saves nudges".into(),
            ));
        }
        // After an error before the first refresh there are no statistics to report.
        if reason.is_ok() || report.refreshes > 0 {
            (self.emit)(Event::Report(Box::new(report)));
        }
        self.result = Some(reason);
    }
}

/// Sets the position and size of a window, and excludes the window from the control of window
/// managers.
fn span_attributes(
    attributes: winit::window::WindowAttributes,
    [x, y]: [i32; 2],
    size: [usize; 2],
) -> winit::window::WindowAttributes {
    let attributes = attributes
        .with_decorations(false)
        .with_position(PhysicalPosition::new(x, y))
        .with_inner_size(PhysicalSize::new(size[0] as u32, size[1] as u32));
    #[cfg(all(unix, not(target_os = "macos")))]
    let attributes = {
        use winit::platform::x11::WindowAttributesExtX11;
        attributes.with_override_redirect(true)
    };
    attributes
}

/// Adds a rule to sway that extends the surface across all outputs. Wayland itself shows a
/// fullscreen surface on one output only.
fn add_span_rule() -> Result<(), WindowError> {
    // sway knows a window only after its first frame, so the command is a rule for windows that
    // open later.
    let rule = format!("for_window [title=\"^{SPAN_TITLE}$\"] fullscreen enable global");
    let asked = std::env::var_os("SWAYSOCK").map(|_| std::process::Command::new("swaymsg").arg(&rule).output());
    match asked {
        Some(Ok(answer)) if answer.status.success() => Ok(()),
        Some(Ok(answer)) => Err(WindowError::Span(format!(
            "expected sway to accept a fullscreen rule, found {}",
            String::from_utf8_lossy(&answer.stdout).trim()
        ))),
        Some(Err(error)) => Err(WindowError::Span(format!("cannot start swaymsg: {error}"))),
        None => Err(WindowError::Span(
            "expected X11 or sway, found another Wayland compositor, which shows a surface on one output only".into(),
        )),
    }
}
