//! The depth budget: the fraction of hits that are in the display's depth of field, and the
//! disparity between views.

use lumistack_core::metrics::percentile;
use lumistack_display::{Display, FieldGeometry};
use serde_json::{Value, json};

use crate::format::{self, figure};

/// Number of bars of a histogram.
const BARS: usize = 60;
/// Number of depths at which the bound on the spatial frequency is sampled.
const CURVE_POINTS: usize = 241;
/// Largest fraction of the depths at either end, and of the disparities at the upper end, that
/// histograms omit.
const STRAY: f64 = 0.005;
/// Smallest fraction of hits in the depth of field for which the report gives no advice. With a
/// smaller fraction, the display does not suit the scene, or the window is misplaced.
const FEW: f64 = 0.75;

/// Depth statistics of a scene on a display. Fractions are fractions of the rays with a hit.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthBudget {
    /// Depths [low, high] between which the display shows the finest detail of the light field's
    /// pixels, millimetres. `None` if there is no such depth.
    pub depth_of_field_mm: Option<[f64; 2]>,
    /// Fraction of hits in the depth of field, over all views, 0..1; NaN without hits.
    pub inside: f64,
    /// Fraction of hits in the depth of field, in the central view.
    pub inside_middle: f64,
    /// 2nd, 25th, 50th, 75th and 98th percentile of the depth, millimetres towards the viewer.
    pub depth_mm: [f64; 5],
    /// Median, 98th percentile and maximum disparity between neighbouring views, pixels.
    pub disparity_px: [f64; 3],
    /// Fraction of hits with a disparity above one pixel.
    pub beyond_a_pixel: f64,
    /// Distance by which the window was moved back to fit the scene, millimetres; negative if it
    /// was moved forward.
    pub moved_back_mm: f64,
    /// Factor on parallax; 1 if the scene is shown unchanged.
    pub depth_scale: f64,
    /// True if the window or the parallax was changed to fit the scene.
    pub fitted: bool,
    /// Fractions of hits by depth, millimetres.
    pub(crate) by_depth: Histogram,
    /// Fractions of hits by disparity, pixels.
    pub(crate) by_disparity: Histogram,
    /// The bound on the spatial frequency by depth. Each point has a depth z in millimetres, and
    /// the highest frequency at z divided by the highest frequency of the light field's pixels.
    pub(crate) bound: Vec<(f64, f64)>,
    /// Distances of the layers, millimetres.
    pub(crate) layers_mm: Vec<f64>,
}

/// Fractions in bars of equal width.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Histogram {
    pub(crate) low: f64,
    pub(crate) width: f64,
    pub(crate) shares: Vec<f64>,
}

impl DepthBudget {
    /// Measures depths in display space. `z_mm` has the depths of the rays of all views, in
    /// millimetres; NaN without a hit. `middle` has the depths of the central view's rays.
    pub fn measure(display: &Display, geometry: &FieldGeometry, z_mm: &[f32], middle: &[f32]) -> Self {
        let depth_of_field_mm = display.depth_of_field(geometry.pitch_mm);
        let seen = |z_mm: &[f32]| -> Vec<f32> { z_mm.iter().copied().filter(|z| z.is_finite()).collect() };
        let share = |z_mm: &[f32], which: &dyn Fn(f64) -> bool| {
            z_mm.iter().filter(|z| which(f64::from(**z))).count() as f64 / z_mm.len() as f64
        };
        let inside = |z: f64| depth_of_field_mm.is_some_and(|[low, high]| (low..=high).contains(&z));
        // Collect the hits, and their disparities between neighbouring views. Disparities are
        // measured along the axis on which neighbouring views are farther apart.
        let (mut all, middle) = (seen(z_mm), seen(middle));
        let step = geometry.grid.bin_width().into_iter().fold(0.0, f64::max);
        let moves = |z: f64| geometry.disparity_px(z, step).abs();
        let mut moved: Vec<f32> = all.iter().map(|z| moves(f64::from(*z)) as f32).collect();
        let at = |values: &mut [f32], share: f64| {
            if values.is_empty() { f64::NAN } else { f64::from(percentile(values, share)) }
        };
        // Choose the ranges of the histograms. They omit outliers, but include layers and depth of
        // field.
        let (stray_low, stray_high) = (at(&mut all, STRAY), at(&mut all, 1.0 - STRAY));
        let layers_mm: Vec<f64> = display.layers.iter().map(|layer| layer.d_mm).collect();
        let shown = layers_mm.iter().copied().chain(depth_of_field_mm.into_iter().flatten());
        let ends = |low: f64, high: f64| {
            let (low, high) = shown.clone().fold((low, high), |(low, high), z| (low.min(z), high.max(z)));
            let margin = (0.03 * (high - low)).max(1e-6);
            (low - margin, high + margin)
        };
        let (low, high) = ends(stray_low.min(f64::MAX), stray_high.max(f64::MIN));
        let most = at(&mut moved, 1.0 - STRAY).max(1.2);
        // Sample the bound over the range of the histogram, relative to the highest frequency of
        // the pixels.
        let own = 0.5 / geometry.pitch_mm;
        let z_at = |i: usize| low + (high - low) * i as f64 / (CURVE_POINTS - 1) as f64;
        let bound = (0..CURVE_POINTS).map(z_at).map(|z| (z, display.spatial_cutoff(z) / own));
        Self {
            depth_of_field_mm,
            inside: share(&all, &inside),
            inside_middle: share(&middle, &inside),
            depth_mm: [0.02, 0.25, 0.5, 0.75, 0.98].map(|share| at(&mut all, share)),
            disparity_px: [0.5, 0.98, 1.0].map(|share| at(&mut moved, share)),
            beyond_a_pixel: share(&all, &|z| moves(z) > 1.0),
            moved_back_mm: 0.0,
            depth_scale: 1.0,
            fitted: false,
            by_depth: Histogram::of(&all, low, high),
            by_disparity: Histogram::of(&moved, 0.0, most),
            bound: bound.collect(),
            layers_mm,
        }
    }

    /// Returns true if any ray has a hit.
    pub fn is_seen(&self) -> bool {
        !self.inside.is_nan()
    }

    /// Returns the budget as a sentence.
    pub fn sentence(&self) -> String {
        if !self.is_seen() {
            return "no surface is seen".into();
        }
        let [_, most, largest] = self.disparity_px.map(format::number_short);
        let lies = match self.depth_of_field_mm {
            None => "the display shows the finest detail of the light field's pixels at no depth".into(),
            Some([low, high]) => {
                let [low, high] = [low, high].map(|z| format::number(z.round()));
                format!(
                    "{} of the visible surfaces lie in the depth of field, {low} to {high} mm",
                    format::percent(self.inside)
                )
            }
        };
        let fitted = if self.fitted { self.fitting() } else { String::new() };
        format!(
            "{lies}{fitted}; between neighbouring views 98 % of the content moves by at most {most} px, and all content by at most {largest} px"
        )
    }

    /// Describes the changes of window and depth that made the scene fit.
    fn fitting(&self) -> String {
        let moved = self.moved_back_mm;
        let mut done = Vec::new();
        if moved != 0.0 {
            let way = if moved > 0.0 { "back" } else { "forward" };
            done.push(format!("the window was moved {way} by {} mm", format::number(moved.abs().round())));
        }
        if self.depth_scale != 1.0 {
            done.push(format!("depth was compressed to {}", format::percent(self.depth_scale)));
        }
        format!(
            "; to fit the scene, {} (`fit_depth = \"off\"` leaves window and depth as they are)",
            done.join(" and ")
        )
    }

    /// Returns advice if the scene does not fit; `None` if it fits.
    pub fn advice(&self) -> Option<String> {
        if !self.is_seen() || self.inside >= FEW {
            return None;
        }
        let share = format::percent(self.inside);
        let few = format!(
            "only {share} of the visible surfaces lie in the display's depth of field, and all other surfaces lose detail"
        );
        Some(if self.fitted {
            format!(
                "{few}, although Lumistack has already moved the window or compressed the depth. Bring the far content of the scene nearer, or set the camera's focus distance to the subject"
            )
        } else {
            format!(
                "{few}. --fit-depth moves the window to where most of the scene fits. --fit-depth=compress also compresses the scene's depth"
            )
        })
    }

    /// Returns the budget as JSON for report.json.
    pub fn to_json(&self) -> Value {
        let [p2, p25, p50, p75, p98] = self.depth_mm.map(figure);
        let [median, most, largest] = self.disparity_px.map(figure);
        let histogram = |histogram: &Histogram| json!({ "low": figure(histogram.low), "width": figure(histogram.width), "shares": histogram.shares });
        json!({
            "depth_of_field_mm": self.depth_of_field_mm,
            "inside": figure(self.inside),
            "inside_middle": figure(self.inside_middle),
            "depth_mm": { "p2": p2, "p25": p25, "p50": p50, "p75": p75, "p98": p98 },
            "disparity_px": { "p50": median, "p98": most, "max": largest },
            "beyond_a_pixel": figure(self.beyond_a_pixel),
            "window_moved_back_mm": self.moved_back_mm,
            "depth_scale": self.depth_scale,
            "depth_histogram": histogram(&self.by_depth),
            "disparity_histogram": histogram(&self.by_disparity),
        })
    }
}

impl Histogram {
    fn of(values: &[f32], low: f64, high: f64) -> Self {
        let width = (high - low) / BARS as f64;
        let mut counts = vec![0u64; BARS];
        for value in values {
            let bar = ((f64::from(*value) - low) / width).floor();
            if (0.0..BARS as f64).contains(&bar) {
                counts[bar as usize] += 1;
            }
        }
        let all = values.len().max(1) as f64;
        Self { low, width, shares: counts.into_iter().map(|count| count as f64 / all).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a display of three layers, 40 mm apart. The slopes of the 5 views over 20° are
    /// 0.0705 apart.
    fn display() -> Display {
        Display::uniform([84, 52], 1.0, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 2)
    }

    #[test]
    fn shares_and_displacements_are_counted() {
        let display = display();
        let geometry = display.geometry().unwrap();
        // The hits are at −100, −10, 10 and 79 mm, a quarter at each depth. Other rays have no hit.
        let mut z_mm = vec![f32::NAN; 50];
        [-100.0, -10.0, 10.0, 79.0].into_iter().for_each(|z| z_mm.extend([z; 25]));
        let budget = DepthBudget::measure(&display, &geometry, &z_mm, &[10.0, f32::NAN]);
        let [low, high] = budget.depth_of_field_mm.unwrap();
        assert!((low + 80.0).abs() < 1e-6 && (high - 80.0).abs() < 1e-6, "twice the gap on either side");
        assert_eq!((budget.inside, budget.inside_middle), (0.75, 1.0));
        let step = 0.4 * 10f64.to_radians().tan();
        let [median, most, largest] = budget.disparity_px;
        assert!((median - 79.0 * step).abs() < 1e-3 || (median - 10.0 * step).abs() < 1e-3, "{median}");
        assert!((most - 100.0 * step).abs() < 1e-3 && (largest - 100.0 * step).abs() < 1e-3);
        assert_eq!(budget.beyond_a_pixel, 0.5);
        assert!((budget.by_depth.shares.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        let bar = ((79.0 - budget.by_depth.low) / budget.by_depth.width) as usize;
        assert_eq!(budget.by_depth.shares[bar], 0.25);
        assert_eq!(budget.advice(), None);
        assert!(
            budget.sentence().starts_with("75.0 % of the visible surfaces lie in the depth of field, −80 to 80 mm;")
        );
        let few = DepthBudget::measure(&display, &geometry, &[-100.0, 100.0, 0.0], &[0.0]);
        assert!(few.advice().is_some_and(|advice| advice.contains("only 33.3 %") && advice.contains("--fit-depth")));
        let fitted = DepthBudget { fitted: true, ..few };
        assert!(
            fitted.advice().is_some_and(|advice| advice.contains("only 33.3 %") && !advice.contains("--fit-depth"))
        );
    }

    #[test]
    fn nothing_seen_and_a_single_depth_are_fine() {
        let display = display();
        let geometry = display.geometry().unwrap();
        let none = DepthBudget::measure(&display, &geometry, &[f32::NAN; 5], &[]);
        assert!(!none.is_seen() && none.advice().is_none() && none.sentence() == "no surface is seen");
        assert!(none.by_depth.low.is_finite() && none.to_json()["inside"].is_null());
        let flat = DepthBudget::measure(&display, &geometry, &[0.0; 5], &[0.0]);
        assert_eq!((flat.inside, flat.disparity_px, flat.beyond_a_pixel), (1.0, [0.0; 3], 0.0));
    }
}
