//! The display, the job, the scene, warnings and versions.

use lumistack_core::Warning;
use lumistack_display::{
    Backlight, ColourSequence, Display, Formation, Layer, LayerColour, Missing, OutsideBins, Projection, Sampling,
    Transfer,
};
use maud::{Markup, html};
use serde_json::Value;

use crate::{ReportInput, format};

/// Lists with more entries than this are collapsed at first.
const FOLD: usize = 60;

/// Lists warnings above the pictures, since they may explain errors of the pictures.
pub(super) fn warnings(warnings: &[Warning]) -> Markup {
    html! {
        @if !warnings.is_empty() {
            details class="warnings" open[warnings.len() <= 5] {
                summary { (format::counted(warnings.len(), "warning")) }
                ul { @for warning in warnings { li { code { (warning.place) } " " (warning.message) } } }
            }
        }
    }
}

/// Makes the last section of the page: display, job, scene and versions.
pub(super) fn section(input: &ReportInput) -> Markup {
    html! {
        section id="settings" {
            h2 { "Settings" }
            @if let Some(command) = input.command { p { "Made by " code { (command) } " with Lumistack " (input.version) "." } }
            (display(input))
            @if let Some(scene) = input.scene { (facts("Scene", scene)) }
            (facts("Job with all defaults", input.settings))
        }
    }
}

fn display(input: &ReportInput) -> Markup {
    let display = input.display;
    html! {
        h3 { "Display" span { (display.name) } }
        table class="facts" { @for (name, value) in display_facts(input) { tr { th scope="row" { (name) } td { (value) } } } }
        div class="scroll" {
            table class="layers" {
                thead { tr { @for name in ["layer", "d, mm", "pixels", "pitch, mm", "size, mm", "offset, mm", "range", "bits", "transfer", "blur, px", "colour"] { th scope="col" { (name) } } } }
                tbody {
                    @for (n, layer) in display.layers.iter().enumerate() {
                        @let [cols, rows] = layer.resolution;
                        tr {
                            td { (n) }
                            td { (format::number(layer.d_mm)) }
                            td { (cols) " × " (rows) }
                            td { (format::number(layer.pitch_mm)) }
                            td { (format::number(cols as f64 * layer.pitch_mm)) " × " (format::number(rows as f64 * layer.pitch_mm)) }
                            td { (format::number(layer.offset_mm[0])) ", " (format::number(layer.offset_mm[1])) }
                            td { @let [low, high] = layer.range(); (format::number(low.into())) " to " (format::number(high.into())) }
                            td { @match layer.bits { Some(bits) => (bits), None => "–" } }
                            td { @match &layer.transfer { Transfer::Srgb => "sRGB", Transfer::Linear => "linear", Transfer::Gamma(gamma) => { "gamma " (gamma.iter().map(|gamma| format::number(*gamma)).collect::<Vec<_>>().join(", ")) }, Transfer::Table(_) => "measured" } }
                            td { (format::number(layer.blur_px)) }
                            td { (colour(layer)) }
                        }
                    }
                }
            }
        }
    }
}

fn colour(layer: &Layer) -> String {
    let mut parts = vec![match layer.colour {
        LayerColour::Rgb => "RGB",
        LayerColour::Mono => "mono",
    }];
    parts.extend((!layer.filters.is_empty()).then_some("colour filters"));
    parts.extend(layer.crosstalk.map(|_| "crosstalk"));
    parts.join(", ")
}

fn display_facts(input: &ReportInput) -> Vec<(&'static str, String)> {
    let display = input.display;
    let geometry = input.target.geometry();
    let [width_mm, height_mm] = geometry.size_mm().map(format::number);
    let range = |slopes: &[f64]| {
        let (low, high) = slopes.iter().fold((f64::MAX, f64::MIN), |(low, high), s| (low.min(*s), high.max(*s)));
        format!("{} to {}", format::angle(low), format::angle(high))
    };
    let projection = match geometry.grid.projection {
        Projection::Oblique => "oblique (parallel projections)".into(),
        Projection::Perspective { distance_mm } => format!("perspective from {} mm", format::number(distance_mm)),
    };
    let [rows, cols] = geometry.grid.views();
    vec![
        (
            "light field",
            format!(
                "{} × {} pixels of {} mm: {width_mm} × {height_mm} mm",
                geometry.cols,
                geometry.rows,
                format::number(geometry.pitch_mm)
            ),
        ),
        (
            "views",
            format!("{cols} across, {} · {rows} up, {}", range(&geometry.grid.slope_x), range(&geometry.grid.slope_y)),
        ),
        ("projection", projection),
        (
            "image formation",
            match display.formation {
                Formation::Attenuating => "attenuating: the product of the layers' transmittances",
                Formation::Additive => "additive: the sum of the layers' emissions",
                Formation::Polarization => "polarization: sin² of the summed rotation",
            }
            .into(),
        ),
        ("frames", frames(display)),
        ("brightness β", format::number(input.stack.brightness)),
        ("backlight", backlight(display)),
        (
            "sampling",
            match display.sampling {
                Sampling::Nearest => "nearest pixel",
                Sampling::Bilinear => "bilinear",
            }
            .into(),
        ),
        (
            "rays that leave a layer",
            match display.missing {
                Missing::Drop => "are excluded (drop)",
                Missing::Clear => "are not attenuated by this layer (clear)",
            }
            .into(),
        ),
    ]
}

fn frames(display: &Display) -> String {
    let colours = match display.colour_sequence {
        ColourSequence::Simultaneous => "",
        ColourSequence::Field => ", each in 3 colours in turn,",
    };
    format!(
        "{}{colours} at {} Hz: all frames are shown {} times per second{}",
        display.frames,
        format::number(display.refresh_hz),
        format::number(display.period_hz()),
        if display.flicker_warning().is_some() { ", so the display flickers" } else { "" }
    )
}

fn backlight(display: &Display) -> String {
    match &display.backlight {
        Backlight::Uniform => "uniform".into(),
        Backlight::Lenslets(b) => format!(
            "{} × {} lenslets of {} mm at d = {} mm, {} × {} directions over {}° × {}°, {} outside of these angles",
            b.lenslets[0],
            b.lenslets[1],
            format::number(b.pitch_mm),
            format::number(b.d_mm),
            b.views[0],
            b.views[1],
            format::number(b.fov_deg[0]),
            format::number(b.fov_deg[1]),
            match b.outside_bins {
                OutsideBins::Dark => "dark",
                OutsideBins::Repeat => "repeated",
            }
        ),
    }
}

/// Shows any JSON value as a table. A key inside of other tables is written with dots.
pub(super) fn facts(name: &str, value: &Value) -> Markup {
    let mut rows = Vec::new();
    flatten(String::new(), value, &mut rows);
    html! {
        @if !rows.is_empty() {
            details open[rows.len() <= FOLD] {
                summary { h3 { (name) } }
                table class="facts" { @for (key, value) in &rows { tr { th scope="row" { (key) } td { (value) } } } }
            }
        }
    }
}

fn flatten(key: String, value: &Value, rows: &mut Vec<(String, String)>) {
    let scalar = |value: &Value| !value.is_object() && !value.is_array();
    match value {
        Value::Object(map) => map.iter().for_each(|(name, value)| {
            flatten(if key.is_empty() { name.clone() } else { format!("{key}.{name}") }, value, rows);
        }),
        Value::Array(list) if !list.iter().all(scalar) => {
            list.iter().enumerate().for_each(|(i, value)| flatten(format!("{key}[{i}]"), value, rows));
        }
        Value::Array(list) => rows.push((key, list.iter().map(text).collect::<Vec<_>>().join(", "))),
        Value::Null if key.is_empty() => {}
        scalar => rows.push((key, text(scalar))),
    }
}

fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "none".into(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nested_settings_become_dotted_keys() {
        let mut rows = Vec::new();
        let value =
            serde_json::json!({"solver": {"iterations": 50, "seed": null}, "fov": [20, 30], "nodes": [{"id": "a"}]});
        flatten(String::new(), &value, &mut rows);
        let rows: Vec<_> = rows.iter().map(|(k, v)| (k.as_str(), v.as_str())).collect();
        assert_eq!(
            rows,
            [("solver.iterations", "50"), ("solver.seed", "none"), ("fov", "20, 30"), ("nodes[0].id", "a")]
        );
    }
}
