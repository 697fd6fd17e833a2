//! Captures go through the whole pipeline, alone and among meshes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{Quat, Vec3};
use lumistack_core::{Cancel, Collector, Task};
use lumistack_pipeline::{Job, Registry, Summary, plan, run};
use lumistack_scene::Cloud;
use lumistack_splats::{glb, write};

/// Returns splats that form an opaque ball of one colour around a point.
fn ball(at: Vec3, radius: f32, rgb: [f32; 3]) -> Cloud {
    let mut cloud = Cloud::default();
    for i in 0..1500 {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / 1500.0;
        let (sin, cos) = (2.399_963 * i as f32).sin_cos();
        let normal = Vec3::new((1.0 - y * y).sqrt() * cos, y, (1.0 - y * y).sqrt() * sin);
        cloud.positions.push(at + radius * normal);
        cloud.rotations.push(Quat::from_rotation_arc(Vec3::Z, normal));
        cloud.scales.push(radius * Vec3::new(0.08, 0.08, 0.01));
        cloud.opacities.push(0.95);
        cloud.harmonics.extend(rgb.map(|value| (value - 0.5) / 0.282_094_8));
    }
    cloud
}

fn job(folder: &Path, scene: &str, more: &str) -> Job {
    let display = "[display]\npreset = \"paper-three-layer\"\nresolution = [48, 30]\nviews = [3, 3]\nframes = 2\n";
    let rest = "[factorize]\niterations = 4\n[render]\nsamples = 16\nheld_out = 1\n";
    let path = folder.join("job.toml");
    std::fs::write(&path, format!("scene = \"{scene}\"\n{display}{rest}{more}")).unwrap();
    Job::load(&path).unwrap()
}

fn run_quietly(job: &Job, dir: &Path) -> (Summary, Vec<String>) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let registry = Registry::built_in().unwrap();
    let summary = run(job, dir, &registry, None, Task::quiet(&warnings, &cancel)).unwrap();
    (summary, warnings.take().iter().map(ToString::to_string).collect())
}

fn pictures(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let entries = std::fs::read_dir(dir.join("target")).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| (path.file_name().unwrap().into(), std::fs::read(&path).unwrap())).collect()
}

/// Returns a pixel of the central view of the target, linear.
fn middle(dir: &Path, at: [usize; 2]) -> [f32; 3] {
    let (field, _) = lumistack_field_io::read_field_folder(&dir.join("target")).unwrap();
    let first = 3 * (at[0] * 48 + at[1]);
    let view = field.view([1, 1]);
    [view[first], view[first + 1], view[first + 2]]
}

fn srgb(value: f32) -> f32 {
    lumistack_core::colour::srgb_decode(value)
}

fn assert_near(found: [f32; 3], expected: [f32; 3]) {
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.02), "{found:?} {expected:?}");
}

#[test]
fn a_capture_becomes_a_display_and_is_taken_from_the_cache() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = ball(Vec3::ZERO, 1.0, [0.9, 0.5, 0.2]);
    // Add a distant splat, which must not move the window.
    capture.positions.push(Vec3::splat(60.0));
    capture.rotations.push(Quat::IDENTITY);
    capture.scales.push(Vec3::splat(0.05));
    capture.opacities.push(1.0);
    capture.harmonics.extend([1.0; 3]);
    std::fs::write(folder.path().join("a.spz"), write::spz(&capture).unwrap()).unwrap();
    let job = job(folder.path(), "a.spz", "");
    let dir = folder.path().join("run");
    let (summary, warnings) = run_quietly(&job, &dir);
    assert!(warnings.is_empty(), "{warnings:?}");
    // The required score is low, since the display has two frames and the solver makes four
    // iterations.
    assert!(summary.psnr_zone.unwrap() > 20.0, "{:?}", summary.psnr_zone);
    // The capture's colours appear without exposure and tone curve, over black.
    assert_near(middle(&dir, [15, 24]), [0.9, 0.5, 0.2].map(srgb));
    assert_near(middle(&dir, [15, 2]), [0.0; 3]);
    // The ball fills the window from top to bottom.
    assert!(middle(&dir, [2, 24])[0] > 0.3, "{:?}", middle(&dir, [2, 24]));
    let first = pictures(&dir);
    let registry = Registry::built_in().unwrap();
    let cached =
        |id: &str| plan(&job, &dir, &registry).unwrap().steps.iter().find(|step| step.id == id).unwrap().cached;
    assert_eq!(["trace", "expose", "factorize"].map(cached), [Some(true); 3]);
    // Missing views are rendered again, and the files have the same bytes.
    let lost = std::fs::read_dir(dir.join("cache/views")).unwrap().map(|entry| entry.unwrap().path());
    let lost = lost.map(|folder| folder.join("splats_01_00.exr")).find(|path| path.exists()).unwrap();
    let bytes = std::fs::read(&lost).unwrap();
    std::fs::remove_file(&lost).unwrap();
    std::fs::remove_dir_all(dir.join("target")).unwrap();
    run_quietly(&job, &dir);
    assert!(std::fs::read(&lost).unwrap() == bytes && pictures(&dir) == first);
}

#[test]
fn a_background_stands_behind_a_capture() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = ball(Vec3::ZERO, 1.0, [0.8, 0.8, 0.8]);
    std::fs::write(folder.path().join("a.ply"), write::ply(&capture)).unwrap();
    let background = "[light]\nbackground = [0.1, 0.2, 0.4]\n";
    let dir = folder.path().join("run");
    run_quietly(&job(folder.path(), "a.ply", background), &dir);
    assert_near(middle(&dir, [15, 24]), [0.8; 3].map(srgb));
    assert_near(middle(&dir, [15, 2]), [0.1, 0.2, 0.4]);
    // Half-transparent splats are blended in sRGB codes. The scene has one splat of half opacity in
    // front of the eye.
    capture = Cloud {
        positions: vec![Vec3::ZERO],
        rotations: vec![Quat::IDENTITY],
        scales: vec![Vec3::new(5.0, 5.0, 0.1)],
        opacities: vec![0.5],
        harmonics: vec![0.5 / 0.282_094_8; 3],
        ..Cloud::default()
    };
    std::fs::write(folder.path().join("b.ply"), write::ply(&capture)).unwrap();
    let window = "[window]\nfrom = \"given\"\ncentre = [0, 0, 0]\nforward = [0, 0, -1]\nup = [0, 1, 0]\nwidth = 1.0\n";
    let dir = folder.path().join("half");
    run_quietly(&job(folder.path(), "b.ply", &format!("{background}{window}")), &dir);
    let encoded = |linear: f32| lumistack_core::colour::srgb_encode(linear);
    assert_near(middle(&dir, [15, 24]), [0.1, 0.2, 0.4].map(|value| srgb(0.5 + 0.5 * encoded(value))));
}

/// A grey, unlit wall is between two red balls of splats. The left ball must hide the wall behind
/// it, and the wall must hide the right ball.
#[test]
fn splats_and_meshes_hide_one_another() {
    let folder = tempfile::tempdir().unwrap();
    let mut balls = ball(Vec3::new(-1.0, 0.0, 1.0), 0.6, [0.8, 0.1, 0.1]);
    let behind = ball(Vec3::new(1.0, 0.0, -1.0), 0.6, [0.8, 0.1, 0.1]);
    balls.positions.extend(behind.positions);
    balls.rotations.extend(behind.rotations);
    balls.scales.extend(behind.scales);
    balls.opacities.extend(behind.opacities);
    balls.harmonics.extend(behind.harmonics);
    let bytes = glb(&balls, [0.0, 0.0, 0.0, 1.0], 1.0).unwrap();
    let unlit = serde_json::json!({
        "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1.0]},
        "extensions": {"KHR_materials_unlit": {}},
    });
    std::fs::write(folder.path().join("a.glb"), with_wall(&bytes, unlit)).unwrap();
    let window = "[window]\nfrom = \"given\"\ncentre = [0, 0, 0]\nforward = [0, 0, -1]\nup = [0, 1, 0]\nwidth = 4.0\nfit_depth = \"off\"\n";
    for denoise in ["off", "shared"] {
        let dir = folder.path().join(denoise);
        let job = job(folder.path(), "a.glb", window);
        let mut job = job;
        job.render.denoise = denoise.parse().unwrap();
        run_quietly(&job, &dir);
        // The left ball is visible, the right ball is hidden, and the unlit wall shows its colour.
        assert_near(middle(&dir, [15, 12]), [0.8, 0.1, 0.1].map(srgb));
        assert_near(middle(&dir, [15, 36]), [0.5; 3]);
        assert_near(middle(&dir, [15, 24]), [0.5; 3]);
    }
}

/// A grey wall is inside a ball of splats, which must light the wall only with `from_splats`. The
/// near plane removes the splats in front of the wall.
#[test]
fn splats_light_meshes_only_if_asked() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = glb(&ball(Vec3::ZERO, 3.0, [0.8, 0.4, 0.2]), [0.0, 0.0, 0.0, 1.0], 1.0).unwrap();
    let diffuse = serde_json::json!({
        "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1.0], "metallicFactor": 0.0},
        "extensions": {"KHR_materials_specular": {"specularFactor": 0.0}},
    });
    std::fs::write(folder.path().join("a.glb"), with_wall(&bytes, diffuse)).unwrap();
    let window = "[window]\nfrom = \"given\"\ncentre = [0, 0, 0]\nforward = [0, 0, -1]\nup = [0, 1, 0]\nwidth = 4.0\nnear = 1.0\n\
                  fit_depth = \"off\"\n";
    let lit = |from_splats: bool| {
        let dir = folder.path().join(from_splats.to_string());
        let light = format!("[light]\nautomatic = false\nfrom_splats = {from_splats}\n");
        run_quietly(&job(folder.path(), "a.glb", &format!("{window}{light}")), &dir);
        middle(&dir, [15, 24])
    };
    assert_near(lit(false), [0.0; 3]);
    // The wall scatters half of the splats' light, which is the same from all directions.
    assert_near(lit(true), [0.8, 0.4, 0.2].map(|value| 0.5 * srgb(value)));
}

/// Adds a wall with this material, in the plane z = 0, to a document.
fn with_wall(document: &[u8], material: serde_json::Value) -> Vec<u8> {
    // A binary glTF file has a JSON chunk and a binary chunk.
    let length = u32::from_le_bytes(document[12..16].try_into().unwrap()) as usize;
    let mut json: serde_json::Value = serde_json::from_slice(&document[20..20 + length]).unwrap();
    let mut bin = document[28 + length..].to_vec();
    let start = bin.len();
    let corners: [[f32; 3]; 4] = [[-3.0, -2.0, 0.0], [3.0, -2.0, 0.0], [-3.0, 2.0, 0.0], [3.0, 2.0, 0.0]];
    bin.extend(corners.as_flattened().iter().flat_map(|value| value.to_le_bytes()));
    let push = |list: &mut serde_json::Value, value: serde_json::Value| {
        let list = list.as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    };
    // Append the corners as a buffer view, an accessor, a mesh and a node.
    let view = push(
        &mut json["bufferViews"],
        serde_json::json!({"buffer": 0, "byteOffset": start, "byteLength": bin.len() - start}),
    );
    let accessor = push(
        &mut json["accessors"],
        serde_json::json!({"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"}),
    );
    let extensions = material["extensions"].as_object().unwrap().keys().cloned();
    json["extensionsUsed"] = std::iter::once("KHR_gaussian_splatting".to_owned()).chain(extensions).collect();
    json["materials"] = serde_json::json!([material]);
    push(
        &mut json["meshes"],
        serde_json::json!({"primitives": [{"mode": 5, "material": 0, "attributes": {"POSITION": accessor}}]}),
    );
    push(&mut json["nodes"], serde_json::json!({"mesh": 1}));
    json["scenes"][0]["nodes"] = serde_json::json!([0, 1]);
    json["buffers"][0]["byteLength"] = bin.len().into();
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &bin)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend_from_slice(kind);
        file.extend_from_slice(chunk);
    }
    file
}

#[test]
fn a_crop_is_applied_to_splats_of_any_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = ball(Vec3::ZERO, 1.0, [0.9, 0.5, 0.2]);
    let second = ball(Vec3::new(5.0, 0.0, 0.0), 1.0, [0.1, 0.2, 0.9]);
    capture.positions.extend(second.positions);
    capture.rotations.extend(second.rotations);
    capture.scales.extend(second.scales);
    capture.opacities.extend(second.opacities);
    capture.harmonics.extend(second.harmonics);
    std::fs::write(folder.path().join("a.glb"), glb(&capture, [0.0, 0.0, 0.0, 1.0], 1.0).unwrap()).unwrap();
    let job = job(folder.path(), "a.glb", "[pose]\ncrop_sphere = [0.0, 0.0, 0.0, 2.0]\n[light]\ntone = \"linear\"\n");
    let dir = folder.path().join("run");
    run_quietly(&job, &dir);
    // The window frames the splats that remain, so its centre is the centre of the first ball.
    assert_near(middle(&dir, [15, 24]), [0.9, 0.5, 0.2].map(srgb));

    let wrong = Job::load(&folder.path().join("job.toml")).unwrap().with("pose.crop_sphere", [0.0; 4].into());
    let error = wrong.unwrap_err().to_string();
    assert!(error.contains("pose.crop_sphere: expected a finite centre and a radius above 0"), "{error}");
}
