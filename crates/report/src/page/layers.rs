//! The masks: large pictures, close-ups, and every frame. The masks have the order in which light
//! goes through the layers.

use lumistack_display::{Backlight, Display, Formation};
use maud::{Markup, html};

use super::{figure, picture};
use crate::patterns::{CHANGE, Emission, Patterns, Sheet, Window};
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
            }
            p {
                (scale(display))
                @if frames > 1 {
                    " The standard deviation over frames is shown × " (CHANGE) ": black pixels are the same in every frame, white pixels change between the ends of the range."
                }
                @if patterns.large_shrunk > 1 { " Large pictures are at 1/" (patterns.large_shrunk) " size, averaged over areas; the exact masks are in the run's files." }
            }
            @if let (Some(emission), Backlight::Lenslets(backlight)) = (&patterns.emission, &display.backlight) {
                @let [bins_x, bins_y] = backlight.views;
                h3 {
                    "Backlight" span {
                        "d = " (format::number(backlight.d_mm)) " mm · " (backlight.lenslets[0]) " × " (backlight.lenslets[1]) " lenslets of "
                        (format::number(backlight.pitch_mm)) " mm · " (bins_x) " × " (bins_y) " directions over " (format::number(backlight.fov_deg[0])) "° × " (format::number(backlight.fov_deg[1])) "°"
                    }
                }
                p { "Every lenslet is a tile of " (bins_x) " × " (bins_y) " pixels, one per direction, topmost and leftmost direction first." }
                (large(&emission.panel, "backlight"))
                (central_bin(emission))
                (close_up(&emission.panel, "backlight"))
            }
            @for (n, (sheet, layer)) in patterns.layers.iter().zip(&display.layers).enumerate() {
                h3 {
                    (name(n, display)) span {
                        "d = " (format::number(layer.d_mm)) " mm · " (layer.resolution[0]) " × " (layer.resolution[1]) " pixels of " (format::number(layer.pitch_mm)) " mm"
                    }
                }
                (large(sheet, &name(n, display)))
                (close_up(sheet, &name(n, display)))
            }
            @if frames > 1 {
                h3 { "All frames" }
                @if patterns.shrunk > 1 { p { "Shown at 1/" (patterns.shrunk) " size, averaged over areas, which blurs details of the close-ups." } }
                (flipper(display, patterns))
                @if let Some(emission) = &patterns.emission { (contact_sheet(&emission.panel, "backlight")) }
                @for (n, sheet) in patterns.layers.iter().enumerate() { (contact_sheet(sheet, &name(n, display))) }
            }
            (files(input))
        }
    }
}

/// Describes how values are shown as grey.
fn scale(display: &Display) -> &'static str {
    match display.formation {
        Formation::Attenuating => {
            "Patterns are linear transmittance, shown sRGB-encoded: black blocks light, white transmits it."
        }
        Formation::Additive => "Patterns are linear emission, shown sRGB-encoded: black is dark, white emits most.",
        Formation::Polarization => {
            "Patterns are rotations of polarization in units of 90°, shown sRGB-encoded: black is none, white a quarter turn."
        }
    }
}

/// Describes features that masks typically have on a display with this backlight, number of layers
/// and number of frames (section 3.4 of the paper).
fn expectation(display: &Display, frames: usize) -> &'static str {
    match (&display.backlight, display.layers.len(), frames) {
        (Backlight::Lenslets(_), _, _) => {
            "A layer should contain content that is equal in all views, with flowing slit-like patterns around all other content. The backlight should contain mostly content that changes with the view, such as objects far in front of or behind the display."
        }
        (Backlight::Uniform, 1, _) => {
            "One layer with a uniform backlight shows the same picture to every eye: expect the mean of all views."
        }
        (Backlight::Uniform, _, 1) => {
            "Objects near a layer should appear mostly on this layer. With one frame a single set of masks serves all views, so objects far from the display appear as blurred copies."
        }
        (Backlight::Uniform, _, _) => {
            "Objects near a layer should appear mostly on this layer, under fine patterns that change from frame to frame and act as content-adaptive barriers. The mean over frames shows the content of a layer; single frames show how the layer directs light."
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

/// Makes a group of all layers of one frame next to each other, with a slider for the frame. The
/// script copies the pictures from the contact sheets farther down.
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

/// Shows the mean of a layer, and its change over the frames.
fn large(sheet: &Sheet, name: &str) -> Markup {
    html! {
        div class="large group" {
            @match &sheet.change {
                None => (figure(&sheet.mean, &format!("{name}: its only frame"), "the only frame")),
                Some(change) => {
                    (figure(&sheet.mean, &format!("{name}: mean over frames"), "mean over frames"))
                    (figure(change, &format!("{name}: standard deviation over frames"), &format!("standard deviation over frames, × {CHANGE}")))
                }
            }
        }
    }
}

/// Shows a small section of every frame at full resolution. The section is the same in all frames.
fn close_up(sheet: &Sheet, name: &str) -> Markup {
    let Some(closeup) = &sheet.closeup else { return html! {} };
    let Window { row, col, rows, cols } = closeup.window;
    let stretched = closeup.stretch != [0.0, 1.0];
    let [low, high] = closeup.stretch.map(|value| format::number_short(f64::from(value)));
    let count = closeup.frames.len() + usize::from(closeup.mean.is_some());
    html! {
        p class="note" {
            "Close-up, pixel by pixel: columns " (col) " to " (col + cols - 1) ", rows " (row) " to " (row + rows - 1)
            @if closeup.mean.is_some() { ", where the differences between frames have the finest detail" }
            ". Only the green channel is shown, since the masks of the channels differ. "
            @if stretched { "Contrast stretched: " (low) " is black, " (high) " white." } @else { "Contrast is unchanged." }
        }
        div class="contact group" style=(format!("--across:{}", if count <= 8 { count.clamp(3, 4) } else { 5 })) {
            @if let Some(mean) = &closeup.mean { (figure(mean, &format!("{name}, close-up: mean over frames"), "mean over frames")) }
            @for (m, embedded) in closeup.frames.iter().enumerate() {
                (figure(embedded, &format!("{name}, close-up: frame {}", m + 1), &format!("frame {}", m + 1)))
            }
        }
    }
}

fn contact_sheet(sheet: &Sheet, name: &str) -> Markup {
    html! {
        p class="note" { (name) }
        div class="contact group" style=(across(sheet.frames.len())) data-sheet=(name) {
            @for (m, embedded) in sheet.frames.iter().enumerate() { (numbered(embedded, name, m)) }
        }
    }
}

/// Returns the style with the number of columns on a wide page: three to eight, such that all rows
/// are about equally long.
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
            p { "The backlight's emission straight ahead only (direction row " (row) ", column " (col) " counted from 0): one pixel per lenslet." }
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
            ul {
                @for output in input.outputs {
                    li {
                        @if let Some(reason) = &output.failed {
                            strong { (output.label) " was not written: " } (reason)
                        } @else {
                            a href=(format::relative_href(&output.path)) { (output.label) } " " code { (output.path) }
                        }
                    }
                }
            }
        }
    }
}
