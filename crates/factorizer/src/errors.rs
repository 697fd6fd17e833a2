//! The objective: squared errors of one field row over all views.

use lumistack_simd::{Function, Kernel, Lanes};

use crate::expand::{Rays, coefficients, errors};
use crate::factor::{Factor, PAD};
use crate::plan::Plan;
use crate::row::Row;
use crate::scratch::Scratch;
use crate::vector::{mask, sum};

/// Sums of squared errors over some rays.
#[derive(Clone, Copy, Debug, Default)]
pub struct ErrorSum {
    /// Σ w (βL − L̃)², with weights w relative to the largest weight.
    pub weighted: f64,
    /// Σ (βL − L̃)² over rays with w > 0.
    pub plain: f64,
}

impl ErrorSum {
    pub(crate) fn merged(self, other: Self) -> Self {
        Self { weighted: self.weighted + other.weighted, plain: self.plain + other.plain }
    }
}

/// One field row in one channel, whose errors are summed.
pub(crate) struct RowErrors<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) factors: &'a [Factor],
    pub(crate) channel: usize,
    pub(crate) row: usize,
    pub(crate) functions: &'a ErrorFunctions,
    pub(crate) scratch: &'a mut Scratch,
}

/// The kernels for one instruction set.
pub(crate) struct ErrorFunctions {
    shifted: Function<Shifted>,
    squared: Function<Squared>,
}

impl ErrorFunctions {
    pub(crate) fn new(plan: &Plan) -> Self {
        Self { shifted: plan.backend.function::<Shifted>(), squared: plan.backend.function::<Squared>() }
    }
}

impl RowErrors<'_> {
    /// Sums the squared errors of the row over all views.
    pub(crate) fn sum(self) -> ErrorSum {
        let Self { plan, factors, channel, row, functions, scratch } = self;
        let mut total = ErrorSum::default();
        for view_y in (0..plan.views[0]).filter(|&view_y| plan.valid_rows[view_y][row]) {
            for view_x in 0..plan.views[1] {
                for run in &plan.runs[view_x] {
                    let rays = Rays { channel, view: [view_y, view_x], row, run };
                    let weights = plan.target.weights(plan.view(view_y, view_x), row);
                    if plan.shifted {
                        // SAFETY: the tables are constant shifts
                        let errors = unsafe { (functions.shifted)((plan, factors, &rays, weights)) };
                        // Squares above 1e38 overflow f32. In that case the code below computes the
                        // sum again in f64.
                        if errors.plain.is_finite() {
                            total = total.merged(errors);
                            continue;
                        }
                    }
                    coefficients(plan, factors, None, &rays, scratch);
                    let e = &mut scratch.errors[..run.len()];
                    errors(plan, &rays, &scratch.emitted, e);
                    let weights = weights.map(|weights| &weights[PAD + run.start..PAD + run.end]);
                    // SAFETY: the kernel has no requirements
                    total = total.merged(unsafe { (functions.squared)((e, weights)) });
                }
            }
        }
        total
    }
}

/// Number of blocks whose squares are summed in f32 before the sum goes into an f64 sum.
const BLOCKS_PER_SUM: usize = 4;

/// Squared errors along rays of attenuating layers, with L̃ = (1/M) Σ_m Π_k f_k over the values f_k
/// that a ray reads. All rays of a view must read each factor at a constant shift, as
/// [`Plan::shifted`] reports.
struct Shifted;

impl Kernel for Shifted {
    type Args<'a> = (&'a Plan, &'a [Factor], &'a Rays<'a>, Option<&'a [f32]>);
    type Output = ErrorSum;

    #[inline(always)]
    unsafe fn run<V: Lanes>((plan, factors, rays, root_weights): Self::Args<'_>) -> ErrorSum {
        // SAFETY: guaranteed by the caller
        unsafe { squared_shifted::<V>(plan, factors, rays, root_weights) }
    }
}

/// # Safety
/// The machine has `V`'s instruction set, and [`Plan::shifted`] holds.
#[inline(always)]
unsafe fn squared_shifted<V: Lanes>(
    plan: &Plan,
    factors: &[Factor],
    rays: &Rays,
    root_weights: Option<&[f32]>,
) -> ErrorSum {
    // for each factor, find the line that the rays read, and the shift between field columns and
    // the line's values
    let lines: Vec<Line> = plan
        .maps
        .iter()
        .zip(factors)
        .map(|(map, factor)| Line {
            values: factor.line(rays.channel, map.y[rays.view[0]][rays.row].first as usize),
            stride: map.layout.stride,
            shift: map.x[rays.view[1]].shift.unwrap_or(0),
        })
        .collect();
    let target = plan.target.row(rays.channel, plan.view(rays.view[0], rays.view[1]), rays.row);
    let run = rays.run;
    let mut total = ErrorSum::default();
    // SAFETY: the machine has the instruction set of V; padding covers every block that touches a
    // valid ray
    unsafe {
        let (mean, brightness) = (V::splat(1.0 / plan.frames as f32), V::splat(plan.target.brightness));
        let zero = V::splat(0.0);
        let (mut weighted, mut plain) = (zero, zero);
        // compute the errors of one vector of rays after another
        for (index, col) in run.clone().step_by(V::COUNT).enumerate() {
            // compute L̃, for up to three frames together
            let mut emitted = zero;
            for m in (0..plan.frames).step_by(3) {
                emitted = match plan.frames - m {
                    1 => emitted_by::<V, 1>(&lines, m, col, emitted),
                    2 => emitted_by::<V, 2>(&lines, m, col, emitted),
                    _ => emitted_by::<V, 3>(&lines, m, col, emitted),
                };
            }
            // compute L̃ − βL, and set it to 0 after the last ray
            let wanted = match target {
                Row::Half(row) => V::load_half(row[PAD + col..][..V::COUNT].as_ptr()),
                Row::Float(row) => V::load(row[PAD + col..][..V::COUNT].as_ptr()),
            };
            let mut error = emitted.mul(mean).sub(wanted.mul(brightness));
            if run.end - col < V::COUNT {
                error = error.mul(mask::<V>(0, run.end - col));
            }
            // multiply by √w before squaring, so that the squares include w
            if let Some(roots) = root_weights {
                let root = V::load(roots[PAD + col..][..V::COUNT].as_ptr());
                let rooted = root.mul(error);
                weighted = rooted.mul_add(rooted, weighted);
                error = error.where_else(zero.below(root), zero);
            }
            plain = error.mul_add(error, plain);
            // add the f32 sums to the f64 sums after few blocks, so that the f32 sums stay precise
            if (index + 1) % BLOCKS_PER_SUM == 0 || col + V::COUNT >= run.end {
                total.plain += sum::<V>(plain);
                total.weighted += if root_weights.is_some() { sum::<V>(weighted) } else { 0.0 };
                (weighted, plain) = (zero, zero);
            }
        }
    }
    if root_weights.is_none() {
        total.weighted = total.plain;
    }
    total
}

/// One line of a factor. A ray reads it at the ray's own column plus `shift`.
struct Line<'a> {
    values: &'a [f32],
    stride: usize,
    shift: isize,
}

/// Adds the products of all lines' values, for the frames m..m + R, to `emitted`.
///
/// # Safety
///
/// Every line must hold `V::COUNT` values from `col` + its shift on, in each of these frames.
#[inline(always)]
unsafe fn emitted_by<V: Lanes, const R: usize>(lines: &[Line], m: usize, col: usize, emitted: V) -> V {
    // SAFETY: guaranteed by the caller
    unsafe {
        let mut products = [V::splat(1.0); R];
        for line in lines {
            for (i, product) in products.iter_mut().enumerate() {
                let at = (col as isize + line.shift) as usize + (m + i) * line.stride;
                debug_assert!(at + V::COUNT <= line.values.len());
                *product = product.mul(V::load(line.values.as_ptr().add(at)));
            }
        }
        products.iter().fold(emitted, |sum, &product| sum.add(product))
    }
}

/// Sums the squared errors of consecutive rays of a field row, in eight interleaved `f64` sums.
struct Squared;

impl Kernel for Squared {
    type Args<'a> = (&'a [f32], Option<&'a [f32]>);
    type Output = ErrorSum;

    #[inline(always)]
    unsafe fn run<V: Lanes>((errors, root_weights): Self::Args<'_>) -> ErrorSum {
        squared(errors, root_weights)
    }
}

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
