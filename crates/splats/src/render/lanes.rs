//! The kernel that projects and shades one splat for all views of a block, a view per lane.
//!
//! Views differ only in slope or eye position, so a splat and its harmonics are read once for all
//! views. The loops over [`VIEWS`] values compile to vector instructions.

use lumistack_simd::{Kernel, Lanes};

use super::harmonics::{MOST, basis};
use super::prepare::{CUTOFF, Eye, NEAREST, PIXEL_VARIANCE, Splat, TILE};

/// Number of views of a block. With more views per block, there are fewer blocks, so lists of
/// splats per tile are made less often. With fewer views per block, less memory is needed, and
/// fewer splats are projected into views that do not show them.
pub(crate) const VIEWS: usize = 16;
/// One value for each view of a block of views.
pub(crate) type Lane = [f32; VIEWS];

/// The eyes of the views of a block. If there are fewer than [`VIEWS`], the last eye is repeated.
#[derive(Clone, Debug)]
pub(crate) struct Eyes {
    /// Slopes of parallel rays, or the eyes' columns (x) and rows (y).
    pub(crate) x: Lane,
    pub(crate) y: Lane,
    /// Distance of the eyes from the window, in pixels; `None` for parallel rays.
    pub(crate) distance: Option<f32>,
}

impl Eyes {
    /// Packs the eyes of 1 to [`VIEWS`] views. All eyes must be of one kind: slopes or positions.
    pub(crate) fn new(eyes: &[Eye]) -> Self {
        let of = |i: usize| match eyes[i.min(eyes.len() - 1)] {
            Eye::Slope(slope) => (slope, None),
            Eye::At(at, distance) => (at, Some(distance)),
        };
        Self { x: std::array::from_fn(|i| of(i).0[0]), y: std::array::from_fn(|i| of(i).0[1]), distance: of(0).1 }
    }
}

/// The projections of a splat into all views of a block.
#[derive(Clone, Debug)]
pub(crate) struct Projected {
    /// Column and row of the splat's projected centre, in each view.
    pub(crate) at: [Lane; 2],
    /// Coefficients [a, b, c] of u/16 = a dx² + b dx dy + c dy², for a pixel at the offset (dx, dy)
    /// from `at`. A splat of opacity o has the opacity o e^(−u) at this pixel.
    pub(crate) conic: [Lane; 3],
    /// Half of the splat's extent along each axis, in pixels, in each view.
    pub(crate) reach: [Lane; 2],
    pub(crate) opacity: Lane,
    pub(crate) colour: [Lane; 3],
    /// Key of the view's blending order; it increases with the distance from the viewer.
    pub(crate) distance: Lane,
    /// One bit for each view in which the splat is visible in the tile.
    pub(crate) seen: u32,
}

impl Projected {
    pub(crate) const NONE: Self = Self {
        at: [[0.0; VIEWS]; 2],
        conic: [[0.0; VIEWS]; 3],
        reach: [[0.0; VIEWS]; 2],
        opacity: [0.0; VIEWS],
        colour: [[0.0; VIEWS]; 3],
        distance: [0.0; VIEWS],
        seen: 0,
    };
}

/// A splat, the eyes of the views, and the memory for the result.
pub(crate) struct Args<'a> {
    pub(crate) splat: &'a Splat,
    pub(crate) eyes: &'a Eyes,
    /// Column and row of the first pixel of the tile.
    pub(crate) origin: [f32; 2],
    /// Coefficients of the splat's harmonics, `[coefficient][rgb]`; empty if no colours are
    /// computed.
    pub(crate) harmonics: &'a [f32],
    /// The basis functions Y_lm of each view's direction. They are used only for parallel rays.
    pub(crate) bases: &'a [Lane; MOST],
    /// Columns of the map from directions in pixels to directions of the cloud.
    pub(crate) cloud_from_pixels: &'a [[f32; 3]; 3],
    pub(crate) to: &'a mut Projected,
}

/// Projects a splat into all views of a block and computes its colour in each.
pub(crate) struct Project;

impl Kernel for Project {
    type Args<'a> = Args<'a>;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(args: Self::Args<'_>) {
        let Args { splat, eyes, origin, harmonics, bases, cloud_from_pixels, to } = args;
        let [x, y, z] = splat.centre;
        let [xx, xy, xz, yy, yz, zz] = splat.covariance;
        // Compute per view the slope of the ray through the splat's centre, and the magnification m
        // at the centre's depth. The head of `prepare.rs` has both equations.
        let (mut slope_x, mut slope_y, mut m) = (eyes.x, eyes.y, 1.0);
        match eyes.distance {
            None => {
                for v in 0..VIEWS {
                    to.distance[v] = -(slope_x[v] * x + slope_y[v] * y + z);
                }
            }
            Some(distance) => {
                let before = distance - z;
                if before <= NEAREST * distance {
                    to.seen = 0;
                    return;
                }
                m = distance / before;
                let share = 1.0 / before;
                for v in 0..VIEWS {
                    let (dx, dy) = (eyes.x[v] - x, eyes.y[v] - y);
                    to.distance[v] = dx * dx + dy * dy + before * before;
                    (slope_x[v], slope_y[v]) = (dx * share, dy * share);
                }
            }
        }
        // Compute per view the projected covariance, to which the variance of the pixel's filter is
        // added. Also compute the inverse of this sum, and the splat's extent in pixels.
        let square = m * m;
        let last = TILE as f32 - 1.0;
        let mut seen = [0.0f32; VIEWS];
        for v in 0..VIEWS {
            let (sx, sy) = (slope_x[v], slope_y[v]);
            let wide = square * (xx - 2.0 * sx * xz + sx * sx * zz);
            let both = square * (xy - sx * yz - sy * xz + sx * sy * zz);
            let high = square * (yy - 2.0 * sy * yz + sy * sy * zz);
            let sharp = (wide * high - both * both).max(0.0);
            let (wide, high) = (wide.max(0.0) + PIXEL_VARIANCE, high.max(0.0) + PIXEL_VARIANCE);
            let determinant = wide * high - both * both;
            let share = 1.0 / determinant;
            let scale = 0.5 / 16.0 * share;
            to.conic[0][v] = scale * high;
            to.conic[1][v] = -2.0 * scale * both;
            to.conic[2][v] = scale * wide;
            // the pixel's filter widens a splat, and lowers its peak so that its integral stays the
            // same
            let opacity = splat.opacity * (sharp * share).sqrt();
            to.opacity[v] = opacity;
            let (reach_x, reach_y) = (CUTOFF * wide.sqrt(), CUTOFF * high.sqrt());
            (to.reach[0][v], to.reach[1][v]) = (reach_x, reach_y);
            let (col, row) = (x - z * sx, y - z * sy);
            (to.at[0][v], to.at[1][v]) = (col, row);
            let (left, top) = (col - origin[0], row - origin[1]);
            let inside = (left + reach_x >= 0.0)
                & (left - reach_x <= last)
                & (top + reach_y >= 0.0)
                & (top - reach_y <= last)
                & (opacity > 0.0)
                & (determinant > 0.0);
            seen[v] = f32::from(u8::from(inside));
        }
        to.seen = seen.iter().enumerate().fold(0, |bits, (v, seen)| bits | u32::from(*seen > 0.0) << v);
        if to.seen == 0 || harmonics.is_empty() {
            return;
        }
        // From an eye, every splat has another direction; parallel rays have one direction per
        // view.
        let mut own = [[0.0; VIEWS]; MOST];
        let bases = match eyes.distance {
            None => bases,
            Some(distance) => {
                directions(eyes, [x, y, z - distance], cloud_from_pixels, harmonics.len(), &mut own);
                &own
            }
        };
        // The colour is the sum of harmonics plus one half, but not negative.
        let coefficients = harmonics.as_chunks::<3>().0;
        let mut v = 0;
        while v < VIEWS {
            // SAFETY: the caller's machine has the instruction set of V. Every lane has VIEWS
            // values, COUNT of them from `v` on are read and written, and COUNT divides VIEWS.
            unsafe {
                let half = V::splat(0.5);
                let (mut red, mut green, mut blue) = (half, half, half);
                for (rgb, basis) in coefficients.iter().zip(bases) {
                    let basis = V::load(basis.as_ptr().add(v));
                    red = basis.mul_add(V::splat(rgb[0]), red);
                    green = basis.mul_add(V::splat(rgb[1]), green);
                    blue = basis.mul_add(V::splat(rgb[2]), blue);
                }
                for (to, sum) in to.colour.iter_mut().zip([red, green, blue]) {
                    sum.max(V::splat(0.0)).store(to.as_mut_ptr().add(v));
                }
            }
            v += V::COUNT;
        }
    }
}

/// Computes the basis functions Y_lm of the directions from the eyes to a point, and writes them to
/// `to`. `z` is the point's depth minus the eyes' depth. `values` is the length of the splat's list
/// of harmonics; up to 3 values, only Y_00 is written.
#[inline(always)]
fn directions(eyes: &Eyes, [x, y, z]: [f32; 3], map: &[[f32; 3]; 3], values: usize, to: &mut [Lane; MOST]) {
    let mut of_axis = [[0.0; VIEWS]; 3];
    for v in 0..VIEWS {
        let (dx, dy) = (x - eyes.x[v], y - eyes.y[v]);
        let turned = [0, 1, 2].map(|axis: usize| map[0][axis] * dx + map[1][axis] * dy + map[2][axis] * z);
        let length = (turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2]).sqrt();
        let share = 1.0 / length.max(f32::MIN_POSITIVE);
        (0..3).for_each(|axis| of_axis[axis][v] = share * turned[axis]);
    }
    if values <= 3 {
        to[0] = [basis([0.0; 3])[0]; VIEWS];
        return;
    }
    for v in 0..VIEWS {
        let of_view = basis([of_axis[0][v], of_axis[1][v], of_axis[2][v]]);
        (0..MOST).for_each(|k| to[k][v] = of_view[k]);
    }
}
