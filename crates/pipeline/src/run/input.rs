//! The light field of a run: rendered, or read from what somebody else rendered.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, LightField};
use lumistack_field_io::picture::Precision;
use lumistack_plugin_host::{Registry, Time};
use lumistack_report::DepthBudget;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Moment, Run};
use crate::error::{PipelineError, display_error, field_error, host_error};
use crate::job::{Job, SourceJob};
use crate::sequence;
use crate::stage::denoise;
use crate::stage::denoise::Denoised;
use crate::stage::expose;
use crate::stage::expose::Exposed;
use crate::stage::fields::Shot;
use crate::stage::given;
use crate::stage::ingest;
use crate::stage::layers;
use crate::stage::look::Look;
use crate::stage::place;
use crate::stage::place::Placement;
use crate::stage::score;
use crate::stage::score::References;
use crate::stage::trace;
use crate::stage::trace::Traced;
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::folder;
use crate::store::key::KeyBuilder;
use crate::store::names::Work;
use crate::store::plugin_files;
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;
use crate::store::used;
use crate::view_options::ViewOptions;

/// What the input stage gives.
pub(crate) struct Input {
    pub(crate) target: LightField,
    pub(crate) held_out: Option<LightField>,
    pub(super) outside: Option<LightField>,
    /// The scene's pictures all over the zone, where it was rendered.
    pub(super) zone: Option<References>,
    /// How it became display-referred, where it was rendered.
    pub(crate) look: Option<Look>,
    /// What the scene's depth asks of the display, where it was rendered.
    pub(crate) depth: Option<DepthBudget>,
    /// What a denoiser did to the target.
    pub(super) denoised: Option<Denoised>,
    pub(super) about: Option<serde_json::Value>,
    /// Folders of cached views that it was made from.
    pub(crate) views: Vec<PathBuf>,
}

/// Renders the views of a job's scene into `target_dir`, without factorizing, as `options` say; returns what their depth asks of the display.
///
/// # Errors
/// When ingest or rendering fails or is cancelled.
pub fn render_only(
    job: &Job,
    target_dir: &Path,
    options: &ViewOptions,
    registry: &Registry,
    task: Task<'_>,
) -> Result<DepthBudget, PipelineError> {
    let Some(scene) = &job.scene else {
        return Err(PipelineError::value("job", "scene", "a scene to render", "none"));
    };
    let job = &plugin_files::resolved(job, registry)?;
    job.check()?;
    let _owned = folder::take(target_dir, Work::Views, job, registry, task)?;
    let display = job.resolve_display()?;
    let geometry = display.geometry().map_err(|source| display_error(source, "field"))?;
    // found out before the first ray, not after
    options.check(job)?;
    options.chosen(geometry.grid.views())?;
    let cache = target_dir.join("cache");
    let ingested = ingest::load_scene(scene, &job.pose, &job.importer, registry, &job.light, Some(&cache), task)?;
    let placement = place::place(&ingested, &job.window, &display, &geometry, Some(&cache), task)?;
    let mut job = job.clone();
    (job.render.held_out, job.render.outside) = (0, 0);
    let footprint = display.angular_footprint();
    let shot = Shot { job: &job, ingested: &ingested, placement: &placement, geometry: &geometry, footprint };
    let (traced, _) = trace::run(shot, options, &cache, task)?;
    denoise::run(shot, &traced.fields, task)?;
    let exposed = expose::run(shot, &traced, options.linear, task)?;
    let budget = traced.depths.budget(&display, &geometry, &placement);
    warn_of_depth(&budget, task);
    let all = geometry.grid.iter().count();
    if traced.views.len() < all && !options.linear && job.light.automatic_exposure {
        let count = traced.views.len();
        let message = format!(
            "exposure is chosen from {count} of {all} views; for equal exposure of views that are rendered apart, set `light.automatic_exposure = false` or give --linear"
        );
        task.warn("exposure", message);
    }
    let mut info = field_info(exposed.look, &placement);
    if options.linear {
        info.insert("tone".into(), "none".into());
        info.insert("radiance".into(), "scene-linear, neither exposed nor clipped".into());
    }
    let layers = layers::write_layers(target_dir, shot, options, &traced, task)?;
    info.extend(layers.map(|layers| ("layers".to_owned(), layers)));
    let precision = if options.linear { Precision::Float } else { Precision::Half };
    lumistack_field_io::write_views(target_dir, &exposed.target, &traced.views, precision, &info)
        .map_err(field_error)?;
    let folders: Vec<_> = traced.fields.iter().map(|field| field.folder.clone()).collect();
    used::keep_only_views(target_dir, &folders)?;
    Ok(budget)
}

impl Run<'_> {
    pub(crate) fn input(&mut self, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let Job { scene, light_field, source, .. } = &*self.job.clone();
        match (scene, light_field, source) {
            (Some(scene), ..) => self.render_scene(scene, moment, task),
            (None, Some(path), _) => self.read_field(path, moment, task),
            (None, None, Some(source)) => self.make_field(source, moment, task),
            (None, None, None) => Err(PipelineError::value("job", "scene", Job::INPUTS, "none")),
        }
    }

    fn render_scene(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let (job, registry) = (&self.job.clone(), self.registry);
        let cache = self.dir.join("cache");
        let loaded;
        let ingested = match moment.ingested {
            Some(ingested) => ingested,
            None => {
                loaded = self.timed("ingest", |_| {
                    let (pose, importer, light) = (&job.pose, &job.importer, &job.light);
                    Ok((ingest::load_scene(path, pose, importer, registry, light, Some(&cache), task)?, false))
                })?;
                &loaded
            }
        };
        let geometry = self.display.geometry().map_err(|source| display_error(source, "field"))?;
        let placement = place::place(ingested, &job.window, &self.display, &geometry, Some(&cache), task)?;
        let footprint = self.display.angular_footprint();
        let shot = Shot { job, ingested, placement: &placement, geometry: &geometry, footprint };
        let (traced, rendered) = self.timed("render", |run| {
            let views = run.dir.join("cache/views");
            let (traced, cached) = trace::run(shot, &ViewOptions::default(), &views, task)?;
            let filtered = denoise::run(shot, &traced.fields, task)?;
            let exposed = expose::run(shot, &traced, false, task)?;
            Ok(((traced, exposed), cached && filtered))
        })?;
        let info = field_info(rendered.look, &placement);
        let fields = [
            ("target", Some(&rendered.target)),
            ("held-out", rendered.held_out.as_ref()),
            ("outside", rendered.outside.as_ref()),
        ];
        task.progress.begin("write light field", fields.len() as u64, "folders");
        let written = fields.into_iter().try_for_each(|(name, field)| {
            task.progress.advance(1, "");
            field.map_or(Ok(()), |field| write_field_if_changed(&self.stamps, &self.dir, name, field, &info))
        });
        task.progress.end();
        written?;
        let references = self.timed("render for the score", |run| {
            let zone = score::zone_of(job, &run.display, &geometry);
            let (how, views) = ((rendered.look, traced.engine), run.dir.join("cache/views"));
            let made = References::render(shot, &zone, how, &views, task)?;
            let cached = made.as_ref().is_none_or(|references| references.cached);
            Ok((made, cached))
        })?;
        let depth = traced.depths.budget(&self.display, &geometry, &placement);
        warn_of_depth(&depth, task);
        let about = about_scene(path, shot, &rendered, &traced);
        let seen = traced.depths.seen(&placement);
        let mut views: Vec<PathBuf> = traced.fields.iter().map(|field| field.folder.clone()).collect();
        let Exposed { target, held_out, outside, look, denoised } = rendered;
        views.extend(references.as_ref().map(|references| references.folder.clone()));
        let target = target.with_depth(Some(seen));
        Ok(Input {
            target,
            held_out,
            outside,
            zone: references,
            look: Some(look),
            depth: Some(depth),
            denoised,
            about: Some(about),
            views,
        })
    }

    fn read_field(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let job = &self.job.clone();
        let defaults = field_defaults(&self.display);
        let display = self.display.clone();
        let target = self.timed("read", |_| {
            let footprint = |geometry: &FieldGeometry| given::adapted_footprint(&display, geometry);
            let read = lumistack_field_io::open_for(path, &job.geometry, &defaults, Some(&footprint), task);
            // not rounded, as `target/` is: figures are about what was given
            let mut field = read.map_err(field_error)?;
            if let Some(look) = Look::of_given(&job.light) {
                look.apply(&mut field);
            }
            Ok((field, false))
        })?;
        if let Some(beyond) = given::Beyond::of(&target) {
            task.warn(path.display().to_string(), beyond.message(given::OFFER_OF_COMMAND));
        }
        let about = json!({ "light field": path.display().to_string() });
        self.take_field(target, path, about, moment, task)
    }

    /// The light field of a source plugin; what it made before is read back.
    fn make_field(&mut self, source: &SourceJob, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let registry = self.registry;
        let mut key = KeyBuilder::new("source", code::PLUGINS);
        key.add("plugin", plugin_key(registry, &source.plugin, &source.params)?.as_bytes())
            .add("display", self.display.without_panels().to_toml().as_bytes())
            .add_json("time", &(source.time, source.time_s));
        let key = key.finish();
        let path = self.dir.join("cache/source.json");
        let target = self.timed(&source.plugin, |run| {
            if let Some(kept) = read_json::<Kept>(&path).filter(|kept| kept.key == key)
                && run.stamps.is_current("target", &kept.target)
                && let Ok((field, _)) = lumistack_field_io::read_field_folder(&run.dir.join("target"))
                && field_key("target", &field, &Map::new()) == kept.target
            {
                return Ok((field, true));
            }
            let (params, time) = (source.params.clone().into(), Time { index: source.time, seconds: source.time_s });
            let made = lumistack_plugin_host::make_field(registry, &source.plugin, &params, &run.display, time, task);
            let mut field = made.map_err(host_error)?;
            lumistack_field_io::round_to_half(&mut field);
            Ok((field, false))
        })?;
        let about = json!({ "source": source.plugin, "time (s)": source.time_s });
        let kept = Kept { key, target: field_key("target", &target, &Map::new()) };
        let input = self.take_field(target, Path::new(&source.plugin), about, moment, task)?;
        write_json(&path, &kept)?;
        Ok(input)
    }

    /// Makes a light field from `place` the target, to which the display adapts.
    fn take_field(
        &mut self,
        target: LightField,
        place: &Path,
        about: Value,
        moment: &Moment<'_>,
        task: Task<'_>,
    ) -> Result<Input, PipelineError> {
        if let Some((geometry, first)) = moment.geometry {
            sequence::check_geometry(place, target.geometry(), geometry, first)?;
        }
        let adapted = self.display.adapted_to(target.geometry());
        let adapted = adapted.map_err(|source| display_error(source, &place.display().to_string()))?;
        if let Some(change) = self.display.backlight_change(&adapted) {
            task.warn("display", change);
        }
        self.display = adapted;
        self.display.check().map_err(|source| display_error(source, "light field"))?;
        write_field_if_changed(&self.stamps, &self.dir, "target", &target, &Map::new())?;
        Ok(Input {
            target,
            held_out: None,
            outside: None,
            zone: None,
            look: None,
            depth: None,
            denoised: None,
            about: Some(about),
            views: Vec::new(),
        })
    }
}

/// What a light field takes of its display where it does not say itself.
pub(super) fn field_defaults(display: &Display) -> lumistack_field_io::GeometryDefaults {
    lumistack_field_io::GeometryDefaults {
        width_mm: Some(display.field_pixels().size_mm()[0]),
        fov_deg: Some(display.field.fov_deg),
    }
}

pub(crate) fn warn_of_depth(budget: &DepthBudget, task: Task<'_>) {
    if !budget.is_seen() {
        let message = "no surface is seen: the picture is empty. --look-from AZ,EL frames the scene from another side, --camera takes another \
                       camera, --near=off shows what stands before the near limit";
        task.warn("window", message);
    }
    if let Some(advice) = budget.advice() {
        task.warn("depth", advice);
    }
}

fn about_scene(path: &Path, shot: Shot<'_>, rendered: &Exposed, traced: &Traced) -> serde_json::Value {
    let Shot { ingested, placement, geometry, .. } = shot;
    let scene = &ingested.scene;
    let pose = serde_json::to_value(&ingested.pose).expect("poses serialize");
    let mut values = rendered.target.radiance().data().to_vec();
    let percentile = |values: &mut [f32], share| f64::from(lumistack_core::metrics::percentile(values, share));
    let span = percentile(&mut values, 0.99) - percentile(&mut values, 0.01);
    let map = placement.window.scene_from_display;
    json!({
        "file": path.display().to_string(),
        "pose": pose,
        "triangles": scene.triangle_count(),
        "meshes": scene.meshes.len(),
        "instances": scene.instances.len(),
        "materials": scene.materials.len(),
        "textures": scene.textures.len(),
        "lights": scene.lights.len(),
        "window centre (scene units)": map.translation.to_array(),
        "scene units per millimetre": map.scale,
        "window moved back to fit (mm)": placement.moved_back_mm,
        "depth scale": placement.depth_scale,
        "framed from azimuth and elevation (degrees)": placement.looked_from_deg,
        "near limit before the window (mm)": placement.window.near_mm,
        "exposure": rendered.look.exposure,
        "tone curve": rendered.look.curve.name(),
        // shares of the window and of the range 0..1: whether framing, light and exposure fit the scene
        "coverage": traced.depths.coverage(geometry.grid.views().map(|count| count / 2)),
        "target span": span,
    })
}

/// What a light field's index says of how it was made.
fn field_info(look: Look, placement: &Placement) -> Map<String, Value> {
    let mut info = Map::new();
    info.insert("exposure".into(), look.exposure.into());
    info.insert("tone".into(), look.curve.name().into());
    info.insert("depth_scale".into(), placement.depth_scale.into());
    if let Some(from_deg) = placement.looked_from_deg {
        info.insert("look_from_deg".into(), from_deg.to_vec().into());
    }
    info
}

fn write_field(dir: &Path, field: &LightField, info: &Map<String, Value>) -> Result<(), PipelineError> {
    lumistack_field_io::write_field(dir, field, info).map_err(field_error)?;
    Ok(())
}

/// Writes a light-field folder unless it already holds these values.
fn write_field_if_changed(
    stamps: &Stamps,
    run_dir: &Path,
    name: &str,
    field: &LightField,
    info: &Map<String, Value>,
) -> Result<(), PipelineError> {
    let key = field_key(name, field, info);
    if stamps.is_current(name, &key) {
        return Ok(());
    }
    stamps.clear(name)?;
    write_field(&run_dir.join(name), field, info)?;
    let mut files = vec![Path::new(name).join("lightfield.json")];
    let views = field.geometry().grid.views();
    let view_file = |view| Path::new(name).join(lumistack_field_io::view_file_name(views, view));
    files.extend(field.geometry().grid.iter().map(view_file));
    stamps.write(name, &key, &files)
}

/// Hash of everything that a light-field folder holds.
fn field_key(name: &str, field: &LightField, info: &Map<String, Value>) -> String {
    let mut key = KeyBuilder::new(name, code::FIELDS);
    key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_f32("radiance", field.radiance().data());
    key.add_json("info", info).finish()
}

/// Which light field a source made, as it is kept between runs.
#[derive(Serialize, Deserialize)]
struct Kept {
    key: String,
    target: String,
}
