//! Round trips of light-field folders, arrays and stacks, also of odd shapes.

use std::fs;
use std::process::Command;

use crate::common::{defaults, open, open_for, random_field};
use lumistack_core::Tensor;
use lumistack_display::{
    Backlight, Display, Layer, LayerStack, LensletBacklight, LightField, Projection, ProjectionKind,
};
use lumistack_field_io::{
    FieldError, GeometryFlags, describe, npy, read_field_folder, read_stack, read_stack_index, round_to_half,
    write_field, write_stack,
};
use proptest::prelude::*;
use serde_json::{Map, json};

/// Tolerance of an encoded and decoded 8-bit code value.
const CODE: f32 = 1e-6;

fn info() -> Map<String, serde_json::Value> {
    json!({ "exposure": 1.5, "scene": "a.glb" }).as_object().unwrap().clone()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_field_survives_its_folder(
        cols in 1usize..9, rows in 1usize..9, views_x in 1usize..4, views_y in 1usize..4, seed in 0u64..1000,
        perspective in any::<bool>(),
    ) {
        let projection = if perspective { Projection::Perspective { distance_mm: 612.5 } } else { Projection::Oblique };
        let field = random_field([views_x, views_y], [cols, rows], projection, seed);
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep/target");
        write_field(&target, &field, &info()).unwrap();
        let (back, back_info) = read_field_folder(&target).unwrap();
        prop_assert_eq!(&back, &field);
        prop_assert_eq!(back_info, info());
        // the folder of a run, the folder of a light field and its index all open the same light
        // field
        for path in [target.clone(), folder.path().join("deep"), target.join("lightfield.json")] {
            let (opened, warnings) = open(&path, &GeometryFlags::default(), &defaults());
            prop_assert_eq!(opened.unwrap(), field.clone());
            prop_assert!(warnings.is_empty());
        }
    }

    #[test]
    fn any_field_survives_an_array(
        cols in 1usize..9, rows in 1usize..9, views_x in 1usize..4, views_y in 1usize..4, seed in 0u64..1000,
    ) {
        let field = random_field([views_x, views_y], [cols, rows], Projection::Oblique, seed);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        npy::write(&path, &field.radiance().shape(), field.radiance().data()).unwrap();
        let flags = GeometryFlags {
            grid: Some(ProjectionKind::Oblique), fov_deg: Some([23.0, 17.0]), pitch_mm: Some(0.731),
            ..GeometryFlags::default()
        };
        let (opened, warnings) = open(&path, &flags, &Default::default());
        prop_assert_eq!(opened.unwrap(), field);
        prop_assert!(warnings.is_empty());
    }
}

#[test]
fn files_contain_values_rounded_to_half() {
    let mut field = random_field([2, 1], [5, 3], Projection::Oblique, 3);
    field.radiance_mut().data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = 0.7 + *v * 1e-3 + i as f32 * 1e-7);
    field.radiance_mut().data_mut()[0] = 1e9;
    let folder = tempfile::tempdir().unwrap();
    let before = field.clone();
    round_to_half(field.radiance_mut().data_mut());
    assert_ne!(field, before);
    assert_eq!(field.radiance().data()[0], 65504.0);
    write_field(folder.path(), &field, &Map::new()).unwrap();
    assert_eq!(read_field_folder(folder.path()).unwrap().0, field);
}

#[test]
fn the_same_field_gives_the_same_bytes() {
    let field = random_field([3, 2], [17, 40], Projection::Oblique, 9);
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    for folder in &folders {
        write_field(folder.path(), &field, &info()).unwrap();
    }
    let mut names: Vec<_> = fs::read_dir(folders[0].path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names.len(), 7, "six views, one index, nothing else: {names:?}");
    for name in names {
        let [a, b] = folders.each_ref().map(|folder| fs::read(folder.path().join(&name)).unwrap());
        assert!(a == b, "{name:?}");
    }
}

#[test]
fn a_field_that_cannot_be_written_leaves_no_index() {
    let mut field = random_field([2, 1], [4, 3], Projection::Oblique, 1);
    let folder = tempfile::tempdir().unwrap();
    write_field(folder.path(), &field, &Map::new()).unwrap();
    *field.radiance_mut().at_mut([0, 1, 2, 3, 1]) = f32::NAN;
    let error = write_field(folder.path(), &field, &Map::new()).unwrap_err().to_string();
    assert!(
        error.contains("view_00_01.exr: [row, col, rgb] = [2, 3, 1]: expected a finite number")
            && error.ends_with("NaN"),
        "{error}"
    );
    // a number that is infinite as a half float could not be read again
    *field.radiance_mut().at_mut([0, 1, 2, 3, 1]) = 70000.0;
    let error = write_field(folder.path(), &field, &Map::new()).unwrap_err().to_string();
    assert!(error.contains("at most 65504") && error.ends_with("found 70000"), "{error}");
    assert!(matches!(read_field_folder(folder.path()), Err(FieldError::Io { .. })));
    let file = folder.path().join("view_00_00.exr");
    let error = write_field(&file, &field, &Map::new()).unwrap_err().to_string();
    assert!(error.contains("view_00_00.exr: output folder: expected a folder or nothing, found a file"), "{error}");
}

/// A plane at z with a grating of frequency ω is in 45 views, whose slopes are Δs apart. Nine views
/// are kept. A footprint δs = nΔs averages n views into each kept view. This leaves sin(πωznΔs)/(n
/// sin(πωzΔs)) of the contrast, about sinc(ω z δs). Without a prefilter the contrast does not
/// change.
#[test]
fn a_prefilter_removes_detail_above_the_bound() {
    let grid = lumistack_display::ViewGrid::uniform(Projection::Oblique, [45, 2], [20.0, 2.0]).unwrap();
    let step = grid.bin_width()[0];
    // a pixel is at x = 0, and half a period has a whole number of pixels, so samples hit the
    // extremes
    for (z_mm, frequency, n) in [(40.0, 0.8, 5), (-60.0, 0.4, 5), (25.0, 0.5, 9), (0.0, 0.8, 9)] {
        let geometry = lumistack_display::FieldGeometry { rows: 1, cols: 101, pitch_mm: 0.125, grid: grid.clone() };
        let mut field = LightField::black(geometry.clone()).unwrap();
        for view in geometry.grid.iter() {
            for (i, value) in field.view_mut(view).iter_mut().enumerate() {
                let x = geometry.x_mm(i / 3) + z_mm * geometry.grid.slope_x[view[1]];
                *value = (0.5 + 0.5 * (std::f64::consts::TAU * frequency * x).cos()) as f32;
            }
        }
        let folder = tempfile::tempdir().unwrap();
        write_field(folder.path(), &field, &Map::new()).unwrap();
        let flags = GeometryFlags { views: Some([9, 2]), prefilter: true, ..GeometryFlags::default() };
        let (filtered, warnings) = open_for(folder.path(), &flags, [n as f64 * step, 0.0]);
        let filtered = filtered.unwrap();
        assert_eq!((filtered.geometry().grid.slope_x.len(), warnings.len()), (9, 0), "{warnings:?}");
        let contrast = |values: &[f32]| {
            let (low, high) = values.iter().fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
            f64::from(high - low)
        };
        let phase = std::f64::consts::PI * frequency * f64::abs(z_mm) * step;
        let expected = if z_mm == 0.0 { 1.0 } else { (f64::from(n) * phase).sin() / (f64::from(n) * phase.sin()) };
        let found = contrast(filtered.view([0, 4]));
        assert!((found - expected.abs()).abs() < 0.01, "{z_mm} mm, {frequency}, {n} views: {found}, not {expected}");
        let (chosen, _) = open(folder.path(), &GeometryFlags { prefilter: false, ..flags }, &defaults());
        assert!((contrast(chosen.unwrap().view([0, 4])) - 1.0).abs() < 0.01);
    }
}

#[test]
fn a_prefilter_is_a_mean_and_says_where_it_does_nothing() {
    let field = random_field([5, 3], [8, 6], Projection::Oblique, 2);
    let folder = tempfile::tempdir().unwrap();
    write_field(folder.path(), &field, &Map::new()).unwrap();
    let [bin_x, bin_y] = field.geometry().grid.bin_width();
    let flags = GeometryFlags { views: Some([1, 3]), prefilter: true, ..GeometryFlags::default() };
    // With one kept view per view row there is no step along x, so views are averaged only along y.
    // The central view has the weight 1/2, and the views above and below it have 1/4 each.
    let (filtered, _) = open_for(folder.path(), &flags, [3.0 * bin_x, 2.0 * bin_y]);
    let filtered = filtered.unwrap();
    for (i, found) in filtered.view([1, 0]).iter().enumerate() {
        let of = |row: usize| field.view([row, 2])[i];
        assert!((found - (0.25 * of(0) + 0.5 * of(1) + 0.25 * of(2))).abs() < 1e-6);
    }
    let (same, warnings) = open_for(folder.path(), &flags, [bin_x, bin_y]);
    assert!(same.unwrap().view([1, 0]) == field.view([1, 2]), "views as far apart as the footprint stay");
    assert!(warnings.iter().any(|text| text.contains("the prefilter changes nothing")), "{warnings:?}");
    let error = open(folder.path(), &flags, &defaults()).0.unwrap_err().to_string();
    assert!(error.contains("--prefilter: expected a display"), "{error}");
    // the middle view row is a part of all three means, but its values are reported once
    let mut negative = field;
    negative.view_mut([1, 2])[0] = -0.25;
    write_field(folder.path(), &negative, &Map::new()).unwrap();
    let (_, warnings) = open_for(folder.path(), &flags, [3.0 * bin_x, 2.0 * bin_y]);
    assert!(warnings.iter().any(|text| text.contains("number of these values: 1;")), "{warnings:?}");
}

/// The views between the kept views have the same slopes as in the whole light field. Each occurs
/// once, and no kept view is among them.
#[test]
fn views_between_those_that_are_kept_are_given_when_wanted() {
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 600.0 }] {
        let field = random_field([7, 5], [8, 6], projection, 2);
        let folder = tempfile::tempdir().unwrap();
        write_field(folder.path(), &field, &Map::new()).unwrap();
        let flags = GeometryFlags { views: Some([3, 2]), ..GeometryFlags::default() };
        let (warnings, cancel) = (lumistack_core::Collector::default(), lumistack_core::Cancel::default());
        let open = |most| {
            let task = lumistack_core::Task::quiet(&warnings, &cancel);
            let reading = lumistack_field_io::Reading { most_left_out: most, ..Default::default() };
            lumistack_field_io::open_for(folder.path(), &flags, &defaults(), reading, task).unwrap()
        };
        let (kept, others) = open(100);
        // columns 0, 3, 6 and rows 0, 4 of 7 × 5 are kept
        assert_eq!((kept.geometry().grid.views(), others.len()), ([2, 3], 35 - 6));
        let grid = &field.geometry().grid;
        for other in &others {
            let place = |slopes: &[f64], slope: f64| slopes.iter().position(|s| (s - slope).abs() < 1e-9).unwrap();
            let (col, row) = (place(&grid.slope_x, other.grid.slope_x[0]), place(&grid.slope_y, other.grid.slope_y[0]));
            assert!(other.radiance == field.view([row, col]), "{row} {col}");
            assert!(![0, 3, 6].contains(&col) || ![0, 4].contains(&row), "{row} {col} is kept");
        }
        assert_eq!((open(5).1.len(), open(0).1.len()), (5, 0));
    }
}

#[test]
fn views_are_subsampled_around_the_middle_and_pixels_are_averaged() {
    let field = random_field([5, 3], [8, 6], Projection::Oblique, 2);
    let folder = tempfile::tempdir().unwrap();
    write_field(folder.path(), &field, &Map::new()).unwrap();
    let flags = GeometryFlags { views: Some([3, 1]), resolution: Some([4, 3]), ..GeometryFlags::default() };
    let (small, _) = open(folder.path(), &flags, &defaults());
    let small = small.unwrap();
    assert_eq!(small.radiance().shape(), [1, 3, 3, 4, 3]);
    let grid = &field.geometry().grid;
    assert_eq!(small.geometry().grid.slope_x, [grid.slope_x[0], grid.slope_x[2], grid.slope_x[4]]);
    assert_eq!(small.geometry().grid.slope_y, [grid.slope_y[1]]);
    assert_eq!(small.geometry().pitch_mm, 2.0 * 0.731);
    let big = field.radiance();
    let mean =
        [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[r, c]| big.get([1, 4, 4 + r, 2 + c, 2])).iter().sum::<f32>() / 4.0;
    assert!((small.radiance().get([0, 2, 2, 1, 2]) - mean).abs() < CODE);
    // a picture of another aspect is cropped, not stretched
    let flags = GeometryFlags { resolution: Some([3, 3]), ..GeometryFlags::default() };
    let cropped = open(folder.path(), &flags, &defaults()).0.unwrap();
    assert_eq!(cropped.geometry().pitch_mm, 2.0 * 0.731);
    let mean = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[r, c]| big.get([0, 0, r, 1 + c, 0])).iter().sum::<f32>() / 4.0;
    assert!((cropped.radiance().get([0, 0, 0, 0, 0]) - mean).abs() < CODE);
}

fn ramp<const N: usize>(tensor: &mut Tensor<N>, offset: usize) {
    let count = tensor.data().len();
    tensor.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = ((i + offset) % count) as f32 / count as f32);
}

fn stack() -> (Display, LayerStack) {
    let plain = Display::uniform([6, 4], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 12.0], 2);
    let mut display = Display { brightness: 0.25, ..plain };
    display.layers[0].resolution = [7, 5];
    display.layers[1] = Layer { offset_mm: [0.5, 0.0], ..Layer::new(12.0, [3, 2], 2.5) };
    let lenslets = LensletBacklight::new(-20.0, [4, 3], 2.0, [3, 2], [20.0, 20.0]);
    display.backlight = Backlight::Lenslets(lenslets);
    let mut stack = LayerStack::filled(&display, 0.0);
    ramp(&mut stack.layers[0], 0);
    ramp(&mut stack.layers[1], 7);
    ramp(stack.emission.as_mut().unwrap(), 3);
    (display, stack)
}

#[test]
fn a_stack_survives_its_folder() {
    let (display, stack) = stack();
    let folder = tempfile::tempdir().unwrap();
    let layers = folder.path().join("layers");
    write_stack(&layers, &display, &stack).unwrap();
    assert_eq!(read_stack(&layers).unwrap(), stack);
    let index = read_stack_index(&layers).unwrap();
    assert_eq!((index.frames, index.brightness, index.layers[1].d_mm), (2, 0.25, 12.0));
    assert_eq!(index.layers[1].file, "layer_1.npy");
    // writing a stack with a uniform backlight into the same folder removes the old emission
    let uniform = Display { backlight: Backlight::Uniform, ..display.clone() };
    let plain = LayerStack::filled(&uniform, 0.5);
    write_stack(&layers, &uniform, &plain).unwrap();
    assert_eq!(read_stack(&layers).unwrap(), plain);
    assert!(!layers.join("emission.npy").exists());
    let error = write_stack(&layers, &display, &plain).unwrap_err().to_string();
    assert!(error.contains("shape of the emission: expected"), "{error}");
    assert_eq!(read_stack(&layers).unwrap(), plain, "a stack that does not fit is refused before anything is touched");
}

#[test]
fn a_stack_that_was_tampered_with_is_refused() {
    let (display, stack) = stack();
    let folder = tempfile::tempdir().unwrap();
    let restore = || write_stack(folder.path(), &display, &stack).unwrap();
    let index = folder.path().join("stack.json");
    restore();
    let text = fs::read_to_string(&index).unwrap();
    for (from, to, message) in [
        ("lumistack/stack", "lumistack/lightfield", "schema: expected lumistack/stack"),
        ("\"version\": 1", "\"version\": 2", "version: expected 1 to 1, found 2"),
        (
            "\"frames\": 2",
            "\"frames\": 3",
            "layer_0.npy: shape: expected [3, 5, 7, 3], as in stack.json, found [2, 5, 7, 3]",
        ),
        ("\"frames\": 2", "\"frames\": 0", "frames: expected 1 to 1000, found 0"),
        ("layer_1.npy", "../layer_1.npy", "file: expected a name inside the folder, found ../layer_1.npy"),
        ("\"brightness\": 0.25", "\"brightness\": 0", "brightness: expected above 0, at most 1, found 0"),
        ("\"frame\"", "\"time\"", "layer_axes: expected"),
    ] {
        fs::write(&index, text.replacen(from, to, 1)).unwrap();
        let error = read_stack(folder.path()).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    restore();
    npy::write(&folder.path().join("layer_1.npy"), &[2, 2, 3, 3], &[1.5; 36]).unwrap();
    let error = read_stack(folder.path()).unwrap_err().to_string();
    assert!(
        error.ends_with("layer_1.npy: value 0 in row-major order: expected a number from 0 to 1, found 1.5"),
        "{error}"
    );
}

#[test]
fn numpy_reads_stacks_without_an_adapter() {
    let Some(python) = lumistack_testkit::skip::python_with("numpy") else { return };
    let (display, stack) = stack();
    let folder = tempfile::tempdir().unwrap();
    write_stack(folder.path(), &display, &stack).unwrap();
    let script = r#"
import json, sys, numpy as np
index = json.load(open("stack.json"))
a = np.load(index["layers"][0]["file"]); e = np.load(index["backlight"]["file"], mmap_mode="r")
assert a.dtype == np.float32 and a.shape == (2, 5, 7, 3) and a.flags["C_CONTIGUOUS"], (a.dtype, a.shape)
assert e.dtype == np.float32 and e.shape == (2, 2, 3, 3, 4, 3), e.shape
np.testing.assert_array_equal(a.ravel(), np.arange(210, dtype=np.float32) / np.float32(210))
np.save("theirs.npy", a[:, ::-1].astype(">f8"))
"#;
    let output = Command::new(python).args(["-c", script]).current_dir(folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // NumPy wrote a copy of layer 0 with big-endian doubles and reversed rows, so the first row of
    // the copy is the last row of layer 0
    let (shape, values) = npy::read(&folder.path().join("theirs.npy")).unwrap();
    assert_eq!(shape, [2, 5, 7, 3]);
    assert_eq!(values[..21], stack.layers[0].data()[4 * 21..5 * 21]);
}

#[test]
fn integers_are_code_values_unless_the_json_says_linear() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let header = "{'descr': '|u1', 'fortran_order': False, 'shape': (1, 1, 1, 1, 3), }";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend([0, 128, 255]);
    fs::write(&path, bytes).unwrap();
    let (field, warnings) = open(&path, &GeometryFlags::default(), &defaults());
    assert!((field.unwrap().radiance().data()[1] - 0.215_860_5).abs() < CODE);
    assert!(warnings[0].contains("sRGB code values"), "{warnings:?}");
    fs::write(path.with_extension("json"), "{\"linear\": true, \"anything\": {\"else\": 1}, \"pitch_mm\": 2.5}")
        .unwrap();
    let (field, warnings) = open(&path, &GeometryFlags::default(), &defaults());
    let field = field.unwrap();
    assert!((field.radiance().data()[1] - 128.0 / 255.0).abs() < CODE);
    assert_eq!((field.geometry().pitch_mm, warnings), (2.5, vec![]));
}

#[test]
fn a_description_has_geometry_and_range() {
    let field = random_field([3, 2], [5, 4], Projection::Perspective { distance_mm: 500.0 }, 4);
    let folder = tempfile::tempdir().unwrap();
    write_field(folder.path(), &field, &info()).unwrap();
    let (warnings, cancel) = (lumistack_core::Collector::default(), lumistack_core::Cancel::default());
    let task = lumistack_core::Task::quiet(&warnings, &cancel);
    let found = describe(folder.path(), &GeometryFlags::default(), task).unwrap();
    assert_eq!((found.views, found.resolution), ([3, 2], [5, 4]));
    assert_eq!((found.pitch_mm, found.distance_mm), (Some(0.731), Some(500.0)));
    let [x, y] = found.fov_deg.unwrap();
    assert!((x - 23.0).abs() < 1e-9 && (y - 17.0).abs() < 1e-9, "{x} {y}");
    let data = field.radiance().data();
    assert_eq!(found.maximum, data.iter().copied().fold(0.0, f32::max));
    assert_eq!(found.minimum, data.iter().copied().fold(1.0, f32::min));
    assert_eq!(found.info, info());
    let json = serde_json::to_value(&found).unwrap();
    assert_eq!((&json["kind"], &json["projection"]), (&json!("folder"), &json!("perspective")));
}

#[test]
fn a_cancelled_read_stops() {
    let field: LightField = random_field([3, 2], [5, 4], Projection::Oblique, 4);
    let folder = tempfile::tempdir().unwrap();
    write_field(folder.path(), &field, &Map::new()).unwrap();
    let (warnings, cancel) = (lumistack_core::Collector::default(), lumistack_core::Cancel::default());
    cancel.cancel();
    let task = lumistack_core::Task::quiet(&warnings, &cancel);
    let result = lumistack_field_io::open(folder.path(), &GeometryFlags::default(), &defaults(), task);
    assert!(matches!(result, Err(FieldError::Cancelled(_))));
}

/// The angles in a file apply to all of its views, even if only some views are kept. Mirroring also
/// mirrors the slopes: their order is reversed, and they change sign.
#[test]
fn kept_and_mirrored_views_have_their_own_slopes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let array = |json: &str| {
        npy::write(&path, &[1, 9, 2, 2, 3], &[0.5; 108]).unwrap();
        std::fs::write(path.with_extension("json"), json).unwrap();
    };
    let slopes = |flags: &GeometryFlags| {
        let flags = GeometryFlags { pitch_mm: Some(0.5), ..flags.clone() };
        open(&path, &flags, &defaults()).0.unwrap().geometry().grid.slope_x.clone()
    };
    array("{\"fov_deg\": [40, 40]}");
    let all = slopes(&GeometryFlags::default());
    let some = slopes(&GeometryFlags { views: Some([3, 1]), ..GeometryFlags::default() });
    assert_eq!(some, [all[0], all[4], all[8]]);
    array("{\"slope_x\": [-0.4, -0.3, -0.2, -0.1, 0, 0.2, 0.3, 0.4, 0.6], \"slope_y\": [0]}");
    let mirrored = slopes(&GeometryFlags { mirror: [true, false], ..GeometryFlags::default() });
    assert_eq!(mirrored, [-0.6, -0.4, -0.3, -0.2, 0.0, 0.1, 0.2, 0.3, 0.4]);
}
