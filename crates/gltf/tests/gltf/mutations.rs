//! Files that are cut short, and files with random bytes: they give an error or a scene, but never
//! a panic.

use std::panic::catch_unwind;
use std::time::{Duration, Instant};

use crate::support::{Builder, F32, I8, Memory, U8, U16, load, load_with, png};
use image::ImageFormat;
use lumistack_core::seed::derive;
use serde_json::json;

const SEED: u64 = 2012;

/// Longest time that one broken file of a few kilobytes may take.
const MAX_LOAD_TIME: Duration = Duration::from_secs(5);

/// Returns a file of a few kilobytes that uses many of the features that are read.
fn everything() -> Builder {
    let mut b = Builder::triangle();
    let indices = b.accessor(U16, "SCALAR", 3, &[0, 0, 1, 0, 2, 0]);
    let normals = b.accessor(I8, "VEC3", 3, &[0, 0, 127, 0, 0, 127, 0, 0, 127]);
    b.set(&format!("/accessors/{normals}/normalized"), json!(true));
    let uvs = b.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let colors = b.accessor(U8, "VEC4", 3, &[255; 12]);
    let joints = b.accessor(U8, "VEC4", 3, &[0; 12]);
    let weights = b.floats("VEC4", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    let tangents = b.floats("VEC4", &[1.0, 0.0, 0.0, 1.0].repeat(3));
    let (index_view, value_view) = (b.view(&[1]), b.view(&[0; 12]));
    let deltas = b.push(
        "accessors",
        json!({"componentType": F32, "type": "VEC3", "count": 3,
            "sparse": {"count": 1, "indices": {"bufferView": index_view, "componentType": U8}, "values": {"bufferView": value_view}}}),
    );
    let inverse_bind: Vec<f32> = glam::Mat4::IDENTITY.to_cols_array().to_vec();
    let inverse_bind = b.floats("MAT4", &inverse_bind);
    let offsets = b.floats("VEC3", &[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    let picture = b.view(&png(2, &[[200, 100, 50, 255]; 4]));
    b.push("images", json!({"bufferView": picture, "mimeType": "image/png"}));
    b.push("samplers", json!({"magFilter": 9728, "wrapS": 33071, "wrapT": 33648}));
    b.push("textures", json!({"source": 0, "sampler": 0}));
    let texture = json!({"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0.0], "rotation": 1.0}}});
    b.push(
        "materials",
        json!({"name": "paint", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true, "emissiveFactor": [1, 0.5, 0],
            "emissiveTexture": texture, "normalTexture": texture,
            "pbrMetallicRoughness": {"baseColorTexture": texture, "metallicRoughnessTexture": texture},
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}, "KHR_materials_ior": {"ior": 1.4},
                "KHR_materials_transmission": {"transmissionFactor": 0.5, "transmissionTexture": texture},
                "KHR_materials_volume": {"thicknessFactor": 1.0, "attenuationDistance": 2.0, "attenuationColor": [1, 0.9, 0.8]}}}),
    );
    let primitive = json!({"attributes": {"POSITION": 0, "NORMAL": normals, "TEXCOORD_0": uvs, "COLOR_0": colors, "TANGENT": tangents},
        "indices": indices, "material": 0, "mode": 5, "targets": [{"POSITION": deltas}]});
    let skinned = json!({"attributes": {"POSITION": 0, "JOINTS_0": joints, "WEIGHTS_0": weights}});
    b.set("/meshes/0", json!({"primitives": [primitive], "weights": [0.5]}));
    b.push("meshes", json!({"primitives": [skinned]}));
    b.push("skins", json!({"joints": [2], "inverseBindMatrices": inverse_bind}));
    b.set(
        "/nodes/0",
        json!({"mesh": 0, "camera": 0, "children": [1, 2],
        "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": offsets}}}}),
    );
    b.push("nodes", json!({"mesh": 1, "skin": 0, "matrix": [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]}));
    b.push(
        "nodes",
        json!({"translation": [1, 2, 3], "rotation": [0, 0, 0, 1], "scale": [1, 2, 1],
        "extensions": {"KHR_lights_punctual": {"light": 0}}}),
    );
    b.push(
        "cameras",
        json!({"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1},
        "extras": {"lumistack": {"focus_distance": 2.5}}}),
    );
    b.set(
        "/extensions",
        json!({"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {"outerConeAngle": 0.5}, "intensity": 3}]}}),
    );
    b.set("/extensionsUsed", json!(["KHR_lights_punctual", "EXT_mesh_gpu_instancing"]));
    b
}

/// Loads the bytes, and returns true if they give a scene. If the reader panics or takes too long,
/// the test fails with `what`, a description of the bytes.
fn survives(bytes: &[u8], what: &str) -> bool {
    let start = Instant::now();
    let result = catch_unwind(|| load(bytes).0.is_ok());
    assert!(start.elapsed() < MAX_LOAD_TIME, "{what} took {:?}", start.elapsed());
    result.unwrap_or_else(|_| panic!("{what} panicked"))
}

#[test]
fn the_whole_file_loads() {
    let (scene, warnings) = load(&everything().glb());
    let scene = scene.unwrap();
    assert_eq!(warnings, Vec::<String>::new());
    assert_eq!((scene.meshes.len(), scene.instances.len(), scene.lights.len(), scene.cameras.len()), (2, 3, 1, 1));
}

#[test]
fn a_file_cut_anywhere_is_refused() {
    let file = everything().glb();
    for length in 0..file.len() {
        assert!(!survives(&file[..length], &format!("cut to {length} bytes")), "cut to {length} bytes loads");
    }
}

#[test]
fn a_binary_chunk_cut_anywhere_is_survived() {
    // cut only the binary chunk, in a valid container; each accessor extends past the data at some
    // of the lengths
    let whole = everything();
    let json_length = whole.bin.len();
    for length in (0..json_length).step_by(3) {
        let mut cut = whole.clone();
        cut.bin.truncate(length);
        survives(&cut.glb(), &format!("binary chunk of {length} bytes"));
    }
}

#[test]
fn random_bytes_are_survived() {
    const FILES: u64 = 4000;
    let original = everything().glb();
    let mut loaded = 0;
    for file in 0..FILES {
        let mut bytes = original.clone();
        for change in 0..1 + derive(SEED, &[file, 1]) % 8 {
            let random = derive(SEED, &[file, 2, change]);
            let at = 12 + (random >> 16) as usize % (bytes.len() - 12);
            bytes[at] = if random & 1 == 0 { (random >> 8) as u8 } else { bytes[at] ^ (1 << ((random >> 8) & 7)) };
        }
        loaded += u32::from(survives(&bytes, &format!("mutation {file}")));
    }
    println!("{loaded} of {FILES} mutated files load");
}

#[test]
fn random_numbers_in_the_json_are_survived() {
    const FILES: u64 = 4000;
    const VALUES: [&str; 14] = [
        "-1",
        "0",
        "1",
        "2",
        "3",
        "7",
        "255",
        "65536",
        "4294967295",
        "4294967296",
        "18446744073709551615",
        "1e38",
        "-1e-40",
        "null",
    ];
    let original = String::from_utf8(everything().gltf()).unwrap();
    let (json, buffers) = original.split_once("\"buffers\"").unwrap();
    let is_number = |byte: u8| byte.is_ascii_digit() || b"-.".contains(&byte);
    let bytes = json.as_bytes();
    let starts: Vec<usize> =
        (1..bytes.len()).filter(|&i| bytes[i].is_ascii_digit() && b":[,".contains(&bytes[i - 1])).collect();
    let mut loaded = 0;
    for file in 0..FILES {
        let random = derive(SEED, &[file, 3]);
        let start = starts[(random >> 8) as usize % starts.len()];
        let end = start + bytes[start..].iter().take_while(|&&byte| is_number(byte)).count();
        let value = VALUES[(random & 0xFF) as usize % VALUES.len()];
        let text = format!("{}{value}{}\"buffers\"{buffers}", &json[..start], &json[end..]);
        loaded += u32::from(survives(text.as_bytes(), &format!("{value} in place of the number at {start}")));
    }
    println!("{loaded} of {FILES} files with a changed number load");
}

#[test]
fn random_bytes_in_pictures_are_survived() {
    const FILES_PER_FORMAT: u64 = 400;
    let rgb = image::RgbImage::from_fn(24, 17, |x, y| image::Rgb([(x * 10) as u8, (y * 15) as u8, (x * y) as u8]));
    let mut triangle = Builder::triangle();
    triangle.push("textures", json!({"source": 0}));
    triangle.push("materials", json!({"emissiveTexture": {"index": 0}}));
    triangle.set("/meshes/0/primitives/0/material", json!(0));
    triangle.push("images", json!({"uri": "picture"}));
    triangle.set("/scenes/0/extras", json!({"lumistack": {"environment": {"image": "sky"}}}));
    let file = triangle.glb();
    let encode = |format| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        match format {
            ImageFormat::Hdr => image::DynamicImage::from(rgb.clone()).into_rgb32f().write_to(&mut bytes, format),
            _ => rgb.write_to(&mut bytes, format),
        }
        .unwrap();
        bytes.into_inner()
    };
    let sound = (encode(ImageFormat::Png), encode(ImageFormat::Hdr));
    for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP, ImageFormat::Hdr] {
        let original = encode(format);
        let mut loaded = 0;
        for number in 0..FILES_PER_FORMAT {
            let mut picture = original.clone();
            for change in 0..1 + derive(SEED, &[number, 4]) % 4 {
                let random = derive(SEED, &[number, 5, change]);
                let at = (random >> 16) as usize % picture.len();
                picture[at] = random as u8;
            }
            if number % 4 == 0 {
                picture.truncate(derive(SEED, &[number, 6]) as usize % picture.len());
            }
            let (picture, sky) =
                if format == ImageFormat::Hdr { (sound.0.clone(), picture) } else { (picture, sound.1.clone()) };
            let resolver = std::panic::AssertUnwindSafe(Memory(vec![("picture", picture), ("sky", sky)]));
            let what = format!("{format:?} {number}");
            let start = Instant::now();
            let result = catch_unwind(|| load_with(&file, &*resolver).0.is_ok());
            loaded += u32::from(result.unwrap_or_else(|_| panic!("{what} panicked")));
            assert!(start.elapsed() < MAX_LOAD_TIME, "{what} took {:?}", start.elapsed());
        }
        println!("{loaded} of {FILES_PER_FORMAT} changed {format:?} pictures load");
    }
}
