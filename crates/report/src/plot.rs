//! Line plots as SVG with real text. Text, axes and grid take the page's text colour, so that they stay readable on light and dark.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::depth::{DepthBudget, Histogram};
use crate::{Iteration, ReportError};

/// One plot: PSNR against something that grows.
pub(crate) struct Axis {
    /// Label with its unit.
    pub(crate) label: &'static str,
    /// Abscissa of an iteration.
    pub(crate) position: fn(&Iteration) -> f64,
}

/// The two ways to read convergence.
pub(crate) const AXES: [Axis; 2] = [
    Axis { label: "iteration", position: |it| it.iteration as f64 },
    Axis { label: "time since the solver's start, s", position: |it| it.seconds },
];

/// Width and height in SVG units.
const SIZE: (u32, u32) = (560, 320);
/// Readable on white and on near-black.
const CURVE: RGBColor = RGBColor(46, 128, 242);

/// Draws `psnr_view` over an axis; `None` when there is no finite point.
///
/// # Errors
/// If plotters fails.
pub(crate) fn convergence(history: &[Iteration], axis: &Axis) -> Result<Option<String>, ReportError> {
    let points: Vec<(f64, f64)> = history.iter().map(|it| ((axis.position)(it), it.psnr_view)).collect();
    let points: Vec<_> = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    if points.is_empty() {
        return Ok(None);
    }
    Ok(Some(line(&points, axis.label, "psnr_view, dB")?))
}

/// Draws a line of decibels through at least one finite point.
///
/// # Errors
/// If plotters fails.
pub(crate) fn line(points: &[(f64, f64)], label: &str, value_label: &str) -> Result<String, ReportError> {
    let svg = draw(points, label, value_label).map_err(|error| ReportError::Plot(error.to_string()))?;
    Ok(in_page_colour(&svg, value_label, label))
}

fn draw(points: &[(f64, f64)], label: &str, value_label: &str) -> Result<String, Box<dyn std::error::Error>> {
    let (x_range, y_range) = (range(points.iter().map(|p| p.0), 0.0), range(points.iter().map(|p| p.1), 0.06));
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .margin_right(22)
            .x_label_area_size(46)
            .y_label_area_size(58)
            .build_cartesian_2d(x_range.clone(), y_range.clone())?;
        let text = |size: i32| ("sans-serif", size).into_font().color(&BLACK);
        // numbers of times and iterations have no halves between them
        let whole = points.iter().all(|(x, _)| x.fract() == 0.0);
        let x_digits = if whole && points.len() > 1 { 0 } else { digits(&x_range) };
        let x_labels = if whole { ((x_range.end - x_range.start) as usize + 1).min(8) } else { 8 };
        let y_digits = digits(&y_range);
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.15))
            .axis_style(BLACK.mix(0.6))
            .x_desc(label)
            .y_desc(value_label)
            .x_labels(x_labels)
            .y_labels(6)
            .x_label_formatter(&|x| format!("{x:.x_digits$}"))
            .y_label_formatter(&|y| format!("{y:.y_digits$}"))
            .label_style(text(17))
            .axis_desc_style(text(18))
            .draw()?;
        chart.draw_series(LineSeries::new(points.iter().copied(), CURVE.stroke_width(2)))?;
        // dots hide a long curve
        let dots = points.iter().copied().filter(|_| points.len() <= 40);
        chart.draw_series(dots.map(|point| Circle::new(point, 3, CURVE.filled())))?;
        if let Some(&last) = points.last() {
            let place = text(17).pos(Pos::new(HPos::Right, VPos::Bottom));
            chart.draw_series([Text::new(format!("{:.1} dB", last.1), last, place)])?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// Shares of what is seen by depth, with the depth of field and the layers.
///
/// # Errors
/// If plotters fails.
pub(crate) fn depths(budget: &DepthBudget) -> Result<String, ReportError> {
    let band = budget.depth_of_field_mm.map(|[low, high]| (low, high));
    bars(
        &budget.by_depth,
        "depth, mm towards the viewer (band: depth of field; lines: layers)",
        band,
        &budget.layers_mm,
    )
}

/// Shares of what is seen by how far it moves from view to view.
///
/// # Errors
/// If plotters fails.
pub(crate) fn disparities(budget: &DepthBudget) -> Result<String, ReportError> {
    bars(&budget.by_disparity, "shift between neighbouring views, pixels (band: up to one)", Some((0.0, 1.0)), &[])
}

/// The highest spatial frequency over depth, relative to the light field's own; the line is 1.
///
/// # Errors
/// If plotters fails.
pub(crate) fn bound(budget: &DepthBudget) -> Result<String, ReportError> {
    // near a single layer the bound rises without limit
    let points: Vec<(f64, f64)> = budget.bound.iter().map(|(z, bound)| (*z, bound.min(MOST_DETAIL))).collect();
    let most = points.iter().fold(1.2f64, |most, (_, bound)| most.max(*bound));
    let (low, high) = (points.first().map_or(0.0, |p| p.0), points.last().map_or(1.0, |p| p.0));
    let labels = ["depth, mm towards the viewer", "finest detail / pixel's own"];
    framed(labels, (low, high), (0.0, 1.05 * most), |chart| {
        chart.draw_series([PathElement::new([(low, 1.0), (high, 1.0)], BLACK.mix(0.6))])?;
        chart.draw_series(LineSeries::new(points.iter().copied(), CURVE.stroke_width(2)))?;
        Ok(())
    })
}

/// The bound is drawn up to this.
const MOST_DETAIL: f64 = 6.0;

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Bars in percent, a band behind them and lines before them.
fn bars(histogram: &Histogram, label: &str, band: Option<(f64, f64)>, lines: &[f64]) -> Result<String, ReportError> {
    let end = histogram.low + histogram.width * histogram.shares.len() as f64;
    let most = 100.0 * histogram.shares.iter().fold(0.01, |most: f64, share| most.max(*share));
    framed([label, "share of what is seen, %"], (histogram.low, end), (0.0, 1.08 * most), |chart| {
        if let Some((low, high)) = band {
            let (low, high) = (low.max(histogram.low), high.min(end));
            chart.draw_series([Rectangle::new([(low, 0.0), (high, 1.08 * most)], CURVE.mix(0.14).filled())])?;
        }
        let bars = histogram.bars().filter(|(.., share)| *share > 0.0);
        chart.draw_series(
            bars.map(|(left, right, share)| Rectangle::new([(left, 0.0), (right, 100.0 * share)], CURVE.filled())),
        )?;
        let lines = lines.iter().map(|z| PathElement::new([(*z, 0.0), (*z, 1.08 * most)], BLACK.mix(0.6)));
        chart.draw_series(lines)?;
        Ok(())
    })
}

/// Axes with labels, and what `content` draws between them.
fn framed(
    [x_label, y_label]: [&str; 2],
    x: (f64, f64),
    y: (f64, f64),
    content: impl FnOnce(&mut Chart) -> Drawn,
) -> Result<String, ReportError> {
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Drawn {
        let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .margin_right(22)
            .x_label_area_size(46)
            .y_label_area_size(58)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let text = |size: i32| ("sans-serif", size).into_font().color(&BLACK);
        let (x_digits, y_digits) = (digits(&(x.0..x.1)), digits(&(y.0..y.1)));
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.15))
            .axis_style(BLACK.mix(0.6))
            .x_desc(x_label)
            .y_desc(y_label)
            .x_labels(8)
            .y_labels(6)
            .x_label_formatter(&|x| format!("{x:.x_digits$}"))
            .y_label_formatter(&|y| format!("{y:.y_digits$}"))
            .label_style(text(17))
            .axis_desc_style(text(18))
            .draw()?;
        content(&mut chart)?;
        drop(chart);
        root.present()?;
        Ok(())
    };
    draw(&mut svg).map_err(|error| ReportError::Plot(error.to_string()))?;
    Ok(in_page_colour(&svg, y_label, x_label))
}

/// The text colour of the page, and a description for those who do not see the plot.
fn in_page_colour(svg: &str, value_label: &str, label: &str) -> String {
    let described = format!("role=\"img\" aria-label=\"{value_label} over {label}\" xmlns=");
    svg.replace("\"#000000\"", "\"currentColor\"").replacen("xmlns=", &described, 1)
}

/// A range around all values, never empty, widened by a share of its width on either side.
fn range(values: impl Iterator<Item = f64>, widen: f64) -> std::ops::Range<f64> {
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let width = high - low;
    if width > 1e-9 { low - widen * width..high + widen * width } else { low - 0.5..high + 0.5 }
}

/// Decimals that tell tick labels apart.
fn digits(range: &std::ops::Range<f64>) -> usize {
    match range.end - range.start {
        width if width >= 8.0 => 0,
        width if width >= 0.8 => 1,
        _ => 2,
    }
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
