//! Finds the outputs that plugins refuse, before a run begins.

use lumistack_core::Task;
use lumistack_plugin_host::Registry;
use serde::Serialize;

use crate::error::{PipelineError, display_error, field_error};
use crate::job::Job;
use crate::plan::graph::outputs_on;
use crate::plan::times::Times;
use crate::stage::field::field_defaults;
use crate::stage::output;
use crate::store::plugin_files;

/// An output of a job that its plugin refuses to write.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RefusedOutput {
    /// Id of the plugin.
    pub plugin: String,
    /// Name of the output's folder.
    pub name: String,
    /// The plugin's message.
    pub reason: String,
}

/// Opens every output of a job with its display, as a run does before it renders, and returns the
/// refused outputs. For a sequence only the first time step is checked, since all time steps have
/// the same geometry.
///
/// # Errors
/// If a display of the job is wrong, the job's light field or a file in a plugin's parameters
/// cannot be opened, or the task is cancelled.
pub fn refused_outputs(job: &Job, registry: &Registry, task: Task<'_>) -> Result<Vec<RefusedOutput>, PipelineError> {
    let job = plugin_files::resolved(job, registry)?;
    let job = match &job.sequence {
        Some(sequence) => Times::find(&job, sequence)?.job(&job, 0, None, None),
        None => job,
    };
    let own = job.resolve_display()?;
    // A light field from files has its own geometry. The light field of a scene or a source has the
    // geometry of the display.
    let (display, geometry) = match (&job.scene, &job.light_field) {
        (None, Some(path)) => {
            let geometry = lumistack_field_io::geometry_of(path, &job.geometry, &field_defaults(&own), task);
            let geometry = geometry.map_err(field_error)?;
            (own.adapted_to(&geometry).map_err(|source| display_error(source, "light field"))?, geometry)
        }
        _ => {
            let geometry = own.geometry().map_err(|source| display_error(source, "display"))?;
            (own, geometry)
        }
    };
    // A plugin checks display and parameters when its output is opened, and writes nothing yet.
    let mut refused = Vec::new();
    for (output, display) in outputs_on(&job, &display, &geometry)? {
        match output::open(&output, &display, registry, task) {
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
