//! Views whose light is divided in two: light that the first surface scatters alike to all viewers,
//! and all other light.
//!
//! ```text
//! L = D + G,   D: scattered by Lambert's law at the first surface, with the reflectance ρ_d
//!             E = D / ρ_d does not depend on the view
//! ```
//!
//! G is all other light. D is a weighted mean of the light of all paths. A path's weight is the
//! fraction of the scattering function at its first vertex that comes from the diffuse lobe. D + G
//! is the light that [`render_view`](Renderer::render_view) computes from the same rays and random
//! numbers, unless paths are [sparse](Settings::sparse_paths).

use glam::Vec3;
use lumistack_core::{Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::features::Features;
use super::first::{ALPHA, APART, FEATURES, FirstSums, MORE_PARTS, PARTS};
use super::sums::PixelMean;
use super::{RenderError, Renderer, further, ranges};
use crate::light16;
use crate::settings::Settings;

/// A view whose diffuse and other light are separate, with data of the surfaces that the light
/// comes from. Light and reflectance are means over a pixel's samples. Normal and depth are means
/// over the samples that hit a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitView {
    /// `[row][col][diffuse rgb, other rgb, reflectance rgb, normal x y z, z_mm, gloss rgb, alpha]`.
    /// The normal is in display space, and z_mm is the depth in display space towards the viewer.
    /// Both are 0 if no surface is seen. The reflectance is that of the diffuse lobe. The gloss is
    /// the reflectance of the base's other lobes at normal incidence. Alpha is the smaller squared
    /// roughness of base and coat; it is 0 if the pixel shows glass or light that a ray itself
    /// sees. With [further rays](Settings::has_further_rays) a second reflectance rgb and a second
    /// gloss rgb follow. The first ones are means over all rays of the pixel, the second ones means
    /// over the rays that continue as paths.
    values: Tensor<3>,
}

/// A view whose diffuse and other light are separate, with data of the surfaces that its rays hit
/// first.
#[derive(Clone, Debug)]
pub struct GuidedSplit {
    /// The view's diffuse and other light.
    pub split: SplitView,
    /// Variance of every mean of the whole light, `[row][col][rgb]`; NaN if fewer than two samples
    /// are finite numbers.
    pub variance: Tensor<3>,
    /// Data of the surfaces that the view's rays hit first.
    pub features: Features,
}

/// A pixel of a [`SplitView`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SplitPixel {
    pub(crate) diffuse: Vec3,
    pub(crate) other: Vec3,
    pub(crate) reflectance: Vec3,
    /// Mean reflectance of the surfaces that the paths hit first. `diffuse` is light from these
    /// surfaces.
    pub(crate) path_reflectance: Vec3,
    pub(crate) normal: Vec3,
    pub(crate) z_mm: f32,
    /// Mean reflectance, at normal incidence, of the lobes that depend on the viewer's direction.
    pub(crate) gloss: Vec3,
    /// Mean of the same reflectance over the surfaces that the paths hit first.
    pub(crate) path_gloss: Vec3,
    /// Squared roughness of the sharpest lobe; 0 if other views see other light at the same point.
    pub(crate) alpha: f32,
}

/// Index of a pixel's reflectance among its values. The values before it are light.
const REFLECTANCE: usize = 6;
/// Index of a pixel's normal among its values.
const NORMAL: usize = 9;
/// Index of a pixel's depth among its values.
const Z: usize = 12;
/// Index of a pixel's glossy reflectance among its values.
const GLOSS: usize = 13;
/// Number of steps between 0 and 1 of a packed normal's components.
const NORMAL_STEPS: f32 = 127.0;

/// Returns the number of bytes of a packed pixel with this number of values: light takes two bytes
/// per value, depth four, and all others one.
fn bytes_of(parts: usize) -> usize {
    parts + REFLECTANCE + (size_of::<f32>() - 1)
}

/// Returns the indices of the values that take one byte.
fn parts_in_bytes(parts: usize) -> impl Iterator<Item = usize> {
    (REFLECTANCE..Z).chain(Z + 1..parts)
}

/// Packs a fraction 0..1 in a byte: its square root times 255. Small fractions thus have smaller
/// steps than large ones, as in pictures of 8 bits.
fn packed_fraction(value: f32) -> u8 {
    // the cast saturates
    (255.0 * value.max(0.0).sqrt()).round() as u8
}

fn fraction(packed: u8) -> f32 {
    let root = f32::from(packed) / 255.0;
    root * root
}

impl SplitView {
    /// Number of values per pixel without [further rays](Settings::has_further_rays).
    pub const VALUES: usize = PARTS;
    /// Range of a pixel's normal and depth among its values. They are 0 if no surface is seen.
    pub const SURFACE: std::ops::Range<usize> = NORMAL..Z + 1;
    /// Index of a pixel's alpha among its values.
    pub const ALPHA: usize = ALPHA;

    /// Returns the number of values per pixel of views with these settings.
    pub fn values_of(settings: &Settings) -> usize {
        if settings.has_further_rays() { MORE_PARTS } else { PARTS }
    }

    /// Makes a view from the tensor that [`values`](Self::values) returns; `None` if the tensor has
    /// a different number of values per pixel.
    pub fn from_values(values: Tensor<3>) -> Option<Self> {
        [PARTS, MORE_PARTS].contains(&values.shape()[2]).then_some(Self { values })
    }

    /// Returns `[row][col][diffuse rgb, other rgb, reflectance rgb, normal xyz, z_mm, gloss rgb,
    /// alpha]`. Light is radiance, normals are in display space, z is in millimetres. The gloss is
    /// the reflectance of the base's lobes that depend on the viewer's direction. Alpha is the
    /// smaller squared roughness of base and coat; it is 0 for glass and for light that rays
    /// themselves see. With [further rays](Settings::has_further_rays) a second reflectance rgb and
    /// a second gloss rgb follow, which are means over the paths alone.
    pub fn values(&self) -> &Tensor<3> {
        &self.values
    }

    /// Returns the values in few bytes for a file: [`packed_bytes`](Self::packed_bytes) per pixel.
    /// Light has a relative error of at most 2⁻¹¹; negative values become 0. The square roots of
    /// reflectances and of alpha have an error of at most 1/510; values above 1 become 1. The
    /// components of normals have an error of at most 1/254.
    pub fn to_bytes(&self) -> Vec<u8> {
        let [rows, cols, parts] = self.values.shape();
        let size = bytes_of(parts);
        let mut bytes = vec![0; rows * cols * size];
        for (packed, values) in bytes.chunks_exact_mut(size).zip(self.pixels()) {
            let (light, rest) = packed.split_at_mut(2 * REFLECTANCE);
            let (z, rest) = rest.split_at_mut(size_of::<f32>());
            for (place, value) in light.as_chunks_mut().0.iter_mut().zip(values) {
                *place = light16::encode(*value).to_le_bytes();
            }
            z.copy_from_slice(&values[Z].to_le_bytes());
            for (place, part) in rest.iter_mut().zip(parts_in_bytes(parts)) {
                *place = match part {
                    NORMAL..Z => (NORMAL_STEPS * values[part]).round() as i8 as u8,
                    _ => packed_fraction(values[part]),
                };
            }
        }
        bytes
    }

    /// Makes a view of `size` = [rows, columns] with these settings from the bytes that
    /// [`to_bytes`](Self::to_bytes) returns; `None` if their number is wrong.
    pub fn from_bytes(bytes: &[u8], size: [usize; 2], settings: &Settings) -> Option<Self> {
        let ([rows, cols], parts) = (size, Self::values_of(settings));
        let size = bytes_of(parts);
        if bytes.len() != rows * cols * size {
            return None;
        }
        let mut values = Tensor::zeros(["row", "col", "part"], [rows, cols, parts]);
        for (values, packed) in values.data_mut().chunks_exact_mut(parts).zip(bytes.chunks_exact(size)) {
            let (light, rest) = packed.split_at(2 * REFLECTANCE);
            let (z, rest) = rest.split_at(size_of::<f32>());
            for (value, place) in values.iter_mut().zip(light.as_chunks().0) {
                *value = light16::decode(u16::from_le_bytes(*place));
            }
            values[Z] = f32::from_le_bytes(z.try_into().ok()?);
            for (place, part) in rest.iter().zip(parts_in_bytes(parts)) {
                values[part] = match part {
                    NORMAL..Z => f32::from(*place as i8) / NORMAL_STEPS,
                    _ => fraction(*place),
                };
            }
        }
        Some(Self { values })
    }

    /// Returns the number of bytes per pixel of [`to_bytes`](Self::to_bytes).
    pub fn packed_bytes(settings: &Settings) -> usize {
        bytes_of(Self::values_of(settings))
    }

    /// Returns [rows, columns].
    pub fn size(&self) -> [usize; 2] {
        let [rows, cols, _] = self.values.shape();
        [rows, cols]
    }

    /// Returns the whole light of the view, the sum of diffuse and other light: `[row][col][rgb]`.
    pub fn radiance(&self) -> Tensor<3> {
        let [rows, cols] = self.size();
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
        for (sum, values) in radiance.data_mut().chunks_exact_mut(3).zip(self.pixels()) {
            sum.copy_from_slice(&both_parts(values));
        }
        radiance
    }

    /// Yields one value per pixel, row by row: true if any of the pixel's samples hits a surface.
    pub fn surfaces(&self) -> impl Iterator<Item = bool> {
        self.pixels().map(|values| values[NORMAL..NORMAL + 3].iter().any(|normal| *normal != 0.0))
    }

    fn pixels(&self) -> impl Iterator<Item = &[f32]> {
        self.values.data().chunks_exact(self.values.shape()[2])
    }

    pub(crate) fn at(&self, row: usize, col: usize) -> SplitPixel {
        let v = self.values.block([row, col]);
        let vector = |first: usize| Vec3::from_slice(&v[first..first + 3]);
        let has_paths = v.len() == MORE_PARTS;
        SplitPixel {
            diffuse: vector(0),
            other: vector(3),
            reflectance: vector(6),
            path_reflectance: vector(if has_paths { PARTS } else { 6 }),
            normal: vector(9),
            z_mm: v[12],
            gloss: vector(GLOSS),
            path_gloss: vector(if has_paths { PARTS + 3 } else { GLOSS }),
            alpha: v[ALPHA],
        }
    }
}

impl Renderer {
    /// Renders one view with its diffuse and other light separate. The samples are the samples of
    /// [`render_view`](Self::render_view) with the same settings, the [further
    /// rays](Settings::further_rays) and the [further paths](Settings::further_paths). With [sparse
    /// paths](Settings::sparse_paths), only some of the samples are paths. Advances the progress as
    /// `render_view` does.
    ///
    /// # Errors
    /// The same errors as [`render_view`](Self::render_view).
    pub fn render_split(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<SplitView, RenderError> {
        let values = if settings.has_further_rays() {
            let count = settings.rays();
            let apart = |pixel: &PixelMean, first: &FirstSums| first.apart(pixel.mean, pixel.finite);
            let values =
                self.view_of::<true, APART>(window, geometry, view, settings, count, task, apart, all_parts)?;
            self.with_further_paths(window, geometry, view, settings, task, &values, None)?
        } else {
            let count = [settings.samples; 2];
            let split = |pixel: &PixelMean, first: &FirstSums| first.split(pixel.mean, pixel.finite);
            self.view_of::<true, PARTS>(window, geometry, view, settings, count, task, split, both_parts)?
        };
        Ok(SplitView { values })
    }

    /// Renders like [`render_split`](Self::render_split). Like
    /// [`render_view_and_features`](Self::render_view_and_features), it also returns the variance
    /// of every mean and data of the first surfaces of all rays.
    ///
    /// # Errors
    /// The same errors as [`render_view`](Self::render_view).
    pub fn render_split_and_features(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<GuidedSplit, RenderError> {
        const VARIANCE: usize = APART + 3;
        let count = settings.rays();
        let all = |pixel: &PixelMean, first: &FirstSums| {
            let mut values = [0.0; VARIANCE + FEATURES];
            if settings.has_further_rays() {
                values[..APART].copy_from_slice(&first.apart(pixel.mean, pixel.finite));
            } else {
                values[..PARTS].copy_from_slice(&first.split(pixel.mean, pixel.finite));
            }
            values[APART..VARIANCE].copy_from_slice(&pixel.variance.to_array());
            values[VARIANCE..].copy_from_slice(&first.features());
            values
        };
        let all = self
            .view_of::<true, { VARIANCE + FEATURES }>(window, geometry, view, settings, count, task, all, all_parts)?;
        let [apart, mut variance, features] = ranges(&all, [("part", APART), ("rgb", 3), ("feature", FEATURES)]);
        let values = if settings.has_further_rays() {
            self.with_further_paths(window, geometry, view, settings, task, &apart, Some(&mut variance))?
        } else {
            further::joined::<PARTS>(&apart)
        };
        Ok(GuidedSplit { split: SplitView { values }, variance, features: Features { values: features } })
    }
}

/// Returns the radiance of a pixel whose first six values are its diffuse and its other light.
fn both_parts(values: &[f32]) -> [f32; 3] {
    [0, 1, 2].map(|c| values[c] + values[3 + c])
}

/// Returns the radiance of a pixel of [`FirstSums::apart`]: the sum of the diffuse light, the other
/// light, and the light that the rays themselves see.
fn all_parts(values: &[f32]) -> [f32; 3] {
    [0, 1, 2].map(|c| values[c] + values[3 + c] + values[MORE_PARTS + c])
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;

    use super::*;

    /// A packed view has the values of the original, apart from rounding. Packing it again changes
    /// nothing.
    #[test]
    fn packed_views_come_back() {
        let mut stream = Stream::new(4);
        let size = [5, 7];
        for further_rays in [false, true] {
            let settings = Settings { further_rays: u32::from(further_rays), samples: 2, ..Settings::default() };
            let parts = SplitView::values_of(&settings);
            assert_eq!(parts, if further_rays { MORE_PARTS } else { PARTS });
            let mut values = Tensor::zeros(["row", "col", "part"], [size[0], size[1], parts]);
            for (i, value) in values.data_mut().iter_mut().enumerate() {
                *value = match i % parts {
                    0..REFLECTANCE => (30.0 * stream.next_f32() - 10.0).exp2(),
                    NORMAL..=Z => 2.0 * stream.next_f32() - 1.0,
                    _ => stream.next_f32(),
                };
            }
            let view = SplitView::from_values(values).unwrap();
            let bytes = view.to_bytes();
            assert_eq!(bytes.len(), size[0] * size[1] * SplitView::packed_bytes(&settings));
            let back = SplitView::from_bytes(&bytes, size, &settings).unwrap();
            for (i, (was, is)) in view.values().data().iter().zip(back.values().data()).enumerate() {
                let (most, error) = match i % parts {
                    0..REFLECTANCE => (was / 2048.0, was - is),
                    NORMAL..Z => (0.5 / NORMAL_STEPS + f32::EPSILON, was - is),
                    Z => (0.0, was - is),
                    _ => (0.5 / 255.0 + f32::EPSILON, was.sqrt() - is.sqrt()),
                };
                assert!(error.abs() <= most, "value {}: {was} and {is}", i % parts);
            }
            assert_eq!(back.to_bytes(), bytes);
            assert!(SplitView::from_bytes(&bytes[1..], size, &settings).is_none());
            assert!(SplitView::from_bytes(&bytes, [5, 8], &settings).is_none());
        }
    }
}
