//! Broken files: the error of each names the place, the expected value and the value found.

use crate::support::{Builder, F32, Memory, U8, U16, U32, error, load, load_choosing, load_with, png};
use lumistack_core::{Cancel, Cancelled, Collector, Task};
use lumistack_gltf::{GltfError, LoadOptions};
use serde_json::json;

/// Asserts an error's message. `expected` leaves out the file's name, with which every message
/// begins.
fn assert_error(builder: &Builder, expected: &str) {
    assert_eq!(error(builder), format!("test.gltf: {expected}"));
}

fn triangle_with(change: impl FnOnce(&mut Builder)) -> Builder {
    let mut builder = Builder::triangle();
    change(&mut builder);
    builder
}

/// Returns a triangle with a base colour texture; `image` is the JSON of its image.
fn textured(image: serde_json::Value) -> Builder {
    triangle_with(|b| {
        b.push("images", image);
        b.push("textures", json!({"source": 0}));
        b.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
        b.set("/meshes/0/primitives/0/material", json!(0));
        let uvs = b.floats("VEC2", &[0.0; 6]);
        b.set("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(uvs));
    })
}

#[test]
fn files_that_are_missing_or_too_short() {
    let triangle = Builder::triangle();
    let result = load(&triangle.gltf_with_buffer("missing%20file.bin")).0;
    let expected = "test.gltf: /buffers/0/uri: expected a readable file, found missing file.bin: No such file";
    assert_eq!(result.unwrap_err().to_string(), expected);

    let short = Memory(vec![("a.bin", vec![0; 20])]);
    let result = load_with(&triangle.gltf_with_buffer("a.bin"), &short).0;
    let expected =
        "test.gltf: /buffers/0/byteLength: expected at most 20 bytes, the length of the buffer's data, found 36";
    assert_eq!(result.unwrap_err().to_string(), expected);

    let expected = "/images/0/uri: expected a readable file, found missing.png: No such file";
    assert_error(&textured(json!({"uri": "missing.png"})), expected);

    let remote = load(&triangle.gltf_with_buffer("https://example.org/a.bin")).0.unwrap_err().to_string();
    let expected = "test.gltf: /buffers/0/uri: expected a path relative to the file, or a data URI, found \
                    https://example.org/a.bin";
    assert_eq!(remote, expected);

    let mut no_uri = serde_json::from_slice::<serde_json::Value>(&triangle.gltf()).unwrap();
    no_uri["buffers"][0].as_object_mut().unwrap().remove("uri");
    let message = load(no_uri.to_string().as_bytes()).0.unwrap_err().to_string();
    assert!(message.contains("/buffers/0/uri: expected a file, a data URI or the binary chunk"), "{message}");
}

#[test]
fn broken_pictures() {
    let uri = format!("data:image/png;base64,{}", "AAAA");
    let message = error(&textured(json!({"uri": uri})));
    let expected = "test.gltf: /images/0/uri: expected a PNG, JPEG, WebP or KTX2 picture, found 3 bytes";
    assert!(message.starts_with(expected), "{message}");

    let picture = png(2, &[[1, 2, 3, 4]; 4]);
    let mut builder = textured(json!({}));
    let view = builder.view(&picture[..picture.len() / 2]);
    builder.set("/images/0", json!({"bufferView": view, "mimeType": "image/png"}));
    let message = error(&builder);
    assert!(message.starts_with("test.gltf: /images/0/bufferView: expected a readable PNG picture"), "{message}");

    assert_error(&textured(json!({})), "/images/0: expected a uri or a bufferView, found neither");

    // the header states 60000 × 60000 texels, which is over the limit
    let mut huge = png(1, &[[0; 4]]);
    huge[16..24].copy_from_slice(&[0, 0, 0xEA, 0x60, 0, 0, 0xEA, 0x60]);
    let crc = crc32(&huge[12..29]);
    huge[29..33].copy_from_slice(&crc.to_be_bytes());
    let mut builder = textured(json!({}));
    let view = builder.view(&huge);
    builder.set("/images/0", json!({"bufferView": view}));
    let message = error(&builder);
    let expected = "a readable PNG picture of at most 32768 texels a side, found Image size exceeds limit";
    assert_eq!(message, format!("test.gltf: /images/0/bufferView: expected {expected}"));
}

/// Returns the checksum of PNG chunks (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 })
    })
}

#[test]
fn a_glb_shorter_than_its_header() {
    let mut file = Builder::triangle().glb();
    file[8..12].copy_from_slice(&11u32.to_le_bytes());
    let expected = "test.gltf: byte 8: expected a length of at least 12 bytes, the size of the header, found 11";
    assert_eq!(load(&file).0.unwrap_err().to_string(), expected);
}

#[test]
fn accessors_that_reach_past_their_bytes() {
    let b = triangle_with(|b| _ = b.set("/accessors/0/count", json!(4)));
    assert_error(
        &b,
        "/accessors/0/count: expected at most 3, the number of elements for which /bufferViews/0 has room, found 4",
    );
    let b = triangle_with(|b| _ = b.set("/accessors/0/count", json!(0)));
    assert_error(&b, "/accessors/0/count: expected a count from 1 to 4294967295, found 0");
    let b = triangle_with(|b| _ = b.set("/accessors/0/count", json!(u64::MAX)));
    assert_error(&b, "/accessors/0/count: expected a count from 1 to 4294967295, found 18446744073709551615");
    let b = triangle_with(|b| _ = b.set("/accessors/0/byteOffset", json!(u64::MAX)));
    let expected = "/accessors/0/byteOffset: expected at most 36, the length of /bufferViews/0 in bytes, found 18446744073709551615";
    assert_error(&b, expected);
    let b = triangle_with(|b| _ = b.set("/bufferViews/0/byteStride", json!(8)));
    assert_error(
        &b,
        "/bufferViews/0/byteStride: expected at least 12 bytes, the size of an element of /accessors/0, found 8",
    );
    let b = triangle_with(|b| _ = b.set("/bufferViews/0/byteLength", json!(37)));
    assert_error(
        &b,
        "/bufferViews/0/byteLength: expected at most 36 bytes, which buffer 0 has after byteOffset, found 37",
    );
    let b = triangle_with(|b| _ = b.set("/bufferViews/0/byteOffset", json!(u64::MAX)));
    assert_error(
        &b,
        "/bufferViews/0/byteLength: expected at most 0 bytes, which buffer 0 has after byteOffset, found 36",
    );
    // 2³² becomes 0 in the typed reader, so the reader has to compare the index as it is written
    let b = triangle_with(|b| _ = b.set("/bufferViews/0/buffer", json!(1u64 << 32)));
    assert_error(&b, "/bufferViews/0/buffer: expected an index below 1, found 4294967296");
    // an accessor without a buffer view has zeros, which take no space in the file, so its count is
    // limited
    let b = triangle_with(|b| {
        b.remove("/accessors/0/bufferView").set("/accessors/0/count", json!(4_000_000_000u64));
    });
    assert_error(&b, "/accessors/0/count: expected a count from 1 to 16777216, found 4000000000");
}

#[test]
fn accessors_of_the_wrong_kind() {
    let b = triangle_with(|b| _ = b.set("/accessors/0/type", json!("VEC2")));
    let expected = "/meshes/0/primitives/0/attributes/POSITION: expected VEC3 of FLOAT, or of 8- or 16-bit integers \
                    (KHR_mesh_quantization), found VEC2 of FLOAT (/accessors/0)";
    assert_error(&b, expected);
    let b = triangle_with(|b| _ = b.set("/accessors/0/componentType", json!(5124)));
    assert_error(&b, "/accessors/0/componentType: expected a value that glTF 2.0 defines, found 5124");
    let b = triangle_with(|b| _ = b.set("/accessors/0/type", json!("VEC9")));
    assert_error(&b, "/accessors/0/type: expected a value that glTF 2.0 defines, found \"VEC9\"");
    let b = triangle_with(|b| {
        let uvs = b.floats("VEC2", &[0.0; 4]);
        b.set("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(uvs));
    });
    let expected = "/meshes/0/primitives/0/attributes/TEXCOORD_0: expected 3 elements, as POSITION has, found 2";
    assert_error(&b, expected);
}

#[test]
fn indices_and_references_out_of_range() {
    for (component, bytes) in [(U8, vec![0, 1, 3]), (U16, vec![0, 0, 1, 0, 3, 0])] {
        let b = triangle_with(|b| {
            let indices = b.accessor(component, "SCALAR", 3, &bytes);
            b.set("/meshes/0/primitives/0/indices", json!(indices));
        });
        assert_error(&b, "/meshes/0/primitives/0/indices: expected vertex indices below 3, found 3 in element 2");
    }
    let b = triangle_with(|b| {
        let indices = b.accessor(U32, "SCALAR", 3, &[255; 12]);
        b.set("/meshes/0/primitives/0/indices", json!(indices));
    });
    assert_error(&b, "/meshes/0/primitives/0/indices: expected vertex indices below 3, found 4294967295 in element 0");
    let b = triangle_with(|b| _ = b.set("/nodes/0/mesh", json!(7)));
    assert_error(&b, "/nodes/0/mesh: expected an index below 1, found 7");
    let b = triangle_with(|b| _ = b.set("/meshes/0/primitives/0/material", json!(0)));
    assert_error(
        &b,
        "/meshes/0/primitives/0/material: expected no index, since the file has nothing to which the index could refer, found 0",
    );
    let b = triangle_with(|b| _ = b.set("/scene", json!(1)));
    assert_error(&b, "/scene: expected an index below 1, found 1");
}

#[test]
fn sparse_accessors() {
    let sparse = |indices: [u8; 2], count: u32| {
        triangle_with(|b| {
            let index_view = b.view(&indices);
            let value_view = b.view(&[0; 24]);
            b.set(
                "/accessors/0/sparse",
                json!({"count": count, "indices": {"bufferView": index_view, "componentType": U8}, "values": {"bufferView": value_view}}),
            );
        })
    };
    assert_error(&sparse([1, 1], 2), "/accessors/0/sparse/indices: expected indices that increase, found 1 before 1");
    assert_error(&sparse([1, 3], 2), "/accessors/0/sparse/indices: expected indices below 3, found 3");
    assert_error(
        &sparse([0, 1], 4),
        "/accessors/0/sparse/count: expected a count from 1 to 3, the accessor's count, found 4",
    );
    assert_error(
        &sparse([0, 1], 3),
        "/accessors/0/sparse/count: expected at most 2, the number of elements for which /bufferViews/1 has room, found 3",
    );
}

#[test]
fn numbers_that_are_not_finite() {
    let mut builder = Builder::triangle();
    builder.bin[16..20].copy_from_slice(&f32::NAN.to_le_bytes());
    let expected =
        "/meshes/0/primitives/0/attributes/POSITION: expected finite numbers, found [1.0, NaN, 0.0] in element 1";
    assert_error(&builder, expected);
    let b = triangle_with(|b| _ = b.set("/nodes/0/scale", json!([1e39, 1, 1])));
    assert!(error(&b).starts_with("test.gltf: /nodes/0: expected a finite placement"), "{}", error(&b));
}

#[test]
fn scenes_with_nothing_to_see() {
    let nothing = "expected at least one triangle with area, found none";
    assert_error(&Builder::new(), &format!("/nodes: {nothing}: the file has no nodes, and the file has no meshes"));
    let b = triangle_with(|b| _ = b.set("/scenes/0/nodes", json!([])));
    let reason = "the scene lists none of the file's nodes (count: 1), and no visible node has the file's mesh";
    assert_error(&b, &format!("/scenes/0: {nothing}: {reason}"));
    let b = triangle_with(|b| _ = b.set("/nodes/0", json!({"camera": 0})).push("cameras", json!({})));
    assert!(error(&b).contains("/cameras/0"), "{}", error(&b));
    let b = triangle_with(|b| _ = b.remove("/nodes/0/mesh"));
    let reason = "none of the scene's visible nodes (count: 1) has a mesh; meshes in the file: 1";
    assert_error(&b, &format!("/scenes/0: {nothing}: {reason}"));
    let hidden = json!({"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": false}}});
    let b = triangle_with(|b| _ = b.set("/nodes/0", hidden));
    assert!(error(&b).contains("every node that the scene lists is hidden"), "{}", error(&b));
    let b = triangle_with(|b| _ = b.set("/meshes/0/primitives", json!([])));
    assert_error(&b, &format!("/scenes/0: {nothing}: /meshes/0 has no primitives"));
    // there are several reasons, and the message states the first
    let primitives = json!([{"attributes": {"POSITION": 0}, "mode": 1}, {"attributes": {}}]);
    let b = triangle_with(|b| _ = b.set("/meshes/0/primitives", primitives));
    let reason = "/meshes/0/primitives/0: a primitive of lines has no surface and is left out (2 primitives are left out in all)";
    assert_error(&b, &format!("/scenes/0: {nothing}: {reason}"));
    // the message also names a defect of data that the scene does not use
    let b = triangle_with(|b| {
        b.set("/nodes/0", json!({}));
        b.set("/accessors/0/count", json!(4));
    });
    let reason = "none of the scene's visible nodes (count: 1) has a mesh; meshes in the file: 1; data that the scene does not use has a defect: \
                  /accessors/0/count: expected at most 3, the number of elements for which /bufferViews/0 has room, found 4";
    assert_error(&b, &format!("/scenes/0: {nothing}: {reason}"));
    let mut flat = Builder::triangle();
    flat.bin.fill(0);
    let (result, warnings) = load(&flat.glb());
    assert_eq!(
        result.unwrap_err().to_string(),
        format!("test.gltf: /scenes/0: {nothing}: the only triangle has no area")
    );
    assert_eq!(warnings, ["test.gltf: /meshes/0/primitives/0: triangles without area, which are left out: 1 of 1"]);
}

#[test]
fn hierarchies_that_are_no_trees() {
    let b = triangle_with(|b| {
        b.push("nodes", json!({"children": [2]}));
        b.push("nodes", json!({"children": [1]}));
    });
    assert_error(&b, "/nodes/1: expected a tree of nodes, found a node among its own ancestors");
    let b = triangle_with(|b| _ = b.set("/nodes/0/children", json!([0])));
    assert_error(&b, "/nodes/0: expected a tree of nodes, found a node among its own ancestors");
}

/// If the pictures in sum exceed the budget, none is decoded, although each alone would fit.
#[test]
fn pictures_are_counted_before_the_first_is_decoded() {
    let mut b = Builder::triangle();
    let sky = png(64, &[[7; 4]; 64 * 64]);
    let (first, second) = (b.view(&sky), b.view(&sky));
    // the first picture is cut off within its pixels, which would be an error if they were decoded
    b.set(&format!("/bufferViews/{first}/byteLength"), json!(60));
    for view in [first, second] {
        b.push("images", json!({"bufferView": view}));
    }
    b.push("textures", json!({"source": 0}));
    b.push("textures", json!({"source": 1}));
    let both = json!({"emissiveTexture": {"index": 0}, "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}});
    b.push("materials", both);
    b.set("/meshes/0/primitives/0/material", json!(0));
    let load = |max_picture_bytes: u64| {
        let options = LoadOptions { max_picture_bytes, ..LoadOptions::default() };
        load_choosing(&b.glb(), &options).0.unwrap_err().to_string()
    };
    let expected = "test.gltf: /images/0/bufferView: expected pictures that decode to at most 0 MiB together (the picture budget), \
                    found a picture of 64 × 64 texels, which needs 1 MiB in addition to the 0 MiB of earlier pictures";
    assert_eq!(load(2 * 64 * 64 * 4 - 1), expected);
    assert!(load(2 * 64 * 64 * 4).contains("/images/0/bufferView: expected a readable PNG picture"));
}

#[test]
fn structure_that_is_not_gltf() {
    let structure = |text: &str| load(text.as_bytes()).0.unwrap_err().to_string();
    assert_eq!(structure(""), "test.gltf: byte 0: expected a glTF file, found an empty file");
    assert_eq!(
        structure("solid cube"),
        "test.gltf: byte 0: expected a glTF file, which starts with { or glTF, found \"solid cube\""
    );
    let message = structure("{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [}");
    assert_eq!(message, "test.gltf: line 1 column 41: expected valid JSON, found an error: expected value");
    assert_eq!(structure("{}"), "test.gltf: /asset: expected a value, found nothing");
    let message = structure(r#"{"asset": {"version": "1.0"}}"#);
    assert_eq!(message, "test.gltf: /asset/version: expected 2.0, found \"1.0\"");
    let b = triangle_with(|b| _ = b.set("/accessors/0/count", json!("three")));
    assert_error(&b, "/accessors/0/count: expected a whole number ≥ 0, found string \"three\"");
    let b = triangle_with(|b| _ = b.remove("/meshes/0/primitives"));
    assert_error(&b, "/meshes/0/primitives: expected a value, found nothing");
    let deep = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"extras\": {}1", "[".repeat(100_000));
    assert!(structure(&deep).contains("recursion limit"), "{}", structure(&deep));
}

#[test]
fn enumerations_and_ranges() {
    let b = triangle_with(|b| _ = b.set("/meshes/0/primitives/0/mode", json!(7)));
    assert_error(&b, "/meshes/0/primitives/0/mode: expected a primitive mode (0 to 6), found 7");
    let b = triangle_with(|b| {
        b.push("materials", json!({"alphaMode": "GLASS"}));
        b.set("/meshes/0/primitives/0/material", json!(0));
    });
    assert_error(&b, "/materials/0/alphaMode: expected OPAQUE, MASK or BLEND, found \"GLASS\"");
    let b = triangle_with(|b| {
        b.push("cameras", json!({"type": "perspective", "perspective": {"yfov": 4.0, "znear": 0.1}}));
        b.set("/nodes/0/camera", json!(0));
    });
    assert_error(&b, "/cameras/0/perspective/yfov: expected a number between 0 and 3.1415927, found 4");
    let b = triangle_with(|b| _ = b.set("/nodes/0/rotation", json!([0, 0, 0, 0])));
    assert_error(
        &b,
        "/nodes/0/rotation: expected a quaternion that is finite and not zero, found [0.0, 0.0, 0.0, 0.0]",
    );
}

#[test]
fn environments_that_cannot_light() {
    let with = |environment: serde_json::Value| {
        triangle_with(|b| _ = b.set("/scenes/0/extras", json!({"lumistack": {"environment": environment}})))
    };
    let place = "/scenes/0/extras/lumistack/environment";
    let expected = format!("{place}/image: expected the path of a Radiance .hdr picture, found nothing");
    assert_error(&with(json!({"strength": 1})), &expected);
    let expected = format!("{place}/image: expected a readable file, found sky.hdr: No such file");
    assert_error(&with(json!({"image": "sky.hdr"})), &expected);
    let file = with(json!({"image": "sky.png"})).glb();
    let result = load_with(&file, &Memory(vec![("sky.png", png(1, &[[9; 4]]))])).0.unwrap_err().to_string();
    assert_eq!(result, format!("test.gltf: {place}/image: expected a Radiance HDR picture, found PNG"));
    let message = error(&with(json!({"image": "sky.hdr", "brightness": 1})));
    assert!(message.contains("expected an object with no members but image, strength, rotation"), "{message}");
}

#[test]
fn required_extensions() {
    for name in [
        "EXT_lights_image_based",
        "EXT_texture_avif",
        "KHR_animation_pointer",
        "KHR_audio_emitter",
        "KHR_materials_diffuse_transmission",
        "KHR_materials_volume_scatter",
        "KHR_techniques_webgl",
        "MSFT_texture_dds",
        "ACME_unheard_of",
    ] {
        let b = triangle_with(|b| _ = b.set("/extensionsRequired", json!(["KHR_mesh_quantization", name])));
        let error = load(&b.glb()).0.unwrap_err();
        let start = "test.gltf: /extensionsRequired/1: expected extensions that can be read (EXT_mesh_gpu_instancing, ";
        let message = error.to_string();
        assert!(message.starts_with(start) && message.contains(&format!("), found {name}")), "{message}");
        assert!(matches!(&error, GltfError::UnsupportedExtension { name: found, .. } if found == name));
        let b = triangle_with(|b| _ = b.set("/extensionsUsed", json!([name])));
        let (result, warnings) = load(&b.glb());
        assert!(result.is_ok() && warnings.len() == 1, "{warnings:?}");
        let start = format!("test.gltf: /extensionsUsed/0: {name} is not supported and has no effect");
        assert!(warnings[0].starts_with(&start), "{warnings:?}");
    }
    for name in ["KHR_node_hoverability", "KHR_node_selectability", "KHR_xmp", "KHR_xmp_json_ld"] {
        let b = triangle_with(|b| {
            b.set("/extensionsUsed", json!([name])).set("/extensionsRequired", json!([name]));
        });
        let (result, warnings) = load(&b.glb());
        assert!(result.is_ok() && warnings.is_empty(), "{warnings:?}");
    }
}

#[test]
fn copies_of_copies_do_not_exhaust_memory() {
    let mut builder = Builder::triangle();
    // a million copies of a mesh with two hundred primitives take no space in the file
    let offsets = builder.push("accessors", json!({"componentType": F32, "type": "VEC3", "count": 1 << 20}));
    builder.set("/meshes/0/primitives", json!(vec![json!({"attributes": {"POSITION": 0}}); 200]));
    let instancing = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": offsets}}});
    builder.set("/nodes/0/extensions", instancing);
    let message = error(&builder);
    let expected = "test.gltf: /nodes/0: expected a scene that decodes to at most 8192 MiB";
    assert!(message.starts_with(expected), "{message}");
}

/// Fifty thousand nodes show a mesh with twenty thousand primitives. The reader must not work on
/// every pair of node and primitive: a billion pairs would take minutes.
#[test]
fn nodes_that_share_a_large_mesh_take_no_time() {
    let mut builder = Builder::triangle();
    builder.set("/meshes/0/primitives", json!(vec![json!({"attributes": {"POSITION": 0}, "mode": 1}); 20_000]));
    builder.set("/nodes", json!(vec![json!({"mesh": 0}); 50_000]));
    builder.set("/scenes/0/nodes", json!((0..50_000).collect::<Vec<_>>()));
    let start = std::time::Instant::now();
    let message = error(&builder);
    assert!(message.contains("expected at least one triangle"), "{message}");
    assert!(start.elapsed().as_secs() < 10, "{:?}", start.elapsed());
}

#[test]
fn a_cancelled_load_says_so() {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    cancel.cancel();
    let task = Task::quiet(&warnings, &cancel);
    let result = lumistack_gltf::load("test.gltf", &Builder::triangle().glb(), &Memory(Vec::new()), task);
    assert_eq!(result.unwrap_err(), GltfError::Cancelled(Cancelled));
}
