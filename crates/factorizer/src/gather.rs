//! One line of one factor, the fast way: every ray reads one pixel of the factor, at its own column plus a constant of the view.
//!
//! That is the paper's case: oblique views, equal pitch, nearest sampling. The simple version, for line j of layer n:
//!
//! ```text
//! for every view (a_y, a_x), every field row r that meets line j, every column x of the line, with c = x − shift_n:
//!     a_m = Π_{k≠n} f_k[line of r][m][c + shift_k]      e = βL[a][r][c] − (1/M) Σ_m a_m f_n[j][m][x]
//!     r[m][x] += w e a_m                                G[m][k][x] += w a_m a_k
//! step f_n[j][..][x] by r and G
//! ```
//!
//! Departures:
//! 1. Columns go in blocks of one vector, and a block meets all views before the next begins: its values stay in the first-level cache, and
//!    no accumulator ever moves to memory.
//! 2. Where registers hold a_m and the sums of all frames (with AVX-512 and NEON up to 8 for the paper's rule, up to 4 for G, and 6), that is all. G of
//!    6 frames is too large for that: 3×3 tiles along its diagonal are summed at once, what lies between them afterwards from a_m in a small
//!    buffer. Otherwise all views' a_m and e are buffered (10 kB for 25 views and 6 frames) before the sums are made tile by tile, each in registers;
//!    so any number of frames takes the same code, and 12 frames spill as little as 6. Buffering alone took 1.3 times as long (multiplicative) and
//!    1.2 times (block-exact) on Zen 4.
//! 3. Many rows are read side by side (frames × layers × view rows, and all views of the target), more than hardware prefetchers follow: each view asks
//!    for a few rows' values of two vectors later (all 60 at the block's start took 4 % longer), and for its own target's, which are read once, only
//!    into the second-level cache: the first is full of factors. With everything in the first-level cache a view of a block would take 26 cycles on
//!    Zen 4; it takes 45 to 50. Tiles of fewer columns, AVX2's vectors with AVX-512's registers, and the sum over frames in two chains gained nothing.
//! 4. The target is read in 16 bits where that is what it holds. √w multiplies a and e, so that no sum needs w.
//! 5. Blocks that the border of the valid rays crosses, and all where rays have weights, are masked; padding makes their loads legal.
//! 6. Where another factor is not at a constant shift (a lenslet grid, a layer of another pitch), its values along the rays are expanded into rows
//!    first; then it is at shift 0.

use crate::aligned::Aligned;
use crate::factor::{Factor, PAD};
use crate::lanes::{Kernel, Lanes};
use crate::line::{LineOf, LineStep, Outcome};
use crate::plan::Plan;
use crate::rays::{LineRays, Place, RowsOfView, TargetRow, expanded_stride, rays_through};
use crate::step::{Block, Rule, sum};

/// How many vectors ahead the factors' rows are asked for. One is a tenth slower, four no faster.
const AHEAD: usize = 2;
/// How many values ahead the target's rows are asked for, into the second-level cache: they are read once, and the first is full of the factors'.
const TARGET_AHEAD: usize = 64;
/// How many blocks' errors are added in f32 before they go to an f64 sum.
const BLOCKS_PER_SUM: usize = 4;

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// Other factors that are not at a constant shift, expanded along the rays: `[view and factor][frame][column]`.
    expanded: Vec<f32>,
    buffers: Buffers,
    /// Storage for the list of a line's rays.
    rays: LineRays<'static>,
}

/// Buffers of one block.
struct Buffers {
    block: Block,
    /// a_m of every view of a block, `[view][frame][lane]`.
    products: Aligned,
    /// e (or βL), and L̃, of every view of a block, `[view][lane]`.
    errors: Aligned,
    emitted: Aligned,
    /// f/M.
    scaled: Aligned,
}

impl Scratch {
    pub(crate) fn new(plan: &Plan, n: usize) -> Self {
        let frames = plan.frames;
        // rows of a view that meet one line: one, or two where rounding doubles one
        let views = plan.views[1] * plan.maps[n].most_rows;
        let vectors = |count: usize| Aligned::filled(0.0, count * PAD);
        let others = (0..plan.maps.len()).filter(|&k| k != n && !plan.maps[k].shifted).count();
        Self {
            buffers: Buffers {
                block: Block::new(frames),
                products: vectors(views * frames),
                errors: vectors(views),
                emitted: vectors(views),
                scaled: vectors(frames),
            },
            expanded: vec![0.0; others * views * frames * expanded_stride(plan)],
            rays: LineRays::default(),
        }
    }
}

/// One line and what becomes of it.
pub(crate) struct GatherLine<'a, 'b> {
    pub(crate) plan: &'a Plan,
    /// The line's own factor is not read.
    pub(crate) factors: &'a [Factor],
    pub(crate) at: LineOf,
    pub(crate) step: LineStep<'b>,
    pub(crate) scratch: &'a mut Scratch,
}

impl Kernel for GatherLine<'_, '_> {
    type Output = Outcome;

    #[inline(always)]
    unsafe fn run<V: Lanes>(self) -> Outcome {
        // SAFETY: passed on from the caller
        unsafe {
            match self.plan.frames {
                1 => self.run_with::<V, 1>(),
                2 => self.run_with::<V, 2>(),
                3 => self.run_with::<V, 3>(),
                4 => self.run_with::<V, 4>(),
                6 => self.run_with::<V, 6>(),
                8 => self.run_with::<V, 8>(),
                12 => self.run_with::<V, 12>(),
                _ => self.run_with::<V, 0>(),
            }
        }
    }
}

impl GatherLine<'_, '_> {
    /// M is the number of frames, so that loops over frames unroll, or 0 for any number.
    #[inline(always)]
    unsafe fn run_with<V: Lanes, const M: usize>(self) -> Outcome {
        let Self { plan, factors, at, mut step, scratch } = self;
        let Scratch { expanded, buffers, rays } = scratch;
        let layout = &plan.maps[at.factor].layout;
        let (frames, stride) = (if M == 0 { layout.frames } else { M }, layout.stride);
        let latest = step.beyond.as_ref().map(|(_, latest)| latest.as_ptr());
        let own = [Some(step.values.as_ptr()), latest].into_iter().flatten();
        let own = own.flat_map(|line| (0..frames).map(move |frame| line.wrapping_add(frame * stride)));
        let list = rays_through(std::mem::take(rays), plan, factors, at, own, expanded);
        let (outer, inner) = (list.outer(), list.inner());
        let first = layout.pad + (outer.start.max(layout.pad) - layout.pad) / V::COUNT * V::COUNT;
        let end = outer.end.min(layout.pad + layout.cols());
        let sight = Sight { brightness: plan.target.brightness, residual: step.rule.needs_gram() };
        let mut outcome = Outcome::default();
        // SAFETY: the machine has V
        let (mut squares, mut gain) = unsafe { (V::splat(0.0), V::splat(0.0)) };
        let mut x = first;
        while x < end {
            // SAFETY: the machine has V; x + offset lies within padded rows for every block that overlaps a view's valid range
            unsafe {
                for m in 0..frames {
                    let f = load::<V>(step.values, m * stride + x);
                    store(f, &mut buffers.block.values, m * V::COUNT);
                    store(f.mul(V::splat(1.0 / frames as f32)), &mut buffers.scaled, m * V::COUNT);
                }
                let sums = Sums { rays: &list, x, sight: &sight, buffers: &mut *buffers };
                let whole = inner.start <= x && x + V::COUNT <= inner.end;
                squares = squares.add(sums.of_block::<V, M>(step.rule, frames, whole));
                gain = gain.add(step.finish_block::<V>(&mut buffers.block, x));
                x += V::COUNT;
                // a few blocks may share an f32 sum, a line may not
                if x >= end || (x - first) % (BLOCKS_PER_SUM * V::COUNT) == 0 {
                    outcome.error += sum::<V>(squares);
                    outcome.gain += sum::<V>(gain);
                    (squares, gain) = (V::splat(0.0), V::splat(0.0));
                }
            }
        }
        *rays = list.emptied();
        outcome
    }
}

/// How rays are compared.
struct Sight {
    brightness: f32,
    /// Whether e is summed, or βL.
    residual: bool,
}

/// What the sums of one block are made from, and where they go.
struct Sums<'a> {
    rays: &'a LineRays<'a>,
    x: usize,
    sight: &'a Sight,
    buffers: &'a mut Buffers,
}

impl Sums<'_> {
    /// Sums over all views; returns the sum of w e². `whole` says that the rays of every view count in full.
    #[inline(always)]
    unsafe fn of_block<V: Lanes, const M: usize>(self, rule: Rule, frames: usize, whole: bool) -> V {
        let in_registers =
            M > 0 && registers_for(rule, M) <= V::REGISTERS && (1..=3).contains(&self.rays.others_per_view);
        // SAFETY: see the caller
        unsafe {
            self.rays.ask_for_rest::<V>(self.x + AHEAD * V::COUNT, in_registers);
            if !in_registers {
                return self.by_buffers::<V, M>(rule, frames);
            }
            match (self.rays.others_per_view, whole) {
                (1, true) => self.in_registers::<V, M, 1, false>(rule),
                (2, true) => self.in_registers::<V, M, 2, false>(rule),
                (3, true) => self.in_registers::<V, M, 3, false>(rule),
                (1, false) => self.in_registers::<V, M, 1, true>(rule),
                (2, false) => self.in_registers::<V, M, 2, true>(rule),
                (3, false) => self.in_registers::<V, M, 3, true>(rule),
                _ => unreachable!("what is in registers has one to three other factors"),
            }
        }
    }

    /// With accumulators that stay in registers, K other factors.
    #[inline(always)]
    unsafe fn in_registers<V: Lanes, const M: usize, const K: usize, const MASKED: bool>(self, rule: Rule) -> V {
        // SAFETY: see the caller
        unsafe { if rule.needs_gram() { self.gram::<V, M, K, MASKED>() } else { self.pairs::<V, M, K, MASKED>() } }
    }

    /// n and d of all frames.
    #[inline(always)]
    unsafe fn pairs<V: Lanes, const M: usize, const K: usize, const MASKED: bool>(self) -> V {
        let Self { rays, x, sight, buffers } = self;
        // SAFETY: see the caller
        unsafe {
            let lit = Lit::<K>::new(rays, x, sight, &buffers.scaled);
            let mut squares = V::splat(0.0);
            let (mut above, mut below) = ([V::splat(0.0); M], [V::splat(0.0); M]);
            for rows in rays.by_view::<K>() {
                let Some(Seen { products, wanted, emitted }) = lit.seen::<V, M, MASKED>(&rows) else { continue };
                let error = wanted.sub(emitted);
                squares = error.mul_add(error, squares);
                for m in 0..M {
                    above[m] = products[m].mul_add(wanted, above[m]);
                    below[m] = products[m].mul_add(emitted, below[m]);
                }
            }
            for m in 0..M {
                store(above[m], &mut buffers.block.residual, m * V::COUNT);
                store(below[m], &mut buffers.block.emitted, m * V::COUNT);
            }
            squares
        }
    }

    /// r of all frames and G: tiles along its diagonal at once, what lies between them from buffered a_m.
    #[inline(always)]
    unsafe fn gram<V: Lanes, const M: usize, const K: usize, const MASKED: bool>(self) -> V {
        let Self { rays, x, sight, buffers } = self;
        let Buffers { block, products: buffered, errors, emitted, scaled } = buffers;
        let tile = tile_of(M);
        // SAFETY: see the caller
        unsafe {
            let lit = Lit::<K>::new(rays, x, sight, scaled);
            let mut squares = V::splat(0.0);
            let (mut residual, mut gram) = ([V::splat(0.0); M], [[V::splat(0.0); M]; M]);
            let mut active = 0;
            for rows in rays.by_view::<K>() {
                let Some(Seen { products, wanted, emitted }) = lit.seen::<V, M, MASKED>(&rows) else { continue };
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
            for m in 0..M {
                store(residual[m], &mut block.residual, m * V::COUNT);
                for k in m..M {
                    if m / tile == k / tile {
                        store(gram[m][k], &mut block.gram, (m * M + k) * V::COUNT);
                    }
                }
            }
            if tile < M {
                Tiles { frames: M, views: active, products: buffered, errors, emitted }.between_tiles::<V>(block);
            }
            squares
        }
    }

    /// By way of buffers, for any number of frames and factors.
    #[inline(always)]
    unsafe fn by_buffers<V: Lanes, const M: usize>(self, rule: Rule, frames: usize) -> V {
        let Self { rays, x, sight, buffers } = self;
        // SAFETY: see the caller
        unsafe {
            let (mut squares, mut active) = (V::splat(0.0), 0);
            for (index, view) in rays.views.iter().enumerate() {
                if let Some(weight) = view.weight::<V>(x) {
                    let to = (active, &mut *buffers);
                    let error = buffered::<V, M>(rays, index, x, frames, weight, sight, to);
                    squares = error.mul_add(error, squares);
                    active += 1;
                }
            }
            sum_views::<V, M>(rule, frames, active, buffers);
            squares
        }
    }
}

/// Accumulators, a_m, and a few values more.
const fn registers_for(rule: Rule, frames: usize) -> usize {
    match rule {
        Rule::Multiplicative => 3 * frames + 4,
        _ => {
            let (tile, tiles) = (tile_of(frames), frames.div_ceil(tile_of(frames)));
            2 * frames + tiles * tile * (tile + 1) / 2 + 5
        }
    }
}

/// Which part of G is summed while a_m is at hand: all of it, or tiles of so many frames along its diagonal.
const fn tile_of(frames: usize) -> usize {
    if frames <= 4 { frames } else { 3 }
}

/// a_m of all frames, βL and L̃ of one view and block, times √w.
struct Seen<V, const M: usize> {
    products: [V; M],
    wanted: V,
    emitted: V,
}

/// What is alike for all views of a block, at hand.
struct Lit<'a, const K: usize> {
    x: usize,
    sight: &'a Sight,
    /// f/M.
    scaled: &'a [f32],
    strides: [usize; K],
}

impl<'a, const K: usize> Lit<'a, K> {
    #[inline(always)]
    fn new(rays: &LineRays, x: usize, sight: &'a Sight, scaled: &'a [f32]) -> Self {
        Self { x, sight, scaled, strides: std::array::from_fn(|k| rays.strides[k]) }
    }

    /// What one view sees of the block; `None` where none of its rays counts.
    #[inline(always)]
    unsafe fn seen<V: Lanes, const M: usize, const MASKED: bool>(&self, rows: &RowsOfView<K>) -> Option<Seen<V, M>> {
        // SAFETY: see the caller
        unsafe {
            rows.ask::<V>(self.x + AHEAD * V::COUNT);
            let weight = if MASKED { rows.view.weight::<V>(self.x)? } else { V::splat(1.0) };
            let mut wanted = wanted::<V>(rows.target, self.x, self.sight);
            if MASKED {
                wanted = wanted.mul(weight);
            }
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
            Some(Seen { products, wanted, emitted })
        }
    }
}

/// a_m, e (or βL) and L̃ of one view and block, times √w, written to place `to` of the buffers; returns e times √w.
#[inline(always)]
unsafe fn buffered<V: Lanes, const M: usize>(
    rays: &LineRays,
    view: usize,
    x: usize,
    frames: usize,
    weight: V,
    sight: &Sight,
    (to, buffers): (usize, &mut Buffers),
) -> V {
    let frames = if M == 0 { frames } else { M };
    let others = rays.others_of(view);
    // SAFETY: see the caller
    unsafe {
        let products = &mut buffers.products[to * frames * V::COUNT..(to + 1) * frames * V::COUNT];
        let emitted = match others {
            [a] => products_of::<V, M, 1>(rays, [a], x, frames, weight, products, &buffers.scaled),
            [a, b] => products_of::<V, M, 2>(rays, [a, b], x, frames, weight, products, &buffers.scaled),
            [a, b, c] => products_of::<V, M, 3>(rays, [a, b, c], x, frames, weight, products, &buffers.scaled),
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
unsafe fn products_of<V: Lanes, const M: usize, const K: usize>(
    rays: &LineRays,
    others: [&Place<f32>; K],
    x: usize,
    frames: usize,
    weight: V,
    products: &mut [f32],
    scaled: &[f32],
) -> V {
    let frames = if M == 0 { frames } else { M };
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
#[inline(always)]
unsafe fn wanted<V: Lanes>(row: &TargetRow, x: usize, sight: &Sight) -> V {
    // SAFETY: see the caller
    unsafe {
        let radiance = match row {
            TargetRow::Half(row) => {
                let at = row.at::<V>(x);
                V::prefetch_far(at.wrapping_add(TARGET_AHEAD));
                V::load_half(at)
            }
            TargetRow::Float(row) => {
                let at = row.at::<V>(x);
                V::prefetch_far(at.wrapping_add(TARGET_AHEAD));
                V::load(at)
            }
        };
        radiance.mul(V::splat(sight.brightness))
    }
}

/// The sums over all views of a block.
#[inline(always)]
unsafe fn sum_views<V: Lanes, const M: usize>(rule: Rule, frames: usize, views: usize, scratch: &mut Buffers) {
    let tiles =
        Tiles { frames, views, products: &scratch.products, errors: &scratch.errors, emitted: &scratch.emitted };
    let block = &mut scratch.block;
    let frames = if M == 0 { frames } else { M };
    // SAFETY: see the caller
    unsafe {
        if !rule.needs_gram() {
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
        tiles.between_tiles::<V>(block);
    }
}

/// The buffers of one block's views, to be summed over.
struct Tiles<'a> {
    frames: usize,
    views: usize,
    products: &'a [f32],
    errors: &'a [f32],
    emitted: &'a [f32],
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

    /// G off the tiles of 3×3 frames along its diagonal.
    #[inline(always)]
    unsafe fn between_tiles<V: Lanes>(&self, block: &mut Block) {
        // SAFETY: see the caller
        unsafe {
            for m in (0..self.frames).step_by(3) {
                for k in (m + 3..self.frames).step_by(3) {
                    match self.frames - k {
                        1 => self.rectangle::<V, 1>(m, k, block),
                        2 => self.rectangle::<V, 2>(m, k, block),
                        _ => self.rectangle::<V, 3>(m, k, block),
                    }
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

/// 1 in lanes low..high, else 0.
#[inline(always)]
pub(crate) unsafe fn mask<V: Lanes>(low: usize, high: usize) -> V {
    static STEPS: [f32; 3 * PAD] = {
        let mut steps = [0.0; 3 * PAD];
        let mut i = PAD;
        while i < 2 * PAD {
            steps[i] = 1.0;
            i += 1;
        }
        steps
    };
    // SAFETY: low and high are at most V::COUNT ≤ PAD
    unsafe { load::<V>(&STEPS, PAD - low).mul(load::<V>(&STEPS, 2 * PAD - high)) }
}

#[inline(always)]
unsafe fn load<V: Lanes>(from: &[f32], at: usize) -> V {
    debug_assert!(at + V::COUNT <= from.len(), "{at} + {} > {}", V::COUNT, from.len());
    // SAFETY: the caller guarantees the range
    unsafe { V::load(from.as_ptr().add(at)) }
}

#[inline(always)]
unsafe fn store<V: Lanes>(vector: V, to: &mut [f32], at: usize) {
    debug_assert!(at + V::COUNT <= to.len(), "{at} + {} > {}", V::COUNT, to.len());
    // SAFETY: the caller guarantees the range
    unsafe { vector.store(to.as_mut_ptr().add(at)) }
}
