//! Writes the site through the plugin's C functions, and reads it with the module that the page
//! runs.

use std::collections::BTreeMap;

use lumistack_plugin::Time;
use lumistack_plugin::core::colour::srgb_encode;
use lumistack_plugin::core::metrics::SquaredError;
use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{Display, LayerStack, LightField, Simulator, ViewGrid};
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

/// For every sample stack, with a uniform or directional backlight, the page's picture differs from
/// the picture of the display model only by the rounding to 8 bits.
#[test]
fn the_page_agrees_with_the_display_model() {
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
    // All files of a frame must be adjacent, but the frames may be in any order.
    for (i, file) in list.iter().take(stack.layers.len() * stack.frames()).enumerate() {
        let layers = stack.layers.len();
        assert_eq!((&file["layer"], &file["frame"]), (&json!(i % layers), &list[i / layers * layers]["frame"]));
        assert_eq!(file["bytes"], files[file["path"].as_str().unwrap()].len());
    }
    let [rows, cols] = target.geometry().grid.views();
    let first = list.iter().find(|file| file["kind"] == "target").unwrap();
    assert_eq!(first["view"], json!([(rows - 1) / 2, (cols - 1) / 2]));
    // The single file must contain every file under its path, and must not refer to files of the
    // folder `app`.
    let page = std::str::from_utf8(&files["preview.html"]).unwrap();
    assert!(
        page.contains("<title>A &lt;b&gt; &amp; c") && !page.contains("href=\"app/") && !page.contains("src=\"app/")
    );
    for file in list {
        assert!(page.contains(&format!("\"{}\":\"iVBOR", file["path"].as_str().unwrap())));
    }
    let index = std::str::from_utf8(&files["index.html"]).unwrap();
    assert!(index.contains(r#"<a href="preview.html">"#) && !page.contains("preview.html</a>"));
    assert!(index.contains("app/viewer.js") && !index.contains("=\"/") && !index.contains("http"), "{index}");
    let few = write(&sample.display, OutputData::LayerStack(stack, None), json!({"single_file": false}));
    assert!(!few.contains_key("preview.html") && !few.keys().any(|path| path.contains("target")));
    let index = std::str::from_utf8(&few["index.html"]).unwrap();
    assert!(!index.contains("preview.html"), "{index}");
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

/// Returns a stack of waves of low spatial frequency, which JPEG compression keeps.
fn waves(display: &Display) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    for (n, layer) in stack.layers.iter_mut().enumerate() {
        let value = |i: usize| 0.6 + 0.4 * (0.02 * (n + 1) as f32 * (i / 3 % 60) as f32).sin();
        layer.data_mut().iter_mut().enumerate().for_each(|(i, place)| *place = value(i));
    }
    stack
}

#[test]
fn the_poster_is_the_seen_picture_and_links_show_it() {
    let display = Display::uniform([60, 40], 1.0, [3, 3], [20.0, 20.0], &[-3.0, 3.0], 2);
    let display = Display { name: "Two layers".into(), brightness: 0.8, ..display };
    let stack = waves(&display);
    let params = json!({"title": "still-life", "caption": "A \"kettle\".", "address": "https://example.org/kettle"});
    let files = write(&display, OutputData::LayerStack(&stack, None), params);
    let poster = image::load_from_memory(&files["stack/poster.jpg"]).unwrap().to_rgb8();
    assert_eq!(poster.dimensions(), (60, 40));
    let geometry = display.geometry().unwrap();
    let grid = ViewGrid::single(geometry.grid.projection, [0.0, 0.0]);
    let seen = Simulator::new(&display, &stack).seen(&geometry.with_grid(grid), [0, 0]).radiance;
    let mut error = SquaredError::default();
    for (code, value) in poster.as_raw().iter().zip(seen.data()) {
        let wanted = srgb_encode((value / 0.8).min(1.0));
        error.add(f64::from(*code) / 255.0, f64::from(wanted));
    }
    assert!(error.psnr() > 38.0, "{} dB", error.psnr());
    let preview: Value = from_slice(&files[PREVIEW_JSON]).unwrap();
    assert_eq!((&preview["title"], &preview["poster"]), (&json!("Still life"), &json!("stack/poster.jpg")));
    let index = std::str::from_utf8(&files["index.html"]).unwrap();
    for part in [
        r#"<title>Still life – Lumistack</title>"#,
        r#"<meta property="og:description" content="A &quot;kettle&quot;.">"#,
        r#"<meta property="og:image" content="https://example.org/kettle/stack/poster.jpg">"#,
        r#"<img slot="poster" src="stack/poster.jpg" width="60" height="40" fetchpriority="high" alt="Still life">"#,
    ] {
        assert!(index.contains(part), "{part} is missing in {index}");
    }
    let page = std::str::from_utf8(&files["preview.html"]).unwrap();
    assert!(page.contains(r#"src="data:image/jpeg;base64,"#) && !page.contains("og:image"));
}

/// The poster's file is small enough for slow connections, and large enough for a sharp picture.
#[test]
fn the_poster_of_a_large_display_has_a_limited_size() {
    let display = Display::uniform([1300, 810], 0.2, [1, 1], [20.0, 20.0], &[-3.0, 3.0], 1);
    let mut stack = waves(&display);
    // Noise needs many bytes. At the best quality the poster of this picture has 77 kB.
    let mut random = Stream::new(8);
    stack.layers[0].data_mut().iter_mut().for_each(|value| *value *= 0.8 + 0.2 * random.next_f32());
    let files = write(&display, OutputData::LayerStack(&stack, None), json!({"single_file": false}));
    let poster = image::load_from_memory(&files["stack/poster.jpg"]).unwrap();
    assert_eq!((poster.width(), poster.height()), (650, 405));
    let bytes = files["stack/poster.jpg"].len();
    assert!((20_000..=45_000).contains(&bytes), "{bytes} bytes");
}

/// The site of a large stack has small views from the whole zone. If the single file would be too
/// large, it is not written, and a message says so.
#[test]
fn a_large_stack_can_be_viewed_before_it_is_loaded() {
    let display = Display::uniform([400, 250], 1.0, [3, 1], [20.0, 20.0], &[-3.0, 3.0], 3);
    let mut stack = LayerStack::filled(&display, 0.0);
    let mut random = Stream::new(5);
    stack.layers.iter_mut().for_each(|layer| layer.data_mut().fill_with(|| random.next_f32()));
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN).unwrap());
    let output = Output::open(&plugin, &host, &json!({"single_file_mb": 2.0}), &display).unwrap();
    output.submit(Time::default(), OutputData::LayerStack(&stack, None)).unwrap();
    output.finish().unwrap();
    let files = host.files();
    let preview: Value = from_slice(&files[PREVIEW_JSON]).unwrap();
    let around = &preview["around"];
    let most = 10f64.to_radians().tan();
    assert_eq!((&around["slope_y"], around["slope_x"].as_array().unwrap().len()), (&json!([0.0]), 5));
    assert!((around["slope_x"][4].as_f64().unwrap() - most).abs() < 1e-12);
    let quilt = image::load_from_memory(&files["stack/around.jpg"]).unwrap().to_rgb8();
    assert_eq!((&around["cols"], &around["rows"]), (&json!(200), &json!(125)));
    assert_eq!(quilt.dimensions(), (1000, 125));
    assert!(!files.contains_key("preview.html"));
    assert!(
        host.messages().iter().any(|(_, text)| text.contains("preview.html was left out") && text.contains("2 MB"))
    );
    // The limit counts the whole file.
    let size = |mb: f64| {
        let host = MemoryHost::new();
        let output = Output::open(&plugin, &host, &json!({ "single_file_mb": mb }), &display).unwrap();
        output.submit(Time::default(), OutputData::LayerStack(&stack, None)).unwrap();
        output.finish().unwrap();
        let messages: Vec<String> = host.messages().into_iter().map(|(_, text)| text).collect();
        (host.files().get("preview.html").map(Vec::len), messages.into_iter().find(|text| text.contains("left out")))
    };
    let (Some(whole), None) = size(30.0) else { panic!("preview.html was left out") };
    assert_eq!(size(whole as f64 / 1e6), (Some(whole), None));
    let less = (whole - 1) as f64 / 1e6;
    assert!(matches!(size(less), (None, Some(text)) if text.contains(&format!("more than {less} MB"))));
    // The site of a small stack must have no small views.
    let display = Display::uniform([6, 5], 1.0, [3, 3], [20.0, 20.0], &[-3.0, 3.0], 2);
    let files = write(&display, OutputData::LayerStack(&LayerStack::filled(&display, 0.5), None), json!({}));
    assert!(!files.contains_key("stack/around.jpg") && files.contains_key("preview.html"));
}
