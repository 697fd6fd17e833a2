//! Renders the views of a scene into the folder of a light field, by the stages of a run up to the
//! exposure.

use std::path::Path;

use lumistack_core::Task;
use lumistack_field_io::picture::Precision;
use lumistack_plugin_host::Registry;
use lumistack_report::DepthBudget;

use crate::engine;
use crate::error::{PipelineError, display_error, field_error};
use crate::job::{Denoise, Job};
use crate::plan::times;
use crate::stage::field::{field_info, warn_of_depth};
use crate::stage::fields::Shot;
use crate::stage::{channels, denoise, depth, expose, ingest, place, samples, trace};
use crate::store::folder;
use crate::store::names::Work;
use crate::store::{plugin_files, used};
use crate::view_options::ViewOptions;

/// Renders the views of a job's scene into `target_dir`, without factorizing. Returns the depth of
/// the views, compared with the display's depth of field.
///
/// # Errors
/// If the job or the options are wrong, or ingest or rendering fails or is cancelled.
pub fn render_views(
    job: &Job,
    target_dir: &Path,
    options: &ViewOptions,
    registry: &Registry,
    task: Task<'_>,
) -> Result<DepthBudget, PipelineError> {
    let Some(scene) = &job.scene else {
        return Err(PipelineError::job("scene", "a scene to render", "none"));
    };
    let mut job = job.clone();
    // A sequence is rendered at its first time step.
    job.pose = times::first_pose(&job);
    if !options.only.is_empty() && job.render.denoise == Denoise::Auto {
        // A denoiser needs all views, but the options may select only some.
        job.render.denoise = Denoise::Off;
    }
    let given = &plugin_files::resolved(&job, registry)?;
    given.check()?;
    let _owned = folder::lock(target_dir, Work::Views, given, registry, task)?;
    let cache = target_dir.join("cache");
    let job = &plugin_files::resolved(&engine::settled(&job, Some(&cache), task)?, registry)?;
    let display = job.resolve_display()?;
    let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
    // Refuse wrong options before the scene is loaded, which may take minutes.
    options.check(job, &display, geometry.grid.iter().count())?;
    options.chosen(geometry.grid.views())?;
    // Run the stages. Held-out views and views outside the zone are not rendered, since only a
    // report needs them.
    let ingested = ingest::load_scene(scene, &job.pose, &job.importer, registry, &job.light, Some(&cache), task)?;
    let placement = place::place(&ingested, &job.window, &display, &geometry, Some(&cache), task)?;
    let mut job = job.clone();
    (job.render.held_out, job.render.outside) = (0, 0);
    let mut samples = samples::measured(&job, &ingested, &placement, &display, &cache, task)?;
    let least = options.least_samples(&job, &display);
    match &mut samples {
        Some(samples) => samples.per_view = samples.per_view.max(least),
        None if job.render.samples_of_view(geometry.grid.iter().count()) < least => job.render.samples = Some(least),
        None => {}
    }
    let shot =
        Shot { job: &job, ingested: &ingested, placement: &placement, geometry: &geometry, display: &display, samples };
    let (traced, _) = trace::run(shot, options, &cache, task)?;
    denoise::run(shot, &traced.fields, task)?;
    let exposed = expose::run(shot, &traced, options.linear, task)?;
    let budget = depth::budget(&traced.depths, &display, &geometry, &placement);
    warn_of_depth(&budget, task);
    // Automatic exposure depends on the rendered views. So if the views of a light field are
    // rendered in several calls, their exposures may differ.
    let all = geometry.grid.iter().count();
    if traced.views.len() < all && !options.linear && job.light.automatic_exposure {
        let count = traced.views.len();
        let message = format!(
            "the exposure is chosen from {count} of {all} views. If you render the other views separately, set `light.automatic_exposure = false`, or use --linear, so that all views have equal exposure"
        );
        task.warn("exposure", message);
    }
    // Write the folder, and remove cached views of earlier settings.
    let mut info = field_info(exposed.tone_mapping, &placement);
    if options.linear {
        info.insert("tone".into(), "none".into());
        info.insert("radiance".into(), "scene-linear, neither exposed nor clipped".into());
    }
    let channels = channels::write_channels(target_dir, shot, options, &traced, task)?;
    info.extend(channels.map(|channels| ("layers".to_owned(), channels)));
    let precision = if options.linear { Precision::Float } else { Precision::Half };
    lumistack_field_io::write_views(target_dir, &exposed.target, &traced.views, precision, &info)
        .map_err(field_error)?;
    let folders: Vec<_> = traced.fields.iter().map(|field| field.folder.clone()).collect();
    used::keep_only_views(target_dir, &folders)?;
    Ok(budget)
}
