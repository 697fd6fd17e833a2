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
//! 2. Where registers hold a_m and the sums of all frames (with AVX-512 and NEON up to 8 for the paper's rule, up to 4 for G, and 6), and rays of all
//!    views count in full, that is all. G of 6 frames is too large for that: 3×3 tiles along its diagonal are summed at once, what lies between
//!    them afterwards from a_m in a small buffer. Otherwise all views' a_m and e are buffered (10 kB for 25 views and 6 frames) before the sums are
//!    made tile by tile, each in registers; so any number of frames takes the same code, and 12 frames spill as little as 6. Buffering alone took
//!    1.3 times as long (multiplicative) and 1.2 times (block-exact) on Zen 4.
//! 3. Many rows are read side by side (frames × layers × view rows, and all views of the target), more than hardware prefetchers follow: each block asks
//!    for what comes two vectors later.
//! 4. The target is read in 16 bits where that is what it holds. √w multiplies a and e, so that no sum needs w.
//! 5. Blocks that the border of the valid rays crosses are masked; padding makes their loads legal.
//! 6. Where another factor is not at a constant shift (a lenslet grid, a layer of another pitch), its values along the rays are expanded into rows
//!    first; then it is at shift 0.

use std::ops::Range;

use crate::aligned::Aligned;
use crate::expand::{Rays, expand_factor};
use crate::factor::{Factor, PAD};
use crate::lanes::{Kernel, Lanes};
use crate::line::{LineOf, LineStep, Outcome};
use crate::plan::Plan;
use crate::step::{Block, Rule, sum};
use crate::target::Row;

/// How many vectors ahead rows are asked for. One is a tenth slower, four no faster.
const AHEAD: usize = 2;
/// How many blocks' errors are added in f32 before they go to an f64 sum.
const BLOCKS_PER_SUM: usize = 4;

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// Other factors that are not at a constant shift, expanded along the rays: `[view and factor][frame][column]`.
    expanded: Vec<f32>,
    buffers: Buffers,
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
        }
    }
}

/// Values of one expanded row.
fn expanded_stride(plan: &Plan) -> usize {
    (PAD + plan.cols + PAD).next_multiple_of(PAD)
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
        let Scratch { expanded, buffers } = scratch;
        let rays = rays_through(plan, factors, at, expanded);
        let layout = &plan.maps[at.factor].layout;
        let (frames, stride) = (if M == 0 { layout.frames } else { M }, layout.stride);
        let first = rays.views.iter().map(|view| view.valid.start).min().unwrap_or(0).max(layout.pad);
        let first = layout.pad + (first - layout.pad) / V::COUNT * V::COUNT;
        let end = rays.views.iter().map(|view| view.valid.end).max().unwrap_or(0).min(layout.pad + layout.cols());
        let inner = rays.inner();
        let sight = Sight { brightness: plan.target.brightness, residual: step.rule.needs_gram() };
        let mut outcome = Outcome::default();
        // SAFETY: the machine has V
        let (mut squares, mut gain) = unsafe { (V::splat(0.0), V::splat(0.0)) };
        let mut x = first;
        while x < end {
            // SAFETY: the machine has V; x + offset lies within padded rows for every block that overlaps a view's valid range
            unsafe {
                for m in 0..frames {
                    let from = m * stride + x;
                    let f = load::<V>(step.values, from);
                    V::prefetch(step.values.as_ptr().wrapping_add(from + AHEAD * V::COUNT));
                    if let Some((_, latest)) = &step.beyond {
                        V::prefetch(latest.as_ptr().wrapping_add(from));
                    }
                    store(f, &mut buffers.block.values, m * V::COUNT);
                    store(f.mul(V::splat(1.0 / frames as f32)), &mut buffers.scaled, m * V::COUNT);
                }
                for lead in &rays.leads {
                    for m in 0..frames {
                        V::prefetch(lead.values.as_ptr().wrapping_add(lead.at(x + AHEAD * V::COUNT) + m * lead.stride));
                    }
                }
                let whole = inner.start <= x && x + V::COUNT <= inner.end;
                let sums = if whole { sum_in_registers::<V, M>(&rays, step.rule, x, &sight, buffers) } else { None };
                if let Some(squared) = sums {
                    squares = squares.add(squared);
                } else {
                    let mut active = 0;
                    for (view, others) in rays.views.iter().zip(rays.others.chunks_exact(rays.others_per_view.max(1))) {
                        if view.valid.start < x + V::COUNT && x < view.valid.end {
                            let others = &others[..rays.others_per_view];
                            let error = view_errors::<V, M>(view, others, x, frames, &sight, active, buffers);
                            squares = error.mul_add(error, squares);
                            active += 1;
                        }
                    }
                    sum_views::<V, M>(step.rule, frames, active, buffers);
                }
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
        outcome
    }
}

/// The rays through one line.
struct LineRays<'a> {
    views: Vec<View<'a>>,
    /// All factors of a view lie together; one unused entry per view where there is no other factor.
    others: Vec<Other<'a>>,
    others_per_view: usize,
    /// Per row of another factor, where the foremost view reads it.
    leads: Vec<Other<'a>>,
}

impl LineRays<'_> {
    /// x where the rays of every view count in full.
    fn inner(&self) -> Range<usize> {
        if self.views.iter().any(|view| view.weights.is_some()) {
            return 0..0;
        }
        let start = self.views.iter().map(|view| view.valid.start).max().unwrap_or(0);
        start..self.views.iter().map(|view| view.valid.end).min().unwrap_or(0)
    }
}

/// One view's rays through the line; x counts in the line's padded storage.
struct View<'a> {
    /// x of the rays that count.
    valid: Range<usize>,
    target: Row<'a>,
    weights: Option<&'a [f32]>,
    /// Index in `target` and `weights` minus x.
    target_offset: isize,
}

/// One other factor's line as one view's rays meet it.
#[derive(Clone, Copy)]
struct Other<'a> {
    values: &'a [f32],
    stride: usize,
    /// Index minus x.
    offset: isize,
}

impl Other<'_> {
    #[inline(always)]
    fn at(&self, x: usize) -> usize {
        (x as isize + self.offset) as usize
    }
}

/// Lists the rays of a line, and expands what is not at a constant shift.
#[inline(always)]
fn rays_through<'a>(plan: &'a Plan, factors: &'a [Factor], at: LineOf, expanded: &'a mut [f32]) -> LineRays<'a> {
    let map = &plan.maps[at.factor];
    let others_per_view = factors.len() - 1;
    let mut rays = LineRays { views: Vec::new(), others: Vec::new(), others_per_view, leads: Vec::new() };
    let mut rest = expanded;
    let stride = expanded_stride(plan);
    for view_y in 0..plan.views[0] {
        for &(row, _) in map.rays_of_line(view_y, at.line) {
            let row = row as usize;
            let before = rays.others.len();
            for view_x in 0..plan.views[1] {
                let ([run], Some(own)) = (plan.runs[view_x].as_slice(), map.x[view_x].shift) else { continue };
                let view = plan.view(view_y, view_x);
                rays.views.push(View {
                    valid: (run.start as isize + own) as usize..(run.end as isize + own) as usize,
                    target: plan.target.row(at.channel, view, row),
                    weights: plan.target.weights(view, row),
                    target_offset: PAD as isize - own,
                });
                for (k, factor) in factors.iter().enumerate().filter(|(k, _)| *k != at.factor) {
                    let other = &plan.maps[k];
                    if let (true, Some(shift)) = (other.shifted, other.x[view_x].shift) {
                        let line = other.y[view_y][row].first as usize;
                        let values = factor.line(at.channel, line);
                        rays.others.push(Other { values, stride: other.layout.stride, offset: shift - own });
                    } else {
                        let (values, tail) = std::mem::take(&mut rest).split_at_mut(plan.frames * stride);
                        rest = tail;
                        let part = Rays { channel: at.channel, view: [view_y, view_x], row, run };
                        for (frame, values) in values.chunks_exact_mut(stride).enumerate() {
                            expand_factor(plan, factors, k, frame, &part, &mut values[PAD + run.start..PAD + run.end]);
                        }
                        rays.others.push(Other { values, stride, offset: PAD as isize - own });
                    }
                }
            }
            if others_per_view == 0 {
                rays.others.resize(rays.views.len(), Other { values: &[], stride: 0, offset: 0 });
            }
            // all views of a view row read the same lines, side by side
            for k in 0..others_per_view {
                let of_factor = rays.others[before..].iter().skip(k).step_by(others_per_view);
                if let Some(lead) = of_factor.max_by_key(|other| other.offset).copied() {
                    rays.leads.push(lead);
                }
            }
        }
    }
    rays
}

/// How rays are compared.
struct Sight {
    brightness: f32,
    /// Whether e is summed, or βL.
    residual: bool,
}

/// a_m, e (or βL) and L̃ of one view and block, times √w, written to place `to` of the buffers; returns e times √w.
#[inline(always)]
unsafe fn view_errors<V: Lanes, const M: usize>(
    view: &View,
    others: &[Other],
    x: usize,
    frames: usize,
    sight: &Sight,
    to: usize,
    scratch: &mut Buffers,
) -> V {
    let frames = if M == 0 { frames } else { M };
    // SAFETY: see the caller
    unsafe {
        let products = &mut scratch.products[to * frames * V::COUNT..(to + 1) * frames * V::COUNT];
        let emitted = match others {
            [] => products_of::<V, M, 0>([], frames, products, &scratch.scaled),
            [a] => products_of::<V, M, 1>([at(a, x)], frames, products, &scratch.scaled),
            [a, b] => products_of::<V, M, 2>([at(a, x), at(b, x)], frames, products, &scratch.scaled),
            [a, b, c] => products_of::<V, M, 3>([at(a, x), at(b, x), at(c, x)], frames, products, &scratch.scaled),
            [a, b, c, rest @ ..] => {
                products_of::<V, M, 3>([at(a, x), at(b, x), at(c, x)], frames, products, &scratch.scaled);
                multiply_by::<V, M>(rest, x, frames, products, &scratch.scaled)
            }
        };
        let mut wanted = wanted::<V>(view, x, sight);
        let mut emitted = emitted;
        if view.weights.is_some() || x < view.valid.start || view.valid.end < x + V::COUNT {
            let (low, high) = (view.valid.start.max(x), view.valid.end.min(x + V::COUNT));
            let mut weight = mask::<V>(low - x, high - x);
            if let Some(weights) = view.weights {
                weight = weight.mul(load::<V>(weights, (x as isize + view.target_offset) as usize));
            }
            wanted = wanted.mul(weight);
            emitted = emitted.mul(weight);
            for m in 0..frames {
                store(load::<V>(products, m * V::COUNT).mul(weight), products, m * V::COUNT);
            }
        }
        let error = wanted.sub(emitted);
        store(if sight.residual { error } else { wanted }, &mut scratch.errors, to * V::COUNT);
        store(emitted, &mut scratch.emitted, to * V::COUNT);
        error
    }
}

#[inline(always)]
fn at(other: &Other, x: usize) -> (*const f32, usize) {
    debug_assert!(other.at(x) < other.values.len());
    (other.values.as_ptr().wrapping_add(other.at(x)), other.stride)
}

/// Products of K factors for all frames; returns Σ_m a_m f_m/M.
#[inline(always)]
unsafe fn products_of<V: Lanes, const M: usize, const K: usize>(
    others: [(*const f32, usize); K],
    frames: usize,
    products: &mut [f32],
    scaled: &[f32],
) -> V {
    let frames = if M == 0 { frames } else { M };
    // SAFETY: see the caller
    unsafe {
        let mut emitted = V::splat(0.0);
        for m in 0..frames {
            let value = |k: usize| V::load(others[k].0.add(m * others[k].1));
            let mut product = if K == 0 { V::splat(1.0) } else { value(0) };
            for k in 1..K {
                product = product.mul(value(k));
            }
            store(product, products, m * V::COUNT);
            emitted = product.mul_add(load::<V>(scaled, m * V::COUNT), emitted);
        }
        emitted
    }
}

/// Multiplies products by more factors; returns Σ_m a_m f_m/M.
#[inline(always)]
unsafe fn multiply_by<V: Lanes, const M: usize>(
    others: &[Other],
    x: usize,
    frames: usize,
    products: &mut [f32],
    scaled: &[f32],
) -> V {
    let frames = if M == 0 { frames } else { M };
    // SAFETY: see the caller
    unsafe {
        let mut emitted = V::splat(0.0);
        for m in 0..frames {
            let mut product = load::<V>(products, m * V::COUNT);
            for other in others {
                product = product.mul(load::<V>(other.values, other.at(x) + m * other.stride));
            }
            store(product, products, m * V::COUNT);
            emitted = product.mul_add(load::<V>(scaled, m * V::COUNT), emitted);
        }
        emitted
    }
}

/// The sums over all views of a block that no border crosses, with accumulators that stay in registers; returns the sum of e². `None` where the
/// registers do not hold them.
#[inline(always)]
unsafe fn sum_in_registers<V: Lanes, const M: usize>(
    rays: &LineRays,
    rule: Rule,
    x: usize,
    sight: &Sight,
    buffers: &mut Buffers,
) -> Option<V> {
    if M == 0 || registers_for(rule, M) > V::REGISTERS {
        return None;
    }
    // SAFETY: see the caller
    unsafe {
        match (rays.others_per_view, rule.needs_gram()) {
            (1, false) => Some(pairs_in_registers::<V, M, 1>(rays, x, sight, buffers)),
            (2, false) => Some(pairs_in_registers::<V, M, 2>(rays, x, sight, buffers)),
            (3, false) => Some(pairs_in_registers::<V, M, 3>(rays, x, sight, buffers)),
            (1, true) => Some(gram_in_registers::<V, M, 1>(rays, x, sight, buffers)),
            (2, true) => Some(gram_in_registers::<V, M, 2>(rays, x, sight, buffers)),
            (3, true) => Some(gram_in_registers::<V, M, 3>(rays, x, sight, buffers)),
            _ => None,
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

/// n and d of all frames.
#[inline(always)]
unsafe fn pairs_in_registers<V: Lanes, const M: usize, const K: usize>(
    rays: &LineRays,
    x: usize,
    sight: &Sight,
    buffers: &mut Buffers,
) -> V {
    // SAFETY: see the caller
    unsafe {
        let mut squares = V::splat(0.0);
        let (mut above, mut below) = ([V::splat(0.0); M], [V::splat(0.0); M]);
        for (view, others) in rays.views.iter().zip(rays.others.chunks_exact(K)) {
            let (products, emitted) = whole_products::<V, M, K>(others, x, &buffers.scaled);
            let wanted = wanted::<V>(view, x, sight);
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
unsafe fn gram_in_registers<V: Lanes, const M: usize, const K: usize>(
    rays: &LineRays,
    x: usize,
    sight: &Sight,
    buffers: &mut Buffers,
) -> V {
    let tile = tile_of(M);
    // SAFETY: see the caller
    unsafe {
        let mut squares = V::splat(0.0);
        let (mut residual, mut gram) = ([V::splat(0.0); M], [[V::splat(0.0); M]; M]);
        for (index, (view, others)) in rays.views.iter().zip(rays.others.chunks_exact(K)).enumerate() {
            let (products, emitted) = whole_products::<V, M, K>(others, x, &buffers.scaled);
            let error = wanted::<V>(view, x, sight).sub(emitted);
            squares = error.mul_add(error, squares);
            for m in 0..M {
                residual[m] = products[m].mul_add(error, residual[m]);
                for k in m..M {
                    if m / tile == k / tile {
                        gram[m][k] = products[m].mul_add(products[k], gram[m][k]);
                    }
                }
                if tile < M {
                    store(products[m], &mut buffers.products, (index * M + m) * V::COUNT);
                }
            }
        }
        let block = &mut buffers.block;
        for m in 0..M {
            store(residual[m], &mut block.residual, m * V::COUNT);
            for k in m..M {
                if m / tile == k / tile {
                    store(gram[m][k], &mut block.gram, (m * M + k) * V::COUNT);
                }
            }
        }
        if tile < M {
            let views = rays.views.len();
            let (products, errors, emitted) = (&buffers.products, &buffers.errors, &buffers.emitted);
            Tiles { frames: M, views, products, errors, emitted }.between_tiles::<V>(block);
        }
        squares
    }
}

/// a_m of all frames and L̃ of one view and block.
#[inline(always)]
unsafe fn whole_products<V: Lanes, const M: usize, const K: usize>(
    others: &[Other],
    x: usize,
    scaled: &[f32],
) -> ([V; M], V) {
    // SAFETY: see the caller
    unsafe {
        let others: [_; K] = std::array::from_fn(|k| at(&others[k], x));
        let (mut products, mut emitted) = ([V::splat(0.0); M], V::splat(0.0));
        for m in 0..M {
            products[m] = V::load(others[0].0.add(m * others[0].1));
            for other in &others[1..] {
                products[m] = products[m].mul(V::load(other.0.add(m * other.1)));
            }
            emitted = products[m].mul_add(load::<V>(scaled, m * V::COUNT), emitted);
        }
        (products, emitted)
    }
}

/// βL of one view and block.
#[inline(always)]
unsafe fn wanted<V: Lanes>(view: &View, x: usize, sight: &Sight) -> V {
    let from = (x as isize + view.target_offset) as usize;
    // SAFETY: see the caller
    unsafe {
        let radiance = match view.target {
            Row::Half(row) => {
                debug_assert!(from + V::COUNT <= row.len());
                V::prefetch(row.as_ptr().wrapping_add(from + 2 * AHEAD * V::COUNT));
                V::load_half(row.as_ptr().add(from))
            }
            Row::Float(row) => {
                V::prefetch(row.as_ptr().wrapping_add(from + 2 * AHEAD * V::COUNT));
                load::<V>(row, from)
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
