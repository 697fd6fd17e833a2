//! The window, the rectangle of the scene that the display plane shows: given by numbers, by a
//! camera, or framed on the visible scene.
//!
//! A camera without a focus distance has its window at the centre of the scene's bounds, if the
//! centre's distance is nearly d*. Otherwise the window is at the distance d*:
//!
//! ```text
//! d* = Σ q / Σ q²,   q = 1/d
//! ```
//!
//! where d are the distances of the visible surfaces, one per pixel of the camera's picture.
//! Parallel views show content at distance d with d/d* of the size that it has in the camera's
//! picture. So a window in the middle between a subject and a far backdrop would show the subject
//! as a speck. d* minimizes Σ q (q − 1/d*)². Each surface counts by its parallax, so near surfaces
//! decide, and a backdrop hardly has an effect, even if it covers most of the picture.

use glam::DVec3;
use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_scene::{Camera, Projection as Lens, Scene, Window};
use serde::{Deserialize, Serialize};

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
/// Largest number of columns of the coarse view from straight ahead that locates the visible scene.
const PROBE_COLS: usize = 336;
/// Largest number of columns at which the camera's picture is traced for the distances of surfaces.
const FOCUS_COLS: usize = 210;
/// The nearest surfaces have their full weight if they cover at least this fraction of the pixels
/// that show a surface. Smaller things, such as a blade of grass in front of the lens, count as if
/// they were farther away.
const STRAY: f64 = 0.02;
/// The window is at the centre of the bounds if the centre's distance differs from d* by at most
/// this factor. The bounds also hold content that the camera does not see, so their centre suits
/// only compact scenes.
const CENTRED: f64 = 1.5;
/// Content is far if its distance from the camera exceeds the window's distance by this factor.
const FAR: f64 = 10.0;
/// A warning reports far content if at least this fraction of the visible surfaces is far.
const FAR_SHARE: f64 = 0.02;

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
/// Without a camera the scene is framed from the direction `look_from` of the job, or else from the
/// side that `side::choose` finds. The frame then shrinks to the visible scene.
///
/// The window of a camera shrinks about its centre if the job does not request the camera, and
/// neither job nor file states a focus distance. It shrinks at most until the scene covers about a
/// quarter of the window, and never cuts off the scene.
///
/// # Errors
/// When the job names a camera that does not exist, or gives numbers that make no rectangle. Also
/// when a key or a camera is missing that its `from` requires, or when a camera that the job
/// requests makes no rectangle. Also when the scene cannot be framed or rendered, or when
/// cancelled.
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
            |key: &str| ShotError::job(format!("window.{key}"), "a value, since `from` is \"given\"", "nothing");
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
        return Err(ShotError::value(
            &scene.name,
            "window.from",
            "a scene with a camera for `from` = \"camera\"",
            "a scene without cameras",
        )
        .into());
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
    // Keep a window at a stated focus distance, and the window of a camera that the job requests.
    // Any other window of a camera may shrink.
    let Some(camera) = camera else {
        if job.focus_distance.is_some() {
            task.warn("window.focus_distance", "no effect, since the scene has no camera");
        }
        return framed();
    };
    let stated = job.focus_distance.or(camera.focus_distance);
    let focus_distance = match stated {
        Some(distance) => Some(distance),
        None => focus(subject, camera, geometry, task)?,
    };
    let found = |window| Found { window, chosen: stated.is_some(), looked_from_deg: None };
    match Window::from_camera(&Camera { focus_distance, ..camera.clone() }, scene.seen_bounds(), size_mm) {
        Ok(window) if stated.is_some() || job.from == WindowFrom::Camera || job.camera.is_some() => Ok(found(window)),
        Ok(window) => close_up(subject, window, geometry, false, task).map(found),
        // A camera of which the job states nothing must not cause an error, so frame the scene
        // instead.
        Err(_) if job.from == WindowFrom::Auto && job.camera.is_none() && job.focus_distance.is_none() => framed(),
        Err(source) => Err(error(source).into()),
    }
}

/// The distances of the surfaces that a camera sees, scene units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Seen {
    /// The distance d* of the window.
    focus: f64,
    /// Distance of the farthest surface.
    farthest: f64,
    /// Fraction of the surfaces that are far.
    far_share: f64,
}

impl Seen {
    /// Measures distances, which need not be sorted. `None` if there are none.
    fn of(mut distances: Vec<f64>) -> Option<Self> {
        distances.sort_by(f64::total_cmp);
        let &farthest = distances.last()?;
        // surfaces nearer than `nearest` count as if they were at this distance
        let nearest = distances[(STRAY * (distances.len() - 1) as f64).round() as usize];
        let disparities = distances.iter().map(|distance| 1.0 / distance.max(nearest));
        let [sum, squares] = disparities.fold([0.0; 2], |[sum, squares], q| [sum + q, squares + q * q]);
        let focus = sum / squares;
        let far = distances.len() - distances.partition_point(|distance| *distance <= FAR * focus);
        Some(Self { focus, farthest, far_share: far as f64 / distances.len() as f64 })
    }
}

/// Returns the distance d* for a camera without a focus distance, and warns of content far behind
/// d*. `None` if the camera sees no surface, or if the centre of the bounds is nearly at d*.
fn focus<S: Subject>(
    subject: &S,
    camera: &Camera,
    geometry: &FieldGeometry,
    task: Task<'_>,
) -> Result<Option<f32>, S::Error> {
    let size_mm = geometry.size_mm();
    // Any window of a camera shows the camera's whole picture to an eye at the camera's position.
    let reach = subject.scene().seen_bounds().size().length();
    let at = Camera { focus_distance: Some(reach), ..camera.clone() };
    let Ok(window) = Window::from_camera(&at, subject.scene().seen_bounds(), size_mm) else { return Ok(None) };
    let centre = Window::from_camera(camera, subject.scene().seen_bounds(), size_mm).ok().map(|middle| {
        let ahead = middle.scene_from_display.translation - window.scene_from_display.translation;
        f64::from(reach) + ahead.dot(window.scene_from_display.rotation * DVec3::NEG_Z)
    });
    // measure the distances of the surfaces in the camera's picture
    let seen: Option<Seen> = subject.remembered("focus", &format!("{window:?} {camera:?}"), || {
        let (scale, distance) = (window.scene_from_display.scale, f64::from(reach));
        let projection = match camera.projection {
            Lens::Perspective { .. } => Projection::Perspective { distance_mm: distance / scale },
            Lens::Orthographic { .. } => Projection::Oblique,
        };
        let cols = geometry.cols.min(FOCUS_COLS);
        let pitch_mm = size_mm[0] / cols as f64;
        let rows = ((size_mm[1] / pitch_mm).round() as usize).max(1);
        let probe = FieldGeometry { rows, cols, pitch_mm, grid: ViewGrid::single(projection, [0.0; 2]) };
        let depth = subject.renderer(task)?.depth(&window, &probe, [0, 0], task)?;
        let distances = depth.data().iter().map(|z| distance - f64::from(*z) * scale);
        Ok(Seen::of(distances.filter(|distance| distance.is_finite() && *distance > 0.0).collect()))
    })?;
    let Some(seen) = seen else { return Ok(None) };
    // the centre of the bounds suits compact scenes; otherwise take d*
    if centre.is_some_and(|centre| (1.0 / CENTRED..=CENTRED).contains(&(centre / seen.focus))) {
        return Ok(None);
    }
    if seen.far_share >= FAR_SHARE {
        task.warn(
            format!("camera {}", camera.name),
            format!(
                "the camera has no focus distance, so the window is {} scene units in front of the camera, near the nearest surfaces. {:.0} % of the surfaces in the camera's picture are more than {FAR} \
                 times as far away, up to {} scene units, and become blurred. If the subject is elsewhere, set the camera's focus distance (in Blender: \
                 Depth of Field, Focus on Object), or the job's `focus_distance`",
                rounded(seen.focus),
                100.0 * seen.far_share,
                rounded(seen.farthest)
            ),
        );
    }
    Ok(Some(seen.focus as f32))
}

/// Returns a number with about three digits.
fn rounded(value: f64) -> String {
    let digits = (2 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

/// Scales a window in its own plane to the visible scene, without cutting off visible content. With
/// `recentre` the window frames the scene, and may move within its plane. Otherwise the window
/// shrinks about its centre, at most until the scene covers the fraction [`COVERAGE`] of the
/// window's area.
fn close_up<S: Subject>(
    subject: &S,
    window: Window,
    geometry: &FieldGeometry,
    recentre: bool,
    task: Task<'_>,
) -> Result<Window, S::Error> {
    let of = format!("{window:?} {recentre} {:?} {}", geometry.grid.projection, geometry.cols);
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
/// pixels or be smaller than [`CLOSEST`]. The region is at most the whole picture.
fn closer(mask: &Tensor<2>) -> (f64, [f64; 2]) {
    let [rows, cols] = mask.shape();
    let middle = [rows, cols].map(|count| 0.5 * count as f64);
    let Some(seen) = extents(mask) else { return (1.0, middle) };
    let reach = |axis: usize| {
        let [first, end] = seen[axis].map(|edge| (edge as f64 - middle[axis]).abs());
        (1.0 + 2.0 * MARGIN) * first.max(end) / middle[axis]
    };
    let least = reach(0).max(reach(1)).max(CLOSEST);
    // the required area is `covered` / COVERAGE; `least` keeps all set pixels inside
    let covered = mask.data().iter().map(|&hit| f64::from(hit)).sum::<f64>() / (rows * cols) as f64;
    ((covered / COVERAGE).sqrt().max(least).min(1.0), middle)
}

/// Finds a camera by its name, or else by its number from 0.
///
/// # Errors
/// If the scene has no such camera.
pub fn find_camera<'a>(scene: &'a Scene, wanted: &str) -> Result<&'a Camera, ShotError> {
    let by_name = scene.cameras.iter().find(|camera| camera.name == wanted);
    let by_number = || wanted.parse::<usize>().ok().and_then(|number| scene.cameras.get(number));
    by_name.or_else(by_number).ok_or_else(|| {
        let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
        let expected = match names.len() {
            0 => "no camera, since the scene has no cameras".into(),
            count => format!("a camera's name ({}), or a camera's number from 0 to {}", names.join(", "), count - 1),
        };
        ShotError::value(&scene.name, "window.camera", expected, wanted)
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Affine3A, Vec3};
    use lumistack_core::{Cancel, Collector};
    use lumistack_display::Display;
    use lumistack_scene::{Instance, Material, Mesh, SceneParts};

    use super::*;
    use crate::subject::LitScene;

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

    /// Returns a scene of a triangle at z = 0. With `has_camera`, a camera at z = 4 looks at it.
    fn triangle(has_camera: bool, task: Task<'_>) -> LitScene {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        let camera = Camera {
            name: "eye".into(),
            scene_from_camera: Affine3A::from_translation(4.0 * Vec3::Z),
            projection: Lens::Perspective { vertical_fov_rad: 0.5, aspect: None },
            focus_distance: None,
            near: None,
        };
        let parts = SceneParts {
            meshes: vec![Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() }],
            instances: vec![Instance { mesh: 0, scene_from_mesh: Affine3A::IDENTITY }],
            materials: vec![Material { unlit: true, ..Material::default() }],
            cameras: if has_camera { vec![camera] } else { Vec::new() },
            ..SceneParts::default()
        };
        LitScene::new(Arc::new(parts.validate(task).unwrap()), task).unwrap()
    }

    /// A negative focus distance in the job must be an error, and must not lead to a framed window.
    /// A focus distance for a scene without a camera must cause a warning.
    #[test]
    fn the_focus_distance_of_a_job_has_its_effect_or_a_message() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let geometry = Display::uniform([32, 20], 1.0, [1, 1], [20.0, 20.0], &[0.0], 1).geometry().unwrap();
        let find = |scene: &LitScene, focus_distance| {
            find_window(scene, &WindowJob { focus_distance, ..WindowJob::default() }, &geometry, task)
        };
        let seen = triangle(true, task);
        let found = find(&seen, Some(3.0)).unwrap();
        assert!((found.window.scene_from_display.translation - DVec3::Z).length() < 1e-6 && found.chosen);
        let error = find(&seen, Some(-1.0)).unwrap_err().to_string();
        assert!(error.contains("at distance -1"), "{error}");
        assert_eq!(warnings.take(), []);
        find(&triangle(false, task), Some(3.0)).unwrap();
        let [warning] = &warnings.take()[..] else { panic!("one warning") };
        assert_eq!(warning.to_string(), "window.focus_distance: no effect, since the scene has no camera");
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
    fn near_surfaces_place_the_window() {
        let picture = |near: usize, [from, to]: [f64; 2], far: f64| {
            let mut distances = vec![far; 1000 - near];
            distances.extend((0..near).map(|i| from + (to - from) * i as f64 / near as f64));
            Seen::of(distances).unwrap()
        };
        // A subject at 3 m covers a twentieth, a third or most of the picture. The backdrop is at
        // 300 m, and the middle of all depths would be 150 m.
        for near in [50, 330, 900] {
            let seen = picture(near, [2.8, 3.2], 300.0);
            assert!((2.8..4.5).contains(&seen.focus), "{near}: {seen:?}");
            assert!((seen.far_share - (1.0 - near as f64 / 1000.0)).abs() < 1e-9 && seen.farthest == 300.0);
        }
        // without a backdrop, the window is near the middle of the surfaces
        let compact = picture(1000, [2.5, 3.5], 0.0);
        assert!((compact.focus - 3.0).abs() < 0.1 && compact.far_share == 0.0, "{compact:?}");
        // a blade of grass in front of the lens covers a hundredth of the picture
        let grass = picture(10, [0.05, 0.06], 4.0);
        assert!((grass.focus - 4.0).abs() < 1e-9 && grass.far_share == 0.0, "{grass:?}");
        assert_eq!(Seen::of(Vec::new()), None);
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
        // if an object covers a seventh of the view, the camera comes closer until the object
        // covers about a quarter
        let seventh = mask(100, 160, |row, col| row.abs_diff(50) < 24 && col.abs_diff(80) < 24);
        let factor = closer(&seventh).0;
        let covered = seventh.data().iter().sum::<f32>() / 16000.0;
        assert!((f64::from(covered) / factor.powi(2) - COVERAGE).abs() < 1e-6, "{factor}");
        // the view of content that reaches the border stays as it is
        assert_eq!(closer(&mask(100, 160, |row, _| row > 90)).0, 1.0);
    }
}
