//! Damaged, incomplete and contradictory input causes one clear error, and never a panic.

use std::fs;
use std::path::Path;

use crate::common::{defaults, open, random_field, save_png};
use lumistack_display::{Display, LayerStack, Projection, ProjectionKind};
use lumistack_field_io::picture::{Picture, Precision, write_exr, write_exr_channels};
use lumistack_field_io::{
    GeometryDefaults, GeometryFlags, npy, picture_bytes, read_field_folder, read_stack, write_field, write_stack,
};
use serde_json::Map;

fn error_of(path: &Path, flags: &GeometryFlags, defaults: &GeometryDefaults) -> String {
    open(path, flags, defaults).0.unwrap_err().to_string()
}

fn plain_error(path: &Path) -> String {
    error_of(path, &GeometryFlags::default(), &defaults())
}

/// Returns the lengths to which a file of `length` bytes is truncated. The cuts are in headers,
/// tables and data.
fn cuts(length: usize) -> Vec<usize> {
    let mut cuts: Vec<usize> = (0..32).chain([length / 4, length / 2, length * 3 / 4]).collect();
    cuts.extend(length.saturating_sub(20)..length);
    cuts.retain(|&cut| cut < length);
    cuts
}

/// Truncates a file at many lengths. `read` must fail for each length, and succeed for the whole
/// file. The last `idle` bytes contain no data, so the file is not cut within them.
fn truncate(file: &Path, idle: usize, read: impl Fn() -> Result<(), String>) {
    let whole = fs::read(file).unwrap();
    for cut in cuts(whole.len() - idle) {
        fs::write(file, &whole[..cut]).unwrap();
        let Err(error) = read() else { panic!("{} cut to {cut} of {} bytes was read", file.display(), whole.len()) };
        assert!(error.contains(file.file_name().unwrap().to_str().unwrap()), "the file is named: {error}");
    }
    fs::write(file, &whole).unwrap();
    read().unwrap();
}

#[test]
fn truncated_folders_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let field = random_field([2, 1], [19, 33], Projection::Oblique, 1);
    write_field(folder.path(), &field, &Map::new()).unwrap();
    let read = || read_field_folder(folder.path()).map(drop).map_err(|error| error.to_string());
    truncate(&folder.path().join("view_00_01.exr"), 0, read);
    let index = folder.path().join("lightfield.json");
    let whole = fs::read(&index).unwrap();
    for cut in cuts(whole.len() - 2) {
        fs::write(&index, &whole[..cut]).unwrap();
        assert!(read().unwrap_err().contains("lightfield.json: line "), "cut at {cut}");
    }
}

#[test]
fn truncated_arrays_and_stacks_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    npy::write(&path, &[2, 3, 4, 5, 3], &[0.5; 360]).unwrap();
    truncate(&path, 0, || open(&path, &GeometryFlags::default(), &defaults()).0.map(drop).map_err(|e| e.to_string()));

    let display = Display::uniform([4, 3], 1.0, [1, 1], [9.0, 9.0], &[0.0], 2);
    let layers = folder.path().join("layers");
    write_stack(&layers, &display, &LayerStack::filled(&display, 0.5)).unwrap();
    truncate(&layers.join("layer_0.npy"), 0, || read_stack(&layers).map(drop).map_err(|e| e.to_string()));
}

/// An index may only name regular files of its folder. Links that lead outside, devices and pipes
/// are refused before they are opened.
#[cfg(unix)]
#[test]
fn files_that_an_index_names_are_regular_and_inside() {
    use std::os::unix::fs::symlink;

    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("field");
    write_field(&folder, &random_field([2, 1], [3, 2], Projection::Oblique, 1), &Map::new()).unwrap();
    let view = folder.join("view_00_00.exr");
    let replace = |target: &Path| {
        std::fs::remove_file(&view).unwrap();
        symlink(target, &view).unwrap();
        plain_error(&folder)
    };
    let elsewhere = outer.path().join("elsewhere.exr");
    std::fs::copy(&view, &elsewhere).unwrap();
    let error = replace(&elsewhere);
    assert!(
        error.contains("views[0].file: expected a name inside the folder, found view_00_00.exr: the path leads to"),
        "{error}"
    );
    let error = replace(Path::new("/dev/zero"));
    assert!(error.contains("/dev/zero, outside of the folder"), "{error}");
    std::fs::remove_file(&view).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&view).status().unwrap().success());
    let error = plain_error(&folder);
    assert!(error.contains("view_00_00.exr: cannot read: expected a regular file, found a pipe"), "{error}");

    let display = Display::uniform([4, 3], 1.0, [1, 1], [9.0, 9.0], &[0.0], 2);
    let layers = outer.path().join("layers");
    write_stack(&layers, &display, &LayerStack::filled(&display, 0.5)).unwrap();
    let layer = layers.join("layer_0.npy");
    std::fs::rename(&layer, outer.path().join("layer.npy")).unwrap();
    symlink(outer.path().join("layer.npy"), &layer).unwrap();
    let error = read_stack(&layers).unwrap_err().to_string();
    assert!(error.contains("file: expected a name inside the folder, found layer_0.npy: the path leads to"), "{error}");
    for name in ["zero.npy", "zero.exr", "zero_qs2x2.png", "lightfield.json"] {
        let path = outer.path().join(name);
        symlink("/dev/zero", &path).unwrap();
        let error = plain_error(&path);
        assert!(error.contains("cannot read: expected a regular file, found a device"), "{error}");
    }
}

#[test]
fn truncated_pictures_are_errors() {
    // the last 4 bytes of a PNG are the checksum of an empty chunk; a PNG can be read without them
    for (name, idle) in [("q_qs2x1.png", 4), ("q_qs2x1.jpg", 0), ("q_qs2x1.webp", 0)] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        save_png(&path, [64, 40], |x, y| [(x * y) as u8, (x ^ y) as u8, (x * 7 + y * 31) as u8]);
        truncate(&path, idle, || {
            open(&path, &GeometryFlags::default(), &defaults()).0.map(drop).map_err(|e| e.to_string())
        });
    }
}

/// Returns the peak memory of this process, bytes.
#[cfg(target_os = "linux")]
fn peak_bytes() -> usize {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<usize>().unwrap() << 10
}

/// Headers declare views of 2.4 GB in total, and no data follows. Memory must be allocated only
/// when pixels are read.
#[test]
#[cfg(target_os = "linux")]
fn headers_that_claim_much_cost_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for view in 0..4 {
        let header = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 7000 +X 7000\n";
        fs::write(folder.path().join(format!("input_Cam{view:03}.hdr")), header).unwrap();
    }
    let before = peak_bytes();
    let error = plain_error(folder.path());
    assert!(error.contains("input_Cam000.hdr"), "{error}");
    let grown = peak_bytes() - before;
    assert!(grown < 1 << 30, "{grown} bytes were touched");
}

/// A picture with the same value in all pixels has the most pixels per byte of its file. The reader
/// must accept it. A header that claims more pixels than the file can hold is an error.
#[test]
fn pictures_do_not_claim_more_pixels_than_they_can_hold() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    for value in [0.0, 0.5] {
        write_exr(&path, [2000, 1000], &vec![value; 3 * 2000 * 1000], Precision::Half).unwrap();
        assert_eq!(Picture::read(&path).unwrap().size(), [2000, 1000]);
    }
    write_exr(&path, [4, 3], &[0.5; 36], Precision::Half).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let key = b"dataWindow\0box2i\0";
    let at = bytes.windows(key.len()).position(|window| window == key).unwrap() + key.len() + 4;
    bytes[at + 8..at + 12].copy_from_slice(&80_000_000i32.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let error = Picture::read(&path).unwrap_err().to_string();
    assert!(error.contains("80000001 × 3 pixels in at least "), "{error}");
}

#[test]
fn the_memory_of_a_picture_includes_all_its_channels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let names = ["R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"];
    let values = [0.5; 12];
    write_exr_channels(&path, [4, 3], &names.map(|name| (name, &values[..]))).unwrap();
    // eight channels of floats, and the linear picture
    assert_eq!(picture_bytes(&path), 12 * (8 * 4 + 12));
    write_exr(&path, [4, 3], &[0.5; 36], Precision::Half).unwrap();
    assert_eq!(picture_bytes(&path), 12 * 24);
}

#[test]
fn damaged_bytes_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let field = random_field([1, 1], [5, 4], Projection::Oblique, 1);
    write_field(folder.path(), &field, &Map::new()).unwrap();
    let array = folder.path().join("a.npy");
    npy::write(&array, &field.radiance().shape(), field.radiance().data()).unwrap();
    for (file, opened) in [
        (folder.path().join("view_00_00.exr"), folder.path().to_path_buf()),
        (folder.path().join("lightfield.json"), folder.path().to_path_buf()),
        (array.clone(), array),
    ] {
        let whole = fs::read(&file).unwrap();
        for at in (0..whole.len().min(1200)).step_by(3) {
            for value in [0x00, 0x7f, 0xff, whole[at] ^ 0x01] {
                let mut damaged = whole.clone();
                damaged[at] = value;
                fs::write(&file, &damaged).unwrap();
                open(&opened, &GeometryFlags::default(), &defaults()).0.ok();
            }
        }
        fs::write(&file, &whole).unwrap();
    }
}

#[test]
fn indices_that_contradict_themselves_name_the_key() {
    let folder = tempfile::tempdir().unwrap();
    let field = random_field([2, 1], [3, 2], Projection::Perspective { distance_mm: 500.0 }, 1);
    write_field(folder.path(), &field, &Map::new()).unwrap();
    let index = folder.path().join("lightfield.json");
    let good: serde_json::Value = serde_json::from_slice(&fs::read(&index).unwrap()).unwrap();
    for (pointer, value, message) in [
        ("/schema", "\"x\"", "schema: expected lumistack/lightfield, found x"),
        ("/version", "2", "version: expected 1 to 1, found 2"),
        ("/axes/0", "\"row\"", "axes: expected"),
        ("/linear", "false", "linear: expected true, found false"),
        ("/resolution", "[3, 3]", "view_00_00.exr: size: expected 3 × 3 as in lightfield.json, found 3 × 2"),
        ("/pitch_mm", "0", "pitch_mm: expected a number above 0, found 0"),
        ("/pitch_mm", "null", "pitch_mm: expected a value, found none"),
        ("/distance_mm", "null", "distance_mm: expected a value, found none"),
        ("/projection", "\"fisheye\"", "unknown variant `fisheye`"),
        ("/slope_x", "[0.0]", "views: expected 1 × 1 views, one for each pair of slopes (x, y), found 2"),
        ("/slope_x", "[]", "1 to 16384 views per axis, found 0 × 1"),
        ("/slope_x/0", "1e999", "number out of range"),
        (
            "/views/1/view",
            "[0, 2]",
            "views[1].view: expected a view [view_y, view_x] with view_y below 1 and view_x below 2, found [0, 2]",
        ),
        ("/views/1/view", "[0, 0]", "views[1].slope: expected slope"),
        ("/views/1/slope", "[0.5, 0.0]", "views[1].slope: expected slope"),
        ("/views/1/eye_mm", "[0.5, 0.0, 500]", "views[1].eye_mm: expected slope"),
        ("/views/1/file", "\"../x.exr\"", "views[1].file: expected a name inside the folder, found ../x.exr"),
        ("/views/1/file", "\"/etc/x.exr\"", "views[1].file: expected a name inside the folder"),
        ("/views/1/file", "\"gone.exr\"", "gone.exr: cannot read"),
    ] {
        let mut bad = good.clone();
        *bad.pointer_mut(pointer).unwrap() = serde_json::from_str(value).unwrap_or("\u{1}".into());
        let text = serde_json::to_string(&bad).unwrap().replace("\"\\u0001\"", value);
        fs::write(&index, text).unwrap();
        let error = plain_error(folder.path());
        assert!(error.contains(message), "{pointer}: {error}");
    }
    // keys of newer or other writers are accepted, and so is `slope_y_up` instead of `slope_y`
    let text = serde_json::to_string(&good).unwrap().replace("\"slope_y\"", "\"slope_y_up\"").replacen(
        '{',
        "{\"new\":[1],",
        1,
    );
    fs::write(&index, text).unwrap();
    assert_eq!(read_field_folder(folder.path()).unwrap().0, field);
}

#[test]
fn views_of_different_sizes_name_both_files() {
    let folder = tempfile::tempdir().unwrap();
    for (name, size) in [("00_00.png", [8, 6]), ("00_01.png", [8, 6]), ("00_02.png", [8, 7])] {
        save_png(&folder.path().join(name), size, |_, _| [9; 3]);
    }
    let error = plain_error(folder.path());
    assert!(
        error.starts_with("expected views of one size, found ") && error.contains("00_00.png with 8 × 6 pixels"),
        "{error}"
    );
    assert!(error.ends_with("00_02.png with 8 × 7 pixels"), "{error}");
}

#[test]
fn incomplete_and_doubtful_folders_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    assert!(plain_error(folder.path()).ends_with("found neither pictures nor arrays"));
    assert!(plain_error(&folder.path().join("gone")).contains("gone: cannot read: "));
    let file = folder.path().join("notes.txt");
    fs::write(&file, "x").unwrap();
    assert!(plain_error(&file).ends_with(".npy, lightfield.json or a picture of tiles, found .txt"));
    let picture = |name: &str| save_png(&folder.path().join(name), [4, 4], |_, _| [9; 3]);
    picture("00_00.png");
    picture("00_01.png");
    picture("01_00.png");
    let error = plain_error(folder.path());
    assert!(error.ends_with("views: expected all of 2 × 2 views, found none for row 1, column 1"), "{error}");
    picture("1_1.png");
    picture("01_01.png");
    let error = plain_error(folder.path());
    assert!(error.contains("row and column: expected one picture per view, found"), "{error}");

    let folder = tempfile::tempdir().unwrap();
    for number in [0, 1, 3] {
        save_png(&folder.path().join(format!("input_Cam{number:03}.png")), [4, 4], |_, _| [9; 3]);
    }
    assert!(
        plain_error(folder.path())
            .ends_with("expected num_cams_x and num_cams_y in parameters.cfg, or a square number of pictures, found 3 pictures, and at most one of the two keys")
    );
    fs::write(folder.path().join("parameters.cfg"), "[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 1\n").unwrap();
    assert!(plain_error(folder.path()).ends_with("expected input_Cam000 to input_Cam002, found no input_Cam002"));
    fs::write(folder.path().join("parameters.cfg"), "[extrinsics]\nnum_cams_x = 5\nnum_cams_y = 1\n").unwrap();
    assert!(plain_error(folder.path()).ends_with("views: expected 5 × 1 pictures, as in parameters.cfg, found 3"));
    fs::write(folder.path().join("parameters.cfg"), "num_cams_x = many\nnum_cams_y = 1\n").unwrap();
    assert!(plain_error(folder.path()).ends_with("num_cams_x: expected a whole number from 1 to 10000, found many"));
}

#[test]
fn missing_geometry_names_the_flag() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    npy::write(&path, &[1, 2, 3, 4, 3], &[0.5; 72]).unwrap();
    let none = GeometryDefaults::default();
    let flags = GeometryFlags::default();
    assert!(
        error_of(&path, &flags, &none).ends_with(
            "the size of the pixels is unknown; state the value with --pitch-mm, for example --pitch-mm 0.5"
        )
    );
    let flags = GeometryFlags { pitch_mm: Some(0.5), ..flags };
    assert!(
        error_of(&path, &flags, &none)
            .ends_with("the full angle of the views is unknown; state the value with --fov, for example --fov 20x20")
    );
    let flags = GeometryFlags { fov_deg: Some([20.0; 2]), grid: Some(ProjectionKind::Perspective), ..flags };
    assert!(
        error_of(&path, &flags, &none)
            .contains("viewing distance of the perspective views is unknown; state the value with --distance-mm")
    );
    let flags = GeometryFlags { distance_mm: Some(600.0), ..flags };
    let field = open(&path, &flags, &none).0.unwrap();
    assert_eq!(field.geometry().grid.projection, Projection::Perspective { distance_mm: 600.0 });

    for (flags, message) in [
        (
            GeometryFlags { views: Some([3, 1]), ..flags.clone() },
            "--views: expected 1 × 1 to 2 × 1 views (the light field has no more), found 3 × 1",
        ),
        (GeometryFlags { views: Some([0, 1]), ..flags.clone() }, "--views: expected"),
        (GeometryFlags { resolution: Some([8, 3]), ..flags.clone() }, "--resolution: expected 1 × 1 to 4 × 3 pixels"),
        (GeometryFlags { resolution: Some([0, 3]), ..flags.clone() }, "--resolution: expected"),
        (GeometryFlags { focus_px: Some(9.0), ..flags.clone() }, "--focus-px: expected a disparity at which all views"),
        (
            GeometryFlags { focus_px: Some(f64::NAN), ..flags.clone() },
            "--focus-px: expected a finite number, found NaN",
        ),
        (GeometryFlags { fov_deg: Some([180.0, 9.0]), ..flags.clone() }, "fov_deg: expected full angles"),
        (GeometryFlags { pitch_mm: Some(-1.0), ..flags.clone() }, "pitch_mm: expected a number above 0, found -1"),
    ] {
        let error = error_of(&path, &flags, &none);
        assert!(error.contains(message), "{error}");
    }

    let picture = folder.path().join("plain.png");
    save_png(&picture, [8, 8], |_, _| [9; 3]);
    assert!(plain_error(&picture).contains("state the value with --quilt COLUMNSxROWS"));
    let flags = GeometryFlags { tiles: Some([3, 2]), ..GeometryFlags::default() };
    assert!(
        error_of(&picture, &flags, &defaults())
            .ends_with("--tiles: expected a picture whose width is a multiple of 3 pixels and whose height is a multiple of 2 pixels, found 8 × 8")
    );
    let flags = GeometryFlags { quilt: Some([9, 1]), ..GeometryFlags::default() };
    assert!(
        error_of(&picture, &flags, &defaults())
            .contains("--quilt: expected 1 × 1 to 8 × 8 tiles, at most one per pixel and 1000 per axis, found 9 × 1")
    );
}

#[test]
fn sidecars_that_do_not_fit_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    npy::write(&path, &[1, 2, 3, 4, 3], &[0.5; 72]).unwrap();
    for (json, message) in [
        ("{\"slope_x\": [0.0]}", "a.json: slope_x: expected 2 slopes, one per view, found 1"),
        ("{\"axes\": [\"row\"]}", "a.json: axes: expected"),
        ("{\n\"pitch_mm\": \"wide\"}", "a.json: line 2, column 18: expected a number, found the text"),
        ("[", "a.json: line 1, column 1"),
    ] {
        fs::write(path.with_extension("json"), json).unwrap();
        let error = plain_error(&path);
        assert!(error.contains(message), "{error}");
    }
    for shape in [&[2, 3, 4, 3][..], &[1, 2, 3, 4, 1], &[1, 2, 0, 4, 3]] {
        npy::write(&path, shape, &vec![0.5; shape.iter().product()]).unwrap();
        let error = plain_error(&path);
        assert!(error.contains(&format!("found {shape:?}")), "{error}");
    }
}

#[test]
fn values_that_are_no_light_are_refused_and_odd_ones_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let mut values = vec![0.5; 72];
    for (bad, found) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (1e9, "1000000000"), (-1e9, "-1000000000")] {
        values[36 + 3 * 5 + 2] = bad;
        npy::write(&path, &[1, 2, 3, 4, 3], &values).unwrap();
        let error = plain_error(&path);
        let expected = format!(
            "[view_y, view_x, row, col, rgb] = [0, 1, 1, 1, 2]: expected a number from 0 to 65504, found {found}"
        );
        assert!(error.ends_with(&expected), "{error}");
    }
    values[36 + 3 * 5 + 2] = -0.25;
    values[7] = 3.0;
    npy::write(&path, &[1, 2, 3, 4, 3], &values).unwrap();
    let (field, warnings) = open(&path, &GeometryFlags::default(), &defaults());
    assert_eq!(field.unwrap().radiance().get([0, 1, 1, 1, 2]), 0.0);
    assert!(
        warnings.iter().any(|w| w.ends_with("are set to 0 (number of these values: 1; lowest value: -0.25)")),
        "{warnings:?}"
    );
    // values above 1 cause no warning here, since a light field may be brighter than a display
    assert!(!warnings.iter().any(|w| w.contains("above 1")), "{warnings:?}");
}
