//! Geometry of a light field's views, from flags, files and defaults.
//!
//! Flags override files, and files override defaults. Every default that is used causes a warning
//! with the name of its flag.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, Projection, ProjectionKind, ViewGrid};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::FieldError;

/// Geometry that the user states. Each value is optional and overrides the files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GeometryFlags {
    /// Projection of one view's rays. `distance_mm` alone implies perspective if the files state no
    /// projection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid: Option<ProjectionKind>,
    /// [horizontal, vertical] full angle of the kept views, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<[f64; 2]>,
    /// Pitch of the resulting pixels on z = 0, millimetres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_mm: Option<f64>,
    /// Viewing distance of a perspective grid, millimetres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_mm: Option<f64>,
    /// [horizontal, vertical] views to keep: evenly spaced around the centre, as far apart as
    /// possible.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<[usize; 2]>,
    /// [columns, rows] of tiles of a quilt. They override the numbers in the name of the quilt's
    /// file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quilt: Option<[usize; 2]>,
    /// [horizontal, vertical] views of a single picture of tiles, with view (0, 0) at the top left.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tiles: Option<[usize; 2]>,
    /// [columns, rows] of every view in the result. Views are cropped to this aspect, then reduced
    /// by area averaging.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution: Option<[usize; 2]>,
    /// Disparity of the content that is moved to z = 0. From a view to its right neighbour, this
    /// content moves to the left by this number of file pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_px: Option<f64>,
    /// Reverse the order of views along [x, y].
    #[serde(skip_serializing_if = "is_unset")]
    pub mirror: [bool; 2],
    /// Replace every kept view by an average over the slopes that the display cannot separate. The
    /// average also uses the views that `views` leaves out; see [`open_for`](crate::open_for).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub prefilter: bool,
}

fn is_unset(mirror: &[bool; 2]) -> bool {
    *mirror == [false; 2]
}

/// Values that are used if neither flags nor files define them. If a value is `None` here too,
/// opening fails. But no angle is needed for a single view, or if the cameras' slopes are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GeometryDefaults {
    /// Width of the light field on the display plane z = 0, millimetres.
    pub width_mm: Option<f64>,
    /// Full angle of all views, [horizontal, vertical], degrees.
    pub fov_deg: Option<[f64; 2]>,
}

/// Geometry that the files define.
#[derive(Clone, Debug, Default)]
pub(crate) struct Hints {
    pub(crate) projection: Option<ProjectionKind>,
    pub(crate) distance_mm: Option<f64>,
    pub(crate) pitch_mm: Option<f64>,
    pub(crate) fov_deg: Option<[f64; 2]>,
    /// Slopes of the view columns (x, right) and of the view rows (y, up), if the files have them.
    pub(crate) slopes: [Option<Vec<f64>>; 2],
    pub(crate) cameras: Option<Cameras>,
    /// Width of one view divided by its height, for anamorphic tiles.
    pub(crate) view_aspect: Option<f64>,
}

/// Cameras in a plane with a common viewing direction.
#[derive(Clone, Debug)]
pub(crate) struct Cameras {
    /// Positions of view columns (x, right) and view rows (y, up), in steps. A step is the mean
    /// distance between neighbours along x, or along y if there is only one column.
    pub(crate) positions: [Vec<f64>; 2],
    /// Focal length, in pixels of the files.
    pub(crate) focal_px: Option<f64>,
    /// Slope between neighbouring cameras: a step divided by the distance of the plane of zero
    /// disparity. 0 if the slope is unknown, and for parallel cameras, for which that plane is at
    /// infinity.
    pub(crate) slope_per_step: f64,
    /// True if the file does not state the plane of zero disparity. The focus then follows from the
    /// content of the pictures.
    pub(crate) plane_unknown: bool,
}

/// Geometry in JSON files: `lightfield.json`, and the file next to an array. Unknown keys are
/// ignored.
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct GeometryJson {
    pub(crate) axes: Option<Vec<String>>,
    pub(crate) linear: Option<bool>,
    pub(crate) pitch_mm: Option<f64>,
    #[serde(alias = "grid")]
    pub(crate) projection: Option<ProjectionKind>,
    pub(crate) distance_mm: Option<f64>,
    pub(crate) slope_x: Option<Vec<f64>>,
    #[serde(alias = "slope_y_up")]
    pub(crate) slope_y: Option<Vec<f64>>,
    pub(crate) fov_deg: Option<[f64; 2]>,
}

impl GeometryJson {
    /// Checks the values against the number of views in the data, `views` = [vertical, horizontal].
    pub(crate) fn into_hints(self, path: &Path, views: [usize; 2]) -> Result<Hints, FieldError> {
        let axes = lumistack_display::LightField::AXES;
        if let Some(found) = &self.axes
            && !found.iter().eq(axes.iter())
        {
            return Err(FieldError::malformed(path, "axes", format!("{axes:?}"), format!("{found:?}")));
        }
        for (key, slopes, count) in [("slope_x", &self.slope_x, views[1]), ("slope_y", &self.slope_y, views[0])] {
            if let Some(slopes) = slopes
                && slopes.len() != count
            {
                let expected = format!("{count} slopes, one per view");
                return Err(FieldError::malformed(path, key, expected, slopes.len().to_string()));
            }
        }
        Ok(Hints {
            projection: self.projection,
            distance_mm: self.distance_mm,
            pitch_mm: self.pitch_mm,
            fov_deg: self.fov_deg,
            slopes: [self.slope_x, self.slope_y],
            ..Hints::default()
        })
    }
}

/// Relates the pixels of the result to the pixels of the files.
pub(crate) struct Pixels {
    /// Number of [columns, rows] of each resulting view.
    pub(crate) size: [usize; 2],
    /// Width of the rectangle that is read from a file's view, in pixels of the file.
    pub(crate) window_cols: f64,
    /// Disparity, per camera step, of the content that is now at z = 0; in pixels of the file.
    pub(crate) focus_px: f64,
}

/// Selects `count` of `available` indices, with equal steps as large as possible, around the
/// centre.
pub(crate) fn pick(available: usize, count: usize) -> Vec<usize> {
    let stride = if count > 1 { (available - 1) / (count - 1) } else { 1 };
    let first = (available - 1 - (count - 1) * stride) / 2;
    (0..count).map(|index| first + index * stride).collect()
}

/// Resolves the geometry of a light field. The file has `views` = [rows, columns] of views, of
/// which the rows `picks[0]` and the columns `picks[1]` are kept.
pub(crate) fn resolve(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    hints: &Hints,
    views: [usize; 2],
    picks: &[Vec<usize>; 2],
    pixels: &Pixels,
    task: Task<'_>,
) -> Result<FieldGeometry, FieldError> {
    let pitch_mm = pitch(path, flags, defaults, hints, pixels, task)?;
    let own_slopes = physical_slopes(hints, picks, pixels);
    let (slopes, physical) = slopes(path, flags, defaults, hints, views, picks, own_slopes, task)?;
    // Select the projection: by the flag, then by the file. If neither defines a projection, it is
    // perspective if a flag states the viewing distance or the slopes come from the cameras.
    // Otherwise it is oblique.
    let kind = flags.grid.or(hints.projection).unwrap_or(match flags.distance_mm {
        None if !physical => ProjectionKind::Oblique,
        _ => ProjectionKind::Perspective,
    });
    if let Some(own) = hints.projection.filter(|own| *own != kind) {
        let name = |kind| if kind == ProjectionKind::Oblique { "oblique" } else { "perspective" };
        task.warn(
            place(path),
            format!("the light field states {} views, but they are taken as {} views (--grid)", name(own), name(kind)),
        );
    }
    if let Some((own_mm, given_mm)) =
        hints.distance_mm.zip(flags.distance_mm).filter(|(own, given)| differ(*own, *given))
    {
        task.warn(
            place(path),
            format!(
                "the light field's own viewing distance, {own_mm} mm, is replaced by {given_mm} mm (--distance-mm)"
            ),
        );
    }
    // A perspective grid needs a viewing distance: from the flag, the file, or the lens.
    let projection = match kind {
        ProjectionKind::Oblique => {
            if flags.distance_mm.is_some() {
                task.warn(place(path), "the given viewing distance has no effect, since the views are parallel projections (--distance-mm)");
            }
            Projection::Oblique
        }
        ProjectionKind::Perspective => {
            let focal_px = hints.cameras.as_ref().and_then(|cameras| cameras.focal_px);
            let width_mm = pitch_mm * pixels.size[0] as f64;
            let from_lens = focal_px.map(|focal_px| width_mm * focal_px / pixels.window_cols);
            let distance_mm = flags.distance_mm.or(hints.distance_mm).or(from_lens);
            Projection::Perspective { distance_mm: distance_mm.ok_or_else(|| missing_distance(path))? }
        }
    };
    let [slope_x, slope_y] = slopes;
    let geometry = FieldGeometry {
        rows: pixels.size[1],
        cols: pixels.size[0],
        pitch_mm,
        grid: ViewGrid { projection, slope_x, slope_y },
    };
    geometry.check().map_err(FieldError::geometry(path))?;
    Ok(geometry)
}

fn pitch(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    hints: &Hints,
    pixels: &Pixels,
    task: Task<'_>,
) -> Result<f64, FieldError> {
    let cols = pixels.size[0] as f64;
    let own_mm = hints.pitch_mm.map(|pitch_mm| pitch_mm * (pixels.window_cols / cols));
    if let Some(pitch_mm) = flags.pitch_mm {
        if let Some(own_mm) = own_mm.filter(|own_mm| differ(*own_mm, pitch_mm)) {
            task.warn(
                place(path),
                format!("the light field's own pixel pitch, {own_mm:.4} mm, is replaced by {pitch_mm} mm (--pitch-mm)"),
            );
        }
        return Ok(pitch_mm);
    }
    if let Some(own_mm) = own_mm {
        return Ok(own_mm);
    }
    let width_mm = defaults.width_mm.ok_or_else(|| FieldError::MissingGeometry {
        path: path.into(),
        what: "the size of the pixels",
        flag: "--pitch-mm, for example --pitch-mm 0.5",
    })?;
    task.warn(
        place(path),
        format!("the physical size of the light field is unknown; a width of {width_mm:.2} mm is used (--pitch-mm sets another pitch)"),
    );
    Ok(width_mm / cols)
}

/// Returns the slopes along x and along y. Also returns true if the cameras' own slopes are used on
/// at least one axis.
fn slopes(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    hints: &Hints,
    views: [usize; 2],
    picks: &[Vec<usize>; 2],
    own_slopes: Option<[Vec<f64>; 2]>,
    task: Task<'_>,
) -> Result<([Vec<f64>; 2], bool), FieldError> {
    let counts = [picks[1].len(), picks[0].len()];
    // Angles in a flag are of the kept views, angles in a file are of all views of the file.
    let all = views.map(|count| (0..count).collect::<Vec<_>>());
    let spread_all = |fov_deg: [f64; 2]| -> Result<[Vec<f64>; 2], FieldError> {
        let slopes = spread(path, fov_deg, hints, &all)?;
        Ok([0, 1].map(|axis| picks[1 - axis].iter().map(|&view| slopes[axis][view]).collect()))
    };
    let spread = |fov_deg: [f64; 2]| spread(path, fov_deg, hints, picks);
    // Angles in the flags override all other angles. Warn if they differ from the files' angles.
    if let Some(fov_deg) = flags.fov_deg {
        let slopes = spread(fov_deg)?;
        let of_file = |axis: usize| {
            let all = hints.slopes[axis].as_ref()?;
            Some(picks[1 - axis].iter().map(|&view| all[view]).collect::<Vec<f64>>())
        };
        let own = of_file(0).zip(of_file(1)).map(|(x, y)| [x, y]);
        let own = own.or_else(|| hints.fov_deg.and_then(|fov_deg| spread_all(fov_deg).ok())).or(own_slopes);
        if let Some(own) = own {
            let pairs = || own.iter().flatten().zip(slopes.iter().flatten());
            if pairs().any(|(own, given)| differ(*own, *given)) {
                let [own_x, own_y] = own.each_ref().map(|slopes| full_angle_deg(slopes));
                let [x, y] = fov_deg;
                let message = format!(
                    "the full angles of the light field's views, {own_x:.1}° × {own_y:.1}°, are replaced by {x}° × {y}° (--fov)"
                );
                task.warn(place(path), message);
            }
        }
        return Ok((slopes, false));
    }
    // Without angles in the flags, use the slopes in the files, or else the full angles in the
    // files.
    let explicit = [0, 1].map(|axis| {
        let all = hints.slopes[axis].as_ref()?;
        Some(picks[1 - axis].iter().map(|&view| all[view]).collect::<Vec<f64>>())
    });
    if let [Some(slope_x), Some(slope_y)] = explicit {
        return Ok(([slope_x, slope_y], false));
    }
    let [given_x, given_y] = explicit;
    let filled = |fallback: [Vec<f64>; 2]| {
        let [x, y] = fallback;
        [given_x.clone().unwrap_or(x), given_y.clone().unwrap_or(y)]
    };
    if let Some(fov_deg) = hints.fov_deg {
        return Ok((filled(spread_all(fov_deg)?), false));
    }
    if counts == [1, 1] {
        return Ok((filled([vec![0.0], vec![0.0]]), false));
    }
    // If neither flags nor files state angles, use the default angles, with a warning. If there are
    // no default angles, use the cameras' own slopes.
    if let Some(fov_deg) = defaults.fov_deg {
        let [x, y] = fov_deg;
        let mut message = format!("the views are spread over {x}° × {y}° (--fov sets other angles)");
        if let Some(own) = &own_slopes {
            let own = own.each_ref().map(|slopes| full_angle_deg(slopes));
            message += &format!("; the cameras of the views were spread over {:.1}° × {:.1}°", own[0], own[1]);
        }
        task.warn(place(path), message);
        return Ok((filled(spread(fov_deg)?), false));
    }
    let missing = || FieldError::MissingGeometry {
        path: path.into(),
        what: "the full angle of the views",
        flag: "--fov, for example --fov 20x20",
    };
    own_slopes.map(|slopes| (filled(slopes), true)).ok_or_else(missing)
}

/// Spreads views over full angles: to the centres of equal bins, or in proportion to the cameras'
/// positions.
fn spread(path: &Path, fov_deg: [f64; 2], hints: &Hints, picks: &[Vec<usize>; 2]) -> Result<[Vec<f64>; 2], FieldError> {
    let counts = [picks[1].len(), picks[0].len()];
    let uniform = ViewGrid::uniform(Projection::Oblique, counts, fov_deg).map_err(FieldError::geometry(path))?;
    let Some(cameras) = &hints.cameras else {
        return Ok([uniform.slope_x, uniform.slope_y]);
    };
    Ok([0, 1].map(|axis| {
        let positions: Vec<f64> = picks[1 - axis].iter().map(|&view| cameras.positions[axis][view]).collect();
        let [first, .., last] = positions.as_slice() else { return vec![0.0; positions.len()] };
        let count = positions.len() as f64;
        let spacing = (last - first).abs() / (count - 1.0);
        let step = 2.0 / count * (0.5 * fov_deg[axis].to_radians()).tan();
        positions.iter().map(|position| (position - 0.5 * (first + last)) / spacing * step).collect()
    }))
}

/// Returns the slopes of the lines from the plane that is now z = 0 to the cameras. One step of the
/// cameras shifts content of this plane by k pixels relative to content at infinity. So the slope
/// of one step is k/f, with the focal length f in pixels. k/f is the sum of `slope_per_step` and
/// `focus_px` / f. `None` if the focal length is unknown, or if the plane is not in front of the
/// cameras.
fn physical_slopes(hints: &Hints, picks: &[Vec<usize>; 2], pixels: &Pixels) -> Option<[Vec<f64>; 2]> {
    let cameras = hints.cameras.as_ref()?;
    let per_step = cameras.slope_per_step + pixels.focus_px / cameras.focal_px?;
    (per_step > 0.0).then(|| {
        [0, 1].map(|axis| picks[1 - axis].iter().map(|&view| per_step * cameras.positions[axis][view]).collect())
    })
}

/// Returns true if two values, one of a flag and one of a file, differ by more than rounding.
fn differ(own: f64, given: f64) -> bool {
    (own - given).abs() > 1e-6 * own.abs().max(given.abs()) + 1e-9
}

/// Returns the full angle of the views, including half a bin past the first view and past the last
/// view; 0 for one view.
pub(crate) fn full_angle_deg(slopes: &[f64]) -> f64 {
    match slopes {
        [first, .., last] => {
            let count = slopes.len() as f64;
            2.0 * (0.5 * (last - first).abs() * count / (count - 1.0)).atan().to_degrees()
        }
        _ => 0.0,
    }
}

fn missing_distance(path: &Path) -> FieldError {
    FieldError::MissingGeometry {
        path: path.into(),
        what: "the viewing distance of the perspective views",
        flag: "--distance-mm, for example --distance-mm 600 (or --grid oblique)",
    }
}

pub(crate) fn place(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_are_even_and_centred() {
        assert_eq!(pick(9, 5), [0, 2, 4, 6, 8]);
        assert_eq!(pick(9, 3), [0, 4, 8]);
        assert_eq!(pick(9, 1), [4]);
        assert_eq!(pick(9, 4), [1, 3, 5, 7]);
        assert_eq!(pick(17, 7), [2, 4, 6, 8, 10, 12, 14]);
        assert_eq!(pick(5, 5), [0, 1, 2, 3, 4]);
        assert_eq!(pick(1, 1), [0]);
    }
}
