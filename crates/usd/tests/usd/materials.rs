//! Materials, textures and lights of scene packages that the test writes; no Python is needed.

use std::io::Cursor;

use glam::{Vec2, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Warning};
use lumistack_scene::{AlphaMode, LightKind, Material, Pixels, Scene};
use lumistack_usd::{Package, scene_from_package};
use serde_json::{Value, json};

/// Returns a scene of one plane with one material and lights. The scene has one picture of 2 × 1
/// texels, and refers to a picture that is missing.
fn scene(material: Value, lights: Value) -> (Scene, Vec<Warning>) {
    let mut png = Vec::new();
    let texels = vec![255, 0, 51, 255, 0, 102, 204, 128];
    let picture = image::DynamicImage::ImageRgba8(image::ImageBuffer::from_raw(2, 1, texels).unwrap());
    picture.write_to(&mut Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    let header = json!({
        "schema": "lumistack.scene-package", "version": 1, "up_axis": "Y", "meters_per_unit": 1.0,
        "geometries": [{"kind": "solid", "place": "/plane", "solid": "plane", "sizes": [2.0, 2.0], "axis": "y"}],
        "instances": [{"geometry": 0, "materials": [0], "chain": []}],
        "materials": [material], "lights": lights, "cameras": [],
        "images": [
            {"place": "/tex", "name": "a.png", "bytes": {"buffer": 0, "type": "u8", "shape": [png.len()]}},
            {"place": "/tex", "name": "gone.png", "path": "/nowhere/gone.png"},
        ],
        "buffers": [[0, png.len()]],
    });
    let header = header.to_string();
    let mut bytes = b"LUMIPKG1".to_vec();
    bytes.extend((header.len() as u64).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(64), 0);
    bytes.extend(&png);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let package = Package::parse(&bytes).unwrap();
    let scene = scene_from_package("test.usd", &package, Task::quiet(&warnings, &cancel)).unwrap();
    (scene, warnings.take())
}

fn shader(model: &str, inputs: Value) -> (Scene, Material, Vec<Warning>) {
    let entry = json!({"place": "/m", "name": "m", "model": model, "inputs": inputs});
    let (scene, warnings) = scene(entry, json!([]));
    let material = scene.materials[scene.meshes[0].material].clone();
    (scene, material, warnings)
}

fn preview(inputs: Value) -> (Scene, Material, Vec<Warning>) {
    shader("UsdPreviewSurface", inputs)
}

/// Returns an input that reads these channels of the scene's first picture.
fn texture(channels: &[usize], scale: f32, bias: f32, space: &str) -> Value {
    let list = |value: f32| vec![value; channels.len()];
    json!({"texture": {
        "image": 0, "channels": channels, "scale": list(scale), "bias": list(bias), "fallback": list(0.25),
        "wrap": ["repeat", "mirror"], "color_space": space, "primvar": "st", "transform": [1, 0, 0, 1, 0, 0],
    }})
}

fn texels(scene: &Scene, texture: usize) -> Vec<[u8; 4]> {
    match &scene.images[scene.textures[texture].image].pixels {
        Pixels::Rgba8(texels) => texels.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn constants_of_the_preview_surface_land_in_their_slots() {
    let (_, material, warnings) = preview(json!({}));
    assert_eq!(material.base_color, Vec4::new(0.18, 0.18, 0.18, 1.0));
    assert_eq!((material.metallic, material.roughness, material.ior), (0.0, 0.5, 1.5));
    assert_eq!((material.alpha_mode, material.clearcoat), (AlphaMode::Opaque, None));
    assert!(warnings.is_empty(), "{warnings:?}");

    let (_, material, warnings) = preview(json!({
        "diffuseColor": {"value": [0.1, 0.2, 0.3]}, "emissiveColor": {"value": [4, 5, 6]}, "metallic": {"value": [0.75]},
        "roughness": {"value": [0.25]}, "clearcoat": {"value": [0.5]}, "clearcoatRoughness": {"value": [0.125]},
        "opacity": {"value": [0.5]}, "ior": {"value": [1.25]}, "occlusion": {"value": [0.5]}, "displacement": {"value": [0.5]},
    }));
    assert_eq!(material.base_color, Vec4::new(0.1, 0.2, 0.3, 0.5));
    assert_eq!(material.emission, Vec3::new(4.0, 5.0, 6.0));
    assert_eq!((material.metallic, material.roughness, material.ior), (0.75, 0.25, 1.25));
    let coat = material.clearcoat.unwrap();
    assert_eq!((coat.factor, coat.roughness, material.alpha_mode), (0.5, 0.125, AlphaMode::Blend));
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].message.contains("displacement"), "{warnings:?}");
}

#[test]
fn the_specular_workflow_sets_the_reflection_at_normal_incidence() {
    let specular = |color: [f32; 3]| {
        preview(json!({"useSpecularWorkflow": {"value": [1]}, "specularColor": {"value": color}, "metallic": {"value": [1]}})).1
    };
    let material = specular([0.5, 0.25, 0.125]);
    assert_eq!((material.ior, material.specular, material.metallic), (0.0, 1.0, 0.0));
    assert_eq!(material.specular_color, Vec3::new(0.5, 0.25, 0.125));
    assert_eq!(specular([0.0; 3]).specular, 0.0);
}

#[test]
fn opacity_cuts_or_blends_and_shares_the_texture_of_the_colour() {
    let alpha = texture(&[3], 1.0, 0.0, "raw");
    let colour = texture(&[0, 1, 2], 1.0, 0.0, "sRGB");
    let (scene, material, _) =
        preview(json!({"diffuseColor": colour, "opacity": alpha, "opacityThreshold": {"value": [0.25]}}));
    assert_eq!(material.alpha_mode, AlphaMode::Mask { cutoff: 0.25 });
    // The material reads colour from the picture's red, green and blue, and opacity from its alpha.
    // So the texture is the unchanged picture.
    assert_eq!(texels(&scene, material.base_color_texture.unwrap().texture), [[255, 0, 51, 255], [0, 102, 204, 128]]);
    // opacity comes from green and the colour is constant, so the texture is white with this alpha
    let (scene, material, _) = preview(json!({"opacity": texture(&[1], 1.0, 0.0, "raw")}));
    assert_eq!((material.alpha_mode, material.base_color), (AlphaMode::Blend, Vec4::new(0.18, 0.18, 0.18, 1.0)));
    assert_eq!(
        texels(&scene, material.base_color_texture.unwrap().texture),
        [[255, 255, 255, 0], [255, 255, 255, 102]]
    );
    // a constant opacity above the threshold hides nothing
    let (_, material, _) = preview(json!({"opacity": {"value": [0.5]}, "opacityThreshold": {"value": [0.25]}}));
    assert_eq!(material.alpha_mode, AlphaMode::Opaque);
}

#[test]
fn roughness_and_metalness_are_packed_from_any_channels() {
    let (scene, material, _) =
        preview(json!({"roughness": texture(&[0], 1.0, 0.0, "auto"), "metallic": texture(&[1], 1.0, 0.0, "auto")}));
    assert_eq!((material.roughness, material.metallic), (1.0, 1.0));
    let packed = texels(&scene, material.metallic_roughness_texture.unwrap().texture);
    assert_eq!(packed.map_channels(), [[255, 0], [0, 102]]);
    // roughness is in green and metallic in blue, where the slot reads them. So the picture is used
    // as it is, and the texture's scale becomes the material's factor (0.5).
    let (scene, material, _) =
        preview(json!({"roughness": texture(&[1], 0.5, 0.0, "raw"), "metallic": texture(&[2], 1.0, 0.0, "raw")}));
    assert_eq!((material.roughness, material.metallic), (0.5, 1.0));
    assert_eq!(texels(&scene, material.metallic_roughness_texture.unwrap().texture)[1], [0, 102, 204, 128]);
    // 1 − texel is not a multiple of the texel, so a picture is baked
    let (scene, material, _) = preview(json!({"roughness": texture(&[0], -1.0, 1.0, "raw")}));
    let packed = texels(&scene, material.metallic_roughness_texture.unwrap().texture);
    assert_eq!([packed[0][1], packed[1][1]], [0, 255]);
}

trait Channels {
    fn map_channels(&self) -> Vec<[u8; 2]>;
}

impl Channels for Vec<[u8; 4]> {
    /// Returns the codes of roughness (green) and metallic (blue) of every texel.
    fn map_channels(&self) -> Vec<[u8; 2]> {
        self.iter().map(|&[_, g, b, _]| [g, b]).collect()
    }
}

#[test]
fn colour_spaces_scale_and_bias_act_in_linear_light() {
    // a slot of colour stores sRGB codes, so the linear values of a raw picture are encoded
    let (scene, material, _) = preview(json!({"diffuseColor": texture(&[0, 1, 2], 1.0, 0.0, "raw")}));
    let expected = lumistack_core::colour::srgb_code(0.4);
    assert_eq!(texels(&scene, material.base_color_texture.unwrap().texture)[1][1], expected);
    // a scale becomes a factor; "auto" with 8 bits is sRGB
    let (scene, material, _) = preview(json!({"diffuseColor": texture(&[0, 1, 2], 0.5, 0.0, "auto")}));
    assert_eq!(material.base_color.truncate(), Vec3::splat(0.5));
    assert_eq!(texels(&scene, material.base_color_texture.unwrap().texture)[0], [255, 0, 51, 255]);
    // a bias needs a baked picture
    let (scene, material, _) = preview(json!({"diffuseColor": texture(&[0, 1, 2], 0.5, 0.25, "raw")}));
    let code = lumistack_core::colour::srgb_code(0.25);
    assert_eq!(texels(&scene, material.base_color_texture.unwrap().texture)[0][1], code);
    // emission above 1 is kept as floating-point radiance
    let (scene, material, _) = preview(json!({"emissiveColor": texture(&[0, 1, 2], 3.0, 1.0, "raw")}));
    let image = &scene.images[scene.textures[material.emission_texture.unwrap().texture].image];
    let Pixels::RgbF32(texels) = &image.pixels else { panic!("{image:?}") };
    assert!((Vec3::from(texels[0]) - Vec3::new(4.0, 1.0, 1.6)).length() < 1e-5, "{texels:?}");
    let (_, material, warnings) = preview(json!({"diffuseColor": texture(&[0, 1, 2], 1.0, 0.0, "squirrel")}));
    assert!(material.base_color_texture.is_some() && warnings[0].message.contains("squirrel"), "{warnings:?}");
}

#[test]
fn normal_maps_are_decoded_as_the_shader_says() {
    let usual = texture(&[0, 1, 2], 2.0, -1.0, "raw");
    let (scene, material, _) = preview(json!({"normal": usual}));
    assert_eq!(material.normal_scale, 1.0);
    assert_eq!(texels(&scene, material.normal_texture.unwrap().texture)[0], [255, 0, 51, 255]);
    assert_eq!(scene.meshes[0].tangents.len(), scene.meshes[0].positions.len());
    // in this map green is inverted, as some programs write it
    let mut flipped = texture(&[0, 1, 2], 2.0, -1.0, "raw");
    (flipped["texture"]["scale"][1], flipped["texture"]["bias"][1]) = (json!(-2.0), json!(1.0));
    let (scene, material, _) = preview(json!({"normal": flipped}));
    let image = &scene.images[scene.textures[material.normal_texture.unwrap().texture].image];
    let Pixels::Rgba16(texels) = &image.pixels else { panic!("{image:?}") };
    // the second texel (0, 0.4, 0.8) gives 2 · 0 − 1, 1 − 2 · 0.4 and 2 · 0.8 − 1, normalized
    let n = Vec3::new(-1.0, 0.2, 0.6).normalize();
    let found = Vec3::new(f32::from(texels[1][0]), f32::from(texels[1][1]), f32::from(texels[1][2])) / 32767.5 - 1.0;
    assert!((found - n).length() < 1e-3, "{found} {n}");
}

#[test]
fn textures_are_placed_by_their_primvar_and_transform() {
    let mut moved = texture(&[0, 1, 2], 1.0, 0.0, "sRGB");
    moved["texture"]["transform"] = json!([2.0, 0.0, 0.0, 3.0, 0.25, 0.5]);
    let mut other = texture(&[0], 1.0, 0.0, "raw");
    other["texture"]["primvar"] = json!("lightmap");
    let (scene, material, _) = preview(json!({"diffuseColor": moved, "roughness": other}));
    let base = material.base_color_texture.unwrap();
    // USD's (0.5, 0.25) is (0.5, 0.75) in the scene, where v points down. USD's transform maps it
    // to (1.25, 1.25), which is (1.25, −0.25) in the scene.
    let found = base.texture_from_mesh.transform_point2(Vec2::new(0.5, 0.75));
    assert!((found - Vec2::new(1.25, -0.25)).length() < 1e-6, "{found}");
    assert_eq!((base.uv_set, material.metallic_roughness_texture.unwrap().uv_set), (0, 1));
    let texture = scene.textures[base.texture];
    assert_eq!(
        (texture.wrap_u, texture.wrap_v),
        (lumistack_scene::Wrap::Repeat, lumistack_scene::Wrap::MirroredRepeat)
    );
}

#[test]
fn pictures_that_cannot_be_read_become_their_fallback() {
    let mut gone = texture(&[0, 1, 2], 1.0, 0.0, "sRGB");
    gone["texture"]["image"] = json!(1);
    let (_, material, warnings) = preview(json!({"diffuseColor": gone}));
    assert_eq!((material.base_color.truncate(), material.base_color_texture), (Vec3::splat(0.25), None));
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].message.starts_with("gone.png is not readable"), "{warnings:?}");
    for broken in [json!({"texture": {"image": 99}}), json!({"value": []}), json!({"value": "red"}), json!(3)] {
        let (_, material, _) = preview(json!({"diffuseColor": broken}));
        assert!(material.base_color.is_finite());
    }
    let mut mean = texture(&[0, 1, 7], 1.0, 0.0, "sRGB");
    assert_eq!(preview(json!({"diffuseColor": mean})).1.base_color.truncate(), Vec3::splat(0.18));
    mean = texture(&[0, 1, 2], 1.0, 0.0, "sRGB");
    mean["texture"]["image"] = json!(99);
    assert_eq!(preview(json!({"diffuseColor": mean})).1.base_color.truncate(), Vec3::splat(0.25));
}

#[test]
fn large_shaders_keep_what_has_a_counterpart_and_name_the_rest() {
    // test standard_surface with every kind of parameter, two of which have no counterpart
    let (_, material, warnings) = shader(
        "standard_surface",
        json!({
            "base": {"value": [0.5]}, "base_color": {"value": [0.8, 0.4, 0.2]}, "specular_roughness": {"value": [0.3]},
            "coat": {"value": [1]}, "coat_color": {"value": [1, 0, 0]}, "coat_IOR": {"value": [1.8]},
            "sheen": {"value": [0.5]}, "thin_film_thickness": {"value": [550]},
            "emission": {"value": [2]}, "emission_color": {"value": [1, 0.5, 0]}, "specular_anisotropy": {"value": [0.5]},
            "transmission_dispersion": {"value": [40]},
        }),
    );
    assert!((material.base_color - Vec4::new(0.4, 0.2, 0.1, 1.0)).length() < 1e-6);
    assert_eq!((material.roughness, material.emission), (0.3, Vec3::new(2.0, 1.0, 0.0)));
    assert_eq!(material.iridescence.unwrap().thickness_nm, [550.0; 2]);
    assert_eq!((material.sheen.unwrap().color, material.anisotropy.unwrap().strength), (Vec3::splat(0.5), 0.5));
    assert!(material.clearcoat.is_some() && material.dispersion == 0.5);
    assert_eq!(warnings.len(), 2);
    assert!(warnings[0].message.contains("index of refraction, 1.8, is not supported; 1.5 is used"), "{warnings:?}");
    assert!(
        warnings[1].message.contains("standard_surface: inputs that cannot be shown are left out: coat_color"),
        "{warnings:?}"
    );

    // test open_pbr_surface with a solid glass, and with a thin window
    let (_, glass, warnings) = shader(
        "open_pbr_surface",
        json!({
            "base_weight": {"value": [0]}, "transmission_weight": {"value": [1]}, "transmission_color": {"value": [0.9, 1, 0.8]},
            "transmission_depth": {"value": [2]}, "specular_ior": {"value": [1.33]}, "thin_film_thickness": {"value": [0.5]},
        }),
    );
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!((glass.transmission, glass.solid, glass.ior), (1.0, true, 1.33));
    assert_eq!((glass.attenuation_color, glass.attenuation_distance), (Vec3::new(0.9, 1.0, 0.8), 2.0));
    assert_eq!((glass.base_color, glass.iridescence), (Vec4::ONE, None));
    let (_, window, _) = shader(
        "open_pbr_surface",
        json!({
            "geometry_thin_walled": {"value": [1]}, "transmission_weight": {"value": [1]}, "transmission_color": {"value": [0.5, 1, 1]},
            "geometry_opacity": {"value": [0.5]},
        }),
    );
    assert_eq!((window.solid, window.base_color), (false, Vec4::new(0.5, 1.0, 1.0, 0.5)));

    // test gltf_pbr with an alpha mask
    let (_, gltf, _) = shader(
        "gltf_pbr",
        json!({"alpha_mode": {"value": [1]}, "alpha": {"value": [0.2]}, "metallic": {"value": [0]}}),
    );
    assert_eq!((gltf.alpha_mode, gltf.metallic, gltf.roughness), (AlphaMode::Mask { cutoff: 0.5 }, 0.0, 1.0));
    // its base colour tints transmitted light, as in glTF
    let (_, red, _) = shader("gltf_pbr", json!({"base_color": {"value": [1, 0, 0]}, "transmission": {"value": [1]}}));
    assert_eq!((red.transmission, red.base_color), (1.0, Vec4::new(1.0, 0.0, 0.0, 1.0)));
}

fn lit(light: Value) -> (Scene, Vec<Warning>) {
    scene(json!({"place": "/m", "name": "m", "model": "UsdPreviewSurface", "inputs": {}}), json!([light]))
}

/// Returns a matrix that scales by 2 and moves to (1, 2, 3).
fn placed() -> Value {
    json!([2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1])
}

/// Returns the radiance of the light's mesh, and its power: radiance times area times π.
fn light_mesh(scene: &Scene) -> (Vec3, f64) {
    let mesh = &scene.meshes[1];
    let radiance = scene.materials[mesh.material].emission;
    let placement = scene.instances[1].scene_from_mesh;
    let at = |i: u32| placement.transform_point3(mesh.positions[i as usize]).as_dvec3();
    let area: f64 = mesh.triangles.iter().map(|&[a, b, c]| 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).length()).sum();
    (radiance, f64::from(radiance.x) * area * std::f64::consts::PI)
}

#[test]
fn light_meshes_have_the_power_of_the_exact_shapes() {
    use std::f64::consts::PI;
    let areas = [
        (json!({"kind": "rect", "width": 3, "height": 0.5}), 1.5 * 4.0),
        (json!({"kind": "disk", "radius": 0.5}), PI * 0.25 * 4.0),
        (json!({"kind": "sphere", "radius": 0.5}), PI * 4.0),
        (json!({"kind": "cylinder", "radius": 0.25, "length": 2}), PI * 4.0),
    ];
    for (mut light, area) in areas {
        for normalize in [false, true] {
            light["radiance"] = json!([6.0, 3.0, 1.5]);
            light["normalize"] = json!(normalize);
            light["matrix"] = placed();
            let (scene, warnings) = lit(light.clone());
            assert!(warnings.is_empty(), "{warnings:?}");
            let (radiance, power) = light_mesh(&scene);
            let expected = 6.0 * PI * if normalize { 1.0 } else { area };
            assert!((power / expected - 1.0).abs() < 1e-4, "{light}: {power} is not {expected}");
            assert!((radiance.x / radiance.y - 2.0).abs() < 1e-5);
        }
    }
    // rectangles and discs emit only towards −z
    for kind in ["rect", "disk"] {
        let (scene, _) = lit(json!({"kind": kind, "radiance": [1, 1, 1], "width": 1, "height": 1, "radius": 1}));
        assert!(scene.meshes[1].normals.iter().all(|normal| *normal == Vec3::NEG_Z));
        assert!(!scene.materials[scene.meshes[1].material].double_sided);
    }
}

#[test]
fn shaped_and_small_lights_are_points_of_the_same_intensity() {
    use std::f32::consts::PI;
    let point = |light: Value| lit(light).0.lights[0];
    let light = point(
        json!({"kind": "sphere", "radius": 0.5, "treatAsPoint": true, "radiance": [3, 3, 3], "matrix": placed()}),
    );
    assert!((light.intensity.x - 3.0 * PI).abs() < 1e-3, "{light:?}");
    assert_eq!((light.kind, light.position), (LightKind::Point, Vec3::new(1.0, 2.0, 3.0)));
    let cone = json!({"cone:angle": 30, "cone:softness": 0.5, "focus": 0});
    let light = point(json!({"kind": "disk", "radius": 0.5, "radiance": [4, 4, 4], "shaping": cone}));
    assert!((light.intensity.x - PI).abs() < 1e-3 && light.direction == Vec3::NEG_Z);
    let LightKind::Spot { inner_cone_rad, outer_cone_rad } = light.kind else { panic!("{light:?}") };
    assert!((inner_cone_rad.to_degrees() - 15.0).abs() < 1e-4 && (outer_cone_rad.to_degrees() - 30.0).abs() < 1e-4);
    // a distant light has the irradiance of a cone with its radiance
    let light = point(json!({"kind": "distant", "angle": 60, "radiance": [8, 8, 8]}));
    assert!((light.intensity.x - 2.0 * PI).abs() < 1e-4);
    assert_eq!(light.kind, LightKind::Distant { half_angle_rad: 30f32.to_radians() });
    let light = point(json!({"kind": "distant", "angle": 60, "radiance": [8, 8, 8], "normalize": true}));
    assert_eq!(light.intensity, Vec3::splat(8.0));
    let light = point(json!({"kind": "distant", "angle": 0, "radiance": [8, 8, 8]}));
    assert_eq!((light.intensity, light.kind), (Vec3::splat(8.0), LightKind::Directional));
}

#[test]
fn domes_look_the_way_openexr_does() {
    let dome = |light: Value| lit(light).0.environment.unwrap();
    let near = |a: Vec3, b: Vec3| assert!((a - b).length() < 1e-6, "{a} {b}");
    let environment = dome(json!({"kind": "dome", "radiance": [2, 3, 4], "image": 0}));
    assert_eq!(environment.strength, Vec3::new(2.0, 3.0, 4.0));
    // the picture's centre shows −z and its right half +x in the scene's environment; in USD they
    // show +z and −x
    let turn = environment.scene_from_environment;
    near(turn * Vec3::NEG_Z, Vec3::Z);
    near(turn * Vec3::X, Vec3::NEG_X);
    near(turn * Vec3::Y, Vec3::Y);
    // if the pole is along z, the top of the picture is +z, as in DomeLight_1 of a stage with z up
    near(
        dome(json!({"kind": "dome", "radiance": [1, 1, 1], "pole_z": true})).scene_from_environment * Vec3::Y,
        Vec3::Z,
    );
    // a dome that is rotated by 90° about y and scaled shows the picture's centre at +x
    let matrix = json!([0, 0, -3, 0, 0, 3, 0, 0, 3, 0, 0, 0, 0, 0, 0, 1]);
    near(
        dome(json!({"kind": "dome", "radiance": [1, 1, 1], "matrix": matrix})).scene_from_environment * Vec3::NEG_Z,
        Vec3::X,
    );
}

#[test]
fn odd_lights_are_reported_and_do_no_harm() {
    for light in [
        json!({"kind": "rect", "radiance": [1, 1, 1], "width": 0, "height": 1}),
        json!({"kind": "rect", "radiance": [1, 1, 1], "width": -1, "height": 1}),
        json!({"kind": "laser", "radiance": [1, 1, 1]}),
        json!({"kind": "sphere", "radiance": [1, 1, 1]}),
        json!({"kind": "sphere", "radiance": 1}),
        json!({"kind": "disk", "radiance": [1, 1, 1], "radius": 1, "matrix": vec![0.0; 16]}),
        json!(7),
    ] {
        let (scene, warnings) = lit(light.clone());
        assert_eq!((scene.lights.len(), scene.meshes.len(), warnings.len()), (0, 1, 1), "{light} {warnings:?}");
    }
    let (scene, warnings) = lit(json!({"kind": "sphere", "radius": 1, "radiance": [0, 0, 0]}));
    assert!(!scene.is_lit() && warnings.is_empty());
}
