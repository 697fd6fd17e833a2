//! The plugin through its C functions: what is read back from the files is what went in.

use std::collections::BTreeMap;

use lumistack_field_io::picture::Picture;
use lumistack_plugin::display::{Transfer, forward};
use lumistack_plugin::encoding::{decode, encode};
use lumistack_plugin::serde_json::{Value, from_slice, json};
use lumistack_plugin::serve::{Output, Plugin};
use lumistack_plugin::testkit::{MemoryHost, Sample, conformance, samples};
use lumistack_plugin::{PluginError, Time};
use lumistack_plugin_images::PLUGIN;

/// Rounding to the nearest code: half a code, and the error of f32 arithmetic in units of a 16-bit code.
const HALF_CODE: f32 = 0.5 + 0.02;
/// Rounding to 11 significant bits.
const HALF_FLOAT: f32 = 1.0 / 2048.0;
/// Smallest step of half floats, for values near 0.
const HALF_FLOAT_STEP: f32 = 1.0 / (1 << 24) as f32;

type Files = BTreeMap<String, Vec<u8>>;

fn write(sample: &Sample, params: Value) -> Result<Files, PluginError> {
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN)?);
    let output = Output::open(&plugin, &host, &params, &sample.display)?;
    output.submit(Time::default(), sample.data())?;
    output.finish()?;
    Ok(host.files())
}

/// Code values of a PNG with the number of its bits.
fn png(files: &Files, name: &str) -> ([usize; 2], Vec<u16>, u32) {
    let decoded = image::load_from_memory(files.get(name).unwrap_or_else(|| panic!("no {name}"))).unwrap();
    let size = [decoded.height() as usize, decoded.width() as usize];
    match decoded {
        image::DynamicImage::ImageRgb8(p) => (size, p.into_raw().into_iter().map(u16::from).collect(), 8),
        image::DynamicImage::ImageRgb16(p) => (size, p.into_raw(), 16),
        other => panic!("{name} has colour type {:?}", other.color()),
    }
}

/// All codes lie within half a code of the values' encoding.
fn assert_png(files: &Files, name: &str, size: [usize; 2], values: &[f32], transfer: Transfer) {
    let (found_size, codes, bits) = png(files, name);
    assert_eq!(found_size, size, "{name}");
    assert_eq!(codes.len(), values.len(), "{name}");
    let top = ((1u32 << bits) - 1) as f32;
    for (i, (&code, &value)) in codes.iter().zip(values).enumerate() {
        let exact = encode(transfer, value) * top;
        assert!((f32::from(code) - exact).abs() <= HALF_CODE, "{name}[{i}]: code {code}, value {value} = {exact}");
        // the linear value that a panel shows differs by no more than the codes around it do
        let around = [exact - HALF_CODE, exact + HALF_CODE].map(|code| decode(transfer, (code / top).clamp(0.0, 1.0)));
        let shown = decode(transfer, f32::from(code) / top);
        assert!(shown >= around[0] && shown <= around[1], "{name}[{i}]: {shown} not in {around:?}");
    }
}

fn exr(files: &Files, name: &str) -> ([usize; 2], Vec<f32>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    std::fs::write(&path, &files[name]).unwrap();
    let picture = Picture::read(&path).unwrap();
    let [cols, rows] = picture.size();
    ([rows, cols], picture.into_linear())
}

fn layered() -> Sample {
    samples().swap_remove(0)
}

fn directional() -> Sample {
    samples().swap_remove(1)
}

fn light_field() -> Sample {
    samples().swap_remove(2)
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn pngs_hold_every_layer_and_frame_in_the_panel_s_codes() {
    let sample = layered();
    let files = write(&sample, json!({"png16": true})).unwrap();
    let stack = sample.stack().unwrap();
    for (l, (layer, panel)) in stack.layers.iter().zip(&sample.display.layers).enumerate() {
        let [frames, rows, cols, _] = layer.shape();
        for m in 0..frames {
            for suffix in [".png", "_16bit.png"] {
                let name = format!("layer_{l}_frame_{m:02}{suffix}");
                assert_png(&files, &name, [rows, cols], layer.block([m]), panel.transfer);
            }
        }
    }
    let transfers: Vec<Transfer> = sample.display.layers.iter().map(|layer| layer.transfer).collect();
    assert_eq!(transfers, [Transfer::Srgb, Transfer::Linear, Transfer::Gamma(2.2)], "the sample has all kinds");
}

#[test]
fn codes_of_a_limited_panel_run_from_its_darkest_to_its_brightest_state() {
    let mut sample = layered();
    let layer = sample.stack().unwrap().layers[0].clone();
    (sample.display.layers[0].black_level, sample.display.layers[0].peak) = (0.1, 0.8);
    let files = write(&sample, json!({"exr": true, "exr_depth": "float"})).unwrap();
    let size = [layer.shape()[1], layer.shape()[2]];
    let driven: Vec<f32> = layer.block([0]).iter().map(|value| ((value - 0.08) / 0.72).clamp(0.0, 1.0)).collect();
    assert_png(&files, "layer_0_frame_00.png", size, &driven, Transfer::Srgb);
    assert_eq!(
        exr(&files, "layer_0_frame_00.exr"),
        (size, layer.block([0]).to_vec()),
        "EXR holds the values themselves"
    );
    let files = write(&sample, json!({"encode": "srgb"})).unwrap();
    assert_png(&files, "layer_0_frame_00.png", size, layer.block([0]), Transfer::Srgb);
}

#[test]
fn the_job_can_choose_another_encoding() {
    let sample = layered();
    let layer = &sample.stack().unwrap().layers[2];
    let size = [layer.shape()[1], layer.shape()[2]];
    let files = write(&sample, json!({"encode": "srgb"})).unwrap();
    assert_png(&files, "layer_2_frame_01.png", size, layer.block([1]), Transfer::Srgb);
    let files = write(&sample, json!({"encode": "linear"})).unwrap();
    assert_png(&files, "layer_2_frame_01_linear.png", size, layer.block([1]), Transfer::Linear);
    assert!(!files.contains_key("layer_2_frame_01.png"), "a picture with linear values says so in its name");
}

#[test]
fn exr_is_exact_to_its_precision() {
    let sample = layered();
    let stack = sample.stack().unwrap();
    let only_exr = |depth: &str| json!({"png8": false, "exr": true, "exr_depth": depth, "views": "none"});
    let (half, float) = (write(&sample, only_exr("half")).unwrap(), write(&sample, only_exr("float")).unwrap());
    assert_eq!(half.len(), 3 * 2 + 1, "six pictures and the manifest");
    for (l, layer) in stack.layers.iter().enumerate() {
        for m in 0..2 {
            let (name, size) = (format!("layer_{l}_frame_{m:02}.exr"), [layer.shape()[1], layer.shape()[2]]);
            assert_eq!(exr(&float, &name), (size, layer.block([m]).to_vec()));
            let (half_size, values) = exr(&half, &name);
            assert_eq!(half_size, size);
            for (value, exact) in values.iter().zip(layer.block([m])) {
                assert!((value - exact).abs() <= HALF_FLOAT * exact + HALF_FLOAT_STEP, "{value} for {exact}");
            }
        }
    }
}

#[test]
fn simulated_views_show_what_an_adapted_viewer_sees() {
    let sample = layered();
    let (stack, geometry) = (sample.stack().unwrap(), sample.display.geometry().unwrap());
    let files = write(&sample, json!({"views": "all"})).unwrap();
    for view in geometry.grid.iter() {
        let slope = geometry.grid.slope_at(view, [0.0, 0.0]);
        let emitted = forward::view_from_slope(&sample.display, stack, slope).radiance;
        let seen: Vec<f32> = emitted.data().iter().map(|value| value / stack.brightness as f32).collect();
        let name = format!("simulated_{:02}_{:02}.png", view[0], view[1]);
        assert_png(&files, &name, [geometry.rows, geometry.cols], &seen, Transfer::Srgb);
    }
    let simulated = |files: &Files| files.keys().filter(|name| name.starts_with("simulated")).count();
    assert_eq!(simulated(&files), 9);
    assert_eq!(simulated(&write(&sample, json!({})).unwrap()), 5);
    assert_eq!(simulated(&write(&sample, json!({"views": "none"})).unwrap()), 0);
}

#[test]
fn the_backlight_s_cells_show_the_bins_as_through_a_lens() {
    let sample = directional();
    let files = write(&sample, json!({"png16": true})).unwrap();
    let emission = sample.stack().unwrap().emission.as_ref().unwrap();
    let [_, bins_y, bins_x, rows, cols, _] = emission.shape();
    let (size, codes, _) = png(&files, "backlight_frame_00_16bit.png");
    assert_eq!(size, [rows * bins_y, cols * bins_x]);
    for (y, x) in (0..size[0]).flat_map(|y| (0..size[1]).map(move |x| (y, x))) {
        let bin = [bins_y - 1 - y % bins_y, bins_x - 1 - x % bins_x];
        for channel in 0..3 {
            let value = emission.get([0, bin[0], bin[1], y / bins_y, x / bins_x, channel]);
            let code = f32::from(codes[3 * (y * size[1] + x) + channel]);
            assert!((code - encode(Transfer::Srgb, value) * 65535.0).abs() <= HALF_CODE);
        }
    }
}

#[test]
fn every_view_of_a_light_field_is_written() {
    let sample = light_field();
    let field = sample.field().unwrap();
    let files = write(&sample, json!({"exr": true, "exr_depth": "float"})).unwrap();
    for view in field.geometry().grid.iter() {
        let (name, size) =
            (format!("view_{:02}_{:02}", view[0], view[1]), [field.geometry().rows, field.geometry().cols]);
        assert_png(&files, &format!("{name}.png"), size, field.view(view), Transfer::Srgb);
        assert_eq!(exr(&files, &format!("{name}.exr")), (size, field.view(view).to_vec()));
    }
    assert_eq!(files.len(), 2 * 6 + 1);
}

#[test]
fn the_manifest_names_every_file_and_says_what_it_is() {
    for sample in [layered(), directional(), light_field()] {
        let files = write(&sample, json!({"png16": true, "exr": true})).unwrap();
        let manifest: Value = from_slice(&files["images.json"]).unwrap();
        assert_eq!((&manifest["schema"], &manifest["version"]), (&json!("lumistack/images"), &json!(1)));
        let entries = manifest["files"].as_array().unwrap();
        let listed: Vec<&str> = entries.iter().map(|entry| entry["file"].as_str().unwrap()).collect();
        assert_eq!(listed, files.keys().filter(|name| *name != "images.json").collect::<Vec<_>>());
        for entry in entries {
            let (name, linear) = (entry["file"].as_str().unwrap(), entry["linear"].as_bool().unwrap());
            assert_eq!(linear, name.ends_with(".exr") || entry["encoding"] == "linear", "{entry}");
        }
    }
    let manifest: Value = from_slice(&write(&layered(), json!({})).unwrap()["images.json"]).unwrap();
    let entry = manifest["files"].as_array().unwrap().iter().find(|e| e["file"] == "layer_2_frame_01.png").unwrap();
    let expected = json!({
        "file": "layer_2_frame_01.png", "content": "layer", "layer": 2, "frame": 1, "d_mm": 4.0, "format": "png",
        "bits": 8, "encoding": {"gamma": 2.2}, "linear": false, "width": 4, "height": 3, "time": 0, "time_seconds": 0.0,
    });
    assert_eq!(entry, &expected);
}

#[test]
fn writing_nothing_at_all_is_refused() {
    let error = write(&layered(), json!({"png8": false})).unwrap_err();
    assert!(matches!(&error, PluginError::Refused(text) if text.contains("`png8`")), "{error:?}");
}
