//! Compares PSNR with published values of an independent implementation, on two light fields in the
//! folder `LUMISTACK_LIGHTFIELDS`.

use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{Backlight, Display, LensletBacklight, LightField, Missing, OutsideBins, Weights};

use lumistack_factorizer::{Multiplicative, Problem, Settings, Solver, factorize, random_start};

/// Largest tolerated PSNR difference from a published value, dB. It is not 0, since random starts
/// differ.
const FIGURE_TOLERANCE: f64 = 0.3;

/// Width of the display in millimetres at any resolution.
const WIDTH_MM: f64 = 473.76;

/// Reads a light field, and returns its middle, cut to the size of the display. The file is in the
/// folder `LUMISTACK_LIGHTFIELDS`. If it is missing, returns `None`, and reports the test as
/// skipped.
#[allow(clippy::disallowed_methods, reason = "a test may read files")]
pub(super) fn light_field(name: &str, display: &Display) -> Option<LightField> {
    let folder = lumistack_testkit::skip::folder("LUMISTACK_LIGHTFIELDS", "../shared/lightfields")?;
    let path = folder.join(format!("{name}.npy"));
    let Ok(bytes) = std::fs::read(&path) else {
        lumistack_testkit::skip::skipped(&format!("{} is not there", path.display()));
        return None;
    };
    let file = npyz::NpyFile::new(&bytes[..]).unwrap();
    let shape: [usize; 5] = file.shape().iter().map(|&n| n as usize).collect::<Vec<_>>().try_into().unwrap();
    let whole = file.into_vec::<f32>().unwrap();
    let geometry = display.geometry().unwrap();
    let [_, _, rows, cols, _] = LightField::shape_of(&geometry);
    let [_, _, all_rows, all_cols, channels] = shape;
    let (top, left) = ((all_rows - rows) / 2, (all_cols - cols) / 2);
    let views = whole.chunks_exact(all_rows * all_cols * channels);
    let lines = views.flat_map(|view| view.chunks_exact(all_cols * channels).skip(top).take(rows));
    let middle = lines.flat_map(|line| line[left * channels..][..cols * channels].iter().copied()).collect();
    let tensor = Tensor::from_vec(LightField::AXES, LightField::shape_of(&geometry), middle).unwrap();
    Some(LightField::new(geometry, tensor).unwrap())
}

/// Returns a display of `layers` layers 40 mm apart around z = 0. It has 160 × 100 pixels and a
/// field of view of 20° × 20°.
pub(super) fn display(views: usize, layers: usize, frames: usize, brightness: f64) -> Display {
    display_of([160, 100], views, layers, frames, brightness)
}

/// Returns the display of [`display`] with another number of pixels, columns × rows.
pub(super) fn display_of(
    resolution: [usize; 2],
    views: usize,
    layers: usize,
    frames: usize,
    brightness: f64,
) -> Display {
    let pitch_mm = WIDTH_MM / 160.0;
    let d_mm: Vec<f64> = (0..layers).map(|n| (n as f64 - (layers as f64 - 1.0) / 2.0) * 40.0).collect();
    Display {
        name: "published".into(),
        refresh_hz: 120.0,
        brightness,
        ..Display::uniform(resolution, pitch_mm, [views; 2], [20.0; 2], &d_mm, frames)
    }
}

/// Returns a display with one layer at z = 0 in front of 47 × 29 lenslets.
fn directional(frames: usize, brightness: f64) -> Display {
    let backlight = Backlight::Lenslets(LensletBacklight {
        d_mm: -8.5,
        lenslets: [47, 29],
        pitch_mm: WIDTH_MM / 47.0,
        fov_deg: [20.0; 2],
        views: [5; 2],
        offset_mm: [0.0; 2],
        black_level: 0.0,
        outside_bins: OutsideBins::Dark,
        transfer: Default::default(),
        panel_resolution: None,
        panel_pitch_mm: None,
        panel: None,
        lens: None,
    });
    Display { backlight, ..display(5, 1, frames, brightness) }
}

/// Returns the PSNR after each of the given numbers of iterations of the paper's rule, from a
/// random start.
fn curve(display: &Display, target: &LightField, updates: &[u32]) -> Vec<f64> {
    let problem = Problem { display, target, weights: &Weights::Uniform };
    let mut run = Multiplicative.start(&problem, random_start(display, 1)).unwrap();
    let mut figures = Vec::new();
    let mut done = 0;
    for &count in updates {
        for _ in done..count {
            run.step(&Cancel::default()).unwrap();
        }
        done = count;
        figures.push(run.objective().psnr_view);
    }
    figures
}

/// Compares PSNR values with published values, and prints all of them.
fn check(what: &str, found: &[f64], published: &[f64]) {
    println!("{what}: {found:.2?} published {published:?}");
    assert!(
        found.iter().zip(published).all(|(a, b)| (a - b).abs() <= FIGURE_TOLERANCE),
        "{what}: {found:.2?} {published:?}"
    );
}

fn three_layers(brightness: f64, updates: &[u32], published: &[f64]) {
    let display = display(5, 3, 6, brightness);
    let Some(target) = light_field("main_5x5_160x100_fov20", &display) else { return };
    check(&format!("3 layers × 6 frames, β = {brightness}"), &curve(&display, &target, updates), published);
}

#[test]
fn three_layers_reach_the_published_figures() {
    three_layers(0.2, &[5, 10, 20, 50], &[21.5, 23.3, 25.2, 27.7]);
    three_layers(1.0, &[5, 20, 50], &[20.9, 23.1, 24.4]);
}

#[test]
#[ignore = "slow"]
fn three_layers_reach_the_published_figures_in_the_long_run() {
    three_layers(0.2, &[200, 500], &[30.9, 32.3]);
    three_layers(1.0, &[500], &[26.1]);
}

#[test]
#[ignore = "slow"]
fn one_layer_before_lenslets_reaches_the_published_figures() {
    for (brightness, published) in [(0.2, 32.2), (1.0, 27.2)] {
        let display = directional(8, brightness);
        let Some(target) = light_field("main_5x5_160x100_fov20", &display) else { return };
        check(&format!("directional, β = {brightness}"), &curve(&display, &target, &[50]), &[published]);
    }
}

/// Returns the PSNR after each of the given numbers of iterations of the default solver from its
/// default start.
fn default_curve(display: &Display, target: &LightField, iterations: &[u32]) -> Vec<f64> {
    let problem = Problem { display, target, weights: &Weights::Uniform };
    let last = iterations.iter().copied().max().unwrap_or(0);
    let settings = Settings { iterations: last, ..Settings::default() };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let result = factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| ()).unwrap();
    iterations.iter().map(|&count| result.history[count as usize].psnr_view).collect()
}

/// Compares the default solver with the best published row at the same number of iterations.
fn check_default(what: &str, display: &Display, rows: &[(u32, f64)]) {
    let Some(target) = light_field("main_5x5_160x100_fov20", display) else { return };
    let (iterations, published): (Vec<u32>, Vec<f64>) = rows.iter().copied().unzip();
    let found = default_curve(display, &target, &iterations);
    println!("{what}, default: {found:.2?} best published {published:?}");
    // The tolerance is 0.05 dB, since published values are rounded to a tenth.
    assert!(
        found.iter().zip(&published).all(|(found, best)| *found >= best - 0.05),
        "{what}: {found:.2?} {published:?}"
    );
}

#[test]
fn the_default_solver_is_at_least_the_best_published_row() {
    check_default("three layers, β = 0.2", &display(5, 3, 6, 0.2), &[(5, 29.6), (10, 31.3), (20, 32.9), (50, 34.1)]);
    check_default("three layers, β = 1", &display(5, 3, 6, 1.0), &[(5, 25.7), (20, 26.4), (50, 26.6)]);
}

#[test]
#[ignore = "slow"]
fn the_default_solver_is_at_least_the_best_published_row_in_the_long_run() {
    check_default("three layers, β = 0.2", &display(5, 3, 6, 0.2), &[(200, 34.8), (500, 35.1)]);
    check_default("three layers, β = 1", &display(5, 3, 6, 1.0), &[(500, 26.8)]);
    check_default("directional, β = 0.2", &directional(8, 0.2), &[(50, 42.3), (200, 44.1)]);
    check_default("directional, β = 1", &directional(8, 1.0), &[(50, 29.7), (200, 29.8)]);
}

/// Returns the PSNR after 50 iterations for N layers and M frames on the teapot; `None` without the
/// light field.
fn teapot(layers: usize, frames: usize, missing: Missing) -> Option<f64> {
    let display = Display { missing, ..display(3, layers, frames, 0.2) };
    let target = light_field("teapot_3x3_160x100_fov20", &display)?;
    Some(curve(&display, &target, &[50])[0])
}

#[test]
fn frames_are_worth_more_than_layers() {
    let (Some(still), Some(six)) = (teapot(3, 1, Missing::Drop), teapot(3, 6, Missing::Drop)) else { return };
    check("teapot, N = 3, M = 1 and 6", &[still, six], &[21.5, 42.5]);
    assert!(six >= still + 12.0);
}

/// The paper states that eight static layers stay below 30 dB.
///
/// This holds with 5 × 5 views, and with 3 × 3 views if no ray is dropped. It does not hold with 3
/// × 3 views under the default `drop`: the result is 33.4 dB. An independent forward model of the
/// written patterns confirms this value. The test asserts these three results.
#[test]
fn eight_static_layers_stay_below_30_db_except_on_dropped_3x3_views() {
    let display = display(5, 8, 1, 0.2);
    let Some(target) = light_field("main_5x5_160x100_fov20", &display) else { return };
    let five_views = curve(&display, &target, &[50])[0];
    let Some(three_views) = teapot(8, 1, Missing::Clear) else { return };
    let Some(dropped) = teapot(8, 1, Missing::Drop) else { return };
    check("teapot, N = 8, M = 1, dropped rays", &[dropped], &[33.4]);
    println!(
        "N = 8, M = 1: {five_views:.2} dB with 5 × 5 views, {three_views:.2} dB with 3 × 3 views and no dropped ray"
    );
    assert!(five_views < 30.0 && three_views < 30.0);
}

#[test]
#[ignore = "slow"]
fn every_number_of_layers_and_frames_reaches_the_published_figures() {
    const FRAMES: [usize; 6] = [1, 2, 3, 4, 6, 8];
    let table: [(usize, &[f64]); 4] = [
        (2, &[19.5, 22.0, 24.2, 26.3, 30.3, 33.6]),
        (3, &[21.5, 25.8, 30.2, 34.7, 42.5, 48.0]),
        (4, &[22.2, 28.4, 35.6, 42.5]),
        (5, &[24.2, 33.0, 42.8]),
    ];
    for (layers, published) in table {
        let Some(found) = published
            .iter()
            .zip(FRAMES)
            .map(|(_, frames)| teapot(layers, frames, Missing::Drop))
            .collect::<Option<Vec<_>>>()
        else {
            return;
        };
        println!("N = {layers}, M = {:?}: {found:.2?} published {published:?}", &FRAMES[..published.len()]);
        for (found, published) in found.iter().zip(published) {
            assert!((found - published).abs() <= FIGURE_TOLERANCE, "{found} {published}");
        }
    }
}
