//! Path tracing of all views of a shot into the cache, picture by picture, so that a run that is stopped goes on from those that are finished.

mod blender;

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_pathtracer::Renderer;
use lumistack_scene::Window;

use super::denoise;
use super::depth::Depths;
use super::fields::{FieldJob, Shot, parts};
use crate::error::{PipelineError, render_error};
use crate::job::{Denoise, Engine};
use crate::store::views::{
    missing, read_split, read_view, split_path, variance_path, view_path, write_split, write_view,
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

/// A picture to trace.
struct Todo {
    field: usize,
    view: [usize; 2],
    /// Which half of the samples, or all of them.
    half: Option<usize>,
    path: PathBuf,
    /// Where its variance is to be written, if it is wanted.
    variance: Option<PathBuf>,
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
    let Shot { job, ingested, .. } = shot;
    options.check(job, shot.geometry.grid.iter().count())?;
    let views = options.chosen(shot.geometry.grid.views())?;
    let (window, kind) = (shot.window(), job.render.denoise);
    let engine = blender::engine(job, ingested, options.variance(), task);
    let fields = shot.fields(cache_dir, engine == Engine::Blender);
    let mut all = Vec::new();
    for (number, field) in fields.iter().enumerate() {
        std::fs::create_dir_all(&field.folder).map_err(PipelineError::write(&field.folder))?;
        let variance = options.variance() && field.is_target();
        for view in field.wanted(&views) {
            for &half in parts(kind) {
                let shared = kind == Denoise::Shared;
                let path = if shared { split_path(&field.folder, view) } else { view_path(&field.folder, view, half) };
                let variance = variance.then(|| variance_path(&field.folder, view, half));
                all.push(Todo { field: number, view, half, path, variance });
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
    let todo = missing(all, |todo| todo.path.clone(), is_kept, task);
    let kept = Depths::read(&fields[0].folder, &fields[0].traced);
    let cached = todo.is_empty() && kept.is_some();
    let depths = match kept {
        Some(depths) => depths,
        None => Depths::trace(ingested.renderer(task)?, window, &fields[0].traced, Some(&fields[0].folder), task)?,
    };
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
        trace(ingested.renderer(task)?, &todo, &fields, window, kind, task)?;
    }
    Ok((Traced { fields, depths, views, engine }, cached))
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
    let result = todo.iter().enumerate().try_for_each(|(number, Todo { field, view, half, path, variance })| {
        let field = &fields[*field];
        let settings = field.settings_of(*half);
        let picture = match variance {
            None if kind == Denoise::Shared => None,
            None => Some(renderer.render_view(window, &field.traced, *view, &settings, task).map_err(render_error)?),
            Some(path) => {
                let both = renderer.render_view_and_variance(window, &field.traced, *view, &settings, task);
                let (picture, variance) = both.map_err(render_error)?;
                write_view(path, &variance)?;
                Some(picture)
            }
        };
        if kind == Denoise::Shared {
            let split = renderer.render_split(window, &field.traced, *view, &settings, task).map_err(render_error)?;
            write_split(path, &split)?;
        } else if let Some(picture) = picture {
            write_view(path, &picture)?;
        }
        let of = if half.is_some() { "half view" } else { "view" };
        task.progress.advance(0, &format!("{of} {} of {}", number + 1, todo.len()));
        Ok(())
    });
    task.progress.end();
    result
}
