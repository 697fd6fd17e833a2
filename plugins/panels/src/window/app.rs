//! The main thread: windows on outputs, keys, and outputs that go away.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lumistack_plugin::display::ColourSequence;
use winit::application::ApplicationHandler;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{Key, ModifiersState, NamedKey};
use winit::window::{Fullscreen, Window, WindowId};

use super::WindowError;
use super::conductor::{Baton, Conductor};
use super::gpu::{self, Part};
use super::outputs::{self, Watch, is_x11, outputs_of};
use super::producer::{Producer, Work};
use super::session::session;
use crate::assign::{Change, Output, assign, bounds, change};
use crate::fit::{fitted, misfits};
use crate::presentation::{Command, Content, Event, Mode, Report, Settings};
use crate::{Feed, Picture, Shows};

/// How often outputs are looked at, and whether it is time to end.
const LOOK: Duration = Duration::from_millis(50);
/// How long windows may take to become as large as their outputs.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long the conductor may take to end before the connection is closed: a surface that nobody sees can hold it for ever.
const FAREWELL: Duration = Duration::from_secs(2);
/// How long after a failure of graphics another reason may still be found for it.
const GRACE: Duration = Duration::from_millis(500);
/// After how long without a refresh somebody is told.
const STILL: Duration = Duration::from_secs(2);
/// Title of the surface across all outputs, by which a compositor can be told about it.
const SPAN_TITLE: &str = "lumistack panels: span";
/// Degrees of the rehearsal's window from its middle to its edge, in units of half the field of view.
const REACH: f64 = 1.2;

/// Shows something until it is ended, by a key, a command, `cancelled` or the wanted duration. Must be called on the main thread, once per process.
///
/// # Errors
/// Without a windowing system, graphics or the outputs that are needed, and when an output goes away.
pub fn present(
    settings: Settings,
    commands: Receiver<Command>,
    cancelled: &dyn Fn() -> bool,
    tell: Arc<dyn Fn(Event) + Send + Sync>,
) -> Result<(), WindowError> {
    let event_loop = EventLoop::<Command>::with_user_event().build().map_err(session)?;
    let proxy = event_loop.create_proxy();
    std::thread::spawn(move || {
        // ends with the sender, or with the loop
        for command in commands {
            if proxy.send_event(command).is_err() {
                break;
            }
        }
    });
    let mut app = App {
        settings: Some(settings),
        cancelled,
        tell,
        stage: None,
        stage_parts: Vec::new(),
        windows: Vec::new(),
        watch: None,
        begun: Instant::now(),
        shown_since: None,
        beat: (0, Instant::now(), false),
        pointer: None,
        modifiers: ModifiersState::empty(),
        selected: 0,
        unsaved: false,
        result: None,
    };
    let ran = event_loop.run_app(&mut app).map_err(session);
    // why it ended comes before what the end itself met
    app.result.unwrap_or(ran)
}

struct App<'a> {
    /// Until the threads have them.
    settings: Option<Settings>,
    cancelled: &'a dyn Fn() -> bool,
    tell: Arc<dyn Fn(Event) + Send + Sync>,
    stage: Option<Stage>,
    stage_parts: Vec<Part>,
    windows: Vec<(Arc<Window>, String, Option<[usize; 2]>)>,
    watch: Option<Watch>,
    begun: Instant,
    shown_since: Option<Instant>,
    /// The last sign of the conductor, when, and whether it was said that no other followed.
    beat: (u64, Instant, bool),
    /// Where the pointer was last.
    pointer: Option<PhysicalPosition<f64>>,
    modifiers: ModifiersState,
    selected: usize,
    /// Shifts that no file has.
    unsaved: bool,
    result: Option<Result<(), WindowError>>,
}

/// What runs beside the main thread.
struct Stage {
    baton: Arc<Baton>,
    work: Sender<Work>,
    report: Receiver<Report>,
    /// Closes when the producer has ended.
    produced: Receiver<()>,
    /// The conductor, and who passes on what it needs no more.
    conducting: [JoinHandle<()>; 2],
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
        self.obey(event_loop, command);
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, id: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => self.obey(event_loop, Command::Quit),
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            WindowEvent::KeyboardInput {
                event: KeyEvent { logical_key, state: ElementState::Pressed, .. }, ..
            } => {
                self.key(event_loop, &logical_key);
            }
            WindowEvent::Resized(size) => {
                let Some(stage) = &self.stage else { return };
                stage.baton.resized.store(true, Ordering::Relaxed);
                if stage.mode == Mode::Window {
                    let _ = stage.work.send(Work::Resized([size.width as usize, size.height as usize]));
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                // a window is also told where a pointer rests that nobody moves
                if self.pointer.replace(position).is_none_or(|before| before == position) {
                    return;
                }
                let size =
                    self.windows.iter().find(|(window, ..)| window.id() == id).map(|(window, ..)| window.inner_size());
                if let (Some(stage), Some(size)) = (&self.stage, size)
                    && stage.mode == Mode::Window
                {
                    let share = [
                        2.0 * position.x / f64::from(size.width.max(1)) - 1.0,
                        1.0 - 2.0 * position.y / f64::from(size.height.max(1)),
                    ];
                    let from = [0, 1].map(|axis| share[axis] * REACH * stage.half_fov_deg[axis]);
                    self.obey(event_loop, Command::Look(from));
                }
            }
            _ => {}
        }
    }

    fn exiting(&mut self, event_loop: &ActiveEventLoop) {
        // nobody asked for it
        self.end(event_loop, Err(WindowError::Lost));
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + LOOK));
        if self.result.is_some() || event_loop.exiting() {
            return;
        }
        if (self.cancelled)() {
            return self.obey(event_loop, Command::Quit);
        }
        let Some(stage) = &self.stage else {
            if let Err(error) = self.start_when_ready(event_loop) {
                self.end(event_loop, Err(error));
            }
            return;
        };
        let over = stage.duration.zip(self.shown_since).is_some_and(|(duration, since)| since.elapsed() >= duration);
        if over {
            return self.obey(event_loop, Command::Quit);
        }
        // an output or a session that goes says so in the meantime
        if let Some((_, found)) = stage.failure.get().filter(|(when, _)| when.elapsed() >= GRACE) {
            let error = WindowError::Graphics { on: "the outputs".into(), found: found.trim().into() };
            return self.end(event_loop, Err(error));
        }
        let watch = self.watch.get_or_insert_with(|| Watch::new(event_loop));
        watch.keep_keys(&self.windows[0].0, stage.mode == Mode::Span);
        if stage.mode != Mode::Window {
            let placed = stage.mode == Mode::Span || is_x11(event_loop);
            let now = watch.outputs(event_loop);
            let mut changes =
                self.stage_parts.iter().filter_map(|part| Some((part, change(&part.output, &now, placed)?)));
            if let Some((Part { shows, output, .. }, change)) = changes.next() {
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
        self.feel_pulse();
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
        if settings.mode == Mode::Window {
            let [cols, rows] = display.field.resolution;
            let scale = (960 / cols.max(1)).clamp(1, 8);
            let size = PhysicalSize::new((cols * scale) as u32, (rows * scale) as u32);
            return open(plain().with_inner_size(size), "the window", None);
        }
        let all: Vec<Output> = outputs.iter().map(|(output, _)| output.clone()).collect();
        let assigned = assign(display, &all)?;
        let part = |screen: usize, origin: [u32; 2], (shows, output): (Shows, Output)| {
            let extent = Some(output.size.map(|count| count as u32));
            Part { shows, output, screen, origin, extent }
        };
        if settings.mode == Mode::Span {
            let is_x11 = is_x11(event_loop);
            if !is_x11 {
                tell_compositor()?;
            }
            // a compositor's fullscreen across everything begins at the first output; a window of our own where we want it
            let (corner, size) = if is_x11 { bounds(assigned.iter().map(|(_, output)| output)) } else { bounds(&all) };
            let attributes = spanning(plain().with_title(SPAN_TITLE), corner, size);
            open(attributes, "across all outputs", Some(size))?;
            self.stage_parts = assigned
                .into_iter()
                .map(|(shows, output)| {
                    let origin = [0, 1].map(|axis| (output.position[axis] - corner[axis]) as u32);
                    part(0, origin, (shows, output))
                })
                .collect();
            return Ok(());
        }
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
        self.stage_parts = assigned.into_iter().enumerate().map(|(i, assigned)| part(i, [0, 0], assigned)).collect();
        Ok(())
    }

    /// Starts the threads once every window is as large as its output.
    fn start_when_ready(&mut self, event_loop: &ActiveEventLoop) -> Result<(), WindowError> {
        let mut sizes = self.windows.iter().map(|(window, name, expected)| {
            let size = window.inner_size();
            (name, *expected, [size.width as usize, size.height as usize])
        });
        let wrong = sizes.find(|(_, expected, found)| expected.is_some_and(|size| size != *found));
        if let Some((output, Some(expected), found)) = wrong {
            if self.begun.elapsed() < PATIENCE {
                return Ok(());
            }
            return Err(WindowError::Size { output: output.clone(), expected, found });
        }
        let Settings { mut display, content, mode, fit, hold, duration, log } =
            self.settings.take().expect("not yet started");
        let windows = self.windows.iter().map(|(window, name, _)| (window.clone(), name.clone())).collect();
        let (gpu, screens) = gpu::open(event_loop, windows)?;
        if mode == Mode::Window {
            let size = self.windows[0].0.inner_size();
            // a window may not be on any output yet
            let monitor =
                self.windows[0].0.current_monitor().or_else(|| Some(outputs_of(event_loop).into_iter().next()?.1));
            let refresh_hz = monitor.and_then(|monitor| monitor.refresh_rate_millihertz()).filter(|rate| *rate > 0);
            let output = Output {
                name: "window".into(),
                position: [0, 0],
                size: [size.width as usize, size.height as usize],
                refresh_hz: refresh_hz.map(|rate| f64::from(rate) / 1000.0),
            };
            self.stage_parts = vec![Part { shows: Shows::Layer(0), output, screen: 0, origin: [0, 0], extent: None }];
        }
        if mode != Mode::Window {
            let assigned: Vec<_> = self.stage_parts.iter().map(|part| (part.shows, part.output.clone())).collect();
            if fit {
                let (fits, pitch_mm) = fitted(&display, &assigned);
                display = fits;
                (self.tell)(Event::Warning(format!(
                    "fit: a panel pixel stands for {pitch_mm:.4} mm; where it is of another size, so is everything, and distances between the panels have to follow"
                )));
            }
            misfits(&display, &assigned).into_iter().for_each(|text| (self.tell)(Event::Warning(text)));
        }
        // the slowest output sets the pace
        let told = self.stage_parts.iter().filter_map(|part| part.output.refresh_hz).reduce(f64::min);
        let (refresh_hz, interval_from) = match told {
            Some(told) => (told, "the platform"),
            None => (display.refresh_hz, "the display file, since the platform does not tell"),
        };
        if matches!(content, Content::Stack(_)) {
            display.refresh_hz = refresh_hz;
            if let Some(warning) = display.flicker_warning() {
                (self.tell)(Event::Warning(warning));
            }
        }
        let fields = if display.colour_sequence == ColourSequence::Field { 3 } else { 1 };
        let baton = Arc::new(Baton {
            stop: AtomicBool::new(false),
            hold: AtomicI64::new(hold.map_or(-1, |frame| frame as i64 * fields)),
            places: AtomicU64::new(1),
            report: AtomicBool::new(false),
            resized: AtomicBool::new(false),
            beat: AtomicU64::new(0),
            waits_for: AtomicUsize::new(0),
            feed: Feed::default(),
        });
        let gpu = Arc::new(gpu);
        let failure = gpu.failure.clone();
        let (work, works) = channel();
        let (retire, retired) = channel();
        let forward = work.clone();
        let passing = std::thread::spawn(move || {
            for deck in retired {
                if forward.send(Work::Retired(deck)).is_err() {
                    break;
                }
            }
        });
        #[cfg(all(unix, not(target_os = "macos")))]
        let feedback = super::feedback::Feedback::new(&screens, 1.0 / refresh_hz);
        let conductor = Conductor {
            gpu: gpu.clone(),
            screens,
            parts: self.stage_parts.clone(),
            baton: baton.clone(),
            retired: retire,
            interval_s: 1.0 / refresh_hz,
            interval_from,
            log,
            #[cfg(all(unix, not(target_os = "macos")))]
            feedback,
        };
        let half_fov_deg = display.field.fov_deg.map(|fov| 0.5 * fov);
        let from_deg = if let Content::Rehearsal { from_deg, .. } = content { from_deg } else { [0.0; 2] };
        let pictures = match mode {
            Mode::Window => Vec::new(),
            _ => self.stage_parts.iter().map(|part| Picture::new(&display, part.shows, part.output.size)).collect(),
        };
        let producer = Producer {
            display,
            content,
            parts: self.stage_parts.clone(),
            gpu,
            baton: baton.clone(),
            work: works,
            pictures,
            number: 0,
        };
        let tell = self.tell.clone();
        let (ends, produced) = channel::<()>();
        let producing = std::thread::Builder::new()
            .name("panels: producer".into())
            .spawn(move || {
                producer.run(&*tell);
                drop(ends);
            })
            .map_err(thread)?;
        let (done, report) = channel();
        let tell = self.tell.clone();
        let conducting = std::thread::Builder::new()
            .name("panels: conductor".into())
            .spawn(move || {
                let _ = done.send(conductor.run(&*tell));
            })
            .map_err(thread)?;
        if mode != Mode::Window {
            outputs::stay_awake(self.windows.iter().map(|(window, ..)| &**window));
        }
        self.stage = Some(Stage {
            baton,
            work,
            report,
            produced,
            conducting: [conducting, passing],
            producing,
            failure,
            mode,
            fields,
            half_fov_deg,
            from_deg,
            duration,
        });
        self.shown_since = Some(Instant::now());
        // who hears that it has begun may press a key
        self.watch.insert(Watch::new(event_loop)).keep_keys(&self.windows[0].0, mode == Mode::Span);
        if mode != Mode::Window {
            for Part { shows: panel, output, .. } in &self.stage_parts {
                let Output { name, position, size, refresh_hz } = output.clone();
                (self.tell)(Event::Shows { panel: *panel, output: name, position, size, refresh_hz });
            }
        }
        (self.tell)(Event::Started);
        Ok(())
    }

    /// Says so where refreshes stop: every output waits for the one that takes no picture.
    fn feel_pulse(&mut self) {
        let Some(stage) = self.stage.as_ref().filter(|stage| stage.mode != Mode::Window) else { return };
        let now = stage.baton.beat.load(Ordering::Relaxed);
        let (last, since, told) = self.beat;
        if now != last {
            self.beat = (now, Instant::now(), false);
        } else if now > 0 && !told && since.elapsed() >= STILL {
            self.beat.2 = true;
            let (_, name, _) = &self.windows[stage.baton.waits_for.load(Ordering::Relaxed)];
            let what = if stage.mode == Mode::Span { "the surface across all outputs" } else { name };
            (self.tell)(Event::Warning(format!(
                "{what}: no picture was taken for {} s (asleep, or another workspace on it?); all panels wait for it",
                STILL.as_secs()
            )));
        }
    }

    fn obey(&mut self, event_loop: &ActiveEventLoop, command: Command) {
        if matches!(command, Command::Quit) {
            return self.end(event_loop, Ok(()));
        }
        let Some(stage) = &mut self.stage else { return };
        let hold = &stage.baton.hold;
        match command {
            Command::Stack(stack) => drop(stage.work.send(Work::Stack(stack))),
            Command::Hold(frame) => hold.store(frame as i64 * stage.fields, Ordering::Relaxed),
            Command::Run => hold.store(-1, Ordering::Relaxed),
            Command::Step(by) => {
                let places = stage.baton.places.load(Ordering::Relaxed).max(1) as i64;
                let next = (hold.load(Ordering::Relaxed).max(0) + by * stage.fields).rem_euclid(places);
                hold.store(next, Ordering::Relaxed);
            }
            Command::Nudge(shows, by) => {
                self.unsaved |= by != [0.0; 2];
                let _ = stage.work.send(Work::Nudge(shows, by));
            }
            Command::Save => {
                self.unsaved = false;
                let _ = stage.work.send(Work::Save);
            }
            Command::Look(from) => {
                stage.from_deg = from.map(|angle| angle.clamp(-80.0, 80.0));
                let _ = stage.work.send(Work::Look(stage.from_deg));
            }
            Command::Report => stage.baton.report.store(true, Ordering::Relaxed),
            Command::Quit => {}
        }
    }

    /// Escape or q ends, space keeps a frame or goes on, comma and full stop step; Tab chooses a panel, arrows shift it (with Shift by ten pixels, with
    /// Control by a tenth), s saves; r reports. In the rehearsal arrows turn by a degree.
    fn key(&mut self, event_loop: &ActiveEventLoop, key: &Key) {
        let Some(stage) = &self.stage else { return };
        let step = match (self.modifiers.shift_key(), self.modifiers.control_key()) {
            (true, _) => 10.0,
            (_, true) => 0.1,
            _ => 1.0,
        };
        let arrow = match key {
            Key::Named(NamedKey::ArrowLeft) => Some([-step, 0.0]),
            Key::Named(NamedKey::ArrowRight) => Some([step, 0.0]),
            Key::Named(NamedKey::ArrowUp) => Some([0.0, -step]),
            Key::Named(NamedKey::ArrowDown) => Some([0.0, step]),
            _ => None,
        };
        let command = match (key, arrow) {
            (_, Some([right, down])) if stage.mode == Mode::Window => {
                Command::Look([stage.from_deg[0] + right, stage.from_deg[1] - down])
            }
            (_, Some(shift)) => Command::Nudge(self.stage_parts[self.selected].shows, shift),
            (Key::Named(NamedKey::Escape), _) => Command::Quit,
            (Key::Named(NamedKey::Space), _) if stage.baton.hold.load(Ordering::Relaxed) >= 0 => Command::Run,
            (Key::Named(NamedKey::Space), _) => Command::Hold(0),
            (Key::Named(NamedKey::Tab), _) => {
                self.selected = (self.selected + 1) % self.stage_parts.len().max(1);
                Command::Nudge(self.stage_parts[self.selected].shows, [0.0, 0.0])
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
        self.obey(event_loop, command);
    }

    /// Ends everything; the first reason counts.
    fn end(&mut self, event_loop: &ActiveEventLoop, reason: Result<(), WindowError>) {
        event_loop.exit();
        if self.result.is_some() {
            return;
        }
        let report = match self.stage.take() {
            None => Report::default(),
            Some(stage) => {
                stage.baton.stop.store(true, Ordering::Relaxed);
                let report = stage.report.recv_timeout(FAREWELL).or_else(|waits| {
                    self.windows.iter().take(1).for_each(|(window, ..)| outputs::hang_up(window));
                    // what it then still has to say
                    stage.report.recv_timeout(FAREWELL).map_err(|_| waits)
                });
                // whoever uses the graphics processor ends before the process does: drivers do not survive it otherwise; a thread that has said its last word may
                // still be giving back what the driver keeps for it
                if report.is_ok() {
                    stage.conducting.into_iter().for_each(|thread| drop(thread.join()));
                }
                drop(stage.work);
                drop(stage.baton);
                if stage.produced.recv_timeout(FAREWELL) == Err(RecvTimeoutError::Disconnected) {
                    let _ = stage.producing.join();
                }
                report.unwrap_or_default()
            }
        };
        self.windows.clear();
        if self.unsaved {
            (self.tell)(Event::Warning("the panels' shifts were not saved (key s, or `save`)".into()));
        }
        // an error that comes before the first refresh has nothing to count
        if reason.is_ok() || report.refreshes > 0 {
            (self.tell)(Event::Report(Box::new(report)));
        }
        self.result = Some(reason);
    }
}

fn thread(error: std::io::Error) -> WindowError {
    WindowError::Session(format!("no thread: {error}"))
}

/// A window of a place and size of our own, whatever a window manager thinks.
fn spanning(
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

/// Wayland gives a client one output; sway can be asked for all of them.
fn tell_compositor() -> Result<(), WindowError> {
    // a window is not there for it before it has a picture, so this is a rule for when it comes
    let wish = format!("for_window [title=\"^{SPAN_TITLE}$\"] fullscreen enable global");
    let asked = std::env::var_os("SWAYSOCK").map(|_| std::process::Command::new("swaymsg").arg(&wish).output());
    match asked {
        Some(Ok(answer)) if answer.status.success() => Ok(()),
        Some(Ok(answer)) => {
            Err(WindowError::Span(format!("sway does not do it: {}", String::from_utf8_lossy(&answer.stdout).trim())))
        }
        Some(Err(error)) => Err(WindowError::Span(format!("swaymsg does not start: {error}"))),
        None => Err(WindowError::Span(
            "expected X11, or sway, whose surfaces can reach across outputs; other Wayland compositors give a surface to one output only".into(),
        )),
    }
}
