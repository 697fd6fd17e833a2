//! One line of one factor, the general way: any tables, any number of frames and factors.
//!
//! For every field row whose rays meet the line and every view column: expand the other factors along the row into P_m (M rows), emit
//! L̃ = (1/M) Σ_m P_m f_m, and add w βL P_m and w L̃ P_m to the line's accumulators. All loops run along columns.

use std::ops::{AddAssign, Mul};

use crate::expand::{Rays, emit, expand_product, pieces_within};
use crate::factor::{Factor, Layout, PAD};
use crate::lanes::{InstructionSet, Lanes, Portable};
use crate::plan::{Access, Plan};
use crate::shifted;

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// P_m, `[frame][column of the run]`.
    pub(crate) product: Vec<f32>,
    /// One factor's values along a run.
    pub(crate) values: Vec<f32>,
    /// L̃ along a run.
    pub(crate) emitted: Vec<f32>,
    /// w βL and w L̃ along a run, times the line's weight.
    weighted: [Vec<f32>; 2],
    /// Numerators and denominators, `[frame][x]`.
    sums: [Vec<f32>; 2],
    /// The same where pixels may get very many rays.
    long_sums: [Vec<f64>; 2],
}

impl Scratch {
    /// For lines of factor `n`.
    pub(crate) fn new(plan: &Plan, n: usize) -> Self {
        let layout = &plan.maps[n].layout;
        let row = || vec![0.0; plan.cols + PAD];
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
pub(crate) fn row_error(set: InstructionSet, plan: &Plan, factors: &[Factor], at: RowOf, s: &mut Scratch) -> ErrorSum {
    match set {
        InstructionSet::Portable => row_error_inline::<Portable>(plan, factors, at, s),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the set was detected
        InstructionSet::Avx2 => unsafe { row_error_avx2(plan, factors, at, s) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the set was detected
        InstructionSet::Avx512 => unsafe { row_error_avx512(plan, factors, at, s) },
    }
}

/// Which field row is compared.
#[derive(Clone, Copy)]
pub(crate) struct RowOf {
    pub(crate) channel: usize,
    pub(crate) row: usize,
    /// Whether the fast kernel may be used; see [`shifted::is_possible`].
    pub(crate) fast: bool,
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
fn row_error_avx2(p: &Plan, f: &[Factor], at: RowOf, s: &mut Scratch) -> ErrorSum {
    row_error_inline::<crate::lanes::x86::Avx2>(p, f, at, s)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
fn row_error_avx512(p: &Plan, f: &[Factor], at: RowOf, s: &mut Scratch) -> ErrorSum {
    row_error_inline::<crate::lanes::x86::Avx512>(p, f, at, s)
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
    if map.short_sums {
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
                    let Scratch { product, weighted, sums, long_sums, .. } = &mut *scratch;
                    if map.short_sums {
                        add(plan, at.factor, &rays, product, weighted, sums);
                    } else {
                        add(plan, at.factor, &rays, product, weighted, long_sums);
                    }
                }
            }
        }
    }
    if map.short_sums {
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
fn row_error_inline<V: Lanes>(plan: &Plan, factors: &[Factor], at: RowOf, scratch: &mut Scratch) -> ErrorSum {
    let RowOf { channel, row, fast } = at;
    let mut total = ErrorSum::default();
    for view_y in (0..plan.views[0]).filter(|&view_y| plan.valid_rows[view_y][row]) {
        for view_x in 0..plan.views[1] {
            for run in &plan.runs[view_x] {
                let rays = Rays { channel, view: [view_y, view_x], row, run };
                if fast {
                    // SAFETY: the instruction set is this function's; `fast` says that the tables are constant shifts
                    unsafe { shifted::emit::<V>(plan, factors, &rays, &mut scratch.emitted) };
                } else {
                    expand_product(plan, factors, None, &rays, scratch);
                    emit(plan, factors, None, &rays, scratch);
                }
                let sum = squared_error(plan, &rays, &scratch.emitted);
                total.weighted += sum.weighted;
                total.plain += sum.plain;
            }
        }
    }
    total
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

/// Adds to a line's accumulators; rays that miss it add to the padding, which is never read.
#[inline(always)]
fn add<T>(plan: &Plan, n: usize, rays: &Rays, product: &[f32], weighted: &[Vec<f32>; 2], sums: &mut [Vec<T>; 2])
where
    T: Copy + From<f32> + AddAssign + Mul<Output = T>,
{
    let layout = &plan.maps[n].layout;
    let x = &plan.maps[n].x[rays.view[1]];
    for frame in 0..layout.frames {
        let product = &product[frame * plan.cols..][..rays.run.len()];
        for (sums, weighted) in sums.iter_mut().zip(weighted) {
            let sums = &mut sums[frame * layout.stride..][..layout.stride];
            for (cols, access) in pieces_within(x, rays.run) {
                let part = cols.start - rays.run.start..cols.end - rays.run.start;
                let values = product[part.clone()].iter().zip(&weighted[part]);
                let values = values.map(|(&p, &value)| T::from(p) * T::from(value));
                match access {
                    Access::Shift { by, t } => {
                        let start = (cols.start as isize + by) as usize;
                        let share = T::from(1.0 - t);
                        if t == 0.0 {
                            sums[start..].iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
                        } else {
                            sums[start..].iter_mut().zip(values.clone()).for_each(|(sum, value)| *sum += share * value);
                            let share = T::from(t);
                            sums[start + 1..].iter_mut().zip(values).for_each(|(sum, value)| *sum += share * value);
                        }
                    }
                    Access::Indexed => {
                        for (&i, value) in x.first[cols].iter().zip(values) {
                            sums[i as usize] += value;
                        }
                    }
                    Access::Mixed => {
                        for (col, value) in cols.zip(values) {
                            sums[x.first[col] as usize] += T::from(1.0 - x.t[col]) * value;
                            sums[x.second[col] as usize] += T::from(x.t[col]) * value;
                        }
                    }
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
    let (mut weighted, mut plain) = ([0.0; LANES], [0.0; LANES]);
    let starts = (0..target.len()).step_by(LANES);
    for ((target, emitted), start) in target.chunks(LANES).zip(emitted.chunks(LANES)).zip(starts) {
        let mut squares = [0.0; LANES];
        for (square, (&target, &emitted)) in squares.iter_mut().zip(target.iter().zip(emitted)) {
            let difference = f64::from(target - emitted);
            *square = difference * difference;
        }
        if let Some(weights) = weights {
            let weights = &weights[start..start + target.len()];
            for (lane, &w) in weights.iter().enumerate() {
                weighted[lane] += f64::from(w) * squares[lane];
                squares[lane] = if w > 0.0 { squares[lane] } else { 0.0 };
            }
        }
        plain.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
    }
    let plain = plain.iter().sum();
    ErrorSum { weighted: if weights.is_some() { weighted.iter().sum() } else { plain }, plain }
}
