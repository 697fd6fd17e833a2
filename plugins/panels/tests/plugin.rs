//! Tests the plugin `panels` through the plugin interface, without windows: the commands that it
//! accepts, and the inputs that it refuses before the presentation.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Backlight, Display, LensletBacklight};
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin_panels::PLUGIN;
use lumistack_plugin_testkit::serve::{Output, Plugin};
use lumistack_plugin_testkit::{MemoryHost, conformance, samples};

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

fn opened(params: &Value, display: &Display) -> Result<(), String> {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    assert!(plugin.info().presents);
    Output::open(&plugin, &MemoryHost::new(), params, display).map(drop).map_err(|error| match error {
        PluginError::Refused(text) => text,
        other => panic!("{other:?}"),
    })
}

#[test]
fn parameters_that_do_not_go_with_the_display_are_refused() {
    let display = Display::uniform([8, 6], 1.0, [3, 3], [10.0, 10.0], &[-10.0, 0.0, 10.0], 3);
    let refused = |params: Value, text: &str| {
        let error = opened(&params, &display).unwrap_err();
        assert!(error.contains(text), "{error}");
    };
    for params in [json!({}), json!({"pattern": "ramp", "only": "2"}), json!({"hold": 2}), json!({"mode": "window"})] {
        assert_eq!(opened(&params, &display), Ok(()));
    }
    refused(json!({"hold": 3}), "`hold`: expected -1 to 2, found 3");
    refused(json!({"pattern": "ramp", "hold": 1}), "`hold`: expected -1 to 0, found 1");
    refused(json!({"pattern": "stripes"}), "found stripes");
    for only in ["backlight", "3", "front"] {
        let expected = format!("`only`: expected one of layer 0, layer 1, layer 2, found {only}");
        refused(json!({"pattern": "ramp", "only": only}), &expected);
    }
    let expected = "`eye_z_mm`: expected a distance in front of all layers, above 10 mm, found 5";
    refused(json!({"pattern": "crosshairs", "eye_z_mm": 5.0}), expected);
    refused(json!({"pattern": "view=0,0"}), "pattern: expected a display with a lenslet backlight for `view`");
    refused(json!({"picture": "no such file"}), "`picture`: no such file");
    refused(json!({"picture": "x", "layer": 3}), "`layer`: expected -1 to 2");
}

#[test]
fn a_lenslet_outside_of_the_array_is_refused() {
    let mut display = Display::uniform([8, 6], 1.0, [3, 2], [40.0, 40.0], &[0.0], 1);
    display.backlight = Backlight::Lenslets(LensletBacklight::new(-6.0, [4, 3], 2.0, [3, 2], [40.0, 40.0]));
    for pattern in ["lenslet=3,2", "view=2,1"] {
        assert_eq!(opened(&json!({"pattern": pattern}), &display), Ok(()));
    }
    let error = |pattern: &str| opened(&json!({"pattern": pattern}), &display).unwrap_err();
    assert_eq!(error("lenslet=99,0"), "pattern: expected lenslet=0,0 to 3,2, found 99,0");
    assert_eq!(error("view=0,2"), "pattern: expected view=0,0 to 2,1, found 0,2");
}

#[test]
fn commands_differ_from_nonsense() {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    let (host, sample) = (MemoryHost::new(), &samples()[0]);
    let output = Output::open(&plugin, &host, &json!({}), &sample.display).unwrap();
    for command in [json!({"hold": 1}), json!("run"), json!({"nudge": ["layer 0", [1.0, -2.0]]}), json!("quit")] {
        assert_eq!(output.command(&command), Ok(()), "{command}");
    }
    for command in [json!("dance"), json!({"hold": -1}), json!({"nudge": ["front", [0.0, 0.0]]}), json!(7)] {
        assert!(matches!(output.command(&command), Err(PluginError::Refused(_))), "{command}");
    }
}
