//! Scene to light field: every view is path-traced and kept in the cache, filtered where the job says so, then one exposure makes all of them
//! display-referred.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, LightField, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::Window;

use crate::blender;
use crate::cache::KeyBuilder;
use crate::code;
use crate::denoise::{self, Denoised, Traced};
use crate::depth::Depths;
use crate::error::PipelineError;
use crate::fit::Placement;
use crate::ingest::Ingested;
use crate::job::{AngularFilter, Denoise, Engine, Job};
use crate::look::Look;
use crate::sealed;

/// Rays that decide about exposure and tone curve, at most.
const MOST_RAYS: usize = 4_000_000;

/// The rendered light fields of a run.
pub struct Rendered {
    /// What the display should show.
    pub target: LightField,
    /// In-between views that the solver does not see.
    pub held_out: Option<LightField>,
    /// Views beyond the outermost ones, which it does not see either.
    pub outside: Option<LightField>,
    /// How scene-linear radiance became display-referred.
    pub(crate) look: Look,
    /// What the target's views see how deep, as traced.
    pub(crate) depths: Depths,
    /// Share of the window where the middle view sees a surface, 0..1.
    pub coverage: f64,
    /// What the denoiser did to the target, where there is one.
    pub(crate) denoised: Option<Denoised>,
    /// Whether no view had to be traced.
    pub cached: bool,
    /// Where the traced views are kept.
    pub(crate) folders: Vec<PathBuf>,
}

/// Evenly spread in-between views: at most `per_axis` of the midpoints on each axis.
pub fn held_out_grid(grid: &ViewGrid, per_axis: usize) -> Option<ViewGrid> {
    if per_axis == 0 || grid.views() == [1, 1] {
        return None;
    }
    let midpoints = grid.in_between();
    let pick = |slopes: &[f64]| {
        let count = per_axis.min(slopes.len());
        (0..count).map(|i| slopes[(2 * i + 1) * slopes.len() / (2 * count)]).collect()
    };
    Some(ViewGrid { projection: grid.projection, slope_x: pick(&midpoints.slope_x), slope_y: pick(&midpoints.slope_y) })
}

/// Traces all views that the cache does not hold. With a depth scale they are traced at slopes that much smaller than those of `geometry`. `footprint` is the
/// width of slopes of the display's own prefilter.
///
/// # Errors
/// When rendering fails or is cancelled, or a view cannot be stored.
pub(crate) fn render(
    job: &Job,
    ingested: &Ingested,
    placement: &Placement,
    geometry: &FieldGeometry,
    footprint: [f64; 2],
    cache_dir: &Path,
    task: Task<'_>,
) -> Result<Rendered, PipelineError> {
    let window = &placement.window;
    let traced = |geometry: &FieldGeometry| geometry.with_grid(geometry.grid.scaled(placement.depth_scale));
    let settings = Settings {
        samples: job.render.samples,
        max_bounces: job.render.max_bounces,
        seed: job.seed,
        clamp: job.render.clamp,
        angular_filter: match job.render.angular_filter {
            _ if job.render.lens_deg > 0.0 => {
                let diameter = 2.0 * (0.5 * job.render.lens_deg.to_radians()).tan();
                lumistack_pathtracer::AngularFilter::Lens(placement.depth_scale * diameter)
            }
            AngularFilter::Point => lumistack_pathtracer::AngularFilter::Point,
            AngularFilter::Bin => lumistack_pathtracer::AngularFilter::Bin,
            AngularFilter::Display => {
                lumistack_pathtracer::AngularFilter::Width(footprint.map(|width| placement.depth_scale * width))
            }
        },
        ..Settings::default()
    };
    // views for the report only average over directions as the target's do, however far apart they stand
    let settings_of_others = Settings {
        angular_filter: match settings.angular_filter {
            lumistack_pathtracer::AngularFilter::Bin => {
                lumistack_pathtracer::AngularFilter::Width(traced(geometry).grid.bin_width())
            }
            other => other,
        },
        ..settings
    };
    let others = [
        ("held-out", 1, held_out_grid(&geometry.grid, job.render.held_out)),
        ("outside", 2, geometry.grid.outside(job.render.outside)),
    ];
    let others = others.map(|(name, stream, grid)| {
        let geometry = geometry.with_grid(grid?);
        let (traced, folder) = (traced(&geometry), PathBuf::new());
        Some(FieldJob { name, stream, geometry, traced, settings: settings_of_others, folder })
    });
    let folder = PathBuf::new();
    let target =
        FieldJob { name: "target", stream: 0, geometry: geometry.clone(), traced: traced(geometry), settings, folder };
    let mut fields: Vec<FieldJob> = std::iter::once(Some(target)).chain(others).flatten().collect();
    let mut key = KeyBuilder::new("render", code::VIEWS);
    ingested.add_to(&mut key);
    // what a view is before it is exposed
    key.add_json("light", &(job.light.environment_strength, job.light.automatic))
        .add_json("render", &(&job.render.max_bounces, job.render.samples, job.seed));
    key.add("settings", format!("{settings:?}").as_bytes()).add("window", format!("{window:?}").as_bytes());
    let kind = job.render.denoise;
    if kind != Denoise::Off {
        key.add("halves", b"2");
    }
    if job.render.engine == Engine::Blender {
        key.add("engine", b"blender");
    }
    let mut todo = Vec::new();
    for (i, field) in fields.iter_mut().enumerate() {
        let mut key = key.clone();
        key.add("geometry", format!("{:?}", field.traced).as_bytes());
        if field.settings != settings {
            key.add("filter", format!("{:?}", field.settings.angular_filter).as_bytes());
        }
        field.folder = cache_dir.join(format!("{}-{}", field.name, &key.finish()[..16]));
        std::fs::create_dir_all(&field.folder).map_err(PipelineError::write(&field.folder))?;
        for view in field.geometry.grid.iter() {
            for &half in denoise::parts(kind) {
                let path = view_path(&field.folder, view, half);
                if read_view(&path, &field.geometry).is_none() {
                    todo.push(Todo { field: i, view, half, path });
                }
            }
        }
    }
    let kept = Depths::read(&fields[0].folder, &fields[0].traced);
    let cached = todo.is_empty() && kept.is_some() && fields.iter().all(|field| field.halves().is_finished(kind));
    let depths = match kept {
        Some(depths) => depths,
        None => Depths::trace(ingested.renderer(task)?, window, &fields[0].traced, Some(&fields[0].folder), task)?,
    };
    if !cached {
        denoise::check(kind)?;
    }
    if job.render.engine == Engine::Blender {
        for (number, field) in fields.iter().enumerate() {
            let of_field = todo.iter().filter(|todo| todo.field == number);
            let wanted: Vec<_> = of_field.map(|todo| (todo.view, todo.path.as_path())).collect();
            if !wanted.is_empty() {
                blender::render(job, window, &field.traced, &wanted, task)?;
            }
        }
    } else if !todo.is_empty() {
        trace(ingested.renderer(task)?, &todo, &fields, window, task)?;
    }
    for field in &fields {
        if !field.halves().is_finished(kind) {
            field.halves().filter(kind, ingested.renderer(task)?, window, task)?;
        }
    }
    let coverage = depths.coverage(geometry.grid.views().map(|count| count / 2));
    let mut radiance = Vec::new();
    for FieldJob { geometry, folder, .. } in &fields {
        let mut field = LightField::black(geometry.clone())?;
        for view in geometry.grid.iter() {
            let path = view_path(&denoise::finished(kind, folder), view, None);
            let picture = read_view(&path, geometry).ok_or_else(|| {
                PipelineError::value(&path, "cached view", "the picture just written", "another or none")
            })?;
            field.view_mut(view).copy_from_slice(&picture);
        }
        radiance.push(field);
    }
    let look = Look::choose(&job.light, &ingested.scene, &brightest(&radiance[0], &depths));
    let denoised = fields[0].halves().denoised(kind, look)?;
    let mut exposed = radiance.into_iter().map(|mut field| {
        look.apply(&mut field);
        lumistack_field_io::round_to_half(&mut field);
        field
    });
    let target = exposed.next().ok_or_else(|| PipelineError::value("job", "views", "at least one", "none"))?;
    let mut other = |name| if fields.iter().any(|field| field.name == name) { exposed.next() } else { None };
    let (held_out, outside) = (other("held-out"), other("outside"));
    let folders = fields.into_iter().map(|field| field.folder).collect();
    Ok(Rendered { target, held_out, outside, look, depths, coverage, denoised, cached, folders })
}

/// One light field to render.
struct FieldJob {
    name: &'static str,
    /// Of random numbers.
    stream: u64,
    /// Of the display.
    geometry: FieldGeometry,
    /// The same in the scene: with the slopes at which it is traced.
    traced: FieldGeometry,
    settings: Settings,
    /// Where its traced views lie.
    folder: PathBuf,
}

impl FieldJob {
    /// As the denoiser takes it up.
    fn halves(&self) -> Traced<'_> {
        let Self { traced, folder, .. } = self;
        Traced { geometry: traced, settings: self.seeded(&[]), folder, checked: self.stream == 0 }
    }

    /// Settings with the seed of this field, and of a part of it.
    fn seeded(&self, part: &[u64]) -> Settings {
        let seed = lumistack_core::seed::derive(self.settings.seed, &[&[self.stream], part].concat());
        Settings { seed, ..self.settings }
    }
}

/// A picture to trace.
struct Todo {
    field: usize,
    view: [usize; 2],
    /// Which half of the samples, or all of them.
    half: Option<usize>,
    path: PathBuf,
}

fn trace(
    renderer: &Renderer,
    todo: &[Todo],
    fields: &[FieldJob],
    window: &Window,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let steps: u64 = todo.iter().map(|todo| Renderer::steps_per_view(&fields[todo.field].geometry)).sum();
    task.progress.begin("render", steps, "tiles");
    let result = todo.iter().enumerate().try_for_each(|(number, Todo { field, view, half, path })| {
        let field = &fields[*field];
        let settings = match half {
            None => field.seeded(&[]),
            Some(half) => Settings { samples: field.settings.samples.div_ceil(2), ..field.seeded(&[1 + *half as u64]) },
        };
        let picture = renderer.render_view(window, &field.traced, *view, &settings, task).map_err(render_error)?;
        denoise::write_view(path, &picture)?;
        let of = if half.is_some() { "half view" } else { "view" };
        task.progress.advance(0, &format!("tiles, {of} {} of {}", number + 1, todo.len()));
        Ok(())
    });
    task.progress.end();
    result
}

pub(crate) fn render_error(error: lumistack_pathtracer::RenderError) -> PipelineError {
    match error {
        lumistack_pathtracer::RenderError::Cancelled(_) => PipelineError::Cancelled,
        other => PipelineError::Render(other),
    }
}

/// The file of a view, or of a half of its samples.
pub(crate) fn view_path(folder: &Path, view: [usize; 2], half: Option<usize>) -> PathBuf {
    let half = half.map_or("", |half| ["-a", "-b"][half]);
    folder.join(format!("view_{:02}_{:02}{half}.exr", view[0], view[1]))
}

/// Reads a view of the geometry's size; `None` where it is not there as it was written.
pub(crate) fn read_view(path: &Path, geometry: &FieldGeometry) -> Option<Vec<f32>> {
    sealed::read_picture(path, [geometry.cols, geometry.rows])
}

/// The brightest channel of evenly spread rays of all views, and whether they meet a surface.
fn brightest(field: &LightField, depths: &Depths) -> Vec<(f32, bool)> {
    let geometry = field.geometry();
    let all = field.radiance().data().len() / 3;
    let every = all.div_ceil(MOST_RAYS).max(1);
    let size = geometry.rows * geometry.cols;
    let mut rays = Vec::with_capacity(all / every + 1);
    for (number, view) in geometry.grid.iter().enumerate() {
        // goes on in the next view where it left off
        let first = (every - number * size % every) % every;
        rays.extend(field.view(view).chunks_exact(3).enumerate().skip(first).step_by(every).map(|(i, rgb)| {
            let surface = depths.is_surface(view, i / geometry.cols, i % geometry.cols, geometry);
            (rgb[0].max(rgb[1]).max(rgb[2]), surface)
        }));
    }
    rays
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_display::Projection;

    #[test]
    fn held_out_views_lie_between_target_views() {
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 1], [20.0, 20.0]).unwrap();
        let held_out = held_out_grid(&grid, 2).unwrap();
        assert_eq!(held_out.views(), [1, 2]);
        for slope in &held_out.slope_x {
            assert!(grid.slope_x.iter().all(|target| (target - slope).abs() > 0.01));
        }
        assert!(held_out_grid(&grid, 0).is_none());
        let one = ViewGrid::single(Projection::Oblique, [0.0, 0.0]);
        assert!(held_out_grid(&one, 2).is_none());
    }
}
