//! How right a display is all over its zone: the scene's pictures in directions that no solver saw, beside the seen pictures from there.
//!
//! Every direction is rendered twice with independent seeds, so that the score is free of their noise
//! ([`DirectionScore`]). A few samples are enough for that, since all pixels of all directions share the mean. SSIM and FLIP see noise, so the first
//! directions, which are spread over the zone like all, get more samples.

use std::path::{Path, PathBuf};

use lumistack_core::metrics::{Flip, Mean, ssim};
use lumistack_core::{Task, seed};
use lumistack_display::{
    DirectionScore, Display, EyeBox, FieldGeometry, LEAST_SHARE, LayerStack, SeenView, Simulator, ViewGrid, Zone,
    ZoneScore,
};
use lumistack_field_io::npy;
use lumistack_pathtracer::{AngularFilter, Renderer, Settings};
use lumistack_report::{ZoneFigures, ZoneView};
use lumistack_scene::Window;
use rayon::prelude::*;

use crate::denoise::write_view;
use crate::error::{PipelineError, field_error};
use crate::ingest::Ingested;
use crate::job::{Background, Engine, Job};
use crate::look::Look;
use crate::render::{read_view, render_error, shot_key};
use crate::surround::expose_over;

/// Directions whose pictures have enough samples to be looked at: for SSIM, FLIP and the report's pictures.
const CLEAN: usize = 8;
/// Samples per pixel of such a direction, and of any other.
const SAMPLES: [u32; 2] = [24, 4];
/// Their random numbers are those of no view.
const STREAM: u64 = 3;

/// The scene's pictures of a run, in the cache.
pub(crate) struct References {
    geometry: FieldGeometry,
    directions: Vec<ViewGrid>,
    pub(crate) folder: PathBuf,
    look: Look,
    background: Background,
    /// Whether none had to be traced.
    pub(crate) cached: bool,
}

/// The zone of a job's display, whose light field is `geometry`: around the expected eyes, where there are any.
pub(crate) fn zone_of(job: &Job, display: &Display, geometry: &FieldGeometry) -> Zone {
    if job.factorize.eyes.is_empty() {
        return Zone::of_grid(&geometry.grid, Some(display.field.fov_deg));
    }
    Zone::Eyes(
        job.factorize
            .eyes
            .iter()
            .map(|eye| EyeBox { eye_mm: eye.eye_mm, sigma_mm: eye.sigma_mm, weight: eye.weight })
            .collect(),
    )
}

impl References {
    /// Traces the pictures that the cache does not hold. `None` where the job wants no score, or
    /// where Blender renders: its seeds are not ours to choose.
    ///
    /// # Errors
    /// When rendering fails or is cancelled, or a picture cannot be stored.
    pub(crate) fn render(
        job: &Job,
        zone: &Zone,
        geometry: &FieldGeometry,
        depth_scale: f64,
        shot: Shot<'_>,
        cache_dir: &Path,
        task: Task<'_>,
    ) -> Result<Option<Self>, PipelineError> {
        let directions = zone.directions(job.report.zone_directions);
        if directions.is_empty() || shot.engine == Engine::Blender {
            return Ok(None);
        }
        let pixels = |direction: &ViewGrid| geometry.with_grid(direction.clone());
        let mut key = shot_key(job, shot.ingested, shot.window);
        key.add_json("zone", &(SAMPLES, job.render.max_bounces, job.seed))
            .add_json("hidden", &(job.light.background != Background::Environment))
            .add("directions", format!("{directions:?} {depth_scale}").as_bytes());
        key.add("pixels", format!("{:?}", (geometry.rows, geometry.cols, geometry.pitch_mm)).as_bytes());
        let folder = cache_dir.join(format!("zone-{}", &key.finish()[..16]));
        std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
        let background = job.light.background;
        let references =
            Self { geometry: geometry.clone(), directions, folder, look: shot.look, background, cached: false };
        let all = (0..references.directions.len()).flat_map(|i| [(i, 0), (i, 1)]);
        let todo: Vec<(usize, usize)> =
            all.filter(|&(i, half)| read_view(&references.path(i, half), geometry).is_none()).collect();
        if todo.is_empty() {
            return Ok(Some(Self { cached: true, ..references }));
        }
        let renderer = shot.ingested.renderer(task)?;
        let steps = todo.len() as u64 * Renderer::steps_per_view(&pixels(&references.directions[0]));
        task.progress.begin("render for the score", steps, "tiles");
        let result = todo.iter().try_for_each(|&(i, half)| -> Result<(), PipelineError> {
            let settings = Settings {
                samples: SAMPLES[usize::from(i >= CLEAN)] / 2,
                max_bounces: job.render.max_bounces,
                // the scene's picture loses no light
                clamp: None,
                seed: seed::derive(job.seed, &[STREAM, i as u64, half as u64]),
                angular_filter: AngularFilter::Point,
                hide_environment: background != Background::Environment,
                ..Settings::default()
            };
            let traced = pixels(&references.directions[i].scaled(depth_scale));
            let picture = renderer.render_view(shot.window, &traced, [0, 0], &settings, task).map_err(render_error)?;
            if background != Background::Environment {
                let missed =
                    renderer.render_misses(shot.window, &traced, [0, 0], &settings, task).map_err(render_error)?;
                let shape = [geometry.rows, geometry.cols];
                npy::write(&references.missed(i, half), &shape, missed.data()).map_err(field_error)?;
            }
            write_view(&references.path(i, half), &picture)
        });
        task.progress.end();
        result.map(|()| Some(references))
    }

    /// Compares the seen pictures of a display with the references; the report shows the worst and the median of the clean directions.
    ///
    /// # Errors
    /// When a picture is gone, or the work is cancelled.
    pub(crate) fn measure(
        &self,
        display: &Display,
        stack: &LayerStack,
        pixels_per_degree: f64,
        task: Task<'_>,
    ) -> Result<ZoneFigures, PipelineError> {
        let simulator = Simulator::new(display, stack);
        let flip = Flip::new(pixels_per_degree);
        task.progress.begin("score", self.directions.len() as u64, "directions");
        let measured: Result<Vec<(DirectionScore, Option<Clean>)>, PipelineError> = (0..self.directions.len())
            .into_par_iter()
            .map(|i| {
                task.cancel.check().map_err(|_| PipelineError::Cancelled)?;
                let direction = &self.directions[i];
                let seen = simulator.seen(&self.geometry.with_grid(direction.clone()), [0, 0]);
                let references = self.read(i)?;
                let score = DirectionScore::new(direction, &seen, stack.brightness, [&references[0], &references[1]]);
                task.progress.advance(1, "");
                let look =
                    || Clean::new(direction.clone(), score, seen, references, stack.brightness, &self.geometry, &flip);
                Ok((score, (i < CLEAN).then(look)))
            })
            .collect();
        task.progress.end();
        let (directions, clean): (Vec<DirectionScore>, Vec<_>) = measured?.into_iter().unzip();
        let mut clean: Vec<Clean> = clean.into_iter().flatten().collect();
        let mean = |of: fn(&Clean) -> Mean| clean.iter().fold(Mean::default(), |sum, look| sum.merged(of(look)));
        let (ssim, flip) = (mean(|look| look.ssim).value(), mean(|look| look.flip).value());
        clean.sort_by(|a, b| b.view.score.mse.total_cmp(&a.view.score.mse));
        let places = [0, clean.len() / 2];
        let picked = clean.into_iter().enumerate().filter(|(place, _)| places.contains(place));
        let shown = picked.map(|(_, look)| look.view).collect();
        Ok(ZoneFigures { score: ZoneScore { directions }, ssim, flip, shown })
    }

    /// The two pictures of a direction, display-referred.
    fn read(&self, i: usize) -> Result<[Vec<f32>; 2], PipelineError> {
        let one = |half| -> Result<Vec<f32>, PipelineError> {
            let path = self.path(i, half);
            let mut picture = read_view(&path, &self.geometry).ok_or_else(|| {
                PipelineError::value(&path, "cached picture", "the picture just written", "another or none")
            })?;
            match self.background {
                Background::Environment => self.look.apply_to(&mut picture),
                Background::Colour(colour) => {
                    let (_, missed) = npy::read(&self.missed(i, half)).map_err(field_error)?;
                    expose_over(self.look, colour, &missed, &mut picture);
                }
            }
            Ok(picture)
        };
        Ok([one(0)?, one(1)?])
    }

    /// Share of every pixel where no surface is.
    fn missed(&self, i: usize, half: usize) -> PathBuf {
        self.path(i, half).with_extension("missed.npy")
    }

    fn path(&self, i: usize, half: usize) -> PathBuf {
        self.folder.join(format!("direction_{i:02}-{}.exr", ["a", "b"][half]))
    }
}

/// Of a direction whose references can be looked at.
struct Clean {
    ssim: Mean,
    flip: Mean,
    view: ZoneView,
}

impl Clean {
    fn new(
        direction: ViewGrid,
        score: DirectionScore,
        seen: SeenView,
        [a, b]: [Vec<f32>; 2],
        brightness: f64,
        geometry: &FieldGeometry,
        metric: &Flip,
    ) -> Self {
        let target: Vec<f32> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
        let scale = (1.0 / brightness) as f32;
        // pixels that do not count are taken from the target, so that they are no error and no edge
        let pixels = seen.radiance.data().chunks_exact(3).zip(target.chunks_exact(3)).zip(&seen.share);
        let shown: Vec<f32> = pixels
            .flat_map(|((seen, target), share)| {
                [0, 1, 2].map(|c| if *share >= LEAST_SHARE { seen[c] * scale } else { target[c] })
            })
            .collect();
        let shape = [geometry.rows, geometry.cols];
        let counts = |i: usize| seen.share[i] >= LEAST_SHARE;
        Self {
            ssim: ssim(&target, &shown, shape).mean_where(counts),
            flip: metric.compare(&target, &shown, shape).mean_where(counts),
            view: ZoneView { direction, score, target, seen },
        }
    }
}

/// What is rendered.
pub(crate) struct Shot<'a> {
    pub(crate) ingested: &'a Ingested,
    pub(crate) window: &'a Window,
    pub(crate) look: Look,
    pub(crate) engine: Engine,
}
