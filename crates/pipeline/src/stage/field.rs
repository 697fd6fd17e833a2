//! The light field that is the input of a run's nodes and outputs, and its folder `target/`.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor};
use lumistack_display::{Display, FieldGeometry, LightField, Projection, Weights};
use lumistack_field_io::GeometryDefaults;
use lumistack_report::DepthBudget;
use lumistack_shot::{Placement, ToneMapping};
use lumistack_simd::{float_from_half, nearest_half};
use serde_json::{Map, Value, json};

use super::denoise::Denoised;
use super::depth;
use super::expose::Exposed;
use super::fields::Shot;
use super::trace::Traced;
use crate::error::{PipelineError, display_error, field_error};
use crate::job::FactorizeJob;
use crate::store::code;
use crate::store::key::KeyBuilder;
use crate::store::stamps::Stamps;

/// A light field, the display that shows it, and facts about its origin.
pub(crate) struct Field {
    pub(crate) target: LightField,
    pub(crate) held_out: Option<LightField>,
    pub(crate) outside: Option<LightField>,
    /// The display. If the light field is not rendered, the display is adapted to it.
    pub(crate) display: Display,
    /// Exposure and tone curve, if the light field was rendered.
    pub(crate) tone_mapping: Option<ToneMapping>,
    /// The scene's depth compared with the display's depth of field, if the light field was
    /// rendered.
    pub(crate) depth: Option<DepthBudget>,
    /// Results of the denoiser on the target, if there was a denoiser.
    pub(crate) denoised: Option<Denoised>,
    /// Facts about the scene or the file, for the report.
    pub(crate) about: Value,
    /// Folders of the cached views.
    pub(crate) views: Vec<PathBuf>,
}

impl Field {
    /// Collects the light fields of a shot. Also writes their folders, if the content changed.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(crate) fn of_scene(
        path: &Path,
        shot: Shot<'_>,
        traced: &Traced,
        exposed: Exposed,
        display: &Display,
        stamps: &Stamps,
        task: Task<'_>,
    ) -> Result<Self, PipelineError> {
        let Shot { placement, geometry, .. } = shot;
        // Write folders, from which outputs and other programs read the light fields.
        let info = field_info(exposed.tone_mapping, placement);
        let fields = [
            ("target", Some(&exposed.target)),
            ("held-out", exposed.held_out.as_ref()),
            ("outside", exposed.outside.as_ref()),
        ];
        task.progress.begin("write light field", fields.len() as u64, "folders");
        let written = fields.into_iter().try_for_each(|(name, field)| {
            task.progress.advance(1, "");
            field.map_or(Ok(()), |field| write_if_changed(stamps, name, field, &info))
        });
        task.progress.end();
        written?;
        // Warn about depth as soon as the depth is known.
        let depth = depth::budget(&traced.depths, display, geometry, placement);
        warn_of_depth(&depth, task);
        let about = about_scene(path, shot, traced, &exposed);
        let Exposed { target, held_out, outside, tone_mapping, denoised } = exposed;
        Ok(Self {
            target: target.with_depth(Some(traced.depths.seen(placement))),
            held_out,
            outside,
            display: display.clone(),
            tone_mapping: Some(tone_mapping),
            depth: Some(depth),
            denoised,
            about,
            views: traced.fields.iter().map(|field| field.folder.clone()).collect(),
        })
    }

    /// Makes a given light field the target, and adapts the display to it. `place` is the path of
    /// the light field's file, or the id of its plugin.
    ///
    /// # Errors
    /// If the display cannot show the light field, or a file cannot be written.
    pub(crate) fn of_given(
        target: LightField,
        place: &Path,
        about: Value,
        display: &Display,
        stamps: &Stamps,
        task: Task<'_>,
    ) -> Result<Self, PipelineError> {
        let adapted = display.adapted_to(target.geometry());
        let adapted = adapted.map_err(|source| display_error(source, &place.display().to_string()))?;
        if let Some(change) = display.backlight_change(&adapted) {
            task.warn("display", change);
        }
        adapted.check().map_err(|source| display_error(source, "light field"))?;
        write_if_changed(stamps, "target", &target, &Map::new())?;
        Ok(Self {
            target,
            held_out: None,
            outside: None,
            display: adapted,
            tone_mapping: None,
            depth: None,
            denoised: None,
            about,
            views: Vec::new(),
        })
    }
}

/// Checks that a light field has the same rays as the light field of an earlier time step. `place`
/// is the origin of that earlier light field.
///
/// # Errors
/// If the geometry differs.
pub(crate) fn check_geometry(
    path: &Path,
    found: &FieldGeometry,
    expected: &FieldGeometry,
    place: &str,
) -> Result<(), PipelineError> {
    if found == expected {
        return Ok(());
    }
    let text = |geometry: &FieldGeometry| {
        let [view_rows, view_cols] = geometry.grid.views();
        let projection = match geometry.grid.projection {
            Projection::Oblique => "oblique".into(),
            Projection::Perspective { distance_mm } => format!("perspective from {distance_mm} mm"),
        };
        format!(
            "{view_cols} × {view_rows} views of {} × {} pixels of {} mm, {projection}, slopes x {:?}, y {:?}",
            geometry.cols, geometry.rows, geometry.pitch_mm, geometry.grid.slope_x, geometry.grid.slope_y
        )
    };
    let expected = format!("the same rays as in {place}: {}", text(expected));
    Err(PipelineError::value(path, "geometry", expected, text(found)))
}

/// Returns the size and angles of a display, for a light field whose files do not state them.
pub(crate) fn field_defaults(display: &Display) -> GeometryDefaults {
    GeometryDefaults { width_mm: Some(display.field_pixels().size_mm()[0]), fov_deg: Some(display.field.fov_deg) }
}

pub(crate) fn warn_of_depth(budget: &DepthBudget, task: Task<'_>) {
    if !budget.is_seen() {
        let message = "no surface is seen, so the picture is empty. Remedies: --look-from AZ,EL shows the scene from another side, --camera uses another \
                       camera, and --near=off also shows surfaces in front of the near plane";
        task.warn("window", message);
    }
    if let Some(advice) = budget.advice() {
        task.warn("depth", advice);
    }
}

fn about_scene(path: &Path, shot: Shot<'_>, traced: &Traced, exposed: &Exposed) -> Value {
    let Shot { ingested, placement, geometry, .. } = shot;
    let scene = &ingested.scene;
    let pose = serde_json::to_value(&ingested.pose).expect("poses serialize");
    let views = exposed.target.geometry().grid.iter().map(|view| exposed.target.view(view));
    let [low, high] = percentiles_of_halves(views, [0.01, 0.99]).map(f64::from);
    let span = high - low;
    let map = placement.window.scene_from_display;
    // Make the names and values of a table in the report.
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
        "exposure": exposed.tone_mapping.exposure,
        "tone curve": exposed.tone_mapping.curve.name(),
        "paths per pixel and view": shot.samples_per_view(),
        "paths chosen because": shot.samples.map(|samples| samples.reason()),
        // Coverage is the fraction of the window with a hit. Coverage and the range of the target's
        // values show how well framing, light and exposure suit the scene.
        "coverage": traced.depths.coverage(geometry.grid.views().map(|count| count / 2)),
        "target span": span,
    })
}

/// Returns percentiles of values that are half floats. `parts` are slices of the values. Counting
/// every bit pattern avoids a sorted copy.
fn percentiles_of_halves<'a>(parts: impl Iterator<Item = &'a [f32]>, shares: [f64; 2]) -> [f32; 2] {
    // Map bits so that they have the order of the values. The bits of negative halves fall as the
    // value rises.
    let turn = |bits: u16| if bits & 0x8000 == 0 { bits | 0x8000 } else { !bits };
    let mut counts = vec![0usize; 1 << 16];
    let mut all = 0usize;
    for values in parts {
        values.iter().for_each(|&value| counts[usize::from(turn(nearest_half(value)))] += 1);
        all += values.len();
    }
    shares.map(|share| {
        let mut rank = (share * all.saturating_sub(1) as f64).round() as usize;
        let found = counts.iter().position(|&count| {
            let is_here = rank < count;
            rank -= if is_here { 0 } else { count };
            is_here
        });
        let turned = found.unwrap_or(0x8000) as u16;
        float_from_half(if turned & 0x8000 == 0 { !turned } else { turned & 0x7fff })
    })
}

/// Returns exposure, tone curve and depth scale for the index of a light field.
pub(crate) fn field_info(tone_mapping: ToneMapping, placement: &Placement) -> Map<String, Value> {
    let mut info = Map::new();
    info.insert("exposure".into(), tone_mapping.exposure.into());
    info.insert("tone".into(), tone_mapping.curve.name().into());
    info.insert("depth_scale".into(), placement.depth_scale.into());
    if let Some(from_deg) = placement.looked_from_deg {
        info.insert("look_from_deg".into(), from_deg.to_vec().into());
    }
    info
}

/// Writes the folder of a light field, unless the folder has these values already.
fn write_if_changed(
    stamps: &Stamps,
    name: &str,
    field: &LightField,
    info: &Map<String, Value>,
) -> Result<(), PipelineError> {
    let write = || {
        lumistack_field_io::write_field(&stamps.dir().join(name), field, info).map_err(field_error)?;
        let mut files = vec![Path::new(name).join("lightfield.json")];
        let views = field.geometry().grid.views();
        let view_file = |view| Path::new(name).join(lumistack_field_io::view_file_name(views, view));
        files.extend(field.geometry().grid.iter().map(view_file));
        Ok(((), files))
    };
    stamps.reuse_or_make(name, &field_key(name, field, info), || Some(()), write).map(|_| ())
}

/// Returns a hash of the content of a light field's folder.
pub(crate) fn field_key(name: &str, field: &LightField, info: &Map<String, Value>) -> String {
    let mut key = KeyBuilder::new(name, code::FIELDS);
    key.add("geometry", format!("{:?}", field.geometry()).as_bytes()).add_field("radiance", field);
    key.add_json("info", info).finish()
}

/// Returns the weights in the file that a job names, or else the weights of its expected eyes.
/// Without a file and without eyes, weights are uniform.
///
/// # Errors
/// If the file cannot be read, the weights do not match the light field, or the job has both a file
/// and eyes.
pub(crate) fn weights(job: &FactorizeJob, geometry: &FieldGeometry) -> Result<Weights, PipelineError> {
    let Some(path) = &job.weights else { return eye_weights(job, geometry) };
    if !job.eyes.is_empty() {
        return Err(PipelineError::job("factorize.eyes", "either `weights` or `eyes`", "both"));
    }
    let (shape, data) = lumistack_field_io::npy::read(path).map_err(field_error)?;
    array_weights(path, &shape, data, geometry)
}

/// Returns the weights of a job's expected eyes. Without eyes, weights are uniform.
///
/// # Errors
/// If an eye position is invalid.
pub(crate) fn eye_weights(job: &FactorizeJob, geometry: &FieldGeometry) -> Result<Weights, PipelineError> {
    if job.eyes.is_empty() {
        return Ok(Weights::Uniform);
    }
    Weights::eye_boxes(geometry, &job.eye_boxes(), job.eye_floor as f32)
        .map_err(|error| PipelineError::job("factorize.eyes", error.expected, error.found))
}

/// Returns the weights in an array. Error messages name `path` as the origin of the array.
///
/// # Errors
/// If the weights do not match the light field.
pub(crate) fn array_weights(
    path: &Path,
    shape: &[usize],
    data: Vec<f32>,
    geometry: &FieldGeometry,
) -> Result<Weights, PipelineError> {
    let weights = match shape {
        &[y, x] => Tensor::from_vec(["view_y", "view_x"], [y, x], data).map(Weights::PerView),
        &[y, x, rows, cols] => {
            Tensor::from_vec(["view_y", "view_x", "row", "col"], [y, x, rows, cols], data).map(Weights::PerRay)
        }
        other => {
            let expected = "an array [view_y][view_x] or [view_y][view_x][row][col]";
            return Err(PipelineError::value(path, "shape", expected, format!("an array of shape {other:?}")));
        }
    }
    .map_err(|error| PipelineError::value(path, "weights", "values that fill the shape", error.to_string()))?;
    weights.check(geometry).map_err(|source| PipelineError::Weights { path: path.to_owned(), source })?;
    Ok(weights)
}

/// Adds weights to a key.
pub(crate) fn add_weights(key: &mut KeyBuilder, weights: &Weights) {
    match weights {
        Weights::Uniform => {}
        Weights::PerView(t) => {
            key.add_f32("weights per view", t.data());
        }
        Weights::PerRay(t) => {
            key.add_f32("weights per ray", t.data());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_half_floats_are_those_of_the_values() {
        let values: Vec<f32> =
            (0..5000).map(|i| float_from_half(nearest_half(((i * 7919) % 5003) as f32 / 3000.0 - 0.2))).collect();
        for shares in [[0.01, 0.99], [0.0, 1.0], [0.12, 0.121]] {
            let expected = shares.map(|share| lumistack_core::metrics::percentile(&mut values.clone(), share));
            assert_eq!(percentiles_of_halves(values.chunks(999), shares), expected);
        }
        assert_eq!(percentiles_of_halves(std::iter::empty(), [0.01, 0.99]), [0.0, 0.0]);
    }
}
