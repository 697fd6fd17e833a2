//! Variants: displays and stacks that differ from the given display and stack in one property. This
//! file also computes the errors of the variants.

use std::borrow::Cow;

use lumistack_core::Task;
use lumistack_core::metrics::SquaredError;
use lumistack_display::{Backlight, Display, Formation, Layer, LayerStack, RayMap, Simulator, quantize, view_error};
use rayon::prelude::*;

use crate::measure::{counting, outstanding_views};
use crate::{ReportError, ReportInput};

/// A value is regarded as at the end of its range if its distance from the end is at most this
/// fraction of the range.
pub(super) const AT_END: f32 = 1e-3;
/// Relative increase of the brightest state for which a gain is measured.
pub(super) const BRIGHTER: f64 = 0.01;
/// Number of bits that is assumed if no layer declares its bits.
pub(super) const USUAL_BITS: u32 = 8;

/// A variant of the display or the stack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variant {
    /// The display and the stack are unchanged.
    Given,
    /// Values that are at the brightest state become slightly brighter.
    Brighter,
    /// Values that are at the darkest state become black, unless the darkest state is black
    /// already.
    Black,
    /// The layers' values are rounded to the panels' codes.
    Quantized,
    /// The layers have neither blur nor crosstalk.
    SharpAndPure,
    /// The mean over frames replaces every frame.
    Still,
}

/// Returns the variants that apply to this display, [`Variant::Given`] first.
pub(super) fn variants(input: &ReportInput) -> Vec<Variant> {
    let layers = &input.display.layers;
    let mut variants = vec![Variant::Given, Variant::Quantized];
    if input.display.formation != Formation::Polarization {
        variants.push(Variant::Brighter);
    }
    let emission_floor = match &input.display.backlight {
        Backlight::Lenslets(backlight) => backlight.range()[0] > 0.0,
        Backlight::Uniform => false,
    };
    if emission_floor || layers.iter().any(|layer| layer.range()[0] > 0.0) {
        variants.push(Variant::Black);
    }
    if layers.iter().any(|layer| layer.blur_px > 0.0 || layer.crosstalk.is_some()) {
        variants.push(Variant::SharpAndPure);
    }
    if input.stack.frames() > 1 {
        variants.push(Variant::Still);
    }
    variants
}

impl Variant {
    pub(super) fn apply<'a>(self, input: &ReportInput<'a>) -> (Cow<'a, Display>, Cow<'a, LayerStack>) {
        let (display, stack) = (Cow::Borrowed(input.display), Cow::Borrowed(input.stack));
        match self {
            Self::Given => (display, stack),
            Self::Brighter => {
                let factors = match display.formation {
                    Formation::Additive => 1.0,
                    // Distribute the increase over the layers and a directional backlight, so that
                    // a fully open display is brighter by BRIGHTER in total.
                    _ => (stack.layers.len() + usize::from(stack.emission.is_some())) as f64,
                };
                let factor = (1.0 + BRIGHTER).powf(1.0 / factors) as f32;
                let brighter = changed(
                    input,
                    |value, [_, high], width| {
                        if value >= high - AT_END * width { value * factor } else { value }
                    },
                );
                (display, Cow::Owned(brighter))
            }
            Self::Black => {
                let black =
                    changed(input, |value, [low, _], width| if value <= low + AT_END * width { 0.0 } else { value });
                (display, Cow::Owned(black))
            }
            Self::Quantized => {
                let mut stack = stack.into_owned();
                for (values, layer) in stack.layers.iter_mut().zip(&input.display.layers) {
                    if let Some(levels) = levels(input.display, layer) {
                        values.data_mut().par_iter_mut().for_each(|value| *value = quantize(*value, &levels));
                    }
                }
                (display, Cow::Owned(stack))
            }
            Self::SharpAndPure => {
                let mut display = display.into_owned();
                display.layers.iter_mut().for_each(|layer| (layer.blur_px, layer.crosstalk) = (0.0, None));
                (Cow::Owned(display), stack)
            }
            Self::Still => {
                let mut stack = stack.into_owned();
                let parts = stack.layers.iter_mut().map(|layer| layer.data_mut());
                let frames = input.stack.frames();
                for data in parts.chain(stack.emission.as_mut().map(|emission| emission.data_mut())) {
                    let size = data.len() / frames;
                    for i in 0..size {
                        let mean = (0..frames).map(|m| data[m * size + i]).sum::<f32>() / frames as f32;
                        (0..frames).for_each(|m| data[m * size + i] = mean);
                    }
                }
                (display, Cow::Owned(stack))
            }
        }
    }
}

/// Returns true if any layer declares a number of bits.
pub(super) fn bits_are_given(display: &Display) -> bool {
    display.layers.iter().any(|layer| layer.bits.is_some())
}

/// Returns the levels that a layer's values can have: the levels of its codes. If no layer declares
/// its bits, these are the levels of 8 bits. `None` if only other layers declare their bits.
fn levels(display: &Display, layer: &Layer) -> Option<Vec<f32>> {
    if bits_are_given(display) {
        return layer.levels();
    }
    Layer { bits: Some(USUAL_BITS), ..layer.clone() }.levels()
}

/// Returns a stack in which every value is changed. `change` receives the value, its range, and the
/// width of the range.
fn changed(input: &ReportInput, change: impl Fn(f32, [f32; 2], f32) -> f32 + Sync) -> LayerStack {
    let mut stack = input.stack.clone();
    let ranges = input.display.layers.iter().map(Layer::range).chain(emission_range(input.display));
    let parts = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for (data, range) in parts.chain(stack.emission.as_mut().map(|emission| emission.data_mut())).zip(ranges) {
        let width = range[1] - range[0];
        data.par_iter_mut().for_each(|value| *value = change(*value, range, width));
    }
    stack
}

pub(super) fn emission_range(display: &Display) -> Option<[f32; 2]> {
    match &display.backlight {
        Backlight::Lenslets(backlight) => Some(backlight.range()),
        Backlight::Uniform => None,
    }
}

/// Returns the error of a variant over the central view and the corner views, and the sums for
/// regressions between the variant's light and the target.
pub(super) fn simulated_error(
    input: &ReportInput,
    display: &Display,
    stack: &LayerStack,
    task: Task,
) -> Result<(SquaredError, Tone), ReportError> {
    let geometry = input.target.geometry();
    let (simulator, map) = (Simulator::new(display, stack), RayMap::new(display, geometry));
    let brightness = input.stack.brightness;
    let (mut error, mut tone) = (SquaredError::default(), Tone::default());
    for together in outstanding_views(&geometry.grid).chunks(rayon::current_num_threads()) {
        task.cancel.check()?;
        let done: Vec<_> = together
            .par_iter()
            .map(|&view| {
                let emitted = simulator.view(&map, geometry, view);
                let counts = counting(&emitted, geometry, input.weights, view);
                let target = input.target.view(view);
                let error = view_error(&emitted, target, brightness, |i| if counts[i] { 1.0 } else { 0.0 });
                (error, Tone::of(emitted.radiance.data(), target, brightness, &counts))
            })
            .collect();
        for (view_error, view_tone) in done {
            (error, tone) = (error.merged(view_error), tone.merged(view_tone));
            task.progress.advance(1, "");
        }
    }
    Ok((error, tone))
}

/// Sums for linear regressions between L̃/β and L.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tone {
    count: f64,
    /// Σx, Σy, Σx², Σxy and Σy² for x = L̃/β and y = L.
    sums: [f64; 5],
}

impl Tone {
    fn of(emitted: &[f32], target: &[f32], brightness: f64, counts: &[bool]) -> Self {
        let mut tone = Self::default();
        let pixels = emitted.chunks_exact(3).zip(target.chunks_exact(3)).zip(counts);
        for ((emitted, target), _) in pixels.filter(|(_, counts)| **counts) {
            for (x, y) in emitted.iter().zip(target) {
                let (x, y) = (f64::from(*x) / brightness, f64::from(*y));
                tone.count += 1.0;
                tone.sums.iter_mut().zip([x, y, x * x, x * y, y * y]).for_each(|(sum, value)| *sum += value);
            }
        }
        tone
    }

    fn merged(self, other: Self) -> Self {
        let sums = std::array::from_fn(|i| self.sums[i] + other.sums[i]);
        Self { count: self.count + other.count, sums }
    }

    /// Returns (offset, slope, fraction) with x = L̃/β and y = L. Offset and slope belong to the
    /// line x ≈ offset + slope·y, which approximates the shown value x of a target value y. The
    /// fraction is the fraction of the squared error that the best line y ≈ a + b·x would remove.
    /// `None` if x or y hardly varies, or if there is hardly any error.
    pub(super) fn fit(self) -> Option<(f64, f64, f64)> {
        let [x, y, xx, xy, yy] = self.sums.map(|sum| sum / self.count);
        let (var_x, var_y, cov) = (xx - x * x, yy - y * y, xy - x * y);
        let error = xx - 2.0 * xy + yy;
        if !(var_x > 1e-12 && var_y > 1e-12 && error > 1e-12) {
            return None;
        }
        let slope = cov / var_y;
        let left = (var_y - cov * cov / var_x).max(0.0);
        Some((x - slope * y, slope, (1.0 - left / error).clamp(0.0, 1.0)))
    }
}
