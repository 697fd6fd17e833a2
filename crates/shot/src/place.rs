//! Places the display in the scene and fits the scene into the display's depth of field. The window
//! moves along its normal. If that does not suffice, depth is compressed.
//!
//! The view from straight ahead stays the same. Let the window move back by t, let k be the factor
//! on the slopes, and D the viewing distance. Then content at depth z appears at
//!
//! ```text
//! oblique:       z' = k (z + t)
//! perspective:   z' with z'/(D − z') = k y/(D − y),   y = (z + t) D/(D + t)
//! ```
//!
//! In perspective the eye stays in place, and the window grows by the factor (D + t)/D to fill the
//! eye's frustum. So the eye's distance in display space remains D.
//!
//! The default, [`FitDepth::Auto`], has an effect only if the scene does not fit. With this
//! default, the window stays in place if numbers or a focus distance determine its depth. Depth is
//! then compressed about the window: content in the display plane remains there.
//!
//! Scaling the slopes is the same as moving all viewpoints closer together: every displacement
//! between views shrinks by the factor k. In oblique views the effect is an affine compression
//! along the window's normal. In perspective views it is a projective compression, which keeps
//! straight lines straight.

pub(crate) mod side;
mod window;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, Projection, ViewGrid};
use lumistack_scene::Window;
use serde::{Deserialize, Serialize};

use crate::error::ShotError;
use crate::job::{FitDepth, Near, WindowFrom, WindowJob};
pub use crate::place::window::{Found, find_camera, find_window};
use crate::subject::Subject;

/// Largest number of columns of the view from straight ahead by which depth is measured.
const PROBE_COLS: usize = 210;
/// Quantiles of the visible depths that must fit, so that a few stray surfaces are ignored.
const ENDS: [f64; 2] = [0.02, 0.98];
/// Two positions of the window are equally good if the fractions of the scene that fit differ by
/// less than this value. Depth scales are equally good if they differ by less than this fraction.
const AS_GOOD: f64 = 0.01;
/// Depths may exceed the depth of field by this rounding error, mm.
const ROUNDED: f64 = 1e-6;
/// Number of window positions to compare.
const TRIED: usize = 2001;
/// Fraction of the frequency 1/(2 pitch) to which the display's bound has fallen at the near plane
/// of a window that is given by numbers. Content in front of this plane is cut off.
const LEAST_DETAIL: f64 = 0.125;
/// Smallest factor to which fitting compresses depth. At this factor a scene looks nearly flat.
const LEAST_SCALE: f64 = 0.03;
/// Fractions of the visible content that compression leaves outside the depth of field, in the
/// order of the attempts. The farthest content is left out. The first fraction is the default.
const LEFT_OUT: [f64; 19] =
    [ENDS[0], 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9];
/// Compression may leave out this fraction for more parallax. A far background between the subjects
/// of a picture often covers about this fraction. Blur of such a background resembles the blur in a
/// photograph.
const MAY_LEAVE_OUT: f64 = 0.1;
/// The parallax of the remaining content must grow by this factor. Otherwise fitting leaves out no
/// content that compression could include.
const WORTH_LEAVING_OUT: f64 = 2.0;

/// A window in the scene, and the depth scale with which the scene fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// The window, after fitting has moved it.
    pub window: Window,
    /// Distance by which fitting moved the window back, in mm of the display space before the move.
    pub moved_back_mm: f64,
    /// Factor on the slopes at which views are traced.
    pub depth_scale: f64,
    /// True if fitting changed the window or the scale.
    pub fitted: bool,
    /// Azimuth and elevation in degrees of the viewer for whom the scene was framed. `None` if the
    /// window was not framed.
    pub looked_from_deg: Option<[f64; 2]>,
}

/// The changes that fitting is allowed to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Means {
    /// True if fitting may move the window.
    moves: bool,
    /// True if fitting may compress depth.
    compresses: bool,
    /// True if fitting changes nothing when the scene fits already.
    at_need: bool,
}

impl Means {
    /// Returns the changes that a job allows; `None` for none. `chosen` is [`Found::chosen`].
    fn of(job: &WindowJob, chosen: bool) -> Option<Self> {
        let scaled = job.depth_scale != 1.0;
        match job.fit_depth {
            FitDepth::Off => None,
            FitDepth::Move => Some(Self { moves: true, compresses: false, at_need: false }),
            FitDepth::Compress => Some(Self { moves: true, compresses: true, at_need: false }),
            // fitting moves no window whose depth is chosen, and changes no depth scale that the
            // job sets
            FitDepth::Auto if chosen && scaled => None,
            FitDepth::Auto => Some(Self { moves: !chosen, compresses: !scaled, at_need: true }),
        }
    }
}

/// Places the display in the scene and fits the scene's depth as the job says.
///
/// # Errors
/// The same errors as [`find_window`]. It is also an error if the job demands compression, and the
/// display's depth of field does not lie on both sides of z = 0.
pub fn place<S: Subject>(
    subject: &S,
    job: &WindowJob,
    display: &Display,
    geometry: &FieldGeometry,
    task: Task<'_>,
) -> Result<Placement, S::Error> {
    // Find the window. If the job gives the window's numbers but no near plane, the near plane is
    // where the display shows hardly any detail.
    let Found { mut window, chosen, looked_from_deg } = find_window(subject, job, geometry, task)?;
    if job.near == Near::Auto && job.from == WindowFrom::Given {
        window.near_mm = farthest_shown(display, geometry.pitch_mm).map(|z| z / job.depth_scale);
    }
    let unfitted =
        Placement { window, moved_back_mm: 0.0, depth_scale: job.depth_scale, fitted: false, looked_from_deg };
    // Change nothing if the job allows no change, or if the display has no suitable depth of field.
    let Some(means) = Means::of(job, chosen) else { return Ok(unfitted) };
    let depth_of_field = display.depth_of_field(geometry.pitch_mm);
    let is_two_sided = |[low, high]: [f64; 2]| low < 0.0 && 0.0 < high;
    if means.at_need && !depth_of_field.is_some_and(is_two_sided) {
        return Ok(unfitted);
    }
    let Some([low, high]) = depth_of_field else {
        task.warn("window.fit_depth", "the display has no depth of field, so the window stays where it is");
        return Ok(unfitted);
    };
    if means.compresses && !is_two_sided([low, high]) {
        let expected = "a display whose depth of field lies on both sides of z = 0";
        let found = format!("a depth of field from {low} to {high} mm");
        return Err(ShotError::job("window.fit_depth", expected, found).into());
    }
    // Fit the scene's depths, as seen from straight ahead, to the depth of field. Tracing the
    // depths is slow, so `subject` caches the fit.
    let projection = geometry.grid.projection;
    let of = format!("{window:?} {projection:?} {low} {high} {means:?} {}", job.depth_scale);
    let fit: Fit = subject.remembered("fit", &of, || {
        let probe = coarser(geometry, ViewGrid::single(projection, [0.0, 0.0]), PROBE_COLS);
        let depth = subject.renderer(task)?.depth(&window, &probe, [0, 0], task)?;
        let mut depths: Vec<f64> = depth.data().iter().filter(|z| z.is_finite()).map(|z| f64::from(*z)).collect();
        depths.sort_by(f64::total_cmp);
        Ok(best_fit(&depths, [low, high], projection, job.depth_scale, means))
    })?;
    let eye_mm = match projection {
        Projection::Oblique => None,
        Projection::Perspective { distance_mm } => Some(distance_mm),
    };
    if fit.is_refused {
        let message = format!(
            "{:.0} % of the visible surfaces lie outside the display's depth of field, and no compression of depth down to {:.0} % brings more surfaces inside. So the window \
             stays where it is, and depth stays as it is. The window should be at the subject: set the camera's focus distance (in Blender: Depth of Field, \
             Focus on Object)",
            100.0 * fit.outside,
            100.0 * LEAST_SCALE
        );
        task.warn("window.fit_depth", message);
    } else if fit.left_out > MAY_LEAVE_OUT {
        let message = format!(
            "the farthest {:.0} % of the visible surfaces stay outside the depth of field and are blurred, since a stronger compression would flatten all other surfaces",
            100.0 * fit.left_out
        );
        task.warn("window.fit_depth", message);
    }
    Ok(Placement {
        window: window.moved_back(fit.moved_back_mm, eye_mm),
        moved_back_mm: fit.moved_back_mm,
        depth_scale: fit.depth_scale,
        fitted: fit.moved_back_mm != 0.0 || fit.depth_scale != job.depth_scale,
        looked_from_deg,
    })
}

/// Returns the z in front of the window up to which the display shows the frequency
/// [`LEAST_DETAIL`] / (2 pitch), mm. Returns `None` if the display shows this frequency nowhere in
/// front of the window, or at every z.
fn farthest_shown(display: &Display, pitch_mm: f64) -> Option<f64> {
    let [_, far] = display.depths_shown(LEAST_DETAIL * 0.5 / pitch_mm)?;
    (far > 0.0 && far.is_finite()).then_some(far)
}

/// Returns a geometry with at most `most_cols` columns, with the centre and width of `geometry`,
/// and with the views of `grid`. Rows are whole, so the height may differ by up to half of a pixel.
pub fn coarser(geometry: &FieldGeometry, grid: ViewGrid, most_cols: usize) -> FieldGeometry {
    let [width_mm, height_mm] = geometry.size_mm();
    let cols = geometry.cols.min(most_cols);
    let pitch_mm = width_mm / cols as f64;
    let rows = ((height_mm / pitch_mm).round() as usize).max(1);
    FieldGeometry { rows, cols, pitch_mm, grid }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Fit {
    moved_back_mm: f64,
    depth_scale: f64,
    /// Fraction of the content that compression left out: the farthest part.
    left_out: f64,
    /// Fraction of the content outside the depth of field after the fit.
    outside: f64,
    /// True if no compression shows more of the scene, so nothing changes.
    is_refused: bool,
}

/// The depths of a scene, and the display that must show them.
struct Fitting<'a> {
    /// Visible depths, sorted, mm. At least one.
    depths: &'a [f64],
    /// Depth of field, mm.
    range: [f64; 2],
    projection: Projection,
    /// Depth scale of the job.
    scale: f64,
    means: Means,
}

/// Finds the movement and the scale that bring most of the sorted `depths` into `range`.
///
/// Compression brings the depths between two quantiles into the range. If that would leave less
/// than [`LEAST_SCALE`] of the parallax, as little as possible of the farthest content is left out.
/// Up to [`MAY_LEAVE_OUT`] is also left out if the remaining content gains enough parallax. If
/// nothing suffices, or the range would contain no more of the scene than before, nothing changes.
fn best_fit(depths: &[f64], range: [f64; 2], projection: Projection, scale: f64, means: Means) -> Fit {
    let stay = Fit { moved_back_mm: 0.0, depth_scale: scale, left_out: ENDS[0], outside: 0.0, is_refused: false };
    if depths.is_empty() {
        return stay;
    }
    let fitting = Fitting { depths, range, projection, scale, means };
    let stay = Fit { outside: 1.0 - fitting.inside(0.0, scale), ..stay };
    if means.at_need && fitting.ends(ENDS[0]).into_iter().all(|end| fitting.is_inside(end, 0.0, scale)) {
        return stay;
    }
    // Leave out more and more, until enough parallax remains.
    let mut best = fitting.leaving_out(LEFT_OUT[0]);
    for left_out in LEFT_OUT.into_iter().skip(1) {
        let is_needed = best.depth_scale < LEAST_SCALE.min(scale);
        if !means.compresses || !(is_needed || left_out <= MAY_LEAVE_OUT) {
            break;
        }
        let next = fitting.leaving_out(left_out);
        if is_needed || next.depth_scale >= WORTH_LEAVING_OUT * best.depth_scale {
            best = next;
        }
    }
    let compresses = best.depth_scale < scale;
    let is_useless = best.outside > stay.outside - AS_GOOD || best.depth_scale < LEAST_SCALE;
    if compresses && is_useless { Fit { is_refused: true, ..stay } } else { best }
}

impl Fitting<'_> {
    /// Returns the two quantiles of the depths that must fit.
    fn ends(&self, left_out: f64) -> [f64; 2] {
        [left_out, ENDS[1]].map(|share| self.depths[(share * (self.depths.len() - 1) as f64).round() as usize])
    }

    fn moved(&self, z: f64, by: f64) -> f64 {
        match self.projection {
            Projection::Oblique => z + by,
            Projection::Perspective { distance_mm } => (z + by) * distance_mm / (distance_mm + by),
        }
    }

    /// Returns the depth at which content at depth z appears after a movement and a scaling.
    fn shown(&self, z: f64, by: f64, scale: f64) -> f64 {
        self.projection.scaled_depth(self.moved(z, by), scale)
    }

    fn is_inside(&self, z: f64, by: f64, scale: f64) -> bool {
        let [low, high] = self.range;
        (low - ROUNDED..=high + ROUNDED).contains(&self.shown(z, by, scale))
    }

    /// Returns the fraction of the depths in the depth of field.
    fn inside(&self, by: f64, scale: f64) -> f64 {
        let [low, high] = self.range;
        let below = self.depths.partition_point(|z| self.shown(*z, by, scale) < low);
        let inside = self.depths.partition_point(|z| self.shown(*z, by, scale) <= high) - below;
        inside as f64 / self.depths.len() as f64
    }

    /// Finds the best fit for the depths without the fraction `left_out`, which is the farthest
    /// part. Among equally good movements, it takes the movements with the least compression. Among
    /// these, it takes the movement that brings the middle of the depths nearest to the middle of
    /// the range.
    fn leaving_out(&self, left_out: f64) -> Fit {
        let (Self { depths, range: [low, high], projection, scale, means }, ends) = (self, self.ends(left_out));
        let [nearest, farthest] = [depths[depths.len() - 1], depths[0]];
        // the window must stay in front of the eye, which limits how far it moves forward
        let least = match projection {
            Projection::Oblique => f64::NEG_INFINITY,
            Projection::Perspective { distance_mm } => -0.9 * distance_mm,
        };
        let scale_at = |by: f64| {
            if !means.compresses {
                return *scale;
            }
            // parallax is proportional to the scale, so each end of the depths limits the scale
            // separately
            let parallax = |z: f64| projection_parallax(*projection, z);
            ends.into_iter().fold(*scale, |scale, end| {
                let end = self.moved(end, by);
                let limit = if end < 0.0 { *low } else { *high };
                if end == 0.0 { scale } else { scale.min(parallax(limit) / parallax(end)) }
            })
        };
        // cap the fraction at the kept content, so that the window does not move towards content
        // that is left out
        let enough = if left_out > ENDS[0] { ENDS[1] - left_out } else { 1.0 };
        let share = |by: f64| self.inside(by, scale_at(by)).min(enough);
        // twice the distance between two middles: of the shown quantiles, and of the depth of field
        let uneven = |by: f64| {
            let scale = scale_at(by);
            (ends.map(|end| self.shown(end, by, scale)).into_iter().sum::<f64>() - (low + high)).abs()
        };
        // try moves between two extremes: the whole scene is in front of the depth of field, or the
        // whole scene is behind it
        let farthest = if left_out > ENDS[0] { ends[0] } else { farthest };
        let (first, last) = ((low - nearest).min(0.0).max(least), (high - farthest).max(0.0).max(least));
        let at = |i: usize| first + (last - first) * i as f64 / (TRIED - 1) as f64;
        let moves = if means.moves { TRIED } else { 0 };
        let tried: Vec<(f64, f64, f64)> =
            (0..moves).map(at).chain([0.0]).map(|by| (by, share(by), scale_at(by))).collect();
        let most = tried.iter().fold(0.0, |most: f64, (_, share, _)| most.max(*share));
        let good = tried.iter().filter(|(_, share, _)| *share >= most - AS_GOOD);
        // choose the moves with the least compression, and among them the most even position
        let largest = good.clone().fold(0.0, |largest: f64, (_, _, scale)| largest.max(*scale));
        let good = good.filter(|(_, _, scale)| *scale >= largest * (1.0 - AS_GOOD));
        let best = good.min_by(|a, b| uneven(a.0).total_cmp(&uneven(b.0)));
        let (moved_back_mm, depth_scale) = best.map_or((0.0, *scale), |(by, _, scale)| (*by, *scale));
        let outside = 1.0 - self.inside(moved_back_mm, depth_scale);
        Fit { moved_back_mm, depth_scale, left_out, outside, is_refused: false }
    }
}

/// Returns a value proportional to the parallax of depth z.
fn projection_parallax(projection: Projection, z: f64) -> f64 {
    match projection {
        Projection::Oblique => z,
        Projection::Perspective { distance_mm } => z / (distance_mm - z),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: [f64; 2] = [-80.0, 80.0];
    const PERSPECTIVE: Projection = Projection::Perspective { distance_mm: 600.0 };

    const MOVE: Means = Means { moves: true, compresses: false, at_need: false };
    const COMPRESS: Means = Means { moves: true, compresses: true, at_need: false };
    const AUTO: Means = Means { moves: true, compresses: true, at_need: true };
    const IN_PLACE: Means = Means { moves: false, compresses: true, at_need: true };

    fn evenly(from: f64, to: f64) -> Vec<f64> {
        (0..1000).map(|i| from + (to - from) * f64::from(i) / 999.0).collect()
    }

    #[test]
    fn a_scene_that_fits_is_centred() {
        let fit = best_fit(&evenly(100.0, 200.0), RANGE, Projection::Oblique, 1.0, COMPRESS);
        assert!((fit.moved_back_mm + 150.0).abs() < 0.5 && fit.depth_scale == 1.0, "{fit:?}");
        let fit = best_fit(&evenly(100.0, 150.0), RANGE, PERSPECTIVE, 1.0, MOVE);
        let moved = |z: f64| (z + fit.moved_back_mm) * 600.0 / (600.0 + fit.moved_back_mm);
        assert!((moved(101.0) + moved(149.0)).abs() < 1.0 && fit.depth_scale == 1.0, "{fit:?}");
    }

    #[test]
    fn a_deep_scene_is_placed_where_most_of_it_is_shown() {
        // 1000 of the 1100 depths are between −310 and −210 mm, and the rest is far behind
        let mut depths = evenly(-310.0, -210.0);
        depths.extend(evenly(-2000.0, -1500.0).iter().step_by(10));
        depths.sort_by(f64::total_cmp);
        let fit = best_fit(&depths, RANGE, Projection::Oblique, 1.0, MOVE);
        assert!((180.0..=390.0).contains(&fit.moved_back_mm), "{fit:?}");
        assert!(depths.iter().filter(|z| (**z + fit.moved_back_mm).abs() <= 80.0).count() >= 985);
        assert_eq!(fit.depth_scale, 1.0);
    }

    #[test]
    fn compression_brings_the_ends_into_the_depth_of_field() {
        for (projection, deep) in [(Projection::Oblique, [-900.0, 300.0]), (PERSPECTIVE, [-2000.0, 250.0])] {
            let depths = evenly(deep[0], deep[1]);
            let fit = best_fit(&depths, RANGE, projection, 1.0, COMPRESS);
            let shown = |z: f64| {
                let moved = match projection {
                    Projection::Oblique => z + fit.moved_back_mm,
                    Projection::Perspective { distance_mm } => {
                        (z + fit.moved_back_mm) * distance_mm / (distance_mm + fit.moved_back_mm)
                    }
                };
                projection.scaled_depth(moved, fit.depth_scale)
            };
            assert!(fit.depth_scale < 0.8, "{fit:?}");
            let (far, near) = (shown(depths[20]), shown(depths[979]));
            assert!((-81.0..-70.0).contains(&far) && (70.0..81.0).contains(&near), "{far} {near} {fit:?}");
        }
    }

    #[test]
    fn unasked_nothing_changes_where_the_scene_fits() {
        let stays = |fit: Fit| fit.moved_back_mm == 0.0 && fit.depth_scale == 1.0 && !fit.is_refused;
        for means in [AUTO, IN_PLACE] {
            // a fiftieth of the depths at either end may be outside, so nothing changes
            assert!(stays(best_fit(&evenly(-81.0, 81.0), RANGE, Projection::Oblique, 1.0, means)));
            assert!(stays(best_fit(&evenly(10.0, 60.0), RANGE, PERSPECTIVE, 1.0, means)));
            assert!(!stays(best_fit(&evenly(-120.0, 81.0), RANGE, Projection::Oblique, 1.0, means)));
        }
        // a scene that does not fit is moved first, then compressed as far as needed
        let moved = best_fit(&evenly(60.0, 200.0), RANGE, Projection::Oblique, 1.0, AUTO);
        assert!((moved.moved_back_mm + 130.0).abs() < 0.5 && moved.depth_scale == 1.0, "{moved:?}");
        // a window that the user placed stays: content 160 mm in front of it is compressed to 80 mm
        let squeezed = best_fit(&evenly(100.0, 160.0), RANGE, Projection::Oblique, 1.0, IN_PLACE);
        assert_eq!(squeezed.moved_back_mm, 0.0);
        assert!((squeezed.depth_scale * 158.8 - 80.0).abs() < 0.2, "{squeezed:?}");
    }

    /// A subject of at most 120 mm depth stands before a backdrop that is 50 m away in display
    /// space.
    #[test]
    fn a_far_backdrop_does_not_flatten_the_subject() {
        for backdrop in [0.08, 0.3, 0.6] {
            let far = (1000.0 * backdrop) as usize;
            let mut depths = vec![-50_000.0; far];
            depths.extend(evenly(-20.0, 100.0).into_iter().take(1000).skip(far));
            depths.sort_by(f64::total_cmp);
            for means in [AUTO, COMPRESS, IN_PLACE] {
                for projection in [Projection::Oblique, PERSPECTIVE] {
                    let fit = best_fit(&depths, RANGE, projection, 1.0, means);
                    let name = format!("{backdrop} {means:?} {projection:?} {fit:?}");
                    // Perspective itself compresses depth behind the window, so a scale of about an
                    // eighth suffices for all content in perspective views.
                    if projection == Projection::Oblique {
                        assert!(fit.depth_scale > 0.7, "{name}");
                        assert!(fit.outside < backdrop + 0.03, "{name}");
                    } else {
                        assert!(fit.depth_scale > 0.1 && fit.outside < backdrop + 0.03, "{name}");
                    }
                }
            }
        }
    }

    /// A tail of the depths is left out if all other depths then have at least twice the parallax.
    #[test]
    fn a_thin_tail_is_left_out_for_parallax() {
        let with_tail = |tail: usize, far: f64| {
            let mut depths = evenly(-90.0, 90.0);
            depths.iter_mut().take(tail).for_each(|z| *z = far);
            depths.sort_by(f64::total_cmp);
            best_fit(&depths, RANGE, Projection::Oblique, 1.0, AUTO)
        };
        let short = with_tail(70, -1000.0);
        assert!(short.left_out == 0.1 && short.depth_scale > 0.9 && short.outside < 0.115, "{short:?}");
        // the tail of 15 % is not thin, and −200 mm is not far
        for kept in [with_tail(150, -1000.0), with_tail(70, -200.0)] {
            assert!(kept.left_out == ENDS[0] && kept.outside < 0.05 && kept.depth_scale < 0.7, "{kept:?}");
        }
    }

    /// A twentieth of the picture is in the window, and all else is a kilometre away. No scale
    /// shows both, and no scale shows more than that twentieth.
    #[test]
    fn a_useless_compression_is_refused() {
        let mut depths = vec![-1e6; 950];
        depths.extend([0.0; 50]);
        let fit = best_fit(&depths, RANGE, Projection::Oblique, 1.0, AUTO);
        assert!(fit.is_refused && fit.moved_back_mm == 0.0 && fit.depth_scale == 1.0, "{fit:?}");
        assert!((fit.outside - 0.95).abs() < 1e-9);
    }

    #[test]
    fn a_choice_is_left_alone() {
        let job = |fit_depth, depth_scale| WindowJob { fit_depth, depth_scale, ..WindowJob::default() };
        assert_eq!(WindowJob::default().fit_depth, FitDepth::Auto);
        assert_eq!(Means::of(&job(FitDepth::Auto, 1.0), false), Some(AUTO));
        assert_eq!(Means::of(&job(FitDepth::Auto, 1.0), true), Some(IN_PLACE));
        assert_eq!(Means::of(&job(FitDepth::Auto, 0.5), false), Some(Means { compresses: false, ..AUTO }));
        assert_eq!(Means::of(&job(FitDepth::Auto, 0.5), true), None);
        assert_eq!(Means::of(&job(FitDepth::Off, 1.0), false), None);
        assert_eq!(Means::of(&job(FitDepth::Compress, 0.5), true), Some(COMPRESS));
    }

    /// Three layers 40 mm apart show the full detail of their pixels up to 80 mm away. The detail
    /// that they show falls as 1/z, so an eighth of it remains at 640 mm.
    #[test]
    fn before_a_given_window_is_seen_what_can_be_shown() {
        let display = Display::uniform([84, 52], 1.0, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 2);
        let near = farthest_shown(&display, 1.0).unwrap();
        assert!((near / 640.0 - 1.0).abs() < 0.05, "{near}");
        let plane = Display::uniform([84, 52], 1.0, [5, 5], [20.0, 20.0], &[0.0], 2);
        assert_eq!(farthest_shown(&plane, 1.0), None);
    }

    #[test]
    fn nothing_to_see_and_a_flat_scene_are_fine() {
        let none = best_fit(&[], RANGE, Projection::Oblique, 0.7, COMPRESS);
        assert_eq!((none.moved_back_mm, none.depth_scale, none.is_refused), (0.0, 0.7, false));
        let flat = best_fit(&[30.0; 9], RANGE, Projection::Oblique, 1.0, COMPRESS);
        assert!((flat.moved_back_mm + 30.0).abs() < 0.2 && flat.depth_scale == 1.0, "{flat:?}");
        // the depth of field of a single layer is a plane
        let plane = best_fit(&[10.0, 10.0, 10.0, 90.0], [0.0, 0.0], Projection::Oblique, 1.0, MOVE);
        assert!(plane.moved_back_mm.is_finite());
    }
}
