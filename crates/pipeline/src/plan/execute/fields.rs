//! Steps that make the light field from a scene, a file or a source plugin.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry};
use lumistack_shot::{Placement, ToneMapping};
use serde_json::json;

use super::context::Context;
use crate::bare::lacking;
use crate::error::{PipelineError, display_error};
use crate::job::Job;
use crate::plan::steps::PartKind;
use crate::plan::times::first_pose;
use crate::stage::field::{Field, check_geometry};
use crate::stage::fields::{Block, Shot};
use crate::stage::ingest::Ingested;
use crate::stage::paths::Samples;
use crate::stage::score::References;
use crate::stage::{denoise, expose, ingest, place, read, samples, score, source, trace};
use crate::store::settings::{write_display, write_job};
use crate::view_options::ViewOptions;

impl Context<'_> {
    /// Loads the scene. Every run reads the scene's files, so the result is never cached.
    pub(super) fn ingest(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let job = self.job(part);
        let pose = first_pose(&job);
        let scene = job.scene.as_ref().ok_or_else(|| PipelineError::job("scene", "a scene", "none"))?;
        let cache = self.cache(part);
        let loaded = ingest::load_scene(scene, &pose, &job.importer, self.registry, &job.light, Some(&cache), task)?;
        self.states[part].ingested = Some(Arc::new(loaded));
        Ok(false)
    }

    /// Places the window in the scene. Also measures the number of paths per pixel and view, if the
    /// job needs this measurement.
    pub(super) fn place(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let job = self.job(part);
        let ingested = self.ingested(part)?;
        let display = job.resolve_display()?;
        let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
        let cache = self.cache(part);
        let placement = place::place(&ingested, &job.window, &display, &geometry, Some(&cache), task)?;
        let samples = match self.plan.time(part) {
            // All time steps are rendered with the number of samples that the sequence has
            // measured.
            Some((_, sequence)) => self.states[sequence].samples,
            None => samples::measured(&job, &ingested, &placement, &display, &cache, task)?,
        };
        if self.lacking.is_empty() {
            let path = job.scene.clone().unwrap_or_default();
            let is_side_chosen = placement.looked_from_deg.is_some() && job.window.look_from.is_none();
            let no_lights = ingested.studio && ingested.scene.lights.is_empty();
            self.lacking = lacking(&path, ingested.scene.cameras.is_empty() && is_side_chosen, no_lights);
        }
        let state = &mut self.states[part];
        (state.placement, state.samples) = (Some(placement), samples);
        Ok(false)
    }

    /// Renders the views. Returns true if they were cached.
    pub(super) fn trace(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let of = self.shot(part)?;
        let views = self.dir(part).join("cache/views");
        let (traced, cached) = trace::run(of.shot(), &ViewOptions::default(), &views, task)?;
        self.states[part].traced = Some(Arc::new(traced));
        Ok(cached)
    }

    /// Renders a block of the views, while other processes may render other blocks.
    pub(super) fn trace_block(&mut self, part: usize, block: Block, task: Task<'_>) -> Result<bool, PipelineError> {
        let of = self.shot(part)?;
        let views = self.dir(part).join("cache/views");
        trace::run_block(of.shot(), &views, block, task)
    }

    /// Renders a block of the pictures for the zone score. The pictures are cached before exposure,
    /// so this step needs no exposure.
    pub(super) fn score_block(&mut self, part: usize, block: Block, task: Task<'_>) -> Result<bool, PipelineError> {
        let of = self.shot(part)?;
        let zone = score::zone_of(&of.job, &of.display, &of.geometry);
        let views = self.dir(part).join("cache/views");
        let engine = trace::engine(of.shot(), &ViewOptions::default(), task);
        let made = References::render(of.shot(), &zone, (ToneMapping::NONE, engine), &views, block, task)?;
        Ok(made.is_none_or(|references| references.cached))
    }

    /// Denoises the views. Returns true if they were cached.
    pub(super) fn denoise(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (of, traced) = (self.shot(part)?, self.of(part, "views", |state| state.traced.clone())?);
        denoise::run(of.shot(), &traced.fields, task)
    }

    /// Exposes the views; the result is the light field.
    pub(super) fn expose(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (of, traced) = (self.shot(part)?, self.of(part, "views", |state| state.traced.clone())?);
        let exposed = expose::run(of.shot(), &traced, false, task)?;
        let path = of.job.scene.clone().unwrap_or_default();
        let stamps = self.stamps(part);
        let field = Field::of_scene(&path, of.shot(), &traced, exposed, &of.display, &stamps, task)?;
        self.take_field(part, field)?;
        Ok(true)
    }

    /// Renders the scene's pictures for the zone score. Returns true if they were cached.
    pub(super) fn score(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let (of, traced) = (self.shot(part)?, self.of(part, "views", |state| state.traced.clone())?);
        let tone_mapping = self.of(part, "an exposure", |state| state.tone_mapping)?;
        let zone = score::zone_of(&of.job, &of.display, &of.geometry);
        let views = self.dir(part).join("cache/views");
        let made = References::render(of.shot(), &zone, (tone_mapping, traced.engine), &views, Block::ALL, task)?;
        let cached = made.as_ref().is_none_or(|references| references.cached);
        let state = &mut self.states[part];
        state.views.extend(made.as_ref().and_then(|references| references.folder()).map(Path::to_owned));
        state.references = made.map(Arc::new);
        Ok(cached)
    }

    /// Reads a light field from a file, and opens outputs for its geometry.
    pub(super) fn read(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let job = self.job(part);
        let path = job.light_field.clone().unwrap_or_default();
        let display = job.resolve_display()?;
        let (target, left_out) = read::run(&path, &job, &display, Some(&self.dir(part)), task)?;
        self.check_geometry(part, &path, target.geometry())?;
        self.states[part].references = References::left_out(target.geometry(), left_out).map(Arc::new);
        let about = json!({ "light field": path.display().to_string() });
        let field = Field::of_given(target, &path, about, &display, &self.stamps(part), task)?;
        self.open_outputs(&job, &field.display, field.target.geometry())?;
        self.take_field(part, field)?;
        Ok(false)
    }

    /// Requests a light field from a source plugin. Returns true if it was cached.
    pub(super) fn source(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let job = self.job(part);
        let source = job.source.clone();
        let source = source.ok_or_else(|| PipelineError::job("scene", Job::INPUTS, "none"))?;
        let (display, stamps, path) = (job.resolve_display()?, self.stamps(part), PathBuf::from(&source.plugin));
        let (target, kept, cached) = source::run(&source, &display, &stamps, self.registry, task)?;
        self.check_geometry(part, &path, target.geometry())?;
        let about = json!({ "source": source.plugin, "time (s)": source.time_s });
        let field = Field::of_given(target, &path, about, &display, &stamps, task)?;
        kept.write(&stamps)?;
        self.open_outputs(&job, &field.display, field.target.geometry())?;
        self.take_field(part, field)?;
        Ok(cached)
    }

    fn shot(&mut self, part: usize) -> Result<OwnedShot, PipelineError> {
        let (job, ingested) = (self.job(part), self.ingested(part)?);
        let placement = self.of(part, "a window", |state| state.placement)?;
        let display = job.resolve_display()?;
        let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
        let samples = self.states[part].samples;
        Ok(OwnedShot { job, ingested, placement, display, geometry, samples })
    }

    fn check_geometry(&self, part: usize, path: &Path, found: &FieldGeometry) -> Result<(), PipelineError> {
        let Some((time, _)) = self.plan.time(part).filter(|(time, _)| *time > 0) else { return Ok(()) };
        // Every time step must have the geometry of the first one. All earlier time steps passed
        // this check, so the message may name the previous time step.
        let first = self.plan.at_time(part, 0).and_then(|first| self.states[first].geometry.as_ref());
        first.map_or(Ok(()), |expected| check_geometry(path, found, expected, &self.source_of(part, time - 1)))
    }

    /// Keeps a light field in memory. If the job has nodes and is not a sweep, also writes the
    /// job's settings.
    fn take_field(&mut self, part: usize, field: Field) -> Result<(), PipelineError> {
        let job = self.job(part);
        if !job.nodes.is_empty() && !matches!(self.plan.parts[0].kind, PartKind::Sweep) {
            let dir = self.dir(part);
            write_job(&job, &dir)?;
            write_display(&dir.join("display.toml"), &field.display)?;
        }
        if self.plan.parts[part].parent.is_none() {
            self.depth.clone_from(&field.depth);
        }
        let state = &mut self.states[part];
        (state.tone_mapping, state.geometry) = (field.tone_mapping, Some(field.target.geometry().clone()));
        state.views.clone_from(&field.views);
        state.field = Some(Arc::new(field));
        Ok(())
    }
}

/// The owner of the data that a [`Shot`] borrows.
struct OwnedShot {
    job: Arc<Job>,
    ingested: Arc<Ingested>,
    placement: Placement,
    display: Display,
    geometry: FieldGeometry,
    samples: Option<Samples>,
}

impl OwnedShot {
    fn shot(&self) -> Shot<'_> {
        let Self { job, ingested, placement, display, geometry, samples } = self;
        Shot { job, ingested, placement, geometry, display, samples: *samples }
    }
}
