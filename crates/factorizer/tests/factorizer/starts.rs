//! Compares warm starts with fresh starts: after five iterations, the start that `warm_start_pays`
//! chooses must not be clearly worse than the other start.

use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{LightField, Weights};

use crate::problems::{Owned, display};
use lumistack_factorizer::{Problem, Settings, factorize, warm_start_pays};

/// Returns a target with a wall of waves behind the display and a striped card in front of it, both
/// moved by `shift` pixels. A different value of `scene` gives other waves and stripes.
fn card(shift: f64, scene: f64) -> Owned {
    let display = display([64, 40], [5, 3], &[-8.0, 0.0, 8.0], 4);
    let geometry = display.geometry().unwrap();
    let mut target = LightField::black(geometry.clone()).unwrap();
    for view in geometry.grid.iter() {
        for (i, pixel) in target.view_mut(view).chunks_exact_mut(3).enumerate() {
            let point = [geometry.x_mm(i % geometry.cols), geometry.y_mm(i / geometry.cols)];
            let slope = geometry.grid.slope_at(view, point);
            let at = |z: f64| [point[0] - shift + z * slope[0], point[1] + z * slope[1]];
            let ([x, y], [u, v]) = (at(-12.0), at(6.0));
            let on_card = u.abs() < 14.0 && v.abs() < 9.0;
            for (c, value) in pixel.iter_mut().enumerate() {
                let k = 1.0 + 0.3 * c as f64 + 0.7 * scene;
                let wall = 0.45 + 0.3 * (0.4 * k * x + 3.0 * scene).sin() * (0.35 * k * y).cos();
                let stripes = 0.5 + 0.4 * (0.9 * u + k * 0.2 * v + scene).sin();
                *value = if on_card { stripes } else { wall } as f32;
            }
        }
    }
    Owned { display, target, weights: Weights::Uniform }
}

fn settings(solver: &str, iterations: u32) -> Settings {
    Settings { solver: solver.into(), iterations, ..Settings::default() }
}

/// Returns a target with a plane of smooth waves behind the display, moved by `shift` pixels.
/// `scene` changes the waves.
fn plane(shift: f64, scene: f64, brightness: f64) -> Owned {
    let mut display = display([64, 40], [5, 3], &[-13.3, 0.0, 13.3], 4);
    display.brightness = brightness;
    let geometry = display.geometry().unwrap();
    let mut target = LightField::black(geometry.clone()).unwrap();
    for view in geometry.grid.iter() {
        for (i, pixel) in target.view_mut(view).chunks_exact_mut(3).enumerate() {
            let point = [geometry.x_mm(i % geometry.cols), geometry.y_mm(i / geometry.cols)];
            let slope = geometry.grid.slope_at(view, point);
            let (x, y) = (point[0] - shift - 10.0 * slope[0], point[1] - 10.0 * slope[1]);
            let wave = |k: f64, phase: f64| {
                (0.16 * k * x + phase).sin() * (0.14 * k * y - phase).cos()
                    + 0.5 * (0.35 * x - 0.23 * k * y + phase).sin()
            };
            for (value, k) in pixel.iter_mut().zip([1.0, 1.3, 1.7]) {
                *value = (0.45 + 0.25 * wave(k, 2.0 * k + scene)) as f32;
            }
        }
    }
    Owned { display, target, weights: Weights::Uniform }
}

/// Largest difference in PSNR, in dB, by which the chosen start may lag behind the other start
/// after five iterations.
const WORST_LOSS_DB: f64 = 1.5;

#[test]
fn the_start_that_is_taken_is_not_the_worse_one() {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    type Make = fn(f64, f64) -> Owned;
    // each case has moves: (shift, scene, expected choice), with `None` if both choices are right
    let cases: [(Make, [(f64, f64, Option<bool>); 5]); 3] = [
        (
            |shift, scene| plane(shift, scene, 0.2),
            [
                (0.0, 0.0, Some(true)),
                (1.0, 0.0, Some(true)),
                (4.0, 0.0, Some(true)),
                (8.0, 0.0, None),
                (0.0, 1.0, None),
            ],
        ),
        (
            |shift, scene| plane(shift, scene, 1.0),
            [
                (0.0, 0.0, Some(true)),
                (1.0, 0.0, Some(true)),
                (4.0, 0.0, Some(true)),
                (8.0, 0.0, None),
                (20.0, 0.0, None),
            ],
        ),
        (
            card,
            [
                (0.0, 0.0, Some(true)),
                (0.5, 0.0, Some(true)),
                (2.0, 0.0, Some(false)),
                (8.0, 0.0, Some(false)),
                (0.0, 1.0, Some(false)),
            ],
        ),
    ];
    for (number, (make, moves)) in cases.into_iter().enumerate() {
        // compare both starts after five iterations; the warm start is a solution for unmoved
        // content
        let before = make(0.0, 0.0);
        let warm = factorize(&before.problem(), &settings("auto", 30), None, task, &mut |_| ()).unwrap().stack;
        for (shift, scene, expected) in moves {
            let now = make(shift, scene);
            let pays = warm_start_pays(&now.problem(), &settings("auto", 5), &warm, "block-exact", task).unwrap();
            assert!(expected.is_none_or(|expected| expected == pays), "case {number}, {shift} {scene}: {pays}");
            let after = |solver, warm| {
                let result = factorize(&now.problem(), &settings(solver, 5), warm, task, &mut |_| ()).unwrap();
                result.history.last().unwrap().psnr_view
            };
            let (from_warm, from_fresh) = (after("block-exact", Some(&warm)), after("block-exact", None));
            let (taken, other) = if pays { (from_warm, from_fresh) } else { (from_fresh, from_warm) };
            assert!(
                taken > other - WORST_LOSS_DB,
                "case {number}, {shift} {scene}: warm {from_warm}, fresh {from_fresh}"
            );
        }
    }
}

/// A target may be black in views of weight 0. In the target of a live display, views in the row of
/// one viewer and a column of another viewer are black. The patterns must not depend on such views.
#[test]
fn views_of_weight_0_change_no_pattern() {
    let Owned { display, target, .. } = card(0.0, 0.0);
    let [view_rows, view_cols] = target.geometry().grid.views();
    let counts = |view: usize| view.is_multiple_of(2);
    let weights = (0..view_rows * view_cols).map(|view| if counts(view) { 1.0 } else { 0.0 }).collect();
    let weights = Tensor::from_vec(["view_y", "view_x"], [view_rows, view_cols], weights).unwrap();
    let weights = Weights::PerView(weights);
    let mut black = target.clone();
    for (index, view) in target.geometry().grid.iter().enumerate().filter(|(index, _)| !counts(*index)) {
        assert_eq!(view, [index / view_cols, index % view_cols]);
        black.view_mut(view).fill(0.0);
    }
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    for iterations in [0, 3] {
        let patterns = [&target, &black].map(|target| {
            let problem = Problem { display: &display, target, weights: &weights };
            let settings = settings("block-exact", iterations);
            factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| {}).unwrap().stack
        });
        assert_eq!(patterns[0], patterns[1], "{iterations}");
    }
}
