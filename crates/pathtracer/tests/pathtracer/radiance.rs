//! Tests results that come with a view's radiance: the fraction of a pixel without a surface, and
//! the variance of the pixel's mean.

use crate::common::{Builder, diffuse, one_view, rectangle, sphere, window};
use glam::Vec3;
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_pathtracer::{AngularFilter, Renderer, Settings};

/// Relative rounding of f32 sums.
const ROUNDING: f32 = 1e-5;

/// Returns a renderer of two balls under a sky of one radiance; the farther ball is partly visible.
fn balls(sky: f32) -> Renderer {
    let mut scene = Builder::default();
    scene.add(sphere(Vec3::new(0.2, 0.1, 0.0), 0.6, 12), diffuse(0.7));
    scene.add(sphere(Vec3::new(-0.5, -0.2, -2.0), 0.5, 12), diffuse(0.3));
    scene.sky(&[sky]);
    scene.renderer()
}

/// If the environment is hidden, each pixel lacks exactly its fraction m of the background: L =
/// L_hidden + m · L_sky.
#[test]
fn hiding_the_environment_takes_its_share_away_and_no_light() {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let (sky, geometry) = (1.5, one_view(24, [0.1, -0.05]));
    let renderer = balls(sky);
    for angular_filter in [AngularFilter::Point, AngularFilter::Lens(0.3)] {
        let seen = Settings { samples: 16, angular_filter, ..Settings::default() };
        let hidden = Settings { hide_environment: true, ..seen };
        let with = renderer.render_view(&window(), &geometry, [0, 0], &seen, task).unwrap();
        let without = renderer.render_view(&window(), &geometry, [0, 0], &hidden, task).unwrap();
        let missed = renderer.render_misses(&window(), &geometry, [0, 0], &hidden, task).unwrap();
        let (mut edges, mut free) = (0, 0);
        for ((with, without), &missed) in with.data().chunks(3).zip(without.data().chunks(3)).zip(missed.data()) {
            let expected = without[0] + missed * sky;
            assert!((with[0] - expected).abs() <= ROUNDING * expected, "{} is not {expected}", with[0]);
            edges += usize::from(missed > 0.0 && missed < 1.0);
            free += usize::from(missed == 1.0);
            assert!(missed < 1.0 || without[0] == 0.0);
        }
        assert!(edges > 20 && free > 50, "{edges} {free}");
    }
}

/// Compares the variance that one render reports with the variance over many renders. The reported
/// variance is an upper bound, since the samples are stratified. It would be exact for independent
/// samples.
#[test]
fn the_reported_variance_is_that_of_the_mean() {
    const RENDERS: usize = 200;
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    // a floor under a bright area of the sky: much noise, which stratification reduces
    let mut scene = Builder::default();
    scene.add(rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), diffuse(0.8));
    scene.add(sphere(Vec3::new(0.0, 0.0, 0.6), 0.4, 12), diffuse(0.8));
    scene.sky(&[9.0, 0.2, 0.1, 0.1]);
    let renderer = scene.renderer();
    let geometry = one_view(8, [0.0, 0.0]);
    let render = |seed: u64| -> (Tensor<3>, Tensor<3>) {
        let settings = Settings { samples: 8, seed, ..Settings::default() };
        let guided = renderer.render_view_and_features(&window(), &geometry, [0, 0], &settings, task).unwrap();
        (guided.radiance, guided.variance)
    };
    let plain = Settings { samples: 8, seed: 1, ..Settings::default() };
    assert_eq!(render(1).0, renderer.render_view(&window(), &geometry, [0, 0], &plain, task).unwrap());
    let count = 3 * 8 * 8;
    let (mut sum, mut squares, mut reported) = (vec![0.0f64; count], vec![0.0f64; count], vec![0.0f64; count]);
    for seed in 0..RENDERS as u64 {
        let (mean, variance) = render(seed);
        for i in 0..count {
            let value = f64::from(mean.data()[i]);
            sum[i] += value;
            squares[i] += value * value;
            reported[i] += f64::from(variance.data()[i]);
        }
    }
    let n = RENDERS as f64;
    let measured: f64 = (0..count).map(|i| (squares[i] - sum[i] * sum[i] / n) / (n - 1.0)).sum();
    let reported: f64 = reported.iter().map(|sum| sum / n).sum();
    let ratio = reported / measured;
    // some 13,000 degrees of freedom in all, so the ratio is known to a few percent
    assert!((0.95..10.0).contains(&ratio), "reported {reported}, measured {measured}");
    let one = Settings { samples: 1, ..Settings::default() };
    let guided = renderer.render_view_and_features(&window(), &geometry, [0, 0], &one, task).unwrap();
    assert!(guided.variance.data().iter().all(|value| value.is_nan()), "one sample has no variance");
}
