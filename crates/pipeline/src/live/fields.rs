//! Light fields of a changing job: a stage runs again only if its input has changed.
//!
//! ```text
//! ingest ─▶ place ─▶ views, in passes ─▶ expose ──────▶ Target
//! read ───────────────────────────────────────────────▶ Target
//! ```
//!
//! While the scene moves, window, exposure and tone curve stay unchanged. The window is placed anew
//! if one of its settings, the display or a camera of the scene changes. Exposure and tone curve
//! are chosen anew if one of their settings or a file changes.
//!
//! Displays get at most 49 automatic views, since all views must be traced before the first
//! picture.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, LightField};
use lumistack_live::Target;
use lumistack_plugin_host::Registry;
use lumistack_shot::{Placement, ToneMapping, expose_over};
use lumistack_splats::Space;
use serde_json::{Value, json};

use super::progressive::Progressive;
use crate::error::{PipelineError, display_error};
use crate::job::{Background, Job, ReportJob, SequenceJob};
use crate::plan::times::Times;
use crate::stage::fields::Shot;
use crate::stage::ingest::{self, Ingested};
use crate::stage::place;
use crate::stage::{EXPOSE, INGEST, PLACE, TRACE, field, read};

/// Maximum number of automatic views of a display.
const MOST_VIEWS: usize = 49;

/// Makes the light fields of a job.
pub struct LiveFields {
    job: Job,
    display: Arc<Display>,
    cache: PathBuf,
    /// The loaded scene, with a key of its inputs. The next three fields also have such a key.
    scene: Option<(Value, Arc<Ingested>)>,
    placement: Option<(Value, Placement)>,
    views: Option<(Value, Progressive)>,
    tone_mapping: Option<(Value, ToneMapping)>,
    /// Key of the last returned light field. If the job names a light field, the key of the last
    /// attempt to read the light field, even if the attempt failed.
    shown: Option<Value>,
    /// Number of reloads. It is part of all keys except the key of the placement. So a reload makes
    /// results anew, but the window stays.
    edition: u64,
    content: u64,
}

impl LiveFields {
    /// Prepares a job; `cache` is a folder for scenes that Blender converts.
    ///
    /// # Errors
    /// If the job is wrong, or has nodes, a sweep, a sequence or a source.
    pub fn new(job: Job, cache: &Path) -> Result<Self, PipelineError> {
        let display = Arc::new(display_of(&job)?);
        let (scene, placement, views, tone_mapping, shown) = (None, None, None, None, None);
        let cache = cache.to_owned();
        Ok(Self { job, display, cache, scene, placement, views, tone_mapping, shown, edition: 0, content: 0 })
    }

    /// Changes the job from the next pass on. After an error the old job remains.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new).
    pub fn change(&mut self, job: Job) -> Result<(), PipelineError> {
        self.display = Arc::new(display_of(&job)?);
        self.job = job;
        Ok(())
    }

    /// Reads the files again at the next pass.
    pub fn reload(&mut self) {
        self.edition += 1;
    }

    /// Returns the current job.
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// Returns the files that the light field, the display and the weights depend on.
    pub fn files(&self) -> Vec<PathBuf> {
        let named = [&self.job.scene, &self.job.light_field, &self.job.display.file, &self.job.light.environment];
        let mut files: Vec<PathBuf> = named.into_iter().flatten().cloned().collect();
        files.extend(self.scene.iter().flat_map(|(_, scene)| scene.files.iter().map(|(path, _)| path.clone())));
        files.extend(self.job.factorize.weights.clone());
        files.sort();
        files.dedup();
        files
    }

    /// Makes the next light field, either of changed content or of the same content with less
    /// noise. Returns `None` if all samples are traced and nothing has changed.
    ///
    /// # Errors
    /// If the scene or the light field cannot be read or rendered, or when cancelled. Earlier
    /// results are kept.
    pub fn pass(&mut self, registry: &Registry, task: Task<'_>) -> Result<Option<Target>, PipelineError> {
        match self.job.light_field.clone() {
            Some(path) => self.read(&path, task),
            None => self.render(registry, task),
        }
    }

    fn read(&mut self, path: &Path, task: Task<'_>) -> Result<Option<Target>, PipelineError> {
        let key = json!([
            path.to_string_lossy(),
            self.edition,
            self.display.to_toml(),
            (crate::stage::READ.reads)(&self.job),
            self.job.factorize
        ]);
        if self.shown.as_ref() == Some(&key) {
            return Ok(None);
        }
        // Keep the key before reading, so that a broken file is reported only once.
        self.shown = Some(key);
        // Omit the views that only the zone score of a report needs.
        let report = ReportJob { zone_directions: 0, ..self.job.report.clone() };
        let (field, _) = read::run(path, &Job { report, ..self.job.clone() }, &self.display, None, task)?;
        let adapted = self.display.adapted_to(field.geometry());
        let adapted = adapted.map_err(|source| display_error(source, &path.display().to_string()))?;
        adapted.check().map_err(|source| display_error(source, "light field"))?;
        self.content += 1;
        self.target(Arc::new(adapted), field, 1).map(Some)
    }

    fn render(&mut self, registry: &Registry, task: Task<'_>) -> Result<Option<Target>, PipelineError> {
        // Ingest the scene. After an error the earlier scene remains.
        let (job, display) = (&self.job, self.display.clone());
        let geometry = display.geometry().map_err(|source| display_error(source, "display"))?;
        let path = job.scene.clone().unwrap_or_default();
        let name = path.to_string_lossy();
        let key_of_scene = json!([name, self.edition, (INGEST.reads)(job)]);
        let before = self.scene.take_if(|(key, _)| *key != key_of_scene);
        if self.scene.is_none() {
            // An animation may switch lights off. A scene that began without automatic studio light
            // does not get studio light while it moves.
            let is_motion = |key: &Value| key[0] == key_of_scene[0] && key[1] == key_of_scene[1];
            let stays_dark = before.as_ref().is_some_and(|(key, scene)| is_motion(key) && !scene.studio);
            match self.load(&path, stays_dark, registry, task) {
                Ok(scene) => self.scene = Some((key_of_scene.clone(), Arc::new(scene))),
                Err(error) => {
                    self.scene = before;
                    return Err(error);
                }
            }
        }
        let Some((_, ingested)) = self.scene.clone() else { return Ok(None) };
        // Place the window. The key of the placement contains the scene's cameras but not its
        // surfaces, so the window stays while the scene moves.
        let cameras = format!("{:?}", ingested.scene.cameras);
        let key_of_place = json!([name, cameras, (PLACE.reads)(&self.job), format!("{geometry:?}")]);
        if self.placement.as_ref().is_none_or(|(key, _)| *key != key_of_place) {
            let placed = place::place(&ingested, &self.job.window, &display, &geometry, None, task)?;
            self.placement = Some((key_of_place, placed));
        }
        let Some((_, placement)) = self.placement else { return Ok(None) };
        // Trace one more pass, unless only the exposure or the patterns' settings changed. If any
        // input of the views has changed, new views begin with their first pass.
        let job = self.job.clone();
        let (geometry, samples) = (&geometry, None);
        let shot = Shot { job: &job, ingested: &ingested, placement: &placement, geometry, display: &display, samples };
        let key_of_views = json!([key_of_scene, format!("{placement:?} {geometry:?}"), (TRACE.reads)(&job)]);
        let (of_light, of_patterns) = ((EXPOSE.reads)(&job), json!([display.to_toml(), job.factorize]));
        let key = json!([key_of_views, of_light, of_patterns]);
        let is_new = self.shown.as_ref() != Some(&key);
        if self.views.as_ref().is_none_or(|(key, _)| *key != key_of_views) {
            self.views = Some((key_of_views, Progressive::new(shot, task)?));
        }
        let Some((_, views)) = &mut self.views else { return Ok(None) };
        // If a setting changed, but the traced paths are still valid, expose the paths that are
        // traced so far. The next call traces more.
        let traced = if is_new && views.passes > 0 { false } else { views.pass(shot, task)? };
        if !(traced || is_new) {
            return Ok(None);
        }
        // Expose the views. Exposure and tone curve stay until files or settings of the light
        // change, so they stay while the scene moves.
        let radiance = views.radiance(shot, task)?;
        let key_of_tone_mapping = json!([name, self.edition, of_light]);
        let tone_mapping = match &self.tone_mapping {
            Some((key, tone_mapping)) if *key == key_of_tone_mapping => *tone_mapping,
            _ => {
                let tone_mapping = ToneMapping::choose(&job.light, &ingested.scene, &radiance.brightest);
                self.tone_mapping = Some((key_of_tone_mapping, tone_mapping));
                tone_mapping
            }
        };
        let mut field = radiance.field;
        expose(tone_mapping, &job, shot, views, &mut field);
        let passes = views.passes;
        if is_new {
            self.content += 1;
            self.shown = Some(key);
        }
        self.target(display, field, passes).map(Some)
    }

    fn load(
        &self,
        path: &Path,
        stays_dark: bool,
        registry: &Registry,
        task: Task<'_>,
    ) -> Result<Ingested, PipelineError> {
        let mut light = self.job.light.clone();
        light.automatic &= !stays_dark;
        ingest::load_scene(path, &self.job.pose, &self.job.importer, registry, &light, Some(&self.cache), task)
    }

    fn target(&self, display: Arc<Display>, field: LightField, passes: u32) -> Result<Target, PipelineError> {
        let weights = field::weights(&self.job.factorize, field.geometry())?;
        Ok(Target { display, field, weights, content: self.content, passes })
    }

    /// Returns the paths of a sequence's light fields, in the order of their time steps.
    ///
    /// # Errors
    /// If the folder cannot be read, or has no light fields or too many.
    pub fn times_of(job: &Job) -> Result<Vec<PathBuf>, PipelineError> {
        Times::find(job, &SequenceJob::default()).map(Times::into_fields)
    }
}

fn expose(tone_mapping: ToneMapping, job: &Job, shot: Shot<'_>, views: &Progressive, field: &mut LightField) {
    let places: Vec<[usize; 2]> = field.geometry().grid.iter().collect();
    for (number, place) in places.into_iter().enumerate() {
        let rgb = field.view_mut(place);
        if let Background::Colour(background) = job.light.background {
            expose_over(tone_mapping, background, Space::of(&shot.ingested.scene), views.missed(number), rgb);
        } else {
            tone_mapping.apply_to(rgb);
        }
        lumistack_field_io::round_to_half(rgb);
    }
}

/// Returns the display of a job, with at most [`MOST_VIEWS`] automatic views.
fn display_of(job: &Job) -> Result<Display, PipelineError> {
    job.check()?;
    let refused = [
        ("nodes", "a job without nodes, since a live display is a single display", !job.nodes.is_empty()),
        ("sweep", "a job without a sweep, since a live display is a single display", job.sweep.is_some()),
        ("sequence", "a job without a sequence, since commands set the time of a live display", job.sequence.is_some()),
        ("source", "a job with a scene or a light field instead of a source", job.source.is_some()),
    ];
    if let Some((key, expected, _)) = refused.into_iter().find(|(.., is_there)| *is_there) {
        return Err(PipelineError::job(key, expected, format!("`{key}`")));
    }
    let display = job.display.resolve()?;
    let [cols, rows] = display.field.resolution;
    let most = job.most_views(&display).min(MOST_VIEWS).min(job.render.affordable_views(cols * rows));
    let display = display.with_views_chosen(most);
    let _: FieldGeometry = display.geometry().map_err(|source| display_error(source, "display"))?;
    Ok(display)
}
