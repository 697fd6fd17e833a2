//! Depths of the first surfaces that the views of a light field see.

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, SeenDepth};
use lumistack_scene::Window;

use crate::error::ShotError;
use crate::place::{Placement, coarser};
use crate::renderer::SceneRenderer;

/// Largest number of columns at which depths are kept. Fractions and percentiles of depths need no
/// more.
const MOST_COLS: usize = 240;

/// z of the first surface along rays of all views, in display space.
#[derive(Clone, Debug)]
pub struct Depths {
    /// Grid and coarse pixels at which the views are traced.
    pub geometry: FieldGeometry,
    /// z of the first surface in display space, `[view_y][view_x][row][col]`, mm. NaN where a ray
    /// misses.
    pub z_mm: Vec<f32>,
}

impl Depths {
    /// Traces the central rays of [`coarse`](Self::coarse) pixels.
    ///
    /// # Errors
    /// When the geometry is out of range, or when cancelled.
    pub fn trace(
        renderer: &SceneRenderer,
        window: &Window,
        geometry: &FieldGeometry,
        task: Task<'_>,
    ) -> Result<Self, ShotError> {
        let geometry = Self::coarse(geometry);
        let mut z_mm = Vec::new();
        task.progress.begin("depth", geometry.grid.iter().count() as u64, "views");
        let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
        let traced = renderer.depths(window, &geometry, &views, task, |_, depth| {
            z_mm.extend_from_slice(depth.data());
            task.progress.advance(1, "");
            Ok(())
        });
        task.progress.end();
        traced.map(|()| Self { geometry, z_mm })
    }

    /// Returns the geometry, with coarser pixels, at which the depths of a light field are kept.
    pub fn coarse(geometry: &FieldGeometry) -> FieldGeometry {
        coarser(geometry, geometry.grid.clone(), MOST_COLS)
    }

    /// Returns the depths of one view, `[row][col]`.
    pub fn view(&self, [y, x]: [usize; 2]) -> &[f32] {
        let size = self.geometry.rows * self.geometry.cols;
        &self.z_mm[(y * self.geometry.grid.views()[1] + x) * size..][..size]
    }

    /// Returns the fraction of a view's pixels that show a surface, 0..1.
    pub fn coverage(&self, view: [usize; 2]) -> f64 {
        let depth = self.view(view);
        depth.iter().filter(|z| z.is_finite()).count() as f64 / depth.len() as f64
    }

    /// Returns the depths of the middle view as the display shows them, scaled by the placement's
    /// depth scale.
    pub fn seen(&self, placement: &Placement) -> SeenDepth {
        let grid = &self.geometry.grid;
        let shown = |z: &f32| grid.projection.scaled_depth(f64::from(*z), placement.depth_scale) as f32;
        let middle = self.view(grid.views().map(|count| count / 2));
        let z_mm = middle.iter().map(|z| z.is_finite().then(|| shown(z))).collect();
        SeenDepth { rows: self.geometry.rows, cols: self.geometry.cols, z_mm }
    }

    /// Returns true if a pixel of the finer geometry `of` shows a surface: if the coarse pixel that
    /// covers the pixel's centre has a depth.
    pub fn is_surface(&self, view: [usize; 2], row: usize, col: usize, of: &FieldGeometry) -> bool {
        let place = |i: usize, from: usize, to: usize| ((2 * i + 1) * to / (2 * from)).min(to - 1);
        let (row, col) = (place(row, of.rows, self.geometry.rows), place(col, of.cols, self.geometry.cols));
        self.view(view)[row * self.geometry.cols + col].is_finite()
    }
}
