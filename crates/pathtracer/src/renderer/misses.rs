//! Share of a view's samples that meet no surface: where a background shows.

use lumistack_core::{NoProgress, Task, Tensor, seed};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::{RenderError, Renderer, centred};
use crate::bvh::{BEAM, Ray};
use crate::sampler::SampleBank;
use crate::settings::Settings;

impl Renderer {
    /// Share 0..1 of the samples of every pixel that meet no surface at first, `[row][col]`: those very rays that
    /// [`render_view`](Self::render_view) traces with the same settings. Does not advance the progress.
    ///
    /// # Errors
    /// As [`render_view`](Self::render_view).
    pub fn render_misses(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<Tensor<2>, RenderError> {
        settings.check()?;
        let rays = self.primary_rays(window, geometry, view, settings.angular_filter)?;
        let bank = SampleBank::new(settings.samples);
        let view_seed = seed::derive(settings.seed, &[view[0] as u64, view[1] as u64]);
        let (quiet, tracer) = (Task { progress: &NoProgress, ..task }, self.tracer());
        let shares = self.by_tiles(geometry, quiet, ["row", "col", "missed"], |row, col, stack| {
            let pixel_seed = seed::derive(view_seed, &[row as u64, col as u64]);
            let rays = rays.pixel(row, col);
            let mut beam = [Ray::ANY; BEAM];
            let mut missed = 0;
            for first in (0..settings.samples).step_by(BEAM) {
                let beam = &mut beam[..(settings.samples - first).min(BEAM as u32) as usize];
                let draws = bank.draws(pixel_seed, first);
                let (in_pixel, in_bin) = (draws.pair(0), draws.pair(1));
                rays.fill(beam, |index| [centred(in_pixel.of(index)), centred(in_bin.of(index))]);
                missed += tracer.misses(beam, rays.in_bounds, &draws, stack);
            }
            [missed as f32 / settings.samples as f32]
        })?;
        let [rows, cols, _] = shares.shape();
        let mut flat = Tensor::zeros(["row", "col"], [rows, cols]);
        flat.data_mut().copy_from_slice(shares.data());
        Ok(flat)
    }
}
