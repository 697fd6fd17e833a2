//! `[importer]`, `[source]`, `[[nodes]]` and `[[outputs]]`: plugins of a job and their connections.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::display::DisplayJob;
use super::factorize::FactorizeJob;
use lumistack_core::path_text::is_default;

/// Settings of the scene's importer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImporterJob {
    /// If true, glTF files and files of importer plugins may refer to files outside of their
    /// folder.
    #[serde(default, skip_serializing_if = "is_default")]
    pub allow_outside: bool,
    /// Memory for the decoded pictures of a scene, MiB: 1 to 1048576. No effect on USD files.
    #[serde(default = "default_picture_mib")]
    pub picture_mib: u64,
    /// Id of the plugin; default: the plugin that reads files of this extension.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plugin: Option<String>,
    /// Parameters of the plugin.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

impl Default for ImporterJob {
    fn default() -> Self {
        Self { allow_outside: false, picture_mib: default_picture_mib(), plugin: None, params: Default::default() }
    }
}

fn default_picture_mib() -> u64 {
    lumistack_gltf::LoadOptions::default().max_picture_bytes >> 20
}

/// The plugin that makes the light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SourceJob {
    /// Id of a source plugin.
    pub plugin: String,
    /// Number of the time step; in a sequence, of the first time step.
    #[serde(default, skip_serializing_if = "is_default")]
    pub time: u64,
    /// Time of the time step, seconds; in a sequence, of the first time step.
    #[serde(default, skip_serializing_if = "is_default")]
    pub time_s: f64,
    /// Parameters of the plugin.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

/// A node: it makes the patterns of a display from the light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeJob {
    /// Name of the node and of its folder, unique in the job.
    pub id: String,
    /// Id of a node plugin (see `lumistack plugins`), or `tensor-display` for the built-in
    /// factorizer.
    #[serde(default = "default_node")]
    pub plugin: String,
    /// Display of the node. Its resolution and views become those of the light field. Default: the
    /// display of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub display: Option<DisplayJob>,
    /// Factorizer settings of a `tensor-display`. Default: the factorizer settings of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factorize: Option<FactorizeJob>,
    /// Parameters of a node plugin.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub params: serde_json::Map<String, serde_json::Value>,
}

impl NodeJob {
    /// Name of the built-in factorizer as a node of a job. Its parameters are in `factorize`.
    pub const TENSOR_DISPLAY: &'static str = "tensor-display";
}

fn default_node() -> String {
    NodeJob::TENSOR_DISPLAY.into()
}

/// An output plugin and its input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OutputJob {
    /// Id of the plugin; see `lumistack plugins`.
    pub plugin: String,
    /// Name of the output's folder; default: the plugin's id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Input of the output: `light_field` or the id of a node. Default: the patterns. A job with
    /// several nodes needs this key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// Parameters of the plugin.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

impl OutputJob {
    /// Value of `from` if the input is the light field itself.
    pub const LIGHT_FIELD: &'static str = "light_field";

    /// Returns an output with default parameters.
    pub fn new(plugin: &str) -> Self {
        Self { plugin: plugin.into(), name: None, from: None, params: serde_json::Map::new() }
    }

    /// Returns true if the input is the light field, not patterns.
    pub(crate) fn takes_light_field(&self) -> bool {
        self.from.as_deref() == Some(Self::LIGHT_FIELD)
    }

    /// Returns the name of the output's folder.
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.plugin)
    }
}
