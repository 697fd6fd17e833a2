//! Achieved contrast by depth: the display is solved for gratings of many depths and frequencies.
//!
//! A plane at z with a grating of frequency ω has, along the ray of slope s through x on z = 0, the
//! radiance
//!
//! ```text
//! L(x, s) = ½ (1 + cos φ(x, s)),        φ = 2π ω (x + z s) + φ_0
//! ```
//!
//! The display is solved for this light field, and its emission is compared with the grating. The
//! modulation transfer is
//!
//! ```text
//! contrast = Σ (L̃/β − mean) cos φ / Σ (L − mean) cos φ        over all valid rays
//! ```
//!
//! The mean is the mean of L̃/β, or of L, over these rays. The contrast is 1 for an exact grating
//! and 0 for grey. Axes are measured separately, on a strip with one row of pixels and one row of
//! views. The three channels have three phases φ_0, a third of a period apart, and the result is
//! the mean over the channels.
//!
//! The bound of [`Display::spatial_cutoff`] limits the frequencies that any patterns could show.
//! The contrast is the result of one solver with M frames.
//!
//! There are three measures ([`Achieved`]).
//!
//! * *At the target views*: over the rays of the target. Errors between the views are not measured.
//!   A display may be exact at these rays and yet show nothing of the grating elsewhere.
//! * *In between*: over rays of the whole zone, with [`POINTS`] rays per pixel and at least two
//!   slopes per view. This covers the whole emission, including the pixels' shape.
//! * *With more views*: over the same rays, for patterns that are solved for more views. There is
//!   one view per [`angular_footprint`](Display::angular_footprint); the bound allows no detail
//!   that needs more views. This measures the hardware; *in between* measures the display with its
//!   own number of views. If the display itself has at least as many views, *in between* and *with
//!   more views* are equal.
//!
//! The contrast *in between* obeys the bound, except in narrow zones. A zone is narrow if a grating
//! moves by at most [`HALF_SINC`] periods over it. In such a zone, even a picture that is the same
//! for all slopes has at least half of the grating's contrast.

use std::f64::consts::TAU;

use lumistack_core::{NoProgress, Task};
use lumistack_display::{
    Backlight, Display, FieldGeometry, LayerStack, LightField, RayMap, Simulator, ViewGrid, Views, Weights,
};
pub use lumistack_factorizer::FactorizeError;
use lumistack_factorizer::{Problem, Settings};
use serde::Serialize;
use thiserror::Error;

use lumistack_plot::{self as plot, Axes, Curve, PlotError};

/// Largest number of columns of a strip.
const MOST_COLS: usize = 96;
/// Smallest contrast at which a grating is regarded as shown.
pub const SHOWN: f64 = 0.5;
/// Number of rays per pixel with which contrast over the whole zone is measured.
pub const POINTS: usize = 3;
/// The x at which sin(πx)/(πx) = ½.
pub const HALF_SINC: f64 = 0.603;
/// Approximate number of slopes in the whole zone at which contrast between the views is measured.
const SLOPES: usize = 40;
/// Largest number of views that a strip gets for the measure *with more views*.
const MOST_VIEWS: usize = 48;

/// The gratings to measure, and settings of the solver.
#[derive(Clone, Debug)]
pub struct Gratings {
    /// Depths, millimetres.
    pub depths_mm: Vec<f64>,
    /// Frequencies of the gratings, divided by the highest frequency of the light field's pixels;
    /// above 0 and at most 1.
    pub frequencies: Vec<f64>,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Random seed of the start.
    pub seed: u64,
}

/// Contrast of one grating, by three measures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Contrast {
    /// Depth of the grating, millimetres.
    pub z_mm: f64,
    /// Frequency of the grating, relative to the highest frequency of the light field's pixels.
    pub frequency: f64,
    /// The bound at this depth, relative to the highest frequency of the light field's pixels.
    pub bound: f64,
    /// Contrast at the target views.
    pub contrast: f64,
    /// Contrast of the whole emission into the viewing zone.
    pub between: f64,
    /// Contrast of the whole emission, for patterns that are solved for one view per angular
    /// footprint.
    pub dense: f64,
}

/// Measures of contrast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Achieved {
    /// The contrast at the rays of the target.
    AtTheViews,
    /// The contrast over the whole emission into the viewing zone.
    InBetween,
    /// The contrast over the whole emission, for patterns that are solved for more views.
    WithMoreViews,
}

impl Contrast {
    /// Returns the contrast of the grating by one measure.
    pub fn of(&self, achieved: Achieved) -> f64 {
        match achieved {
            Achieved::AtTheViews => self.contrast,
            Achieved::InBetween => self.between,
            Achieved::WithMoreViews => self.dense,
        }
    }
}

/// Reasons for which the contrast cannot be measured.
#[derive(Debug, Error)]
pub enum ContrastError {
    /// The display cannot be reduced to a strip.
    #[error("contrast: {0}")]
    Display(#[from] lumistack_display::DisplayError),
    /// The strip's light field is invalid.
    #[error("contrast: {0}")]
    Grid(#[from] lumistack_display::GridError),
    /// The factorization failed, or the work was cancelled.
    #[error(transparent)]
    Factorize(#[from] FactorizeError),
}

impl Gratings {
    /// Returns gratings of eight frequencies at depths up to `reach_mm` on both sides.
    pub fn up_to(reach_mm: f64) -> Self {
        Self {
            depths_mm: (0..17).map(|i| reach_mm * (f64::from(i) / 8.0 - 1.0)).collect(),
            frequencies: vec![1.0 / 32.0, 1.0 / 16.0, 0.125, 0.25, 0.375, 0.5, 0.75, 1.0],
            iterations: 60,
            seed: 1,
        }
    }

    /// Solves a display for every grating along an axis (0: x, 1: y), depth by depth.
    ///
    /// # Errors
    /// If the display is invalid, or the work was cancelled.
    pub fn measure(&self, display: &Display, axis: usize, task: Task<'_>) -> Result<Vec<Contrast>, ContrastError> {
        let own_views = strip(display, axis, display.views()[axis])?;
        let useful = useful_views(display, axis);
        let dense = if useful > display.views()[axis] { Some(strip(display, axis, useful)?) } else { None };
        let own = 0.5 / display.field.pitch_mm;
        let mut found = Vec::new();
        task.progress.begin("contrast", (self.depths_mm.len() * self.frequencies.len()) as u64, "gratings");
        for (&z_mm, &frequency) in self.depths_mm.iter().flat_map(|z| self.frequencies.iter().map(move |f| (z, f))) {
            let shown =
                |strip: &Display| self.one(strip, z_mm, frequency * own, task).inspect_err(|_| task.progress.end());
            let bound = display.spatial_cutoff_along(axis, z_mm) / own;
            let [contrast, between] = shown(&own_views)?;
            let dense = dense.as_ref().map(&shown).transpose()?.map_or(between, |[_, between]| between);
            found.push(Contrast { z_mm, frequency, bound, contrast, between, dense });
            task.progress.advance(1, "");
        }
        task.progress.end();
        Ok(found)
    }

    /// Solves a strip for one grating. Returns the contrast at the target views, and the contrast
    /// over rays of the whole zone.
    fn one(&self, strip: &Display, z_mm: f64, frequency: f64, task: Task<'_>) -> Result<[f64; 2], ContrastError> {
        let geometry = strip.geometry()?;
        let mut target = LightField::black(geometry.clone())?;
        let grating = Grating { z_mm, frequency };
        for view in 0..geometry.grid.views()[1] {
            for (i, value) in target.view_mut([0, view]).iter_mut().enumerate() {
                *value = (0.5 + 0.5 * grating.phase(&geometry, view, i).cos()) as f32;
            }
        }
        let settings = Settings {
            iterations: self.iterations,
            seed: self.seed,
            report_every: self.iterations.max(1),
            ..Settings::default()
        };
        let problem = Problem { display: strip, target: &target, weights: &Weights::Uniform };
        let quiet = Task { progress: &NoProgress, ..task };
        let stack = lumistack_factorizer::factorize(&problem, &settings, None, quiet, &mut |_| {})?.stack;
        Ok([&geometry, &finer(&geometry)].map(|geometry| grating.share_of(strip, &stack, geometry)))
    }
}

/// A grating of a depth and frequency, cycles per millimetre.
struct Grating {
    z_mm: f64,
    frequency: f64,
}

impl Grating {
    /// Returns the grating's phase φ at value `i` of a view, whose values are [col][rgb].
    fn phase(&self, geometry: &FieldGeometry, view: usize, i: usize) -> f64 {
        let x = geometry.x_mm(i / 3);
        let s = geometry.grid.slope_at([0, view], [x, 0.0])[0];
        TAU * (self.frequency * (x + self.z_mm * s) + (i % 3) as f64 / 3.0 + 0.1)
    }

    /// Returns the contrast over the rays of a geometry: the formula in the head of the file.
    fn share_of(&self, display: &Display, stack: &LayerStack, geometry: &FieldGeometry) -> f64 {
        let (simulator, map) = (Simulator::new(display, stack), RayMap::new(display, geometry));
        // `sums` has six sums over the rays for each channel: Σ 1, Σ L, Σ L̃/β, Σ cos φ, Σ L cos φ
        // and Σ (L̃/β) cos φ.
        let mut sums = [[0.0f64; 6]; 3];
        for view in 0..geometry.grid.views()[1] {
            let emitted = simulator.view(&map, geometry, [0, view]);
            for (i, shown) in emitted.radiance.data().iter().enumerate().filter(|(i, _)| emitted.valid[i / 3]) {
                let cos = self.phase(geometry, view, i).cos();
                let (shown, wanted) = (f64::from(*shown) / stack.brightness, 0.5 + 0.5 * cos);
                let terms = [1.0, wanted, shown, cos, wanted * cos, shown * cos];
                sums[i % 3].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            }
        }
        let covariance = |k: usize| sums.iter().map(|s| s[3 + k] - s[k] * s[3] / s[0].max(1.0)).sum::<f64>();
        let wanted = covariance(1);
        if wanted.abs() > 1e-9 { covariance(2) / wanted } else { 0.0 }
    }
}

/// Returns the geometry of a strip with more rays: [`POINTS`] per pixel, and more slopes between
/// the views.
fn finer(geometry: &FieldGeometry) -> FieldGeometry {
    let slopes = &geometry.grid.slope_x;
    let per_view = (SLOPES / slopes.len()).max(2);
    let width = geometry.grid.bin_width()[0];
    let inside = |k: usize| ((k as f64 + 0.5) / per_view as f64 - 0.5) * width;
    FieldGeometry {
        cols: POINTS * geometry.cols,
        pitch_mm: geometry.pitch_mm / POINTS as f64,
        grid: ViewGrid {
            slope_x: slopes.iter().flat_map(|s| (0..per_view).map(move |k| s + inside(k))).collect(),
            ..geometry.grid.clone()
        },
        ..geometry.clone()
    }
}

/// Returns the number of views at which each angular footprint has one view, at most
/// [`MOST_VIEWS`]. More views than one per footprint add no detail that the bound allows.
fn useful_views(display: &Display, axis: usize) -> usize {
    let zone = 2.0 * (0.5 * display.field.fov_deg[axis].to_radians()).tan();
    let footprint = display.angular_footprint()[axis];
    if footprint > 0.0 { ((zone / footprint - 1e-9).ceil() as usize).clamp(1, MOST_VIEWS) } else { 1 }
}

/// Returns the display reduced to one row of pixels, and to `views` views, along an axis.
fn strip(display: &Display, axis: usize, views: usize) -> Result<Display, ContrastError> {
    let mut strip = display.clone();
    let cols = display.field.resolution[axis].min(MOST_COLS);
    let width_mm = cols as f64 * display.field.pitch_mm;
    let half = (0.5 * display.field.fov_deg[axis].to_radians()).tan();
    strip.field.resolution = [cols, 1];
    strip.field.views = Views::Fixed([views, 1]);
    strip.field.fov_deg = [display.field.fov_deg[axis], 0.0];
    for layer in &mut strip.layers {
        // The layer becomes as wide as the rays require, but not wider than it was.
        let needed = ((width_mm + 2.0 * layer.d_mm.abs() * half) / layer.pitch_mm).ceil() as usize + 2;
        layer.resolution = [needed.min(layer.resolution[axis]).max(1), 1];
        layer.offset_mm = [layer.offset_mm[axis], 0.0];
    }
    if let Backlight::Lenslets(backlight) = &mut strip.backlight {
        let needed = ((width_mm + 2.0 * backlight.d_mm.abs() * half) / backlight.pitch_mm).ceil() as usize + 2;
        // Keep an odd count odd and an even count even, since a lenslet's centre lies on the axis
        // only if the count is odd.
        let count = needed.min(backlight.lenslets[axis]);
        let same_parity = count + (backlight.lenslets[axis] - count) % 2;
        backlight.lenslets = [same_parity.max(1), 1];
        backlight.views = [backlight.views[axis], 1];
        backlight.fov_deg = [backlight.fov_deg[axis], 1.0];
        backlight.offset_mm = [backlight.offset_mm[axis], 0.0];
    }
    strip.check()?;
    Ok(strip)
}

/// Returns, for each depth, the frequency up to which the contrast is at least [`SHOWN`]. A pair is
/// [z in millimetres, frequency divided by the highest frequency of the pixels].
pub fn achieved_cutoff(found: &[Contrast], achieved: Achieved) -> Vec<[f64; 2]> {
    let mut by_depth: Vec<(f64, Vec<&Contrast>)> = Vec::new();
    for contrast in found {
        match by_depth.iter_mut().find(|(z, _)| *z == contrast.z_mm) {
            Some((_, list)) => list.push(contrast),
            None => by_depth.push((contrast.z_mm, vec![contrast])),
        }
    }
    let cutoff = |mut list: Vec<&Contrast>| {
        list.sort_by(|a, b| a.frequency.total_cmp(&b.frequency));
        // Interpolate between the last contrast above the threshold and the first contrast below
        // it. At frequency 0 the contrast is 1.
        let (mut frequency, mut before) = (0.0, 1.0);
        for contrast in list {
            if contrast.of(achieved) < SHOWN {
                let share: f64 = (before - SHOWN) / (before - contrast.of(achieved));
                return frequency + share * (contrast.frequency - frequency);
            }
            (frequency, before) = (contrast.frequency, contrast.of(achieved));
        }
        frequency
    };
    by_depth.into_iter().map(|(z, list)| [z, cutoff(list)]).collect()
}

/// Draws [`Contrast::dense`] over depth as SVG, with a curve for each frequency.
///
/// # Errors
/// If there are no results.
pub fn contrast_plot(name: &str, found: &[Contrast]) -> Result<String, PlotError> {
    let mut frequencies: Vec<f64> = found.iter().map(|contrast| contrast.frequency).collect();
    frequencies.sort_by(f64::total_cmp);
    frequencies.dedup();
    let curves = frequencies.iter().enumerate().map(|(place, &frequency)| {
        let own = found.iter().filter(|contrast| contrast.frequency == frequency);
        let name = format!("{frequency:.3} × the finest of the pixels").replace(".000", "");
        let points = own.map(|contrast| [contrast.z_mm, contrast.dense]).collect();
        let (colour, dashed) = (place % plot::COLOURS.len(), place >= plot::COLOURS.len());
        Curve { name, points, colour, dashed, dots: true }
    });
    let axes = Axes {
        title: format!("{name}: contrast of gratings"),
        x_label: "depth, mm towards the viewer".into(),
        y_label: "contrast, relative to the grating's".into(),
        x: None,
        y: Some([-0.1, 1.15]),
    };
    plot::curves(&axes, &curves.collect::<Vec<_>>(), &[], &[])
}

/// Makes the axes of a plot that shows, for each depth, the highest frequency with a contrast of at
/// least ½.
fn cutoff_axes(title: String) -> Axes {
    Axes {
        title,
        x_label: "depth, mm towards the viewer".into(),
        y_label: "frequency, × the finest of the pixels".into(),
        x: None,
        y: Some([0.0, 1.6]),
    }
}

fn bound_of(found: &[Contrast]) -> Vec<[f64; 2]> {
    let mut bound: Vec<[f64; 2]> = found.iter().map(|contrast| [contrast.z_mm, contrast.bound]).collect();
    bound.dedup();
    bound
}

/// Draws, as SVG, the highest frequency with a contrast of at least ½ at each depth. The plot has a
/// curve for each measure of contrast, and the display's bound.
///
/// # Errors
/// If there are no results.
pub fn achieved_plot(name: &str, found: &[Contrast]) -> Result<String, PlotError> {
    let achieved = |name: &str, achieved, colour| Curve {
        name: name.into(),
        points: achieved_cutoff(found, achieved),
        colour,
        dots: true,
        ..Curve::default()
    };
    let black = plot::COLOURS.len();
    let curves = [
        Curve { name: "bound".into(), points: bound_of(found), colour: black, dashed: true, ..Curve::default() },
        achieved("solved for more views, over the whole zone", Achieved::WithMoreViews, 1),
        achieved("solved for its views, over the whole zone", Achieved::InBetween, 0),
        achieved("solved for its views, measured only at its views", Achieved::AtTheViews, 2),
    ];
    plot::curves(&cutoff_axes(format!("{name}: half contrast")), &curves, &[], &[])
}

/// Draws, as SVG, the highest frequency with a contrast of at least ½ at each depth, for several
/// displays. The measure is [`Contrast::dense`]. The plot also shows the displays' bounds.
///
/// # Errors
/// If there are no results.
pub fn all_achieved_plot(all: &[(String, Vec<Contrast>)]) -> Result<String, PlotError> {
    let mut curves = Vec::new();
    for (colour, (name, found)) in all.iter().enumerate() {
        let one = Curve { colour, ..Curve::default() };
        curves.push(Curve { name: format!("{name}: bound"), points: bound_of(found), dashed: true, ..one.clone() });
        let points = achieved_cutoff(found, Achieved::WithMoreViews);
        curves.push(Curve { name: "achieved".into(), points, dots: true, ..one });
    }
    plot::curves(&cutoff_axes("Achieved depth of field: half contrast".into()), &curves, &[], &[])
}

#[cfg(test)]
mod tests {
    use lumistack_core::{Cancel, Collector};
    use lumistack_display::LensletBacklight;

    use super::*;

    fn measured(display: &Display, depths_mm: &[f64], frequencies: &[f64]) -> Vec<Contrast> {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let gratings =
            Gratings { depths_mm: depths_mm.into(), frequencies: frequencies.into(), iterations: 80, seed: 1 };
        gratings.measure(display, 0, Task::quiet(&warnings, &cancel)).unwrap()
    }

    fn stack(d_mm: &[f64], frames: usize) -> Display {
        let display = Display::uniform([64, 40], 0.5, [5, 5], [20.0, 20.0], d_mm, frames);
        Display { brightness: 0.3, ..display }
    }

    /// Returns a lens array of pitch Δx = 4 pixels with a layer in its plane. If `open`, the layer
    /// is clear, so that the display works by integral imaging alone.
    fn lenses(frames: usize, open: bool) -> Display {
        let mut display = stack(&[0.0], frames);
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-1e-6, [16, 10], 2.0, [5, 5], [20.0, 20.0]));
        if open {
            display.layers[0].black_level = 0.9999;
        }
        display
    }

    #[test]
    fn a_layer_shows_its_own_plane_and_nothing_else() {
        let found = measured(&stack(&[0.0], 1), &[0.0, 60.0], &[0.5, 0.9]);
        assert!(found[0].contrast > 0.99 && found[1].contrast > 0.99, "{found:?}");
        assert!(found[2].contrast < 0.5 && found[3].contrast < 0.3, "{found:?}");
    }

    #[test]
    fn frames_bring_a_stack_towards_its_bound() {
        let at = |frames: usize| measured(&stack(&[-20.0, 20.0], frames), &[40.0], &[0.6])[0];
        let (few, many) = (at(1), at(8));
        assert!(many.contrast > few.contrast + 0.1, "{few:?} {many:?}");
        assert!((many.bound - 2.0 * 40.0 / (40.0 + 80.0)).abs() < 1e-9);
    }

    /// Repeats the paper's Figure 11, but measures the contrast over rays of the whole zone, so
    /// also between the views. A layer in front of the lens array improves the contrast on the
    /// display plane, even with one frame. Off the display plane this needs more than one frame.
    #[test]
    fn a_layer_helps_on_the_display_plane_and_off_it_only_with_frames() {
        let bin = 0.4 * 10f64.to_radians().tan();
        // At this depth the frequency is above 1/(2Δx), the limit of the lens array alone. It is
        // below 1/(2 z Δs), the bound with the layer. Here Δs is the width of an angular bin.
        let off = 0.45 * 2.0 / bin;
        let gratings = |display: &Display| {
            let found = measured(display, &[0.0, off], &[0.45]);
            assert!(found.iter().all(|at| at.frequency > 0.25 && at.frequency < at.bound), "{found:?}");
            [found[0].between, found[1].between]
        };
        let (alone, one, many) = (gratings(&lenses(1, true)), gratings(&lenses(1, false)), gratings(&lenses(6, false)));
        println!("lenses alone {alone:?}, with a layer {one:?}, and six frames {many:?}");
        assert!(alone.iter().all(|contrast| contrast.abs() < 0.1), "the lens array alone: {alone:?}");
        assert!(one[0] > 0.9, "on the display plane, one frame: {}", one[0]);
        assert!(one[1].abs() < 0.1, "off the display plane, one frame: {}", one[1]);
        assert!(many[0] > 0.9 && many[1] > SHOWN, "six frames: {many:?}");
    }

    /// Over the whole emission no display exceeds its bound by more than the frequency `alike`. Up
    /// to this frequency, even a picture that is the same for all slopes has at least half of the
    /// grating's contrast. At the target views, each of these displays exceeds its bound.
    #[test]
    fn the_bound_holds_for_all_that_is_emitted() {
        // The half-contrast frequency is interpolated between two measured frequencies, which
        // causes an error of about this size.
        const BETWEEN_FREQUENCIES: f64 = 0.01;
        let zone = 2.0 * 10f64.to_radians().tan();
        let depths = [-90.0, -50.0, -30.0, 25.0, 60.0];
        let frequencies = [0.03125, 0.0625, 0.09375, 0.125, 0.1875, 0.25, 0.375, 0.5, 0.75, 1.0];
        for display in [stack(&[-20.0, 20.0], 4), stack(&[-10.0, 0.0, 10.0], 6), lenses(6, false)] {
            let found = measured(&display, &depths, &frequencies);
            let cutoffs = [Achieved::AtTheViews, Achieved::InBetween, Achieved::WithMoreViews]
                .map(|achieved| achieved_cutoff(&found, achieved));
            for (i, &z) in depths.iter().enumerate() {
                let bound = found.iter().find(|at| at.z_mm == z).unwrap().bound;
                let alike = HALF_SINC / (zone * z.abs()) / (0.5 / display.field.pitch_mm);
                let most = bound + alike + BETWEEN_FREQUENCIES;
                let [at_views, between, dense] = [0, 1, 2].map(|k| cutoffs[k][i][1]);
                let measures =
                    format!("{} layers, {z} mm: {at_views} {between} {dense}, bound {bound}", display.layers.len());
                println!("{measures}");
                assert!(between < most && dense < most, "{measures}");
                assert!(at_views > most, "contrast at the target views alone does not obey the bound: {measures}");
                assert!(dense > 0.25 * bound, "little is achieved: {measures}");
            }
        }
    }

    #[test]
    fn half_contrast_is_found_in_between() {
        let at = |frequency: f64, contrast: f64| Contrast {
            z_mm: 3.0,
            frequency,
            bound: 1.0,
            contrast,
            between: contrast / 2.0,
            dense: contrast,
        };
        let views = Achieved::AtTheViews;
        assert_eq!(achieved_cutoff(&[at(0.5, 1.0), at(1.0, 0.0)], views), [[3.0, 0.75]]);
        assert_eq!(achieved_cutoff(&[at(1.0, 0.9), at(0.5, 1.0)], views), [[3.0, 1.0]]);
        // The contrast falls linearly from 1 at frequency 0 to ¼ at frequency 0.5, so it is ½ at
        // two thirds of the way.
        assert_eq!(achieved_cutoff(&[at(0.5, 0.5)], Achieved::InBetween), [[3.0, 0.5 * 0.5 / 0.75]]);
        assert!(contrast_plot("a", &[at(0.5, 1.0), at(1.0, 0.0)]).unwrap().contains("contrast of gratings"));
        assert!(achieved_plot("a", &[at(0.5, 1.0)]).unwrap().contains("a: half contrast"));
        assert!(all_achieved_plot(&[("a".into(), vec![at(0.5, 1.0)])]).unwrap().contains("a: bound"));
    }
}
