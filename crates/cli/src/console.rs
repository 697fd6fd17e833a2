//! Output of progress and warnings: on a terminal, in log files, and as JSON.

use std::io::{IsTerminal, Write};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use lumistack_core::{Progress, Warning, Warnings};
use serde_json::json;

use crate::program::hinted;

/// Prints a line to standard output. Ends the program quietly when the reader has closed the pipe
/// (`lumistack displays | head -1`).
macro_rules! say {
    ($($text:tt)*) => { $crate::console::print_line(format_args!($($text)*)) };
}
pub(crate) use say;

/// Prints a line to standard error, and continues when the reader has closed the pipe
/// (`lumistack run JOB 2>&1 | head -1`).
macro_rules! tell {
    ($($text:tt)*) => { $crate::console::tell_line(format_args!($($text)*)) };
}
pub(crate) use tell;

pub(crate) fn tell_line(text: std::fmt::Arguments<'_>) {
    // Write each line by a single call. Standard error has no buffer, so lines of several programs
    // could mix otherwise. An error of this write cannot be reported.
    let _ = std::io::stderr().write_all(format!("{text}\n").as_bytes());
}

pub(crate) fn print_line(text: std::fmt::Arguments<'_>) {
    let Err(error) = writeln!(std::io::stdout(), "{text}") else { return };
    if error.kind() == std::io::ErrorKind::BrokenPipe {
        std::process::exit(0);
    }
    tell_line(format_args!("error: standard output cannot be written: {error}"));
    std::process::exit(1);
}

/// Interval between two reports of a stage, without a progress bar.
const PLAIN_INTERVAL: Duration = Duration::from_millis(2500);
/// Interval at which a thread checks whether a report is due.
const TICK: Duration = Duration::from_millis(250);
/// Time after which a stage of a single step is announced, and after which the remaining time of a
/// stage is estimated.
const LAZY: Duration = Duration::from_secs(1);

/// Output of progress and warnings. Each variant has the running stage, and the warnings so far,
/// since each warning is printed only once.
pub(crate) enum Console {
    /// A bar on the terminal.
    Bar(Mutex<Option<ProgressBar>>, Mutex<Vec<Warning>>),
    /// Plain lines on standard error.
    Plain(Arc<Mutex<Option<Stage>>>, Mutex<Vec<Warning>>),
    /// JSON lines on standard output.
    Json(Arc<Mutex<Option<Stage>>>, Mutex<Vec<Warning>>),
}

/// A running stage.
pub(crate) struct Stage {
    name: String,
    unit: String,
    done: u64,
    total: u64,
    note: String,
    start: Instant,
    shown: Instant,
    /// True if a line on standard error has announced the stage.
    announced: bool,
}

impl Console {
    pub(crate) fn new(json: bool) -> Self {
        if !json && std::io::stderr().is_terminal() {
            return Self::Bar(Mutex::default(), Mutex::default());
        }
        let state = Arc::<Mutex<Option<Stage>>>::default();
        let watched = Arc::downgrade(&state);
        // A stage reports nothing during a long step, so this thread reports for the stage.
        std::thread::spawn(move || {
            while let Some(state) = watched.upgrade() {
                if let Some(stage) = lock(&state).as_mut() {
                    stage.tick(json);
                }
                drop(state);
                std::thread::sleep(TICK);
            }
        });
        if json { Self::Json(state, Mutex::default()) } else { Self::Plain(state, Mutex::default()) }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

impl Stage {
    fn new(name: &str, total: u64, unit: &str) -> Self {
        let now = Instant::now();
        let (name, unit, note) = (name.into(), unit.into(), String::new());
        Self { name, unit, done: 0, total, note, start: now, shown: now, announced: false }
    }

    /// Announces the stage if this is due, and reports the progress if the last report is at least
    /// [`PLAIN_INTERVAL`] ago.
    fn tick(&mut self, json: bool) {
        if !json && !self.announced && self.start.elapsed() >= LAZY {
            self.announce();
        }
        if self.shown.elapsed() < PLAIN_INTERVAL {
            return;
        }
        self.shown = Instant::now();
        let Self { name, unit, done, total, note, start, .. } = self;
        let seconds = start.elapsed().as_secs_f64();
        if json {
            let event = json!({
                "event": "progress", "stage": name, "done": done, "total": total, "note": note, "seconds": seconds,
            });
            say!("{event}");
        } else if *total <= 1 {
            tell!("{name}: {seconds:.0} s");
        } else {
            let left =
                remaining(*done, *total, start.elapsed()).map_or_else(String::new, |left| format!(", {left} left"));
            let note = if note.is_empty() { String::new() } else { format!(", {note}") };
            tell!("{name}: {done} of {total} {unit}{note}{left}");
        }
    }

    fn announce(&mut self) {
        self.announced = true;
        self.shown = Instant::now();
        match self.total {
            0 | 1 => tell!("{} ...", self.name),
            total => tell!("{}: {total} {}", self.name, self.unit),
        }
    }
}

/// Returns the time that a stage still takes if its remaining steps are as fast as its finished
/// steps. Returns `None` if no step is finished, if all are finished, or if the stage has just
/// begun.
fn remaining(done: u64, total: u64, spent: Duration) -> Option<String> {
    if done == 0 || done >= total || spent < LAZY {
        return None;
    }
    let left = spent.as_secs_f64() * (total - done) as f64 / done as f64;
    let seconds = left.ceil() as u64;
    Some(match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {:02} s", seconds / 60, seconds % 60),
        _ => format!("{} h {:02} min", seconds / 3600, seconds / 60 % 60),
    })
}

impl Progress for Console {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        match self {
            Self::Bar(bar, _) => {
                // The unit may be a plugin's text, so its braces must be escaped in the template.
                let unit = unit.replace('{', "{{").replace('}', "}}");
                let template = ["{prefix:>12} {wide_bar:.cyan/dim} {pos}/{len} ", &unit, " {msg} {eta:>4}"].concat();
                let style = ProgressStyle::with_template(&template).expect("the template is valid");
                let new = ProgressBar::new(total).with_style(style).with_prefix(stage.to_string());
                new.enable_steady_tick(Duration::from_millis(250));
                *lock(bar) = Some(new);
            }
            Self::Plain(state, _) => {
                let mut stage = Stage::new(stage, total, unit);
                if total > 1 {
                    stage.announce();
                }
                *lock(state) = Some(stage);
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
                if let Some(stage) = lock(state).as_mut() {
                    stage.done += steps;
                    if !note.is_empty() {
                        stage.note = note.into();
                    }
                    stage.tick(matches!(self, Self::Json(..)));
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
                    tell!("{name:>12} {message}  {seconds:.1} s");
                }
            }
            Self::Plain(state, _) => {
                if let Some(stage) = lock(state).take().filter(|stage| stage.announced) {
                    tell!("{}: done in {:.1} s", stage.name, stage.start.elapsed().as_secs_f64());
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
        let warning = Warning { message: hinted(&warning.message), ..warning };
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
                Some(bar) => bar.suspend(|| tell!("warning: {warning}")),
                None => tell!("warning: {warning}"),
            },
            Self::Plain(..) => tell!("warning: {warning}"),
            Self::Json(..) => {
                say!("{}", json!({"event": "warning", "place": warning.place, "message": warning.message}));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remaining_time_follows_from_the_finished_steps() {
        let of = |done, total, seconds| remaining(done, total, Duration::from_secs(seconds));
        assert_eq!(of(1, 4, 10).as_deref(), Some("30 s"));
        assert_eq!(of(1, 11, 8).as_deref(), Some("1 min 20 s"));
        assert_eq!(of(1, 3601, 2).as_deref(), Some("2 h 00 min"));
        // nothing is finished, everything is finished, or the stage has just begun
        assert_eq!([of(0, 4, 10), of(4, 4, 10), of(1, 4, 0)], [None, None, None]);
    }
}
