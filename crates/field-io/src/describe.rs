//! Describes a light field: its geometry as far as the files define it, and the range of its
//! values, which are read view by view.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::ProjectionKind;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::geometry::{GeometryFlags, full_angle_deg};
use crate::source::Kind;
use crate::{FieldError, detect};

/// Summary of a light field on disk. A value is `None` if neither files nor flags define it.
#[derive(Clone, Debug, Serialize)]
pub struct Description {
    /// Kind of the files that hold the light field.
    pub kind: Kind,
    /// Path of the light field.
    pub path: String,
    /// Number of views, [horizontal, vertical].
    pub views: [usize; 2],
    /// Size of every view in pixels, [columns, rows].
    pub resolution: [usize; 2],
    /// Projection of the rays of one view.
    pub projection: Option<ProjectionKind>,
    /// Distance of the eyes from the display plane, millimetres, if views are perspective.
    pub distance_mm: Option<f64>,
    /// Pixel pitch on z = 0, millimetres.
    pub pitch_mm: Option<f64>,
    /// Full angle of all views, [horizontal, vertical], degrees.
    pub fov_deg: Option<[f64; 2]>,
    /// Slopes of view columns, left to right.
    pub slope_x: Option<Vec<f64>>,
    /// Slopes of view rows, y up, top to bottom.
    pub slope_y: Option<Vec<f64>>,
    /// Smallest finite value of all views, linear.
    pub minimum: f32,
    /// Largest finite value of all views, linear.
    pub maximum: f32,
    /// Mean of the finite values of all views, linear.
    pub mean: f64,
    /// Number of values that are infinite or not a number.
    pub not_finite: u64,
    /// Notes of the program that wrote the folder, from `info` in `lightfield.json`.
    pub info: Map<String, Value>,
}

/// Describes a light field of any kind that [`open`](crate::open) reads. One view (or one quilt) at
/// a time is in memory.
///
/// # Errors
/// If the path is of another kind, a file is damaged, or views differ in size. Incomplete geometry
/// is no error: it gives `None`. Values that are not finite are counted.
pub fn describe(path: &Path, flags: &GeometryFlags, task: Task<'_>) -> Result<Description, FieldError> {
    let mut source = detect::detect(path, flags, task)?;
    let [rows, cols] = source.views;
    // Read every view once, since the statistics are over all values.
    let (mut minimum, mut maximum) = (f32::INFINITY, f32::NEG_INFINITY);
    let (mut sum, mut finite, mut not_finite) = (0.0, 0u64, 0);
    task.progress.begin("read views", (rows * cols) as u64, "views");
    for view in (0..rows).flat_map(|y| (0..cols).map(move |x| [y, x])) {
        task.cancel.check()?;
        for value in source.reader.load(view)? {
            if value.is_finite() {
                (minimum, maximum) = (minimum.min(value), maximum.max(value));
                sum += f64::from(value);
                finite += 1;
            } else {
                not_finite += 1;
            }
        }
        task.progress.advance(1, "");
    }
    task.progress.end();
    // Flags override the geometry of the files.
    let hints = source.hints;
    let [slope_x, slope_y] = hints.slopes;
    let from_slopes = slope_x.as_ref().zip(slope_y.as_ref()).map(|(x, y)| [full_angle_deg(x), full_angle_deg(y)]);
    Ok(Description {
        kind: source.kind,
        path: source.path.display().to_string(),
        views: [cols, rows],
        resolution: source.size,
        projection: flags.grid.or(hints.projection),
        distance_mm: flags.distance_mm.or(hints.distance_mm),
        pitch_mm: flags.pitch_mm.or(hints.pitch_mm),
        fov_deg: flags.fov_deg.or(hints.fov_deg).or(from_slopes),
        slope_x,
        slope_y,
        minimum,
        maximum,
        mean: sum / finite as f64,
        not_finite,
        info: source.info,
    })
}
