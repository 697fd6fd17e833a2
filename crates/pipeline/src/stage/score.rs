//! Scores a display over its viewing zone: compares seen pictures with pictures of the scene, in
//! directions that no solver used.
//!
//! The scene is rendered twice in every direction, with independent seeds, so the score contains no
//! noise ([`DirectionScore`]). But pictures are cut to white before they are compared, so noise
//! darkens bright pixels. Few samples per pixel would therefore bias the score: in `still-life`, 4
//! samples raise it by 0.2 dB, and 24 samples by 0.06 dB. So every rendered pixel has [`SAMPLES`]
//! samples, and most directions render only a sixth of their pixels. SSIM and FLIP need whole
//! pictures. Therefore only the first directions, which are spread over the zone, have these two
//! scores. A light field that is not rendered is scored by views that the solver does not use.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_core::{Task, Tensor, seed};
use lumistack_display::{
    DirectionScore, Display, FieldGeometry, LayerStack, LightField, SeenView, Simulator, ViewGrid, Zone, ZoneScore,
};
use lumistack_field_io::{LeftOut, npy};
use lumistack_pathtracer::{AngularFilter, PixelSet, Renderer, Settings};
use lumistack_report::{ZoneFigures, ZoneView};
use lumistack_shot::{ToneMapping, expose_over, put_before};
use lumistack_splats::Space;
use rayon::prelude::*;

use crate::error::{PipelineError, field_error, render_error};
use crate::job::{Background, Engine, Job};
use crate::stage::fields::{Block, Shot};
use crate::stage::groups::in_groups;
use crate::store::code;
use crate::store::key::KeyBuilder;
use crate::store::views::{missing, read_view, write_view};

/// Number of directions whose pixels are all rendered: for the score, for SSIM, FLIP and the
/// report's pictures.
const WHOLE: usize = 8;
/// Samples per rendered pixel of a direction. Each of its two renders has half of these samples.
const SAMPLES: u32 = 24;
/// Identifies a sequence of random numbers that no view uses.
const STREAM: u64 = 3;

/// The scene's pictures in directions that no solver used.
pub struct References {
    geometry: FieldGeometry,
    directions: Vec<ViewGrid>,
    pictures: Pictures,
    /// Hash of everything that the pictures depend on.
    pub(crate) key: String,
    /// True if all pictures were cached.
    pub(crate) cached: bool,
}

/// A direction, and its two pictures `[row][col][rgb]`, display-referred. Pixels that were not
/// rendered are NaN.
pub type ReferencePictures = (ViewGrid, [Arc<Vec<f32>>; 2]);

/// Location of the pictures.
enum Pictures {
    /// The pictures are in a folder of the cache, two per direction.
    Rendered { folder: PathBuf, tone_mapping: ToneMapping, background: Background, space: Option<Space> },
    /// The pictures are in memory, display-referred, two per direction. If a picture has no noise,
    /// the two pictures are equal.
    Held { pictures: Vec<[Arc<Vec<f32>>; 2]>, left_out: bool },
}

/// Returns the viewing zone of the job's display for this geometry. If the job has expected eyes,
/// returns their zone instead.
pub(crate) fn zone_of(job: &Job, display: &Display, geometry: &FieldGeometry) -> Zone {
    if job.factorize.eyes.is_empty() {
        return Zone::of_grid(&geometry.grid, Some(display.field.fov_deg));
    }
    Zone::Eyes(job.factorize.eye_boxes())
}

/// Returns the number of paths per pixel, over all directions of a score.
pub(crate) fn paths_per_pixel(directions: usize) -> u64 {
    let whole = directions.min(WHOLE);
    u64::from(SAMPLES) * (whole + (directions - whole).div_ceil(PixelSet::SIXTHS)) as u64
}

/// Returns the pixels of a direction that are rendered.
fn pixels(direction: usize) -> PixelSet {
    if direction < WHOLE { PixelSet::All } else { PixelSet::Sixth(direction - WHOLE) }
}

impl References {
    /// Traces the pictures of a block that are not cached. Returns `None` if the job requests no
    /// score, or if Blender renders, whose seeds cannot be chosen. The traced pictures do not
    /// depend on `tone_mapping`.
    ///
    /// # Errors
    /// If rendering fails or is cancelled, or a picture cannot be written.
    pub(crate) fn render(
        shot: Shot<'_>,
        zone: &Zone,
        (tone_mapping, engine): (ToneMapping, Engine),
        cache_dir: &Path,
        block: Block,
        task: Task<'_>,
    ) -> Result<Option<Self>, PipelineError> {
        let Shot { job, ingested, geometry, .. } = shot;
        let (window, depth_scale) = (shot.window(), shot.placement.depth_scale);
        let directions = zone.directions(job.report.zone_directions);
        if directions.is_empty() || engine == Engine::Blender {
            return Ok(None);
        }
        let geometry_of = |direction: &ViewGrid| geometry.with_grid(direction.clone());
        // The name of the folder contains a key of the traced radiance. The key of the score also
        // contains exposure and background.
        let mut key = shot.key();
        key.add_json("zone", &(SAMPLES, WHOLE, PixelSet::SIXTHS, job.render.max_bounces, job.seed))
            .add_json("hidden", &(job.light.background != Background::Environment))
            .add("directions", format!("{directions:?} {depth_scale}").as_bytes());
        key.add("pixels", format!("{:?}", (geometry.rows, geometry.cols, geometry.pitch_mm)).as_bytes());
        let traced = key.finish();
        let folder = cache_dir.join(format!("zone-{}", &traced[..16]));
        std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
        let (background, space) = (job.light.background, Space::of(&ingested.scene));
        let mut key = KeyBuilder::new("zone", code::VIEWS);
        key.add("traced", traced.as_bytes()).add("look", format!("{tone_mapping:?} {background:?}").as_bytes());
        let key = key.finish();
        let pictures = Pictures::Rendered { folder: folder.clone(), tone_mapping, background, space };
        let references = Self { geometry: geometry.clone(), directions, pictures, key, cached: false };
        // Trace only pictures that the cache lacks.
        let all: Vec<(usize, usize)> = (0..references.directions.len()).flat_map(|i| [(i, 0), (i, 1)]).collect();
        let is_kept = |&(i, half): &(usize, usize)| references.one(i, half).is_some();
        let todo = missing(block.of(all), |&(i, half)| path(&folder, i, half), is_kept, task);
        if todo.is_empty() {
            return Ok(Some(Self { cached: true, ..references }));
        }
        let renderer = ingested.renderer(task)?;
        let tracer = &renderer.tracer;
        // The splats of all directions are rendered together.
        let mut splats = Vec::new();
        let grids: Vec<ViewGrid> = references.directions.iter().map(|grid| grid.scaled(depth_scale)).collect();
        let slopes: Vec<[f64; 2]> = grids.iter().map(|grid| [grid.slope_x[0], grid.slope_y[0]]).collect();
        renderer.splat_views(window, geometry, &slopes, task, |_, view| {
            splats.push(view.light);
            Ok::<(), PipelineError>(())
        })?;
        let steps = todo.len() as u64 * Renderer::steps_per_view(&geometry_of(&references.directions[0]));
        task.progress.begin("render for the score", steps, "tiles");
        let one = |_: usize, &(i, half): &(usize, usize), task: Task<'_>| {
            let settings = Settings {
                samples: SAMPLES / 2,
                max_bounces: job.render.max_bounces,
                // Samples are not clamped, since clamped references would lack light.
                clamp: None,
                seed: seed::derive(job.seed, &[STREAM, i as u64, half as u64]),
                angular_filter: AngularFilter::Point,
                hide_environment: background != Background::Environment,
                pixels: pixels(i),
                ..Settings::default()
            };
            let traced = geometry_of(&references.directions[i].scaled(depth_scale));
            let mut picture = if ingested.scene.needs_paths() {
                tracer.render_view(window, &traced, [0, 0], &settings, task).map_err(render_error)?
            } else {
                Tensor::zeros(["row", "col", "rgb"], [geometry.rows, geometry.cols, 3])
            };
            if let (Some(splats), Some(space)) = (splats.get(i), space) {
                put_before(space, splats.data(), picture.data_mut());
            }
            // mark pixels that were not rendered
            if ingested.scene.needs_paths() {
                let places = (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| [row, col]));
                let pictures = picture.data_mut().chunks_exact_mut(3).zip(places);
                pictures.filter(|(_, at)| !settings.pixels.contains(*at)).for_each(|(rgb, _)| rgb.fill(f32::NAN));
            }
            // Keep the fraction of each pixel that shows the background, since the background is
            // added later.
            if background != Background::Environment {
                let shape = [geometry.rows, geometry.cols];
                let mut missed = if ingested.scene.instances.is_empty() {
                    vec![1.0; geometry.rows * geometry.cols]
                } else {
                    let missed = tracer.render_misses(window, &traced, [0, 0], &settings, task);
                    missed.map_err(render_error)?.data().to_vec()
                };
                if let Some(splats) = splats.get(i) {
                    let pixels = splats.data().chunks_exact(4);
                    missed.iter_mut().zip(pixels).for_each(|(missed, pixel)| *missed *= pixel[3]);
                }
                npy::write(&missed_path(&folder, i, half), &shape, &missed).map_err(field_error)?;
            }
            write_view(&path(&folder, i, half), &picture)
        };
        let result = in_groups(&todo, task, one, Ok);
        task.progress.end();
        result.map(|()| Some(references))
    }

    /// Returns references made of those views of a file that the solver does not use; `None` if
    /// there are none.
    pub(crate) fn left_out(geometry: &FieldGeometry, views: Vec<LeftOut>) -> Option<Self> {
        let known = !views.is_empty();
        let views = views.into_iter().map(|view| (view.grid, Arc::new(view.radiance)));
        known
            .then(|| Self::of_pictures(geometry, views.map(|(grid, picture)| (grid, [picture.clone(), picture])), true))
    }

    /// Returns references made of all views of a light field. No solver may have used these views.
    pub fn views_of(field: &LightField) -> Self {
        let geometry = field.geometry();
        let views = geometry.grid.iter().map(|view| {
            let picture = Arc::new(field.view(view).to_vec());
            let slope = [geometry.grid.slope_x[view[1]], geometry.grid.slope_y[view[0]]];
            (ViewGrid::single(geometry.grid.projection, slope), [picture.clone(), picture])
        });
        Self::of_pictures(geometry, views, true)
    }

    /// Returns references from pictures with the pixels of a geometry. `left_out` is true for views
    /// of the light field's file that the light field lacks.
    pub fn of_pictures(
        geometry: &FieldGeometry,
        views: impl Iterator<Item = ReferencePictures>,
        left_out: bool,
    ) -> Self {
        let (directions, pictures): (Vec<ViewGrid>, Vec<_>) = views.unzip();
        let mut key = KeyBuilder::new("zone", code::FIELDS);
        key.add("directions", format!("{directions:?}").as_bytes());
        for picture in pictures.iter().flatten() {
            key.add_f32("radiance", picture);
        }
        let pictures = Pictures::Held { pictures, left_out };
        Self { geometry: geometry.clone(), directions, pictures, key: key.finish(), cached: true }
    }

    /// Returns the pictures, and `left_out`, as [`Self::of_pictures`] takes them. Returns `None` if
    /// the pictures are not in memory.
    pub fn pictures(&self) -> Option<(impl Iterator<Item = ReferencePictures>, bool)> {
        let Pictures::Held { pictures, left_out } = &self.pictures else { return None };
        Some((self.directions.iter().cloned().zip(pictures.iter().cloned()), *left_out))
    }

    /// Reads all pictures into memory, so that the caller may remove their folder.
    ///
    /// # Errors
    /// If a picture is missing.
    pub(crate) fn held(self) -> Result<Self, PipelineError> {
        let pictures = (0..self.directions.len()).map(|i| Ok(self.read(i)?.map(Arc::new)));
        let pictures = Pictures::Held { pictures: pictures.collect::<Result<_, PipelineError>>()?, left_out: false };
        Ok(Self { pictures, ..self })
    }

    /// Returns the cache folder of the pictures, if they are not in memory.
    pub(crate) fn folder(&self) -> Option<&Path> {
        match &self.pictures {
            Pictures::Rendered { folder, .. } => Some(folder),
            Pictures::Held { .. } => None,
        }
    }

    /// Compares the seen pictures of a display with the references. Keeps some pictures for the
    /// report.
    ///
    /// # Errors
    /// If a picture is missing, or the task is cancelled.
    pub(crate) fn measure(
        &self,
        display: &Display,
        stack: &LayerStack,
        task: Task<'_>,
    ) -> Result<ZoneFigures, PipelineError> {
        let each = self.each(display, stack, task, |i, score, [a, b], seen| {
            let target = || a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
            let direction = || self.directions[i].clone();
            (i < WHOLE).then(|| ZoneView { direction: direction(), score, target: target(), seen: seen.into() })
        })?;
        let (directions, views): (Vec<DirectionScore>, Vec<_>) = each.into_iter().unzip();
        let left_out = matches!(self.pictures, Pictures::Held { left_out: true, .. });
        Ok(ZoneFigures { score: ZoneScore { directions }, left_out, views: views.into_iter().flatten().collect() })
    }

    /// Returns the score of a display's seen pictures.
    ///
    /// # Errors
    /// If a picture is missing, or the task is cancelled.
    pub fn score(&self, display: &Display, stack: &LayerStack, task: Task<'_>) -> Result<ZoneScore, PipelineError> {
        let each = self.each(display, stack, task, |_, _, _, _| ())?;
        Ok(ZoneScore { directions: each.into_iter().map(|(score, ())| score).collect() })
    }

    /// Scores every direction. `keep` receives the number of the direction, the score, the
    /// references and the seen picture.
    fn each<T: Send>(
        &self,
        display: &Display,
        stack: &LayerStack,
        task: Task<'_>,
        keep: impl Fn(usize, DirectionScore, [Vec<f32>; 2], SeenView) -> T + Sync,
    ) -> Result<Vec<(DirectionScore, T)>, PipelineError> {
        let simulator = Simulator::new(display, stack);
        task.progress.begin("score", self.directions.len() as u64, "directions");
        let measured = self.directions.par_iter().enumerate().map(|(i, direction)| {
            task.cancel.check().map_err(|_| PipelineError::Cancelled)?;
            let seen = simulator.seen(&self.geometry.with_grid(direction.clone()), [0, 0]);
            let [a, b] = self.read(i)?;
            let score = DirectionScore::new(direction, &seen, stack.brightness, [&a, &b]);
            task.progress.advance(1, "");
            Ok((score, keep(i, score, [a, b], seen)))
        });
        let measured = measured.collect();
        task.progress.end();
        measured
    }

    /// Reads the two pictures of a direction, display-referred.
    fn read(&self, i: usize) -> Result<[Vec<f32>; 2], PipelineError> {
        let one = |half| {
            let gone = || PipelineError::Replaced { path: self.place(i, half), role: "cached picture" };
            self.one(i, half).ok_or_else(gone)
        };
        Ok([one(0)?, one(1)?])
    }

    /// Reads one picture, display-referred. If the job has a background colour, the picture is over
    /// this colour. Returns `None` if a file is missing or damaged.
    fn one(&self, i: usize, half: usize) -> Option<Vec<f32>> {
        let (folder, tone_mapping, background, space) = match &self.pictures {
            Pictures::Rendered { folder, tone_mapping, background, space } => {
                (folder, *tone_mapping, *background, *space)
            }
            Pictures::Held { pictures, .. } => return pictures.get(i).map(|pair| Vec::clone(&pair[half])),
        };
        let radiance = read_view(&path(folder, i, half), &self.geometry)?;
        let mut picture = radiance.clone();
        match background {
            Background::Environment => tone_mapping.apply_to(&mut picture),
            Background::Colour(colour) => {
                let (shape, missed) = npy::read(&missed_path(folder, i, half)).ok()?;
                (shape == [self.geometry.rows, self.geometry.cols]).then_some(())?;
                expose_over(tone_mapping, colour, space, &missed, &mut picture);
            }
        }
        keep_missing(&radiance, &mut picture);
        Some(picture)
    }

    fn place(&self, i: usize, half: usize) -> PathBuf {
        path(self.folder().unwrap_or(Path::new("")), i, half)
    }
}

/// Sets values of a reference picture to NaN where they were NaN before a change. Tone curves may
/// turn NaN into numbers.
pub fn keep_missing(before: &[f32], after: &mut [f32]) {
    after.iter_mut().zip(before).filter(|(_, before)| before.is_nan()).for_each(|(after, _)| *after = f32::NAN);
}

fn path(folder: &Path, i: usize, half: usize) -> PathBuf {
    folder.join(format!("direction_{i:02}-{}.exr", ["a", "b"][half]))
}

/// Returns the path of the file with the fraction of every pixel that shows the background.
fn missed_path(folder: &Path, i: usize, half: usize) -> PathBuf {
    path(folder, i, half).with_extension("missed.npy")
}
