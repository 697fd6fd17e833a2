//! Checks the settings of a plan before its steps run. So a wrong setting is reported immediately,
//! and not after hours of rendering.

use lumistack_plugin_host::{PluginKind, Registry};

use super::context::Context;
use crate::error::{PipelineError, display_error};
use crate::job::Job;
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
            // Skip sweeps, since `sweep::add` has checked their designs.
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
            factorize::check(&job.factorize)?;
            let display = job.resolve_display()?;
            if job.nodes.is_empty() && node::is_factorized(plan.node(number)) {
                factorize::check_solver(&job.factorize, &display)?;
            }
            plugins(job, self.registry)?;
            check_folder(&self.dir(number))?;
            // Open the outputs of a scene, so that their plugins refuse displays that they do not
            // support. For other inputs, the step that reads or makes the light field opens them.
            if job.scene.is_some() && !matches!(part.kind, PartKind::Node(_)) {
                let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
                if job.nodes.is_empty() {
                    factorize::check_shapes(&job.factorize, &display, &geometry)?;
                }
                self.open_outputs(job, &display, &geometry)?;
            }
        }
        Ok(())
    }
}

/// Checks that the source, output and node plugins of a job exist, and that they accept their
/// parameters.
///
/// # Errors
/// The first plugin or parameter that is wrong.
pub(crate) fn plugins(job: &Job, registry: &Registry) -> Result<(), PipelineError> {
    if let Some(source) = &job.source {
        registry.get_kind(&source.plugin, PluginKind::Source).map_err(PipelineError::Output)?;
        registry.check_params(&source.plugin, &source.params.clone().into()).map_err(PipelineError::Output)?;
    }
    output::check(job, registry)?;
    job.nodes.iter().try_for_each(|node| node::check(node, registry))
}
