//! The run's report: what the display shows beside what it should show, as one HTML file and as numbers.
//!
//! [`build`] simulates every target view once with the display's forward model and returns two texts; it writes no files, reads no clock and
//! makes no network request. `report.html` is one file: pictures are data URIs, style and script are inline.
//!
//! ```text
//! Display + LayerStack + LightField ──▶ measure (PSNR, pictures) ──▶ json  ──▶ report.json
//!                                                                └──▶ page  ──▶ report.html
//! ```
//!
//! PSNR is the display crate's: peak 1, linear light, over all rays with w > 0 that meet the display, and all channels. `psnr_view` compares
//! L̃/β with L, `psnr_raw` compares L̃ with βL and is higher by −20·log10 β.
//!
//! # report.json
//!
//! | key | value |
//! |---|---|
//! | `schema`, `version` | `"lumistack/report"`, 1 |
//! | `title`, `lumistack_version`, `command` | texts; `command` may be null |
//! | `psnr_view`, `psnr_raw` | dB, all target views |
//! | `brightness` | β |
//! | `views` | of the target: `slope_x[view_x]`, `slope_y[view_y]` (tangents, y up), `projection`, `distance_mm`, `rows`, `cols`, `pitch_mm`, and `[view_y][view_x]` arrays `psnr_view` (dB) and `counted_share` (share of rays that count, 0..1) |
//! | `held_out` | null, or the same keys as `views` for views that were not optimized, with `overall_psnr_view` and `overall_psnr_raw` |
//! | `convergence` | list of `iteration`, `objective` (Σ w (βL − L̃)²), `psnr_view` (dB), `seconds` since the solver's start |
//! | `stages`, `seconds_total` | list of `name`, `seconds`, `cached` |
//! | `display`, `settings`, `scene` | the display file, the resolved job, facts about the scene or null |
//! | `warnings`, `outputs` | lists of `place`, `message` and of `label`, `path` (relative to the report) |
//!
//! JSON has no infinity: a PSNR of equal pictures is the text `"Infinity"`, which `float()` of Python, `Number()` of JavaScript and
//! `str::parse::<f64>` of Rust all read; a figure without any counted ray is `null`.

mod format;
mod json;
mod measure;
mod page;
mod patterns;
mod picture;
mod plot;

use lumistack_core::{Cancelled, Task, Warning};
use lumistack_display::{Display, LayerStack, LightField, StackError, WeightError, Weights};
use thiserror::Error;

/// One iteration of the solver, as the pipeline recorded it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Full updates done so far.
    pub iteration: u32,
    /// Σ w (βL − L̃)² (eq. 27).
    pub objective: f64,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// Seconds since the solver started.
    pub seconds: f64,
}

/// One stage of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name for people: "render", "factorize".
    pub name: String,
    /// Wall time in this run, seconds.
    pub seconds: f64,
    /// Whether its result came from an earlier run.
    pub cached: bool,
}

/// A file or folder that the run wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// What it is, for people.
    pub label: String,
    /// Path relative to the report, with `/` between parts.
    pub path: String,
}

/// Everything that a report shows.
#[derive(Clone, Copy, Debug)]
pub struct ReportInput<'a> {
    /// Headline, usually the scene's or the job's name.
    pub title: &'a str,
    /// The display.
    pub display: &'a Display,
    /// Its patterns.
    pub stack: &'a LayerStack,
    /// What the display should show.
    pub target: &'a LightField,
    /// Weights of the target's rays.
    pub weights: &'a Weights,
    /// Views that the solver did not see, usually at [`lumistack_display::ViewGrid::in_between`]. Without them in-between views are shown as
    /// simulated only.
    pub held_out: Option<&'a LightField>,
    /// The solver's history; may be empty.
    pub convergence: &'a [Iteration],
    /// Timings; may be empty.
    pub stages: &'a [Stage],
    /// The resolved job, every default written out.
    pub settings: &'a serde_json::Value,
    /// Facts about the scene (name, triangles, ...), where there is one.
    pub scene: Option<&'a serde_json::Value>,
    /// Warnings of all stages.
    pub warnings: &'a [Warning],
    /// What else the run wrote.
    pub outputs: &'a [Output],
    /// The command line that made the run.
    pub command: Option<&'a str>,
    /// Lumistack's version.
    pub version: &'a str,
}

/// The two files of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Text of `report.html`.
    pub html: String,
    /// Content of `report.json`.
    pub json: serde_json::Value,
    /// PSNR of all target rays, L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of all target rays, L̃ against βL, dB.
    pub psnr_raw: f64,
    /// `psnr_view` of the held-out views, dB.
    pub held_out_psnr_view: Option<f64>,
}

/// A report that cannot be made.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The patterns are not the display's.
    #[error("layer stack: {0}")]
    Stack(#[from] StackError),
    /// The weights are not the target's.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The work was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A picture could not be encoded.
    #[error("encoding a picture: {0}")]
    Picture(#[from] image::ImageError),
    /// A plot could not be drawn.
    #[error("drawing the convergence plot: {0}")]
    Plot(String),
    /// The display could not be written as JSON.
    #[error("writing report.json: {0}")]
    Json(#[from] serde_json::Error),
}

/// Simulates the display and makes its report.
///
/// # Errors
/// If stack or weights do not fit display and target, or the task is cancelled.
pub fn build(input: &ReportInput, task: Task) -> Result<Report, ReportError> {
    input.stack.check(input.display)?;
    input.weights.check(input.target.geometry())?;
    let views = |field: &LightField| field.geometry().grid.iter().count() as u64;
    let steps = views(input.target) + input.held_out.map_or(0, views) + patterns::count(input.stack) as u64;
    task.progress.begin("report", steps, "pictures");
    let report = build_parts(input, task);
    task.progress.end();
    report
}

fn build_parts(input: &ReportInput, task: Task) -> Result<Report, ReportError> {
    let measured = measure::measure(input, task)?;
    let patterns = patterns::encode(input, task)?;
    let json = json::report(input, &measured)?;
    let html = page::render(input, &measured, &patterns)?;
    let held_out_psnr_view = measured.held_out.as_ref().map(measure::FieldScore::psnr_view);
    let target = &measured.target;
    Ok(Report { html, json, psnr_view: target.psnr_view(), psnr_raw: target.psnr_raw(), held_out_psnr_view })
}

#[cfg(test)]
mod tests;
