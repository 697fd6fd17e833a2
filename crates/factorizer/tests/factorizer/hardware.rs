//! Measures the PSNR that hardware effects cost, with solvers that ignore the effects and with
//! solvers that model them.

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, EyeBox, Formation, LayerColour, LayerStack, LightField, Sampling, Weights, score};

use crate::fields::{display_of, light_field};
use lumistack_factorizer::device::Updater;
use lumistack_factorizer::internals::Engine;
use lumistack_factorizer::{Factorization, Problem, Settings, factorize};

/// Number of iterations of a solve; the last test makes half of them. With so few iterations, PSNR
/// differences vary by about 0.2 dB.
const ITERATIONS: u32 = 30;

/// Pixels of the display, columns × rows. Every effect acts within a few pixels, so the middle of
/// the light fields shows all effects.
const MIDDLE: [usize; 2] = [96, 60];

/// Limit in dB, below which PSNR differences are treated as noise, since solves have few
/// iterations.
const NEGLIGIBLE_DB: f64 = 0.2;

fn display(views: usize, layers: usize, frames: usize, brightness: f64) -> Display {
    display_of(MIDDLE, views, layers, frames, brightness)
}

fn solve(display: &Display, target: &LightField, levels: bool) -> Factorization {
    let problem = Problem { display, target, weights: &Weights::Uniform };
    let settings = Settings { iterations: ITERATIONS, report_every: ITERATIONS, levels, ..Settings::default() };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| ()).unwrap()
}

/// Returns the PSNR on a display with its real limits: values are clamped to each layer's range,
/// and monochrome layers show no colour.
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

/// Returns three PSNR values in dB. The effect is absent in the first. In the second the solver
/// ignores the effect, and in the third the solver models it. `blind` are the patterns that the
/// solver makes for the display `ideal`, without the effect.
fn effect(name: &str, target: &LightField, ideal: &Display, blind: &LayerStack, real: &Display) -> [f64; 3] {
    let figures = [
        score(ideal, blind, target, &Weights::Uniform).psnr_view(),
        shown(real, blind, target),
        shown(real, &solve(real, target, true).stack, target),
    ];
    println!("{name}: ideal {:.1}, ignored {:.1}, modelled {:.1} dB", figures[0], figures[1], figures[2]);
    figures
}

#[test]
fn modelling_an_effect_recovers_at_least_half_of_what_it_costs() {
    let ideal = display(5, 3, 6, 0.2);
    let Some(target) = light_field("main_5x5_160x100_fov20", &ideal) else { return };
    let blind = solve(&ideal, &target, true).stack;
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
    // measure each effect alone, on all layers or on the rear layer
    for (name, real) in [
        ("contrast 1000:1", each(&|layer| layer.black_level = 1e-3)),
        ("contrast 200:1", each(&|layer| layer.black_level = 5e-3)),
        ("contrast 50:1", each(&|layer| layer.black_level = 0.02)),
        ("peak 0.8", each(&|layer| layer.peak = 0.8)),
        ("blur of one layer, 0.5 px", rear(&|layer| layer.blur_px = 0.5)),
        ("blur of one layer, 1 px", rear(&|layer| layer.blur_px = 1.0)),
        ("crosstalk of 5 %", each(&|layer| layer.crosstalk = leak(0.05))),
        ("one layer without colour", rear(&|layer| layer.colour = LayerColour::Mono)),
    ] {
        let [ideal, ignored, modelled] = effect(name, &target, &ideal, &blind, &real);
        let lost = ideal - ignored;
        assert!(modelled >= ignored + if lost > NEGLIGIBLE_DB { lost / 2.0 } else { -NEGLIGIBLE_DB }, "{name}");
        assert!(name != "contrast 50:1" || modelled >= ideal - 1.0, "{name}");
    }
}

#[test]
fn a_known_misalignment_is_part_of_the_ray_map() {
    let ideal = Display { sampling: Sampling::Bilinear, ..display(5, 3, 6, 0.2) };
    let Some(target) = light_field("main_5x5_160x100_fov20", &ideal) else { return };
    let blind = solve(&ideal, &target, true).stack;
    for pixels in [0.25, 0.5] {
        let mut real = ideal.clone();
        real.layers[0].offset_mm = [pixels * real.layers[0].pitch_mm; 2];
        let name = format!("rear layer off by {pixels} px");
        let [ideal, ignored, modelled] = effect(&name, &target, &ideal, &blind, &real);
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

#[test]
fn weights_around_two_eyes_make_what_these_eyes_see_better() {
    // The eyes are far away, so each sees the whole display within the zone of the target's views.
    let display = display(5, 3, 3, 0.6);
    let Some(target) = light_field("main_5x5_160x100_fov20", &display) else { return };
    let eye = |x: f64| EyeBox { eye_mm: [x, 0.0, 3000.0], sigma_mm: 60.0, weight: 1.0 };
    let weights = Weights::eye_boxes(target.geometry(), &[eye(-200.0), eye(200.0)], 0.01).unwrap();
    let solve = |weights: &Weights| {
        let problem = Problem { display: &display, target: &target, weights };
        let settings = Settings { iterations: ITERATIONS, report_every: ITERATIONS, ..Settings::default() };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| ()).unwrap().stack
    };
    let problem = Problem { display: &display, target: &target, weights: &weights };
    let seen = |stack: LayerStack| Engine::new(&problem, stack, 0.0).unwrap().objective().value;
    let (blind, tracked) = (seen(solve(&Weights::Uniform)), seen(solve(&weights)));
    println!(
        "weighted error {blind:.4} without, {tracked:.4} with weights: {:.1} dB",
        10.0 * (blind / tracked).log10()
    );
    assert!(tracked < blind / 2.0, "{blind} {tracked}");
}

#[test]
fn every_image_formation_comes_closer_to_the_target() {
    for (formation, frames, brightness, least) in [
        (Formation::Additive, 1, 0.5, 21.2),
        (Formation::Polarization, 1, 1.0, 21.2),
        (Formation::Polarization, 3, 1.0, 23.3),
    ] {
        let display = Display { formation, ..display(5, 3, frames, brightness) };
        let Some(target) = light_field("main_5x5_160x100_fov20", &display) else { return };
        let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
        // Half the iterations are enough for these limits.
        let settings = Settings { iterations: ITERATIONS / 2, report_every: 5, ..Settings::default() };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let history = factorize(&problem, &settings, None, task, &mut |_| ()).unwrap().history;
        let curve: Vec<f64> = history.iter().map(|entry| entry.psnr_view).collect();
        println!("{formation:?}, M = {frames}: {curve:.2?}");
        assert!(curve[curve.len() - 1] >= least, "{formation:?}: {curve:.2?}");
    }
}
