//! Limits of the panels: brightest and darkest states, bits, blur and crosstalk.

use lumistack_core::metrics::SquaredError;
use lumistack_display::Layer;
use rayon::prelude::*;
use serde_json::json;

use super::limit::{Limit, without};
use super::variants::{AT_END, BRIGHTER, Tone, USUAL_BITS, bits_are_given, emission_range};
use crate::{ReportInput, format};

/// The report states the gain for a brightest state that is brighter by this fraction. The gain is
/// extrapolated from the measured gain for the smaller fraction [`BRIGHTER`].
const BRIGHTER_SHOWN: f64 = 0.1;

/// Fractions of the stack's values that are at the ends of their ranges.
pub(super) struct Ends {
    /// Fractions at the darkest value: for each layer, rearmost first, and then for the backlight.
    darkest: Vec<f64>,
    /// Fractions at the brightest value, in the order of `darkest`.
    brightest: Vec<f64>,
}

impl Ends {
    pub(super) fn of(input: &ReportInput) -> Self {
        let ranges = input.display.layers.iter().map(Layer::range).chain(emission_range(input.display));
        let parts = input.stack.layers.iter().map(|layer| layer.data());
        let parts = parts.chain(input.stack.emission.as_ref().map(|emission| emission.data()));
        let (mut darkest, mut brightest) = (Vec::new(), Vec::new());
        for (data, [low, high]) in parts.zip(ranges) {
            let near = AT_END * (high - low);
            let share = |at: &(dyn Fn(f32) -> bool + Sync)| {
                data.par_iter().filter(|value| at(**value)).count() as f64 / data.len() as f64
            };
            darkest.push(share(&|value| value <= low + near));
            brightest.push(share(&|value| value >= high - near));
        }
        Self { darkest, brightest }
    }
}

/// Makes a list such as "12 %, 3 % and 40 % of the values of layers 0 to 2".
fn listed(shares: &[f64], layers: usize) -> String {
    let percents: Vec<String> = shares.iter().map(|share| format::percent(*share)).collect();
    let text = match percents.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
        _ => percents.concat(),
    };
    match (layers, shares.len() > layers) {
        (1, false) => format!("{text} of the layer's values"),
        (1, true) => format!("{text} of the values of the layer and of the backlight (in this order)"),
        (n, false) => format!("{text} of the values of layers 0 to {} (in this order)", n - 1),
        (n, true) => format!("{text} of the values of layers 0 to {} and of the backlight (in this order)", n - 1),
    }
}

pub(super) fn brightness(
    input: &ReportInput,
    ends: &Ends,
    base: SquaredError,
    brighter: Option<SquaredError>,
) -> Option<Limit> {
    let relative = ((base.mse() - brighter?.mse()) / base.mse()).max(0.0);
    // As the brightest state becomes brighter, each further increase gains less. So extrapolation
    // of the gain by a straight line is an upper bound.
    let extrapolated = without((relative * BRIGHTER_SHOWN / BRIGHTER).min(0.99)).max(0.0);
    let mut text = format!("{} are at their brightest. ", listed(&ends.brightest, input.display.layers.len()));
    text += &if relative > 0.0 {
        format!(
            "If the brightest state transmitted 1 % more, these patterns would have {} less squared error. Extrapolated to 10 % more light, or to a β that is 10 % lower, the PSNR \
             would rise by up to {} dB.",
            format::percent(relative),
            format::decibels_fine(extrapolated)
        )
    } else {
        "A brighter state would not improve this layer stack.".into()
    };
    let figures = json!({ "share_at_brightest": ends.brightest, "less_error_for_1_percent": relative });
    Some(Limit { name: "Brightness", decibels: Some(extrapolated), text, figures })
}

pub(super) fn contrast(ends: &Ends, tone: Tone, black: Option<f64>) -> Option<Limit> {
    let (offset, slope, share) = tone.fit()?;
    let layers = ends.darkest.len();
    let mut text = format!(
        "On average a target value L is shown as {} + {} · L. This change of contrast causes {} of the squared error. ",
        format::number(offset),
        format::number(slope),
        format::percent(share)
    );
    let darkest = ends.darkest.iter().sum::<f64>() / layers as f64;
    text += &match black {
        Some(gain) => format!(
            "{} of all values are at their darkest, which is not black. With a perfect black, the PSNR of this layer stack would be {} dB higher.",
            format::percent(darkest),
            format::decibels_fine(gain)
        ),
        None => format!("{} of all values are at their darkest, which is black here.", format::percent(darkest)),
    };
    let figures = json!({ "offset": offset, "slope": slope, "share_of_error": share, "share_at_darkest": ends.darkest, "black_gain_db": black });
    Some(Limit { name: "Contrast", decibels: Some(without(share).max(black.unwrap_or(0.0))), text, figures })
}

pub(super) fn bits(input: &ReportInput, gain: Option<f64>) -> Limit {
    let loss = -gain.unwrap_or(f64::NAN);
    let loss = if loss.is_infinite() { f64::NAN } else { loss };
    let given = bits_are_given(input.display);
    let counts: Vec<u32> = input.display.layers.iter().filter_map(|layer| layer.bits).collect();
    let which = match (counts.iter().min(), counts.iter().max()) {
        (Some(low), Some(high)) if low == high => format!("the layers' {low} bits"),
        (Some(low), Some(high)) => format!("the layers' {low} to {high} bits"),
        _ => format!("{USUAL_BITS} bits (assumed, since the display file states none)"),
    };
    let text = if given && loss.abs() < 1e-9 {
        format!("The masks already contain only the values of {which}; the scores include the loss by rounding.")
    } else {
        format!(
            "With values that are rounded to {which} per channel, the PSNR of this layer stack would be {} dB lower.",
            format::decibels_fine(loss.max(0.0))
        )
    };
    let figures = json!({ "given": given, "bits": if given { counts } else { vec![USUAL_BITS] }, "loss_db": loss });
    Limit { name: "Bits", decibels: Some(loss.max(0.0)), text, figures }
}

pub(super) fn blur_and_crosstalk(gain: f64) -> Limit {
    let text = if gain >= 0.0 {
        format!(
            "On layers without blur and crosstalk the PSNR of this layer stack would be {} dB higher.",
            format::decibels_fine(gain)
        )
    } else {
        format!(
            "On layers without blur and crosstalk the PSNR of this layer stack would be {} dB lower, since the patterns compensate for the blur and crosstalk of this display.",
            format::decibels_fine(-gain)
        )
    };
    Limit { name: "Blur and crosstalk", decibels: Some(gain.max(0.0)), text, figures: json!({ "gain_db": gain }) }
}
