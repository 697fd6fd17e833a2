//! Data of a view's first surfaces. They guide a denoiser, and picture files can store them as
//! layers.
//!
//! Most values are means over the paths of a pixel that hit a surface; [`Feature`] describes the
//! other values. [`Renderer::render_view_and_features`] records the surfaces while it renders.
//! [`Renderer::render_features`] traces the same rays only to their first hits.

use glam::Vec3;
use lumistack_core::{NoProgress, Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::beams::place_in_pixel;
use super::first::{FEATURES, FirstSums};
use super::sums::PixelMean;
use super::{RenderError, Renderer, ranges, rgb};
use crate::settings::Settings;

/// Data of the first surfaces of one view, which guide a denoiser.
#[derive(Clone, Debug)]
pub struct Features {
    /// `[row][col][covered, albedo rgb, normal xyz, z_mm, gloss, alpha, central z_mm]`.
    pub(super) values: Tensor<3>,
}

/// A view, and data of the surfaces that its paths hit first.
#[derive(Clone, Debug)]
pub struct GuidedView {
    /// Scene-linear radiance, `[row][col][rgb]`.
    pub radiance: Tensor<3>,
    /// Variance of every pixel's mean, `[row][col][rgb]`: the variance of the samples divided by
    /// their number. Samples are stratified, so the true variance of the means is smaller. NaN if
    /// fewer than two samples are finite numbers.
    pub variance: Tensor<3>,
    /// Data of the surfaces that the view's paths hit first.
    pub features: Features,
}

/// The guides of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feature {
    /// Fraction of the pixel in which a surface is seen, 0..1. All other values except the central
    /// depth are means over this fraction, and 0 if no surface is seen.
    pub covered: f32,
    /// Reflectance, 0..1: base colour plus the few percent that a dielectric reflects.
    pub albedo: Vec3,
    /// Mean of the shading normals on the viewer's side, in display space. It is shorter than 1 if
    /// the pixel shows several normals.
    pub normal: Vec3,
    /// Depth in display space, towards the viewer, in millimetres.
    pub z_mm: f32,
    /// Fraction of the reflectance that depends on the viewer's direction (mirrors, metals, glass),
    /// 0..1.
    pub gloss: f32,
    /// Width of the lobe that depends on the viewer's direction: squared roughness, 0..1.
    pub alpha: f32,
    /// Depth of the first hit of the path that is nearest to the pixel's centre, in display space,
    /// in millimetres. `None` if this path hits nothing.
    pub central_z_mm: Option<f32>,
}

impl Features {
    /// Number of values per pixel.
    pub const VALUES: usize = FEATURES;

    /// Makes features from the tensor that [`values`](Self::values) returns; `None` if the tensor
    /// has a different number of values per pixel.
    pub fn from_values(values: Tensor<3>) -> Option<Self> {
        (values.shape()[2] == FEATURES).then_some(Self { values })
    }

    /// Returns `[row][col][covered, albedo rgb, normal xyz, z_mm, gloss, alpha, central z_mm]`.
    /// [`Feature`] describes these values; an absent central depth is NaN.
    pub fn values(&self) -> &Tensor<3> {
        &self.values
    }

    /// Returns the guides of a pixel.
    pub fn at(&self, row: usize, col: usize) -> Feature {
        let [covered, r, g, b, x, y, z, z_mm, gloss, alpha, central]: [f32; FEATURES] =
            self.values.block([row, col]).try_into().expect("a pixel has FEATURES values");
        let (albedo, normal) = (Vec3::new(r, g, b), Vec3::new(x, y, z));
        let central_z_mm = (!central.is_nan()).then_some(central);
        Feature { covered, albedo, normal, z_mm, gloss, alpha, central_z_mm }
    }

    /// Returns [rows, columns].
    pub fn size(&self) -> [usize; 2] {
        let [rows, cols, _] = self.values.shape();
        [rows, cols]
    }

    /// Returns the guides over the samples of two renders of one view. The renders must have equal
    /// numbers of samples. The central depth is the central depth of `self`.
    ///
    /// # Panics
    /// If the sizes of `self` and `other` differ.
    #[must_use]
    pub fn joined(mut self, other: &Self) -> Self {
        assert_eq!(self.size(), other.size(), "expected guides of equal sizes");
        let pixels = self.values.data_mut().chunks_exact_mut(FEATURES).zip(other.values.data().chunks_exact(FEATURES));
        for (own, other) in pixels {
            let all = own[0] + other[0];
            let share = if all > 0.0 { other[0] / all } else { 0.0 };
            own[0] = 0.5 * all;
            for (own, other) in own[1..FEATURES - 1].iter_mut().zip(&other[1..]) {
                *own += share * (other - *own);
            }
        }
        self
    }
}

impl Renderer {
    /// Renders a view, and also returns the variance of every mean and data of the first surfaces
    /// of all paths. In all pixels that [`render_view`](Self::render_view) renders, the radiance
    /// equals its radiance bit for bit.
    ///
    /// # Errors
    /// The same errors as [`render_view`](Self::render_view).
    pub fn render_view_and_features(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<GuidedView, RenderError> {
        let all = |pixel: &PixelMean, first: &FirstSums| {
            let mut values = [0.0; 6 + FEATURES];
            values[..3].copy_from_slice(&pixel.mean.to_array());
            values[3..6].copy_from_slice(&pixel.variance.to_array());
            values[6..].copy_from_slice(&first.features());
            values
        };
        let (count, settings) = ([settings.samples; 2], &Settings { sparse_paths: false, ..*settings });
        let all = self.view_of::<true, { 6 + FEATURES }>(window, geometry, view, settings, count, task, all, rgb)?;
        let [radiance, variance, values] = ranges(&all, [("rgb", 3), ("rgb", 3), ("feature", FEATURES)]);
        Ok(GuidedView { radiance, variance, features: Features { values } })
    }

    /// Returns the guides of one view. The view's rays are the rays that
    /// [`render_view`](Self::render_view) traces with the same settings. No light is computed. Does
    /// not advance the progress.
    ///
    /// # Errors
    /// The same errors as [`render_view`](Self::render_view).
    pub fn render_features(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<Features, RenderError> {
        let samples = self.samples_of(window, geometry, view, settings, settings.samples)?;
        let (quiet, tracer) = (Task { progress: &NoProgress, ..task }, self.tracer());
        let values = self.by_tiles(geometry, quiet, ["row", "col", "feature"], |row, col, stack| {
            let mut sums = FirstSums::default();
            samples.for_each_beam(&[[row, col]], |beam, draws| {
                let (in_bounds, (rays, cones)) = (beam.in_bounds, beam.parts());
                let surfaces = tracer.first(rays, cones, in_bounds, draws, stack);
                for (index, first) in surfaces[..rays.len()].iter().enumerate() {
                    sums.add(first, place_in_pixel(draws, index), &samples.axes);
                }
            });
            sums.turned(&samples.axes).features()
        })?;
        Ok(Features { values })
    }
}
