//! Steps that write outputs, of a light field or of patterns.

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry};
use lumistack_plugin_host::OutputData;

use super::context::Context;
use crate::error::PipelineError;
use crate::job::{Job, NodeJob, OutputJob};
use crate::plan::graph::outputs_on;
use crate::stage::output;

impl Context<'_> {
    /// Opens the outputs of a job and of its nodes, each for its own display and for `geometry`.
    pub(super) fn open_outputs(
        &self,
        job: &Job,
        display: &Display,
        geometry: &FieldGeometry,
    ) -> Result<(), PipelineError> {
        let outputs = outputs_on(job, display, geometry)?;
        outputs.iter().try_for_each(|(output, display)| output::open(output, display, self.registry, self.task))
    }

    /// Writes an output of the light field; `number` is the number of the output in the job, from
    /// 0.
    pub(super) fn field_output(&mut self, part: usize, number: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let field = self.field(part)?;
        let relative = format!("outputs/{}", OutputJob::LIGHT_FIELD);
        self.output(part, number, &relative, &field.display, OutputData::LightField(&field.target), task)
    }

    /// Writes an output of the patterns; `number` is the number of the output in the job, from 0.
    pub(super) fn stack_output(&mut self, part: usize, number: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let field = self.field(part)?;
        let patterns = self.of(part, "patterns", |state| state.patterns.clone())?;
        let relative = match self.plan.node(part) {
            Some(node) => format!("../../outputs/{}", node.id),
            None => format!("outputs/{}", NodeJob::TENSOR_DISPLAY),
        };
        let data = OutputData::LayerStack(&patterns.solved.stack, Some(&field.target));
        self.output(part, number, &relative, &patterns.display, data, task)
    }

    fn output(
        &mut self,
        part: usize,
        number: usize,
        folder: &str,
        display: &Display,
        data: OutputData<'_>,
        task: Task<'_>,
    ) -> Result<bool, PipelineError> {
        let job = self.job(part);
        let output = &job.outputs[number];
        let relative = format!("{folder}/{}", output.name());
        let (written, cached) = output::run(output, &relative, display, data, &self.stamps(part), self.registry, task)?;
        let prefix = &self.plan.parts[self.plan.field_part(part)].folder;
        self.failed.extend(output::failed(std::slice::from_ref(&written), prefix));
        self.states[part].outputs.push(written);
        Ok(cached)
    }
}
