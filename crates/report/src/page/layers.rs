//! The patterns as contact sheets, in the order in which light passes them.

use lumistack_display::{Backlight, Display};
use maud::{Markup, html};

use super::{figure, picture, shrunk_note};
use crate::patterns::{Emission, Patterns, Sheet};
use crate::picture::Embedded;
use crate::{ReportInput, format};

pub(super) fn patterns(input: &ReportInput, patterns: &Patterns) -> Markup {
    let display = input.display;
    let frames = display.frames;
    html! {
        section id="layers" {
            h2 { "Layers and frames" }
            p {
                (format::counted(display.layers.len(), "layer")) " × " (format::counted(frames, "frame"))
                ", from the rear to the front. " (expectation(display, frames))
                " Patterns are linear transmittance, shown sRGB-encoded: black blocks light, white lets it through." (shrunk_note(patterns.shrunk))
                @if patterns.shrunk > 1 || !patterns.lossless {
                    " The last picture of every layer is the middle of its first frame, pixel by pixel; the exact patterns are in the run's files."
                }
            }
            @if frames > 1 { (flipper(display, patterns)) }
            @if let (Some(emission), Backlight::Lenslets(backlight)) = (&patterns.emission, &display.backlight) {
                @let [bins_x, bins_y] = backlight.views;
                h3 {
                    "Backlight" span {
                        "d = " (format::number(backlight.d_mm)) " mm · " (backlight.lenslets[0]) " × " (backlight.lenslets[1]) " lenslets of "
                        (format::number(backlight.pitch_mm)) " mm · " (bins_x) " × " (bins_y) " directions over " (format::number(backlight.fov_deg[0])) "° × " (format::number(backlight.fov_deg[1])) "°"
                    }
                }
                p { "Every lenslet is a tile of " (bins_x) " × " (bins_y) " pixels, one per direction, topmost and leftmost direction first." }
                (contact_sheet(&emission.panel, "backlight"))
                (central_bin(emission))
            }
            @for (n, (sheet, layer)) in patterns.layers.iter().zip(&display.layers).enumerate() {
                h3 {
                    (name(n, display)) span {
                        "d = " (format::number(layer.d_mm)) " mm · " (layer.resolution[0]) " × " (layer.resolution[1]) " pixels of " (format::number(layer.pitch_mm)) " mm"
                    }
                }
                (contact_sheet(sheet, &name(n, display)))
            }
            (files(input))
        }
    }
}

/// What a reader should find in patterns of such a display (section 3.4 of the paper).
fn expectation(display: &Display, frames: usize) -> &'static str {
    match (&display.backlight, display.layers.len(), frames) {
        (Backlight::Lenslets(_), _, _) => {
            "The layer should hold what looks the same from everywhere, with flowing slit-like patterns around what does not; the backlight should hold mostly what changes with the view, such as things far in front of or behind the display."
        }
        (Backlight::Uniform, 1, _) => {
            "One layer with a uniform backlight shows the same picture to every eye: expect the mean of all views."
        }
        (Backlight::Uniform, _, 1) => {
            "Things near a layer should appear mostly on it. Without further frames a single set of patterns must serve all views, which shows as blurred copies of things that are far from the display."
        }
        (Backlight::Uniform, _, _) => {
            "Things near a layer should appear mostly on it, under fine patterns that change from frame to frame and act like barriers fitted to the content. The mean over frames shows what a layer holds; single frames show how the light is steered."
        }
    }
}

fn name(n: usize, display: &Display) -> String {
    match (n, display.layers.len()) {
        (_, 1) => "Layer 0".into(),
        (0, _) => "Layer 0, rearmost".into(),
        (n, count) if n + 1 == count => format!("Layer {n}, frontmost"),
        (n, _) => format!("Layer {n}"),
    }
}

/// All layers of one frame side by side, with a slider. Its pictures are those of the sheets below; the script swaps them.
fn flipper(display: &Display, patterns: &Patterns) -> Markup {
    let backlight = patterns.emission.iter().map(|emission| ("backlight".to_string(), &emission.panel.frames));
    let layers = patterns.layers.iter().enumerate().map(|(n, sheet)| (name(n, display), &sheet.frames));
    let first: Vec<_> = backlight.chain(layers).filter_map(|(name, frames)| Some((name, frames.first()?))).collect();
    html! {
        div id="frames" {
            label {
                "Frame " output { "1" } " of " (display.frames)
                input type="range" min="1" max=(display.frames) value="1";
            }
            div class="side group" style=(across(first.len())) {
                @for (name, embedded) in &first {
                    figure { span data-sheet=(name) { (picture(embedded, name)) } figcaption { (name) } }
                }
            }
        }
    }
}

fn contact_sheet(sheet: &Sheet, name: &str) -> Markup {
    let count = sheet.frames.len() + usize::from(sheet.mean.is_some()) + usize::from(sheet.closeup.is_some());
    html! {
        div class="contact group" style=(across(count)) data-sheet=(name) {
            @if let Some(mean) = &sheet.mean { (figure(mean, &format!("{name}: mean over frames"), "mean over frames")) }
            @for (m, embedded) in sheet.frames.iter().enumerate() { (numbered(embedded, name, m)) }
            @if let Some(closeup) = &sheet.closeup {
                (figure(closeup, &format!("{name}, frame 1: its middle, pixel by pixel"), "frame 1, its middle"))
            }
        }
    }
}

/// Columns on a wide page: at most eight, rows equally long.
fn across(count: usize) -> String {
    format!("--across:{}", count.div_ceil(count.div_ceil(8)).max(3))
}

fn numbered(embedded: &Embedded, name: &str, frame: usize) -> Markup {
    let label = format!("frame {}", frame + 1);
    html! { figure data-frame=(frame + 1) { (picture(embedded, &format!("{name}, {label}"))) figcaption { (label) } } }
}

fn central_bin(emission: &Emission) -> Markup {
    let [row, col] = emission.bin;
    html! {
        @if !emission.central_bin.is_empty() {
            p { "The same, only what goes straight ahead (direction row " (row) ", column " (col) " counted from 0): one pixel per lenslet." }
            div class="contact group" style=(across(emission.central_bin.len())) {
                @for (m, embedded) in emission.central_bin.iter().enumerate() { (numbered(embedded, "backlight, straight ahead", m)) }
            }
        }
    }
}

fn files(input: &ReportInput) -> Markup {
    html! {
        @if !input.outputs.is_empty() {
            h3 { "Files of this run" }
            ul { @for output in input.outputs { li { a href=(format::relative_href(&output.path)) { (output.label) } " " code { (output.path) } } } }
        }
    }
}
