//! The output plugins of a run.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{Display, LightField};
use lumistack_plugin_host::{OutputContext, OutputData, Time};
use lumistack_report::Output;

use super::Run;
use crate::cache::KeyBuilder;
use crate::error::{PipelineError, host_error};
use crate::files::{read_json, write_json};
use crate::ingest;
use crate::job::OutputJob;

/// Plugins are told how deep the middle view sees.
fn add_depth(key: &mut KeyBuilder, field: &LightField) {
    if let Some(depth) = field.depth() {
        let z_mm: Vec<f32> = depth.z_mm.iter().map(|z| z.unwrap_or(f32::NAN)).collect();
        key.add_json("depth", &(depth.rows, depth.cols)).add_f32("z", &z_mm);
    }
}

impl Run<'_> {
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
            let mut key = KeyBuilder::new(&format!("output {}", output.plugin), 3);
            key.add("plugin", ingest::plugin_key(registry, &output.plugin, &output.params)?.as_bytes())
                .add("display", display.to_toml().as_bytes());
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
            let key = key.finish();
            let stage = match from {
                OutputJob::LIGHT_FIELD => format!("output-{from}-{}", output.name()),
                _ => format!("output-{}", output.name()),
            };
            let written: Vec<PathBuf> = self.timed(&stage, |run| {
                let list = run.dir.join("cache").join(format!("{stage}-files.json"));
                if run.stamps.is_current(&stage, &key)
                    && let Some(written) = read_json(&list)
                {
                    return Ok((written, true));
                }
                run.stamps.clear(&stage)?;
                let out_dir = &run.dir.join(&relative);
                let context = OutputContext { display, data, time: Time::default(), out_dir, task };
                let result = lumistack_plugin_host::run_output(registry, &output.plugin, &params, context);
                let mut written = result.map_err(host_error)?;
                written.iter_mut().for_each(|file| *file = Path::new(&relative).join(&*file));
                write_json(&list, &written)?;
                run.stamps.write(&stage, &key, &written)?;
                Ok((written, false))
            })?;
            outputs.push(Output { label: format!("{}, {} files", output.name(), written.len()), path: relative });
        }
        Ok(outputs)
    }
}
