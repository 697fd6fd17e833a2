//! The site through the plugin's C functions, read back by the module that the page uses.

use std::collections::BTreeMap;

use lumistack_plugin::Time;
use lumistack_plugin::core::metrics::SquaredError;
use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{Display, LayerStack, LightField, Simulator};
use lumistack_plugin::serde_json::{Value, from_slice, json};
use lumistack_plugin_testkit::serve::{Output, OutputData, Plugin};
use lumistack_plugin_testkit::{MemoryHost, conformance, samples};
use lumistack_plugin_web_simulator::{PLUGIN, PREVIEW_JSON};
use lumistack_web::Model;

type Files = BTreeMap<String, Vec<u8>>;

fn write(display: &Display, data: OutputData<'_>, params: Value) -> Files {
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN).unwrap());
    let output = Output::open(&plugin, &host, &params, display).unwrap();
    output.submit(Time::default(), data).unwrap();
    output.finish().unwrap();
    host.files()
}

fn model_of(files: &Files) -> Model {
    let mut model = Model::new(std::str::from_utf8(&files[PREVIEW_JSON]).unwrap()).unwrap();
    let paths: Vec<String> = model.preview().files.iter().map(|file| file.path.clone()).collect();
    for (i, path) in paths.iter().enumerate() {
        model.put(i, &files[path]).unwrap();
    }
    model
}

fn random_target(display: &Display) -> LightField {
    let mut field = LightField::black(display.geometry().unwrap()).unwrap();
    let mut random = Stream::new(4);
    field.radiance_mut().data_mut().fill_with(|| random.next_f32());
    field
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

/// Of every sample stack, uniform and directional: what the page shows is what the display shows, but for the rounding that the preview itself states.
#[test]
fn the_page_shows_what_the_display_shows() {
    for sample in samples().iter().filter(|sample| sample.stack().is_some()) {
        let (stack, display) = (sample.stack().unwrap(), &sample.display);
        let target = random_target(display);
        let files = write(display, OutputData::LayerStack(stack, Some(&target)), json!({}));
        let model = model_of(&files);
        assert_eq!(model.frames_ready(), stack.frames());
        assert_eq!(model.targets_ready(), target.geometry().grid.iter().count());
        let simulator = Simulator::new(display, stack);
        let mut error = SquaredError::default();
        for slope in [[0.0, 0.0], [0.1, -0.05], [-0.08, 0.11]] {
            let expected = simulator.from_slope(slope).radiance;
            let found = model.view_linear(slope);
            if model.geometry().grid.projection == lumistack_plugin::display::Projection::Oblique {
                for (found, expected) in found.iter().zip(expected.data()) {
                    error.add(f64::from(*found), f64::from(*expected) / stack.brightness);
                }
            }
        }
        let stated = model.preview().rounding_db;
        assert!(error.count == 0 || error.psnr() >= 45.0, "{}: {} dB, stated {stated:?}", sample.name, error.psnr());
        assert!(stated.is_none_or(|stated| stated > 40.0), "{}: {stated:?}", sample.name);
    }
}

#[test]
fn files_come_frame_by_frame_and_then_the_target_from_the_middle() {
    let sample = samples().into_iter().find(|sample| sample.stack().is_some()).unwrap();
    let (stack, target) = (sample.stack().unwrap(), random_target(&sample.display));
    let files = write(&sample.display, OutputData::LayerStack(stack, Some(&target)), json!({"title": "A <b> & c"}));
    let preview: Value = from_slice(&files[PREVIEW_JSON]).unwrap();
    let list = preview["files"].as_array().unwrap();
    for (i, file) in list.iter().take(stack.layers.len()).enumerate() {
        assert_eq!((&file["layer"], &file["frame"]), (&json!(i), &json!(0)));
        assert_eq!(file["bytes"], files[file["path"].as_str().unwrap()].len());
    }
    let [rows, cols] = target.geometry().grid.views();
    let first = list.iter().find(|file| file["kind"] == "target").unwrap();
    assert_eq!(first["view"], json!([(rows - 1) / 2, (cols - 1) / 2]));
    // the single file has everything under its path, and no links
    let page = std::str::from_utf8(&files["preview.html"]).unwrap();
    assert!(
        page.contains("<title>A &lt;b&gt; &amp; c") && !page.contains("href=\"app/") && !page.contains("src=\"app/")
    );
    for file in list {
        assert!(page.contains(&format!("\"{}\":\"iVBOR", file["path"].as_str().unwrap())));
    }
    let index = std::str::from_utf8(&files["index.html"]).unwrap();
    assert!(index.contains("app/viewer.js") && !index.contains("=\"/") && !index.contains("http"), "{index}");
    let few = write(&sample.display, OutputData::LayerStack(stack, None), json!({"single_file": false}));
    assert!(!few.contains_key("preview.html") && !few.keys().any(|path| path.contains("target")));
    let none = json!({"target": false});
    let few = write(&sample.display, OutputData::LayerStack(stack, Some(&target)), none);
    assert!(!few.keys().any(|path| path.contains("target")));
}

#[test]
fn rounding_of_exact_codes_costs_nothing() {
    let display = Display::uniform([6, 5], 1.0, [3, 3], [20.0, 20.0], &[-3.0, 3.0], 2);
    let mut stack = LayerStack::filled(&display, 0.0);
    let mut random = Stream::new(9);
    for layer in &mut stack.layers {
        layer.data_mut().fill_with(|| (256.0 * random.next_f32()).floor() / 255.0);
    }
    let files = write(&display, OutputData::LayerStack(&stack, None), json!({}));
    let stated = model_of(&files).preview().rounding_db;
    assert!(stated.is_none_or(|stated| stated > 120.0), "{stated:?}");
}
