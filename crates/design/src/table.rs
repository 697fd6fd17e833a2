//! Results of many designs: a table as CSV, and plots like the paper's Figures 7 and 8.

use lumistack_display::{Backlight, Display};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use lumistack_plot::{self as plot, Axes, COLOURS, Curve, Map, PlotError};

/// One design: its parameters and hardware requirements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Design {
    /// Name of the display file that the design varies.
    pub display: String,
    /// Number of layers N.
    pub layers: usize,
    /// Number of frames M.
    pub frames: usize,
    /// Brightness scale β.
    pub brightness: f64,
    /// Mean distance between neighbouring layers, millimetres. For a single layer, the layer's
    /// distance to the directional backlight, or 0 without such a backlight.
    pub gap_mm: f64,
    /// Field of view: [horizontal, vertical] full angles, degrees.
    pub fov_deg: [f64; 2],
    /// [columns, rows] of lenslets; [0, 0] without lenslets.
    pub lenslets: [usize; 2],
    /// Distance from the rearmost to the frontmost plane, millimetres. The planes are the layers,
    /// and the lenslets of a directional backlight.
    pub thickness_mm: f64,
    /// Number of panels: the layers, and the panel behind the lenslets.
    pub panels: usize,
    /// Lowest refresh rate at which the display does not flicker, hertz; 0 for a static display.
    pub refresh_hz: f64,
    /// Values of the patterns per ray of the light field: the degrees of freedom. With 1 or more,
    /// each ray could have its own value.
    pub values_per_ray: f64,
}

impl Design {
    /// Returns the design of a display.
    pub fn of(name: &str, display: &Display) -> Self {
        let layers = &display.layers;
        let d_mm = || layers.iter().map(|layer| layer.d_mm);
        let (first, last) = d_mm().fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(d), b.max(d)));
        let pixels = |[cols, rows]: [usize; 2]| (cols * rows) as f64;
        let mut values: f64 = layers.iter().map(|layer| pixels(layer.resolution)).sum();
        let (mut rear, mut lenslets) = (first, [0, 0]);
        if let Backlight::Lenslets(backlight) = &display.backlight {
            (rear, lenslets) = (backlight.d_mm, backlight.lenslets);
            values += pixels(lenslets) * pixels(backlight.views);
        }
        let rays = pixels(display.field.resolution) * pixels(display.views());
        Self {
            display: name.into(),
            layers: layers.len(),
            frames: display.frames,
            brightness: display.brightness,
            gap_mm: if layers.len() > 1 { (last - first) / (layers.len() - 1) as f64 } else { first - rear },
            fov_deg: display.field.fov_deg,
            lenslets,
            thickness_mm: last - rear,
            panels: layers.len() + usize::from(lenslets != [0, 0]),
            refresh_hz: if display.subframes() > 1 { Display::FLICKER_HZ * display.subframes() as f64 } else { 0.0 },
            values_per_ray: display.frames as f64 * values / rays,
        }
    }
}

/// A design and its results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The design.
    pub design: Design,
    /// Zone score: PSNR of seen pictures over the whole zone, dB. `None` without reference
    /// pictures.
    #[serde(default)]
    pub psnr_zone_db: Option<f64>,
    /// As `psnr_zone_db`, but only over the tenth of the directions with the lowest PSNR, dB.
    #[serde(default)]
    pub psnr_zone_worst_tenth_db: Option<f64>,
    /// PSNR of L̃/β against L, dB, at most [`MOST_DB`]. `None` if no ray was scored.
    pub psnr_view_db: Option<f64>,
    /// PSNR of L̃ against βL, dB, at most [`MOST_DB`]. `None` if no ray was scored.
    pub psnr_raw_db: Option<f64>,
    /// PSNR of L̃/β at views between the target's views, dB; `None` if these views are not known.
    pub psnr_between_db: Option<f64>,
    /// PSNR of L̃/β against L at the worst time step of a sequence, dB; `None` for a still. The
    /// other scores are over all time steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_worst_db: Option<f64>,
    /// Results of each node, for a job with several nodes. The scores above are then the scores of
    /// the first node.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeRow>,
}

impl Row {
    /// Returns the PSNR by which designs are ranked, dB: the zone score or, without reference
    /// pictures, the PSNR at the target views. −∞ if nothing was scored.
    pub fn quality_db(&self) -> f64 {
        self.psnr_zone_db.or(self.psnr_view_db).unwrap_or(f64::NEG_INFINITY)
    }

    /// Returns [`quality_db`](Self::quality_db) as a text with its unit.
    pub fn quality_text(&self) -> String {
        let quality_db = self.quality_db();
        if quality_db.is_finite() { format!("{quality_db:.1} dB") } else { "no score".into() }
    }
}

/// Results of one node with a design.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeRow {
    /// Name of the node.
    pub id: String,
    /// Zone score of the node, dB; `None` without reference pictures.
    #[serde(default)]
    pub psnr_zone_db: Option<f64>,
    /// Zone score over the tenth of the directions with the lowest PSNR, dB.
    #[serde(default)]
    pub psnr_zone_worst_tenth_db: Option<f64>,
    /// PSNR of L̃/β against L, dB, at most [`MOST_DB`]. `None` if no ray was scored.
    pub psnr_view_db: Option<f64>,
    /// PSNR of L̃ against βL, dB, at most [`MOST_DB`]. `None` if no ray was scored.
    pub psnr_raw_db: Option<f64>,
    /// PSNR of L̃/β at views between the target's views, dB; `None` if these views are not known.
    pub psnr_between_db: Option<f64>,
    /// PSNR of L̃/β against L at the worst time step of a sequence, dB; `None` for a still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_worst_db: Option<f64>,
}

/// Largest PSNR in the table, dB. An exact display has an infinite PSNR, which JSON cannot store.
pub const MOST_DB: f64 = 200.0;

/// Writes the table as CSV: a line of names, then a line per row. Several time steps add a column
/// for the worst time step. Several nodes add columns for each node.
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from(
        "display,layers,frames,brightness,gap_mm,fov_x_deg,fov_y_deg,lenslets_x,lenslets_y,thickness_mm,panels,refresh_hz,values_per_ray,\
         psnr_zone_db,psnr_zone_worst_tenth_db,psnr_view_db,psnr_raw_db,psnr_between_db",
    );
    // Sequences and further nodes add columns to the heading.
    let has_times = rows.iter().any(|row| row.psnr_worst_db.is_some());
    if has_times {
        text.push_str(",psnr_worst_db");
    }
    for node in rows.first().map_or(&[][..], |row| &row.nodes) {
        text.push_str(&format!(",{0}_psnr_zone_db,{0}_psnr_view_db", node.id));
        if has_times {
            text.push_str(&format!(",{}_psnr_worst_db", node.id));
        }
    }
    text.push('\n');
    // Only names may need quotes; a missing score is an empty cell.
    for row in rows {
        let d = &row.design;
        let name = if d.display.contains([',', '"', '\n']) {
            format!("\"{}\"", d.display.replace('"', "\"\""))
        } else {
            d.display.clone()
        };
        let numbers = [
            d.layers as f64,
            d.frames as f64,
            d.brightness,
            d.gap_mm,
            d.fov_deg[0],
            d.fov_deg[1],
            d.lenslets[0] as f64,
            d.lenslets[1] as f64,
            d.thickness_mm,
            d.panels as f64,
            d.refresh_hz,
        ];
        let mut cells: Vec<String> = std::iter::once(name).chain(numbers.map(|n| rounded(n, 6))).collect();
        cells.push(rounded(d.values_per_ray, 4));
        let cell = |psnr: Option<f64>| psnr.map_or(String::new(), |psnr| format!("{psnr:.3}"));
        cells.extend([row.psnr_zone_db, row.psnr_zone_worst_tenth_db].map(cell));
        cells.extend([row.psnr_view_db, row.psnr_raw_db, row.psnr_between_db].map(cell));
        cells.extend(has_times.then(|| cell(row.psnr_worst_db)));
        for node in &row.nodes {
            cells.extend([node.psnr_zone_db, node.psnr_view_db].map(cell));
            cells.extend(has_times.then(|| cell(node.psnr_worst_db)));
        }
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    text
}

/// Returns a number with at most `digits` decimals.
fn rounded(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// An axis along which designs differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Axis {
    Display,
    Layers,
    Frames,
    Brightness,
    Gap,
    Fov,
    VerticalFov,
    Lenslets,
    LensletRows,
}

impl Axis {
    const ALL: [Self; 9] = [
        Self::Display,
        Self::Layers,
        Self::Frames,
        Self::Brightness,
        Self::Gap,
        Self::Fov,
        Self::VerticalFov,
        Self::Lenslets,
        Self::LensletRows,
    ];

    /// Returns the label of the axis, with the unit.
    fn label(self) -> &'static str {
        match self {
            Self::Display => "display",
            Self::Layers => "layers N",
            Self::Frames => "frames M",
            Self::Brightness => "brightness β",
            Self::Gap => "distance of layers Δd, mm",
            Self::Fov => "horizontal field of view α, degrees",
            Self::VerticalFov => "vertical field of view, degrees",
            Self::Lenslets => "lenslets per row",
            Self::LensletRows => "rows of lenslets",
        }
    }

    fn stem(self) -> &'static str {
        match self {
            Self::Display => "display",
            Self::Layers => "layers",
            Self::Frames => "frames",
            Self::Brightness => "brightness",
            Self::Gap => "gap",
            Self::Fov => "fov",
            Self::VerticalFov => "vertical-fov",
            Self::Lenslets => "lenslets",
            Self::LensletRows => "lenslet-rows",
        }
    }

    /// Returns the position of a design on this axis.
    fn number(self, design: &Design) -> f64 {
        match self {
            Self::Display => f64::NAN,
            Self::Layers => design.layers as f64,
            Self::Frames => design.frames as f64,
            Self::Brightness => design.brightness,
            Self::Gap => design.gap_mm,
            Self::Fov => design.fov_deg[0],
            Self::VerticalFov => design.fov_deg[1],
            Self::Lenslets => design.lenslets[0] as f64,
            Self::LensletRows => design.lenslets[1] as f64,
        }
    }

    /// Returns true if the design has a position on this axis.
    fn concerns(self, design: &Design) -> bool {
        match self {
            Self::Gap => design.layers > 1,
            Self::Lenslets | Self::LensletRows => design.lenslets != [0, 0],
            _ => true,
        }
    }

    /// Returns true if designs differ along this axis. A vertical value often follows from the
    /// horizontal value, for example if both fields of view are equal. The vertical value is then
    /// no separate axis.
    fn varies(self, rows: &[Row]) -> bool {
        let differ = |rows: &[Row]| values(rows, self).len() > 1;
        match self {
            Self::VerticalFov => groups(rows, &[Self::Fov]).iter().any(|part| differ(part)),
            Self::LensletRows => groups(rows, &[Self::Lenslets]).iter().any(|part| differ(part)),
            _ => differ(rows),
        }
    }

    /// Returns the value of a design on this axis as a text. Different values have different texts.
    fn name(self, design: &Design) -> String {
        match self {
            Self::Display => design.display.clone(),
            axis => rounded(axis.number(design), 4),
        }
    }

    /// Returns the name and value of a design on this axis, for titles.
    fn with_value(self, design: &Design) -> String {
        let value = self.name(design);
        match self {
            Self::Display => value,
            Self::Layers => format!("N = {value}"),
            Self::Frames => format!("M = {value}"),
            Self::Brightness => format!("β = {value}"),
            Self::Gap => format!("Δd = {value} mm"),
            Self::Fov => format!("α = {value}°"),
            Self::VerticalFov => format!("vertical α = {value}°"),
            Self::Lenslets | Self::LensletRows if design.lenslets == [0, 0] => "no lenslets".into(),
            Self::Lenslets => format!("{value} lenslets"),
            Self::LensletRows => format!("{value} rows of lenslets"),
        }
    }
}

/// A plot of the table: the stem of its file name, and the SVG.
pub type Plot = (String, String);

/// Largest number of maps per pair of axes, and of plots of curves per axis.
const MOST_PLOTS: usize = 12;
/// Largest number of plots if the job does not request all.
const FEW_PLOTS: usize = 6;
/// The paper's threshold of good quality.
const GOOD_DB: f64 = 40.0;

/// Selection of the plots of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Plots {
    /// No plots.
    None,
    /// At most six plots: maps over one pair of axes, then curves along the other axes. The pair is
    /// the first of (frames, layers), (frames, brightness) and (layers, brightness) whose two axes
    /// the sweep varies.
    #[default]
    Few,
    /// Maps over every pair of the axes layers, frames and brightness, and curves along every axis
    /// except displays. Each combination of values on the remaining axes has separate plots, at
    /// most twelve per pair or axis.
    All,
}

/// The content of a plot: a map over two axes, or curves along the first axis, with one curve per
/// value of the second axis.
enum View {
    Map(Axis, Axis),
    Curves(Axis, Option<Axis>),
}

/// A possible plot: its name, content, rows, and the axes along which these rows agree.
struct Sketch {
    stem: String,
    view: View,
    part: Vec<Row>,
    others: Vec<Axis>,
}

/// Draws plots of [`Row::quality_db`] over the axes along which designs differ. Maps have two of
/// the axes layers, frames and brightness (the paper's Figures 7 and 8), and curves have one axis.
/// Also returns the number of plots that `which` omits.
///
/// # Errors
/// If drawing fails.
pub fn plots(rows: &[Row], which: Plots) -> Result<(Vec<Plot>, usize), PlotError> {
    let all = if scores(rows).next().is_some() { sketches(rows) } else { Vec::new() };
    let count = all.len();
    let chosen = match which {
        Plots::None => Vec::new(),
        Plots::Few => few(all),
        Plots::All => all,
    };
    let draw = |Sketch { stem, view, part, others }: Sketch| -> Result<Plot, PlotError> {
        let drawn = match view {
            View::Map(x, y) => map_of(rows, &part, x, y, &others),
            View::Curves(x, by) => curves_of(rows, &part, x, by, &others),
        };
        Ok((stem, drawn?))
    };
    let plots = chosen.into_iter().map(draw).collect::<Result<Vec<Plot>, PlotError>>()?;
    let more = count - plots.len();
    Ok((plots, more))
}

/// Returns the scores of the designs that have one, dB.
fn scores(rows: &[Row]) -> impl Iterator<Item = f64> {
    rows.iter().map(|row| row.quality_db()).filter(|psnr| psnr.is_finite())
}

fn sketches(rows: &[Row]) -> Vec<Sketch> {
    let varying: Vec<Axis> = Axis::ALL.into_iter().filter(|axis| axis.varies(rows)).collect();
    let mut found = Vec::new();
    let pairs = [(Axis::Frames, Axis::Layers), (Axis::Frames, Axis::Brightness), (Axis::Layers, Axis::Brightness)];
    for (x, y) in pairs.into_iter().filter(|(x, y)| varying.contains(x) && varying.contains(y)) {
        let others: Vec<Axis> = varying.iter().copied().filter(|axis| ![x, y].contains(axis)).collect();
        for (number, part) in groups(rows, &others).into_iter().take(MOST_PLOTS).enumerate() {
            let stem = format!("psnr-{}-{}-{:02}", x.stem(), y.stem(), number + 1);
            found.push(Sketch { stem, view: View::Map(x, y), part, others: others.clone() });
        }
    }
    for &x in varying.iter().filter(|axis| **axis != Axis::Display) {
        let by = varying.iter().copied().find(|axis| *axis != x && *axis != Axis::Display);
        let others: Vec<Axis> = varying.iter().copied().filter(|axis| *axis != x && Some(*axis) != by).collect();
        for (number, part) in groups(rows, &others).into_iter().take(MOST_PLOTS).enumerate() {
            let stem = format!("psnr-{}-{:02}", x.stem(), number + 1);
            found.push(Sketch { stem, view: View::Curves(x, by), part, others: others.clone() });
        }
    }
    found
}

/// Selects the first maps of the first pair of axes, and the first curves along every other axis,
/// at most [`FEW_PLOTS`] together.
fn few(all: Vec<Sketch>) -> Vec<Sketch> {
    let mut shown: Vec<Axis> = Vec::new();
    let mut pair = None;
    let mut chosen = Vec::new();
    for sketch in all {
        let wanted = match sketch.view {
            View::Map(x, y) => *pair.get_or_insert((x, y)) == (x, y) && chosen.len() < FEW_PLOTS - 2,
            View::Curves(x, _) => !shown.contains(&x) && chosen.len() < FEW_PLOTS,
        };
        if wanted {
            match sketch.view {
                View::Map(x, y) => shown.extend([x, y]),
                View::Curves(x, _) => shown.push(x),
            }
            chosen.push(sketch);
        }
    }
    chosen
}

/// Returns the values of an axis in rising order; displays are in the order of the rows.
fn values(rows: &[Row], axis: Axis) -> Vec<String> {
    let mut found: Vec<(f64, String)> = Vec::new();
    for row in rows.iter().filter(|row| axis.concerns(&row.design)) {
        let name = axis.name(&row.design);
        if !found.iter().any(|(_, other)| *other == name) {
            found.push((axis.number(&row.design), name));
        }
    }
    if axis != Axis::Display {
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    found.into_iter().map(|(_, name)| name).collect()
}

/// Returns groups of rows that have equal values on all of `axes`, in order of appearance.
fn groups(rows: &[Row], axes: &[Axis]) -> Vec<Vec<Row>> {
    let mut found: Vec<(Vec<String>, Vec<Row>)> = Vec::new();
    for row in rows {
        let key: Vec<String> = axes.iter().map(|axis| axis.name(&row.design)).collect();
        match found.iter_mut().find(|(other, _)| *other == key) {
            Some((_, part)) => part.push(row.clone()),
            None => found.push((key, vec![row.clone()])),
        }
    }
    found.into_iter().map(|(_, part)| part).collect()
}

/// Returns true if the zone score ranks the designs.
fn of_zone(rows: &[Row]) -> bool {
    rows.iter().any(|row| row.psnr_zone_db.is_some())
}

/// Returns the name and the unit of the score that ranks the designs.
fn score_label(rows: &[Row]) -> &'static str {
    if of_zone(rows) { "PSNR over the whole zone, dB" } else { "PSNR at the target views, dB" }
}

fn title(part: &[Row], others: &[Axis]) -> String {
    let labels: Vec<String> =
        part.first().map_or(Vec::new(), |row| others.iter().map(|axis| axis.with_value(&row.design)).collect());
    if labels.is_empty() { "All designs".into() } else { labels.join(", ") }
}

fn map_of(all: &[Row], part: &[Row], x: Axis, y: Axis, others: &[Axis]) -> Result<String, PlotError> {
    let (columns, rows) = (values(part, x), values(part, y));
    let value = |row: &String, column: &String| {
        let here = part.iter().find(|r| x.name(&r.design) == *column && y.name(&r.design) == *row);
        here.map(|row| row.quality_db()).filter(|psnr| psnr.is_finite()).unwrap_or(f64::NAN)
    };
    let values = rows.iter().map(|row| columns.iter().map(|column| value(row, column)).collect()).collect();
    let lowest = scores(all).fold(f64::MAX, f64::min);
    plot::map(&Map {
        title: title(part, others),
        x_label: x.label().into(),
        y_label: y.label().into(),
        value_label: match of_zone(all) {
            true => score_label(all).into(),
            false => format!("{}; cells with an outline have {GOOD_DB:.0} dB or more", score_label(all)),
        },
        columns,
        rows,
        values,
        // The paper's threshold refers to target views, so plots of zone scores do not mark it.
        mark_from: (!of_zone(all)).then_some(GOOD_DB),
        range: if of_zone(all) { [lowest.min(15.0), 35.0] } else { [lowest.min(20.0), 50.0] },
    })
}

fn curves_of(all: &[Row], part: &[Row], x: Axis, by: Option<Axis>, others: &[Axis]) -> Result<String, PlotError> {
    let names = by.map_or(vec![String::new()], |by| values(part, by));
    let curves = names.iter().enumerate().map(|(place, name)| {
        let own = part.iter().filter(|row| {
            let fits = by.is_none_or(|by| by.name(&row.design) == *name);
            x.concerns(&row.design) && fits && row.quality_db().is_finite()
        });
        let mut points: Vec<[f64; 2]> =
            own.clone().map(|row| [x.number(&row.design), row.quality_db().min(plot::CAP_DB)]).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let first = own.clone().next();
        let name = by.zip(first).map_or(String::new(), |(by, row)| by.with_value(&row.design));
        Curve { name, points, colour: place % COLOURS.len(), dashed: place >= COLOURS.len(), dots: true }
    });
    let lowest = scores(all).fold(f64::MAX, f64::min);
    let highest = scores(all).map(|psnr| psnr.min(plot::CAP_DB)).fold(f64::MIN, f64::max);
    let axes = Axes {
        title: title(part, others),
        x_label: x.label().into(),
        y_label: score_label(all).into(),
        x: None,
        y: Some([(lowest - 1.0).floor(), (highest + 1.0).ceil()]),
    };
    plot::curves(&axes, &curves.collect::<Vec<_>>(), &[], &[])
}

#[cfg(test)]
mod tests {
    use lumistack_display::{LensletBacklight, Variation};

    use super::*;

    fn rows() -> Vec<Row> {
        let base = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 12.0], 2);
        let mut rows = Vec::new();
        for (name, layers, frames) in [("a", 1, 1), ("a", 2, 1), ("a", 1, 3), ("a", 2, 3), ("b, wide", 1, 1)] {
            let variation = Variation { layers: Some(layers), frames: Some(frames), ..Variation::default() };
            let design = Design::of(name, &variation.applied_to(&base).unwrap());
            let psnr = 20.0 + 5.0 * (layers * frames) as f64;
            rows.push(Row {
                design,
                psnr_zone_db: None,
                psnr_zone_worst_tenth_db: None,
                psnr_view_db: Some(psnr),
                psnr_raw_db: Some(psnr),
                psnr_between_db: None,
                psnr_worst_db: None,
                nodes: Vec::new(),
            });
        }
        rows
    }

    #[test]
    fn a_design_lists_its_cost() {
        let mut display = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 0.0, 12.0], 6);
        let design = Design::of("x", &display);
        assert_eq!((design.gap_mm, design.thickness_mm, design.panels, design.refresh_hz), (12.0, 24.0, 3, 360.0));
        assert!((design.values_per_ray - 2.0).abs() < 1e-12, "6 frames of 3 layers for 9 views");
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-20.0, [4, 5], 4.0, [3, 3], [20.0, 20.0]));
        let design = Design::of("x", &display);
        assert_eq!((design.lenslets, design.thickness_mm, design.panels), ([4, 5], 32.0, 4));
        assert!((design.values_per_ray - 6.0 * (3.0 * 160.0 + 180.0) / (9.0 * 160.0)).abs() < 1e-12);
        let still = Display { frames: 1, ..display };
        assert_eq!(Design::of("x", &still).refresh_hz, 0.0);
    }

    #[test]
    fn the_table_has_a_line_per_design() {
        let text = csv(&rows());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 6);
        assert_eq!(lines[0].split(',').count(), 18);
        assert_eq!(lines[1], "a,1,1,1,0,20,20,0,0,0,1,0,0.1111,,,25.000,25.000,");
        assert!(lines[5].starts_with("\"b, wide\",1,1,"));
    }

    #[test]
    fn a_design_without_score_has_empty_cells_and_the_lowest_rank() {
        let mut rows = rows();
        (rows[2].psnr_view_db, rows[2].psnr_raw_db) = (None, None);
        assert!(csv(&rows).lines().nth(3).unwrap().ends_with(",,,,,"), "{}", csv(&rows));
        assert_eq!(rows[2].quality_text(), "no score");
        assert!(rows.iter().all(|row| row.quality_db() >= rows[2].quality_db()));
        let text = serde_json::to_string(&rows).unwrap();
        assert_eq!(serde_json::from_str::<Vec<Row>>(&text).unwrap(), rows);
        let (drawn, _) = plots(&rows, Plots::All).unwrap();
        assert!(drawn.iter().all(|(_, svg)| !svg.contains("NaN") && !svg.contains("inf")));
        rows.iter_mut().for_each(|row| row.psnr_view_db = None);
        assert_eq!(plots(&rows, Plots::All).unwrap(), (Vec::new(), 0));
    }

    #[test]
    fn axes_with_several_values_are_plotted() {
        let stems =
            |which: Plots| -> Vec<String> { plots(&rows(), which).unwrap().0.into_iter().map(|plot| plot.0).collect() };
        let all = stems(Plots::All);
        for stem in ["psnr-frames-layers-01", "psnr-frames-layers-02", "psnr-layers-01", "psnr-frames-01"] {
            assert!(all.iter().any(|other| other == stem), "{stem} is not among {all:?}");
        }
        // Brightness and gap get no plots. Brightness is constant, and so is the gap of the designs
        // with two layers.
        assert!(!all.iter().any(|stem| stem.contains("brightness") || stem.contains("gap")), "{all:?}");
        // The axes layers and frames need no curves, since the maps show them.
        assert_eq!(stems(Plots::Few), ["psnr-frames-layers-01", "psnr-frames-layers-02"]);
        assert_eq!(plots(&rows(), Plots::None).unwrap(), (Vec::new(), all.len()));
        assert!(plots(&rows()[..1], Plots::All).unwrap().0.is_empty(), "one design is no trend");
    }

    #[test]
    fn the_default_has_few_plots() {
        let base = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 12.0], 2);
        // four axes vary, so that there would be many plots
        let mut rows = Vec::new();
        for (layers, frames, tenths) in (2..6).flat_map(|n| (1..4).flat_map(move |m| (1..11).map(move |b| (n, m, b)))) {
            for gap_mm in [5.0, 10.0, 20.0] {
                let brightness = Some(f64::from(tenths) / 10.0);
                let variation = Variation {
                    layers: Some(layers),
                    frames: Some(frames),
                    brightness,
                    gap_mm: Some(gap_mm),
                    ..Variation::default()
                };
                let design = Design::of("a", &variation.applied_to(&base).unwrap());
                rows.push(Row {
                    design,
                    psnr_zone_db: None,
                    psnr_zone_worst_tenth_db: None,
                    psnr_view_db: Some(30.0),
                    psnr_raw_db: Some(40.0),
                    psnr_between_db: None,
                    psnr_worst_db: None,
                    nodes: Vec::new(),
                });
            }
        }
        let (few, more) = plots(&rows, Plots::Few).unwrap();
        let stems: Vec<&str> = few.iter().map(|plot| plot.0.as_str()).collect();
        assert!(few.len() <= FEW_PLOTS && more > 24, "{stems:?} and {more}");
        assert!(
            stems.contains(&"psnr-brightness-01") && stems.contains(&"psnr-gap-01"),
            "every axis is seen: {stems:?}"
        );
    }

    /// Makes rows of designs with these fields of view and these numbers of lenslets.
    fn rows_of(designs: &[([f64; 2], [usize; 2])]) -> Vec<Row> {
        let row = |&(fov_deg, lenslets)| {
            let row = rows().swap_remove(0);
            Row { design: Design { fov_deg, lenslets, ..row.design }, ..row }
        };
        designs.iter().map(row).collect()
    }

    #[test]
    fn designs_that_differ_only_vertically_have_axes_of_their_own() {
        let varying = |designs: &[([f64; 2], [usize; 2])]| -> Vec<Axis> {
            let rows = rows_of(designs);
            Axis::ALL.into_iter().filter(|axis| axis.varies(&rows)).collect()
        };
        let (wide, high, none) = ([20.0, 5.0], [20.0, 20.0], [0, 0]);
        assert_eq!(varying(&[(wide, none), (high, none)]), [Axis::VerticalFov]);
        assert_eq!(varying(&[(wide, [4, 3]), (wide, [4, 6]), (wide, none)]), [Axis::LensletRows]);
        assert_eq!(
            varying(&[(wide, [4, 3]), (high, [4, 3]), ([10.0, 5.0], [8, 3])]),
            [Axis::Fov, Axis::VerticalFov, Axis::Lenslets]
        );
        // a vertical value that follows from the horizontal one has no curves of its own
        assert_eq!(varying(&[([10.0, 10.0], [4, 3]), (high, [8, 6])]), [Axis::Fov, Axis::Lenslets]);
        // no plot has two designs at one place
        let crossed = [(wide, none), (high, none), ([10.0, 5.0], none), ([10.0, 20.0], none)];
        let plots = plots(&rows_of(&crossed), Plots::All).unwrap().0;
        let stems: Vec<&str> = plots.iter().map(|plot| plot.0.as_str()).collect();
        assert_eq!(stems, ["psnr-fov-01", "psnr-vertical-fov-01"]);
        for (_, svg) in &plots {
            assert!(svg.contains("vertical"), "{svg}");
        }
    }
}
