//! `lumistack live`: shows a display that follows its scene while settings, files, time and viewers
//! change.
//!
//! ```text
//! standard input ─▶ Requests ─▶ renderer ──light fields──▶ solver ──states──▶ page, panels
//! files, video ───▶
//! viewers ────────▶ Tracker ─────────────────rays──────────▶
//! ```
//!
//! The renderer, the solver, the page and the panels run in one thread each.

mod clock;
mod control;
mod door;
mod feed;
mod messages;
mod requests;
mod watch;
mod work;

use std::net::UdpSocket;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, SystemTime};

use clap::Args as ClapArgs;
use lumistack_core::{Cancel, NoProgress, Task};
use lumistack_pipeline::{
    Job, LiveFields, LiveFolder, LiveSolver, PipelineError, PresentContext, PresenterInput, PresenterOutput, Registry,
    present,
};
use lumistack_plugin_panels::presentation::{Command, Event};
use serde_json::json;

use self::control::{read_commands, read_packets};
use self::door::{Door, Events};
use self::feed::{Guest, PageFeed};
use self::messages::Once;
use self::requests::{Requests, lock};
use self::watch::Watched;
use self::work::{Rates, Shared, render, solve};
use crate::console::{say, tell};
use crate::groups::{
    DisplayArgs, FactorizeArgs, RenderArgs, change_display, change_factorize, change_render, in_place, is_job,
    job_or_scene, stem,
};
use crate::server::{Site, listen, port_of, serve};
use crate::values::Numbers;

/// Examples and commands that `lumistack live --help` prints.
pub(crate) const EXAMPLES: &str = "Examples:\n  lumistack live model.glb\n      updates the display when the model is saved again\n  lumistack live scenes/still-life/job.toml --resolution 160x100\n      updates a smaller display when the job or its scene is saved again\n  echo '{\"set\": {\"display.brightness\": 0.5}}' | lumistack live model.glb\n      starts with another brightness\n  lumistack live views/ --times --rate 12\n      plays a video of 12 light fields per second\n  lumistack live model.glb --opentrack 4242\n      follows the head whose position OpenTrack sends to this UDP port\n\nStandard input accepts commands. Each line is a JSON object, such as:\n  {\"set\": {KEY: VALUE, ...}}       changes keys of the job\n  {\"time\": SECONDS}                changes the time of the scene's animation\n  {\"viewers\": [[X, Y, Z], ...]}    states the positions of the viewers' heads, millimetres\n  {\"reload\": true}                 reads the files of the scene or light field again\n  {\"stop\": true}                   ends the display\n  {\"stop_at_end\": true}            ends the display when standard input ends\n\nWhen the display ends, also by Ctrl-C, its last state is written as a run folder. docs/LIVE.md has the details.";

/// Help of `--denoise`. A live display shares light between views with every kind except `off`.
const DENOISE: &str = "Filter that removes noise from views: auto, shared, off, guided or oidn. With off, the views stay as they are traced. With every other kind, light that several views see alike is averaged over these views";

/// Interval at which files are checked for changes.
const LOOK: Duration = Duration::from_millis(100);
/// Interval at which threads check whether the display has stopped.
const TICK: Duration = Duration::from_millis(20);
/// Smallest and largest number of time steps per second.
const RATES_HZ: [f64; 2] = [0.001, 1000.0];

#[derive(Debug, ClapArgs)]
#[command(mut_arg("iterations", |arg| arg.hide(true)))]
#[command(mut_arg("warm_start", |arg| arg.hide(true)))]
#[command(mut_arg("engine", |arg| arg.hide(true)))]
#[command(mut_arg("denoise", |arg| arg.help(DENOISE)))]
pub(crate) struct Live {
    /// Job file (.toml), scene, or light field that states its geometry; with --times a folder of
    /// light fields
    pub(crate) input: PathBuf,
    /// Folder for the last state [default: runs/NAME-live]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    /// Port of this machine at which the display is served as a page for the browser; 0 for any
    /// free port
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) port: u16,
    /// Do not open the browser
    #[arg(long)]
    pub(crate) no_open: bool,
    /// Also show the display outside of the browser. This needs a build with the feature panels.
    /// MODE is outputs (one surface per panel), span (one surface across all panels) or window (a
    /// preview in a window)
    #[arg(long, value_name = "MODE", value_parser = ["outputs", "span", "window"])]
    pub(crate) show: Option<String>,
    /// Largest number of iterations from one shown state to the next. An iteration updates every
    /// layer once, and a directional backlight, if there is one. The number is reduced if the
    /// iterations would take longer than 0.3 s. --iterations and --warm-start have no effect on a
    /// live display
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) updates: u32,
    /// Read the input as a video: a folder of light fields, one per time step, in the order of
    /// their names
    #[arg(long, help_heading = "Video")]
    pub(crate) times: bool,
    /// Time steps per second, from 0.001 to 1000
    #[arg(long, value_name = "HZ", default_value_t = 24.0, requires = "times", help_heading = "Video")]
    pub(crate) rate: f64,
    /// Largest delay of playback, in time steps. If the delay is greater, playback skips to the
    /// present time step; skipped time steps are counted
    #[arg(long, value_name = "N", default_value_t = 3, requires = "times", help_heading = "Video")]
    pub(crate) most_late: usize,
    /// UDP port of this machine to which OpenTrack sends the head's position
    #[arg(long, value_name = "PORT", help_heading = "Viewers")]
    pub(crate) opentrack: Option<u16>,
    /// Position of the head when OpenTrack was centred: X right, Y up, Z in front of the display,
    /// millimetres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, default_value = "0,0,600", help_heading = "Viewers")]
    pub(crate) head_mm: Numbers<3>,
    /// Use the mouse in the window of `--show window` as a tracked head, at the distance Z of
    /// --head-mm
    #[arg(long, requires = "show", conflicts_with = "opentrack", help_heading = "Viewers")]
    pub(crate) mouse: bool,
    /// Uncertainty of the predicted position of an eye (standard deviation), millimetres. Patterns
    /// are solved for two points at this distance from each eye, to its left and right
    #[arg(long, value_name = "MM", default_value_t = lumistack_live::SIGMA_MM, help_heading = "Viewers")]
    pub(crate) sigma_mm: f64,
    #[command(flatten)]
    pub(crate) display: DisplayArgs,
    #[command(flatten)]
    pub(crate) render: RenderArgs,
    #[command(flatten)]
    pub(crate) factorize: FactorizeArgs,
}

impl Live {
    /// Makes the job of the input, with the changes of the command line.
    fn job(&self) -> Result<Job, PipelineError> {
        let mut job = if is_light_field(&self.input) {
            let display = self.display.display.clone().unwrap_or_else(|| crate::groups::DEFAULT_DISPLAY.into());
            let mut job = Job::new(lumistack_pipeline::DisplayJob::by_name_or_path(&display));
            (job.name, job.light_field) = (stem(&self.input), Some(self.input.clone()));
            job
        } else {
            job_or_scene(&self.input)?
        };
        change_display(&mut job, &self.display);
        change_render(&mut job, &self.render);
        change_factorize(&mut job, &self.factorize);
        Ok(job)
    }

    fn check(&self) -> Result<(), PipelineError> {
        let positive = |name, key, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(PipelineError::option(name, key, "a number above 0", value.to_string())),
        };
        let [least, most] = RATES_HZ;
        if !(least..=most).contains(&self.rate) {
            let expected = format!("a number from {least} to {most}");
            return Err(PipelineError::option("--rate", "value", expected, self.rate.to_string()));
        }
        positive("--sigma-mm", "value", self.sigma_mm)?;
        positive("--head-mm", "Z", self.head_mm.0[2])?;
        match &self.show {
            Some(mode) if self.mouse && mode != "window" => Err(PipelineError::option(
                "--mouse",
                "--show",
                "`window`, since only the window has a mouse pointer",
                format!("`{mode}`"),
            )),
            _ => Ok(()),
        }
    }
}

/// Returns whether a path is read as a light field.
fn is_light_field(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase();
    !is_job(path) && (path.is_dir() || ["npy", "png", "jpg", "jpeg", "webp"].contains(&extension.as_str()))
}

pub(crate) fn live_command(args: &Live, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    args.check()?;
    let begun = SystemTime::now();
    // Prepare job, run folder, page and tracker. Their errors end the command before a thread
    // starts.
    let in_input = |error| in_place(error, &args.input);
    let mut job = args.job().map_err(in_input)?;
    let times = if args.times { LiveFields::times_of(&job).map_err(in_input)? } else { Vec::new() };
    if let Some(first) = times.first() {
        job.light_field = Some(first.clone());
    }
    let dir = args.output.clone().unwrap_or_else(|| Path::new("runs").join(format!("{}-live", job.name)));
    let folder = LiveFolder::lock(&dir, &job, registry, task)?;
    let site = folder.cache().join("live");
    let live_fields = LiveFields::new(job.clone(), &folder.cache()).map_err(in_input)?;
    let solver = LiveSolver::new(&job).map_err(in_input)?;
    let server = listen(args.port).map_err(|error| {
        PipelineError::option("--port", "N", "a free port of this machine", format!("{} ({error})", args.port))
    })?;
    let socket = args.opentrack.map(open_socket).transpose()?;
    // no program may change the light fields of a video, so a video has no `Door`
    let door = (!args.times).then(|| Door::open(&folder.cache())).transpose()?;

    let title = job.name.clone();
    let shared = Shared::new(Requests::new(job), Events::new(json), args.updates, args.sigma_mm);
    let warnings = Once::new(task.warnings, &shared.messages, &shared.events);
    let work = Task { progress: &NoProgress, warnings: &warnings, cancel: task.cancel };
    // A thread that waits for a line of input cannot be ended, so it is detached.
    let requests = shared.requests.clone();
    std::thread::spawn(move || read_commands(std::io::stdin().lock(), &requests, json));
    // The page may move the viewer only if neither a tracker nor the mouse in the window moves the
    // viewer.
    let is_tracked = args.opentrack.is_some() || args.mouse;
    let guest = (!is_tracked).then(|| Guest::new(&shared.requests, args.head_mm.0[2])).transpose()?;
    let feed = PageFeed::new(&shared.states, &shared.messages, (&site, &title), guest, registry, work);
    let rates = Rates { times, rate_hz: args.rate, most_late: args.most_late };
    // Threads run until the user, a command, the end of the video or a panic stops them.
    let shared = &shared;
    let ended = std::thread::scope(|scope| {
        let renderer = scope.spawn(|| shared.guard(|| render(live_fields, shared, rates, registry, work)));
        let solver = scope.spawn(|| shared.guard(|| solve(solver, shared, work)));
        if let Some(door) = &door {
            scope.spawn(|| shared.guard(|| door.attend(&shared.requests, &shared.events)));
        }
        if let Some(socket) = &socket {
            scope.spawn(|| shared.guard(|| read_packets(socket, args.head_mm.0, &shared.requests, work)));
        }
        scope.spawn(|| shared.guard(|| watch_files(args, begun, shared, work)));
        let page = scope.spawn(|| shared.guard(|| serve_page(args, &server, &feed, shared, json, work)));
        let shown = shared.guard(|| match &args.show {
            Some(mode) => show(mode, args.mouse.then_some(args.head_mm.0[2]), shared, registry, work),
            None => {
                // Wait for Ctrl-C, a command that stops the display, or the end of a video.
                while !(task.cancel.is_cancelled() || shared.requests.is_stopped()) {
                    std::thread::sleep(TICK);
                }
                Ok(())
            }
        });
        shared.stop();
        feed.stop();
        // A panic of a thread is a panic of the command.
        page.join().unwrap_or_else(|panic| resume_unwind(panic));
        let solved = solver.join().unwrap_or_else(|panic| resume_unwind(panic));
        let dropped = renderer.join().unwrap_or_else(|panic| resume_unwind(panic));
        shown.and(solved).and(dropped)
    });
    let _ = std::fs::remove_dir_all(&site);
    let dropped = ended.map_err(in_input)?;
    let Some((number, state)) = shared.states.after(0) else { return Err(PipelineError::Cancelled) };
    // Ctrl-C may have set the cancel flag of `task`, which would stop these last steps too. So
    // these steps get another flag.
    let cancel = Cancel::default();
    let report = folder.finish(
        &shared.requests.job(),
        &state,
        Task { progress: &NoProgress, warnings: &warnings, cancel: &cancel },
    )?;
    let psnr_view = state.psnr_view;
    let shown_psnr = psnr_view.is_finite().then_some(psnr_view);
    shared.events.say(
        &json!({"event": "done", "states": number, "dropped": dropped, "psnr_view": shown_psnr, "report": report.to_string_lossy()}),
    );
    shared.events.end();
    if !json {
        let video = if args.times { format!(", skipped time steps: {dropped}") } else { String::new() };
        say!("shown states: {number}{video}; PSNR of the last state: {psnr_view:.1} dB at the solver's views");
        say!("{}", report.display());
    }
    Ok(())
}

fn open_socket(port: u16) -> Result<UdpSocket, PipelineError> {
    let bound = UdpSocket::bind(("127.0.0.1", port)).and_then(|socket| {
        socket.set_read_timeout(Some(LOOK))?;
        Ok(socket)
    });
    bound.map_err(|error| {
        PipelineError::option("--opentrack", "PORT", "a free UDP port of this machine", format!("{port} ({error})"))
    })
}

fn serve_page(
    args: &Live,
    server: &crate::server::Server,
    feed: &PageFeed<'_>,
    shared: &Shared,
    json: bool,
    task: Task<'_>,
) {
    // The page's own files are written with the first state, so the address is printed only then.
    while feed.prepare().is_none() {
        if shared.is_stopped() {
            return;
        }
        std::thread::sleep(TICK);
    }
    let address = format!("http://localhost:{}/", port_of(server));
    shared.events.say(&json!({"event": "serving", "address": address}));
    if !json {
        say!("{address}   (Ctrl-C ends it)");
    }
    if !args.no_open
        && let Err(error) = opener::open_browser(&address)
    {
        task.warn("live", format!("the browser did not open ({error}); open {address} yourself"));
    }
    serve(server, Site { root: feed.root(), live: Some(feed) }, || (!shared.is_stopped()).then(String::new));
}

/// Watches the job file and the files of the current light field. A changed job file replaces the
/// job. Without `--times`, a change of another file makes the renderer read the light field's files
/// again. The job file was read after `begun`.
fn watch_files(args: &Live, begun: SystemTime, shared: &Shared, task: Task<'_>) {
    let mut watched = Watched::default();
    let mut of_job = Watched::default();
    while !shared.is_stopped() {
        std::thread::sleep(LOOK);
        let (files, read) = shared.files();
        if !args.times && watched.have_changed(&files, read) {
            shared.requests.reload();
        }
        if is_job(&args.input) && of_job.have_changed(std::slice::from_ref(&args.input), begun) {
            let changed = args.job().and_then(|job| shared.requests.replace(job));
            if let Err(error) = changed {
                // The changed file is incomplete or wrong, so the previous job stays in use.
                task.warn(args.input.display().to_string(), error.to_string());
            }
        }
    }
}

/// Runs the presenter until it is closed. With `mouse_mm`, the mouse in its window moves a tracked
/// head at this distance from the display.
fn show(
    mode: &str,
    mouse_mm: Option<f64>,
    shared: &Shared,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let first = loop {
        if let Some(first) = shared.states.wait_after(0, TICK) {
            break first;
        }
        if task.cancel.is_cancelled() || shared.requests.is_stopped() {
            return Ok(());
        }
    };
    let (mut seen, state) = first;
    // The channel holds one state. Newer states wait in the mailbox `shared.states`, in which each
    // state replaces the previous one.
    let (send, input) = sync_channel(1);
    let stop = Cancel::default();
    let see = |head_mm| {
        if let Err(error) = shared.requests.see(&[head_mm], lumistack_live::Eyes::Picture) {
            task.warn("--mouse", error.to_string());
        }
    };
    let (display, stop_of_thread) = (&*state.target.display, &stop);
    let head = Mutex::new(None);
    let head_of_thread = &head;
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while !(stop_of_thread.is_cancelled() || shared.is_stopped() || shared.requests.is_stopped()) {
                // A mouse that rests sends no events. Its position is repeated, so that the
                // tracker follows a head that stands still.
                if let Some(head_mm) = *lock(head_of_thread) {
                    see(head_mm);
                }
                let Some((number, state)) = shared.states.wait_after(seen, TICK) else { continue };
                seen = number;
                if state.stack.check(display).is_err() {
                    task.warn(
                        "show",
                        "the panels continue with the old patterns, since the size and the frames of panels cannot change while they show patterns; restart `lumistack live`",
                    );
                } else if send.send(PresenterInput::Stack(state.stack.clone())).is_err() {
                    return;
                }
            }
            // A stop by a command must also close the panels.
            let _ = send.send(PresenterInput::Command(json!(Command::Quit)));
        });
        let on_output = |output: PresenterOutput<'_>| match output {
            PresenterOutput::Warning(text) => tell!("warning: {text}"),
            PresenterOutput::Event(event) => {
                if let (Some(distance_mm), Ok(Event::Looked { from_deg })) =
                    (mouse_mm, serde_json::from_value(event.clone()))
                {
                    *lock(&head) = Some(head_at(from_deg, distance_mm));
                }
            }
        };
        let params = json!({"mode": mode});
        let context = PresentContext { display, first: Some(&state.stack), input, on_output: &on_output, task };
        let shown = present(registry, "panels", &params, context).map_err(PipelineError::Output);
        stop.cancel();
        shown
    })
}

/// Returns the position of a head at `distance_mm` in front of the display, mm. `from_deg` has the
/// angles, to the right and up, from which the head sees the display's centre.
fn head_at(from_deg: [f64; 2], distance_mm: f64) -> [f64; 3] {
    let [x, y] = from_deg.map(|angle| distance_mm * angle.to_radians().tan());
    [x, y, distance_mm]
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        live: Live,
    }

    #[test]
    fn a_rate_without_a_schedule_is_refused() {
        let check = |rate: &str| {
            let command = Command::parse_from(["live", "views", "--times", "--rate", rate]);
            command.live.check().map_err(|error| error.to_string())
        };
        assert_eq!(["24", "0.001", "1000"].map(check), [Ok(()), Ok(()), Ok(())]);
        for rate in ["0", "1e-30", "1e9", "inf", "NaN"] {
            let error = check(rate).unwrap_err();
            assert!(error.starts_with("--rate: value: expected a number from 0.001 to 1000, found"), "{rate}: {error}");
        }
    }
}
