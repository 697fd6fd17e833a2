//! One line of one factor, the general way: any tables, any number of frames and factors.
//!
//! For every field row whose rays meet the line and every view column: expand the other factors along the row into P_m (M rows), emit
//! L̃ = (1/M) Σ_m P_m f_m, and add w βL P_m and w L̃ P_m to the line's accumulators. All loops run along columns.

use std::ops::Range;

use crate::factor::{Factor, Layout, PAD};
use crate::lanes::InstructionSet;
use crate::plan::{ColumnTaps, LineTap, Plan};

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// P_m, `[frame][column of the run]`.
    product: Vec<f32>,
    /// One factor's values along a run.
    values: Vec<f32>,
    /// L̃ along a run.
    emitted: Vec<f32>,
    /// w βL and w L̃ along a run, times the line's weight.
    weighted: [Vec<f32>; 2],
    /// Numerators and denominators, `[frame][x]`. Lines whose pixels get few rays each (constant shift) add in f32.
    sums: [Vec<f32>; 2],
    /// The same for lines whose pixels may get very many rays.
    long_sums: [Vec<f64>; 2],
}

impl Scratch {
    /// For lines of factor `n`.
    pub(crate) fn new(plan: &Plan, n: usize) -> Self {
        let layout = &plan.maps[n].layout;
        let row = || vec![0.0; plan.cols];
        Self {
            product: vec![0.0; layout.frames * plan.cols],
            values: row(),
            emitted: row(),
            weighted: [row(), row()],
            sums: [vec![0.0; layout.line_len()], vec![0.0; layout.line_len()]],
            long_sums: [vec![0.0; layout.line_len()], vec![0.0; layout.line_len()]],
        }
    }
}

/// Error sums of some rays.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ErrorSum {
    /// Σ w (βL − L̃)², weights relative to the largest.
    pub(crate) weighted: f64,
    /// Σ (βL − L̃)² over rays with w > 0.
    pub(crate) plain: f64,
}

/// Multiplicative update of one line of factor `n`: reads `factors`, writes `next` (the line, all frames).
pub(crate) fn update_line(
    set: InstructionSet,
    plan: &Plan,
    factors: &[Factor],
    at: LineOf,
    floor: f32,
    next: &mut [f32],
    scratch: &mut Scratch,
) {
    match set {
        InstructionSet::Portable => update_line_inline(plan, factors, at, floor, next, scratch),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the set was detected
        InstructionSet::Avx2 => unsafe { update_line_avx2(plan, factors, at, floor, next, scratch) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the set was detected
        InstructionSet::Avx512 => unsafe { update_line_avx512(plan, factors, at, floor, next, scratch) },
    }
}

/// Errors of one field row in one channel, over all views.
pub(crate) fn row_error(
    set: InstructionSet,
    plan: &Plan,
    factors: &[Factor],
    channel: usize,
    row: usize,
    scratch: &mut Scratch,
) -> ErrorSum {
    match set {
        InstructionSet::Portable => row_error_inline(plan, factors, channel, row, scratch),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the set was detected
        InstructionSet::Avx2 => unsafe { row_error_avx2(plan, factors, channel, row, scratch) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the set was detected
        InstructionSet::Avx512 => unsafe { row_error_avx512(plan, factors, channel, row, scratch) },
    }
}

/// Which line is updated.
#[derive(Clone, Copy)]
pub(crate) struct LineOf {
    pub(crate) factor: usize,
    pub(crate) channel: usize,
    pub(crate) line: usize,
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn update_line_avx2(p: &Plan, f: &[Factor], at: LineOf, floor: f32, next: &mut [f32], s: &mut Scratch) {
    update_line_inline(p, f, at, floor, next, s);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
fn update_line_avx512(p: &Plan, f: &[Factor], at: LineOf, floor: f32, next: &mut [f32], s: &mut Scratch) {
    update_line_inline(p, f, at, floor, next, s);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn row_error_avx2(p: &Plan, f: &[Factor], channel: usize, row: usize, s: &mut Scratch) -> ErrorSum {
    row_error_inline(p, f, channel, row, s)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
fn row_error_avx512(p: &Plan, f: &[Factor], channel: usize, row: usize, s: &mut Scratch) -> ErrorSum {
    row_error_inline(p, f, channel, row, s)
}

#[inline(always)]
fn update_line_inline(
    plan: &Plan,
    factors: &[Factor],
    at: LineOf,
    floor: f32,
    next: &mut [f32],
    scratch: &mut Scratch,
) {
    let map = &plan.maps[at.factor];
    let shifted = map.x.iter().zip(&plan.runs).all(|(x, runs)| x.shift.is_some() || runs.is_empty());
    if shifted {
        scratch.sums.iter_mut().for_each(|sums| sums.fill(0.0));
    } else {
        scratch.long_sums.iter_mut().for_each(|sums| sums.fill(0.0));
    }
    for view_y in 0..plan.views[0] {
        for &(row, line_weight) in map.rays_of_line(view_y, at.line) {
            for view_x in 0..plan.views[1] {
                for run in &plan.runs[view_x] {
                    let rays = Rays { channel: at.channel, view: [view_y, view_x], row: row as usize, run };
                    expand_product(plan, factors, Some(at.factor), &rays, scratch);
                    emit(plan, factors, Some(at.factor), &rays, scratch);
                    weigh(plan, &rays, line_weight, scratch);
                    if shifted {
                        add_shifted(plan, at.factor, &rays, scratch);
                    } else {
                        add_indexed(plan, at.factor, &rays, scratch);
                    }
                }
            }
        }
    }
    if shifted {
        quotient(&map.layout, next, &scratch.sums, floor);
    } else {
        let [numerators, denominators] = &scratch.long_sums;
        for frame in 0..map.layout.frames {
            for i in map.layout.columns(frame) {
                // what is 0 in f32 counts as 0
                if denominators[i] > f64::from(f32::MIN_POSITIVE) {
                    next[i] = (next[i] * (numerators[i] / denominators[i]) as f32).max(floor).min(1.0);
                }
            }
        }
    }
}

/// f ← clamp(f · numerator/denominator) for all columns of a line; left alone where the denominator is 0. The padding stays.
#[inline(always)]
pub(crate) fn quotient(layout: &Layout, values: &mut [f32], sums: &[Vec<f32>; 2], floor: f32) {
    for frame in 0..layout.frames {
        let columns = layout.columns(frame);
        let sums = sums[0][columns.clone()].iter().zip(&sums[1][columns.clone()]);
        for (value, (&numerator, &denominator)) in values[columns].iter_mut().zip(sums) {
            let updated = (*value * (numerator / denominator)).max(floor).min(1.0);
            *value = if denominator > f32::MIN_POSITIVE { updated } else { *value };
        }
    }
}

#[inline(always)]
fn row_error_inline(plan: &Plan, factors: &[Factor], channel: usize, row: usize, scratch: &mut Scratch) -> ErrorSum {
    let mut total = ErrorSum::default();
    for view_y in (0..plan.views[0]).filter(|&view_y| plan.valid_rows[view_y][row]) {
        for view_x in 0..plan.views[1] {
            for run in &plan.runs[view_x] {
                let rays = Rays { channel, view: [view_y, view_x], row, run };
                expand_product(plan, factors, None, &rays, scratch);
                emit(plan, factors, None, &rays, scratch);
                let sum = squared_error(plan, &rays, &scratch.emitted);
                total.weighted += sum.weighted;
                total.plain += sum.plain;
            }
        }
    }
    total
}

/// Rays of one view through a part of one field row.
struct Rays<'a> {
    channel: usize,
    view: [usize; 2],
    row: usize,
    run: &'a Range<usize>,
}

impl Rays<'_> {
    #[inline(always)]
    fn target<'p>(&self, plan: &'p Plan) -> (&'p [f32], Option<&'p [f32]>) {
        let view = plan.view(self.view[0], self.view[1]);
        let part = PAD + self.run.start..PAD + self.run.end;
        (
            &plan.target.row(self.channel, view, self.row)[part.clone()],
            plan.target.weights(view, self.row).map(|weights| &weights[part]),
        )
    }
}

/// P_m = Π_{k ≠ skip} of the factors' values along the rays.
#[inline(always)]
fn expand_product(plan: &Plan, factors: &[Factor], skip: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let frames = plan.maps[0].layout.frames;
    let len = rays.run.len();
    let mut first = true;
    for k in (0..factors.len()).filter(|&k| Some(k) != skip) {
        for frame in 0..frames {
            let product = &mut scratch.product[frame * plan.cols..][..len];
            if first {
                expand(plan, factors, k, frame, rays, product, |product, value| *product = value);
            } else {
                expand(plan, factors, k, frame, rays, product, |product, value| *product *= value);
            }
        }
        first = false;
    }
    if first {
        scratch.product.fill(1.0);
    }
}

/// L̃ = (1/M) Σ_m P_m f_m with the values of factor `own`, or (1/M) Σ_m P_m where the product holds every factor.
#[inline(always)]
fn emit(plan: &Plan, factors: &[Factor], own: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let frames = plan.maps[0].layout.frames;
    let len = rays.run.len();
    let emitted = &mut scratch.emitted[..len];
    emitted.fill(0.0);
    for frame in 0..frames {
        let product = &scratch.product[frame * plan.cols..][..len];
        if let Some(own) = own {
            let values = &mut scratch.values[..len];
            expand(plan, factors, own, frame, rays, values, |to, value| *to = value);
            for ((sum, &p), &f) in emitted.iter_mut().zip(product).zip(&*values) {
                *sum += p * f;
            }
        } else {
            emitted.iter_mut().zip(product).for_each(|(sum, &p)| *sum += p);
        }
    }
    let scale = 1.0 / frames as f32;
    emitted.iter_mut().for_each(|sum| *sum *= scale);
}

/// One factor's values along the rays, handed to `put` one by one.
#[inline(always)]
fn expand(
    plan: &Plan,
    factors: &[Factor],
    k: usize,
    frame: usize,
    rays: &Rays,
    to: &mut [f32],
    put: impl Fn(&mut f32, f32),
) {
    let map = &plan.maps[k];
    let x: &ColumnTaps = &map.x[rays.view[1]];
    let LineTap { first, second, t } = map.y[rays.view[0]][rays.row];
    let upper = factors[k].row(rays.channel, first as usize, frame);
    if t == 0.0 {
        if let Some(shift) = x.shift {
            let from = &upper[(rays.run.start as isize + shift) as usize..][..to.len()];
            to.iter_mut().zip(from).for_each(|(to, &value)| put(to, value));
        } else if x.exact {
            let indices = &x.first[rays.run.clone()];
            to.iter_mut().zip(indices).for_each(|(to, &i)| put(to, upper[i as usize]));
        } else {
            mix(x, rays.run, to, put, |i| upper[i]);
        }
    } else {
        let lower = factors[k].row(rays.channel, second as usize, frame);
        mix(x, rays.run, to, put, |i| upper[i] + t * (lower[i] - upper[i]));
    }
}

/// Linear interpolation along columns of what `value` gives.
#[inline(always)]
fn mix(x: &ColumnTaps, run: &Range<usize>, to: &mut [f32], put: impl Fn(&mut f32, f32), value: impl Fn(usize) -> f32) {
    let taps = x.first[run.clone()].iter().zip(&x.second[run.clone()]).zip(&x.t[run.clone()]);
    for (to, ((&first, &second), &t)) in to.iter_mut().zip(taps) {
        let (left, right) = (value(first as usize), value(second as usize));
        put(to, left + t * (right - left));
    }
}

/// w βL and w L̃, times the weight of the line in these rays.
#[inline(always)]
fn weigh(plan: &Plan, rays: &Rays, line_weight: f32, scratch: &mut Scratch) {
    let len = rays.run.len();
    let (target, weights) = rays.target(plan);
    let [wanted, emitted] = &mut scratch.weighted;
    let pairs = [(&mut wanted[..len], target), (&mut emitted[..len], &scratch.emitted[..len])];
    for (to, from) in pairs {
        match weights {
            None => to.iter_mut().zip(from).for_each(|(to, &value)| *to = line_weight * value),
            Some(weights) => {
                to.iter_mut().zip(from).zip(weights).for_each(|((to, &value), &w)| *to = line_weight * w * value);
            }
        }
    }
}

/// Adds to the accumulators of a line whose columns are the rays' columns, shifted.
#[inline(always)]
fn add_shifted(plan: &Plan, n: usize, rays: &Rays, scratch: &mut Scratch) {
    let map = &plan.maps[n];
    let Some(shift) = map.x[rays.view[1]].shift else { return };
    let (len, start) = (rays.run.len(), (rays.run.start as isize + shift) as usize);
    for frame in 0..map.layout.frames {
        let product = &scratch.product[frame * plan.cols..][..len];
        for (sums, weighted) in scratch.sums.iter_mut().zip(&scratch.weighted) {
            let sums = &mut sums[frame * map.layout.stride + start..][..len];
            for ((sum, &p), &value) in sums.iter_mut().zip(product).zip(weighted) {
                *sum += p * value;
            }
        }
    }
}

/// Adds to the accumulators of a line through tables; rays that miss it add to the padding, which is never read.
#[inline(always)]
fn add_indexed(plan: &Plan, n: usize, rays: &Rays, scratch: &mut Scratch) {
    let map = &plan.maps[n];
    let x = &map.x[rays.view[1]];
    let len = rays.run.len();
    let (first, second, t) = (&x.first[rays.run.clone()], &x.second[rays.run.clone()], &x.t[rays.run.clone()]);
    for frame in 0..map.layout.frames {
        let product = &scratch.product[frame * plan.cols..][..len];
        for (sums, weighted) in scratch.long_sums.iter_mut().zip(&scratch.weighted) {
            let sums = &mut sums[frame * map.layout.stride..][..map.layout.stride];
            for i in 0..len {
                let value = f64::from(product[i]) * f64::from(weighted[i]);
                if x.exact {
                    sums[first[i] as usize] += value;
                } else {
                    let t = f64::from(t[i]);
                    sums[first[i] as usize] += (1.0 - t) * value;
                    sums[second[i] as usize] += t * value;
                }
            }
        }
    }
}

/// Squared errors of a run, added in eight interleaved `f64` sums.
#[inline(always)]
fn squared_error(plan: &Plan, rays: &Rays, emitted: &[f32]) -> ErrorSum {
    const LANES: usize = 8;
    let (target, weights) = rays.target(plan);
    let emitted = &emitted[..target.len()];
    let square = |i: usize| {
        let difference = f64::from(target[i] - emitted[i]);
        difference * difference
    };
    let whole = target.len() / LANES * LANES;
    let (mut weighted, mut plain) = ([0.0; LANES], [0.0; LANES]);
    let add = |i: usize, lane: usize, weighted: &mut [f64; LANES], plain: &mut [f64; LANES]| {
        let square = square(i);
        match weights {
            None => plain[lane] += square,
            Some(weights) => {
                weighted[lane] += f64::from(weights[i]) * square;
                plain[lane] += if weights[i] > 0.0 { square } else { 0.0 };
            }
        }
    };
    for start in (0..whole).step_by(LANES) {
        for lane in 0..LANES {
            add(start + lane, lane, &mut weighted, &mut plain);
        }
    }
    for i in whole..target.len() {
        add(i, i - whole, &mut weighted, &mut plain);
    }
    let plain = plain.iter().sum();
    ErrorSum { weighted: if weights.is_some() { weighted.iter().sum() } else { plain }, plain }
}
