//! The report of a job with several nodes for one light field: a page with all displays.
//!
//! # report.json
//!
//! | key | value |
//! |---|---|
//! | `schema`, `version` | `"lumistack/graph-report"`, 1 |
//! | `title`, `lumistack_version`, `command` | texts; `command` may be null |
//! | `psnr_view` | dB, of the first node |
//! | `nodes` | list of `id`, `plugin`, `display`, `report` (path), `psnr_view`, `psnr_raw`, `held_out_psnr_view`, `psnr_zone`, `brightness`, `layers`, `frames`, `seconds`, `outputs` (paths of files written) |
//! | `outputs` | paths of files written for the light field itself |
//! | `settings`, `warnings` | the resolved job; list of `place`, `message` |

use lumistack_core::Warning;
use serde_json::{Value, json};

use crate::format::figure;
use crate::{Output, ReportError, Thumbnail, page};

/// One node of the job.
#[derive(Clone, Debug)]
pub struct GraphNode {
    /// Id of the node in the job.
    pub id: String,
    /// The plugin that made the node's patterns.
    pub plugin: String,
    /// Name of the node's display.
    pub display: String,
    /// Path of the node's report, relative to this report.
    pub report: String,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of L̃ against βL, dB.
    pub psnr_raw: f64,
    /// PSNR of L̃/β against L at held-out views, dB.
    pub held_out_psnr_view: Option<f64>,
    /// Zone score: PSNR of seen pictures over the whole zone, dB.
    pub psnr_zone: Option<f64>,
    /// Brightness scale β.
    pub brightness: f64,
    /// Number of layers.
    pub layers: usize,
    /// Number of frames.
    pub frames: usize,
    /// Time from the light field to the outputs, seconds.
    pub seconds: f64,
    /// Files written for the node; paths are relative to this report.
    pub outputs: Vec<Output>,
    /// Central view of the display, L̃/β.
    pub shown: Thumbnail,
}

/// Input of the graph report.
#[derive(Clone, Copy, Debug)]
pub struct GraphInput<'a> {
    /// Title.
    pub title: &'a str,
    /// Central view of the light field.
    pub wanted: &'a Thumbnail,
    /// All nodes, in the order of the job.
    pub nodes: &'a [GraphNode],
    /// Files written for the light field itself.
    pub outputs: &'a [Output],
    /// The resolved job.
    pub settings: &'a Value,
    /// Warnings of the whole run.
    pub warnings: &'a [Warning],
    /// The command line of the run.
    pub command: Option<&'a str>,
    /// Version of Lumistack.
    pub version: &'a str,
}

/// Makes the two files of the report, `report.html` and `report.json`, as texts. Writes no files.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn graph(input: &GraphInput) -> Result<(String, Value), ReportError> {
    let paths = |outputs: &[Output]| {
        let written = outputs.iter().filter(|output| output.failed.is_none());
        written.map(|output| output.path.clone()).collect::<Vec<_>>()
    };
    let json = json!({
        "schema": "lumistack/graph-report",
        "version": 1,
        "title": input.title,
        "lumistack_version": input.version,
        "command": input.command,
        "psnr_view": input.nodes.first().map(|node| figure(node.psnr_view)),
        "nodes": input.nodes.iter().map(|node| json!({
            "id": node.id,
            "plugin": node.plugin,
            "display": node.display,
            "report": node.report,
            "psnr_view": figure(node.psnr_view),
            "psnr_raw": figure(node.psnr_raw),
            "held_out_psnr_view": node.held_out_psnr_view.map(figure),
            "psnr_zone": node.psnr_zone.map(figure),
            "brightness": figure(node.brightness),
            "layers": node.layers,
            "frames": node.frames,
            "seconds": figure(node.seconds),
            "outputs": paths(&node.outputs),
        })).collect::<Vec<_>>(),
        "outputs": paths(input.outputs),
        "settings": input.settings,
        "warnings": input.warnings.iter().map(|w| json!({"place": w.place, "message": w.message})).collect::<Vec<_>>(),
    });
    Ok((page::graph::render(input)?, json))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_node_is_linked_and_listed() {
        let thumbnail = Thumbnail::new([1, 2], &[0.5; 6], 1.0);
        let output = |path: &str| Output { label: "images, 3 files".into(), path: path.into(), failed: None };
        let node = |id: &str, psnr_view: f64| GraphNode {
            id: id.into(),
            plugin: "tensor-display".into(),
            display: "two <layers>".into(),
            report: format!("nodes/{id}/report.html"),
            psnr_view,
            psnr_raw: 30.0,
            held_out_psnr_view: None,
            psnr_zone: None,
            brightness: 0.25,
            layers: 2,
            frames: 3,
            seconds: 1.0,
            outputs: vec![output(&format!("outputs/{id}/images"))],
            shown: thumbnail.clone(),
        };
        let nodes = [node("a", 21.5), node("b", f64::INFINITY)];
        let input = GraphInput {
            title: "both",
            wanted: &thumbnail,
            nodes: &nodes,
            outputs: &[output("outputs/light_field/images")],
            settings: &json!({"name": "both"}),
            warnings: &[Warning { place: "here".into(), message: "look".into() }],
            command: Some("lumistack run both.toml"),
            version: "0.0.0",
        };
        let (html, json) = graph(&input).unwrap();
        for text in [
            "href=\"./nodes/a/report.html\"",
            "href=\"./nodes/b/report.html\"",
            "href=\"./outputs/b/images\"",
            "href=\"./outputs/light_field/images\"",
            "two &lt;layers&gt;",
            "look",
            "21.5",
        ] {
            assert!(html.contains(text), "{text}");
        }
        for picture in ["target", "a", "b"] {
            assert_eq!(html.matches(&format!("alt=\"{picture}\"")).count(), 1, "{picture}");
        }
        assert_eq!((&json["psnr_view"], &json["nodes"][0]["outputs"][0]), (&json!(21.5), &json!("outputs/a/images")));
        assert_eq!(json["nodes"].as_array().unwrap().len(), 2);
    }
}
