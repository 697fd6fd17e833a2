//! The page of a job with several nodes.

use maud::{Markup, html};

use super::{document, picture, settings};
use crate::graph::{GraphInput, GraphNode};
use crate::{Output, ReportError, format};

pub(crate) fn render(input: &GraphInput) -> Result<String, ReportError> {
    let header = html! {
        h1 { (input.title) }
        p { "One light field on " (format::counted(input.nodes.len(), "display")) "." }
        (settings::warnings(input.warnings))
    };
    let main = html! {
        (pictures(input)?)
        (table(input.nodes))
        @if !input.outputs.is_empty() {
            section id="outputs" {
                h2 { "Outputs of the light field" }
                (links(input.outputs))
            }
        }
        section id="settings" {
            h2 { "Settings" }
            @if let Some(command) = input.command { p { "Made by " code { (command) } " with Lumistack " (input.version) "." } }
            (settings::facts("Job with all defaults", input.settings))
        }
    };
    Ok(document(input.title, input.version, &header, &main))
}

/// Shows central views: the view of the target, and the view of every display.
fn pictures(input: &GraphInput) -> Result<Markup, ReportError> {
    let mut shown = Vec::new();
    for node in input.nodes {
        shown.push((node, node.shown.embedded()?));
    }
    let wanted = input.wanted.embedded()?;
    Ok(html! {
        section id="views" class="headline" {
            h2 { "Central view" }
            p { "The target, and each display's view (divided by its β, clamped to 0..1 and sRGB-encoded)." }
            div class="times" style=(format!("--across:{}", shown.len() + 1)) {
                div class="group" {
                    (picture(&wanted, "target"))
                    @for (node, shown) in &shown { (picture(shown, &node.id)) }
                }
                div class="group" {
                    span { "target" }
                    @for (node, _) in &shown { span { (node.id) } }
                }
            }
        }
    })
}

fn table(nodes: &[GraphNode]) -> Markup {
    let names = [
        "node",
        "made by",
        "display",
        "layers",
        "frames",
        "β",
        "psnr_zone, dB",
        "psnr_view, dB",
        "psnr_raw, dB",
        "in between, dB",
        "time",
        "outputs",
    ];
    html! {
        section id="nodes" {
            h2 { "Every display" }
            p { "psnr_zone is the PSNR of seen pictures over the whole zone. psnr_view compares the view of an adapted viewer, L̃/β, with the light field; psnr_raw compares the emitted light L̃ with βL." }
            div class="scroll" {
                table class="layers nodes" {
                    thead { tr { @for name in names { th scope="col" { (name) } } } }
                    tbody {
                        @for node in nodes {
                            tr {
                                td { a href=(format::relative_href(&node.report)) { (node.id) } }
                                td { (node.plugin) }
                                td { (node.display) }
                                td { (node.layers) }
                                td { (node.frames) }
                                td { (format::number(node.brightness)) }
                                td { (node.psnr_zone.map_or("–".into(), format::decibels)) }
                                td { (format::decibels(node.psnr_view)) }
                                td { (format::decibels(node.psnr_raw)) }
                                td { (node.held_out_psnr_view.map_or("–".into(), format::decibels)) }
                                td { (format::duration(node.seconds)) }
                                td { (links(&node.outputs)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn links(outputs: &[Output]) -> Markup {
    html! {
        @for (i, output) in outputs.iter().enumerate() {
            @if i > 0 { br; }
            @if let Some(reason) = &output.failed {
                strong { (output.label) " was not written: " } (reason)
            } @else {
                a href=(format::relative_href(&output.path)) { (output.label) }
            }
        }
    }
}
