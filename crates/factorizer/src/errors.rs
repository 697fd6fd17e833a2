//! The objective: errors of one field row over all views.

use crate::expand::{Rays, coefficients};
use crate::factor::{Factor, PAD};
use crate::lanes::{Kernel, Lanes};
use crate::plan::Plan;
use crate::sums::Scratch;

/// Error sums of some rays.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ErrorSum {
    /// Σ w (βL − L̃)², weights relative to the largest.
    pub(crate) weighted: f64,
    /// Σ (βL − L̃)² over rays with w > 0.
    pub(crate) plain: f64,
}

impl ErrorSum {
    pub(crate) fn merged(self, other: Self) -> Self {
        Self { weighted: self.weighted + other.weighted, plain: self.plain + other.plain }
    }
}

/// Errors of one field row in one channel.
pub(crate) struct RowErrors<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) factors: &'a [Factor],
    pub(crate) channel: usize,
    pub(crate) row: usize,
    pub(crate) scratch: &'a mut Scratch,
}

impl Kernel for RowErrors<'_> {
    type Output = ErrorSum;

    #[inline(always)]
    unsafe fn run<V: Lanes>(self) -> ErrorSum {
        let Self { plan, factors, channel, row, scratch } = self;
        let mut total = ErrorSum::default();
        let mut errors = vec![0.0; plan.cols];
        for view_y in (0..plan.views[0]).filter(|&view_y| plan.valid_rows[view_y][row]) {
            for view_x in 0..plan.views[1] {
                for run in &plan.runs[view_x] {
                    let rays = Rays { channel, view: [view_y, view_x], row, run };
                    if plan.shifted {
                        // SAFETY: the machine has V; the tables are constant shifts
                        unsafe { emit::<V>(plan, factors, &rays, &mut scratch.emitted) };
                    } else {
                        coefficients(plan, factors, None, &rays, scratch);
                    }
                    let errors = &mut errors[..run.len()];
                    plan.target.errors(&rays, plan, &scratch.emitted, errors);
                    let weights = plan.target.weights(plan.view(view_y, view_x), row);
                    total =
                        total.merged(squared(errors, weights.map(|weights| &weights[PAD + run.start..PAD + run.end])));
                }
            }
        }
        total
    }
}

/// L̃ = (1/M) Σ_m Π_k f_k along rays, where every factor is at a constant shift.
///
/// # Safety
/// The machine has `V`'s instruction set, and [`Plan::shifted`] holds; `emitted` has room for the run and a vector.
#[inline(always)]
unsafe fn emit<V: Lanes>(plan: &Plan, factors: &[Factor], rays: &Rays, emitted: &mut [f32]) {
    let lines: Vec<(&[f32], usize, isize)> = plan
        .maps
        .iter()
        .zip(factors)
        .map(|(map, factor)| {
            let line = map.y[rays.view[0]][rays.row].first as usize;
            (factor.line(rays.channel, line), map.layout.stride, map.x[rays.view[1]].shift.unwrap_or(0))
        })
        .collect();
    let Some((first, rest)) = lines.split_first() else { return };
    let load = |(values, stride, shift): &(&[f32], usize, isize), frame: usize, col: usize| {
        let at = (col as isize + shift) as usize + frame * stride;
        debug_assert!(at + V::COUNT <= values.len());
        // SAFETY: padding covers every block that touches a valid ray
        unsafe { V::load(values.as_ptr().add(at)) }
    };
    // SAFETY: see above
    unsafe {
        let mean = V::splat(1.0 / plan.frames as f32);
        for col in (rays.run.start..rays.run.end).step_by(V::COUNT) {
            let mut sum = V::splat(0.0);
            for frame in 0..plan.frames {
                let product =
                    rest.iter().fold(load(first, frame, col), |product, line| product.mul(load(line, frame, col)));
                sum = product.mul_add(mean, sum);
            }
            sum.store(emitted[col - rays.run.start..][..V::COUNT].as_mut_ptr());
        }
    }
}

/// Squared errors of a run, added in eight interleaved `f64` sums.
#[inline(always)]
fn squared(errors: &[f32], root_weights: Option<&[f32]>) -> ErrorSum {
    const LANES: usize = 8;
    let (mut weighted, mut plain) = ([0.0; LANES], [0.0; LANES]);
    for (part, errors) in errors.chunks(LANES).enumerate() {
        let mut squares = [0.0; LANES];
        for (square, &error) in squares.iter_mut().zip(errors) {
            *square = f64::from(error) * f64::from(error);
        }
        if let Some(roots) = root_weights {
            let roots = &roots[part * LANES..][..errors.len()];
            for (lane, &root) in roots.iter().enumerate() {
                weighted[lane] += f64::from(root) * f64::from(root) * squares[lane];
                squares[lane] = if root > 0.0 { squares[lane] } else { 0.0 };
            }
        }
        plain.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
    }
    let plain = plain.iter().sum();
    ErrorSum { weighted: if root_weights.is_some() { weighted.iter().sum() } else { plain }, plain }
}
