//! Results of the denoiser: the bias of each view, and a picture of the difference.

use lumistack_display::ViewGrid;
use maud::{Markup, html};

use super::{figure, legend};
use crate::picture::{DIVERGING, Encoding, Linear, amplification, difference, shrink_factor, signed_error};
use crate::{ReportError, ReportInput, format};

/// Maximum number of pixels of the three pictures together.
const BUDGET: usize = 1_500_000;

/// Returns the section. `grid` has all views of the target.
pub(super) fn section(input: &ReportInput, grid: &ViewGrid) -> Result<Markup, ReportError> {
    let Some(denoising) = input.denoising else { return Ok(html! {}) };
    let geometry = input.target.geometry();
    let (rows, cols) = (geometry.rows, geometry.cols);
    // Reduce the three pictures so that they have at most [`BUDGET`] pixels together.
    let factor = shrink_factor(&[(rows, cols); 3], BUDGET);
    let small = |values: &[f32]| Linear::new(rows, cols, values, 1.0).shrunk(factor);
    let (before, after) = (small(denoising.unbiased), small(denoising.filtered));
    let errors = signed_error(&after.data, &before.data, |_| true);
    let gain = amplification(errors.iter());
    let encoding = Encoding::for_pixels(3 * before.rows * before.cols);
    let taken = difference(before.rows, before.cols, &errors, gain).embedded(encoding)?;
    let (before, after) = (before.encoded().embedded(encoding)?, after.encoded().embedded(encoding)?);
    let end = format::number(1.0 / f64::from(gain));
    let overall = denoising.overall;
    let relative = |value: f64| format!("{:+.3} %", 100.0 * value).replace('-', "−");
    let measured = grid.iter().zip(&denoising.views).filter(|(_, figures)| !figures.mse_before[0].is_nan());
    Ok(html! {
        section id="denoising" {
            h2 { "Denoising" }
            p {
                "Every view was filtered by " (denoising.name) ". Mean squared error of the exposed radiance: "
                strong { (estimate(overall.mse_before)) " before, " (estimate(overall.mse_after)) " after" }
                ", measured at one pixel in 64 of at most 25 views, with new samples that the filter never used. The mean changed by "
                strong { (relative(overall.mean_change[0] / overall.mean)) } " ± " (format!("{:.3} %", 100.0 * overall.mean_change[1] / overall.mean))
                ". The value after ± is a standard error."
            }
            div class="compare three group" {
                (figure(&before, "The central view as rendered", "As rendered, unbiased"))
                (figure(&after, "The central view filtered", "Filtered"))
                (figure(&taken, "Change by the filter", &format!("Filtered picture minus rendered picture, multiplied by {gain}. Any shape of the scene in this picture is detail that the filter removed")))
            }
            (legend(&DIVERGING, &[format!("≤ −{end} darker than rendered"), "0".into(), format!("≥ +{end} brighter")]))
            details {
                summary { "Per measured view" }
                div class="scroll" {
                    table class="layers" {
                        thead { tr { @for name in ["view (row, column)", "mean changed by", "error before", "error after"] { th scope="col" { (name) } } } }
                        tbody {
                            @for (view, figures) in measured {
                                tr {
                                    td { (view[0]) ", " (view[1]) }
                                    td { (relative(figures.mean_change[0] / figures.mean)) }
                                    td { (estimate(figures.mse_before)) }
                                    td { (estimate(figures.mse_after)) }
                                }
                            }
                        }
                    }
                }
            }
        }
    })
}

/// Formats a value and its standard error.
fn estimate([value, error]: [f64; 2]) -> String {
    format!("{value:.2e} ± {error:.0e}")
}
