//! The error of a display's emission against its target.
//!
//! PSNR has a peak of 1. It includes all channels of all valid rays of weight w > 0. `psnr_view`
//! compares L̃/β, the picture that an adapted viewer sees, with L. `psnr_raw` compares L̃ with βL,
//! so `psnr_raw` exceeds `psnr_view` by −20·log10 β.

use lumistack_core::metrics::SquaredError;

use crate::{Display, EmittedView, LayerStack, LightField, RayMap, Simulator, Weights};

/// Errors of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewScore {
    /// Position of the view in the grid: [view_y, view_x].
    pub view: [usize; 2],
    /// Squared error of L̃/β against L.
    pub error: SquaredError,
}

/// Errors of a light field, view by view.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// The errors of all views, row by row.
    pub views: Vec<ViewScore>,
    brightness: f64,
}

impl Score {
    /// Returns the PSNR of L̃/β against L over all rays, dB.
    pub fn psnr_view(&self) -> f64 {
        self.total().psnr()
    }

    /// Returns the PSNR of L̃ against βL over all rays, dB.
    pub fn psnr_raw(&self) -> f64 {
        self.total().psnr() - 20.0 * self.brightness.log10()
    }

    fn total(&self) -> SquaredError {
        self.views.iter().fold(SquaredError::default(), |sum, view| sum.merged(view.error))
    }
}

/// Returns the squared error of `emitted` / `brightness` against the view `target`,
/// `[row][col][rgb]`. The error includes valid rays for which `weight(index of the pixel)` is above
/// 0.
pub fn view_error(
    emitted: &EmittedView,
    target: &[f32],
    brightness: f64,
    weight: impl Fn(usize) -> f32,
) -> SquaredError {
    let mut error = SquaredError::default();
    let pixels = emitted.radiance.data().chunks_exact(3).zip(target.chunks_exact(3)).zip(&emitted.valid);
    for (i, ((emitted, target), &valid)) in pixels.enumerate() {
        if valid && weight(i) > 0.0 {
            for c in 0..3 {
                error.add(f64::from(emitted[c]) / brightness, f64::from(target[c]));
            }
        }
    }
    error
}

/// Simulates every view of the target and compares it with the target.
pub fn score(display: &Display, stack: &LayerStack, target: &LightField, weights: &Weights) -> Score {
    let geometry = target.geometry();
    let (simulator, map) = (Simulator::new(display, stack), RayMap::new(display, geometry));
    let views = geometry.grid.iter().map(|view| {
        let emitted = simulator.view(&map, geometry, view);
        let weight = |i: usize| weights.at(view, i / geometry.cols, i % geometry.cols);
        ViewScore { view, error: view_error(&emitted, target.view(view), stack.brightness, weight) }
    });
    Score { views: views.collect(), brightness: stack.brightness }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::tests::small_display;

    #[test]
    fn both_conventions_differ_by_the_brightness() {
        let display = small_display();
        let stack = LayerStack::filled(&display, 0.5);
        let mut target = LightField::black(display.geometry().unwrap()).unwrap();
        target.radiance_mut().data_mut().fill(0.125 / 0.2 + 0.1);
        let score = score(&display, &stack, &target, &Weights::Uniform);
        assert!((score.psnr_view() - 20.0).abs() < 1e-4, "{}", score.psnr_view());
        assert!((score.psnr_raw() - (20.0 - 20.0 * 0.2f64.log10())).abs() < 1e-4);
        assert!(score.views[0].error.count < score.views[4].error.count, "corner views lose rays at the border");
    }
}
