//! Single stages of a run, for callers that have their data in memory and keep the results.

use std::path::{Path, PathBuf};

use lumistack_core::tone::ToneCurve;
use lumistack_core::{Task, Warning};
use lumistack_display::{Display, FieldGeometry, LEAST_DIRECTIONS, LayerStack, LightField, Weights};
use lumistack_factorizer::{Factorization, Iteration, Problem};
use lumistack_field_io::{GeometryDefaults, GeometryFlags, Reading};
use lumistack_plugin_host::{OutputContext, OutputData, Registry, Time};
use lumistack_report::{DepthBudget, ReportInput, Solution};
use lumistack_shot::ToneMapping;
use serde_json::{Map, Value};

use crate::error::{PipelineError, display_error, field_error, host_error};
use crate::job::{FactorizeJob, Job, ReportJob};
use crate::stage::device::on_device;
use crate::stage::factorize::Solve;
use crate::stage::field::{array_weights, eye_weights, warn_of_depth};
use crate::stage::fields::{Block, Shot};
use crate::stage::ingest::Ingested;
use crate::stage::read::{self, OutOfRange};
use crate::stage::score::{self, References};
use crate::stage::{denoise, depth, expose, place, samples, trace};
use crate::store::files::{check_folder, write_report};
use crate::view_options::ViewOptions;

/// A rendered light field.
pub struct RenderedField {
    /// The views, rounded to half floats as in the target of a run.
    pub field: LightField,
    /// The scene's depth compared with the display's depth of field.
    pub depth: DepthBudget,
    /// Factor by which scene-linear radiance is multiplied before the tone curve.
    pub exposure: f64,
    /// Name of the tone curve.
    pub tone: &'static str,
    /// The scene's pictures over the viewing zone, if the job requests them.
    pub references: Option<References>,
}

/// Renders the views of a scene that a display needs, and the pictures for its zone score.
///
/// Uses `window`, `light`, `render`, `seed`, `factorize.eyes` and `report.zone_directions` of the
/// job. Held-out views and views outside the zone are not rendered. Traced views are cached in
/// `cache_dir`.
///
/// # Errors
/// If a value is invalid, or rendering fails or is cancelled.
pub fn render_field(
    job: &Job,
    display: &Display,
    ingested: &Ingested,
    cache_dir: &Path,
    task: Task<'_>,
) -> Result<RenderedField, PipelineError> {
    job.check()?;
    // Place the window, then trace, denoise and expose as a run does.
    let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
    let placement = place::place(ingested, &job.window, display, &geometry, Some(cache_dir), task)?;
    // The report of `write_report_on` has no scores of held-out views or of views outside the zone,
    // so do not render such views.
    let mut job = job.clone();
    (job.render.held_out, job.render.outside) = (0, 0);
    job.render.denoise = job.denoise_for(display);
    let samples = samples::measured(&job, ingested, &placement, display, cache_dir, task)?;
    let shot = Shot { job: &job, ingested, placement: &placement, geometry: &geometry, display, samples };
    let (traced, _) = trace::run(shot, &ViewOptions::default(), cache_dir, task)?;
    denoise::run(shot, &traced.fields, task)?;
    let rendered = expose::run(shot, &traced, false, task)?;
    // Return depth and references, from which the caller can make a report.
    let depth = depth::budget(&traced.depths, display, &geometry, &placement);
    warn_of_depth(&depth, task);
    let (exposure, tone) = (rendered.tone_mapping.exposure, rendered.tone_mapping.curve.name());
    let seen = traced.depths.seen(&placement);
    let zone = score::zone_of(&job, display, &geometry);
    let references =
        References::render(shot, &zone, (rendered.tone_mapping, traced.engine), cache_dir, Block::ALL, task)?;
    let references = references.map(References::held).transpose()?;
    Ok(RenderedField { field: rendered.target.with_depth(Some(seen)), depth, exposure, tone, references })
}

/// Reads a light field of any kind, without rounding. Size and angles come from `flags`, or else
/// from the file, or else from `display`. If `flags` select only some views, some of the other
/// views are returned as references for scores.
///
/// # Errors
/// If the light field cannot be read, or its geometry is incomplete.
pub fn open_field(
    path: &Path,
    flags: &GeometryFlags,
    display: Option<&Display>,
    task: Task<'_>,
) -> Result<(LightField, Option<References>), PipelineError> {
    let defaults = GeometryDefaults {
        width_mm: display.map(|display| display.field_pixels().size_mm()[0]),
        fov_deg: display.map(|display| display.field.fov_deg),
    };
    let footprint = display.map(|display| move |geometry: &FieldGeometry| read::adapted_footprint(display, geometry));
    let footprint = footprint.as_ref().map(|footprint| footprint as lumistack_field_io::Footprint<'_>);
    let most = if flags.views.is_some() { LEAST_DIRECTIONS } else { 0 };
    let reading = Reading { footprint, most_left_out: most, ..Reading::default() };
    let read = lumistack_field_io::open_for(path, flags, &defaults, reading, task);
    let (field, left_out) = read.map_err(field_error)?;
    let references = References::left_out(field.geometry(), left_out);
    Ok((field, references))
}

/// Applies an exposure, in stops, and a tone curve to a copy of a light field. The tone curve is
/// one of `linear` (clips to 0..1), `khronos-neutral` and `agx`.
///
/// # Errors
/// If the tone curve does not exist, or the exposure is not in -100 to 100.
pub fn expose_field(field: &LightField, exposure_ev: f64, tone: &str) -> Result<LightField, PipelineError> {
    let Some((_, curve)) = ToneCurve::ALL.into_iter().find(|(name, _)| *name == tone) else {
        let names = ToneCurve::ALL.map(|(name, _)| name).join(", ");
        return Err(PipelineError::value("light field", "tone", format!("one of {names}"), format!("`{tone}`")));
    };
    if !(exposure_ev.is_finite() && exposure_ev.abs() <= 100.0) {
        return Err(PipelineError::value("light field", "exposure_ev", "-100 to 100", exposure_ev.to_string()));
    }
    let mut field = field.clone();
    ToneMapping { exposure: 2f64.powf(exposure_ev), curve }.apply(&mut field);
    Ok(field)
}

/// Shape and values of an array of weights. `None` stands for the weights of the job's expected
/// eyes, or for uniform weights without eyes.
pub type WeightsFrom = Option<(Vec<usize>, Vec<f32>)>;

/// Returns the weights in an array, `[view_y][view_x]` or `[view_y][view_x][row][col]`. Without an
/// array, returns the weights of the job's expected eyes.
///
/// # Errors
/// If the weights do not match the light field, or the job has eyes and there is an array.
pub fn weights_of(job: &FactorizeJob, array: WeightsFrom, target: &LightField) -> Result<Weights, PipelineError> {
    match array {
        Some(_) if !job.eyes.is_empty() => {
            Err(PipelineError::value("factorize", "eyes", "either `weights` or `eyes`", "both"))
        }
        Some((shape, data)) => array_weights(Path::new("weights"), &shape, data, target.geometry()),
        None => eye_weights(job, target.geometry()),
    }
}

/// Factorizes a light field. Files that the job names are not read. `on_iteration` is called
/// whenever the objective is evaluated.
///
/// # Errors
/// If display, light field, weights and settings do not match, the job's device is not available or
/// fails, or the task is cancelled.
pub fn factorize_field(
    problem: &Problem<'_>,
    job: &FactorizeJob,
    seed: u64,
    warm: Option<&LayerStack>,
    task: Task<'_>,
    on_iteration: &mut dyn FnMut(&Iteration),
) -> Result<Factorization, PipelineError> {
    if let Some(out_of_range) = OutOfRange::of(problem.target) {
        task.warn("light field", out_of_range.message(read::REMEDY_IN_PYTHON));
    }
    let Problem { display, target, weights } = *problem;
    let solve = Solve { job, seed, display, target, weights };
    on_device(&job.device, task, |site| solve.factorize(site, warm, task, on_iteration))
}

/// Writes files with an output plugin into `out_dir`. Returns the paths of the files, relative to
/// `out_dir`.
///
/// # Errors
/// If the plugin does not exist, it refuses the parameters or the data, or the files cannot be
/// written.
pub fn write_output(
    registry: &Registry,
    plugin: &str,
    params: Map<String, Value>,
    display: &Display,
    data: OutputData<'_>,
    out_dir: &Path,
    task: Task<'_>,
) -> Result<Vec<PathBuf>, PipelineError> {
    let context = OutputContext { display, data, time: Time::default(), out_dir, task };
    lumistack_plugin_host::run_output(registry, plugin, &params.into(), context).map_err(host_error)
}

/// Input of [`write_report_on`].
pub struct ReportOn<'a> {
    /// Title of the report.
    pub title: &'a str,
    /// The display.
    pub display: &'a Display,
    /// Patterns of the display.
    pub stack: &'a LayerStack,
    /// Target of the display.
    pub target: &'a LightField,
    /// The scene's pictures over the viewing zone, if there are any.
    pub references: Option<&'a References>,
    /// Weights of the target's rays.
    pub weights: &'a Weights,
    /// Settings and convergence of a solver, if a solver made the patterns.
    pub solution: Option<(&'a Solution, &'a [lumistack_report::Iteration])>,
    /// Table of settings in the report.
    pub settings: &'a Value,
}

/// Writes `report.html` and `report.json` into `folder`. Returns the content of `report.json`.
///
/// # Errors
/// If the data in `on` do not match each other, a file cannot be written, or the task is cancelled.
pub fn write_report_on(on: &ReportOn<'_>, folder: &Path, task: Task<'_>) -> Result<Value, PipelineError> {
    check_folder(folder)?;
    // Values outside 0..1 may dominate all scores, so the report must warn about them.
    let out_of_range = OutOfRange::of(on.target).map(|out_of_range| out_of_range.message(read::REMEDY_IN_PYTHON));
    let warnings: Vec<_> =
        out_of_range.into_iter().map(|message| Warning { place: "light field".into(), message }).collect();
    // The zone score needs references. Only rendered scenes, and light fields with left-out views,
    // have them.
    let zone = on.references.map(|references| references.measure(on.display, on.stack, task)).transpose()?;
    let report = lumistack_report::build(
        &ReportInput {
            title: on.title,
            display: on.display,
            stack: on.stack,
            target: on.target,
            weights: on.weights,
            held_out: None,
            outside: None,
            zone: zone.as_ref(),
            pixels_per_degree: ReportJob::default().pixels_per_degree,
            convergence: on.solution.map_or(&[], |(_, steps)| steps),
            solution: on.solution.map(|(solution, _)| solution),
            stages: &[],
            settings: on.settings,
            denoising: None,
            scene: None,
            depth: None,
            warnings: &warnings,
            outputs: &[],
            command: None,
            version: env!("CARGO_PKG_VERSION"),
        },
        task,
    )
    // If the report was cancelled, return the error of cancelled work.
    .map_err(|error| match error {
        lumistack_report::ReportError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Report(other),
    })?;
    lumistack_field_io::atomic::create_folder(folder).map_err(field_error)?;
    write_report(folder, &report.html, &report.json)?;
    Ok(report.json)
}
