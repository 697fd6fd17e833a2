//! Distribution of the error over three classes of rays: content outside of the layers' depths,
//! depth discontinuities, and outer views.

use lumistack_core::Task;
use lumistack_core::metrics::SquaredError;
use lumistack_display::{Backlight, Display, RayMap, Simulator, view_error};
use rayon::prelude::*;
use serde_json::json;

use super::depth::DepthMap;
use super::limit::Limit;
use crate::measure::{FieldScore, counting, left_to_right, top_to_bottom};
use crate::{ReportError, ReportInput, format};

/// Matching is regarded as failed if more than this fraction of the rays is near depth
/// discontinuities.
const BELIEVABLE_JUMPS: f64 = 0.6;

/// Squared error of all pixels, and of a class of pixels (`inside`).
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    all: SquaredError,
    inside: SquaredError,
}

impl Part {
    fn merged(self, other: Self) -> Self {
        Self { all: self.all.merged(other.all), inside: self.inside.merged(other.inside) }
    }

    fn share_of_rays(self) -> f64 {
        self.inside.count as f64 / self.all.count as f64
    }

    fn share_of_error(self) -> f64 {
        if self.all.sum > 0.0 { self.inside.sum / self.all.sum } else { 0.0 }
    }

    /// Returns the gain of PSNR, in dB, if the pixels of the class had the mean error of all other
    /// pixels.
    fn gain(self) -> f64 {
        let rest = (self.all.sum - self.inside.sum) / (self.all.count - self.inside.count) as f64;
        if self.inside.count == 0 || self.all.sum == 0.0 {
            0.0
        } else {
            (10.0 * (self.all.mse() / rest).log10()).max(0.0)
        }
    }
}

/// Returns two limits: by content outside of the layers' depths, and by depth discontinuities. Both
/// are measured in the leftmost, the central and the rightmost view of the central row. There are
/// no such limits if a row has one view, or if matching failed.
pub(super) fn depth_limits(input: &ReportInput, task: Task) -> Result<Vec<Limit>, ReportError> {
    let geometry = input.target.geometry();
    let (order, down) = (left_to_right(&geometry.grid), top_to_bottom(&geometry.grid));
    let (middle, last, y) = (order.len() / 2, order.len() - 1, down[down.len() / 2]);
    if last == 0 {
        return Ok(Vec::new());
    }
    task.cancel.check()?;
    // Measure the views (two or three), each matched with a neighbour.
    let mut places = vec![(0, 1), (middle, if middle < last { middle + 1 } else { middle - 1 }), (last, last - 1)];
    places.dedup_by_key(|(place, _)| *place);
    let (low, high) = depth_range(input.display);
    let (simulator, map) = (Simulator::new(input.display, input.stack), RayMap::new(input.display, geometry));
    let found: Vec<_> = places
        .par_iter()
        .filter_map(|&(place, neighbour)| {
            let view = [y, order[place]];
            let depths = DepthMap::new(input.target, view, [y, order[neighbour]])?;
            let emitted = simulator.view(&map, geometry, view);
            let counts = counting(&emitted, geometry, input.weights, view);
            let part = |inside: &dyn Fn(usize, usize) -> bool| {
                let error = |rays: &dyn Fn(usize) -> bool| {
                    view_error(&emitted, input.target.view(view), input.stack.brightness, |i| {
                        if rays(i) { 1.0 } else { 0.0 }
                    })
                };
                let chosen = |i: usize| counts[i] && inside(i / geometry.cols, i % geometry.cols);
                Part { all: error(&|i| counts[i]), inside: error(&chosen) }
            };
            let (low, high) = (low - depths.resolution_mm, high + depths.resolution_mm);
            let far = part(&|row, col| !(low..=high).contains(&depths.z_mm(row, col)));
            Some((place, far, part(&|row, col| depths.is_edge(row, col))))
        })
        .collect();
    // Sum each class over the views. Then compute the gain if the class had the mean error of all
    // other pixels.
    let jumps = found.iter().fold(Part::default(), |sum, (_, _, edges)| sum.merged(*edges));
    // On noise and on pictures without texture, matching finds discontinuities everywhere, so no
    // limit is reported.
    if found.is_empty() || jumps.share_of_rays() > BELIEVABLE_JUMPS {
        return Ok(Vec::new());
    }
    let limit = |name, what: &str, pick: &dyn Fn(&(usize, Part, Part)) -> Part| {
        let sum = |chosen: &dyn Fn(usize) -> bool| {
            let views = found.iter().filter(|(place, ..)| chosen(*place));
            views.fold(Part::default(), |sum, view| sum.merged(pick(view)))
        };
        // If a row has two views, the right view is both the central view and an outer view.
        let (all, centre) = (sum(&|_| true), sum(&|place| place == middle));
        let outer = sum(&|place| place == 0 || place == last);
        let mut text = format!(
            "{what} are {} of the central view's rays, and have {} of its squared error. In the leftmost and rightmost views, rays of this kind are {} of all rays, and have {} of the squared error. ",
            format::percent(centre.share_of_rays()),
            format::percent(centre.share_of_error()),
            format::percent(outer.share_of_rays()),
            format::percent(outer.share_of_error()),
        );
        text += &if all.gain() > 0.0 {
            let gain = format::decibels_fine(all.gain());
            format!(
                "If rays of this kind were as good as all other rays, the PSNR of these views would be {gain} dB higher."
            )
        } else {
            "Rays of this kind are no worse than other rays.".into()
        };
        let figures = json!({
            "share_of_rays_middle": centre.share_of_rays(),
            "share_of_error_middle": centre.share_of_error(),
            "share_of_rays_outer": outer.share_of_rays(),
            "share_of_error_outer": outer.share_of_error(),
        });
        Limit { name, decibels: Some(all.gain()), text, figures }
    };
    let range = format!("{} to {} mm", format::number(low), format::number(high));
    let far = limit(
        "Depth",
        &format!(
            "Rays to things in front of or behind the layers (outside {range}, found by matching neighbouring views)"
        ),
        &|v| v.1,
    );
    let edges = limit("Depth edges", "Rays near edges where one thing covers another", &|v| v.2);
    Ok(vec![far, edges])
}

/// Returns the range that contains the depths of the layers, the depth of the lenslets, and z = 0,
/// millimetres.
fn depth_range(display: &Display) -> (f64, f64) {
    let lenslets = match &display.backlight {
        Backlight::Lenslets(backlight) => Some(backlight.d_mm),
        Backlight::Uniform => None,
    };
    let distances = display.layers.iter().map(|layer| layer.d_mm).chain(lenslets);
    distances.fold((0.0, 0.0), |(low, high), d| (low.min(d), high.max(d)))
}

pub(super) fn outer_views(target: &FieldScore) -> Option<Limit> {
    let grid = &target.geometry.grid;
    let (down, across) = (top_to_bottom(grid), left_to_right(grid));
    let centre = target.view([down[down.len() / 2], across[across.len() / 2]]).error;
    let outermost = |view: &[usize; 2]| {
        let ends =
            |order: &[usize], index: usize| order.len() > 1 && (index == order[0] || index == order[order.len() - 1]);
        ends(&down, view[0]) || ends(&across, view[1])
    };
    let rim =
        grid.iter().filter(outermost).fold(SquaredError::default(), |sum, view| sum.merged(target.view(view).error));
    if grid.views() == [1, 1] || centre.count == 0 || rim.count == 0 || target.psnr_view().is_infinite() {
        return None;
    }
    let gain = (centre.psnr() - target.psnr_view()).max(0.0);
    let (middle, rim_text) = (format::decibels(centre.psnr()), format::decibels(rim.psnr()));
    let mut text =
        format!("The PSNR of the central view is {middle} dB, that of the outermost views together {rim_text} dB.");
    if gain > 0.0 {
        let gain = format::decibels_fine(gain);
        text += &format!(
            " If all views were as good as the central view, the PSNR of the result would be {gain} dB higher."
        );
    }
    let figures = json!({ "psnr_centre": centre.psnr(), "psnr_outermost": rim.psnr() });
    Some(Limit { name: "Outer views", decibels: Some(gain), text, figures })
}
