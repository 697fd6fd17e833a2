//! Sums of one block of pixels, for any number of frames and factors. The terms of each view go
//! through buffers. [`step`](crate::step) defines the terms a_m and e and the sums n, d, r and G.
//!
//! [`registers`](crate::registers) has faster functions for common cases and uses the types of this
//! file.

use lumistack_simd::{Kernel, Lanes, MAX_LANES, prefetch_far};

use crate::aligned::Aligned;
use crate::rays::{LineRays, Place, TargetRow};
use crate::step::{Block, Sums};
use crate::vector::{Vector, load, store};

/// Number of vectors by which the factors' rows are prefetched ahead. With one vector an update is
/// 10 % slower, with four it is no faster.
pub(crate) const AHEAD: usize = 2;
/// Number of values by which the target's rows are prefetched ahead, into the second-level cache.
/// The first-level cache is avoided, since it is full of the factors' rows, and an update reads
/// each value of the target only once.
const TARGET_AHEAD: usize = 64;

/// Number of views that are buffered before their terms are added to the sums. The buffers of
/// 13 × 13 views would take twice the first-level cache.
pub(crate) const GROUP: usize = 32;

/// Buffers of one block of pixels. The derivatives a_m, the errors e, βL and L̃ (see `step.rs`)
/// include a factor √w, so that their products include w.
pub(crate) struct Buffers {
    pub(crate) block: Block,
    /// The derivatives a_m = ∂L̃/∂(f_m/M) for a group of views, `[view][frame][lane]`.
    pub(crate) products: Aligned,
    /// The errors e = βL − L̃ of a group of views, or βL for the paper's rule: `[view][lane]`.
    pub(crate) errors: Aligned,
    /// L̃ of a group of views, `[view][lane]`.
    pub(crate) emitted: Aligned,
    /// Values f of the block's pixels, divided by the number M of frames.
    pub(crate) scaled: Aligned,
    /// Σ w (βL − L̃)² over the block's rays, per lane.
    pub(crate) squares: Vector,
}

impl Buffers {
    /// Allocates the buffers for `frames` frames.
    pub(crate) fn new(frames: usize) -> Self {
        let vectors = |count: usize| Aligned::filled(0.0, count * MAX_LANES);
        Self {
            block: Block::new(frames),
            products: vectors(GROUP * frames),
            errors: vectors(GROUP),
            emitted: vectors(GROUP),
            scaled: vectors(frames),
            squares: Vector::default(),
        }
    }
}

/// The brightness β, and the sums that an update needs.
#[derive(Clone, Copy)]
pub(crate) struct SumParams {
    pub(crate) brightness: f32,
    /// The sums that the rule needs.
    pub(crate) sums: Sums,
}

/// One block of a line: the pixels x to x + lanes. Its sums and values go to `buffers`.
///
/// If a block contains valid rays of a view, x to x + lanes must lie within that view's rows of
/// target and weights, padding included.
pub(crate) struct BlockOfLine<'a> {
    pub(crate) rays: &'a LineRays<'a>,
    pub(crate) x: usize,
    pub(crate) params: SumParams,
    /// The line's own rows, one per frame, `stride` apart.
    pub(crate) values: &'a [f32],
    pub(crate) stride: usize,
    pub(crate) buffers: &'a mut Buffers,
}

impl BlockOfLine<'_> {
    /// Copies the values f of the block's pixels, and f divided by the number of frames, into the
    /// buffers. Also prefetches rows.
    ///
    /// If `in_registers` is true, the caller prefetches some rows view by view, and this function
    /// leaves these rows out.
    ///
    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    pub(crate) unsafe fn begin<V: Lanes>(&mut self, frames: usize, in_registers: bool) {
        // SAFETY: guaranteed by the caller
        unsafe {
            for m in 0..frames {
                let f = load::<V>(self.values, m * self.stride + self.x);
                store(f, &mut self.buffers.block.values, m * V::COUNT);
                store(f.mul(V::splat(1.0 / frames as f32)), &mut self.buffers.scaled, m * V::COUNT);
            }
        }
        self.rays.prefetch_rest(self.x + AHEAD * V::COUNT, in_registers);
    }
}

/// Computes the sums of a block over all views, by way of the buffers.
pub(crate) struct ByBuffers;

impl Kernel for ByBuffers {
    type Args<'a> = BlockOfLine<'a>;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(mut at: BlockOfLine<'_>) {
        let frames = at.buffers.block.frames;
        // SAFETY: guaranteed by the caller
        unsafe {
            at.begin::<V>(frames, false);
            let BlockOfLine { rays, x, params, buffers, .. } = at;
            let (mut squares, mut active, mut add) = (V::splat(0.0), 0, false);
            // buffer one view after another; a full group is summed before the next begins
            for (index, view) in rays.views.iter().enumerate() {
                if let Some(weight) = view.weight::<V>(x) {
                    if active == GROUP {
                        sum_views::<V, false>(params.sums, buffers, &[], Group { frames, views: active, add });
                        (active, add) = (0, true);
                    }
                    let error = buffered::<V, false>(rays, index, x, weight, params, (active, &mut *buffers));
                    squares = error.mul_add(error, squares);
                    active += 1;
                }
            }
            store(squares, &mut buffers.squares, 0);
            sum_views::<V, false>(params.sums, buffers, &[], Group { frames, views: active, add });
        }
    }
}

/// Writes the derivatives a_m, the error e and the emission L̃ of one view (see `step.rs`) to
/// position `to` of the buffers, times √w. For the paper's rule it writes βL instead of e. Returns
/// e √w.
///
/// If `OWN` is true, each view reads different values of the factor under update, as under bilinear
/// sampling.
///
/// # Safety
/// The machine has `V`'s instruction set, and x lies within the rows of the view.
#[inline(always)]
pub(crate) unsafe fn buffered<V: Lanes, const OWN: bool>(
    rays: &LineRays,
    view: usize,
    x: usize,
    weight: V,
    params: SumParams,
    (to, buffers): (usize, &mut Buffers),
) -> V {
    let (frames, others) = (buffers.block.frames, rays.others_of(view));
    // SAFETY: guaranteed by the caller
    unsafe {
        // If each view reads different values of the factor under update, they are read along the
        // rays. Otherwise they come from the block.
        let products = &mut buffers.products[to * frames * V::COUNT..(to + 1) * frames * V::COUNT];
        let scaled = if OWN {
            Scaled::<V, OWN> {
                first: rays.own[view].at::<V>(x),
                stride: rays.own_stride,
                mean: V::splat(1.0 / frames as f32),
            }
        } else {
            Scaled { first: buffers.scaled.as_ptr(), stride: V::COUNT, mean: V::splat(1.0) }
        };
        // compute a_m and L̃, in separate loops for one, two and three other factors
        let emitted = match others {
            [a] => products_of::<V, OWN, 1>(rays, [a], x, frames, weight, products, scaled),
            [a, b] => products_of::<V, OWN, 2>(rays, [a, b], x, frames, weight, products, scaled),
            [a, b, c] => products_of::<V, OWN, 3>(rays, [a, b, c], x, frames, weight, products, scaled),
            _ => {
                let mut emitted = V::splat(0.0);
                for m in 0..frames {
                    let mut product = weight;
                    for (other, stride) in others.iter().zip(&rays.strides) {
                        product = product.mul(V::load(other.at::<V>(x).wrapping_add(m * stride)));
                    }
                    store(product, products, m * V::COUNT);
                    emitted = product.mul_add(scaled.of(m), emitted);
                }
                emitted
            }
        };
        // store the error e, or βL for the paper's rule
        let wanted = wanted::<V>(&rays.targets[view], x, params).mul(weight);
        let error = wanted.sub(emitted);
        store(if params.sums == Sums::Ratio { wanted } else { error }, &mut buffers.errors, to * V::COUNT);
        store(emitted, &mut buffers.emitted, to * V::COUNT);
        error
    }
}

/// Values of the factor under update in every frame, divided by the number of frames. If each view
/// reads different values (`OWN`), they are read along the rays; otherwise they come from the
/// block.
#[derive(Clone, Copy)]
struct Scaled<V, const OWN: bool> {
    first: *const f32,
    stride: usize,
    mean: V,
}

impl<V: Lanes, const OWN: bool> Scaled<V, OWN> {
    #[inline(always)]
    unsafe fn of(&self, frame: usize) -> V {
        // SAFETY: guaranteed by the caller
        unsafe {
            let value = V::load(self.first.wrapping_add(frame * self.stride));
            if OWN { value.mul(self.mean) } else { value }
        }
    }
}

/// Writes a_m = ∂L̃/∂(f_m/M) for every frame m: the product of `weight` and the values of K other
/// factors. Returns Σ_m a_m f_m/M over the M frames.
#[inline(always)]
unsafe fn products_of<V: Lanes, const OWN: bool, const K: usize>(
    rays: &LineRays,
    others: [&Place<f32>; K],
    x: usize,
    frames: usize,
    weight: V,
    products: &mut [f32],
    scaled: Scaled<V, OWN>,
) -> V {
    let others: [_; K] = std::array::from_fn(|k| (others[k].at::<V>(x), rays.strides[k]));
    // SAFETY: guaranteed by the caller
    unsafe {
        let mut emitted = V::splat(0.0);
        for m in 0..frames {
            let value = |k: usize| V::load(others[k].0.wrapping_add(m * others[k].1));
            let mut product = value(0);
            for k in 1..K {
                product = product.mul(value(k));
            }
            let product = product.mul(weight);
            store(product, products, m * V::COUNT);
            emitted = product.mul_add(scaled.of(m), emitted);
        }
        emitted
    }
}

/// Returns βL of one view in the block.
///
/// # Safety
/// The machine has `V`'s instruction set, and x lies within the row.
#[inline(always)]
pub(crate) unsafe fn wanted<V: Lanes>(row: &TargetRow, x: usize, params: SumParams) -> V {
    // SAFETY: guaranteed by the caller
    unsafe {
        let radiance = match row {
            TargetRow::Half(row) => {
                let at = row.at::<V>(x);
                prefetch_far(at.wrapping_add(TARGET_AHEAD));
                V::load_half(at)
            }
            TargetRow::Float(row) => {
                let at = row.at::<V>(x);
                prefetch_far(at.wrapping_add(TARGET_AHEAD));
                V::load(at)
            }
        };
        radiance.mul(V::splat(params.brightness))
    }
}

/// The numbers of buffered views and of frames.
#[derive(Clone, Copy)]
pub(crate) struct Group {
    pub(crate) frames: usize,
    pub(crate) views: usize,
    /// True to add to the sums in the block instead of replacing them.
    pub(crate) add: bool,
}

/// Adds the terms of a group of views to the sums. If `SHARED` is true, the terms of each view are
/// multiplied by the view's share. The share is the interpolation weight of the line under update
/// in the values that the view's rays read.
///
/// # Safety
/// The machine has `V`'s instruction set, and the buffers hold as many views as the group.
#[inline(always)]
pub(crate) unsafe fn sum_views<V: Lanes, const SHARED: bool>(
    sums: Sums,
    buffers: &mut Buffers,
    shares: &[f32],
    group: Group,
) {
    let Buffers { block, products, errors, emitted, .. } = buffers;
    let (frames, tiles) = (group.frames, Tiles::<SHARED> { group, shares, products, errors, emitted });
    // SAFETY: guaranteed by the caller
    unsafe {
        // Without the whole Gram matrix, a pixel has two sums per frame. Each pass over the views
        // computes them for as many frames as registers hold.
        if sums != Sums::Gram {
            let mut m = 0;
            while m < frames {
                let diagonal = sums == Sums::Diagonal;
                match frames - m {
                    1 => tiles.pair::<V, 1>(m, diagonal, block),
                    2 => tiles.pair::<V, 2>(m, diagonal, block),
                    3..=5 => tiles.pair::<V, 3>(m, diagonal, block),
                    _ => tiles.pair::<V, 6>(m, diagonal, block),
                }
                m += match frames - m {
                    rest @ 1..=2 => rest,
                    3..=5 => 3,
                    _ => 6,
                };
            }
            return;
        }
        // Sum the Gram matrix: first its tiles of 3×3 frames along the diagonal, together with the
        // residual sums, then its other entries.
        for m in (0..frames).step_by(3) {
            match frames - m {
                1 => tiles.diagonal::<V, 1>(m, block),
                2 => tiles.diagonal::<V, 2>(m, block),
                _ => tiles.diagonal::<V, 3>(m, block),
            }
        }
        V::call::<BetweenTiles<SHARED>>((tiles, block));
    }
}

/// The buffers of a block's views, to be summed.
pub(crate) struct Tiles<'a, const SHARED: bool> {
    pub(crate) group: Group,
    /// For each view, its share, see [`sum_views`]; empty if `SHARED` is false.
    pub(crate) shares: &'a [f32],
    pub(crate) products: &'a [f32],
    pub(crate) errors: &'a [f32],
    pub(crate) emitted: &'a [f32],
}

impl<const SHARED: bool> Tiles<'_, SHARED> {
    /// Returns `value` times the view's share, see [`sum_views`].
    #[inline(always)]
    unsafe fn shared<V: Lanes>(&self, view: usize, value: V) -> V {
        // SAFETY: guaranteed by the caller
        unsafe { if SHARED { value.mul(V::splat(self.shares[view])) } else { value } }
    }

    #[inline(always)]
    unsafe fn product<V: Lanes>(&self, view: usize, frame: usize) -> V {
        // SAFETY: guaranteed by the caller
        unsafe { load::<V>(self.products, (view * self.group.frames + frame) * V::COUNT) }
    }

    /// Returns the sum of a quantity over all groups before this group; 0 for the first group.
    #[inline(always)]
    unsafe fn sum_so_far<V: Lanes>(&self, sums: &[f32], quantity: usize) -> V {
        // SAFETY: guaranteed by the caller
        unsafe { if self.group.add { load::<V>(sums, quantity * V::COUNT) } else { V::splat(0.0) } }
    }

    #[inline(always)]
    unsafe fn put<V: Lanes>(&self, sum: V, sums: &mut [f32], quantity: usize) {
        // SAFETY: guaranteed by the caller
        unsafe { store(sum, sums, quantity * V::COUNT) }
    }

    /// Adds up two sums for each of the frames m..m + R: n and d, or r and the diagonal of G if
    /// `diagonal` is true. `step.rs` defines these sums.
    #[inline(always)]
    unsafe fn pair<V: Lanes, const R: usize>(&self, m: usize, diagonal: bool, block: &mut Block) {
        // SAFETY: guaranteed by the caller
        unsafe {
            let mut residual: [V; R] = std::array::from_fn(|i| self.sum_so_far(&block.residual, m + i));
            let mut below: [V; R] = std::array::from_fn(|i| self.sum_so_far(&block.emitted, m + i));
            for view in 0..self.group.views {
                let error = load::<V>(self.errors, view * V::COUNT);
                let emitted = load::<V>(self.emitted, view * V::COUNT);
                for i in 0..R {
                    let a = self.product::<V>(view, m + i);
                    let shared = self.shared(view, a);
                    residual[i] = shared.mul_add(error, residual[i]);
                    below[i] = shared.mul_add(if diagonal { a } else { emitted }, below[i]);
                }
            }
            for i in 0..R {
                self.put(residual[i], &mut block.residual, m + i);
                self.put(below[i], &mut block.emitted, m + i);
            }
        }
    }

    /// Adds up r of the frames m..m + R, and the upper triangle of G between these frames;
    /// `step.rs` defines r and G.
    #[inline(always)]
    unsafe fn diagonal<V: Lanes, const R: usize>(&self, m: usize, block: &mut Block) {
        let at = |i: usize, k: usize| (m + i) * self.group.frames + m + k;
        // SAFETY: guaranteed by the caller
        unsafe {
            let mut residual: [V; R] = std::array::from_fn(|i| self.sum_so_far(&block.residual, m + i));
            let mut gram: [[V; R]; R] =
                std::array::from_fn(|i| std::array::from_fn(|k| self.sum_so_far(&block.gram, at(i, k.max(i)))));
            for view in 0..self.group.views {
                let error = load::<V>(self.errors, view * V::COUNT);
                let a: [V; R] = std::array::from_fn(|i| self.product::<V>(view, m + i));
                for i in 0..R {
                    let shared = self.shared(view, a[i]);
                    residual[i] = shared.mul_add(error, residual[i]);
                    for k in i..R {
                        gram[i][k] = shared.mul_add(a[k], gram[i][k]);
                    }
                }
            }
            for i in 0..R {
                self.put(residual[i], &mut block.residual, m + i);
                for k in i..R {
                    self.put(gram[i][k], &mut block.gram, at(i, k));
                }
            }
        }
    }

    /// Adds up the entries of G (see `step.rs`) in the rows m..m + 3 and the columns k..k + C.
    #[inline(always)]
    unsafe fn rectangle<V: Lanes, const C: usize>(&self, m: usize, k: usize, block: &mut Block) {
        let at = |i: usize, c: usize| (m + i) * self.group.frames + k + c;
        // SAFETY: guaranteed by the caller
        unsafe {
            let mut gram: [[V; C]; 3] =
                std::array::from_fn(|i| std::array::from_fn(|c| self.sum_so_far(&block.gram, at(i, c))));
            for view in 0..self.group.views {
                let a: [V; 3] = std::array::from_fn(|i| self.shared(view, self.product::<V>(view, m + i)));
                for c in 0..C {
                    let b = self.product::<V>(view, k + c);
                    for i in 0..3 {
                        gram[i][c] = a[i].mul_add(b, gram[i][c]);
                    }
                }
            }
            for i in 0..3 {
                for c in 0..C {
                    self.put(gram[i][c], &mut block.gram, at(i, c));
                }
            }
        }
    }
}

/// Adds up G of `step.rs` outside the tiles of 3×3 frames along its diagonal.
pub(crate) struct BetweenTiles<const SHARED: bool>;

impl<const SHARED: bool> Kernel for BetweenTiles<SHARED> {
    type Args<'a> = (Tiles<'a, SHARED>, &'a mut Block);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((tiles, block): Self::Args<'_>) {
        let frames = tiles.group.frames;
        // SAFETY: guaranteed by the caller
        unsafe {
            for m in (0..frames).step_by(3) {
                for k in (m + 3..frames).step_by(3) {
                    match frames - k {
                        1 => tiles.rectangle::<V, 1>(m, k, block),
                        2 => tiles.rectangle::<V, 2>(m, k, block),
                        _ => tiles.rectangle::<V, 3>(m, k, block),
                    }
                }
            }
        }
    }
}
