//! How deep the views see.

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, SeenDepth};
use lumistack_scene::Window;

use crate::error::ShotError;
use crate::place::{Placement, probe};
use crate::renderer::SceneRenderer;

/// Columns at which depth is kept: enough for shares and percentiles.
const MOST_COLS: usize = 240;

/// z of the first surface along rays of all views, in the display space of the window.
#[derive(Clone, Debug)]
pub struct Depths {
    /// Its grid is that at which the views are traced.
    pub geometry: FieldGeometry,
    /// `[view_y][view_x][row][col]`, millimetres towards the viewer, NaN where a ray meets nothing.
    pub z_mm: Vec<f32>,
}

impl Depths {
    /// Traces the central rays of coarser pixels.
    ///
    /// # Errors
    /// When cancelled.
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

    /// The pixels at which depths of a geometry's views are kept.
    pub fn coarse(geometry: &FieldGeometry) -> FieldGeometry {
        probe(geometry, geometry.grid.clone(), MOST_COLS)
    }

    /// Of one view, `[row][col]`.
    pub fn view(&self, [y, x]: [usize; 2]) -> &[f32] {
        let size = self.geometry.rows * self.geometry.cols;
        &self.z_mm[(y * self.geometry.grid.views()[1] + x) * size..][..size]
    }

    /// Share of a view, 0..1, where it sees a surface.
    pub fn coverage(&self, view: [usize; 2]) -> f64 {
        let depth = self.view(view);
        depth.iter().filter(|z| z.is_finite()).count() as f64 / depth.len() as f64
    }

    /// How deep the middle view sees on a display that shows the views with depth scaled as the placement says.
    pub fn seen(&self, placement: &Placement) -> SeenDepth {
        let grid = &self.geometry.grid;
        let shown = |z: &f32| grid.projection.scaled_depth(f64::from(*z), placement.depth_scale) as f32;
        let middle = self.view(grid.views().map(|count| count / 2));
        let z_mm = middle.iter().map(|z| z.is_finite().then(|| shown(z))).collect();
        SeenDepth { rows: self.geometry.rows, cols: self.geometry.cols, z_mm }
    }

    /// Whether the ray through a pixel of a finer geometry of the same size meets a surface.
    pub fn is_surface(&self, view: [usize; 2], row: usize, col: usize, of: &FieldGeometry) -> bool {
        let place = |i: usize, from: usize, to: usize| ((2 * i + 1) * to / (2 * from)).min(to - 1);
        let (row, col) = (place(row, of.rows, self.geometry.rows), place(col, of.cols, self.geometry.cols));
        self.view(view)[row * self.geometry.cols + col].is_finite()
    }
}
