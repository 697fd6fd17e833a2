//! Tests the committed scenes. They have the bytes that the generator writes, a valid structure and
//! the right camera, and the views show only intended surfaces.

mod reader;

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use crate::window::{WINDOW_HEIGHT_M, WINDOW_WIDTH_M, Window};
use crate::{glass, letters, still_life, write_scenes};
use reader::{Scene, Triangle};

/// Largest slope of a view for which the scenes are made: the outermost of five views over 48
/// degrees, 0.8 tan 24 degrees.
const LARGEST_SLOPE: f64 = 0.357;
/// Largest size of all files that the generator writes, bytes.
const BYTE_BUDGET: usize = 4_000_000;
/// Tolerance for lengths: files store lengths with nine decimals of a metre, and angles with nine
/// decimals of a radian.
const LENGTH_TOLERANCE_M: f64 = 1e-7;

const WINDOWS: [(&str, Window); 3] =
    [("still-life", still_life::WINDOW), ("letters", letters::WINDOW), ("glass", glass::WINDOW)];

/// Scenes of splats, which have neither meshes nor a camera.
const SPLATS: [&str; 1] = ["dandelion"];

fn committed_folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Extensions of files in a scene's folder that the generator does not write: job files, and USD
/// (by `to_usd.py`).
const OTHERS: [&str; 4] = ["toml", "usda", "usdc", "usdz"];

/// Returns the files of a scene's folder by name, without files whose extensions are in [`OTHERS`].
fn files_in(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    std::fs::read_dir(folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.expect("the folder can be listed").path())
        .filter(|path| path.extension().is_none_or(|extension| OTHERS.iter().all(|other| extension != *other)))
        .map(|path| {
            let name = path.file_name().expect("an entry has a name").to_string_lossy().into_owned();
            let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
            (name, bytes)
        })
        .collect()
}

fn committed_scene(name: &str) -> Scene {
    Scene::read(files_in(&committed_folder().join(name)), &format!("{name}.gltf"))
}

#[test]
fn regenerating_gives_the_committed_bytes_of_every_scene() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let total = write_scenes(scratch.path()).expect("the scenes can be written");
    assert!(total < BYTE_BUDGET, "{total} bytes");
    let folders = std::fs::read_dir(scratch.path()).expect("the folder can be listed");
    let mut written: Vec<_> = folders.map(|entry| entry.expect("the folder can be listed").file_name()).collect();
    let mut expected: Vec<_> = WINDOWS.into_iter().map(|(name, _)| name).chain(SPLATS).collect();
    written.sort();
    expected.sort_unstable();
    assert_eq!(written, expected);
    for name in expected {
        let fresh = files_in(&scratch.path().join(name));
        let committed = files_in(&committed_folder().join(name));
        assert_eq!(
            fresh.keys().collect::<Vec<_>>(),
            committed.keys().collect::<Vec<_>>(),
            "files of {name}; run `cargo run -p lumistack-scene-generator`"
        );
        for (file, bytes) in &fresh {
            assert!(bytes == &committed[file], "{name}/{file} differs; run `cargo run -p lumistack-scene-generator`");
        }
    }
}

#[test]
fn structure_is_valid() {
    for (name, _) in WINDOWS {
        committed_scene(name).check_structure();
    }
}

#[test]
fn the_glass_scene_has_what_its_description_says() {
    let scene = committed_scene("glass");
    let primitives = scene.primitives();
    let with = |key: &str| primitives.iter().filter(|p| p.get(key).is_some()).count();
    assert_eq!(primitives.iter().filter(|p| p["mode"] == 5).count(), 1);
    assert_eq!(with("indices"), primitives.len() - 2, "the strip and the gem have no indices");
    let sparse = scene.list("accessors").iter().filter(|a| a.get("sparse").is_some()).count();
    assert_eq!(sparse, 2);
    let modes: Vec<_> = scene.list("materials").iter().filter_map(|m| m["alphaMode"].as_str()).collect();
    assert_eq!(modes.iter().filter(|m| **m == "BLEND").count(), 3);
    assert_eq!(modes.iter().filter(|m| **m == "MASK").count(), 1);
}

#[test]
fn the_camera_frames_the_window() {
    for (name, window) in WINDOWS {
        let scene = committed_scene(name);
        let camera = &scene.list("cameras")[0];
        let focus = camera["extras"]["lumistack"]["focus_distance"].as_f64().expect("a focus distance");
        let yfov = camera["perspective"]["yfov"].as_f64().expect("a field of view");
        let aspect = camera["perspective"]["aspectRatio"].as_f64().expect("an aspect ratio");
        let height = 2.0 * focus * (0.5 * yfov).tan();
        assert!((height - WINDOW_HEIGHT_M).abs() < LENGTH_TOLERANCE_M, "{name}: {height}");
        assert!((height * aspect - WINDOW_WIDTH_M).abs() < LENGTH_TOLERANCE_M, "{name}");
        let world_from_camera = scene.camera_transform();
        let middle = world_from_camera.transform_point3(DVec3::new(0.0, 0.0, -focus));
        assert!(middle.length() < LENGTH_TOLERANCE_M, "{name}: {middle}");
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let seen = world_from_camera.transform_vector3(axis);
            assert!((seen - window.world_from_display() * axis).length() < LENGTH_TOLERANCE_M, "{name}");
        }
    }
}

/// Returns rays from the viewer's side through 9 x 9 points of the window. Every point has a ray
/// for each of 5 x 5 slopes.
fn viewing_rays(window: &Window) -> Vec<(DVec3, DVec3)> {
    let world_from_display = window.world_from_display();
    let steps = |count: i32| (-count..=count).map(move |k| f64::from(k) / f64::from(count));
    let mut rays = Vec::new();
    for (sx, sy) in steps(2).flat_map(|x| steps(2).map(move |y| (x, y))) {
        for (px, py) in steps(4).flat_map(|x| steps(4).map(move |y| (x, y))) {
            let point = DVec3::new(0.5 * px * WINDOW_WIDTH_M, 0.5 * py * WINDOW_HEIGHT_M, 0.0);
            let towards_viewer = DVec3::new(LARGEST_SLOPE * sx, LARGEST_SLOPE * sy, 1.0);
            rays.push((world_from_display * (point + 2.0 * towards_viewer), world_from_display * -towards_viewer));
        }
    }
    rays
}

#[test]
fn no_view_sees_past_the_scene_or_into_a_lamp() {
    for (name, window) in WINDOWS {
        let triangles = committed_scene(name).world_triangles();
        assert!(triangles.len() > 1000, "{name}");
        for (origin, direction) in viewing_rays(&window) {
            let nearest = triangles
                .iter()
                .filter_map(|triangle| triangle.hit(origin, direction).map(|t| (t, triangle)))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let (_, hit) = nearest.unwrap_or_else(|| panic!("{name}: {origin} along {direction} hits nothing"));
            assert!(!hit.emissive, "{name}: {origin} along {direction} sees a lamp");
        }
    }
}

#[test]
fn nothing_stands_below_its_floor() {
    for name in ["still-life", "glass"] {
        let scene = committed_scene(name);
        let lowest = |triangles: &[Triangle]| {
            triangles.iter().flat_map(|t| t.corners).map(|p| p.y).fold(f64::INFINITY, f64::min)
        };
        let bottom = lowest(&scene.world_triangles());
        assert!((bottom + 0.09).abs() < LENGTH_TOLERANCE_M, "{name}: {bottom}");
    }
}

#[test]
fn depths_lie_on_both_sides_of_the_display_plane() {
    // The visible content must reach from at least 0.14 m behind the display plane to at least 0.08
    // m in front of it.
    for (name, window) in WINDOWS {
        let display_from_world = window.world_from_display().transpose();
        let (mut rearmost, mut foremost) = (0f64, 0f64);
        for triangle in committed_scene(name).world_triangles() {
            let corners = triangle.corners.map(|corner| display_from_world * corner);
            let inside = corners.iter().all(|p| p.x.abs() < 0.5 * WINDOW_WIDTH_M && p.y.abs() < 0.5 * WINDOW_HEIGHT_M);
            if inside {
                for corner in corners {
                    rearmost = rearmost.min(corner.z);
                    foremost = foremost.max(corner.z);
                }
            }
        }
        assert!((-0.20..-0.14).contains(&rearmost), "{name}: {rearmost}");
        assert!((0.08..0.13).contains(&foremost), "{name}: {foremost}");
    }
}
