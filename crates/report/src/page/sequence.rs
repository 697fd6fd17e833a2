//! The page of a sequence of time steps.

use maud::{Markup, PreEscaped, html};

use super::{document, picture, settings};
use crate::sequence::{SequenceFigures, SequenceInput, SequenceReport, SequenceSeries, SequenceTime};
use crate::{ReportError, format, plot};

/// Largest number of time steps with pictures.
const PICTURES: usize = 24;

pub(crate) fn render(input: &SequenceInput, report: &SequenceReport) -> Result<String, ReportError> {
    let header = html! {
        h1 { (input.title) }
        @for (series, figures) in input.series.iter().zip(&report.series) {
            @if let Some(id) = series.id { h2 { "Node " (id) } }
            (key_figures(series, figures))
        }
        (settings::warnings(input.warnings))
    };
    let main = html! {
        @for series in input.series { (section(series)?) }
        section id="settings" {
            h2 { "Settings" }
            @if let Some(command) = input.command { p { "Made by " code { (command) } " with Lumistack " (input.version) "." } }
            (settings::facts("Job with all defaults", input.settings))
        }
    };
    Ok(document(input.title, input.version, &header, &main))
}

/// Makes the section of one display over time.
fn section(series: &SequenceSeries<'_>) -> Result<Markup, ReportError> {
    let name = |name: &str| series.id.map_or(name.to_owned(), |id| format!("{name}-{id}"));
    Ok(html! {
        @if let Some(id) = series.id { h1 { "Node " (id) } }
        (pictures(series.times, &name("views"))?)
        (plots(series.times, &name("error"))?)
        (table(series.times, &name("times")))
    })
}

fn key_figures(input: &SequenceSeries<'_>, report: &SequenceFigures) -> Markup {
    let db = |value: Option<f64>| value.map_or("–".into(), |value| format!("{} dB", format::decibels(value)));
    let seconds: f64 = input.times.iter().map(|time| time.seconds).filter(|seconds| seconds.is_finite()).sum();
    let iterations: u32 = input.times.iter().map(|time| time.iterations).sum();
    let iterations = format::counted(iterations as usize, "iteration");
    let figures = [
        (
            "Time steps",
            input.times.len().to_string(),
            "each later time step starts from the patterns of the previous time step, unless a fresh start is better",
        ),
        ("PSNR of the views", db(Some(report.psnr_view)), "psnr_view of all time steps together"),
        ("PSNR of raw light", db(Some(report.psnr_raw)), "psnr_raw: emitted light, L̃ against βL"),
        (
            "Flicker over time",
            db(report.psnr_change),
            "psnr_change: PSNR of the shown change against the change of the target; higher means less flicker",
        ),
        ("Flicker where still", db(report.psnr_still), "psnr_still: psnr_change over rays whose target is constant"),
        ("Brightness β", format::number(input.brightness), "emitted light as a fraction of the target's"),
        ("Solver", format::duration(seconds), iterations.as_str()),
    ];
    html! {
        dl class="key" {
            @for (name, value, note) in figures { div { dt { (name) } dd { strong { (value) } small { (note) } } } }
        }
    }
}

/// Shows central views: the target in the upper row, the display in the lower row.
fn pictures(times: &[SequenceTime], id: &str) -> Result<Markup, ReportError> {
    // Show evenly spaced time steps, including the first and the last one.
    let count = times.len().min(PICTURES);
    let chosen = (0..count).map(|i| &times[i * (times.len() - 1) / (count - 1).max(1)]);
    let mut cells = Vec::new();
    for time in chosen {
        cells.push((time, time.wanted.embedded()?, time.shown.embedded()?));
    }
    Ok(html! {
        section id=(id) class="headline" {
            h2 { "Central view over time" }
            p {
                "The upper row shows the target, the lower row the display (divided by β, clamped to 0..1 and sRGB-encoded)."
                @if times.len() > count { " " (count) " of " (times.len()) " time steps, evenly spread." }
                " To play the time steps, click a picture and hold an arrow key."
            }
            div class="times" style=(format!("--across:{count}")) {
                div class="group" { @for (time, wanted, _) in &cells { (picture(wanted, &format!("{}: target", time.name))) } }
                div class="group" { @for (time, _, shown) in &cells { (picture(shown, &format!("{}: display", time.name))) } }
                div class="group" { @for (time, ..) in &cells { span { (time.name) } } }
            }
        }
    })
}

fn plots(times: &[SequenceTime], id: &str) -> Result<Markup, ReportError> {
    let plotted = |value: fn(&SequenceTime) -> f64, label: &str| {
        let points = times.iter().enumerate().map(|(i, time)| ((i + 1) as f64, value(time)));
        let points: Vec<(f64, f64)> = points.filter(|(_, y)| y.is_finite()).collect();
        if points.is_empty() { Ok(None) } else { plot::line(&points, "time", label).map(Some) }
    };
    let error = plotted(|time| time.error.psnr(), "psnr_view, dB")?;
    let flicker = plotted(SequenceTime::psnr_change, "psnr_change, dB")?;
    let still = plotted(SequenceTime::psnr_still, "psnr_still, dB")?;
    let same = times.iter().all(|time| time.still_share() == 1.0 || time.change.is_none());
    Ok(html! {
        section id=(id) {
            h2 { "Error and flicker over time" }
            p {
                "Left: the PSNR of every time step. The first time step usually has no warm start. If the curve falls after the first time step, more iterations at later time steps help."
                @if flicker.is_some() {
                    " Next: flicker, the unwanted change. Flicker is the rms, over all rays and channels, of the change of the error L̃/β − L since the previous time step, in dB below full "
                    "brightness, so higher means less flicker. A constant error does not flicker. If errors of time steps are independent, flicker is 3 dB below the PSNR."
                }
                @if still.is_some() && !same {
                    " Last: flicker over rays whose target keeps its colour (8-bit sRGB codes to within 1), where an eye sees flicker most."
                }
            }
            div class="plots" {
                @for svg in [error, flicker, still.filter(|_| !same)].into_iter().flatten() { (PreEscaped(svg)) }
            }
        }
    })
}

fn table(times: &[SequenceTime], id: &str) -> Markup {
    let names = [
        "time",
        "start",
        "start, dB",
        "psnr_view, dB",
        "psnr_change, dB",
        "psnr_still, dB",
        "still rays",
        "iterations",
        "solver",
        "light field",
    ];
    let share = |time: &SequenceTime| {
        let share = time.still_share();
        if share.is_nan() { "–".into() } else { format::percent(share) }
    };
    html! {
        section id=(id) {
            h2 { "Every time step" }
            p {
                "A \"warm\" start uses the patterns of the previous time step. If a fresh start promises a better result, as after a cut, the fresh start is used instead. "
                "\"start, dB\" is the PSNR before the first iteration."
            }
            details open[times.len() <= 60] {
                summary { (format::counted(times.len(), "time step")) }
                div class="scroll" {
                    table class="layers" {
                        thead { tr { @for name in names { th scope="col" { (name) } } } }
                        tbody {
                            @for time in times {
                                tr {
                                    td { @match &time.report { Some(path) => a href=(format::relative_href(path)) { (time.name) }, None => (time.name) } }
                                    td { (time.start) }
                                    td { (format::decibels(time.psnr_start)) }
                                    td { (format::decibels(time.error.psnr())) }
                                    td { (format::decibels(time.psnr_change())) }
                                    td { (format::decibels(time.psnr_still())) }
                                    td { (share(time)) }
                                    td { (time.iterations) }
                                    td { (format::duration(time.seconds)) @if time.cached { " (earlier run)" } }
                                    td { (time.source) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}
