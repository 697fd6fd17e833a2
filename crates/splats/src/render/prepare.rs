//! Splats in the coordinates of a window: the work that all views share.
//!
//! Coordinates are pixels of the light field. The column is x and the row is y; both are whole
//! numbers at the centres of pixels. The axis z points from the window to the viewer. A ray of
//! slope s = (s_x, s_y), with y downwards, that crosses z = 0 at p has the points p + z s. Let a
//! splat have the centre (x, y, z) and the covariance Σ. The projection onto z = 0 along such rays
//! is linear, so the projected splat is a Gaussian, too. It has the centre p and the covariance Σ':
//!
//! ```text
//! p = (x − z s_x, y − z s_y),   Σ' = J Σ Jᵀ,   J = m (1 0 −s_x; 0 1 −s_y),   m = 1
//! ```
//!
//! The ray from an eye through the splat's centre has s = (e − c)/(D − z) and m = D/(D − z). Here e
//! has the column and row of the eye, and c = (x, y) those of the centre. D is the distance of the
//! eye from the window. Within one splat, rays are treated as parallel. This is the affine
//! approximation that KHR_gaussian_splatting prescribes, for the sheared frustum of the window.

use glam::{DMat3, DVec3, Mat3, Vec3};
use lumistack_display::{FieldGeometry, Projection};
use lumistack_scene::{Scene, Window};
#[cfg(feature = "parallel")]
use rayon::prelude::*;

/// Width and height of a tile, in pixels.
pub(crate) const TILE: usize = 16;
/// Variance of a box as wide as a pixel, pixels².
pub(crate) const PIXEL_VARIANCE: f32 = 1.0 / 12.0;
/// Mahalanobis distance from the centre at which a splat ends.
pub(crate) const CUTOFF: f32 = 3.0;
/// Splats closer to the eye than this fraction of the eye's distance from the window are not shown.
pub(crate) const NEAREST: f32 = 0.05;

/// A splat in the window's coordinates, in pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Splat {
    /// Column, row and depth of the splat's centre.
    pub(crate) centre: [f32; 3],
    /// Covariance of the splat in pixels²: xx, xy, xz, yy, yz, zz.
    pub(crate) covariance: [f32; 6],
    pub(crate) opacity: f32,
    /// Index of the placed cloud (`placed`), and of the splat in the cloud (`index`).
    pub(crate) placed: u32,
    pub(crate) index: u32,
}

/// A view: parallel rays, or an eye, in pixels with y downwards.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Eye {
    Slope([f32; 2]),
    /// Column and row of the eye, and its distance from the window.
    At([f32; 2], f32),
}

/// The projection of a splat onto the window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) at: [f32; 2],
    /// Covariance of the projection in pixels²: xx, xy, yy, without the pixel's variance.
    pub(crate) covariance: [f32; 3],
}

impl Eye {
    pub(crate) fn new(geometry: &FieldGeometry, slope: [f64; 2]) -> Self {
        let down = [slope[0], -slope[1]];
        match geometry.grid.projection {
            Projection::Oblique => Self::Slope(down.map(|s| s as f32)),
            Projection::Perspective { distance_mm } => {
                let distance = distance_mm / geometry.pitch_mm;
                let middle = middle(geometry);
                Self::At([0, 1].map(|axis| (middle[axis] + distance * down[axis]) as f32), distance as f32)
            }
        }
    }

    /// Returns the slopes of the ray through a splat's centre, and the magnification m. `None` for
    /// a splat behind the eye, or closer to the eye than [`NEAREST`].
    #[inline]
    fn ray(&self, [x, y, z]: [f32; 3]) -> Option<([f32; 2], f32)> {
        match *self {
            Self::Slope(slope) => Some((slope, 1.0)),
            Self::At(eye, distance) => {
                let before = distance - z;
                (before > NEAREST * distance)
                    .then(|| ([(eye[0] - x) / before, (eye[1] - y) / before], distance / before))
            }
        }
    }

    /// Projects a splat onto the window. `None` for a splat behind the eye, or closer to the eye
    /// than [`NEAREST`].
    #[inline]
    pub(crate) fn project(&self, splat: &Splat) -> Option<Seen> {
        let ([sx, sy], m) = self.ray(splat.centre)?;
        let [x, y, z] = splat.centre;
        let [xx, xy, xz, yy, yz, zz] = splat.covariance;
        let square = m * m;
        Some(Seen {
            at: [x - z * sx, y - z * sy],
            covariance: [
                square * (xx - 2.0 * sx * xz + sx * sx * zz),
                square * (xy - sx * yz - sy * xz + sx * sy * zz),
                square * (yy - 2.0 * sy * yz + sy * sy * zz),
            ],
        })
    }

    /// Returns the direction from the viewer to a point. Its y points down, and its length is
    /// arbitrary.
    #[inline]
    pub(crate) fn direction(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        match *self {
            Self::Slope([sx, sy]) => [-sx, -sy, -1.0],
            Self::At(eye, distance) => [x - eye[0], y - eye[1], z - distance],
        }
    }
}

/// Returns the column and row of the centre of a view, in pixels.
fn middle(geometry: &FieldGeometry) -> [f64; 2] {
    [geometry.cols, geometry.rows].map(|count| 0.5 * (count as f64 - 1.0))
}

/// Returns two eyes that have the smallest and the largest coordinates of all eyes.
///
/// The centre of a projected splat is a linear function of each coordinate of the eye, and its
/// extent is a convex function. So the bounds of these two projections contain the projections into
/// all views.
pub(crate) fn ends(eyes: &[Eye]) -> Vec<Eye> {
    let both = |of: fn(f32, f32) -> f32| {
        eyes.iter().copied().reduce(|a, b| match (a, b) {
            (Eye::Slope(a), Eye::Slope(b)) => Eye::Slope([of(a[0], b[0]), of(a[1], b[1])]),
            (Eye::At(a, distance), Eye::At(b, _)) => Eye::At([of(a[0], b[0]), of(a[1], b[1])], distance),
            (a, _) => a,
        })
    };
    [both(f32::min), both(f32::max)].into_iter().flatten().collect()
}

/// All splats that a window can show, with their order by depth.
pub(crate) struct Prepared {
    /// The splats in the order of their clouds. In large clouds, splats that are close in space are
    /// also close in memory.
    pub(crate) splats: Vec<Splat>,
    /// Indices of the splats, nearest to the viewer first.
    pub(crate) by_depth: Vec<u32>,
    /// For each placed cloud, the map from directions in pixels to directions of the cloud. It
    /// reverses y and rotates.
    pub(crate) cloud_from_pixels: Vec<Mat3>,
}

impl Prepared {
    pub(crate) fn new(scene: &Scene, window: &Window, geometry: &FieldGeometry) -> Self {
        let map = window.scene_from_display;
        let per_pixel = map.scale * geometry.pitch_mm;
        let display_from_scene = DMat3::from_quat(map.rotation.inverse());
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        let middle = middle(geometry);
        // Splats in front of the near plane are left out.
        let near = window.near_mm.map_or(f32::INFINITY, |near| (near / geometry.pitch_mm) as f32);
        let mut splats = Vec::new();
        let mut cloud_from_pixels = Vec::new();
        for (number, placed) in scene.placed_clouds.iter().enumerate() {
            let cloud = &scene.clouds[placed.cloud];
            let axes = DMat3::from_cols_array(&placed.scene_from_cloud.matrix3.to_cols_array().map(f64::from));
            let linear = flip * display_from_scene * axes * (1.0 / per_pixel);
            let moved = placed.scene_from_cloud.translation.as_dvec3() - map.translation;
            let moved = flip * display_from_scene * moved / per_pixel + DVec3::new(middle[0], middle[1], 0.0);
            // Harmonics depend only on the direction, so the map of directions has no scale.
            let unit = DMat3::from_cols(
                axes.x_axis.normalize_or_zero(),
                axes.y_axis.normalize_or_zero(),
                axes.z_axis.normalize_or_zero(),
            );
            cloud_from_pixels.push((unit.transpose() * display_from_scene.transpose() * flip).as_mat3());
            // Keep splats that are visible and finite.
            let one = |i: usize| {
                let centre = (linear * cloud.positions[i].as_dvec3() + moved).as_vec3();
                let opacity = cloud.opacities[i];
                let own = Mat3::from_quat(cloud.rotations[i]) * Mat3::from_diagonal(cloud.scales[i]);
                let axes = linear.as_mat3() * own;
                let [x, y, z]: [Vec3; 3] = [axes.row(0), axes.row(1), axes.row(2)];
                let covariance = [x.dot(x), x.dot(y), x.dot(z), y.dot(y), y.dot(z), z.dot(z)];
                let seen = opacity > 0.0 && centre.z <= near && centre.is_finite();
                (seen && covariance.iter().all(|value| value.is_finite())).then_some(Splat {
                    centre: centre.to_array(),
                    covariance,
                    opacity,
                    placed: number as u32,
                    index: i as u32,
                })
            };
            #[cfg(feature = "parallel")]
            splats.par_extend((0..cloud.len()).into_par_iter().filter_map(one));
            #[cfg(not(feature = "parallel"))]
            splats.extend((0..cloud.len()).filter_map(one));
        }
        // Splats of equal depth keep the order of the cloud, so that every run has the same order.
        let mut order: Vec<u64> =
            splats.iter().zip(0u64..).map(|(splat, i)| u64::from(!sortable(splat.centre[2])) << 32 | i).collect();
        #[cfg(feature = "parallel")]
        order.par_sort_unstable();
        #[cfg(not(feature = "parallel"))]
        order.sort_unstable();
        let by_depth = order.into_iter().map(|key| key as u32).collect();
        Self { splats, by_depth, cloud_from_pixels }
    }
}

/// Converts a float to an integer. A larger float gives a larger integer.
pub(crate) fn sortable(value: f32) -> u32 {
    let bits = value.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}
