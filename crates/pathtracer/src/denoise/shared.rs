//! Light that does not depend on the view, averaged over all views that see the point from which
//! the light comes.
//!
//! ```text
//! E = D / ρ_d                            of the first surface (see SplitView): view-independent
//! E'(v, p) = Σ_u w E(u, p_u) / Σ_u w     over the views u of a row, then over those of a column
//! L' = G + ρ_d E'
//! ```
//!
//! p_u is the pixel where view u sees the point of p: a point at depth z moves by (s − s')·z from
//! view to view. The weight w is 1 if u sees the same surface there, and falls to 0 if it sees
//! another. It follows from the distance of u's point from the plane of p's point. Nothing is
//! averaged over neighbouring pixels, so shadows and textures stay sharp up to a pixel's rounding:
//! E is read at the pixel nearest to p_u. The mirrored light G stays as rendered.
//!
//! So a point that hundreds of views see has the samples of all of them. Each costs one shift and
//! one comparison. Averaging first over rows and then over columns takes as many steps as there are
//! rows and columns. One average over all views would take the product of these numbers.

use glam::{DVec2, Vec3};
use lumistack_core::{Cancelled, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection};
#[cfg(feature = "parallel")]
use rayon::prelude::*;

use crate::SplitView;

/// Distance of a point from the plane of another, in pixels, at which its weight has fallen to
/// about a third.
const PLANE_SCALE: f32 = 0.75;
/// Two surfaces are treated as different if the cosine between their normals is below this.
const LEAST_COSINE: f32 = 0.8;
/// Smallest reflectance that radiance is divided by. The light of darker surfaces is too noisy to
/// be shared.
const LEAST_REFLECTANCE: f32 = 0.02;

/// Data of a pixel for the filter: 20 bytes, since the pixels of all views are in memory.
#[derive(Clone, Copy)]
struct Point {
    /// E from the pixel's own samples.
    light: [f32; 3],
    z_mm: f32,
    /// Unit normal, times 127.
    normal: [i8; 3],
    /// True if the surface scatters light by Lambert's law.
    is_lit: bool,
}

/// Collects the light of a light field and averages it; needs 32 bytes for every ray meanwhile.
pub struct SharedLight<'a> {
    geometry: &'a FieldGeometry,
    points: Vec<Vec<Point>>,
}

/// E of every pixel of one view.
pub struct ViewLight(Vec<[f32; 3]>);

impl<'a> SharedLight<'a> {
    /// A collection without any view.
    pub fn new(geometry: &'a FieldGeometry) -> Self {
        Self { geometry, points: Vec::new() }
    }

    /// Adds the next view of the grid.
    ///
    /// # Panics
    /// If the view is not of the geometry's size.
    pub fn add(&mut self, view: &SplitView) {
        let [rows, cols] = view.size();
        assert_eq!([rows, cols], [self.geometry.rows, self.geometry.cols], "views of the geometry's size");
        self.points.push((0..rows * cols).map(|i| Point::of(view, i / cols, i % cols)).collect());
    }

    /// The mean light of every view of the grid. Advances the progress twice for each view.
    ///
    /// # Errors
    /// When cancelled.
    ///
    /// # Panics
    /// If not every view of the grid was added.
    pub fn averaged(mut self, task: Task<'_>) -> Result<Vec<ViewLight>, Cancelled> {
        let [view_rows, view_cols] = self.geometry.grid.views();
        assert_eq!(self.points.len(), view_rows * view_cols, "every view of the grid");
        let of_row = |index: usize| (0..view_cols).map(|x| index / view_cols * view_cols + x).collect::<Vec<usize>>();
        let of_col = |index: usize| (0..view_rows).map(|y| y * view_cols + index % view_cols).collect::<Vec<usize>>();
        let shared = pass(self.geometry, &self.points, of_row, task)?;
        for (points, light) in self.points.iter_mut().zip(shared) {
            points.iter_mut().zip(light.0).for_each(|(point, light)| point.light = light);
        }
        pass(self.geometry, &self.points, of_col, task)
    }
}

impl ViewLight {
    /// Returns the view with its view-independent light E replaced by this one, `[row][col][rgb]`.
    pub fn on(&self, view: &SplitView) -> Tensor<3> {
        let [rows, cols] = view.size();
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
        for (i, (rgb, light)) in radiance.data_mut().chunks_exact_mut(3).zip(&self.0).enumerate() {
            let pixel = view.at(i / cols, i % cols);
            rgb.copy_from_slice(&(pixel.other + divisor(pixel.reflectance) * Vec3::from_array(*light)).to_array());
        }
        radiance
    }
}

impl Point {
    fn of(view: &SplitView, row: usize, col: usize) -> Self {
        let pixel = view.at(row, col);
        Self {
            light: (pixel.diffuse / divisor(pixel.reflectance)).to_array(),
            z_mm: pixel.z_mm,
            normal: pixel.normal.to_array().map(|n| (127.0 * n).round() as i8),
            is_lit: pixel.reflectance.max_element() > 0.0,
        }
    }

    fn normal(&self) -> Vec3 {
        Vec3::from_array(self.normal.map(f32::from)) / 127.0
    }
}

fn divisor(reflectance: Vec3) -> Vec3 {
    reflectance.max(Vec3::splat(LEAST_REFLECTANCE))
}

/// The mean of every pixel's light over the views that `partners` lists for the pixel's view.
fn pass(
    geometry: &FieldGeometry,
    points: &[Vec<Point>],
    partners: impl Fn(usize) -> Vec<usize> + Sync,
    task: Task<'_>,
) -> Result<Vec<ViewLight>, Cancelled> {
    let one = |index: usize| {
        task.cancel.check()?;
        let light = of_view(geometry, points, index, &partners(index));
        task.progress.advance(1, "");
        Ok(light)
    };
    #[cfg(feature = "parallel")]
    return (0..points.len()).into_par_iter().map(one).collect();
    #[cfg(not(feature = "parallel"))]
    (0..points.len()).map(one).collect()
}

fn of_view(geometry: &FieldGeometry, points: &[Vec<Point>], index: usize, partners: &[usize]) -> ViewLight {
    let (rows, cols, pitch) = (geometry.rows, geometry.cols, geometry.pitch_mm);
    let grid = &geometry.grid;
    let view_cols = grid.slope_x.len();
    let slope_of = |view: usize| DVec2::new(grid.slope_x[view % view_cols], grid.slope_y[view / view_cols]);
    let own = &points[index];
    let mut light = Vec::with_capacity(own.len());
    let (mut sums, mut weights) = (vec![Vec3::ZERO; cols], vec![0.0f32; cols]);
    for row in 0..rows {
        let line = &own[row * cols..][..cols];
        // begin with the view's own light
        for ((sum, weight), point) in sums.iter_mut().zip(&mut weights).zip(line) {
            (*sum, *weight) = (Vec3::from_array(point.light), 1.0);
        }
        for &other in partners.iter().filter(|other| **other != index) {
            // add the light of every other view that sees the same point
            let turn = (slope_of(index) - slope_of(other)) / pitch;
            let (turn_x, turn_y) = (turn.x as f32, turn.y as f32);
            let seen = &points[other];
            for (col, point) in line.iter().enumerate() {
                if !point.is_lit {
                    continue;
                }
                let normal = point.normal();
                // x + s z is the same for both views; in a perspective view s decreases by x / D
                let depth = match grid.projection {
                    Projection::Oblique => point.z_mm,
                    Projection::Perspective { distance_mm } => point.z_mm / (1.0 - point.z_mm / distance_mm as f32),
                };
                let x = (col as f32 + turn_x * depth).round();
                let y = (row as f32 - turn_y * depth).round();
                if !(x >= 0.0 && y >= 0.0 && x < cols as f32 && y < rows as f32) {
                    continue;
                }
                let there = &seen[y as usize * cols + x as usize];
                if !there.is_lit || normal.dot(there.normal()) < LEAST_COSINE {
                    continue;
                }
                // up to a pixel's rounding both points are on the ray of p, so they differ only in
                // depth
                let off = normal.z * (there.z_mm - point.z_mm) / pitch as f32;
                let nearness = (1.0 - off * off * (0.25 / (PLANE_SCALE * PLANE_SCALE))).max(0.0);
                let weight = (nearness * nearness) * (nearness * nearness);
                sums[col] += weight * Vec3::from_array(there.light);
                weights[col] += weight;
            }
        }
        light.extend(sums.iter().zip(&weights).map(|(sum, weight)| (*sum / *weight).to_array()));
    }
    ViewLight(light)
}
