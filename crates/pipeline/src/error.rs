//! Errors of the pipeline, from the job file to the outputs. A message about a wrong value states
//! the place, the expected value and the found value. The place is a file with the position in it,
//! a key, or an option.

use std::path::{Path, PathBuf};

use lumistack_core::Cancelled;
use lumistack_core::config::ConfigError;
use lumistack_display::{DisplayError, GridError, StackError, WeightError};
use lumistack_factorizer::FactorizeError;
use lumistack_field_io::FieldError;
use lumistack_gltf::GltfError;
use lumistack_pathtracer::RenderError;
use lumistack_plot::PlotError;
use lumistack_plugin_host::HostError;
use lumistack_report::ReportError;
use lumistack_scene::{SceneError, WindowError};
use lumistack_shot::ShotError;
pub use lumistack_shot::{BadValue, Place};
use lumistack_usd::UsdError;
use serde::Serialize;
use thiserror::Error;

/// The reason for which a job did not finish.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// The user stopped the run; finished results are kept.
    #[error("stopped; run the same command again to continue from the finished results")]
    Cancelled,
    /// A file cannot be read.
    #[error("{}: expected a readable file, found: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// A file or folder cannot be written.
    #[error("{}: cannot write: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// A file has the path of the output folder.
    #[error("{}: expected a folder to write to, found a file", path.display())]
    NotAFolder {
        /// The path.
        path: PathBuf,
    },
    /// Another process works in the output folder.
    #[error(
        "{}: {owner} uses this folder; wait until that process ends, end the process, or choose another folder with -o",
        folder.display()
    )]
    InUse {
        /// The folder.
        folder: PathBuf,
        /// The process that uses the folder, with its host if it is known.
        owner: String,
    },
    /// The folder has no plan of units of work.
    #[error(
        "{}: expected a run folder with a farm's plan, found none; check that this path leads to the shared run folder on this machine",
        folder.display()
    )]
    NoFarmPlan {
        /// The folder.
        folder: PathBuf,
    },
    /// The worker has another build, so its results may differ from the other workers' results.
    #[error(
        "{}: expected the program that planned the run ({plan}), found another program ({worker}); install the same build on all workers, or plan the run again",
        folder.display()
    )]
    OtherCode {
        /// The run folder.
        folder: PathBuf,
        /// Version and fingerprint of the program that planned the run.
        plan: String,
        /// Version and fingerprint of the worker.
        worker: String,
    },
    /// The output would replace a file that Lumistack did not write, or that was changed since
    /// Lumistack wrote it.
    #[error(
        "{}: expected no file, or a file that Lumistack wrote, found {}, which {work} would replace; move the file away, or choose another folder with -o",
        path.display(), if *changed { "a file that was changed since Lumistack wrote it" } else { "a file or folder that Lumistack did not write" }
    )]
    Foreign {
        /// The file or folder.
        path: PathBuf,
        /// The work that would replace the file.
        work: &'static str,
        /// True if Lumistack wrote the file and it was changed since.
        changed: bool,
    },
    /// An input is among the files that the output would replace.
    #[error(
        "{}: expected the {role} outside of the output folder, found the {role} at a path that the command writes in {}; choose another folder with -o",
        input.display(), folder.display()
    )]
    Overwrites {
        /// The input file or folder.
        input: PathBuf,
        /// Role of the input, such as `scene`.
        role: &'static str,
        /// The output folder.
        folder: PathBuf,
    },
    /// Some outputs failed; the rest of the run is finished.
    #[error("{}", failed_outputs(failed))]
    Outputs {
        /// The failed outputs and their reasons.
        failed: Vec<FailedOutput>,
    },
    /// A job file does not parse.
    #[error("{}: {source}{}", path.display(), excerpt(text, source))]
    Config {
        /// The file.
        path: PathBuf,
        /// Text of the file.
        text: String,
        /// Position and message.
        source: ConfigError,
    },
    /// A display file does not parse, or has a wrong value.
    #[error("{}: {source}{}", path.display(), display_excerpt(text, source))]
    Display {
        /// The file or preset.
        path: PathBuf,
        /// Text of the file; empty if the values do not come from a file.
        text: String,
        /// The cause.
        source: DisplayError,
    },
    /// There is no preset of this name.
    #[error("display `{name}`: expected a preset or a .toml file; `lumistack displays` lists the presets{}", nearest.as_ref().map_or(String::new(), |n| format!("; did you mean `{n}`?")))]
    UnknownDisplay {
        /// The requested name.
        name: String,
        /// The preset with the most similar name, if there is one.
        nearest: Option<String>,
    },
    /// A value is wrong.
    #[error(transparent)]
    Value(Box<BadValue>),
    /// Another program replaced a result that a stage has just written.
    #[error("{}: {role}: expected the picture that was just written, found another picture or none; another program changes the folder", path.display())]
    Replaced {
        /// The file.
        path: PathBuf,
        /// Text for the message that names the role of the file.
        role: &'static str,
    },
    /// glTF ingest failed.
    #[error(transparent)]
    Gltf(#[from] GltfError),
    /// USD ingest failed.
    #[error(transparent)]
    Usd(UsdError),
    /// The scene cannot be rendered.
    #[error("{name}: {source}")]
    Scene {
        /// The scene's file.
        name: String,
        /// The cause.
        source: SceneError,
    },
    /// The window cannot be placed.
    #[error("{name}: {source}")]
    Window {
        /// The scene's file.
        name: String,
        /// The cause.
        source: WindowError,
    },
    /// A view grid is wrong.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A light field or stack cannot be read or written.
    #[error(transparent)]
    Field(FieldError),
    /// A stack does not fit its display.
    #[error("{}: {source}", path.display())]
    Stack {
        /// The folder.
        path: PathBuf,
        /// The cause.
        source: StackError,
    },
    /// Weights do not fit the light field.
    #[error("{}: {source}", path.display())]
    Weights {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: WeightError,
    },
    /// Rendering failed.
    #[error(transparent)]
    Render(RenderError),
    /// Factorization failed.
    #[error(transparent)]
    Factorize(FactorizeError),
    /// A plugin is missing, refuses its parameters, or failed.
    #[error(transparent)]
    Output(HostError),
    /// The report could not be made.
    #[error(transparent)]
    Report(ReportError),
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(PlotError),
    /// Work that a command does outside of the pipeline failed.
    #[error(transparent)]
    Command(Box<dyn std::error::Error + Send + Sync>),
}

/// An output that could not be written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FailedOutput {
    /// Folder of the output, relative to the run folder.
    pub path: String,
    /// The cause of the failure.
    pub reason: String,
}

fn failed_outputs(failed: &[FailedOutput]) -> String {
    let list = failed.iter().map(|output| format!("{}: {}", output.path, output.reason)).collect::<Vec<_>>().join("; ");
    match failed.len() {
        1 => format!("one output failed; everything else is finished. The failed output: {list}"),
        count => format!("{count} outputs failed; everything else is finished. The failed outputs: {list}"),
    }
}

impl From<Cancelled> for PipelineError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl PipelineError {
    /// Returns an error for a wrong value. `place` is a file or another origin of the value.
    pub fn value(
        place: impl Into<Place>,
        key: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        let (place, key, expected, found) = (place.into(), key.into(), expected.into(), found.into());
        Self::Value(Box::new(BadValue { place, key, expected, found }))
    }

    /// Returns an error for a wrong value of the job.
    pub fn job(key: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::value(Place::Job, key, expected, found)
    }

    /// Returns an error for a wrong value of a command-line option or an environment variable.
    pub fn option(
        name: &'static str,
        key: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::value(Place::Option(name), key, expected, found)
    }

    /// Returns a function, for `ok_or_else`, that makes the error for a result that was replaced
    /// just after it was written.
    pub(crate) fn replaced<'a>(path: &'a Path, role: &'static str) -> impl FnOnce() -> Self + 'a {
        move || Self::Replaced { path: path.to_owned(), role }
    }

    /// Wraps an error of work that a command does outside of the pipeline, for `map_err`.
    pub fn command(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Command(Box::new(error))
    }

    /// Returns true if the error comes from this machine, so that another machine may succeed.
    pub fn is_machine_specific(&self) -> bool {
        matches!(self, Self::NoFarmPlan { .. } | Self::OtherCode { .. })
    }

    /// Returns true if the storage failed: no space, read-only, or disconnected.
    pub fn is_storage_failure(&self) -> bool {
        use std::io::ErrorKind;
        let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(self);
        while let Some(error) = cause {
            let kind = error.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
            if matches!(
                kind,
                Some(
                    ErrorKind::StorageFull
                        | ErrorKind::QuotaExceeded
                        | ErrorKind::ReadOnlyFilesystem
                        | ErrorKind::StaleNetworkFileHandle
                )
            ) {
                return true;
            }
            cause = error.source();
        }
        false
    }

    /// Returns a function, for `map_err`, that makes the error for a failed write.
    pub fn write(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Write { path: path.to_owned(), source }
    }
}

/// Converts an error of a plugin; a cancelled call becomes [`PipelineError::Cancelled`].
pub(crate) fn host_error(error: HostError) -> PipelineError {
    match error {
        HostError::Cancelled => PipelineError::Cancelled,
        other => PipelineError::Output(other),
    }
}

impl From<UsdError> for PipelineError {
    fn from(error: UsdError) -> Self {
        match error {
            UsdError::Cancelled(_) => Self::Cancelled,
            other => Self::Usd(other),
        }
    }
}

impl From<ShotError> for PipelineError {
    fn from(error: ShotError) -> Self {
        match error {
            ShotError::Cancelled(_) => Self::Cancelled,
            ShotError::Value(bad) => Self::Value(bad),
            ShotError::Scene { name, source } => Self::Scene { name, source },
            ShotError::Window { name, source } => Self::Window { name, source },
            ShotError::Render(source) => Self::Render(source),
        }
    }
}

pub(crate) fn factorize_error(error: FactorizeError) -> PipelineError {
    match error {
        FactorizeError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Factorize(other),
    }
}

pub(crate) fn display_error(source: lumistack_display::DisplayError, place: &str) -> PipelineError {
    PipelineError::Display { path: place.into(), text: String::new(), source }
}

pub(crate) fn render_error(error: lumistack_pathtracer::RenderError) -> PipelineError {
    match error {
        lumistack_pathtracer::RenderError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Render(other),
    }
}

pub(crate) fn field_error(error: lumistack_field_io::FieldError) -> PipelineError {
    match error {
        lumistack_field_io::FieldError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Field(other),
    }
}

/// Reads a regular file.
///
/// # Errors
/// If it cannot be read.
pub fn read(path: &Path) -> Result<Vec<u8>, PipelineError> {
    lumistack_files::read(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })
}

/// Reads a regular file of UTF-8 text.
///
/// # Errors
/// If it cannot be read or is not UTF-8.
pub fn read_to_string(path: &Path) -> Result<String, PipelineError> {
    lumistack_files::read_text(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })
}

/// Returns the line of the error, with marks under the error's position.
fn excerpt(text: &str, error: &ConfigError) -> String {
    let Some(line) = text.lines().nth(error.line.saturating_sub(1)) else { return String::new() };
    let length = error.span.len().clamp(1, line.chars().count().saturating_sub(error.column - 1).max(1));
    let number = error.line.to_string();
    let margin = " ".repeat(number.len());
    format!(
        "\n {margin} |\n {number} | {line}\n {margin} | {}{}",
        " ".repeat(error.column.saturating_sub(1)),
        "^".repeat(length)
    )
}

fn display_excerpt(text: &str, error: &DisplayError) -> String {
    match error {
        DisplayError::Config(error) => excerpt(text, error),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_typo_in_a_job_is_shown_in_its_line() {
        let text = "scene = \"a.glb\"\n[display]\npresett = \"x\"\n";
        let source = lumistack_core::config::parse::<crate::Job>(text).unwrap_err();
        let error = PipelineError::Config { path: "job.toml".into(), text: text.into(), source }.to_string();
        assert!(error.starts_with("job.toml: line 3, column 1: unknown field `presett`"), "{error}");
        assert!(error.contains("did you mean `preset`?"), "{error}");
        assert!(error.ends_with("\n 3 | presett = \"x\"\n   | ^^^^^^^"), "{error}");
    }
}
