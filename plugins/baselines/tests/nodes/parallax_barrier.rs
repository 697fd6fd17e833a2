//! Tests the plugin `parallax_barrier`: compares the masks and the emission along every ray with
//! the definition of a parallax barrier.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Display, RayMap, Simulator};
use lumistack_plugin_baselines::parallax_barrier::PLUGIN;
use lumistack_plugin_testkit::{conformance, made_by, random_field};

/// Tolerance of sums of a few f32 values.
const ROUNDING: f32 = 1e-5;

/// Returns a display of two layers, in which rays of neighbouring views through one slit hit
/// neighbouring pixels of the rear layer.
fn display(views: [usize; 2], frames: usize) -> Display {
    // Slopes of neighbouring views differ by `step`. The layers are 1/`step` apart, so this
    // difference shifts the rear pixel by one.
    let step = 2.0 * 10f64.to_radians().tan() / views[0] as f64;
    Display::uniform(
        [24, 18],
        1.0,
        views,
        [20.0, 20.0 * views[1] as f64 / views[0] as f64],
        &[-1.0 / step, 0.0],
        frames,
    )
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn with_a_frame_for_every_place_all_rays_are_right() {
    let display = display([3, 1], 3);
    let field = random_field(&display).unwrap();
    let stack = made_by(&PLUGIN, "{}", &display, &field).unwrap();
    assert_eq!(stack.brightness, 1.0 / 3.0);
    let map = RayMap::new(&display, field.geometry());
    let simulator = Simulator::new(&display, &stack);
    let mut compared = 0;
    for view in field.geometry().grid.iter() {
        let shown = simulator.view(&map, field.geometry(), view);
        let taps = map.layers[0].x.of_view(view[1]);
        for (i, (shown, wanted)) in shown.radiance.data().iter().zip(field.view(view)).enumerate() {
            // Rays that miss the rear layer are not compared, since they have no rear pixel.
            if taps[i / 3 % field.geometry().cols].is_missed() {
                continue;
            }
            assert!((shown * 3.0 - wanted).abs() < ROUNDING, "view {view:?}, value {i}: {shown}, wanted {wanted} / 3");
            compared += 1;
        }
    }
    assert!(compared > 3 * 20 * 18 * 3);
}

#[test]
fn one_frame_is_a_static_barrier() {
    let display = display([3, 1], 1);
    let field = random_field(&display).unwrap();
    let stack = made_by(&PLUGIN, "{}", &display, &field).unwrap();
    let [_, rows, cols, _] = stack.layers[1].shape();
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        assert_eq!(stack.layers[1].get([0, row, col, 1]), f32::from(col % 3 == 0), "row {row}, column {col}");
    }
    // Every ray through an open slit is exact, since no other ray uses its rear pixel.
    let map = RayMap::new(&display, field.geometry());
    let mut through = 0;
    for view in field.geometry().grid.iter() {
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let [rear, front] = [0, 1].map(|n| map.layers[n].x.of_view(view[1])[col]);
            if !rear.is_missed() && !front.is_missed() && front.first % 3 == 0 {
                let rear_row = map.layers[0].y.of_view(view[0])[row].first as usize;
                let shown = stack.layers[0].get([0, rear_row, rear.first as usize, 2]);
                let wanted = field.radiance().get([view[0], view[1], row, col, 2]);
                assert!((shown - wanted).abs() < ROUNDING, "view {view:?}, row {row}, column {col}");
                through += 1;
            }
        }
    }
    assert!(through > 3 * 7 * rows, "{through} rays");
}

#[test]
fn views_that_share_a_pixel_are_averaged() {
    let display = display([3, 1], 1);
    let mut field = random_field(&display).unwrap();
    field.radiance_mut().data_mut().fill(0.25);
    // With a period of 1 the whole mask is open, so a constant light field is shown exactly by
    // equal rear pixels.
    let stack = made_by(&PLUGIN, r#"{"period_x": 1}"#, &display, &field).unwrap();
    assert_eq!(stack.brightness, 1.0);
    assert!(stack.layers[0].data().iter().all(|value| (value - 0.25).abs() < ROUNDING));
    assert!(stack.layers[1].data().iter().all(|value| *value == 1.0));
}

#[test]
fn other_displays_are_refused() {
    let mut display = display([3, 1], 1);
    let field = random_field(&display).unwrap();
    display.layers.push(display.layers[1].clone());
    display.layers[2].d_mm += 1.0;
    let error = made_by(&PLUGIN, "{}", &display, &field).unwrap_err();
    assert!(matches!(&error, PluginError::Refused(text) if text.contains("expected two layers, found 3")), "{error:?}");
}
