//! Flicker: the change of a display's error from one time step to the next.
//!
//! ```text
//! e_t = L̃_t/β − L_t                                     error of a ray at time step t
//! flicker_t = rms over rays and channels of e_t − e_(t−1)
//!           = rms of (L̃_t − L̃_(t−1))/β − (L_t − L_(t−1))
//! ```
//!
//! Flicker is the change that a viewer sees and should not see. A constant error does not flicker.
//! Flicker is computed in linear light, over the rays with a weight above 0 that hit the display.
//! The score is −20·log10(flicker) in dB: the PSNR (peak 1) of the change of the emission against
//! the change of the target. If errors of neighbouring time steps are independent, the score is 3
//! dB less than `psnr_view`.
//!
//! Eyes are most sensitive where nothing else moves. Therefore a second score includes only still
//! rays: rays along which the target's 8-bit sRGB codes change by at most [`STILL_CODES`].

use lumistack_core::colour::srgb_code;
use lumistack_core::metrics::SquaredError;
use lumistack_core::{Cancelled, Task};
use lumistack_display::{Display, LayerStack, LightField, RayMap, Simulator, Weights};
use rayon::prelude::*;

/// Largest change of the target along a still ray, 8-bit sRGB codes.
const STILL_CODES: u8 = 1;

/// Patterns and target of a time step.
#[derive(Clone, Copy)]
pub(crate) struct Shown<'a> {
    pub(crate) stack: &'a LayerStack,
    pub(crate) target: &'a LightField,
}

/// Errors of a time step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TimeError {
    /// Error of the emission, L̃/β, against the target L.
    pub(crate) error: SquaredError,
    /// Error of the change of the emission, L̃/β, against the change of the target L, over all
    /// rays.
    pub(crate) change: SquaredError,
    /// The same error as `change`, but only over still rays: rays along which the target hardly
    /// changes.
    pub(crate) still: SquaredError,
}

/// Simulates all views of a time step and of the previous one, and sums their errors. Without a
/// previous time step, `change` and `still` are empty.
///
/// # Errors
/// If cancelled.
pub(crate) fn measure(
    display: &Display,
    now: Shown<'_>,
    before: Option<Shown<'_>>,
    weights: &Weights,
    task: Task<'_>,
) -> Result<TimeError, Cancelled> {
    let geometry = now.target.geometry();
    let map = RayMap::new(display, geometry);
    let (simulator, earlier) = (Simulator::new(display, now.stack), before.map(|b| Simulator::new(display, b.stack)));
    let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
    // Sum the errors of one view; both time steps have the same rays.
    let of_view = |view: [usize; 2]| -> Result<TimeError, Cancelled> {
        task.cancel.check()?;
        let emitted = simulator.view(&map, geometry, view);
        let emitted_before = earlier.as_ref().map(|earlier| earlier.view(&map, geometry, view));
        let mut sums = TimeError::default();
        for (pixel, wanted) in now.target.view(view).chunks_exact(3).enumerate() {
            if !emitted.valid[pixel] || weights.at(view, pixel / geometry.cols, pixel % geometry.cols) <= 0.0 {
                continue;
            }
            let shown = |radiance: &[f32], beta: f64| [0, 1, 2].map(|c| f64::from(radiance[3 * pixel + c]) / beta);
            let now_shown = shown(emitted.radiance.data(), now.stack.brightness);
            (0..3).for_each(|c| sums.error.add(now_shown[c], f64::from(wanted[c])));
            let (Some(before), Some(emitted_before)) = (before, &emitted_before) else { continue };
            let then_shown = shown(emitted_before.radiance.data(), before.stack.brightness);
            let then_wanted = &before.target.view(view)[3 * pixel..][..3];
            let still = (0..3).all(|c| srgb_code(wanted[c]).abs_diff(srgb_code(then_wanted[c])) <= STILL_CODES);
            for c in 0..3 {
                let (change, change_wanted) =
                    (now_shown[c] - then_shown[c], f64::from(wanted[c]) - f64::from(then_wanted[c]));
                sums.change.add(change, change_wanted);
                if still {
                    sums.still.add(change, change_wanted);
                }
            }
        }
        Ok(sums)
    };
    // Join the sums in the order of the views, so that the result does not depend on the number of
    // threads.
    let of_views: Vec<TimeError> = views.into_par_iter().map(of_view).collect::<Result<_, _>>()?;
    Ok(of_views.into_iter().fold(TimeError::default(), |sum, view| TimeError {
        error: sum.error.merged(view.error),
        change: sum.change.merged(view.change),
        still: sum.still.merged(view.still),
    }))
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;
    use lumistack_core::{Cancel, Collector};

    use super::*;
    use crate::presets;

    /// Tolerance against the oracle, dB. Both computations sum the values of the simulator in f64.
    const AGREEMENT_DB: f64 = 1e-6;

    fn display() -> Display {
        let mut display = presets::load("fig7-uniform").unwrap().with_resolution([24, 15]);
        (display.frames, display.field.views) = (2, lumistack_display::Views::Fixed([3, 2]));
        display
    }

    fn random_stack(display: &Display, seed: u64) -> LayerStack {
        let (mut stack, mut random) = (LayerStack::filled(display, 0.5), Stream::new(seed));
        stack.layers.iter_mut().flat_map(|layer| layer.data_mut()).for_each(|value| *value = random.next_f32());
        stack
    }

    /// Returns a random target whose right half is the same for all seeds.
    fn random_target(display: &Display, seed: u64) -> LightField {
        let mut target = LightField::black(display.geometry().unwrap()).unwrap();
        let (cols, mut still, mut moving) = (target.geometry().cols, Stream::new(77), Stream::new(seed));
        for (pixel, rgb) in target.radiance_mut().data_mut().chunks_exact_mut(3).enumerate() {
            let (a, b) = (still.next_f32(), moving.next_f32());
            rgb.fill(if pixel % cols >= cols / 2 { a } else { b });
        }
        target
    }

    fn measured(display: &Display, now: Shown<'_>, before: Shown<'_>, weights: &Weights) -> TimeError {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        measure(display, now, Some(before), weights, Task::quiet(&warnings, &cancel)).unwrap()
    }

    #[test]
    fn a_naive_computation_gives_the_same() {
        let display = display();
        let stacks = [1, 2].map(|seed| random_stack(&display, seed));
        let targets = [3, 4].map(|seed| random_target(&display, seed));
        let [before, now] = [0, 1].map(|t| Shown { stack: &stacks[t], target: &targets[t] });
        let found = measured(&display, now, before, &Weights::Uniform);
        // Oracle: list the error L̃/β − L of every ray for both time steps, then subtract the
        // lists.
        let geometry = now.target.geometry();
        let map = RayMap::new(&display, geometry);
        let errors = |shown: Shown<'_>| -> Vec<f64> {
            let simulator = Simulator::new(&display, shown.stack);
            let view = |view| {
                let emitted = simulator.view(&map, geometry, view);
                let values = emitted.radiance.data().iter().zip(shown.target.view(view)).enumerate();
                let error = |(i, (l, t)): (usize, (&f32, &f32))| {
                    if emitted.valid[i / 3] { f64::from(*l) / display.brightness - f64::from(*t) } else { f64::NAN }
                };
                values.map(error).collect::<Vec<_>>()
            };
            geometry.grid.iter().flat_map(view).collect()
        };
        let (now_errors, then_errors) = (errors(now), errors(before));
        let decibels = |of: &dyn Fn(usize) -> bool| {
            let squares = (0..now_errors.len()).filter(|i| of(*i) && !now_errors[*i].is_nan());
            let squares: Vec<f64> = squares.map(|i| (now_errors[i] - then_errors[i]).powi(2)).collect();
            -10.0 * (squares.iter().sum::<f64>() / squares.len() as f64).log10()
        };
        assert!((found.change.psnr() - decibels(&|_| true)).abs() < AGREEMENT_DB);
        let right_half = |i: usize| (i / 3) % geometry.cols >= geometry.cols / 2;
        // Compare codes in the left half too, since there a random ray may keep its code by chance.
        let same = |i: usize| {
            let code = |target: &LightField| srgb_code(target.radiance().data()[i]);
            code(now.target).abs_diff(code(before.target)) <= STILL_CODES
        };
        assert!((found.still.psnr() - decibels(&|i| right_half(i) || same(i))).abs() < AGREEMENT_DB);
        assert!(found.still.count > found.change.count / 3 && found.still.count < found.change.count);
        let score = lumistack_display::score(&display, now.stack, now.target, &Weights::Uniform);
        assert!((found.error.psnr() - score.psnr_view()).abs() < AGREEMENT_DB);
    }

    #[test]
    fn an_error_that_stands_still_does_not_flicker() {
        let display = display();
        let (stack, target) = (random_stack(&display, 1), random_target(&display, 3));
        let shown = Shown { stack: &stack, target: &target };
        let found = measured(&display, shown, shown, &Weights::Uniform);
        assert!(found.error.psnr() < 20.0, "the error itself is large");
        assert_eq!((found.change.sum, found.change.psnr()), (0.0, f64::INFINITY));
        assert_eq!(found.still.count, found.change.count);
    }

    #[test]
    fn rays_without_weight_do_not_count() {
        let display = display();
        let stacks = [1, 2].map(|seed| random_stack(&display, seed));
        let target = random_target(&display, 3);
        let [before, now] = [0, 1].map(|t| Shown { stack: &stacks[t], target: &target });
        let mut one = lumistack_core::Tensor::zeros(["view_y", "view_x"], [2, 3]);
        *one.at_mut([1, 2]) = 0.5;
        let all = measured(&display, now, before, &Weights::Uniform);
        let found = measured(&display, now, before, &Weights::PerView(one));
        assert!(found.error.count * 5 < all.error.count && found.error.count > 0);
        assert_eq!(found.change.count, found.error.count);
    }
}
