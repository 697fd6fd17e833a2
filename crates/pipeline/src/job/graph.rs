//! `[importer]`, `[source]`, `[[nodes]]` and `[[outputs]]`: the plugins of a job and what joins them.

use serde::{Deserialize, Serialize};

use super::{DisplayJob, FactorizeJob, Job, is_default};
use crate::error::PipelineError;

/// How the scene's files are read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImporterJob {
    /// Whether glTF and OBJ files may name files outside of their own folder.
    #[serde(default, skip_serializing_if = "is_default")]
    pub allow_outside: bool,
    /// Memory for the decoded pictures of a glTF or OBJ scene, MiB: 1 to 1048576.
    #[serde(default = "default_picture_mib")]
    pub picture_mib: u64,
    /// Id of the plugin; default: the one that takes files of this extension.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plugin: Option<String>,
    /// Its parameters.
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

/// Which plugin makes the light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceJob {
    /// Id of a source plugin.
    pub plugin: String,
    /// Number of the time that it makes; a sequence counts on from it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub time: u64,
    /// The time in seconds.
    #[serde(default, skip_serializing_if = "is_default")]
    pub time_s: f64,
    /// Its parameters.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

/// What makes a layer stack from the light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeJob {
    /// Name, unique in the job; also that of its folder.
    pub id: String,
    /// The id of a node plugin; see `lumistack plugins`.
    #[serde(default = "default_node")]
    pub plugin: String,
    /// Its display, which takes the light field's resolution and views; default: the job's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub display: Option<DisplayJob>,
    /// Factorizer of `tensor-display`; default: the job's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factorize: Option<FactorizeJob>,
    /// Parameters of a node plugin.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub params: serde_json::Map<String, serde_json::Value>,
}

impl NodeJob {
    /// The factorizer, whose parameters are the table `factorize`.
    pub const TENSOR_DISPLAY: &'static str = "tensor-display";
}

fn default_node() -> String {
    NodeJob::TENSOR_DISPLAY.into()
}

/// One output plugin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputJob {
    /// Id of the plugin; see `lumistack plugins`.
    pub plugin: String,
    /// Name of its folder; default: the plugin's id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// What it takes: `light_field`, or a node; default: the one node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// Its parameters.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

impl OutputJob {
    /// `from` of an output that takes the light field itself.
    pub const LIGHT_FIELD: &'static str = "light_field";

    /// An output with default parameters.
    pub fn new(plugin: &str) -> Self {
        Self { plugin: plugin.into(), name: None, from: None, params: serde_json::Map::new() }
    }

    /// Name of its folder.
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.plugin)
    }
}

/// Whether a text can be a folder on every system.
fn is_folder_name(name: &str) -> bool {
    !name.is_empty() && name.len() <= 100 && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
}

impl Job {
    /// Checks that nodes and outputs have names of their own, and that every output takes something that is there.
    pub(super) fn check_graph(&self) -> Result<(), PipelineError> {
        let fail = |key: String, expected: &str, found: String| Err(PipelineError::value("job", key, expected, found));
        if !self.nodes.is_empty() && self.sequence.is_some() {
            return fail("nodes".into(), "either `nodes` or `sequence`", "both".into());
        }
        let mut ids: Vec<&str> = Vec::new();
        for (i, node) in self.nodes.iter().enumerate() {
            if !is_folder_name(&node.id) || node.id == OutputJob::LIGHT_FIELD || ids.contains(&node.id.as_str()) {
                let expected = "a name of its own: letters, digits, `-` and `_`, and not `light_field`";
                return fail(format!("nodes[{i}].id"), expected, format!("`{}`", node.id));
            }
            ids.push(&node.id);
            let (unused, owner) = match (node.plugin == NodeJob::TENSOR_DISPLAY, &node.factorize) {
                (true, _) if !node.params.is_empty() => ("params", "a node plugin"),
                (false, Some(_)) => ("factorize", "`tensor-display`"),
                _ => continue,
            };
            return fail(format!("nodes[{i}].{unused}"), &format!("nothing, as only {owner} has it"), "a table".into());
        }
        if self.nodes.is_empty() {
            ids.push(NodeJob::TENSOR_DISPLAY);
        }
        let mut taken: Vec<(&str, &str)> = Vec::new();
        for (i, output) in self.outputs.iter().enumerate() {
            let known = || format!("`{}` or one of {}", OutputJob::LIGHT_FIELD, ids.join(", "));
            let from = match (&output.from, ids.as_slice()) {
                (Some(from), _) if from == OutputJob::LIGHT_FIELD || ids.contains(&from.as_str()) => from.as_str(),
                (Some(from), _) => return fail(format!("outputs[{i}].from"), &known(), format!("`{from}`")),
                (None, [only]) => only,
                (None, _) => return fail(format!("outputs[{i}].from"), &known(), "nothing".into()),
            };
            if !is_folder_name(output.name()) {
                return fail(
                    format!("outputs[{i}].name"),
                    "letters, digits, `-` and `_`",
                    format!("`{}`", output.name()),
                );
            }
            if taken.contains(&(from, output.name())) {
                let expected = "a `name` of its own beside another of the same plugin";
                return fail(format!("outputs[{i}]"), expected, format!("`{}` twice", output.name()));
            }
            taken.push((from, output.name()));
        }
        Ok(())
    }

    /// The plugins of the job: their place in it, id and parameters. The id of an importer that is chosen by the scene's extension is empty.
    pub(crate) fn plugins_mut(
        &mut self,
    ) -> impl Iterator<Item = (String, &str, &mut serde_json::Map<String, serde_json::Value>)> {
        let importer = self.importer.plugin.as_deref().unwrap_or_default();
        let importer = [("importer".into(), importer, &mut self.importer.params)];
        let source = self.source.iter_mut().map(|job| ("source".into(), job.plugin.as_str(), &mut job.params));
        let nodes = self.nodes.iter_mut().enumerate().filter(|(_, node)| node.plugin != NodeJob::TENSOR_DISPLAY);
        let nodes = nodes.map(|(i, job)| (format!("nodes[{i}]"), job.plugin.as_str(), &mut job.params));
        let outputs = self.outputs.iter_mut().enumerate();
        let outputs = outputs.map(|(i, job)| (format!("outputs[{i}]"), job.plugin.as_str(), &mut job.params));
        importer.into_iter().chain(source).chain(nodes).chain(outputs)
    }

    /// The outputs that take what `from` makes.
    pub(crate) fn outputs_of(&self, from: &str) -> impl Iterator<Item = &OutputJob> {
        let only = self.nodes.len() < 2;
        self.outputs
            .iter()
            .filter(move |output| output.from.as_deref().map_or(only && from != OutputJob::LIGHT_FIELD, |f| f == from))
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::config;

    use super::*;

    #[test]
    fn a_graph_names_what_it_joins() {
        let job = |text: &str| {
            let job: Job = config::parse(&format!("scene = \"a.glb\"\n{text}")).unwrap();
            job.check().map(|()| job).map_err(|error| error.to_string())
        };
        let display = "[display]\npreset = \"fig7-uniform\"\n";
        let nodes = format!("{display}[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\nplugin = \"parallax_barrier\"\n");
        let output = |keys: &str| format!("[[outputs]]\nplugin = \"images\"\n{keys}\n");
        let graph = job(&format!("{nodes}{}{}", output("from = \"a\""), output("from = \"light_field\""))).unwrap();
        assert_eq!(["a", "b", "light_field"].map(|from| graph.outputs_of(from).count()), [1, 0, 1]);
        assert_eq!(config::parse::<Job>(&graph.to_toml()).unwrap(), graph);
        let plain = job(&format!("{display}{}", output("name = \"other\""))).unwrap();
        assert_eq!(["tensor-display", "light_field"].map(|from| plain.outputs_of(from).count()), [1, 0]);
        for (text, message) in [
            (format!("{nodes}{}", output("")), "outputs[0].from: expected `light_field` or one of a, b, found nothing"),
            (
                format!("{nodes}{}", output("from = \"c\"")),
                "outputs[0].from: expected `light_field` or one of a, b, found `c`",
            ),
            (format!("{nodes}[[nodes]]\nid = \"a\"\n"), "nodes[2].id: expected a name of its own"),
            (format!("{nodes}[[nodes]]\nid = \"../a\"\n"), "nodes[2].id: expected a name of its own"),
            (
                format!("{nodes}params = {{ x = 1 }}\nfactorize = {{ }}\n"),
                "nodes[1].factorize: expected nothing, as only `tensor-display` has it",
            ),
            (format!("{display}{}{}", output(""), output("")), "outputs[1]: expected a `name` of its own"),
            (format!("{display}{}", output("name = \"a/b\"")), "outputs[0].name: expected letters"),
            (format!("{nodes}[sequence]\ntimes = 2\n"), "nodes: expected either `nodes` or `sequence`, found both"),
        ] {
            let error = job(&text).unwrap_err();
            assert!(error.contains(message), "{error}\n{message}");
        }
    }
}
