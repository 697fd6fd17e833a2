//! The side from which a scene without a camera is seen.
//!
//! The front of an asset is +z (glTF 2.0, section 3.4). Some scenes show hardly anything from
//! there: a board that lies flat, a card seen edge-on, a pane that faces away. A grid of rays along
//! each candidate direction measures
//!
//! ```text
//! A(direction) = pixels that hit a surface · area of a pixel
//! ```
//!
//! A is the visible area in squared scene units. A face adds its area times the cosine of its
//! slant, and a face that is culled from behind adds nothing. So A prefers directions that surfaces
//! face. The front stays unless another direction shows more than eight times as much; captures
//! have another limit, `CAPTURE_SHARE`. If the front does not stay, the choice is the first
//! candidate that shows nearly the largest area (`ENOUGH`). The order of the candidates begins at
//! the front: all elevations at azimuth 0°, then all elevations at 45°, and so on.

use glam::{DVec3, Vec3};
use lumistack_core::Task;
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_scene::{Bounds, Instance, Scene, Window, WindowError};

use crate::error::ShotError;
use crate::renderer::SceneRenderer;

/// Azimuth and elevation of the front, degrees.
pub(crate) const FRONT: [f64; 2] = [0.0; 2];
/// Azimuths of the candidate directions in order of preference, degrees.
const AZIMUTHS: [f64; 8] = [0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0];
/// Elevations of the candidate directions at each azimuth, in order of preference, degrees.
const ELEVATIONS: [f64; 7] = [0.0, 20.0, 40.0, 55.0, -20.0, -40.0, -55.0];
/// The front stays if it shows at least this fraction of the largest area.
const FRONT_SHARE: f64 = 0.125;
/// For captures, the front stays if it shows at least this fraction of the largest area. The axes
/// of a capture come from training, so its front deserves no preference. Two examples: A guitar
/// shows 0.69 of its largest area towards +z, so another side is chosen. A person in profile shows
/// 0.79, so the front stays.
const CAPTURE_SHARE: f64 = ENOUGH;
/// A side is good enough if it shows at least this fraction of the largest area. A flat board shows
/// most from the highest candidate elevation, 55°. From 40° it shows sin 40° / sin 55° = 0.78 of
/// that, which suffices. A card that faces +x shows only 0.71 from the azimuth 45°, so it is seen
/// from 90°.
const ENOUGH: f64 = 0.745;
/// Numbers of columns and rows of rays by which the area along a candidate direction is measured.
const PROBE: [usize; 2] = [96, 60];

/// Computes the forward and up vectors of a viewer, from the azimuth to the right of +z and the
/// elevation in degrees.
pub(crate) fn directions([azimuth_deg, elevation_deg]: [f64; 2]) -> [DVec3; 2] {
    let [(sin_a, cos_a), (sin_e, cos_e)] = [azimuth_deg, elevation_deg].map(|angle| angle.to_radians().sin_cos());
    let forward = -DVec3::new(sin_a * cos_e, sin_e, cos_a * cos_e);
    [forward, DVec3::new(-sin_a * sin_e, cos_e, -cos_a * sin_e)]
}

/// Returns a window that holds the visible scene from a direction, with a small margin.
///
/// # Errors
/// The same errors as [`Window::framing`].
pub(crate) fn framed(scene: &Scene, from_deg: [f64; 2], size_mm: [f64; 2]) -> Result<Window, WindowError> {
    if from_deg == FRONT {
        return Window::framing(scene.seen_bounds(), size_mm);
    }
    let [forward, up] = directions(from_deg);
    let points = seen(scene).flat_map(|instance| {
        let mesh = &scene.meshes[instance.mesh];
        let indices = mesh.triangles.iter().flatten();
        indices.map(|&index| instance.scene_from_mesh.transform_point3(mesh.positions[index as usize]).as_dvec3())
    });
    Window::framing_points(points.chain(seen_splats(scene)), forward, up, size_mm)
}

/// Returns the centres of the splats, except floaters: stray splats outside the visible bounds.
fn seen_splats(scene: &Scene) -> impl Iterator<Item = DVec3> {
    let bounds = scene.seen_bounds();
    scene.splat_positions().filter(move |at| bounds.contains(*at)).map(|at| at.as_dvec3())
}

/// Chooses an azimuth and an elevation that show much of the scene, degrees.
///
/// # Errors
/// When the scene has no extent, or when cancelled.
pub(crate) fn choose(
    renderer: &SceneRenderer,
    scene: &Scene,
    size_mm: [f64; 2],
    task: Task<'_>,
) -> Result<[f64; 2], ShotError> {
    // Replace meshes by their boxes, since a frame that holds the boxes also holds the meshes.
    let boxes: Vec<Bounds> = scene
        .meshes
        .iter()
        .map(|mesh| {
            let mut bounds = Bounds::EMPTY;
            mesh.triangles.iter().flatten().for_each(|&index| bounds.include(mesh.positions[index as usize]));
            bounds
        })
        .collect();
    let corners: Vec<Vec3> = seen(scene)
        .flat_map(|instance| boxes[instance.mesh].corners().map(|at| instance.scene_from_mesh.transform_point3(at)))
        .collect();
    let splats = (!scene.placed_clouds.is_empty()).then(|| scene.seen_bounds().corners());
    let corners: Vec<Vec3> = corners.into_iter().chain(splats.into_iter().flatten()).collect();
    // Measure the visible area along a direction, by a coarse grid of rays that is framed on the
    // boxes.
    let area = |from_deg: [f64; 2]| -> Result<f64, ShotError> {
        let [forward, up] = directions(from_deg);
        let points = corners.iter().map(|corner| corner.as_dvec3());
        let window = Window::framing_points(points, forward, up, size_mm)
            .map_err(|source| ShotError::Window { name: scene.name.clone(), source })?;
        let [cols, rows] = PROBE;
        let pitch_mm = (size_mm[0] / cols as f64).max(size_mm[1] / rows as f64);
        let grid = ViewGrid::single(Projection::Oblique, [0.0; 2]);
        let mask = renderer.hit_mask(&window, &FieldGeometry { rows, cols, pitch_mm, grid }, [0, 0], task);
        let hits: f64 = mask?.data().iter().map(|&hit| f64::from(hit)).sum();
        Ok(hits * (pitch_mm * window.scene_from_display.scale).powi(2))
    };
    // Try every candidate in order of preference.
    let mut tried = Vec::new();
    for azimuth in AZIMUTHS {
        for elevation in ELEVATIONS {
            tried.push(([azimuth, elevation], area([azimuth, elevation])?));
        }
    }
    let is_capture = scene.instances.is_empty();
    Ok(best(&tried, if is_capture { CAPTURE_SHARE } else { FRONT_SHARE }))
}

/// Returns the front if it shows at least `front_share` of the largest area. Otherwise returns the
/// first tried direction that shows at least [`ENOUGH`] of the largest area.
fn best(tried: &[([f64; 2], f64)], front_share: f64) -> [f64; 2] {
    let most = tried.iter().fold(0.0f64, |most, (_, area)| most.max(*area));
    let Some((front, area)) = tried.first() else { return FRONT };
    if *area >= front_share * most {
        return *front;
    }
    tried.iter().find(|(_, area)| *area >= ENOUGH * most).map_or(*front, |(from_deg, _)| *from_deg)
}

/// Returns the instances that the viewer sees. If all instances are unseen lamps, returns all.
fn seen(scene: &Scene) -> impl Iterator<Item = &Instance> {
    let none = !scene.instances.iter().any(|instance| scene.is_seen(instance));
    scene.instances.iter().filter(move |instance| none || scene.is_seen(instance))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Affine3A, Quat};
    use lumistack_core::{Cancel, Collector};
    use lumistack_scene::{Lamp, Material, Mesh, SceneParts};

    use super::*;

    const SIZE_MM: [f64; 2] = [475.0, 297.0];

    /// Returns a rectangle in the plane z = 0 that shows its front to +z.
    fn card(width: f32, height: f32) -> Mesh {
        let corner = |x: f32, y: f32| Vec3::new(0.5 * x * width, 0.5 * y * height, 0.0);
        Mesh {
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    /// Returns a box of six cards around `at`.
    fn block(size: Vec3, at: Vec3) -> Vec<(Mesh, Affine3A)> {
        let [x, y, z] = size.to_array();
        let half_turn = std::f32::consts::PI;
        let faces = [
            (card(x, y), Quat::IDENTITY, Vec3::new(0.0, 0.0, 0.5 * z)),
            (card(x, y), Quat::from_rotation_y(half_turn), Vec3::new(0.0, 0.0, -0.5 * z)),
            (card(z, y), Quat::from_rotation_y(0.5 * half_turn), Vec3::new(0.5 * x, 0.0, 0.0)),
            (card(z, y), Quat::from_rotation_y(-0.5 * half_turn), Vec3::new(-0.5 * x, 0.0, 0.0)),
            (card(x, z), Quat::from_rotation_x(-0.5 * half_turn), Vec3::new(0.0, 0.5 * y, 0.0)),
            (card(x, z), Quat::from_rotation_x(0.5 * half_turn), Vec3::new(0.0, -0.5 * y, 0.0)),
        ];
        faces.map(|(mesh, turn, place)| (mesh, Affine3A::from_rotation_translation(turn, place + at))).to_vec()
    }

    fn scene(parts: Vec<(Mesh, Affine3A)>, double_sided: bool) -> Arc<Scene> {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let (meshes, places): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        let instance = |(mesh, scene_from_mesh)| Instance { mesh, scene_from_mesh };
        let parts = SceneParts {
            meshes,
            instances: places.into_iter().enumerate().map(instance).collect(),
            materials: vec![Material { double_sided, ..Material::default() }],
            ..SceneParts::default()
        };
        Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap())
    }

    fn chosen(scene: &Arc<Scene>) -> [f64; 2] {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let renderer = SceneRenderer::new(scene.clone(), task).unwrap();
        choose(&renderer, scene, SIZE_MM, task).unwrap()
    }

    #[test]
    fn solid_things_are_seen_from_the_front() {
        assert_eq!(chosen(&scene(block(Vec3::ONE, Vec3::ZERO), false)), FRONT);
        // a figure of a head on a body, slender from the front, is seen from the front
        let mut figure = block(Vec3::new(0.5, 1.2, 0.3), Vec3::new(2.0, 0.6, -3.0));
        figure.extend(block(Vec3::new(0.25, 0.3, 0.25), Vec3::new(2.0, 1.4, -3.0)));
        assert_eq!(chosen(&scene(figure, false)), FRONT);
        // an animal that is longer than wide is seen from the front
        assert_eq!(chosen(&scene(block(Vec3::new(25.0, 78.0, 154.0), Vec3::ZERO), false)), FRONT);
        assert_eq!(chosen(&scene(vec![(card(3.0, 2.0), Affine3A::IDENTITY)], false)), FRONT);
    }

    #[test]
    fn flat_things_are_seen_from_where_they_face() {
        let turned = |turn: Quat| vec![(card(3.0, 2.0), Affine3A::from_quat(turn))];
        let quarter = std::f32::consts::FRAC_PI_2;
        for double_sided in [false, true] {
            // one card lies in the plane xz with its front up, the other stands in the plane yz
            // with its front to +x
            assert_eq!(chosen(&scene(turned(Quat::from_rotation_x(-quarter)), double_sided)), [0.0, 40.0]);
            assert_eq!(chosen(&scene(turned(Quat::from_rotation_y(quarter)), double_sided)), [90.0, 0.0]);
        }
        // the card's front faces −x, then down, then away from the viewer
        assert_eq!(chosen(&scene(turned(Quat::from_rotation_y(-quarter)), false)), [-90.0, 0.0]);
        assert_eq!(chosen(&scene(turned(Quat::from_rotation_x(quarter)), false)), [0.0, -40.0]);
        assert_eq!(chosen(&scene(turned(Quat::from_rotation_y(2.0 * quarter)), false)), [180.0, 0.0]);
    }

    /// 32 pieces stand on a board. From the front, the board is a narrow strip, so it is seen from
    /// above.
    #[test]
    fn a_chess_board_is_seen_from_above() {
        let mut parts = block(Vec3::new(8.0, 0.2, 8.0), Vec3::ZERO);
        for row in [0, 1, 6, 7] {
            for col in 0..8 {
                let at = Vec3::new(col as f32 - 3.5, 0.6, row as f32 - 3.5);
                parts.extend(block(Vec3::new(0.4, 1.0, 0.4), at));
            }
        }
        let board = scene(parts, false);
        let from_deg = chosen(&board);
        assert!(from_deg[0] == 0.0 && (20.0..=55.0).contains(&from_deg[1]), "{from_deg:?}");
        // the frame holds the whole board
        let window = framed(&board, from_deg, SIZE_MM).unwrap();
        for corner in block(Vec3::new(8.0, 0.2, 8.0), Vec3::ZERO) {
            for position in corner.0.positions {
                let at = window.scene_from_display.inverse_point(corner.1.transform_point3(position).as_dvec3());
                assert!(at.x.abs() <= 0.5 * SIZE_MM[0] && at.y.abs() <= 0.5 * SIZE_MM[1], "{at}");
            }
        }
    }

    #[test]
    fn lamps_that_are_not_seen_do_not_count() {
        let mut parts = vec![(card(1.0, 1.0), Affine3A::from_rotation_x(-std::f32::consts::FRAC_PI_2))];
        let mut lamp = card(100.0, 100.0);
        lamp.material = 1;
        parts.push((lamp, Affine3A::from_translation(Vec3::new(0.0, 0.0, 60.0))));
        let with = |kind: Lamp| {
            let (warnings, cancel) = (Collector::default(), Cancel::default());
            let (meshes, places): (Vec<_>, Vec<_>) = parts.iter().cloned().unzip();
            let instances = places.into_iter().enumerate();
            let glowing = Material { emission: Vec3::ONE, lamp: kind, ..Material::default() };
            let parts = SceneParts {
                meshes,
                instances: instances.map(|(mesh, scene_from_mesh)| Instance { mesh, scene_from_mesh }).collect(),
                materials: vec![Material::default(), glowing],
                ..SceneParts::default()
            };
            Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap())
        };
        let unseen = with(Lamp::Unseen);
        assert_eq!(chosen(&unseen), [0.0, 40.0]);
        assert!(framed(&unseen, [0.0, 40.0], SIZE_MM).unwrap().scene_from_display.scale * SIZE_MM[0] < 2.0);
        assert_eq!(chosen(&with(Lamp::Seen)), FRONT, "a visible lamp counts like any surface");
    }

    #[test]
    fn azimuth_goes_to_the_viewers_right_and_elevation_up() {
        let close = |[forward, up]: [DVec3; 2], expected: [DVec3; 2]| {
            assert!(forward.distance(expected[0]) < 1e-12 && up.distance(expected[1]) < 1e-12, "{forward} {up}");
        };
        close(directions(FRONT), [DVec3::NEG_Z, DVec3::Y]);
        close(directions([90.0, 0.0]), [DVec3::NEG_X, DVec3::Y]);
        close(directions([0.0, 90.0]), [DVec3::NEG_Y, DVec3::NEG_Z]);
        close(directions([180.0, -90.0]), [DVec3::Y, DVec3::NEG_Z]);
    }

    #[test]
    fn the_front_is_left_for_much_more_alone() {
        let tried = |areas: [f64; 3]| [([0.0, 0.0], areas[0]), ([0.0, 20.0], areas[1]), ([0.0, 40.0], areas[2])];
        assert_eq!(best(&tried([0.2, 0.9, 1.0]), FRONT_SHARE), FRONT);
        assert_eq!(best(&tried([0.1, 0.9, 1.0]), FRONT_SHARE), [0.0, 20.0]);
        assert_eq!(best(&tried([0.2, 0.9, 1.0]), CAPTURE_SHARE), [0.0, 20.0]);
        assert_eq!(best(&tried([0.69, 0.83, 1.0]), CAPTURE_SHARE), [0.0, 20.0]);
        assert_eq!(best(&tried([0.79, 0.9, 1.0]), CAPTURE_SHARE), FRONT);
        assert_eq!(best(&tried([0.1, 0.5, 1.0]), FRONT_SHARE), [0.0, 40.0]);
        assert_eq!(best(&tried([0.0; 3]), FRONT_SHARE), FRONT, "nothing to see anywhere");
    }
}
