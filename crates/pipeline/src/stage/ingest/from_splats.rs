//! Makes an environment map by which splats light the meshes among them.
//!
//! ```text
//! L(ω) = linear light of the splats from direction ω, seen from the centre of the meshes
//! ```
//!
//! The six faces of a cube are rendered as views from the centre. The light of an environment comes
//! from infinity, so it is the same for all meshes. Meshes cast no shadow on splats.

use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3};
use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_scene::{Bounds, Image, Pixels, Scene, Similarity, Window};
use lumistack_splats::{Renderer, Space, Wanted};

use crate::error::PipelineError;

/// Pixels along an edge of a face of the cube.
const FACE: usize = 96;
/// Width and height of the environment map, pixels.
const SIZE: [usize; 2] = [256, 128];
/// Distance of a face of the cube from the eye, as a fraction of the scene's diagonal. It is small,
/// so that splats near the eye are seen.
const NEAR: f64 = 1e-3;
/// View directions of the cube's faces, each with its up direction.
const FACES: [[DVec3; 2]; 6] = [
    [DVec3::X, DVec3::Y],
    [DVec3::NEG_X, DVec3::Y],
    [DVec3::Z, DVec3::Y],
    [DVec3::NEG_Z, DVec3::Y],
    [DVec3::Y, DVec3::Z],
    [DVec3::NEG_Y, DVec3::Z],
];

/// Returns the environment map in the scene's axes; `None` if there are no splats or no meshes.
///
/// # Errors
/// If cancelled.
pub(crate) fn panorama(scene: &Arc<Scene>, task: Task<'_>) -> Result<Option<Image>, PipelineError> {
    let (Some(renderer), Some(space)) = (Renderer::new(scene.clone()), Space::of(scene)) else { return Ok(None) };
    let mut meshes = Bounds::EMPTY;
    for instance in &scene.instances {
        let points = scene.meshes[instance.mesh].positions.iter();
        points.for_each(|point| meshes.include(instance.scene_from_mesh.transform_point3(*point)));
    }
    if meshes.is_empty() {
        return Ok(None);
    }
    // Render six views of 90° around the centre of the meshes.
    let centre = meshes.centre().as_dvec3();
    let scale = NEAR * f64::from(scene.bounds().size().length());
    // Each face of the cube is a window of 2 × 2 mm, 1 mm in front of the eye.
    let grid = ViewGrid::single(Projection::Perspective { distance_mm: 1.0 }, [0.0; 2]);
    let geometry = FieldGeometry { rows: FACE, cols: FACE, pitch_mm: 2.0 / FACE as f64, grid };
    let turns = FACES.map(|[forward, up]| DMat3::from_cols(forward.cross(up), up, -forward));
    let mut faces: Vec<Tensor<3>> = Vec::new();
    for turn in &turns {
        let scene_from_display =
            Similarity { rotation: DQuat::from_mat3(turn), scale, translation: centre - scale * turn.z_axis };
        let window = Window { scene_from_display, size_mm: geometry.size_mm(), near_mm: None };
        let none = |_: usize| Ok::<_, PipelineError>(None);
        renderer.render(&window, &geometry, &[[0.0; 2]], &none, Wanted::Light, task, |_, view| {
            faces.push(view.light);
            Ok(())
        })?;
    }
    // Each texel has a direction. Read its value from the cube face that this direction hits.
    let [width, height] = SIZE;
    let texel = |i: usize| {
        let elevation = std::f64::consts::PI * (0.5 - ((i / width) as f64 + 0.5) / height as f64);
        // The central column of the map is the direction −z; columns to its right turn towards +x.
        let azimuth = std::f64::consts::TAU * (((i % width) as f64 + 0.5) / width as f64 - 0.5);
        let to = DVec3::new(elevation.cos() * azimuth.sin(), elevation.sin(), -elevation.cos() * azimuth.cos());
        let along = |face: &usize| FACES[*face][0].dot(to);
        let face = (0..6).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or_default();
        let own = turns[face].transpose() * to;
        let place = |at: f64| (0.5 * FACE as f64 * (1.0 + at / -own.z)) as usize;
        let (row, col) = (place(-own.y).min(FACE - 1), place(own.x).min(FACE - 1));
        let [r, g, b, through] = [0, 1, 2, 3].map(|value| faces[face].get([row, col, value]));
        space.over([r, g, b, through], [0.0; 3])
    };
    let texels = (0..width * height).map(texel).collect();
    Ok(Some(Image { name: "light of the splats".into(), width, height, pixels: Pixels::RgbF32(texels) }))
}
