//! Light that does not depend on the view, averaged over all views that see the point from which
//! the light comes.
//!
//! ```text
//! E = D / ρ_p                            of the first surface (see SplitView): view-independent
//! E'(v, p) = Σ_u w E(u, p_u) / Σ_u w     over the views u of a row, then of a column
//! L' = G + ρ_d E'
//! ```
//!
//! D is the light that the first surface scatters diffusely, and G all other light. The mean
//! reflectance of the first surface is ρ_p over the pixel's paths, and ρ_d over all rays of the
//! pixel. With [`Settings::further_paths`](crate::Settings::further_paths), pixels of textures have
//! more rays than paths.
//!
//! View u sees the surface point of pixel p at the pixel p_u. Between two views with the slopes s
//! and s', a point at depth z moves by (s − s')·z. The weight w is ρ_p of view u, times a number
//! from 0 to 1. This number is 1 if u sees the same surface at p_u. It falls to 0 with the distance
//! of u's point from the plane of p's point, and is 0 if the normals differ too much. Light from
//! dark surfaces is noisy once it is divided by ρ_p; with the factor ρ_p it contributes little.
//! Nothing is averaged over neighbouring pixels, so shadows and textures stay sharp up to a pixel's
//! rounding: E is read at the pixel nearest to p_u. G stays as rendered, and so does D where no
//! other view sees the surface.
//!
//! So a point that hundreds of views see has the samples of all of them. Each step of an average
//! costs one shift and one comparison. The averages over a row and then over a column of views take
//! one step per view of that row and column. One average over all views would take one step per
//! view of the grid.
//!
//! Further paths for noisy pixels improve views that are seen one by one. They do not help if the
//! views are chosen for a display, since its solver averages the same noise over many views. The
//! table is for 13 × 13 views of still-life with its own materials, 70 × 44 pixels. The variance in
//! the table is the variance of the mean of all views, as a fraction of white squared.
//!
//! | samples | further paths | CPU seconds | variance |
//! |---|---|---|---|
//! | 1 | no | 1.16 | 3.8e-4 |
//! | 1 | yes | 2.19 | 1.5e-4 |
//! | 2 | no | 1.79 | 1.5e-4 |
//!
//! The job `scenes/still-life/job.toml` confirms this. With further paths and 1 path per view it
//! scored 26.2 dB after 72 s of rendering. Without them and with 2 paths per view it scored 26.0 dB
//! in about 60 s.

use std::io;

use glam::{DVec2, Vec3};
use lumistack_core::pages::{Array, Plain, Storage, Window};
use lumistack_core::{Cancelled, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection};
#[cfg(feature = "parallel")]
use rayon::prelude::*;

use crate::{SplitView, light16};

/// Distance of one point from the plane of another point, in pixels, at which the weight has fallen
/// to about a third.
const PLANE_SCALE: f32 = 0.75;
/// Two surfaces are treated as different if the cosine between their normals is below this.
const LEAST_COSINE: f32 = 0.8;
/// Smallest reflectance that radiance is divided by. The light of darker surfaces is too noisy to
/// be shared.
const LEAST_REFLECTANCE: f32 = 0.02;

/// Data of a pixel for the filter. It is kept small, 16 bytes, since the pixels of all views are in
/// memory or in a file together.
#[derive(Clone, Copy, Default)]
#[repr(C)]
struct Point {
    z_mm: f32,
    /// E, which the top of the file defines, as codes of [`light16`]. In the first pass it comes
    /// from the pixel's own samples. In the second pass it is the mean over the pixel's row of
    /// views.
    light: [u16; 3],
    /// 1 if another view has contributed to E, otherwise 0.
    is_shared: u16,
    /// Unit normal, times [`UNIT`]; 0 if the surface does not scatter light by Lambert's law.
    normal: [i8; 3],
    /// Weight of E, times 255: the largest channel of the reflectance of the surfaces that the
    /// paths hit.
    weight: u8,
}

// SAFETY: one float, four 16-bit numbers and four single bytes, without gaps
unsafe impl Plain for Point {}

/// Mean of E over the views that see a point, as codes of [`light16`]. The first code is [`ALONE`]
/// if no other view sees the point.
#[derive(Clone, Copy, Default)]
#[repr(transparent)]
struct Light([u16; 3]);

// SAFETY: three 16-bit numbers, without gaps
unsafe impl Plain for Light {}

/// First code of the light of a point that no other view sees.
const ALONE: u16 = u16::MAX;
/// Length of a unit normal in a [`Point`].
const UNIT: f32 = 127.0;

impl Light {
    fn shared(rgb: Vec3) -> Self {
        let [r, g, b] = rgb.to_array().map(light16::encode);
        Self([r.min(ALONE - 1), g, b])
    }

    fn codes(self) -> Option<[u16; 3]> {
        (self.0[0] != ALONE).then_some(self.0)
    }
}

/// Light that the views of a light field are to share. It takes 22 bytes for every ray.
pub struct SharedLight<'a> {
    geometry: &'a FieldGeometry,
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

    /// Starts without any view, in memory.
    pub fn new(geometry: &'a FieldGeometry) -> Self {
        Self { geometry, added: 0, points: Array::Held(Vec::new()), light: Array::Held(Vec::new()) }
    }

    /// Starts without any view, in two arrays of a storage. While light is averaged, each thread
    /// also keeps the points of one view in memory.
    ///
    /// # Errors
    /// If the storage is full.
    pub fn in_storage(geometry: &'a FieldGeometry, storage: &Storage) -> io::Result<Self> {
        let rays = geometry.grid.iter().count() * geometry.rows * geometry.cols;
        let (points, light) = (Array::zeros(rays, Some(storage))?, Array::zeros(rays, Some(storage))?);
        Ok(Self { geometry, added: 0, points, light })
    }

    /// Adds the next view of the grid.
    ///
    /// # Panics
    /// If the view is not of the geometry's size. With a storage, also if all views of the grid
    /// were added before.
    pub fn add(&mut self, view: &SplitView) {
        let [rows, cols] = view.size();
        assert_eq!([rows, cols], [self.geometry.rows, self.geometry.cols], "views of the geometry's size");
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
        assert_eq!(self.added, view_rows * view_cols, "every view of the grid");
        if let Array::Held(light) = &mut self.light {
            *light = vec![Light::default(); self.added * self.geometry.rows * self.geometry.cols];
        }
        let of_row = |index: usize| (0..view_cols).map(|x| index / view_cols * view_cols + x).collect::<Vec<usize>>();
        let of_col = |index: usize| (0..view_rows).map(|y| y * view_cols + index % view_cols).collect::<Vec<usize>>();
        pass(self.geometry, &self.points, of_row, &mut self.light, task)?;
        let ((points, of_points), (light, of_light)) = (self.points.all_mut(), self.light.all());
        let cols = self.geometry.cols;
        let take = |(points, light): (&mut [Point], &[Light])| {
            announce(of_points, size_of_val(points));
            announce(of_light, size_of_val(light));
            for (point, light) in points.iter_mut().zip(light) {
                if let Some(codes) = light.codes() {
                    (point.light, point.is_shared) = (codes, 1);
                    // If the pixel's own paths missed the surface, the pixel now has light from
                    // other views of the same row. So its weight must not be 0.
                    point.weight = point.weight.max(1);
                }
            }
        };
        #[cfg(feature = "parallel")]
        points.par_chunks_mut(cols).zip(light.par_chunks(cols)).for_each(take);
        #[cfg(not(feature = "parallel"))]
        points.chunks_mut(cols).zip(light.chunks(cols)).for_each(take);
        pass(self.geometry, &self.points, of_col, &mut self.light, task)?;
        Ok(MeanLight { light: self.light })
    }
}

impl MeanLight {
    /// Returns the view of this number in the grid as radiance `[row][col][rgb]`. Where other views
    /// contributed to the mean light, it replaces the diffuse light of the view itself.
    pub fn on(&self, number: usize, view: &SplitView) -> Tensor<3> {
        let [rows, cols] = view.size();
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
        let light = self.light.part(number * rows * cols..(number + 1) * rows * cols);
        for (i, (rgb, light)) in radiance.data_mut().chunks_exact_mut(3).zip(light).enumerate() {
            let pixel = view.at(i / cols, i % cols);
            let shared = |codes: [u16; 3]| divisor(pixel.reflectance) * Vec3::from_array(codes.map(light16::decode));
            let diffuse = light.codes().map_or(pixel.diffuse, shared);
            rgb.copy_from_slice(&(pixel.other + diffuse).to_array());
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
        let is_lit = pixel.reflectance.max_element() > 0.0;
        let normal = if is_lit { pixel.normal } else { Vec3::ZERO };
        let light = pixel.diffuse / divisor(pixel.path_reflectance);
        Self {
            z_mm: pixel.z_mm,
            light: light.to_array().map(light16::encode),
            is_shared: 0,
            normal: normal.to_array().map(|n| (UNIT * n).round() as i8),
            // the cast saturates
            weight: (255.0 * pixel.path_reflectance.max_element()).ceil() as u8,
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
    normal: [i32; 3],
}

fn divisor(reflectance: Vec3) -> Vec3 {
    reflectance.max(Vec3::splat(LEAST_REFLECTANCE))
}

/// Computes the mean of every pixel's light over the views that `partners` lists for the pixel's
/// view.
fn pass(
    geometry: &FieldGeometry,
    points: &Array<Point>,
    partners: impl Fn(usize) -> Vec<usize> + Sync,
    light: &mut Array<Light>,
    task: Task<'_>,
) -> Result<(), Cancelled> {
    let (light, of_light) = light.all_mut();
    let one = |(index, light): (usize, &mut [Light])| {
        task.cancel.check()?;
        announce(of_light, size_of_val(light));
        match points.all() {
            (points, None) => of_view(geometry, points, &|_| {}, index, &partners(index), light),
            (points, Some(window)) => {
                let announce = |points: usize| window.announce(points * size_of::<Point>());
                of_view(geometry, points, &announce, index, &partners(index), light);
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
    let slant = 0.5 / (PLANE_SCALE * pitch as f32 * UNIT);
    // the smallest product of two normals at which the surfaces are treated as equal
    let least_product = (LEAST_COSINE * UNIT * UNIT).ceil() as i32;
    let mut lit: Vec<Own> = Vec::with_capacity(cols);
    // sums of the weighted light, and of the weights
    let mut sums = vec![[0.0f32; 4]; cols];
    let mut shared = vec![false; cols];
    for (row, light) in light.chunks_exact_mut(cols).enumerate() {
        let line = &own[row * cols..][..cols];
        announce(cols);
        lit.clear();
        for (col, point) in line.iter().enumerate() {
            // begin with the view's own light
            let weight = f32::from(point.weight);
            let [r, g, b] = point.light.map(light16::decode);
            sums[col] = [weight * r, weight * g, weight * b, weight];
            shared[col] = point.is_shared != 0;
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
            lit.push(Own { col, z_mm: point.z_mm, depth, slant: slant * normal[2] as f32, normal });
        }
        for &other in partners.iter().filter(|other| **other != index) {
            // add the light of every other view that sees the same point
            let turn = (slope_of(index) - slope_of(other)) / pitch;
            let (turn_x, turn_y) = (turn.x as f32, turn.y as f32);
            let seen = of_view(other);
            let (mut first, mut last) = (usize::MAX, 0);
            for point in &lit {
                // The sums are not negative, so the conversion to whole numbers rounds down. It is
                // faster than `round`, which is a call on processors without SSE 4.1.
                let x = point.col as f32 + turn_x * point.depth + 0.5;
                let y = row as f32 - turn_y * point.depth + 0.5;
                if !(x >= 0.0 && y >= 0.0 && x < cols_f && y < rows_f) {
                    continue;
                }
                let at = y as i32 as usize * cols + x as i32 as usize;
                (first, last) = (first.min(at), last.max(at));
                let there = &seen[at];
                let [nx, ny, nz] = there.normal.map(i32::from);
                if point.normal[0] * nx + point.normal[1] * ny + point.normal[2] * nz < least_product {
                    continue;
                }
                // `point` and `there` are on the ray of one pixel, apart from the rounding to whole
                // pixels. So they differ only in depth.
                let off = point.slant * (there.z_mm - point.z_mm);
                let nearness = (1.0 - off * off).max(0.0);
                let weight = (nearness * nearness) * (nearness * nearness) * f32::from(there.weight);
                let [r, g, b] = there.light.map(light16::decode);
                let sum = &mut sums[point.col];
                *sum = [sum[0] + weight * r, sum[1] + weight * g, sum[2] + weight * b, sum[3] + weight];
                shared[point.col] |= weight > 0.0;
            }
            announce((last + 1).saturating_sub(first));
        }
        for ((light, [r, g, b, weight]), is_shared) in light.iter_mut().zip(&sums).zip(&shared) {
            *light = if *is_shared { Light::shared(Vec3::new(*r, *g, *b) / *weight) } else { Light([ALONE, 0, 0]) };
        }
    }
}
