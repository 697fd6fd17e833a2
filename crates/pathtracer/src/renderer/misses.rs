//! Fraction of a view's samples that miss all surfaces, and so show a background.

use lumistack_core::{NoProgress, Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::{RenderError, Renderer};
use crate::settings::Settings;

impl Renderer {
    /// Returns, as `[row][col]`, the fraction 0..1 of the primary rays of every pixel that miss all
    /// surfaces. With the same settings, [`render_split`](Self::render_split) traces exactly these
    /// rays before any [further paths](Settings::further_paths). Without [further
    /// rays](Settings::further_rays), [`render_view`](Self::render_view) does, too. Does not
    /// advance the progress.
    ///
    /// # Errors
    /// The same errors as [`render_view`](Self::render_view).
    pub fn render_misses(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<Tensor<2>, RenderError> {
        let [_, rays_of_pixel] = settings.rays();
        let samples = self.samples_of(window, geometry, view, settings, rays_of_pixel)?;
        let (quiet, tracer) = (Task { progress: &NoProgress, ..task }, self.tracer());
        let shares = self.by_tiles(geometry, quiet, ["row", "col", "missed"], |row, col, stack| {
            if !settings.pixels.contains([row, col]) {
                return [0.0];
            }
            let mut missed = 0;
            let seed = |at| samples.pixel_seed(at);
            samples.for_each_beam_of(&[[row, col]], seed, [rays_of_pixel; 2], |beam, draws| {
                let (in_bounds, (rays, _)) = (beam.in_bounds, beam.parts());
                missed += tracer.misses(rays, in_bounds, draws, stack);
            });
            [missed as f32 / rays_of_pixel as f32]
        })?;
        let [rows, cols, _] = shares.shape();
        let mut flat = Tensor::zeros(["row", "col"], [rows, cols]);
        flat.data_mut().copy_from_slice(shares.data());
        Ok(flat)
    }
}
