//! The patterns of the page agree with the patterns of the command, and the page's zip is a run
//! folder.

use std::io::{Cursor, Read as _};
use std::path::{Path, PathBuf};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_pipeline::{Job, Registry};
use lumistack_web_solver::{Files, Settings, Stage, Work, patterns};

const CHOICE: &str = r#"{"cols": 48, "frames": 3, "zone_samples": 150, "iterations": 4}"#;

fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(name)
}

fn files(folder: &Path) -> Files {
    let mut files = Files::default();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        files.add(&path.file_name().unwrap().to_string_lossy(), std::fs::read(&path).unwrap());
    }
    files
}

/// Computes all pieces. Returns the number of times that new patterns were ready to show.
fn finish(work: &mut Work) -> u32 {
    let mut last = work.share();
    while work.stage() != Stage::Done {
        work.advance().unwrap();
        assert!(work.share() >= last, "{} after {last}", work.share());
        last = work.share();
    }
    work.shown()
}

fn unpacked(zip: Vec<u8>, folder: &Path) {
    let mut zip = zip::ZipArchive::new(Cursor::new(zip)).unwrap();
    for i in 0..zip.len() {
        let mut file = zip.by_index(i).unwrap();
        let path = folder.join(file.enclosed_name().unwrap());
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

/// Finishes `work`, and runs the command on the job of `work`, with the files of `folder` beside
/// it. Returns the root mean square difference between the patterns of the page and of the command.
fn difference(folder: &Path, mut work: Work) -> f64 {
    let shown = finish(&mut work);
    assert!(shown > 1, "new patterns were ready only {shown} times");
    let (display, stack) = (work.display(), work.stack().unwrap());
    let run = tempfile::tempdir().unwrap();
    unpacked(patterns::zip(display, stack, &work.job()).unwrap(), run.path());
    let read = lumistack_field_io::read_stack(&run.path().join("layers")).unwrap();
    assert_eq!(&read, stack);
    // put the scene's files beside the job
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            std::fs::copy(&path, run.path().join(path.file_name().unwrap())).unwrap();
        }
    }
    let mut job = Job::load(&run.path().join("job.toml")).unwrap();
    (job.outputs, job.report.zone_directions, job.render.outside) = (Vec::new(), 0, 0);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let out = run.path().join("out");
    let registry = Registry::built_in().unwrap();
    lumistack_pipeline::run(&job, &out, &registry, None, Task::quiet(&warnings, &cancel)).unwrap();
    let command = lumistack_field_io::read_stack(&out.join("layers")).unwrap();
    let curve = std::fs::read(out.join("cache/convergence.json")).unwrap();
    let curve: serde_json::Value = serde_json::from_slice(&curve).unwrap();
    let last = curve["value"]["steps"].as_array().and_then(|steps| steps.last()).unwrap();
    let psnr = last["psnr_view"].as_f64().unwrap();
    assert!((work.psnr() - psnr).abs() < 0.01, "page {} dB, command {psnr} dB", work.psnr());
    let pairs = || stack.layers.iter().zip(&command.layers).flat_map(|(a, b)| a.data().iter().zip(b.data()));
    let squares: f64 = pairs().map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (squares / pairs().count() as f64).sqrt()
}

#[test]
fn patterns_are_those_of_the_command() {
    // the command rounds filtered views when it caches them, so a small difference remains
    for (folder, file) in [("letters", "letters.gltf"), ("dandelion", "dandelion.spz")] {
        let settings = Settings::from_json(CHOICE).unwrap();
        let work = Work::new(files(&scene(folder)), file, settings).unwrap();
        let difference = difference(&scene(folder), work);
        assert!(difference < 2e-3, "{folder}: {difference}");
    }
}

/// Writes a quilt of 4 × 2 views of stripes at two depths.
fn quilt(path: &Path) {
    let [cols, rows] = [60, 40];
    let picture = image::RgbImage::from_fn(4 * cols, 2 * rows, |x, y| {
        let view = x / cols + 4 * (1 - y / rows);
        let [col, row] = [x % cols, y % rows];
        let near = (col + view) % 15 < 5 && row > 10;
        let far = (col + 30 - view) % 10 < 5;
        image::Rgb([if near { 220 } else { 30 }, if far { 180 } else { 60 }, if near || far { 90 } else { 10 }])
    });
    picture.save(path).unwrap();
}

#[test]
fn a_light_field_is_solved_as_the_command_solves_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stripes_qs4x2a1.5.png");
    quilt(&path);
    let settings = |more: &str| Settings::from_json(&format!(r#"{{"iterations": 5, "frames": 2, {more}}}"#)).unwrap();
    // The views have 60 columns. If the settings allow 160 columns, the views stay as they are;
    // with 48 they are reduced to 48 columns.
    for (cols, expected) in [(160, [60, 40]), (48, [48, 32])] {
        let settings = settings(&format!(r#""cols": {cols}"#));
        let work = Work::of_field(path.to_str().unwrap(), settings).unwrap();
        let difference = difference(folder.path(), work);
        assert!(difference < 1e-6, "{cols} columns: {difference}");
        let mut work = Work::of_field(path.to_str().unwrap(), Settings::from_json(CHOICE).unwrap()).unwrap();
        work.change(Settings::from_json(&format!(r#"{{"iterations": 1, "cols": {cols}}}"#)).unwrap()).unwrap();
        assert_eq!(finish(&mut work), 2);
        assert_eq!(work.display().field.resolution, expected);
    }
    // a missing light field gives the error of the command
    let work = Work::of_field(folder.path().join("none.npy").to_str().unwrap(), settings(r#""cols": 48"#));
    let error = work.unwrap().advance().unwrap_err().to_string();
    assert!(error.ends_with("none.npy: cannot read: No such file or directory (os error 2)"), "{error}");
}

#[test]
fn another_display_takes_the_same_scene() {
    let quick =
        |more: &str| Settings::from_json(&format!(r#"{{"cols": 32, "zone_samples": 9, "iterations": 1{more}}}"#));
    let mut work = Work::new(files(&scene("letters")), "letters.gltf", quick("").unwrap()).unwrap();
    // change the settings after the first patterns
    while work.shown() == 0 {
        work.advance().unwrap();
    }
    work.change(quick(r#", "layers": 2, "frames": 2"#).unwrap()).unwrap();
    assert!(work.stack().is_none() && work.stage() == Stage::Scene);
    finish(&mut work);
    assert_eq!((work.stack().unwrap().layers.len(), work.stack().unwrap().frames()), (2, 2));
    // after the change, the patterns equal the patterns of a new solve with the changed settings
    let mut fresh =
        Work::new(files(&scene("letters")), "letters.gltf", quick(r#", "layers": 2, "frames": 2"#).unwrap()).unwrap();
    finish(&mut fresh);
    assert_eq!(fresh.stack(), work.stack());
}

#[test]
fn bad_input_is_one_sentence() {
    let message = |files: Files, path: &str| {
        let mut work = Work::new(files, path, Settings::default()).unwrap();
        let error = work.advance().unwrap_err().to_string();
        assert!(work.advance().is_ok() && work.stage() == Stage::Done, "nothing goes on");
        error
    };
    let one = |path: &str, bytes: &[u8]| {
        let mut files = Files::default();
        files.add(path, bytes.to_vec());
        message(files, path)
    };
    assert!(one("a.glb", b"glTF").starts_with("a.glb: "), "{}", one("a.glb", b"glTF"));
    assert!(one("a.ply", b"no").contains("a.ply: byte 0: expected a .ply"), "{}", one("a.ply", b"no"));
    let text = br#"{"asset": {"version": "2.0"}, "buffers": [{"uri": "../secret.bin", "byteLength": 4}],
        "bufferViews": [{"buffer": 0, "byteLength": 4}], "accessors": [{"bufferView": 0, "componentType": 5126, "count": 1, "type": "SCALAR"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0}"#;
    let error = one("a.gltf", text);
    assert!(error.contains("a.gltf"), "{error}");
    for (choice, expected) in [
        (r#"{"cols": 100000}"#, "cols: expected 16 to 640"),
        (r#"{"preset": "x"}"#, "preset: expected the name of a built-in display, found x"),
        (r#"{"frames": 0}"#, "frames"),
        (r#"{"brightness": 2.0}"#, "brightness"),
        (r#"{"colour": 1}"#, "unknown field `colour`"),
    ] {
        let error =
            Settings::from_json(choice).and_then(|settings| settings.display().map(drop)).unwrap_err().to_string();
        assert!(error.contains(expected), "{choice}: {error}");
    }
}
