//! The run's report: simulated views beside their targets, as one HTML file and as numbers.
//!
//! [`build`] simulates every target view once with the display's forward model and returns two
//! texts; it writes no files, reads no clock and makes no network request. `report.html` is one
//! file: pictures are data URIs, style and script are inline.
//!
//! ```text
//! Display + LayerStack + LightField ─▶ measure  PSNR, SSIM, FLIP, pictures ─▶ json ─▶ report.json
//!                                      light    absolute brightness       └─▶ page ─▶ report.html
//!                                      limits   causes of the remaining error
//!                                      patterns pictures of the masks
//! ```
//!
//! A sequence of times has a report of its own, [`sequence()`], and so has a job that feeds several
//! displays, [`graph()`].
//!
//! The headline is `psnr_zone`, the score of seen pictures: at no view in particular, averaged over
//! the area of every pixel.
//!
//! PSNR is the display crate's: peak 1, linear light, over all rays with w > 0 that hit the
//! display, and all channels. `psnr_view` compares L̃/β with L, `psnr_raw` compares L̃ with βL and
//! is higher by −20·log10 β. SSIM and FLIP compare L̃/β with L, clamped to 0..1, as
//! [`lumistack_core::metrics`] defines them. Rays that do not count are set to the target in both
//! pictures, and the means run over the pixels that count.
//!
//! # report.json
//!
//! | key | value |
//! |---|---|
//! | `schema`, `version` | `"lumistack/report"`, 1 |
//! | `title`, `lumistack_version`, `command` | texts; `command` may be null |
//! | `psnr_zone`, `psnr_zone_worst_tenth` | the headline: dB of seen pictures over directions all over the zone, which no solver used, and over the worst tenth of them. Null where the scene's pictures from there are unknown |
//! | `zone` | null, or `directions` (list of `slope`, `psnr` in dB and `pixels`), and `ssim` and `flip`, means over those whose references have enough samples, the first eight |
//! | `psnr_view`, `psnr_raw` | dB, target views by their pixels' centre rays: how well the solver did. Here and below, where there are more than 7 views along an axis, 7 of them stand for all |
//! | `ssim`, `flip` | means over all target views |
//! | `pixels_per_degree` | pixels per degree of visual angle, for FLIP |
//! | `brightness` | β |
//! | `light` | luminances relative to the backlight's: `emitted` (mean of L̃), `wanted` (mean of L), `open` (of a display whose every pixel is at its brightest, from straight ahead), and `text` |
//! | `views` | the target's `slope_x[view_x]`, `slope_y[view_y]` (tangents, y up), `projection`, `distance_mm`, `rows`, `cols`, `pitch_mm`, and `[view_y][view_x]` arrays `psnr_view` (dB), `ssim`, `flip` and `counted_share` (share of rays that count, 0..1) |
//! | `held_out`, `outside` | null, or the same keys as `views` for views that were not optimized, in between and outside the zone, with `overall_psnr_view`, `overall_psnr_raw`, `overall_ssim` and `overall_flip` |
//! | `limits` | list, the largest first, of `name`, `decibels` (how much better psnr_view would be without it; null where one run cannot decide), `text` and the `figures` behind it |
//! | `depth` | null, or figures of the rays of all views that hit a surface: `depth_of_field_mm` ([low, high] or null), shares `inside` it, `inside_middle` (of the middle view), `beyond_a_pixel`. Also percentiles `depth_mm` and `disparity_px` (between neighbouring views), `window_moved_back_mm`, `depth_scale`, and two histograms |
//! | `convergence` | list of `iteration`, `objective` (Σ w (βL − L̃)²), `psnr_view` (dB), `seconds` since the solver's start |
//! | `reached` | list of `seconds`, `iteration`, `psnr_view`: the last point of the convergence by then |
//! | `denoising` | null, or `name`, and over all views and in the list `views`: `mean` (of the unbiased picture), `mean_change`, `mse_before`, `mse_after`. Each is a pair of value and standard error (exposed radiance; errors at pixels that the filter never used) |
//! | `stages`, `seconds_total` | list of `name`, `seconds`, `cached` |
//! | `display`, `settings`, `scene` | the display file, the resolved job, facts about the scene or null |
//! | `warnings`, `outputs` | lists of `place`, `message` and of `label`, `path` (relative to the report), `failed` (null, or why nothing is there) |
//!
//! JSON has no infinity: a PSNR of equal pictures is the text `"Infinity"`. `float()` of Python,
//! `Number()` of JavaScript and `str::parse::<f64>` of Rust all read it. A figure without any
//! counted ray is `null`.

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
use lumistack_display::LightField;

pub use depth::DepthBudget;
use found::Found;
pub use graph::{GraphInput, GraphNode, graph};
pub use input::{
    DenoisedView, Denoising, Iteration, Output, Report, ReportError, ReportInput, Solution, Stage, ZoneFigures,
    ZoneView,
};
pub use sequence::{SequenceFigures, SequenceInput, SequenceReport, SequenceSeries, SequenceTime, Thumbnail, sequence};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that
/// this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// Simulates the display and makes its report.
///
/// # Errors
/// If stack or weights do not fit display and target, or the task is cancelled.
pub fn build(input: &ReportInput, task: Task) -> Result<Report, ReportError> {
    input.stack.check(input.display)?;
    input.weights.check(input.target.geometry())?;
    let some = thinned::thinned(input.target, input.weights);
    let input = &match &some {
        Some((target, weights)) => ReportInput { target, weights, ..*input },
        None => *input,
    };
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

#[cfg(test)]
mod tests;
