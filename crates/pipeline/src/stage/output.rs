//! Output plugins. A run checks them with the display before its work begins, and executes them
//! when the patterns or the light field are finished.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{Display, LightField};
use lumistack_plugin_host::{OutputContext, OutputData, PluginKind, Port, Registry, Time};
use lumistack_report::Output;

use super::factorize::add_stack;
use crate::error::{FailedOutput, PipelineError, host_error};
use crate::job::{Job, OutputJob};
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::KeyBuilder;
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;

/// Checks plugins and parameters of a job's outputs, without opening them.
///
/// # Errors
/// If an output plugin does not exist, refuses the parameters or the kind of data, or drives
/// panels.
pub(crate) fn check(job: &Job, registry: &Registry) -> Result<(), PipelineError> {
    for output in &job.outputs {
        let info = registry.get_kind(&output.plugin, PluginKind::Output).map_err(PipelineError::Output)?.info();
        registry.check_params(&output.plugin, &output.params.clone().into()).map_err(PipelineError::Output)?;
        let port = port_of(output);
        if !info.ports.contains(&port) {
            let expected = format!("a plugin for a {port}");
            return Err(PipelineError::job("outputs", expected, format!("`{}`", output.plugin)));
        }
        if info.presents {
            let found = format!("`{}`, which drives panels (use `lumistack show`)", output.plugin);
            return Err(PipelineError::job("outputs", "a plugin that writes files", found));
        }
    }
    Ok(())
}

fn port_of(output: &OutputJob) -> Port {
    if output.takes_light_field() { Port::LightField } else { Port::LayerStack }
}

/// Opens an output for a display before a run renders or solves, so that a refusal is known early.
///
/// # Errors
/// If the output refuses the display, or the task is cancelled.
pub(crate) fn open(
    output: &OutputJob,
    display: &Display,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let params = output.params.clone().into();
    let checked =
        lumistack_plugin_host::check_output(registry, &output.plugin, &params, display, port_of(output), task);
    checked.map_err(host_error)
}

/// Returns the failed outputs. The function puts `prefix` before each path.
pub(crate) fn failed(outputs: &[Output], prefix: &Path) -> Vec<FailedOutput> {
    let failed =
        outputs.iter().filter_map(|output| Some((output.path.trim_start_matches("../"), output.failed.clone()?)));
    let place = |path: &str| prefix.join(path).to_string_lossy().into_owned();
    failed.map(|(path, reason)| FailedOutput { path: place(path), reason }).collect()
}

/// Adds a light field and the depth of its central view to a key. Outputs receive the light field
/// and the depth.
fn add_field(key: &mut KeyBuilder, label: &str, field: &LightField) {
    key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_field(label, field);
    if let Some(depth) = field.depth() {
        let z_mm: Vec<f32> = depth.z_mm.iter().map(|z| z.unwrap_or(f32::NAN)).collect();
        key.add_json("depth", &(depth.rows, depth.cols)).add_f32("z", &z_mm);
    }
}

/// Returns the name of an output's stage, which is also the name of its stamp.
pub(crate) fn stage_name(output: &OutputJob) -> String {
    match output.takes_light_field() {
        true => format!("output-{}-{}", OutputJob::LIGHT_FIELD, output.name()),
        false => format!("output-{}", output.name()),
    }
}

/// Writes an output into the folder `relative`, a path relative to the folder of `stamps`, unless
/// the output's files are current. Returns true if they were current. If the output fails, the
/// result has the message, and the run continues.
///
/// # Errors
/// If cancelled.
pub(crate) fn run(
    output: &OutputJob,
    relative: &str,
    display: &Display,
    data: OutputData<'_>,
    stamps: &Stamps,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(Output, bool), PipelineError> {
    // The key contains everything that the plugin reads.
    let mut key = KeyBuilder::new(&format!("output {}", output.plugin), code::PLUGINS);
    key.add("display", display.to_toml().as_bytes());
    match data {
        OutputData::LayerStack(stack, target) => {
            if let Some(target) = target {
                add_field(&mut key, "target", target);
            }
            key.add_json("brightness", &stack.brightness);
            add_stack(&mut key, stack);
        }
        OutputData::LightField(field) => add_field(&mut key, "radiance", field),
    }
    // The list of files is cached too, since only the plugin knows which files it wrote.
    let stage = stage_name(output);
    let list = stamps.dir().join("cache").join(format!("{stage}-files.json"));
    let make = || {
        let (params, out_dir) = (output.params.clone().into(), &stamps.dir().join(relative));
        let context = OutputContext { display, data, time: Time::default(), out_dir, task };
        let written = lumistack_plugin_host::run_output(registry, &output.plugin, &params, context);
        let mut written = written.map_err(host_error)?;
        written.iter_mut().for_each(|file| *file = Path::new(relative).join(&*file));
        write_json(&list, &written)?;
        Ok((written.clone(), written))
    };
    let plugin = plugin_key(registry, &output.plugin, &output.params);
    let written: Result<(Vec<PathBuf>, bool), PipelineError> = plugin.and_then(|plugin| {
        key.add("plugin", plugin.as_bytes());
        stamps.reuse_or_make(&stage, &key.finish(), || read_json(&list), make)
    });
    // If an output failed, later outputs and the report are still written.
    match written {
        Ok((written, cached)) => {
            let files = if written.len() == 1 { "file" } else { "files" };
            let label = format!("{}, {} {files}", output.name(), written.len());
            Ok((Output { label, path: relative.into(), failed: None }, cached))
        }
        Err(PipelineError::Cancelled) => Err(PipelineError::Cancelled),
        Err(error) => {
            let reason = error.to_string();
            task.warn(relative.trim_start_matches("../"), format!("the output was not written: {reason}"));
            Ok((Output { label: output.name().into(), path: relative.into(), failed: Some(reason) }, false))
        }
    }
}
