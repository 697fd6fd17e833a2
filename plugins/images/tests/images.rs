//! Writes files through the plugin's C functions, reads them back, and compares them with the
//! input.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use lumistack_plugin::core::{Cancel, Collector, Task};
use lumistack_plugin::display::{
    Channels, FieldGeometry, LightField, Projection, SeenDepth, Transfer, ViewGrid, forward,
};
use lumistack_plugin::encoding::{decode, encode};
use lumistack_plugin::field_io::picture::Picture;
use lumistack_plugin::field_io::{GeometryDefaults, GeometryFlags};
use lumistack_plugin::serde_json::{Value, from_slice, json};
use lumistack_plugin::{PluginError, Time};
use lumistack_plugin_images::PLUGIN;
use lumistack_plugin_testkit::serve::{Output, OutputData, Plugin};
use lumistack_plugin_testkit::{MemoryHost, Sample, conformance, samples};

/// Tolerance in codes: half a code for rounding, and 0.02 of a 16-bit code for f32 arithmetic.
const HALF_CODE: f32 = 0.5 + 0.02;
/// Relative tolerance for the rounding to half floats, which have 11 significant bits.
const HALF_FLOAT: f32 = 1.0 / 2048.0;
/// Distance of neighbouring half floats near 0, the absolute tolerance there.
const HALF_FLOAT_STEP: f32 = 1.0 / (1 << 24) as f32;

type Files = BTreeMap<String, Vec<u8>>;

fn write(sample: &Sample, params: Value) -> Result<Files, PluginError> {
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN)?);
    let output = Output::open(&plugin, &host, &params, &sample.display)?;
    output.submit(Time::default(), sample.data())?;
    output.finish()?;
    Ok(host.files())
}

/// Reads a PNG, and returns [rows, cols], the code values and the bits per channel.
fn png(files: &Files, name: &str) -> ([usize; 2], Vec<u16>, u32) {
    let decoded = image::load_from_memory(files.get(name).unwrap_or_else(|| panic!("no {name}"))).unwrap();
    let size = [decoded.height() as usize, decoded.width() as usize];
    match decoded {
        image::DynamicImage::ImageRgb8(p) => (size, p.into_raw().into_iter().map(u16::from).collect(), 8),
        image::DynamicImage::ImageRgb16(p) => (size, p.into_raw(), 16),
        other => panic!("{name} has colour type {:?}", other.color()),
    }
}

/// Asserts that all codes of a PNG are within half a code of the exact codes of `values`.
fn assert_png(files: &Files, name: &str, size: [usize; 2], values: &[f32], transfer: &Transfer) {
    let (found_size, codes, bits) = png(files, name);
    assert_eq!(found_size, size, "{name}");
    assert_eq!(codes.len(), values.len(), "{name}");
    let top = ((1u32 << bits) - 1) as f32;
    for (i, (&code, &value)) in codes.iter().zip(values).enumerate() {
        let channel = i % 3;
        let exact = encode(transfer, channel, value) * top;
        assert!((f32::from(code) - exact).abs() <= HALF_CODE, "{name}[{i}]: code {code}, value {value} = {exact}");
        // The light of the found code must lie between the light of two codes, `exact` minus and
        // `exact` plus half a code.
        let around =
            [exact - HALF_CODE, exact + HALF_CODE].map(|code| decode(transfer, channel, (code / top).clamp(0.0, 1.0)));
        let shown = decode(transfer, channel, f32::from(code) / top);
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
                assert_png(&files, &name, [rows, cols], layer.block([m]), &panel.transfer);
            }
        }
    }
    let transfers: Vec<Transfer> = sample.display.layers.iter().map(|layer| layer.transfer.clone()).collect();
    assert_eq!(transfers, [Transfer::Srgb, Transfer::Linear, Transfer::gamma(2.2)], "the sample has all three kinds");
}

#[test]
fn codes_of_a_limited_panel_run_from_its_darkest_to_its_brightest_state() {
    let mut sample = layered();
    let layer = sample.stack().unwrap().layers[0].clone();
    (sample.display.layers[0].black_level, sample.display.layers[0].peak) = (0.1, 0.8);
    let files = write(&sample, json!({"exr": true, "exr_depth": "float"})).unwrap();
    let size = [layer.shape()[1], layer.shape()[2]];
    let driven: Vec<f32> = layer.block([0]).iter().map(|value| ((value - 0.08) / 0.72).clamp(0.0, 1.0)).collect();
    assert_png(&files, "layer_0_frame_00.png", size, &driven, &Transfer::Srgb);
    assert_eq!(exr(&files, "layer_0_frame_00.exr"), (size, layer.block([0]).to_vec()), "the EXR file has other values");
    let files = write(&sample, json!({"encode": "srgb"})).unwrap();
    assert_png(&files, "layer_0_frame_00.png", size, layer.block([0]), &Transfer::Srgb);
}

#[test]
fn the_job_can_choose_another_encoding() {
    let sample = layered();
    let layer = &sample.stack().unwrap().layers[2];
    let size = [layer.shape()[1], layer.shape()[2]];
    let files = write(&sample, json!({"encode": "srgb"})).unwrap();
    assert_png(&files, "layer_2_frame_01.png", size, layer.block([1]), &Transfer::Srgb);
    let files = write(&sample, json!({"encode": "linear"})).unwrap();
    assert_png(&files, "layer_2_frame_01_linear.png", size, layer.block([1]), &Transfer::Linear);
    assert!(!files.contains_key("layer_2_frame_01.png"), "the name of a picture with linear codes does not state it");
}

#[test]
fn exr_is_exact_to_its_precision() {
    let sample = layered();
    let stack = sample.stack().unwrap();
    let only_exr = |depth: &str| json!({"png8": false, "exr": true, "exr_depth": depth, "views": "none"});
    let (half, float) = (write(&sample, only_exr("half")).unwrap(), write(&sample, only_exr("float")).unwrap());
    assert_eq!(half.len(), 3 * 2 + 1, "expected six pictures and the manifest");
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
fn simulated_views_are_those_of_an_adapted_viewer() {
    let sample = layered();
    let (stack, geometry) = (sample.stack().unwrap(), sample.display.geometry().unwrap());
    let files = write(&sample, json!({"views": "all"})).unwrap();
    for view in geometry.grid.iter() {
        let slope = geometry.grid.slope_at(view, [0.0, 0.0]);
        let emitted = forward::view_from_slope(&sample.display, stack, slope).radiance;
        let seen: Vec<f32> = emitted.data().iter().map(|value| value / stack.brightness as f32).collect();
        let name = format!("simulated_{:02}_{:02}.png", view[0], view[1]);
        assert_png(&files, &name, [geometry.rows, geometry.cols], &seen, &Transfer::Srgb);
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
            assert!((code - encode(&Transfer::Srgb, channel, value) * 65535.0).abs() <= HALF_CODE);
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
        assert_png(&files, &format!("{name}.png"), size, field.view(view), &Transfer::Srgb);
        assert_eq!(exr(&files, &format!("{name}.exr")), (size, field.view(view).to_vec()));
    }
    assert_eq!(files.len(), 2 * 6 + 1);
}

#[test]
fn the_manifest_names_and_describes_every_file() {
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

#[test]
fn a_measured_panel_of_few_bits_shows_the_right_mean_light() {
    let mut sample = layered();
    let table = |exponent: f64| (0..=16).map(|i| [f64::from(i), 0.5 + f64::from(i).powf(exponent)]).collect();
    let transfer = Transfer::Table(Channels::Rgb([table(2.0), table(2.2), table(2.6)]));
    (sample.display.layers[0].transfer, sample.display.layers[0].black_level) = (transfer.clone(), 0.05);
    let layer = sample.stack().unwrap().layers[0].clone();
    let [frames, rows, cols, _] = layer.shape();
    for dither in ["none", "ordered", "blue_noise", "diffusion"] {
        let files = write(&sample, json!({"bits": 3, "dither": dither, "png16": true, "atlas": true})).unwrap();
        for frame in 0..frames {
            let [eight, sixteen] = ["", "_16bit"].map(|end| png(&files, &format!("layer_0_frame_{frame:02}{end}.png")));
            assert!(eight.1.iter().all(|code| (0..8).any(|k| u32::from(*code) == (k * 255 + 3) / 7)), "3 bits");
            assert!(sixteen.1.iter().zip(&eight.1).all(|(a, b)| a >> 13 == b >> 5), "the samples' highest bits differ");
            for (i, (&code, &value)) in eight.1.iter().zip(layer.block([frame])).enumerate() {
                let top = decode(&transfer, i % 3, f32::from((code >> 5) + 1) / 7.0);
                let low = decode(&transfer, i % 3, (f32::from(code >> 5) - 1.0).max(0.0) / 7.0);
                let drive = ((value - 0.05) / 0.95).clamp(0.0, 1.0);
                let near = dither == "diffusion" || (low..=top).contains(&drive);
                assert!(near, "{dither}: the value {drive} has the code {}", code >> 5);
            }
        }
        let manifest: Value = from_slice(&files["images.json"]).unwrap();
        for name in ["layer_0_frame_01.png", "atlas.png"] {
            let entry = manifest["files"].as_array().unwrap().iter().find(|entry| entry["file"] == name).unwrap();
            assert_eq!(entry["panel_bits"], 3, "{name}");
            assert_eq!(entry["dither"], if dither == "none" { Value::Null } else { json!(dither) }, "{name}");
        }
        assert_eq!((rows, cols), (6, 8));
    }
    // Without the parameter `bits`, the panel has the two bits of the display file, so all codes
    // are multiples of 85.
    (sample.display.layers[0].transfer, sample.display.layers[0].bits) = (Transfer::gamma(2.2), Some(2));
    let files = write(&sample, json!({})).unwrap();
    assert!(png(&files, "layer_0_frame_00.png").1.iter().all(|code| code % 85 == 0));
}

#[test]
fn the_panel_behind_the_lenses_agrees_with_the_optics() {
    let sample = directional();
    let emission = sample.stack().unwrap().emission.as_ref().unwrap();
    let params = json!({
        "lenslet_panel": true, "panel_columns": 90, "panel_rows": 61, "panel_pitch_mm": 0.1, "lens_rotation_deg": 2.0,
        "lens_offset_x_mm": 0.3, "lens_samples": 1, "exr": true, "exr_depth": "float", "lens_focal_mm": 3.0,
    });
    let files = write(&sample, params).unwrap();
    let (size, values) = exr(&files, "panel_frame_00.exr");
    assert_eq!(size, [61, 90]);
    assert_png(&files, "panel_frame_00.png", size, &values, &Transfer::Srgb);
    // The oracle searches the lens in front of each pixel: there are 4 × 3 lenses of 2 mm, with 3 ×
    // 2 bins over 40°.
    let (angle, half) = (2f64.to_radians(), 20f64.to_radians().tan());
    for (row, col) in (0..61).flat_map(|row| (0..90).map(move |col| (row, col))) {
        let point = [(col as f64 - 44.5) * 0.1, (30.0 - row as f64) * 0.1];
        let mut expected = [0.0; 3];
        for (j, i) in (0..3).flat_map(|j| (0..4).map(move |i| (j, i))) {
            let [x, y] = [(f64::from(i) - 1.5) * 2.0, (1.0 - f64::from(j)) * 2.0];
            let centre = [0.3 + x * angle.cos() - y * angle.sin(), x * angle.sin() + y * angle.cos()];
            let u = [point[0] - centre[0], point[1] - centre[1]];
            let own = [u[0] * angle.cos() + u[1] * angle.sin(), u[1] * angle.cos() - u[0] * angle.sin()];
            let bin = [-u[0] / 3.0, u[1] / 3.0].map(|slope| slope / half);
            if own.iter().all(|u| u.abs() < 1.0) && bin.iter().all(|b| b.abs() < 1.0) {
                let bin = [((bin[1] + 1.0) * 1.0) as usize, ((bin[0] + 1.0) * 1.5) as usize];
                expected = [0, 1, 2].map(|rgb| emission.get([0, bin[0], bin[1], j as usize, i as usize, rgb]));
            }
        }
        assert_eq!(values[3 * (row * 90 + col)..][..3], expected, "row {row}, column {col}");
    }
    let uniform = write(&layered(), json!({"lenslet_panel": true})).unwrap_err();
    assert!(matches!(&uniform, PluginError::Refused(text) if text.contains("`lenslet_panel`")), "{uniform:?}");
}

/// Reads files with NumPy, Pillow and OpenEXR's own bindings, and returns the values as JSON.
/// `None` if these packages are not installed.
fn read_by_others(files: &Files) -> Option<Value> {
    let python = lumistack_testkit::skip::python_with("numpy, PIL, OpenEXR")?;
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read.py");
    let output = Command::new(python).arg(script).arg(folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(from_slice(&output.stdout).unwrap())
}

fn floats(value: &Value) -> Vec<f32> {
    match value {
        Value::Array(values) => values.iter().flat_map(floats).collect(),
        number => vec![number.as_f64().unwrap() as f32],
    }
}

#[test]
fn others_read_arrays_atlas_animation_and_multi_view_pictures() {
    let (sample, params) = (
        layered(),
        json!({
            "npz": true, "atlas": true, "animation": "ellipse", "animation_pictures": 12, "animation_rate": 25, "exr_multi_view": true,
            "exr_depth": "float", "views": "none",
        }),
    );
    let (stack, geometry) = (sample.stack().unwrap(), sample.display.geometry().unwrap());
    let files = write(&sample, params).unwrap();
    let Some(read) = read_by_others(&files) else { return };
    for (l, layer) in stack.layers.iter().enumerate() {
        let array = &read["stack.npz"][format!("layer_{l}")];
        assert_eq!(array["shape"], json!(layer.shape()));
        assert_eq!(floats(&array["values"]), layer.data());
    }
    assert_eq!(floats(&read["stack.npz"]["d_mm"]["values"]), [-4.0, 0.0, 4.0]);
    // Check the atlas: the layers of 8 × 6, 10 × 7 and 4 × 3 pixels are side by side, and the
    // frames are one below another.
    let sheet = &read["atlas.png"];
    assert_eq!((&sheet["size"], &sheet["mode"]), (&json!([22, 14]), &json!("RGB")));
    let pixels = floats(&sheet["pixels"]);
    let atlas: Value = from_slice(&files["atlas.json"]).unwrap();
    let tiles = atlas["tiles"].as_array().unwrap();
    assert_eq!(tiles.len(), 6);
    for tile in tiles {
        let key = |name: &str| tile[name].as_u64().unwrap() as usize;
        let name = format!("layer_{}_frame_{:02}.png", key("layer"), key("frame"));
        let (size, codes, _) = png(&files, &name);
        assert_eq!(size, [key("height"), key("width")]);
        for (i, code) in codes.iter().enumerate() {
            let (row, col) = (key("y") + i / 3 / size[1], key("x") + i / 3 % size[1]);
            assert_eq!(pixels[3 * (row * 22 + col) + i % 3], f32::from(*code), "{name}");
        }
    }
    // Check the animation of twelve pictures: the first picture is seen from the top centre, the
    // fourth from the right.
    let swing = &read["swing.png"];
    assert_eq!((&swing["size"], &swing["frames"], &swing["loop"]), (&json!([8, 6]), &json!(12), &json!(0)));
    assert!((swing["duration_ms"].as_f64().unwrap() - 40.0).abs() < 1e-9);
    for (picture, view) in [(0, [0, 1]), (3, [1, 2]), (6, [2, 1]), (9, [1, 0])] {
        let slope = geometry.grid.slope_at(view, [0.0, 0.0]);
        let emitted = forward::view_from_slope(&sample.display, stack, slope).radiance;
        let shown = floats(&swing["pixels"][picture]);
        for (i, (code, value)) in shown.iter().zip(emitted.data()).enumerate() {
            let exact = encode(&Transfer::Srgb, i % 3, value / stack.brightness as f32) * 255.0;
            assert!((code - exact).abs() <= HALF_CODE, "picture {picture}: {code} for {exact}");
        }
    }
    // Check the multi-view file, whose first view must be the central one.
    let views = &read["views.exr"];
    let names: Vec<&str> = views["multiView"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    assert_eq!(names[..3], ["view_01_01", "view_00_00", "view_00_01"]);
    assert_eq!(names.len(), 9);
    for name in names {
        let view = [&name[5..7], &name[8..10]].map(|digits| digits.parse::<usize>().unwrap());
        let slope = geometry.grid.slope_at(view, [0.0, 0.0]);
        let emitted = forward::view_from_slope(&sample.display, stack, slope).radiance;
        let expected: Vec<f32> = emitted.data().iter().map(|value| value * (1.0 / stack.brightness as f32)).collect();
        assert_eq!(floats(&views["views"][name]), expected, "{name}");
    }
}

#[test]
fn folders_are_read_back_as_the_light_field_they_were() {
    let sample = light_field();
    let field = sample.field().unwrap();
    let files = write(&sample, json!({"stanford": true, "png8": false, "png16": true, "npz": true})).unwrap();
    let refused = write(&sample, json!({"hci": true})).unwrap_err();
    assert!(matches!(&refused, PluginError::Refused(text) if text.contains("equal steps")), "{refused:?}");
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files.iter().filter(|(name, _)| name.starts_with("stanford/")) {
        std::fs::write(folder.path().join(name.trim_start_matches("stanford/")), bytes).unwrap();
    }
    assert!(files.contains_key("stanford/out_00_02_-25.000000_75.000000.png"), "{:?}", files.keys());
    let grid = &field.geometry().grid;
    let flags = GeometryFlags { pitch_mm: Some(0.5), focus_px: Some(0.0), ..GeometryFlags::default() };
    let back = open(folder.path(), &flags);
    same_within_codes(&back, field);
    let fov = [field.geometry().grid.slope_x.len(), field.geometry().grid.slope_y.len()];
    assert_eq!(fov, [3, 2]);
    // The folder states only the cameras' centres, so slopes must agree up to a common factor.
    let ratio = |slopes: &[f64]| (slopes[1] - slopes[0]) / (slopes[2] - slopes[0]);
    assert!((ratio(&back.geometry().grid.slope_x) - ratio(&grid.slope_x)).abs() < 1e-6);
    if let Some(read) = read_by_others(&files) {
        assert_eq!(floats(&read["views.npz"]["radiance"]["values"]), field.radiance().data());
        let slopes: Vec<f32> = grid.slope_y.iter().map(|slope| *slope as f32).collect();
        assert_eq!(floats(&read["views.npz"]["slope_y"]["values"]), slopes);
    }
}

#[test]
fn an_hci_folder_keeps_its_geometry() {
    let geometry = FieldGeometry {
        rows: 5,
        cols: 9,
        pitch_mm: 0.5,
        grid: ViewGrid {
            projection: Projection::Perspective { distance_mm: 600.0 },
            slope_x: vec![-0.1, 0.0, 0.1],
            slope_y: vec![0.05, -0.05],
        },
    };
    let mut field = LightField::black(geometry).unwrap();
    let mut random = lumistack_plugin::core::seed::Stream::new(4);
    field.radiance_mut().data_mut().fill_with(|| random.next_f32());
    let display = layered().display;
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN).unwrap());
    let params = json!({"hci": true, "png8": false, "png16": true});
    let output = Output::open(&plugin, &host, &params, &display).unwrap();
    output.submit(Time::default(), OutputData::LightField(&field)).unwrap();
    output.finish().unwrap();
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in host.files().iter().filter(|(name, _)| name.starts_with("hci/")) {
        std::fs::write(folder.path().join(name.trim_start_matches("hci/")), bytes).unwrap();
    }
    let flags = GeometryFlags { pitch_mm: Some(0.5), ..GeometryFlags::default() };
    let back = open(folder.path(), &flags);
    same_within_codes(&back, &field);
    let (found, expected) = (back.geometry(), field.geometry());
    let pairs = found.grid.slope_x.iter().chain(&found.grid.slope_y);
    let given = expected.grid.slope_x.iter().chain(&expected.grid.slope_y);
    assert!(pairs.zip(given).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
    let Projection::Perspective { distance_mm } = found.grid.projection else { panic!("{found:?}") };
    assert!((distance_mm - 600.0).abs() < 1e-9);
}

/// Returns a depth map with half as many columns as the views have. It has a slanted plane on the
/// left half, and no hit on the right half.
fn slanted(geometry: &FieldGeometry) -> SeenDepth {
    let (rows, cols) = (geometry.rows, geometry.cols.div_ceil(2));
    let z = |i: usize| (i % cols < cols / 2).then(|| -40.0 + 10.0 * (i % cols) as f32 + 5.0 * (i / cols) as f32);
    SeenDepth { rows, cols, z_mm: (0..rows * cols).map(z).collect() }
}

/// Reads a folder in the HCI format with `hci.py`, which shares no code with this project. `None`
/// without Python.
fn read_as_the_benchmark(files: &Files) -> Option<Value> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files.iter().filter(|(name, _)| name.starts_with("hci/")) {
        std::fs::write(folder.path().join(name.trim_start_matches("hci/")), bytes).unwrap();
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hci.py");
    let candidates = [std::env::var("LUMISTACK_PYTHON").ok(), Some("python3".to_string())];
    for python in candidates.into_iter().flatten() {
        let Ok(output) = Command::new(python).arg(&script).arg(folder.path()).output() else { continue };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        return Some(from_slice(&output.stdout).unwrap());
    }
    println!("skipped: no Python");
    None
}

#[test]
fn the_benchmark_s_reader_finds_all_that_it_demands() {
    let perspective = Projection::Perspective { distance_mm: 600.0 };
    for (projection, distance_mm) in [(perspective, 600.0), (Projection::Oblique, 1000.0)] {
        let grid = ViewGrid { projection, slope_x: vec![-0.1, 0.0, 0.1], slope_y: vec![0.1, 0.0, -0.1] };
        let geometry = FieldGeometry { rows: 5, cols: 8, pitch_mm: 0.5, grid };
        for depth in [Some(slanted(&geometry)), None] {
            let field = LightField::black(geometry.clone()).unwrap().with_depth(depth.clone());
            let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN).unwrap());
            let params = json!({"hci": true, "hci_authors": "A. Lovelace, C. Babbage", "hci_contact": "a@example.org"});
            let display = layered().display;
            let output = Output::open(&plugin, &host, &params, &display).unwrap();
            output.submit(Time::default(), OutputData::LightField(&field)).unwrap();
            output.finish().unwrap();
            let Some(read) = read_as_the_benchmark(&host.files()) else { return };
            let parameters = &read["parameters"];
            assert_eq!(parameters["authors"], json!(["A. Lovelace", "C. Babbage"]));
            assert_eq!((&parameters["contact"], &parameters["date"]), (&json!("a@example.org"), &json!("unknown")));
            assert_eq!((&parameters["width"], &parameters["height"]), (&json!(8), &json!(5)));
            assert_eq!(parameters["depth_map_scale"], json!(1.0));
            // The benchmark defines the offset as b f / D in pixels, for cameras b apart at
            // distance D with focal length f.
            let number = |key: &str| parameters[key].as_f64().unwrap_or_else(|| panic!("{key}: {parameters}"));
            let focal_px = number("focal_length_mm") / number("sensor_size_mm") * 8.0;
            let offset = number("baseline_mm") * focal_px / (1000.0 * number("focus_distance_m"));
            assert!((offset - 0.1 * distance_mm / 0.5).abs() < 1e-6, "{offset}");
            assert!((number("offset") - offset).abs() < 1e-6);
            let disparities: Vec<Option<f64>> = read["disparities"]
                .as_array()
                .unwrap()
                .iter()
                .flat_map(|row| row.as_array().unwrap().iter().map(Value::as_f64))
                .collect();
            assert_eq!(disparities.len(), 40);
            let [least, largest] = ["disp_min", "disp_max"].map(number);
            assert!(least <= largest && number("frustum_disp_min") <= number("frustum_disp_max"));
            let note = read["notes"].to_string();
            let Some(depth) = &depth else {
                assert!(disparities.iter().all(Option::is_none), "the depth is unknown, but there are disparities");
                assert!(note.contains("is not known"), "{note}");
                continue;
            };
            assert!(!note.contains("is not known"), "{note}");
            for (i, found) in disparities.iter().enumerate() {
                // The disparity is f b (1/Z − 1/D), where Z is the content's distance from the
                // cameras. For parallel views it is the limit of this expression for large D.
                let z = depth.z_mm[i / 8 * 4 + i % 8 / 2].map(f64::from);
                let expected = match (projection, z) {
                    (Projection::Oblique, Some(z)) => Some(0.1 * z / 0.5),
                    (Projection::Oblique, None) => None,
                    (Projection::Perspective { .. }, z) => {
                        let inverse = z.map_or(0.0, |z| 1.0 / (600.0 - z));
                        Some(number("baseline_mm") * focal_px * (inverse - 1.0 / 600.0))
                    }
                };
                assert_eq!(found.is_some(), expected.is_some(), "pixel {i}");
                if let (Some(found), Some(expected)) = (found, expected) {
                    assert!((found - expected).abs() < 1e-4 * (1.0 + expected.abs()), "pixel {i}: {found}, {expected}");
                    assert!(*found >= least - 1e-4 && *found <= largest + 1e-4);
                }
            }
        }
    }
}

/// Returns the names of the chunks of a PNG before its pixels.
fn png_chunks(bytes: &[u8]) -> Vec<String> {
    let (mut at, mut names) = (8, Vec::new());
    loop {
        let length = u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let name = String::from_utf8(bytes[at + 4..at + 8].to_vec()).unwrap();
        if name == "IDAT" {
            return names;
        }
        names.push(name);
        at += 12 + length;
    }
}

#[test]
fn pngs_say_how_their_codes_stand_for_light() {
    let sample = layered();
    let has = |files: &Files, name: &str, chunk: &str| png_chunks(&files[name]).iter().any(|found| found == chunk);
    let files = write(&sample, json!({"png16": true, "sheet": true, "animation": "side"})).unwrap();
    // The sample's three layers have the transfer functions sRGB, linear and gamma 2.2. Only sRGB
    // has its own chunk.
    for suffix in [".png", "_16bit.png"] {
        for (layer, srgb) in [(0, true), (1, false), (2, false)] {
            let name = format!("layer_{layer}_frame_00{suffix}");
            assert!(has(&files, &name, "sRGB") == srgb && (srgb || has(&files, &name, "gAMA")), "{name}");
        }
    }
    let views: Vec<&String> =
        files.keys().filter(|name| name.starts_with("simulated_") && name.ends_with(".png")).collect();
    assert_eq!(views.len(), 2 * 5, "8 and 16 bits, the central view and four corners");
    for name in views {
        assert!(has(&files, name, "sRGB"), "{name}");
    }
    assert!(has(&files, "sheet.png", "sRGB") && has(&files, "swing.png", "sRGB"));
    let files = write(&sample, json!({"encode": "linear", "atlas": true})).unwrap();
    assert!(has(&files, "layer_0_frame_00_linear.png", "gAMA") && has(&files, "atlas.png", "gAMA"));
    // The layers of an atlas keep their own transfer functions, which the index states. The entry
    // states a function only if all layers share it.
    let entry = |files: &Files| {
        let manifest: Value = from_slice(&files["images.json"]).unwrap();
        let entries = manifest["files"].as_array().unwrap();
        entries.iter().find(|entry| entry["file"] == "atlas.png").unwrap().clone()
    };
    assert!(entry(&files)["encoding"] == "linear" && entry(&files)["linear"] == true);
    let files = write(&sample, json!({"atlas": true})).unwrap();
    let index: Value = from_slice(&files["atlas.json"]).unwrap();
    let encodings: Vec<&Value> = (0..3).map(|layer| &index["tiles"][layer]["encoding"]).collect();
    assert!(entry(&files)["encoding"].is_null() && entry(&files)["linear"] == false, "{}", entry(&files));
    assert!(encodings[0] == "srgb" && encodings[1] == "linear", "{encodings:?}");
    assert!(encodings[2].to_string().contains("2.2"), "{encodings:?}");
    // The entry of an atlas also states the bits of the panels only if all panels share them.
    let mut sample = sample;
    sample.display.layers.iter_mut().for_each(|layer| (layer.transfer, layer.bits) = (Transfer::Linear, Some(6)));
    let atlas = entry(&write(&sample, json!({"atlas": true})).unwrap());
    assert!(atlas["encoding"] == "linear" && atlas["linear"] == true && atlas["panel_bits"] == 6, "{atlas}");
    sample.display.layers[1].bits = None;
    let atlas = entry(&write(&sample, json!({"atlas": true})).unwrap());
    assert!(atlas["panel_bits"].is_null(), "{atlas}");
    let files = write(&light_field(), json!({"stanford": true})).unwrap();
    let stanford = files.keys().find(|name| name.starts_with("stanford/") && name.ends_with(".png")).unwrap();
    assert!(has(&files, stanford, "sRGB"));
}

/// Opens a light field with the program's own reader, without defaults for its geometry.
fn open(path: &Path, flags: &GeometryFlags) -> LightField {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let defaults = GeometryDefaults { width_mm: None, fov_deg: None };
    let flags = GeometryFlags { fov_deg: stanford_fov(path), ..flags.clone() };
    lumistack_plugin::field_io::open(path, &flags, &defaults, Task::quiet(&warnings, &cancel)).unwrap()
}

/// Returns the field of view that a reader of the folder needs from the user. A Stanford folder
/// states no angles, but an HCI folder does.
fn stanford_fov(path: &Path) -> Option<[f64; 2]> {
    (!path.join("parameters.cfg").exists()).then_some([20.0, 10.0])
}

fn same_within_codes(found: &LightField, expected: &LightField) {
    assert_eq!(found.radiance().shape(), expected.radiance().shape());
    for (i, (a, b)) in found.radiance().data().iter().zip(expected.radiance().data()).enumerate() {
        let [a, b] = [a, b].map(|value| encode(&Transfer::Srgb, 0, *value) * 65535.0);
        assert!((a - b).abs() <= HALF_CODE + 0.02, "{i}: {a} for {b}");
    }
}
