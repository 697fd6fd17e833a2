//! Predicts depth, coverage and memory of a scene on a display, without rendering.

use lumistack_core::Task;
use lumistack_display::Display;
use lumistack_pathtracer::Memory;
use lumistack_plugin_host::Registry;
use lumistack_report::DepthBudget;
use lumistack_shot::Depths;

use crate::error::{PipelineError, display_error};
use crate::job::Job;
use crate::stage::ingest::load_scene;
use crate::stage::{depth, place};

/// Depth, coverage and memory of a scene on a display.
pub struct Prediction {
    /// The scene's depth compared with the display's depth of field.
    pub depth: DepthBudget,
    /// Fraction of the window where the middle view has a hit, 0..1.
    pub coverage: f64,
    /// Memory of the scene when it is ready for rendering.
    pub memory: Memory,
}

/// Places the job's display in the job's scene as a run does. Then traces the depth of the views,
/// and measures the scene's depth, coverage and memory.
///
/// # Errors
/// If the job has no scene, or its scene, display or window is wrong.
pub fn predict(job: &Job, registry: &Registry, task: Task<'_>) -> Result<Prediction, PipelineError> {
    predict_on(job, &job.resolve_display()?, registry, task)
}

/// Makes the prediction of [`predict`] for another display than the display of the job.
///
/// # Errors
/// The errors of [`predict`].
pub fn predict_on(
    job: &Job,
    display: &Display,
    registry: &Registry,
    task: Task<'_>,
) -> Result<Prediction, PipelineError> {
    let Some(scene) = &job.scene else {
        return Err(PipelineError::job("scene", "a scene", "none"));
    };
    let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
    let ingested = load_scene(scene, &job.pose, &job.importer, registry, &job.light, None, task)?;
    let placement = place::place(&ingested, &job.window, display, &geometry, None, task)?;
    let renderer = ingested.renderer(task)?;
    let traced = geometry.with_grid(geometry.grid.scaled(placement.depth_scale));
    let depths = Depths::trace(renderer, &placement.window, &traced, task)?;
    let coverage = depths.coverage(geometry.grid.views().map(|count| count / 2));
    Ok(Prediction {
        depth: depth::budget(&depths, display, &geometry, &placement),
        coverage,
        memory: renderer.tracer.memory(),
    })
}
