//! Writes quilts and native pictures through the plugin's C functions. Reads them back with this
//! project's reader and with other readers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use lumistack_plugin::core::{Cancel, Collector, Task};
use lumistack_plugin::display::{Display, FieldGeometry, LightField, Projection, Transfer, ViewGrid, forward};
use lumistack_plugin::encoding::{codes8, encode};
use lumistack_plugin::field_io::{GeometryDefaults, GeometryFlags, open};
use lumistack_plugin::serde_json::{Value, from_slice, json};
use lumistack_plugin::{PluginError, Time};
use lumistack_plugin_quilt::PLUGIN;
use lumistack_plugin_testkit::serve::{LogLevel, Output, OutputData, Plugin};
use lumistack_plugin_testkit::{MemoryHost, conformance_but_for, samples};

type Files = BTreeMap<String, Vec<u8>>;

/// Tolerance for the rounding to the nearest code: half a code, and the error of f32 arithmetic.
const HALF_CODE: f32 = 0.5 + 1e-3;

fn write(display: &Display, data: OutputData<'_>, params: Value) -> Result<(Files, Vec<String>), PluginError> {
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN)?);
    let output = Output::open(&plugin, &host, &params, display)?;
    output.submit(Time::default(), data)?;
    output.finish()?;
    let warnings = host.messages().into_iter().filter(|(level, _)| *level == LogLevel::Warn).map(|(_, text)| text);
    Ok((host.files(), warnings.collect()))
}

/// Returns a light field of random values. `views` is [columns, rows] of views.
fn random_field(views: [usize; 2], [cols, rows]: [usize; 2]) -> LightField {
    let grid = ViewGrid::uniform(Projection::Oblique, views, [30.0, 10.0]).unwrap();
    let mut field = LightField::black(FieldGeometry { rows, cols, pitch_mm: 0.5, grid }).unwrap();
    let mut random = lumistack_plugin::core::seed::Stream::new(11);
    field.radiance_mut().data_mut().fill_with(|| random.next_f32());
    field
}

fn display() -> Display {
    samples().swap_remove(0).display
}

fn python() -> Option<PathBuf> {
    lumistack_testkit::skip::python_with("numpy, PIL")
}

fn tests(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests").join(name)
}

fn succeed(command: &mut Command) -> Vec<u8> {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

#[test]
fn conforms() {
    // The quilts of devices have up to 67 megapixels. So this test writes none of them, and another
    // test writes one.
    conformance_but_for(&PLUGIN, &["device"]).unwrap();
}

#[test]
fn a_quilt_gives_back_every_view() {
    let field = random_field([6, 3], [10, 7]);
    let params = json!({"columns": 3, "rows": 2, "name": "test"});
    let (files, warnings) = write(&display(), OutputData::LightField(&field), params).unwrap();
    assert_eq!(files.keys().collect::<Vec<_>>(), ["quilt.json", "test_qs3x2a1.42857.png"]);
    assert!(warnings.is_empty(), "{warnings:?}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test_qs3x2a1.42857.png");
    std::fs::write(&path, &files["test_qs3x2a1.42857.png"]).unwrap();
    // Read the quilt with this project's reader. Flags state the geometry, since a quilt has no
    // angles.
    let flags = GeometryFlags { fov_deg: Some([30.0, 0.1]), pitch_mm: Some(0.5), ..GeometryFlags::default() };
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let back = open(&path, &flags, &GeometryDefaults::default(), task).unwrap();
    assert_eq!(back.radiance().shape(), [1, 6, 7, 10, 3]);
    for view in 0..6 {
        // The light field has three rows of views. The quilt must have the views of the central
        // row.
        let codes = codes8(&Transfer::Srgb, field.view([1, view]));
        assert_eq!(codes8(&Transfer::Srgb, back.view([0, view])), codes, "view {view}");
    }
    let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
    assert!(back.geometry().grid.slope_x.iter().zip(&field.geometry().grid.slope_x).all(near));
    // Read the quilt with Pillow.
    let Some(python) = python() else { return };
    let read: Value = from_slice(&succeed(Command::new(python).arg(tests("read.py")).arg(&path))).unwrap();
    assert_eq!((&read["mode"], &read["size"], &read["tile"]), (&json!("RGB"), &json!([30, 14]), &json!([10, 7])));
    assert!((read["aspect"].as_f64().unwrap() - 10.0 / 7.0).abs() < 1e-5);
    for view in 0..6 {
        let codes = codes8(&Transfer::Srgb, field.view([1, view]));
        assert_eq!(read["views"][view], json!(codes), "view {view}");
    }
}

#[test]
fn views_that_a_light_field_lacks_are_named() {
    let field = random_field([3, 2], [6, 4]);
    let data = OutputData::LightField(&field);
    let params = |missing: &str| json!({"columns": 2, "rows": 3, "missing_views": missing, "view_row": 1});
    let refused = write(&display(), data, params("refuse")).unwrap_err().to_string();
    assert!(refused.contains("expected 6 views per row, found 3") && refused.contains("views = [6, 1]"), "{refused}");
    let codes = |files: &Files| image::load_from_memory(&files["quilt_qs2x3a1.5.png"]).unwrap().into_rgb8();
    let tile = |picture: &image::RgbImage, view: u32| {
        let part = image::imageops::crop_imm(picture, view % 2 * 6, picture.height() - 4 * (view / 2 + 1), 6, 4);
        part.to_image().into_raw()
    };
    // The positions −0.25, 0.25, 0.75, ... are nearest to the views 0, 0, 1, 1, 2, 2 of the light
    // field.
    let (files, warnings) = write(&display(), data, params("nearest")).unwrap();
    assert!(warnings[0].contains("Every tile shows the nearest view"), "{warnings:?}");
    for view in 0..6 {
        let expected = codes8(&Transfer::Srgb, field.view([1, view as usize / 2]));
        assert_eq!(tile(&codes(&files), view), expected, "view {view}");
    }
    let manifest: Value = from_slice(&files["quilt.json"]).unwrap();
    let entry = &manifest["files"][0];
    assert_eq!(entry["views"][3], json!({"slope": [0.0, field.geometry().grid.slope_y[1]], "made": "nearest"}));
    let (files, warnings) = write(&display(), data, params("blend")).unwrap();
    assert!(warnings[0].contains("shows double edges"), "{warnings:?}");
    let (a, b) = (field.view([1, 0]), field.view([1, 1]));
    let mixed: Vec<f32> = a.iter().zip(b).map(|(a, b)| a + 0.25 * (b - a)).collect();
    assert_eq!(tile(&codes(&files), 1), codes8(&Transfer::Srgb, &mixed));
    assert_eq!(tile(&codes(&files), 0), codes8(&Transfer::Srgb, a), "position −0.25 has the outermost view");
    let no_row = write(&display(), data, json!({"view_row": 2})).unwrap_err().to_string();
    assert!(no_row.contains("`view_row`: expected a row of views from -1 to 1"), "{no_row}");
}

#[test]
fn a_layer_stack_is_seen_from_every_tile_s_place() {
    let sample = samples().swap_remove(0);
    let stack = sample.stack().unwrap();
    let (files, warnings) = write(&sample.display, sample.data(), json!({"columns": 4, "rows": 2})).unwrap();
    assert!(warnings.is_empty());
    let manifest: Value = from_slice(&files["quilt.json"]).unwrap();
    let entry = &manifest["files"][0];
    assert_eq!((&entry["width"], &entry["tile"], &entry["video"]), (&json!(32), &json!([8, 6]), &json!("h264")));
    let picture = image::load_from_memory(&files["quilt_qs4x2a1.33333.png"]).unwrap().into_rgb8();
    let half = 5f64.to_radians().tan();
    for view in 0..8u32 {
        // the views are at the centres of eight equal parts of the zone
        let slope = [half * ((f64::from(view) + 0.5) / 4.0 - 1.0), 0.0];
        let found: Vec<f64> =
            (0..2).map(|axis| entry["views"][view as usize]["slope"][axis].as_f64().unwrap()).collect();
        assert!((found[0] - slope[0]).abs() < 1e-12 && found[1].abs() < 1e-12, "{found:?} {slope:?}");
        let emitted = forward::view_from_slope(&sample.display, stack, [found[0], found[1]]).radiance;
        for (i, value) in emitted.data().iter().enumerate() {
            let (x, y) = (view % 4 * 8 + i as u32 / 3 % 8, (1 - view / 4) * 6 + i as u32 / 24);
            let exact = encode(&Transfer::Srgb, i % 3, value / stack.brightness as f32) * 255.0;
            assert!((f32::from(picture.get_pixel(x, y).0[i % 3]) - exact).abs() <= HALF_CODE);
        }
    }
}

#[test]
fn a_device_s_quilt_has_its_size_and_name() {
    let field = random_field([3, 1], [9, 12]);
    let (files, warnings) =
        write(&display(), OutputData::LightField(&field), json!({"device": "portrait", "sequence": true})).unwrap();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    let picture = image::load_from_memory(&files["quilt_f0000_qs8x6a0.75.png"]).unwrap();
    assert_eq!((picture.width(), picture.height(), picture.color()), (3360, 3360, image::ColorType::Rgb8));
}

/// Native pictures equal the pictures that NumPy computes, for subpixels in stripes and in cells.
/// The calibrations are published calibrations of real displays.
#[test]
fn native_pictures_equal_numpy_s() {
    let Some(python) = python() else { return };
    let field = random_field([12, 1], [64, 36]);
    for (name, columns, rows) in [("stripes.json", 4, 3), ("cells.json", 3, 4)] {
        let file = tests(name);
        let params = json!({"columns": columns, "rows": rows, "calibration": file.to_str().unwrap()});
        let (files, _) = write(&display(), OutputData::LightField(&field), params).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let [quilt, native] = ["_qs", "_native"].map(|part| {
            let (name, bytes) = files.iter().find(|(name, _)| name.contains(part)).unwrap();
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        });
        let text = succeed(Command::new(&python).arg(tests("weave.py")).arg(&file).args([quilt, native]));
        let text = String::from_utf8(text).unwrap();
        let figures: Vec<usize> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
        println!("{name}: {} of {} samples differ", figures[0], figures[1]);
        assert_eq!(figures[1..], [3840 * 2160 * 3, 3840, 2160]);
        // Both programs compute in f64. Rounding may assign a phase at the border between two views
        // to either view.
        assert!(figures[0] <= 2, "{figures:?}");
    }
    // The parameter may also be the text of the calibration, and the quilt need not be written.
    let text =
        std::fs::read_to_string(tests("cells.json")).unwrap().replace("3840.0", "40.0").replace("2160.0", "20.0");
    let params = json!({"calibration": text, "write_quilt": false});
    let (files, _) = write(&display(), OutputData::LightField(&field), params).unwrap();
    assert_eq!(files.keys().collect::<Vec<_>>(), ["quilt.json", "quilt_native.png"]);
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let field = random_field([2, 1], [4, 3]);
    for (params, message) in [
        (json!({"name": "a/b"}), "parameter `name`"),
        (json!({"name": ""}), "parameter `name`"),
        (json!({"columns": 3}), "parameters `columns` and `rows`: expected two numbers above 0"),
        (json!({"columns": 2, "rows": 1, "width": 1}), "parameters `width` and `height`: expected at least"),
        (json!({"calibration": "nowhere.json"}), "parameter `calibration`: cannot read nowhere.json"),
        (json!({"calibration": "{\"pitch\": 1}"}), "parameter `calibration`: slope: expected a number"),
        (json!({"write_quilt": false}), "parameter `write_quilt`: expected true, or a `calibration`"),
        (json!({"device": "phone"}), "parameter `device`: expected one of custom, portrait"),
    ] {
        let error = write(&display(), OutputData::LightField(&field), params.clone()).unwrap_err();
        assert!(matches!(&error, PluginError::Refused(text) if text.starts_with(message)), "{params}: {error:?}");
    }
}

#[test]
fn how_much_of_a_quilt_is_black_is_said() {
    let field = random_field([6, 1], [16, 10]);
    let warnings = |params: Value| write(&display(), OutputData::LightField(&field), params).unwrap().1;
    let portrait = json!({"columns": 6, "rows": 1, "aspect": 0.75});
    let said = warnings(portrait.clone());
    // A view of aspect 1.6 fills 0.75 / 1.6 = 47 % of a tile of aspect 0.75. The other 53 % are
    // black.
    assert!(said.iter().any(|text| text.starts_with("53 % of the quilt is black")), "{said:?}");
    assert!(said[0].contains("16 × 21") && said[0].contains("cover"), "{said:?}");
    let mut cover = portrait;
    cover["fit"] = json!("cover");
    assert!(warnings(cover).is_empty() && warnings(json!({"columns": 6, "rows": 1})).is_empty());
}
