//! Further rays and paths for the pixels of a split view that are noisier than others.
//!
//! When light is shared between views, most of the remaining noise is in few pixels. Paths help
//! where mirrored light is noisy, and at edges, where no other view has the same mixture of
//! surfaces. Where a texture varies inside of a pixel, rays that end at the first surface suffice.
//! Such a ray takes a sixth to a half of the time of a path.
//!
//! ```text
//! paths of pixel i = n σ_i / σ_0,      σ_i: standard deviation of the light of a path,
//! from n to n (1 + `MOST`)             σ_0: the constant `OTHER` or `EDGE`,
//!                                      n: paths of every pixel without further paths
//! ```
//!
//! The choice for a pixel depends only on the pixels around it and on the mean of the view. The
//! samples of these pixels are independent of the pixel's own samples. In the mean, the pixel is
//! only one of thousands. So the choice adds no bias that could be measured.
//!
//! Measured with 5 × 5 views of 140 × 88 pixels and 4 samples: processor time at equal squared
//! error, as a fraction of the time of views rendered one by one. The columns state which pixels
//! get further rays: none with "shared alone". The variant "all" doubles the rays of every pixel,
//! but not its paths. The renderer does not have this variant.
//!
//! | scene | shared alone | all | edges and mirrors | with textures |
//! |---|---|---|---|---|
//! | FlightHelmet, diffuse | 1 / 2.3 | 1 / 2.7 | 1 / 3.3 | 1 / 4.1 |
//! | FlightHelmet, own materials | 1 / 1.8 | 1 / 1.8 | 1 / 2.8 | 1 / 3.2 |
//! | still-life, diffuse | 1 / 2.4 | 1 / 3.4 | 1 / 2.5 | 1 / 4.0 |
//! | still-life, own materials | 1 / 1.5 | 1 / 1.3 | 1 / 2.4 | 1 / 2.7 |

use glam::{Vec2, Vec3};
use lumistack_core::colour::luminance;
use lumistack_core::{NoProgress, Task, Tensor, seed};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::beams::ViewSamples;
use super::first::{ALPHA, APART, DisplayAxes, MORE_PARTS, PARTS};
use super::{RenderError, Renderer};
use crate::clamp::Clamped;
use crate::settings::Settings;

/// Stream of random numbers that no view uses for its other paths.
const STREAM: u64 = 0xed9e_0001;
/// The light of a pixel counts at most as this multiple of the view's mean light, since no display
/// shows more.
const BRIGHTEST: f32 = 4.0;
/// Two surfaces are treated as different if a point of one is farther than this from the plane of
/// the other, in pixels.
const LEAST_STEP: f32 = 1.5;
/// Two surfaces are also treated as different if the cosine between their normals is below this.
const LEAST_COSINE: f32 = 0.8;

/// σ_0 of the light that is not diffuse, as a fraction of the view's mean light. With half or twice
/// the values of `OTHER` and `EDGE`, the measured results were up to a tenth worse.
const OTHER: f32 = 0.12;
/// σ_0 of all light at edges, as a fraction of the view's mean light.
const EDGE: f32 = 0.2;
/// Greatest number of further paths of a pixel, as a multiple of the samples of a pixel.
const MOST: f32 = 8.0;
/// Smallest standard deviation of a texture's light, as a fraction of the view's mean light, for
/// which a pixel gets further rays.
const TEXTURE: f32 = 0.2;
/// Number of further rays of a pixel inside of a texture, as a multiple of the samples of a pixel.
const TEXTURE_RAYS: u32 = 3;
/// Largest factor from the variance of neighbouring pixels to the variance of a path. Below this
/// limit, the factor is the number of samples. With more samples, most of the pixels' variance is
/// contrast of the picture, which more samples do not reduce.
const NOISY_SAMPLES: f32 = 4.0;

/// Indices of the values by which the pixels around a pixel are compared.
const OTHER_LIGHT: usize = 0;
const ALL_LIGHT: usize = 1;
const DIFFUSE_LIGHT: usize = 2;
const REFLECTANCE: usize = 3;

/// Further rays of a pixel, of which the first continue as paths.
#[derive(Clone, Copy, Default)]
struct Further {
    paths: u32,
    rays: u32,
}

impl Renderer {
    /// Adds [further paths](Settings::further_paths) to a view whose pixels have the values of
    /// [`FirstSums::apart`]. Returns [`MORE_PARTS`] values per pixel. Also updates the variance of
    /// the means. Does not advance the progress.
    pub(super) fn with_further_paths(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
        values: &Tensor<3>,
        mut variance: Option<&mut Tensor<3>>,
    ) -> Result<Tensor<3>, RenderError> {
        // choose the pixels that get further rays
        let cols = values.shape()[1];
        let mut joined = joined::<MORE_PARTS>(values);
        if !settings.has_further_paths() {
            return Ok(joined);
        }
        let further = further(&joined, geometry.pitch_mm as f32, settings.samples);
        let most = further.iter().map(|further| further.rays).max().unwrap_or(0);
        if most == 0 {
            return Ok(joined);
        }
        // trace the further rays, with random numbers that no other ray uses
        let seed = seed::derive(settings.seed, &[STREAM]);
        let settings = Settings { seed, sparse_paths: false, ..*settings };
        let rays = self.primary_rays(window, geometry, view, settings.angular_filter)?;
        let samples = ViewSamples::new(rays, DisplayAxes::new(window, self.geometry.space), view, &settings, most);
        let (clamped, quiet) = (Clamped::default(), Task { progress: &NoProgress, ..task });
        let more = self.by_groups(geometry, quiet, ["row", "col", "part"], 1, |pixels, buffers, more| {
            let mut values = [0.0; APART + 3];
            let [row, col] = pixels[0];
            let Further { paths, rays } = further[row * cols + col];
            if rays > 0 {
                let count = [paths, rays];
                let seed = |at| samples.pixel_seed(at);
                self.pixels::<true>(&samples, pixels, seed, count, &settings, &clamped, buffers, |pixel, first| {
                    values[..APART].copy_from_slice(&first.apart(pixel.mean, pixel.finite));
                    values[APART..].copy_from_slice(&pixel.variance.to_array());
                });
            }
            more.push(values);
        })?;
        // join the values of both sets of rays, weighted by their numbers
        let [own_samples, own_rays] = settings.rays().map(|count| count as f32);
        let own = values.data().chunks_exact(APART);
        let pixels = joined.data_mut().chunks_exact_mut(MORE_PARTS).zip(own).zip(more.data().chunks_exact(APART + 3));
        for (number, ((joined, own), more)) in pixels.enumerate().filter(|(number, _)| further[*number].rays > 0) {
            let Further { paths, rays } = further[number];
            let (paths, rays) = (paths as f32, rays as f32);
            // fraction of the further paths among all paths, and of the further rays among all rays
            let (of_paths, of_rays) = (paths / (paths + own_samples), rays / (rays + own_rays));
            let surface = |values: &[f32]| values[9..12].iter().any(|normal| *normal != 0.0);
            let of_surface = match [surface(own), surface(more)] {
                [true, true] => of_rays,
                [own, _] => f32::from(u8::from(!own)),
            };
            let mut mean = [0.0; APART];
            for (index, ((mean, own), more)) in mean.iter_mut().zip(own).zip(more).enumerate() {
                let share = match index {
                    0..6 | PARTS..MORE_PARTS => of_paths,
                    9..13 => of_surface,
                    ALPHA => f32::from(u8::from(more < own)),
                    _ => of_rays,
                };
                *mean = own + share * (more - own);
            }
            joined.copy_from_slice(&join::<MORE_PARTS>(&mean));
            if let Some(variance) = variance.as_mut().filter(|_| paths > 0.0) {
                let variance = &mut variance.data_mut()[3 * number..3 * number + 3];
                for (own, more) in variance.iter_mut().zip(&more[APART..]) {
                    // Either the pixel's own paths or its further paths may be a single path, which
                    // has no variance. The single path then gets the variance per path of the other
                    // paths.
                    let [alone, more] = match [own.is_nan(), more.is_nan()] {
                        [true, _] => [more * paths / own_samples, *more],
                        [_, true] => [*own, *own * own_samples / paths],
                        _ => [*own, *more],
                    };
                    *own = (1.0 - of_paths).powi(2) * alone + of_paths.powi(2) * more;
                }
            }
        }
        Ok(joined)
    }
}

/// Applies [`join`] to every pixel.
pub(super) fn joined<const K: usize>(apart: &Tensor<3>) -> Tensor<3> {
    let [rows, cols, _] = apart.shape();
    let mut joined = Tensor::zeros(["row", "col", "part"], [rows, cols, K]);
    let pixels = joined.data_mut().chunks_exact_mut(K).zip(apart.data().chunks_exact(APART));
    pixels.for_each(|(joined, apart)| joined.copy_from_slice(&join::<K>(apart)));
    joined
}

/// Returns the first `K` values of a pixel of [`FirstSums::apart`]. The last three values of
/// `apart`, the light that the rays themselves see, are added to the light that is not diffuse.
fn join<const K: usize>(apart: &[f32]) -> [f32; K] {
    let mut joined = [0.0; K];
    joined.copy_from_slice(&apart[..K]);
    (0..3).for_each(|c| joined[3 + c] += apart[MORE_PARTS + c]);
    joined
}

/// Returns the further rays of each pixel, for a split view with `samples` paths per pixel.
fn further(values: &Tensor<3>, pitch_mm: f32, samples: u32) -> Vec<Further> {
    let [rows, cols, _] = values.shape();
    let vector = |pixel: &[f32], first: usize| Vec3::from_slice(&pixel[first..first + 3]);
    let pixels: Vec<&[f32]> = values.data().chunks_exact(MORE_PARTS).collect();
    let lightness = |rgb: Vec3| luminance(rgb.to_array());
    let sum: f64 = pixels.iter().map(|pixel| f64::from(lightness(vector(pixel, 0) + vector(pixel, 3)))).sum();
    let mean = (sum / pixels.len() as f64) as f32;
    if !(mean > 0.0 && mean.is_finite()) {
        return vec![Further::default(); pixels.len()];
    }
    let shown = |light: Vec3| (lightness(light) / mean).min(BRIGHTEST);
    let values_of = |pixel: &&[f32]| {
        let [diffuse, other] = [vector(pixel, 0), vector(pixel, 3)];
        [shown(other), shown(diffuse + other), shown(diffuse), lightness(vector(pixel, 6))]
    };
    let light: Vec<[f32; 4]> = pixels.iter().map(values_of).collect();
    let differ = |a: usize, b: usize, step: Vec2| {
        let (n, m) = (vector(pixels[a], 9), vector(pixels[b], 9));
        if (n == Vec3::ZERO) != (m == Vec3::ZERO) {
            return true;
        }
        let off = n.dot(Vec3::new(step.x, step.y, (pixels[b][12] - pixels[a][12]) / pitch_mm));
        n != Vec3::ZERO && (n.dot(m) < LEAST_COSINE * n.length() * m.length() || off.abs() > LEAST_STEP)
    };
    let counted = (samples as f32).min(NOISY_SAMPLES);
    let of_pixel = |i: usize| {
        let (row, col) = (i / cols, i % cols);
        if row == 0 || col == 0 || row + 1 == rows || col + 1 == cols {
            return Further::default();
        }
        let [up, down] = [i - cols, i + cols];
        let around = [up - 1, up, up + 1, i - 1, i + 1, down - 1, down, down + 1];
        // pairs of pixels on opposite sides; rows go down, and y goes up
        let is_edge = differ(up, down, Vec2::new(0.0, -2.0))
            || differ(i - 1, i + 1, Vec2::new(2.0, 0.0))
            || differ(up - 1, down + 1, Vec2::new(2.0, -2.0))
            || differ(up + 1, down - 1, Vec2::new(-2.0, -2.0));
        let mean = |of: usize| around.iter().map(|&at| light[at][of]).sum::<f32>() / 8.0;
        let variance = |of: usize| {
            let mean = mean(of);
            around.iter().map(|&at| (light[at][of] - mean).powi(2)).sum::<f32>() / 7.0
        };
        let (noisy, least) = if is_edge { (ALL_LIGHT, EDGE) } else { (OTHER_LIGHT, OTHER) };
        let deviation = (counted * variance(noisy)).sqrt();
        let paths = (samples as f32 * (deviation / least - 1.0).clamp(0.0, MOST)).round() as u32;
        // the reflectance is noisy inside of a texture; the light on the surface, which is the
        // diffuse light divided by the reflectance, is not
        let light_of_white = mean(DIFFUSE_LIGHT) / mean(REFLECTANCE).max(f32::MIN_POSITIVE);
        let texture = (counted * variance(REFLECTANCE)).sqrt() * light_of_white;
        let surfaces = if texture > TEXTURE { TEXTURE_RAYS * samples } else { 0 };
        Further { paths, rays: paths.max(surfaces) }
    };
    (0..pixels.len()).map(of_pixel).collect()
}
