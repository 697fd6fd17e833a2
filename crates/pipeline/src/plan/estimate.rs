//! Estimates of a plan without executing it: keys, cached results, time and memory.
//!
//! ```text
//! key of a step = hash(stage, code, values of the job that it reads, keys of its inputs,
//!                      content of its files)
//! time          = work of the step / rate
//! rate          = work / time of the last run in this folder, or else of a short calibration
//! ```
//!
//! A stamp identifies a result by the content of its inputs, which exists only after the earlier
//! stages. The keys of this file need only the job, the files that it names, and the scene's files
//! that the last run listed. A run writes the keys to `cache/steps.json`, where the next plan finds
//! which results are current. The run also writes the time of each step, and the scene's files.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Backlight, Display, FieldGeometry, ViewGrid};
use lumistack_factorizer::{held_bytes, paged_bytes, weight_bytes};
use lumistack_field_io::npy::NpyFile;
use lumistack_pathtracer::Settings;
use lumistack_pathtracer::denoise::SharedLight;
use lumistack_plugin_host::Registry;
use lumistack_shot::Depths;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::disk::{self, Disk};
use super::steps::{PartKind, Plan, Step, StepKind};
use crate::error::PipelineError;
use crate::job::{Denoise, Job};
use crate::reader::is_capture;
use crate::stage::denoise::GUIDED_BYTES;
use crate::stage::field::field_defaults;
use crate::stage::fields::held_out_grid;
use crate::stage::groups::views_at_once;
use crate::stage::node::is_factorized;
use crate::stage::output::stage_name;
use crate::stage::samples;
use crate::stage::score::paths_per_pixel;
use crate::stage::tiles::Tiles;
use crate::store::files::{read_json, write_json};
use crate::store::key::{KeyBuilder, content_hash};
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;

/// File with the [`Record`] of every executed step, relative to the run folder.
const FILE: &str = "cache/steps.json";
/// Number of hexadecimal digits of a key in a plan.
const DIGITS: usize = 16;

/// Record of an executed step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Record {
    key: Option<String>,
    /// Time of the work, seconds; `None` if the result was cached.
    seconds: Option<f64>,
    /// Amount of work, in the unit of the stage.
    work: f64,
    /// Files of the scene, each with a hash of its content.
    #[serde(with = "lumistack_core::path_text::hashed")]
    files: Vec<(PathBuf, String)>,
}

impl Record {
    pub(crate) fn new(seconds: f64, cached: bool, files: Vec<(PathBuf, String)>) -> Self {
        // The list of files also has entries for importers, Blender and scenes in memory. The paths
        // of these entries are only names, so they are not made absolute.
        let place = |path: PathBuf| match path.is_file() {
            true => std::path::absolute(&path).unwrap_or(path),
            false => path,
        };
        let files = files.into_iter().map(|(path, hash)| (place(path), hash)).collect();
        Self { key: None, seconds: (!cached).then_some(seconds), work: 0.0, files }
    }
}

type Records = BTreeMap<String, Record>;

/// Writes the records of executed steps. Computes all keys again, since the keys contain the
/// scene's files, which only the run has found.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn note(plan: &Plan, registry: &Registry, new: Records) -> Result<(), PipelineError> {
    let path = plan.folder.join(FILE);
    if new.is_empty() || !plan.folder.join("cache").is_dir() {
        return Ok(());
    }
    let sizes = sizes(plan);
    // Drop the records of steps that this plan does not have.
    let mut records: Records = read_json(&path).unwrap_or_default();
    let ids = plan.indices();
    records.retain(|id, _| ids.contains_key(id.as_str()));
    for (id, mut record) in new {
        let Some(&index) = ids.get(id.as_str()) else { continue };
        record.work = work(plan, index, &sizes);
        // A cached result keeps the time of the run that made it.
        if let Some(old) = records.get(&id).filter(|_| record.seconds.is_none()) {
            (record.seconds, record.work) = (old.seconds, old.work);
        }
        records.insert(id, record);
    }
    for (index, key) in keys(plan, &records, registry).into_iter().enumerate() {
        if let Some(record) = records.get_mut(&plan.steps[index].id) {
            record.key = key;
        }
    }
    write_json(&path, &records)
}

/// Fills in keys, cached results and estimates of all steps.
pub(crate) fn fill(plan: &mut Plan, registry: &Registry) {
    let records: Records = read_json(&plan.folder.join(FILE)).unwrap_or_default();
    let keys = keys(plan, &records, registry);
    let (machine, sizes) = (steps_per_second(), sizes(plan));
    let of_step = |step: &Step| sizes[step.part].as_ref().map_or([0, 0], |sizes| sizes.disk.of_step(step.kind));
    plan.disk_bytes = disk::together(plan.steps.iter().map(of_step));
    for (index, key) in keys.into_iter().enumerate() {
        let record = records.get(&plan.steps[index].id);
        // The name of a design's file depends on the content of the light field. So only a sweep
        // can find out if an earlier sweep solved the design. Without a record, any other result is
        // not cached. Without a key, only a run can find out if the result is current.
        let is_design = matches!(plan.steps[index].kind, StepKind::Design(_) | StepKind::Search);
        let cached = match (&key, record) {
            _ if is_design && plan.folder.join("designs").is_dir() => None,
            (_, None) => Some(false),
            (None, Some(_)) => None,
            (Some(key), Some(record)) => Some(record.key.as_ref() == Some(key) && is_there(plan, index)),
        };
        let (work, memory_bytes) = (work(plan, index, &sizes), memory(plan, index, &sizes));
        // The rate comes from this step's last execution, or else from another step of the same
        // stage, or else from the calibration.
        let own = record.filter(|record| record.seconds.is_some());
        let stage = plan.steps[index].stage;
        let alike = || {
            let of_stage = plan.steps.iter().filter(|step| step.stage == stage);
            of_stage.filter_map(|step| records.get(&step.id)).find(|record| record.seconds.is_some())
        };
        let rate = own.or_else(alike).and_then(|record| Some(record.work / record.seconds?)).filter(|rate| *rate > 0.0);
        let seconds = if cached == Some(true) { 0.0 } else { work / rate.unwrap_or(machine / cost(stage)) };
        let step = &mut plan.steps[index];
        (step.key, step.cached, step.memory_bytes, step.seconds) = (key, cached, memory_bytes, seconds);
    }
}

/// Computes the key of every step. The key is `None` if a file or plugin that it depends on is not
/// known yet, or cannot be read.
fn keys(plan: &Plan, records: &Records, registry: &Registry) -> Vec<Option<String>> {
    let ids = plan.indices();
    let mut keys: Vec<Option<String>> = Vec::new();
    for step in &plan.steps {
        let info = plan.stage_of(step.part, step.kind);
        let job = settings(plan, step.part);
        let mut key = KeyBuilder::new(info.name, info.code);
        key.add_json("reads", &(info.reads)(&job));
        let inputs: Option<Vec<&String>> =
            step.inputs.iter().map(|id| ids.get(id.as_str()).and_then(|index| keys.get(*index)?.as_ref())).collect();
        let known = inputs.map(|inputs| {
            inputs.into_iter().for_each(|input| {
                key.add("input", input.as_bytes());
            })
        });
        let content = known
            .and_then(|()| add_content(&mut key, plan, step.part, step.kind, &job, records.get(&step.id), registry));
        keys.push(content.map(|()| key.finish()[..DIGITS].to_owned()));
    }
    keys
}

/// Returns the job of a part. For time steps after the first, the job lacks `warm_start`, since
/// this path depends on the run folder.
fn settings(plan: &Plan, part: usize) -> Job {
    let mut job = plan.parts[part].job.clone();
    if plan.time(part).is_some_and(|(time, _)| time > 0) {
        job.factorize.warm_start = None;
        job.nodes.iter_mut().filter_map(|node| node.factorize.as_mut()).for_each(|job| job.warm_start = None);
    }
    job
}

/// Adds the content of the files and plugins that a step reads to the step's key. Returns `None` if
/// one of them is not known or cannot be read.
fn add_content(
    key: &mut KeyBuilder,
    plan: &Plan,
    part: usize,
    kind: StepKind,
    job: &Job,
    record: Option<&Record>,
    registry: &Registry,
) -> Option<()> {
    // For a plugin, the key contains the plugin's version, code and parameters.
    let mut plugin = |id: &str, params: &Map<String, Value>| {
        key.add("plugin", plugin_key(registry, id, params).ok()?.as_bytes());
        Some(())
    };
    match kind {
        // Importers and scenes in memory have no file, so the key contains their recorded hash
        // instead.
        StepKind::Ingest => {
            for (path, hash) in &record?.files {
                let found = if path.is_absolute() { content_hash(path).ok()? } else { hash.clone() };
                key.add("file", path.file_name()?.as_encoded_bytes()).add("content", found.as_bytes());
            }
            Some(())
        }
        StepKind::Read => add_files(key, job.light_field.as_deref()?),
        StepKind::Source => plugin(&job.source.as_ref()?.plugin, &job.source.as_ref()?.params),
        StepKind::Patterns => {
            // The solver and node plugins have weights, but only the solver has a warm start.
            let warm_start = match plan.node(part).filter(|node| !is_factorized(Some(node))) {
                Some(node) => {
                    plugin(&node.plugin, &node.params)?;
                    None
                }
                None => job.factorize.warm_start.as_ref(),
            };
            job.factorize.weights.iter().chain(warm_start).try_for_each(|path| add_files(key, path))
        }
        StepKind::FieldOutput(number) | StepKind::StackOutput(number) => {
            let output = &job.outputs[number];
            plugin(&output.plugin, &output.params)
        }
        _ => Some(()),
    }
}

/// Adds the content of a file, or of all files in a folder and its subfolders, sorted by name.
/// Returns `None` if a file cannot be read.
fn add_files(key: &mut KeyBuilder, path: &Path) -> Option<()> {
    if !path.is_dir() {
        key.add("content", content_hash(path).ok()?.as_bytes());
        return Some(());
    }
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(path).ok()?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    entries.sort();
    entries.iter().try_for_each(|entry| {
        key.add("name", entry.file_name()?.as_encoded_bytes());
        add_files(key, entry)
    })
}

/// Returns true if the run folder has the files of a result. Files with a stamp must be unchanged;
/// for other files, this function checks only that they exist.
fn is_there(plan: &Plan, index: usize) -> bool {
    let step = &plan.steps[index];
    let dir = plan.folder.join(&step.folder);
    let stamps = Stamps::new(&dir);
    let job = &plan.parts[step.part].job;
    let exists = |names: &[&str]| names.iter().all(|name| dir.join(name).exists());
    match step.kind {
        // Every run makes the results of the first three kinds again, so they are never cached. A
        // design whose folder does not exist is not cached either.
        StepKind::Ingest | StepKind::Place | StepKind::Read | StepKind::Design(_) | StepKind::Search => false,
        StepKind::Trace | StepKind::Denoise | StepKind::Score => exists(&["cache/views"]),
        StepKind::Expose | StepKind::Source => stamps.is_whole("target"),
        StepKind::Patterns => stamps.is_whole(step.stage),
        StepKind::FieldOutput(number) | StepKind::StackOutput(number) => {
            stamps.is_whole(&stage_name(&job.outputs[number]))
        }
        StepKind::Measure => stamps.is_whole("measure"),
        StepKind::Report => match plan.parts[step.part].kind {
            PartKind::Time(_) => stamps.is_whole("report"),
            _ => false,
        },
    }
}

/// Sizes of a part's display and light field. They are floats, so that their products cannot
/// overflow.
struct Sizes {
    /// Pixels of a view.
    pixels: f64,
    /// Views of the target.
    views: f64,
    /// Number of views in the light fields that only the report needs.
    others: f64,
    layers: f64,
    /// Number of values in the patterns of all frames.
    values: f64,
    frames: f64,
    /// Time of the solver for each ray, layer and frame, as a multiple of the time for a uniform
    /// backlight.
    solver_times: f64,
    /// Number of paths of the measurement that chooses the number of samples.
    measured_paths: f64,
    /// Time of a view's paths, as a multiple of the time without further paths, further rays and
    /// sparse paths.
    path_times: f64,
    memory: Memory,
    disk: Disk,
}

/// Memory of a part's data, bytes, with a field for each kind of data. Light fields in mapped files
/// are included only with their bytes in memory.
struct Memory {
    /// Memory of the light fields: the target, and the light fields for the report.
    fields: f64,
    /// Memory of the solver, without the light fields.
    solving: f64,
    /// Memory of the denoiser.
    denoising: f64,
    /// Memory for further paths of one view.
    further: f64,
    /// Memory for the measurement of the number of paths.
    measuring: f64,
    /// Memory of the depths of the target's views.
    depths: f64,
    /// Memory of the views of a given light field that are left out of the target. These views
    /// serve for the zone score.
    left_out: f64,
    /// Memory of the decoded file of a given light field, if the file is one picture.
    picture: f64,
}

impl Sizes {
    fn of(job: &Job) -> Option<Self> {
        let own: Display = job.resolve_display().ok()?;
        let (display, geometry) = match &job.light_field {
            // A given light field has views and pixels of its own.
            Some(path) => {
                let (warnings, cancel) = (Collector::default(), Cancel::default());
                let task = Task::quiet(&warnings, &cancel);
                let given = lumistack_field_io::geometry_of(path, &job.geometry, &field_defaults(&own), task).ok()?;
                (own.adapted_to(&given).ok()?, given)
            }
            None => {
                let geometry = own.geometry().ok()?;
                (own, geometry)
            }
        };
        let count = |grid: &Option<ViewGrid>| grid.as_ref().map_or(0, |grid| grid.iter().count());
        let area = |[cols, rows]: [usize; 2]| (cols * rows) as f64;
        let frames = display.frames as f64;
        // A given light field has no further light fields for the report.
        let others = match &job.light_field {
            Some(_) => [None, None],
            None => [held_out_grid(&geometry.grid, job.render.held_out), geometry.grid.outside(job.render.outside)],
        };
        Some(Self {
            memory: Memory::of(job, &display, &geometry, &others),
            disk: Disk::of(job, &display, &geometry, &others),
            pixels: (geometry.rows * geometry.cols) as f64,
            views: geometry.grid.iter().count() as f64,
            others: (count(&others[0]) + count(&others[1])) as f64,
            layers: display.layers.len() as f64,
            values: 3.0 * frames * display.layers.iter().map(|layer| area(layer.resolution)).sum::<f64>(),
            frames,
            solver_times: if matches!(display.backlight, Backlight::Uniform) { 1.0 } else { DIRECTIONAL_TIMES },
            path_times: path_times(job, &display, &geometry),
            measured_paths: if job.scene.is_some() { samples::paths(job, &display, &geometry) as f64 } else { 0.0 },
        })
    }

    fn rays(&self) -> f64 {
        self.pixels * self.views
    }
}

/// Returns true if a job has a weight for every ray: from its expected eyes, or from a file with
/// four axes.
fn weighs_rays(job: &Job) -> bool {
    let of_rays = |path: &PathBuf| NpyFile::open(path).is_ok_and(|file| file.shape().len() == 4);
    !job.factorize.eyes.is_empty() || job.factorize.weights.as_ref().is_some_and(of_rays)
}

impl Memory {
    fn of(job: &Job, display: &Display, geometry: &FieldGeometry, others: &[Option<ViewGrid>; 2]) -> Self {
        let (render, threads) = (&job.render, rayon::current_num_threads());
        let rays = |geometry: &FieldGeometry| (geometry.grid.iter().count() * geometry.rows * geometry.cols) as f64;
        let (view, window) = (RGB * (geometry.rows * geometry.cols) as f64, render.window_bytes() as f64);
        // For a light field in a mapped file, `window` bytes of the file are in memory, and one
        // view per thread.
        let in_use = |bytes: f64, of_thread: f64| bytes.min(window + threads as f64 * of_thread);
        let of_field = |geometry: &FieldGeometry| match render.is_held(geometry) {
            true => RGB * rays(geometry),
            false => in_use(RGB * rays(geometry), view),
        };
        let is_held = render.is_held(geometry);
        let others = others.iter().flatten().map(|grid| geometry.with_grid(grid.clone()));
        // A given light field may come from pictures with integer codes, whose values are not half
        // floats. Then the solver's copy of the target takes twice the memory.
        let wider = if job.light_field.is_some() { 8.0 * rays(geometry) } else { 0.0 };
        let solving = match (Tiles::of(&job.factorize, display, geometry), is_held) {
            (Some(tiles), _) => tiles.bytes(display, geometry) as f64 + wider / tiles.count() as f64,
            (None, true) => held_bytes(display, geometry, threads) as f64 + wider,
            (None, false) => paged_bytes(display, geometry, threads, window as u64) as f64 + wider / 4.0,
        };
        // weights of single rays are in memory twice: as the job's array, and as the solver's copy
        let weighing = if weighs_rays(job) { 4.0 * rays(geometry) + weight_bytes(geometry) as f64 } else { 0.0 };
        let (denoise, shared) = (job.denoise_for(display), SharedLight::BYTES_PER_RAY as f64);
        let denoising = match denoise {
            Denoise::Auto | Denoise::Off => 0.0,
            Denoise::Guided => GUIDED_BYTES as f64 * rays(geometry),
            Denoise::Oidn => GUIDED_BYTES as f64 / RGB * view,
            Denoise::Shared if is_held => shared * rays(geometry),
            Denoise::Shared => 2.0 * in_use(0.5 * shared * rays(geometry), shared / RGB * view),
        };
        let settings = job.split_settings(Settings::default(), display);
        let further = if settings.further_paths { FURTHER_VALUES / 3.0 * view } else { 0.0 };
        let depths = Depths::coarse(geometry);
        let kept = match &job.light_field {
            Some(_) => job.report.zone_directions as f64 * view,
            None => 0.0,
        };
        Self {
            fields: of_field(geometry) + others.map(|geometry| of_field(&geometry)).sum::<f64>(),
            solving: solving + weighing,
            denoising,
            further,
            measuring: if job.scene.is_some() { samples::bytes(job, display, geometry, threads) as f64 } else { 0.0 },
            depths: if job.scene.is_some() { 8.0 * rays(&depths) } else { 0.0 },
            left_out: kept,
            picture: job.light_field.as_deref().map_or(0.0, |path| lumistack_field_io::picture_bytes(path) as f64),
        }
    }
}

/// Returns [`Sizes::path_times`].
fn path_times(job: &Job, display: &Display, geometry: &FieldGeometry) -> f64 {
    let samples = job.render.samples_of_view(geometry.grid.iter().count());
    let settings = job.split_settings(Settings { samples, ..Settings::default() }, display);
    match (settings.further_paths, settings.sparse_paths) {
        (true, _) => FURTHER_TIMES,
        (false, true) => SPARSE_TIMES + FURTHER_RAY_TIMES * f64::from(settings.further_rays),
        (false, false) => 1.0,
    }
}

/// Returns the work of a step, in the unit of its stage. The unit of tracing is a path. The unit of
/// factorizing is one ray, layer, frame and iteration. The unit of most other stages is a ray.
fn work(plan: &Plan, index: usize, sizes: &[Option<Sizes>]) -> f64 {
    let step = &plan.steps[index];
    let job = &plan.parts[step.part].job;
    let Some(sizes) = &sizes[step.part] else { return 0.0 };
    // Renders of splats have no noise, so one ray per pixel is enough.
    let is_capture = job.scene.as_deref().is_some_and(is_capture);
    let samples = if is_capture { 1.0 } else { f64::from(job.render.samples_of_view(sizes.views as usize)) };
    // Count the units of the step's stage.
    match step.kind {
        StepKind::Ingest => 1.0,
        StepKind::Place => PLACE + MEASURED_TIMES * sizes.measured_paths,
        StepKind::Trace => {
            sizes.pixels * (sizes.views + sizes.others) * samples * if is_capture { 1.0 } else { sizes.path_times }
        }
        StepKind::Denoise if !job.render.denoise.filters() => 0.0,
        StepKind::Denoise if job.render.denoise == Denoise::Shared => {
            SHARED_SHARE * sizes.pixels * (sizes.views + sizes.others)
        }
        StepKind::Denoise | StepKind::Expose => sizes.pixels * (sizes.views + sizes.others),
        StepKind::Score => {
            let directions = job.report.zone_directions;
            sizes.pixels * if is_capture { directions as f64 } else { paths_per_pixel(directions) as f64 }
        }
        StepKind::Patterns => {
            let iterations = job.factorize.iterations().max(1) + warm_up_iterations(plan, step.part);
            sizes.rays() * sizes.layers * sizes.frames * f64::from(iterations) * sizes.solver_times
        }
        StepKind::Design(_) | StepKind::Search => {
            let count =
                if step.kind == StepKind::Search { job.sweep.as_ref().map_or(1, |sweep| sweep.count()) } else { 1 };
            let iterations = f64::from(job.factorize.iterations().max(1));
            sizes.rays() * sizes.layers * sizes.frames * iterations * count as f64 * sizes.solver_times
        }
        StepKind::Report => sizes.pixels * (sizes.views + sizes.others + job.report.zone_directions as f64),
        _ => sizes.rays(),
    }
}

/// Returns the additional iterations of a time step that begins a chunk, since it also solves some
/// earlier time steps.
fn warm_up_iterations(plan: &Plan, part: usize) -> u32 {
    let Some((time, sequence)) = plan.time(part) else { return 0 };
    let PartKind::Sequence(times) = &plan.parts[sequence].kind else { return 0 };
    match times.warm_up(time).len() as u32 {
        0 => 0,
        count => plan.parts[sequence].job.factorize.iterations() + (count - 1) * times.sequence.iterations,
    }
}

/// Returns the number of steps of [`steps_per_second`] that take as long as one unit of a stage's
/// work. The numbers were measured on two cores, with `scenes/still-life/job.toml` and with
/// FlightHelmet at the size of the paper's displays. Scenes with glass or with many lights take
/// longer.
fn cost(stage: &str) -> f64 {
    match stage {
        "ingest" => 1e8,
        "place" | "trace" | "score" => 1.1e3,
        "denoise" => 7e3,
        "factorize" | "design" => 0.4,
        "node" => 4e3,
        "report" | "expose" => 90.0,
        "output" => 20.0,
        _ => 300.0,
    }
}

/// Bytes of a pixel: three floats.
const RGB: f64 = 12.0;
/// Bytes of the rays from which an exposure is chosen. The program has two copies of these rays;
/// the number includes both.
const EXPOSURE: f64 = (64 << 20) as f64;
/// Bytes of the program itself: its code, libraries and threads, and memory that the allocator
/// keeps.
const PROGRAM: f64 = (80 << 20) as f64;
/// Maximum number of views that one thread has in memory.
const VIEWS_IN_WORK: f64 = 8.0;
/// Time of the filter `shared`, divided by the time of the other filters. Measured with 169 views
/// of 420 × 262 pixels.
const SHARED_SHARE: f64 = 0.06;
/// Time of the solver for a directional backlight, divided by its time for a uniform one.
const DIRECTIONAL_TIMES: f64 = 8.0;
/// Time to place the window, as a multiple of the time of a path.
const PLACE: f64 = 1e5;
/// Time of the measurement that chooses the number of samples, divided by the time of its paths.
/// The measurement also solves and compares.
const MEASURED_TIMES: f64 = 1.5;
/// Time of views that share light and get further paths, divided by the time of the same views
/// without further paths. Measured factors are between 1.3 and 2.4 (docs/ZONE.md).
const FURTHER_TIMES: f64 = 1.8;
/// Time of views with sparse paths, divided by the time of the same views with all paths.
const SPARSE_TIMES: f64 = 0.7;
/// Time of a ray that ends at the first surface, divided by the time of a path.
const FURTHER_RAY_TIMES: f64 = 0.17;
/// Largest number of values per pixel of a view while the view gets further paths. These are the
/// values of its first paths, of the further paths, and of all paths together.
const FURTHER_VALUES: f64 = 80.0;

/// Returns an upper bound of the memory of a job's run, and an estimate of the disk space of one
/// light field and its display, bytes. `None` if the display or the light field cannot be read. See
/// [`Step::memory_bytes`](super::steps::Step::memory_bytes) and
/// [`Plan::disk_bytes`](super::steps::Plan::disk_bytes).
pub fn needs_of(job: &Job) -> Option<[u64; 2]> {
    let job = job.with_automatic_settings();
    let sizes = Sizes::of(&job)?;
    let made = match (&job.scene, &job.light_field) {
        (Some(_), _) => {
            [StepKind::Place, StepKind::Trace, StepKind::Denoise, StepKind::Expose, StepKind::Score].as_slice()
        }
        (None, Some(_)) => &[StepKind::Read],
        (None, None) => &[StepKind::Source],
    };
    let kinds = || made.iter().chain(&[StepKind::Patterns, StepKind::Report]);
    let memory = kinds().map(|kind| bytes(*kind, &job, &sizes)).max()?;
    Some([memory, disk::together(kinds().map(|kind| sizes.disk.of_step(*kind)))])
}

fn sizes(plan: &Plan) -> Vec<Option<Sizes>> {
    plan.parts.iter().map(|part| Sizes::of(&part.job)).collect()
}

fn memory(plan: &Plan, index: usize, sizes: &[Option<Sizes>]) -> u64 {
    let step = &plan.steps[index];
    let job = &plan.parts[step.part].job;
    sizes[step.part].as_ref().map_or(0, |sizes| bytes(step.kind, job, sizes))
}

/// Returns an upper bound of the memory of a step, bytes. For three kinds of data it is only a
/// rough estimate: the BVH of a scene, a plugin's own data, and the pictures of an output.
fn bytes(kind: StepKind, job: &Job, sizes: &Sizes) -> u64 {
    let (memory, threads) = (&sizes.memory, rayon::current_num_threads() as f64);
    // Memory of a scene as a multiple of the size of its file. The factor for splats is larger,
    // since files pack splats more tightly than triangles.
    let packed = if job.scene.as_deref().is_some_and(is_capture) { 16.0 } else { 4.0 };
    let scene =
        packed * job.scene.as_ref().and_then(|path| std::fs::metadata(path).ok()).map_or(0.0, |data| data.len() as f64);
    let (view, patterns) = (RGB * sizes.pixels, 4.0 * sizes.values);
    let (views, at_once) = (VIEWS_IN_WORK * threads * view, views_at_once() as f64);
    // The scene, the depths and the views that are left out of a given light field stay in memory
    // until the report.
    let kept = PROGRAM + scene + memory.depths + memory.left_out;
    let of_step = match kind {
        StepKind::Ingest => 0.0,
        StepKind::Place => memory.measuring,
        // A view that is not denoised yet has several times as many values as the radiance of the
        // view.
        StepKind::Trace => at_once * (3.0 * VIEWS_IN_WORK * view + memory.further),
        StepKind::Denoise => memory.denoising + at_once * 3.0 * VIEWS_IN_WORK * view,
        StepKind::Expose => memory.fields + views + EXPOSURE,
        StepKind::Read => memory.fields + views + memory.picture,
        StepKind::Source => RGB * sizes.rays() + views,
        StepKind::Patterns | StepKind::Design(_) | StepKind::Search => memory.fields + memory.solving,
        StepKind::Measure => 2.0 * (memory.fields + patterns) + views,
        _ => memory.fields + 3.0 * patterns + 2.0 * views,
    };
    (kept + of_step) as u64
}

/// Measures the rate of a chain of operations on one thread in a few milliseconds, and multiplies
/// it by the number of threads. A step of the chain is a shift, an exclusive or, and a
/// multiplication. Each step needs the result of the step before, so all builds of the program
/// take nearly the same time. For a chain of multiply-adds on vectors, builds with other
/// optimizations took up to 60 times as long.
///
/// The fastest of several short rounds counts, since other work may interrupt a round. Only one
/// thread is measured, since rounds of all threads would be interrupted more often.
fn steps_per_second() -> f64 {
    const ROUNDS: u64 = 16;
    const STEPS: u32 = 1 << 16;
    let rate = |round: u64| {
        let start = Instant::now();
        let (mut step, mut x) = (0, black_box(round));
        // a plain loop, since iterators are slow in builds with few optimizations
        while step < STEPS {
            x = (x ^ (x >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            step += 1;
        }
        black_box(x);
        f64::from(STEPS) / start.elapsed().as_secs_f64().max(1e-6)
    };
    rayon::current_num_threads() as f64 * (0..ROUNDS).map(rate).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use lumistack_core::config;

    use super::*;
    use crate::plan::graph::job_of;

    #[test]
    fn the_work_of_tracing_depends_on_further_and_sparse_paths() {
        let of = |views: &str, denoise: &str| {
            let text = format!(
                "scene = \"a.glb\"\n[display]\npreset = \"paper-three-layer\"\n{views}\n[render]\nsamples = 8\ndenoise = \"{denoise}\"\n"
            );
            let job = config::parse::<Job>(&text).ok().unwrap().with_automatic_settings();
            let mut plan = Plan::new(&job, Path::new("run"));
            let part = plan.add_part(PathBuf::from("run"), PartKind::Run, job, None);
            plan.add_step(part, StepKind::Trace, Vec::new());
            work(&plan, 0, &sizes(&plan))
        };
        let plain = of("views = [5, 5]", "off");
        assert!((of("views = [5, 5]", "shared") / plain - FURTHER_TIMES).abs() < 1e-9);
        // Automatic views have sparse paths.
        assert!((of("", "shared") / of("", "off") - SPARSE_TIMES).abs() < 1e-9);
        assert!(plain > 0.0);
    }

    #[test]
    fn the_key_of_a_node_plugin_depends_on_the_content_of_its_weights() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.npy");
        let text = "scene = \"a.glb\"\n[display]\npreset = \"paper-three-layer\"\n[[nodes]]\nid = \"a\"\nplugin = \"parallax_barrier\"\n";
        let mut job = config::parse::<Job>(text).ok().unwrap();
        job.factorize.weights = Some(path.clone());
        let mut plan = Plan::new(&job, folder.path());
        let around = plan.add_part(PathBuf::new(), PartKind::Run, job.clone(), None);
        let part = plan.add_part("nodes/a".into(), PartKind::Node(0), job_of(&job, &job.nodes[0]), Some(around));
        plan.add_step(part, StepKind::Patterns, Vec::new());
        let registry = Registry::built_in().unwrap();
        let key = |content: &str| {
            std::fs::write(&path, content).unwrap();
            keys(&plan, &Records::new(), &registry)[0].clone().unwrap()
        };
        assert_eq!(key("1"), key("1"));
        assert_ne!(key("1"), key("2"));
    }
}
