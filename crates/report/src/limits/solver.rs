//! Limits of the solution: the number of iterations, and the number of pattern values per ray.

use lumistack_display::ViewGrid;
use serde_json::json;

use super::limit::Limit;
use crate::measure::FieldScore;
use crate::{Iteration, ReportInput, format};

/// A gain below this is invisible, dB.
const NEGLIGIBLE_DB: f64 = 0.05;

pub(super) fn iterations(history: &[Iteration]) -> Option<Limit> {
    let last = history.last().filter(|last| last.iteration > 1)?;
    let half = history.iter().rev().find(|it| 2 * it.iteration <= last.iteration)?;
    let gain = last.psnr_view - half.psnr_view;
    if !gain.is_finite() {
        return None;
    }
    let text = if gain < NEGLIGIBLE_DB {
        format!(
            "The second half of the {} iterations raised the PSNR by {} dB. More iterations would make no visible difference.",
            last.iteration,
            format::decibels_fine(gain)
        )
    } else {
        format!(
            "The second half of the {0} iterations raised the PSNR by {1} dB. Another {0} iterations would raise the PSNR by at most about {1} dB.",
            last.iteration,
            format::decibels_fine(gain)
        )
    };
    let figures = json!({ "iterations": last.iteration, "gain_of_second_half_db": gain });
    Some(Limit { name: "Iterations", decibels: Some(gain.max(0.0)), text, figures })
}

pub(super) fn frames(input: &ReportInput, target: &FieldScore, grid: &ViewGrid, still: Option<f64>) -> Limit {
    let stack = input.stack;
    let parts = stack.layers.iter().map(|layer| layer.data().len());
    let unknowns: usize = parts.chain(stack.emission.as_ref().map(|emission| emission.data().len())).sum();
    // Count the values of the measured views' rays. All other views have about as many per view.
    let measured: u64 = target.geometry.grid.iter().map(|view| target.view(view).error.count).sum();
    let [views, measured_views] = [grid, &target.geometry.grid].map(|grid| grid.iter().count());
    let rays = measured * views as u64 / measured_views as u64;
    let ratio = unknowns as f64 / rays as f64;
    let (layers, frames) = (stack.layers.len(), stack.frames());
    let emitter = if stack.emission.is_some() { " and the backlight's values" } else { "" };
    let mut text = format!(
        "{} × {}{emitter} have to show {}: {} values of the patterns for every ray. ",
        format::counted(layers, "layer"),
        format::counted(frames, "frame"),
        format::counted(views, "view"),
        format::number_short(ratio)
    );
    text += if ratio < 1.0 {
        "The layer stack cannot represent every light field. More layers or frames would help, or views that are more alike."
    } else {
        "There are at least as many values as rays, so the layer stack could fit nearly any light field. Scores above about 60 dB do not describe a display."
    };
    if let Some(still) = still.filter(|still| still.is_finite()) {
        text += &format!(
            " If every frame were the mean of all frames, the PSNR would be {} dB lower.",
            format::decibels_fine((-still).max(0.0))
        );
    }
    let figures = json!({ "unknowns": unknowns, "values_of_rays": rays, "ratio": ratio, "still_loss_db": still.map(|still| -still) });
    Limit { name: "Frames", decibels: None, text, figures }
}
