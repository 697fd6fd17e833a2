//! The patterns against what a barrier should show, ray by ray.

use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{Display, LayerStack, LightField, RayMap, Simulator};
use lumistack_plugin::serve::{Plugin, make_stack};
use lumistack_plugin::testkit::{MemoryHost, conformance};
use lumistack_plugin::{PluginError, Time};
use lumistack_plugin_parallax_barrier::PLUGIN;

/// Rounding of sums of a few f32 values.
const ROUNDING: f32 = 1e-5;

/// Two layers 1.5 pixels apart per step of slope: neighbouring views behind one slit are neighbouring rear pixels.
fn display(views: [usize; 2], frames: usize) -> Display {
    // slopes of neighbouring views differ by 2·tan(10°)/views; the layers' distance makes that one pixel
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

fn random_field(display: &Display) -> LightField {
    let mut field = LightField::black(display.geometry().unwrap()).unwrap();
    let mut stream = Stream::new(7);
    field.radiance_mut().data_mut().fill_with(|| stream.next_f32());
    field
}

fn make(display: &Display, field: &LightField, params: &str) -> Result<LayerStack, PluginError> {
    let (plugin, host) = (Plugin::compiled_in(&PLUGIN).unwrap(), MemoryHost::new());
    make_stack(&plugin, &host, params, display, Time::default(), field)
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn with_a_frame_for_every_place_all_rays_are_right() {
    let display = display([3, 1], 3);
    let field = random_field(&display);
    let stack = make(&display, &field, "{}").unwrap();
    assert_eq!(stack.brightness, 1.0 / 3.0);
    let map = RayMap::new(&display, field.geometry());
    let simulator = Simulator::new(&display, &stack);
    let mut compared = 0;
    for view in field.geometry().grid.iter() {
        let shown = simulator.view(&map, field.geometry(), view);
        let taps = map.layers[0].x.of_view(view[1]);
        for (i, (shown, wanted)) in shown.radiance.data().iter().zip(field.view(view)).enumerate() {
            // beside the rear layer there is nothing to show
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
    let field = random_field(&display);
    let stack = make(&display, &field, "{}").unwrap();
    let [_, rows, cols, _] = stack.layers[1].shape();
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        assert_eq!(stack.layers[1].get([0, row, col, 1]), f32::from(col % 3 == 0), "row {row}, column {col}");
    }
    // every ray through a slit has a rear pixel of its own
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
    let mut field = random_field(&display);
    field.radiance_mut().data_mut().fill(0.25);
    // no barrier at all: everything is open, and a constant light field is constant
    let stack = make(&display, &field, r#"{"period_x": 1}"#).unwrap();
    assert_eq!(stack.brightness, 1.0);
    assert!(stack.layers[0].data().iter().all(|value| (value - 0.25).abs() < ROUNDING));
    assert!(stack.layers[1].data().iter().all(|value| *value == 1.0));
}

#[test]
fn other_displays_are_refused() {
    let mut display = display([3, 1], 1);
    let field = random_field(&display);
    display.layers.push(display.layers[1].clone());
    display.layers[2].d_mm += 1.0;
    let error = make(&display, &field, "{}").unwrap_err();
    assert!(matches!(&error, PluginError::Refused(text) if text.contains("expected two layers, found 3")), "{error:?}");
}
