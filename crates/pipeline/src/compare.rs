//! Two runs side by side, a run beside a photograph of its panels, and what an eye's pupil makes of a display.
//!
//! Two runs are simulated at the same rays, those of the first one's target, and compared with each other and with their targets.
//!
//! Through a pupil around the eye e at distance D, focused on depth z, a display is the mean of what is seen from points q of the pupil, each moved so that the
//! plane at z stays where it is: by (q − e) z/(D − z) on z = 0.

mod displays;
mod likeness;
mod photo;

use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor};
use lumistack_display::{Display, LayerStack, RayMap, Simulator};
use serde::Serialize;

pub use self::displays::{DisplayLikeness, DisplaysComparison, compare_displays};
pub use self::likeness::Likeness;
use self::likeness::{Sums, difference, save, target_of};
pub use self::photo::{PhotoComparison, Pose, compare_photo};
use crate::error::{PipelineError, display_error};
use crate::simulate::{RunFolder, Viewpoint, picture_from};

/// What two runs have in common and what not.
#[derive(Clone, Debug, Serialize)]
pub struct RunComparison {
    /// Rays' views at which both were simulated.
    pub views: usize,
    /// The first against its target, where it has one.
    pub first: Option<Likeness>,
    /// The second against the same target.
    pub second: Option<Likeness>,
    /// The second against the first.
    pub between: Likeness,
    /// Pictures that were written.
    #[serde(serialize_with = "crate::path_text::told_each")]
    pub pictures: Vec<PathBuf>,
}

/// Compares two run folders whose light fields have the same pixels; writes the left, middle and right view of both with their difference into `out`.
///
/// # Errors
/// When they cannot be read, or have other pixels.
pub fn compare_runs(
    first: &Path,
    second: &Path,
    out: Option<&Path>,
    task: Task<'_>,
) -> Result<RunComparison, PipelineError> {
    let [a, b] = [RunFolder::open(first)?, RunFolder::open(second)?];
    let [own, other] = [&a, &b].map(|run| run.display.field_pixels());
    if [own.rows, own.cols] != [other.rows, other.cols] || (own.pitch_mm / other.pitch_mm - 1.0).abs() > 1e-6 {
        let of = |g: &lumistack_display::FieldGeometry| format!("{} × {} pixels of {} mm", g.cols, g.rows, g.pitch_mm);
        return Err(PipelineError::value(second, "field", of(&own), of(&other)));
    }
    let target = target_of(first)?;
    let geometry = match &target {
        Some(target) => target.geometry().clone(),
        None => a.display.geometry().map_err(|source| display_error(source, "field"))?,
    };
    let simulators = [&a, &b].map(|run| Simulator::new(&run.display, &run.stack));
    let maps = [&a, &b].map(|run| RayMap::new(&run.display, &geometry));
    let shape = [geometry.rows, geometry.cols];
    let [rows, cols] = geometry.grid.views();
    let shown_as_picture = [[rows / 2, 0], [rows / 2, cols / 2], [rows / 2, cols - 1]];
    let (mut of_first, mut of_second, mut between) = (Sums::new(), Sums::new(), Sums::new());
    let mut pictures = Vec::new();
    task.progress.begin("compare", (rows * cols) as u64, "views");
    for view in geometry.grid.iter() {
        task.cancel.check()?;
        let emitted = [0, 1].map(|i| simulators[i].view(&maps[i], &geometry, view));
        let seen = [0, 1].map(|i| {
            let scale = 1.0 / [&a, &b][i].stack.brightness as f32;
            emitted[i].radiance.data().iter().map(|value| value * scale).collect::<Vec<f32>>()
        });
        if let Some(target) = &target {
            of_first.add(target.view(view), &seen[0], shape, &emitted[0].valid);
            of_second.add(target.view(view), &seen[1], shape, &emitted[1].valid);
        }
        let both: Vec<bool> = emitted[0].valid.iter().zip(&emitted[1].valid).map(|(a, b)| *a && *b).collect();
        between.add(&seen[0], &seen[1], shape, &both);
        if let Some(out) = out.filter(|_| shown_as_picture.contains(&view)) {
            let path = out.join(format!("view_{:02}_{:02}.png", view[0], view[1]));
            if !pictures.contains(&path) {
                let target = target.as_ref().map(|target| target.view(view));
                let panes = target.into_iter().chain([&seen[0][..], &seen[1][..]]).map(<[f32]>::to_vec);
                save(&path, panes.chain([difference(&seen[0], &seen[1])]).collect(), shape)?;
                pictures.push(path);
            }
        }
        task.progress.advance(1, "");
    }
    task.progress.end();
    let has_target = target.is_some();
    Ok(RunComparison {
        views: rows * cols,
        first: has_target.then(|| of_first.likeness()),
        second: has_target.then(|| of_second.likeness()),
        between: between.likeness(),
        pictures,
    })
}

/// Samples of a pupil per axis; those outside its disc do not count.
const PUPIL_SAMPLES: usize = 7;

/// What an eye at `eye_mm` with a pupil of `pupil_mm` sees of a display, focused on the depth `focus_mm`: `[row][col][rgb]`, linear, L̃/β.
///
/// # Errors
/// When the eye is not in front of the display and of the focus.
pub fn refocused(
    display: &Display,
    stack: &LayerStack,
    eye_mm: [f64; 3],
    pupil_mm: f64,
    focus_mm: f64,
) -> Result<Tensor<3>, PipelineError> {
    let distance = eye_mm[2];
    if !(pupil_mm.is_finite() && pupil_mm >= 0.0) {
        return Err(PipelineError::option("--pupil-mm", "MM", "a diameter ≥ 0", pupil_mm.to_string()));
    }
    if !(focus_mm.is_finite() && focus_mm < distance) {
        let expected = format!("a depth before the eye, less than {distance} mm");
        return Err(PipelineError::option("--focus", "Z", expected, focus_mm.to_string()));
    }
    let pixels = display.field_pixels();
    let mut sum = Tensor::zeros(["row", "col", "rgb"], [pixels.rows, pixels.cols, 3]);
    let mut count = 0u32;
    let place = |i: usize| ((2 * i + 1) as f64 / PUPIL_SAMPLES as f64 - 1.0) * 0.5 * pupil_mm;
    for (dy, dx) in (0..PUPIL_SAMPLES).flat_map(|y| (0..PUPIL_SAMPLES).map(move |x| (place(y), place(x)))) {
        if dx.hypot(dy) > 0.5 * pupil_mm {
            continue;
        }
        let view = picture_from(display, stack, Viewpoint::Eye([eye_mm[0] + dx, eye_mm[1] + dy, distance]), false)?;
        // columns to the right, rows down
        let shift = [-dy, dx].map(|offset| offset * focus_mm / ((distance - focus_mm) * pixels.pitch_mm));
        add_moved(&mut sum, &view, shift);
        count += 1;
    }
    sum.data_mut().iter_mut().for_each(|value| *value /= count.max(1) as f32);
    Ok(sum)
}

/// Adds a picture moved by [rows, columns]; beyond its edge it goes on as at the edge.
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

    /// A dot on the front layer is sharp in focus and a disc of the pupil's size out of it.
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
