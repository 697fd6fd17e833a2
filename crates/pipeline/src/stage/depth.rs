//! How deep the views see, kept in the cache beside them.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry, SeenDepth};
use lumistack_report::DepthBudget;
use lumistack_scene::Window;

use crate::error::{PipelineError, field_error};
use crate::stage::ingest::renderer::SceneRenderer;
use crate::stage::place::{Placement, probe};
use crate::store::files::{read_json, write_json};
use crate::store::key::content_hash;

/// Columns at which depth is kept: enough for shares and percentiles.
const MOST_COLS: usize = 240;
/// Its file beside the views.
const FILE: &str = "depth.npy";
/// Beside it a hash of its content.
const HASH: &str = "depth.json";

/// z of the first surface along rays of all views, in the display space of the window.
#[derive(Clone, Debug)]
pub(crate) struct Depths {
    /// Its grid is that at which the views are traced.
    pub(crate) geometry: FieldGeometry,
    /// `[view_y][view_x][row][col]`, millimetres towards the viewer, NaN where a ray meets nothing.
    z_mm: Vec<f32>,
}

impl Depths {
    /// Reads what was kept for the views of a geometry.
    pub(crate) fn read(folder: &Path, geometry: &FieldGeometry) -> Option<Self> {
        let geometry = probe(geometry, geometry.grid.clone(), MOST_COLS);
        let [view_rows, view_cols] = geometry.grid.views();
        let hash: String = read_json(&folder.join(HASH))?;
        if content_hash(&folder.join(FILE)).ok()? != hash {
            return None;
        }
        let (shape, z_mm) = lumistack_field_io::npy::read(&folder.join(FILE)).ok()?;
        (shape == [view_rows, view_cols, geometry.rows, geometry.cols]).then_some(Self { geometry, z_mm })
    }

    /// Traces the central rays of coarser pixels and keeps what they meet, in a folder if there is one.
    ///
    /// # Errors
    /// When cancelled, or the file cannot be written.
    pub(crate) fn trace(
        renderer: &SceneRenderer,
        window: &Window,
        geometry: &FieldGeometry,
        folder: Option<&Path>,
        task: Task<'_>,
    ) -> Result<Self, PipelineError> {
        let geometry = probe(geometry, geometry.grid.clone(), MOST_COLS);
        let mut z_mm = Vec::new();
        task.progress.begin("depth", geometry.grid.iter().count() as u64, "views");
        let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
        let traced = renderer.depths(window, &geometry, &views, task, |_, depth| {
            z_mm.extend_from_slice(depth.data());
            task.progress.advance(1, "");
            Ok(())
        });
        task.progress.end();
        traced?;
        let [view_rows, view_cols] = geometry.grid.views();
        let shape = [view_rows, view_cols, geometry.rows, geometry.cols];
        if let Some(folder) = folder {
            let path = folder.join(FILE);
            lumistack_field_io::npy::write(&path, &shape, &z_mm).map_err(field_error)?;
            let hash = content_hash(&path).map_err(|source| PipelineError::Read { path, source })?;
            write_json(&folder.join(HASH), &hash)?;
        }
        Ok(Self { geometry, z_mm })
    }

    /// Of one view, `[row][col]`.
    pub(crate) fn view(&self, [y, x]: [usize; 2]) -> &[f32] {
        let size = self.geometry.rows * self.geometry.cols;
        &self.z_mm[(y * self.geometry.grid.views()[1] + x) * size..][..size]
    }

    /// Share of a view, 0..1, where it sees a surface.
    pub(crate) fn coverage(&self, view: [usize; 2]) -> f64 {
        let depth = self.view(view);
        depth.iter().filter(|z| z.is_finite()).count() as f64 / depth.len() as f64
    }

    /// What they ask of a display that shows the views at the slopes of `shown`, with depth scaled as the placement says.
    pub(crate) fn budget(&self, display: &Display, shown: &FieldGeometry, placement: &Placement) -> DepthBudget {
        let projection = shown.grid.projection;
        let z_mm: Vec<f32> =
            self.z_mm.iter().map(|z| projection.scaled_depth(f64::from(*z), placement.depth_scale) as f32).collect();
        let views = shown.grid.views();
        let size = self.geometry.rows * self.geometry.cols;
        let first = (views[0] / 2 * views[1] + views[1] / 2) * size;
        let mut budget = DepthBudget::measure(display, shown, &z_mm, &z_mm[first..first + size]);
        (budget.moved_back_mm, budget.depth_scale) = (placement.moved_back_mm, placement.depth_scale);
        budget.fitted = placement.fitted;
        budget
    }

    /// How deep the middle view sees on a display that shows the views with depth scaled as the placement says.
    pub(crate) fn seen(&self, placement: &Placement) -> SeenDepth {
        let grid = &self.geometry.grid;
        let shown = |z: &f32| grid.projection.scaled_depth(f64::from(*z), placement.depth_scale) as f32;
        let middle = self.view(grid.views().map(|count| count / 2));
        let z_mm = middle.iter().map(|z| z.is_finite().then(|| shown(z))).collect();
        SeenDepth { rows: self.geometry.rows, cols: self.geometry.cols, z_mm }
    }

    /// Whether the ray through a pixel of a finer geometry of the same size meets a surface.
    pub(crate) fn is_surface(&self, view: [usize; 2], row: usize, col: usize, of: &FieldGeometry) -> bool {
        let place = |i: usize, from: usize, to: usize| ((2 * i + 1) * to / (2 * from)).min(to - 1);
        let (row, col) = (place(row, of.rows, self.geometry.rows), place(col, of.cols, self.geometry.cols));
        self.view(view)[row * self.geometry.cols + col].is_finite()
    }
}
