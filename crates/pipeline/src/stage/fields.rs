//! Light fields of a shot: the target, held-out views, and views outside the viewing zone. The
//! stages for tracing, denoising and exposing exchange these light fields in
//! `cache/views/NAME-KEY`.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, ViewGrid};
use lumistack_pathtracer::{Features, Settings};
use lumistack_shot::{Placement, put_before, seeded};
use lumistack_splats::Space;

use super::ingest::Ingested;
use super::paths::Samples;
use crate::error::{PipelineError, field_error, render_error};
use crate::job::{Background, Denoise, Job};
use crate::store::code;
use crate::store::key::KeyBuilder;
use crate::store::views::{guides_path, read_guides, read_splats, read_view, splats_path, variance_path, view_path};

/// A shot: a scene that is placed in front of a display, and the settings of the job.
#[derive(Clone, Copy)]
pub(crate) struct Shot<'a> {
    pub(crate) job: &'a Job,
    pub(crate) ingested: &'a Ingested,
    pub(crate) placement: &'a Placement,
    /// Geometry of the display's light field.
    pub(crate) geometry: &'a FieldGeometry,
    pub(crate) display: &'a Display,
    /// Measured number of paths, if it was measured.
    pub(crate) samples: Option<Samples>,
}

impl Shot<'_> {
    pub(crate) fn window(&self) -> &lumistack_scene::Window {
        &self.placement.window
    }

    /// Returns a geometry with the slopes at which its views are traced: the slopes of the display
    /// times the depth scale.
    fn traced(&self, geometry: &FieldGeometry) -> FieldGeometry {
        geometry.with_grid(geometry.grid.scaled(self.placement.depth_scale))
    }

    /// Returns a key of views before exposure. The key contains neither the geometry of the views
    /// nor their number of samples.
    pub(crate) fn key(&self) -> KeyBuilder {
        let light = &self.job.light;
        let mut key = KeyBuilder::new("render", code::VIEWS);
        self.ingested.add_to(&mut key);
        // Add only the settings of light that change traced radiance. Exposure is applied after
        // tracing.
        key.add_json(
            "light",
            &(light.environment_strength, light.automatic, light.environment_rotation_deg, light.from_splats),
        )
        .add("window", format!("{:?}", self.window()).as_bytes());
        key
    }

    /// Returns the denoiser of the views; `Off` if no paths are traced.
    pub(crate) fn denoise(&self) -> Denoise {
        if self.ingested.scene.needs_paths() { self.job.render.denoise } else { Denoise::Off }
    }

    /// Returns the number of paths per pixel and view.
    pub(crate) fn samples_per_view(&self) -> u32 {
        let by_job = || self.job.render.samples_of_view(self.geometry.grid.iter().count());
        self.samples.map_or_else(by_job, |samples| samples.per_view)
    }

    fn settings(&self) -> Settings {
        let (job, samples) = (self.job, self.samples_per_view());
        let hidden = job.light.background != Background::Environment;
        let footprint = self.display.angular_footprint();
        let settings = job.render.settings(job.seed, samples, hidden, self.placement.depth_scale, footprint);
        job.split_settings(settings, self.display)
    }

    /// Returns all light fields of the shot, the target first. The traced views of each light field
    /// are in a folder inside `cache_dir`. `blender` is true if Blender renders the views.
    pub(crate) fn fields(&self, cache_dir: &Path, blender: bool) -> Vec<FieldJob> {
        let (job, geometry, settings) = (self.job, self.geometry, self.settings());
        // The target's views may be averaged over their bins of slopes. Then views of the other
        // light fields are averaged over ranges of the same width, not over bins of their own
        // grids.
        let settings_of_others = Settings {
            angular_filter: match settings.angular_filter {
                lumistack_pathtracer::AngularFilter::Bin => {
                    lumistack_pathtracer::AngularFilter::Width(self.traced(geometry).grid.bin_width())
                }
                other => other,
            },
            // Sparse paths suit only many views that share light; these light fields have few.
            sparse_paths: false,
            ..settings
        };
        // The names of folders contain a key of everything that traced views depend on.
        let mut key = self.key();
        key.add_json("render", &(&job.render.max_bounces, settings.samples, job.seed));
        key.add("settings", format!("{settings:?}").as_bytes());
        match self.denoise() {
            Denoise::Auto | Denoise::Off => {}
            Denoise::Shared => {
                key.add("parts", b"split");
            }
            Denoise::Guided | Denoise::Oidn => {
                key.add("halves", b"2");
            }
        }
        if blender {
            key.add("engine", b"blender");
        }
        let all = [
            ("target", settings, Some(geometry.grid.clone())),
            ("held-out", settings_of_others, held_out_grid(&geometry.grid, job.render.held_out)),
            ("outside", settings_of_others, geometry.grid.outside(job.render.outside)),
        ];
        let fields = all.into_iter().enumerate().filter_map(|(stream, (name, of_field, grid))| {
            let geometry = geometry.with_grid(grid?);
            let (traced, mut key) = (self.traced(&geometry), key.clone());
            key.add("geometry", format!("{traced:?}").as_bytes());
            if of_field != settings {
                key.add("filter", format!("{:?}", of_field.angular_filter).as_bytes());
            }
            let folder = cache_dir.join(format!("{name}-{}", &key.finish()[..16]));
            Some(FieldJob { name, stream: stream as u64, geometry, traced, settings: of_field, folder })
        });
        fields.collect()
    }
}

/// One of `count` blocks into which a list of pictures is cut for tracing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    number: usize,
    count: usize,
}

impl Block {
    /// The only block of a list that is not cut.
    pub(crate) const ALL: Self = Self { number: 0, count: 1 };

    /// Returns a block by its number from 1; `None` if the number is out of range.
    pub(crate) fn new([number, count]: [usize; 2]) -> Option<Self> {
        (1..=count).contains(&number).then(|| Self { number: number - 1, count })
    }

    /// Returns the block's number, from 0.
    pub(crate) fn number(self) -> usize {
        self.number
    }

    pub(crate) fn count(self) -> usize {
        self.count
    }

    pub(crate) fn is_first(self) -> bool {
        self.number == 0
    }

    /// Returns the elements of a list that belong to the block. Each element belongs to exactly one
    /// block.
    pub(crate) fn of<T>(self, list: Vec<T>) -> Vec<T> {
        let [from, to] = [self.number, self.number + 1].map(|number| list.len() * number / self.count);
        list.into_iter().skip(from).take(to - from).collect()
    }
}

/// Returns a grid of held-out views. Their slopes are midpoints between neighbouring views, evenly
/// spread, and at most `per_axis` per axis. An axis with one view keeps the slope of this view.
/// `None` if `per_axis` is 0 or the grid has only one view.
pub(crate) fn held_out_grid(grid: &ViewGrid, per_axis: usize) -> Option<ViewGrid> {
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

/// Joins the first hits of the parts of a view; a part is a half of the samples, or the whole view.
/// Returns `None` if there are no parts.
fn joined(parts: Vec<Features>) -> Option<Features> {
    parts.into_iter().reduce(|all, part| all.joined(&part))
}

/// Returns the parts in which a view is traced: two halves of its samples for filters that need
/// halves, otherwise the whole view.
pub(crate) fn parts(kind: Denoise) -> &'static [Option<usize>] {
    if kind.takes_halves() { &[Some(0), Some(1)] } else { &[None] }
}

/// A light field to render, and the folder of its views.
pub(crate) struct FieldJob {
    pub(crate) name: &'static str,
    /// Identifies the light field's sequence of random numbers.
    stream: u64,
    /// Geometry of the light field, with the slopes of the display.
    pub(crate) geometry: FieldGeometry,
    /// Geometry of the light field, with the slopes at which it is traced.
    pub(crate) traced: FieldGeometry,
    pub(crate) settings: Settings,
    /// Folder of the traced views.
    pub(crate) folder: PathBuf,
}

impl FieldJob {
    pub(crate) fn is_target(&self) -> bool {
        self.stream == 0
    }

    /// Returns the folder of the views after denoising.
    pub(crate) fn finished(&self, kind: Denoise) -> PathBuf {
        if kind.filters() { self.folder.join(kind.name()) } else { self.folder.clone() }
    }

    /// Returns the views to render: the `chosen` views of the target, but all views of other light
    /// fields.
    pub(crate) fn wanted(&self, chosen: &[[usize; 2]]) -> Vec<[usize; 2]> {
        if self.is_target() { chosen.to_vec() } else { self.geometry.grid.iter().collect() }
    }

    /// Returns the number of pixels of a view.
    pub(crate) fn pixels(&self) -> u64 {
        (self.traced.rows * self.traced.cols) as u64
    }

    /// Returns the settings of a view, or of a half of its samples.
    pub(crate) fn settings_of(&self, half: Option<usize>) -> Settings {
        match half {
            None => self.seeded(&[]),
            Some(half) => Settings { samples: self.settings.samples.div_ceil(2), ..self.seeded(&[1 + half as u64]) },
        }
    }

    /// Returns the fraction of every pixel that shows the background behind the scene,
    /// `[row][col]`, 0..1.
    ///
    /// # Errors
    /// If the scene cannot be rendered, a file is missing or cannot be written, or the task is
    /// cancelled.
    pub(crate) fn missed(&self, view: [usize; 2], shot: Shot<'_>, task: Task<'_>) -> Result<Vec<f32>, PipelineError> {
        let mut missed = if shot.ingested.scene.instances.is_empty() {
            vec![1.0; self.traced.rows * self.traced.cols]
        } else {
            self.missed_by_surfaces(view, shot, task)?
        };
        if let Some(splats) = self.splats(view, shot.ingested)? {
            missed.iter_mut().zip(splats.chunks_exact(4)).for_each(|(missed, pixel)| *missed *= pixel[3]);
        }
        Ok(missed)
    }

    /// Reads the splats of a view, `[row][col][r, g, b, T]` with the transmittance T. Returns
    /// `None` if the scene has no splats.
    fn splats(&self, view: [usize; 2], ingested: &Ingested) -> Result<Option<Vec<f32>>, PipelineError> {
        if ingested.scene.placed_clouds.is_empty() {
            return Ok(None);
        }
        let path = splats_path(&self.folder, view);
        read_splats(&path, &self.traced).ok_or_else(PipelineError::replaced(&path, "cached view of splats")).map(Some)
    }

    /// Returns a finished view, `[row][col][rgb]`, scene-linear over black: the view after
    /// denoising, with its splats in front.
    ///
    /// # Errors
    /// If a file is missing.
    pub(crate) fn radiance(&self, view: [usize; 2], shot: Shot<'_>) -> Result<Vec<f32>, PipelineError> {
        let mut picture = if shot.ingested.scene.needs_paths() {
            let path = view_path(&self.finished(shot.denoise()), view, None);
            read_view(&path, &self.geometry).ok_or_else(PipelineError::replaced(&path, "cached view"))?
        } else {
            vec![0.0; 3 * self.traced.rows * self.traced.cols]
        };
        if let (Some(splats), Some(space)) = (self.splats(view, shot.ingested)?, Space::of(&shot.ingested.scene)) {
            put_before(space, &splats, &mut picture);
        }
        Ok(picture)
    }

    /// Returns the fraction of every pixel's samples that hit no surface, `[row][col]`, 0..1. It is
    /// cached next to the view.
    fn missed_by_surfaces(&self, view: [usize; 2], shot: Shot<'_>, task: Task<'_>) -> Result<Vec<f32>, PipelineError> {
        let (kind, window) = (shot.denoise(), shot.window());
        let path = self.folder.join(format!("missed_{:02}_{:02}.npy", view[0], view[1]));
        let shape = [self.traced.rows, self.traced.cols];
        if let Ok((found, missed)) = lumistack_field_io::npy::read(&path)
            && found == shape
        {
            return Ok(missed);
        }
        if let Some(kept) = self.kept_guides(view, kind) {
            return Ok(kept.values().data().chunks_exact(Features::VALUES).map(|pixel| 1.0 - pixel[0]).collect());
        }
        let parts = parts(kind);
        let mut missed = vec![0.0; shape[0] * shape[1]];
        for &half in parts {
            let settings = self.settings_of(half);
            let tracer = &shot.ingested.renderer(task)?.tracer;
            let of_part = tracer.render_misses(window, &self.traced, view, &settings, task).map_err(render_error)?;
            missed.iter_mut().zip(of_part.data()).for_each(|(sum, part)| *sum += part / parts.len() as f32);
        }
        lumistack_field_io::npy::write(&path, &shape, &missed).map_err(field_error)?;
        Ok(missed)
    }

    /// Returns the guides of a denoiser for all samples of a view. If they were not kept with the
    /// radiance, they are traced again along the same rays.
    ///
    /// # Errors
    /// If the scene cannot be rendered, or the task is cancelled.
    pub(crate) fn guides(&self, view: [usize; 2], shot: Shot<'_>, task: Task<'_>) -> Result<Features, PipelineError> {
        if let Some(kept) = self.kept_guides(view, shot.denoise()) {
            return Ok(kept);
        }
        let tracer = &shot.ingested.renderer(task)?.tracer;
        let of_part = |&half: &Option<usize>| {
            tracer.render_features(shot.window(), &self.traced, view, &self.settings_of(half), task)
        };
        let parts: Result<Vec<Features>, _> = parts(shot.denoise()).iter().map(of_part).collect();
        let joined = joined(parts.map_err(render_error)?);
        joined.ok_or_else(|| PipelineError::job("samples", "at least one part", "none"))
    }

    /// Returns the guides of all samples of a view, if they were kept with the radiance.
    fn kept_guides(&self, view: [usize; 2], kind: Denoise) -> Option<Features> {
        let of_part = |&half: &Option<usize>| read_guides(&guides_path(&self.folder, view, half), &self.traced);
        joined(parts(kind).iter().map(of_part).collect::<Option<Vec<Features>>>()?)
    }

    /// Returns the variance of every value of a view before denoising, `[row][col][rgb]`. If the
    /// view is traced in halves, the result is the variance of their mean.
    ///
    /// # Errors
    /// If the variance was not written when the view was rendered.
    pub(crate) fn variance(&self, view: [usize; 2], kind: Denoise) -> Result<Vec<f32>, PipelineError> {
        let parts = parts(kind);
        let mut variance = vec![0.0; 3 * self.traced.rows * self.traced.cols];
        for &half in parts {
            let path = variance_path(&self.folder, view, half);
            let of_part =
                read_view(&path, &self.traced).ok_or_else(PipelineError::replaced(&path, "cached variance"))?;
            let share = 1.0 / (parts.len() * parts.len()) as f32;
            variance.iter_mut().zip(of_part).for_each(|(sum, part)| *sum += share * part);
        }
        Ok(variance)
    }

    /// Returns the settings with a seed for this light field and for `part`, such as a half of the
    /// samples.
    pub(crate) fn seeded(&self, part: &[u64]) -> Settings {
        seeded(self.settings, self.stream, part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_display::Projection;

    #[test]
    fn every_picture_belongs_to_one_block() {
        for count in [1, 2, 3, 7, 12] {
            let blocks = (1..=count).map(|number| Block::new([number, count]).unwrap());
            let all: Vec<usize> = blocks.flat_map(|block| block.of((0..10).collect())).collect();
            assert_eq!(all, (0..10).collect::<Vec<_>>(), "{count} blocks");
        }
        assert_eq!(Block::ALL.of(vec![1, 2]), [1, 2]);
        assert!([[0, 3], [4, 3], [1, 0]].map(Block::new).iter().all(Option::is_none));
    }

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
