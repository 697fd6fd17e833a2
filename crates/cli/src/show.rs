//! `lumistack show`: drives physical panels, or rehearses them in a window.

use std::path::PathBuf;

use crate::values::Numbers;
use clap::Args as ClapArgs;

#[derive(Debug, ClapArgs)]
#[cfg_attr(not(feature = "panels"), allow(dead_code, reason = "read where there are windows"))]
pub(crate) struct Show {
    /// A run folder; with --pattern also a display file or the name of a preset
    #[arg(required_unless_present = "list")]
    pub(crate) dir: Option<PathBuf>,
    /// List the outputs of this session
    #[arg(long)]
    pub(crate) list: bool,
    /// One surface across all outputs, so that all layers flip together (X11, or sway)
    #[arg(long)]
    pub(crate) span: bool,
    /// In an ordinary window what the display would show; the mouse moves the viewer
    #[arg(long, conflicts_with_all = ["span", "pattern", "full_resolution_2d", "hold"])]
    pub(crate) rehearse: bool,
    /// Angles from which the rehearsal begins, degrees to the right and up
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, requires = "rehearse")]
    pub(crate) from: Option<Numbers<2>>,
    /// Fill the panels, whatever their size: for a run that was made for other panels; distances then no longer hold
    #[arg(long, conflicts_with_all = ["rehearse", "pattern"])]
    pub(crate) fit: bool,
    /// Show a picture (PNG, JPEG, WebP) on one layer with all its pixels, the others clear
    #[arg(long, value_name = "FILE", conflicts_with = "pattern")]
    pub(crate) full_resolution_2d: Option<PathBuf>,
    /// The layer of --full-resolution-2d, 0 the rearmost [default: the one nearest to the display's plane]
    #[arg(long, value_name = "N", requires = "full_resolution_2d")]
    pub(crate) layer: Option<usize>,
    /// Show a test pattern: crosshairs, ramp, code=V, code=R,G,B, lenslet=COLUMN,ROW, view=X,Y, clear or identify
    #[arg(long, value_name = "PATTERN")]
    pub(crate) pattern: Option<lumistack_plugin_panels::Pattern>,
    /// Show the pattern on one panel alone, a layer's number or `backlight`; the others are clear
    #[arg(long, value_name = "N|backlight", requires = "pattern")]
    pub(crate) only: Option<String>,
    /// Place of the eye, or camera, for which the crosshairs of all layers coincide [default: 0,0,2000 or the display's viewing distance]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "pattern")]
    pub(crate) eye_mm: Option<Numbers<3>>,
    /// Keep frame K instead of showing all in turn
    #[arg(long, value_name = "K")]
    pub(crate) hold: Option<usize>,
    /// Display file whose calibration is used, and to which nudges are saved [default: display.toml of the run]
    #[arg(long, value_name = "FILE")]
    pub(crate) calibration: Option<PathBuf>,
    /// End after this many seconds
    #[arg(long, value_name = "S")]
    pub(crate) duration_s: Option<f64>,
    /// Take commands on standard input, one a line: hold K, run, step N, nudge PANEL RIGHT DOWN, save, look X Y, report, quit
    #[arg(long)]
    pub(crate) control: bool,
    /// Write every submission to a file: refresh, place in the period, number of the pictures, seconds
    #[arg(long, value_name = "FILE")]
    pub(crate) log: Option<PathBuf>,
}

#[cfg(not(feature = "panels"))]
pub(crate) fn show_command(
    _: &Show,
    _: bool,
    _: lumistack_core::Task<'_>,
) -> Result<(), lumistack_pipeline::PipelineError> {
    let found = "one without (cargo build --release -p lumistack-cli --features panels)";
    Err(lumistack_pipeline::PipelineError::value("lumistack", "show", "a build with the feature `panels`", found))
}

#[cfg(feature = "panels")]
pub(crate) use with_windows::show_command;

#[cfg(feature = "panels")]
mod with_windows {
    use std::fmt::Write as _;
    use std::io::BufRead;
    use std::path::{Path, PathBuf};
    use std::sync::Arc;
    use std::sync::mpsc::Sender;
    use std::time::{Duration, SystemTime};

    use lumistack_core::{Cancel, Task};
    use lumistack_display::{Display, LayerStack};
    use lumistack_pipeline::{PipelineError, RunFolder, presets, resealed};
    use lumistack_plugin_panels::assign::Output;
    use lumistack_plugin_panels::window::{self, Command, Content, Event, Mode, Report, Settings};
    use lumistack_plugin_panels::{Shows, keep_panels};
    use serde_json::json;

    use super::Show;
    use crate::console::{say, tell};

    /// Viewing distance where the display names none: the paper's photographs were taken from here.
    const DISTANCE_MM: f64 = 2000.0;
    /// How often a run's folder is looked at.
    const LOOK: Duration = Duration::from_millis(200);

    pub(crate) fn show_command(args: &Show, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
        if args.list {
            return list(json);
        }
        let dir = args.dir.as_deref().unwrap_or(Path::new("."));
        let Subject { display, stack, file } = subject(args, dir)?;
        let mode = match (args.rehearse, args.span) {
            (true, _) => Mode::Window,
            (_, true) => Mode::Span,
            _ => Mode::Outputs,
        };
        let frames = stack.as_ref().map_or(1, LayerStack::frames);
        if let Some(hold) = args.hold
            && hold >= frames
        {
            return Err(PipelineError::value("--hold", "K", format!("0 to {}", frames - 1), hold.to_string()));
        }
        let reloads = args.pattern.is_none() && args.full_resolution_2d.is_none();
        let content = content(args, &display, stack)?;
        let duration = match args.duration_s {
            Some(seconds) => Some(Duration::try_from_secs_f64(seconds).map_err(|_| {
                PipelineError::value("--duration-s", "S", "a number of seconds above 0", seconds.to_string())
            })?),
            None => None,
        };
        let (send, commands) = window::commands();
        if reloads {
            let (send, dir, display) = (send.clone(), dir.to_owned(), display.clone());
            std::thread::spawn(move || watch(&dir, &display, &send));
        }
        if args.control {
            let send = send.clone();
            std::thread::spawn(move || control(&send));
        }
        let log = args.log.is_some();
        let settings = Settings { display, content, mode, fit: args.fit, hold: args.hold, duration, log };
        let cancel: Cancel = task.cancel.clone();
        let tell = move |event: Event| told(&event, json, file.as_deref());
        let report = window::present(settings, commands, &|| cancel.is_cancelled(), Arc::new(tell));
        drop(send);
        let report = report.map_err(PipelineError::command)?;
        if let Some(path) = &args.log {
            let mut text = String::from("refresh,place,pictures,seconds\n");
            for (refresh, place, pictures, seconds) in &report.log {
                let _ = writeln!(text, "{refresh},{place},{pictures},{seconds:.6}");
            }
            lumistack_field_io::atomic::write_bytes(path, text.as_bytes()).map_err(PipelineError::Field)?;
        }
        print_report(&report, json);
        Ok(())
    }

    /// What is to be shown, and the file that keeps its calibration.
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
            return Err(PipelineError::value(dir, "folder", "a run, with layers/stack.json in it", "none"));
        };
        if let Some(path) = &args.calibration {
            let measured = presets::load_file(path)?;
            subject.display = calibrated(&subject.display, &measured, path)?;
            subject.file = Some(path.clone());
        }
        if args.fit {
            // its panels are of another size, and so are its shifts
            subject.file = None;
        }
        Ok(subject)
    }

    /// The display with the panels of another file of it.
    fn calibrated(display: &Display, measured: &Display, path: &Path) -> Result<Display, PipelineError> {
        let fits = |display: &Display| {
            let masks: Vec<_> =
                display.layers.iter().map(|layer| (layer.resolution, layer.pitch_mm.to_bits())).collect();
            (masks, LayerStack::emission_shape(&Display { frames: 1, ..display.clone() }))
        };
        if fits(display) != fits(measured) {
            let expected = "the layers and lenslets that the patterns were made for";
            return Err(PipelineError::value(path, "layers", expected, "others"));
        }
        // distances and frames are those that the patterns were made for
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
        display.check().map_err(|source| PipelineError::Display {
            path: path.to_owned(),
            text: String::new(),
            source,
        })?;
        Ok(display)
    }

    fn content(args: &Show, display: &Display, stack: Option<LayerStack>) -> Result<Content, PipelineError> {
        if let Some(pattern) = args.pattern {
            let only = args.only.as_deref().map(|text| panel_of(text, display)).transpose()?;
            let eye_mm = args.eye_mm.map_or([0.0, 0.0, display.field.distance_mm.unwrap_or(DISTANCE_MM)], |eye| eye.0);
            let nearest = display.layers.last().map_or(0.0, |layer| layer.d_mm);
            if eye_mm[2] <= nearest {
                let expected = format!("a distance in front of all layers, above {nearest}");
                return Err(PipelineError::value("--eye-mm", "Z", expected, eye_mm[2].to_string()));
            }
            return Ok(Content::Pattern { pattern, only, eye_mm });
        }
        if let Some(path) = &args.full_resolution_2d {
            let nearest = (0..display.layers.len())
                .min_by(|a, b| display.layers[*a].d_mm.abs().total_cmp(&display.layers[*b].d_mm.abs()))
                .unwrap_or(0);
            let layer = args.layer.unwrap_or(nearest);
            if layer >= display.layers.len() {
                let expected = format!("0 to {}", display.layers.len() - 1);
                return Err(PipelineError::value("--layer", "N", expected, layer.to_string()));
            }
            let picture = image::ImageReader::open(path)
                .and_then(image::ImageReader::with_guessed_format)
                .map_err(|source| PipelineError::Read { path: path.clone(), source })?
                .decode()
                .map_err(|error| PipelineError::value(path, "picture", "PNG, JPEG or WebP", error.to_string()))?;
            return Ok(Content::Flat { picture: picture.to_rgb8(), layer });
        }
        let stack = stack.expect("without a pattern or picture there is a run");
        Ok(match args.rehearse {
            true => Content::Rehearsal { stack, from_deg: args.from.map_or([0.0; 2], |from| from.0) },
            false => Content::Stack(stack),
        })
    }

    fn panel_of(text: &str, display: &Display) -> Result<Shows, PipelineError> {
        let all = Shows::all(display);
        let found = match text.parse() {
            Ok(layer) => Some(Shows::Layer(layer)),
            Err(_) => (text == "backlight").then_some(Shows::Backlight),
        };
        found.filter(|shows| all.contains(shows)).ok_or_else(|| {
            let names = all.iter().map(Shows::to_string).collect::<Vec<_>>().join(", ");
            PipelineError::value("--only", "panel", format!("the number of one of {names}, or backlight"), text)
        })
    }

    fn list(json: bool) -> Result<(), PipelineError> {
        let outputs = window::outputs().map_err(PipelineError::command)?;
        for output in &outputs {
            say!("{}", describe(output, json));
        }
        if outputs.is_empty() && !json {
            say!("no outputs");
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

    /// New patterns of a run that is written anew.
    fn watch(dir: &Path, display: &Display, send: &Sender<Command>) {
        let (layers, index) = (dir.join("layers"), dir.join("layers/stack.json"));
        let stamp = || std::fs::metadata(&index).and_then(|data| data.modified()).ok();
        let mut shown: Option<SystemTime> = stamp();
        loop {
            std::thread::sleep(LOOK);
            let before = stamp();
            if before.is_none() || before == shown {
                continue;
            }
            // the index goes first and comes last: a stack is whole if it is the same before and after reading
            let Ok(stack) = lumistack_field_io::read_stack(&layers) else { continue };
            if stamp() != before {
                continue;
            }
            shown = before;
            if stack.check(display).is_ok() && send.send(Command::Stack(stack)).is_err() {
                return;
            }
        }
    }

    /// Commands from standard input.
    fn control(send: &Sender<Command>) {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            match command_of(&line) {
                Ok(command) => {
                    if send.send(command).is_err() {
                        return;
                    }
                }
                Err(error) => tell!("warning: {error}"),
            }
        }
    }

    fn command_of(line: &str) -> Result<Command, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number =
            |i: usize| words.get(i).and_then(|word| word.parse::<f64>().ok()).filter(|number| number.is_finite());
        let panel = |word: &str| match word {
            "backlight" => Some(Shows::Backlight),
            _ => word.parse().ok().map(Shows::Layer),
        };
        let command = match (words.first().copied().unwrap_or(""), words.len()) {
            ("hold", 2) => words[1].parse().ok().map(Command::Hold),
            ("step", 2) => words[1].parse().ok().map(Command::Step),
            ("run", 1) => Some(Command::Run),
            ("save", 1) => Some(Command::Save),
            ("report", 1) => Some(Command::Report),
            ("quit", 1) => Some(Command::Quit),
            ("look", 3) => number(1).zip(number(2)).map(|(x, y)| Command::Look([x, y])),
            ("nudge", 4) => panel(words[1])
                .zip(number(2).zip(number(3)))
                .map(|(shows, (right, down))| Command::Nudge(shows, [right, down])),
            _ => None,
        };
        let expected = "hold K, run, step N, nudge PANEL RIGHT DOWN, save, look X Y, report or quit";
        command.ok_or_else(|| format!("standard input: expected {expected}, found `{line}`"))
    }

    /// What happens while it runs.
    fn told(event: &Event, json: bool, file: Option<&Path>) {
        match event {
            Event::Started(shown) => {
                for (shows, output) in shown {
                    match json {
                        true => {
                            say!("{}", json!({"event": "shows", "panel": shows.to_string(), "output": output.name}))
                        }
                        false => say!("{shows} on {}", describe(output, false)),
                    }
                }
                if json {
                    say!("{}", json!({"event": "started"}));
                }
            }
            Event::Swapped { times, refresh } => {
                if json {
                    say!("{}", json!({"event": "swapped", "times": times, "refresh": refresh}));
                }
            }
            Event::Warning(text) => match json {
                true => say!("{}", json!({"event": "warning", "place": "show", "message": text})),
                false => tell!("warning: {text}"),
            },
            Event::Selected(shows, [right, down]) => match json {
                true => say!("{}", json!({"event": "nudged", "panel": shows.to_string(), "nudge_px": [right, down]})),
                false => say!("{shows}: {right} px right, {down} px down"),
            },
            Event::Save(display) => {
                let kept = save(display, file);
                match (kept, json) {
                    (Ok(path), true) => say!("{}", json!({"event": "saved", "file": path.to_string_lossy()})),
                    (Ok(path), false) => say!("saved: {}", path.display()),
                    (Err(error), true) => {
                        say!("{}", json!({"event": "warning", "place": "save", "message": error.to_string()}))
                    }
                    (Err(error), false) => tell!("warning: {error}"),
                }
            }
            Event::Report(report) => print_report(report, json),
        }
    }

    fn save(display: &Display, file: Option<&Path>) -> Result<PathBuf, PipelineError> {
        let path = file.ok_or_else(|| {
            PipelineError::value(
                "save",
                "file",
                "a display file to save to (--calibration FILE)",
                "a preset of the program, or --fit",
            )
        })?;
        let text =
            lumistack_files::read_text(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })?;
        let text = resealed(&text, &keep_panels(&text, display).map_err(PipelineError::command)?);
        lumistack_field_io::atomic::write_bytes(path, text.as_bytes()).map_err(PipelineError::Field)?;
        Ok(path.to_owned())
    }

    fn print_report(report: &Report, json: bool) {
        let rate = if report.seconds > 0.0 { (report.refreshes.max(1) - 1) as f64 / report.seconds } else { 0.0 };
        let tally = |tally: &lumistack_plugin_panels::Tally| json!({"shown": tally.shown, "late": tally.late, "repeated": tally.repeated, "dropped": tally.dropped, "out_of_order": tally.out_of_order});
        let known = report.skew.as_ref().and_then(|skew| Some((skew.mean_s()?, skew.largest_s)));
        if json {
            let shown: serde_json::Map<_, _> =
                report.shown.iter().map(|(name, shown)| (name.clone(), tally(shown))).collect();
            say!(
                "{}",
                json!({
                    "event": "report", "refreshes": report.refreshes, "seconds": report.seconds, "rate_hz": rate,
                    "interval_s": report.interval_s, "interval_from": report.interval_from, "swaps": report.swaps, "missed": report.missed,
                    "submitted": report.submitted.as_ref().map(tally), "presented": shown,
                    "skew_mean_s": known.map(|known| known.0), "skew_largest_s": known.map(|known| known.1),
                })
            );
            return;
        }
        if report.refreshes == 0 {
            return say!("nothing was shown");
        }
        say!(
            "{} refreshes in {:.1} s, {rate:.1} Hz; expected {:.1} Hz ({})",
            report.refreshes,
            report.seconds,
            1.0 / report.interval_s.max(1e-9),
            report.interval_from
        );
        let counts = |tally: &lumistack_plugin_panels::Tally| {
            format!(
                "{} late, {} repeated, {} dropped, {} out of order",
                tally.late, tally.repeated, tally.dropped, tally.out_of_order
            )
        };
        match (report.shown.is_empty(), &report.submitted) {
            (true, Some(submitted)) => say!(
                "by the times of submission: {}; the platform does not tell when pictures were shown",
                counts(submitted)
            ),
            _ => report.shown.iter().for_each(|(name, tally)| say!("{name}: {}", counts(tally))),
        }
        match known {
            Some((mean, largest)) => {
                say!("skew between outputs: {:.2} ms, at most {:.2} ms", 1000.0 * mean, 1000.0 * largest)
            }
            None if report.shown.len() == 1 => say!("skew between outputs: none, they are one surface"),
            None => say!("skew between outputs: unknown, the platform does not tell"),
        }
    }
}
