//! One output from open to the files in place.

use std::path::{Path, PathBuf};

use crate::serve::{Output, OutputData, PluginKind};
use lumistack_core::Task;
use lumistack_display::Display;
use lumistack_plugin::Time;
use serde_json::Value;

use crate::disk::DiskHost;
use crate::publish::{Staging, publish};
use crate::{HostError, Registry};

/// What an output is made from and where it goes.
#[derive(Clone, Copy)]
pub struct OutputContext<'a> {
    /// The display.
    pub display: &'a Display,
    /// A layer stack or a light field.
    pub data: OutputData<'a>,
    /// Place in the sequence; the default for a still.
    pub time: Time,
    /// The output's own folder, made if need be.
    pub out_dir: &'a Path,
    /// Progress, warnings, cancellation.
    pub task: Task<'a>,
}

/// Writes one time with the output plugin `id`, which must not be a presenter. Returns the files, relative to `out_dir`, sorted.
///
/// Files are collected beside `out_dir` and moved into it once the plugin has finished: replaced are files of the same names, and removed
/// what an earlier output into this folder wrote and this one does not. Other files in it stay. At most one output may be written into
/// a folder at a time.
///
/// # Errors
/// See [`HostError`]; `out_dir` then holds what it held before.
pub fn run_output(
    registry: &Registry,
    id: &str,
    params: &Value,
    context: OutputContext<'_>,
) -> Result<Vec<PathBuf>, HostError> {
    let OutputContext { display, data, time, out_dir, task } = context;
    with_output(registry, id, params, display, out_dir, task, |output| output.submit(time, data))
}

/// An output that takes times; see [`with_output`].
pub struct OpenOutput<'a> {
    output: &'a Output<'a>,
    id: &'a str,
}

impl OpenOutput<'_> {
    /// Hands over one time. From any thread, in any order; times are numbered from 0.
    ///
    /// # Errors
    /// If the plugin does not accept the data or fails.
    pub fn submit(&self, time: Time, data: OutputData<'_>) -> Result<(), HostError> {
        self.output.submit(time, data).map_err(|error| HostError::of_plugin(PluginKind::Output, self.id, error))
    }
}

/// As [`run_output`], with all times that `submit_all` hands to the output: for sequences, and for data that come one by one.
///
/// # Errors
/// As [`run_output`], and what `submit_all` returns.
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
