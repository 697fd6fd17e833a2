//! The output plugins of a run.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, LightField};
use lumistack_plugin_host::{OutputContext, OutputData, Registry, Time};
use lumistack_report::Output;
use serde::Serialize;

use super::Run;
use super::input::field_defaults;
use crate::error::{PipelineError, display_error, field_error, host_error};
use crate::job::{Job, OutputJob};
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::KeyBuilder;
use crate::store::plugin_files;
use crate::store::plugin_files::plugin_key;

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
        let params = output.params.clone().into();
        match lumistack_plugin_host::check_output(registry, &output.plugin, &params, &display, task).map_err(host_error)
        {
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

/// Plugins are told how deep the middle view sees.
fn add_depth(key: &mut KeyBuilder, field: &LightField) {
    if let Some(depth) = field.depth() {
        let z_mm: Vec<f32> = depth.z_mm.iter().map(|z| z.unwrap_or(f32::NAN)).collect();
        key.add_json("depth", &(depth.rows, depth.cols)).add_f32("z", &z_mm);
    }
}

impl Run<'_> {
    /// Opens the outputs against the display as it is now: what they refuse is known before the work and not after. Those of a job's nodes are the nodes'.
    ///
    /// # Errors
    /// That of the first that refuses; when cancelled.
    pub(crate) fn check_outputs(&self, task: Task<'_>) -> Result<(), PipelineError> {
        let own =
            |output: &&OutputJob| self.job.nodes.is_empty() || output.from.as_deref() == Some(OutputJob::LIGHT_FIELD);
        for output in self.job.outputs.iter().filter(own) {
            let params = output.params.clone().into();
            let checked =
                lumistack_plugin_host::check_output(self.registry, &output.plugin, &params, &self.display, task);
            checked.map_err(host_error)?;
        }
        Ok(())
    }

    /// Runs the outputs of the job that take what `from` makes; `folder` is where, relative to the run's folder.
    pub(crate) fn write_outputs(
        &mut self,
        from: &str,
        folder: &str,
        display: &Display,
        data: OutputData<'_>,
        task: Task<'_>,
    ) -> Result<Vec<Output>, PipelineError> {
        let (job, registry) = (self.job.clone(), self.registry);
        let mut outputs = Vec::new();
        for output in job.outputs_of(from) {
            let relative = format!("{folder}/{}", output.name());
            let params = output.params.clone().into();
            let mut key = KeyBuilder::new(&format!("output {}", output.plugin), code::PLUGINS);
            key.add("display", display.to_toml().as_bytes());
            match data {
                OutputData::LayerStack(stack, target) => {
                    if let Some(target) = target {
                        key.add("geometry", format!("{:?}", target.geometry()).as_bytes());
                        key.add_f32("target", target.radiance().data());
                        add_depth(&mut key, target);
                    }
                    key.add_json("brightness", &stack.brightness);
                    for layer in &stack.layers {
                        key.add_f32("layer", layer.data());
                    }
                    if let Some(emission) = &stack.emission {
                        key.add_f32("emission", emission.data());
                    }
                }
                OutputData::LightField(field) => {
                    key.add("geometry", format!("{:?}", field.geometry()).as_bytes());
                    key.add_f32("radiance", field.radiance().data());
                    add_depth(&mut key, field);
                }
            }
            let plugin = plugin_key(registry, &output.plugin, &output.params);
            let key = plugin.map(|plugin| key.add("plugin", plugin.as_bytes()).finish());
            let stage = match from {
                OutputJob::LIGHT_FIELD => format!("output-{from}-{}", output.name()),
                _ => format!("output-{}", output.name()),
            };
            let written: Result<Vec<PathBuf>, PipelineError> = self.timed(&stage, |run| {
                let key = match key {
                    Ok(key) => key,
                    Err(error) => return Ok((Err(error), false)),
                };
                let list = run.dir.join("cache").join(format!("{stage}-files.json"));
                if run.stamps.is_current(&stage, &key)
                    && let Some(written) = read_json(&list)
                {
                    return Ok((Ok(written), true));
                }
                run.stamps.clear(&stage)?;
                let out_dir = &run.dir.join(&relative);
                let context = OutputContext { display, data, time: Time::default(), out_dir, task };
                let result = lumistack_plugin_host::run_output(registry, &output.plugin, &params, context);
                let mut written = match result.map_err(host_error) {
                    Ok(written) => written,
                    Err(PipelineError::Cancelled) => return Err(PipelineError::Cancelled),
                    Err(error) => return Ok((Err(error), false)),
                };
                written.iter_mut().for_each(|file| *file = Path::new(&relative).join(&*file));
                write_json(&list, &written)?;
                run.stamps.write(&stage, &key, &written)?;
                Ok((Ok(written), false))
            })?;
            outputs.push(match written {
                Ok(written) => {
                    let label = format!("{}, {} files", output.name(), written.len());
                    Output { label, path: relative, failed: None }
                }
                // costs neither the report nor the outputs after it
                Err(error) => {
                    let reason = error.to_string();
                    task.warn(relative.trim_start_matches("../"), format!("not written: {reason}"));
                    Output { label: output.name().into(), path: relative, failed: Some(reason) }
                }
            });
        }
        Ok(outputs)
    }
}
