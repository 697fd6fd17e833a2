//! Path tracing of all views of a shot into the cache, picture by picture, so that a run that is stopped goes on from those that are finished.

mod blender;

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_pathtracer::{GuidedSplit, GuidedView, Renderer};
use lumistack_scene::Window;
use lumistack_shot::{Depths, SceneRenderer, slopes};

use super::fields::{Block, FieldJob, Shot, parts};
use super::ingest::Ingested;
use super::{denoise, depth};
use crate::error::{PipelineError, render_error};
use crate::job::{Denoise, Engine};
use crate::store::views::{
    guides_path, missing, read_splats, read_split, read_view, splats_path, split_path, variance_path, view_path,
    write_guides, write_splats, write_split, write_view,
};
use crate::view_options::ViewOptions;

/// The traced views of a shot, in the cache.
pub(crate) struct Traced {
    /// The target first.
    pub(crate) fields: Vec<FieldJob>,
    /// How deep the target's views see.
    pub(crate) depths: Depths,
    /// The views of the target that were wanted, [view_y, view_x].
    pub(crate) views: Vec<[usize; 2]>,
    /// Who rendered them.
    pub(crate) engine: Engine,
}

/// Who renders a shot's views.
pub(crate) fn engine(shot: Shot<'_>, options: &ViewOptions, task: Task<'_>) -> Engine {
    blender::engine(shot.job, shot.ingested, options.variance(), task)
}

/// A picture to trace.
struct Todo {
    field: usize,
    view: [usize; 2],
    /// Which half of the samples, or all of them.
    half: Option<usize>,
    path: PathBuf,
    /// Where its variance is to be written, if it is wanted.
    variance: Option<PathBuf>,
    /// Where its first surfaces are to be written, if they are wanted.
    guides: Option<PathBuf>,
}

/// Traces all views that the cache does not hold; says whether it held them all.
///
/// # Errors
/// When the options do not fit the job, rendering fails or is cancelled, or a view cannot be stored.
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

/// Traces the views of a block that the cache does not hold, and depths with the first block; says whether it held them. Others may trace other blocks meanwhile.
///
/// # Errors
/// As [`run`].
pub(crate) fn run_block(shot: Shot<'_>, cache_dir: &Path, block: Block, task: Task<'_>) -> Result<bool, PipelineError> {
    let Views { fields, cached, .. } = trace_views(shot, &ViewOptions::default(), cache_dir, block, task)?;
    let known = !block.is_first() || depths(shot, &fields[0], task)?.1;
    Ok(cached && known)
}

/// Views of a shot in the cache, or a block of them.
struct Views {
    fields: Vec<FieldJob>,
    views: Vec<[usize; 2]>,
    engine: Engine,
    /// Whether none had to be traced.
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
    options.check(job, shot.geometry.grid.iter().count())?;
    let views = options.chosen(shot.geometry.grid.views())?;
    let (window, kind) = (shot.window(), shot.denoise());
    let engine = engine(shot, options, task);
    let fields = shot.fields(cache_dir, engine == Engine::Blender);
    let mut all = Vec::new();
    for (number, field) in fields.iter().enumerate() {
        std::fs::create_dir_all(&field.folder).map_err(PipelineError::write(&field.folder))?;
        let variance = options.variance() && field.is_target();
        let guides = kind.takes_halves() || options.surfaces() && field.is_target();
        let traced = if ingested.is_traced() { field.wanted(&views) } else { Vec::new() };
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
    // what light is shared from is dropped when that is done
    let is_shared: Vec<bool> =
        fields.iter().map(|field| kind == Denoise::Shared && denoise::is_finished(field, kind)).collect();
    let is_kept = |Todo { field, path, variance, .. }: &Todo| {
        let geometry = &fields[*field].geometry;
        let is_there = |path: &PathBuf| read_view(path, geometry).is_some();
        let traced = if kind == Denoise::Shared {
            is_shared[*field] || read_split(path, geometry).is_some()
        } else {
            is_there(path)
        };
        traced && variance.as_ref().is_none_or(is_there)
    };
    let todo = missing(block.of(all), |todo| todo.path.clone(), is_kept, task);
    let splats = missing_splats(ingested, &fields, &views, block, task);
    let cached = todo.is_empty() && splats.iter().all(Vec::is_empty);
    if !(cached && fields.iter().all(|field| denoise::is_finished(field, kind))) {
        // before an hour of rendering, not after
        denoise::check(kind)?;
    }
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

/// How deep the views of the target see, and whether the cache held that.
fn depths(shot: Shot<'_>, target: &FieldJob, task: Task<'_>) -> Result<(Depths, bool), PipelineError> {
    if let Some(kept) = depth::kept(&target.folder, &target.traced) {
        return Ok((kept, true));
    }
    let renderer = shot.ingested.renderer(task)?;
    Ok((depth::trace(renderer, shot.window(), &target.traced, &target.folder, task)?, false))
}

/// The views of a block of every field whose splats the cache does not hold.
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

/// Renders what the views of a field see of the splats.
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
    let result = todo.iter().enumerate().try_for_each(|(number, one)| {
        let Todo { field, view, half, path, variance, guides } = one;
        let field = &fields[*field];
        let (traced, settings) = (&field.traced, field.settings_of(*half));
        let (alone, shared) = (variance.is_none() && guides.is_none(), kind == Denoise::Shared);
        // everything of the same paths: their light alone, or also what they hit first
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
            let picture = renderer.render_view(window, traced, *view, &settings, task).map_err(render_error)?;
            write_view(path, &picture)?;
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
        task.progress.advance(0, &format!("{of} {} of {}", number + 1, todo.len()));
        Ok(())
    });
    task.progress.end();
    result
}
