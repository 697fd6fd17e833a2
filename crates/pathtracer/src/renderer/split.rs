//! Views in two parts: light that the first surface scatters alike to all viewers, and all else.
//!
//! ```text
//! L = D + G,   D: scattered by Lambert's law at the first surface, with the reflectance ρ_d
//!             E = D / ρ_d does not depend on the view
//! ```
//!
//! Where a path's light is weighted by the share of the diffuse lobe in the scattering function at
//! its first vertex, the mean of that is D. It is the same light, of the same rays and random
//! numbers, that [`render_view`](Renderer::render_view) adds up.

use glam::Vec3;
use lumistack_core::{Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::{RenderError, Renderer};
use crate::bvh::BEAM;
use crate::clamp::Clamped;
use crate::settings::Settings;
use crate::tracer::First;

const VALUES: usize = SplitView::VALUES;

/// A view's light in two parts, with data of the surfaces that it comes from: means over the
/// samples of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitView {
    /// `[row][col][diffuse rgb, other rgb, reflectance rgb, normal x y z, z_mm]`. The normal has
    /// display axes, z_mm is depth in display space towards the viewer; both are 0 where no surface
    /// is seen.
    values: Tensor<3>,
}

/// A pixel of a [`SplitView`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SplitPixel {
    pub(crate) diffuse: Vec3,
    pub(crate) other: Vec3,
    pub(crate) reflectance: Vec3,
    pub(crate) normal: Vec3,
    pub(crate) z_mm: f32,
}

impl SplitView {
    /// Values of a pixel.
    pub const VALUES: usize = 13;

    /// From values as [`values`](Self::values) gives them; `None` where they have another shape.
    pub fn from_values(values: Tensor<3>) -> Option<Self> {
        (values.shape()[2] == VALUES).then_some(Self { values })
    }

    /// `[row][col][diffuse rgb, other rgb, reflectance rgb, normal xyz, z_mm]`: radiance, display
    /// axes, millimetres.
    pub fn values(&self) -> &Tensor<3> {
        &self.values
    }

    /// [rows, columns].
    pub fn size(&self) -> [usize; 2] {
        let [rows, cols, _] = self.values.shape();
        [rows, cols]
    }

    /// The view: the sum of both parts, `[row][col][rgb]`.
    pub fn radiance(&self) -> Tensor<3> {
        let [rows, cols] = self.size();
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
        for (sum, values) in radiance.data_mut().chunks_exact_mut(3).zip(self.values.data().chunks_exact(VALUES)) {
            (0..3).for_each(|c| sum[c] = values[c] + values[3 + c]);
        }
        radiance
    }

    /// Returns for each pixel, row by row, if a sample of it hits a surface.
    pub fn surfaces(&self) -> impl Iterator<Item = bool> {
        self.values.data().chunks_exact(VALUES).map(|values| values[9..12].iter().any(|normal| *normal != 0.0))
    }

    pub(crate) fn at(&self, row: usize, col: usize) -> SplitPixel {
        let v = self.values.block([row, col]);
        let vector = |first: usize| Vec3::from_slice(&v[first..first + 3]);
        SplitPixel { diffuse: vector(0), other: vector(3), reflectance: vector(6), normal: vector(9), z_mm: v[12] }
    }
}

impl Renderer {
    /// One view in two parts, by the samples of [`render_view`](Self::render_view) with the same
    /// settings. Advances the progress as that does.
    ///
    /// # Errors
    /// As [`render_view`](Self::render_view).
    pub fn render_split(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<SplitView, RenderError> {
        let samples = self.samples_of(window, geometry, view, settings)?;
        let (space, clamped, tracer) = (self.geometry.space, Clamped::default(), self.tracer());
        let display_from_scene = window.scene_from_display.rotation.inverse().as_quat();
        let values = self.by_tiles(geometry, task, ["row", "col", "part"], |row, col, stack| {
            let [mut diffuse, mut all, mut reflectance, mut normal] = [Vec3::ZERO; 4];
            let (mut z_mm, mut seen, mut finite) = (0.0, 0, 0);
            samples.for_each_beam([row, col], samples.pixel_seed(row, col), |beam, rays, draws| {
                let mut first = [First::default(); BEAM];
                let split = &mut first[..beam.len()];
                let radiance =
                    tracer.radiance_split::<true>(beam, rays.cone, rays.in_bounds, settings, draws, stack, split);
                for (&sample, first) in radiance.iter().zip(split) {
                    if !(sample.is_finite() && first.diffuse.is_finite()) {
                        continue;
                    }
                    // a limit dims both parts alike
                    let dimmed = settings.clamp.map_or(sample, |limit| clamped.dim(sample, limit));
                    let kept = if dimmed == sample { 1.0 } else { dimmed.max_element() / sample.max_element() };
                    finite += 1;
                    all += dimmed;
                    diffuse += kept * first.diffuse;
                    // the first surface, in display axes
                    if first.is_there {
                        seen += 1;
                        reflectance += first.reflectance;
                        normal += display_from_scene * first.normal;
                        let position = first.position.as_dvec3() / space.scale + space.centre;
                        z_mm += window.scene_from_display.inverse_point(position).z as f32;
                    }
                }
            });
            // light is a mean over all samples, normal and depth over those with a surface
            let (share, count) = (1.0 / finite.max(1) as f32, 1.0 / seen.max(1) as f32);
            let (diffuse, all) = (share * diffuse, share * all);
            let [other, reflectance, normal] =
                [all - diffuse, share * reflectance, count * normal].map(|v| v.to_array());
            let mut values = [0.0; VALUES];
            values[..3].copy_from_slice(&diffuse.to_array());
            values[3..6].copy_from_slice(&other);
            values[6..9].copy_from_slice(&reflectance);
            values[9..12].copy_from_slice(&normal);
            values[12] = count * z_mm;
            values
        })?;
        Ok(SplitView { values })
    }
}
