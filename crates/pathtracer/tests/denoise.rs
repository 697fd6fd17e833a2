//! The denoiser on rendered views, against long renders: what it tells of itself is true, means stay, edges stay.

mod common;

use common::{Builder, WINDOW_MM, glowing, matt, rectangle, window};
use glam::{Quat, Vec3};
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::denoise::{Estimate, NoisyView, Window, denoise, figures};
use lumistack_pathtracer::{AngularFilter, Renderer, Settings};

const SIZE: usize = 64;
/// Column of the edge of the pole, whose depth, and of the back wall, whose colour changes.
const POLE: usize = 16;
const COLOUR: usize = 44;

/// A corner of a room: a back wall of two colours, a floor, and a pole before the wall, lit by a lamp and a dim sky.
fn room() -> Renderer {
    let x = |col: usize| WINDOW_MM as f32 * (col as f32 / SIZE as f32 - 0.5);
    let mut builder = Builder::default();
    let wall = |left: f32, right: f32| {
        rectangle(Vec3::new(0.5 * (left + right), 0.0, -0.4), 0.5 * (right - left) * Vec3::X, 2.0 * Vec3::Y)
    };
    builder.add(wall(-2.0, x(COLOUR)), matt(0.2));
    builder.add(wall(x(COLOUR), 2.0), matt(0.8));
    builder.add(rectangle(Vec3::new(0.0, -0.7, 0.0), 2.0 * Vec3::X, 0.6 * Vec3::NEG_Z), matt(0.5));
    let pole = rectangle(Vec3::new(x(POLE) - 0.1, 0.2, 0.0), 0.1 * Vec3::X, 0.5 * Vec3::Y);
    builder.add(pole, matt(0.7));
    // faces down and forwards, above the picture
    let turn = Quat::from_rotation_x(0.6);
    builder.add(
        rectangle(Vec3::new(0.3, 1.6, 0.8), turn * (0.3 * Vec3::X), turn * (0.3 * Vec3::Z)),
        glowing(Vec3::splat(20.0)),
    );
    builder.sky(&[0.2]);
    builder.renderer()
}

fn geometry() -> FieldGeometry {
    let grid = ViewGrid::uniform(Projection::Oblique, [3, 1], [12.0, 1.0]).unwrap();
    FieldGeometry { rows: SIZE, cols: SIZE, pitch_mm: WINDOW_MM / SIZE as f64, grid }
}

fn render(renderer: &Renderer, view: [usize; 2], samples: u32, seed: u64) -> Tensor<3> {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let settings = Settings { samples, seed, ..Settings::default() };
    renderer.render_view(&window(), &geometry(), view, &settings, Task::quiet(&collector, &cancel)).unwrap()
}

fn mean(picture: &Tensor<3>) -> f64 {
    picture.data().iter().map(|value| f64::from(*value)).sum::<f64>() / picture.data().len() as f64
}

/// Mean of a column between the floor and the top of the pole.
fn column(picture: &Tensor<3>, col: usize) -> f64 {
    (20..40).map(|row| f64::from(picture.get([row, col, 0]))).sum::<f64>() / 20.0
}

#[test]
fn the_report_is_true_and_means_and_edges_stay() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let (renderer, geometry) = (room(), geometry());
    let samples = 4;
    let places: Vec<[usize; 2]> = geometry.grid.iter().collect();
    let views: Vec<NoisyView> = places
        .iter()
        .map(|&view| NoisyView {
            halves: [1, 2].map(|seed| render(&renderer, view, samples / 2, seed)),
            features: renderer.render_features(&window(), &geometry, view, 16, AngularFilter::Point, task).unwrap(),
        })
        .collect();
    let filtered = denoise(&geometry, &views, Window::default(), task).unwrap();
    let (mut told, mut before, mut after) = (Vec::new(), 0.0, 0.0);
    for ((&view, noisy), picture) in places.iter().zip(&views).zip(&filtered) {
        let settings = Settings { samples: 16, ..Settings::default() };
        let checks = renderer.render_checks(&window(), &geometry, view, &settings, task).unwrap();
        told.push(figures(picture, noisy, &checks));
        // two long renders: the product of differences is free of their noise
        let [a, b] = [11, 12].map(|seed| render(&renderer, view, 256, seed));
        let error = |picture: &Tensor<3>| {
            let pixels = picture.data().iter().zip(a.data()).zip(b.data());
            let sum: f64 = pixels.map(|((f, a), b)| f64::from(f - a) * f64::from(f - b)).sum();
            sum / (a.data().len() * places.len()) as f64
        };
        before += error(&noisy.mean());
        after += error(picture);
        let truth = 0.5 * (mean(&a) + mean(&b));
        assert!((mean(picture) / truth - 1.0).abs() < 0.01, "{} instead of {truth}", mean(picture));
        // either side of both edges of the middle view, where they stand between two columns, and the columns beside
        for col in [POLE - 2, POLE - 1, POLE, POLE + 1, COLOUR - 2, COLOUR - 1, COLOUR, COLOUR + 1] {
            let (found, truth) = (column(picture, col), 0.5 * (column(&a, col) + column(&b, col)));
            assert!((found / truth - 1.0).abs() < 0.08, "view {view:?}, column {col}: {found} instead of {truth}");
        }
    }
    let [told_before, told_after] =
        [Estimate::joined(told.iter().map(|f| f.mse_before)), Estimate::joined(told.iter().map(|f| f.mse_after))];
    println!("{before} {told_before:?} {}, {after} {told_after:?} {}", told_before.error(), told_after.error());
    // four standard errors: a false alarm in one of 16,000, were it not for fixed seeds
    assert!((told_before.value() - before).abs() < 4.0 * told_before.error(), "{before} {told_before:?}");
    assert!((told_after.value() - after).abs() < 4.0 * told_after.error(), "{after} {told_after:?}");
    assert!(after < 0.25 * before, "{after} of {before}");
    assert!(told_after.error() < 0.2 * before, "{told_after:?}");
}
