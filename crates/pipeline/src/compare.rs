//! Compares two runs, or a run with a photograph of its panels. Also simulates an eye with a pupil.
//!
//! Seen pictures of two runs are compared over directions of the first run's viewing zone. Both
//! runs are also compared with the target of the first run, along the target's rays. The zone score
//! of each run comes from the run's report.
//!
//! An eye e at distance D with a pupil, focused on depth z, sees the mean of pictures from points q
//! of the pupil. Each picture is shifted so that content at depth z stays in place:
//!
//! ```text
//! shift on z = 0:  (q − e) z/(D − z)
//! ```

mod displays;
mod likeness;
mod photo;

use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor};
use lumistack_display::{Display, FieldGeometry, LEAST_DIRECTIONS, LayerStack, RayMap, Simulator, Zone};
use serde::Serialize;

pub use self::displays::{DisplayLikeness, DisplaysComparison, compare_displays};
pub use self::likeness::{Likeness, ZoneLikeness};
use self::likeness::{Sums, along_rays, difference, middle_views, save, seen, some_views, target_of, zone_of};
pub use self::photo::{PhotoComparison, Pose, compare_photo};
use crate::error::{PipelineError, display_error};
use crate::job::Job;
use crate::simulate::{RunFolder, Viewpoint, picture_from};
use crate::stage::score;

/// Comparison of two runs.
#[derive(Clone, Debug, Serialize)]
pub struct RunComparison {
    /// Zone score of the first run, if its report has one.
    pub first_zone: Option<ZoneLikeness>,
    /// Zone score of the second run, if its report has one.
    pub second_zone: Option<ZoneLikeness>,
    /// Number of directions of the first run's viewing zone whose seen pictures were compared.
    pub directions: usize,
    /// Scores of the second run against the first run, over the compared directions.
    pub between: Likeness,
    /// Number of views of the first run's target that were compared; 0 without a target.
    pub views: usize,
    /// Scores of the first run against its target.
    pub first: Option<Likeness>,
    /// Scores of the second run against the target of the first run.
    pub second: Option<Likeness>,
    /// Written pictures.
    #[serde(serialize_with = "lumistack_core::path_text::told_each")]
    pub pictures: Vec<PathBuf>,
}

/// Compares two run folders whose light fields have the same pixels.
///
/// If `out` is given, writes pictures from the left, the middle and the right into that folder.
/// Each picture shows the target, if there is one, both runs and their difference.
///
/// # Errors
/// If a run cannot be read, the pixels differ, a picture cannot be written, or the task is
/// cancelled.
pub fn compare_runs(
    first: &Path,
    second: &Path,
    out: Option<&Path>,
    task: Task<'_>,
) -> Result<RunComparison, PipelineError> {
    let [a, b] = [RunFolder::open(first)?, RunFolder::open(second)?];
    let [own, other] = [&a, &b].map(|run| run.display.field_pixels());
    if [own.rows, own.cols] != [other.rows, other.cols] || (own.pitch_mm / other.pitch_mm - 1.0).abs() > 1e-6 {
        let of = |g: &FieldGeometry| format!("{} × {} pixels of {} mm", g.cols, g.rows, g.pitch_mm);
        return Err(PipelineError::value(
            second,
            "light field",
            format!("{}, as in the first run", of(&own)),
            of(&other),
        ));
    }
    // Views and directions come from the target of the first run or, without a target, from the
    // display of the first run.
    let target = target_of(first)?;
    let geometry = match &target {
        Some(target) => target.geometry().clone(),
        None => a.display.geometry().map_err(|source| display_error(source, "display"))?,
    };
    let simulators = [&a, &b].map(|run| Simulator::new(&run.display, &run.stack));
    let shape = [geometry.rows, geometry.cols];
    // If the job has expected eye positions, they limit the zone. A folder of saved patterns may
    // have no job; then the zone is the whole zone of the display.
    let zone = match Job::load(&first.join("job.toml")) {
        Ok(job) => score::zone_of(&job, &a.display, &geometry),
        Err(_) => Zone::of_grid(&geometry.grid, Some(a.display.field.fov_deg)),
    };
    let directions = zone.directions(LEAST_DIRECTIONS);
    let views = if target.is_some() { some_views(&geometry.grid) } else { Vec::new() };
    let shown = middle_views(&geometry.grid);
    task.progress.begin("compare", (directions.len() + views.len() + shown.len()) as u64, "pictures");
    let pair = |geometry: &FieldGeometry, view| {
        [0, 1].map(|i| seen(&simulators[i], [&a, &b][i].stack.brightness, geometry, view))
    };
    // Compare the runs with each other, over the pixels that both displays show.
    let mut between = Sums::new();
    for direction in &directions {
        task.cancel.check()?;
        let [(first, counts), (second, also)] = pair(&geometry.with_grid(direction.clone()), [0, 0]);
        let both: Vec<bool> = counts.iter().zip(&also).map(|(a, b)| *a && *b).collect();
        between.add(&first, &second, shape, &both);
        task.progress.advance(1, "");
    }
    // Compare each run with the target.
    let mut of_target = [Sums::new(), Sums::new()];
    if let Some(target) = &target {
        let maps = [&a, &b].map(|run| RayMap::new(&run.display, &geometry));
        for &view in &views {
            task.cancel.check()?;
            for (i, sums) in of_target.iter_mut().enumerate() {
                let brightness = [&a, &b][i].stack.brightness;
                let (shows, counts) = along_rays(&simulators[i], &maps[i], brightness, &geometry, view);
                sums.add(target.view(view), &shows, shape, &counts);
            }
            task.progress.advance(1, "");
        }
    }
    // Write the target, both runs and their difference next to each other.
    let mut pictures = Vec::new();
    for view in shown {
        if let Some(out) = out {
            let [(first, _), (second, _)] = pair(&geometry, view);
            let target = target.as_ref().map(|target| target.view(view).to_vec());
            let panes = target.into_iter().chain([first.clone(), second.clone(), difference(&first, &second)]);
            let path = out.join(format!("view_{:02}_{:02}.png", view[0], view[1]));
            save(&path, panes.collect(), shape)?;
            pictures.push(path);
        }
        task.progress.advance(1, "");
    }
    task.progress.end();
    let [of_first, of_second] = of_target.map(|sums| target.as_ref().map(|_| sums.likeness()));
    Ok(RunComparison {
        first_zone: zone_of(first),
        second_zone: zone_of(second),
        directions: directions.len(),
        between: between.likeness(),
        views: views.len(),
        first: of_first,
        second: of_second,
        pictures,
    })
}

/// Number of samples of a pupil per axis; samples outside of the pupil's disc are skipped.
const PUPIL_SAMPLES: usize = 7;

/// Returns the picture for an eye at `eye_mm` with a pupil of diameter `pupil_mm` that focuses on
/// the depth `focus_mm`: `[row][col][rgb]`, linear, L̃/β.
///
/// # Errors
/// If the pupil's diameter is negative or not finite, or the eye is not in front of the display and
/// of the focus.
pub fn refocused(
    display: &Display,
    stack: &LayerStack,
    eye_mm: [f64; 3],
    pupil_mm: f64,
    focus_mm: f64,
) -> Result<Tensor<3>, PipelineError> {
    let distance = eye_mm[2];
    if !(pupil_mm.is_finite() && pupil_mm >= 0.0) {
        return Err(PipelineError::option("--pupil-mm", "MM", "a diameter of 0 or more", pupil_mm.to_string()));
    }
    if !(focus_mm.is_finite() && focus_mm < distance) {
        let expected = format!("a depth z below {distance} mm, which is the eye's distance from the display");
        return Err(PipelineError::option("--focus", "Z", expected, focus_mm.to_string()));
    }
    // Average over a square grid of samples, without the samples outside of the pupil's disc.
    let pixels = display.field_pixels();
    let mut sum = Tensor::zeros(["row", "col", "rgb"], [pixels.rows, pixels.cols, 3]);
    let mut count = 0u32;
    let place = |i: usize| ((2 * i + 1) as f64 / PUPIL_SAMPLES as f64 - 1.0) * 0.5 * pupil_mm;
    for (dy, dx) in (0..PUPIL_SAMPLES).flat_map(|y| (0..PUPIL_SAMPLES).map(move |x| (place(y), place(x)))) {
        if dx.hypot(dy) > 0.5 * pupil_mm {
            continue;
        }
        let view = picture_from(display, stack, Viewpoint::Eye([eye_mm[0] + dx, eye_mm[1] + dy, distance]), false)?;
        // Rows count downwards, but y points up, so dy changes its sign.
        let shift = [-dy, dx].map(|offset| offset * focus_mm / ((distance - focus_mm) * pixels.pitch_mm));
        add_moved(&mut sum, &view, shift);
        count += 1;
    }
    sum.data_mut().iter_mut().for_each(|value| *value /= count.max(1) as f32);
    Ok(sum)
}

/// Adds a picture that is shifted by [rows, columns]. A pixel whose source is outside of the
/// picture has the value of the nearest pixel at the edge.
fn add_moved(sum: &mut Tensor<3>, view: &Tensor<3>, [down, right]: [f64; 2]) {
    let [rows, cols, _] = view.shape();
    let axis = |i: usize, shift: f64, count: usize| {
        let at = (i as f64 - shift).clamp(0.0, (count - 1) as f64);
        let first = at.floor() as usize;
        (first, (first + 1).min(count - 1), (at - at.floor()) as f32)
    };
    for row in 0..rows {
        let (top, bottom, ty) = axis(row, down, rows);
        for col in 0..cols {
            let (left, right, tx) = axis(col, right, cols);
            for c in 0..3 {
                let mix = |row: usize| (1.0 - tx) * view.get([row, left, c]) + tx * view.get([row, right, c]);
                *sum.at_mut([row, col, c]) += (1.0 - ty) * mix(top) + ty * mix(bottom);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The front layer has one black pixel. An eye that focuses on this layer sees a dark dot. An
    /// eye that focuses on the rear layer sees the dot blurred, and therefore brighter.
    #[test]
    fn focus_is_sharp_where_it_lies() {
        let mut display = Display::uniform([41, 41], 1.0, [3, 3], [20.0, 20.0], &[0.0, 60.0], 1);
        (display.missing, display.sampling) =
            (lumistack_display::Missing::Clear, lumistack_display::Sampling::Bilinear);
        let mut stack = LayerStack::filled(&display, 1.0);
        stack.layers[1].block_mut([0, 20, 20]).fill(0.0);
        let eye = [0.0, 0.0, 600.0];
        let darkest = |focus: f64| {
            let seen = refocused(&display, &stack, eye, 60.0, focus).unwrap();
            seen.data().iter().copied().fold(f32::MAX, f32::min)
        };
        let (sharp, blurred) = (darkest(60.0), darkest(0.0));
        assert!(sharp < 0.35 && blurred > 0.75, "{sharp} {blurred}");
        assert!(refocused(&display, &stack, eye, 4.0, 700.0).is_err());
    }
}
