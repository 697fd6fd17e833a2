//! How right a display is all over its zone: the scene's pictures in directions that no solver saw, beside the seen pictures from there.
//!
//! Every direction is rendered twice with independent seeds, so that the score is free of their noise
//! ([`DirectionScore`]). A few samples are enough for that, since all pixels of all directions share the mean. SSIM and FLIP see noise, so the first
//! directions, which are spread over the zone like all, get more samples.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, seed};
use lumistack_display::{DirectionScore, Display, FieldGeometry, LayerStack, Simulator, ViewGrid, Zone, ZoneScore};
use lumistack_field_io::npy;
use lumistack_pathtracer::{AngularFilter, Renderer, Settings};
use lumistack_report::{ZoneFigures, ZoneView};
use rayon::prelude::*;

use crate::error::{PipelineError, field_error, render_error};
use crate::job::{Background, Engine, Job};
use crate::stage::expose::expose_over;
use crate::stage::fields::Shot;
use crate::stage::look::Look;
use crate::store::views::{missing, read_view, write_view};

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
    Zone::Eyes(job.factorize.eye_boxes())
}

impl References {
    /// Traces the pictures that the cache does not hold. `None` where the job wants no score, or
    /// where Blender renders: its seeds are not ours to choose.
    ///
    /// # Errors
    /// When rendering fails or is cancelled, or a picture cannot be stored.
    pub(crate) fn render(
        shot: Shot<'_>,
        zone: &Zone,
        (look, engine): (Look, Engine),
        cache_dir: &Path,
        task: Task<'_>,
    ) -> Result<Option<Self>, PipelineError> {
        let Shot { job, ingested, geometry, .. } = shot;
        let (window, depth_scale) = (shot.window(), shot.placement.depth_scale);
        let directions = zone.directions(job.report.zone_directions);
        if directions.is_empty() || engine == Engine::Blender {
            return Ok(None);
        }
        let pixels = |direction: &ViewGrid| geometry.with_grid(direction.clone());
        let mut key = shot.key();
        key.add_json("zone", &(SAMPLES, job.render.max_bounces, job.seed))
            .add_json("hidden", &(job.light.background != Background::Environment))
            .add("directions", format!("{directions:?} {depth_scale}").as_bytes());
        key.add("pixels", format!("{:?}", (geometry.rows, geometry.cols, geometry.pitch_mm)).as_bytes());
        let folder = cache_dir.join(format!("zone-{}", &key.finish()[..16]));
        std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
        let background = job.light.background;
        let references = Self { geometry: geometry.clone(), directions, folder, look, background, cached: false };
        let all = (0..references.directions.len()).flat_map(|i| [(i, 0), (i, 1)]).collect();
        let is_kept = |&(i, half): &(usize, usize)| references.one(i, half).is_some();
        let todo = missing(all, |&(i, half)| references.path(i, half), is_kept, task);
        if todo.is_empty() {
            return Ok(Some(Self { cached: true, ..references }));
        }
        let renderer = ingested.renderer(task)?;
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
            let picture = renderer.render_view(window, &traced, [0, 0], &settings, task).map_err(render_error)?;
            if background != Background::Environment {
                let missed = renderer.render_misses(window, &traced, [0, 0], &settings, task).map_err(render_error)?;
                let shape = [geometry.rows, geometry.cols];
                npy::write(&references.missed(i, half), &shape, missed.data()).map_err(field_error)?;
            }
            write_view(&references.path(i, half), &picture)
        });
        task.progress.end();
        result.map(|()| Some(references))
    }

    /// Compares the seen pictures of a display with the references.
    ///
    /// # Errors
    /// When a picture is gone, or the work is cancelled.
    pub(crate) fn measure(
        &self,
        display: &Display,
        stack: &LayerStack,
        task: Task<'_>,
    ) -> Result<ZoneFigures, PipelineError> {
        let simulator = Simulator::new(display, stack);
        task.progress.begin("score", self.directions.len() as u64, "directions");
        let measured: Result<Vec<(DirectionScore, Option<ZoneView>)>, PipelineError> = self
            .directions
            .par_iter()
            .enumerate()
            .map(|(i, direction)| {
                task.cancel.check().map_err(|_| PipelineError::Cancelled)?;
                let seen = simulator.seen(&self.geometry.with_grid(direction.clone()), [0, 0]);
                let [a, b] = self.read(i)?;
                let score = DirectionScore::new(direction, &seen, stack.brightness, [&a, &b]);
                task.progress.advance(1, "");
                let view = || ZoneView {
                    direction: direction.clone(),
                    score,
                    target: a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect(),
                    seen: seen.into(),
                };
                Ok((score, (i < CLEAN).then(view)))
            })
            .collect();
        task.progress.end();
        let (directions, views): (Vec<DirectionScore>, Vec<_>) = measured?.into_iter().unzip();
        Ok(ZoneFigures { score: ZoneScore { directions }, views: views.into_iter().flatten().collect() })
    }

    /// The two pictures of a direction, display-referred.
    fn read(&self, i: usize) -> Result<[Vec<f32>; 2], PipelineError> {
        let one = |half| {
            self.one(i, half)
                .ok_or_else(|| PipelineError::Replaced { path: self.path(i, half), what: "cached picture" })
        };
        Ok([one(0)?, one(1)?])
    }

    /// One of them; `None` where it, or what is known of its background, is not there as it was written.
    fn one(&self, i: usize, half: usize) -> Option<Vec<f32>> {
        let mut picture = read_view(&self.path(i, half), &self.geometry)?;
        match self.background {
            Background::Environment => self.look.apply_to(&mut picture),
            Background::Colour(colour) => {
                let (shape, missed) = npy::read(&self.missed(i, half)).ok()?;
                (shape == [self.geometry.rows, self.geometry.cols]).then_some(())?;
                expose_over(self.look, colour, &missed, &mut picture);
            }
        }
        Some(picture)
    }

    /// Share of every pixel where no surface is.
    fn missed(&self, i: usize, half: usize) -> PathBuf {
        self.path(i, half).with_extension("missed.npy")
    }

    fn path(&self, i: usize, half: usize) -> PathBuf {
        self.folder.join(format!("direction_{i:02}-{}.exr", ["a", "b"][half]))
    }
}
