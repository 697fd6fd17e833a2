//! Depth of the scene: z in display space of the first hits of a view's rays.
//!
//! ```text
//! z = ẑ · display_from_scene(o + t d)          in millimetres towards the viewer
//!
//! for the nearest hit at t along the central ray of a pixel
//! ```
//!
//! z is the depth of the first surface. Mirrors and panes have their own depth, not the depth of
//! the objects that they show.

use glam::DVec3;
use lumistack_core::{NoProgress, Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::{RenderError, Renderer};
use crate::settings::AngularFilter;

impl Renderer {
    /// Returns the depth of a view, `view` = [view_y, view_x] of the geometry's grid, as
    /// `[row][col]` in millimetres. The depth is z in display space of the first surface on each
    /// pixel's central ray that viewers see; NaN if there is none. Does not advance the progress.
    ///
    /// # Errors
    /// If the geometry or the view is out of range, or when cancelled.
    pub fn depth(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        task: Task<'_>,
    ) -> Result<Tensor<2>, RenderError> {
        let rays = self.primary_rays(window, geometry, view, AngularFilter::Point)?;
        let (quiet, space) = (Task { progress: &NoProgress, ..task }, self.geometry.space);
        let depth = self.by_tiles(geometry, quiet, ["row", "col", "z_mm"], |row, col, stack| {
            let rays = rays.pixel(row, col);
            let ray = rays.central();
            let t = if rays.in_bounds { self.tracer().first_surface(ray, stack) } else { None };
            [t.map_or(f32::NAN, |t| {
                let point: DVec3 = ray.origin.as_dvec3() + f64::from(t) * ray.direction.as_dvec3();
                let in_scene = space.centre + point / space.scale;
                window.scene_from_display.inverse_point(in_scene).z as f32
            })]
        })?;
        let [rows, cols, _] = depth.shape();
        let mut flat = Tensor::zeros(["row", "col"], [rows, cols]);
        flat.data_mut().copy_from_slice(depth.data());
        Ok(flat)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Affine3A, DQuat, Vec3};
    use lumistack_core::{Cancel, Collector};
    use lumistack_display::{Projection, ViewGrid};
    use lumistack_scene::{Instance, Material, Mesh, SceneParts, Similarity};

    use super::*;

    /// Tolerance in millimetres: the scene is about 100 mm large, and rays are 32-bit.
    const ROUNDED: f32 = 2e-3;

    /// Makes a piece of the plane z = slant · x around `centre`, as two triangles. Its half width
    /// and half height are `half`, in scene units.
    fn slanted(centre: Vec3, half: f32, slant: f32) -> Mesh {
        let corner = |x: f32, y: f32| centre + Vec3::new(x * half, y * half, slant * x * half);
        Mesh {
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn depth_is_where_rays_hit_planes() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let centre = Vec3::new(3.0, -1.0, 7.0);
        let parts = SceneParts {
            meshes: vec![slanted(centre, 4.0, 0.5)],
            instances: vec![Instance { mesh: 0, scene_from_mesh: Affine3A::IDENTITY }],
            materials: vec![Material { double_sided: true, ..Material::default() }],
            ..SceneParts::default()
        };
        let renderer = Renderer::new(Arc::new(parts.validate(task).unwrap()), task).unwrap();
        // a millimetre is 0.1 units; the plane passes through (0, 0, 12 mm)
        let map = Similarity {
            rotation: DQuat::IDENTITY,
            scale: 0.1,
            translation: centre.as_dvec3() - DVec3::new(0.0, 0.0, 1.2),
        };
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 300.0 }] {
            let grid = ViewGrid { projection, slope_x: vec![-0.1, 0.0, 0.2], slope_y: vec![0.1, 0.0] };
            let geometry = FieldGeometry { rows: 11, cols: 21, pitch_mm: 6.0, grid };
            let window = Window { scene_from_display: map, size_mm: geometry.size_mm(), near_mm: None };
            let (mut surfaces, mut missed) = (0, 0);
            for view in geometry.grid.iter() {
                let depth = renderer.depth(&window, &geometry, view, task).unwrap();
                let hits = renderer.hit_mask(&window, &geometry, view, task).unwrap();
                for (row, col) in (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| (row, col))) {
                    let point = [geometry.x_mm(col), geometry.y_mm(row)];
                    let slope = geometry.grid.slope_at(view, point);
                    // z = 12 + 0.5 (x + z s) in millimetres
                    let z = (12.0 + 0.5 * point[0]) / (1.0 - 0.5 * slope[0]);
                    let [x, y] = [0, 1].map(|axis| point[axis] + z * slope[axis]);
                    let found = depth.get([row, col]);
                    assert_eq!(hits.get([row, col]) == 0.0, found.is_nan());
                    if x.abs() < 39.9 && y.abs() < 39.9 {
                        assert!((found - z as f32).abs() < ROUNDED, "{projection:?} {view:?} {row} {col}: {found} {z}");
                        surfaces += 1;
                    } else if x.abs() > 40.1 || y.abs() > 40.1 {
                        assert!(found.is_nan(), "{projection:?} {view:?} {row} {col}: {found}");
                        missed += 1;
                    }
                }
            }
            assert!(surfaces > 300 && missed > 100, "{surfaces} {missed}");
        }
    }
}
