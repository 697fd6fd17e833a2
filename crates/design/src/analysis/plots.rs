//! Plots of several displays: the bound over depth (the paper's Figure 6) and the spectral supports
//! (Figure 4).

use super::{Analysis, Scene};
use lumistack_plot::{self as plot, Area, Axes, Curve, PlotError};

/// Largest plotted bound, as a multiple of the highest frequency of the light field's pixels.
const MOST_DETAIL: f64 = 4.0;

impl Analysis {
    /// Draws the bound over depth along an axis (0: x, 1: y), as SVG. Each display has a curve of
    /// its bound. Dashed curves show each closed form that differs from the bound by more than 1 %,
    /// and the bound of each lens array alone, without layers. The depth histogram of the first
    /// scene is in the background.
    ///
    /// # Errors
    /// If the plot cannot be drawn.
    pub fn depth_of_field_plot(all: &[Self], axis: usize) -> Result<String, PlotError> {
        let own = all.iter().map(|analysis| analysis.axes[axis].own_cutoff).fold(0.0, f64::max);
        let reach = all.iter().flat_map(|analysis| analysis.axes[axis].bound.last()).map(|p| p[0]).fold(0.0, f64::max);
        let mut curves = Vec::new();
        let mut highest = own;
        for (colour, analysis) in all.iter().enumerate() {
            let found = &analysis.axes[axis];
            highest = found.bound.iter().map(|p| p[1]).fold(highest, f64::max);
            curves.push(Curve { name: analysis.name.clone(), points: found.bound.clone(), colour, ..Curve::default() });
            for form in [&found.closed, &found.lens_array].into_iter().flatten() {
                if form.equation == 23 || form.largest_difference > 0.01 {
                    let of = if form.equation == 23 { "its lens array alone" } else { "closed form" };
                    let name = format!("eq. {}: {of}", form.equation);
                    let points = form.bound.clone();
                    // Displays with the same lens array share one curve for it.
                    let same = |other: &Curve| other.name == name && other.points.first() == points.first();
                    if curves.iter().any(same) {
                        continue;
                    }
                    curves.push(Curve { name, points, colour, dashed: true, ..Curve::default() });
                }
            }
        }
        let scene = all.iter().find_map(|analysis| analysis.scene.as_ref());
        let mut levels: Vec<(String, f64)> = Vec::new();
        for analysis in all {
            let level = analysis.axes[axis].layer_cutoff;
            if !levels.iter().any(|(_, other)| (other / level - 1.0).abs() < 1e-6) {
                levels.push((format!("ω0 of a layer, {level:.2}"), level));
            }
        }
        let axes = Axes {
            title: format!("Bound of spatial frequency over depth, {}", ["horizontal", "vertical"][axis]),
            x_label: "depth, mm towards the viewer".into(),
            y_label: "highest frequency, cycles/mm".into(),
            x: Some([-reach, reach]),
            y: Some([0.0, 1.06 * highest.min(MOST_DETAIL * own)]),
        };
        let mut drawn = plot::curves(&axes, &curves, &scene.map_or(Vec::new(), bars), &levels)?;
        if scene.is_some() {
            drawn =
                drawn.replacen("aria-label=\"", "aria-label=\"Grey: fraction of the scene's hits at each depth. ", 1);
        }
        Ok(drawn)
    }

    /// Draws the spectral supports along an axis (0: x, 1: y), as SVG.
    ///
    /// # Errors
    /// If there are no displays.
    pub fn support_plot(all: &[Self], axis: usize) -> Result<String, PlotError> {
        let areas: Vec<Area> = all
            .iter()
            .enumerate()
            .map(|(colour, analysis)| Area {
                name: analysis.name.clone(),
                corners: analysis.axes[axis].support.clone(),
                colour,
            })
            .collect();
        let axes = Axes {
            title: format!("Upper bound on bandwidth, {}", ["horizontal", "vertical"][axis]),
            x_label: "spatial frequency, cycles/mm".into(),
            y_label: "cycles per unit of slope".into(),
            ..Axes::default()
        };
        plot::areas(&axes, &areas)
    }
}

/// Returns the scene's depth histogram, scaled so that the largest bar has 0.9 of the plot's
/// height.
fn bars(scene: &Scene) -> Vec<[f64; 3]> {
    let most = scene.shares.iter().map(|bar| bar[2]).fold(1e-9, f64::max);
    scene.shares.iter().map(|[from, to, share]| [*from, *to, 0.9 * share / most]).collect()
}
