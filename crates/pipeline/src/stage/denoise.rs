//! Denoises a light field: reads traced views, writes filtered views and estimates of their error.
//!
//! ```text
//! cache/views/target-KEY/view_YY_XX-a.exr -b.exr     traced halves of the samples
//! cache/views/target-KEY/guided/view_YY_XX.exr       filtered; figures.json is written last
//! ```
//!
//! After a stop, traced views are reused, but a filter that did not finish filters all views again.
//! The filters `guided` and `oidn` use the same halves. For the filter `shared`, the path tracer
//! separates two kinds of light: light that views share, and all other light. A view then has one
//! file, `split_YY_XX.bin`, instead of two halves.

mod oidn;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use lumistack_core::{Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_pathtracer::denoise::{self, Estimate, NoisyView, SharedLight, ViewFigures, Window as Around};
use lumistack_pathtracer::{Checks, Settings, SplitView};
use lumistack_report::{DenoisedView, Denoising};
use lumistack_shot::ToneMapping;

use self::oidn::Oidn;
use super::fields::{FieldJob, Shot};
use super::groups::in_groups;
use crate::error::{PipelineError, render_error};
use crate::job::{Denoise, Job};
use crate::store::files::{read_json, write_json};
use crate::store::space;
use crate::store::views::{read_split, read_view, split_path, view_path, write_view};

/// Returns the version of Open Image Denoise that the denoiser `oidn` uses.
///
/// # Errors
/// If Open Image Denoise is not found. The message lists the searched places.
pub fn oidn_version() -> Result<String, PipelineError> {
    Oidn::find().map(|oidn| oidn.version)
}

/// To check a filter, some pixels are rendered again, twice with different seeds. Each time, such a
/// pixel gets this factor times the number of paths that it has in its view.
const CHECK_FACTOR: u32 = 2;
/// Maximum number of views whose pixels are rendered again to check a filter. This number of views,
/// spread over the viewing zone, suffices to judge a filter.
const CHECKED_VIEWS: usize = 25;
/// Maximum number of samples of the path tracer.
const MOST_SAMPLES: u32 = 65536;

/// The effect of a denoiser on the target, for the report.
pub(crate) struct Denoised {
    kind: Denoise,
    /// Scores of each view, in the order of the grid, for exposed radiance.
    figures: Vec<ViewFigures>,
    /// The central view before the filter, `[row][col][rgb]`, as displayed.
    unbiased: Vec<f32>,
    /// The central view after the filter, `[row][col][rgb]`, as displayed.
    filtered: Vec<f32>,
}

/// Bytes per ray while the guided filter works. The filter needs all views in memory together.
pub(crate) const GUIDED_BYTES: u64 = 192;

/// Checks before any rendering that the filter is installed, and that the job allows the memory
/// that the filter needs.
///
/// # Errors
/// If Open Image Denoise is not installed, or the guided filter needs more memory than the job
/// allows.
pub(crate) fn check(kind: Denoise, job: &Job, geometry: &FieldGeometry) -> Result<(), PipelineError> {
    let rays = (geometry.grid.iter().count() * geometry.rows * geometry.cols) as u64;
    let mib = (GUIDED_BYTES * rays).div_ceil(1 << 20);
    match kind {
        Denoise::Oidn => Oidn::find().map(drop),
        Denoise::Guided if mib > job.render.field_mib => {
            let expected = format!(
                "`render.field_mib` of {mib} or more for `guided`, which holds all views in memory, or the filter `shared`, which needs less memory"
            );
            Err(PipelineError::job(
                "render.denoise",
                expected,
                format!("`guided` with `render.field_mib` of {}", job.render.field_mib),
            ))
        }
        _ => Ok(()),
    }
}

/// Filters every light field whose filtered views are not all in the cache. Returns true if the
/// cache already had all filtered views.
///
/// # Errors
/// If cancelled, if a file cannot be written, or if Open Image Denoise fails.
pub(crate) fn run(shot: Shot<'_>, fields: &[FieldJob], task: Task<'_>) -> Result<bool, PipelineError> {
    let kind = shot.denoise();
    let mut cached = true;
    for field in fields {
        if is_finished(field, kind) {
            // a run that was killed after the filter may have left split views
            remove_splits(field, kind)?;
        } else {
            cached = false;
            filter(field, shot, task)?;
        }
    }
    Ok(cached)
}

/// Returns true if all filtered views of a light field are in the cache, or if `kind` does not
/// filter.
pub(crate) fn is_finished(field: &FieldJob, kind: Denoise) -> bool {
    let folder = field.finished(kind);
    let is_there = |view| read_view(&view_path(&folder, view, None), &field.traced).is_some();
    let shows = kind != Denoise::Shared || split(field, middle(&field.traced)).is_ok();
    !kind.filters() || (read_figures(&folder).is_some() && shows && field.traced.grid.iter().all(is_there))
}

/// Filters the views. Writes the error estimates last, since these estimates mark the filter as
/// finished.
///
/// # Errors
/// If cancelled, if a file cannot be written, or if Open Image Denoise fails.
fn filter(field: &FieldJob, shot: Shot<'_>, task: Task<'_>) -> Result<(), PipelineError> {
    let (kind, window, renderer) = (shot.denoise(), shot.window(), &shot.ingested.renderer(task)?.tracer);
    let geometry = &field.traced;
    let folder = field.finished(kind);
    std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
    let filtered = match kind {
        Denoise::Shared => shared(field, shot.job, task)?,
        Denoise::Oidn => by_oidn(field, shot, &folder)?,
        _ => by_guides(field, shot, task)?,
    };
    // Filter each view. Render some pixels of some of the target's views again, to measure noise
    // and bias of the filter.
    let settings = field.seeded(&[]);
    let of_checks = Settings { samples: (CHECK_FACTOR * settings.samples).min(MOST_SAMPLES), ..settings };
    let mut written = Vec::new();
    let stage = if field.is_target() { "check the denoiser" } else { "write views" };
    let count = geometry.grid.iter().count();
    task.progress.begin(stage, count as u64, "views");
    let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
    let one = |number: usize, &view: &[usize; 2], task: Task<'_>| {
        let [before, picture] = filtered(number, view, task)?;
        write_view(&view_path(&folder, view, None), &picture)?;
        let is_checked = field.is_target() && number.is_multiple_of(count.div_ceil(CHECKED_VIEWS));
        let checks = if is_checked {
            renderer.render_checks(window, geometry, view, &of_checks, task).map_err(render_error)?
        } else {
            Checks::default()
        };
        let figures = denoise::figures(&picture, &before, &checks);
        task.progress.advance(1, "");
        Ok((figures.mean, [figures.change, figures.mse_before, figures.mse_after].map(|e| e.parts())))
    };
    let checked = in_groups(&views, task, one, |scores| {
        written.push(scores);
        Ok(())
    });
    task.progress.end();
    checked?;
    // The scores are written last, since they mark the light field as finished.
    write_json(&figures_path(&folder), &written)?;
    remove_splits(field, kind)
}

/// Removes all split views of a filtered light field but the central one, since they take gigabytes
/// and the report shows only the central one.
fn remove_splits(field: &FieldJob, kind: Denoise) -> Result<(), PipelineError> {
    let middle = middle(&field.traced);
    for view in field.traced.grid.iter().filter(|view| kind == Denoise::Shared && *view != middle) {
        let path = split_path(&field.folder, view);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(PipelineError::write(&path)(error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Returns the central view, whose unfiltered picture the report shows.
fn middle(geometry: &FieldGeometry) -> [usize; 2] {
    geometry.grid.views().map(|count| count / 2)
}

/// A function that returns a view before and after the filter. Its first two arguments are the
/// view's number and grid position. All views together are large, so only the guided filter keeps
/// them in memory.
type Filtered<'a> = Box<dyn Fn(usize, [usize; 2], Task<'_>) -> Result<[Tensor<3>; 2], PipelineError> + Sync + 'a>;

/// Averages the light that views share. Keeps the light in memory if the job allows this for the
/// light field, and otherwise in files.
fn shared<'a>(field: &'a FieldJob, job: &Job, task: Task<'_>) -> Result<Filtered<'a>, PipelineError> {
    let geometry = &field.traced;
    let mut light = if job.render.is_held(geometry) {
        SharedLight::new(geometry, &field.settings)
    } else {
        let storage = lumistack_field_io::storage(&field.folder, job.render.window_bytes());
        SharedLight::in_storage(geometry, &field.settings, &storage).map_err(PipelineError::write(&field.folder))?
    };
    task.progress.begin("share light", 3 * geometry.grid.iter().count() as u64, "views");
    let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
    let averaged = in_groups(
        &views,
        task,
        |_, &view, _| split(field, view),
        |split| {
            light.add(&split);
            task.progress.advance(1, "");
            Ok(())
        },
    );
    let averaged = averaged.and_then(|()| Ok(light.averaged(task)?));
    task.progress.end();
    let averaged = averaged?;
    Ok(Box::new(move |number, view, _| {
        let split = split(field, view)?;
        Ok([split.radiance(), averaged.on(number, &split)])
    }))
}

/// Returns the size of the filtered views that do not exist yet, bytes.
pub(crate) fn missing_bytes(field: &FieldJob, kind: Denoise) -> u64 {
    let folder = field.finished(kind);
    let missing = field.traced.grid.iter().filter(|view| !view_path(&folder, *view, None).exists()).count();
    if kind.filters() { missing as u64 * field.pixels() * space::VIEW } else { 0 }
}

/// Returns the size of the light that views share, bytes; 0 if this light is in memory.
pub(crate) fn shared_bytes(field: &FieldJob, kind: Denoise, job: &Job) -> u64 {
    let is_in_files = kind == Denoise::Shared && !job.render.is_held(&field.traced);
    let rays = field.traced.grid.iter().count() as u64 * field.pixels();
    if is_in_files { SharedLight::BYTES_PER_RAY * rays } else { 0 }
}

/// Reads a traced view whose diffuse and other light are separate.
fn split(field: &FieldJob, view: [usize; 2]) -> Result<SplitView, PipelineError> {
    let path = split_path(&field.folder, view);
    read_split(&path, &field.traced, &field.settings).ok_or_else(PipelineError::replaced(&path, "cached view"))
}

/// Filters all views together, from two halves of each view. Features of the first hits guide the
/// filter.
fn by_guides<'a>(field: &FieldJob, shot: Shot<'_>, task: Task<'_>) -> Result<Filtered<'a>, PipelineError> {
    let geometry = &field.traced;
    let count = geometry.grid.iter().count() as u64;
    task.progress.begin("guides of the denoiser", count, "views");
    let views = geometry.grid.iter().map(|view| {
        let noisy = noisy(field, view, shot, task);
        task.progress.advance(1, "");
        noisy
    });
    let views: Result<Vec<NoisyView>, _> = views.collect();
    task.progress.end();
    let views = views?;
    task.progress.begin("denoise", denoise::steps(geometry), "bands");
    let filtered = denoise::denoise(geometry, &views, Around::default(), task);
    task.progress.end();
    let filtered = filtered?;
    Ok(Box::new(move |number, _, _| Ok([views[number].mean(), filtered[number].clone()])))
}

/// Filters the views by Open Image Denoise, through files in a temporary folder. Open Image Denoise
/// uses all cores, so the views are filtered one after another.
fn by_oidn<'a>(field: &'a FieldJob, shot: Shot<'a>, folder: &Path) -> Result<Filtered<'a>, PipelineError> {
    let oidn = Oidn::find()?;
    let exchange = Mutex::new(tempfile::tempdir_in(folder).map_err(PipelineError::write(folder))?);
    Ok(Box::new(move |_, view, task| {
        task.cancel.check()?;
        let noisy = noisy(field, view, shot, task)?;
        let before = noisy.mean();
        let mut picture = before.clone();
        let exchange = exchange.lock().unwrap_or_else(PoisonError::into_inner);
        let values = oidn.denoise(before.data(), &noisy.features, exchange.path())?;
        drop(exchange);
        picture.data_mut().copy_from_slice(&values);
        Ok([before, picture])
    }))
}

/// Reads the halves of a view, and its guides.
fn noisy(field: &FieldJob, view: [usize; 2], shot: Shot<'_>, task: Task<'_>) -> Result<NoisyView, PipelineError> {
    let halves = [half(field, view, 0)?, half(field, view, 1)?];
    Ok(NoisyView { halves, features: field.guides(view, shot, task)? })
}

/// Reads a traced half of a view.
fn half(field: &FieldJob, view: [usize; 2], half: usize) -> Result<Tensor<3>, PipelineError> {
    let path = view_path(&field.folder, view, Some(half));
    read_view(&path, &field.traced)
        .and_then(|values| {
            Tensor::from_vec(["row", "col", "rgb"], [field.traced.rows, field.traced.cols, 3], values).ok()
        })
        .ok_or_else(PipelineError::replaced(&path, "cached view"))
}

/// Reads the results of the filter for the report.
///
/// # Errors
/// If a file of the filter is missing.
pub(crate) fn denoised(
    field: &FieldJob,
    kind: Denoise,
    tone_mapping: ToneMapping,
) -> Result<Option<Denoised>, PipelineError> {
    if !kind.filters() {
        return Ok(None);
    }
    // The cached scores are for scene-linear radiance, but the report shows scores for exposed
    // radiance.
    let folder = field.finished(kind);
    let path = figures_path(&folder);
    let missing = || {
        PipelineError::value(
            &path,
            "content",
            "the scores that were just written",
            "other scores or none; another program changes the folder",
        )
    };
    let mut figures = read_figures(&folder).ok_or_else(missing)?;
    for f in &mut figures {
        f.mean *= tone_mapping.exposure;
        f.change = f.change.scaled(tone_mapping.exposure);
        f.mse_before = f.mse_before.scaled(tone_mapping.exposure.powi(2));
        f.mse_after = f.mse_after.scaled(tone_mapping.exposure.powi(2));
    }
    // The picture before the filter is the mean of the two halves. For a split view it is the sum
    // of diffuse and other light.
    let middle = middle(&field.traced);
    let mut unbiased: Vec<f32> = if kind == Denoise::Shared {
        split(field, middle)?.radiance().data().to_vec()
    } else {
        let (a, b) = (half(field, middle, 0)?, half(field, middle, 1)?);
        a.data().iter().zip(b.data()).map(|(a, b)| 0.5 * (a + b)).collect()
    };
    let path = view_path(&folder, middle, None);
    let mut filtered = read_view(&path, &field.traced).ok_or_else(PipelineError::replaced(&path, "cached view"))?;
    tone_mapping.apply_to(&mut unbiased);
    tone_mapping.apply_to(&mut filtered);
    Ok(Some(Denoised { kind, figures, unbiased, filtered }))
}

impl Denoised {
    /// Returns the scores for the report.
    pub(crate) fn about(&self) -> Denoising<'_> {
        let pair = |estimate: Estimate| [estimate.value(), estimate.error()];
        let view = |figures: &ViewFigures| DenoisedView {
            mean: figures.mean,
            mean_change: pair(figures.change),
            mse_before: pair(figures.mse_before),
            mse_after: pair(figures.mse_after),
        };
        let all = |of: fn(&ViewFigures) -> Estimate| Estimate::joined(self.figures.iter().map(of));
        let overall = ViewFigures {
            mean: self.figures.iter().map(|f| f.mean).sum::<f64>() / self.figures.len() as f64,
            change: all(|f| f.change),
            mse_before: all(|f| f.mse_before),
            mse_after: all(|f| f.mse_after),
        };
        let name = match self.kind {
            Denoise::Oidn => "Intel Open Image Denoise, view by view",
            Denoise::Shared => "light shared by the views that see a point",
            Denoise::Guided | Denoise::Auto | Denoise::Off => "the guided filter over all views",
        };
        Denoising {
            name,
            overall: view(&overall),
            views: self.figures.iter().map(view).collect(),
            unbiased: &self.unbiased,
            filtered: &self.filtered,
        }
    }
}

fn figures_path(folder: &Path) -> PathBuf {
    folder.join("figures.json")
}

/// Reads the scores in a folder; `None` if the filter has not finished.
fn read_figures(folder: &Path) -> Option<Vec<ViewFigures>> {
    let list: Vec<(f64, [[f64; 3]; 3])> = read_json(&figures_path(folder))?;
    let figures = list.into_iter().map(|(mean, parts)| {
        let [change, mse_before, mse_after] = parts.map(Estimate::from_parts);
        ViewFigures { mean, change, mse_before, mse_after }
    });
    Some(figures.collect())
}
