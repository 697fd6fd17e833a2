//! Sums of one line of one factor if layers do not attenuate, for any tables and any number of
//! frames and factors.
//!
//! For every field row whose rays hit the line, and for every view column:
//!
//! 1. Compute a_m for all M frames, and the error e = βL − L̃, along the row.
//! 2. Add w e a_m and w a_m a_k to the line's sums. Several pixels may share a ray;
//!    [`scatter`](crate::scatter) explains the shares.
//!
//! All loops run along columns.

use std::f32::consts::{FRAC_PI_2, PI};

use crate::expand::{Rays, coefficients, errors, wanted};
use crate::factor::{Factor, PAD};
use crate::line::{LineOf, LineStep, Outcome, StepFunctions};
use crate::plan::Plan;
use crate::scratch::Scratch;
use crate::step::Sums;

/// One line of a factor, and the step that updates it.
pub(crate) struct SumLine<'a, 'b> {
    pub(crate) plan: &'a Plan,
    /// All factors. The factor of the line is read too, since L̃ depends on all factors.
    pub(crate) factors: &'a [Factor],
    pub(crate) at: LineOf,
    /// True to take the curvature at the current point instead of its upper bound. This matters
    /// only if L̃ is not linear in the values.
    pub(crate) local: bool,
    pub(crate) functions: &'a StepFunctions,
    pub(crate) step: LineStep<'b>,
    pub(crate) scratch: &'a mut Scratch,
}

impl SumLine<'_, '_> {
    /// Sums the line's rays, and updates its pixels by a step. Returns the error of the rays and
    /// the gain of the step.
    pub(crate) fn update(self) -> Outcome {
        let Self { plan, factors, at, local, functions, mut step, scratch } = self;
        scratch.sums.fill(0.0);
        scratch.long_sums.fill(0.0);
        let error = add_line(plan, factors, at, step.rule.sums(), local, scratch);
        let Scratch { sums, long_sums, block, .. } = scratch;
        // the step reads f32, so sums in f64 are rounded once, at the end
        if !plan.maps[at.factor].short_sums {
            sums.iter_mut().zip(long_sums).for_each(|(to, sum)| *to = *sum as f32);
        }
        Outcome { error, gain: step.by_sums(functions, sums, block) }
    }
}

/// Adds the terms of all rays through a line to the line's sums. Returns Σ w e². Here each w is
/// multiplied by the weight of the line in the value that the ray reads.
fn add_line(plan: &Plan, factors: &[Factor], at: LineOf, needed: Sums, local: bool, scratch: &mut Scratch) -> f64 {
    let map = &plan.maps[at.factor];
    let (frames, stride) = (plan.frames, map.layout.stride);
    let mut error = 0.0;
    for view_y in 0..plan.views[0] {
        for &(row, line_weight) in map.rays_of_line(view_y, at.line) {
            for view_x in 0..plan.views[1] {
                for run in &plan.runs[view_x] {
                    let rays = Rays { channel: at.channel, view: [view_y, view_x], row: row as usize, run };
                    // compute the derivatives a_m and the emission L̃ of these rays
                    coefficients(plan, factors, Some(at.factor), &rays, scratch);
                    let len = run.len();
                    let weights = plan.target.weights(plan.view(view_y, view_x), row as usize);
                    let weights = weights.map(|weights| &weights[PAD + run.start..PAD + run.end]);
                    let Scratch { product, emitted, errors: e, weighted, sums, long_sums, curvature, .. } =
                        &mut *scratch;
                    let (e, weighted) = (&mut e[..len], &mut weighted[..len]);
                    let weigh = |values: &[f32], to: &mut [f32]| plan.row.weigh(values, line_weight, weights, to);
                    // compute the error e of these rays, and add w e² to the sum of errors
                    errors(plan, &rays, emitted, e);
                    weigh(e, weighted);
                    error += e.iter().zip(&*weighted).map(|(&e, &we)| f64::from(e) * f64::from(we)).sum::<f64>();
                    let x = &map.x[view_x];
                    let mut add = |quantity: usize, a: &[f32], b: &[f32]| {
                        if map.short_sums {
                            plan.row.scatter(x, run, a, b, &mut sums[quantity * stride..][..stride]);
                        } else {
                            plan.row.scatter_long(x, run, a, b, &mut long_sums[quantity * stride..][..stride]);
                        }
                    };
                    let row_of = |m: usize| &product[m * plan.cols..][..len];
                    // the paper's rule: n = Σ w βL a_m and d = Σ w L̃ a_m
                    if needed == Sums::Ratio {
                        wanted(plan, &rays, e);
                        weigh(e, weighted);
                        (0..frames).for_each(|m| add(m, row_of(m), weighted));
                        weigh(&emitted[..len], weighted);
                        (0..frames).for_each(|m| add(frames + m, row_of(m), weighted));
                        continue;
                    }
                    // Add Σ w e a_m. Then add the Gram matrix, unless an upper bound of the
                    // curvature replaces it.
                    (0..frames).for_each(|m| add(m, row_of(m), weighted));
                    let mut quantity = frames;
                    let bounded = plan.is_bounded(at.factor);
                    if bounded || local {
                        for m in 0..frames {
                            weigh(row_of(m), weighted);
                            for k in m..if needed == Sums::Gram { frames } else { m + 1 } {
                                add(quantity, row_of(k), weighted);
                                quantity += 1;
                            }
                        }
                    }
                    // In layers that rotate polarization, the Gram matrix does not bound the
                    // curvature. With `local`, the Gram matrix is one term of the curvature; add a
                    // bound of the other term, which contains e, to the diagonal. Without `local`,
                    // add only a bound of the whole curvature to the diagonal.
                    if !bounded {
                        if local {
                            // with u = f/M, the term of the curvature that contains e is at most
                            // (π²/2) M |e|, since |cos| ≤ 1
                            let most = FRAC_PI_2 * PI * frames as f32;
                            curvature.iter_mut().zip(&*e).for_each(|(value, e)| *value = most * e.abs());
                        }
                        weigh(&curvature[..len], weighted);
                        let ones = &plan.ones[..len];
                        let mut quantity = frames;
                        for m in 0..frames {
                            add(quantity, ones, weighted);
                            quantity += if needed == Sums::Gram { frames - m } else { 1 };
                        }
                    }
                }
            }
        }
    }
    error
}
