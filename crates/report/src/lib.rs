//! The run's report: what the display shows beside what it should show, as one HTML file and as numbers.
//!
//! [`build`] simulates every target view once with the display's forward model and returns two texts; it writes no files, reads no clock and
//! makes no network request. `report.html` is one file: pictures are data URIs, style and script are inline.
//!
//! ```text
//! Display + LayerStack + LightField ──▶ measure  PSNR, SSIM, FLIP, pictures ──▶ json ──▶ report.json
//!                                       light    absolute brightness       └──▶ page ──▶ report.html
//!                                       limits   what limits the result
//!                                       patterns pictures of the masks
//! ```
//!
//! A sequence of times has a report of its own, [`sequence()`], and so has a job that feeds several displays, [`graph()`].
//!
//! The headline is `psnr_zone`: what eyes see that are at no view in particular, pictures averaged over the area of every pixel.
//!
//! PSNR is the display crate's: peak 1, linear light, over all rays with w > 0 that meet the display, and all channels. `psnr_view` compares
//! L̃/β with L, `psnr_raw` compares L̃ with βL and is higher by −20·log10 β. SSIM and FLIP compare L̃/β with L, clamped to 0..1, as
//! [`lumistack_core::metrics`] defines them: rays that do not count are set to the target in both pictures, and the means run over the pixels that
//! count.
//!
//! # report.json
//!
//! | key | value |
//! |---|---|
//! | `schema`, `version` | `"lumistack/report"`, 1 |
//! | `title`, `lumistack_version`, `command` | texts; `command` may be null |
//! | `psnr_zone`, `psnr_zone_worst_tenth` | the headline: dB of seen pictures over directions all over the zone, which no solver saw, and over the worst tenth of them; null where the scene's pictures from there are not known |
//! | `zone` | null, or `directions` (list of `slope`, `psnr` in dB and `pixels`), and `ssim` and `flip`, means over those whose references have enough samples, the first eight |
//! | `psnr_view`, `psnr_raw` | dB, all target views by their pixels' centre rays: how well the solver did |
//! | `ssim`, `flip` | means over all target views |
//! | `pixels_per_degree` | of visual angle, for FLIP |
//! | `brightness` | β |
//! | `light` | luminances relative to the backlight's: `emitted` (mean of L̃), `wanted` (mean of L), `open` (of a display whose every pixel is at its brightest, from straight ahead), and `text` |
//! | `views` | of the target: `slope_x[view_x]`, `slope_y[view_y]` (tangents, y up), `projection`, `distance_mm`, `rows`, `cols`, `pitch_mm`, and `[view_y][view_x]` arrays `psnr_view` (dB), `ssim`, `flip` and `counted_share` (share of rays that count, 0..1) |
//! | `held_out`, `outside` | null, or the same keys as `views` for views that were not optimized, in between and beyond the zone, with `overall_psnr_view`, `overall_psnr_raw`, `overall_ssim` and `overall_flip` |
//! | `limits` | list, the largest first, of `name`, `decibels` (how much better psnr_view would be without it; null where one run cannot tell), `text` and the `figures` behind it |
//! | `depth` | null, or of the rays of all views that meet a surface: `depth_of_field_mm` ([low, high] or null), shares `inside` it, `inside_middle` (of the middle view), `beyond_a_pixel`, percentiles `depth_mm` and `disparity_px` (between neighbouring views), `window_moved_back_mm`, `depth_scale`, and two histograms |
//! | `convergence` | list of `iteration`, `objective` (Σ w (βL − L̃)²), `psnr_view` (dB), `seconds` since the solver's start |
//! | `reached` | list of `seconds`, `iteration`, `psnr_view`: the last point of the convergence by then |
//! | `denoising` | null, or `name`, and over all views and in the list `views`: `mean` (of the unbiased picture), `mean_change`, `mse_before`, `mse_after`, each of these a pair of value and standard error (exposed radiance; errors at pixels that the filter never saw) |
//! | `stages`, `seconds_total` | list of `name`, `seconds`, `cached` |
//! | `display`, `settings`, `scene` | the display file, the resolved job, facts about the scene or null |
//! | `warnings`, `outputs` | lists of `place`, `message` and of `label`, `path` (relative to the report), `failed` (null, or why nothing is there) |
//!
//! JSON has no infinity: a PSNR of equal pictures is the text `"Infinity"`, which `float()` of Python, `Number()` of JavaScript and
//! `str::parse::<f64>` of Rust all read; a figure without any counted ray is `null`.

mod convergence;
mod depth;
mod format;
mod graph;
mod json;
mod light;
mod limits;
mod measure;
mod page;
mod patterns;
mod picture;
mod plot;
mod sequence;

use lumistack_core::{Cancelled, Task, Warning};
use lumistack_display::{
    DirectionScore, Display, EmittedView, LayerStack, LightField, StackError, ViewGrid, WeightError, Weights, ZoneScore,
};
use thiserror::Error;

pub use depth::DepthBudget;
pub use graph::{GraphInput, GraphNode, graph};
pub use sequence::{SequenceFigures, SequenceInput, SequenceReport, SequenceSeries, SequenceTime, Thumbnail, sequence};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

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

/// How the solver came to the patterns.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Name of the solver that was used.
    pub solver: String,
    /// How the patterns started.
    pub start: String,
    /// Levels of half the resolution at which it began.
    pub coarse_levels: u32,
    /// How far the patterns are from the first-order (KKT) conditions: root mean square change of the emission that one more exact coordinate step of
    /// a value would make.
    pub unsettled: f64,
    /// `psnr_view` (dB) of the continuous patterns, of their values rounded to the panels' levels, and of the patterns re-optimized on the
    /// levels, which are the result; where layers have few bits.
    pub levels: Option<[f64; 3]>,
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

/// What a denoiser did to one view or to all, in exposed radiance, all channels together. Pairs are a value and its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DenoisedView {
    /// Mean of the unbiased picture.
    pub mean: f64,
    /// Mean of the filtered picture minus that.
    pub mean_change: [f64; 2],
    /// Mean squared error of the unbiased picture.
    pub mse_before: [f64; 2],
    /// Mean squared error of the filtered one.
    pub mse_after: [f64; 2],
}

/// What a denoiser did to the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Denoising<'a> {
    /// Its name, for people.
    pub name: &'a str,
    /// Over all views.
    pub overall: DenoisedView,
    /// Per view, in the order of the target's grid.
    pub views: Vec<DenoisedView>,
    /// The middle view as rendered, `[row][col][rgb]`, of the target's size, as displayed.
    pub unbiased: &'a [f32],
    /// The middle view filtered, likewise.
    pub filtered: &'a [f32],
}

/// How right the display is all over its zone.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneFigures {
    /// Errors of the seen pictures, direction by direction.
    pub score: ZoneScore,
    /// Directions whose references have enough samples for SSIM and FLIP, and to be looked at.
    pub views: Vec<ZoneView>,
}

/// A direction to look at.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneView {
    /// From where: a grid of one view.
    pub direction: ViewGrid,
    /// Its error.
    pub score: DirectionScore,
    /// The scene's picture from there, `[row][col][rgb]` of the target's size.
    pub target: Vec<f32>,
    /// The seen picture that the display shows there.
    pub seen: EmittedView,
}

/// A file or folder that the run wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// What it is, for people.
    pub label: String,
    /// Path relative to the report, with `/` between parts.
    pub path: String,
    /// Why nothing was written; `None` where it was.
    pub failed: Option<String>,
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
    /// Views beyond the target's, usually at [`lumistack_display::ViewGrid::outside`]. Without them such views are shown as simulated only.
    pub outside: Option<&'a LightField>,
    /// How right the display is all over its zone. `None` where the scene's pictures from there are not known.
    pub zone: Option<&'a ZoneFigures>,
    /// Pixels of a view per degree of visual angle, for FLIP; usually [`Flip::DEFAULT_PIXELS_PER_DEGREE`](lumistack_core::metrics::Flip).
    pub pixels_per_degree: f64,
    /// The solver's history; may be empty.
    pub convergence: &'a [Iteration],
    /// What the solver says of itself, where a solver ran.
    pub solution: Option<&'a Solution>,
    /// Timings; may be empty.
    pub stages: &'a [Stage],
    /// The resolved job, every default written out.
    pub settings: &'a serde_json::Value,
    /// What a denoiser did to the target, where one was used.
    pub denoising: Option<&'a Denoising<'a>>,
    /// Facts about the scene (name, triangles, ...), where there is one.
    pub scene: Option<&'a serde_json::Value>,
    /// What the scene's depth asks of the display, where a scene was rendered.
    pub depth: Option<&'a DepthBudget>,
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
    /// Headline: PSNR of seen pictures all over the zone, dB.
    pub psnr_zone: Option<f64>,
    /// The same of the worst tenth of the directions, dB.
    pub psnr_zone_worst: Option<f64>,
    /// PSNR of all target rays, L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of all target rays, L̃ against βL, dB.
    pub psnr_raw: f64,
    /// `psnr_view` of the held-out views, dB.
    pub held_out_psnr_view: Option<f64>,
    /// `psnr_view` of the views beyond the zone, dB.
    pub outside_psnr_view: Option<f64>,
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
    let views = |field: &LightField| field.geometry().grid.iter().count();
    let others = [input.held_out, input.outside].into_iter().flatten().map(views);
    let steps = views(input.target) + others.sum::<usize>() + limits::count(input) + patterns::count(input.stack);
    task.progress.begin("report", steps as u64, "pictures");
    let report = build_parts(input, task);
    task.progress.end();
    report
}

fn build_parts(input: &ReportInput, task: Task) -> Result<Report, ReportError> {
    let measured = measure::measure(input, task)?;
    let target = &measured.target;
    let found = Found { light: light::light(input, target), limits: limits::find(input, target, task)? };
    let patterns = patterns::encode(input, task)?;
    let json = json::report(input, &measured, &found)?;
    let html = page::render(input, &measured, &found, &patterns)?;
    Ok(Report {
        html,
        json,
        psnr_zone: input.zone.and_then(|zone| zone.score.psnr()),
        psnr_zone_worst: input.zone.and_then(|zone| zone.score.worst_tenth()),
        psnr_view: target.psnr_view(),
        psnr_raw: target.psnr_raw(),
        held_out_psnr_view: measured.held_out.as_ref().map(measure::FieldScore::psnr_view),
        outside_psnr_view: measured.outside.as_ref().map(measure::FieldScore::psnr_view),
    })
}

/// What was found out beside the views' own figures.
struct Found {
    light: light::Light,
    limits: Vec<limits::Limit>,
}

#[cfg(test)]
mod tests;
