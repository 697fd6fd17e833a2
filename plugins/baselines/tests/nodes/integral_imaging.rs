//! Tests the plugin `integral_imaging`: compares the emission along every ray with the target.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Backlight, Display, LensletBacklight, RayMap, Simulator};
use lumistack_plugin_baselines::integral_imaging::PLUGIN;
use lumistack_plugin_testkit::{conformance, made_by, random_field};

/// Tolerance of f32 rounding.
const ROUNDING: f32 = 1e-6;

/// Returns a display of one layer of 12 × 12 pixels, in the plane of `lenslets` × `lenslets`
/// lenslets.
fn display(lenslets: usize) -> Display {
    let mut display = Display::uniform([12, 12], 1.0, [3, 3], [20.0, 20.0], &[0.0], 2);
    let pitch = 12.0 / lenslets as f64;
    display.backlight = Backlight::Lenslets(LensletBacklight::new(-1e-9, [lenslets; 2], pitch, [3, 3], [20.0, 20.0]));
    display.layers[0].peak = 0.8;
    display
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn with_a_lenslet_per_pixel_all_rays_are_right() {
    let display = display(12);
    let field = random_field(&display).unwrap();
    let stack = made_by(&PLUGIN, "{}", &display, &field).unwrap();
    assert_eq!(stack.brightness, 0.8);
    let (map, simulator) = (RayMap::new(&display, field.geometry()), Simulator::new(&display, &stack));
    for view in field.geometry().grid.iter() {
        let shown = simulator.view(&map, field.geometry(), view);
        for (shown, wanted) in shown.radiance.data().iter().zip(field.view(view)) {
            assert!((shown / 0.8 - wanted).abs() < ROUNDING, "{view:?}");
        }
    }
}

/// A lenslet that is larger than a pixel shows, in every bin, the mean of the target over the
/// lenslet's area.
#[test]
fn a_coarse_array_shows_means() {
    let display = display(4);
    let field = random_field(&display).unwrap();
    let stack = made_by(&PLUGIN, "{}", &display, &field).unwrap();
    let emission = stack.emission.as_ref().unwrap();
    let [_, bins_y, bins_x, rows, cols, _] = emission.shape();
    for (bin_y, bin_x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
        for (row, col) in (0..rows).flat_map(|y| (0..cols).map(move |x| (y, x))) {
            let over = (0..3).flat_map(|y| (0..3).map(move |x| (3 * row + y, 3 * col + x)));
            let mean: f32 = over.map(|(y, x)| field.radiance().get([bin_y, bin_x, y, x, 1])).sum::<f32>() / 9.0;
            for frame in [0, 1] {
                let found = emission.get([frame, bin_y, bin_x, row, col, 1]);
                assert!((found - mean).abs() < ROUNDING, "bin {bin_y} {bin_x}, lenslet {row} {col}");
            }
        }
    }
}

#[test]
fn other_displays_are_refused() {
    let display = Display::uniform([12, 12], 1.0, [3, 3], [20.0, 20.0], &[0.0], 2);
    let error = made_by(&PLUGIN, "{}", &display, &random_field(&display).unwrap()).unwrap_err();
    assert!(
        matches!(&error, PluginError::Refused(text) if text.contains("expected a directional backlight")),
        "{error:?}"
    );
}
