//! Key figures, PSNR per view, convergence and timings.

use maud::{Markup, PreEscaped, html};

use super::legend;
use crate::measure::{FieldScore, Measured, left_to_right, top_to_bottom};
use crate::picture::{SEQUENTIAL, map_colour};
use crate::{ReportError, ReportInput, Stage, format, plot};

/// The strip under the title.
pub(super) fn key_figures(input: &ReportInput, measured: &Measured) -> Markup {
    let geometry = input.target.geometry();
    let [view_rows, view_cols] = geometry.grid.views();
    let db = |value: f64| format!("{} dB", format::decibels(value));
    let mut figures = vec![
        ("PSNR of the views", db(measured.target.psnr_view()), "psnr_view: what an adapted eye sees, L̃/β against L"),
        ("PSNR of raw light", db(measured.target.psnr_raw()), "psnr_raw: emitted light, L̃ against βL"),
    ];
    if let Some(held_out) = &measured.held_out {
        figures.push(("Held-out PSNR", db(held_out.psnr_view()), "psnr_view of views the solver did not see"));
    }
    let backlight = if input.stack.emission.is_some() { "and a directional backlight" } else { "uniform backlight" };
    figures.extend([
        ("Brightness β", format::number(input.stack.brightness), "emitted light as a share of the target's"),
        ("Layers × frames", format!("{} × {}", input.stack.layers.len(), input.stack.frames()), backlight),
        ("Views", format!("{view_cols} × {view_rows}"), "across × up"),
        ("Resolution", format!("{} × {}", geometry.cols, geometry.rows), "pixels of one view"),
    ]);
    if !input.stages.is_empty() {
        let total = input.stages.iter().map(|stage| stage.seconds).sum();
        figures.push(("Time of this run", format::duration(total), "all stages"));
    }
    html! {
        dl class="key" {
            @for (name, value, note) in figures { div { dt { (name) } dd { strong { (value) } small { (note) } } } }
        }
    }
}

/// PSNR per view, laid out like the views; held-out views beside it on the same scale.
pub(super) fn psnr_grids(measured: &Measured) -> Markup {
    let fields = [Some(&measured.target), measured.held_out.as_ref()].into_iter().flatten();
    let all = fields.flat_map(|score| score.geometry.grid.iter().map(|view| score.view(view).psnr()));
    let finite = all.filter(|psnr| psnr.is_finite());
    let (low, high) = finite.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    // a narrow range would paint differences that nobody can see
    const NARROWEST_DB: f64 = 6.0;
    let (low, high) = match (low <= high, 0.5 * (low + high)) {
        (false, _) => (30.0, 30.0 + NARROWEST_DB),
        (true, _) if high - low >= NARROWEST_DB => (low, high),
        (true, middle) => (middle - 0.5 * NARROWEST_DB, middle + 0.5 * NARROWEST_DB),
    };
    html! {
        section id="psnr" {
            h2 { "PSNR per view, dB" }
            p {
                "Every cell is a view, laid out as an eye in front of the display moves: the topmost views in the top row. PSNR is 10·log₁₀(1/mean squared error) in linear light with peak 1; "
                "6 dB more is half the error. It usually falls towards the corners; a single bad cell points at a view that needs a look."
            }
            div class="grids" {
                (grid(&measured.target, "Target views", (low, high)))
                @if let Some(held_out) = &measured.held_out { (grid(held_out, "Held-out views, not optimized", (low, high))) }
            }
            (legend(SEQUENTIAL, &[format!("{} dB", format::decibels(low)), format!("{} dB", format::decibels(high))]))
            @if measured.held_out.is_none() { p class="quiet" { "No held-out views were rendered." } }
        }
    }
}

fn grid(score: &FieldScore, name: &str, (low, high): (f64, f64)) -> Markup {
    let grid = &score.geometry.grid;
    let (rows, cols) = (top_to_bottom(grid), left_to_right(grid));
    html! {
        div class="scroll" {
            p { (name) ": " strong { (format::decibels(score.psnr_view())) " dB" } }
            table class="heat" {
                thead { tr { th {} @for x in &cols { th scope="col" { (format::angle(grid.slope_x[*x])) } } } }
                tbody {
                    @for y in &rows {
                        tr {
                            th scope="row" { (format::angle(grid.slope_y[*y])) }
                            @for x in &cols { (cell(score.view([*y, *x]).psnr(), (low, high))) }
                        }
                    }
                }
            }
        }
    }
}

fn cell(psnr: f64, (low, high): (f64, f64)) -> Markup {
    if psnr.is_nan() {
        return html! { td { "–" } };
    }
    let [r, g, b] = map_colour(SEQUENTIAL, ((psnr - low) / (high - low)) as f32);
    let light = 299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b) > 128_000;
    let style = format!("background:rgb({r} {g} {b});color:{}", if light { "#000" } else { "#fff" });
    html! { td style=(style) { (format::decibels(psnr)) } }
}

/// PSNR over iterations and over time.
pub(super) fn convergence(input: &ReportInput) -> Result<Markup, ReportError> {
    let mut plots = Vec::new();
    for axis in &plot::AXES {
        plots.extend(plot::convergence(input.convergence, axis)?);
    }
    Ok(html! {
        section id="convergence" {
            h2 { "Convergence" }
            @match input.convergence.last() {
                None => p class="quiet" { "The solver left no history: the patterns came from elsewhere or from an earlier run." },
                Some(last) => p {
                    "After " (format::counted(last.iteration as usize, "iteration")) " and " (format::duration(last.seconds)) ": " (format::decibels(last.psnr_view)) " dB. "
                    "A curve that still climbs at its right end asks for more iterations; a flat one has met the limit of its layers, frames and brightness."
                },
            }
            @if plots.is_empty() && !input.convergence.is_empty() { p class="quiet" { "No finite PSNR to plot." } }
            div class="plots" { @for svg in &plots { (PreEscaped(svg)) } }
        }
    })
}

/// Seconds per stage.
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
