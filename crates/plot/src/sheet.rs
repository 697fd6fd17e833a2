//! Standalone plots: black on white, with title and legend.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::PlotError;
use crate::chart::{Chart, Drawn, FAMILY, described, digits, ends};

/// Axes of curves and areas.
#[derive(Clone, Debug, Default)]
pub struct Axes {
    /// Title.
    pub title: String,
    /// Label of the horizontal axis, with its unit.
    pub x_label: String,
    /// Label of the vertical axis, with its unit.
    pub y_label: String,
    /// Ends of the horizontal axis; `None` chooses a range that contains all points.
    pub x: Option<[f64; 2]>,
    /// Ends of the vertical axis; `None` chooses a range that contains all points and the levels of
    /// [`curves`].
    pub y: Option<[f64; 2]>,
}

/// A line through points.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    /// Name in the legend; empty for none.
    pub name: String,
    /// Points of the line. A point that is not finite interrupts the line.
    pub points: Vec<[f64; 2]>,
    /// Index of the colour in [`COLOURS`]; an index past the end stands for black.
    pub colour: usize,
    /// If true, the line is dashed.
    pub dashed: bool,
    /// If true, the points are marked.
    pub dots: bool,
}

/// A filled polygon.
#[derive(Clone, Debug, Default)]
pub struct Area {
    /// Name in the legend.
    pub name: String,
    /// Corners of the polygon.
    pub corners: Vec<[f64; 2]>,
    /// Index of the colour in [`COLOURS`].
    pub colour: usize,
}

/// A table of values, drawn as coloured cells.
#[derive(Clone, Debug, Default)]
pub struct Map {
    /// Title.
    pub title: String,
    /// Label of the columns.
    pub x_label: String,
    /// Label of the rows.
    pub y_label: String,
    /// Quantity and unit of the values.
    pub value_label: String,
    /// Names of the columns, from left to right.
    pub columns: Vec<String>,
    /// Names of the rows, from the bottom up.
    pub rows: Vec<String>,
    /// `[row][column]`; NaN for missing values.
    pub values: Vec<Vec<f64>>,
    /// Cells with at least this value have a frame.
    pub mark_from: Option<f64>,
    /// Values at the ends of the colour scale.
    pub range: [f64; 2],
}

/// Colours that most colour-blind readers can distinguish (Okabe and Ito).
pub const COLOURS: [[u8; 3]; 7] =
    [[0, 114, 178], [0, 158, 115], [230, 159, 0], [213, 94, 0], [204, 121, 167], [86, 180, 233], [120, 94, 20]];

/// Width and height in SVG units.
const SIZE: (u32, u32) = (760, 400);
const LEGEND: u32 = 214;
/// The library plotters has integer coordinates. Curves are drawn enlarged by this factor, so that
/// steps are not visible.
const FINE: u32 = 4;

/// Draws curves in front of bars `[from, to, height as a fraction of the axis]`, and in front of
/// horizontal lines at `levels` (name, y).
///
/// # Errors
/// If an axis has no given ends, and no finite point or level determines them.
pub fn curves(axes: &Axes, curves: &[Curve], bars: &[[f64; 3]], levels: &[(String, f64)]) -> Result<String, PlotError> {
    let points = || curves.iter().flat_map(|curve| &curve.points).filter(|p| p.iter().all(|v| v.is_finite()));
    let x = axes.x.or_else(|| ends(points().map(|p| p[0]), 0.0));
    let y = axes.y.or_else(|| ends(points().map(|p| p[1]).chain(levels.iter().map(|level| level.1)), 0.06));
    let (Some(x), Some(y)) = (x, y) else {
        return Err(PlotError::new("expected at least one finite point, found none"));
    };
    let mut legend: Vec<Entry> = curves
        .iter()
        .filter(|curve| !curve.name.is_empty())
        .map(|curve| Entry { name: &curve.name, colour: colour(curve.colour), dashed: curve.dashed, area: false })
        .collect();
    legend.extend(levels.iter().map(|(name, _)| Entry { name, colour: BLACK, dashed: true, area: false }));
    framed(axes, x, y, &legend, |chart| {
        for &[from, to, height] in bars {
            let corners = [(from.max(x[0]), y[0]), (to.min(x[1]), y[0] + height * (y[1] - y[0]))];
            if corners[0].0 < corners[1].0 {
                chart.draw_series([Rectangle::new(corners, RGBColor(210, 210, 214).filled())])?;
            }
        }
        for (_, level) in levels {
            chart.draw_series(DashedLineSeries::new(
                [(x[0], *level), (x[1], *level)],
                5 * FINE,
                4 * FINE,
                BLACK.mix(0.7).stroke_width(FINE),
            ))?;
        }
        for curve in curves {
            let style = colour(curve.colour).stroke_width(2 * FINE);
            for part in curve.points.split(|p| !p.iter().all(|v| v.is_finite())).filter(|part| !part.is_empty()) {
                for line in inside(part, y) {
                    if curve.dashed {
                        chart.draw_series(DashedLineSeries::new(line, 7 * FINE, 5 * FINE, style))?;
                    } else {
                        chart.draw_series(LineSeries::new(line, style))?;
                    }
                }
                if curve.dots {
                    let seen = part.iter().filter(|p| (y[0]..=y[1]).contains(&p[1]));
                    let dots = seen.map(|p| Circle::new((p[0], p[1]), 3 * FINE as i32, colour(curve.colour).filled()));
                    chart.draw_series(dots)?;
                }
            }
        }
        Ok(())
    })
}

/// Draws areas over one another, the largest first.
///
/// # Errors
/// If an axis has no given ends, and no finite corner determines them.
pub fn areas(axes: &Axes, areas: &[Area]) -> Result<String, PlotError> {
    let corners = || areas.iter().flat_map(|area| &area.corners).filter(|p| p.iter().all(|v| v.is_finite()));
    let x = axes.x.or_else(|| ends(corners().map(|p| p[0]), 0.06));
    let y = axes.y.or_else(|| ends(corners().map(|p| p[1]), 0.06));
    let (Some(x), Some(y)) = (x, y) else { return Err(PlotError::new("expected finite corners, found none")) };
    let legend: Vec<Entry> = areas
        .iter()
        .map(|area| Entry { name: &area.name, colour: colour(area.colour), dashed: false, area: true })
        .collect();
    let mut order: Vec<&Area> = areas.iter().collect();
    order.sort_by(|a, b| surface(&b.corners).total_cmp(&surface(&a.corners)));
    framed(axes, x, y, &legend, |chart| {
        for area in order {
            let corners: Vec<(f64, f64)> = area.corners.iter().map(|p| (p[0], p[1])).collect();
            let closed: Vec<(f64, f64)> = corners.iter().chain(corners.first()).copied().collect();
            chart.draw_series([Polygon::new(corners, colour(area.colour).mix(0.16).filled())])?;
            chart.draw_series(LineSeries::new(closed, colour(area.colour).stroke_width(2 * FINE)))?;
        }
        Ok(())
    })
}

/// Draws a map: a cell for each value, with the value as text, coloured from dark blue to yellow.
///
/// # Errors
/// If the map has no cells.
pub fn map(map: &Map) -> Result<String, PlotError> {
    let (rows, cols) = (map.rows.len(), map.columns.len());
    if rows == 0 || cols == 0 {
        return Err(PlotError::new("expected a map with cells, found none"));
    }
    // Size the cells for a map of at most about 560 × 300 units. Cells have at least 34 × 24 units.
    let cell = [(560 / cols as i32).clamp(34, 84), (300 / rows as i32).clamp(24, 46)];
    let [left, top, below] = [74, 44, 58];
    let size = ((left + cell[0] * cols as i32 + 26).max(420) as u32, (top + cell[1] * rows as i32 + below) as u32);
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Drawn {
        let root = SVGBackend::with_string(svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let anchor = |size: i32, h: HPos, v: VPos, colour: RGBColor| {
            (FAMILY, size).into_font().color(&colour).pos(Pos::new(h, v))
        };
        let write = |text: String, x: i32, y: i32, size: i32, h: HPos, colour: RGBColor| {
            root.draw(&Text::new(text, (x, y), anchor(size, h, VPos::Center, colour)))
        };
        write(map.title.clone(), left, 16, 15, HPos::Left, BLACK)?;
        write(map.value_label.clone(), left, 33, 12, HPos::Left, RGBColor(90, 90, 90))?;
        // Draw cells row by row, from the bottom up, each with its value as text.
        for (row, (name, values)) in map.rows.iter().zip(&map.values).enumerate() {
            let y = top + cell[1] * (rows - 1 - row) as i32;
            write(name.clone(), left - 8, y + cell[1] / 2, 13, HPos::Right, BLACK)?;
            for (col, &value) in values.iter().enumerate() {
                let x = left + cell[0] * col as i32;
                let share = ((value - map.range[0]) / (map.range[1] - map.range[0])).clamp(0.0, 1.0);
                let filled = if value.is_nan() { RGBColor(238, 238, 238) } else { heat(share) };
                root.draw(&Rectangle::new([(x, y), (x + cell[0] - 2, y + cell[1] - 2)], filled.filled()))?;
                if map.mark_from.is_some_and(|least| value >= least) {
                    let frame = [(x + 1, y + 1), (x + cell[0] - 3, y + cell[1] - 3)];
                    root.draw(&Rectangle::new(frame, BLACK.stroke_width(2)))?;
                }
                let ink = if share > 0.6 { BLACK } else { WHITE };
                let number = match value {
                    value if value.is_nan() => String::new(),
                    value if value > CAP_DB => format!(">{CAP_DB:.0}"),
                    value => format!("{value:.1}"),
                };
                write(number, x + cell[0] / 2 - 1, y + cell[1] / 2 - 1, 12, HPos::Center, ink)?;
            }
        }
        // Label the axes.
        let under = top + cell[1] * rows as i32;
        for (col, name) in map.columns.iter().enumerate() {
            let x = left + cell[0] * col as i32 + cell[0] / 2 - 1;
            write(name.clone(), x, under + 10, 13, HPos::Center, BLACK)?;
        }
        let middle = left + cell[0] * cols as i32 / 2;
        write(map.x_label.clone(), middle, under + 34, 14, HPos::Center, BLACK)?;
        let upright = anchor(14, HPos::Center, VPos::Center, BLACK).transform(FontTransform::Rotate270);
        root.draw(&Text::new(map.y_label.clone(), (16, (top + under) / 2), upright))?;
        root.present()?;
        Ok(())
    };
    draw(&mut svg).map_err(PlotError::new)?;
    Ok(described(&svg, &map.title))
}

/// Largest value that a map prints as a number, dB. A larger value is printed as ">60".
pub const CAP_DB: f64 = 60.0;

struct Entry<'a> {
    name: &'a str,
    colour: RGBColor,
    dashed: bool,
    area: bool,
}

/// Draws axes, the legend on the right, and `content`.
fn framed(
    axes: &Axes,
    x: [f64; 2],
    y: [f64; 2],
    legend: &[Entry],
    content: impl FnOnce(&mut Chart) -> Drawn,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    let draw = |svg: &mut String| -> Drawn {
        // Split the area into plot and legend, at the enlarged scale.
        let root = SVGBackend::with_string(svg, (FINE * SIZE.0, FINE * SIZE.1)).into_drawing_area();
        root.fill(&WHITE)?;
        let (plot, side) = root.split_horizontally(FINE * (SIZE.0 - if legend.is_empty() { 16 } else { LEGEND }));
        let text = |size: u32| (FAMILY, FINE * size).into_font().color(&BLACK);
        let fine = |length: i32| FINE as i32 * length;
        let mut chart = ChartBuilder::on(&plot)
            .margin(fine(10))
            .margin_top(fine(if axes.title.is_empty() { 10 } else { 34 }))
            .x_label_area_size(fine(46))
            .y_label_area_size(fine(64))
            .build_cartesian_2d(x[0]..x[1], y[0]..y[1])?;
        let (x_digits, y_digits) = (digits(x), digits(y));
        let number = |value: f64, digits: usize| {
            // Print −0 as 0.
            let value = if value.abs() < 0.5 * 0.1f64.powi(digits as i32) { 0.0 } else { value };
            format!("{value:.digits$}").replace('-', "−")
        };
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12).stroke_width(FINE))
            .axis_style(BLACK.mix(0.6).stroke_width(FINE))
            .set_all_tick_mark_size(fine(5))
            .x_desc(axes.x_label.as_str())
            .y_desc(axes.y_label.as_str())
            .x_labels(8)
            .y_labels(7)
            .x_label_formatter(&|x| number(*x, x_digits))
            .y_label_formatter(&|y| number(*y, y_digits))
            .label_style(text(13))
            .axis_desc_style(text(14))
            .draw()?;
        content(&mut chart)?;
        drop(chart);
        // Draw title and legend over the finished chart.
        root.draw(&Text::new(axes.title.clone(), (fine(14), fine(10)), text(15)))?;
        let mut at = 36;
        for entry in legend {
            let style = entry.colour.stroke_width(2 * FINE);
            if entry.area {
                side.draw(&Rectangle::new(
                    [(fine(4), fine(at - 6)), (fine(24), fine(at + 6))],
                    entry.colour.mix(0.16).filled(),
                ))?;
                side.draw(&Rectangle::new([(fine(4), fine(at - 6)), (fine(24), fine(at + 6))], style))?;
            } else {
                let pieces: &[(i32, i32)] = if entry.dashed { &[(4, 11), (16, 24)] } else { &[(4, 24)] };
                for &(from, to) in pieces {
                    side.draw(&PathElement::new([(fine(from), fine(at)), (fine(to), fine(at))], style))?;
                }
            }
            for line in wrapped(entry.name, 26) {
                let place = text(12).pos(Pos::new(HPos::Left, VPos::Center));
                side.draw(&Text::new(line, (fine(30), fine(at)), place))?;
                at += 16;
            }
            at += 6;
        }
        root.present()?;
        Ok(())
    };
    draw(&mut svg).map_err(PlotError::new)?;
    // Set the nominal size; the view box keeps the enlarged coordinates.
    let [width, height] = [SIZE.0, SIZE.1].map(|side| (FINE * side, side));
    let svg = svg.replacen(
        &format!("width=\"{}\" height=\"{}\"", width.0, height.0),
        &format!("width=\"{}\" height=\"{}\"", width.1, height.1),
        1,
    );
    Ok(described(&svg, &format!("{}: {} over {}", axes.title, axes.y_label, axes.x_label)))
}

fn colour(place: usize) -> RGBColor {
    COLOURS.get(place).map_or(BLACK, |&[r, g, b]| RGBColor(r, g, b))
}

/// Returns a colour of a scale from dark blue through green to yellow, with increasing lightness.
fn heat(share: f64) -> RGBColor {
    const STOPS: [[f64; 3]; 5] =
        [[49.0, 38.0, 96.0], [52.0, 84.0, 140.0], [32.0, 138.0, 134.0], [98.0, 190.0, 92.0], [246.0, 226.0, 60.0]];
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let (at, t) = ((place as usize).min(STOPS.len() - 2), place - (place as usize).min(STOPS.len() - 2) as f64);
    let [r, g, b] = [0, 1, 2].map(|c| (STOPS[at][c] + t * (STOPS[at + 1][c] - STOPS[at][c])).round() as u8);
    RGBColor(r, g, b)
}

/// Cuts a polyline into the pieces that lie between two heights.
fn inside(points: &[[f64; 2]], [low, high]: [f64; 2]) -> Vec<Vec<(f64, f64)>> {
    let mut parts: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut part: Vec<(f64, f64)> = Vec::new();
    if let [only] = points
        && (low..=high).contains(&only[1])
    {
        return vec![vec![(only[0], only[1])]];
    }
    for pair in points.windows(2) {
        let ([x0, y0], [x1, y1]) = (pair[0], pair[1]);
        // Returns the position of the height y on the segment: 0 at its start, 1 at its end.
        let at = |y: f64| if y1 == y0 { f64::NAN } else { (y - y0) / (y1 - y0) };
        let (a, b) = (at(low).min(at(high)), at(low).max(at(high)));
        let (from, to) = if y1 == y0 {
            if (low..=high).contains(&y0) { (0.0, 1.0) } else { (1.0, 0.0) }
        } else {
            (a.max(0.0), b.min(1.0))
        };
        if from > to {
            parts.extend((!part.is_empty()).then(|| std::mem::take(&mut part)));
            continue;
        }
        let point = |t: f64| (x0 + t * (x1 - x0), y0 + t * (y1 - y0));
        if part.is_empty() {
            part.push(point(from));
        }
        part.push(point(to));
        if to < 1.0 {
            parts.push(std::mem::take(&mut part));
        }
    }
    parts.extend((!part.is_empty()).then_some(part));
    parts
}

/// Breaks a text at spaces into lines of at most `most` characters.
fn wrapped(text: &str, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= most => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

/// Returns twice the area of a polygon.
fn surface(corners: &[[f64; 2]]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::png;

    fn axes() -> Axes {
        Axes { title: "Bounds".into(), x_label: "depth, mm".into(), y_label: "cycles/mm".into(), x: None, y: None }
    }

    #[test]
    fn text_shows_in_the_png() {
        let curve = Curve { name: "three layers β".into(), points: vec![[0.0, 1.0], [2.0, 3.0]], ..Curve::default() };
        let svg = curves(&axes(), &[curve], &[[0.0, 1.0, 0.5]], &[("ω0".into(), 2.0)]).unwrap();
        assert!(svg.contains("three layers β") && svg.contains("aria-label=\"Bounds: cycles/mm over depth, mm\""));
        let with = image::load_from_memory(&png(&svg, 1.0).unwrap()).unwrap().to_luma8();
        let start = svg.find("three layers β").unwrap();
        let without = svg.replacen(&svg[start..start + "three layers β".len()], "", 1);
        let without = image::load_from_memory(&png(&without, 1.0).unwrap()).unwrap().to_luma8();
        assert_eq!((with.width(), with.height()), SIZE);
        let changed = with.pixels().zip(without.pixels()).filter(|(a, b)| a != b).count();
        assert!(changed > 100, "the legend's letters are {changed} pixels");
    }

    #[test]
    fn curves_are_cut_at_the_axis() {
        let line = inside(&[[0.0, 0.0], [1.0, 10.0], [2.0, 0.0]], [0.0, 5.0]);
        assert_eq!(line, [vec![(0.0, 0.0), (0.5, 5.0)], vec![(1.5, 5.0), (2.0, 0.0)]]);
        assert!(inside(&[[0.0, 9.0], [1.0, 9.0]], [0.0, 5.0]).is_empty());
        assert_eq!(inside(&[[3.0, 1.0]], [0.0, 5.0]), [vec![(3.0, 1.0)]]);
    }

    #[test]
    fn nothing_to_draw_is_an_error() {
        assert!(curves(&axes(), &[], &[], &[]).is_err());
        assert!(map(&Map::default()).is_err());
        let nan = Curve { points: vec![[f64::NAN, 1.0]], ..Curve::default() };
        assert!(curves(&axes(), &[nan], &[], &[]).is_err());
    }

    #[test]
    fn a_map_prints_its_numbers() {
        let drawn = map(&Map {
            title: "PSNR".into(),
            columns: vec!["1".into(), "2".into()],
            rows: vec!["β 0.2".into()],
            values: vec![vec![31.25, 75.0]],
            mark_from: Some(40.0),
            range: [20.0, 50.0],
            ..Map::default()
        })
        .unwrap();
        assert!(drawn.contains("31.2") && drawn.contains("&gt;60"), "{drawn}");
    }
}
