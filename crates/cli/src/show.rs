//! `lumistack show`: drives panels, or shows a preview in a window.

use std::fmt::Write as _;
use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use clap::Args as ClapArgs;
use lumistack_core::Task;
use lumistack_display::{Display, LayerStack};
use lumistack_pipeline::{
    PipelineError, PresentContext, PresenterInput, PresenterOutput, Registry, RunFolder, present, presets,
    with_new_seal,
};
use lumistack_plugin_panels::assign::Output;
use lumistack_plugin_panels::presentation::{Command, Event, Report};
use lumistack_plugin_panels::{keep_panels, window};
use serde_json::{Value, json};

use crate::console::{say, tell};
use crate::values::Numbers;

/// Id of the plugin that drives panels.
const PRESENTER: &str = "panels";
/// Interval at which a run's folder is checked for new patterns.
const LOOK: Duration = Duration::from_millis(200);

#[derive(Debug, ClapArgs)]
pub(crate) struct Show {
    /// A run folder. With --pattern or --full-resolution-2d, DIR may also be a display file or the
    /// name of a built-in display
    #[arg(required_unless_present = "list")]
    pub(crate) dir: Option<PathBuf>,
    /// List the outputs of this desktop session, to which panels may be connected
    #[arg(long)]
    pub(crate) list: bool,
    /// Draw one surface across all outputs, so that all layers change their frames together. The
    /// option works on X11, and on Wayland with sway
    #[arg(long)]
    pub(crate) span: bool,
    /// Show a preview of the display in an ordinary window; the mouse moves the viewer
    #[arg(long, alias = "rehearse", conflicts_with_all = ["span", "pattern", "full_resolution_2d", "hold"])]
    pub(crate) preview: bool,
    /// Initial direction of the preview's viewer, degrees to the right and up
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, requires = "preview")]
    pub(crate) from: Option<Numbers<2>>,
    /// Scale the masks to your panels, if the run was made for panels of other sizes. You must then
    /// also scale the distances between the panels by the printed factor
    #[arg(long, conflicts_with_all = ["preview", "pattern"])]
    pub(crate) fit: bool,
    /// Show a picture (PNG, JPEG, WebP) on one layer at the panel's full resolution; the other
    /// layers are clear
    #[arg(long, value_name = "FILE", conflicts_with = "pattern")]
    pub(crate) full_resolution_2d: Option<PathBuf>,
    /// Layer that shows the picture of --full-resolution-2d; 0 is the rearmost [default: the layer
    /// nearest to the display plane]
    #[arg(long, value_name = "N", requires = "full_resolution_2d")]
    pub(crate) layer: Option<usize>,
    /// Show a test pattern: crosshairs, ramp, code=V, code=R,G,B (codes 0 to 255),
    /// lenslet=COLUMN,ROW, view=X,Y, clear or identify
    #[arg(long, value_name = "PATTERN")]
    pub(crate) pattern: Option<String>,
    /// Show the pattern on one panel only, given as a layer's number or `backlight`; the other
    /// panels are clear
    #[arg(long, value_name = "N|backlight", requires = "pattern")]
    pub(crate) only: Option<String>,
    /// Position of the eye or camera for which the crosshairs of all layers coincide: X right, Y
    /// up, Z in front of the display, millimetres. The default is straight ahead at the display's
    /// viewing distance, or at 2000 mm if the display has none
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "pattern")]
    pub(crate) eye_mm: Option<Numbers<3>>,
    /// Hold frame K, counted from 0, instead of showing all frames in turn
    #[arg(long, value_name = "K")]
    pub(crate) hold: Option<usize>,
    /// Display file with the calibration of the panels. The key s saves shifts of panels to this
    /// file [default: display.toml of the run]
    #[arg(long, value_name = "FILE")]
    pub(crate) calibration: Option<PathBuf>,
    /// End after this many seconds
    #[arg(long, value_name = "S")]
    pub(crate) duration_s: Option<f64>,
    /// Read commands from standard input, one per line: hold K, run, step N, nudge PANEL RIGHT DOWN
    /// (pixels), save, look X Y (degrees to the right and up), report, quit
    #[arg(long)]
    pub(crate) control: bool,
    /// Write a CSV file with a line for each submitted frame. Its columns are: index of the
    /// refresh, position in the cycle of frames, index of the set of patterns, seconds since the
    /// first frame. The file has at most the first 1,048,576 frames
    #[arg(long, value_name = "FILE")]
    pub(crate) log: Option<PathBuf>,
}

pub(crate) fn show_command(args: &Show, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    if args.list {
        return list(json);
    }
    let dir = args.dir.as_deref().unwrap_or(Path::new("."));
    let Subject { display, stack, file } = subject(args, dir)?;
    let params = params(args)?;
    // Only patterns of a run may change later; a test pattern or a picture stays.
    let first = stack.filter(|_| args.pattern.is_none() && args.full_resolution_2d.is_none());
    let (send, input) = channel();
    if first.is_some() {
        let (send, dir) = (send.clone(), dir.to_owned());
        std::thread::spawn(move || watch(&dir, &send));
    }
    if args.control {
        std::thread::spawn(move || control(&send));
    }
    // The callback for events cannot return an error, so the last error is kept.
    let failed = Mutex::new(None);
    let on_output = |output: PresenterOutput<'_>| match output {
        PresenterOutput::Warning(text) => warn("show", text, json),
        PresenterOutput::Event(event) => {
            if let Err(error) = happened(event, json, file.as_deref(), args.log.as_deref()) {
                *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            }
        }
    };
    let context = PresentContext { display: &display, first: first.as_ref(), input, on_output: &on_output, task };
    present(registry, PRESENTER, &params, context).map_err(PipelineError::Output)?;
    failed.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

fn warn(place: &str, text: &str, json: bool) {
    match json {
        true => say!("{}", json!({"event": "warning", "place": place, "message": text})),
        false => tell!("warning: {text}"),
    }
}

/// The display to show, its patterns, and the file with its calibration.
struct Subject {
    display: Display,
    stack: Option<LayerStack>,
    file: Option<PathBuf>,
}

fn subject(args: &Show, dir: &Path) -> Result<Subject, PipelineError> {
    let mut subject = if dir.join("layers/stack.json").is_file() {
        let run = RunFolder::open(dir)?;
        Subject { display: run.display, stack: Some(run.stack), file: Some(dir.join("display.toml")) }
    } else if args.pattern.is_some() || args.full_resolution_2d.is_some() {
        match lumistack_pipeline::DisplayJob::by_name_or_path(dir).file {
            Some(file) => Subject { display: presets::load_file(&file)?, stack: None, file: Some(file) },
            None => Subject { display: presets::load(&dir.to_string_lossy())?, stack: None, file: None },
        }
    } else {
        return Err(PipelineError::value(
            dir,
            "folder",
            "a run folder, which contains layers/stack.json",
            "no run folder; to show a test pattern on a display, add --pattern",
        ));
    };
    if let Some(path) = &args.calibration {
        let measured = presets::load_file(path)?;
        subject.display = calibrated(&subject.display, &measured, path)?;
        subject.file = Some(path.clone());
    }
    if args.fit {
        // With --fit the shown panels are not the panels of the display file, so their shifts must
        // not be saved to this file.
        subject.file = None;
    }
    Ok(subject)
}

/// Returns the display with the calibration of `measured`, which must have the same layers.
fn calibrated(display: &Display, measured: &Display, path: &Path) -> Result<Display, PipelineError> {
    let fits = |display: &Display| {
        let masks: Vec<_> = display.layers.iter().map(|layer| (layer.resolution, layer.pitch_mm.to_bits())).collect();
        (masks, LayerStack::emission_shape(&Display { frames: 1, ..display.clone() }))
    };
    if fits(display) != fits(measured) {
        let expected = "the layers and lenslets of the shown display, with equal pixels and pitches";
        return Err(PipelineError::value(path, "layers", expected, "other layers or lenslets"));
    }
    // Take only the calibration. Distances and frames must stay as they were when the patterns were
    // solved.
    let mut display = display.clone();
    for (own, measured) in display.layers.iter_mut().zip(&measured.layers) {
        own.panel.clone_from(&measured.panel);
        own.transfer.clone_from(&measured.transfer);
        (own.panel_resolution, own.panel_pitch_mm) = (measured.panel_resolution, measured.panel_pitch_mm);
        (own.black_level, own.peak, own.bits) = (measured.black_level, measured.peak, measured.bits);
    }
    display.colour_order = measured.colour_order;
    display.refresh_hz = measured.refresh_hz;
    use lumistack_display::Backlight::Lenslets;
    if let (Lenslets(own), Lenslets(measured)) = (&mut display.backlight, &measured.backlight) {
        own.panel.clone_from(&measured.panel);
        own.lens.clone_from(&measured.lens);
        own.transfer.clone_from(&measured.transfer);
        own.black_level = measured.black_level;
        (own.panel_resolution, own.panel_pitch_mm) = (measured.panel_resolution, measured.panel_pitch_mm);
    }
    display.check().map_err(|source| PipelineError::Display { path: path.to_owned(), text: String::new(), source })?;
    Ok(display)
}

/// Makes the presenter's parameters from the options.
fn params(args: &Show) -> Result<Value, PipelineError> {
    let mode = match (args.preview, args.span) {
        (true, _) => "window",
        (_, true) => "span",
        _ => "outputs",
    };
    let mut params = json!({"mode": mode, "fit": args.fit, "log": args.log.is_some()});
    let mut set = |name: &str, value: Option<Value>| {
        if let Some(value) = value {
            params[name] = value;
        }
    };
    set("hold", args.hold.map(Value::from));
    // For the presenter 0 means "not set", so these options must be above 0.
    let eye_z_mm = args.eye_mm.map(|eye| eye.0[2]);
    for (flag, key, value) in [("--duration-s", "value", args.duration_s), ("--eye-mm", "Z", eye_z_mm)] {
        if let Some(found) = value.filter(|value| *value <= 0.0) {
            return Err(PipelineError::value(flag, key, "a number above 0", found.to_string()));
        }
    }
    set("duration_s", args.duration_s.map(Value::from));
    for (axis, name) in ["from_x_deg", "from_y_deg"].into_iter().enumerate() {
        set(name, args.from.map(|from| from.0[axis].into()));
    }
    set("pattern", args.pattern.clone().map(Value::from));
    set("only", args.only.clone().map(Value::from));
    for (axis, name) in ["eye_x_mm", "eye_y_mm", "eye_z_mm"].into_iter().enumerate() {
        set(name, args.eye_mm.map(|eye| eye.0[axis].into()));
    }
    if let Some(path) = &args.full_resolution_2d {
        let text = path.to_str().ok_or_else(|| PipelineError::value(path, "name", "UTF-8", "other bytes"))?;
        set("picture", Some(text.into()));
    }
    set("layer", args.layer.map(Value::from));
    Ok(params)
}

/// Lists the outputs of the session, or returns the reason why they cannot be listed.
pub(crate) fn outputs() -> Result<Vec<String>, String> {
    Ok(window::outputs().map_err(|error| error.to_string())?.iter().map(|output| describe(output, false)).collect())
}

fn list(json: bool) -> Result<(), PipelineError> {
    let outputs = window::outputs().map_err(PipelineError::command)?;
    for output in &outputs {
        say!("{}", describe(output, json));
    }
    if outputs.is_empty() && !json {
        say!("found no outputs, since no monitor is on");
    }
    Ok(())
}

fn describe(output: &Output, json: bool) -> String {
    let Output { name, position: [x, y], size: [cols, rows], refresh_hz } = output;
    if json {
        return json!({"event": "output", "name": name, "position": [x, y], "size": [cols, rows], "refresh_hz": refresh_hz}).to_string();
    }
    let rate = refresh_hz.map_or("refresh rate unknown".into(), |rate| format!("{rate:.2} Hz"));
    format!("{name}: {cols} × {rows} pixels at {x},{y}, {rate}")
}

/// Sends the patterns of a run each time they have been written again.
fn watch(dir: &Path, send: &Sender<PresenterInput>) {
    let (layers, index) = (dir.join("layers"), dir.join("layers/stack.json"));
    let stamp = || std::fs::metadata(&index).and_then(|data| data.modified()).ok();
    let mut shown: Option<SystemTime> = stamp();
    loop {
        std::thread::sleep(LOOK);
        let before = stamp();
        if before.is_none() || before == shown {
            continue;
        }
        // A run removes the index first and writes it last. So the stack is complete if the index
        // is the same before and after the stack is read.
        let Ok(stack) = lumistack_field_io::read_stack(&layers) else { continue };
        if stamp() != before {
            continue;
        }
        shown = before;
        if send.send(PresenterInput::Stack(stack)).is_err() {
            return;
        }
    }
}

/// Reads commands from standard input.
fn control(send: &Sender<PresenterInput>) {
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        match command_of(&line) {
            Ok(command) => {
                if send.send(PresenterInput::Command(json!(command))).is_err() {
                    return;
                }
            }
            Err(error) => tell!("warning: {error}"),
        }
    }
}

fn command_of(line: &str) -> Result<Command, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let number = |i: usize| words.get(i).and_then(|word| word.parse::<f64>().ok()).filter(|number| number.is_finite());
    let command = match (words.first().copied().unwrap_or(""), words.len()) {
        ("hold", 2) => words[1].parse().ok().map(Command::Hold),
        ("step", 2) => words[1].parse().ok().map(Command::Step),
        ("run", 1) => Some(Command::Run),
        ("save", 1) => Some(Command::Save),
        ("report", 1) => Some(Command::Report),
        ("quit", 1) => Some(Command::Quit),
        ("look", 3) => number(1).zip(number(2)).map(|(x, y)| Command::Look([x, y])),
        ("nudge", 4) => {
            let panel = words[1].parse().ok();
            panel.zip(number(2).zip(number(3))).map(|(panel, (right, down))| Command::Nudge(panel, [right, down]))
        }
        _ => None,
    };
    let expected = "hold K, run, step N, nudge PANEL RIGHT DOWN, save, look X Y, report or quit";
    command.ok_or_else(|| format!("standard input: expected {expected}, found `{line}`"))
}

/// Prints an event of the presenter. If the event requests that the display is saved, saves it to
/// `file`. Writes a report's list of submissions to `log`. Without `json`, the events `Started`,
/// `Swapped`, `Looked` and `Warning` are not printed.
fn happened(event: &Value, json: bool, file: Option<&Path>, log: Option<&Path>) -> Result<(), PipelineError> {
    match serde_json::from_value(event.clone()) {
        Ok(Event::Save { display }) => match save(&display, file) {
            Ok(path) if json => say!("{}", json!({"event": "saved", "file": path.to_string_lossy()})),
            Ok(path) => say!("saved: {}", path.display()),
            Err(error) => warn("save", &error.to_string(), json),
        },
        Ok(Event::Report(mut report)) => {
            let submissions = std::mem::take(&mut report.log);
            if let Some(path) = log {
                write_log(path, &submissions)?;
            }
            match json {
                true => say!("{}", json!(Event::Report(report))),
                false => print_report(&report),
            }
        }
        Ok(_) if json => say!("{event}"),
        Ok(Event::Shows { panel, output: name, position, size, refresh_hz }) => {
            say!("{panel} on {}", describe(&Output { name, position, size, refresh_hz }, false));
        }
        Ok(Event::Nudged { panel, nudge_px: [right, down] }) => {
            say!("{panel}: shifted {right} px to the right and {down} px down")
        }
        Ok(Event::Started | Event::Swapped { .. } | Event::Looked { .. } | Event::Warning(_)) => {}
        Err(error) => warn("show", &format!("{event}: {error}"), json),
    }
    Ok(())
}

fn write_log(path: &Path, submissions: &[(u64, usize, u64, f64)]) -> Result<(), PipelineError> {
    let mut text = String::from("refresh,place,pictures,seconds\n");
    for (refresh, place, pictures, seconds) in submissions {
        let _ = writeln!(text, "{refresh},{place},{pictures},{seconds:.6}");
    }
    lumistack_field_io::atomic::write_bytes(path, text.as_bytes()).map_err(PipelineError::Field)
}

fn save(display: &Display, file: Option<&Path>) -> Result<PathBuf, PipelineError> {
    let path = file.ok_or_else(|| {
        PipelineError::value(
            "save",
            "file",
            "a display file of these panels (--calibration FILE names one, but not together with --fit)",
            "a built-in display, or a display that --fit changed",
        )
    })?;
    let text =
        lumistack_files::read_text(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })?;
    let text = with_new_seal(&text, &keep_panels(&text, display).map_err(PipelineError::command)?);
    lumistack_field_io::atomic::write_bytes(path, text.as_bytes()).map_err(PipelineError::Field)?;
    Ok(path.to_owned())
}

fn print_report(report: &Report) {
    if report.refreshes == 0 {
        return say!("no frame was shown");
    }
    say!(
        "number of refreshes: {} in {:.1} s, so {:.1} Hz; expected {:.1} Hz, as stated by {}",
        report.refreshes,
        report.seconds,
        report.rate_hz,
        1.0 / report.interval_s.max(1e-9),
        report.interval_from
    );
    let counts = |tally: &lumistack_plugin_panels::Tally| {
        format!(
            "frames late: {}, repeated: {}, dropped: {}, out of order: {}",
            tally.late, tally.repeated, tally.dropped, tally.out_of_order
        )
    };
    // Some platforms do not report when frames were shown. Then only the times of submission are
    // known.
    match (report.presented.is_empty(), &report.submitted) {
        (true, Some(submitted)) => say!(
            "{}, by the times at which the frames were submitted, since the platform does not report when frames were shown",
            counts(submitted)
        ),
        _ => report.presented.iter().for_each(|(name, tally)| say!("{name}: {}", counts(tally))),
    }
    match report.skew_mean_s.zip(report.skew_largest_s) {
        Some((mean, largest)) => {
            say!("skew between outputs: {:.2} ms on average, at most {:.2} ms", 1000.0 * mean, 1000.0 * largest)
        }
        None if report.presented.len() == 1 => say!("skew between outputs: none, since all panels are on one surface"),
        None => say!("skew between outputs: not known, since the platform does not report the skew"),
    }
}
