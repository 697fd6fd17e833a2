//! The sums of one block by way of buffers, for any number of frames and factors, and what the ways have in common.

use lumistack_simd::{Kernel, Lanes, MAX_LANES, prefetch_far};

use crate::aligned::Aligned;
use crate::rays::{LineRays, Place, TargetRow};
use crate::step::Block;
use crate::vector::{Vector, load, store};

/// How many vectors ahead the factors' rows are asked for. One is a tenth slower, four no faster.
pub(crate) const AHEAD: usize = 2;
/// How many values ahead the target's rows are asked for, into the second-level cache: they are read once, and the first is full of the factors'.
const TARGET_AHEAD: usize = 64;

/// Buffers of one block.
pub(crate) struct Buffers {
    pub(crate) block: Block,
    /// a_m of every view of a block, `[view][frame][lane]`.
    pub(crate) products: Aligned,
    /// e (or βL), and L̃, of every view of a block, `[view][lane]`.
    pub(crate) errors: Aligned,
    pub(crate) emitted: Aligned,
    /// f/M.
    pub(crate) scaled: Aligned,
    /// Σ w e², per lane.
    pub(crate) squares: Vector,
}

impl Buffers {
    /// For so many frames and rows of views.
    pub(crate) fn new(frames: usize, views: usize) -> Self {
        let vectors = |count: usize| Aligned::filled(0.0, count * MAX_LANES);
        Self {
            block: Block::new(frames),
            products: vectors(views * frames),
            errors: vectors(views),
            emitted: vectors(views),
            scaled: vectors(frames),
            squares: Vector::default(),
        }
    }
}

/// How rays are compared.
#[derive(Clone, Copy)]
pub(crate) struct Sight {
    pub(crate) brightness: f32,
    /// Whether e is summed, or βL.
    pub(crate) residual: bool,
}

/// One block of a line: x to x + lanes lies within padded rows where it overlaps a view's valid range. Its sums and values go to the buffers.
pub(crate) struct BlockOfLine<'a> {
    pub(crate) rays: &'a LineRays<'a>,
    pub(crate) x: usize,
    pub(crate) sight: Sight,
    /// The line's own rows, `stride` apart.
    pub(crate) values: &'a [f32],
    pub(crate) stride: usize,
    pub(crate) buffers: &'a mut Buffers,
}

impl BlockOfLine<'_> {
    /// Reads the block's values f, and f/M; `in_registers` says whether each view asks for rows ahead.
    ///
    /// # Safety
    /// The machine has V.
    #[inline(always)]
    pub(crate) unsafe fn begin<V: Lanes>(&mut self, frames: usize, in_registers: bool) {
        // SAFETY: passed on from the caller
        unsafe {
            for m in 0..frames {
                let f = load::<V>(self.values, m * self.stride + self.x);
                store(f, &mut self.buffers.block.values, m * V::COUNT);
                store(f.mul(V::splat(1.0 / frames as f32)), &mut self.buffers.scaled, m * V::COUNT);
            }
        }
        self.rays.ask_for_rest(self.x + AHEAD * V::COUNT, in_registers);
    }
}

/// Sums over all views by way of buffers.
pub(crate) struct ByBuffers;

impl Kernel for ByBuffers {
    type Args<'a> = BlockOfLine<'a>;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(mut at: BlockOfLine<'_>) {
        let frames = at.buffers.block.frames;
        // SAFETY: passed on from the caller
        unsafe {
            at.begin::<V>(frames, false);
            let BlockOfLine { rays, x, sight, buffers, .. } = at;
            let (mut squares, mut active) = (V::splat(0.0), 0);
            for (index, view) in rays.views.iter().enumerate() {
                if let Some(weight) = view.weight::<V>(x) {
                    let error = buffered::<V>(rays, index, x, weight, sight, (active, &mut *buffers));
                    squares = error.mul_add(error, squares);
                    active += 1;
                }
            }
            store(squares, &mut buffers.squares, 0);
            sum_views::<V>(sight.residual, frames, active, buffers);
        }
    }
}

/// a_m, e (or βL) and L̃ of one view and block, times √w, written to place `to` of the buffers; returns e times √w.
#[inline(always)]
unsafe fn buffered<V: Lanes>(
    rays: &LineRays,
    view: usize,
    x: usize,
    weight: V,
    sight: Sight,
    (to, buffers): (usize, &mut Buffers),
) -> V {
    let (frames, others) = (buffers.block.frames, rays.others_of(view));
    // SAFETY: see the caller
    unsafe {
        let products = &mut buffers.products[to * frames * V::COUNT..(to + 1) * frames * V::COUNT];
        let emitted = match others {
            [a] => products_of::<V, 1>(rays, [a], x, frames, weight, products, &buffers.scaled),
            [a, b] => products_of::<V, 2>(rays, [a, b], x, frames, weight, products, &buffers.scaled),
            [a, b, c] => products_of::<V, 3>(rays, [a, b, c], x, frames, weight, products, &buffers.scaled),
            _ => {
                let mut emitted = V::splat(0.0);
                for m in 0..frames {
                    let mut product = weight;
                    for (other, stride) in others.iter().zip(&rays.strides) {
                        product = product.mul(V::load(other.at::<V>(x).wrapping_add(m * stride)));
                    }
                    store(product, products, m * V::COUNT);
                    emitted = product.mul_add(load::<V>(&buffers.scaled, m * V::COUNT), emitted);
                }
                emitted
            }
        };
        let wanted = wanted::<V>(&rays.targets[view], x, sight).mul(weight);
        let error = wanted.sub(emitted);
        store(if sight.residual { error } else { wanted }, &mut buffers.errors, to * V::COUNT);
        store(emitted, &mut buffers.emitted, to * V::COUNT);
        error
    }
}

/// Products of K factors for all frames, times the weight; returns Σ_m a_m f_m/M.
#[inline(always)]
unsafe fn products_of<V: Lanes, const K: usize>(
    rays: &LineRays,
    others: [&Place<f32>; K],
    x: usize,
    frames: usize,
    weight: V,
    products: &mut [f32],
    scaled: &[f32],
) -> V {
    let others: [_; K] = std::array::from_fn(|k| (others[k].at::<V>(x), rays.strides[k]));
    // SAFETY: see the caller
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
            emitted = product.mul_add(load::<V>(scaled, m * V::COUNT), emitted);
        }
        emitted
    }
}

/// βL of one view and block.
///
/// # Safety
/// The machine has V, and x lies within the row.
#[inline(always)]
pub(crate) unsafe fn wanted<V: Lanes>(row: &TargetRow, x: usize, sight: Sight) -> V {
    // SAFETY: see the caller
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
        radiance.mul(V::splat(sight.brightness))
    }
}

/// The sums over all views of a block.
#[inline(always)]
unsafe fn sum_views<V: Lanes>(gram: bool, frames: usize, views: usize, buffers: &mut Buffers) {
    let tiles =
        Tiles { frames, views, products: &buffers.products, errors: &buffers.errors, emitted: &buffers.emitted };
    let block = &mut buffers.block;
    // SAFETY: see the caller
    unsafe {
        if !gram {
            let mut m = 0;
            while m < frames {
                match frames - m {
                    1 => tiles.pair::<V, 1>(m, block),
                    2 => tiles.pair::<V, 2>(m, block),
                    3 => tiles.pair::<V, 3>(m, block),
                    4 | 5 => tiles.pair::<V, 4>(m, block),
                    _ => tiles.pair::<V, 6>(m, block),
                }
                m += match frames - m {
                    rest @ 1..=3 => rest,
                    4 | 5 => 4,
                    _ => 6,
                };
            }
            return;
        }
        for m in (0..frames).step_by(3) {
            match frames - m {
                1 => tiles.diagonal::<V, 1>(m, block),
                2 => tiles.diagonal::<V, 2>(m, block),
                _ => tiles.diagonal::<V, 3>(m, block),
            }
        }
        V::call::<BetweenTiles>((tiles, block));
    }
}

/// The buffers of one block's views, to be summed over.
pub(crate) struct Tiles<'a> {
    pub(crate) frames: usize,
    pub(crate) views: usize,
    pub(crate) products: &'a [f32],
    pub(crate) errors: &'a [f32],
    pub(crate) emitted: &'a [f32],
}

impl Tiles<'_> {
    #[inline(always)]
    unsafe fn product<V: Lanes>(&self, view: usize, frame: usize) -> V {
        // SAFETY: see the caller
        unsafe { load::<V>(self.products, (view * self.frames + frame) * V::COUNT) }
    }

    /// n and d of frames m..m + R.
    #[inline(always)]
    unsafe fn pair<V: Lanes, const R: usize>(&self, m: usize, block: &mut Block) {
        // SAFETY: see the caller
        unsafe {
            let (mut residual, mut below) = ([V::splat(0.0); R], [V::splat(0.0); R]);
            for view in 0..self.views {
                let error = load::<V>(self.errors, view * V::COUNT);
                let emitted = load::<V>(self.emitted, view * V::COUNT);
                for i in 0..R {
                    let a = self.product::<V>(view, m + i);
                    residual[i] = a.mul_add(error, residual[i]);
                    below[i] = a.mul_add(emitted, below[i]);
                }
            }
            for i in 0..R {
                store(residual[i], &mut block.residual, (m + i) * V::COUNT);
                store(below[i], &mut block.emitted, (m + i) * V::COUNT);
            }
        }
    }

    /// r of frames m..m + R and the upper triangle of their part of G.
    #[inline(always)]
    unsafe fn diagonal<V: Lanes, const R: usize>(&self, m: usize, block: &mut Block) {
        // SAFETY: see the caller
        unsafe {
            let (mut residual, mut gram) = ([V::splat(0.0); R], [[V::splat(0.0); R]; R]);
            for view in 0..self.views {
                let error = load::<V>(self.errors, view * V::COUNT);
                let a: [V; R] = std::array::from_fn(|i| self.product::<V>(view, m + i));
                for i in 0..R {
                    residual[i] = a[i].mul_add(error, residual[i]);
                    for k in i..R {
                        gram[i][k] = a[i].mul_add(a[k], gram[i][k]);
                    }
                }
            }
            for i in 0..R {
                store(residual[i], &mut block.residual, (m + i) * V::COUNT);
                for k in i..R {
                    store(gram[i][k], &mut block.gram, ((m + i) * self.frames + m + k) * V::COUNT);
                }
            }
        }
    }

    /// G between frames m..m + 3 and k..k + C.
    #[inline(always)]
    unsafe fn rectangle<V: Lanes, const C: usize>(&self, m: usize, k: usize, block: &mut Block) {
        // SAFETY: see the caller
        unsafe {
            let mut gram = [[V::splat(0.0); C]; 3];
            for view in 0..self.views {
                let a: [V; 3] = std::array::from_fn(|i| self.product::<V>(view, m + i));
                for c in 0..C {
                    let b = self.product::<V>(view, k + c);
                    for i in 0..3 {
                        gram[i][c] = a[i].mul_add(b, gram[i][c]);
                    }
                }
            }
            for i in 0..3 {
                for c in 0..C {
                    store(gram[i][c], &mut block.gram, ((m + i) * self.frames + k + c) * V::COUNT);
                }
            }
        }
    }
}

/// G off the tiles of 3×3 frames along its diagonal.
pub(crate) struct BetweenTiles;

impl Kernel for BetweenTiles {
    type Args<'a> = (Tiles<'a>, &'a mut Block);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((tiles, block): Self::Args<'_>) {
        // SAFETY: passed on from the caller
        unsafe {
            for m in (0..tiles.frames).step_by(3) {
                for k in (m + 3..tiles.frames).step_by(3) {
                    match tiles.frames - k {
                        1 => tiles.rectangle::<V, 1>(m, k, block),
                        2 => tiles.rectangle::<V, 2>(m, k, block),
                        _ => tiles.rectangle::<V, 3>(m, k, block),
                    }
                }
            }
        }
    }
}
