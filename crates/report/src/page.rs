//! report.html: pictures first, then scores, then settings. The library maud escapes every text.

mod denoising;
mod depth;
mod figures;
pub(crate) mod graph;
pub(crate) mod sequence;
mod settings;
mod views;

mod layers;

use lumistack_display::ViewGrid;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::measure::Measured;
use crate::patterns::Patterns;
use crate::picture::Embedded;
use crate::{Found, ReportError, ReportInput};

const STYLE: &str = include_str!("page/style.css");
const SCRIPT: &str = include_str!("page/script.js");
/// Forbids network requests: pictures are data URIs, style and script are inline.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// Pictures with fewer columns than this are enlarged without smoothing.
const SHARP_COLS: usize = 600;

pub(crate) fn render(
    input: &ReportInput,
    measured: &Measured,
    grid: &ViewGrid,
    found: &Found,
    patterns: &Patterns,
) -> Result<String, ReportError> {
    let header = html! {
        h1 { (input.title) }
        (figures::key_figures(input, measured))
        (settings::warnings(input.warnings))
        nav {
            a href="#views" { "Views" }
            a href="#zone" { "Zone" }
            @if input.denoising.is_some() { a href="#denoising" { "Denoising" } }
            @if input.depth.is_some() { a href="#depth" { "Depth" } }
            a href="#limits" { "Limits" }
            a href="#layers" { "Layers" }
            a href="#quality" { "Quality per view" }
            a href="#convergence" { "Convergence" }
            a href="#time" { "Time" }
            a href="#settings" { "Settings" }
        }
    };
    let main = html! {
        (views::headline(measured))
        (views::look_around(measured))
        (views::comparisons(input, measured))
        (figures::zone(input))
        (denoising::section(input, grid)?)
        @if let Some(budget) = input.depth { (depth::section(budget)?) }
        (figures::limits(input, found))
        (layers::patterns(input, patterns))
        (figures::quality(input, measured))
        (figures::convergence(input)?)
        (figures::timings(input.stages))
        (settings::section(input))
    };
    Ok(document(input.title, input.version, &header, &main))
}

/// Makes a standalone page, with style, script and the dialog for pictures at full size.
pub(crate) fn document(title: &str, version: &str, header: &Markup, main: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                title { (title) " – Lumistack report" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header { (header) }
                main { (main) }
                footer { "Lumistack " (version) "; the numbers of this page are in report.json" }
                dialog id="zoom" {
                    div class="bar" {
                        button type="button" data-step="-1" aria-label="previous picture" { "‹" }
                        button type="button" data-step="1" aria-label="next picture" { "›" }
                        output {}
                        button type="button" data-close="" { "close" }
                    }
                    div class="room" { img alt=""; }
                }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

/// Makes a picture that fills its container and opens at full size.
fn picture(embedded: &Embedded, description: &str) -> Markup {
    let class = if embedded.cols < SHARP_COLS { "zoom sharp" } else { "zoom" };
    html! {
        img class=(class) src=(embedded.uri) width=(embedded.cols) height=(embedded.rows) alt=(description) title=(description) tabindex="0";
    }
}

/// Makes a picture with a caption.
fn figure(embedded: &Embedded, description: &str, caption: &str) -> Markup {
    html! { figure { (picture(embedded, description)) figcaption { (caption) } } }
}

/// Makes a colour bar with labels at its ends.
fn legend(anchors: &[[u8; 3]], labels: &[String]) -> Markup {
    let stops: Vec<String> = anchors.iter().map(|[r, g, b]| format!("rgb({r} {g} {b})")).collect();
    html! {
        div class="legend" {
            div class="ramp" style=(format!("background:linear-gradient(to right,{})", stops.join(","))) {}
            div class="ticks" { @for label in labels { span { (label) } } }
        }
    }
}

/// Makes a note such as "Shown at 1/2 size", or nothing.
fn shrunk_note(factor: usize) -> String {
    if factor > 1 { format!(" Shown at 1/{factor} size, averaged over areas.") } else { String::new() }
}
