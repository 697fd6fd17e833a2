//! Limits of the result. They are measured on the solved stack, without another solve. Some are
//! measured by variants of the forward model, some by fractions of the squared error, and one by
//! the solver's history.
//!
//! A value in dB is the gain of psnr_view if one effect were absent and everything else unchanged.
//! Two values are extrapolated instead: for 10 % more light, and for twice as many iterations. The
//! limit by the number of frames has no such value. Effects overlap, so the gains do not add up.
//! Variants are simulated for the central view and the corner views.

mod depth;
mod hardware;
mod limit;
mod solver;
mod variants;
mod views;

use lumistack_core::Task;
use lumistack_display::ViewGrid;

use crate::measure::{FieldScore, outstanding_views};
use crate::{ReportError, ReportInput};
pub(crate) use limit::Limit;
use variants::{Tone, Variant, simulated_error, variants};

/// Returns the number of progress steps of [`find`].
pub(crate) fn count(input: &ReportInput) -> usize {
    outstanding_views(&input.target.geometry().grid).len() * variants(input).len()
}

/// Returns the limits of a result: the largest first, and the limit by the number of frames last.
/// `grid` has all views of the target, `target` the scores of the measured views.
pub(crate) fn find(
    input: &ReportInput,
    target: &FieldScore,
    grid: &ViewGrid,
    task: Task,
) -> Result<Vec<Limit>, ReportError> {
    let mut errors = Vec::new();
    let mut tone = Tone::default();
    for (i, variant) in variants(input).into_iter().enumerate() {
        let (display, stack) = variant.apply(input);
        let (error, found) = simulated_error(input, &display, &stack, task)?;
        if i == 0 {
            tone = found;
        }
        errors.push((variant, error));
    }
    let base = errors[0].1;
    if base.count == 0 {
        return Ok(Vec::new());
    }
    if base.sum == 0.0 {
        // If the result is exact, only the number of frames can limit it.
        return Ok(vec![solver::frames(input, target, grid, None)]);
    }
    let error = |variant| errors.iter().find(|(other, _)| *other == variant).map(|(_, error)| *error);
    let gain = |variant| error(variant).map(|error| 10.0 * (base.mse() / error.mse()).log10());
    let ends = hardware::Ends::of(input);
    let mut limits = Vec::new();
    limits.extend(hardware::brightness(input, &ends, base, error(Variant::Brighter)));
    limits.extend(hardware::contrast(&ends, tone, gain(Variant::Black)));
    limits.push(hardware::bits(input, gain(Variant::Quantized)));
    limits.extend(gain(Variant::SharpAndPure).map(hardware::blur_and_crosstalk));
    limits.extend(views::depth_limits(input, task)?);
    limits.extend(views::outer_views(target));
    limits.extend(solver::iterations(input.convergence));
    limits.retain(|limit| limit.decibels.is_none_or(|gain| !gain.is_nan()));
    limits.sort_by(|a, b| b.decibels.unwrap_or(0.0).total_cmp(&a.decibels.unwrap_or(0.0)));
    limits.push(solver::frames(input, target, grid, gain(Variant::Still)));
    Ok(limits)
}
