//! The meaning of valid files: nearly every test writes a small file and checks the scene.

use std::f32::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

use crate::support::{self, Builder, F32, I8, I16, Memory, U8, U16, U32, load, load_with, png, scene};
use glam::{Affine2, Quat, Vec2, Vec3, Vec4};
use lumistack_gltf::AssetResolver;
use lumistack_scene::{AlphaMode, Filter, Light, LightKind, Pixels, Projection, TextureUse, Wrap};
use serde_json::{Value, json};

/// Tolerance of coordinates: a few rounding errors of 32-bit numbers, at the size of these scenes.
const TOLERANCE: f32 = 1e-5;

fn assert_near(found: Vec3, expected: Vec3) {
    assert!((found - expected).abs().max_element() < TOLERANCE, "expected {expected}, found {found}");
}

/// Returns the positions of the corners of every triangle of a mesh.
fn corners(scene: &lumistack_scene::Scene, mesh: usize) -> Vec<[Vec3; 3]> {
    let mesh = &scene.meshes[mesh];
    mesh.triangles.iter().map(|triangle| triangle.map(|i| mesh.positions[i as usize])).collect()
}

#[test]
fn every_container_gives_the_same_scene() {
    let builder = Builder::triangle();
    let from_glb = scene(&builder);
    let resolver = Memory(vec![("a b.bin", builder.bin.clone())]);
    let mut marked = b"\xEF\xBB\xBF".to_vec();
    marked.extend(builder.gltf());
    for (bytes, resolver) in [
        (builder.gltf(), &Memory(Vec::new())),
        (builder.gltf_with_buffer("a%20b.bin"), &resolver),
        (marked, &Memory(Vec::new())),
    ] {
        let (result, warnings) = load_with(&bytes, resolver);
        assert_eq!(warnings, Vec::<String>::new());
        assert_eq!(result.unwrap().meshes, from_glb.meshes);
    }
    let mesh = &from_glb.meshes[0];
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    assert_eq!(mesh.place, "/meshes/0/primitives/0");
    assert_eq!(from_glb.materials[mesh.material].roughness, 1.0);
}

#[test]
fn lists_strips_and_fans_make_the_same_square() {
    let square = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
    let modes: [(u32, Option<&[u32]>); 6] = [
        (4, Some(&[0, 1, 2, 2, 1, 3])),
        (5, None),
        (5, Some(&[0, 1, 2, 3])),
        (6, Some(&[0, 1, 3, 2])),
        (6, Some(&[3, 2, 0, 1])),
        (4, Some(&[0, 1, 3, 0, 3, 2, 1])),
    ];
    for (mode, indices) in modes {
        for component in [U8, U16, U32] {
            let mut b = Builder::triangle();
            let positions = b.floats("VEC3", &square);
            b.set("/meshes/0/primitives/0", json!({"attributes": {"POSITION": positions}, "mode": mode}));
            if let Some(indices) = indices {
                let bytes: Vec<u8> = match component {
                    U8 => indices.iter().map(|&i| i as u8).collect(),
                    U16 => indices.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect(),
                    _ => indices.iter().flat_map(|&i| i.to_le_bytes()).collect(),
                };
                let accessor = b.accessor(component, "SCALAR", indices.len(), &bytes);
                b.set("/meshes/0/primitives/0/indices", json!(accessor));
            }
            let (scene, warnings) = load(&b.glb());
            let scene = scene.unwrap();
            assert_eq!(warnings.len(), usize::from(indices.is_some_and(|i| i.len() == 7)), "{warnings:?}");
            assert_eq!(scene.triangle_count(), 2);
            // both triangles face +z and cover the square
            let twice_area: f32 = corners(&scene, 0).iter().map(|[a, b, c]| (b - a).cross(c - a).z).sum();
            assert_eq!(twice_area, 2.0);
            assert!(scene.meshes[0].normals.iter().all(|&normal| normal == Vec3::Z));
        }
    }
}

#[test]
fn points_and_lines_are_left_out_with_a_warning() {
    for mode in 0..4 {
        let mut b = Builder::triangle();
        b.push("meshes", json!({"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}));
        b.push("nodes", json!({"mesh": 1}));
        b.set("/scenes/0/nodes", json!([0, 1]));
        let (scene, warnings) = load(&b.glb());
        assert_eq!(scene.unwrap().triangle_count(), 1);
        assert!(warnings[0].starts_with("test.gltf: /meshes/1/primitives/0: a primitive of "), "{warnings:?}");
    }
}

#[test]
fn sparse_elements_replace_dense_ones_or_zeros() {
    for dense in [true, false] {
        let mut b = Builder::triangle();
        let indices = b.view(&[1, 0, 2, 0]);
        let values: Vec<u8> = [5.0f32, 0.0, 0.0, 0.0, 7.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let values = b.view(&values);
        b.set(
            "/accessors/0/sparse",
            json!({"count": 2, "indices": {"bufferView": indices, "componentType": U16}, "values": {"bufferView": values}}),
        );
        if !dense {
            b.remove("/accessors/0/bufferView");
        }
        assert_eq!(scene(&b).meshes[0].positions, [Vec3::ZERO, 5.0 * Vec3::X, 7.0 * Vec3::Y]);
    }
}

#[test]
fn interleaved_and_quantized_attributes() {
    let mut b = Builder::triangle();
    // a vertex has 12 bytes: position i16×3, padding, normal i8×3, padding
    let mut bytes = Vec::new();
    for position in [[0i16, 0, 0], [32767, 0, 0], [0, -32768, 0]] {
        position.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.extend([0, 0, 0, 0, 0x81, 0]);
    }
    let view = b.view(&bytes);
    b.set(&format!("/bufferViews/{view}/byteStride"), json!(12));
    let accessor = |component, offset, normalized| json!({"bufferView": view, "byteOffset": offset, "componentType": component, "type": "VEC3", "count": 3, "normalized": normalized});
    b.set("/accessors/0", accessor(I16, 0, true));
    let normals = b.push("accessors", accessor(I8, 8, true));
    b.set("/meshes/0/primitives/0/attributes/NORMAL", json!(normals));
    b.set("/extensionsRequired", json!(["KHR_mesh_quantization"]));
    let normalized = scene(&b);
    assert_eq!(normalized.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::NEG_Y]);
    assert!(normalized.meshes[0].normals.iter().all(|&normal| normal == Vec3::NEG_Z));
    b.set("/accessors/0", accessor(I16, 0, false));
    assert_eq!(scene(&b).meshes[0].positions, [Vec3::ZERO, 32767.0 * Vec3::X, -32768.0 * Vec3::Y]);
}

#[test]
fn vertex_colours_of_every_kind() {
    let half = 0.5f32.to_le_bytes();
    let cases: [(u32, &str, Vec<u8>, Vec4); 4] = [
        (U8, "VEC4", [0, 255, 51, 102].repeat(3), Vec4::new(0.0, 1.0, 0.2, 0.4)),
        (U16, "VEC3", [0, 0, 255, 255, 0, 0].repeat(3), Vec4::new(0.0, 1.0, 0.0, 1.0)),
        (F32, "VEC3", half.repeat(9), Vec4::new(0.5, 0.5, 0.5, 1.0)),
        (F32, "VEC4", half.repeat(12), Vec4::splat(0.5)),
    ];
    for (component, kind, bytes, expected) in cases {
        let mut b = Builder::triangle();
        let tight = if component == U16 { &bytes[..18] } else { &bytes[..] };
        let colors = b.accessor(component, kind, 3, tight);
        b.set("/meshes/0/primitives/0/attributes/COLOR_0", json!(colors));
        b.set(&format!("/accessors/{colors}/normalized"), json!(component != F32));
        let scene = scene(&b);
        assert!(scene.meshes[0].colors.iter().all(|&color| (color - expected).length() < TOLERANCE), "{kind}");
    }
}

#[test]
fn only_the_vertices_in_use_are_kept() {
    let mut b = Builder::triangle();
    let mut positions = vec![0.0; 300];
    positions[30..39].copy_from_slice(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    positions[299] = f32::NAN;
    let positions = b.floats("VEC3", &positions);
    let indices = b.accessor(U8, "SCALAR", 3, &[12, 10, 11]);
    b.set("/meshes/0/primitives/0", json!({"attributes": {"POSITION": positions}, "indices": indices}));
    let scene = scene(&b);
    assert_eq!(corners(&scene, 0), [[Vec3::Y, Vec3::ZERO, Vec3::X]]);
    assert_eq!(scene.meshes[0].positions.len(), 3);
}

#[test]
fn shared_meshes_become_instances_under_their_parents() {
    let mut b = Builder::triangle();
    b.push("nodes", json!({"mesh": 0, "translation": [0, 0, 1], "children": [2]}));
    b.push("nodes", json!({"mesh": 0, "rotation": [0, 0, FRAC_1_SQRT_2, FRAC_1_SQRT_2], "scale": [2, 2, 2]}));
    b.push("nodes", json!({"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1]}));
    b.set("/scenes/0/nodes", json!([0, 1, 3]));
    let scene = scene(&b);
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 4));
    let place = |i: usize| scene.instances[i].scene_from_mesh.transform_point3(Vec3::X);
    assert_near(place(0), Vec3::X);
    assert_near(place(1), Vec3::new(1.0, 0.0, 1.0));
    // node 2 is scaled by two and turned by 90° about z, then its parent lifts it
    assert_near(place(2), Vec3::new(0.0, 2.0, 1.0));
    assert_near(place(3), Vec3::new(3.0, 5.0, 6.0));
}

#[test]
fn the_default_scene_is_chosen() {
    let mut b = Builder::triangle();
    b.push("nodes", json!({"mesh": 0, "translation": [9, 0, 0]}));
    b.push("scenes", json!({"nodes": [1]}));
    b.push("scenes", json!({"name": "a scene without the list that glTF leaves optional"}));
    assert_eq!(scene(&b).bounds().min.x, 0.0);
    b.set("/scene", json!(1));
    assert_eq!(scene(&b).bounds().min.x, 9.0);
    // if a file has no scenes, every node without a parent is shown
    b.remove("/scene").remove("/scenes");
    assert_eq!(scene(&b).instances.len(), 2);
}

#[test]
fn hidden_nodes_are_left_out() {
    let mut b = Builder::triangle();
    b.push("nodes", json!({"mesh": 0, "children": [2], "extensions": {"KHR_node_visibility": {"visible": false}}}));
    b.push("nodes", json!({"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": true}}}));
    b.push("nodes", json!({"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": true}}}));
    b.set("/scenes/0/nodes", json!([0, 1, 3])).set("/extensionsRequired", json!(["KHR_node_visibility"]));
    assert_eq!(scene(&b).instances.len(), 2);
}

#[test]
fn gpu_instancing_places_copies() {
    let mut b = Builder::triangle();
    let translations = b.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 3.0]);
    let rotations = b.accessor(I16, "VEC4", 2, &[0, 0, 0, 0, 0, 0, 0xFF, 0x7F, 0, 0, 0, 0, 0xFF, 0x7F, 0, 0]);
    b.set(
        "/nodes/0",
        json!({"mesh": 0, "translation": [1, 0, 0],
            "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": translations, "ROTATION": rotations}}}}),
    );
    let scene = scene(&b);
    let place = |i: usize| scene.instances[i].scene_from_mesh.transform_point3(Vec3::Y);
    assert_near(place(0), Vec3::new(1.0, 1.0, 0.0));
    // copy 1 makes half a turn about z, and is then moved by 3 along z
    assert_near(place(1), Vec3::new(1.0, -1.0, 3.0));
}

#[test]
fn a_skin_poses_its_mesh() {
    let mut b = Builder::triangle();
    let joints = b.accessor(U8, "VEC4", 3, &[0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0]);
    let weights = b.floats("VEC4", &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0]);
    let mut bind = glam::Mat4::IDENTITY.to_cols_array().to_vec();
    bind.extend(glam::Mat4::from_translation(Vec3::new(0.0, 0.0, -1.0)).to_cols_array());
    let bind = b.floats("MAT4", &bind);
    b.set("/meshes/0/primitives/0/attributes/JOINTS_0", json!(joints));
    b.set("/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(weights));
    b.push("skins", json!({"joints": [1, 2], "inverseBindMatrices": bind}));
    b.set("/nodes/0", json!({"mesh": 0, "skin": 0, "translation": [100, 100, 100]}));
    b.push("nodes", json!({"children": [2], "translation": [0, 0, 1]}));
    b.push("nodes", json!({"translation": [0, 2, 0]}));
    b.set("/scenes/0/nodes", json!([0, 1]));
    let scene = scene(&b);
    // Joint 0 adds 1 to z. Joint 1 is bound at z = 1 and moved to (0, 2, 1), so it adds 2 to y.
    let placed: Vec<Vec3> =
        scene.meshes[0].positions.iter().map(|&p| scene.instances[0].scene_from_mesh.transform_point3(p)).collect();
    assert_near(placed[0], Vec3::new(0.0, 0.0, 1.0));
    assert_near(placed[1], Vec3::new(1.0, 2.0, 0.0));
    assert_near(placed[2], Vec3::new(0.0, 2.0, 0.5));
}

#[test]
fn a_skin_turns_normals_with_the_surface() {
    let mut b = Builder::triangle();
    let joints = b.accessor(U8, "VEC4", 3, &[0; 12]);
    let weights = b.floats("VEC4", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    let normals = b.floats("VEC3", &[FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0].repeat(3));
    let attributes = json!({"POSITION": 0, "NORMAL": normals, "JOINTS_0": joints, "WEIGHTS_0": weights});
    b.set("/meshes/0/primitives/0/attributes", attributes);
    b.push("skins", json!({"joints": [0]}));
    b.set("/nodes/0", json!({"mesh": 0, "skin": 0, "scale": [2, 1, 1]}));
    let scene = scene(&b);
    // the plane x + y = c becomes x/2 + y = c if it is stretched by two along x
    assert_near(scene.meshes[0].normals[0], Vec3::new(1.0, 2.0, 0.0).normalize());
    assert_near(scene.meshes[0].positions[1], 2.0 * Vec3::X);
}

#[test]
fn morph_targets_count_at_their_weights() {
    let mut b = Builder::triangle();
    let deltas = b.floats("VEC3", &[0.0, 0.0, 4.0].repeat(3));
    b.set("/meshes/0/primitives/0/targets", json!([{"POSITION": deltas}, {"POSITION": 999}]));
    b.set("/meshes/0/weights", json!([0.25, 0.0]));
    b.push("nodes", json!({"mesh": 0, "weights": [0.5]}));
    b.set("/scenes/0/nodes", json!([0, 1]));
    let scene = scene(&b);
    assert_eq!(scene.meshes[0].positions[0].z, 1.0);
    assert_eq!(scene.meshes[1].positions[0].z, 2.0);
}

/// Returns a triangle whose material has many textures and extensions.
fn painted() -> Builder {
    let mut b = Builder::triangle();
    let uvs = b.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    for set in ["TEXCOORD_0", "TEXCOORD_3"] {
        b.set(&format!("/meshes/0/primitives/0/attributes/{set}"), json!(uvs));
    }
    b.set("/meshes/0/primitives/0/material", json!(1));
    let picture = b.view(&png(2, &[[10, 20, 30, 40], [50, 60, 70, 80], [1, 2, 3, 4], [5, 6, 7, 8]]));
    b.push("images", json!({"bufferView": picture, "mimeType": "image/jpeg"}));
    b.push("samplers", json!({"magFilter": 9728, "wrapS": 33071, "wrapT": 33648}));
    b.push("textures", json!({"source": 0, "sampler": 0}));
    b.push("textures", json!({"source": 0}));
    b.push("materials", json!({"name": "unused", "emissiveTexture": {"index": 77}}));
    let transform = json!({"offset": [0.5, 0.25], "rotation": FRAC_PI_2, "scale": [2.0, 3.0], "texCoord": 3});
    b.push(
        "materials",
        json!({"name": "paint", "alphaMode": "MASK", "alphaCutoff": 0.75, "doubleSided": true,
            "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.25,
                "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": transform}},
                "metallicRoughnessTexture": {"index": 1}},
            "normalTexture": {"index": 1, "scale": 0.5, "extensions": {"KHR_texture_transform": {"offset": [0.125, 0]}}},
            "emissiveFactor": [1.0, 0.5, 0.0], "emissiveTexture": {"index": 1},
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}, "KHR_materials_ior": {"ior": 1.25},
                "KHR_materials_transmission": {"transmissionFactor": 0.75, "transmissionTexture": {"index": 1}},
                "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationDistance": 2.0, "attenuationColor": [1.0, 0.5, 0.25]}}}),
    );
    b
}

#[test]
fn materials_keep_every_factor_and_texture() {
    let scene = scene(&painted());
    let material = &scene.materials[1];
    assert_eq!(scene.meshes[0].material, 1);
    assert_eq!(material.name, "paint");
    assert_eq!(material.base_color, Vec4::new(0.1, 0.2, 0.3, 0.4));
    assert_eq!((material.metallic, material.roughness, material.normal_scale), (0.5, 0.25, 0.5));
    assert_eq!(material.emission, Vec3::new(4.0, 2.0, 0.0));
    assert_eq!(material.alpha_mode, AlphaMode::Mask { cutoff: 0.75 });
    assert_eq!((material.double_sided, material.unlit, material.solid), (true, false, true));
    assert_eq!((material.ior, material.transmission, material.attenuation_distance), (1.25, 0.75, 2.0));
    assert_eq!(material.attenuation_color, Vec3::new(1.0, 0.5, 0.25));
    assert_eq!(material.textures().count(), 5);

    // sets 0 and 3 of the file become sets 0 and 1 of the mesh
    let base = material.base_color_texture.unwrap();
    assert_eq!(base.uv_set, 1);
    assert_eq!(scene.meshes[0].uvs[1], [Vec2::ZERO, Vec2::X, Vec2::Y]);
    let plain = TextureUse { texture: 1, uv_set: 0, texture_from_mesh: Affine2::IDENTITY };
    assert_eq!(material.metallic_roughness_texture, Some(plain));
    let shifted = Affine2::from_translation(Vec2::new(0.125, 0.0));
    assert_eq!(material.normal_texture, Some(TextureUse { texture_from_mesh: shifted, ..plain }));

    let [sampled, default] = [0, 1].map(|i| scene.textures[i]);
    assert_eq!(
        (sampled.wrap_u, sampled.wrap_v, sampled.filter),
        (Wrap::ClampToEdge, Wrap::MirroredRepeat, Filter::Nearest)
    );
    assert_eq!((default.wrap_u, default.wrap_v, default.filter), (Wrap::Repeat, Wrap::Repeat, Filter::Linear));
    // the picture is decoded only once, and its first row is at the top
    assert_eq!((sampled.image, default.image, scene.images.len()), (0, 0, 1));
    assert_eq!(
        scene.images[0].pixels,
        Pixels::Rgba8(vec![[10, 20, 30, 40], [50, 60, 70, 80], [1, 2, 3, 4], [5, 6, 7, 8]])
    );
}

#[test]
fn texture_transforms_scale_then_turn_then_shift() {
    let scene = scene(&painted());
    let map = scene.materials[1].base_color_texture.unwrap().texture_from_mesh;
    // The point (1, 1) is scaled to (2, 3). A quarter turn from u towards −v gives (3, −2), and the
    // offset gives (3.5, −1.75).
    assert!((map.transform_point2(Vec2::ONE) - Vec2::new(3.5, -1.75)).length() < TOLERANCE);
}

#[test]
fn the_transform_test_scene_agrees_on_the_sense_of_rotation() {
    let Some(folder) = support::assets("gltf/TextureTransformTest") else { return };
    let (scene, _) = support::load_file(&folder.join("TextureTransformTest.gltf"));
    let scene = scene.unwrap();
    // The arrow's tip is on the diagonal of the picture, and the scene marks the tip's position on
    // the rotated square. The square's corners (−0.5, 0.5) and (0.5, −0.5) have the texture
    // coordinates (0, 0) and (1, 1).
    let material = scene.materials.iter().find(|material| material.name == "Rotation").unwrap();
    let map = material.base_color_texture.unwrap().texture_from_mesh;
    let marked = map.transform_point2(Vec2::new(0.5 - 0.079_048_224, 0.5 + 0.516_267_5));
    assert!((marked.x - marked.y).abs() < TOLERANCE, "{marked}");
}

#[test]
fn unlit_and_other_alpha_modes() {
    let mut b = Builder::triangle();
    b.push(
        "materials",
        json!({"alphaMode": "BLEND", "extensions": {"KHR_materials_unlit": {}, "KHR_materials_volume": {}}}),
    );
    b.set("/meshes/0/primitives/0/material", json!(0));
    let scene = scene(&b);
    assert_eq!((scene.materials[0].unlit, scene.materials[0].alpha_mode), (true, AlphaMode::Blend));
    // a thickness of 0, the default, means a thin wall
    assert!(!scene.materials[0].solid && scene.materials[0].attenuation_distance == f32::INFINITY);
    assert_eq!(scene.materials.len(), 1);
}

#[test]
fn pictures_of_every_format_and_depth() {
    let encode = |image: image::DynamicImage, format| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    let rgb8 = image::DynamicImage::from(image::RgbImage::from_pixel(8, 8, image::Rgb([200, 100, 50])));
    let deep = image::ImageBuffer::from_pixel(1, 2, image::Rgb([1000u16, 2000, 3000]));
    let cases = [
        (encode(rgb8.clone(), image::ImageFormat::Png), Pixels::Rgba8(vec![[200, 100, 50, 255]; 64])),
        (encode(rgb8.clone(), image::ImageFormat::WebP), Pixels::Rgba8(vec![[200, 100, 50, 255]; 64])),
        (encode(deep.into(), image::ImageFormat::Png), Pixels::Rgba16(vec![[1000, 2000, 3000, 65535]; 2])),
    ];
    let load_picture = |bytes: Vec<u8>| {
        let mut b = painted();
        b.set("/images/0", json!({"uri": "folder/picture%201.bin"}));
        let (scene, _) = load_with(&b.glb(), &Memory(vec![("folder/picture 1.bin", bytes)]));
        scene.unwrap().images[0].clone()
    };
    for (bytes, expected) in cases {
        assert_eq!(load_picture(bytes).pixels, expected);
    }
    let Pixels::Rgba8(texels) = load_picture(encode(rgb8, image::ImageFormat::Jpeg)).pixels else { panic!() };
    // allow 2 codes for JPEG's rounding in YCbCr
    assert!(texels.iter().all(|t| t[0].abs_diff(200) <= 2 && t[1].abs_diff(100) <= 2 && t[2].abs_diff(50) <= 2));
}

#[test]
fn webp_is_preferred_to_its_fallback() {
    let mut b = painted();
    let image = image::RgbImage::from_pixel(1, 1, image::Rgb([1, 2, 3]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::WebP).unwrap();
    let view = b.view(bytes.get_ref());
    b.push("images", json!({"bufferView": view, "mimeType": "image/webp"}));
    for texture in 0..2 {
        b.set(&format!("/textures/{texture}/extensions"), json!({"EXT_texture_webp": {"source": 1}}));
    }
    b.set("/extensionsRequired", json!(["EXT_texture_webp"]));
    assert_eq!(scene(&b).images[0].pixels, Pixels::Rgba8(vec![[1, 2, 3, 255]]));
}

#[test]
fn lights_shine_along_minus_z_of_their_nodes() {
    let mut b = Builder::triangle();
    b.set(
        "/extensions",
        json!({"KHR_lights_punctual": {"lights": [
            {"type": "directional", "color": [1, 0.5, 0], "intensity": 4},
            {"type": "point", "range": 3},
            {"type": "spot", "intensity": 2, "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}}]}}),
    );
    // a quarter turn about y moves −z to −x
    let turned = json!([0, FRAC_1_SQRT_2, 0, FRAC_1_SQRT_2]);
    for light in 0..3 {
        let light = json!({"KHR_lights_punctual": {"light": light}});
        b.push("nodes", json!({"translation": [1, 2, 3], "rotation": turned, "scale": [5, 5, 5], "extensions": light}));
    }
    b.set("/scenes/0/nodes", json!([0, 1, 2, 3]));
    let scene = scene(&b);
    let expected = [
        (Vec3::new(4.0, 2.0, 0.0), LightKind::Directional),
        (Vec3::ONE, LightKind::Point),
        (Vec3::splat(2.0), LightKind::Spot { inner_cone_rad: 0.25, outer_cone_rad: 0.5 }),
    ];
    assert_eq!(scene.lights.len(), expected.len());
    for (light, (intensity, kind)) in scene.lights.iter().zip(expected) {
        assert_eq!(*light, Light { intensity, kind, ..*light });
        assert_near(light.position, Vec3::new(1.0, 2.0, 3.0));
        assert_near(light.direction, Vec3::NEG_X);
    }
}

#[test]
fn cameras_of_both_kinds_with_their_focus() {
    let mut b = Builder::triangle();
    b.push("cameras", json!({"type": "orthographic", "orthographic": {"xmag": 3, "ymag": 2, "zfar": 9, "znear": 0}}));
    b.push(
        "cameras",
        json!({"name": "data", "type": "perspective", "perspective": {"yfov": 0.5, "aspectRatio": 1.6, "znear": 0.1},
            "extras": {"lumistack": {"focus_distance": 2.5}}}),
    );
    b.push("nodes", json!({"name": "Camera", "camera": 1, "translation": [0, 0, 7], "scale": [3, 3, 3]}));
    b.push("nodes", json!({"camera": 0}));
    b.set("/scenes/0/nodes", json!([0, 1, 2]));
    let scene = scene(&b);
    let [first, second] = [0, 1].map(|i| scene.cameras[i].clone());
    assert_eq!(first.projection, Projection::Orthographic { half_width: 3.0, half_height: 2.0 });
    assert_eq!((first.name.as_str(), first.focus_distance), ("0", None));
    assert_eq!(second.projection, Projection::Perspective { vertical_fov_rad: 0.5, aspect: Some(1.6) });
    assert_eq!((second.name.as_str(), second.focus_distance), ("Camera", Some(2.5)));
    assert_near(second.scene_from_camera.transform_point3(Vec3::NEG_Z), Vec3::new(0.0, 0.0, 6.0));
}

#[test]
fn the_environment_of_the_scene() {
    let mut b = Builder::triangle();
    let environment = json!({"image": "sky.hdr", "strength": 2, "rotation": [0, 1, 0, 0]});
    b.set("/scenes/0/extras", json!({"lumistack": {"environment": environment}}));
    let mut picture = std::io::Cursor::new(Vec::new());
    // powers of two are exact in texels with a shared exponent
    let texels = [[4.0f32, 2.0, 1.0], [0.5, 0.25, 0.125]].map(image::Rgb);
    image::codecs::hdr::HdrEncoder::new(&mut picture).encode(&texels, 2, 1).unwrap();
    let (scene, warnings) = load_with(&b.glb(), &Memory(vec![("sky.hdr", picture.into_inner())]));
    assert_eq!(warnings, Vec::<String>::new());
    let scene = scene.unwrap();
    let environment = scene.environment.unwrap();
    assert_eq!(environment.strength, Vec3::splat(2.0));
    assert_eq!(environment.scene_from_environment, Quat::from_xyzw(0.0, 1.0, 0.0, 0.0));
    assert_eq!(scene.images[environment.image].pixels, Pixels::RgbF32(texels.map(|t| t.0).to_vec()));
}

#[test]
fn whole_numbers_may_be_written_as_floats() {
    let text = String::from_utf8(Builder::triangle().gltf()).unwrap();
    let text =
        text.replace("\"count\":3", "\"count\":3.0").replace("\"componentType\":5126", "\"componentType\":5.126e3");
    assert!(text.contains("3.0") && load(text.as_bytes()).0.is_ok());
}

/// A scene that lists a child, the same node twice, or a node with two parents is not a tree. Other
/// readers show such a scene, and so does this reader.
#[test]
fn scenes_that_list_children_are_shown() {
    let corner = |b: &Builder| {
        let (scene, warnings) = load(&b.glb());
        let scene = scene.unwrap();
        let corners = scene.instances.iter().map(|instance| instance.scene_from_mesh.translation.x);
        (
            corners.collect::<Vec<_>>(),
            warnings.iter().map(|text| text.replacen("test.gltf: ", "", 1)).collect::<Vec<_>>(),
        )
    };
    let under = |roots: Value| {
        let mut b = Builder::triangle();
        b.push("nodes", json!({"children": [0], "translation": [3, 0, 0]}));
        b.set("/scenes/0/nodes", roots);
        b
    };
    let child = "expected a node without a parent, found node 0, a child of node 1";
    let shown_there = format!("{child}; node 0 stays a child of node 1");
    assert_eq!(corner(&under(json!([0, 1]))), (vec![3.0], vec![format!("/scenes/0/nodes/0: {shown_there}")]));
    assert_eq!(corner(&under(json!([1, 0]))), (vec![3.0], vec![format!("/scenes/0/nodes/1: {shown_there}")]));
    let alone =
        format!("/scenes/0/nodes/0: {child}; the scene does not show node 1, so node 0 is shown without its parent");
    assert_eq!(corner(&under(json!([0]))), (vec![0.0], vec![alone]));
    let again = "/scenes/0/nodes/1: expected every node once, found node 1 again; the node is shown once";
    assert_eq!(corner(&under(json!([1, 1]))), (vec![3.0], vec![again.into()]));
    // a node with two parents keeps the first
    let mut b = under(json!([1, 2]));
    b.push("nodes", json!({"children": [0, 0], "translation": [5, 0, 0]}));
    let (places, warnings) = corner(&b);
    assert_eq!((places, warnings.len()), (vec![3.0], 2));
    let expected = "/nodes/2/children/0: expected a node without another parent, found node 0, which is a child of node 1; the node stays a child of node 1";
    assert_eq!(warnings[0], expected);
}

/// glTF has strides only for vertices. A stride on indices is applied if it is larger than an index
/// and the indices fit into their view with it, as in other readers. Otherwise it has no effect.
#[test]
fn strides_where_none_belong_are_said() {
    for (bytes, stride, expected) in [
        (&[0u8, 0, 1, 0, 2, 0][..], 2, None),
        (&[0, 0, 9, 9, 1, 0, 9, 9, 2, 0], 4, Some("found 4; /accessors/1 is read with the stride 4")),
        (&[0, 0, 1, 0, 2, 0], 12, Some("found 12; /accessors/1 is read without a stride")),
        (&[0, 0, 1, 0, 2, 0], 1, Some("found 1; /accessors/1 is read without a stride")),
    ] {
        let mut b = Builder::triangle();
        let indices = b.accessor(U16, "SCALAR", 3, bytes);
        b.set("/bufferViews/1/byteStride", json!(stride));
        b.set("/meshes/0/primitives/0/indices", json!(indices));
        let (scene, warnings) = load(&b.glb());
        assert_eq!(scene.unwrap().meshes[0].triangles, [[0, 1, 2]], "stride {stride}");
        let start = "expected no stride, which glTF allows only for attributes of vertices";
        let expected = expected.map(|text| format!("test.gltf: /bufferViews/1/byteStride: {start}, {text}"));
        assert_eq!(warnings, expected.into_iter().collect::<Vec<_>>(), "stride {stride}");
    }
}

/// Two buffers, and two images, with equal URIs are read once.
#[test]
fn equal_uris_are_read_and_decoded_once() {
    struct Counted(Memory, std::cell::RefCell<Vec<String>>);
    impl AssetResolver for Counted {
        fn read(&self, uri: &str, max_bytes: u64) -> Result<Vec<u8>, String> {
            self.1.borrow_mut().push(uri.to_owned());
            self.0.read(uri, max_bytes)
        }
    }
    let mut b = Builder::triangle();
    let uvs = b.floats("VEC2", &[0.0; 6]);
    b.set("/bufferViews/1/buffer", json!(1));
    b.set("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(uvs));
    for _ in 0..2 {
        let image = b.push("images", json!({"uri": "a.png"}));
        b.push("textures", json!({"source": image}));
    }
    let both = json!({"emissiveTexture": {"index": 0}, "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}});
    b.push("materials", both);
    b.set("/meshes/0/primitives/0/material", json!(0));
    b.set("/buffers", json!([])).set("/asset", json!({"version": "2.0"}));
    for _ in 0..2 {
        b.push("buffers", json!({"byteLength": b.bin.len(), "uri": "a.bin"}));
    }
    let files = Memory(vec![("a.bin", b.bin.clone()), ("a.png", png(1, &[[1, 2, 3, 255]]))]);
    let files = Counted(files, Default::default());
    let (scene, warnings) = load_with(b.json.to_string().as_bytes(), &files);
    assert_eq!(warnings, Vec::<String>::new());
    assert_eq!(scene.unwrap().images.len(), 1);
    assert_eq!(*files.1.borrow(), ["a.png", "a.bin"]);
}

#[test]
fn what_has_no_effect_is_said() {
    let mut b = Builder::triangle();
    let tangents = b.floats("VEC4", &[0.0; 12]);
    let normals = b.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    b.set("/meshes/0/primitives/0/attributes", json!({"POSITION": 0, "NORMAL": normals, "TANGENT": tangents}));
    b.push("animations", json!({"channels": [{"sampler": 0, "target": {"path": "pointer"}}], "samplers": []}));
    b.set("/scenes/0/extras", json!({"lumistack": {"enviroment": {}}}));
    let (scene, warnings) = load(&b.glb());
    assert!(scene.unwrap().meshes[0].tangents.is_empty());
    let expected = [
        "/animations: the file is animated; its nodes keep their own values, since neither a time nor an animation is given",
        "/scenes/0/extras/lumistack/enviroment: the member is unknown and has no effect; known members: environment",
        "/meshes/0/primitives/0: some tangents have no direction; all tangents of the primitive are replaced by generated ones where a material needs them",
    ];
    assert_eq!(warnings, expected.map(|warning| format!("test.gltf: {warning}")));
}
