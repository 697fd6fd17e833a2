//! Light that neighbouring views see alike, averaged over the nearest views that see the point from
//! which the light comes.
//!
//! ```text
//! E = D / ρ_p        D: light that the first surface scatters by Lambert's law (see SplitView)
//! H = G / γ_p        G: other light; it changes slowly from view to view if the surface is rough
//!
//! E'(v, p) = Σ_u w ρ_p(u) E(u, p_u) / Σ_u w ρ_p(u)           over the views u of a row,
//! H'(v, p) = Σ_u w k γ_p(u) H(u, p_u) / Σ_u w k γ_p(u)       then of a column
//! L' = ρ_d E' + γ_d H'
//! ```
//!
//! The mean diffuse reflectance of the first surfaces is ρ_p over the pixel's paths, and ρ_d over
//! all rays of the pixel. The same means of the other lobes' reflectance at normal incidence are
//! γ_p and γ_d. With [`Settings::further_rays`](crate::Settings::further_rays), pixels have more
//! rays than paths.
//!
//! View u sees the surface point of pixel p at the position p_u. Between two views with the slopes
//! s and s', a point at depth z moves by (s − s')·z. The weight w is 1 if u sees the same surface
//! at p_u. It falls to 0 with the distance of u's point from the plane of p's point, and is 0 if
//! the normals differ too much. At a distance of 1/√m pixels, where m is the number of rays of a
//! pixel, w is about a third. A pixel's depth is the mean over its rays, so more rays make it more
//! exact. Light from dark surfaces is noisy once it is divided by ρ_p; with the factor ρ_p it
//! contributes little. Nothing is averaged over neighbouring pixels; only [sparse
//! paths](crate::Settings::sparse_paths) serve several pixels. But E is read at the pixel nearest
//! to p_u, which blurs shadows and bumps over a fraction of a pixel. So w also falls with the
//! distance of p_u from this pixel's centre. D and G stay as rendered where no other view sees the
//! surface.
//!
//! E is the same in all views. A lobe of the roughness √α spreads light over angles of about α
//! around the mirrored direction. From view to view, this direction turns by |s − s'|. The weight
//! k = exp(−n |s − s'|² / α²), approximately, averages H over angles that the lobe spreads anyway.
//! With n = 1 path per pixel and view, the lobe becomes wider by about 9 %; with more paths, less
//! is averaged. With sparse paths, n is the number of paths on a smooth surface. Mirrors and glass,
//! with k = 0, keep their light as rendered.
//!
//! So a point that hundreds of views see has the diffuse samples of all of them, or of the nearest
//! [`NEAREST`]² views. Each step of an average costs one shift and one comparison. The averages
//! over a row and then over a column of views take one step per view of that row and column. One
//! average over all views would take one step per view of the grid.
//!
//! The table has results of `scenes/still-life/job.toml`, whose teapot is a rough metal, with
//! 13 × 13 views, and without sparse paths. The score is that of the viewing zone. A further ray
//! ends at the first surface.
//!
//! | paths | further rays | G | CPU seconds of rendering | score in the viewing zone |
//! |---|---|---|---|---|
//! | 1 | 0 | as rendered | 27 | 24.9 dB |
//! | 1 | 1 | as rendered | 31 | 25.4 dB |
//! | 2 | 0 | as rendered | 53 | 26.0 dB |
//! | 1 | 0 | shared | 27 | 25.5 dB |
//! | 1 | 1 | shared | 31 | 26.1 dB |
//! | 1 | 2 | shared | 36 | 26.1 dB |
//! | 2 | 0 | shared | 52 | 26.3 dB |
//! | 9 | 0 | as rendered | 227 | 26.6 dB |
//!
//! Twice and four times the square of α in k gave the same score within 0.02 dB. FlightHelmet,
//! whose metals have textures and bumps, scored 38.53 dB with 8 paths and G as rendered. With G
//! shared, but without the factor n and the weight of the distance from the pixel's centre, it
//! scored 38.48 dB, and with both 38.59 dB. Dielectrics matter, too: with G as rendered where
//! γ < 0.08, still-life lost 0.12 dB.
//!
//! [Further paths](crate::Settings::further_paths) for noisy pixels improve views that are seen one
//! by one. They do not help if the views are chosen for a display, since its solver averages the
//! same noise over many views.

use std::io;
use std::ops::Range;

use glam::{DVec2, Vec3};
use lumistack_core::pages::{Array, Plain, Storage, Window};
use lumistack_core::{Cancelled, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection};
#[cfg(feature = "parallel")]
use rayon::prelude::*;

use crate::surface::divisor;
use crate::{Settings, SplitView, light32};

/// Two surfaces are treated as different if the cosine between their normals is below this.
const LEAST_COSINE: f32 = 0.8;

/// Largest α of the weight k. Rougher surfaces are less noisy, and an average over many views
/// has a bias at the rim of the zone, where views on one side are missing.
const MOST_ALPHA: f32 = 0.1;

/// Number of views along each axis that are averaged if there are more. The noise that is left is
/// then in light that views do not share, so further views would only take time.
const NEAREST: usize = 13;

/// Data of a pixel for the filter. It is kept small, 20 bytes, since the pixels of all views are in
/// memory or in a file together.
#[derive(Clone, Copy, Default)]
#[repr(C)]
struct Point {
    z_mm: f32,
    /// E and H, which the top of the file defines, as codes of [`light32`]. In the first pass they
    /// come from the pixel's own samples. In the second pass they are the means over the pixel's
    /// row of views.
    light: [u32; 2],
    /// Weights of E and H, times 255: the largest channels of the reflectances of the surfaces that
    /// the paths hit.
    weights: [u8; 2],
    /// For E and H, 1 if another view has contributed, otherwise 0.
    are_shared: [u8; 2],
    /// Unit normal, times [`UNIT`]; 0 if no light of the surface can be shared.
    normal: [i8; 3],
    /// The square root of α, times 255.
    roughness: u8,
}

// SAFETY: a float, two 32-bit numbers and eight single bytes, without gaps
unsafe impl Plain for Point {}

/// Means of E and H over the views that see a point, as codes of [`light32`], or [`light32::NONE`]
/// if no other view contributes.
#[derive(Clone, Copy, Default)]
#[repr(transparent)]
struct Light([u32; 2]);

// SAFETY: two 32-bit numbers, without gaps
unsafe impl Plain for Light {}

/// Length of a unit normal in a [`Point`].
const UNIT: f32 = 127.0;

impl Light {
    /// Returns the means of E and H, `None` if no other view contributes.
    fn codes(self) -> [Option<u32>; 2] {
        self.0.map(|code| (code != light32::NONE).then_some(code))
    }
}

/// Light that the views of a light field are to share. It takes 28 bytes for every ray of the light
/// field, that is, for every pixel of every view.
pub struct SharedLight<'a> {
    geometry: &'a FieldGeometry,
    /// n of the weight k, the number of paths of a pixel on a smooth surface.
    paths: u32,
    /// Number of rays of a pixel.
    rays: u32,
    /// Number of views added.
    added: usize,
    /// Data of every pixel, `[view][row][col]`.
    points: Array<Point>,
    /// Mean of [`Point::light`] over the views, `[view][row][col]`, once it is computed.
    light: Array<Light>,
}

/// The mean light of every view.
pub struct MeanLight {
    /// Mean of [`Point::light`] over the views, `[view][row][col]`.
    light: Array<Light>,
}

impl<'a> SharedLight<'a> {
    /// Number of bytes that a ray takes.
    pub const BYTES_PER_RAY: u64 = (size_of::<Point>() + size_of::<Light>()) as u64;

    /// Starts without any view, in memory, for views with these settings.
    pub fn new(geometry: &'a FieldGeometry, settings: &Settings) -> Self {
        let (paths, [_, rays]) = (settings.paths_on_surface(), settings.rays());
        Self { geometry, paths, rays, added: 0, points: Array::Held(Vec::new()), light: Array::Held(Vec::new()) }
    }

    /// Starts without any view, in two arrays of a storage. While light is averaged, each thread
    /// also keeps the points of one view in memory.
    ///
    /// # Errors
    /// If the storage cannot create the arrays, for example because it is full.
    pub fn in_storage(geometry: &'a FieldGeometry, settings: &Settings, storage: &Storage) -> io::Result<Self> {
        let rays = geometry.grid.iter().count() * geometry.rows * geometry.cols;
        let (points, light) = (Array::zeros(rays, Some(storage))?, Array::zeros(rays, Some(storage))?);
        let (paths, [_, rays]) = (settings.paths_on_surface(), settings.rays());
        Ok(Self { geometry, paths, rays, added: 0, points, light })
    }

    /// Adds the next view of the grid.
    ///
    /// # Panics
    /// If the view is not of the geometry's size. With a storage, also if all views of the grid
    /// were added before.
    pub fn add(&mut self, view: &SplitView) {
        let [rows, cols] = view.size();
        assert_eq!([rows, cols], [self.geometry.rows, self.geometry.cols], "expected a view of the geometry's size");
        let first = self.added * rows * cols;
        if let Array::Held(points) = &mut self.points {
            points.resize(first + rows * cols, Point::default());
        }
        let (points, window) = self.points.all_mut();
        let points = &mut points[first..][..rows * cols];
        announce(window, size_of_val(points));
        let of_row = |(row, points): (usize, &mut [Point])| {
            points.iter_mut().enumerate().for_each(|(col, point)| *point = Point::of(view, row, col));
        };
        #[cfg(feature = "parallel")]
        points.par_chunks_mut(cols).enumerate().for_each(of_row);
        #[cfg(not(feature = "parallel"))]
        points.chunks_mut(cols).enumerate().for_each(of_row);
        self.added += 1;
    }

    /// Returns the mean light of every view of the grid. Advances the progress twice for each view.
    ///
    /// # Errors
    /// When cancelled.
    ///
    /// # Panics
    /// If not every view of the grid was added.
    pub fn averaged(mut self, task: Task<'_>) -> Result<MeanLight, Cancelled> {
        let [view_rows, view_cols] = self.geometry.grid.views();
        assert_eq!(self.added, view_rows * view_cols, "expected every view of the grid");
        if let Array::Held(light) = &mut self.light {
            *light = vec![Light::default(); self.added * self.geometry.rows * self.geometry.cols];
        }
        let of_row = |index: usize| {
            let near = nearest(index % view_cols, view_cols, view_rows);
            near.map(|x| index / view_cols * view_cols + x).collect::<Vec<usize>>()
        };
        let of_col = |index: usize| {
            let near = nearest(index / view_cols, view_rows, view_cols);
            near.map(|y| y * view_cols + index % view_cols).collect::<Vec<usize>>()
        };
        let scales = Scales { turns: turns(self.paths), plane_px: 1.0 / (self.rays.max(1) as f32).sqrt() };
        pass(self.geometry, &self.points, &scales, of_row, &mut self.light, task)?;
        let ((points, of_points), (light, of_light)) = (self.points.all_mut(), self.light.all());
        let cols = self.geometry.cols;
        let take = |(points, light): (&mut [Point], &[Light])| {
            announce(of_points, size_of_val(points));
            announce(of_light, size_of_val(light));
            for (point, light) in points.iter_mut().zip(light) {
                for (kind, code) in light.codes().into_iter().enumerate() {
                    let Some(code) = code else { continue };
                    (point.light[kind], point.are_shared[kind]) = (code, 1);
                    // If the pixel's own paths missed the surface, the pixel now has light from
                    // other views of the same row. So its weight must not be 0.
                    point.weights[kind] = point.weights[kind].max(1);
                }
            }
        };
        #[cfg(feature = "parallel")]
        points.par_chunks_mut(cols).zip(light.par_chunks(cols)).for_each(take);
        #[cfg(not(feature = "parallel"))]
        points.chunks_mut(cols).zip(light.chunks(cols)).for_each(take);
        pass(self.geometry, &self.points, &scales, of_col, &mut self.light, task)?;
        Ok(MeanLight { light: self.light })
    }
}

impl MeanLight {
    /// Returns the view of this number in the grid as radiance `[row][col][rgb]`. Where other views
    /// contributed to the mean light, the mean light replaces the light of the view itself.
    pub fn on(&self, number: usize, view: &SplitView) -> Tensor<3> {
        let [rows, cols] = view.size();
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
        let light = self.light.part(number * rows * cols..(number + 1) * rows * cols);
        for (i, (rgb, light)) in radiance.data_mut().chunks_exact_mut(3).zip(light).enumerate() {
            let pixel = view.at(i / cols, i % cols);
            let [diffuse, other] = light.codes();
            let shared = |reflectance: Vec3, code| divisor(reflectance) * Vec3::from_array(light32::decode(code));
            let diffuse = diffuse.map_or(pixel.diffuse, |code| shared(pixel.reflectance, code));
            let other = other.map_or(pixel.other, |code| shared(pixel.gloss, code));
            rgb.copy_from_slice(&(diffuse + other).to_array());
        }
        radiance
    }
}

fn announce(window: Option<&Window>, bytes: usize) {
    window.into_iter().for_each(|window| window.announce(bytes));
}

impl Point {
    fn of(view: &SplitView, row: usize, col: usize) -> Self {
        let pixel = view.at(row, col);
        let alpha = if pixel.gloss == Vec3::ZERO { 0.0 } else { pixel.alpha };
        let can_share = pixel.reflectance != Vec3::ZERO || alpha > 0.0;
        let normal = if can_share { pixel.normal } else { Vec3::ZERO };
        let code = |light: Vec3, reflectance| light32::encode((light / divisor(reflectance)).to_array());
        // the casts saturate
        let weight = |reflectance: Vec3| (255.0 * reflectance.max_element()).ceil() as u8;
        Self {
            z_mm: pixel.z_mm,
            light: [code(pixel.diffuse, pixel.path_reflectance), code(pixel.other, pixel.path_gloss)],
            weights: [weight(pixel.path_reflectance), weight(pixel.path_gloss)],
            are_shared: [0; 2],
            normal: normal.to_array().map(|n| (UNIT * n).round() as i8),
            roughness: (255.0 * alpha.sqrt()).round() as u8,
        }
    }
}

/// A pixel of the view whose mean light is computed, prepared for the comparison with the pixels of
/// other views.
struct Own {
    col: usize,
    z_mm: f32,
    /// Factor from a difference of slopes, in pixels per millimetre, to the shift of the point
    /// between two views, pixels.
    depth: f32,
    /// Factor from a difference of z to the distance of a point from this point's plane, relative
    /// to the distance at which the weight is 0.
    slant: f32,
    /// Factors from the offset of p_u from a pixel's centre to a distance from this point's plane.
    /// The offset is in half pixels along x and y; the distance has the unit of `slant`'s result.
    tilt: [f32; 2],
    normal: [i32; 3],
    /// The factor of |s − s'|² at the pixel's roughness, from [`turns`]. In perspective views, s
    /// and s' are the central slopes.
    turn: f32,
}

/// Scales of the weights of an average.
struct Scales {
    /// The factor of |s − s'|² in the weight k, for every value of [`Point::roughness`].
    turns: [f32; 256],
    /// Distance of one point from the plane of another point, in pixels, at which the weight w has
    /// fallen to about a third.
    plane_px: f32,
}

/// Returns n / (4 α²) of the weight k for every value of [`Point::roughness`]. It is infinite for
/// mirrors.
fn turns(paths: u32) -> [f32; 256] {
    std::array::from_fn(|roughness| {
        let alpha = (roughness as f32 / 255.0).powi(2).min(MOST_ALPHA);
        0.25 * paths as f32 / (alpha * alpha)
    })
}

/// Returns the views of a row or column of `count` views that are averaged for the view `own`. The
/// other axis has `across` views. The result has at most `NEAREST` views, or more if `across` is
/// smaller than `NEAREST`.
fn nearest(own: usize, count: usize, across: usize) -> Range<usize> {
    let most = (NEAREST * NEAREST / across.clamp(1, NEAREST)).min(count);
    let first = own.saturating_sub(most / 2).min(count - most);
    first..first + most
}

/// Computes the mean of every pixel's light over the views that `partners` lists for the pixel's
/// view.
fn pass(
    geometry: &FieldGeometry,
    points: &Array<Point>,
    scales: &Scales,
    partners: impl Fn(usize) -> Vec<usize> + Sync,
    light: &mut Array<Light>,
    task: Task<'_>,
) -> Result<(), Cancelled> {
    let (light, of_light) = light.all_mut();
    let one = |(index, light): (usize, &mut [Light])| {
        task.cancel.check()?;
        announce(of_light, size_of_val(light));
        match points.all() {
            (points, None) => of_view(geometry, points, scales, &|_| {}, index, &partners(index), light),
            (points, Some(window)) => {
                let announce = |points: usize| window.announce(points * size_of::<Point>());
                of_view(geometry, points, scales, &announce, index, &partners(index), light);
            }
        }
        task.progress.advance(1, "");
        Ok(())
    };
    let pixels = geometry.rows * geometry.cols;
    #[cfg(feature = "parallel")]
    return light.par_chunks_mut(pixels).enumerate().try_for_each(one);
    #[cfg(not(feature = "parallel"))]
    light.chunks_mut(pixels).enumerate().try_for_each(one)
}

/// Computes the mean light of one view over the view and its partners. `announce` receives the
/// number of points that have been read.
fn of_view(
    geometry: &FieldGeometry,
    points: &[Point],
    scales: &Scales,
    announce: &impl Fn(usize),
    index: usize,
    partners: &[usize],
    light: &mut [Light],
) {
    let (rows, cols, pitch) = (geometry.rows, geometry.cols, geometry.pitch_mm);
    let grid = &geometry.grid;
    let view_cols = grid.slope_x.len();
    let slope_of = |view: usize| DVec2::new(grid.slope_x[view % view_cols], grid.slope_y[view / view_cols]);
    let of_view = |view: usize| &points[view * rows * cols..][..rows * cols];
    let own = of_view(index);
    let (rows_f, cols_f) = (rows as f32, cols as f32);
    let tilt = 0.25 / (scales.plane_px * UNIT);
    let slant = 2.0 * tilt / pitch as f32;
    // the smallest product of two normals at which the surfaces are treated as equal
    let least_product = (LEAST_COSINE * UNIT * UNIT).ceil() as i32;
    let mut lit: Vec<Own> = Vec::with_capacity(cols);
    // sums of the weighted E and H, and of the weights
    let mut sums = vec![[[0.0f32; 4]; 2]; cols];
    let mut shared = vec![[false; 2]; cols];
    for (row, light) in light.chunks_exact_mut(cols).enumerate() {
        let line = &own[row * cols..][..cols];
        announce(cols);
        lit.clear();
        for (col, point) in line.iter().enumerate() {
            // begin with the view's own light
            sums[col] = [0, 1].map(|kind| weighted(f32::from(point.weights[kind]), point.light[kind]));
            shared[col] = point.are_shared.map(|shared| shared != 0);
            if point.normal == [0; 3] {
                continue;
            }
            // In both views a point at (X, z) appears at the x for which x + s z = X. In a
            // perspective view, the slope s at x is the view's central slope minus x /
            // `distance_mm`.
            let depth = match grid.projection {
                Projection::Oblique => point.z_mm,
                Projection::Perspective { distance_mm } => point.z_mm / (1.0 - point.z_mm / distance_mm as f32),
            };
            let normal = point.normal.map(i32::from);
            let turn = scales.turns[usize::from(point.roughness)];
            let ([x, y, z], z_mm) = (normal.map(|n| n as f32), point.z_mm);
            lit.push(Own { col, z_mm, depth, slant: slant * z, tilt: [tilt * x, tilt * y], normal, turn });
        }
        for &other in partners.iter().filter(|other| **other != index) {
            // add the light of every other view that sees the same point
            let turn = slope_of(index) - slope_of(other);
            let (turn_x, turn_y) = ((turn.x / pitch) as f32, (turn.y / pitch) as f32);
            let turn_squared = turn.length_squared() as f32;
            let seen = of_view(other);
            let (mut first, mut last) = (usize::MAX, 0);
            for point in &lit {
                // After the check below, x and y are not negative, so their conversion to whole
                // numbers rounds down. The conversion is faster than `round`, which is a call on
                // processors without SSE 4.1.
                let x = point.col as f32 + turn_x * point.depth + 0.5;
                let y = row as f32 - turn_y * point.depth + 0.5;
                if !(x >= 0.0 && y >= 0.0 && x < cols_f && y < rows_f) {
                    continue;
                }
                let (whole_x, whole_y) = (x as i32, y as i32);
                let at = whole_y as usize * cols + whole_x as usize;
                (first, last) = (first.min(at), last.max(at));
                let there = &seen[at];
                let [nx, ny, nz] = there.normal.map(i32::from);
                if point.normal[0] * nx + point.normal[1] * ny + point.normal[2] * nz < least_product {
                    continue;
                }
                // distance from the centre of the pixel that is read, 1 at the pixel's edges
                let (aside_x, aside_y) = (2.0 * (x - whole_x as f32) - 1.0, 2.0 * (y - whole_y as f32) - 1.0);
                // The read point differs from the own point in depth, and by the way to the pixel's
                // centre. Both change its distance from the own point's plane. Rows go down, y goes
                // up.
                let off = point.slant * (there.z_mm - point.z_mm) - point.tilt[0] * aside_x + point.tilt[1] * aside_y;
                let nearness = (1.0 - off * off).max(0.0);
                let central = (1.0 - aside_x * aside_x) * (1.0 - aside_y * aside_y);
                let same = central * (nearness * nearness) * (nearness * nearness);
                let (sums, shared) = (&mut sums[point.col], &mut shared[point.col]);
                let mut add = |kind: usize, weight: f32| {
                    let weight = weight * f32::from(there.weights[kind]);
                    let more = weighted(weight, there.light[kind]);
                    sums[kind].iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
                    shared[kind] |= weight > 0.0;
                };
                add(0, same);
                // the curve of k is close to exp(−x), and 0 from x = 4 on
                if turn_squared * point.turn < 1.0 {
                    let alike =
                        (1.0 - turn_squared * point.turn.max(scales.turns[usize::from(there.roughness)])).max(0.0);
                    add(1, same * (alike * alike) * (alike * alike));
                }
            }
            announce((last + 1).saturating_sub(first));
        }
        for ((light, sums), shared) in light.iter_mut().zip(&sums).zip(&shared) {
            light.0 = [0, 1].map(|kind| {
                let [r, g, b, weight] = sums[kind];
                if shared[kind] { light32::encode([r, g, b].map(|sum| sum / weight)) } else { light32::NONE }
            });
        }
    }
}

/// Returns light times its weight, then the weight.
#[inline]
fn weighted(weight: f32, code: u32) -> [f32; 4] {
    let [r, g, b] = light32::decode(code);
    [weight * r, weight * g, weight * b, weight]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_views_are_averaged() {
        // all views of the grids of most displays
        assert_eq!([nearest(0, 13, 13), nearest(12, 13, 13), nearest(2, 5, 5)], [0..13, 0..13, 0..5]);
        // 25 × 25 views: 13 views, six on either side; near the rim, the nearest 13 views
        assert_eq!([0, 3, 12, 20, 24].map(|own| nearest(own, 25, 25)), [0..13, 0..13, 6..19, 12..25, 12..25]);
        // a quilt has a single row
        assert_eq!([nearest(20, 45, 1), nearest(0, 1, 45), nearest(30, 60, 4)], [0..45, 0..1, 9..51]);
    }
}
