//! The package's functions.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use lumistack_core::Task;
use lumistack_display::{Display as Description, LightField as Field};
use lumistack_factorizer::Problem;
use lumistack_pipeline::{
    FactorizeJob, Job, LightJob, OutputData, PipelineError, Registry, RenderJob, ReportOn, Viewpoint, WindowJob,
    factorize_field, picture_from, plugin_list, presets, render_field, weights_of, write_output, write_report_on,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyString};
use serde_json::{Map, Value, json};

use crate::array::{Array, Part, Values};
use crate::display::{adapted, display_of};
use crate::error::{exception, of_call, raised, setting};
use crate::field::LightField;
use crate::json::{map_of, numbers, parsed, table, table_of, to_python, value_of};
use crate::plugin::{registry, set_launcher};
use crate::scene::Scene;
use crate::solved::Solved;
use crate::stack::LayerStack;
use crate::work::{command, long};

/// Renders, with the path tracer, the views of a scene that a display needs.
///
/// scene: a Scene, or a scene's path; display: a Display, or an argument for Display(); the default
/// is "paper-three-layer". All other arguments are optional and have the meaning of a job file's
/// keys (docs/JOB.md); defaults() returns the defaults:
///
/// * samples: paths per pixel of each view, 1 to 65536
/// * zone_samples: instead of samples, paths per pixel, summed over all views; "auto" chooses the
///   number such that more paths would hardly improve the display's picture
/// * max_bounces: largest number of bounces (scattering events) of a path, the bounce at the first
///   hit included, 0 to 1024
/// * clamp: largest value of a single path; brighter paths are dimmed to this value
/// * denoise: "auto", "off", "shared", "guided" or "oidn"
/// * angular_filter: "point", "bin" or "display"
/// * lens_deg: aperture of a lens that is focused on the display plane, as the full angle seen from
///   this plane, degrees, 0 to 90
/// * camera: name or number of the camera that sees the scene; its plane of focus, if any, becomes
///   the display plane
/// * look_from: (azimuth, elevation) from which the scene is seen, degrees
/// * fit_depth: "auto", "off", "move" or "compress"
/// * depth_scale: factor on parallax, 0.001 to 10
/// * window: a mapping with the other keys of [window], such as {"from": "bounds"}
/// * exposure_ev: stops added to the automatic exposure
/// * tone: "auto", "linear", "khronos-neutral" or "agx"
/// * light: a mapping with the other keys of [light]
/// * seed: seed of all random numbers; the same seed gives the same values on any number of threads
/// * zone_directions: number of reference pictures, in directions all over the viewing zone, 32 to
///   4096; 0 for none. psnr_zone() and report() compare seen pictures with the reference pictures
/// * cache: a folder for traced views, so that a later call continues a call that was stopped;
///   without a folder, traced views are discarded
/// * callback: callback(stage, fraction) receives progress
///
/// Returns a LightField for factorize(). Ctrl-C stops the call.
#[pyfunction]
#[pyo3(signature = (
    scene, display=None, *, samples=None, zone_samples=None, max_bounces=None, clamp=None, denoise=None, angular_filter=None, lens_deg=None, camera=None, look_from=None, fit_depth=None,
    depth_scale=None, window=None, exposure_ev=None, tone=None, light=None, seed=None, zone_directions=0, cache=None, callback=None
))]
pub(crate) fn render(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    display: Option<&Bound<'_, PyAny>>,
    samples: Option<&Bound<'_, PyAny>>,
    zone_samples: Option<&Bound<'_, PyAny>>,
    max_bounces: Option<&Bound<'_, PyAny>>,
    clamp: Option<&Bound<'_, PyAny>>,
    denoise: Option<&Bound<'_, PyAny>>,
    angular_filter: Option<&Bound<'_, PyAny>>,
    lens_deg: Option<&Bound<'_, PyAny>>,
    camera: Option<&Bound<'_, PyAny>>,
    look_from: Option<&Bound<'_, PyAny>>,
    fit_depth: Option<&Bound<'_, PyAny>>,
    depth_scale: Option<&Bound<'_, PyAny>>,
    window: Option<&Bound<'_, PyAny>>,
    exposure_ev: Option<&Bound<'_, PyAny>>,
    tone: Option<&Bound<'_, PyAny>>,
    light: Option<&Bound<'_, PyAny>>,
    seed: Option<u64>,
    zone_directions: usize,
    cache: Option<PathBuf>,
    callback: Option<&Bound<'_, PyAny>>,
) -> PyResult<LightField> {
    // Read the settings as tables of a job, so that the job's checks apply.
    let render: RenderJob = table(
        py,
        "render",
        &[
            ("samples", samples),
            ("zone_samples", zone_samples),
            ("max_bounces", max_bounces),
            ("clamp", clamp),
            ("denoise", denoise),
            ("angular_filter", angular_filter),
            ("lens_deg", lens_deg),
        ],
    )?;
    let lit = [("exposure_ev", exposure_ev), ("tone", tone)];
    table::<LightJob>(py, "render", &lit)?;
    let camera = camera.map(|camera| camera.str()).transpose()?.map(Bound::into_any);
    let fit =
        [("camera", camera.as_ref()), ("look_from", look_from), ("fit_depth", fit_depth), ("depth_scale", depth_scale)];
    table::<WindowJob>(py, "render", &fit)?;
    let window: WindowJob = parsed(py, "window", merged("window", window, &fit)?)?;
    // Load the scene, unless the argument is a loaded Scene.
    let loaded;
    let scene = match scene.cast::<Scene>() {
        Ok(scene) => scene.get(),
        Err(_) => {
            let light = light.map(|light| table_of("light", light)).transpose()?.unwrap_or_default();
            loaded = Scene::load(py, scene, Default::default(), light, Default::default(), callback)?;
            &loaded
        }
    };
    if let Some(camera) = camera.as_ref().filter(|_| scene.ingested.scene.cameras.is_empty()) {
        return Err(setting(
            py,
            format!("render: camera: expected no value, since the scene has no cameras, found {camera}"),
        ));
    }
    let Value::Object(mut lights) = serde_json::to_value(&scene.light).expect("settings serialize") else {
        unreachable!("a table is an object")
    };
    lights.extend(merged("light", light, &lit)?);
    let display = display_of(py, display)?;
    let mut job = Job::new(Default::default());
    (job.render, job.window, job.light) = (render, window, parsed(py, "light", lights)?);
    // The lights belong to the Scene, so other settings of lights in this call are an error.
    for (key, differs) in [
        ("environment", job.light.environment != scene.light.environment),
        ("environment_strength", job.light.environment_strength != scene.light.environment_strength),
        ("environment_rotation_deg", job.light.environment_rotation_deg != scene.light.environment_rotation_deg),
        ("from_splats", job.light.from_splats != scene.light.from_splats),
        ("automatic", job.light.automatic != scene.light.automatic),
        ("visible", job.light.visible != scene.light.visible),
    ] {
        if differs {
            let message = format!(
                "light.{key}: expected the value with which the Scene was loaded, since the lights belong to the Scene, found a different value in this call"
            );
            return Err(setting(py, message));
        }
    }
    // Trace the views. Without a cache they are kept in a temporary folder.
    job.report.zone_directions = zone_directions;
    (job.scene, job.seed) = (Some(scene.path.clone()), seed.unwrap_or(job.seed));
    let traced = long(py, callback, |task| {
        let forgotten = match &cache {
            Some(_) => None,
            None => Some(tempfile::tempdir().map_err(PipelineError::write(&std::env::temp_dir()))?),
        };
        let folder = forgotten.as_ref().map(tempfile::TempDir::path).or(cache.as_deref()).unwrap_or(Path::new("."));
        render_field(&job, &display, &scene.ingested, folder, task).map_err(|error| of_call("render", error))
    })?;
    // Keep the settings for `info`.
    let mut info = Map::new();
    info.insert("scene".into(), scene.path.display().to_string().into());
    info.insert("exposure".into(), traced.exposure.into());
    info.insert("tone".into(), traced.tone.into());
    info.insert("depth".into(), traced.depth.to_json());
    info.insert("depth_sentence".into(), traced.depth.sentence().into());
    let references = traced.references.map(Arc::new);
    Ok(LightField { field: Arc::new(traced.field), display: Some(display), info, references })
}

/// Factorizes a light field into the patterns of a display.
///
/// light_field: a LightField, from render() or from an array; display: a Display, or an argument
/// for Display(). The default is the display for which the light field was made, otherwise
/// "paper-three-layer". The display is adapted to the light field's resolution, size and views. All
/// other arguments are optional and have the meaning of a job file's keys (docs/JOB.md); defaults()
/// returns the defaults:
///
/// * brightness: β, above 0 and at most 1, instead of the display's brightness
/// * frames: M, 1 to 1000, instead of the display's number of frames
/// * solver: "auto", "multiplicative" (the paper's rule), "block-exact" or "extrapolated"
/// * iterations: number of iterations, by default 50; each updates every factor once
/// * start: "auto", "random", "smooth" or "content"
/// * coarse_levels, coarse_iterations: number of coarser levels, each at half the resolution of the
///   next finer level, and iterations at each coarser level
/// * levels: with True, masks of layers with few bits are optimized once more, on the values that
///   the panel can show
/// * weights: an array ≥ 0, [view_y, view_x] or [view_y, view_x, row, col]
/// * eyes: expected eyes, a list of {"eye_mm": (x, y, z), "sigma_mm": s, "weight": w}, instead of
///   weights
/// * eye_floor: weight of rays far from every eye
/// * warm_start: a LayerStack of the same display, used as the start
/// * seed: seed of all random numbers; the same seed gives the same patterns on any number of
///   threads
/// * callback: callback(stage, fraction) receives progress
///
/// Returns a LayerStack. Python's lock is released, and Ctrl-C stops the call.
#[pyfunction]
#[pyo3(signature = (
    light_field, display=None, *, brightness=None, frames=None, solver=None, iterations=None, start=None, coarse_levels=None, coarse_iterations=None,
    levels=None, weights=None, eyes=None, eye_floor=None, warm_start=None, seed=None, callback=None
))]
pub(crate) fn factorize(
    py: Python<'_>,
    light_field: &Bound<'_, PyAny>,
    display: Option<&Bound<'_, PyAny>>,
    brightness: Option<&Bound<'_, PyAny>>,
    frames: Option<&Bound<'_, PyAny>>,
    solver: Option<&Bound<'_, PyAny>>,
    iterations: Option<&Bound<'_, PyAny>>,
    start: Option<&Bound<'_, PyAny>>,
    coarse_levels: Option<&Bound<'_, PyAny>>,
    coarse_iterations: Option<&Bound<'_, PyAny>>,
    levels: Option<&Bound<'_, PyAny>>,
    weights: Option<&Bound<'_, PyAny>>,
    eyes: Option<&Bound<'_, PyAny>>,
    eye_floor: Option<&Bound<'_, PyAny>>,
    warm_start: Option<&Bound<'_, PyAny>>,
    seed: Option<u64>,
    callback: Option<&Bound<'_, PyAny>>,
) -> PyResult<LayerStack> {
    let warm_start = warm_start.map(|object| LayerStack::of("warm_start", object)).transpose()?;
    let light_field = LightField::of("light_field", light_field)?;
    let (brightness, frames) = (numbers("brightness", brightness)?, numbers("frames", frames)?);
    if let Some(found) = py.detach(|| not_finite(&light_field.field)) {
        return Err(exception(py, "FactorizeError", &format!("light_field, {found}")));
    }
    // Read the settings as a table of a job, so that the job's checks apply.
    let arguments = [
        ("solver", solver),
        ("iterations", iterations),
        ("start", start),
        ("coarse_levels", coarse_levels),
        ("coarse_iterations", coarse_iterations),
        ("levels", levels),
        ("eyes", eyes),
        ("eye_floor", eye_floor),
    ];
    let job: FactorizeJob = table(py, "factorize", &arguments)?;
    // Adapt the display to the light field.
    let is_default = display.is_none() && light_field.display.is_none();
    let display = match (display, &light_field.display) {
        (None, Some(display)) => display.clone(),
        (display, _) => display_of(py, display)?,
    };
    let own = display;
    let mut display = adapted(py, &own, &light_field.field)?;
    if brightness.is_some() || frames.is_some() {
        let changed = Arc::make_mut(&mut display);
        changed.brightness = brightness.unwrap_or(changed.brightness);
        changed.frames = frames.unwrap_or(changed.frames);
    }
    if let Err(source) = display.check() {
        let path = PathBuf::from(&display.name);
        return Err(raised(py, &PipelineError::Display { path, text: String::new(), source }));
    }
    // Run the solver in another thread. Record the time of every evaluation of the objective, for
    // the report.
    let weights = weights.map(|weights| Values::read(weights, "weights")).transpose()?.map(Values::into_parts);
    let seed = seed.unwrap_or(Job::new(Default::default()).seed);
    let warm = warm_start.map(|warm| &*warm.stack);
    let target = &*light_field.field;
    let (made, seconds) = long(py, callback, |task| {
        if let Some(warm) = warm {
            let path = "warm_start".into();
            warm.check(&display).map_err(|source| PipelineError::Stack { path, source })?;
        }
        if is_default {
            task.warn("display", default_warning(&display));
        }
        if let Some(change) = own.backlight_change(&display) {
            task.warn("display", change);
        }
        let weights = weights_of(&job, weights, target).map_err(|error| of_call("factorize", error))?;
        let problem = Problem { display: &display, target, weights: &weights };
        let (start, mut seconds) = (Instant::now(), Vec::new());
        let mut watch = |_: &_| seconds.push(start.elapsed().as_secs_f64());
        let made = factorize_field(&problem, &job, seed, warm, task, &mut watch);
        let made = made.map_err(|error| of_call("factorize", error))?;
        Ok((made, seconds))
    })?;
    let solved = Some(Solved::of(&made, &seconds, warm.is_some()));
    Ok(LayerStack { stack: Arc::new(made.stack), display, solved })
}

/// Simulates a display: returns the picture seen from a viewpoint, as a NumPy array [row, col, rgb]
/// of linear values.
///
/// The viewpoint is one of these arguments; the default is the slope (0, 0):
///
/// * slope: (x, y), to the right and up; a parallel projection
/// * angle_deg: (x, y), angles to the right and up, degrees; a parallel projection
/// * eye_mm: (x, y, z), right, up and in front of the display's centre, millimetres; a perspective
///   view
///
/// The picture is L̃/β, as an adapted viewer sees it; with raw=True it is the emitted light L̃
/// itself.
#[pyfunction]
#[pyo3(signature = (stack, slope=None, *, angle_deg=None, eye_mm=None, raw=false))]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    stack: &Bound<'py, PyAny>,
    slope: Option<&Bound<'_, PyAny>>,
    angle_deg: Option<&Bound<'_, PyAny>>,
    eye_mm: Option<&Bound<'_, PyAny>>,
    raw: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let stack = LayerStack::of("stack", stack)?;
    let (slope, angle) = (numbers("slope", slope)?, numbers("angle_deg", angle_deg)?);
    let viewpoint = match (slope, angle, numbers("eye_mm", eye_mm)?) {
        (None, None, None) => Viewpoint::Slope([0.0, 0.0]),
        (Some(slope), None, None) => Viewpoint::Slope(slope),
        (None, Some(angle), None) => Viewpoint::Angle(angle),
        (None, None, Some(eye_mm)) => Viewpoint::Eye(eye_mm),
        _ => {
            return Err(setting(
                py,
                "simulate: expected at most one of `slope`, `angle_deg` and `eye_mm`, found several",
            ));
        }
    };
    let picture = py.detach(|| picture_from(&stack.display, &stack.stack, viewpoint, raw));
    let picture = picture.map_err(|error| raised(py, &error))?;
    Array::numpy(py, Part::Picture(Arc::new(picture)))
}

/// Writes patterns or a light field with an output plugin; plugins() lists the plugins.
///
/// * `what`: a LayerStack or a LightField
/// * plugin: id of the output plugin
/// * folder: the destination, created if necessary
/// * display: for a light field, the display that shows it
/// * target: for patterns, the light field that they should show; some plugins compare it with the
///   patterns
/// * params: the plugin's own parameters by name
///
/// Returns the files, relative to the folder. They appear together after the plugin has finished,
/// or not at all.
#[pyfunction]
#[pyo3(signature = (what, plugin, folder, *, display=None, target=None, callback=None, **params))]
pub(crate) fn write(
    py: Python<'_>,
    what: &Bound<'_, PyAny>,
    plugin: &str,
    folder: PathBuf,
    display: Option<&Bound<'_, PyAny>>,
    target: Option<&Bound<'_, PyAny>>,
    callback: Option<&Bound<'_, PyAny>>,
    params: Option<&Bound<'_, PyDict>>,
) -> PyResult<Vec<PathBuf>> {
    let target = target.map(|object| LightField::of("target", object)).transpose()?;
    // Find the data and their display.
    let registry = registry(py)?;
    let params = params.map(|params| map_of("params", params.as_any())).transpose()?.unwrap_or_default();
    let mut is_default = false;
    let (display, stack, field) = if let Ok(stack) = what.cast::<LayerStack>() {
        let stack = stack.get();
        if display.is_some() {
            return Err(setting(
                py,
                "write: expected no `display`, since patterns have a display of their own, found a display",
            ));
        }
        (stack.display.clone(), Some(stack.stack.clone()), target.map(|target| target.field.clone()))
    } else if let Ok(field) = what.cast::<LightField>() {
        if target.is_some() {
            let text =
                "write: expected no `target`, since a light field is written without another one, found a target";
            return Err(setting(py, text));
        }
        let field = field.get();
        is_default = display.is_none() && field.display.is_none();
        let display = match (display, &field.display) {
            (None, Some(display)) => display.clone(),
            (display, _) => display_of(py, display)?,
        };
        (adapted(py, &display, &field.field)?, None, Some(field.field.clone()))
    } else {
        let found = what.get_type().name()?;
        return Err(PyTypeError::new_err(format!("write: expected a LayerStack or a LightField, found {found}")));
    };
    long(py, callback, |task| {
        if is_default {
            task.warn("display", default_warning(&display));
        }
        let data = match (&stack, &field) {
            (Some(stack), target) => OutputData::LayerStack(stack, target.as_deref()),
            (None, Some(field)) => OutputData::LightField(field),
            (None, None) => return Err(PipelineError::value("write", "what", "patterns or a light field", "neither")),
        };
        write_output(registry, plugin, params, &display, data, &folder, task)
    })
}

/// Compares patterns with the light field that they should show. If the light field has reference
/// pictures of the viewing zone, the comparison covers these, too. Writes report.html and
/// report.json into a folder, and returns the content of report.json.
#[pyfunction]
#[pyo3(signature = (stack, light_field, folder, *, title=None, weights=None, callback=None))]
pub(crate) fn report<'py>(
    py: Python<'py>,
    stack: &Bound<'py, PyAny>,
    light_field: &Bound<'py, PyAny>,
    folder: PathBuf,
    title: Option<&str>,
    weights: Option<&Bound<'_, PyAny>>,
    callback: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let light_field = LightField::of("light_field", light_field)?;
    let stack = LayerStack::of("stack", stack)?;
    let weights = weights.map(|weights| Values::read(weights, "weights")).transpose()?.map(Values::into_parts);
    let target = &*light_field.field;
    if let Some(found) = py.detach(|| not_finite(target)) {
        return Err(exception(py, "DataError", &format!("light_field, {found}")));
    }
    let title = title.unwrap_or(&stack.display.name);
    let settings = json!({ "light field": light_field.info, "display": stack.display.name });
    let answer = long(py, callback, |task| {
        let weights = &weights_of(&FactorizeJob::default(), weights, target)?;
        let solution = stack.solved.as_ref().map(|solved| (&solved.solution, solved.steps.as_slice()));
        let (display, stack, settings) = (&*stack.display, &*stack.stack, &settings);
        let references = light_field.references.as_deref();
        write_report_on(
            &ReportOn { title, display, stack, target, references, weights, solution, settings },
            &folder,
            task,
        )
    })?;
    to_python(py, &answer)
}

/// Runs a whole job into a folder, like `lumistack run`. Finished results are kept, and the same
/// call continues a run that was stopped.
///
/// job: path of a job file, or a mapping with its keys (docs/JOB.md). Paths in a mapping are
/// relative to the working folder. folder: the run's folder; by default its path is runs/ and the
/// job's name. Returns the summary: report, psnr_view, psnr_raw, and so on.
#[pyfunction]
#[pyo3(signature = (job, folder=None, *, callback=None))]
pub(crate) fn run<'py>(
    py: Python<'py>,
    job: &Bound<'_, PyAny>,
    folder: Option<PathBuf>,
    callback: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let is_mapping = job.cast::<PyMapping>().is_ok() && job.cast::<PyString>().is_err();
    let job = if is_mapping {
        let mut job: Job = parsed(py, "job", map_of("job", job)?)?;
        if job.name.is_empty() {
            job.name = "job".into();
        }
        job
    } else {
        Job::load(&job.extract::<PathBuf>()?).map_err(|error| raised(py, &error))?
    };
    let folder = folder.unwrap_or_else(|| Path::new("runs").join(&job.name));
    let registry = registry(py)?;
    let summary = long(py, callback, |task| {
        warn_of_plugins(registry, task);
        lumistack_pipeline::run(&job, &folder, registry, None, task)
    })?;
    to_python(py, &serde_json::to_value(&summary).expect("summaries serialize"))
}

fn warn_of_plugins(registry: &Registry, task: Task<'_>) {
    registry.failed().iter().for_each(|error| task.warn("plugin", error.to_string()));
}

/// Returns the content of a file or folder, as `lumistack info --json` does: a scene, a light
/// field, patterns, a run, a display or a job.
#[pyfunction]
#[pyo3(signature = (path, *, callback=None))]
pub(crate) fn info<'py>(
    py: Python<'py>,
    path: PathBuf,
    callback: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let registry = registry(py)?;
    let value = long(py, callback, |task| lumistack_cli::describe_path(&path, registry, task))?;
    to_python(py, &value)
}

/// Returns all plugins: dictionaries with id, kind, version, doc, ports, origin and params.
///
/// params is a list of parameters. Each has a name, help, kind, default, range and unit.
#[pyfunction]
pub(crate) fn plugins(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let registry = registry(py)?;
    // for this list every library is loaded, in its own process
    let list = py.detach(|| plugin_list(registry, &[])).map_err(|error| raised(py, &error))?;
    to_python(py, &list["plugins"])
}

/// Returns the names of the built-in displays; Display(name) makes a display from a name.
#[pyfunction]
pub(crate) fn displays() -> Vec<&'static str> {
    presets::PRESETS.iter().map(|(name, _)| *name).collect()
}

/// Returns the defaults of a job's settings. Settings without a fixed default, such as samples and
/// iterations, are absent.
///
/// >>> defaults()["render"]["max_bounces"]
/// 6
#[pyfunction]
pub(crate) fn defaults(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    to_python(py, &serde_json::to_value(Job::new(Default::default())).expect("jobs serialize"))
}

/// Sets the number of worker threads of the process; results do not depend on this number. Call
/// this function before any other work.
#[pyfunction]
pub(crate) fn set_threads(py: Python<'_>, count: usize) -> PyResult<()> {
    if count == 0 {
        return Err(setting(py, "set_threads: expected 1 or more, found 0"));
    }
    lumistack_pipeline::set_threads(count).map_err(|_| {
        let found =
            "worker threads that have already started; call set_threads before all other functions of the package";
        setting(py, format!("set_threads: expected no worker threads yet, found {found}"))
    })
}

/// Runs the command `lumistack` with these arguments and returns its exit code: 0 done, 1 failed, 2
/// wrong usage, 130 interrupted. Messages name the command as `program`.
#[pyfunction]
#[pyo3(signature = (arguments, program = None))]
pub(crate) fn main(py: Python<'_>, arguments: Vec<OsString>, program: Option<OsString>) -> PyResult<u8> {
    set_launcher(py);
    let program = program.unwrap_or_else(|| "lumistack".into());
    let words: Vec<OsString> = std::iter::once(program).chain(arguments).collect();
    command(py, &words)
}

/// Returns the place of the first value that is not finite, and the remedy; `None` if all values
/// are finite.
fn not_finite(field: &Field) -> Option<String> {
    let values = field.radiance().data();
    let at = values.iter().position(|value| !value.is_finite())?;
    let [_, view_cols, rows, cols, channels] = field.radiance().shape();
    let (channel, pixel) = (["red", "green", "blue"][at % channels], at / channels);
    let (col, row, view) = (pixel % cols, pixel / cols % rows, pixel / cols / rows);
    let view = format!("view [{}, {}], row {row}, column {col}, {channel}", view / view_cols, view % view_cols);
    let remedy = "replace values that are not finite, for example with numpy.nan_to_num";
    Some(format!("{view}: expected a finite value, found {}; {remedy}", values[at]))
}

/// Returns the warning that a light field without a display gets the default display.
fn default_warning(display: &Description) -> String {
    format!(
        "the light field has no display, so the default display is used, {} with {} frames. Remedy: pass display= in this call or to LightField(...)",
        display.name, display.frames
    )
}

/// Merges a mapping with named arguments; the arguments take precedence.
fn merged(
    place: &str,
    mapping: Option<&Bound<'_, PyAny>>,
    arguments: crate::json::Arguments<'_, '_>,
) -> PyResult<Map<String, Value>> {
    let mut map = mapping.map(|mapping| map_of(place, mapping)).transpose()?.unwrap_or_default();
    for (name, value) in arguments {
        if let Some(value) = value {
            map.insert((*name).into(), value_of(place, value)?);
        }
    }
    Ok(map)
}
