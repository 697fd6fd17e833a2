//! Simulates every view once: its error, and the pictures that the page compares.

use lumistack_core::Task;
use lumistack_core::metrics::SquaredError;
use lumistack_display::forward::{EmittedView, simulate};
use lumistack_display::{FieldGeometry, LightField, RayMap, ViewGrid, Weights, view_error};

use crate::picture::{self, Embedded, Encoding, Linear, Picture};
use crate::{ReportError, ReportInput, format};

/// Errors of a light field's views.
#[derive(Clone, Debug)]
pub(crate) struct FieldScore {
    pub(crate) geometry: FieldGeometry,
    /// Row by row, L̃/β against L.
    errors: Vec<SquaredError>,
    brightness: f64,
}

/// Target, simulated and difference of one view.
#[derive(Clone, Debug)]
pub(crate) struct Comparison {
    /// "Top left view".
    pub(crate) title: String,
    /// "seen from −8.0° across, +8.0° up".
    pub(crate) direction: String,
    /// Absent where no target exists.
    pub(crate) psnr: Option<f64>,
    pub(crate) counted_share: f64,
    pub(crate) target: Option<Embedded>,
    pub(crate) simulated: Embedded,
    pub(crate) difference: Option<Embedded>,
    /// Of the difference.
    pub(crate) amplification: u32,
}

/// All target views in one picture, topmost row and leftmost column first, and the same of the simulated ones.
#[derive(Clone, Debug)]
pub(crate) struct Sheets {
    pub(crate) target: Embedded,
    pub(crate) simulated: Embedded,
    /// Directions of its columns, left to right.
    pub(crate) across: Vec<String>,
    /// Directions of its rows, top to bottom.
    pub(crate) up: Vec<String>,
}

/// What the report knows about the views.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    pub(crate) target: FieldScore,
    pub(crate) held_out: Option<FieldScore>,
    /// The central view, large.
    pub(crate) headline: Comparison,
    /// Centre, corners, worst, in-between.
    pub(crate) rows: Vec<Comparison>,
    /// Factor by which the pictures of `rows` are smaller than the views.
    pub(crate) rows_shrunk: usize,
    /// Factor by which those of `headline` are.
    pub(crate) headline_shrunk: usize,
    pub(crate) sheets: Sheets,
    /// Whether any ray of the shown views does not count.
    pub(crate) has_dropped_rays: bool,
}

/// Pixels of the headline's three pictures together.
const HEADLINE_BUDGET: usize = 1_500_000;
/// Pixels of all other comparisons together.
const ROWS_BUDGET: usize = 3_000_000;
/// Pixels of one sheet of all views.
const SHEET_BUDGET: usize = 2_800_000;

pub(crate) fn measure(input: &ReportInput, task: Task) -> Result<Measured, ReportError> {
    let grid = &input.target.geometry().grid;
    let mut sheets = SheetPair::new(input.target.geometry());
    let keep = outstanding_views(grid);
    let (target, mut shown) = simulate_field(input, input.target, input.weights, &keep, task, |view, emitted| {
        sheets.place(view, input, emitted);
    })?;
    if let Some(worst) = target.worst_view().filter(|worst| !keep.contains(worst)) {
        let map = RayMap::new(input.display, &target.geometry);
        let emitted = simulate(input.display, &map, input.stack, &target.geometry, worst);
        let mut view = Shown::new(input, input.target, input.weights, worst, emitted);
        view.title = format!("Worst of all: {}", view.title.to_lowercase());
        shown.push(view);
    }
    let targets = shown.len();
    let mut held_out = None;
    match input.held_out {
        Some(field) => {
            let keep = sample_views(&field.geometry().grid);
            let (score, views) = simulate_field(input, field, &Weights::Uniform, &keep, task, |_, _| {})?;
            held_out = Some(score);
            shown.extend(views);
        }
        None => shown.extend(simulated_only(input, task)?),
    }
    let errors = |views: &[Shown]| picture::amplification(views.iter().flat_map(|view| view.errors.iter().flatten()));
    // held-out views are often far worse: on one scale the target views' differences would vanish
    let (amplification, held_out_amplification) = (errors(&shown[..targets]), errors(&shown[targets..]));
    let sizes: Vec<_> = shown.iter().flat_map(|view| [(view.simulated.rows, view.simulated.cols); 3]).collect();
    let (headline_shrunk, rows_shrunk) =
        (picture::shrink_factor(&sizes[..3], HEADLINE_BUDGET), picture::shrink_factor(&sizes, ROWS_BUDGET));
    let rows = shown.iter().enumerate().map(|(i, view)| {
        let amplification = if i < targets { amplification } else { held_out_amplification };
        view.compare(amplification, rows_shrunk, shown.len())
    });
    Ok(Measured {
        rows: rows.collect::<Result<_, _>>()?,
        headline: shown[0].compare(amplification, headline_shrunk, 1)?,
        rows_shrunk,
        headline_shrunk,
        sheets: sheets.embedded(grid)?,
        has_dropped_rays: shown.iter().any(|view| view.counted_share < 1.0),
        target,
        held_out,
    })
}

impl FieldScore {
    /// PSNR of all rays, L̃/β against L, dB.
    pub(crate) fn psnr_view(&self) -> f64 {
        self.errors.iter().fold(SquaredError::default(), |sum, error| sum.merged(*error)).psnr()
    }

    /// PSNR of all rays, L̃ against βL, dB.
    pub(crate) fn psnr_raw(&self) -> f64 {
        self.psnr_view() - 20.0 * self.brightness.log10()
    }

    /// Error of one view; `view` = [view_y, view_x].
    pub(crate) fn view(&self, view: [usize; 2]) -> SquaredError {
        self.errors[view[0] * self.geometry.grid.views()[1] + view[1]]
    }

    /// Share of a view's rays that count, 0..1.
    pub(crate) fn counted_share(&self, view: [usize; 2]) -> f64 {
        self.view(view).count as f64 / (3 * self.geometry.rows * self.geometry.cols) as f64
    }

    /// The view with the lowest PSNR, where PSNR tells views apart.
    fn worst_view(&self) -> Option<[usize; 2]> {
        let figures = self.geometry.grid.iter().map(|view| (view, self.view(view).psnr()));
        figures.filter(|(_, psnr)| psnr.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(view, _)| view)
    }
}

/// Simulates all views of a field; keeps those of `keep`, in that order.
fn simulate_field(
    input: &ReportInput,
    field: &LightField,
    weights: &Weights,
    keep: &[[usize; 2]],
    task: Task,
    mut each: impl FnMut([usize; 2], &EmittedView),
) -> Result<(FieldScore, Vec<Shown>), ReportError> {
    let geometry = field.geometry();
    let map = RayMap::new(input.display, geometry);
    let mut errors = Vec::new();
    let mut kept: Vec<Option<Shown>> = keep.iter().map(|_| None).collect();
    for view in geometry.grid.iter() {
        task.cancel.check()?;
        let emitted = simulate(input.display, &map, input.stack, geometry, view);
        let weight = |i: usize| weights.at(view, i / geometry.cols, i % geometry.cols);
        errors.push(view_error(&emitted, field.view(view), input.stack.brightness, weight));
        each(view, &emitted);
        if let Some(place) = keep.iter().position(|kept| *kept == view) {
            kept[place] = Some(Shown::new(input, field, weights, view, emitted));
        }
        task.progress.advance(1, "");
    }
    let score = FieldScore { geometry: geometry.clone(), errors, brightness: input.stack.brightness };
    Ok((score, kept.into_iter().flatten().collect()))
}

/// In-between views without a target.
fn simulated_only(input: &ReportInput, task: Task) -> Result<Vec<Shown>, ReportError> {
    let grid = &input.target.geometry().grid;
    let between = grid.in_between();
    if between.views() == [1, 1] && grid.views() == [1, 1] {
        return Ok(Vec::new());
    }
    let geometry = input.target.geometry().with_grid(between);
    let map = RayMap::new(input.display, &geometry);
    let views = sample_views(&geometry.grid).into_iter().map(|view| {
        task.cancel.check()?;
        let emitted = simulate(input.display, &map, input.stack, &geometry, view);
        Ok(Shown::without_target(input, &geometry, view, emitted))
    });
    views.collect()
}

/// A view at full precision, before it is encoded.
struct Shown {
    title: String,
    direction: String,
    psnr: Option<f64>,
    counted_share: f64,
    target: Option<Linear>,
    /// L̃/β.
    simulated: Linear,
    /// See [`picture::signed_error`].
    errors: Option<Vec<Option<f32>>>,
}

impl Shown {
    fn new(input: &ReportInput, field: &LightField, weights: &Weights, view: [usize; 2], emitted: EmittedView) -> Self {
        let geometry = field.geometry();
        let target = field.view(view);
        let weight = |i: usize| weights.at(view, i / geometry.cols, i % geometry.cols);
        let error = view_error(&emitted, target, input.stack.brightness, weight);
        let counts: Vec<bool> = emitted.valid.iter().enumerate().map(|(i, valid)| *valid && weight(i) > 0.0).collect();
        let shown = Self::without_target(input, geometry, view, emitted);
        Self {
            psnr: Some(error.psnr()),
            counted_share: error.count as f64 / target.len() as f64,
            errors: Some(picture::signed_error(&shown.simulated.data, target, |i| counts[i])),
            target: Some(Linear::new(geometry.rows, geometry.cols, target, 1.0)),
            ..shown
        }
    }

    fn without_target(input: &ReportInput, geometry: &FieldGeometry, view: [usize; 2], emitted: EmittedView) -> Self {
        let scale = (1.0 / input.stack.brightness) as f32;
        let grid = &geometry.grid;
        let valid = emitted.valid.iter().filter(|valid| **valid).count();
        Self {
            title: title(grid, &input.target.geometry().grid, view),
            direction: format!(
                "{} across, {} up",
                format::angle(grid.slope_x[view[1]]),
                format::angle(grid.slope_y[view[0]])
            ),
            psnr: None,
            counted_share: valid as f64 / emitted.valid.len() as f64,
            target: None,
            simulated: Linear::new(geometry.rows, geometry.cols, emitted.radiance.data(), scale),
            errors: None,
        }
    }

    /// Encodes the pictures, `factor` times smaller, as one of `count` comparisons.
    fn compare(&self, amplification: u32, factor: usize, count: usize) -> Result<Comparison, ReportError> {
        let simulated = self.simulated.shrunk(factor).encoded();
        let (rows, cols) = (self.simulated.rows, self.simulated.cols);
        let encoding = Encoding::for_pixels(3 * count * simulated.rows * simulated.cols);
        let target = self.target.as_ref().map(|target| target.shrunk(factor).encoded().embedded(encoding));
        let difference = self
            .errors
            .as_ref()
            .map(|errors| picture::difference(rows, cols, errors, amplification).shrunk(factor).embedded(encoding));
        Ok(Comparison {
            title: self.title.clone(),
            direction: self.direction.clone(),
            psnr: self.psnr,
            counted_share: self.counted_share,
            target: target.transpose()?,
            simulated: simulated.embedded(encoding)?,
            difference: difference.transpose()?,
            amplification,
        })
    }
}

/// Indices of view columns from left to right.
pub(crate) fn left_to_right(grid: &ViewGrid) -> Vec<usize> {
    let mut order: Vec<usize> = (0..grid.slope_x.len()).collect();
    order.sort_by(|a, b| grid.slope_x[*a].total_cmp(&grid.slope_x[*b]));
    order
}

/// Indices of view rows from top to bottom.
pub(crate) fn top_to_bottom(grid: &ViewGrid) -> Vec<usize> {
    let mut order: Vec<usize> = (0..grid.slope_y.len()).collect();
    order.sort_by(|a, b| grid.slope_y[*b].total_cmp(&grid.slope_y[*a]));
    order
}

/// The central view, then the corners.
fn outstanding_views(grid: &ViewGrid) -> Vec<[usize; 2]> {
    let (down, across) = (top_to_bottom(grid), left_to_right(grid));
    let (bottom, right) = (down.len() - 1, across.len() - 1);
    let places = [[down.len() / 2, across.len() / 2], [0, 0], [0, right], [bottom, 0], [bottom, right]];
    distinct(places.map(|[y, x]| [down[y], across[x]]))
}

/// A central view and two opposite corners, to stand for a grid that is not the target's.
fn sample_views(grid: &ViewGrid) -> Vec<[usize; 2]> {
    let (down, across) = (top_to_bottom(grid), left_to_right(grid));
    let places = [[down.len() / 2, across.len() / 2], [0, 0], [down.len() - 1, across.len() - 1]];
    distinct(places.map(|[y, x]| [down[y], across[x]]))
}

fn distinct<const N: usize>(views: [[usize; 2]; N]) -> Vec<[usize; 2]> {
    let mut list = Vec::with_capacity(N);
    views.into_iter().for_each(|view| {
        if !list.contains(&view) {
            list.push(view)
        }
    });
    list
}

/// Names a view by its place among the target views.
fn title(grid: &ViewGrid, target: &ViewGrid, view: [usize; 2]) -> String {
    if grid != target {
        return foreign_title([grid.slope_x[view[1]], grid.slope_y[view[0]]], target).into();
    }
    let rank = |order: Vec<usize>, index: usize| (order.iter().position(|i| *i == index).unwrap_or(0), order.len());
    let ((y, rows), (x, cols)) = (rank(top_to_bottom(grid), view[0]), rank(left_to_right(grid), view[1]));
    let edge = |rank: usize, count: usize, [first, last]: [&'static str; 2]| match rank {
        _ if count == 1 => "",
        0 => first,
        r if r == count - 1 => last,
        _ => "",
    };
    match (edge(y, rows, ["Top", "Bottom"]), edge(x, cols, ["left", "right"])) {
        ("", "") if (y, x) == (rows / 2, cols / 2) => "Central view".into(),
        ("Top", "") if cols == 1 => "Top view".into(),
        ("Bottom", "") if cols == 1 => "Bottom view".into(),
        ("", "left") if rows == 1 => "Leftmost view".into(),
        ("", "right") if rows == 1 => "Rightmost view".into(),
        (vertical, horizontal) if !vertical.is_empty() && !horizontal.is_empty() => {
            format!("{vertical} {horizontal} view")
        }
        _ => format!("View in row {} of {rows}, column {} of {cols}", y + 1, x + 1),
    }
}

/// Names a view that is not on the target's grid.
fn foreign_title(slope: [f64; 2], target: &ViewGrid) -> &'static str {
    /// Slopes closer than this are the same direction.
    const SAME: f64 = 1e-9;
    let place = |slope: f64, of: &[f64]| {
        let (low, high) = of.iter().fold((f64::MAX, f64::MIN), |(low, high), s| (low.min(*s), high.max(*s)));
        (of.iter().any(|s| (s - slope).abs() < SAME), slope < low - SAME || slope > high + SAME)
    };
    let ((on_x, outside_x), (on_y, outside_y)) = (place(slope[0], &target.slope_x), place(slope[1], &target.slope_y));
    match (outside_x || outside_y, on_x && on_y) {
        (true, _) => "View outside the target's",
        (false, true) => "Another look at a target view",
        (false, false) => "In-between view",
    }
}

/// The sheets while they are filled.
struct SheetPair {
    factor: usize,
    down: Vec<usize>,
    across: Vec<usize>,
    target: Picture,
    simulated: Picture,
}

impl SheetPair {
    fn new(geometry: &FieldGeometry) -> Self {
        let [view_rows, view_cols] = geometry.grid.views();
        let factor = picture::shrink_factor(&vec![(geometry.rows, geometry.cols); view_rows * view_cols], SHEET_BUDGET);
        let (rows, cols) = (view_rows * geometry.rows.div_ceil(factor), view_cols * geometry.cols.div_ceil(factor));
        let blank = Picture { rows, cols, rgb: vec![0; rows * cols * 3] };
        Self {
            factor,
            down: top_to_bottom(&geometry.grid),
            across: left_to_right(&geometry.grid),
            target: blank.clone(),
            simulated: blank,
        }
    }

    fn place(&mut self, view: [usize; 2], input: &ReportInput, emitted: &EmittedView) {
        let geometry = input.target.geometry();
        let scale = (1.0 / input.stack.brightness) as f32;
        let rank = |order: &[usize], index: usize| order.iter().position(|i| *i == index).unwrap_or(0);
        let (y, x) = (rank(&self.down, view[0]), rank(&self.across, view[1]));
        for (sheet, values, scale) in
            [(&mut self.target, input.target.view(view), 1.0), (&mut self.simulated, emitted.radiance.data(), scale)]
        {
            let tile = Linear::new(geometry.rows, geometry.cols, values, scale).shrunk(self.factor).encoded();
            for (row, line) in tile.rgb.chunks_exact(tile.cols * 3).enumerate() {
                let start = ((y * tile.rows + row) * sheet.cols + x * tile.cols) * 3;
                sheet.rgb[start..start + line.len()].copy_from_slice(line);
            }
        }
    }

    fn embedded(&self, grid: &ViewGrid) -> Result<Sheets, ReportError> {
        let encoding = Encoding::for_pixels(2 * self.target.rows * self.target.cols);
        Ok(Sheets {
            target: self.target.embedded(encoding)?,
            simulated: self.simulated.embedded(encoding)?,
            across: self.across.iter().map(|x| format::angle(grid.slope_x[*x])).collect(),
            up: self.down.iter().map(|y| format::angle(grid.slope_y[*y])).collect(),
        })
    }
}
