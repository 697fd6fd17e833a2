//! Our light-field folder: `lightfield.json` with the geometry of every view, and an OpenEXR
//! picture per view, usually of half floats.
//!
//! ```json
//! { "schema": "lumistack/lightfield", "version": 1, "linear": true,
//!   "axes": ["view_y", "view_x", "row", "col", "rgb"],
//!   "resolution": [cols, rows], "pitch_mm": 0.5, "projection": "perspective",
//!   "distance_mm": 600.0,
//!   "slope_x": [left, ..., right], "slope_y": [top, ..., bottom], "info": { },
//!   "views": [{ "file": "view_00_00.exr", "view": [view_y, view_x],
//!               "slope": [s_x, s_y], "eye_mm": [x, y, z] }] }
//! ```
//!
//! Slopes are tangents, x right, y up. `eye_mm` (perspective views only) is D·(s_x, s_y, 1), with D
//! = `distance_mm`. The index is written last, so a folder with an index is complete.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use exr::prelude::f16;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{FieldGeometry, LightField, Projection, ProjectionKind};
use lumistack_files::{Folder, Refusal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::assemble::{LARGEST, Reading, assemble};
use crate::cameras::PictureGrid;
use crate::geometry::{GeometryDefaults, GeometryFlags, GeometryJson};
use crate::index::{check_schema, parse_json, read_index, write_json};
use crate::picture::{Precision, write_exr};
use crate::source::{Kind, Source};
use crate::{FieldError, atomic};

/// Name of the index in a light field's folder.
pub(crate) const INDEX: &str = "lightfield.json";
const SCHEMA: &str = "lumistack/lightfield";
const VERSION: u32 = 1;
/// Largest difference between the slope in a view's entry and the slope of the view's row and
/// column.
const SLOPE_TOLERANCE: f64 = 1e-6;
/// Largest plausible number of views along an axis. An index with more views is regarded as
/// damaged.
const VIEW_LIMIT: usize = 1 << 14;

#[derive(Serialize)]
struct Index<'a> {
    schema: &'a str,
    version: u32,
    axes: [&'a str; 5],
    linear: bool,
    resolution: [usize; 2],
    pitch_mm: f64,
    projection: ProjectionKind,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance_mm: Option<f64>,
    slope_x: &'a [f64],
    slope_y: &'a [f64],
    /// True if the folder lacks some of the views that the slopes define.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    partial: bool,
    info: &'a Map<String, Value>,
    views: Vec<ViewEntry>,
}

#[derive(Serialize, Deserialize)]
struct ViewEntry {
    file: String,
    view: [usize; 2],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    slope: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    eye_mm: Option<[f64; 3]>,
}

/// Keys of the index in addition to the keys of [`GeometryJson`].
#[derive(Deserialize)]
struct Listing {
    schema: String,
    version: u32,
    resolution: [usize; 2],
    views: Vec<ViewEntry>,
    #[serde(default)]
    partial: bool,
    #[serde(default)]
    info: Map<String, Value>,
}

/// Rounds every value to the nearest half float, as the folder of a light field stores it. So a
/// factorization of the light field in memory uses the same values as one that reads its folder.
pub fn round_to_half(values: &mut [f32]) {
    for value in values {
        *value = f16::from_f32(value.clamp(-LARGEST, LARGEST)).to_f32();
    }
}

/// Returns the name of a view's file: `view_YY_XX.exr`, with more digits for more than 100 views
/// along an axis.
pub fn view_file_name(views: [usize; 2], view: [usize; 2]) -> String {
    let digits = (views[0].max(views[1]).saturating_sub(1)).to_string().len().max(2);
    format!("view_{:0digits$}_{:0digits$}.exr", view[0], view[1])
}

/// Writes a light field into a folder, which is created if missing. `info` is copied into the
/// index.
///
/// # Errors
/// If a value is not finite or its magnitude is above 65504, or the files cannot be written.
pub fn write_field(folder: &Path, field: &LightField, info: &Map<String, Value>) -> Result<(), FieldError> {
    atomic::create_folder(folder)?;
    atomic::remove(&folder.join(INDEX))?;
    let views: Vec<[usize; 2]> = field.geometry().grid.iter().collect();
    // write views in parallel, since their compression takes longer than writing
    views.par_iter().try_for_each(|&view| write_view(folder, field.geometry(), view, field.view(view)))?;
    write_index(folder, field.geometry(), info)
}

/// Writes one view, `[row][col][rgb]`, into an existing folder, for views that are rendered one by
/// one.
///
/// # Errors
/// If a value is not finite or its magnitude is above 65504, or the file cannot be written.
///
/// # Panics
/// If `rgb` has another length than the geometry requires.
pub fn write_view(folder: &Path, geometry: &FieldGeometry, view: [usize; 2], rgb: &[f32]) -> Result<(), FieldError> {
    write_view_as(folder, geometry, view, rgb, Precision::Half)
}

fn write_view_as(
    folder: &Path,
    geometry: &FieldGeometry,
    view: [usize; 2],
    rgb: &[f32],
    precision: Precision,
) -> Result<(), FieldError> {
    let path = folder.join(view_file_name(geometry.grid.views(), view));
    // A larger value would become infinite as a half float, and such a file cannot be read.
    let (most, expected) = match precision {
        Precision::Half => (LARGEST, "a finite number of at most 65504, the largest half float"),
        Precision::Float => (f32::MAX, "a finite number"),
    };
    if let Some(index) = rgb.iter().position(|value| value.is_nan() || value.abs() > most) {
        let (row, col) = (index / 3 / geometry.cols, index / 3 % geometry.cols);
        let place = format!("[row, col, rgb] = [{row}, {col}, {}]", index % 3);
        return Err(FieldError::malformed(path, place, expected, rgb[index].to_string()));
    }
    write_exr(&path, [geometry.cols, geometry.rows], rgb, precision)
}

/// Writes a subset of the views, as [`write_field`] does but with the given precision. `views`
/// lists each view [view_y, view_x] once. Files have the same names as in the folder of the whole
/// field.
///
/// If `views` holds every combination of some view rows and some view columns, the result is a
/// complete light field. Its index has the slopes of these rows and columns only. If some rows or
/// columns are missing, `info.part_of` lists the selected rows and columns, and has the numbers of
/// view rows and view columns of the whole field. For another selection, the index has the slopes
/// of all views and `"partial": true`, and readers refuse the folder.
///
/// # Errors
/// If a value is not finite, or the files cannot be written. With [`Precision::Half`] also if the
/// magnitude of a value is above 65504.
pub fn write_views(
    folder: &Path,
    field: &LightField,
    views: &[[usize; 2]],
    precision: Precision,
    info: &Map<String, Value>,
) -> Result<(), FieldError> {
    let geometry = field.geometry();
    atomic::create_folder(folder)?;
    // Remove the index first: readers refuse a folder without an index, so an interrupted write
    // leaves no light field that seems complete.
    atomic::remove(&folder.join(INDEX))?;
    for &view in views {
        write_view_as(folder, geometry, view, field.view(view), precision)?;
    }
    let all = geometry.grid.views();
    if views.len() == all[0] * all[1] {
        return write_index(folder, geometry, info);
    }
    // All combinations of some rows and columns form a complete light field. Other selections are
    // marked partial.
    let of_axis = |axis: usize| views.iter().map(|view| view[axis]).collect::<BTreeSet<_>>().into_iter().collect();
    let [rows, cols]: [Vec<usize>; 2] = [of_axis(0), of_axis(1)];
    let is_grid = rows.len() * cols.len() == views.len();
    let mut info = info.clone();
    let mut part = geometry.clone();
    if is_grid {
        part.grid.slope_x = cols.iter().map(|&col| geometry.grid.slope_x[col]).collect();
        part.grid.slope_y = rows.iter().map(|&row| geometry.grid.slope_y[row]).collect();
        info.insert("part_of".into(), serde_json::json!({ "views": all, "rows": rows, "columns": cols }));
    }
    let place = |axis: &[usize], index: usize| axis.iter().position(|&kept| kept == index).unwrap_or_default();
    let entries = views.iter().map(|&view| {
        let within = if is_grid { [place(&rows, view[0]), place(&cols, view[1])] } else { view };
        (within, view_file_name(all, view))
    });
    write_index_of(folder, &part, entries, !is_grid, &info)
}

/// Writes the index of a folder whose views are complete.
///
/// # Errors
/// If the file cannot be written.
pub fn write_index(folder: &Path, geometry: &FieldGeometry, info: &Map<String, Value>) -> Result<(), FieldError> {
    let views = geometry.grid.views();
    let entries = geometry.grid.iter().map(|view| (view, view_file_name(views, view)));
    write_index_of(folder, geometry, entries, false, info)
}

/// Writes the index of a folder: the views of a geometry, and the file of each.
fn write_index_of(
    folder: &Path,
    geometry: &FieldGeometry,
    entries: impl Iterator<Item = ([usize; 2], String)>,
    partial: bool,
    info: &Map<String, Value>,
) -> Result<(), FieldError> {
    let grid = &geometry.grid;
    let distance_mm = match grid.projection {
        Projection::Oblique => None,
        Projection::Perspective { distance_mm } => Some(distance_mm),
    };
    // Each entry repeats its slope and eye position, for readers that do not interpret the grid.
    let entry = |(view, file): ([usize; 2], String)| {
        let slope = [grid.slope_x[view[1]], grid.slope_y[view[0]]];
        ViewEntry {
            file,
            view,
            slope: Some(slope),
            eye_mm: distance_mm.map(|distance| [slope[0] * distance, slope[1] * distance, distance]),
        }
    };
    let index = Index {
        schema: SCHEMA,
        version: VERSION,
        axes: LightField::AXES,
        linear: true,
        resolution: [geometry.cols, geometry.rows],
        pitch_mm: geometry.pitch_mm,
        projection: if distance_mm.is_some() { ProjectionKind::Perspective } else { ProjectionKind::Oblique },
        distance_mm,
        slope_x: &grid.slope_x,
        slope_y: &grid.slope_y,
        partial,
        info,
        views: entries.map(entry).collect(),
    };
    write_json(&folder.join(INDEX), &index)
}

/// Reads the folder of a light field, and `info` of its index.
///
/// # Errors
/// If the index is malformed, or a view is missing, damaged or of another size. Also if a value is
/// not finite or its magnitude is above 65504.
pub fn read_field_folder(folder: &Path) -> Result<(LightField, Map<String, Value>), FieldError> {
    let mut source = source(folder)?;
    let info = std::mem::take(&mut source.info);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let (flags, defaults) = (GeometryFlags::default(), GeometryDefaults::default());
    let (field, _) = assemble(&mut source, &flags, &defaults, Reading::default(), task)?;
    Ok((field, info))
}

/// Reads a region, some rows and columns of pixels, of all views of a light field's folder.
/// `geometry` is the geometry of the result. Besides the result, only one view is in memory.
///
/// # Errors
/// The errors of [`read_field_folder`], except errors of values, which are not checked. Also if the
/// folder has another number of views than the geometry, or fewer pixels than the region.
pub fn read_field_region(
    folder: &Path,
    geometry: FieldGeometry,
    rows: Range<usize>,
    cols: Range<usize>,
) -> Result<LightField, FieldError> {
    let mut source = source(folder)?;
    let (views, [width, height]) = (geometry.grid.views(), source.size);
    if source.views != views || rows.end > height || cols.end > width {
        let text = |[down, across]: [usize; 2], least: &str, [width, height]: [usize; 2]| {
            format!("{across} × {down} views of {least}{width} × {height} pixels")
        };
        let expected = text(views, "at least ", [cols.end, rows.end]);
        let found = text(source.views, "", source.size);
        return Err(FieldError::malformed(folder.join(INDEX), "size", expected, found));
    }
    let bad = |error: lumistack_display::GridError| {
        FieldError::malformed(folder.join(INDEX), error.what, error.expected, error.found)
    };
    let mut field = LightField::black(geometry).map_err(bad)?;
    for view in (0..views[0]).flat_map(|y| (0..views[1]).map(move |x| [y, x])) {
        let picture = source.reader.load(view)?;
        let lines = field.view_mut(view).chunks_exact_mut(3 * cols.len());
        for (line, row) in lines.zip(rows.clone()) {
            line.copy_from_slice(&picture[3 * (row * width + cols.start)..][..3 * cols.len()]);
        }
    }
    Ok(field)
}

/// Opens a light field's folder without reading its pictures.
pub(crate) fn source(folder: &Path) -> Result<Source, FieldError> {
    let path = folder.join(INDEX);
    let text = read_index(&path)?;
    let listing: Listing = parse_json(&path, &text)?;
    let geometry: GeometryJson = parse_json(&path, &text)?;
    check_schema(&path, &listing.schema, SCHEMA, listing.version, VERSION)?;
    if geometry.linear == Some(false) {
        return Err(FieldError::malformed(&path, "linear", "true", "false"));
    }
    // Refuse partial folders, which are not light fields.
    if listing.partial {
        let count = |slopes: &Option<Vec<f64>>| slopes.as_ref().map_or(0, Vec::len);
        let all = count(&geometry.slope_y) * count(&geometry.slope_x);
        let expected = "all views, or whole rows and columns of views (`lumistack render` without --only-views renders the missing views)";
        return Err(FieldError::malformed(&path, "views", expected, format!("{} of {all} views", listing.views.len())));
    }
    // Check required keys and plausible counts before files are opened.
    let missing = |key: &str| FieldError::malformed(&path, key, "a value", "none");
    let slope_x = geometry.slope_x.clone().ok_or_else(|| missing("slope_x"))?;
    let slope_y = geometry.slope_y.clone().ok_or_else(|| missing("slope_y"))?;
    geometry.pitch_mm.ok_or_else(|| missing("pitch_mm"))?;
    let kind = geometry.projection.ok_or_else(|| missing("projection"))?;
    if kind == ProjectionKind::Perspective && geometry.distance_mm.is_none() {
        return Err(missing("distance_mm"));
    }
    let views = [slope_y.len(), slope_x.len()];
    if views.iter().any(|count| !(1..=VIEW_LIMIT).contains(count)) {
        let found = format!("{} × {}", views[1], views[0]);
        return Err(FieldError::malformed(
            &path,
            "slope_x, slope_y",
            format!("1 to {VIEW_LIMIT} views per axis"),
            found,
        ));
    }
    let distance_mm = geometry.distance_mm;
    // Check the listed files against the slopes, and the size of the pictures against the index
    // file.
    let files = listed_files(folder, &path, &listing.views, &slope_x, &slope_y, distance_mm)?;
    let reader = PictureGrid::new(files, views)?;
    let size = reader.size();
    if size != listing.resolution {
        let expected = format!("{} × {} as in {INDEX}", listing.resolution[0], listing.resolution[1]);
        let place = reader.first_file().to_path_buf();
        return Err(FieldError::malformed(place, "size", expected, format!("{} × {}", size[0], size[1])));
    }
    Ok(Source {
        kind: Kind::Folder,
        path: folder.to_path_buf(),
        views,
        size,
        hints: geometry.into_hints(&path, views)?,
        info: listing.info,
        reader: Box::new(reader),
    })
}

/// Checks the entries of the index. Returns the files of all views, row by row.
fn listed_files(
    folder: &Path,
    index: &Path,
    entries: &[ViewEntry],
    slope_x: &[f64],
    slope_y: &[f64],
    distance_mm: Option<f64>,
) -> Result<Vec<PathBuf>, FieldError> {
    let [rows, cols] = [slope_y.len(), slope_x.len()];
    if entries.len() != rows * cols {
        let expected = format!("{cols} × {rows} views, one for each pair of slopes (x, y)");
        return Err(FieldError::malformed(index, "views", expected, entries.len().to_string()));
    }
    let inside = Folder::around(index).map_err(FieldError::io(index, "read"))?;
    let mut files = vec![None; rows * cols];
    for (i, entry) in entries.iter().enumerate() {
        let bad = |key: &str, expected: String, found: String| {
            Err(FieldError::malformed(index, format!("views[{i}].{key}"), expected, found))
        };
        let [view_y, view_x] = entry.view;
        if view_y >= rows || view_x >= cols {
            return bad(
                "view",
                format!("a view [view_y, view_x] with view_y below {rows} and view_x below {cols}"),
                format!("{:?}", entry.view),
            );
        }
        let expected = [slope_x[view_x], slope_y[view_y]];
        let from_eye = entry.eye_mm.zip(distance_mm).map(|(eye, distance)| [eye[0] / distance, eye[1] / distance]);
        for (key, own) in [("slope", entry.slope), ("eye_mm", from_eye)] {
            if let Some(own) = own
                && !own.iter().zip(expected).all(|(own, slope)| (own - slope).abs() <= SLOPE_TOLERANCE)
            {
                return bad(key, format!("slope {expected:?}, as in slope_x and slope_y"), format!("{own:?}"));
            }
        }
        let name = Path::new(&entry.file);
        let plain = name.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        if !plain || entry.file.is_empty() {
            return bad("file", "a name inside the folder".into(), entry.file.clone());
        }
        // A link that leads outside of the folder is an error. A missing file is an error only when
        // it is read.
        if let Err(refusal @ Refusal::Outside { .. }) = inside.resolve(name) {
            return bad("file", "a name inside the folder".into(), format!("{}: {refusal}", entry.file));
        }
        let slot = &mut files[view_y * cols + view_x];
        if slot.is_some() {
            return bad("view", "each view once".into(), format!("[{view_y}, {view_x}] again"));
        }
        *slot = Some(folder.join(name));
    }
    Ok(files.into_iter().flatten().collect())
}
