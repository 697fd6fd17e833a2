//! Tests the plugin `directional_sequence`: compares the emission along every ray with the target.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Backlight, Display, LensletBacklight, RayMap, Simulator};
use lumistack_plugin_baselines::directional_sequence::PLUGIN;
use lumistack_plugin_testkit::{conformance, made_by, random_field};

/// Tolerance of f32 rounding.
const ROUNDING: f32 = 1e-5;

fn display(frames: usize) -> Display {
    let mut display = Display::uniform([12, 9], 1.0, [3, 2], [20.0, 20.0], &[0.0], frames);
    display.backlight = Backlight::Lenslets(LensletBacklight::new(-5.0, [6, 6], 2.5, [3, 2], [20.0, 20.0]));
    display.layers[0].peak = 0.8;
    display
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

/// Views whose directions share a frame are all shown as the mean of these views. With one frame
/// per view, the display shows each view unchanged.
#[test]
fn views_that_share_a_frame_share_its_picture() {
    for frames in [6, 3, 1] {
        let display = display(frames);
        let field = random_field(&display).unwrap();
        let stack = made_by(&PLUGIN, "{}", &display, &field).unwrap();
        assert!((stack.brightness - 0.8 / frames as f64).abs() < 1e-12);
        let (map, simulator) = (RayMap::new(&display, field.geometry()), Simulator::new(&display, &stack));
        let together = 6 / frames;
        for view in field.geometry().grid.iter() {
            let shown = simulator.view(&map, field.geometry(), view);
            let first = (3 * view[0] + view[1]) / together * together;
            let views: Vec<&[f32]> = (first..first + together).map(|k| field.view([k / 3, k % 3])).collect();
            for (i, shown) in shown.radiance.data().iter().enumerate() {
                let wanted = views.iter().map(|view| view[i]).sum::<f32>() / together as f32;
                let found = shown / stack.brightness as f32;
                assert!((found - wanted).abs() < ROUNDING, "{frames} frames, {view:?}: {found} instead of {wanted}");
            }
        }
    }
}

#[test]
fn other_displays_are_refused() {
    let display = Display { frames: 7, ..display(6) };
    let error = made_by(&PLUGIN, "{}", &display, &random_field(&display).unwrap()).unwrap_err();
    assert!(
        matches!(&error, PluginError::Refused(text) if text.contains("expected at most 6 frames, one per direction of the backlight, found 7")),
        "{error:?}"
    );
    let uniform = Display { backlight: Backlight::Uniform, ..display };
    assert!(made_by(&PLUGIN, "{}", &uniform, &random_field(&uniform).unwrap()).is_err());
}
