//! Main scores, quality of each view, limits, convergence and times.

use lumistack_core::metrics::Mean;
use lumistack_display::DirectionScore;
use maud::{Markup, PreEscaped, html};

use super::legend;
use crate::convergence::{Reached, reached};
use crate::measure::{FieldScore, Measured, ViewFigures, left_to_right, top_to_bottom};
use crate::picture::{SEQUENTIAL, map_colour};
use crate::{Found, ReportError, ReportInput, Solution, Stage, format, plot};

/// Makes the bar of main scores under the title.
pub(super) fn key_figures(input: &ReportInput, measured: &Measured) -> Markup {
    let geometry = input.target.geometry();
    // Show the display's number of views, since the page may show only some of them.
    let [view_cols, view_rows] = input.display.views();
    let pixels = format!("across × up, {} × {} pixels each", geometry.cols, geometry.rows);
    let db = |value: f64| format!("{} dB", format::decibels(value));
    let (zone, worst) = zone_figures(input);
    let mut figures = vec![
        (
            "PSNR over the zone",
            zone,
            "psnr_zone: seen pictures over the whole zone; it does not depend on the choice of target views",
        ),
        ("Worst tenth of the zone", worst, "psnr_zone over the tenth of the directions with the lowest PSNR"),
        ("PSNR at the solver's views", db(measured.target.psnr_view()), "psnr_view: a diagnostic of the solver"),
    ];
    if let Some(held_out) = &measured.held_out {
        figures.push((
            "Held-out PSNR",
            db(held_out.psnr_view()),
            "psnr_view of in-between views, which the solver did not use",
        ));
    }
    let mean = |of: fn(&ViewFigures) -> Mean| format::similarity(measured.target.mean(of));
    let (ssim, flip) = match &measured.zone {
        Some(looks) => (format::similarity(looks.ssim.value()), format::similarity(looks.flip.value())),
        None => (mean(|view| view.ssim), mean(|view| view.flip)),
    };
    figures.extend([
        ("SSIM", ssim, "fraction of the structure that is kept; 1 means all structure"),
        ("FLIP", flip, "difference that an eye sees; 0 means no difference"),
    ]);
    let backlight =
        if input.stack.emission.is_some() { "with a directional backlight" } else { "with a uniform backlight" };
    figures.extend([
        ("Brightness β", format::number(input.stack.brightness), "emitted light as a fraction of the target's"),
        ("Layers × frames", format!("{} × {}", input.stack.layers.len(), input.stack.frames()), backlight),
        ("Views", format!("{view_cols} × {view_rows}"), pixels.as_str()),
    ]);
    if !input.stages.is_empty() {
        let total = input.stages.iter().map(|stage| stage.seconds).sum();
        figures.push((
            "Time of this run",
            format::duration(total),
            "all stages, without the checks before the first stage and without this report",
        ));
    }
    html! {
        dl class="key" {
            @for (name, value, note) in figures { div { dt { (name) } dd { strong { (value) } small { (note) } } } }
        }
    }
}

/// Returns the zone score, and the score of the worst tenth of the directions.
fn zone_figures(input: &ReportInput) -> (String, String) {
    let db = |value: Option<f64>| value.map_or("not known".into(), |value| format!("{} dB", format::decibels(value)));
    (db(input.zone.and_then(|zone| zone.score.psnr())), db(input.zone.and_then(|zone| zone.score.worst_tenth())))
}

/// Makes the section about the quality over the zone, with a map of the measured directions.
pub(super) fn zone(input: &ReportInput) -> Markup {
    /// Side of the square map of directions, SVG units.
    const SIDE: f64 = 400.0;
    const DOT: f64 = 19.0;
    let Some(zone) = input.zone else {
        return html! {
            section id="zone" {
                h2 { "Whole viewing zone" }
                p class="quiet" {
                    "Unknown: the run has no reference pictures for directions over the zone. The scores below are the scores of single views. "
                    "If a given light field has more views than the display needs, keep fewer views (" code { "--views" } "). The other views are then the references of the zone."
                }
            }
        };
    };
    // Draw a map of the zone: a dot for each direction, coloured by its PSNR.
    let directions: Vec<_> = zone.score.directions.iter().filter(|direction| direction.pixels > 0).collect();
    let psnr = |direction: &DirectionScore| direction.psnr();
    let (low, high) =
        directions.iter().fold((f64::MAX, f64::MIN), |(low, high), d| (low.min(psnr(d)), high.max(psnr(d))));
    let reach = directions.iter().flat_map(|d| d.slope).fold(1e-9f64, |most, slope| most.max(slope.abs()));
    let place = |slope: f64| 0.5 * SIDE + slope / reach * (0.5 * SIDE - 1.3 * DOT);
    let dot = |direction: &DirectionScore| {
        let t = if high > low { ((psnr(direction) - low) / (high - low)) as f32 } else { 1.0 };
        let [r, g, b] = map_colour(&SEQUENTIAL, t);
        let light = 299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b) > 128_000;
        let [x, y] = [place(direction.slope[0]), SIDE - place(direction.slope[1])];
        let (fill, text) = (format!("rgb({r} {g} {b})"), if light { "#000" } else { "#fff" });
        html! {
            circle cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r=(DOT) fill=(fill) {
                title { (format::angle(direction.slope[0])) " across, " (format::angle(direction.slope[1])) " up: " (format::decibels(psnr(direction))) " dB" }
            }
            text x=(format!("{x:.1}")) y=(format!("{:.1}", y + 4.5)) fill=(text) text-anchor="middle" font-size="13" { (format::decibels(psnr(direction))) }
        }
    };
    let (mean, worst) = zone_figures(input);
    html! {
        section id="zone" {
            h2 { "Whole viewing zone" }
            p {
                "Eyes may be anywhere, so the display is scored from " (directions.len()) " directions over its whole zone, none of which the solver used. Each seen picture, averaged over the area of every pixel, is compared with "
                @if zone.left_out { "a view of the given light field that was left out" } @else { "two renders of the scene from the same direction, so that their noise is excluded" }
                ": " strong { (mean) } " over all directions, " strong { (worst) } " over the worst tenth. SSIM and FLIP are means over the first eight directions"
                @if !zone.left_out { ", whose renders show every pixel" } "."
            }
            svg class="zone" role="img" aria-label="PSNR by direction" viewBox=(format!("0 0 {SIDE} {SIDE}")) {
                @for direction in &directions { (dot(direction)) }
            }
            (legend(&SEQUENTIAL, &[low, high].map(|value| format!("{} dB", format::decibels(value)))))
        }
    }
}

/// A score of every view, as a table with colours.
struct Heat {
    heading: &'static str,
    explanation: &'static str,
    value: fn(&ViewFigures) -> f64,
    overall: fn(&FieldScore) -> f64,
    text: fn(f64) -> String,
    unit: &'static str,
    /// Smallest difference of the scores at the ends of the colour scale. On a narrower scale the
    /// colours would exaggerate invisible differences.
    narrowest: f64,
    /// Ends of the colour scale if no view has a finite value.
    fallback: (f64, f64),
    larger_is_better: bool,
}

const HEATS: [Heat; 3] = [
    Heat {
        heading: "PSNR per view, dB",
        explanation: "Every cell is a view. The cells are in the order of the eye positions, with the topmost views in the top row. PSNR is 10·log₁₀(1/mean squared error) in linear light with peak 1; \
                      6 dB more is half the root-mean-square error. PSNR usually falls towards the corners; a single bad cell marks a view to check.",
        value: |view| view.error.psnr(),
        overall: FieldScore::psnr_view,
        text: format::decibels,
        unit: " dB",
        narrowest: 6.0,
        fallback: (30.0, 36.0),
        larger_is_better: true,
    },
    Heat {
        heading: "SSIM per view",
        explanation: "Structural similarity (Wang et al. 2004) of the views, sRGB-encoded. 1 means that all structure is kept.",
        value: |view| view.ssim.value(),
        overall: |score| score.mean(|view| view.ssim),
        text: format::similarity,
        unit: "",
        narrowest: 0.05,
        fallback: (0.9, 1.0),
        larger_is_better: true,
    },
    Heat {
        heading: "FLIP per view",
        explanation: "FLIP (Andersson et al. 2020): the difference that an eye sees between target and display, from 0 (none) to 1 (largest).",
        value: |view| view.flip.value(),
        overall: |score| score.mean(|view| view.flip),
        text: format::similarity,
        unit: "",
        narrowest: 0.05,
        fallback: (0.0, 0.1),
        larger_is_better: false,
    },
];

/// Makes the tables of PSNR, SSIM and FLIP of each view, in the arrangement of the views. Held-out
/// and outside views are next to the target views, on the same scale.
pub(super) fn quality(input: &ReportInput, measured: &Measured) -> Markup {
    html! {
        section id="quality" {
            h2 { "Quality per view" }
            @for heat in &HEATS { (heat.tables(measured)) }
            p class="quiet" {
                "FLIP assumes " (format::number_short(input.pixels_per_degree)) " pixels of a view per degree of visual angle. SSIM and FLIP compare L̃/β with the target, clamped to 0..1. For rays that are "
                "excluded, the target replaces L̃/β."
                @if measured.held_out.is_none() || measured.outside.is_none() {
                    " Views that were not rendered ("
                    @if measured.held_out.is_none() { "in-between" }
                    @if measured.held_out.is_none() && measured.outside.is_none() { " and " }
                    @if measured.outside.is_none() { "outside" }
                    ") have no scores."
                }
            }
        }
    }
}

impl Heat {
    fn tables(&self, measured: &Measured) -> Markup {
        let target = Some((&measured.target, "Target views"));
        let held_out = measured.held_out.as_ref().map(|score| (score, "In-between views, not optimized"));
        let outside = measured.outside.as_ref().map(|score| (score, "Views outside the zone"));
        let fields: Vec<_> = [target, held_out, outside].into_iter().flatten().collect();
        let all =
            fields.iter().flat_map(|(score, _)| score.geometry.grid.iter().map(|view| (self.value)(score.view(view))));
        let finite = all.filter(|value| value.is_finite());
        let (low, high) = finite.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = match (low <= high, 0.5 * (low + high)) {
            (false, _) => self.fallback,
            (true, _) if high - low >= self.narrowest => (low, high),
            (true, middle) => (middle - 0.5 * self.narrowest, middle + 0.5 * self.narrowest),
        };
        let ends = [low, high].map(|value| format!("{}{}", (self.text)(value), self.unit));
        html! {
            h3 { (self.heading) }
            p { (self.explanation) }
            div class="grids" { @for (score, name) in fields { (self.grid(score, name, (low, high))) } }
            (legend(&SEQUENTIAL, &if self.larger_is_better { ends } else { let [low, high] = ends; [high, low] }))
        }
    }

    fn grid(&self, score: &FieldScore, name: &str, range: (f64, f64)) -> Markup {
        let grid = &score.geometry.grid;
        let (rows, cols) = (top_to_bottom(grid), left_to_right(grid));
        html! {
            div class="scroll" {
                p { (name) ": " strong { ((self.text)((self.overall)(score))) (self.unit) } }
                table class="heat" {
                    thead { tr { th {} @for x in &cols { th scope="col" { (format::angle(grid.slope_x[*x])) } } } }
                    tbody {
                        @for y in &rows {
                            tr {
                                th scope="row" { (format::angle(grid.slope_y[*y])) }
                                @for x in &cols { (self.cell((self.value)(score.view([*y, *x])), range)) }
                            }
                        }
                    }
                }
            }
        }
    }

    fn cell(&self, value: f64, (low, high): (f64, f64)) -> Markup {
        if value.is_nan() {
            return html! { td { "–" } };
        }
        let t = ((value - low) / (high - low)) as f32;
        let [r, g, b] = map_colour(&SEQUENTIAL, if self.larger_is_better { t } else { 1.0 - t });
        let light = 299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b) > 128_000;
        let style = format!("background:rgb({r} {g} {b});color:{}", if light { "#000" } else { "#fff" });
        html! { td style=(style) { ((self.text)(value)) } }
    }
}

/// Makes the section about the limits of the result, and about the display's brightness.
pub(super) fn limits(input: &ReportInput, found: &Found) -> Markup {
    html! {
        section id="limits" {
            h2 { "Limits of the result" }
            p {
                "Measured on this layer stack, without solving again. A number in dB is the gain of the PSNR if one effect were absent and all else unchanged; the largest gain is first. For brightness and iterations the gain is extrapolated, as the text states. Effects overlap, so the "
                "gains do not add up. Effects that need another simulation are measured only at the central view and the corners."
            }
            ol class="limits" {
                @for limit in &found.limits {
                    li {
                        strong { (limit.name) }
                        @if let Some(decibels) = limit.decibels { span class="gain" { (format::decibels_fine(decibels)) " dB" } }
                        p { (limit.text) }
                    }
                }
            }
            h3 { "Absolute brightness" }
            p { (found.light.sentence(input)) }
        }
    }
}

/// Makes the section with plots of PSNR over iterations and over time.
pub(super) fn convergence(input: &ReportInput) -> Result<Markup, ReportError> {
    let mut plots = Vec::new();
    for axis in &plot::AXES {
        plots.extend(plot::convergence(input.convergence, axis)?);
    }
    Ok(html! {
        section id="convergence" {
            h2 { "Convergence" }
            @match input.convergence.last() {
                None => p class="quiet" { "There is no history of the solver: another source or an earlier run made the layer stack." },
                Some(last) => p {
                    "After " (format::counted(last.iteration as usize, "iteration")) " and " (format::duration(last.seconds)) ": " (format::decibels(last.psnr_view)) " dB. "
                    "A curve that still rises at its right end needs more iterations; a flat curve has reached the limit of the layers, frames and brightness."
                },
            }
            @if let Some(solution) = input.solution { p { (solved_by(solution)) } }
            @if plots.is_empty() && !input.convergence.is_empty() { p class="quiet" { "No finite PSNR to plot." } }
            div class="plots" { @for svg in &plots { (PreEscaped(svg)) } }
            @if input.convergence.len() > 1 { (reached_by(&reached(input.convergence))) }
        }
    })
}

/// Summarizes the solution in a few sentences.
fn solved_by(solution: &Solution) -> String {
    let begun = match solution.coarse_levels {
        0 => String::new(),
        1 => ", first at half the resolution".into(),
        levels => format!(", first at {levels} coarser resolutions"),
    };
    let mut text = format!(
        "Solver {}, start {}{begun}. One more exact step of each value would change the emission by {:.1e} (root mean square). This change is 0 if the \
         first-order conditions are satisfied.",
        solution.solver, solution.start, solution.kkt_residual
    );
    if let Some([continuous, rounded, reoptimized]) = solution.levels {
        let [continuous, rounded, reoptimized] = [continuous, rounded, reoptimized].map(format::decibels);
        text += &format!(
            " The panels have few levels. The PSNR is {continuous} dB with continuous values, {rounded} dB with values that are rounded to the levels, and {reoptimized} dB after another optimization on the levels."
        );
    }
    text
}

/// Makes the table of PSNR at round numbers of seconds.
fn reached_by(lines: &[Reached]) -> Markup {
    html! {
        div class="scroll" {
            table class="reached" {
                tr { th scope="row" { "after" } @for line in lines { td { (format::duration_short(line.seconds)) } } }
                tr { th scope="row" { "iterations" } @for line in lines { td { (line.iteration) } } }
                tr { th scope="row" { "psnr_view, dB" } @for line in lines { td { (format::decibels(line.psnr_view)) } } }
            }
        }
    }
}

/// Makes the table of the time of each stage, seconds.
pub(super) fn timings(stages: &[Stage]) -> Markup {
    let total: f64 = stages.iter().map(|stage| stage.seconds).sum();
    let share = |stage: &Stage| if total > 0.0 { (100.0 * stage.seconds / total).clamp(0.0, 100.0) } else { 0.0 };
    html! {
        section id="time" {
            h2 { "Time per stage" }
            @if stages.is_empty() { p class="quiet" { "No timings were recorded." } } @else {
                p { "Wall time of this run. A stage from the cache was computed by an earlier run." }
                table class="time" {
                    @for stage in stages {
                        tr {
                            th scope="row" { (stage.name) }
                            td class="figure" { (format::duration(stage.seconds)) }
                            td class="track" { div style=(format!("width:{:.1}%", share(stage))) {} }
                            td { @if stage.cached { "from the cache" } }
                        }
                    }
                    tr class="total" { th scope="row" { "all" } td class="figure" { (format::duration(total)) } td {} td {} }
                }
            }
        }
    }
}
