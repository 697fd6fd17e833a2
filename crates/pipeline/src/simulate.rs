//! Simulates a finished run from a viewpoint, and writes the browser simulator of a run.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor, colour};
use lumistack_display::{Display, LayerStack, ProjectionKind, Simulator};
use lumistack_field_io::picture::{Precision, write_exr};
use lumistack_plugin_host::{OutputContext, OutputData, Registry, Time};
use rayon::prelude::*;
use serde_json::json;

use crate::error::{PipelineError, field_error, host_error};
use crate::presets;
use crate::store::code;
use crate::store::files::write;
use crate::store::key::{KeyBuilder, content_hash};
use crate::store::lock::lock_preview;
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;

/// Name of the folder of a run's preview, and also of the stamp of the preview.
const PREVIEW: &str = "preview";

/// A finished run: its display and patterns.
pub struct RunFolder {
    /// The run folder.
    pub dir: PathBuf,
    /// The display.
    pub display: Display,
    /// The patterns of the display.
    pub stack: LayerStack,
}

/// Returns the title in the report of a run; empty without a report.
fn title_of(dir: &Path) -> String {
    let report = std::fs::read(dir.join("report.json")).ok();
    let report = report.and_then(|text| serde_json::from_slice::<serde_json::Value>(&text).ok());
    report.and_then(|report| report["title"].as_str().map(str::to_owned)).unwrap_or_default()
}

/// A direction or position of the viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Viewpoint {
    /// A parallel projection at these angles from the z axis, degrees: right and up.
    Angle([f64; 2]),
    /// A parallel projection at this slope: right and up.
    Slope([f64; 2]),
    /// An eye in display space, millimetres: right, up, in front.
    Eye([f64; 3]),
    /// A number of parallel projections next to each other, spread over the horizontal field of
    /// view.
    Sweep(usize),
}

impl RunFolder {
    /// Reads the display and the patterns of a run.
    ///
    /// # Errors
    /// If display or patterns are missing or wrong, or do not match.
    pub fn open(dir: &Path) -> Result<Self, PipelineError> {
        if dir.is_dir() && !dir.join("display.toml").exists() {
            let expected = "a run folder, which contains display.toml and layers/stack.json";
            return Err(PipelineError::value(dir, "folder", expected, "a folder without display.toml"));
        }
        let display = presets::load_file(&dir.join("display.toml"))?;
        let layers = dir.join("layers");
        let stack = lumistack_field_io::read_stack(&layers).map_err(field_error)?;
        stack.check(&display).map_err(|source| PipelineError::Stack { path: layers, source })?;
        Ok(Self { dir: dir.to_owned(), display, stack })
    }

    /// Writes the browser simulator of the run into `out_dir`, with the target if the run has one.
    /// Returns the paths of the files, relative to `out_dir`.
    fn write_preview(
        &self,
        registry: &Registry,
        out_dir: &Path,
        task: Task<'_>,
    ) -> Result<Vec<PathBuf>, PipelineError> {
        let folder = self.dir.join("target");
        // The target is optional: the folder of a node and old runs have no target.
        let target = if folder.join("lightfield.json").is_file() {
            Some(lumistack_field_io::read_field_folder(&folder).map_err(field_error)?.0)
        } else {
            None
        };
        let data = OutputData::LayerStack(&self.stack, target.as_ref());
        let context = OutputContext { display: &self.display, data, time: Time::default(), out_dir, task };
        let written = lumistack_plugin_host::run_output(
            registry,
            "web_simulator",
            &json!({"title": title_of(&self.dir)}),
            context,
        );
        written.map_err(host_error)
    }

    /// Returns a warning if the viewpoint sees some of the display from outside of the viewing
    /// zone.
    pub fn zone_warning(&self, viewpoint: Viewpoint) -> Option<String> {
        let share = share_outside_zone(&self.display, viewpoint)?;
        let field = &self.display.field;
        let [x, y] = field.fov_deg;
        let part = if share > 0.999 { "all".into() } else { format!("{:.0} %", (100.0 * share).max(1.0)) };
        let from = match field.distance_mm {
            Some(distance_mm) if field.projection == ProjectionKind::Perspective => format!(" at {distance_mm} mm"),
            _ => String::new(),
        };
        let zone = format!("±{}° × ±{}°{from}", round(0.5 * x), round(0.5 * y));
        (share > 0.0).then(|| format!("at this viewpoint, the rays from {part} of the display are outside of the viewing zone of {zone}. The solver does not constrain these rays"))
    }

    /// Returns the picture of the run from a viewpoint; see [`picture_from`].
    ///
    /// # Errors
    /// If the viewpoint is not in front of the display, or its numbers are out of range.
    pub fn picture(&self, viewpoint: Viewpoint, raw: bool) -> Result<Tensor<3>, PipelineError> {
        picture_from(&self.display, &self.stack, viewpoint, raw)
    }
}

/// Writes the browser simulator of the run in `dir` into the run's folder `preview`, unless the
/// preview is current. Returns true if it was written.
///
/// The check compares contents of files, not their times, since a copy or a backup changes times.
///
/// # Errors
/// If `dir` is not a finished run, another process writes its preview, the plugin `web_simulator`
/// is missing, or the files cannot be written.
pub fn update_preview(dir: &Path, registry: &Registry, task: Task<'_>) -> Result<bool, PipelineError> {
    let stamps = Stamps::new(dir);
    let key = preview_key(dir, registry)?;
    if stamps.is_current(PREVIEW, &key) {
        return Ok(false);
    }
    let _owned = lock_preview(dir, task)?;
    stamps.clear(PREVIEW)?;
    let written = RunFolder::open(dir)?.write_preview(registry, &dir.join(PREVIEW), task)?;
    let files: Vec<PathBuf> = written.iter().map(|file| Path::new(PREVIEW).join(file)).collect();
    stamps.write(PREVIEW, &key, &files)?;
    Ok(true)
}

/// Computes a hash of all inputs of a run's preview.
fn preview_key(dir: &Path, registry: &Registry) -> Result<String, PipelineError> {
    let mut key = KeyBuilder::new(PREVIEW, code::PLUGINS);
    key.add("plugin", plugin_key(registry, "web_simulator", &serde_json::Map::new())?.as_bytes());
    let mut files: Vec<PathBuf> = vec!["display.toml".into()];
    for folder in ["layers", "target"] {
        let entries = std::fs::read_dir(dir.join(folder)).into_iter().flatten().flatten();
        files.extend(entries.map(|entry| Path::new(folder).join(entry.file_name())));
    }
    files.sort();
    let hashed: Vec<_> = files.par_iter().map(|file| content_hash(&dir.join(file))).collect();
    for (file, hash) in files.iter().zip(hashed) {
        let hash = hash.map_err(|source| PipelineError::Read { path: dir.join(file), source })?;
        key.add("file", file.as_os_str().as_encoded_bytes()).add("content", hash.as_bytes());
    }
    Ok(key.add("title", title_of(dir).as_bytes()).finish())
}

/// Returns the picture that patterns on a display show to a viewpoint: `[row][col][rgb]`, linear.
/// The values are L̃/β, or L̃ if `raw` is true.
///
/// # Errors
/// If the viewpoint is not in front of the display, or its numbers are out of range.
pub fn picture_from(
    display: &Display,
    stack: &LayerStack,
    viewpoint: Viewpoint,
    raw: bool,
) -> Result<Tensor<3>, PipelineError> {
    // Check the viewpoint, and simulate the display from this viewpoint.
    let scale = if raw { 1.0 } else { (1.0 / stack.brightness) as f32 };
    let simulator = Simulator::new(display, stack);
    let mut picture = match viewpoint {
        Viewpoint::Angle(degrees) => {
            if !degrees.iter().all(|angle| angle.abs() < 90.0) {
                let found = format!("{} and {}", degrees[0], degrees[1]);
                return Err(PipelineError::option("--view", "X,Y", "angles between -90 and 90 degrees", found));
            }
            simulator.from_slope(degrees.map(|angle| angle.to_radians().tan())).radiance
        }
        Viewpoint::Slope(slope) => {
            if !slope.iter().all(|slope| slope.is_finite()) {
                return Err(PipelineError::value("simulate", "slope", "finite tangents", format!("{slope:?}")));
            }
            simulator.from_slope(slope).radiance
        }
        Viewpoint::Eye(eye_mm) => {
            if !(eye_mm[2] > 0.0 && eye_mm.iter().all(|x| x.is_finite())) {
                let expected = "finite numbers, with a distance z above 0 in front of the display";
                return Err(PipelineError::option("--eye", "X,Y,Z", expected, format!("{eye_mm:?}")));
            }
            simulator.from_eye(eye_mm).radiance
        }
        Viewpoint::Sweep(count) => strip(display, &simulator, count)?,
    };
    // Unless `raw` is true, divide by β, which gives the picture the brightness of the target.
    picture.data_mut().iter_mut().for_each(|value| *value *= scale);
    Ok(picture)
}

/// Returns the fraction of the display, 0..1, that a viewpoint sees along rays outside of the
/// viewing zone. `None` for a sweep, for an angle of 90° or more, and for an eye that is not in
/// front of the display.
fn share_outside_zone(display: &Display, viewpoint: Viewpoint) -> Option<f64> {
    let field = &display.field;
    let size_mm = display.field_pixels().size_mm();
    let slope_of = |place: [f64; 2]| match viewpoint {
        Viewpoint::Angle(degrees) if degrees.iter().all(|angle| angle.abs() < 90.0) => {
            Some(degrees.map(|angle| angle.to_radians().tan()))
        }
        Viewpoint::Slope(slope) => Some(slope),
        Viewpoint::Eye(eye) if eye[2] > 0.0 => Some([0, 1].map(|axis| (eye[axis] - place[axis]) / eye[2])),
        _ => None,
    };
    let (views, mut outside) = (display.views(), 0);
    for i in 0..PROBES * PROBES {
        let place = [i % PROBES, i / PROBES].map(|i| (i as f64 + 0.5) / PROBES as f64 - 0.5);
        let place = [place[0] * size_mm[0], place[1] * size_mm[1]];
        let slope = slope_of(place)?;
        let is_outside = |axis: usize| {
            // The zone of perspective views is a range of eye positions, so follow the ray to the
            // distance of the eyes. An axis with a single view does not limit the zone, since all
            // eyes see the same view.
            let seen = match field.distance_mm {
                Some(distance_mm) if field.projection == ProjectionKind::Perspective => {
                    place[axis] / distance_mm + slope[axis]
                }
                _ => slope[axis],
            };
            let limit = (0.5 * field.fov_deg[axis].to_radians()).tan();
            views[axis] > 1 && seen.abs() > limit * (1.0 + 1e-9)
        };
        outside += usize::from(is_outside(0) || is_outside(1));
    }
    Some(outside as f64 / (PROBES * PROBES) as f64)
}

/// Number of points of the display per axis whose rays to the viewer are tested.
const PROBES: usize = 32;

/// Rounds degrees to one digit, for messages.
fn round(degrees: f64) -> f64 {
    (10.0 * degrees).round() / 10.0
}

fn strip(display: &Display, simulator: &Simulator<'_>, count: usize) -> Result<Tensor<3>, PipelineError> {
    if !(1..=64).contains(&count) {
        return Err(PipelineError::option("--sweep", "N", "1 to 64 views", count.to_string()));
    }
    let half_width = (0.5 * display.field.fov_deg[0].to_radians()).tan();
    let views: Vec<Tensor<3>> = (0..count)
        .map(|i| {
            // The slopes are the centres of `count` equal bins of the field of view.
            let slope = (2.0 * i as f64 + 1.0 - count as f64) / count as f64 * half_width;
            simulator.from_slope([slope, 0.0]).radiance
        })
        .collect();
    let [rows, cols, _] = views[0].shape();
    let mut strip = Tensor::zeros(["row", "col", "rgb"], [rows, cols * count, 3]);
    for row in 0..rows {
        let line = strip.block_mut([row]);
        for (i, view) in views.iter().enumerate() {
            line[3 * cols * i..3 * cols * (i + 1)].copy_from_slice(view.block([row]));
        }
    }
    Ok(strip)
}

/// Writes a linear picture `[row][col][rgb]` as PNG (sRGB-encoded) or EXR (linear). The extension
/// of the file selects the format.
///
/// # Errors
/// If the file has another extension or cannot be written.
pub fn simulate_to_file(picture: &Tensor<3>, path: &Path) -> Result<(), PipelineError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let [rows, cols, _] = picture.shape();
    match extension.as_str() {
        "exr" => write_exr(path, [cols, rows], picture.data(), Precision::Float).map_err(field_error),
        "png" => {
            let codes: Vec<u8> = picture.data().iter().map(|&value| colour::srgb_code(value)).collect();
            let image = image::RgbImage::from_raw(cols as u32, rows as u32, codes).ok_or_else(|| {
                PipelineError::value(path, "picture", "a size that PNG can hold", format!("{cols} × {rows}"))
            })?;
            let mut bytes = std::io::Cursor::new(Vec::new());
            image.write_to(&mut bytes, image::ImageFormat::Png).map_err(|error| {
                PipelineError::value(path, "picture", "a picture that PNG can hold", error.to_string())
            })?;
            write(path, bytes.get_ref())
        }
        other => Err(PipelineError::value(path, "extension", "png or exr", format!("`{other}`"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_zone_ends_where_the_outermost_views_do() {
        // The field of view is 20° × 20°, so parallel projections at less than 10° are within the
        // zone.
        let display = presets::load("paper-three-layer").unwrap();
        let share = |viewpoint| share_outside_zone(&display, viewpoint).unwrap();
        assert_eq!(share(Viewpoint::Angle([4.0, -2.0])), 0.0);
        assert_eq!(share(Viewpoint::Angle([9.9, 0.0])), 0.0);
        assert_eq!(share(Viewpoint::Angle([10.1, 0.0])), 1.0);
        assert_eq!(share(Viewpoint::Angle([0.0, -30.0])), 1.0);
        // The first eye position is the example in the help of `lumistack simulate`. The second eye
        // is nearer, so it sees the sides of the display from outside of the zone.
        assert_eq!(share(Viewpoint::Eye([100.0, 0.0, 2000.0])), 0.0);
        let near = share(Viewpoint::Eye([100.0, 0.0, 600.0]));
        // At 600 mm, 10° correspond to 105.8 mm. So the part inside the zone has |x − 100| and |y|
        // of at most 105.8 mm, on a display of ±237.5 × ±148.4 mm.
        assert!((near - (1.0 - (211.6 / 475.0) * (211.6 / 296.9))).abs() < 0.05, "{near}");
        assert_eq!(share_outside_zone(&display, Viewpoint::Sweep(3)), None);
        let mut perspective = display.clone();
        (perspective.field.projection, perspective.field.distance_mm) = (ProjectionKind::Perspective, Some(600.0));
        let share = |viewpoint| share_outside_zone(&perspective, viewpoint).unwrap();
        assert_eq!(share(Viewpoint::Eye([100.0, 0.0, 600.0])), 0.0);
        assert_eq!(share(Viewpoint::Eye([110.0, 0.0, 600.0])), 1.0);
    }
}
