//! Views of the target, simulated views, their differences, and FLIP maps.

use maud::{Markup, html};

use super::{figure, legend, shrunk_note};
use crate::measure::{Comparison, Measured};
use crate::picture::{DIVERGING, Embedded, MAGMA};
use crate::{ReportInput, format};

/// Makes the large comparison at the top of the page.
pub(super) fn headline(measured: &Measured) -> Markup {
    let k = measured.headline.amplification;
    html! {
        section id="views" class="headline" {
            div class="compare group" { (pictures(&measured.headline)) }
            div class="beside" {
                p {
                    @if measured.zone.is_some() { "The seen picture from a direction that the solver did not use. Among the directions whose references show every pixel, this direction has the median score. " } @else { "The view from straight ahead. " }
                    "A good display shows the picture of the target, and the difference is almost white. Red is too bright, blue is too dark. The error is "
                    "amplified " strong { "× " (k) } " (the error of the colour channel with the largest error, in linear light)."
                    @if measured.has_dropped_rays { " Grey squares are rays that leave a layer or have weight 0; scores exclude them, and the display may show black there." }
                    " Views are divided by the brightness β, clamped to 0..1 and sRGB-encoded." (shrunk_note(measured.headline_shrunk))
                    " Click a picture for full size; there the arrow keys flip between target, simulated, difference and FLIP error in place. FLIP shows where an eye that sees target and display "
                    "in turn notices a difference: the lighter, the larger the difference."
                }
                div { (difference_legend(k)) (flip_legend()) }
            }
        }
    }
}

/// Shows two pictures whose view follows the pointer: target and simulation.
pub(super) fn look_around(measured: &Measured) -> Markup {
    let sheets = &measured.sheets;
    let (rows, cols) = (sheets.up.len(), sheets.across.len());
    if rows * cols < 2 {
        return html! {};
    }
    let sheet = |picture: &Embedded, name: &str| {
        // The sheet of all views is shifted so that the central view is visible. The script shifts
        // the sheet to other views.
        let style = format!(
            "width:{}%;transform:translate({}%,{}%)",
            100 * cols,
            -100.0 * (cols / 2) as f64 / cols as f64,
            -100.0 * (rows / 2) as f64 / rows as f64
        );
        let ratio = format!("aspect-ratio:{}/{}", picture.cols / cols, picture.rows / rows);
        let class = if picture.cols / cols < super::SHARP_COLS { "sharp" } else { "" };
        html! {
            figure {
                div class="sheet" style=(ratio) {
                    img class=(class) src=(picture.uri) width=(picture.cols) height=(picture.rows) style=(style) alt=(format!("{name}: all {rows} × {cols} views"));
                }
                figcaption { (name) }
            }
        }
    };
    html! {
        section {
            h2 { "Look around" }
            p {
                "Move the pointer across either picture, as your eye would move in front of the display (or focus a picture and use the arrow keys). When the pointer moves right, things in front of the display plane shift to the "
                "left and things behind it to the right, in both pictures alike. A target that was rendered with few samples per view looks speckled; the solver averages this noise over all views."
            }
            div id="look" tabindex="0" data-across=(sheets.across.join("|")) data-up=(sheets.up.join("|")) {
                (sheet(&sheets.target, "Target"))
                (sheet(&sheets.simulated, "Simulated"))
                output { "view from straight ahead" }
            }
        }
    }
}

/// Shows the smaller comparisons; [`Measured::rows`] lists their views.
pub(super) fn comparisons(input: &ReportInput, measured: &Measured) -> Markup {
    let grid = &input.target.geometry().grid;
    let one_view = grid.views() == [1, 1];
    let with_target: Vec<&Comparison> = measured.rows.iter().filter(|row| row.target.is_some()).collect();
    let simulated_only = measured.rows.iter().filter(|row| row.target.is_none());
    let missing = match (input.held_out.is_some() || input.zone.is_some(), input.outside.is_some()) {
        (false, false) => {
            " No target was rendered for in-between and outside views here, so they are shown as simulated only."
        }
        (false, true) => " No target was rendered for the in-between views here, so they are shown as simulated only.",
        (true, false) => " No target was rendered for the outside views here, so they are shown as simulated only.",
        (true, true) => "",
    };
    html! {
        section {
            h2 { "Views side by side" }
            p {
                "Corner views are the hardest: their rays are the most oblique, so things far from the display blur or double there first. Seen pictures are averaged over the area of every pixel, and come from directions of the zone that were not targets of the optimization. If ghosts and noise appear "
                "only in seen pictures, the target's views are too far apart. Views outside the outermost ones are not constrained, so the picture may break up there."
                @if !one_view { (missing) }
                (shrunk_note(measured.rows_shrunk))
            }
            @for (i, row) in with_target.iter().enumerate() {
                @if i == 0 || row.amplification != with_target[i - 1].amplification { (difference_legend(row.amplification)) }
                div class="row" {
                    h3 { (row.title) span { (facts(row)) } }
                    div class="compare group" { (pictures(row)) }
                }
            }
            @if simulated_only.clone().next().is_some() {
                div class="row" {
                    h3 { "In-between and outside views" span { "simulated only" } }
                    div class="compare group" {
                        @for view in simulated_only { (figure(&view.simulated, &format!("Simulated: {}, from {}", view.title, view.direction), &format!("{}, {}", view.title, facts(view)))) }
                    }
                }
            }
        }
    }
}

fn facts(view: &Comparison) -> String {
    let mut facts = format!("from {}", view.direction);
    if let Some(figures) = &view.figures {
        facts += &format!(
            " · PSNR {} dB · SSIM {} · FLIP {}",
            format::decibels(figures.error.psnr()),
            format::similarity(figures.ssim.value()),
            format::similarity(figures.flip.value())
        );
    }
    if view.counted_share < 1.0 {
        facts += &format!(" · {} of rays included", format::percent(view.counted_share));
    }
    facts
}

/// Shows target, simulated view, difference and FLIP error. Without a target, only the simulated
/// view.
fn pictures(view: &Comparison) -> Markup {
    let amplification = view.amplification;
    let name = |what: &str| format!("{what}: {}, {}", view.title, view.direction);
    html! {
        @if let Some(target) = &view.target { (figure(target, &name("Target"), "Target L")) }
        (figure(&view.simulated, &name("Simulated"), "Simulated L̃/β"))
        @if let Some(difference) = &view.difference {
            (figure(difference, &name(&format!("Difference × {amplification}")), &format!("Simulated − target, × {amplification}")))
        }
        @if let Some(flip) = &view.flip { (figure(flip, &name("FLIP error"), "FLIP error, 0 to 1")) }
    }
}

fn flip_legend() -> Markup {
    legend(&MAGMA, &["0 no FLIP error".into(), "0.5".into(), "1 largest".into()])
}

fn difference_legend(amplification: u32) -> Markup {
    let end = 1.0 / f64::from(amplification);
    let end = format::number(end);
    let labels = [format!("≤ −{end} too dark"), "0".into(), format!("≥ +{end} too bright")];
    legend(&DIVERGING, &labels)
}
