//! Plots in a page. Text, axes and grid have the colour of the page's text, so they are readable on
//! light and dark backgrounds.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::PlotError;
use crate::chart::{Chart, Drawn, described, digits, ends};

/// Width and height in SVG units.
const SIZE: (u32, u32) = (560, 320);
/// Colour of curves, readable on white and on near-black.
const CURVE: RGBColor = RGBColor(46, 128, 242);
/// Curves with more points than this have no markers, which would hide the curve.
const DOTS: usize = 40;

/// Bars of equal width.
#[derive(Clone, Copy, Debug)]
pub struct Bars<'a> {
    /// Left end of the first bar.
    pub low: f64,
    /// Width of a bar.
    pub width: f64,
    /// Heights as fractions, 0..1. They are drawn in percent.
    pub shares: &'a [f64],
}

/// Draws a line through `points`, which must be finite. Writes the last value, in decibels, at the
/// line's end. `labels` name the horizontal and the vertical axis.
///
/// # Errors
/// If there are no points.
pub fn line(points: &[(f64, f64)], labels: [&str; 2]) -> Result<String, PlotError> {
    let none = || PlotError::new("expected at least one point, found none");
    let x = ends(points.iter().map(|p| p.0), 0.0).ok_or_else(none)?;
    let y = ends(points.iter().map(|p| p.1), 0.06).ok_or_else(none)?;
    // If all positions are whole, such as numbers of iterations, their labels have no decimals.
    let whole = points.iter().all(|(x, _)| x.fract() == 0.0);
    let x_digits = if whole && points.len() > 1 { 0 } else { decimals(x) };
    let x_labels = if whole { ((x[1] - x[0]) as usize + 1).min(8) } else { 8 };
    framed(labels, [x, y], (x_labels, x_digits), |chart| {
        chart.draw_series(LineSeries::new(points.iter().copied(), CURVE.stroke_width(2)))?;
        let dots = points.iter().copied().filter(|_| points.len() <= DOTS);
        chart.draw_series(dots.map(|point| Circle::new(point, 3, CURVE.filled())))?;
        if let Some(&last) = points.last() {
            let place = text(17).pos(Pos::new(HPos::Right, VPos::Bottom));
            chart.draw_series([Text::new(format!("{:.1} dB", last.1), last, place)])?;
        }
        Ok(())
    })
}

/// Draws bars in percent. `band` is the range, on the horizontal axis, of a coloured area behind
/// the bars; `lines` are positions of vertical lines in front of the bars.
///
/// # Errors
/// If the plot cannot be drawn.
pub fn bars(bars: Bars<'_>, labels: [&str; 2], band: Option<[f64; 2]>, lines: &[f64]) -> Result<String, PlotError> {
    let Bars { low, width, shares } = bars;
    let end = low + width * shares.len() as f64;
    let most = 100.0 * shares.iter().fold(0.01, |most: f64, share| most.max(*share));
    let x = [low, end];
    framed(labels, [x, [0.0, 1.08 * most]], (8, decimals(x)), |chart| {
        if let Some([from, to]) = band {
            let (from, to) = (from.max(low), to.min(end));
            chart.draw_series([Rectangle::new([(from, 0.0), (to, 1.08 * most)], CURVE.mix(0.14).filled())])?;
        }
        let seen = shares.iter().enumerate().filter(|(_, share)| **share > 0.0);
        chart.draw_series(seen.map(|(i, share)| {
            let left = low + i as f64 * width;
            Rectangle::new([(left, 0.0), (left + width, 100.0 * share)], CURVE.filled())
        }))?;
        let lines = lines.iter().map(|z| PathElement::new([(*z, 0.0), (*z, 1.08 * most)], BLACK.mix(0.6)));
        chart.draw_series(lines)?;
        Ok(())
    })
}

/// Draws a curve of positive values and a horizontal line at `level`. The vertical axis always
/// includes `level`.
///
/// # Errors
/// If the plot cannot be drawn.
pub fn against(points: &[(f64, f64)], level: f64, labels: [&str; 2]) -> Result<String, PlotError> {
    let most = points.iter().fold(1.2 * level, |most: f64, (_, value)| most.max(*value));
    let (low, high) = (points.first().map_or(0.0, |p| p.0), points.last().map_or(1.0, |p| p.0));
    let x = [low, high];
    framed(labels, [x, [0.0, 1.05 * most]], (8, decimals(x)), |chart| {
        chart.draw_series([PathElement::new([(low, level), (high, level)], BLACK.mix(0.6))])?;
        chart.draw_series(LineSeries::new(points.iter().copied(), CURVE.stroke_width(2)))?;
        Ok(())
    })
}

fn text(size: i32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&BLACK)
}

/// Returns the number of decimals of tick labels: at most two, since there is little room.
fn decimals(range: [f64; 2]) -> usize {
    digits(range).min(2)
}

/// Draws axes with labels, and `content` between them. The horizontal axis has about `x_labels`
/// tick labels of `x_digits` decimals.
fn framed(
    [x_label, y_label]: [&str; 2],
    [x, y]: [[f64; 2]; 2],
    (x_labels, x_digits): (usize, usize),
    content: impl FnOnce(&mut Chart) -> Drawn,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Drawn {
        let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .margin_right(22)
            .x_label_area_size(46)
            .y_label_area_size(58)
            .build_cartesian_2d(x[0]..x[1], y[0]..y[1])?;
        let y_digits = decimals(y);
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.15))
            .axis_style(BLACK.mix(0.6))
            .x_desc(x_label)
            .y_desc(y_label)
            .x_labels(x_labels)
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
    draw(&mut svg).map_err(PlotError::new)?;
    let in_page_colour = svg.replace("\"#000000\"", "\"currentColor\"");
    Ok(described(&in_page_colour, &format!("{y_label} over {x_label}")))
}
