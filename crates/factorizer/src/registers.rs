//! Sums of one block with accumulators in registers, for fixed numbers of frames M and other
//! factors K.

use lumistack_simd::{Kernel, Lanes};

use crate::buffers::{AHEAD, BetweenTiles, BlockOfLine, Buffers, ByBuffers, GROUP, Group, SumParams, Tiles, wanted};
use crate::rays::{LineRays, RowsOfView};
use crate::vector::{load, store};

/// Adds up two sums per frame m over the rays through each pixel: n_m = Σ w βL a_m and
/// d_m = Σ w L̃ a_m. If `DIAGONAL` is true, it adds up r_m = Σ w e a_m and G_mm = Σ w a_m² instead.
/// The head of `step.rs` defines the symbols.
///
/// `MASKED` is true if some rays of a view are invalid or weighted.
pub(crate) struct Pairs<const M: usize, const K: usize, const MASKED: bool, const DIAGONAL: bool>;

/// Adds up r_m = Σ w e a_m and G_mk = Σ w a_m a_k over the rays through each pixel, for all frames
/// m and k. The head of `step.rs` defines the symbols.
///
/// The tiles of G along the diagonal are summed together. The rest of G is summed from buffered
/// a_m. `MASKED` has the same meaning as in [`Pairs`].
pub(crate) struct Gram<const M: usize, const K: usize, const MASKED: bool>;

/// Returns the number of registers that [`Pairs`] needs: three for each frame (two sums and the
/// derivative a_m), and a few more.
const fn registers_for_pairs(frames: usize) -> usize {
    3 * frames + 4
}

/// Returns the number of registers that [`Gram`] needs: the residual sum and the derivative a_m of
/// each frame, the upper triangles of the tiles, and a few more.
const fn registers_for_gram(frames: usize) -> usize {
    let (tile, tiles) = (tile_of(frames), frames.div_ceil(tile_of(frames)));
    2 * frames + tiles * tile * (tile + 1) / 2 + 5
}

/// Returns the number of frames per tile of the Gram matrix. In registers, only the tiles along the
/// diagonal are summed. Up to 4 frames, one tile is the whole matrix.
const fn tile_of(frames: usize) -> usize {
    if frames <= 4 { frames } else { 3 }
}

impl<const M: usize, const K: usize, const MASKED: bool, const DIAGONAL: bool> Kernel
    for Pairs<M, K, MASKED, DIAGONAL>
{
    type Args<'a> = BlockOfLine<'a>;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(mut at: BlockOfLine<'_>) {
        // SAFETY: guaranteed by the caller
        unsafe {
            // With too few registers the sums would spill to memory, so buffers are faster.
            if registers_for_pairs(M) > V::REGISTERS {
                return V::call::<ByBuffers>(at);
            }
            at.begin::<V>(M, true);
            let BlockOfLine { rays, x, params, buffers, .. } = at;
            // one pass over the views, with all sums in registers
            let shared = SharedInputs::<K>::new(rays, x, params, &buffers.scaled);
            let mut squares = V::splat(0.0);
            let (mut above, mut below) = ([V::splat(0.0); M], [V::splat(0.0); M]);
            for rows in rays.by_view::<K>(0..rays.views.len()) {
                let Some(ViewTerms { products, wanted, emitted }) = shared.terms_of::<V, M, MASKED>(&rows) else {
                    continue;
                };
                let error = wanted.sub(emitted);
                squares = error.mul_add(error, squares);
                for m in 0..M {
                    above[m] = products[m].mul_add(if DIAGONAL { error } else { wanted }, above[m]);
                    below[m] = products[m].mul_add(if DIAGONAL { products[m] } else { emitted }, below[m]);
                }
            }
            // store the two sums of every frame in the block
            for m in 0..M {
                store(above[m], &mut buffers.block.residual, m * V::COUNT);
                store(below[m], &mut buffers.block.emitted, m * V::COUNT);
            }
            store(squares, &mut buffers.squares, 0);
        }
    }
}

impl<const M: usize, const K: usize, const MASKED: bool> Kernel for Gram<M, K, MASKED> {
    type Args<'a> = BlockOfLine<'a>;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(mut at: BlockOfLine<'_>) {
        // SAFETY: guaranteed by the caller
        unsafe {
            // With too few registers the sums would spill to memory, so buffers are faster.
            if registers_for_gram(M) > V::REGISTERS {
                return V::call::<ByBuffers>(at);
            }
            at.begin::<V>(M, true);
            let BlockOfLine { rays, x, params, buffers, .. } = at;
            let Buffers { block, products: buffered, errors, emitted, scaled, squares: all } = buffers;
            let tile = tile_of(M);
            let shared = SharedInputs::<K>::new(rays, x, params, scaled);
            let views = rays.views.len();
            let mut first = 0;
            // Views are summed in groups whose derivatives a_m fit the buffer. Between groups the
            // sums are in memory, since the function called at the end of this loop may overwrite
            // all registers.
            loop {
                let add = first > 0;
                let mut squares = if add { load::<V>(all, 0) } else { V::splat(0.0) };
                let (mut residual, mut gram) = ([V::splat(0.0); M], [[V::splat(0.0); M]; M]);
                if add {
                    for m in 0..M {
                        residual[m] = load::<V>(&block.residual, m * V::COUNT);
                        for k in m..M {
                            if m / tile == k / tile {
                                gram[m][k] = load::<V>(&block.gram, (m * M + k) * V::COUNT);
                            }
                        }
                    }
                }
                // sum the tiles along the diagonal in registers, and buffer the derivatives a_m for
                // the other entries
                let mut active = 0;
                for rows in rays.by_view::<K>(first..views.min(first + GROUP)) {
                    let Some(ViewTerms { products, wanted, emitted }) = shared.terms_of::<V, M, MASKED>(&rows) else {
                        continue;
                    };
                    let error = wanted.sub(emitted);
                    squares = error.mul_add(error, squares);
                    for m in 0..M {
                        residual[m] = products[m].mul_add(error, residual[m]);
                        for k in m..M {
                            if m / tile == k / tile {
                                gram[m][k] = products[m].mul_add(products[k], gram[m][k]);
                            }
                        }
                        if tile < M {
                            store(products[m], buffered, (active * M + m) * V::COUNT);
                        }
                    }
                    active += 1;
                }
                // store the sums so far in the block
                for m in 0..M {
                    store(residual[m], &mut block.residual, m * V::COUNT);
                    for k in m..M {
                        if m / tile == k / tile {
                            store(gram[m][k], &mut block.gram, (m * M + k) * V::COUNT);
                        }
                    }
                }
                store(squares, all, 0);
                // sum the other entries of the Gram matrix from the buffered derivatives a_m
                if tile < M {
                    let group = Group { frames: M, views: active, add };
                    let tiles = Tiles { group, shares: &[], products: buffered, errors, emitted };
                    V::call::<BetweenTiles<false>>((tiles, block));
                }
                first += GROUP;
                if first >= views {
                    break;
                }
            }
        }
    }
}

/// Terms of one view in a block, each times √w: a_m = ∂L̃/∂(f_m/M) for each frame m, βL, and the
/// emission L̃.
struct ViewTerms<V, const M: usize> {
    products: [V; M],
    wanted: V,
    emitted: V,
}

/// The inputs that all views of a block share.
struct SharedInputs<'a, const K: usize> {
    x: usize,
    params: SumParams,
    /// Values f of the block's pixels, divided by the number M of frames.
    scaled: &'a [f32],
    strides: [usize; K],
}

impl<'a, const K: usize> SharedInputs<'a, K> {
    #[inline(always)]
    fn new(rays: &LineRays, x: usize, params: SumParams, scaled: &'a [f32]) -> Self {
        Self { x, params, scaled, strides: std::array::from_fn(|k| rays.strides[k]) }
    }

    /// Computes the [`ViewTerms`] of one view in the block. `None` if no ray of the view in the
    /// block is valid.
    #[inline(always)]
    unsafe fn terms_of<V: Lanes, const M: usize, const MASKED: bool>(
        &self,
        rows: &RowsOfView<K>,
    ) -> Option<ViewTerms<V, M>> {
        // SAFETY: guaranteed by the caller
        unsafe {
            // load the rows of a later block into the cache during this block's arithmetic
            rows.prefetch(self.x + AHEAD * V::COUNT);
            let weight = if MASKED { rows.view.weight::<V>(self.x)? } else { V::splat(1.0) };
            let mut wanted = wanted::<V>(rows.target, self.x, self.params);
            if MASKED {
                wanted = wanted.mul(weight);
            }
            // a_m is the product of the other factors' values in frame m, and L̃ = Σ_m a_m f_m/M
            let others: [_; K] = std::array::from_fn(|k| rows.others[k].at::<V>(self.x));
            let (mut products, mut emitted) = ([V::splat(0.0); M], V::splat(0.0));
            for m in 0..M {
                let value = |k: usize| V::load(others[k].wrapping_add(m * self.strides[k]));
                products[m] = value(0);
                for k in 1..K {
                    products[m] = products[m].mul(value(k));
                }
                if MASKED {
                    products[m] = products[m].mul(weight);
                }
                emitted = products[m].mul_add(load::<V>(self.scaled, m * V::COUNT), emitted);
            }
            Some(ViewTerms { products, wanted, emitted })
        }
    }
}
