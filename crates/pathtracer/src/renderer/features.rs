//! First surfaces of a view, without their light: the guides of the denoiser.
//!
//! Every number is the mean over the primary rays of a pixel that hit a surface. They have next to
//! no noise at a few rays per pixel, because paths end at the first hit.

use glam::{DVec3, Vec3};
use lumistack_core::{NoProgress, Task, Tensor, seed};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::beams::centred;
use super::{RenderError, Renderer};
use crate::sampler::SampleBank;
use crate::settings::AngularFilter;

/// Values of a pixel in [`Features`].
pub(crate) const FEATURES: usize = 10;
/// Reflectance of a dielectric at normal incidence, about.
const DIELECTRIC_SHARE: f32 = 0.04;
/// Stream of random numbers that no view's radiance uses.
const STREAM: u64 = 0xfea7;

/// Guides of one view, `[row][col][k]`.
#[derive(Clone, Debug)]
pub struct Features {
    values: Tensor<3>,
}

/// The guides of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feature {
    /// Share of the pixel where a surface is seen, 0..1; the other values are means over that part,
    /// and 0 where it is empty.
    pub covered: f32,
    /// Reflectance, 0..1: base colour plus a dielectric's few percent.
    pub albedo: Vec3,
    /// Shading normal on the viewer's side, display axes; shorter than 1 where the pixel sees
    /// several.
    pub normal: Vec3,
    /// Depth in display space, millimetres, towards the viewer.
    pub z_mm: f32,
    /// Share of the reflectance that goes with the viewer's direction (mirrors, metals, glass),
    /// 0..1.
    pub gloss: f32,
    /// Width of that lobe: squared roughness, 0..1.
    pub alpha: f32,
}

impl Features {
    /// The guides of a pixel.
    pub fn at(&self, row: usize, col: usize) -> Feature {
        let [covered, r, g, b, x, y, z, z_mm, gloss, alpha]: [f32; FEATURES] =
            self.values.block([row, col]).try_into().expect("a pixel has so many");
        Feature { covered, albedo: Vec3::new(r, g, b), normal: Vec3::new(x, y, z), z_mm, gloss, alpha }
    }

    /// [rows, columns].
    pub fn size(&self) -> [usize; 2] {
        let [rows, cols, _] = self.values.shape();
        [rows, cols]
    }

    /// Guides from values `[row][col][covered, albedo rgb, normal xyz, z_mm, gloss, alpha]`, for
    /// tests.
    #[cfg(test)]
    pub(crate) fn from_values(values: Tensor<3>) -> Self {
        Self { values }
    }
}

impl Renderer {
    /// Guides of one view from `samples` rays per pixel, over the same pixel and slopes as
    /// [`render_view`](Self::render_view). Does not advance the progress.
    ///
    /// # Errors
    /// As [`render_view`](Self::render_view).
    pub fn render_features(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        samples: u32,
        angular_filter: AngularFilter,
        task: Task<'_>,
    ) -> Result<Features, RenderError> {
        let rays = self.primary_rays(window, geometry, view, angular_filter)?;
        let (bank, space) = (SampleBank::new(samples), self.geometry.space);
        let view_seed = seed::derive(STREAM, &[view[0] as u64, view[1] as u64]);
        let display_from_scene = window.scene_from_display.rotation.inverse().as_quat();
        let quiet = Task { progress: &NoProgress, ..task };
        let values = self.by_tiles(geometry, quiet, ["row", "col", "feature"], |row, col, stack| {
            let pixel_seed = seed::derive(view_seed, &[row as u64, col as u64]);
            let mut sum = [0.0f32; FEATURES];
            let rays = rays.pixel(row, col);
            let samples_in_bounds = if rays.in_bounds { samples } else { 0 };
            for index in 0..samples_in_bounds {
                let draws = bank.draws(pixel_seed, index);
                let ray = rays.ray(centred(draws.pair(0).of(0)), centred(draws.pair(1).of(0)));
                let Some((point, normal, appearance)) = self.tracer().first_seen(&ray, rays.cone, &draws, stack) else {
                    continue;
                };
                // reflectance, and the share of it that depends on the viewer
                let reflectance = appearance.base.lerp(Vec3::ONE, DIELECTRIC_SHARE * (1.0 - appearance.metallic));
                let dielectric = DIELECTRIC_SHARE.max(appearance.transmission);
                let gloss = appearance.metallic + (1.0 - appearance.metallic) * dielectric;
                // position and normal in display axes
                let position = point.as_dvec3() / space.scale + space.centre;
                let at: DVec3 = window.scene_from_display.inverse_point(position);
                let n = display_from_scene * normal;
                let alpha = appearance.roughness * appearance.roughness;
                let [r, g, b] = reflectance.to_array();
                let values = [1.0, r, g, b, n.x, n.y, n.z, at.z as f32, gloss, alpha];
                (0..FEATURES).for_each(|k| sum[k] += values[k]);
            }
            // means over the hits; the share of hits is a mean over all samples
            let hits = sum[0].max(1.0);
            let mut mean = sum.map(|s| s / hits);
            mean[0] = sum[0] / samples as f32;
            mean
        })?;
        Ok(Features { values })
    }
}
