//! Estimates of a plan without executing it: keys, cached results, time and memory.
//!
//! ```text
//! key of a step = hash(stage, code, values of the job that it reads, keys of its inputs,
//!                      content of its files)
//! time          = work of the step / rate
//! rate          = work / time of the last run in this folder, or else of a short calibration
//! ```
//!
//! The stamp of a result needs the content of its inputs, which exists only after the earlier
//! stages. The keys of this file need only the job and the files that it names. A run writes them
//! to `cache/steps.json`, where the next plan finds which results are current. With each key it
//! writes the time of the step, and the files of the scene.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_display::{Display, FieldGeometry};
use lumistack_plugin_host::Registry;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::steps::{PartKind, Plan, StepKind};
use crate::error::PipelineError;
use crate::job::Job;
use crate::reader::is_capture;
use crate::stage::fields::held_out_grid;
use crate::stage::node::is_factorized;
use crate::stage::output::stage_name;
use crate::stage::tiles::Tiles;
use crate::store::files::{read_json, write_json};
use crate::store::key::{KeyBuilder, content_hash};
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;

/// File of the records, relative to the run folder.
const FILE: &str = "cache/steps.json";
/// Number of hexadecimal digits of a key that is shown.
const DIGITS: usize = 16;
/// Mean number of rays per pixel for a direction of the zone score, in its two renders together.
const SCORE_SAMPLES: f64 = 6.5;

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
        // The list also has entries for importers, Blender and scenes in memory. Their paths are
        // only names, so they stay as they are.
        let place = |path: PathBuf| match path.is_file() {
            true => std::path::absolute(&path).unwrap_or(path),
            false => path,
        };
        let files = files.into_iter().map(|(path, hash)| (place(path), hash)).collect();
        Self { key: None, seconds: (!cached).then_some(seconds), work: 0.0, files }
    }
}

type Records = BTreeMap<String, Record>;

/// Writes records of executed steps. Computes all keys again, since a run finds the files of the
/// scene, which the keys contain.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn note(plan: &Plan, registry: &Registry, new: Records) -> Result<(), PipelineError> {
    let path = plan.folder.join(FILE);
    if new.is_empty() || !plan.folder.join("cache").is_dir() {
        return Ok(());
    }
    // Records of steps that the plan does not have are removed.
    let mut records: Records = read_json(&path).unwrap_or_default();
    let ids = plan.indices();
    records.retain(|id, _| ids.contains_key(id.as_str()));
    for (id, mut record) in new {
        let Some(&index) = ids.get(id.as_str()) else { continue };
        record.work = work(plan, index);
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
    let machine = multiply_adds_per_second();
    for (index, key) in keys.into_iter().enumerate() {
        let record = records.get(&plan.steps[index].id);
        // Without a record a result is not cached. Without a key, only a run can find out.
        let cached = match (&key, record) {
            (_, None) => Some(false),
            (None, Some(_)) => None,
            (Some(key), Some(record)) => Some(record.key.as_ref() == Some(key) && is_there(plan, index)),
        };
        let (work, memory_bytes) = (work(plan, index), memory(plan, index));
        // The rate comes from the last execution of this step, or else of another step of the same
        // stage.
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

/// Computes the key of every step. The key is `None` if the scene's files are not known yet.
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

/// Returns the job of a part, without paths that depend on the run folder.
fn settings(plan: &Plan, part: usize) -> Job {
    let mut job = plan.parts[part].job.clone();
    if plan.time(part).is_some_and(|(time, _)| time > 0) {
        job.factorize.warm_start = None;
        job.nodes.iter_mut().filter_map(|node| node.factorize.as_mut()).for_each(|job| job.warm_start = None);
    }
    job
}

/// Adds the content of the files that a step reads. Returns `None` if they are not known.
fn add_content(
    key: &mut KeyBuilder,
    plan: &Plan,
    part: usize,
    kind: StepKind,
    job: &Job,
    record: Option<&Record>,
    registry: &Registry,
) -> Option<()> {
    // For a plugin, the key contains version, code and parameters.
    let mut plugin = |id: &str, params: &Map<String, Value>| {
        key.add("plugin", plugin_key(registry, id, params).ok()?.as_bytes());
        Some(())
    };
    match kind {
        // Importers and scenes in memory have no file, so their recorded hash is used instead.
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
            let node = plan.node(part).filter(|node| !is_factorized(Some(node)));
            match node {
                Some(node) => plugin(&node.plugin, &node.params),
                None => [&job.factorize.weights, &job.factorize.warm_start]
                    .into_iter()
                    .flatten()
                    .try_for_each(|path| add_files(key, path)),
            }
        }
        StepKind::FieldOutput(number) | StepKind::StackOutput(number) => {
            let output = &job.outputs[number];
            plugin(&output.plugin, &output.params)
        }
        _ => Some(()),
    }
}

/// Adds the content of a file, or of all files in a folder and its subfolders, sorted by name.
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

/// True if the run folder has the unchanged files of a result.
fn is_there(plan: &Plan, index: usize) -> bool {
    let step = &plan.steps[index];
    let dir = plan.folder.join(&step.folder);
    let stamps = Stamps::new(&dir);
    let job = &plan.parts[step.part].job;
    let exists = |names: &[&str]| names.iter().all(|name| dir.join(name).exists());
    match step.kind {
        // every run reads or makes these again
        StepKind::Ingest | StepKind::Place | StepKind::Read => false,
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
        StepKind::Design(_) | StepKind::Search => exists(&["sweep.json"]),
    }
}

/// Sizes of a part's display and light field, as floats for products.
struct Sizes {
    /// Pixels of a view.
    pixels: f64,
    /// Views of the target.
    views: f64,
    /// Views of the light fields that only the report needs.
    others: f64,
    layers: f64,
    /// Values of the patterns of all frames.
    values: f64,
    frames: f64,
    /// Bytes of the light fields in memory: of the target, and of those for the report.
    held: f64,
    /// Bytes that the solver needs in addition.
    solving: f64,
}

impl Sizes {
    fn of(job: &Job) -> Option<Self> {
        let display: Display = job.resolve_display().ok()?;
        let geometry = display.geometry().ok()?;
        let count = |grid: Option<lumistack_display::ViewGrid>| grid.map_or(0, |grid| grid.iter().count()) as f64;
        let area = |[cols, rows]: [usize; 2]| (cols * rows) as f64;
        let frames = display.frames as f64;
        // Larger light fields are in mapped files, which take no memory.
        let others = [held_out_grid(&geometry.grid, job.render.held_out), geometry.grid.outside(job.render.outside)];
        let fields = others.into_iter().chain([Some(geometry.grid.clone())]).flatten();
        let held = fields.map(|grid| geometry.with_grid(grid)).filter(|geometry| job.render.is_held(geometry));
        let bytes =
            |geometry: FieldGeometry| (12 * geometry.grid.iter().count() * geometry.rows * geometry.cols) as f64;
        Some(Self {
            held: held.map(bytes).sum(),
            solving: match Tiles::of(&job.factorize, &display, &geometry) {
                Some(tiles) => tiles.bytes(&display, &geometry),
                None => lumistack_factorizer::held_bytes(&display, &geometry, rayon::current_num_threads()),
            } as f64,
            pixels: (geometry.rows * geometry.cols) as f64,
            views: geometry.grid.iter().count() as f64,
            others: count(held_out_grid(&geometry.grid, job.render.held_out))
                + count(geometry.grid.outside(job.render.outside)),
            layers: display.layers.len() as f64,
            values: 3.0 * frames * display.layers.iter().map(|layer| area(layer.resolution)).sum::<f64>(),
            frames,
        })
    }

    fn rays(&self) -> f64 {
        self.pixels * self.views
    }
}

/// Returns the work of a step, in the unit of its stage: paths, multiply-adds per ray, or rays.
fn work(plan: &Plan, index: usize) -> f64 {
    let step = &plan.steps[index];
    let job = &plan.parts[step.part].job;
    let Some(sizes) = Sizes::of(job) else { return 0.0 };
    // Splats are rendered without noise, by one ray per pixel.
    let is_capture = job.scene.as_deref().is_some_and(is_capture);
    let samples = if is_capture { 1.0 } else { f64::from(job.render.samples_of_view(sizes.views as usize)) };
    match step.kind {
        StepKind::Ingest | StepKind::Place => 1.0,
        StepKind::Trace => sizes.pixels * (sizes.views + sizes.others) * samples,
        StepKind::Denoise if !job.render.denoise.filters() => 0.0,
        StepKind::Denoise | StepKind::Expose => sizes.pixels * (sizes.views + sizes.others),
        StepKind::Score => {
            let samples = if is_capture { 1.0 } else { SCORE_SAMPLES };
            sizes.pixels * job.report.zone_directions as f64 * samples
        }
        StepKind::Patterns => {
            let iterations = job.factorize.iterations().max(1) + warm_up_iterations(plan, step.part);
            sizes.rays() * sizes.layers * sizes.frames * f64::from(iterations)
        }
        StepKind::Design(_) | StepKind::Search => {
            let count =
                if step.kind == StepKind::Search { job.sweep.as_ref().map_or(1, |sweep| sweep.count()) } else { 1 };
            sizes.rays() * sizes.layers * sizes.frames * f64::from(job.factorize.iterations().max(1)) * count as f64
        }
        StepKind::Report => sizes.pixels * (sizes.views + sizes.others + job.report.zone_directions as f64),
        _ => sizes.rays(),
    }
}

/// Returns the additional iterations of a time step that begins a chunk.
fn warm_up_iterations(plan: &Plan, part: usize) -> u32 {
    let Some((time, sequence)) = plan.time(part) else { return 0 };
    let PartKind::Sequence(times) = &plan.parts[sequence].kind else { return 0 };
    match times.warm_up(time).len() as u32 {
        0 => 0,
        count => plan.parts[sequence].job.factorize.iterations() + (count - 1) * times.sequence.iterations,
    }
}

/// Number of multiply-adds that take as long as one unit of a stage's work. It includes memory
/// accesses, was measured once, and is right to an order of magnitude.
fn cost(stage: &str) -> f64 {
    match stage {
        "ingest" | "place" => 1e8,
        "trace" | "score" => 1e4,
        "denoise" => 8e4,
        "factorize" | "design" => 40.0,
        "node" | "output" | "report" => 4e3,
        _ => 300.0,
    }
}

/// Estimates the memory of a step, bytes.
fn memory(plan: &Plan, index: usize) -> u64 {
    let step = &plan.steps[index];
    let job = &plan.parts[step.part].job;
    let Some(sizes) = Sizes::of(job) else { return 0 };
    const RGB: f64 = 12.0;
    let field = RGB * sizes.rays();
    // Estimate the memory of a scene by the size of its file. Triangles need a tree, and textures
    // are decoded. A capture needs more, since its file packs splats more tightly.
    let packed = if job.scene.as_deref().is_some_and(is_capture) { 16.0 } else { 4.0 };
    let scene =
        packed * job.scene.as_ref().and_then(|path| std::fs::metadata(path).ok()).map_or(0.0, |data| data.len() as f64);
    let bytes = match step.kind {
        StepKind::Ingest | StepKind::Place => scene,
        StepKind::Trace | StepKind::Score => scene + 4.0 * RGB * sizes.pixels,
        StepKind::Denoise => scene + 3.0 * field,
        StepKind::Expose => scene + sizes.held + RGB * sizes.pixels,
        StepKind::Patterns | StepKind::Design(_) | StepKind::Search => sizes.held + sizes.solving,
        StepKind::Measure => 2.0 * (sizes.held + 4.0 * sizes.values),
        _ => sizes.held + 4.0 * sizes.values,
    };
    bytes as u64
}

/// Measures the rate of multiply-adds of all threads in a few milliseconds.
fn multiply_adds_per_second() -> f64 {
    const ROUNDS: u32 = 1 << 20;
    let start = Instant::now();
    let threads = rayon::current_num_threads();
    let sums: Vec<f32> = (0..threads)
        .into_par_iter()
        .map(|thread| (0..ROUNDS).fold([thread as f32; 8], |sum, _| sum.map(|x| x * 0.999 + 0.5)).iter().sum())
        .collect();
    // The compiler would remove the loop if its result were not used.
    let scale = if sums.iter().all(|sum| sum.is_finite()) { 8.0 } else { 1.0 };
    scale * f64::from(ROUNDS) * threads as f64 / start.elapsed().as_secs_f64().max(1e-6)
}
