//! Runs importers, sources and nodes. Messages, progress and cancellation go to the task. These
//! plugins cannot write files.

use lumistack_core::Task;
use lumistack_display::{Display, LightField};
use lumistack_plugin::{PluginError, Time};
use serde_json::Value;

use crate::serve::{self, Made, NodeData, Plugin, PluginKind, ReadAsset, Services};
use crate::{HostError, Registry};

/// Runs the importer `id`, which converts `file` into a glTF document. The document is not yet
/// validated. `read` reads `file` and other files in its folder.
///
/// # Errors
/// If no importer has this id, or the importer refuses the parameters, fails or is cancelled.
pub fn import_scene(
    registry: &Registry,
    id: &str,
    params: &Value,
    file: &str,
    read: &ReadAsset<'_>,
    task: Task<'_>,
) -> Result<Vec<u8>, HostError> {
    make(registry, id, PluginKind::Importer, params, task, |plugin, host, params| {
        serve::import(plugin, host, params, file, read)
    })
}

/// Runs the source `id` for one time step and returns its light field.
///
/// # Errors
/// If no source has this id, or the source refuses the parameters, fails, is cancelled, or returns
/// an invalid light field.
pub fn make_field(
    registry: &Registry,
    id: &str,
    params: &Value,
    display: &Display,
    time: Time,
    task: Task<'_>,
) -> Result<LightField, HostError> {
    make(registry, id, PluginKind::Source, params, task, |plugin, host, params| {
        serve::make_field(plugin, host, params, display, time)
    })
}

/// Runs the node `id` for one time step and returns its layer stack.
///
/// # Errors
/// If no node has this id, if the node refuses the parameters or the display, or if it fails or is
/// cancelled. Also if the weights do not match the light field, or the start or the returned layer
/// stack does not match the display.
pub fn make_stack(
    registry: &Registry,
    id: &str,
    params: &Value,
    node: &NodeData<'_>,
    task: Task<'_>,
) -> Result<Made, HostError> {
    make(registry, id, PluginKind::Node, params, task, |plugin, host, params| {
        serve::make_stack(plugin, host, params, node)
    })
}

fn make<T>(
    registry: &Registry,
    id: &str,
    kind: PluginKind,
    params: &Value,
    task: Task<'_>,
    work: impl FnOnce(&Plugin, &TaskHost<'_>, &str) -> Result<T, PluginError>,
) -> Result<T, HostError> {
    let plugin = registry.get_kind(id, kind)?;
    let of_plugin = |error| HostError::of_plugin(kind, id, error);
    let params = serve::resolved(plugin, params).map_err(of_plugin)?;
    let made = work(plugin, &TaskHost { kind, id, task }, &params).map_err(of_plugin)?;
    task.cancel.check().map_err(|_| HostError::Cancelled)?;
    Ok(made)
}

/// Services for importers, sources and nodes: they refuse all files.
struct TaskHost<'a> {
    kind: PluginKind,
    id: &'a str,
    task: Task<'a>,
}

impl Services for TaskHost<'_> {
    fn task(&self) -> Task<'_> {
        self.task
    }

    fn warn(&self, message: &str) {
        self.task.warn(format!("{} `{}`", self.kind.name(), self.id), message);
    }

    fn no_files(&self) -> PluginError {
        PluginError::Refused(format!("{} writes no files", self.kind))
    }
}
