//! The window through which the display looks at a scene: given by numbers, by a camera, or framed
//! on the visible scene.

use glam::DVec3;
use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, ViewGrid};
use lumistack_scene::{Camera, Scene, Window};

use super::side;
use crate::error::ShotError;
use crate::job::{Near, WindowFrom, WindowJob};
use crate::subject::Subject;

/// Free margin on each side of a framed scene, as a fraction of the scene's size.
const MARGIN: f64 = 0.03;
/// Fraction of a camera's view that the scene should cover, if the job does not name the camera.
const COVERAGE: f64 = 0.26;
/// Smallest width of a window, relative to the view of a camera that the job does not name.
const CLOSEST: f64 = 0.58;
/// Largest number of columns of the view from straight ahead that finds where the scene is visible.
const PROBE_COLS: usize = 336;

/// A window before depth is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The window that was found.
    pub window: Window,
    /// True if numbers of the job, or a focus distance of the job or of the file's camera,
    /// determine the depth of the window.
    pub chosen: bool,
    /// Azimuth and elevation in degrees of the viewer for whom the scene was framed. `None` if the
    /// window was not framed.
    pub looked_from_deg: Option<[f64; 2]>,
}

/// Finds the window in the scene.
///
/// Without a camera the scene is framed from the front, or from the side that `side::choose` finds.
/// The frame then shrinks to the visible scene and holds all of it. If the job requests no camera
/// and the file's camera has no focus, the camera's window shrinks about its centre. It shrinks at
/// most until the scene covers about a quarter of the window, and never cuts off the scene.
///
/// # Errors
/// When the job names a camera that does not exist, or gives numbers that make no rectangle.
pub fn find_window<S: Subject>(
    subject: &S,
    job: &WindowJob,
    geometry: &FieldGeometry,
    task: Task<'_>,
) -> Result<Found, S::Error> {
    let mut found = unlimited_window(subject, job, geometry, task)?;
    match job.near {
        Near::Auto => {}
        Near::Off => found.window.near_mm = None,
        Near::At(near) => found.window.near_mm = Some(near / found.window.scene_from_display.scale),
    }
    Ok(found)
}

fn unlimited_window<S: Subject>(
    subject: &S,
    job: &WindowJob,
    geometry: &FieldGeometry,
    task: Task<'_>,
) -> Result<Found, S::Error> {
    let scene = subject.scene();
    let size_mm = geometry.size_mm();
    let error = |source| ShotError::Window { name: scene.name.clone(), source };
    // Read the four keys of a given window.
    if job.from == WindowFrom::Given {
        let missing =
            |key: &str| ShotError::job(format!("window.{key}"), "a value, as `from = \"given\"` needs", "nothing");
        let vector = |key: &str, value: Option<[f64; 3]>| value.map(DVec3::from_array).ok_or_else(|| missing(key));
        let (centre, forward) = (vector("centre", job.centre)?, vector("forward", job.forward)?);
        let (up, width) = (vector("up", job.up)?, job.width.ok_or_else(|| missing("width"))?);
        let window = Window::given(centre, forward, up, width, size_mm).map_err(error)?;
        return Ok(Found { window, chosen: true, looked_from_deg: None });
    }
    // Use the camera that the job names, or else the first camera of the file.
    let camera = match (job.from, &job.camera) {
        (WindowFrom::Bounds, _) => None,
        (_, Some(wanted)) => Some(find_camera(scene, wanted)?),
        // a direction in the job takes precedence over a camera that the job does not name
        (_, None) if job.look_from.is_some() => None,
        (_, None) => scene.cameras.first(),
    };
    if job.from == WindowFrom::Camera && camera.is_none() {
        return Err(ShotError::value(&scene.name, "window.from", "a camera in the scene", "none").into());
    }
    // Frame the scene from the job's direction, or else from the best side. Then shrink the frame
    // to the visible scene.
    let framed = || -> Result<Found, S::Error> {
        let from_deg = match job.look_from {
            Some(from_deg) => from_deg,
            None => subject.remembered("side", &format!("{size_mm:?}"), || {
                Ok(side::choose(subject.renderer(task)?, scene, size_mm, task)?)
            })?,
        };
        let window = side::framed(scene, from_deg, size_mm).map_err(error)?;
        let window = close_up(subject, window, geometry, true, task)?;
        Ok(Found { window, chosen: false, looked_from_deg: Some(from_deg) })
    };
    // A camera's own plane of focus stays. A window of a camera without focus may shrink.
    let Some(camera) = camera else { return framed() };
    let focus_distance = job.focus_distance.or(camera.focus_distance);
    let found = |window| Found { window, chosen: focus_distance.is_some(), looked_from_deg: None };
    match Window::from_camera(&Camera { focus_distance, ..camera.clone() }, scene.seen_bounds(), size_mm) {
        Ok(window) if focus_distance.is_some() || job.from == WindowFrom::Camera || job.camera.is_some() => {
            Ok(found(window))
        }
        Ok(window) => close_up(subject, window, geometry, false, task).map(found),
        // a camera that the job does not name must not cause an error, so frame the scene instead
        Err(_) if job.from == WindowFrom::Auto && job.camera.is_none() => framed(),
        Err(source) => Err(error(source).into()),
    }
}

/// Scales a window in its own plane to the visible scene, without cutting off visible content. With
/// `recentre` the window frames the scene, and may move within its plane. Otherwise the window
/// shrinks about its centre, at most until the scene covers the fraction [`COVERAGE`] of its area.
fn close_up<S: Subject>(
    subject: &S,
    window: Window,
    geometry: &FieldGeometry,
    recentre: bool,
    task: Task<'_>,
) -> Result<Window, S::Error> {
    let of = format!("{window:?} {recentre}");
    let (place, factor): ([f64; 2], f64) = subject.remembered("window", &of, || {
        let renderer = subject.renderer(task)?;
        // a coarse view from straight ahead suffices to locate the scene
        let cols = geometry.cols.min(PROBE_COLS);
        let pitch_mm = window.size_mm[0] / cols as f64;
        let rows = ((window.size_mm[1] / pitch_mm).round() as usize).max(1);
        let grid = ViewGrid::single(geometry.grid.projection, [0.0, 0.0]);
        let probe = FieldGeometry { rows, cols, pitch_mm, grid };
        let mask = renderer.hit_mask(&window, &probe, [0, 0], task)?;
        let (factor, [row, col]) = if recentre { whole(&mask) } else { closer(&mask) };
        let half = 0.5 * pitch_mm;
        Ok(([probe.x_mm(0) - half + col * pitch_mm, probe.y_mm(0) + half - row * pitch_mm], factor))
    })?;
    Ok(window.scaled_about(place, factor))
}

/// Returns the ranges of rows and of columns that hold all set pixels of the mask, as first and end
/// index. `None` if no pixel is set.
fn extents(mask: &Tensor<2>) -> Option<[[usize; 2]; 2]> {
    let [rows, cols] = mask.shape();
    let is_hit = |row: usize, col: usize| mask.get([row, col]) > 0.0;
    let hit = |axis: usize, i: usize| match axis {
        0 => (0..cols).any(|col| is_hit(i, col)),
        _ => (0..rows).any(|row| is_hit(row, i)),
    };
    let seen = |axis: usize, count: usize| {
        Some([(0..count).find(|&i| hit(axis, i))?, (0..count).rfind(|&i| hit(axis, i))? + 1])
    };
    Some([seen(0, rows)?, seen(1, cols)?])
}

/// Returns the region of a picture that holds every set pixel and a [margin](MARGIN). The region is
/// given by a factor on the picture's size, and by its centre [row, column] in pixels.
fn whole(mask: &Tensor<2>) -> (f64, [f64; 2]) {
    let size = mask.shape();
    let Some(seen) = extents(mask) else { return (1.0, size.map(|count| 0.5 * count as f64)) };
    // add one pixel, since content may end anywhere in its last pixel
    let share = |axis: usize| (seen[axis][1] - seen[axis][0] + 1) as f64 / size[axis] as f64;
    let factor = (1.0 + 2.0 * MARGIN) * share(0).max(share(1));
    (factor, seen.map(|[first, end]| 0.5 * (first + end) as f64))
}

/// Returns a region around the middle of a picture, in the form of [`whole`]. Set pixels cover the
/// fraction [`COVERAGE`] of this region. The region is larger if it would otherwise cut off set
/// pixels or be smaller than [`CLOSEST`].
fn closer(mask: &Tensor<2>) -> (f64, [f64; 2]) {
    let [rows, cols] = mask.shape();
    let middle = [rows, cols].map(|count| 0.5 * count as f64);
    let Some(seen) = extents(mask) else { return (1.0, middle) };
    let reach = |axis: usize| {
        let [first, end] = seen[axis].map(|edge| (edge as f64 - middle[axis]).abs());
        (1.0 + 2.0 * MARGIN) * first.max(end) / middle[axis]
    };
    let least = reach(0).max(reach(1)).max(CLOSEST);
    // the wanted area is `covered` / COVERAGE; `least` keeps all set pixels inside
    let covered = mask.data().iter().map(|&hit| f64::from(hit)).sum::<f64>() / (rows * cols) as f64;
    ((covered / COVERAGE).sqrt().max(least).min(1.0), middle)
}

fn find_camera<'a>(scene: &'a Scene, wanted: &str) -> Result<&'a Camera, ShotError> {
    let by_name = scene.cameras.iter().find(|camera| camera.name == wanted);
    let by_number = || wanted.parse::<usize>().ok().and_then(|number| scene.cameras.get(number));
    by_name.or_else(by_number).ok_or_else(|| {
        let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
        let expected = format!("one of the scene's cameras ({}): {}", names.len(), names.join(", "));
        ShotError::value(&scene.name, "window.camera", expected, wanted)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: usize, cols: usize, is_set: impl Fn(usize, usize) -> bool) -> Tensor<2> {
        let mut mask = Tensor::zeros(["row", "col"], [rows, cols]);
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            *mask.at_mut([row, col]) = f32::from(u8::from(is_set(row, col)));
        }
        mask
    }

    /// Returns the edges of a region in pixels: top, bottom, left, right.
    fn edges(mask: &Tensor<2>, (factor, [row, col]): (f64, [f64; 2])) -> [f64; 4] {
        let [height, width] = mask.shape().map(|count| 0.5 * factor * count as f64);
        [row - height, row + height, col - width, col + width]
    }

    #[test]
    fn what_is_framed_is_shown_whole() {
        // Every case is the mask of an object. The cases are a head on a thin stand, a slender
        // animal, a wide row of small things, a speck in a corner, and a full mask.
        let cases: [(&str, Box<dyn Fn(usize, usize) -> bool>); 5] = [
            ("bust", Box::new(|row, col| col.abs_diff(80) < if row < 40 { 22 } else { 3 })),
            ("animal", Box::new(|row, col| (2..98).contains(&row) && col.abs_diff(80) < 9)),
            ("row", Box::new(|row, col| (60..68).contains(&row) && (10..150).contains(&col))),
            ("speck", Box::new(|row, col| row < 3 && col > 150)),
            ("all", Box::new(|_, _| true)),
        ];
        for (name, is_set) in cases {
            let mask = mask(100, 160, &is_set);
            let [[top, bottom], [left, right]] = extents(&mask).unwrap().map(|ends| ends.map(|end| end as f64));
            let kept = edges(&mask, whole(&mask));
            assert!(kept[0] < top && kept[1] > bottom && kept[2] < left && kept[3] > right, "{name}: {kept:?}");
            // the window is no larger than needed: the longer axis has a margin of 3 % on both
            // sides
            let spare = ((kept[1] - kept[0]) / (bottom - top + 1.0)).min((kept[3] - kept[2]) / (right - left + 1.0));
            assert!((spare - 1.06).abs() < 1e-9, "{name}: {spare}");
        }
        let empty = mask(10, 16, |_, _| false);
        assert_eq!(whole(&empty), (1.0, [5.0, 8.0]));
        assert_eq!(closer(&empty), (1.0, [5.0, 8.0]));
    }

    #[test]
    fn a_camera_comes_closer_but_cuts_nothing_off() {
        // An object of two fifths of the height is right of the middle. A region of factor 0.82
        // would show it large enough, but would cut it off at the right.
        let beside = mask(100, 160, |row, col| (30..70).contains(&row) && (80..150).contains(&col));
        let (factor, centre) = closer(&beside);
        assert_eq!(centre, [50.0, 80.0], "a camera's axis stays in the middle");
        assert!(edges(&beside, (factor, centre))[3] >= 150.0, "{factor}");
        // a small object in the middle gets the closest view
        let small = mask(100, 160, |row, col| row.abs_diff(50) < 5 && col.abs_diff(80) < 5);
        assert_eq!(closer(&small).0, CLOSEST);
        // an object that covers a seventh of the view gets a view of which it covers about a
        // quarter
        let seventh = mask(100, 160, |row, col| row.abs_diff(50) < 24 && col.abs_diff(80) < 24);
        let factor = closer(&seventh).0;
        let covered = seventh.data().iter().sum::<f32>() / 16000.0;
        assert!((f64::from(covered) / factor.powi(2) - COVERAGE).abs() < 1e-6, "{factor}");
        // the view of content that reaches the border stays as it is
        assert_eq!(closer(&mask(100, 160, |row, _| row > 90)).0, 1.0);
    }
}
