//! Tests the filter on pictures whose truth is known, and the errors and biases that it reports.

use glam::Vec3;
use lumistack_core::seed::Stream;
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};

use super::frame::{Frame, box_mean};
use super::{Estimate, NoisyView, Window, denoise, figures};
use crate::renderer::{Check, Checks, FEATURES, Features};

const ROWS: usize = 24;
const COLS: usize = 40;
/// Depth of the wall in [`wall`], in millimetres: 2 pixels of disparity between neighbouring views.
const Z_MM: f64 = 20.0;

fn geometry(views: [usize; 2], projection: Projection) -> FieldGeometry {
    let axis = |count: usize| (0..count).map(|i| 0.1 * (i as f64 - 0.5 * (count as f64 - 1.0))).collect::<Vec<f64>>();
    let slope_y = axis(views[1]).into_iter().rev().collect();
    FieldGeometry {
        rows: ROWS,
        cols: COLS,
        pitch_mm: 1.0,
        grid: ViewGrid { projection, slope_x: axis(views[0]), slope_y },
    }
}

/// Makes views of a flat wall parallel to the display. `shade` is the wall's radiance at a point
/// (x, y) in millimetres. Each half has noise of standard deviation `noise`. Returns the views and
/// the truth.
fn wall(
    geometry: &FieldGeometry,
    shade: impl Fn(f64, f64) -> f64,
    noise: f64,
    seed: u64,
) -> (Vec<NoisyView>, Vec<Tensor<3>>) {
    let mut stream = Stream::new(seed);
    let mut views = Vec::new();
    let mut truths = Vec::new();
    for view in geometry.grid.iter() {
        let mut truth = Tensor::zeros(["row", "col", "rgb"], [ROWS, COLS, 3]);
        let mut features = Tensor::zeros(["row", "col", "feature"], [ROWS, COLS, FEATURES]);
        let mut halves = [truth.clone(), truth.clone()];
        for row in 0..ROWS {
            for col in 0..COLS {
                let point = [geometry.x_mm(col), geometry.y_mm(row)];
                let slope = geometry.grid.slope_at(view, point);
                let radiance = shade(point[0] + slope[0] * Z_MM, point[1] + slope[1] * Z_MM);
                let values = [1.0, 0.5, 0.5, 0.5, 0.0, 0.0, 1.0, Z_MM as f32, 0.04, 1.0, Z_MM as f32];
                features.block_mut([row, col]).copy_from_slice(&values);
                for c in 0..3 {
                    *truth.at_mut([row, col, c]) = radiance as f32;
                    for half in &mut halves {
                        // uniform noise of the given standard deviation
                        let u = f64::from(stream.next_f32()) - 0.5;
                        *half.at_mut([row, col, c]) = (radiance + noise * 12f64.sqrt() * u) as f32;
                    }
                }
            }
        }
        views.push(NoisyView { halves, features: Features::from_values(features).unwrap() });
        truths.push(truth);
    }
    (views, truths)
}

fn filtered(geometry: &FieldGeometry, views: &[NoisyView], window: Window) -> Vec<Tensor<3>> {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    denoise(geometry, views, window, Task::quiet(&collector, &cancel)).unwrap()
}

fn squared_error(picture: &Tensor<3>, truth: &Tensor<3>) -> f64 {
    let pairs = picture.data().iter().zip(truth.data());
    pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / truth.data().len() as f64
}

fn smooth(x: f64, y: f64) -> f64 {
    1.0 + 0.2 * (0.15 * x).sin() + 0.1 * (0.2 * y).cos()
}

fn edge(x: f64, _: f64) -> f64 {
    if x < 3.3 { 0.3 } else { 1.2 }
}

/// Makes checks at every third pixel, each with two values whose noise has the standard deviation
/// `noise`.
fn checks(truth: &Tensor<3>, noise: f64, seed: u64) -> Checks {
    let mut stream = Stream::new(seed);
    let list = (0..ROWS * COLS).step_by(3).map(|i| {
        let (row, col) = (i / COLS, i % COLS);
        let mut value = |c: usize| {
            let u = f64::from(stream.next_f32()) - 0.5;
            truth.get([row, col, c]) + (noise * 12f64.sqrt() * u) as f32
        };
        let first = [value(0), value(1), value(2)];
        Check { row, col, radiance: [first, [value(0), value(1), value(2)]] }
    });
    Checks { list: list.collect() }
}

#[test]
fn noise_goes_and_checks_tell_how_much_is_left() {
    let geometry = geometry([3, 3], Projection::Oblique);
    for (shade, seed) in [(smooth as fn(f64, f64) -> f64, 1), (edge, 2)] {
        let (views, truths) = wall(&geometry, shade, 0.2, seed);
        let result = filtered(&geometry, &views, Window::default());
        let mut told = Vec::new();
        let mut after = 0.0;
        for (n, (picture, truth)) in result.iter().zip(&truths).enumerate() {
            told.push(figures(picture, &views[n].mean(), &checks(truth, 0.2, 100 * seed + n as u64)));
            after += squared_error(picture, truth) / truths.len() as f64;
        }
        let before = Estimate::joined(told.iter().map(|f| f.mse_before));
        // The mean of two halves of variance 0.04 has the variance 0.02. Four standard errors give
        // a false alarm in one of 16,000 runs.
        assert!((before.value() - 0.02).abs() < 4.0 * before.error() && before.error() < 0.001, "{before:?}");
        assert!(after < 0.1 * 0.02, "{after}");
        let estimate = Estimate::joined(told.iter().map(|f| f.mse_after));
        assert!((estimate.value() - after).abs() < 4.0 * estimate.error(), "{estimate:?} {after}");
        assert!(estimate.error() < 0.03 * 0.02, "{estimate:?}");
        let change = Estimate::joined(told.iter().map(|f| f.change));
        let mean = |pictures: &[Tensor<3>]| {
            let sum: f64 = pictures.iter().flat_map(|picture| picture.data()).map(|value| f64::from(*value)).sum();
            sum / (pictures.len() * 3 * ROWS * COLS) as f64
        };
        let bias = mean(&result) - mean(&truths);
        assert!((change.value() - bias).abs() < 4.0 * change.error(), "{change:?} {bias}");
        assert!(bias.abs() < 0.01 && change.error() < 0.003, "{change:?} {bias}");
    }
}

/// [`figures`] reports the bias of a filter that dims.
#[test]
fn a_bias_is_told() {
    let geometry = geometry([1, 1], Projection::Oblique);
    let (views, truths) = wall(&geometry, smooth, 0.2, 8);
    let mut dimmed = truths[0].clone();
    dimmed.data_mut().iter_mut().for_each(|value| *value -= 0.1);
    let told = figures(&dimmed, &views[0].mean(), &checks(&truths[0], 0.1, 9));
    assert!((told.change.value() + 0.1).abs() < 4.0 * told.change.error() && told.change.error() < 0.02, "{told:?}");
    assert!((told.mse_after.value() - 0.01).abs() < 4.0 * told.mse_after.error(), "{told:?}");
    assert!(told.mse_after.error() < 0.002, "{told:?}");
    let half = told.mse_after.scaled(0.5);
    assert_eq!(Estimate::from_parts(half.parts()), half);
    assert!((half.value() / told.mse_after.value() - 0.5).abs() < 1e-12 && half.error() < told.mse_after.error());
    assert!(Estimate::default().value().is_nan() && Estimate::default().error().is_nan());
}

#[test]
fn neighbouring_views_share_their_samples() {
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 500.0 }] {
        let geometry = geometry([5, 3], projection);
        let (views, truths) = wall(&geometry, smooth, 0.3, 3);
        let small = Window { radius: 2, ..Window::default() };
        let error = |window: Window| {
            let result = filtered(&geometry, &views, window);
            result.iter().zip(&truths).map(|(picture, truth)| squared_error(picture, truth)).sum::<f64>()
        };
        let (alone, together) = (error(Window { views: 0, ..small }), error(small));
        assert!(together < 0.5 * alone, "{together} and {alone}");
    }
}

#[test]
fn a_picture_without_noise_stays_as_it_is() {
    let geometry = geometry([3, 1], Projection::Oblique);
    let (views, truths) = wall(&geometry, edge, 0.0, 4);
    for (picture, truth) in filtered(&geometry, &views, Window::default()).iter().zip(&truths) {
        assert!(squared_error(picture, truth) < 1e-9);
    }
}

#[test]
fn pixels_without_a_surface_are_left_alone() {
    let geometry = geometry([3, 1], Projection::Oblique);
    let (mut views, _) = wall(&geometry, smooth, 0.2, 5);
    for view in &mut views {
        view.features =
            Features::from_values(Tensor::zeros(["row", "col", "feature"], [ROWS, COLS, FEATURES])).unwrap();
    }
    for (picture, view) in filtered(&geometry, &views, Window::default()).iter().zip(&views) {
        assert!(squared_error(picture, &view.mean()) < 1e-12);
    }
}

#[test]
fn a_surface_point_is_found_in_the_other_view() {
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 500.0 }] {
        let geometry = geometry([3, 3], projection);
        // the radiance is the x coordinate of the wall's point in one picture, and its y coordinate
        // in another
        let (views, across) = wall(&geometry, |x, _| x, 0.0, 6);
        let (_, up) = wall(&geometry, |_, y| y, 0.0, 6);
        let places: Vec<[usize; 2]> = geometry.grid.iter().collect();
        let frames: Vec<Frame> =
            places.iter().zip(&views).map(|(&view, source)| Frame::new(&geometry, view, source)).collect();
        let mut found = 0;
        for (own, other) in [(0, 8), (4, 0), (4, 5), (2, 6)] {
            for row in 0..ROWS {
                for col in 0..COLS {
                    let Some(at) = frames[own].seen_in(&frames[other], row, col) else { continue };
                    for place in [&across, &up] {
                        let here = place[own].get([row, col, 0]);
                        let there = place[other].get([at / COLS, at % COLS, 0]);
                        // the tolerance is half a pixel, since the shift is rounded to whole pixels
                        assert!((here - there).abs() < 0.501, "{here} {there}");
                    }
                    found += 1;
                }
            }
        }
        assert!(found > 2 * ROWS * COLS);
    }
}

#[test]
fn box_means_are_means_over_boxes() {
    let (rows, cols) = (7, 5);
    let mut stream = Stream::new(7);
    let values: Vec<f32> = (0..rows * cols).map(|_| stream.next_f32() - 0.5).collect();
    for radius in [0, 1, 3, 9] {
        let fast = box_mean(&values, rows, cols, radius);
        for i in 0..rows * cols {
            let near = |a: usize, b: usize| a.abs_diff(b) <= radius;
            let held: Vec<f32> = (0..rows * cols)
                .filter(|j| near(j / cols, i / cols) && near(j % cols, i % cols))
                .map(|j| values[j])
                .collect();
            let mean = held.iter().sum::<f32>() / held.len() as f32;
            assert!((fast[i] - mean).abs() < 1e-5, "{radius} {i}");
        }
    }
}

#[test]
fn a_single_pixel_is_its_own_answer() {
    let geometry = FieldGeometry { rows: 1, cols: 1, ..geometry([1, 1], Projection::Oblique) };
    let values = vec![1.0, 0.5, 0.5, 0.5, 0.0, 0.0, 1.0, 0.0, 0.04, 1.0, 0.0];
    let features =
        Features::from_values(Tensor::from_vec(["row", "col", "feature"], [1, 1, FEATURES], values).unwrap()).unwrap();
    let half = |value: f32| Tensor::filled(["row", "col", "rgb"], [1, 1, 3], value);
    let view = NoisyView { halves: [half(1.0), half(3.0)], features };
    let picture = &filtered(&geometry, &[view], Window::default())[0];
    assert!((Vec3::from_slice(picture.data()) - Vec3::splat(2.0)).length() < 1e-5);
}
