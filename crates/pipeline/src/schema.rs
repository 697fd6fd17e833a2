//! JSON Schemas of job and display files, for completion and checks in editors.
//!
//! Structure, defaults and descriptions come from the types that read the files. Parameters of
//! plugins come from the declarations of the plugins, with their ranges. For most other keys, the
//! schema states no range, except the minimum 0 of unsigned integers. The program checks all
//! ranges.

use lumistack_display::Display;
use lumistack_plugin_host::{Kind, Param, PluginInfo, Registry};
use schemars::generate::SchemaSettings;
use schemars::transform::{Transform, transform_subschemas};
use schemars::{JsonSchema, Schema};
use serde_json::{Map, Value, json};

use crate::job::Job;

/// Generates a schema of draft 7, which TOML editors support.
fn made<T: JsonSchema>(title: &str) -> Schema {
    let mut schema = SchemaSettings::draft07().into_generator().into_root_schema_for::<T>();
    let _ = schema.insert("title".into(), title.into());
    Editors.transform(&mut schema);
    schema
}

/// Returns the schema of display files.
pub fn display() -> Schema {
    made::<Display>("Lumistack display")
}

/// Returns the schema of job files, with the parameters of all loaded plugins.
pub fn job(registry: &Registry) -> Schema {
    let mut schema = made::<Job>("Lumistack job");
    for definition in ["ImporterJob", "SourceJob", "NodeJob", "OutputJob"] {
        let kind = definition.trim_end_matches("Job").to_lowercase();
        let of_kind = registry.infos().filter(|info| json!(info.kind) == kind).map(parameters).collect::<Vec<_>>();
        if let Some(table) = schema.pointer_mut(&format!("/definitions/{definition}")) {
            table["allOf"] = of_kind.into();
        }
    }
    schema
}

/// Returns a rule of the schema: if the key `plugin` has this plugin's id, the table has the
/// plugin's parameters.
fn parameters(info: &PluginInfo) -> Value {
    let properties: Map<String, Value> =
        info.schema.params.iter().map(|param| (param.name.clone(), parameter(param))).collect();
    json!({
        "if": { "required": ["plugin"], "properties": { "plugin": { "const": info.id } } },
        "then": { "properties": { "params": { "properties": properties, "additionalProperties": false } } },
    })
}

fn parameter(param: &Param) -> Value {
    let mut schema = match &param.kind {
        Kind::Bool { .. } => json!({ "type": "boolean" }),
        Kind::Int { min, max, .. } => json!({ "type": "integer", "minimum": min, "maximum": max }),
        Kind::Float { min, max, .. } => json!({ "type": "number", "minimum": min, "maximum": max }),
        Kind::Choice { options, .. } => {
            json!({ "enum": options.iter().map(|option| &option.value).collect::<Vec<_>>() })
        }
        Kind::Text { .. } | Kind::File => json!({ "type": "string" }),
    };
    let unit = param.unit.as_ref().filter(|unit| *unit != "1").map_or(String::new(), |unit| format!(" Unit: {unit}."));
    schema["description"] = format!("{}{unit}", param.help).into();
    schema["default"] = param.default_value();
    schema
}

/// Adapts schemas of Rust types for editors of files. Removes links to Rust documentation, null
/// values, and sizes of integers.
struct Editors;

impl Transform for Editors {
    fn transform(&mut self, schema: &mut Schema) {
        if let Some(text) = schema.get("description").and_then(Value::as_str).map(plain) {
            let _ = schema.insert("description".into(), text.into());
        }
        // `format` states the size of an integer in memory, which an author of files need not know.
        let _ = schema.remove("format");
        // TOML has no null: optional keys are absent instead.
        if let Some(kinds) = schema.get_mut("type").and_then(Value::as_array_mut) {
            kinds.retain(|kind| kind != "null");
            if let [kind] = kinds.as_slice() {
                let kind = kind.clone();
                let _ = schema.insert("type".into(), kind);
            }
        }
        if let Some(forms) = schema.get_mut("anyOf").and_then(Value::as_array_mut) {
            forms.retain(|form| form["type"] != "null");
        }
        if schema.get("default").is_some_and(Value::is_null) {
            let _ = schema.remove("default");
        }
        transform_subschemas(self, schema);
    }
}

/// Removes rustdoc links from Markdown: ``[`Shared`](Self::Shared)`` becomes `` `Shared` ``.
fn plain(text: &str) -> String {
    let mut plain = String::new();
    let mut rest = text;
    while let Some(start) = rest.find("[`") {
        let (before, link) = rest.split_at(start);
        plain.push_str(before);
        let Some(end) = link.find("`]") else {
            rest = link;
            break;
        };
        plain.push_str(&link[1..=end]);
        rest = &link[end + 2..];
        if let Some(target) = rest.strip_prefix('(') {
            rest = target.split_once(')').map_or(rest, |(_, after)| after);
        }
    }
    plain + rest
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn links_of_rust_are_no_part_of_a_description() {
        assert_eq!(
            plain("As [`Compress`](Self::Compress), [x, y] of `a`, or [`B`]."),
            "As `Compress`, [x, y] of `a`, or `B`."
        );
    }

    #[test]
    fn committed_schemas_are_those_of_the_types() {
        let registry = Registry::built_in().unwrap();
        for (name, schema) in [("job", job(&registry)), ("display", display())] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../docs/schema/{name}.json"));
            let made = format!("{}\n", serde_json::to_string_pretty(&schema).unwrap());
            if std::env::var_os("LUMISTACK_WRITE").is_some() {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(&path, &made).unwrap();
            }
            let committed = std::fs::read_to_string(&path).unwrap_or_default();
            assert!(
                committed == made,
                "docs/schema/{name}.json does not match the types: LUMISTACK_WRITE=1 cargo test -p lumistack-pipeline schema:: writes it"
            );
        }
    }

    /// A schema without restrictions would also accept valid files, so this test checks that
    /// restrictions exist.
    #[test]
    fn a_table_of_a_job_knows_its_keys_and_its_plugins() {
        let schema = job(&Registry::built_in().unwrap());
        let at = |pointer: &str| schema.pointer(pointer).unwrap_or_else(|| panic!("{pointer}"));
        assert_eq!(at("/additionalProperties"), false);
        assert_eq!(at("/definitions/RenderJob/properties/max_bounces/default"), 6);
        assert!(at("/definitions/DisplayJob/properties/preset/enum").as_array().unwrap().len() > 10);
        assert_eq!(at("/required"), &json!(["display"]));
        let outputs = at("/definitions/OutputJob/allOf").as_array().unwrap();
        let images = outputs.iter().find(|form| form["if"]["properties"]["plugin"]["const"] == "images").unwrap();
        assert_eq!(images["then"]["properties"]["params"]["properties"]["png8"]["type"], "boolean");
    }
}
