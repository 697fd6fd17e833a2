//! Scene to light field: every view is path-traced and kept in the cache, filtered where the job says so, then one exposure makes all of them
//! display-referred.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_core::tone::ToneCurve;
use lumistack_display::{FieldGeometry, LightField, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_scene::Window;

use crate::blender;
use crate::cache::KeyBuilder;
use crate::code;
use crate::denoise::{self, Denoised, Traced};
use crate::depth::Depths;
use crate::error::{PipelineError, field_error};
use crate::fit::Placement;
use crate::ingest::Ingested;
use crate::job::{AngularFilter, Background, Denoise, Engine, Job};
use crate::look::Look;
use crate::sealed;
use crate::surround::expose_over;
use crate::views::ViewOptions;

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
    /// How the target was traced, and where.
    pub(crate) traced: FieldJob,
    /// The views of the target that were wanted, [view_y, view_x]; the others are black.
    pub(crate) views: Vec<[usize; 2]>,
    /// What rendered them.
    pub(crate) engine: Engine,
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
    render_views(job, ingested, placement, geometry, footprint, cache_dir, &ViewOptions::default(), task)
}

/// [`render`] with other views of the target than all, or without exposure.
///
/// # Errors
/// As there, and when the options do not fit the job.
pub(crate) fn render_views(
    job: &Job,
    ingested: &Ingested,
    placement: &Placement,
    geometry: &FieldGeometry,
    footprint: [f64; 2],
    cache_dir: &Path,
    options: &ViewOptions,
    task: Task<'_>,
) -> Result<Rendered, PipelineError> {
    options.check(job)?;
    let views = options.chosen(geometry.grid.views())?;
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
        hide_environment: job.light.background != Background::Environment,
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
    let mut key = shot_key(job, ingested, window);
    key.add_json("render", &(&job.render.max_bounces, job.render.samples, job.seed));
    key.add("settings", format!("{settings:?}").as_bytes());
    let kind = job.render.denoise;
    if kind != Denoise::Off {
        key.add("halves", b"2");
    }
    let engine = blender::engine(job, ingested, options.variance(), task);
    if engine == Engine::Blender {
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
        let variance = options.variance() && i == 0;
        for view in field.wanted(&views) {
            for &half in denoise::parts(kind) {
                let path = view_path(&field.folder, view, half);
                let variance = variance.then(|| variance_path(&field.folder, view, half));
                let is_there = |path: &PathBuf| read_view(path, &field.geometry).is_some();
                if !(is_there(&path) && variance.as_ref().is_none_or(is_there)) {
                    todo.push(Todo { field: i, view, half, path, variance });
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
    if engine == Engine::Blender {
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
    let all: usize = fields.iter().map(|field| field.geometry.grid.iter().count()).sum();
    task.progress.begin("expose", all as u64, "views");
    let exposed = expose(job, ingested, &fields, &views, &depths, window, options, task);
    task.progress.end();
    let (look, denoised, shown) = exposed?;
    let coverage = depths.coverage(geometry.grid.views().map(|count| count / 2));
    let mut exposed = shown.into_iter();
    let target = exposed.next().ok_or_else(|| PipelineError::value("job", "views", "at least one", "none"))?;
    let mut other = |name| if fields.iter().any(|field| field.name == name) { exposed.next() } else { None };
    let (held_out, outside) = (other("held-out"), other("outside"));
    let folders = fields.iter().map(|field| field.folder.clone()).collect();
    let traced = fields.swap_remove(0);
    Ok(Rendered { target, held_out, outside, look, depths, coverage, denoised, cached, engine, folders, traced, views })
}

/// Reads the finished views of all fields and makes them display-referred, with one look for all, or leaves them as they are.
fn expose(
    job: &Job,
    ingested: &Ingested,
    fields: &[FieldJob],
    views: &[[usize; 2]],
    depths: &Depths,
    window: &Window,
    options: &ViewOptions,
    task: Task<'_>,
) -> Result<(Look, Option<Denoised>, Vec<LightField>), PipelineError> {
    let kind = job.render.denoise;
    let mut radiance = Vec::new();
    for one in fields {
        let FieldJob { geometry, folder, .. } = one;
        let mut field = LightField::black(geometry.clone())?;
        for view in one.wanted(views) {
            let path = view_path(&denoise::finished(kind, folder), view, None);
            let picture = read_view(&path, geometry).ok_or_else(|| {
                PipelineError::value(&path, "cached view", "the picture just written", "another or none")
            })?;
            field.view_mut(view).copy_from_slice(&picture);
        }
        radiance.push(field);
    }
    let look = if options.linear {
        Look { exposure: 1.0, curve: ToneCurve::Linear }
    } else {
        Look::choose(&job.light, &ingested.scene, &brightest(&radiance[0], views, depths))
    };
    let denoised = fields[0].halves().denoised(kind, look)?;
    let mut shown = Vec::new();
    for (field, mut radiance) in fields.iter().zip(radiance) {
        if options.linear {
            // neither exposed nor clipped nor rounded
        } else if let Background::Colour(background) = job.light.background {
            for view in field.wanted(views) {
                let missed = field.missed(view, kind, || ingested.renderer(task), window, task)?;
                expose_over(look, background, &missed, radiance.view_mut(view));
            }
            lumistack_field_io::round_to_half(&mut radiance);
        } else {
            look.apply(&mut radiance);
            lumistack_field_io::round_to_half(&mut radiance);
        }
        task.progress.advance(field.geometry.grid.iter().count() as u64, "");
        shown.push(radiance);
    }
    Ok((look, denoised, shown))
}

/// Key of what a view is before it is exposed, but for its geometry and its samples.
pub(crate) fn shot_key(job: &Job, ingested: &Ingested, window: &Window) -> KeyBuilder {
    let mut key = KeyBuilder::new("render", code::VIEWS);
    ingested.add_to(&mut key);
    // of a view before it is exposed
    key.add_json("light", &(job.light.environment_strength, job.light.automatic, job.light.environment_rotation_deg))
        .add("window", format!("{window:?}").as_bytes());
    key
}

/// One light field to render.
pub(crate) struct FieldJob {
    name: &'static str,
    /// Of random numbers.
    stream: u64,
    /// Of the display.
    geometry: FieldGeometry,
    /// The same in the scene: with the slopes at which it is traced.
    pub(crate) traced: FieldGeometry,
    pub(crate) settings: Settings,
    /// Where its traced views lie.
    pub(crate) folder: PathBuf,
}

impl FieldJob {
    /// As the denoiser takes it up.
    fn halves(&self) -> Traced<'_> {
        let Self { traced, folder, .. } = self;
        Traced { geometry: traced, settings: self.seeded(&[]), folder, checked: self.stream == 0 }
    }

    /// The views to render: of the target those that were chosen, else all.
    fn wanted(&self, chosen: &[[usize; 2]]) -> Vec<[usize; 2]> {
        if self.stream == 0 { chosen.to_vec() } else { self.geometry.grid.iter().collect() }
    }

    /// Settings with which a view is traced, or a half of its samples.
    fn settings_of(&self, half: Option<usize>) -> Settings {
        match half {
            None => self.seeded(&[]),
            Some(half) => Settings { samples: self.settings.samples.div_ceil(2), ..self.seeded(&[1 + half as u64]) },
        }
    }

    /// Share of the samples of every pixel of a view that meet no surface, `[row][col]`; kept beside the view.
    ///
    /// # Errors
    /// When the scene cannot be rendered, the file cannot be written, or when cancelled.
    pub(crate) fn missed<'a>(
        &self,
        view: [usize; 2],
        kind: Denoise,
        renderer: impl Fn() -> Result<&'a Renderer, PipelineError>,
        window: &Window,
        task: Task<'_>,
    ) -> Result<Vec<f32>, PipelineError> {
        let path = self.folder.join(format!("missed_{:02}_{:02}.npy", view[0], view[1]));
        let shape = [self.traced.rows, self.traced.cols];
        if let Ok((found, missed)) = lumistack_field_io::npy::read(&path)
            && found == shape
        {
            return Ok(missed);
        }
        let parts = denoise::parts(kind);
        let mut missed = vec![0.0; shape[0] * shape[1]];
        for &half in parts {
            let settings = self.settings_of(half);
            let of_part =
                renderer()?.render_misses(window, &self.traced, view, &settings, task).map_err(render_error)?;
            missed.iter_mut().zip(of_part.data()).for_each(|(sum, part)| *sum += part / parts.len() as f32);
        }
        lumistack_field_io::npy::write(&path, &shape, &missed).map_err(field_error)?;
        Ok(missed)
    }

    /// Variance of every value of a view before it is filtered, `[row][col][rgb]`: of the mean of its halves, where it has halves.
    ///
    /// # Errors
    /// When it was not rendered with the view.
    pub(crate) fn variance(&self, view: [usize; 2], kind: Denoise) -> Result<Vec<f32>, PipelineError> {
        let parts = denoise::parts(kind);
        let mut variance = vec![0.0; 3 * self.traced.rows * self.traced.cols];
        for &half in parts {
            let path = variance_path(&self.folder, view, half);
            let of_part = read_view(&path, &self.traced).ok_or_else(|| {
                PipelineError::value(&path, "cached variance", "the picture just written", "another or none")
            })?;
            let share = 1.0 / (parts.len() * parts.len()) as f32;
            variance.iter_mut().zip(of_part).for_each(|(sum, part)| *sum += share * part);
        }
        Ok(variance)
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
    /// Where its variance is to be written, if it is wanted.
    variance: Option<PathBuf>,
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
    let result = todo.iter().enumerate().try_for_each(|(number, Todo { field, view, half, path, variance })| {
        let field = &fields[*field];
        let settings = field.settings_of(*half);
        let picture = match variance {
            None => renderer.render_view(window, &field.traced, *view, &settings, task).map_err(render_error)?,
            Some(path) => {
                let both = renderer.render_view_and_variance(window, &field.traced, *view, &settings, task);
                let (picture, variance) = both.map_err(render_error)?;
                denoise::write_view(path, &variance)?;
                picture
            }
        };
        denoise::write_view(path, &picture)?;
        let of = if half.is_some() { "half view" } else { "view" };
        task.progress.advance(0, &format!("{of} {} of {}", number + 1, todo.len()));
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

/// The file of the variance of a view, or of a half of its samples.
fn variance_path(folder: &Path, view: [usize; 2], half: Option<usize>) -> PathBuf {
    let half = half.map_or("", |half| ["-a", "-b"][half]);
    folder.join(format!("variance_{:02}_{:02}{half}.exr", view[0], view[1]))
}

/// Reads a view of the geometry's size; `None` where it is not there as it was written.
pub(crate) fn read_view(path: &Path, geometry: &FieldGeometry) -> Option<Vec<f32>> {
    sealed::read_picture(path, [geometry.cols, geometry.rows])
}

/// The brightest channel of evenly spread rays of some views, and whether they meet a surface.
fn brightest(field: &LightField, views: &[[usize; 2]], depths: &Depths) -> Vec<(f32, bool)> {
    let geometry = field.geometry();
    let size = geometry.rows * geometry.cols;
    let all = views.len() * size;
    let every = all.div_ceil(MOST_RAYS).max(1);
    let mut rays = Vec::with_capacity(all / every + 1);
    for (number, &view) in views.iter().enumerate() {
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
