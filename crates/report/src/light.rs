//! Absolute brightness: the fraction of the backlight's luminance that a display emits.
//!
//! `emitted` is the mean luminance of L̃ over all rays that scores include, relative to a backlight
//! of 1. For emissive layers, `emitted` is relative to an emission of 1. `open` is the mean
//! luminance of the picture from straight ahead if all layers are fully open.

use lumistack_core::colour::luminance;
use lumistack_core::metrics::Mean;
use lumistack_display::{Display, FieldGeometry, Formation, LayerStack, Projection, RayMap, Simulator, ViewGrid};

use crate::measure::FieldScore;
use crate::{ReportInput, format};

/// Luminances relative to the luminance of the backlight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Light {
    /// Mean of L̃.
    pub(crate) emitted: f64,
    /// Mean luminance of the target L, without the factor β.
    pub(crate) wanted: f64,
    /// Mean luminance if all pixels are at their brightest; NaN if no ray hits the display.
    pub(crate) open: f64,
}

pub(crate) fn light(input: &ReportInput, target: &FieldScore) -> Light {
    Light {
        emitted: target.mean(|view| view.emitted),
        wanted: target.mean(|view| view.wanted),
        open: open(input.display, input.target.geometry()),
    }
}

/// Returns the mean luminance, seen from straight ahead, of a display with all pixels at their
/// brightest.
fn open(display: &Display, geometry: &FieldGeometry) -> f64 {
    let mut display = Display { frames: 1, ..display.clone() };
    // A total rotation of 90° is the brightest; a larger rotation would darken the pixel again.
    let rotation: f64 = display.layers.iter().map(|layer| layer.peak).sum();
    let share = if display.formation == Formation::Polarization { (1.0 / rotation).min(1.0) } else { 1.0 };
    display.layers.iter_mut().for_each(|layer| layer.peak *= share);
    let mut stack = LayerStack::filled(&display, 1.0);
    for (values, layer) in stack.layers.iter_mut().zip(&display.layers) {
        values.data_mut().fill(layer.range()[1]);
    }
    let geometry = geometry.with_grid(ViewGrid::single(Projection::Oblique, [0.0; 2]));
    let view = Simulator::new(&display, &stack).view(&RayMap::new(&display, &geometry), &geometry, [0, 0]);
    let lit = view.radiance.data().chunks_exact(3).zip(&view.valid).filter(|(_, valid)| **valid);
    let one = |rgb: &[f32]| Mean { sum: f64::from(luminance([rgb[0], rgb[1], rgb[2]])), count: 1 };
    lit.fold(Mean::default(), |mean, (rgb, _)| mean.merged(one(rgb))).value()
}

impl Light {
    /// Describes the brightness in a few sentences.
    pub(crate) fn sentence(&self, input: &ReportInput) -> String {
        let display = input.display;
        if self.emitted.is_nan() {
            return "No ray of the target hits the display.".into();
        }
        let mut text = format!(
            "The mean luminance of the display is {} of {}. The target's mean luminance is {}, and β is {}.",
            format::percent(self.emitted),
            match display.formation {
                Formation::Additive => "the emission of one fully driven layer",
                _ => "its backlight's luminance",
            },
            format::number(self.wanted),
            format::number(input.stack.brightness),
        );
        // State the fraction of light that open layers transmit. Then report if the display cannot
        // reach a white of brightness β.
        let peaks: Vec<f64> = display.layers.iter().map(|layer| layer.peak).collect();
        if display.formation == Formation::Attenuating && self.open.is_finite() {
            text += &if self.open > 1.0 - 1e-6 {
                " Fully open layers would transmit all light of the backlight.".into()
            } else {
                let listed = peaks.iter().map(|peak| format::number(*peak)).collect::<Vec<_>>().join(" · ");
                format!(
                    " Fully open layers transmit {} of the backlight's light (peak transmittances {listed}); the other {} is always lost.",
                    format::percent(self.open),
                    format::percent(1.0 - self.open)
                )
            };
        }
        if self.open < input.stack.brightness - 1e-6 {
            text += &format!(
                " A white of brightness β, {}, cannot be shown: the brightest white of this display has {}.",
                format::percent(input.stack.brightness),
                format::percent(self.open)
            );
        }
        text
    }
}
