//! Without any settings, a display shows a scene so that its content is visible. The program
//! chooses a side with content, light, a near plane that removes obstacles, and a depth that the
//! display can show.

use std::path::Path;

use lumistack_field_io::picture::Picture;
use serde_json::{Value, json};

use crate::common::{lumistack, number, succeed};

/// Returns a scene of cards of 2 × 2 units. The front of a card faces +z, before its translation
/// (x, y, z) and its rotation (x, y, z, w), as in glTF, are applied.
fn scene(cards: &[([f64; 3], [f64; 4])], change: impl FnOnce(&mut Value)) -> String {
    use base64::Engine as _;
    let mut bytes = Vec::new();
    for value in [-1.0f32, -1.0, 0.0, 1.0, -1.0, 0.0, 1.0, 1.0, 0.0, -1.0, 1.0, 0.0] {
        bytes.extend(value.to_le_bytes());
    }
    for index in [0u16, 1, 2, 0, 2, 3] {
        bytes.extend(index.to_le_bytes());
    }
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    let nodes: Vec<Value> = cards
        .iter()
        .map(|(translation, rotation)| json!({ "mesh": 0, "translation": translation, "rotation": rotation }))
        .collect();
    let mut document = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }], "nodes": nodes,
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": { "metallicFactor": 0, "baseColorFactor": [0.8, 0.6, 0.4, 1] } }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0] },
            { "bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR" },
        ],
        "bufferViews": [{ "buffer": 0, "byteLength": 48 }, { "buffer": 0, "byteOffset": 48, "byteLength": 12 }],
        "buffers": [{ "byteLength": 60, "uri": format!("data:application/octet-stream;base64,{data}") }],
    });
    change(&mut document);
    document.to_string()
}

const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
/// Rotation by 90° about −x, after which the front of a card faces upwards.
const LYING: [f64; 4] = [-std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2];

/// Renders a scene. Returns the messages, the settings in the light field's index, and the
/// brightest value and the mean of the middle view.
fn render(folder: &Path, scene: &str, flags: &[&str]) -> (String, Value, [f32; 2]) {
    let (file, views) = (folder.join("scene.gltf"), folder.join("views"));
    let _ = std::fs::remove_dir_all(&views);
    std::fs::write(&file, scene).unwrap();
    let small = ["--resolution", "60x38", "--samples", "4", "--max-bounces", "2"];
    let output = lumistack().arg("render").arg(&file).arg("-o").arg(&views).args(small).args(flags).output().unwrap();
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert!(output.status.success(), "{said}");
    let index: Value = serde_json::from_slice(&std::fs::read(views.join("lightfield.json")).unwrap()).unwrap();
    let info = if index["info"].is_null() { index } else { index["info"].clone() };
    let middle = Picture::read(&views.join("view_02_02.exr")).unwrap().into_linear();
    let brightest = middle.iter().copied().fold(0.0, f32::max);
    let mean = middle.iter().sum::<f32>() / middle.len() as f32;
    (said, info, [brightest, mean])
}

#[test]
fn a_board_is_seen_from_above_and_an_empty_picture_is_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let board = scene(&[([0.0; 3], LYING)], |_| {});
    let (said, info, [brightest, mean]) = render(folder.path(), &board, &[]);
    assert_eq!(info["look_from_deg"], json!([0.0, 40.0]), "{said}");
    assert!(!said.contains("no surface is seen") && brightest > 0.5 && mean > 0.15, "{said} {brightest} {mean}");
    let (said, info, _) = render(folder.path(), &board, &["--look-from=0,-30"]);
    assert_eq!(info["look_from_deg"], json!([0.0, -30.0]));
    assert!(said.contains("no surface is seen") && said.contains("--look-from"), "its back is culled: {said}");
    // `--look-from` overrides the camera of the file
    let with_camera = scene(&[([0.0; 3], UPRIGHT)], |document| {
        document["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1 } }]);
        document["nodes"].as_array_mut().unwrap().push(json!({ "camera": 0, "translation": [0, 0, 5] }));
        document["scenes"][0]["nodes"] = json!([0, 1]);
    });
    let (_, info, _) = render(folder.path(), &with_camera, &[]);
    assert!(info["look_from_deg"].is_null(), "{info}");
    let (_, info, _) = render(folder.path(), &with_camera, &["--look-from", "30,20"]);
    assert_eq!(info["look_from_deg"], json!([30.0, 20.0]));
}

#[test]
fn lamps_that_miss_the_visible_side_are_supplemented() {
    let folder = tempfile::tempdir().unwrap();
    let lit_from = |z: f64| {
        scene(&[([0.0; 3], UPRIGHT)], move |document| {
            // the lamp shines towards −z; with z < 0 it is behind the card and shines away from the
            // card
            document["extensionsUsed"] = json!(["KHR_lights_punctual"]);
            document["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
                { "type": "spot", "intensity": 40, "spot": { "outerConeAngle": 0.6 } }] } });
            let lamp = json!({ "translation": [0, 0, z], "extensions": { "KHR_lights_punctual": { "light": 0 } } });
            document["nodes"].as_array_mut().unwrap().push(lamp);
            document["scenes"][0]["nodes"] = json!([0, 1]);
        })
    };
    let (said, _, [brightest, mean]) = render(folder.path(), &lit_from(-3.0), &[]);
    assert!(said.contains("the scene's own lamps leave almost all visible surfaces dark"), "{said}");
    assert!(brightest > 0.4 && mean > 0.1, "{brightest} {mean}");
    let (said, _, [_, mean]) = render(folder.path(), &lit_from(4.0), &[]);
    assert!(!said.contains("the scene's own lamps leave") && mean > 0.1, "{said} {mean}");
}

/// The studio light is visible only as a dark background, and not as a bright environment.
#[test]
fn studio_light_is_no_bright_background() {
    let folder = tempfile::tempdir().unwrap();
    let card = scene(&[([0.0; 3], UPRIGHT)], |_| {});
    let (_, _, [brightest, _]) = render(folder.path(), &card, &[]);
    let views = folder.path().join("views");
    let middle = Picture::read(&views.join("view_02_02.exr")).unwrap().into_linear();
    let corner = &middle[..3];
    assert!(brightest > 0.6, "{brightest}");
    assert!(corner.iter().all(|&value| (0.003..0.12).contains(&value)), "{corner:?}");
    assert!(corner.iter().all(|&value| value == corner[0]), "neutral: {corner:?}");
}

/// Five cards stand in a diagonal row, over a depth of 12 units. By default their depth is
/// compressed into the display's depth of field, and one message reports this.
#[test]
fn depth_that_does_not_fit_is_fitted_by_default() {
    let folder = tempfile::tempdir().unwrap();
    let row: Vec<_> = (0..5).map(|i| ([f64::from(i) - 2.0, 0.0, -3.0 * f64::from(i)], UPRIGHT)).collect();
    let deep = scene(&row, |_| {});
    let (said, info, _) = render(folder.path(), &deep, &[]);
    let line = said.lines().find(|line| line.starts_with("Depth: ")).unwrap();
    assert!(line.contains("compressed to") && line.contains("fit_depth"), "{line}");
    assert!(number(&info, "depth_scale") < 0.5);
    let (said, info, _) = render(folder.path(), &deep, &["--fit-depth=off"]);
    assert!(!said.contains("compressed to") && number(&info, "depth_scale") == 1.0, "{said}");
    assert!(said.contains("only"), "most of it does not fit: {said}");
    // if the depth of a scene fits, it is not changed
    let (said, info, _) = render(folder.path(), &scene(&[([0.0; 3], UPRIGHT)], |_| {}), &[]);
    assert!(
        !said.contains("compressed to") && !said.contains("was moved") && number(&info, "depth_scale") == 1.0,
        "{said}"
    );
}

/// A camera without focus stands 4 units in front of a card, and a backdrop is 400 units away. The
/// window is at the card, and not in the middle of the depths, where the card would be a speck. The
/// card keeps its parallax.
#[test]
fn a_far_backdrop_does_not_draw_the_window_away() {
    let folder = tempfile::tempdir().unwrap();
    let with = |backdrop: f64, focus: Option<f64>| {
        scene(&[([0.0; 3], UPRIGHT), ([0.0, 0.0, -backdrop], UPRIGHT)], |document| {
            document["nodes"][1]["scale"] = json!([backdrop, backdrop, 1.0]);
            document["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1 } }]);
            if let Some(distance) = focus {
                document["cameras"][0]["extras"] = json!({ "lumistack": { "focus_distance": distance } });
            }
            document["nodes"].as_array_mut().unwrap().push(json!({ "camera": 0, "translation": [0, 0, 4] }));
            document["scenes"][0]["nodes"] = json!([0, 1, 2]);
        })
    };
    let depth = |document: &str| {
        let (said, info, _) = render(folder.path(), document, &["--json"]);
        let mut done = said.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let done = done.rfind(|event| event["event"] == "done").unwrap();
        (said, number(&info, "depth_scale"), number(&done["depth"], "inside"))
    };
    // The card covers about a fifth of the picture. A window at the backdrop would show the
    // backdrop sharply, but the card as a speck.
    let (said, scale, inside) = depth(&with(396.0, None));
    assert!(scale == 1.0 && (0.15..0.3).contains(&inside), "{scale} {inside} {said}");
    assert!(said.contains("up to 400 scene units") && said.contains("Focus on Object"), "{said}");
    // if the file states a focus distance, the message suggests no other focus; the backdrop still
    // does not fit
    let (said, scale, inside) = depth(&with(396.0, Some(4.0)));
    assert!(scale == 1.0 && (0.15..0.3).contains(&inside), "{scale} {inside} {said}");
    assert!(said.contains("stay outside the depth of field") && !said.contains("Focus on Object"), "{said}");
    // a backdrop near the card causes neither message
    let (said, ..) = depth(&with(2.0, None));
    assert!(!said.contains("Focus on Object") && !said.contains("stay outside the depth of field"), "{said}");
}

/// A run reports a camera and lights that the file lacks, and their replacements.
#[test]
fn a_run_reports_what_the_file_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("card.gltf");
    std::fs::write(&file, scene(&[([0.0; 3], UPRIGHT)], |_| {})).unwrap();
    let run = |options: &[&str]| {
        let small = ["--resolution", "32x20", "--views", "3x3", "--samples", "1", "--iterations", "2", "--frames", "2"];
        let mut command = lumistack();
        command.arg("run").arg(&file).arg("-o").arg(folder.path().join("run")).args(small).args(options);
        succeed(&mut command)
    };
    let text = run(&[]);
    for part in ["Scene: no camera in the file", "Scene: no lights in the file", "Punctual Lights"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let text = run(&["--look-from", "10,5"]);
    assert!(!text.contains("no camera") && text.contains("no lights"), "{text}");
    let text = succeed(lumistack().arg("info").arg(&file));
    assert!(text.contains("no camera in the file") && text.contains("no lights in the file"), "{text}");
}

/// A card behind the camera would hide all other content in oblique views. So the views start at
/// the camera's near plane, and the card is not visible.
#[test]
fn content_behind_the_camera_is_hidden() {
    let folder = tempfile::tempdir().unwrap();
    let document = scene(&[([0.0; 3], UPRIGHT), ([0.0, 0.0, 9.0], UPRIGHT)], |document| {
        document["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.3, "znear": 0.5 },
            "extras": { "lumistack": { "focus_distance": 5.0 } } }]);
        document["nodes"].as_array_mut().unwrap().push(json!({ "camera": 0, "translation": [0, 0, 5] }));
        document["scenes"][0]["nodes"] = json!([0, 1, 2]);
    });
    // If the near plane does not hide the card 9 units in front of the window, its depth on the
    // display is several metres.
    let depth = |flags: &[&str]| {
        let said = render(folder.path(), &document, &[&["--json", "--fit-depth=off"], flags].concat()).0;
        let mut done = said.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let done = done.rfind(|event| event["event"] == "done").unwrap();
        number(&done["depth"]["depth_mm"], "p98")
    };
    assert!(depth(&[]).abs() < 1.0);
    assert!(depth(&["--near", "6"]).abs() < 1.0);
    assert!(depth(&["--near", "off"]) > 1000.0);
    assert!(depth(&["--near", "9.5"]) > 1000.0);
}
