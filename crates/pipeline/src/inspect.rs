//! What the shells ask besides running: what is in a light field, which plugins there are.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_field_io::{Description, GeometryFlags};
use lumistack_plugin_host::{Kind, Registry};

use crate::error::{PipelineError, field_error};

/// Describes a light field of any kind.
///
/// # Errors
/// When it cannot be read.
pub fn describe_light_field(path: &Path, flags: &GeometryFlags, task: Task<'_>) -> Result<Description, PipelineError> {
    lumistack_field_io::describe(path, flags, task).map_err(field_error)
}

/// The plugins that are compiled in, and those in libraries: in `paths`, the places that the environment variable `LUMISTACK_PLUGIN_PATH` names, and the user's data
/// folder. Without the feature `dynamic` only the former.
///
/// # Errors
/// When a plugin that is compiled in describes itself badly.
pub fn plugins(paths: &[PathBuf]) -> Result<Registry, PipelineError> {
    #[cfg_attr(not(feature = "dynamic"), expect(unused_mut, reason = "only libraries are added"))]
    let mut registry = Registry::built_in().map_err(PipelineError::Output)?;
    #[cfg(feature = "dynamic")]
    registry.load(&lumistack_plugin_host::PluginPaths::of_system(paths));
    #[cfg(not(feature = "dynamic"))]
    let _ = paths;
    Ok(registry)
}

/// All plugins with their parameters and where they come from, and what gave no plugin and why, as JSON.
pub fn plugin_list(registry: &Registry) -> serde_json::Value {
    let plugins = registry.entries().map(|(info, origin)| {
        let mut plugin = serde_json::to_value(info).expect("descriptions serialize");
        plugin["origin"] = origin.to_string().into();
        plugin
    });
    let failed = registry.failed().iter().map(ToString::to_string);
    serde_json::json!({ "plugins": plugins.collect::<Vec<_>>(), "failed": failed.collect::<Vec<_>>() })
}

/// The same as text.
pub fn plugin_text(registry: &Registry) -> String {
    let mut text = String::new();
    for (info, origin) in registry.entries() {
        let kind = serde_json::to_value(info.kind).expect("names serialize");
        let _ = writeln!(text, "{} {} ({}, {origin})", info.id, info.version, kind.as_str().unwrap_or_default());
        let _ = writeln!(text, "  {}", info.doc.trim());
        for param in &info.schema.params {
            let unit =
                param.unit.as_deref().filter(|unit| *unit != "1").map_or(String::new(), |unit| format!(" {unit}"));
            let range = match &param.kind {
                Kind::Bool { default } => format!("true or false, default {default}"),
                Kind::Int { default, min, max } => format!("{min} to {max}{unit}, default {default}"),
                Kind::Float { default, min, max } => format!("{min} to {max}{unit}, default {default}"),
                Kind::Choice { default, options } => {
                    let names: Vec<&str> = options.iter().map(|option| option.value.as_str()).collect();
                    format!("{}, default {default}", names.join(" | "))
                }
                Kind::Text { default } if default.is_empty() => "a text".into(),
                Kind::Text { default } => format!("a text, default \"{default}\""),
                Kind::File => "a file, or its text".into(),
            };
            let _ = writeln!(text, "    {:14} {} [{range}]", param.name, param.help);
        }
    }
    if !registry.failed().is_empty() {
        text.push_str("not loaded\n");
    }
    for error in registry.failed() {
        let _ = writeln!(text, "  {error}");
    }
    text.trim_end().to_string()
}
