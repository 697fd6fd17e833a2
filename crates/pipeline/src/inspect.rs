//! Descriptions for the command line and other front ends: light fields and plugins.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_field_io::{Description, GeometryFlags};
use lumistack_plugin_host::{Kind, Origin, Param, PluginInfo, Registry};

use crate::error::{PipelineError, field_error};

/// Describes the light field in a file or folder.
///
/// # Errors
/// If it cannot be read.
pub fn describe_light_field(path: &Path, flags: &GeometryFlags, task: Task<'_>) -> Result<Description, PipelineError> {
    lumistack_field_io::describe(path, flags, task).map_err(field_error)
}

/// Loads the built-in plugins. With the feature `dynamic`, this function also loads plugins from
/// libraries. It looks for libraries in `paths`, then in the paths of the environment variable
/// `LUMISTACK_PLUGIN_PATH`, then in the user's data folder.
///
/// # Errors
/// If the description of a built-in plugin is wrong.
pub fn plugins(paths: &[PathBuf]) -> Result<Registry, PipelineError> {
    #[cfg_attr(not(feature = "dynamic"), expect(unused_mut, reason = "only libraries are added"))]
    let mut registry = Registry::built_in().map_err(PipelineError::Output)?;
    #[cfg(feature = "dynamic")]
    registry.load(&lumistack_plugin_host::PluginPaths::of_system(paths));
    #[cfg(not(feature = "dynamic"))]
    let _ = paths;
    Ok(registry)
}

/// Returns the plugins of `ids` as JSON, with their parameters and origins. If `ids` is empty,
/// returns all plugins, and the errors of libraries that could not be loaded.
///
/// # Errors
/// If an id belongs to no plugin, or to a plugin whose library cannot be used.
pub fn plugin_list(registry: &Registry, ids: &[String]) -> Result<serde_json::Value, PipelineError> {
    let plugins = chosen(registry, ids)?.into_iter().map(|(info, origin)| {
        let mut plugin = serde_json::to_value(info).expect("descriptions serialize");
        plugin["origin"] = origin.to_string().into();
        plugin
    });
    let plugins: Vec<_> = plugins.collect();
    let failed = failed(registry, ids);
    Ok(serde_json::json!({ "plugins": plugins, "failed": failed }))
}

/// Returns the plugins of `ids` and their origins; all plugins if `ids` is empty.
fn chosen<'a>(registry: &'a Registry, ids: &[String]) -> Result<Vec<(&'a PluginInfo, &'a Origin)>, PipelineError> {
    if ids.is_empty() {
        return Ok(registry.entries().collect());
    }
    let one = |id: &String| {
        let info = registry.get(id).map_err(PipelineError::Output)?.info();
        Ok((info, registry.origin(id).expect("every plugin has an origin")))
    };
    ids.iter().map(one).collect()
}

/// Returns the errors of libraries that could not be loaded; empty if plugins are requested by id.
fn failed(registry: &Registry, ids: &[String]) -> Vec<String> {
    if ids.is_empty() { registry.failed().iter().map(ToString::to_string).collect() } else { Vec::new() }
}

/// Describes plugins as text. If plugins are requested by id, the options of their parameters are
/// included.
///
/// # Errors
/// The errors of [`plugin_list`].
pub fn plugin_text(registry: &Registry, ids: &[String]) -> Result<String, PipelineError> {
    let mut text = String::new();
    for (info, origin) in chosen(registry, ids)? {
        let kind = serde_json::to_value(info.kind).expect("names serialize");
        let _ = writeln!(text, "{} {} ({}, {origin})", info.id, info.version, kind.as_str().unwrap_or_default());
        let _ = writeln!(text, "  {}", info.doc.trim());
        for param in &info.schema.params {
            let _ = writeln!(text, "    {:14} {} [{}]", param.name, param.help, values_of(param));
            if let (Kind::Choice { options, .. }, false) = (&param.kind, ids.is_empty()) {
                for option in options {
                    let _ = writeln!(text, "    {:16} {}: {}", "", option.value, option.help);
                }
            }
        }
    }
    let failed = failed(registry, ids);
    if !failed.is_empty() {
        text.push_str("libraries that could not be loaded\n");
    }
    for error in failed {
        let _ = writeln!(text, "  {error}");
    }
    Ok(text.trim_end().to_string())
}

/// Returns the allowed values of a parameter in its unit, and its default.
fn values_of(param: &Param) -> String {
    let unit = param.unit.as_ref().filter(|unit| *unit != "1").map_or(String::new(), |unit| format!(" {unit}"));
    let default = match param.default_value() {
        serde_json::Value::String(text) if text.is_empty() => "none".into(),
        serde_json::Value::String(text) => text,
        number => format!("{number}{unit}"),
    };
    format!("{}; default {default}", param.expected())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_have_units_and_no_names_of_types() {
        for (param, expected) in [
            (Param::bool("a", true, "A."), "true or false; default true"),
            (Param::int("a", 4, 1..=9, "A.").unit("1"), "a whole number from 1 to 9; default 4"),
            (Param::float("a", 0.5, 0.0..=2.0, "A.").unit("mm"), "a number from 0 to 2 mm; default 0.5 mm"),
            (Param::choice("a", "x", [("x", "X."), ("y", "Y.")], "A."), "one of x, y; default x"),
            (Param::text("a", "", "A."), "a text; default none"),
            (Param::text("a", "b c", "A."), "a text; default b c"),
            (Param::file("a", "A."), "the path of a file, or a file's text, which begins with {; default none"),
        ] {
            assert_eq!(values_of(&param), expected);
        }
        let all = plugin_text(&plugins(&[]).unwrap(), &[]).unwrap();
        assert!(
            all.contains("images") && !["Text {", "Float {", "File]"].iter().any(|name| all.contains(name)),
            "{all}"
        );
    }
}
