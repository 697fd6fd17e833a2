//! Checks the settings of a plan before its steps run. So a wrong setting is reported immediately,
//! and not after hours of rendering.

use lumistack_plugin_host::PluginKind;

use super::context::Context;
use crate::error::{PipelineError, display_error};
use crate::plan::steps::PartKind;
use crate::stage::{factorize, node, output};
use crate::store::files::check_folder;

impl Context<'_> {
    /// Checks jobs, displays, settings and outputs of all parts.
    ///
    /// # Errors
    /// The first invalid value that is found.
    pub(super) fn check(&mut self) -> Result<(), PipelineError> {
        let plan = self.plan;
        for (number, part) in plan.parts.iter().enumerate() {
            // Skip time steps, since their settings are checked with the sequence. Skip the nodes
            // of later time steps, since they have the settings of the first time step's nodes.
            // Skip sweeps, since `Designs` checks their designs.
            let job = &part.job;
            match (&part.kind, part.parent) {
                (PartKind::Time(_), _) => continue,
                (PartKind::Node(_), Some(parent)) if matches!(plan.parts[parent].kind, PartKind::Time(time) if time > 0) =>
                {
                    continue;
                }
                (PartKind::Sweep, _) => continue,
                (PartKind::Node(_), _) => {}
                _ => job.check()?,
            }
            // Check settings, plugins and folders.
            let display = job.resolve_display()?;
            factorize::check(&job.factorize)?;
            if let Some(source) = &job.source {
                self.registry.get_kind(&source.plugin, PluginKind::Source).map_err(PipelineError::Output)?;
                let params = source.params.clone().into();
                self.registry.check_params(&source.plugin, &params).map_err(PipelineError::Output)?;
            }
            output::check(job, self.registry)?;
            check_folder(&self.dir(number))?;
            for node in &job.nodes {
                node::check(node, self.registry)?;
            }
            // Open the outputs, so that their plugins refuse displays that they cannot show.
            if job.scene.is_some() && !matches!(part.kind, PartKind::Node(_)) {
                self.open_outputs(
                    job,
                    &display,
                    &display.geometry().map_err(|source| display_error(source, "field"))?,
                )?;
            }
        }
        Ok(())
    }
}
