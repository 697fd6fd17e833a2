//! What hardware does to a solution that ignores it, and what is left of that when the solver knows.

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, LayerColour, LayerStack, LightField, Sampling, Weights, score};

use super::fields::{display, light_field};
use crate::{Factorization, Problem, Settings, factorize};

/// Iterations of every solve; enough for the differences to settle to about 0.2 dB.
const ITERATIONS: u32 = 30;

/// A loss that is none: what solutions differ by after so few iterations, dB.
const NOTHING: f64 = 0.2;

fn solve(display: &Display, target: &LightField, levels: bool) -> Factorization {
    let problem = Problem { display, target, weights: &Weights::Uniform };
    let settings = Settings { iterations: ITERATIONS, report_every: ITERATIONS, levels, ..Settings::default() };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| ()).unwrap()
}

/// PSNR on a display whose layers cannot leave their range, nor show a colour where they have none.
fn shown(display: &Display, stack: &LayerStack, target: &LightField) -> f64 {
    let mut stack = stack.clone();
    for (layer, values) in display.layers.iter().zip(&mut stack.layers) {
        let [low, high] = layer.range();
        values.data_mut().iter_mut().for_each(|value| *value = value.clamp(low, high));
        if layer.colour == LayerColour::Mono {
            for pixel in values.data_mut().chunks_exact_mut(3) {
                let mean = pixel.iter().sum::<f32>() / 3.0;
                pixel.fill(mean);
            }
        }
    }
    score(display, &stack, target, &Weights::Uniform).psnr_view()
}

/// [without the effect, with it and ignored, with it and modelled], dB.
fn effect(what: &str, target: &LightField, ideal: &Display, real: &Display) -> [f64; 3] {
    let blind = solve(ideal, target, true).stack;
    let figures = [
        score(ideal, &blind, target, &Weights::Uniform).psnr_view(),
        shown(real, &blind, target),
        shown(real, &solve(real, target, true).stack, target),
    ];
    println!("{what}: ideal {:.1}, ignored {:.1}, modelled {:.1} dB", figures[0], figures[1], figures[2]);
    figures
}

#[test]
fn modelling_an_effect_recovers_at_least_half_of_what_it_costs() {
    let ideal = display(5, 3, 6, 0.2);
    let Some(target) = light_field("main_5x5_160x100_fov20", &ideal) else { return };
    let each = |change: &dyn Fn(&mut lumistack_display::Layer)| {
        let mut real = ideal.clone();
        real.layers.iter_mut().for_each(change);
        real
    };
    let rear = |change: &dyn Fn(&mut lumistack_display::Layer)| {
        let mut real = ideal.clone();
        change(&mut real.layers[0]);
        real
    };
    let leak = |share: f64| {
        let row = |own: usize| [0, 1, 2].map(|c: usize| if c == own { 1.0 - 2.0 * share } else { share });
        Some([row(0), row(1), row(2)])
    };
    for (what, real) in [
        ("contrast 1000:1", each(&|layer| layer.black_level = 1e-3)),
        ("contrast 200:1", each(&|layer| layer.black_level = 5e-3)),
        ("contrast 50:1", each(&|layer| layer.black_level = 0.02)),
        ("peak 0.8", each(&|layer| layer.peak = 0.8)),
        ("blur of one layer, 0.5 px", rear(&|layer| layer.blur_px = 0.5)),
        ("blur of one layer, 1 px", rear(&|layer| layer.blur_px = 1.0)),
        ("crosstalk of 5 %", each(&|layer| layer.crosstalk = leak(0.05))),
        ("one layer without colour", rear(&|layer| layer.colour = LayerColour::Mono)),
    ] {
        let [ideal, ignored, modelled] = effect(what, &target, &ideal, &real);
        let lost = ideal - ignored;
        assert!(modelled >= ignored + if lost > NOTHING { lost / 2.0 } else { -NOTHING }, "{what}");
        assert!(what != "contrast 50:1" || modelled >= ideal - 1.0, "{what}");
    }
}

#[test]
fn a_known_misalignment_is_part_of_the_ray_map() {
    let ideal = Display { sampling: Sampling::Bilinear, ..display(5, 3, 6, 0.2) };
    let Some(target) = light_field("main_5x5_160x100_fov20", &ideal) else { return };
    for pixels in [0.25, 0.5] {
        let mut real = ideal.clone();
        real.layers[0].offset_mm = [pixels * real.layers[0].pitch_mm; 2];
        let [ideal, ignored, modelled] = effect(&format!("rear layer off by {pixels} px"), &target, &ideal, &real);
        assert!(modelled >= ignored + (ideal - ignored) / 2.0, "{pixels}");
    }
}

#[test]
fn few_bits_cost_less_when_the_patterns_know_them() {
    let ideal = display(3, 3, 6, 0.2);
    let Some(target) = light_field("teapot_3x3_160x100_fov20", &ideal) else { return };
    for (bits, least) in [(2, 6.0), (4, 6.0), (8, 6.0)] {
        let mut real = ideal.clone();
        real.layers.iter_mut().for_each(|layer| layer.bits = Some(bits));
        let result = solve(&real, &target, true);
        let loss = result.levels.unwrap();
        println!("{bits} bits: {loss:.1?}");
        assert!(loss.reoptimized >= loss.rounded + least, "{bits} bits: {loss:?}");
        let levels = real.layers[0].levels().unwrap();
        let on_a_level = |value: &f32| levels.contains(value);
        assert!(result.stack.layers.iter().all(|layer| layer.data().iter().all(on_a_level)), "{bits} bits");
        let psnr = score(&real, &result.stack, &target, &Weights::Uniform).psnr_view();
        assert!((psnr - loss.reoptimized).abs() < 1e-2, "{psnr} {loss:?}");
    }
}
