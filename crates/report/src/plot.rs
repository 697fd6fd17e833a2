//! The plots of a report.

use lumistack_plot::page::{self, Bars};

use crate::depth::{DepthBudget, Histogram};
use crate::{Iteration, ReportError};

/// Horizontal axis of a convergence plot.
pub(crate) struct Axis {
    /// Label with its unit.
    pub(crate) label: &'static str,
    /// Position of an iteration on the axis.
    pub(crate) position: fn(&Iteration) -> f64,
}

/// The two axes of convergence plots.
pub(crate) const AXES: [Axis; 2] = [
    Axis { label: "iteration", position: |it| it.iteration as f64 },
    Axis { label: "time since the solver's start, s", position: |it| it.seconds },
];

/// Largest value that the plot of the bound on the frequency shows.
const MOST_DETAIL: f64 = 6.0;

/// Draws `psnr_view` over an axis; `None` if there is no finite point.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn convergence(history: &[Iteration], axis: &Axis) -> Result<Option<String>, ReportError> {
    let points = history.iter().map(|it| ((axis.position)(it), it.psnr_view));
    let points: Vec<_> = points.filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    if points.is_empty() {
        return Ok(None);
    }
    Ok(Some(page::line(&points, [axis.label, "psnr_view, dB"])?))
}

/// Draws values as a line, with the labels of both axes. `points` has at least one point, and all
/// points are finite.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn line(points: &[(f64, f64)], label: &str, value_label: &str) -> Result<String, ReportError> {
    Ok(page::line(points, [label, value_label])?)
}

/// Draws the fractions of hits by depth, with the depth of field and the layers.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn depths(budget: &DepthBudget) -> Result<String, ReportError> {
    let label = "depth, mm towards the viewer (band: depth of field; lines: layers)";
    shares(&budget.by_depth, label, budget.depth_of_field_mm, &budget.layers_mm)
}

/// Draws the fractions of hits by disparity between neighbouring views.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn disparities(budget: &DepthBudget) -> Result<String, ReportError> {
    let label = "shift between neighbouring views, pixels (band: up to one)";
    shares(&budget.by_disparity, label, Some([0.0, 1.0]), &[])
}

/// Draws the highest spatial frequency over depth, relative to the highest frequency of the light
/// field's pixels. A horizontal line marks the value 1.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn bound(budget: &DepthBudget) -> Result<String, ReportError> {
    // If the layers' pixels are much finer than the light field's pixels, the bound is far above 1,
    // so clamp it to the plotted range.
    let points: Vec<(f64, f64)> = budget.bound.iter().map(|(z, bound)| (*z, bound.min(MOST_DETAIL))).collect();
    Ok(page::against(&points, 1.0, ["depth, mm towards the viewer", "finest detail / finest detail of the pixels"])?)
}

fn shares(histogram: &Histogram, label: &str, band: Option<[f64; 2]>, lines: &[f64]) -> Result<String, ReportError> {
    let bars = Bars { low: histogram.low, width: histogram.width, shares: &histogram.shares };
    Ok(page::bars(bars, [label, "fraction of hits, %"], band, lines)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn history(psnr: &[f64]) -> Vec<Iteration> {
        let iteration = |(i, &psnr_view): (usize, &f64)| Iteration {
            iteration: i as u32,
            objective: 1.0,
            psnr_view,
            seconds: 0.1 * i as f64,
        };
        psnr.iter().enumerate().map(iteration).collect()
    }

    #[test]
    fn labels_are_text_in_the_page_colour() {
        let svg = convergence(&history(&[20.0, 25.0, 26.0]), &AXES[0]).unwrap().unwrap();
        assert!(svg.contains("psnr_view, dB") && svg.contains("<text") && svg.contains("iteration"));
        assert!(svg.contains("26.0 dB"));
        assert!(svg.contains("fill=\"currentColor\"") && !svg.contains("#000000"));
    }

    #[test]
    fn a_history_without_figures_has_no_plot() {
        assert!(convergence(&[], &AXES[0]).unwrap().is_none());
        assert!(convergence(&history(&[f64::INFINITY, f64::NAN]), &AXES[1]).unwrap().is_none());
        assert!(convergence(&history(&[31.0]), &AXES[1]).unwrap().is_some());
    }
}
