//! Compares denoised views with long renders: the reported errors are true, and means and edges are
//! kept.

use crate::common::{Builder, WINDOW_MM, diffuse, glowing, rectangle, window};
use glam::{Quat, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::denoise::{Estimate, NoisyView, SharedLight, Window, denoise, figures};
use lumistack_pathtracer::{Renderer, Settings, SplitView};
use lumistack_scene::Material;

const SIZE: usize = 64;
/// Column of the pole's edge, where the depth changes.
const POLE: usize = 16;
/// Column of the back wall where the colour changes.
const COLOUR: usize = 44;

/// Returns a renderer of a corner of a room: a back wall of two colours, a floor, and a pole in
/// front of the wall. A lamp and a dim sky light it.
fn room() -> Renderer {
    let x = |col: usize| WINDOW_MM as f32 * (col as f32 / SIZE as f32 - 0.5);
    let mut builder = Builder::default();
    let wall = |left: f32, right: f32| {
        rectangle(Vec3::new(0.5 * (left + right), 0.0, -0.4), 0.5 * (right - left) * Vec3::X, 2.0 * Vec3::Y)
    };
    builder.add(wall(-2.0, x(COLOUR)), diffuse(0.2));
    builder.add(wall(x(COLOUR), 2.0), diffuse(0.8));
    builder.add(rectangle(Vec3::new(0.0, -0.7, 0.0), 2.0 * Vec3::X, 0.6 * Vec3::NEG_Z), diffuse(0.5));
    let pole = rectangle(Vec3::new(x(POLE) - 0.1, 0.2, 0.0), 0.1 * Vec3::X, 0.5 * Vec3::Y);
    builder.add(pole, diffuse(0.7));
    // the lamp faces down and forwards, above the picture
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

/// Returns the mean of the pixels of a column in rows that show neither the floor nor the pole's
/// upper end.
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
        .map(|&view| {
            let [a, b] = [1, 2].map(|seed| {
                let settings = Settings { samples: samples / 2, seed, ..Settings::default() };
                renderer.render_view_and_features(&window(), &geometry, view, &settings, task).unwrap()
            });
            NoisyView { halves: [a.radiance, b.radiance], features: a.features.joined(&b.features) }
        })
        .collect();
    let filtered = denoise(&geometry, &views, Window::default(), task).unwrap();
    let (mut told, mut before, mut after) = (Vec::new(), 0.0, 0.0);
    for ((&view, noisy), picture) in places.iter().zip(&views).zip(&filtered) {
        let settings = Settings { samples: 16, ..Settings::default() };
        let checks = renderer.render_checks(&window(), &geometry, view, &settings, task).unwrap();
        told.push(figures(picture, &noisy.mean(), &checks));
        // The error is a mean product of the differences to two long renders, so the renders' noise
        // averages out.
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
        // Test the two columns on either side of both edges. In the middle view both edges are
        // between two columns. In the other views the edge of the colours passes through pixels.
        // Four samples of a pixel locate such an edge only roughly, so the tolerance is large.
        for col in [POLE - 2, POLE - 1, POLE, POLE + 1, COLOUR - 2, COLOUR - 1, COLOUR, COLOUR + 1] {
            let (found, truth) = (column(picture, col), 0.5 * (column(&a, col) + column(&b, col)));
            assert!((found / truth - 1.0).abs() < 0.15, "view {view:?}, column {col}: {found} instead of {truth}");
        }
    }
    let [told_before, told_after] =
        [Estimate::joined(told.iter().map(|f| f.mse_before)), Estimate::joined(told.iter().map(|f| f.mse_after))];
    println!("{before} {told_before:?} {}, {after} {told_after:?} {}", told_before.error(), told_after.error());
    // The bound is four standard errors: with random seeds, one of 16,000 runs would be a false
    // alarm.
    assert!((told_before.value() - before).abs() < 4.0 * told_before.error(), "{before} {told_before:?}");
    assert!((told_after.value() - after).abs() < 4.0 * told_after.error(), "{after} {told_after:?}");
    assert!(after < 0.35 * before, "{after} of {before}");
    assert!(told_after.error() < 0.2 * before, "{told_after:?}");
}

/// Diffuse and other light of a view add up to the view itself. Diffuse surfaces have only diffuse
/// light, metals have only other light.
#[test]
fn parts_add_up_to_the_view() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let geometry = geometry();
    let metal = Material { metallic: 1.0, roughness: 0.4, ..Material::default() };
    let plastic =
        Material { base_color: Vec4::new(0.8, 0.3, 0.1, 1.0), metallic: 0.0, roughness: 0.3, ..Material::default() };
    for (material, least, most) in [(diffuse(0.6), 1.0, 1.0), (metal, 0.0, 0.0), (plastic, 0.5, 0.98)] {
        let mut builder = Builder::default();
        builder.add(rectangle(Vec3::new(0.0, 0.0, -0.3), 4.0 * Vec3::X, 4.0 * Vec3::Y), material);
        builder.add(rectangle(Vec3::new(0.4, 2.5, 1.2), 0.5 * Vec3::X, 0.5 * Vec3::Z), glowing(Vec3::splat(9.0)));
        builder.sky(&[0.4]);
        let renderer = builder.renderer();
        let settings = Settings { samples: 5, seed: 3, ..Settings::default() };
        let whole = renderer.render_view(&window(), &geometry, [0, 1], &settings, task).unwrap();
        let split = renderer.render_split(&window(), &geometry, [0, 1], &settings, task).unwrap();
        for (a, b) in split.radiance().data().iter().zip(whole.data()) {
            assert!((a - b).abs() <= 1e-5 * b.max(1.0), "{a} {b}");
        }
        let diffuse: f32 = split.values().data().chunks(SplitView::VALUES).map(|v| v[0] + v[1] + v[2]).sum();
        let share = diffuse / whole.data().iter().sum::<f32>();
        assert!(share >= least - 1e-5 && share <= most + 1e-5, "{share} of {least} to {most}");
    }
}

/// Shared light lowers the mean error of three views of a room. It keeps their means, and the edges
/// of the middle view.
#[test]
fn shared_light_has_the_samples_of_all_views() {
    let renderer = room();
    let grid = ViewGrid::uniform(Projection::Oblique, [7, 5], [12.0, 8.0]).unwrap();
    let geometry = geometry().with_grid(grid);
    let settings = Settings { samples: 4, seed: 5, ..Settings::default() };
    let views: Vec<_> = geometry.grid.iter().collect();
    let (splits, shared) = split_and_shared(&renderer, &geometry, &settings);
    let (mut before, mut after) = (0.0, 0.0);
    for number in [0, 17, 34] {
        let (view, picture) = (views[number], &shared[number]);
        let references = references(&renderer, &geometry, view);
        before += error(&splits[number].radiance(), &references);
        after += error(picture, &references);
        let [a, b] = references;
        let truth = 0.5 * (mean(&a) + mean(&b));
        assert!((mean(picture) / truth - 1.0).abs() < 0.01, "{} instead of {truth}", mean(picture));
        if view == [2, 3] {
            for col in [POLE - 2, POLE - 1, POLE, POLE + 1, COLOUR - 2, COLOUR - 1, COLOUR, COLOUR + 1] {
                let (found, truth) = (column(picture, col), 0.5 * (column(&a, col) + column(&b, col)));
                assert!((found / truth - 1.0).abs() < 0.08, "column {col}: {found} instead of {truth}");
            }
        }
    }
    println!("{before} {after}");
    // With 35 views the noise could fall to a 35th. But edges inside of pixels keep their noise,
    // and so do points that few views see.
    assert!(after < 0.35 * before, "{before} {after}");
    // without another view nothing is shared
    let alone = geometry.with_grid(ViewGrid::single(Projection::Oblique, [0.0; 2]));
    let (splits, same) = split_and_shared(&renderer, &alone, &settings);
    assert!(same[0] == splits[0].radiance());
}

/// Renders a view twice with many samples and independent noise.
fn references(renderer: &Renderer, geometry: &FieldGeometry, view: [usize; 2]) -> [Tensor<3>; 2] {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    [11, 12].map(|seed| {
        let settings = Settings { samples: 256, seed, ..Settings::default() };
        renderer.render_view(&window(), geometry, view, &settings, Task::quiet(&collector, &cancel)).unwrap()
    })
}

/// Returns the mean squared error of a picture, without the noise of the two references.
fn error(picture: &Tensor<3>, [a, b]: &[Tensor<3>; 2]) -> f64 {
    let pixels = picture.data().iter().zip(a.data()).zip(b.data());
    pixels.map(|((f, a), b)| f64::from(f - a) * f64::from(f - b)).sum::<f64>() / a.data().len() as f64
}

/// Renders all views of a grid, and shares their light. Returns the views before and after.
fn split_and_shared(
    renderer: &Renderer,
    geometry: &FieldGeometry,
    settings: &Settings,
) -> (Vec<SplitView>, Vec<Tensor<3>>) {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let split = |view| renderer.render_split(&window(), geometry, view, settings, task).unwrap();
    let splits: Vec<SplitView> = geometry.grid.iter().map(split).collect();
    let mut light = SharedLight::new(geometry, settings);
    splits.iter().for_each(|split| light.add(split));
    let mean = light.averaged(task).unwrap();
    let shared = splits.iter().enumerate().map(|(number, split)| mean.on(number, split)).collect();
    (splits, shared)
}

/// Views share the reflections of rough metal, which lowers the error and keeps the mean. Nearly
/// smooth metal, glass and glowing surfaces stay as rendered.
#[test]
fn reflections_of_rough_metal_are_shared() {
    let grid = ViewGrid::uniform(Projection::Oblique, [7, 5], [12.0, 8.0]).unwrap();
    let geometry = geometry().with_grid(grid);
    let wall = |material: Material| {
        let mut builder = Builder::default();
        builder.add(rectangle(Vec3::new(0.0, 0.0, -0.3), 4.0 * Vec3::X, 4.0 * Vec3::Y), material);
        builder.add(rectangle(Vec3::new(0.4, 2.5, 1.2), 0.5 * Vec3::X, 0.5 * Vec3::Z), glowing(Vec3::splat(9.0)));
        builder.sky(&[0.4]);
        builder.renderer()
    };
    let metal = |roughness| Material { metallic: 1.0, roughness, ..Material::default() };
    let settings = Settings { samples: 2, seed: 5, ..Settings::default() };
    for roughness in [0.35, 0.6] {
        let renderer = wall(metal(roughness));
        let (splits, shared) = split_and_shared(&renderer, &geometry, &settings);
        for number in [0, 17, 34] {
            let view = geometry.grid.iter().nth(number).unwrap();
            let references = references(&renderer, &geometry, view);
            let [before, after] =
                [&splits[number].radiance(), &shared[number]].map(|picture| error(picture, &references));
            let [found, truth] = [mean(&shared[number]), 0.5 * references.iter().map(mean).sum::<f64>()];
            println!("{roughness} {number}: {before} {after}, {found} {truth}");
            assert!(after < 0.25 * before, "roughness {roughness}, view {number}: {before} {after}");
            // at the rim of the zone, views on one side are missing in the average
            assert!((found / truth - 1.0).abs() < 0.02, "roughness {roughness}, view {number}: {found} {truth}");
        }
    }
    let glass = Material { metallic: 0.0, roughness: 0.5, transmission: 1.0, ..Material::default() };
    let lamp = Material { emission: Vec3::ONE, ..metal(0.5) };
    for material in [metal(0.1), glass, lamp] {
        let (splits, shared) = split_and_shared(&wall(material), &geometry, &settings);
        for (split, shared) in splits.iter().zip(&shared) {
            assert!(*shared == split.radiance());
        }
    }
}

/// Compares renders with the true pictures, which are known under a sky of radiance 1. A wall of
/// two colours has the radiance of its albedo. White metal between the colours, and a glowing pole,
/// have the radiance 1. From view to view, the pole covers another part of the wall.
#[test]
fn further_paths_do_no_harm_where_views_share_no_light() {
    const POLE_X: [f32; 2] = [-0.13, 0.12];
    const MIRROR_X: [f32; 2] = [-0.41, 0.42];
    const POLE_Z: f32 = 0.6;
    const WALL_Z: f32 = -0.4;
    const ALBEDO: [f64; 2] = [0.2, 0.8];
    let wall = |[left, right]: [f32; 2], z: f32| {
        rectangle(Vec3::new(0.5 * (left + right), 0.0, z), 0.5 * (right - left) * Vec3::X, 3.0 * Vec3::Y)
    };
    let mirror = Material { metallic: 1.0, roughness: 0.3, ..Material::default() };
    let mut builder = Builder::default();
    builder.add(wall([-4.0, MIRROR_X[0]], WALL_Z), diffuse(ALBEDO[0] as f32));
    builder.add(wall(MIRROR_X, WALL_Z), mirror);
    builder.add(wall([MIRROR_X[1], 4.0], WALL_Z), diffuse(ALBEDO[1] as f32));
    builder.add(wall(POLE_X, POLE_Z), glowing(Vec3::ONE));
    builder.sky(&[1.0]);
    let renderer = builder.renderer();
    let geometry = geometry().with_grid(ViewGrid::uniform(Projection::Oblique, [9, 1], [30.0, 1.0]).unwrap());
    // the radiance at a column, averaged over points between its edges
    let truth = |view: [usize; 2], col: usize| {
        const POINTS: usize = 1000;
        let at = |point: usize| {
            let x = geometry.x_mm(col) + geometry.pitch_mm * ((point as f64 + 0.5) / POINTS as f64 - 0.5);
            let seen = |z: f32| (x + geometry.grid.slope_x[view[1]] * f64::from(z)) as f32;
            let inside = |x: f32, [left, right]: [f32; 2]| x > left && x < right;
            let (pole, wall) = (seen(POLE_Z), seen(WALL_Z));
            match inside(pole, POLE_X) || inside(wall, MIRROR_X) {
                true => 1.0,
                false => ALBEDO[usize::from(wall > 0.0)],
            }
        };
        (0..POINTS).map(at).sum::<f64>() / POINTS as f64
    };
    // mean squared error, and the largest error of the mean of a column, over all views
    let errors = |further_paths: bool, shares: bool| -> [f64; 2] {
        let settings = Settings { samples: 4, seed: 5, further_paths, ..Settings::default() };
        let (splits, shared) = split_and_shared(&renderer, &geometry, &settings);
        let (mut squares, mut worst) = (0.0, 0.0f64);
        for (number, view) in geometry.grid.iter().enumerate() {
            let picture = if shares { shared[number].clone() } else { splits[number].radiance() };
            for col in 0..SIZE {
                let truth = truth(view, col);
                let error = |row: usize| f64::from(picture.get([row, col, 0])) - truth;
                squares += (0..SIZE).map(|row| error(row).powi(2)).sum::<f64>();
                worst = worst.max(((0..SIZE).map(error).sum::<f64>() / SIZE as f64).abs());
            }
        }
        [squares / (geometry.grid.iter().count() * SIZE * SIZE) as f64, worst]
    };
    let [alone, shared, further] = [errors(false, false), errors(false, true), errors(true, true)];
    println!("{alone:?} {shared:?} {further:?}");
    assert!(shared[0] < 0.7 * alone[0] && further[0] < 0.7 * shared[0], "{alone:?} {shared:?} {further:?}");
    // At an edge, a sample has a standard deviation of at most 0.4, and the mean of a pixel's four
    // samples 0.2. So the mean of 64 pixels has a standard error of at most 0.025.
    assert!(further[1] < shared[1].min(0.05), "{alone:?} {shared:?} {further:?}");
}

/// Further rays lower the error of a view, and change no mean. The result is the same with any
/// number of threads.
#[test]
fn further_rays_smooth_edges_and_keep_means() {
    let (renderer, geometry) = (room(), geometry());
    let plain = Settings { samples: 1, seed: 4, ..Settings::default() };
    let further = Settings { further_rays: 1, ..plain };
    let [alone, with] = [&plain, &further].map(|settings| split_and_shared(&renderer, &geometry, settings));
    let truth = render(&renderer, [0, 1], 1024, 3);
    let error = |picture: &Tensor<3>| {
        let pixels = picture.data().iter().zip(truth.data());
        pixels.map(|(found, truth)| f64::from(found - truth).powi(2)).sum::<f64>() / truth.data().len() as f64
    };
    let [before, after] = [error(&alone.1[1]), error(&with.1[1])];
    println!("{before} {after}");
    assert!(after < 0.9 * before, "{before} {after}");
    assert_means_and_bytes(&renderer, &geometry, &further, &truth);
}

/// Asserts that shared pictures of many seeds have the mean of a reference, and that the pictures
/// are the same with any number of threads.
fn assert_means_and_bytes(renderer: &Renderer, geometry: &FieldGeometry, settings: &Settings, truth: &Tensor<3>) {
    // The tolerance is four standard errors, plus 0.5 % since light is read at the nearest pixel of
    // other views.
    let means = (0..24).map(|seed| {
        let (_, shared) = split_and_shared(renderer, geometry, &Settings { seed, ..*settings });
        mean(&shared[1])
    });
    let found: Vec<f64> = means.collect();
    let average = found.iter().sum::<f64>() / found.len() as f64;
    let spread = found.iter().map(|value| (value - average).powi(2)).sum::<f64>() / (found.len() - 1) as f64;
    let allowed = 4.0 * (spread / found.len() as f64).sqrt() + 0.005 * mean(truth);
    assert!((average - mean(truth)).abs() < allowed, "{average}, {}, {allowed}", mean(truth));
    let with = split_and_shared(renderer, geometry, settings);
    for count in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
        let (splits, shared) = pool.install(|| split_and_shared(renderer, geometry, settings));
        assert!(splits == with.0 && shared == with.1, "{count} threads");
    }
}

/// With sparse paths and one sample, four pixels on one surface have the light of one path. With
/// more samples, their light differs. The mean stays the same.
#[test]
fn sparse_paths_are_shared_on_one_surface() {
    let (renderer, geometry) = (room(), geometry());
    let truth = render(&renderer, [0, 1], 1024, 3);
    // Returns true if the light that falls on four pixels is the same. It is the diffuse light,
    // divided by the reflectance of the surfaces that the paths hit.
    let is_same = |view: &SplitView, col: usize, row: usize| {
        let light = |row: usize, col: usize| {
            let pixel = view.values().block([row, col]);
            pixel[0] / pixel[SplitView::VALUES]
        };
        let others = [light(row, col + 1), light(row + 1, col), light(row + 1, col + 1)];
        others.iter().all(|other| (other / light(row, col) - 1.0).abs() < 1e-5)
    };
    let rows = || (20..40).step_by(2);
    for (samples, further_rays) in [(1, 0), (1, 1), (2, 0), (3, 0), (8, 0)] {
        let sparse = Settings { samples, further_rays, seed: 4, sparse_paths: true, ..Settings::default() };
        assert_means_and_bytes(&renderer, &geometry, &sparse, &truth);
        let views = split_and_shared(&renderer, &geometry, &sparse).0;
        // every group on the wall sees one surface: the colour changes between two groups
        for col in (POLE + 4..SIZE).step_by(2) {
            let same = rows().filter(|row| is_same(&views[1], col, *row)).count();
            assert_eq!(same, if samples == 1 { rows().count() } else { 0 }, "{samples} samples, column {col}");
        }
    }
}

/// Sparse paths keep the mean of every column. Under a sky of radiance 1, a wall has two materials,
/// and their edge is inside of groups. A pixel without a path gets the light of its group, divided
/// by the group's reflectance and multiplied by the pixel's reflectance.
#[test]
fn lent_light_is_independent_of_reflectance() {
    const EDGE: usize = 31;
    let x = |col: usize| WINDOW_MM as f32 * (col as f32 / SIZE as f32 - 0.5);
    let wall = |left: f32, right: f32| {
        rectangle(Vec3::new(0.5 * (left + right), 0.0, -0.4), 0.5 * (right - left) * Vec3::X, 2.0 * Vec3::Y)
    };
    let geometry = FieldGeometry { rows: 21, cols: 61, ..geometry() };
    let metal = Material { metallic: 1.0, roughness: 0.6, ..Material::default() };
    // pixels of similar colours lend each other light; black and white pixels do not
    for [left, right] in [[diffuse(0.4), diffuse(0.8)], [diffuse(0.0), diffuse(0.8)], [diffuse(0.6), metal]] {
        let mut builder = Builder::default();
        builder.add(wall(-4.0, x(EDGE)), left).add(wall(x(EDGE), 4.0), right);
        builder.sky(&[1.0]);
        let renderer = builder.renderer();
        for settings in [(1, 0), (1, 1), (2, 0), (3, 0), (12, 0), (24, 0)].map(|(samples, further_rays)| Settings {
            samples,
            further_rays,
            ..Settings::default()
        }) {
            let sums = |sparse_paths: bool| {
                // Eight seeds of three views give a column 504 pixels. With one sample, at least a
                // quarter of them have a path.
                let of_seed =
                    |seed| split_and_shared(&renderer, &geometry, &Settings { sparse_paths, seed, ..settings }).1;
                let views: Vec<Tensor<3>> = (0..8).flat_map(of_seed).collect();
                let col = |col: usize| {
                    let of_view = |view: &Tensor<3>| (0..21).map(|row| f64::from(view.get([row, col, 0]))).sum::<f64>();
                    views.iter().map(of_view).sum::<f64>() / (21 * views.len()) as f64
                };
                (0..61).map(col).collect::<Vec<f64>>()
            };
            let [all, sparse] = [sums(false), sums(true)];
            for (col, (all, sparse)) in all.iter().zip(&sparse).enumerate() {
                assert!((all - sparse).abs() < 0.02 + 0.08 * all, "{settings:?}, column {col}: {all} {sparse}");
            }
        }
    }
}

/// Where pixels of a group see different surfaces or nearly smooth metal, sparse paths end no path.
#[test]
fn edges_and_mirrors_keep_their_paths() {
    let x = |col: usize| WINDOW_MM as f32 * (col as f32 / SIZE as f32 - 0.5);
    let wall = |left: f32, right: f32, z: f32| {
        rectangle(Vec3::new(0.5 * (left + right), 0.0, z), 0.5 * (right - left) * Vec3::X, 2.0 * Vec3::Y)
    };
    // the pole's edge is between the two columns of a group
    let edge = POLE + 1;
    let mut builder = Builder::default();
    builder.add(wall(-2.0, x(edge), 0.0), diffuse(0.7));
    builder.add(wall(-2.0, x(COLOUR), -0.4), diffuse(0.2));
    builder.add(wall(x(COLOUR), 2.0, -0.4), Material { metallic: 1.0, roughness: 0.1, ..Material::default() });
    builder.sky(&[0.2, 2.0, 0.4]);
    let (renderer, geometry) = (builder.renderer(), geometry());
    let plain = Settings { samples: 1, further_rays: 1, seed: 4, ..Settings::default() };
    let [all, sparse] = [false, true].map(|sparse_paths| {
        split_and_shared(&renderer, &geometry, &Settings { sparse_paths, ..plain }).0.swap_remove(1)
    });
    let kept = |col: usize| {
        (0..SIZE).filter(|row| all.values().block([*row, col]) == sparse.values().block([*row, col])).count()
    };
    for col in 0..SIZE {
        let keeps = [edge - 1, edge].contains(&col) || col >= COLOUR;
        // elsewhere, one of four pixels keeps its path
        let found = kept(col) as f64 / SIZE as f64;
        assert!(if keeps { found == 1.0 } else { (0.02..0.6).contains(&found) }, "column {col}: {found}");
    }
}

/// Further paths change neither a view without noise nor the mean of a noisy view. The result is
/// the same with any number of threads, and with guides.
#[test]
fn further_paths_keep_the_mean_and_the_bytes() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let (renderer, geometry) = (room(), geometry());
    let plain = Settings { samples: 2, seed: 4, ..Settings::default() };
    let settings = Settings { further_paths: true, ..plain };
    let split = |settings: &Settings| renderer.render_split(&window(), &geometry, [0, 1], settings, task).unwrap();
    let further = split(&settings);
    assert!(further != split(&plain));
    for count in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
        assert!(pool.install(|| split(&settings)) == further, "{count} threads");
    }
    let guided = renderer.render_split_and_features(&window(), &geometry, [0, 1], &settings, task).unwrap();
    assert!(guided.split == further && guided.variance.data().iter().all(|value| value.is_finite()));
    // a view that no other view helps stays as it is
    let alone = geometry.with_grid(ViewGrid::uniform(Projection::Oblique, [1, 1], [1.0, 1.0]).unwrap());
    let own = renderer.render_split(&window(), &alone, [0, 0], &settings, task).unwrap();
    let mut light = SharedLight::new(&alone, &settings);
    light.add(&own);
    assert!(light.averaged(task).unwrap().on(0, &own) == own.radiance());
    let dark = Settings { max_bounces: 0, hide_environment: true, ..plain };
    assert!(split(&dark).radiance() == split(&Settings { further_paths: true, ..dark }).radiance());
    // The average of 64 means is compared with the mean of two references. The tolerance is four
    // standard errors of the average, plus the difference of the two references.
    let truth = [1, 2].map(|seed| render(&renderer, [0, 1], 256, seed));
    let (first, second) = (mean(&truth[0]), mean(&truth[1]));
    let means = (0..64).map(|seed| mean(&split(&Settings { seed, ..settings }).radiance()));
    let found: Vec<f64> = means.collect();
    let average = found.iter().sum::<f64>() / found.len() as f64;
    let spread = found.iter().map(|value| (value - average).powi(2)).sum::<f64>() / (found.len() - 1) as f64;
    let allowed = 4.0 * (spread / found.len() as f64).sqrt() + (first - second).abs();
    assert!((average - 0.5 * (first + second)).abs() < allowed, "{average}, {first} and {second}, {allowed}");
}
