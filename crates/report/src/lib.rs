//! The report of a run: scores, and views of the display next to views of the target, as one HTML
//! file.
//!
//! [`build`] simulates the target views (at most 7 along an axis) with the display's forward model,
//! and returns the contents of two files. It writes no files, reads no clock and makes no network
//! request. `report.html` is one file: pictures are data URIs, style and script are inline.
//!
//! ```text
//! Display + LayerStack + LightField ─▶ measure  PSNR, SSIM, FLIP, pictures ─▶ json ─▶ report.json
//!                                      light    absolute brightness        └▶ page ─▶ report.html
//!                                      limits   limits of the result
//!                                      patterns pictures of the masks
//! ```
//!
//! A sequence of time steps has another report, [`sequence()`]. A job with several displays has the
//! report [`graph()`].
//!
//! The main score is `psnr_zone`: PSNR of seen pictures in directions over the whole zone. It does
//! not depend on the choice of target views.
//!
//! PSNR is defined as in the display crate: peak 1, linear light, over all channels and all rays
//! with a weight w > 0 that hit the display. `psnr_view` compares L̃/β with L. `psnr_raw` compares
//! L̃ with βL and is higher by −20·log10 β. SSIM and FLIP compare L̃/β with L, clamped to 0..1, as
//! [`lumistack_core::metrics`] defines them. At the pixels of rays that the scores exclude, both
//! pictures have the target's value, and the means do not include these pixels.
//!
//! # report.json
//!
//! | key | value |
//! |---|---|
//! | `schema`, `version` | `"lumistack/report"`, 1 |
//! | `title`, `lumistack_version`, `command` | texts; `command` may be null |
//! | `psnr_zone`, `psnr_zone_worst_tenth` | The main score: PSNR of seen pictures in dB, over directions in the whole zone, which no solver used. The second is over the worst tenth of the directions. Both are null without reference pictures |
//! | `zone` | null, or `directions` (list of `slope`, `psnr` in dB and `pixels`), `ssim` and `flip`. The last two are means over the first eight directions, whose references show every pixel |
//! | `psnr_view`, `psnr_raw` | dB, along the centre rays of the target views' pixels: the quality of the solver. Here and in `light`, `views` and `limits`, at most 7 target views along an axis are measured |
//! | `ssim`, `flip` | means over the measured target views |
//! | `pixels_per_degree` | pixels per degree of visual angle, for FLIP |
//! | `brightness` | β |
//! | `light` | luminances relative to the backlight's: `emitted` (mean of L̃), `wanted` (mean of L) and `open`: the luminance, from straight ahead, of a display with all pixels at their brightest. `text` states them in a few sentences |
//! | `views` | The target's `slope_x[view_x]`, `slope_y[view_y]` (tangents, y up), `projection`, `distance_mm`, `rows`, `cols`, `pitch_mm`. Arrays `[view_y][view_x]`: `psnr_view` (dB), `ssim`, `flip` and `counted_share` (fraction of rays that scores include, 0..1) |
//! | `held_out`, `outside` | null, or the same keys as `views` for views that the solver did not use: held-out views, and views outside of the zone. Also `overall_psnr_view`, `overall_psnr_raw`, `overall_ssim` and `overall_flip` |
//! | `limits` | list, the largest first and the limit `Frames` last, of `name`, `decibels`, `text` and `figures` (the numbers of the measurement). `decibels` is the gain of psnr_view if the effect were absent; null if one run cannot determine it. For `Brightness` it is the gain with 10 % more light, for `Iterations` with twice as many iterations |
//! | `solution` | null, or `solver`, `start`, `coarse_levels`, `kkt_residual`, and `levels`: null, or psnr_view (dB) of the stacks `continuous`, `rounded` and `reoptimized` |
//! | `depth` | null, or `depth_of_field_mm` ([low, high] or null) and three fractions of the rays with a hit. `inside` are inside the depth of field, `inside_middle` likewise in the central view, and `beyond_a_pixel` have a disparity above one pixel. Also the percentiles `depth_mm` and `disparity_px` (between neighbouring views), two histograms, and the numbers `window_moved_back_mm` and `depth_scale` |
//! | `convergence` | list of `iteration`, `objective` (Σ w (βL − L̃)²), `psnr_view` (dB), `seconds` since the solver's start |
//! | `reached` | list of `seconds`, `iteration`, `psnr_view`: the last point of the convergence by that time |
//! | `denoising` | null, or `name`, four numbers for all views together, and `views`, a list with the same numbers for each view. The numbers are `mean` (of the unbiased picture), `mean_change`, `mse_before` and `mse_after`, in exposed radiance. Each but `mean` is a pair of value and standard error. The mean squared errors are measured with samples that the filter never used, in some of the views; they are null in all other views |
//! | `stages`, `seconds_total` | list of `name`, `seconds`, `cached` |
//! | `display`, `settings`, `scene` | the display file, the resolved job, facts about the scene or null |
//! | `warnings`, `outputs` | lists of `place`, `message` and of `label`, `path` (relative to the report), `failed` (null, or the reason) |
//!
//! JSON has no infinity: the PSNR of equal pictures is the text `"Infinity"`. Python's `float()`,
//! JavaScript's `Number()` and Rust's `str::parse::<f64>` read it. A score that includes no ray is
//! `null`.

mod convergence;
mod depth;
mod format;
mod found;
mod graph;
mod input;
mod json;
mod light;
mod limits;
mod measure;
mod page;
mod patterns;
mod picture;
mod plot;
mod sequence;
mod thinned;

use lumistack_core::Task;
use lumistack_display::{LightField, ViewGrid};

pub use depth::DepthBudget;
use found::Found;
pub use graph::{GraphInput, GraphNode, graph};
pub use input::{
    DenoisedView, Denoising, Iteration, Output, Report, ReportError, ReportInput, Solution, Stage, ZoneFigures,
    ZoneView,
};
pub use sequence::{SequenceFigures, SequenceInput, SequenceReport, SequenceSeries, SequenceTime, Thumbnail, sequence};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that these sources affect.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// Simulates the display and makes the report.
///
/// # Errors
/// If stack or weights do not match display and target. If a picture, a plot or report.json cannot
/// be made, or if the task is cancelled.
pub fn build(input: &ReportInput, task: Task) -> Result<Report, ReportError> {
    input.stack.check(input.display)?;
    input.weights.check(input.target.geometry())?;
    let grid = &input.target.geometry().grid;
    let some = thinned::thinned(input.target, input.weights);
    let input = &match &some {
        Some((target, weights)) => ReportInput { target, weights, ..*input },
        None => *input,
    };
    let views = |field: &LightField| field.geometry().grid.iter().count();
    let others = [input.held_out, input.outside].into_iter().flatten().map(views);
    let steps = views(input.target) + others.sum::<usize>() + limits::count(input) + patterns::count(input.stack);
    task.progress.begin("report", steps as u64, "pictures");
    let report = build_parts(input, grid, task);
    task.progress.end();
    report
}

/// Makes the report of measured target views. `grid` has all views of the target.
fn build_parts(input: &ReportInput, grid: &ViewGrid, task: Task) -> Result<Report, ReportError> {
    let measured = measure::measure(input, task)?;
    let target = &measured.target;
    let found = Found { light: light::light(input, target), limits: limits::find(input, target, grid, task)? };
    let patterns = patterns::encode(input, task)?;
    let json = json::report(input, &measured, &found)?;
    let html = page::render(input, &measured, grid, &found, &patterns)?;
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

#[cfg(test)]
mod tests;
