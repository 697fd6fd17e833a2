//! One line of one factor, the general way: any tables, any image formation, any number of frames and factors.
//!
//! For every field row whose rays meet the line and every view column: expand the other factors along the row into a_m (M rows) and the residual
//! e = βL − L̃, and add w e a_m and w a_m a_k to the line's accumulators, by the share of the ray that a pixel has. All loops run along columns.
//!
//! Under bilinear sampling a ray's value is a mean Σ_t s_t f_t of pixels, so (e − a·Σ s_t δ_t)² ≤ Σ_t s_t (e − a·δ_t)²: sums by shares describe a
//! quadratic that bounds the objective from above and touches it, separable over pixels. Its minimum is a step that never worsens.

use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::{AddAssign, Mul};

use crate::expand::{Rays, coefficients, pieces_within};
use crate::factor::{Factor, PAD};
use crate::lanes::{Kernel, Lanes};
use crate::line::{LineOf, LineStep, Outcome, quantities_of};
use crate::plan::{Access, Plan};
use crate::step::{Block, Rule, sum};

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// a_m, `[frame][column of the run]`.
    pub(crate) product: Vec<f32>,
    /// Sums of rotations or emissions per frame, where formation needs them.
    pub(crate) phase: Vec<f32>,
    /// One factor's values along a run.
    pub(crate) values: Vec<f32>,
    /// L̃ along a run.
    pub(crate) emitted: Vec<f32>,
    /// e along a run.
    errors: Vec<f32>,
    /// Curvature along a run, where the Gram matrix does not bound it.
    pub(crate) curvature: Vec<f32>,
    /// Weights times e, L̃, a_m or the curvature.
    weighted: Vec<f32>,
    /// r and the upper triangle of G, or n and d: `[quantity][x]`.
    sums: Vec<f32>,
    /// The same where pixels may get very many rays.
    long_sums: Vec<f64>,
    block: Block,
}

impl Scratch {
    /// For lines of factor `n`.
    pub(crate) fn new(plan: &Plan, n: usize) -> Self {
        let frames = plan.frames;
        let row = || vec![0.0; plan.cols + PAD];
        let sums = quantities_of(Rule::Probe, frames).max(2 * frames) * plan.maps[n].layout.stride;
        let short = plan.maps[n].short_sums;
        Self {
            product: vec![0.0; frames * plan.cols],
            phase: if plan.is_product() { Vec::new() } else { vec![0.0; frames * plan.cols] },
            values: row(),
            emitted: row(),
            errors: row(),
            curvature: row(),
            weighted: row(),
            sums: vec![0.0; if short { sums } else { 0 }],
            long_sums: vec![0.0; if short { 0 } else { sums }],
            block: Block::new(frames),
        }
    }
}

/// One line and what becomes of it.
pub(crate) struct SumLine<'a, 'b> {
    pub(crate) plan: &'a Plan,
    /// The line's own factor is read where layers are mixed with their neighbours.
    pub(crate) factors: &'a [Factor],
    pub(crate) at: LineOf,
    /// Where L̃ is not linear in the values: whether to take the curvature at this point instead of a bound that holds everywhere.
    pub(crate) local: bool,
    pub(crate) step: LineStep<'b>,
    pub(crate) scratch: &'a mut Scratch,
}

impl Kernel for SumLine<'_, '_> {
    type Output = Outcome;

    #[inline(always)]
    unsafe fn run<V: Lanes>(self) -> Outcome {
        let Self { plan, factors, at, local, mut step, scratch } = self;
        let short = plan.maps[at.factor].short_sums;
        scratch.sums.fill(0.0);
        scratch.long_sums.fill(0.0);
        let mut outcome = Outcome {
            error: add_line(plan, factors, at, step.rule.needs_gram(), local, scratch),
            ..Outcome::default()
        };
        let (columns, stride) = (step.columns.clone(), step.stride);
        for x in columns.step_by(V::COUNT) {
            step.fetch_block::<V>(&mut scratch.block, x, |quantity, to| {
                let from = quantity * stride + x..quantity * stride + x + V::COUNT;
                if short {
                    to.copy_from_slice(&scratch.sums[from]);
                } else {
                    to.iter_mut().zip(&scratch.long_sums[from]).for_each(|(to, &sum)| *to = sum as f32);
                }
            });
            // SAFETY: the machine has V; padding covers the last block
            outcome.gain += unsafe { sum::<V>(step.finish_block::<V>(&mut scratch.block, x)) };
        }
        outcome
    }
}

/// Adds all rays of a line to its accumulators; returns Σ w e² by shares.
#[inline(always)]
fn add_line(plan: &Plan, factors: &[Factor], at: LineOf, gram: bool, local: bool, scratch: &mut Scratch) -> f64 {
    let map = &plan.maps[at.factor];
    let (frames, stride) = (plan.frames, map.layout.stride);
    let mut error = 0.0;
    for view_y in 0..plan.views[0] {
        for &(row, line_weight) in map.rays_of_line(view_y, at.line) {
            for view_x in 0..plan.views[1] {
                for run in &plan.runs[view_x] {
                    let rays = Rays { channel: at.channel, view: [view_y, view_x], row: row as usize, run };
                    coefficients(plan, factors, Some(at.factor), &rays, scratch);
                    let len = run.len();
                    let weights = plan.target.weights(plan.view(view_y, view_x), row as usize);
                    let weights = weights.map(|weights| &weights[PAD + run.start..PAD + run.end]);
                    let Scratch { product, emitted, errors, weighted, sums, long_sums, curvature, .. } = &mut *scratch;
                    let (errors, weighted) = (&mut errors[..len], &mut weighted[..len]);
                    plan.target.errors(&rays, plan, emitted, errors);
                    weigh(errors, line_weight, weights, weighted);
                    error += errors.iter().zip(&*weighted).map(|(&e, &we)| f64::from(e) * f64::from(we)).sum::<f64>();
                    let x = &map.x[view_x];
                    let mut add = |quantity: usize, a: &[f32], b: &[f32]| {
                        if map.short_sums {
                            scatter(x, run, a, b, &mut sums[quantity * stride..][..stride]);
                        } else {
                            scatter(x, run, a, b, &mut long_sums[quantity * stride..][..stride]);
                        }
                    };
                    let row_of = |m: usize| &product[m * plan.cols..][..len];
                    if !gram {
                        plan.target.wanted(&rays, plan, errors);
                        weigh(errors, line_weight, weights, weighted);
                        (0..frames).for_each(|m| add(m, row_of(m), weighted));
                        weigh(&emitted[..len], line_weight, weights, weighted);
                        (0..frames).for_each(|m| add(frames + m, row_of(m), weighted));
                        continue;
                    }
                    (0..frames).for_each(|m| add(m, row_of(m), weighted));
                    let mut quantity = frames;
                    let bounded = plan.is_bounded(at.factor);
                    if bounded || local {
                        for m in 0..frames {
                            weigh(row_of(m), line_weight, weights, weighted);
                            for k in m..frames {
                                add(quantity, row_of(k), weighted);
                                quantity += 1;
                            }
                        }
                    }
                    if !bounded {
                        if local {
                            // |∂²L̃/∂u²| = (π²/2) M |cos|, times |e|
                            let most = FRAC_PI_2 * PI * frames as f32;
                            curvature.iter_mut().zip(&*errors).for_each(|(value, e)| *value = most * e.abs());
                        }
                        weigh(&curvature[..len], line_weight, weights, weighted);
                        let ones = &plan.ones[..len];
                        let mut quantity = frames;
                        for m in 0..frames {
                            add(quantity, ones, weighted);
                            quantity += frames - m;
                        }
                    }
                }
            }
        }
    }
    error
}

/// value · share of the line · w.
#[inline(always)]
fn weigh(values: &[f32], line_weight: f32, root_weights: Option<&[f32]>, to: &mut [f32]) {
    match root_weights {
        None => to.iter_mut().zip(values).for_each(|(to, &value)| *to = line_weight * value),
        Some(roots) => {
            to.iter_mut()
                .zip(values)
                .zip(roots)
                .for_each(|((to, &value), &root)| *to = line_weight * root * root * value);
        }
    }
}

/// Adds a·b of every ray to the pixels that it reads; rays that miss the line add to the padding, which is never read.
#[inline(always)]
pub(crate) fn scatter<T>(
    x: &crate::plan::ColumnTaps,
    run: &std::ops::Range<usize>,
    a: &[f32],
    b: &[f32],
    sums: &mut [T],
) where
    T: Copy + From<f32> + AddAssign + Mul<Output = T>,
{
    for (cols, access) in pieces_within(x, run) {
        let part = cols.start - run.start..cols.end - run.start;
        let values = a[part.clone()].iter().zip(&b[part]).map(|(&a, &b)| T::from(a) * T::from(b));
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
