//! Achieved contrast by depth: gratings at many depths and frequencies, through the solved stack.
//!
//! A plane at z with the grating of frequency ω shows along the ray of slope s through x on z = 0
//!
//! ```text
//! L(x, s) = ½ (1 + cos φ(x, s)),    φ = 2π ω (x + z s) + φ_0
//! ```
//!
//! The display is solved for that as for any light field, and what it shows is compared with the grating: the modulation transfer is
//!
//! ```text
//! contrast = Σ (L̃/β − mean) cos φ / Σ (L − mean) cos φ        over all rays that count
//! ```
//!
//! 1 where the grating comes out whole and 0 where it is grey. One axis at a time: a strip of one row of pixels and of views. The three channels carry three phases
//! φ_0, a third of a turn apart, and the mean of all counts. The bound of [`Display::spatial_cutoff`] says where a grating can be shown at all; this is what a
//! solver with M frames makes of it.

use std::f64::consts::TAU;

use lumistack_core::{NoProgress, Task};
use lumistack_display::{Backlight, Display, LightField, RayMap, Simulator, Weights};
pub use lumistack_factorizer::FactorizeError;
use lumistack_factorizer::{Problem, Settings};
use serde::Serialize;
use thiserror::Error;

use crate::plot::{self, Axes, Curve, PlotError};

/// Columns of a strip at most.
const MOST_COLS: usize = 96;
/// Contrast from which on a grating counts as shown.
pub const SHOWN: f64 = 0.5;

/// Which gratings, and how hard to try.
#[derive(Clone, Debug)]
pub struct Gratings {
    /// Depths, millimetres.
    pub depths_mm: Vec<f64>,
    /// Frequencies, relative to the finest of the light field's pixels, above 0 and at most 1.
    pub frequencies: Vec<f64>,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Seed of its start.
    pub seed: u64,
}

/// What came of one grating.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Contrast {
    /// Its depth, millimetres.
    pub z_mm: f64,
    /// Its frequency, relative to the finest of the light field's pixels.
    pub frequency: f64,
    /// The bound there, likewise.
    pub bound: f64,
    /// Contrast of what is shown, relative to the grating's.
    pub contrast: f64,
}

/// A grating that cannot be solved.
#[derive(Debug, Error)]
pub enum ContrastError {
    /// The display cannot be reduced to a strip.
    #[error("contrast: {0}")]
    Display(#[from] lumistack_display::DisplayError),
    /// The strip's light field makes no sense.
    #[error("contrast: {0}")]
    Grid(#[from] lumistack_display::GridError),
    /// It cannot be factorized, or the work was stopped.
    #[error(transparent)]
    Factorize(#[from] FactorizeError),
}

impl Gratings {
    /// Eight frequencies at depths up to `reach_mm` on both sides.
    pub fn up_to(reach_mm: f64) -> Self {
        Self {
            depths_mm: (0..17).map(|i| reach_mm * (f64::from(i) / 8.0 - 1.0)).collect(),
            frequencies: (1..=8).map(|i| f64::from(i) / 8.0).collect(),
            iterations: 60,
            seed: 1,
        }
    }

    /// Solves a display for every grating along an axis (0: x, 1: y), depth by depth.
    ///
    /// # Errors
    /// If the display makes no sense, or when cancelled.
    pub fn measure(&self, display: &Display, axis: usize, task: Task<'_>) -> Result<Vec<Contrast>, ContrastError> {
        let strip = strip(display, axis)?;
        let own = 0.5 / strip.field.pitch_mm;
        let mut found = Vec::new();
        task.progress.begin("contrast", (self.depths_mm.len() * self.frequencies.len()) as u64, "gratings");
        for (&z_mm, &frequency) in self.depths_mm.iter().flat_map(|z| self.frequencies.iter().map(move |f| (z, f))) {
            let contrast = self.one(&strip, z_mm, frequency * own, task);
            if contrast.is_err() {
                task.progress.end();
            }
            let bound = display.spatial_cutoff_along(axis, z_mm) / own;
            found.push(Contrast { z_mm, frequency, bound, contrast: contrast? });
            task.progress.advance(1, "");
        }
        task.progress.end();
        Ok(found)
    }

    fn one(&self, strip: &Display, z_mm: f64, frequency: f64, task: Task<'_>) -> Result<f64, ContrastError> {
        let geometry = strip.geometry()?;
        let mut target = LightField::black(geometry.clone())?;
        let phase = |view: usize, col: usize, channel: usize| {
            let x = geometry.x_mm(col);
            let s = geometry.grid.slope_at([0, view], [x, 0.0])[0];
            TAU * (frequency * (x + z_mm * s) + channel as f64 / 3.0 + 0.1)
        };
        let views = geometry.grid.views()[1];
        for view in 0..views {
            for (i, value) in target.view_mut([0, view]).iter_mut().enumerate() {
                *value = (0.5 + 0.5 * phase(view, i / 3, i % 3).cos()) as f32;
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
        let (simulator, map) = (Simulator::new(strip, &stack), RayMap::new(strip, &geometry));
        // Σ of weight, wanted, shown, cos, and products with cos, per channel
        let mut sums = [[0.0f64; 6]; 3];
        for view in 0..views {
            let emitted = simulator.view(&map, &geometry, [0, view]);
            for (i, (shown, wanted)) in emitted.radiance.data().iter().zip(target.view([0, view])).enumerate() {
                if emitted.valid[i / 3] {
                    let cos = phase(view, i / 3, i % 3).cos();
                    let (shown, wanted) = (f64::from(*shown) / stack.brightness, f64::from(*wanted));
                    let terms = [1.0, wanted, shown, cos, wanted * cos, shown * cos];
                    sums[i % 3].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                }
            }
        }
        let covariance = |k: usize| sums.iter().map(|s| s[3 + k] - s[k] * s[3] / s[0].max(1.0)).sum::<f64>();
        let wanted = covariance(1);
        Ok(if wanted.abs() > 1e-9 { covariance(2) / wanted } else { 0.0 })
    }
}

/// The display reduced to a row of pixels and of views along an axis.
fn strip(display: &Display, axis: usize) -> Result<Display, ContrastError> {
    let mut strip = display.clone();
    let cols = display.field.resolution[axis].min(MOST_COLS);
    let width_mm = cols as f64 * display.field.pitch_mm;
    let half = (0.5 * display.field.fov_deg[axis].to_radians()).tan();
    strip.field.resolution = [cols, 1];
    strip.field.views = [display.field.views[axis], 1];
    strip.field.fov_deg = [display.field.fov_deg[axis], 0.0];
    for layer in &mut strip.layers {
        // no wider than the layer is, and no narrower than the rays need
        let needed = ((width_mm + 2.0 * layer.d_mm.abs() * half) / layer.pitch_mm).ceil() as usize + 2;
        layer.resolution = [needed.min(layer.resolution[axis]).max(1), 1];
        layer.offset_mm = [layer.offset_mm[axis], 0.0];
    }
    if let Backlight::Lenslets(backlight) = &mut strip.backlight {
        let needed = ((width_mm + 2.0 * backlight.d_mm.abs() * half) / backlight.pitch_mm).ceil() as usize + 2;
        // an odd number keeps a lenslet in the middle, as even and odd arrays differ by half a lenslet
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

/// The highest frequency up to which contrast stays at [`SHOWN`] and above, by depth: [z in millimetres, frequency relative to the pixels'].
pub fn achieved_cutoff(found: &[Contrast]) -> Vec<[f64; 2]> {
    let mut by_depth: Vec<(f64, Vec<&Contrast>)> = Vec::new();
    for contrast in found {
        match by_depth.iter_mut().find(|(z, _)| *z == contrast.z_mm) {
            Some((_, list)) => list.push(contrast),
            None => by_depth.push((contrast.z_mm, vec![contrast])),
        }
    }
    let cutoff = |mut list: Vec<&Contrast>| {
        list.sort_by(|a, b| a.frequency.total_cmp(&b.frequency));
        // from 0, where everything is shown, to where contrast falls below, in a straight line in between
        let (mut frequency, mut before) = (0.0, 1.0);
        for contrast in list {
            if contrast.contrast < SHOWN {
                let share: f64 = (before - SHOWN) / (before - contrast.contrast);
                return frequency + share * (contrast.frequency - frequency);
            }
            (frequency, before) = (contrast.frequency, contrast.contrast);
        }
        frequency
    };
    by_depth.into_iter().map(|(z, list)| [z, cutoff(list)]).collect()
}

/// Contrast over depth, a curve per frequency, as SVG.
///
/// # Errors
/// If there is none.
pub fn contrast_plot(name: &str, found: &[Contrast]) -> Result<String, PlotError> {
    let mut frequencies: Vec<f64> = found.iter().map(|contrast| contrast.frequency).collect();
    frequencies.sort_by(f64::total_cmp);
    frequencies.dedup();
    let curves = frequencies.iter().enumerate().map(|(place, &frequency)| {
        let own = found.iter().filter(|contrast| contrast.frequency == frequency);
        let name = format!("{frequency:.3} × the pixels' own").replace(".000", "");
        let points = own.map(|contrast| [contrast.z_mm, contrast.contrast]).collect();
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

/// What is achieved beside the bound, for several displays, as SVG: the frequency at which contrast falls to a half, over depth.
///
/// # Errors
/// If there is none.
pub fn achieved_plot(all: &[(String, Vec<Contrast>)]) -> Result<String, PlotError> {
    let mut curves = Vec::new();
    for (colour, (name, found)) in all.iter().enumerate() {
        let mut bound: Vec<[f64; 2]> = found.iter().map(|contrast| [contrast.z_mm, contrast.bound]).collect();
        bound.dedup();
        curves.push(Curve { name: format!("{name}, bound"), points: bound, colour, dashed: true, dots: false });
        curves.push(Curve {
            name: format!("{name}, achieved"),
            points: achieved_cutoff(found),
            colour,
            dashed: false,
            dots: true,
        });
    }
    let axes = Axes {
        title: "Achieved depth of field: half contrast".into(),
        x_label: "depth, mm towards the viewer".into(),
        y_label: "frequency, × the pixels' own".into(),
        x: None,
        y: Some([0.0, 1.6]),
    };
    plot::curves(&axes, &curves, &[], &[])
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

    /// A lens array of Δx = 4 pixels with a layer in its plane; `open` keeps the layer clear, which leaves integral imaging.
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

    /// The paper's Figure 11: a layer before integral imaging helps on the screen at once, and off it only with more frames than one.
    #[test]
    fn a_layer_helps_integral_imaging_on_the_screen_and_off_it_with_frames() {
        let bin = 0.4 * 10f64.to_radians().tan();
        // between the lens array's own limit, 1/(2Δx), and the bound with the layer, 1/(2 z Δs)
        let off = 0.45 * 2.0 / bin;
        let gratings = |display: &Display| {
            let found = measured(display, &[0.0, off], &[0.45]);
            [found[0].contrast, found[1].contrast]
        };
        let (alone, one, many) = (gratings(&lenses(1, true)), gratings(&lenses(1, false)), gratings(&lenses(6, false)));
        println!("lenses alone {alone:?}, with a layer {one:?}, and six frames {many:?}");
        assert!(alone[0] < 0.2, "the lens array alone shows {} on the screen", alone[0]);
        assert!(one[0] > 0.95, "with a layer {}", one[0]);
        assert!(many[1] > one[1] + 0.15, "off the screen {} with one frame, {} with six", one[1], many[1]);
    }

    #[test]
    fn half_contrast_is_found_in_between() {
        let at = |frequency: f64, contrast: f64| Contrast { z_mm: 3.0, frequency, bound: 1.0, contrast };
        assert_eq!(achieved_cutoff(&[at(0.5, 1.0), at(1.0, 0.0)]), [[3.0, 0.75]]);
        assert_eq!(achieved_cutoff(&[at(1.0, 0.9), at(0.5, 1.0)]), [[3.0, 1.0]]);
        assert!(contrast_plot("a", &[at(0.5, 1.0), at(1.0, 0.0)]).unwrap().contains("contrast of gratings"));
        assert!(achieved_plot(&[("a".into(), vec![at(0.5, 1.0)])]).unwrap().contains("a, bound"));
    }
}
