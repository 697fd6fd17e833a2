//! What the shells ask besides running: what is in a light field, which plugins there are.

use std::fmt::Write as _;
use std::path::Path;

use lumistack_core::Task;
use lumistack_field_io::{Description, GeometryFlags};
use lumistack_plugin_host::{Kind, Registry};

use crate::error::PipelineError;
use crate::run::field_error;

/// Describes a light field of any kind.
///
/// # Errors
/// When it cannot be read.
pub fn describe_light_field(path: &Path, flags: &GeometryFlags, task: Task<'_>) -> Result<Description, PipelineError> {
    lumistack_field_io::describe(path, flags, task).map_err(field_error)
}

/// All plugins and their parameters as JSON.
///
/// # Errors
/// When a plugin describes itself badly.
pub fn plugin_list() -> Result<serde_json::Value, PipelineError> {
    let registry = Registry::built_in().map_err(PipelineError::Output)?;
    Ok(registry.infos().map(|info| serde_json::to_value(info).expect("descriptions serialize")).collect())
}

/// All plugins and their parameters as text.
///
/// # Errors
/// When a plugin describes itself badly.
pub fn plugin_text() -> Result<String, PipelineError> {
    let registry = Registry::built_in().map_err(PipelineError::Output)?;
    let mut text = String::new();
    for info in registry.infos() {
        let kind = serde_json::to_value(info.kind).expect("names serialize");
        let _ = writeln!(text, "{} {} ({})", info.id, info.version, kind.as_str().unwrap_or_default());
        let _ = writeln!(text, "  {}", info.doc.trim());
        for param in &info.schema.params {
            let range = match &param.kind {
                Kind::Bool { default } => format!("true or false, default {default}"),
                Kind::Int { default, min, max } => format!("{min} to {max}, default {default}"),
                Kind::Float { default, min, max } => format!("{min} to {max}, default {default}"),
                Kind::Choice { default, options } => {
                    let names: Vec<&str> = options.iter().map(|option| option.value.as_str()).collect();
                    format!("{}, default {default}", names.join(" | "))
                }
                other => format!("{other:?}"),
            };
            let unit = param.unit.as_ref().map_or(String::new(), |unit| format!(" {unit}"));
            let _ = writeln!(text, "    {:14} {} [{range}{unit}]", param.name, param.help);
        }
    }
    Ok(text.trim_end().to_string())
}
