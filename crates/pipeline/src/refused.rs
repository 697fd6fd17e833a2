//! Outputs of a job that would be refused, before any work.

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry};
use lumistack_plugin_host::Registry;
use serde::Serialize;

use crate::error::{PipelineError, display_error, field_error};
use crate::job::Job;
use crate::stage::field::field_defaults;
use crate::stage::output;
use crate::store::plugin_files;

/// An output of a job that would not be written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RefusedOutput {
    /// The plugin.
    pub plugin: String,
    /// Name of its folder.
    pub name: String,
    /// Why not.
    pub reason: String,
}

/// Opens every output of a job against the display that it would be given, as a run does before the first ray, and says which are refused.
///
/// # Errors
/// When a display of the job makes no sense, the light field that it reads cannot be opened, or when cancelled.
pub fn refused_outputs(job: &Job, registry: &Registry, task: Task<'_>) -> Result<Vec<RefusedOutput>, PipelineError> {
    let job = &plugin_files::resolved(job, registry)?;
    let display = job.resolve_display()?;
    // a source makes the light field of the display; what is read has a geometry of its own
    let field = match (&job.scene, &job.light_field) {
        (None, Some(path)) if job.sequence.is_none() => {
            let defaults = field_defaults(&display);
            Some(lumistack_field_io::geometry_of(path, &job.geometry, &defaults, task).map_err(field_error)?)
        }
        _ => None,
    };
    let adapted = |display: Display, to: Option<&FieldGeometry>| match to {
        Some(geometry) => display.adapted_to(geometry).map_err(|source| display_error(source, "light field")),
        None => Ok(display),
    };
    let shared = match &field {
        Some(geometry) => geometry.clone(),
        None => display.geometry().map_err(|source| display_error(source, "field"))?,
    };
    let own = adapted(display, field.as_ref())?;
    let mut refused = Vec::new();
    for output in &job.outputs {
        let node = job.nodes.iter().find(|node| output.from.as_deref() == Some(node.id.as_str()));
        // the only node needs not be named
        let node = node.or_else(|| job.nodes.first().filter(|_| output.from.is_none()));
        let display = match node.and_then(|node| node.display.as_ref()) {
            Some(display) => adapted(display.resolve()?, Some(&shared))?,
            None => own.clone(),
        };
        match output::open(output, &display, registry, task) {
            Ok(()) => {}
            Err(PipelineError::Cancelled) => return Err(PipelineError::Cancelled),
            Err(error) => refused.push(RefusedOutput {
                plugin: output.plugin.clone(),
                name: output.name().into(),
                reason: error.to_string(),
            }),
        }
    }
    Ok(refused)
}
