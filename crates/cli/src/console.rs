//! Progress and warnings for people on a terminal, for log files, and for machines.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use lumistack_core::{Progress, Warning, Warnings};
use serde_json::json;

/// `println!` that ends the program quietly when nobody reads any more (`lumistack displays | head -1`).
macro_rules! say {
    ($($text:tt)*) => { $crate::console::print_line(format_args!($($text)*)) };
}
pub(crate) use say;

pub(crate) fn print_line(text: std::fmt::Arguments<'_>) {
    if writeln!(std::io::stdout(), "{text}").is_err() {
        std::process::exit(0);
    }
}

/// How often a stage reports where there is no terminal.
const PLAIN_INTERVAL: Duration = Duration::from_secs(10);

/// Where progress and warnings go.
pub(crate) enum Console {
    /// A bar on the terminal.
    Bar(Mutex<Option<ProgressBar>>, Mutex<Vec<Warning>>),
    /// Plain lines on standard error.
    Plain(Mutex<Option<Stage>>, Mutex<Vec<Warning>>),
    /// JSON lines on standard output.
    Json(Mutex<Option<Stage>>, Mutex<Vec<Warning>>),
}

/// A running stage.
pub(crate) struct Stage {
    name: String,
    unit: String,
    done: u64,
    total: u64,
    start: Instant,
    shown: Instant,
}

impl Console {
    pub(crate) fn new(json: bool) -> Self {
        if json {
            Self::Json(Mutex::default(), Mutex::default())
        } else if std::io::stderr().is_terminal() {
            Self::Bar(Mutex::default(), Mutex::default())
        } else {
            Self::Plain(Mutex::default(), Mutex::default())
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

impl Stage {
    fn new(name: &str, total: u64, unit: &str) -> Self {
        let now = Instant::now();
        Self { name: name.into(), unit: unit.into(), done: 0, total, start: now, shown: now }
    }
}

impl Progress for Console {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        match self {
            Self::Bar(bar, _) => {
                let style =
                    ProgressStyle::with_template("{prefix:>12} {wide_bar:.cyan/dim} {pos}/{len} {msg} {eta:>4}")
                        .expect("the template is valid");
                let new = ProgressBar::new(total).with_style(style).with_prefix(stage.to_string());
                new.enable_steady_tick(Duration::from_millis(250));
                new.set_message(unit.to_string());
                *lock(bar) = Some(new);
            }
            Self::Plain(state, _) => {
                eprintln!("{stage}: {total} {unit}");
                *lock(state) = Some(Stage::new(stage, total, unit));
            }
            Self::Json(state, _) => {
                say!("{}", json!({"event": "begin", "stage": stage, "total": total, "unit": unit}));
                *lock(state) = Some(Stage::new(stage, total, unit));
            }
        }
    }

    fn advance(&self, steps: u64, note: &str) {
        match self {
            Self::Bar(bar, _) => {
                if let Some(bar) = lock(bar).as_ref() {
                    bar.inc(steps);
                    if !note.is_empty() {
                        bar.set_message(note.to_string());
                    }
                }
            }
            Self::Plain(state, _) | Self::Json(state, _) => {
                let mut state = lock(state);
                let Some(stage) = state.as_mut() else { return };
                stage.done += steps;
                if stage.shown.elapsed() < PLAIN_INTERVAL {
                    return;
                }
                stage.shown = Instant::now();
                if matches!(self, Self::Plain(..)) {
                    eprintln!("{}: {} of {} {} {note}", stage.name, stage.done, stage.total, stage.unit);
                } else {
                    let event = json!({"event": "progress", "stage": stage.name, "done": stage.done, "total": stage.total, "note": note});
                    say!("{event}");
                }
            }
        }
    }

    fn end(&self) {
        match self {
            Self::Bar(bar, _) => {
                if let Some(bar) = lock(bar).take() {
                    let seconds = bar.elapsed().as_secs_f64();
                    let (name, message) = (bar.prefix(), bar.message());
                    bar.finish_and_clear();
                    eprintln!("{name:>12} {message}  {seconds:.1} s");
                }
            }
            Self::Plain(state, _) => {
                if let Some(stage) = lock(state).take() {
                    eprintln!("{}: done in {:.1} s", stage.name, stage.start.elapsed().as_secs_f64());
                }
            }
            Self::Json(state, _) => {
                if let Some(stage) = lock(state).take() {
                    let seconds = stage.start.elapsed().as_secs_f64();
                    say!("{}", json!({"event": "end", "stage": stage.name, "seconds": seconds}));
                }
            }
        }
    }
}

impl Warnings for Console {
    fn warn(&self, warning: Warning) {
        let (Self::Bar(_, seen) | Self::Plain(_, seen) | Self::Json(_, seen)) = self;
        {
            let mut seen = lock(seen);
            if seen.contains(&warning) {
                return;
            }
            seen.push(warning.clone());
        }
        match self {
            Self::Bar(bar, _) => match lock(bar).as_ref() {
                Some(bar) => bar.suspend(|| eprintln!("warning: {warning}")),
                None => eprintln!("warning: {warning}"),
            },
            Self::Plain(..) => eprintln!("warning: {warning}"),
            Self::Json(..) => {
                say!("{}", json!({"event": "warning", "place": warning.place, "message": warning.message}));
            }
        }
    }
}
