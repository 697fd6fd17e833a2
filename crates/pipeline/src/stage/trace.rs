//! Traces all views of a shot into the cache, several pictures at the same time. A stopped run
//! continues with the pictures that are missing.

mod blender;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use lumistack_core::Task;
use lumistack_pathtracer::{GuidedSplit, GuidedView, Renderer};
use lumistack_scene::Window;
use lumistack_shot::{Depths, SceneRenderer, slopes};

use super::fields::{Block, FieldJob, Shot, parts};
use super::groups::in_groups;
use super::ingest::Ingested;
use super::{denoise, depth};
use crate::error::{PipelineError, render_error};
use crate::job::{Denoise, Engine};
use crate::store::space;
use crate::store::views::{
    guides_path, missing, read_splats, read_split, read_view, splats_path, split_path, variance_path, view_path,
    write_guides, write_splats, write_split, write_view,
};
use crate::view_options::ViewOptions;

/// The traced views of a shot in the cache.
pub(crate) struct Traced {
    /// The light fields, with the target first.
    pub(crate) fields: Vec<FieldJob>,
    /// Depths of the target's views.
    pub(crate) depths: Depths,
    /// The views of the target that are rendered, [view_y, view_x].
    pub(crate) views: Vec<[usize; 2]>,
    /// The renderer that made the views.
    pub(crate) engine: Engine,
}

/// Chooses the renderer of the shot's views.
pub(crate) fn engine(shot: Shot<'_>, options: &ViewOptions, task: Task<'_>) -> Engine {
    blender::engine(shot.job, shot.ingested, options.variance(), task)
}

/// A picture to trace.
struct Todo {
    field: usize,
    view: [usize; 2],
    /// Number of a half of the samples, 0 or 1; `None` for all samples.
    half: Option<usize>,
    path: PathBuf,
    /// File for the variance, if it is requested.
    variance: Option<PathBuf>,
    /// File for the guides of a denoiser, if they are requested.
    guides: Option<PathBuf>,
}

impl Todo {
    /// Returns the size of the picture's files, bytes.
    fn bytes(&self, field: &FieldJob, kind: Denoise) -> u64 {
        let guides = if self.guides.is_some() { space::GUIDES } else { 0 };
        let variance = if self.variance.is_some() { space::VIEW } else { 0 };
        field.pixels() * (space::traced(kind, &field.settings) + guides + variance)
    }
}

/// Traces all views that are not cached. Returns true if all were cached.
///
/// # Errors
/// If the options do not match the job, rendering fails or is cancelled, or a view cannot be
/// written.
pub(crate) fn run(
    shot: Shot<'_>,
    options: &ViewOptions,
    cache_dir: &Path,
    task: Task<'_>,
) -> Result<(Traced, bool), PipelineError> {
    let Views { fields, views, engine, cached } = trace_views(shot, options, cache_dir, Block::ALL, task)?;
    let (depths, known) = depths(shot, &fields[0], task)?;
    Ok((Traced { fields, depths, views, engine }, cached && known))
}

/// Traces the views of a block that are not cached. The first block also traces depths. Returns
/// true if everything was cached. Other processes may trace other blocks.
///
/// # Errors
/// The errors of [`run`].
pub(crate) fn run_block(shot: Shot<'_>, cache_dir: &Path, block: Block, task: Task<'_>) -> Result<bool, PipelineError> {
    let Views { fields, cached, .. } = trace_views(shot, &ViewOptions::default(), cache_dir, block, task)?;
    let known = !block.is_first() || depths(shot, &fields[0], task)?.1;
    Ok(cached && known)
}

/// Views of a shot in the cache: all views, or the views of a block.
struct Views {
    fields: Vec<FieldJob>,
    views: Vec<[usize; 2]>,
    engine: Engine,
    /// True if all of these views were cached.
    cached: bool,
}

fn trace_views(
    shot: Shot<'_>,
    options: &ViewOptions,
    cache_dir: &Path,
    block: Block,
    task: Task<'_>,
) -> Result<Views, PipelineError> {
    let Shot { job, ingested, .. } = shot;
    options.check(job, shot.display, shot.geometry.grid.iter().count())?;
    let views = options.chosen(shot.geometry.grid.views())?;
    let (window, kind) = (shot.window(), shot.denoise());
    let engine = engine(shot, options, task);
    let fields = shot.fields(cache_dir, engine == Engine::Blender);
    // List all pictures of all light fields: views, or halves of their samples.
    let mut all = Vec::new();
    for (number, field) in fields.iter().enumerate() {
        std::fs::create_dir_all(&field.folder).map_err(PipelineError::write(&field.folder))?;
        let variance = options.variance() && field.is_target();
        let guides = kind.takes_halves() || options.surfaces() && field.is_target();
        let traced = if ingested.scene.needs_paths() { field.wanted(&views) } else { Vec::new() };
        for view in traced {
            for &half in parts(kind) {
                let shared = kind == Denoise::Shared;
                let path = if shared { split_path(&field.folder, view) } else { view_path(&field.folder, view, half) };
                let variance = variance.then(|| variance_path(&field.folder, view, half));
                let guides = guides.then(|| guides_path(&field.folder, view, half));
                all.push(Todo { field: number, view, half, path, variance, guides });
            }
        }
    }
    // Find once which light fields are filtered, since the check reads all filtered views. A
    // finished filter has removed the split views, so missing split views need no tracing.
    let finished: Vec<bool> = fields.iter().map(|field| denoise::is_finished(field, kind)).collect();
    let is_kept = |Todo { field, path, variance, .. }: &Todo| {
        let FieldJob { geometry, settings, .. } = &fields[*field];
        let is_there = |path: &PathBuf| read_view(path, geometry).is_some();
        let traced = if kind == Denoise::Shared {
            finished[*field] || read_split(path, geometry, settings).is_some()
        } else {
            is_there(path)
        };
        traced && variance.as_ref().is_none_or(is_there)
    };
    // Trace only pictures that the cache lacks.
    let todo = missing(block.of(all), |todo| todo.path.clone(), is_kept, task);
    let splats = missing_splats(ingested, &fields, &views, block, task);
    let cached = todo.is_empty() && splats.iter().all(Vec::is_empty);
    if !(cached && finished.iter().all(|finished| *finished)) {
        // Check the denoiser before the rendering, which may take hours.
        denoise::check(kind, job, shot.geometry)?;
    }
    // A disk that is full would end the rendering, so check the free space, too. A filter also
    // needs space for its views, and for the shared light of one light field at a time.
    let of_todo = todo.iter().map(|todo| todo.bytes(&fields[todo.field], kind));
    let of_splats =
        fields.iter().zip(&splats).map(|(field, views)| space::SPLATS * field.pixels() * views.len() as u64);
    let unfiltered = || {
        let unfinished = fields.iter().zip(&finished).filter(|(_, finished)| !**finished && block == Block::ALL);
        unfinished.map(|(field, _)| field)
    };
    let of_filter = unfiltered().map(|field| denoise::missing_bytes(field, kind));
    let of_light = unfiltered().map(|field| denoise::shared_bytes(field, kind, job)).max();
    space::check(cache_dir, of_todo.chain(of_splats).chain(of_filter).chain(of_light).sum())?;
    if engine == Engine::Blender {
        for (number, field) in fields.iter().enumerate() {
            let of_field = todo.iter().filter(|todo| todo.field == number);
            let wanted: Vec<_> = of_field.map(|todo| (todo.view, todo.path.as_path())).collect();
            if !wanted.is_empty() {
                blender::render(job, window, &field.traced, &wanted, task)?;
            }
        }
    } else if !todo.is_empty() {
        trace(&ingested.renderer(task)?.tracer, &todo, &fields, window, kind, task)?;
    }
    for (field, views) in fields.iter().zip(&splats) {
        if !views.is_empty() {
            render_splats(ingested.renderer(task)?, field, views, window, task)?;
        }
    }
    Ok(Views { fields, views, engine, cached })
}

/// Returns the depths of the target's views, and true if they were cached.
fn depths(shot: Shot<'_>, target: &FieldJob, task: Task<'_>) -> Result<(Depths, bool), PipelineError> {
    if let Some(kept) = depth::kept(&target.folder, &target.traced) {
        return Ok((kept, true));
    }
    let renderer = shot.ingested.renderer(task)?;
    Ok((depth::trace(renderer, shot.window(), &target.traced, &target.folder, task)?, false))
}

/// Returns, for each light field, the views of a block whose splats are not cached.
fn missing_splats(
    ingested: &Ingested,
    fields: &[FieldJob],
    views: &[[usize; 2]],
    block: Block,
    task: Task<'_>,
) -> Vec<Vec<[usize; 2]>> {
    let of_field = |field: &FieldJob| {
        if ingested.scene.placed_clouds.is_empty() {
            return Vec::new();
        }
        let path = |view: &[usize; 2]| splats_path(&field.folder, *view);
        missing(block.of(field.wanted(views)), path, |view| read_splats(&path(view), &field.traced).is_some(), task)
    };
    fields.iter().map(of_field).collect()
}

/// Renders the splats of a light field's views.
fn render_splats(
    renderer: &SceneRenderer,
    field: &FieldJob,
    views: &[[usize; 2]],
    window: &Window,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let slopes = slopes(&field.traced, views);
    task.progress.begin("render splats", views.len() as u64, "views");
    let result = renderer.splat_views(window, &field.traced, &slopes, task, |number, view| {
        write_splats(&splats_path(&field.folder, views[number]), &view.light)?;
        task.progress.advance(1, "");
        Ok(())
    });
    task.progress.end();
    result
}

fn trace(
    renderer: &Renderer,
    todo: &[Todo],
    fields: &[FieldJob],
    window: &Window,
    kind: Denoise,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let steps: u64 = todo.iter().map(|todo| Renderer::steps_per_view(&fields[todo.field].geometry)).sum();
    task.progress.begin("render", steps, "tiles");
    let finished = AtomicUsize::new(0);
    let one = |_: usize, picture: &Todo, task: Task<'_>| {
        let Todo { field, view, half, path, variance, guides } = picture;
        let field = &fields[*field];
        // Each half of a view has its own seed.
        let (traced, settings) = (&field.traced, field.settings_of(*half));
        let (alone, shared) = (variance.is_none() && guides.is_none(), kind == Denoise::Shared);
        // Radiance, variance and first hits come from the same paths. If neither variance nor first
        // hits are requested, only the radiance is computed.
        let more = if shared && alone {
            let split = renderer.render_split(window, traced, *view, &settings, task).map_err(render_error)?;
            write_split(path, &split)?;
            None
        } else if shared {
            let both = renderer.render_split_and_features(window, traced, *view, &settings, task);
            let GuidedSplit { split, variance, features } = both.map_err(render_error)?;
            write_split(path, &split)?;
            Some((variance, features))
        } else if alone {
            let radiance = renderer.render_view(window, traced, *view, &settings, task).map_err(render_error)?;
            write_view(path, &radiance)?;
            None
        } else {
            let both = renderer.render_view_and_features(window, traced, *view, &settings, task);
            let GuidedView { radiance, variance, features } = both.map_err(render_error)?;
            write_view(path, &radiance)?;
            Some((variance, features))
        };
        if let Some((values, features)) = more {
            variance.as_ref().map_or(Ok(()), |path| write_view(path, &values))?;
            guides.as_ref().map_or(Ok(()), |path| write_guides(path, &features))?;
        }
        let of = if half.is_some() { "half view" } else { "view" };
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        task.progress.advance(0, &format!("{of} {finished} of {}", todo.len()));
        Ok(())
    };
    let result = in_groups(todo, task, one, Ok);
    task.progress.end();
    result
}
