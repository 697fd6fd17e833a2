//! Runs an output plugin, from its opening until its files are in the output's folder.

use std::path::{Path, PathBuf};

use crate::serve::{Output, OutputData, PluginKind};
use lumistack_core::Task;
use lumistack_display::Display;
use lumistack_plugin::Time;
use serde_json::Value;

use crate::disk::DiskHost;
use crate::publish::{Staging, publish};
use crate::{HostError, Registry};

/// Inputs and target of an output.
#[derive(Clone, Copy)]
pub struct OutputContext<'a> {
    /// The display of the data.
    pub display: &'a Display,
    /// A layer stack or a light field.
    pub data: OutputData<'a>,
    /// Time step; the default for a still.
    pub time: Time,
    /// The output's folder. It is created if it does not exist.
    pub out_dir: &'a Path,
    /// Progress, warnings and cancellation.
    pub task: Task<'a>,
}

/// Writes one time step with the output plugin `id`, which must not be a presenter. Returns the
/// files relative to `out_dir`, sorted.
///
/// Files are staged next to `out_dir` and moved into it after the plugin has finished. Existing
/// files of equal names are replaced. Files of an earlier output in this folder that the new output
/// does not write are removed. Other files stay. Two outputs must not write into one folder at the
/// same time.
///
/// # Errors
/// See [`HostError`]. After an error `out_dir` is unchanged.
pub fn run_output(
    registry: &Registry,
    id: &str,
    params: &Value,
    context: OutputContext<'_>,
) -> Result<Vec<PathBuf>, HostError> {
    let OutputContext { display, data, time, out_dir, task } = context;
    with_output(registry, id, params, display, out_dir, task, |output| output.submit(time, data))
}

/// An open output that accepts time steps; see [`with_output`].
pub struct OpenOutput<'a> {
    output: &'a Output<'a>,
    id: &'a str,
}

impl OpenOutput<'_> {
    /// Submits one time step, from any thread and in any order. Time steps are numbered from 0.
    ///
    /// # Errors
    /// If the plugin refuses the data or fails.
    pub fn submit(&self, time: Time, data: OutputData<'_>) -> Result<(), HostError> {
        self.output.submit(time, data).map_err(|error| HostError::of_plugin(PluginKind::Output, self.id, error))
    }
}

/// Writes a sequence with the output plugin `id`, as [`run_output`] writes one time step.
/// `submit_all` submits all time steps.
///
/// # Errors
/// Those of [`run_output`] and of `submit_all`.
pub fn with_output(
    registry: &Registry,
    id: &str,
    params: &Value,
    display: &Display,
    out_dir: &Path,
    task: Task<'_>,
    submit_all: impl FnOnce(&OpenOutput<'_>) -> Result<(), HostError>,
) -> Result<Vec<PathBuf>, HostError> {
    let plugin = registry.output(id, false)?;
    let resolved = registry.check_params(id, params)?;
    let staging = Staging::new(out_dir)?;
    let host = DiskHost::new(staging.path(), id, task);
    let of_plugin = |error| HostError::of_plugin(PluginKind::Output, id, error);

    let output = Output::open(plugin, &host, &Value::Object(resolved), display).map_err(of_plugin)?;
    submit_all(&OpenOutput { output: &output, id })?;
    output.finish().map_err(of_plugin)?;

    let files = host.into_files().map_err(|files| HostError::Uncommitted { plugin: id.into(), files })?;
    task.cancel.check().map_err(|_| HostError::Cancelled)?;
    publish(staging, id, &files)?;
    Ok(files.into_iter().map(PathBuf::from).collect())
}
