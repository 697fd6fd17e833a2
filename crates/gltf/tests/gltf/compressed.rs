//! Compares compressed meshes and pictures with their sources. Encoders of other projects wrote the
//! compressed files (`data/make.mjs`).

use std::collections::BTreeMap;

use crate::support::{self, Builder, assets, load, load_choosing, scene, workspace};
use glam::{Vec2, Vec3};
use lumistack_gltf::LoadOptions;
use lumistack_scene::{Pixels, Scene};
use meshoptimizer_rs::Workspace;
use meshoptimizer_rs::codec::{VertexEncoding, encode_vertex_buffer};
use serde_json::json;

fn data(name: &str) -> Vec<u8> {
    std::fs::read(workspace().join("crates/gltf/tests/data").join(name)).unwrap()
}

/// The vertices of a grid (position, normal, texture coordinates), and its triangles. The key of a
/// vertex is twice its x and y, rounded, since the grid's spacing is one half. A triangle has the
/// keys of its corners, with the smallest key first.
type Grid = (BTreeMap<[i32; 2], (Vec3, Vec3, Vec2)>, Vec<[[i32; 2]; 3]>);

fn grid(scene: &Scene) -> Grid {
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 1));
    let (mesh, placed) = (&scene.meshes[0], &scene.instances[0].scene_from_mesh);
    let key = |i: u32| {
        let position = placed.transform_point3(mesh.positions[i as usize]);
        [(2.0 * position.x).round() as i32, (2.0 * position.y).round() as i32]
    };
    let vertices = (0..mesh.positions.len()).map(|i| {
        let position = placed.transform_point3(mesh.positions[i]);
        (key(i as u32), (position, mesh.normals[i], mesh.uvs[0][i]))
    });
    let mut triangles: Vec<[[i32; 2]; 3]> = mesh
        .triangles
        .iter()
        .map(|triangle| {
            let mut corners = triangle.map(key);
            let least = (0..3).min_by_key(|&i| corners[i]).unwrap();
            corners.rotate_left(least);
            corners
        })
        .collect();
    triangles.sort_unstable();
    (vertices.collect(), triangles)
}

/// Returns the grid before it was compressed.
fn plain() -> Grid {
    let grid = grid(&load(&data("grid.glb")).0.unwrap());
    assert_eq!((grid.0.len(), grid.1.len()), (20, 24));
    grid
}

fn assert_same(name: &str, tolerances: [f32; 3]) {
    let (result, warnings) = load(&data(name));
    let (vertices, triangles) = grid(&result.unwrap_or_else(|error| panic!("{name}: {error}")));
    assert_eq!(warnings.len(), 1, "expected only the warning that the file is animated: {warnings:?}");
    let (expected_vertices, expected_triangles) = plain();
    assert_eq!(triangles, expected_triangles, "{name}");
    assert!(vertices.keys().eq(expected_vertices.keys()), "{name}");
    let mut largest = [0.0f32; 3];
    for ((a, b, c), (position, normal, uv)) in vertices.values().zip(expected_vertices.values()) {
        let found = [a.distance(*position), b.distance(*normal), c.distance(*uv)];
        largest = std::array::from_fn(|i| largest[i].max(found[i]));
    }
    println!("{name}: position, normal and coordinates are off by at most {largest:?}");
    assert!((0..3).all(|i| largest[i] < tolerances[i]), "{name}: {largest:?}");
}

#[test]
fn draco_primitives_are_decoded() {
    // KHR_draco_mesh_compression: the tolerances follow from the bits. Positions have 14 bits over
    // the extent of the grid, normals have 10 bits, texture coordinates have 12 bits.
    for name in ["grid-draco-edgebreaker.glb", "grid-draco-sequential.glb"] {
        assert_same(name, [3e-4, 5e-3, 5e-4]);
    }
    let Some(folder) = assets("gltf") else { return };
    let (jet, warnings) = support::load_file(&folder.join("jet-fighter/jet-fighter.glb"));
    let jet = jet.unwrap();
    assert_eq!(jet.triangle_count(), 36440, "{warnings:?}");
    // print the bounds, for a comparison with the bounds before compression, which the file states
    let bounds = jet.bounds();
    println!("jet-fighter spans {} to {}", bounds.min, bounds.max);
}

#[test]
fn meshopt_views_are_unpacked() {
    // EXT_meshopt_compression: the files use the modes ATTRIBUTES and TRIANGLES, and the filters
    // OCTAHEDRAL and QUATERNION
    assert_same("grid-meshopt-quantize.glb", [2e-4, 5e-3, 2e-4]);
    assert_same("grid-meshopt-filter.glb", [2e-4, 2e-2, 2e-4]);
    for name in ["grid-meshopt-quantize.glb", "grid-meshopt-filter.glb"] {
        let options = LoadOptions { time_s: Some(0.5), ..LoadOptions::default() };
        let turned = load_choosing(&data(name), &options).0.unwrap().instances[0].scene_from_mesh;
        let plain = load_choosing(&data("grid.glb"), &options).0.unwrap().instances[0].scene_from_mesh;
        let x = turned.transform_vector3(Vec3::X).normalize();
        assert!(x.distance(plain.transform_vector3(Vec3::X).normalize()) < 1e-3, "{name}: {x}");
        // at this time, the node has made an eighth of a turn about z
        assert!(x.distance(Vec3::new(1.0, 1.0, 0.0).normalize()) < 1e-3, "{name}: {x}");
    }
    // only KHR_meshopt_compression allows the second version of the codec, but the reader accepts
    // that version under both names
    let mut b = Builder::triangle();
    let encoding = VertexEncoding::new(1, 2).unwrap();
    let mut workspace = Workspace::default();
    let packed = encode_vertex_buffer(&b.bin[..36], 3, 12, encoding, &mut workspace).unwrap();
    let packed = b.view(&packed);
    let source = b.json["bufferViews"][packed].clone();
    for name in ["KHR_meshopt_compression", "EXT_meshopt_compression"] {
        let mut b = b.clone();
        let extension = json!({"buffer": 0, "byteOffset": source["byteOffset"], "byteLength": source["byteLength"],
            "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"});
        // the view's own buffer, for readers without the extension, has no data
        let fallback = json!({"buffer": 1, "byteOffset": 0, "byteLength": 36, "extensions": {name: extension}});
        b.set("/bufferViews/0", fallback).set("/extensionsRequired", json!([name]));
        b.set("/buffers", json!([{"byteLength": b.bin.len()}, {"byteLength": 36}]));
        assert_eq!(scene(&b).meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
        for (field, value, expected) in [
            ("count", json!(4), "expected count × byteStride to be 36, the view's byteLength"),
            ("mode", json!("POINTS"), "expected ATTRIBUTES, TRIANGLES or INDICES"),
            ("filter", json!("BLUR"), "expected NONE, OCTAHEDRAL"),
            ("byteLength", json!(10), "expected a sound meshopt stream"),
            ("byteLength", json!(1000), "expected at most"),
            ("buffer", json!(7), "expected an index below 2"),
        ] {
            let mut broken = b.clone();
            broken.set(&format!("/bufferViews/0/extensions/{name}/{field}"), value);
            let message = support::error(&broken);
            assert!(message.contains(expected), "{field}: {message}");
        }
    }
}

#[test]
fn claims_that_no_stream_can_back_are_refused_before_memory_is_taken() {
    let mut b = Builder::triangle();
    let packed = b.view(&[0xA0; 64]);
    let offset = b.json["bufferViews"][packed]["byteOffset"].clone();
    let extension = json!({"buffer": 0, "byteOffset": offset, "byteLength": 64, "byteStride": 256, "count": 1 << 24,
        "mode": "ATTRIBUTES"});
    b.set("/bufferViews/0/byteLength", json!(1u64 << 32));
    b.set("/bufferViews/0/extensions", json!({"EXT_meshopt_compression": extension}));
    assert!(support::error(&b).contains("(1024 times the 64 packed bytes"), "{}", support::error(&b));
    // Draco: breaking any byte of the stream causes no panic
    let file = data("grid-draco-edgebreaker.glb");
    let view = file.windows(5).position(|bytes| bytes == b"DRACO").unwrap();
    for at in view..file.len() {
        for value in [0, 0x7F, 0xFF] {
            let mut broken = file.clone();
            broken[at] = value;
            let options = LoadOptions { max_decoded_bytes: 64 << 20, ..LoadOptions::default() };
            // the result may be an error or a scene
            _ = load_choosing(&broken, &options);
        }
    }
}

/// Returns a file with a triangle that shows a picture.
fn picture(bytes: &[u8]) -> Builder {
    let mut b = Builder::triangle();
    let view = b.view(bytes);
    b.push("images", json!({"bufferView": view, "mimeType": "image/ktx2"}));
    b.push("textures", json!({"extensions": {"KHR_texture_basisu": {"source": 0}}}));
    b.push("materials", json!({"emissiveTexture": {"index": 0}}));
    let uvs = b.floats("VEC2", &[0.0; 6]);
    b.set("/meshes/0/primitives/0/material", json!(0));
    b.set("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(uvs));
    b.set("/extensionsRequired", json!(["KHR_texture_basisu"]));
    b
}

#[test]
fn basis_pictures_are_decoded() {
    // KHR_texture_basisu. In ETC1S the colours of a block lie on one line in the space of colours,
    // so the tolerance of ETC1S is larger.
    for (name, tolerance) in [("etc1s", 24), ("uastc", 8), ("uastc-zstd", 8)] {
        let file = data(&format!("{name}.ktx2"));
        let scene = scene(&picture(&file));
        let image = &scene.images[0];
        assert_eq!((image.width, image.height), (20, 12));
        let Pixels::Rgba8(texels) = &image.pixels else { panic!() };
        let mut largest = 0;
        for (i, texel) in texels.iter().enumerate() {
            let (x, y) = (i % 20, i / 20);
            let expected = [40 + 8 * x, 200 - 10 * y, 90, if x < 10 { 255 } else { 128 }].map(|value| value as u8);
            largest = (0..4).fold(largest, |largest, c| largest.max(texel[c].abs_diff(expected[c])));
        }
        println!("{name}: off by at most {largest}");
        assert!(largest <= tolerance, "{name}: {largest}");
        // The file is cut short, which must be an error. Then one byte after another is broken,
        // which gives an error or a picture, but no panic.
        for length in 0..file.len() {
            assert!(load(&picture(&file[..length]).glb()).0.is_err(), "{name} cut to {length}");
        }
        for at in 12..file.len() {
            for value in [0, 0x7F, 0xFF, file[at] ^ 1] {
                let mut broken = file.clone();
                broken[at] = value;
                _ = load(&picture(&broken).glb());
            }
        }
    }
    // the key/value data ends with an entry that is not padded, past which the decoder must not
    // read
    let mut noted = data("uastc.ktx2");
    noted.resize(noted.len().next_multiple_of(4), 0);
    let notes = [noted.len() as u32, 7].map(u32::to_le_bytes);
    noted[56..64].copy_from_slice(notes.as_flattened());
    noted.extend(b"\x03\0\0\0a\0b");
    assert_eq!(scene(&picture(&noted)).images[0].pixels, scene(&picture(&data("uastc.ktx2"))).images[0].pixels);
    let mut wide = data("uastc.ktx2");
    wide[20..24].copy_from_slice(&40_000u32.to_le_bytes());
    assert!(support::error(&picture(&wide)).contains("expected a KTX2 picture with 1 to 32768 texels a side"));
    let mut plain = data("uastc.ktx2");
    plain[12] = 37;
    assert!(support::error(&picture(&plain)).contains("found the Vulkan format 37"));
}
