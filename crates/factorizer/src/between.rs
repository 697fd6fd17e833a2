//! Updates lines of one factor that rays read between pixels. All rays of a view column read the
//! factor at one constant shift from their field columns.
//!
//! As in [`scatter`](crate::scatter), each ray adds its terms to four pixels, by the shares
//! (1 − t_y, t_y) and (1 − t_x, t_x). But at a constant shift, a pixel's rays are known from the
//! pixel's column, so each pixel collects its sums:
//!
//! ```text
//! for every part of line j (some columns x):
//!     low = the high sums of line j − 1 at x,  high = 0
//!     for every row of rays between the lines j and j + 1, for every block of pixels:
//!         sums = Σ over view columns: (1 − t_x) · (w e a_m, w a_m a_k) of rays between x and x + 1
//!                                         + t_x · (w e a_m, w a_m a_k) of rays between x − 1 and x
//!         low += (1 − t_y) · sums,  high += t_y · sums
//!     step the pixels by low, keep high for line j + 1
//! ```
//!
//! The terms a_m and e of a ray are computed once, with one ray per lane. A ray reads pixel x with
//! the share 1 − t_x, and pixel x + 1 with the share t_x. So a second vector has the terms of the
//! first vector, moved up by one lane. Lane 0 of the second vector is the last lane of the
//! previous block. Shares are applied like weights: the terms are multiplied by the root of the
//! share, as by √w.
//!
//! At a border, a ray reads the border pixel twice. So the lines that rays read are copies whose
//! border pixels are repeated once, and a border pixel gets both shares. A line is copied or mixed
//! for only one part and one row of rays, just before its use. So the copy stays in the first-level
//! cache, like the sums of the part. An update by whole lines took 10 % longer.

use std::ops::Range;

use lumistack_simd::{Backend, Function, Kernel, Lanes};

use crate::aligned::Aligned;
use crate::buffers::{AHEAD, Buffers, GROUP, Group, SumParams, sum_views};
use crate::factor::Factor;
use crate::line::{Fetch, LineOf, LineStep, Outcome, StepFunctions};
use crate::plan::Plan;
use crate::rays::{LineRays, RowOfRays, Spare, Windows, rays_between};
use crate::step::{Rule, Sums};
use crate::vector::{self, load, store};

/// Number of columns of a line that are summed together, as one part.
const PART: usize = 128;

/// The functions of an update, for one instruction set and rule.
pub(crate) struct BetweenFunctions {
    lanes: usize,
    sums: Function<SumsBetween>,
    fetch: Function<Fetch>,
    step: StepFunctions,
}

impl BetweenFunctions {
    pub(crate) fn new(backend: Backend, step: StepFunctions) -> Self {
        Self {
            lanes: backend.lanes(),
            sums: backend.function::<SumsBetween>(),
            fetch: backend.function::<Fetch>(),
            step,
        }
    }
}

/// Buffers of one thread, reused from band to band.
pub(crate) struct Scratch {
    buffers: Buffers,
    rays: LineRays<'static>,
    spare: Spare,
    /// For each row of rays, the share of the row's sums that the next line gets.
    t: Vec<f32>,
    /// For every view column that has valid rays, the roots of the shares that pixels get from
    /// these rays.
    shares: Vec<ColumnShares>,
    /// Copies of the lines that a row of rays reads. If the rays read between two lines of a
    /// factor, the copy is a mixture of the two lines.
    windows: Windows,
    /// For each row of rays, the index at which its entries end in the list of rows to prefetch.
    ahead: Vec<usize>,
    /// For each factor k, the smallest and the largest difference over all rays. The difference of
    /// a ray is its column in factor k, minus its column in the factor under update.
    spread: Vec<[isize; 2]>,
    /// The sums for the pixels of a part of the line under update, `[quantity][column]`.
    low: Aligned,
    /// The shares of the rays' sums that the next line gets, `[quantity][x]`.
    high: Vec<f32>,
    /// The share of the rays' error Σ w e² that the next line gets.
    high_error: f64,
    /// For each listed view, the terms of the rays through the previous block of pixels: a_m =
    /// ∂L̃/∂(f_m/M), then βL and L̃. The order is `[row of rays and view][M + 2][lane]`.
    before: Aligned,
}

/// Roots of the shares that pixel x gets from rays of a view column. `first` is for the ray whose
/// first pixel is x, `second` for the ray whose second pixel is x.
struct ColumnShares {
    first: Vec<f32>,
    /// Empty if no ray reads a second pixel.
    second: Vec<f32>,
    /// Range of the pixels x that are the first pixels of valid rays.
    valid: Range<usize>,
}

impl Scratch {
    pub(crate) fn new(plan: &Plan, n: usize, rule: Rule) -> Self {
        let layout = &plan.maps[n].layout;
        let quantities = rule.sums().count(plan.frames);
        Self {
            buffers: Buffers::new(plan.frames),
            rays: LineRays::default(),
            spare: Spare::default(),
            t: Vec::new(),
            shares: shares(plan, n),
            windows: Windows::new(plan),
            ahead: Vec::new(),
            spread: spread(plan, n),
            low: Aligned::filled(0.0, quantities * PART),
            high: vec![0.0; quantities * layout.stride],
            high_error: 0.0,
            before: Aligned::default(),
        }
    }
}

/// Returns, for each factor k, the smallest and the largest difference over all rays. The
/// difference of a ray is its column in factor k, minus its column in factor `n`.
fn spread(plan: &Plan, n: usize) -> Vec<[isize; 2]> {
    let distances = |k: usize| {
        let both = plan.maps[k].x.iter().zip(&plan.maps[n].x);
        both.filter_map(|(other, own)| Some(other.between?.0 - own.between?.0))
    };
    let of = |k: usize| [distances(k).min().unwrap_or(0), distances(k).max().unwrap_or(0)];
    (0..plan.maps.len()).map(of).collect()
}

/// Returns, for every view column that has valid rays, the roots of the shares that pixels get from
/// these rays.
fn shares(plan: &Plan, n: usize) -> Vec<ColumnShares> {
    let map = &plan.maps[n];
    let (pad, cols) = (map.layout.pad as isize, map.layout.cols());
    let mut all = Vec::new();
    for (x, runs) in map.x.iter().zip(&plan.runs) {
        let ([run], Some((by, t))) = (runs.as_slice(), x.between) else { continue };
        let valid = (run.start as isize + by)..(run.end as isize + by);
        let row = |moved: isize, share: f32, border: usize| -> Vec<f32> {
            let mut row = vec![0.0; map.layout.stride];
            for pixel in (0..cols).filter(|&pixel| valid.contains(&(pixel as isize + pad - moved))) {
                row[pixel + map.layout.pad] = if pixel == border && t != 0.0 { 1.0 } else { share.sqrt() };
            }
            row
        };
        all.push(ColumnShares {
            first: row(0, 1.0 - t, cols - 1),
            second: if t == 0.0 { Vec::new() } else { row(1, t, 0) },
            valid: valid.start as usize..valid.end as usize,
        });
    }
    all
}

/// Consecutive lines of one factor, to be updated in order.
pub(crate) struct BetweenBand<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) factors: &'a [Factor],
    pub(crate) functions: &'a BetweenFunctions,
    pub(crate) scratch: &'a mut Scratch,
    /// The line that was updated last; `None` before the first update. The rays between that line
    /// and the next line have already added their sums for the next line.
    pub(crate) before: Option<LineOf>,
}

impl BetweenBand<'_> {
    /// Sums the rays that read the line `at`, and steps the line's pixels.
    pub(crate) fn update(&mut self, at: LineOf, mut step: LineStep) -> Outcome {
        let needed = step.rule.sums();
        let follows = self.before.is_some_and(|before| before.channel == at.channel && before.line + 1 == at.line);
        // If this band did not update the previous line, sum the rays between the two lines again.
        if !follows {
            self.scratch.high.fill(0.0);
            self.scratch.high_error = 0.0;
            if at.line > 0 {
                self.add_rays(LineOf { line: at.line - 1, ..at }, needed, None);
            }
        }
        self.before = Some(at);
        self.add_rays(at, needed, Some(&mut step))
    }

    /// Sums the rays between a line and the next line, and steps the line. Without `step`, only the
    /// sums for the next line are kept.
    fn add_rays(&mut self, at: LineOf, needed: Sums, mut step: Option<&mut LineStep>) -> Outcome {
        let (plan, factors, functions) = (self.plan, self.factors, self.functions);
        let Scratch { buffers, rays, spare, t, shares, windows, ahead, spread, low, high, high_error, before } =
            &mut *self.scratch;
        let map = &plan.maps[at.factor];
        let (layout, lanes) = (&map.layout, functions.lanes);
        // list the rows of rays between the line and the next line
        spare.rows.clear();
        t.clear();
        for view_y in 0..plan.views[0] {
            for &(row, next) in map.rays_after_line(view_y, at.line) {
                spare.rows.push(RowOfRays { view_y, row: row as usize });
                t.push(next);
            }
        }
        if step.is_none() && t.iter().all(|&t| t == 0.0) {
            return Outcome::default();
        }
        let windows = windows.lines();
        let rows = spare.rows.clone();
        let list = rays_between(std::mem::take(rays), plan, factors, at, (spare, &windows), ahead);
        // the terms of the block before the first block are zeros
        let count = list.views.len() * (plan.frames + 2) * lumistack_simd::MAX_LANES;
        if before.len() < count {
            *before = Aligned::filled(0.0, count);
        }
        before[..count].fill(0.0);
        let params = SumParams { brightness: plan.target.brightness, sums: needed };
        let mut outcome = Outcome { error: std::mem::take(high_error), gain: 0.0 };
        // If a ray's first pixel is in the padding and its second pixel is pixel 0, begin one block
        // earlier.
        let outside = shares.iter().any(|column| !column.second.is_empty() && column.valid.start < layout.pad);
        let first = if outside { layout.pad - lanes } else { layout.pad };
        let end = layout.pad + layout.cols().next_multiple_of(lanes);
        for start in (first..end).step_by(PART) {
            let part = start..(start + PART).min(end);
            // begin with the sums that the rays between the previous line and this line have added
            for (high, low) in high.chunks_exact_mut(layout.stride).zip(low.chunks_exact_mut(PART)) {
                low[..part.len()].copy_from_slice(&high[part.clone()]);
                high[part.clone()].fill(0.0);
            }
            for (row, (&rays, &t)) in rows.iter().zip(&*t).enumerate() {
                for k in (0..factors.len()).filter(|&k| Windows::holds(plan, k, rays)) {
                    let [from, to] = spread[k];
                    let len = plan.maps[k].layout.stride as isize;
                    let columns = [part.start as isize + from, part.end as isize + to + 1].map(|x| x.clamp(0, len));
                    // SAFETY: only pointers to these values exist
                    unsafe {
                        Windows::mix(
                            windows(k),
                            plan,
                            (k, &factors[k]),
                            at.channel,
                            rays,
                            columns[0] as usize..columns[1] as usize,
                        );
                    }
                }
                let ahead = if row == 0 { 0 } else { ahead[row - 1] }..ahead[row];
                let part = PartBetween {
                    rays: &list,
                    shares,
                    first: row * shares.len(),
                    t,
                    ahead,
                    part: part.clone(),
                    params,
                    buffers,
                    low,
                    high,
                    stride: layout.stride,
                    before,
                };
                // SAFETY: all columns of the part lie within padded rows
                let squares = unsafe { (functions.sums)(part) };
                outcome.error += squares * f64::from(1.0 - t);
                *high_error += squares * f64::from(t);
            }
            let Some(step) = &mut step else { continue };
            for x in part.clone().step_by(lanes).filter(|&x| x >= layout.pad) {
                // SAFETY: the kernel has no requirements
                unsafe { (functions.fetch)((*step, &low[x - start..], PART, &mut buffers.block, x)) };
                step.finish_block(&functions.step, &mut buffers.block, x);
                outcome.gain += vector::sum_of(&buffers.block.gain[..lanes]);
            }
        }
        *rays = list.emptied();
        outcome
    }
}

/// One part of a line, with one row of rays between the line and the next line.
struct PartBetween<'a> {
    rays: &'a LineRays<'a>,
    shares: &'a [ColumnShares],
    /// Index of the row's first view in the list of rays.
    first: usize,
    /// The share of these rays' sums that the next line gets.
    t: f32,
    /// Range of this row's entries in the list of rows to prefetch.
    ahead: Range<usize>,
    /// Range of the part's columns x.
    part: Range<usize>,
    params: SumParams,
    buffers: &'a mut Buffers,
    low: &'a mut Aligned,
    high: &'a mut [f32],
    stride: usize,
    before: &'a mut Aligned,
}

/// Adds the terms of a row of rays to the sums of a part; returns Σ w e².
struct SumsBetween;

impl Kernel for SumsBetween {
    type Args<'a> = PartBetween<'a>;
    type Output = f64;

    #[inline(always)]
    unsafe fn run<V: Lanes>(at: PartBetween<'_>) -> f64 {
        let PartBetween { rays, shares, first, t, ahead, part, params, buffers, low, high, stride, before } = at;
        let frames = buffers.block.frames;
        let size = (frames + 2) * V::COUNT;
        // SAFETY: guaranteed by the caller
        unsafe {
            let mut squares = V::splat(0.0);
            for x in part.clone().step_by(V::COUNT) {
                rays.prefetch(ahead.clone(), x + AHEAD * V::COUNT);
                let mut group = Group { frames, views: 0, add: false };
                for (view, column) in shares.iter().enumerate() {
                    if column.valid.start < x + V::COUNT && x < column.valid.end + 1 {
                        // a view adds one or two entries to the group, which must have room for two
                        if group.views + 2 > GROUP {
                            sum_views::<V, false>(params.sums, buffers, &[], group);
                            group = Group { frames, views: 0, add: true };
                        }
                        let before = &mut before[(first + view) * size..][..size];
                        let to = (group.views, &mut *buffers, before);
                        let added = add_view::<V>(rays, (first + view, column), x, params, to);
                        group.views += added.0;
                        squares = squares.add(added.1);
                    }
                }
                sum_views::<V, false>(params.sums, buffers, &[], group);
                // divide the sums between the line and the next line
                let Buffers { block, .. } = &mut *buffers;
                let (low, high) = (&mut low[x - part.start..], &mut high[x..]);
                for m in 0..frames {
                    share::<V>(&block.residual, m, (low, &mut *high, stride), m, t);
                }
                let mut q = frames;
                for m in 0..frames {
                    if params.sums == Sums::Gram {
                        for k in m..frames {
                            share::<V>(&block.gram, m * frames + k, (low, &mut *high, stride), q, t);
                            q += 1;
                        }
                    } else {
                        share::<V>(&block.emitted, m, (low, &mut *high, stride), q, t);
                        q += 1;
                    }
                }
            }
            vector::sum(squares)
        }
    }
}

/// Adds the sum at index `at` of `from` to quantity `q` of two lines. The line under update gets
/// the fraction 1 − t of the sum, and the next line gets the fraction t.
#[inline(always)]
unsafe fn share<V: Lanes>(
    from: &[f32],
    at: usize,
    (low, high, stride): (&mut [f32], &mut [f32], usize),
    q: usize,
    t: f32,
) {
    // SAFETY: guaranteed by the caller
    unsafe {
        let sum = load::<V>(from, at * V::COUNT);
        let kept = load::<V>(low, q * PART);
        store(sum.mul_add(V::splat(1.0 - t), kept), low, q * PART);
        if t != 0.0 {
            let kept = load::<V>(high, q * stride);
            store(sum.mul_add(V::splat(t), kept), high, q * stride);
        }
    }
}

/// Buffers the terms of one view's rays, times the roots of their shares. The first entry is for
/// rays whose first pixel is in the block, the second for rays whose second pixel is in the block.
/// Returns the number of entries, and their Σ w (βL − L̃)² per lane.
#[inline(always)]
unsafe fn add_view<V: Lanes>(
    rays: &LineRays,
    (view, column): (usize, &ColumnShares),
    x: usize,
    params: SumParams,
    (to, buffers, before): (usize, &mut Buffers, &mut [f32]),
) -> (usize, V) {
    // SAFETY: guaranteed by the caller
    unsafe {
        let frames = buffers.block.frames;
        let reads = Reads { rays, view, x, fresh: x < column.valid.end };
        let between = !column.second.is_empty();
        let first = load::<V>(&column.first, x);
        let second = if between { load::<V>(&column.second, x) } else { first };
        // buffer the derivatives a_m, for as many frames as registers hold, and sum L̃
        let (mut emitted, mut m) = (V::splat(0.0), 0);
        while m < frames {
            let target =
                Buffered { to, between, first, second, frames, products: &mut buffers.products, before: &mut *before };
            (emitted, m) = match frames - m {
                1 => (reads.frames::<V, 1>(m, emitted, target), m + 1),
                2 => (reads.frames::<V, 2>(m, emitted, target), m + 2),
                3..=5 => (reads.frames::<V, 3>(m, emitted, target), m + 3),
                _ => (reads.frames::<V, 6>(m, emitted, target), m + 6),
            };
        }
        // βL and L̃ stay 0 if no ray has its first pixel in the block
        let (mut wanted, ratio) = (V::splat(0.0), params.sums == Sums::Ratio);
        if reads.fresh {
            emitted = emitted.mul(V::splat(1.0 / frames as f32));
            wanted = crate::buffers::wanted::<V>(&rays.targets[view], x, params);
            if let Some(weights) = rays.views[view].root_weights() {
                wanted = wanted.mul(V::load(weights.at::<V>(x)));
            }
        }
        let error = put::<V>(buffers, to, ratio, wanted, emitted, first);
        let squares = error.mul(error);
        if !between {
            return (1, squares);
        }
        // rays whose second pixel is in the block have the same terms, one lane further
        let (wanted_at, emitted_at) = (frames * V::COUNT, (frames + 1) * V::COUNT);
        let moved_wanted = wanted.moved_up(load::<V>(before, wanted_at));
        let moved_emitted = emitted.moved_up(load::<V>(before, emitted_at));
        store(wanted, before, wanted_at);
        store(emitted, before, emitted_at);
        let error = put::<V>(buffers, to + 1, ratio, moved_wanted, moved_emitted, second);
        (2, error.mul_add(error, squares))
    }
}

/// Stores the error e = βL − L̃ (βL itself for the paper's rule) and L̃ in the buffers, times the
/// root of the share. Returns e times that root.
#[inline(always)]
unsafe fn put<V: Lanes>(buffers: &mut Buffers, to: usize, ratio: bool, wanted: V, emitted: V, share: V) -> V {
    // SAFETY: guaranteed by the caller
    unsafe {
        let (wanted, emitted) = (wanted.mul(share), emitted.mul(share));
        let error = wanted.sub(emitted);
        store(if ratio { wanted } else { error }, &mut buffers.errors, to * V::COUNT);
        store(emitted, &mut buffers.emitted, to * V::COUNT);
        error
    }
}

/// The rays of one view that read the pixels of a block.
struct Reads<'a> {
    rays: &'a LineRays<'a>,
    view: usize,
    x: usize,
    /// False if no ray reads a pixel of the block as its first pixel.
    fresh: bool,
}

/// Position of a view's derivatives a_m in the buffers, and the roots of the shares that multiply
/// them.
struct Buffered<'a, V> {
    to: usize,
    between: bool,
    first: V,
    second: V,
    frames: usize,
    products: &'a mut [f32],
    before: &'a mut [f32],
}

impl Reads<'_> {
    /// Computes a_m = ∂L̃/∂(f_m/M) for the frames m..m + R, and buffers it, times the roots of the
    /// shares. Returns `emitted` plus Σ a_m f_m over these frames.
    #[inline(always)]
    unsafe fn frames<V: Lanes, const R: usize>(&self, m: usize, mut emitted: V, buffered: Buffered<V>) -> V {
        let Buffered { to, between, first, second, frames, products, before } = buffered;
        let (rays, view, x) = (self.rays, self.view, self.x);
        // SAFETY: guaranteed by the caller
        unsafe {
            // a_m is the product of √w and the other factors' values; L̃ also needs the values of
            // the factor under update
            let mut a = [V::splat(0.0); R];
            if self.fresh {
                let fractions = &rays.fractions[view * (rays.others_per_view + 1)..][..rays.others_per_view + 1];
                let weights = rays.views[view].root_weights();
                a = [if let Some(weights) = weights { V::load(weights.at::<V>(x)) } else { V::splat(1.0) }; R];
                for k in 0..rays.others_per_view {
                    let (stride, t) = (rays.strides[k], fractions[k]);
                    let from = rays.others[view * rays.others_per_view + k].at::<V>(x).wrapping_add(m * stride);
                    if t == 0.0 {
                        for i in 0..R {
                            a[i] = a[i].mul(V::load(from.wrapping_add(i * stride)));
                        }
                    } else {
                        for i in 0..R {
                            a[i] = a[i].mul(between_pixels(from.wrapping_add(i * stride), t));
                        }
                    }
                }
                let (from, stride, t) = (rays.own[view].at::<V>(x), rays.own_stride, fractions[rays.others_per_view]);
                let from = from.wrapping_add(m * stride);
                if t == 0.0 {
                    for i in 0..R {
                        emitted = a[i].mul_add(V::load(from.wrapping_add(i * stride)), emitted);
                    }
                } else {
                    for i in 0..R {
                        emitted = a[i].mul_add(between_pixels(from.wrapping_add(i * stride), t), emitted);
                    }
                }
            }
            // buffer a_m for the rays' first pixels, and moved by one lane for their second pixels
            for i in 0..R {
                store(a[i].mul(first), products, (to * frames + m + i) * V::COUNT);
                if between {
                    let moved = a[i].moved_up(load::<V>(before, (m + i) * V::COUNT));
                    store(moved.mul(second), products, ((to + 1) * frames + m + i) * V::COUNT);
                    store(a[i], before, (m + i) * V::COUNT);
                }
            }
            emitted
        }
    }
}

/// Interpolates, at the fraction `t`, between two vectors: the values from `from` on, and the
/// values one pixel further.
#[inline(always)]
unsafe fn between_pixels<V: Lanes>(from: *const f32, t: f32) -> V {
    // SAFETY: guaranteed by the caller
    unsafe {
        let value = V::load(from);
        V::load(from.wrapping_add(1)).sub(value).mul_add(V::splat(t), value)
    }
}
