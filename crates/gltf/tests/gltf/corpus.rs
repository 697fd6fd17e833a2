//! Files of other projects: sample assets, which load, and hostile files, which must do no harm.
//! Also the scenes of this project.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::support::{Builder, Folder, assets, load_file, load_with, workspace};
use glam::Vec3;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_gltf::{GltfError, LoadOptions};
use lumistack_scene::Scene;
use serde_json::{Value, json};

/// Longest time in which any file of the corpus is loaded or refused.
const MAX_LOAD_TIME: Duration = Duration::from_secs(20);

/// Numbers of triangles of files, including copies. The numbers are from the corpus' own inventory,
/// unless a comment says otherwise.
const TRIANGLES: [(&str, usize); 25] = [
    ("BoxMeshopt/BoxMeshopt.glb", 12),
    ("BoxMeshopt/BoxMeshopt.gltf", 12),
    // the inventory has 36446, since it includes triangles without area
    ("jet-fighter/jet-fighter.glb", 36440),
    ("AttenuationTest/AttenuationTest.glb", 292),
    ("Box/Box.glb", 12),
    ("Box/Box.gltf", 12),
    ("BoxTextured/BoxTextured.gltf", 12),
    ("BoxTextured-Embedded/BoxTextured.gltf", 12),
    ("BoxVertexColors/BoxVertexColors.glb", 12),
    ("Cameras/Cameras.gltf", 2),
    ("ClearCoatTest/ClearCoatTest.glb", 37116),
    ("CornellBox/CornellBox.glb", 36),
    ("Cube/Cube.gltf", 12),
    ("FlightHelmet/FlightHelmet.gltf", 94722),
    ("Fox/Fox.glb", 576),
    ("Iray-extensions/issue-261.gltf", 12),
    ("Lights/Lights.glb", 12),
    ("MorphStressTest/MorphStressTest.gltf", 2412),
    ("SimpleSkin/SimpleSkin.gltf", 8),
    ("TextureTransformTest/TextureTransformTest.gltf", 24),
    ("TransmissionRoughnessTest/TransmissionRoughnessTest.glb", 77792),
    ("TransmissionRoughnessTest-quantized/TransmissionRoughnessTest-quantized.glb", 77792),
    ("many-cubes/many-cubes.gltf", 6012),
    // 125 copies of 12 triangles
    ("simple-instancing/simple-instancing.glb", 1500),
    // the inventory has 121496, since it includes triangles without area
    ("2CylinderEngine/2CylinderEngine.glb", 110_336),
];

fn gltf_files(folder: &Path) -> Vec<(String, PathBuf)> {
    let mut files = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(directory) = open.pop() {
        for entry in std::fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") {
                files.push((path.strip_prefix(folder).unwrap().display().to_string(), path));
            }
        }
    }
    files.sort();
    files
}

fn timed<T>(name: &str, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    assert!(start.elapsed() < MAX_LOAD_TIME, "{name} took {:?}", start.elapsed());
    result
}

#[test]
fn sample_assets_load_or_are_refused_for_their_extensions() {
    let Some(folder) = assets("gltf") else { return };
    for (name, path) in gltf_files(&folder) {
        let start = Instant::now();
        let (result, warnings) = timed(&name, || load_file(&path));
        match &result {
            Ok(scene) => println!(
                "{name}: {} triangles, {} instances of {} meshes, {} images, {} lights, {} cameras, {} warnings, {:.0?}",
                scene.triangle_count(),
                scene.instances.len(),
                scene.meshes.len(),
                scene.images.len(),
                scene.lights.len(),
                scene.cameras.len(),
                warnings.len(),
                start.elapsed(),
            ),
            Err(error) => println!("{error} ({name})"),
        }
        if let Some((_, expected)) = TRIANGLES.iter().find(|(file, _)| *file == name) {
            assert_eq!(result.unwrap().triangle_count(), *expected, "{name}");
        } else if let Some(rest) = name.split("Mesh_PrimitiveMode_").nth(2) {
            check_primitive_mode(rest[..2].parse().unwrap(), result);
        }
    }
}

/// Checks a file of glTF-Asset-Generator by its number. Files 0 to 6 have the modes 0 to 6 without
/// indices, and files 7 to 13 with indices. The last two files have other sizes of indices. Modes
/// that make triangles show a unit square that faces +z.
fn check_primitive_mode(file: usize, result: Result<Scene, GltfError>) {
    if file % 7 < 4 && file < 14 {
        assert!(result.unwrap_err().to_string().contains("at least one triangle"));
        return;
    }
    let scene = result.unwrap();
    assert_eq!((scene.triangle_count(), scene.bounds().size()), (2, Vec3::new(1.0, 1.0, 0.0)), "mode {file}");
    assert!(scene.meshes[0].normals.iter().all(|&normal| normal == Vec3::Z), "mode {file}");
}

#[test]
fn quantized_and_plain_meshes_are_the_same_surface() {
    let Some(folder) = assets("gltf") else { return };
    let plain = load_file(&folder.join("TransmissionRoughnessTest/TransmissionRoughnessTest.glb")).0.unwrap();
    let name = "TransmissionRoughnessTest-quantized/TransmissionRoughnessTest-quantized.glb";
    let quantized = load_file(&folder.join(name)).0.unwrap();
    // quantized positions have 14 bits over an extent of 2
    let tolerance = 2.0 / 16384.0;
    let corners = |scene: &Scene| -> Vec<Vec3> {
        let placed = scene.instances.iter().flat_map(|instance| {
            let mesh = &scene.meshes[instance.mesh];
            let corner = |&i: &u32| instance.scene_from_mesh.transform_point3(mesh.positions[i as usize]);
            mesh.triangles.as_flattened().iter().map(corner).collect::<Vec<_>>()
        });
        placed.collect()
    };
    let mut largest = 0.0f32;
    for (a, b) in corners(&plain).into_iter().zip(corners(&quantized)) {
        largest = largest.max((a - b).abs().max_element());
    }
    println!("largest difference {largest}");
    assert!(largest < tolerance && largest > 0.0);
}

/// Error codes of the Khronos validator that do not change the picture, with the reason. A file
/// with no other errors loads, unless [`STRICT`] lists it.
const HARMLESS: [(&str, &str); 32] = [
    ("ACCESSOR_ANIMATION_INPUT_NEGATIVE", "values hold before the first key, wherever it is"),
    ("ACCESSOR_ANIMATION_SAMPLER_OUTPUT_NON_NORMALIZED_QUATERNION", "made unit length"),
    ("ACCESSOR_ELEMENT_OUT_OF_MAX_BOUND", "stated bounds are not read"),
    ("ACCESSOR_ELEMENT_OUT_OF_MIN_BOUND", "stated bounds are not read"),
    ("ACCESSOR_INVALID_IBM", "any affine part of an inverse bind matrix is applied"),
    ("ACCESSOR_INVALID_SIGN", "only the sign of the handedness is used"),
    ("ACCESSOR_MAX_MISMATCH", "stated bounds are not read"),
    ("ACCESSOR_MIN_MISMATCH", "stated bounds are not read"),
    ("ACCESSOR_NON_CLAMPED", "clamped, with a warning"),
    ("ACCESSOR_OFFSET_ALIGNMENT", "bytes are read one by one"),
    ("ACCESSOR_TOTAL_OFFSET_ALIGNMENT", "bytes are read one by one"),
    ("ACCESSOR_VECTOR3_NON_UNIT", "made unit length"),
    ("BUFFER_DATA_URI_MIME_TYPE_INVALID", "the stated media type is not read"),
    ("BUFFER_VIEW_INVALID_BYTE_STRIDE", "a larger stride is applied if the elements fit; each stride has a warning"),
    ("BUFFER_VIEW_TARGET_OVERRIDE", "targets are hints for graphics cards"),
    ("CAMERA_ZFAR_LEQUAL_ZNEAR", "nothing is clipped"),
    ("DUPLICATE_ELEMENTS", "an extension that is named twice is still one"),
    ("EMPTY_ENTITY", "an empty list means the same as none"),
    ("GLB_CHUNK_LENGTH_UNALIGNED", "bytes are read one by one"),
    ("IMAGE_BUFFER_VIEW_WITH_BYTESTRIDE", "the bytes of a picture are all bytes of its view"),
    ("IMAGE_MIME_TYPE_INVALID", "the content decides the format"),
    ("MESH_PRIMITIVES_UNEQUAL_TARGETS_COUNT", "a weight without a target moves nothing"),
    ("MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_UNSIGNED_INT", "attributes of this type are not read"),
    ("MESH_PRIMITIVE_INDEXED_SEMANTIC_CONTINUITY", "every set is read by its own number"),
    ("MESH_PRIMITIVE_INDICES_ACCESSOR_WITH_BYTESTRIDE", "a larger stride is applied if the indices fit"),
    ("MESH_PRIMITIVE_INVALID_ATTRIBUTE", "unknown attributes are not read"),
    ("MESH_PRIMITIVE_MORPH_TARGET_NO_BASE_ACCESSOR", "a delta without a base moves nothing"),
    ("MESH_PRIMITIVE_TOO_FEW_TEXCOORDS", "the missing coordinates read (0, 0), with a warning"),
    ("NODE_PARENT_OVERRIDE", "the node stays with its first parent, with a warning"),
    ("NODE_MATRIX_TRS", "the matrix is used, with a warning"),
    ("UNSATISFIED_DEPENDENCY", "skin or weights without a mesh, undeclared extensions: no effect"),
    ("VALUE_MULTIPLE_OF", "the multiple of a stride does not matter: bytes are read one by one"),
];

/// Loads a file at the time of 0.5 s, so that its animations are read too.
fn load_posed(bytes: &[u8], resolver: &Folder) -> Result<Scene, GltfError> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let options = LoadOptions { time_s: Some(0.5), ..LoadOptions::default() };
    lumistack_gltf::load_with("test.gltf", bytes, resolver, &options, Task::quiet(&warnings, &cancel))
}

/// Returns the error codes in the validator's report on a file.
fn verdict(path: &Path) -> Option<Vec<String>> {
    let report = std::fs::read(path.with_added_extension("report.json")).ok()?;
    let report: Value = serde_json::from_slice(&report).unwrap();
    let messages = report.pointer("/issues/messages").and_then(Value::as_array);
    let errors = messages.into_iter().flatten().filter(|message| message["severity"] == 0);
    Some(errors.map(|message| message["code"].as_str().unwrap().to_owned()).collect())
}

/// Returns a `.gltf` file with a triangle added to its scene, so that only the file's defects can
/// be a reason to refuse it.
fn with_a_triangle(path: &Path) -> Option<Vec<u8>> {
    let file: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    let (mut b, [_, node]) = add_triangle(&file)?;
    let scene = b.json.get("scene").and_then(Value::as_u64).unwrap_or_default();
    // if a file has no scenes, every node without a parent is shown
    if let Some(scene) = b.json.pointer_mut(&format!("/scenes/{scene}")) {
        scene.as_object_mut()?.entry("nodes").or_insert_with(|| json!([])).as_array_mut()?.push(json!(node));
    }
    Some(b.json.to_string().into_bytes())
}

/// Files that are not refused for the error that the validator finds in them, and the reason why
/// this is right.
const LENIENT: [(&str, &str); 6] = [
    ("buffer/invalid_uri_data.glb", "shows nothing; its twin in JSON is refused when shown"),
    ("buffer/no_bin_chunk.glb", "shows nothing; a test in errors.rs shows a mesh with this defect, which is refused"),
    ("glb/bom.glb", "a byte order mark is skipped"),
    ("json/bom.gltf", "a byte order mark is skipped"),
    ("image/invalid_data_uri_mime_type.gltf", "the stated media type is wrong; the content decides the format"),
    ("root/extensions_non_objects.gltf", "extensions of this form are not read"),
];

/// Files that are refused although all of their errors are in [`HARMLESS`], and the reason.
const STRICT: [(&str, &str); 1] = [(
    "animation_data/quaternion_non_unit_values.gltf",
    "its times have no data and so are all zero, which the validator does not check",
)];

/// A file with a harmful validator error is refused, at the latest when the scene shows the object
/// that has the error. All other files load after a triangle was added to the scene, or are refused
/// only because they show nothing. [`LENIENT`] and [`STRICT`] list the exceptions.
#[test]
fn hostile_files_do_no_harm() {
    let Some(folder) = assets("hostile/gltf") else { return };
    let (mut loaded, mut refused) = (0, 0);
    let (mut disagreements, mut reasons) = (Vec::new(), Vec::new());
    for (name, path) in gltf_files(&folder) {
        let load = |bytes: &[u8]| timed(&name, || load_posed(bytes, &Folder::of(&path)));
        let bytes = std::fs::read(&path).unwrap();
        let result = load(&bytes);
        let text = result.as_ref().map_or_else(|error| error.to_string(), |_| "loads".to_owned());
        println!("{name}: {text}");
        reasons.extend(
            text.split_once("expected at least one triangle with area, found ").map(|(_, reason)| reason.to_owned()),
        );
        let Some(errors) = verdict(&path) else { continue };
        let is_harmless = |code: &String| HARMLESS.iter().any(|(known, _)| known == code);
        let is_sound = errors.iter().all(is_harmless) || LENIENT.iter().any(|(file, _)| name.ends_with(file));
        let shows_nothing = text.contains("expected at least one triangle");
        if is_sound {
            // most files show no triangle and are refused for that reason, so a triangle is added
            let shown = with_a_triangle(&path).map_or(result, |bytes| load(&bytes));
            loaded += 1;
            if let Err(error) = shown.as_ref().map_err(ToString::to_string)
                && !error.contains("expected at least one triangle")
                && !STRICT.iter().any(|(file, _)| name.ends_with(file))
            {
                disagreements.push(format!("{name} should load ({errors:?}): {error}"));
            }
        } else {
            refused += 1;
            let file = serde_json::from_slice::<Value>(&bytes).unwrap_or_default();
            let refusal = shown_in_turn(&file).iter().find_map(|(what, variant)| {
                load(variant.to_string().as_bytes()).err().map(|error| format!("{what}: {error}"))
            });
            if let Some(refusal) = &refusal {
                println!("    {refusal}");
            }
            if (result.is_ok() || shows_nothing) && refusal.is_none() {
                disagreements.push(format!("{name} should be refused ({errors:?}): {text}"));
            }
        }
    }
    println!("{loaded} load, {refused} refused");
    assert!(disagreements.is_empty(), "{disagreements:#?}");
    // every file that shows nothing has a reason, and together the files have more than 20 reasons
    assert!(reasons.iter().all(|reason| reason.starts_with("none: ")), "{reasons:#?}");
    let count = reasons.len();
    reasons.sort();
    reasons.dedup();
    println!("{count} files show nothing, for {} reasons", reasons.len());
    assert!(reasons.len() > 20, "{reasons:#?}");
    // these files show nothing or are broken, and the error must name the place
    let named = [
        ("assimp-BoxWithInfinites/BoxWithInfinites.glb", "/attributes/POSITION: expected finite numbers"),
        ("assimp-IndexOutOfRange/IndexOutOfRange.gltf", "/indices: expected vertex indices below 24, found 255"),
        ("assimp-MissingBin/BoxTextured.gltf", "/images/0/uri: expected a readable file"),
        ("assimp-RecursiveNodes/RecursiveNodes.gltf", "/nodes/0: expected a tree of nodes"),
        ("validator/glb/length_mismatch.glb", "byte 8: expected a file of 49 bytes, found 48"),
        ("validator/node/node_loop.gltf", "/nodes/0: expected a tree of nodes"),
        ("validator/node/unresolved_child_node.gltf", "/nodes/0/children/0: expected an index below 1, found 1"),
    ];
    for (name, expected) in named {
        let message = load_file(&folder.join(name)).0.unwrap_err().to_string();
        assert!(message.contains(expected), "{name}: {message}");
    }
}

/// Most hostile files have their defect in an object that no scene shows, so here each object is
/// shown in its own copy of the file.
#[test]
fn hostile_objects_do_no_harm_when_shown() {
    let Some(folder) = assets("hostile/gltf") else { return };
    let (mut loaded, mut refused) = (0, 0);
    let mut messages = Vec::new();
    for (name, path) in gltf_files(&folder) {
        let Ok(file) = serde_json::from_slice::<Value>(&std::fs::read(&path).unwrap()) else { continue };
        for (what, variant) in shown_in_turn(&file) {
            let text = variant.to_string();
            let (result, _) = timed(&name, || load_with(text.as_bytes(), &Folder::of(&path)));
            match result {
                Ok(_) => loaded += 1,
                Err(error) => {
                    refused += 1;
                    messages.push(format!("{name} {what}: {error}"));
                }
            }
        }
    }
    messages.iter().for_each(|message| println!("{message}"));
    println!("{loaded} load, {refused} refused");
    // [`add_triangle`] appends entries, so an index just past the end of a list is valid here;
    // other tests check such indices
    for (file, expected) in [
        ("mesh/accessor_unequal_count", "/attributes/COLOR_0: expected"),
        ("mesh/position_accessor_invalid_format", "/attributes/POSITION: expected VEC3"),
        ("accessor/small_stride", "byteStride: expected at least"),
        ("mesh_data/index_buffer_oob", "/indices: expected vertex indices below"),
        ("node/unresolved_skin", "/skin: expected"),
        ("image/unrecognized_format", "expected a PNG, JPEG, WebP or KTX2 picture"),
        ("buffer/not_found", "/buffers/0/uri: expected a readable file"),
    ] {
        let is_named = messages.iter().any(|message| message.contains(file) && message.contains(expected));
        let of_file: Vec<_> = messages.iter().filter(|message| message.contains(file)).collect();
        assert!(is_named, "{file}: expected {expected}, found {of_file:#?}");
    }
}

/// Copies a file, and adds a mesh with one triangle and a node that has this mesh. The node is not
/// in any scene. Returns the copy, and the indices of mesh and node. `None` if a member that should
/// be a list is not one.
fn add_triangle(file: &Value) -> Option<(Builder, [usize; 2])> {
    let mut b = Builder { json: file.clone(), bin: Vec::new() };
    for list in ["scenes", "nodes", "meshes", "accessors", "bufferViews", "buffers", "materials", "textures"] {
        if b.json.get(list).is_some_and(|list| !list.is_array()) {
            return None;
        }
    }
    // a small buffer without data gets zeros, so that the objects that use it can be read
    let buffers = b.json.get_mut("buffers").and_then(Value::as_array_mut);
    for buffer in buffers.into_iter().flatten().filter_map(Value::as_object_mut) {
        let length = buffer.get("byteLength").and_then(Value::as_u64).filter(|&length| length <= 1 << 16);
        if let (Some(length), false) = (length, buffer.contains_key("uri")) {
            let zeros = "%00".repeat(length as usize);
            buffer.insert("uri".into(), json!(format!("data:,{zeros}")));
        }
    }
    let triangle = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let buffer = b.push("buffers", json!({"byteLength": 36, "uri": triangle}));
    let view = b.push("bufferViews", json!({"buffer": buffer, "byteLength": 36}));
    let positions = json!({"bufferView": view, "componentType": 5126, "type": "VEC3", "count": 3});
    let positions = b.push("accessors", positions);
    let mesh = b.push("meshes", json!({"primitives": [{"attributes": {"POSITION": positions}}]}));
    let node = b.push("nodes", json!({"mesh": mesh}));
    Some((b, [mesh, node]))
}

/// Returns copies of a file with an added triangle. Each copy uses one object of the file: a node
/// beside the triangle, a mesh instead of the triangle, or data that the triangle reads.
fn shown_in_turn(file: &Value) -> Vec<(String, Value)> {
    let count = |list: &str| file.get(list).and_then(Value::as_array).map_or(0, Vec::len);
    let mut variants = Vec::new();
    let mut show = |what: String, change: &dyn Fn(&mut Builder, Value)| {
        // a file with a member that should be a list, but is not one, is tested unchanged by
        // `hostile_files_do_no_harm`
        let Some((mut b, [mesh, node])) = add_triangle(file) else { return };
        let scene = b.push("scenes", json!({"nodes": [node]}));
        b.json["scene"] = json!(scene);
        change(&mut b, json!({"mesh": mesh, "node": node, "scene": scene}));
        variants.push((what, b.json));
    };
    for i in 0..count("meshes") {
        show(format!("mesh {i}"), &|b, at| _ = b.set(&format!("/nodes/{}/mesh", at["node"]), json!(i)));
    }
    for i in 0..count("nodes") {
        show(format!("node {i}"), &|b, at| {
            b.set(&format!("/scenes/{}/nodes", at["scene"]), json!([at["node"], i]));
            if b.json["nodes"][i].get("mesh").is_none() {
                b.json["nodes"][i]["mesh"] = json!(0);
            }
        });
    }
    for i in 0..count("accessors") {
        for attribute in ["POSITION", "NORMAL", "TANGENT", "TEXCOORD_0", "COLOR_0"] {
            show(format!("accessor {i} as {attribute}"), &|b, at| {
                b.set(&format!("/meshes/{}/primitives/0/attributes/{attribute}", at["mesh"]), json!(i));
            });
        }
        show(format!("accessor {i} as indices"), &|b, at| {
            b.set(&format!("/meshes/{}/primitives/0/indices", at["mesh"]), json!(i));
        });
    }
    for i in 0..count("images") {
        show(format!("image {i}"), &|b, at| {
            let texture = b.push("textures", json!({"source": i}));
            let material = b.push("materials", json!({"emissiveTexture": {"index": texture}}));
            b.set(&format!("/meshes/{}/primitives/0/material", at["mesh"]), json!(material));
        });
    }
    for i in 0..count("bufferViews") {
        show(format!("buffer view {i}"), &|b, at| {
            let accessor =
                b.push("accessors", json!({"bufferView": i, "componentType": 5121, "type": "SCALAR", "count": 1}));
            b.set(&format!("/meshes/{}/primitives/0/indices", at["mesh"]), json!(accessor));
        });
    }
    for i in 0..count("buffers") {
        show(format!("buffer {i}"), &|b, at| {
            let view = b.push("bufferViews", json!({"buffer": i, "byteLength": 1}));
            let accessor =
                b.push("accessors", json!({"bufferView": view, "componentType": 5121, "type": "SCALAR", "count": 1}));
            b.set(&format!("/meshes/{}/primitives/0/indices", at["mesh"]), json!(accessor));
        });
    }
    for i in 0..count("cameras") {
        show(format!("camera {i}"), &|b, at| _ = b.set(&format!("/nodes/{}/camera", at["node"]), json!(i)));
    }
    variants
}

#[test]
fn the_scenes_of_this_project_load_without_a_warning() {
    for name in ["still-life", "letters", "glass"] {
        let path = workspace().join(format!("scenes/{name}/{name}.gltf"));
        let resolver = Folder::of(&path);
        let (result, warnings) = load_with(&std::fs::read(&path).unwrap(), &resolver);
        let scene = result.unwrap();
        println!(
            "{name}: {} triangles, {} instances of {} meshes, {} images, reads {:?}",
            scene.triangle_count(),
            scene.instances.len(),
            scene.meshes.len(),
            scene.images.len(),
            resolver.read.borrow(),
        );
        assert_eq!(warnings, Vec::<String>::new(), "{name}");
        assert!(scene.environment.is_some() && scene.is_lit(), "{name}");
        assert!(scene.cameras[0].focus_distance.is_some_and(|distance| distance > 0.0), "{name}");
        assert!(scene.materials.iter().any(|material| material.base_color_texture.is_some()), "{name}");
        // the binary file, the sky and every picture must be read only once
        let mut read = resolver.read.borrow().clone();
        read.sort();
        let before = read.len();
        read.dedup();
        assert_eq!((read.len(), read.contains(&"sky.hdr".to_owned())), (before, true), "{name}");
    }
}
