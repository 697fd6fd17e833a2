//! Tests unlit values: they are dark at the end of a run, and the picture loses nothing.

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{LayerStack, RayMap};
use lumistack_simd::Backend;

use crate::problems::{Kind, Owned, display, random};
use lumistack_factorizer::device::Updater;
use lumistack_factorizer::internals::Engine;
use lumistack_factorizer::{Settings, StartKind, factorize, random_start};

/// Largest PSNR that darkening at the end of a run may cost, dB.
const COST_DB: f64 = 1e-3;
/// Transmittance of the other layer below which these tests treat a pixel as unlit. It is far below
/// the solver's own limit, 10⁻⁴ of the brightness.
const UNLIT: f32 = 1e-6;

/// Largest allowed value of an unlit pixel. It is not 0, since the solver darkens one layer after
/// the other. Where the second layer becomes dark, pixels of the first layer become unlit, and keep
/// their values. The second layer becomes dark only where these values are below the solver's
/// limit.
const BLACK: f32 = 1e-4;

/// Returns a problem with two layers of three frames. The left half of the target is black; its
/// right half has waves.
fn half_black() -> Owned {
    let mut display = display([40, 24], [3, 3], &[-5.3, 5.1], 3);
    display.brightness = 0.5;
    let mut owned = Owned::constant(display, 0.0);
    let geometry = owned.target.geometry().clone();
    for view in geometry.grid.iter() {
        for (i, pixel) in owned.target.view_mut(view).chunks_exact_mut(3).enumerate() {
            let (col, row) = ((i % geometry.cols) as f32, (i / geometry.cols) as f32);
            if col >= 20.0 {
                pixel.fill(0.5 + 0.4 * (0.8 * col + view[1] as f32).sin() * (0.6 * row + view[0] as f32).cos());
            }
        }
    }
    owned
}

fn solve(owned: &Owned, settings: &Settings, warm: Option<&LayerStack>) -> (LayerStack, f64) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let made = factorize(&owned.problem(), settings, warm, task, &mut |_| ()).unwrap();
    let psnr = made.history.last().unwrap().psnr_view;
    (made.stack, psnr)
}

/// For each value of each layer, returns the largest value of the other layer in the same frame,
/// over all rays through the pixel. `None` for a pixel without rays. This function requires two
/// layers and nearest sampling.
fn light(owned: &Owned, stack: &LayerStack) -> [Vec<Option<f32>>; 2] {
    let geometry = owned.target.geometry();
    let map = RayMap::new(&owned.display, geometry);
    [0, 1].map(|n: usize| {
        let (own, other) = (&map.layers[n], &map.layers[1 - n]);
        let [frames, rows, cols, _] = stack.layers[n].shape();
        let mut light = vec![None; frames * rows * cols * 3];
        for [view_y, view_x] in geometry.grid.iter() {
            for (row, col) in (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| (row, col))) {
                let taps = [own, other].map(|map| [map.y.of_view(view_y)[row], map.x.of_view(view_x)[col]]);
                if taps.iter().flatten().any(|tap| tap.is_missed()) {
                    continue;
                }
                let [[y, x], [other_y, other_x]] = taps.map(|taps| taps.map(|tap| tap.first as usize));
                for (m, c) in (0..frames).flat_map(|m| (0..3).map(move |c| (m, c))) {
                    let a = stack.layers[1 - n].get([m, other_y, other_x, c]);
                    let most = &mut light[((m * rows + y) * cols + x) * 3 + c];
                    *most = Some(most.map_or(a, |most: f32| most.max(a)));
                }
            }
        }
        light
    })
}

#[test]
fn where_no_light_reaches_masks_are_black_from_every_start() {
    let owned = half_black();
    for solver in ["auto", "block-exact"] {
        let solutions = [1, 2].map(|seed| {
            let start = Some(StartKind::Random);
            let settings = Settings { solver: solver.into(), seed, start, iterations: 20, ..Settings::default() };
            let (stack, _) = solve(&owned, &settings, None);
            let light = light(&owned, &stack);
            (stack, light)
        });
        let mut unlit = 0;
        for n in 0..2 {
            let [a, b] = solutions.each_ref().map(|(stack, light)| (stack.layers[n].data(), &light[n]));
            for i in 0..a.0.len() {
                let dark = |of: (&[f32], &Vec<Option<f32>>)| of.1[i].is_some_and(|light| light <= UNLIT);
                for solution in [a, b].into_iter().filter(|solution| dark(*solution)) {
                    assert!(solution.0[i] <= BLACK, "{solver}, layer {n}, value {i}: {}", solution.0[i]);
                }
                if dark(a) && dark(b) {
                    unlit += 1;
                }
            }
        }
        // more than half of the values in the black half are unlit: 2 layers × 3 frames × 3
        // channels × 20 × 24 pixels
        assert!(unlit > 2 * 3 * 3 * 20 * 24 / 2, "{solver}: {unlit} unlit values");
    }
}

#[test]
fn the_end_of_a_run_costs_nothing_and_is_the_same_by_every_kernel() {
    let owned = half_black();
    let problem = owned.problem();
    let (stack, _) = solve(&owned, &Settings { iterations: 0, ..Settings::default() }, None);
    let mut ended = Vec::new();
    for (set, fast) in Backend::available().iter().flat_map(|backend| [(*backend, false), (*backend, true)]) {
        let mut engine = Engine::new(&problem, stack.clone(), 0.0).unwrap();
        for _ in 0..10 {
            (0..engine.plan().factor_count()).for_each(|n| {
                engine.update(n, lumistack_factorizer::device::Rule::Block { sweeps: 4 }, None);
            });
        }
        let before = engine.download();
        // every kernel ends a run from the same patterns
        let first = ended.first().map_or(before.clone(), |(first, _): &(LayerStack, LayerStack)| first.clone());
        let mut engine = Engine::new(&problem, first.clone(), 0.0).unwrap();
        engine.use_kernel(set, fast);
        let psnr = engine.objective().psnr_view;
        engine.darken_unlit();
        assert!(engine.objective().psnr_view > psnr - COST_DB, "{set:?} {fast}: {psnr} dB before");
        ended.push((first, engine.download()));
    }
    let changed = ended[0].0.layers[0].data().iter().zip(ended[0].1.layers[0].data()).filter(|(a, b)| a != b);
    assert!(changed.count() > 100, "too few unlit values were darkened");
    for (_, other) in &ended[1..] {
        assert!(*other == ended[0].1);
    }
}

#[test]
fn darkening_changes_no_value_that_light_reaches_on_any_display() {
    for kind in Kind::ALL {
        for seed in 0..6 {
            let owned = random(kind, seed);
            let problem = owned.problem();
            let mut engine = Engine::new(&problem, random_start(&owned.display, seed), 0.0).unwrap();
            (0..engine.plan().factor_count()).for_each(|n| {
                engine.update(n, lumistack_factorizer::device::Rule::Block { sweeps: 4 }, None);
            });
            let before = engine.objective();
            engine.darken_unlit();
            let after = engine.objective();
            let same = before.psnr_view.is_nan() || after.psnr_view > before.psnr_view.min(80.0) - COST_DB;
            assert!(same, "{kind:?} {seed}: {before:?} to {after:?}");
        }
    }
}

#[test]
fn pixels_that_no_ray_reaches_keep_what_they_have() {
    let mut display = display([20, 12], [3, 3], &[-5.3, 5.1], 2);
    // Layers are wider than the field, so that some pixels have no rays.
    for layer in &mut display.layers {
        layer.resolution = [60, 36];
    }
    let owned = Owned::constant(display, 0.0);
    let start = random_start(&owned.display, 3);
    let (stack, _) = solve(&owned, &Settings { iterations: 3, ..Settings::default() }, Some(&start));
    let light = light(&owned, &stack);
    for n in 0..2 {
        let (ends, starts) = (stack.layers[n].data(), start.layers[n].data());
        let mut unreached = 0;
        for (i, light) in light[n].iter().enumerate() {
            match light {
                None => {
                    assert_eq!(ends[i], starts[i], "layer {n}, value {i}");
                    unreached += 1;
                }
                Some(_) => assert_eq!(ends[i], 0.0, "a black target"),
            }
        }
        assert!(unreached > 1000);
    }
}

#[test]
fn black_patterns_are_a_start_like_any_other() {
    let owned = half_black();
    let black = LayerStack::filled(&owned.display, 0.0);
    for iterations in [1, 5] {
        let settings = Settings { solver: "block-exact".into(), iterations, ..Settings::default() };
        let (_, psnr) = solve(&owned, &settings, Some(&black));
        // The limit is low, since all frames start equal and there are few iterations.
        assert!(psnr > 12.0, "{psnr} dB after {iterations} iterations from black");
    }
    // a mask that was black in one time step becomes bright in the next
    let dark = Owned::constant(owned.display.clone(), 0.0);
    let (before, _) = solve(&dark, &Settings { iterations: 5, ..Settings::default() }, None);
    assert!(before.layers.iter().all(|layer| layer.data().iter().all(|value| *value == 0.0)));
    let bright = Owned::constant(owned.display.clone(), 0.6);
    let (_, psnr) = solve(&bright, &Settings { iterations: 2, ..Settings::default() }, Some(&before));
    assert!(psnr > 30.0, "{psnr} dB");
}
