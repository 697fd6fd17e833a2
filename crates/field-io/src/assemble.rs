//! Assembles a light field in memory or in a file from a source. Views are selected, focused,
//! cropped and reduced, and their values are checked.
//!
//! Let a camera be at position (x, y), in steps to the right and up. Relative to the central
//! camera, this camera sees content of disparity k (pixels per step) k·x pixels further left and
//! k·y pixels lower. That content moves to z = 0 if pixel (column c, row r) of this camera's view
//! is read at column c − k·x and row r + k·y. The result is the rectangle of pixels that exist in
//! all kept views, possibly cropped to the aspect of [`GeometryFlags::resolution`].

use std::collections::BTreeSet;
use std::path::Path;

use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, LightField, ViewGrid};

use crate::FieldError;
use crate::disparity::{self, Motion};
use crate::geometry::{self, GeometryDefaults, GeometryFlags, Pixels, pick};
use crate::npy::reserved;
use crate::paged::FieldWriter;
use crate::prefilter::{self, Footprint, Shares};
use crate::resample::{Rect, area};
use crate::source::Source;

/// Largest accepted value: the largest half float.
pub(crate) const LARGEST: f32 = 65504.0;
/// Negative values become 0. Only values below this limit cause a warning, since the pixel filters
/// of renderers overshoot slightly.
const OVERSHOOT: f32 = -1e-3;
/// Pixels are regarded as square if their width and height differ by less than this fraction.
const SQUARE: f64 = 0.01;
/// Smallest disparity at which content is moved to z = 0, in pixels per step. The 10th and the 90th
/// percentile of the disparities must have one sign, and magnitudes of at least this size.
const STILL_PX: f64 = 0.5;

/// A view of the source that is not kept, and lies between two kept ones.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// Direction of the view, as a grid that has only this view.
    pub grid: ViewGrid,
    /// Linear radiance, `[row][col][rgb]`, with as many rows and columns as a kept view.
    pub radiance: Vec<f32>,
}

/// Options of reading a light field.
#[derive(Clone, Copy, Default)]
pub struct Reading<'a> {
    /// The display's footprint. Required only if [`GeometryFlags::prefilter`] is set.
    pub footprint: Option<Footprint<'a>>,
    /// Largest number of other views, between the kept views, that are also read.
    pub most_left_out: usize,
    /// Decides whether the light field is kept in a file. `None` keeps every light field in memory.
    pub paging: Option<Paging<'a>>,
    /// Function that changes every view, `[row][col][rgb]`, after it is read.
    pub change: Option<&'a dyn Fn(&mut [f32])>,
}

/// A function that returns the folder for a light field's file, and the number of the file's bytes
/// that may be in memory. The result `None` keeps the light field in memory.
pub type Paging<'a> = &'a dyn Fn(&FieldGeometry) -> Option<(&'a Path, usize)>;

/// The parts of a source to read, and their geometry.
pub(crate) struct Plan {
    /// Indices of the kept views in the source: view rows, then view columns.
    picks: [Vec<usize>; 2],
    window: Window,
    pub(crate) geometry: FieldGeometry,
}

pub(crate) fn plan(
    source: &mut Source,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    task: Task<'_>,
) -> Result<Plan, FieldError> {
    let path = source.path.clone();
    let picks = picks(source, flags)?;
    let focus_px = match flags.focus_px {
        Some(focus_px) if !focus_px.is_finite() => {
            return Err(FieldError::malformed(&path, "--focus-px", "a finite number", focus_px.to_string()));
        }
        Some(focus_px) => focus_px,
        None => find_focus(source, task)?,
    };
    let window = Window::new(source, flags, &picks, focus_px)?;
    let pixels = Pixels { size: window.out_size, window_cols: window.size[0], focus_px };
    let geometry = geometry::resolve(&path, flags, defaults, &source.hints, source.views, &picks, &pixels, task)?;
    Ok(Plan { picks, window, geometry })
}

pub(crate) fn assemble(
    source: &mut Source,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    reading: Reading<'_>,
    task: Task<'_>,
) -> Result<(LightField, Vec<LeftOut>), FieldError> {
    let path = source.path.clone();
    let Plan { picks, window, geometry } = plan(source, flags, defaults, task)?;
    let averaged = averaged(source, flags, reading.footprint, &picks, &window, &geometry, task)?;
    let shape = LightField::shape_of(&geometry);
    let count = Tensor::element_count(shape).ok_or_else(|| {
        FieldError::malformed(&path, "size", "a light field that fits in memory", format!("the shape {shape:?}"))
    })?;
    // Reserve memory or begin a file for the result, and read views one at a time.
    let place = reading.paging.and_then(|paging| paging(&geometry));
    let mut all = match place {
        // Only reserve memory, since a header may claim any size. The system provides the pages
        // when values arrive.
        None => FieldWriter::Held { geometry: geometry.clone(), values: reserved(&path, count)? },
        Some(_) => FieldWriter::begin(geometry.clone(), place)?,
    };
    let length = count / (shape[0] * shape[1]);
    let mut range = Range::default();
    let change = |view: &mut [f32]| reading.change.into_iter().for_each(|change| change(view));
    let (mut part, mut one) = (Vec::new(), Vec::new());
    let others = left_out(source, &picks, &geometry, reading.most_left_out);
    task.progress.begin("read views", (shape[0] * shape[1] + others.len()) as u64, "views");
    for index in 0..shape[0] * shape[1] {
        task.cancel.check()?;
        part.clear();
        let [of_row, of_col] = [&averaged[0][index / shape[1]], &averaged[1][index % shape[1]]];
        let views: Vec<([usize; 2], f32)> =
            of_row.iter().flat_map(|y| of_col.iter().map(move |x| ([y.0, x.0], y.1 * x.1))).collect();
        for (view, share) in &views {
            let mut values = source.reader.load(*view)?;
            check_values(source, *view, &mut values, &mut range)?;
            part.resize(length, 0.0);
            if views.len() == 1 {
                area(&values, source.size, window.rect(*view), window.out_size, &mut part);
                continue;
            }
            one.resize(length, 0.0);
            area(&values, source.size, window.rect(*view), window.out_size, &mut one);
            part.iter_mut().zip(&one).for_each(|(sum, value)| *sum += share * value);
        }
        change(&mut part);
        all.write(&part)?;
        task.progress.advance(1, "");
    }
    // Read the left-out views between the kept ones, in the same geometry.
    let mut left_out = Vec::with_capacity(others.len());
    for (view, grid) in others {
        task.cancel.check()?;
        let mut values = source.reader.load(view)?;
        check_values(source, view, &mut values, &mut range)?;
        let mut radiance = vec![0.0; length];
        area(&values, source.size, window.rect(view), window.out_size, &mut radiance);
        change(&mut radiance);
        left_out.push(LeftOut { grid, radiance });
        task.progress.advance(1, "");
    }
    task.progress.end();
    range.warn(&path, task);
    Ok((all.finish(&path)?, left_out))
}

/// Returns up to `most` evenly spread views between the kept views, with their slopes.
fn left_out(
    source: &Source,
    picks: &[Vec<usize>; 2],
    geometry: &FieldGeometry,
    most: usize,
) -> Vec<([usize; 2], ViewGrid)> {
    let grid = &geometry.grid;
    let positions = positions(source);
    // along each axis, list the views that are kept or lie between two kept ones, with their slopes
    let along = |axis: usize, slopes: &[f64]| -> Vec<(usize, f64)> {
        let (kept, positions) = (&picks[1 - axis], &positions[axis]);
        let mut found = vec![(kept[0], slopes[0])];
        for (kept, slopes) in kept.windows(2).zip(slopes.windows(2)) {
            let [first, last] = [positions[kept[0]], positions[kept[1]]];
            found.extend((kept[0] + 1..=kept[1]).map(|view| {
                let share = (positions[view] - first) / (last - first);
                (view, slopes[0] + share * (slopes[1] - slopes[0]))
            }));
        }
        found
    };
    let [cols, rows] = [along(0, &grid.slope_x), along(1, &grid.slope_y)];
    let mut all: Vec<([usize; 2], ViewGrid)> = Vec::new();
    for (row, slope_y) in &rows {
        for (col, slope_x) in cols.iter().filter(|(col, _)| !(picks[0].contains(row) && picks[1].contains(col))) {
            all.push(([*row, *col], ViewGrid::single(grid.projection, [*slope_x, *slope_y])));
        }
    }
    // choose `most` of the views: multiples of the golden ratio, modulo 1, are evenly spread
    let mut order: Vec<(f64, usize)> = (0..all.len()).map(|i| ((i as f64 * GOLDEN).fract(), i)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.truncate(most);
    order.sort_by_key(|(_, i)| *i);
    order.into_iter().map(|(_, i)| all[i].clone()).collect()
}

/// The golden ratio's fraction, (√5 − 1)/2.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Returns the views that are averaged into every kept view, with their weights. The first list has
/// an entry for every kept view row, and the second list has an entry for every kept view column.
fn averaged(
    source: &Source,
    flags: &GeometryFlags,
    footprint: Option<Footprint<'_>>,
    picks: &[Vec<usize>; 2],
    window: &Window,
    geometry: &FieldGeometry,
    task: Task<'_>,
) -> Result<[Shares; 2], FieldError> {
    let alone = [0, 1].map(|axis| prefilter::alone(&picks[axis]));
    if !flags.prefilter {
        return Ok(alone);
    }
    let Some(footprint) = footprint else {
        return Err(FieldError::malformed(
            &source.path,
            "--prefilter",
            "a display, whose prefilter is applied",
            "none",
        ));
    };
    let (width, positions) = (footprint(geometry), positions(source));
    let along = |axis: usize, slopes: &[f64]| {
        let mut shares = prefilter::shares(slopes, &picks[1 - axis], &positions[axis], width[axis]);
        for list in &mut shares {
            // exclude a view if its window extends past the border of its picture
            let room = source.size[axis] as f64 - window.size[axis] + 1e-6;
            list.retain(|(view, _)| (-1e-6..=room).contains(&(window.corner[axis] + window.shift[axis][*view])));
            let sum: f32 = list.iter().map(|(_, share)| share).sum();
            list.iter_mut().for_each(|(_, share)| *share /= sum);
        }
        shares
    };
    let shares = [along(1, &geometry.grid.slope_y), along(0, &geometry.grid.slope_x)];
    if shares == alone {
        let message = "the prefilter changes nothing, since the views are too far apart for the display";
        task.warn(geometry::place(&source.path), message);
    }
    Ok(shares)
}

fn picks(source: &Source, flags: &GeometryFlags) -> Result<[Vec<usize>; 2], FieldError> {
    let [rows, cols] = source.views;
    let [kept_cols, kept_rows] = flags.views.unwrap_or([cols, rows]);
    if !(1..=cols).contains(&kept_cols) || !(1..=rows).contains(&kept_rows) {
        let expected = format!("1 × 1 to {cols} × {rows} views (the light field has no more)");
        return Err(FieldError::malformed(&source.path, "--views", expected, format!("{kept_cols} × {kept_rows}")));
    }
    Ok([pick(rows, kept_rows), pick(cols, kept_cols)])
}

/// The rectangle of pixels that is read from every view.
struct Window {
    corner: [f64; 2],
    size: [f64; 2],
    out_size: [usize; 2],
    /// Offset of `corner` in each view: x for each view column in `shift[0]`, y for each view row
    /// in `shift[1]`, in pixels.
    shift: [Vec<f64>; 2],
}

impl Window {
    fn new(source: &Source, flags: &GeometryFlags, picks: &[Vec<usize>; 2], focus_px: f64) -> Result<Self, FieldError> {
        let positions = positions(source);
        let mut window = Self { corner: [0.0; 2], size: [0.0; 2], out_size: source.size, shift: [vec![], vec![]] };
        for axis in 0..2 {
            let sign = [-1.0, 1.0][axis];
            window.shift[axis] = positions[axis].iter().map(|position| sign * focus_px * position).collect();
            let kept = picks[1 - axis].iter().map(|&view| window.shift[axis][view]);
            let low = kept.clone().fold(f64::INFINITY, f64::min);
            let high = kept.fold(f64::NEG_INFINITY, f64::max);
            window.corner[axis] = -low;
            window.size[axis] = (source.size[axis] as f64 - (high - low)).floor();
            if window.size[axis] < 1.0 {
                let expected = "a disparity at which all views have some pixels in common";
                return Err(FieldError::malformed(&source.path, "--focus-px", expected, focus_px.to_string()));
            }
        }
        let tile_aspect = source.size[0] as f64 / source.size[1] as f64;
        let pixel_aspect = source.hints.view_aspect.map_or(1.0, |aspect| aspect / tile_aspect);
        window.fit(source, flags.resolution, pixel_aspect)?;
        Ok(window)
    }

    /// Chooses the size of the result so that its pixels are square. With `resolution`, crops the
    /// rectangle to the aspect of `resolution`. `pixel_aspect` is the width of a file's pixel
    /// divided by its height.
    fn fit(&mut self, source: &Source, resolution: Option<[usize; 2]>, pixel_aspect: f64) -> Result<(), FieldError> {
        let pixel_aspect = if (pixel_aspect - 1.0).abs() < SQUARE { 1.0 } else { pixel_aspect };
        let rounded = |length: f64| (length.round() as usize).max(1);
        let Some([cols, rows]) = resolution else {
            self.out_size = [self.size[0] as usize, self.size[1] as usize];
            if pixel_aspect > 1.0 {
                self.out_size[1] = rounded(self.size[1] / pixel_aspect);
            } else if pixel_aspect < 1.0 {
                self.out_size[0] = rounded(self.size[0] * pixel_aspect);
            }
            return Ok(());
        };
        if cols == 0 || rows == 0 || cols as f64 > self.size[0] || rows as f64 > self.size[1] {
            let expected = format!("1 × 1 to {} × {} pixels, since views are not enlarged", self.size[0], self.size[1]);
            return Err(FieldError::malformed(&source.path, "--resolution", expected, format!("{cols} × {rows}")));
        }
        let wanted = cols as f64 / rows as f64;
        let aspect = self.size[0] * pixel_aspect / self.size[1];
        let axis = usize::from(aspect < wanted);
        let cropped =
            if axis == 0 { self.size[1] * wanted / pixel_aspect } else { self.size[0] * pixel_aspect / wanted };
        // a rounding error must not crop a picture of the right aspect
        let cropped = if (cropped - self.size[axis]).abs() < 1e-6 { self.size[axis] } else { cropped };
        self.corner[axis] += 0.5 * (self.size[axis] - cropped);
        self.size[axis] = cropped;
        self.out_size = [cols, rows];
        Ok(())
    }

    fn rect(&self, [view_y, view_x]: [usize; 2]) -> Rect {
        let shift = [self.shift[0][view_x], self.shift[1][view_y]];
        Rect { corner: [self.corner[0] + shift[0], self.corner[1] + shift[1]], size: self.size }
    }
}

/// Returns the positions of view columns (x, right) and view rows (y, up) relative to the centre,
/// in steps.
fn positions(source: &Source) -> [Vec<f64>; 2] {
    if let Some(cameras) = &source.hints.cameras {
        return cameras.positions.clone();
    }
    let centred =
        |count: usize, sign: f64| (0..count).map(|i| sign * (i as f64 - (count as f64 - 1.0) / 2.0)).collect();
    [centred(source.views[1], 1.0), centred(source.views[0], -1.0)]
}

/// Returns the disparity of the plane that becomes z = 0, for pictures whose plane of zero
/// disparity is unknown. If nearly all content moves in one direction (see [`STILL_PX`]), the
/// result is the median disparity, rounded to whole pixels; otherwise it is 0.
fn find_focus(source: &mut Source, task: Task<'_>) -> Result<f64, FieldError> {
    if !source.hints.cameras.as_ref().is_some_and(|cameras| cameras.plane_unknown) {
        return Ok(0.0);
    }
    let Some(Motion { low, median, high }) = disparity_per_step(source)? else { return Ok(0.0) };
    if low < STILL_PX && high > -STILL_PX {
        return Ok(0.0);
    }
    let focus_px = median.round();
    let mut message = format!(
        "no content is at zero disparity: from view to view, content moves by {low:.1} to {high:.1} pixels. So content with a disparity of {focus_px} pixels is moved to z = 0 (--focus-px sets another disparity)"
    );
    if median < 0.0 {
        message += "; content moves in the direction of the camera's movement. If the scene looks inside out, the views are in reverse order (--mirror reverses the order again)";
    }
    task.warn(geometry::place(&source.path), message);
    Ok(focus_px)
}

/// Returns the disparity between the two central views: the shift of content to the left (or down)
/// while the viewpoint moves one step to the right (or up). `None` for a single view, or if
/// [`disparity::motion`] finds no motion.
fn disparity_per_step(source: &mut Source) -> Result<Option<Motion>, FieldError> {
    let positions = positions(source);
    let [rows, cols] = source.views;
    let middle = [rows / 2, cols / 2];
    let (axis, other) = if cols > 1 {
        (0, [middle[0], middle[1] - 1])
    } else if rows > 1 {
        (1, [middle[0] - 1, middle[1]])
    } else {
        return Ok(None);
    };
    let first = source.reader.load(other)?;
    let second = source.reader.load(middle)?;
    let index = 1 - axis;
    let step = (positions[axis][middle[index]] - positions[axis][other[index]]).abs();
    let motion = disparity::motion(&first, &second, source.size, axis);
    Ok(motion.map(|m| Motion { low: -m.high / step, median: -m.median / step, high: -m.low / step }))
}

/// Number of values below [`OVERSHOOT`], and the lowest value, for a single warning.
#[derive(Default)]
struct Range {
    /// The counted views, since a prefilter reads views more than once.
    views: BTreeSet<[usize; 2]>,
    negative: usize,
    lowest: f32,
}

impl Range {
    fn warn(&self, path: &Path, task: Task<'_>) {
        if self.negative > 0 {
            let (count, lowest) = (self.negative, self.lowest);
            task.warn(
                geometry::place(path),
                format!(
                    "values below {OVERSHOOT} are set to 0 (number of these values: {count}; lowest value: {lowest})"
                ),
            );
        }
    }
}

/// Refuses values that are not finite or too large, and sets negative values to 0. `range` counts
/// the values for the warning.
fn check_values(
    source: &Source,
    [view_y, view_x]: [usize; 2],
    values: &mut [f32],
    range: &mut Range,
) -> Result<(), FieldError> {
    let is_new = range.views.insert([view_y, view_x]);
    for (index, value) in values.iter_mut().enumerate() {
        if (0.0..=1.0).contains(value) {
            continue;
        }
        if !value.is_finite() || *value > LARGEST || *value < -LARGEST {
            let (pixel, rgb) = (index / 3, index % 3);
            let (row, col) = (pixel / source.size[0], pixel % source.size[0]);
            let place = format!("[view_y, view_x, row, col, rgb] = [{view_y}, {view_x}, {row}, {col}, {rgb}]");
            let expected = format!("a number from 0 to {LARGEST}");
            let file = source.reader.file([view_y, view_x]);
            return Err(FieldError::malformed(file, place, expected, value.to_string()));
        }
        if *value < 0.0 {
            range.negative += usize::from(is_new && *value < OVERSHOOT);
            range.lowest = range.lowest.min(*value);
            *value = 0.0;
        }
    }
    Ok(())
}
