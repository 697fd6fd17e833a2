//! Limits of a display that follow only from its description: bound on spatial frequency, depth of
//! field, spectral support, viewing zone, frame rate and brightness. If there is a scene, its
//! depths are compared with these limits.

mod plots;
mod text;

use lumistack_display::{Backlight, ClosedForm, Display, Formation, OutsideBins, ProjectionKind};
use serde::Serialize;

use crate::step::view_step;

/// Number of depths at which the bound is sampled.
const SAMPLES: usize = 1601;

/// Limits of a display, and the depths of a scene if there is one.
#[derive(Clone, Debug, Serialize)]
pub struct Analysis {
    /// Name of the analysed display.
    pub name: String,
    /// Number of layers N.
    pub layers: usize,
    /// Distances of the layers from z = 0, millimetres.
    pub layers_mm: Vec<f64>,
    /// Distance of a directional backlight from z = 0, millimetres; `None` for a uniform backlight.
    pub backlight_mm: Option<f64>,
    /// Distance from the rearmost to the frontmost plane, millimetres. The planes are the layers,
    /// and the lenslets of a directional backlight.
    pub thickness_mm: f64,
    /// [low, high] depths between which the display can show the finest detail of the light field's
    /// pixels, millimetres. `None` if there is no such depth.
    pub depth_of_field_mm: Option<[f64; 2]>,
    /// True if patterns can reach the bound at all depths. A display that adds the light of its
    /// layers reaches the bound only on the planes of its layers.
    pub bound_holds: bool,
    /// The bound on spatial frequency, along x and along y.
    pub axes: [AxisAnalysis; 2],
    /// The viewing zone of the display.
    pub zone: Zone,
    /// Frames and refresh rate.
    pub timing: Timing,
    /// Brightness and contrast.
    pub brightness: Brightness,
    /// Depths of a scene, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<Scene>,
}

/// The bound along one axis. Frequencies are in cycles per millimetre.
#[derive(Clone, Debug, Serialize)]
pub struct AxisAnalysis {
    /// Highest frequency of the light field's pixels, 1/(2 pitch).
    pub own_cutoff: f64,
    /// ω0: the highest frequency that the finest layer can show.
    pub layer_cutoff: f64,
    /// Value of the bound on the display plane, where z = 0.
    pub cutoff_on_screen: f64,
    /// Points of the bound: [z in millimetres, bound].
    pub bound: Vec<[f64; 2]>,
    /// Corners of the spectral support, a polygon: [cycles per millimetre, cycles per unit of
    /// slope].
    pub support: Vec<[f64; 2]>,
    /// Width of the prefilter: the range of slopes over which it averages the light field.
    pub footprint: f64,
    /// The closed form of the bound that the paper has for displays of this kind, if there is one.
    pub closed: Option<Closed>,
    /// The paper's equation (23): the bound of the backlight's lens array alone, without the
    /// layers. `None` without a lens array.
    pub lens_array: Option<Closed>,
}

/// A closed form of the paper, compared with the general bound.
#[derive(Clone, Debug, Serialize)]
pub struct Closed {
    /// Number of the equation in the paper.
    pub equation: u32,
    /// Assumptions of the equation.
    pub assumes: &'static str,
    /// The assumptions that this display violates.
    pub broken: Vec<String>,
    /// Maximum of |general bound/closed form − 1| over the sampled depths.
    pub largest_difference: f64,
    /// Depth at which `largest_difference` is found, millimetres.
    pub at_mm: f64,
    /// General bound divided by the closed form, minus 1, far from the display.
    pub difference_far: f64,
    /// Points of the closed form: [z in millimetres, bound].
    pub bound: Vec<[f64; 2]>,
}

/// The viewing zone. Pairs are [horizontal, vertical].
#[derive(Clone, Debug, Serialize)]
pub struct Zone {
    /// Field of view: full angles, degrees.
    pub fov_deg: [f64; 2],
    /// Number of views.
    pub views: [usize; 2],
    /// Difference of slope between neighbouring views. If an axis with a fixed number of views has
    /// one view, this is the range of slopes that the view stands for.
    pub step: [f64; 2],
    /// Smallest distance at which an eye on the axis sees the whole display within the zone,
    /// millimetres. For pinhole views, this is the distance for which they are made.
    pub whole_from_mm: f64,
    /// Width and height of the zone at the distance `at_mm`, millimetres.
    pub width_mm: [f64; 2],
    /// Distance from the display at which `width_mm` and `views_between_eyes` are stated,
    /// millimetres: twice `whole_from_mm`, or the viewing distance of pinhole views.
    pub at_mm: f64,
    /// Number of views between two eyes that are 63 mm apart, at the distance `at_mm`.
    pub views_between_eyes: f64,
    /// True if eyes beside the zone see the views of the zone again, through neighbouring lenslets.
    pub repeats: bool,
}

/// Frames and refresh rate.
#[derive(Clone, Debug, Serialize)]
pub struct Timing {
    /// Number of frames M.
    pub frames: usize,
    /// Number of refreshes in which the panels show all frames once: M, or 3M with a colour
    /// sequence.
    pub subframes: usize,
    /// Refresh rate of the panels, hertz.
    pub refresh_hz: f64,
    /// Number of times a second that the panels show all frames.
    pub period_hz: f64,
    /// Refresh rate at which all frames are shown [`Display::FLICKER_HZ`] times a second, hertz.
    pub wanted_hz: f64,
    /// True if the panels change, and show all frames less than [`Display::FLICKER_HZ`] times a
    /// second.
    pub flickers: bool,
}

/// Brightness and contrast.
#[derive(Clone, Debug, Serialize)]
pub struct Brightness {
    /// Brightness scale β.
    pub beta: f64,
    /// Largest transmittance of all layers together, which is the largest possible β; 1 if layers
    /// do not attenuate.
    pub white: f64,
    /// Light of the darkest state divided by the light of the brightest state.
    pub black: f64,
}

/// Depths of a scene, from the depth budget of a run or a prediction.
#[derive(Clone, Debug, Serialize)]
pub struct Scene {
    /// One sentence that describes the depths.
    pub sentence: String,
    /// Fraction of hits within the depth of field.
    pub inside: Option<f64>,
    /// 2nd, 25th, 50th, 75th and 98th percentile of depth. Each is [depth in millimetres, bound at
    /// this depth divided by the highest frequency of the pixels].
    pub percentiles: Vec<[f64; 2]>,
    /// Bars of the depth histogram: [from, to in millimetres, fraction of the hits].
    pub shares: Vec<[f64; 3]>,
}

impl Scene {
    /// Reads the depths of a scene from a depth budget, in the form that `report.json` has.
    pub fn from_budget(budget: &serde_json::Value, sentence: String) -> Self {
        let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
        let histogram = &budget["depth_histogram"];
        let (low, width) = (number(&histogram["low"]), number(&histogram["width"]));
        let shares = histogram["shares"].as_array().map_or(&[][..], Vec::as_slice).iter().enumerate();
        let shares = shares.map(|(i, share)| [low + width * i as f64, low + width * (i + 1) as f64, number(share)]);
        let percentiles = ["p2", "p25", "p50", "p75", "p98"].map(|p| [number(&budget["depth_mm"][p]), f64::NAN]);
        Self {
            sentence,
            inside: budget["inside"].as_f64(),
            percentiles: percentiles.into_iter().filter(|p| p[0].is_finite()).collect(),
            shares: shares.filter(|bar| bar.iter().all(|v| v.is_finite())).collect(),
        }
    }
}

impl Analysis {
    /// Computes the analysis. `reach_mm` is the largest depth at which the bound is sampled. `None`
    /// derives it from the depths of the display and of the scene.
    pub fn of(display: &Display, scene: Option<Scene>, reach_mm: Option<f64>) -> Self {
        let depth_of_field_mm = display.depth_of_field(display.field.pitch_mm);
        let layers_mm: Vec<f64> = display.layers.iter().map(|layer| layer.d_mm).collect();
        let backlight_mm = match &display.backlight {
            Backlight::Lenslets(backlight) => Some(backlight.d_mm),
            Backlight::Uniform => None,
        };
        // Sample depths up to the requested depth, or else up to some distance past the layers, the
        // scene and the depth of field.
        let parts = || layers_mm.iter().copied().chain(backlight_mm);
        let (rear, front) = parts().fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(d), b.max(d)));
        let of_scene = scene.iter().flat_map(|scene| &scene.percentiles).map(|p| 1.2 * p[0].abs());
        let of_field = depth_of_field_mm.into_iter().flatten().map(|z| 1.6 * z.abs());
        let reach = reach_mm
            .unwrap_or_else(|| parts().map(|d| 3.0 * d.abs()).chain(of_scene).chain(of_field).fold(20.0, f64::max));
        let mut depths: Vec<f64> =
            (0..SAMPLES).map(|i| reach * (2.0 * i as f64 / (SAMPLES - 1) as f64 - 1.0)).chain(parts()).collect();
        depths.retain(|z| z.abs() <= reach);
        depths.sort_by(f64::total_cmp);
        depths.dedup();
        let axes = [0, 1].map(|axis| AxisAnalysis::of(display, axis, &depths));
        // Compare the scene's depths with the bound and the depth of field.
        let scene = scene.map(|mut scene| {
            for p in &mut scene.percentiles {
                p[1] = display.spatial_cutoff(p[0]) / axes[0].own_cutoff;
            }
            scene.inside =
                depth_of_field_mm.map_or(scene.inside, |[low, high]| share_between(&scene.shares, low, high));
            scene
        });
        Self {
            name: display.name.clone(),
            layers: layers_mm.len(),
            thickness_mm: front - rear,
            layers_mm,
            backlight_mm,
            depth_of_field_mm,
            bound_holds: display.formation != Formation::Additive,
            axes,
            zone: Zone::of(display),
            timing: Timing::of(display),
            brightness: Brightness::of(display),
            scene,
        }
    }
}

impl Analysis {
    /// Returns the largest depth at which the bound is sampled, millimetres.
    pub fn reach_mm(&self) -> f64 {
        self.axes[0].bound.last().map_or(0.0, |last| last[0])
    }
}

/// Returns the fraction of the hits between two depths. A bar that crosses a limit contributes the
/// fraction of its width that is between the limits.
fn share_between(bars: &[[f64; 3]], low: f64, high: f64) -> Option<f64> {
    let all: f64 = bars.iter().map(|bar| bar[2]).sum();
    let inside =
        bars.iter().map(|[from, to, share]| share * ((to.min(high) - from.max(low)) / (to - from)).clamp(0.0, 1.0));
    (all > 0.0).then(|| inside.sum::<f64>() / all)
}

impl AxisAnalysis {
    fn of(display: &Display, axis: usize, depths: &[f64]) -> Self {
        let general = |z: f64| display.spatial_cutoff_along(axis, z);
        let closed = |form: ClosedForm| {
            let bound: Vec<[f64; 2]> = depths.iter().map(|&z| [z, form.cutoff(z)]).collect();
            let differences = bound.iter().map(|&[z, value]| (z, (general(z) / value - 1.0).abs()));
            let (at_mm, largest_difference) =
                differences.fold((0.0, 0.0), |most, at| if at.1 > most.1 { at } else { most });
            let far = 1e3 * depths.last().copied().unwrap_or(1.0);
            let difference_far = general(far) / form.cutoff(far) - 1.0;
            let ClosedForm { equation, assumes, broken, .. } = form;
            Closed { equation, assumes, broken, largest_difference, at_mm, difference_far, bound }
        };
        Self {
            own_cutoff: 0.5 / display.field.pitch_mm,
            layer_cutoff: display.layers.iter().map(|layer| 0.5 / layer.pitch_mm).fold(0.0, f64::max),
            cutoff_on_screen: general(0.0),
            bound: depths.iter().map(|&z| [z, general(z)]).collect(),
            support: display.spectral_support(axis),
            footprint: display.angular_footprint()[axis],
            closed: display.closed_form(axis).map(closed),
            lens_array: display.lens_array_form(axis).map(closed),
        }
    }
}

impl Zone {
    /// Distance between two eyes, millimetres.
    const EYES_MM: f64 = 63.0;

    fn of(display: &Display) -> Self {
        let field = &display.field;
        let half = field.fov_deg.map(|fov| (0.5 * fov.to_radians()).tan());
        let size = display.field_pixels().size_mm();
        let step = view_step(display);
        let pinholes = field.distance_mm.filter(|_| field.projection == ProjectionKind::Perspective);
        // Let α be the field of view. From the distance `whole` on, the rays from the eye to both
        // edges of the display have slopes of at most tan(α/2). An axis with a single direction
        // requires no distance.
        let whole = [0, 1].map(|axis| if half[axis] > 0.0 { 0.5 * size[axis] / half[axis] } else { 0.0 });
        let whole_from_mm = pinholes.unwrap_or(whole[0].max(whole[1]));
        let at_mm = pinholes.unwrap_or(2.0 * whole_from_mm);
        let edge = |axis: usize| if pinholes.is_some() { 0.0 } else { size[axis] };
        let width_mm = [0, 1].map(|axis| (2.0 * at_mm * half[axis] - edge(axis)).max(0.0));
        let repeats = matches!(&display.backlight, Backlight::Lenslets(b) if b.outside_bins == OutsideBins::Repeat);
        let views_between_eyes = Self::EYES_MM / (at_mm * step[0]);
        Self {
            fov_deg: field.fov_deg,
            views: display.views(),
            step,
            whole_from_mm,
            width_mm,
            at_mm,
            views_between_eyes: if views_between_eyes.is_finite() { views_between_eyes } else { 0.0 },
            repeats,
        }
    }
}

impl Timing {
    fn of(display: &Display) -> Self {
        Self {
            frames: display.frames,
            subframes: display.subframes(),
            refresh_hz: display.refresh_hz,
            period_hz: display.period_hz(),
            wanted_hz: Display::FLICKER_HZ * display.subframes() as f64,
            flickers: display.flicker_warning().is_some(),
        }
    }
}

impl Brightness {
    fn of(display: &Display) -> Self {
        let peaks = display.layers.iter().map(|layer| layer.peak);
        let blacks = display.layers.iter().map(|layer| layer.black_level);
        let lamp = match &display.backlight {
            Backlight::Lenslets(backlight) => backlight.black_level,
            Backlight::Uniform => 1.0,
        };
        let (white, black) = match display.formation {
            Formation::Attenuating => (peaks.product(), blacks.product::<f64>() * lamp),
            // The other formations do not multiply transmittances. The highest black level of a
            // layer serves as an estimate of the darkest state.
            _ => (1.0, blacks.fold(0.0, f64::max)),
        };
        Self { beta: display.brightness, white, black }
    }
}

#[cfg(test)]
mod tests {
    use lumistack_display::{LensletBacklight, Views};

    use super::*;

    fn directional() -> Display {
        let mut display = Display::uniform([840, 525], 0.5655, [5, 5], [48.0, 48.0], &[0.0], 12);
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-8.5, [187, 117], 2.54, [5, 5], [48.0, 48.0]));
        Display { refresh_hz: 120.0, name: "prototype".into(), ..display }
    }

    #[test]
    fn the_prototypes_gap_is_reported() {
        let analysis = Analysis::of(&directional(), None, None);
        let closed = analysis.axes[0].closed.as_ref().unwrap();
        assert_eq!((closed.equation, closed.broken.len()), (26, 1));
        assert!((0.55..0.65).contains(&closed.difference_far), "{}", closed.difference_far);
        assert!(closed.largest_difference >= closed.difference_far - 1e-6);
        assert_eq!(analysis.axes[0].lens_array.as_ref().unwrap().equation, 23);
        assert_eq!(analysis.thickness_mm, 8.5);
        assert!(analysis.timing.flickers && analysis.timing.wanted_hz == 720.0);
        let text = analysis.text();
        assert!(text.contains("eq. 26") && text.contains("the lens array is at z = -8.5 mm, not at z = 0"), "{text}");
    }

    #[test]
    fn where_its_assumptions_hold_a_closed_form_is_the_bound() {
        let display = Display::uniform([84, 52], 1.0, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 2);
        let analysis = Analysis::of(&display, None, None);
        let closed = analysis.axes[1].closed.as_ref().unwrap();
        assert!(closed.broken.is_empty() && closed.largest_difference < 1e-9, "{}", closed.largest_difference);
        assert!(
            analysis.text().contains("eq. 25") && analysis.text().contains("the closed form equals the bound"),
            "{}",
            analysis.text()
        );
    }

    /// Oracle: an eye at distance D sees the edges of a display of width W at slopes of ±W/(2D).
    /// The zone must contain these slopes.
    #[test]
    fn the_zone_holds_the_whole_display() {
        let zone = Analysis::of(&directional(), None, None).zone;
        let half = 24f64.to_radians().tan();
        assert!((zone.whole_from_mm - 0.5 * 840.0 * 0.5655 / half).abs() < 1e-9);
        assert!((zone.width_mm[0] - 840.0 * 0.5655).abs() < 1e-9, "at twice the distance it is as wide as the display");
    }

    /// Oracle: the differences of the slopes in the grid of views.
    #[test]
    fn the_step_is_that_of_the_views() {
        let fixed = Display::uniform([100, 60], 1.0, [5, 1], [20.0, 10.0], &[-3.0, 0.0, 3.0], 2);
        for views in [Views::Auto, Views::Step([0.07, 0.02]), Views::Fixed([5, 3])] {
            let mut display = fixed.clone();
            display.field.views = views;
            let grid = display.geometry().unwrap().grid;
            let expected = [grid.slope_x[1] - grid.slope_x[0], grid.slope_y[0] - grid.slope_y[1]];
            let zone = Analysis::of(&display, None, None).zone;
            assert!((0..2).all(|axis| (zone.step[axis] - expected[axis]).abs() < 1e-12), "{views:?}: {:?}", zone.step);
        }
        // one of several equal bins, and a view straight ahead
        let zone = Analysis::of(&fixed, None, None).zone;
        assert!((zone.step[1] - 2.0 * 5f64.to_radians().tan()).abs() < 1e-12);
        let mut single = fixed;
        single.field.views = Views::Step([0.0, 0.1]);
        assert_eq!(Analysis::of(&single, None, None).zone.step[0], 0.0);
    }

    #[test]
    fn a_scene_is_measured_by_the_bound() {
        let budget = serde_json::json!({
            "inside": 0.1,
            "depth_mm": {"p2": -100.0, "p25": -50.0, "p50": 0.0, "p75": 40.0, "p98": 80.0},
            "depth_histogram": {"low": -120.0, "width": 80.0, "shares": [0.5, 0.25, 0.25]},
        });
        let display = Display::uniform([84, 52], 1.0, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 2);
        let analysis = Analysis::of(&display, Some(Scene::from_budget(&budget, "deep".into())), None);
        let scene = analysis.scene.as_ref().unwrap();
        // The depth of field is −80 to 80 mm, so half of the first bar and half of the last bar are
        // outside.
        assert!((scene.inside.unwrap() - 0.625).abs() < 1e-6, "{:?}", scene.inside);
        let expected = [0.8, 3.0 * 40.0 / 90.0, 3.0, 1.5, 1.0];
        for (found, expected) in scene.percentiles.iter().zip(expected) {
            assert!((found[1] - expected).abs() < 1e-9, "{found:?}");
        }
        assert!(analysis.text().contains("deep"));
    }

    #[test]
    fn plots_come_out_of_every_kind() {
        let single = Display::uniform([84, 52], 1.0, [1, 1], [0.0, 0.0], &[0.0], 1);
        let additive = Display { formation: Formation::Additive, ..directional() };
        let all: Vec<Analysis> =
            [directional(), single, additive].iter().map(|display| Analysis::of(display, None, None)).collect();
        for axis in [0, 1] {
            assert!(Analysis::depth_of_field_plot(&all, axis).unwrap().contains("prototype"));
            assert!(Analysis::support_plot(&all, axis).unwrap().contains("prototype"));
        }
        assert!(all[2].text().contains("the light of the layers adds up"), "{}", all[2].text());
    }
}
