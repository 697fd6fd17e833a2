//! One line of one factor, the fast way: every ray reads one pixel per factor, at its own column plus a constant of the view.
//!
//! That is the paper's case: oblique views, equal pitch, nearest sampling. The simple version, for line j of layer n:
//!
//! ```text
//! for every view (a_y, a_x), every field row r that meets line j, every column x of the line, with c = x − shift_n:
//!     P_m = Π_{k≠n} f_k[line of r][m][c + shift_k]      L̃ = (1/M) Σ_m P_m f_n[j][m][x]
//!     num[m][x] += w βL[a][r][c] P_m                    den[m][x] += w L̃ P_m
//! f_n[j][m][x] ← clamp(f num/den)
//! ```
//!
//! Departures: (1) columns go in blocks of one vector; P, f, num and den of all M frames stay in registers, so M is a compile-time constant.
//! (2) a_y is outermost, then blocks, then a_x: the view columns of one view row read the same lines at neighbouring places (first-level
//! cache), and the accumulators move to memory and back once per view row. Blocks outermost with all views inside read too many
//! separate lines at a time for the hardware prefetcher. (3) Blocks that the border of the valid rays crosses are masked; padding makes their loads legal.

use std::ops::Range;

use crate::expand::Rays;
use crate::factor::{Factor, PAD};
use crate::lanes::{InstructionSet, Lanes, Portable};
use crate::plan::Plan;
use crate::rows::{LineOf, quotient};

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// Numerators and denominators, `[frame][x]`.
    sums: [Vec<f32>; 2],
}

impl Scratch {
    /// For lines of factor `n`.
    pub(crate) fn new(plan: &Plan, n: usize) -> Self {
        let len = plan.maps[n].layout.line_len();
        Self { sums: [vec![0.0; len], vec![0.0; len]] }
    }
}

/// Whether the tables are constant shifts and the number of frames is one of the compiled ones.
pub(crate) fn is_possible(plan: &Plan) -> bool {
    let frames = plan.maps[0].layout.frames;
    (FRAMES.contains(&frames)) && plan.maps.iter().all(|map| map.is_shifted(&plan.runs))
}

macro_rules! for_each_frame_count {
    ($($frames:literal)*) => {
        /// Numbers of frames M with a kernel of their own.
        const FRAMES: &[usize] = &[$($frames),*];

        #[inline(always)]
        unsafe fn run<V: Lanes>(line: &mut Line, views: &[View], others: &[Other]) {
            // SAFETY: passed on from the caller
            unsafe {
                match (line.frames, line.weighted) {
                    $(
                        ($frames, false) => add_views::<V, $frames, false>(line, views, others),
                        ($frames, true) => add_views::<V, $frames, true>(line, views, others),
                    )*
                    _ => unreachable!("is_possible admits compiled frame counts only"),
                }
            }
        }
    };
}

for_each_frame_count!(1 2 3 4 5 6 7 8 10 12);

/// Multiplicative update in place of one line, all frames; needs [`is_possible`]. The line's own factor in `factors` is not read.
pub(crate) fn update_line(
    set: InstructionSet,
    plan: &Plan,
    factors: &[Factor],
    at: LineOf,
    floor: f32,
    values: &mut [f32],
    scratch: &mut Scratch,
) {
    let map = &plan.maps[at.factor];
    let layout = &map.layout;
    scratch.sums.iter_mut().for_each(|sums| sums.fill(0.0));
    let mut views: Vec<View> = Vec::with_capacity(plan.views[1]);
    let mut others: Vec<Other> = Vec::with_capacity(plan.views[1] * factors.len());
    for view_y in 0..plan.views[0] {
        for &(row, _) in map.rays_of_line(view_y, at.line) {
            views.clear();
            others.clear();
            for view_x in 0..plan.views[1] {
                let ([run], Some(own)) = (plan.runs[view_x].as_slice(), map.x[view_x].shift) else { continue };
                let view = plan.view(view_y, view_x);
                views.push(View {
                    valid: (run.start as isize + own) as usize..(run.end as isize + own) as usize,
                    target: plan.target.row(at.channel, view, row as usize),
                    weights: plan.target.weights(view, row as usize),
                    target_offset: PAD as isize - own,
                });
                for (k, factor) in factors.iter().enumerate().filter(|(k, _)| *k != at.factor) {
                    let other = &plan.maps[k];
                    let Some(shift) = other.x[view_x].shift else { continue };
                    let line = other.y[view_y][row as usize].first as usize;
                    others.push(Other {
                        values: factor.line(at.channel, line),
                        stride: other.layout.stride,
                        offset: shift - own,
                    });
                }
            }
            let mut line = Line {
                frames: layout.frames,
                stride: layout.stride,
                columns: layout.pad..layout.pad + layout.cols(),
                weighted: plan.target.is_weighted(),
                values,
                sums: &mut scratch.sums,
            };
            debug_assert_eq!(others.len(), views.len() * (factors.len() - 1));
            // SAFETY: the set was detected; offsets follow from the plan, whose padding covers every block that touches a valid ray
            unsafe {
                match set {
                    InstructionSet::Portable => run::<Portable>(&mut line, &views, &others),
                    #[cfg(target_arch = "x86_64")]
                    InstructionSet::Avx2 => run_avx2(&mut line, &views, &others),
                    #[cfg(target_arch = "x86_64")]
                    InstructionSet::Avx512 => run_avx512(&mut line, &views, &others),
                }
            }
        }
    }
    quotient(layout, values, &scratch.sums, floor);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn run_avx2(line: &mut Line, views: &[View], others: &[Other]) {
    // SAFETY: passed on from the caller
    unsafe { run::<crate::lanes::x86::Avx2>(line, views, others) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
unsafe fn run_avx512(line: &mut Line, views: &[View], others: &[Other]) {
    // SAFETY: passed on from the caller
    unsafe { run::<crate::lanes::x86::Avx512>(line, views, others) }
}

/// The line that is updated; x counts in its padded storage.
struct Line<'a> {
    frames: usize,
    stride: usize,
    columns: Range<usize>,
    weighted: bool,
    values: &'a [f32],
    /// Numerators and denominators.
    sums: &'a mut [Vec<f32>; 2],
}

/// One view's rays through the line.
struct View<'a> {
    /// x of the rays that count.
    valid: Range<usize>,
    target: &'a [f32],
    weights: Option<&'a [f32]>,
    /// Index in `target` and `weights` minus x.
    target_offset: isize,
}

/// One other factor's line as one view's rays meet it; all factors of a view lie together.
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

/// Adds the rays of the views of one view row and field row to the line's accumulators.
///
/// # Safety
/// The machine has `V`'s instruction set; for every block of `V::COUNT` columns that overlaps a view's valid range, x + offset lies
/// within the rows of `others` and `target`.
#[inline(always)]
unsafe fn add_views<V: Lanes, const M: usize, const WEIGHTED: bool>(line: &mut Line, views: &[View], others: &[Other]) {
    if views.is_empty() {
        return;
    }
    let per_view = others.len() / views.len();
    let first = views.iter().map(|view| view.valid.start).min().unwrap_or(0).max(line.columns.start);
    let first = line.columns.start + (first - line.columns.start) / V::COUNT * V::COUNT;
    let end = views.iter().map(|view| view.valid.end).max().unwrap_or(0).min(line.columns.end);
    // SAFETY: see above; accumulators and values are padded to whole blocks
    unsafe {
        let mean = V::splat(1.0 / M as f32);
        let mut x = first;
        while x < end {
            let own: [V; M] = std::array::from_fn(|m| load::<V>(line.values, m * line.stride + x).mul(mean));
            let mut numerators: [V; M] = std::array::from_fn(|m| load::<V>(&line.sums[0], m * line.stride + x));
            let mut denominators: [V; M] = std::array::from_fn(|m| load::<V>(&line.sums[1], m * line.stride + x));
            for (v, view) in views.iter().enumerate() {
                let (low, high) = (view.valid.start.max(x), view.valid.end.min(x + V::COUNT));
                if low >= high {
                    continue;
                }
                let product = product::<V, M>(&others[v * per_view..(v + 1) * per_view], x);
                let mut emitted = product[0].mul(own[0]);
                for m in 1..M {
                    emitted = product[m].mul_add(own[m], emitted);
                }
                let at = (x as isize + view.target_offset) as usize;
                let mut wanted = load::<V>(view.target, at);
                V::prefetch(view.target.as_ptr().wrapping_add(at + PREFETCH));
                if WEIGHTED && let Some(weights) = view.weights {
                    let weights = load::<V>(weights, at);
                    wanted = wanted.mul(weights);
                    emitted = emitted.mul(weights);
                }
                if high - low < V::COUNT {
                    let mask = mask::<V>(low - x, high - x);
                    wanted = wanted.mul(mask);
                    emitted = emitted.mul(mask);
                }
                for m in 0..M {
                    numerators[m] = product[m].mul_add(wanted, numerators[m]);
                    denominators[m] = product[m].mul_add(emitted, denominators[m]);
                }
            }
            for m in 0..M {
                store(numerators[m], &mut line.sums[0], m * line.stride + x);
                store(denominators[m], &mut line.sums[1], m * line.stride + x);
            }
            x += V::COUNT;
        }
    }
}

/// L̃ = (1/M) Σ_m Π_k f_k along rays, for any number of frames.
///
/// # Safety
/// The machine has `V`'s instruction set, and [`is_possible`] holds; `emitted` has room for the run and a vector.
#[inline(always)]
pub(crate) unsafe fn emit<V: Lanes>(plan: &Plan, factors: &[Factor], rays: &Rays, emitted: &mut [f32]) {
    let frames = plan.maps[0].layout.frames;
    let start = rays.run.start;
    let lines: Vec<Other> = plan
        .maps
        .iter()
        .zip(factors)
        .map(|(map, factor)| Other {
            values: factor.line(rays.channel, map.y[rays.view[0]][rays.row].first as usize),
            stride: map.layout.stride,
            offset: map.x[rays.view[1]].shift.unwrap_or(0),
        })
        .collect();
    let Some((first, rest)) = lines.split_first() else { return };
    // SAFETY: padding covers every block that touches a valid ray
    unsafe {
        let mean = V::splat(1.0 / frames as f32);
        for col in (start..rays.run.end).step_by(V::COUNT) {
            let mut sum = V::splat(0.0);
            for frame in 0..frames {
                let mut product = load::<V>(first.values, first.at(col) + frame * first.stride).mul(mean);
                for other in rest {
                    product = product.mul(load::<V>(other.values, other.at(col) + frame * other.stride));
                }
                sum = sum.add(product);
            }
            store(sum, emitted, col - start);
        }
    }
}

/// How many values ahead of a row of the target are asked for.
const PREFETCH: usize = 64;

/// P_m of a block.
#[inline(always)]
unsafe fn product<V: Lanes, const M: usize>(others: &[Other], x: usize) -> [V; M] {
    // SAFETY: the caller's offsets stay within the rows
    unsafe {
        let Some((first, rest)) = others.split_first() else { return [V::splat(1.0); M] };
        let at = first.at(x);
        let mut product: [V; M] = std::array::from_fn(|m| load::<V>(first.values, m * first.stride + at));
        for other in rest {
            let at = other.at(x);
            for m in 0..M {
                product[m] = product[m].mul(load::<V>(other.values, m * other.stride + at));
            }
        }
        product
    }
}

/// 1 in lanes low..high, else 0.
#[inline(always)]
unsafe fn mask<V: Lanes>(low: usize, high: usize) -> V {
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
