//! Nodes: plugins that make the patterns of a display from a light field. The node `tensor-display`
//! is the solver in this process. Other nodes receive the light field through the plugin interface
//! (ABI).

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, LayerStack, LightField, Weights};
use lumistack_plugin_host::{NodeData, PluginKind, Registry};

use super::factorize::{Convergence, Solved, reuse_or_make};
use super::field::add_weights;
use crate::error::{PipelineError, display_error, host_error};
use crate::job::NodeJob;
use crate::store::code;
use crate::store::key::KeyBuilder;
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;

/// Returns true if the solver of this program makes the patterns of a node, or of a job without
/// nodes.
pub(crate) fn is_factorized(node: Option<&NodeJob>) -> bool {
    node.is_none_or(|node| node.plugin == NodeJob::TENSOR_DISPLAY)
}

/// Checks a node's plugin and parameters, without any work.
///
/// # Errors
/// If the node plugin does not exist, or it refuses the parameters.
pub(crate) fn check(node: &NodeJob, registry: &Registry) -> Result<(), PipelineError> {
    if is_factorized(Some(node)) {
        return Ok(());
    }
    registry.get_kind(&node.plugin, PluginKind::Node).map_err(PipelineError::Output)?;
    registry.check_params(&node.plugin, &node.params.clone().into()).map_err(PipelineError::Output)?;
    Ok(())
}

/// Returns the display of a node for a light field of this geometry. If the node names a display,
/// `of_job` is this display. The result is then `of_job`, adapted to the geometry, and a text if
/// the adaptation changes the backlight. Otherwise the result is `shared`, without a text.
///
/// # Errors
/// If the display cannot show the light field.
pub(crate) fn display(
    node: &NodeJob,
    of_job: &Display,
    shared: &Display,
    geometry: &FieldGeometry,
) -> Result<(Display, Option<String>), PipelineError> {
    let place = format!("node `{}`", node.id);
    let (display, change) = match node.display {
        Some(_) => {
            let adapted = of_job.adapted_to(geometry).map_err(|source| display_error(source, &place))?;
            let change = of_job.backlight_change(&adapted);
            (adapted, change)
        }
        None => (shared.clone(), None),
    };
    display.check().map_err(|source| display_error(source, &place))?;
    Ok((display, change))
}

/// The input of a node plugin.
#[derive(Clone, Copy)]
pub(crate) struct NodeInput<'a> {
    pub(crate) node: &'a NodeJob,
    pub(crate) seed: u64,
    pub(crate) display: &'a Display,
    pub(crate) target: &'a LightField,
    pub(crate) weights: &'a Weights,
}

/// Returns the patterns of a node plugin in `layers/`, and true if they were cached.
///
/// # Errors
/// If the plugin fails or is cancelled, or a file cannot be written.
pub(crate) fn run(
    given: NodeInput<'_>,
    stamps: &Stamps,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(Solved, bool), PipelineError> {
    let NodeInput { node, seed, display, target, weights } = given;
    // The baselines among the node plugins use the factorizer, so the factorizer's code is part of
    // the key.
    let mut key = KeyBuilder::new("node", code::PATTERNS);
    key.add("plugin", plugin_key(registry, &node.plugin, &node.params)?.as_bytes())
        .add("display", display.to_toml().as_bytes())
        .add("geometry", format!("{:?}", target.geometry()).as_bytes())
        .add_field("target", target)
        .add_json("seed", &seed);
    add_weights(&mut key, weights);
    reuse_or_make("node", &key.finish(), display, stamps, || make(given, registry, task))
}

/// Makes the patterns with a node plugin, without the cache. Returns the patterns and their
/// convergence.
///
/// # Errors
/// If the plugin fails or is cancelled.
pub(crate) fn make(
    given: NodeInput<'_>,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(LayerStack, Option<Convergence>), PipelineError> {
    let NodeInput { node, seed, display, target, weights } = given;
    let data = NodeData { weights, seed, ..NodeData::new(display, target) };
    let made = lumistack_plugin_host::make_stack(registry, &node.plugin, &node.params.clone().into(), &data, task)
        .map_err(host_error)?;
    Ok((made.stack, made.solution.map(|solution| Convergence::of_node(solution, &made.steps))))
}
