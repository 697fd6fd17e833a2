//! The light field of a run: rendered, or read from what somebody else rendered.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::LightField;
use lumistack_plugin_host::Registry;
use lumistack_report::DepthBudget;
use serde_json::{Map, Value, json};

use super::{Moment, Run};
use crate::cache::{KeyBuilder, Stamps};
use crate::denoise::Denoised;
use crate::error::{PipelineError, display_error, field_error};
use crate::files::check_folder;
use crate::fit::{self, Placement};
use crate::ingest::{self, Ingested};
use crate::job::Job;
use crate::look::Look;
use crate::render;
use crate::sequence;

/// What the input stage gives.
pub(crate) struct Input {
    pub(crate) target: LightField,
    pub(super) held_out: Option<LightField>,
    pub(super) outside: Option<LightField>,
    /// How it became display-referred, where it was rendered.
    pub(crate) look: Option<Look>,
    /// What the scene's depth asks of the display, where it was rendered.
    pub(crate) depth: Option<DepthBudget>,
    /// What a denoiser did to the target.
    pub(super) denoised: Option<Denoised>,
    pub(super) about: Option<serde_json::Value>,
}

/// Renders the views of a job's scene into `target_dir`, without factorizing; says what their depth asks of the display.
///
/// # Errors
/// When ingest or rendering fails or is cancelled.
pub fn render_only(
    job: &Job,
    target_dir: &Path,
    registry: &Registry,
    task: Task<'_>,
) -> Result<DepthBudget, PipelineError> {
    let Some(scene) = &job.scene else {
        return Err(PipelineError::value("job", "scene", "a scene to render", "none"));
    };
    check_folder(target_dir)?;
    let display = job.resolve_display()?;
    let geometry = display.geometry().map_err(|source| display_error(source, "field"))?;
    let ingested = ingest::load_scene(scene, &job.pose, &job.importer, registry, &job.light, task)?;
    let cache = target_dir.join("cache");
    let placement = fit::place(&ingested, &job.window, &display, &geometry, Some(&cache), task)?;
    let mut job = job.clone();
    (job.render.held_out, job.render.outside) = (0, 0);
    let rendered = render::render(&job, &ingested, &placement, &geometry, &cache, task)?;
    let budget = rendered.depths.budget(&display, &geometry, &placement);
    warn_of_depth(&budget, task);
    write_field(target_dir, &rendered.target, &field_info(&rendered, &placement))?;
    Ok(budget)
}

impl Run<'_> {
    pub(crate) fn input(&mut self, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        match (self.job.scene.clone(), self.job.light_field.clone()) {
            (Some(scene), _) => self.render_scene(&scene, moment, task),
            (None, Some(path)) => self.read_field(&path, moment, task),
            (None, None) => Err(PipelineError::value("job", "scene", "either `scene` or `light_field`", "neither")),
        }
    }

    fn render_scene(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let (job, registry) = (&self.job.clone(), self.registry);
        let loaded;
        let ingested = match moment.ingested {
            Some(ingested) => ingested,
            None => {
                loaded = self.timed("ingest", |_| {
                    Ok((ingest::load_scene(path, &job.pose, &job.importer, registry, &job.light, task)?, false))
                })?;
                &loaded
            }
        };
        let geometry = self.display.geometry().map_err(|source| display_error(source, "field"))?;
        let cache = self.dir.join("cache");
        let placement = fit::place(ingested, &job.window, &self.display, &geometry, Some(&cache), task)?;
        let rendered = self.timed("render", |run| {
            let views = run.dir.join("cache/views");
            let rendered = render::render(job, ingested, &placement, &geometry, &views, task)?;
            let cached = rendered.cached;
            Ok((rendered, cached))
        })?;
        let info = field_info(&rendered, &placement);
        write_field_if_changed(&self.stamps, &self.dir, "target", &rendered.target, &info)?;
        for (name, field) in [("held-out", &rendered.held_out), ("outside", &rendered.outside)] {
            if let Some(field) = field {
                write_field_if_changed(&self.stamps, &self.dir, name, field, &info)?;
            }
        }
        let depth = rendered.depths.budget(&self.display, &geometry, &placement);
        warn_of_depth(&depth, task);
        let about = about_scene(path, ingested, &placement, &rendered);
        let render::Rendered { target, held_out, outside, look, denoised, .. } = rendered;
        Ok(Input { target, held_out, outside, look: Some(look), depth: Some(depth), denoised, about: Some(about) })
    }

    fn read_field(&mut self, path: &Path, moment: &Moment<'_>, task: Task<'_>) -> Result<Input, PipelineError> {
        let job = &self.job.clone();
        let defaults = lumistack_field_io::GeometryDefaults {
            width_mm: Some(self.display.field_pixels().size_mm()[0]),
            fov_deg: Some(self.display.field.fov_deg),
        };
        let target = self.timed("read", |_| {
            let mut field = lumistack_field_io::open(path, &job.geometry, &defaults, task).map_err(field_error)?;
            lumistack_field_io::round_to_half(&mut field);
            Ok((field, false))
        })?;
        if let Some((geometry, place)) = moment.geometry {
            sequence::check_geometry(path, target.geometry(), geometry, place)?;
        }
        self.display = self.display.adapted_to(target.geometry());
        self.display.check().map_err(|source| display_error(source, "light field"))?;
        write_field_if_changed(&self.stamps, &self.dir, "target", &target, &Map::new())?;
        let about = Some(json!({ "light field": path.display().to_string() }));
        Ok(Input { target, held_out: None, outside: None, look: None, depth: None, denoised: None, about })
    }
}

fn warn_of_depth(budget: &DepthBudget, task: Task<'_>) {
    if let Some(advice) = budget.advice() {
        task.warn("depth", advice);
    }
}

fn about_scene(
    path: &Path,
    ingested: &Ingested,
    placement: &Placement,
    rendered: &render::Rendered,
) -> serde_json::Value {
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
        "exposure": rendered.look.exposure,
        "tone curve": rendered.look.curve.name(),
        // shares of the window and of the range 0..1: whether framing, light and exposure fit the scene
        "coverage": rendered.coverage,
        "target span": span,
    })
}

/// What a light field's index says of how it was made.
fn field_info(rendered: &render::Rendered, placement: &Placement) -> Map<String, Value> {
    let mut info = Map::new();
    info.insert("exposure".into(), rendered.look.exposure.into());
    info.insert("tone".into(), rendered.look.curve.name().into());
    info.insert("depth_scale".into(), placement.depth_scale.into());
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
    let mut key = KeyBuilder::new(name, 1);
    key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_f32("radiance", field.radiance().data());
    let key = key.add_json("info", info).finish();
    if stamps.is_current(name, &key) {
        return Ok(());
    }
    stamps.clear(name)?;
    write_field(&run_dir.join(name), field, info)?;
    let mut files = vec![Path::new(name).join("lightfield.json")];
    files.extend(field.geometry().grid.iter().map(|[y, x]| Path::new(name).join(format!("view_{y:02}_{x:02}.exr"))));
    stamps.write(name, &key, &files)
}
