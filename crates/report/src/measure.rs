//! Simulates every view. Computes the scores of the views, and the pictures of the page.

mod names;
mod score;
mod sheets;
mod shown;

use lumistack_core::Task;
use lumistack_core::metrics::Mean;
use lumistack_display::{LightField, RayMap, ViewGrid, Weights};

pub(crate) use names::{left_to_right, outstanding_views, top_to_bottom};
pub(crate) use score::{FieldScore, Judge, ViewFigures, counting};
pub(crate) use sheets::Sheets;
pub(crate) use shown::Comparison;

use crate::{ReportError, ReportInput, ZoneFigures, picture};
use rayon::prelude::*;
use sheets::SheetPair;
use shown::Shown;

/// Scores and pictures of the views.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    pub(crate) target: FieldScore,
    pub(crate) zone: Option<ZoneLooks>,
    pub(crate) held_out: Option<FieldScore>,
    pub(crate) outside: Option<FieldScore>,
    /// The large comparison: the median direction of the zone or, without a zone score, the central
    /// view.
    pub(crate) headline: Comparison,
    /// The central view and the corner views, the worst view, the worst and the median direction of
    /// the zone, and views between and outside of the target's views.
    pub(crate) rows: Vec<Comparison>,
    /// Factor by which the pictures of `rows` are smaller than the views.
    pub(crate) rows_shrunk: usize,
    /// Factor by which the pictures of `headline` are smaller than the views.
    pub(crate) headline_shrunk: usize,
    pub(crate) sheets: Sheets,
    /// True if scores exclude some rays of the shown views.
    pub(crate) has_dropped_rays: bool,
}

/// SSIM and FLIP over the directions of [`ZoneFigures::views`].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ZoneLooks {
    pub(crate) ssim: Mean,
    pub(crate) flip: Mean,
}

/// Maximum number of pixels in the four pictures of the large comparison.
const HEADLINE_BUDGET: usize = 2_000_000;
/// Maximum number of pixels in all pictures of [`Measured::rows`].
const ROWS_BUDGET: usize = 4_000_000;

pub(crate) fn measure(input: &ReportInput, task: Task) -> Result<Measured, ReportError> {
    let grid = &input.target.geometry().grid;
    let judge = Judge::new(input);
    let mut sheets = SheetPair::new(input.target.geometry());
    let keep = outstanding_views(grid);
    let (target, mut shown) = field(&judge, input.target, input.weights, &keep, task)?;
    // The section "Look around" shows seen pictures instead of the emission along rays.
    sheets.fill(input, &judge.simulator, task)?;
    if let Some(worst) = target.worst_view().filter(|worst| !keep.contains(worst)) {
        let map = RayMap::new(input.display, &target.geometry);
        let emitted = judge.simulator.view(&map, &target.geometry, worst);
        let (geometry, of_worst) = (&target.geometry, input.target.view(worst));
        let mut view = Shown::new(input, geometry, of_worst, input.weights, worst, target.view(worst), emitted);
        view.title = format!("Worst of all: {}", view.title.to_lowercase());
        shown.push(view);
    }
    let targets = shown.len();
    let zone = input.zone.map(|zone| zone_looks(&judge, zone, &mut shown));
    // The large comparison shows the median direction of the zone, if there is one; `zone_looks`
    // adds this direction last. Its rendered reference usually has more samples than a view of the
    // target, so less noise.
    let median_of_zone = (shown.len() > targets).then(|| shown.len() - 1);
    let mut others = |given: Option<&LightField>, grid: Option<ViewGrid>| -> Result<Option<FieldScore>, ReportError> {
        if let Some(given) = given {
            let keep = names::sample_views(&given.geometry().grid);
            let (score, views) = field(&judge, given, &Weights::Uniform, &keep, task)?;
            shown.extend(views);
            return Ok(Some(score));
        }
        shown.extend(grid.map_or(Ok(Vec::new()), |grid| simulated_only(&judge, grid, task))?);
        Ok(None)
    };
    let between = (grid.views() != [1, 1] && input.zone.is_none()).then(|| grid.in_between());
    let held_out = others(input.held_out, between)?;
    let outside = others(input.outside, grid.outside(1))?;
    let errors = |views: &[Shown]| picture::amplification(views.iter().flat_map(|view| view.errors.iter().flatten()));
    // Directions of the zone and held-out views are often far worse than target views. With a
    // common amplification, the errors of target views would be invisible. So target views have an
    // amplification of their own.
    let (amplification, other_amplification) = (errors(&shown[..targets]), errors(&shown[targets..]));
    let sizes: Vec<_> = shown.iter().flat_map(|view| [(view.simulated.rows, view.simulated.cols); 4]).collect();
    let (headline_shrunk, rows_shrunk) =
        (picture::shrink_factor(&sizes[..4], HEADLINE_BUDGET), picture::shrink_factor(&sizes, ROWS_BUDGET));
    let headline = match median_of_zone {
        Some(median) => shown[median].compare(other_amplification, headline_shrunk, 1)?,
        None => shown[0].compare(amplification, headline_shrunk, 1)?,
    };
    let rows = shown.par_iter().enumerate().map(|(i, view)| {
        let amplification = if i < targets { amplification } else { other_amplification };
        view.compare(amplification, rows_shrunk, shown.len())
    });
    Ok(Measured {
        rows: rows.collect::<Result<_, _>>()?,
        headline,
        rows_shrunk,
        headline_shrunk,
        sheets: sheets.embedded(grid)?,
        has_dropped_rays: shown.iter().any(|view| view.counted_share < 1.0),
        target,
        zone,
        held_out,
        outside,
    })
}

/// Returns SSIM and FLIP over the directions of [`ZoneFigures::views`]. Adds the worst and then the
/// median of these directions to `shown`.
fn zone_looks(judge: &Judge, zone: &ZoneFigures, shown: &mut Vec<Shown>) -> ZoneLooks {
    let mut views: Vec<_> = zone.views.par_iter().map(|view| (view, judge.zone_view(view))).collect();
    let looks = views.iter().fold(ZoneLooks::default(), |sum, (_, figures)| ZoneLooks {
        ssim: sum.ssim.merged(figures.ssim),
        flip: sum.flip.merged(figures.flip),
    });
    views.sort_by(|(a, _), (b, _)| b.score.mse.total_cmp(&a.score.mse));
    let mut places = vec![0, views.len() / 2];
    places.dedup();
    let picked = places.into_iter().filter_map(|place| views.get(place));
    shown.extend(picked.map(|(view, figures)| Shown::of_zone(judge.input, view, figures)));
    looks
}

/// Returns the scores of all views of a light field, and the views that `keep` lists, in the order
/// of `keep`.
fn field(
    judge: &Judge,
    field: &LightField,
    weights: &Weights,
    keep: &[[usize; 2]],
    task: Task,
) -> Result<(FieldScore, Vec<Shown>), ReportError> {
    let mut kept: Vec<Option<Shown>> = keep.iter().map(|_| None).collect();
    let score = judge.field(field, weights, task, |view, figures, emitted| {
        if let Some(place) = keep.iter().position(|kept| *kept == view) {
            let (geometry, target) = (field.geometry(), field.view(view));
            kept[place] = Some(Shown::new(judge.input, geometry, target, weights, view, figures, emitted));
        }
    })?;
    Ok((score, kept.into_iter().flatten().collect()))
}

/// Simulates some views of a grid that has no target.
fn simulated_only(judge: &Judge, grid: ViewGrid, task: Task) -> Result<Vec<Shown>, ReportError> {
    let geometry = judge.input.target.geometry().with_grid(grid);
    let map = RayMap::new(judge.input.display, &geometry);
    let views = names::sample_views(&geometry.grid).into_iter().map(|view| {
        task.cancel.check()?;
        let emitted = judge.simulator.view(&map, &geometry, view);
        Ok(Shown::without_target(judge.input, &geometry, view, emitted))
    });
    views.collect()
}
