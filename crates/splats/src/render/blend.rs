//! The kernel that blends splats from front to back into a block of 4 × 4 pixels.
//!
//! ```text
//! α_i = o_i exp(−u_i),   C += T α_i c_i,   T ← T (1 − α_i),   z = z_i where T falls below ½
//! ```
//!
//! Here o, c and z are a splat's opacity, colour and depth. T is the transmittance of all nearer
//! splats, and u is half the squared Mahalanobis distance of the pixel from the splat's centre. A
//! block's sums stay in registers for all splats. e^(−u) is computed as (e^(−v))^16 with v = u/16.
//! For e^(−v) the kernel uses the Taylor polynomial of degree 4. Within a splat's extent (v ≤ 0.28)
//! its error is below 2·10⁻⁵, and the error of e^(−u) is below 4·10⁻⁶.

use lumistack_simd::{Kernel, Lanes};

use super::prepare::CUTOFF;

/// Width and height of a block of pixels, in pixels.
pub(crate) const EDGE: usize = 4;
/// Number of pixels of a block. It is a multiple of the lanes of every vector type.
pub(crate) const PIXELS: usize = EDGE * EDGE;
/// A pixel with less transmittance than this is finished.
pub(crate) const DARK: f32 = 1e-4;
/// Largest v within a splat's extent. The splat's opacity falls off as e^(−16 v).
const LIMIT: f32 = 0.5 * CUTOFF * CUTOFF / 16.0;

/// The projection of a splat into one view.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Flat {
    pub(crate) at: [f32; 2],
    /// Coefficients [a, b, c] of u/16 = a dx² + b dx dy + c dy², for a pixel at the offset (dx, dy)
    /// from `at`. A splat of opacity o has the opacity o e^(−u) at this pixel.
    pub(crate) conic: [f32; 3],
    pub(crate) opacity: f32,
    pub(crate) colour: [f32; 3],
    pub(crate) z: f32,
}

/// Sums over the splats that were blended so far, for each pixel of a block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sums {
    pub(crate) rgb: [[f32; PIXELS]; 3],
    pub(crate) transmittance: [f32; PIXELS],
    /// Depth of the splat at which the transmittance falls below one half; NaN until this happens.
    pub(crate) z: [f32; PIXELS],
}

impl Sums {
    pub(crate) const EMPTY: Self =
        Self { rgb: [[0.0; PIXELS]; 3], transmittance: [1.0; PIXELS], z: [f32::NAN; PIXELS] };
}

/// A block of pixels and the splats that cover it.
pub(crate) struct Args<'a> {
    pub(crate) splats: &'a [Flat],
    /// Indices into `splats` of the splats that are blended, nearest first.
    pub(crate) chosen: &'a [u16],
    /// Column and row of the block's first pixel in the light field.
    pub(crate) first: [f32; 2],
    /// For each pixel, the depth of the surface that hides splats behind it; −∞ without a surface.
    pub(crate) cuts: &'a [f32; PIXELS],
    pub(crate) sums: &'a mut Sums,
}

/// Columns and rows of the pixels of a block, relative to its first pixel.
const OFFSETS: [[f32; PIXELS]; 2] = {
    let mut offsets = [[0.0; PIXELS]; 2];
    let mut i = 0;
    while i < PIXELS {
        offsets[0][i] = (i % EDGE) as f32;
        offsets[1][i] = (i / EDGE) as f32;
        i += 1;
    }
    offsets
};

/// Adds the chosen splats to the sums of a block. Returns true if any pixel is still unfinished.
pub(crate) struct Blend;

impl Kernel for Blend {
    type Args<'a> = Args<'a>;
    type Output = bool;

    #[inline(always)]
    unsafe fn run<V: Lanes>(args: Self::Args<'_>) -> bool {
        let Args { splats, chosen, first, cuts, sums } = args;
        let mut open = false;
        // SAFETY: the caller's machine has the instruction set of V, and `chosen` holds indices of
        // `splats`. Every array has PIXELS values, COUNT of them from `i` on are read and written,
        // and COUNT divides PIXELS.
        unsafe {
            let (zero, one) = (V::splat(0.0), V::splat(1.0));
            let (limit, dark, half) = (V::splat(LIMIT), V::splat(DARK), V::splat(0.5));
            let mut i = 0;
            while i < PIXELS {
                let x = V::load(OFFSETS[0].as_ptr().add(i)).add(V::splat(first[0]));
                let y = V::load(OFFSETS[1].as_ptr().add(i)).add(V::splat(first[1]));
                let cut = V::load(cuts.as_ptr().add(i));
                let [mut red, mut green, mut blue] = [0, 1, 2].map(|c: usize| V::load(sums.rgb[c].as_ptr().add(i)));
                let mut through = V::load(sums.transmittance.as_ptr().add(i));
                let mut depth = V::load(sums.z.as_ptr().add(i));
                for &number in chosen {
                    let splat = splats.get_unchecked(number as usize);
                    let dx = x.sub(V::splat(splat.at[0]));
                    let dy = y.sub(V::splat(splat.at[1]));
                    let [a, b, c] = splat.conic.map(|value| V::splat(value));
                    let v = dx.mul(a).mul_add(dx, b.mul(dx).mul_add(dy, c.mul(dy).mul(dy)));
                    let z = V::splat(splat.z);
                    // A splat contributes to a pixel if the pixel is unfinished and within the
                    // splat's extent. The splat must also be in front of the pixel's surface.
                    let lit = V::both(V::both(v.at_most(limit), dark.at_most(through)), cut.at_most(z));
                    if V::bits(lit) == 0 {
                        continue;
                    }
                    // Evaluate the polynomial of e^(−v), then square it four times.
                    let series = v.mul_add(V::splat(1.0 / 24.0), V::splat(-1.0 / 6.0));
                    let series = series.mul_add(v, half);
                    let series = series.mul_add(v, V::splat(-1.0));
                    let root = series.mul_add(v, one);
                    let root = root.mul(root);
                    let root = root.mul(root);
                    let root = root.mul(root);
                    let alpha = root.mul(root).mul(V::splat(splat.opacity)).where_else(lit, zero);
                    let weight = alpha.mul(through);
                    red = weight.mul_add(V::splat(splat.colour[0]), red);
                    green = weight.mul_add(V::splat(splat.colour[1]), green);
                    blue = weight.mul_add(V::splat(splat.colour[2]), blue);
                    // The depth of a pixel is the depth of the splat at which the pixel's
                    // transmittance falls below one half.
                    let left = through.sub(weight);
                    depth = z.where_else(V::both(half.at_most(through), left.below(half)), depth);
                    through = left;
                }
                for (c, value) in [red, green, blue].into_iter().enumerate() {
                    value.store(sums.rgb[c].as_mut_ptr().add(i));
                }
                through.store(sums.transmittance.as_mut_ptr().add(i));
                depth.store(sums.z.as_mut_ptr().add(i));
                open |= V::bits(dark.at_most(through)) != 0;
                i += V::COUNT;
            }
        }
        open
    }
}
