//! Shader networks and lights of small stages, which the user's OpenUSD reads. The tests need
//! `LUMISTACK_PYTHON`, and are skipped without it.

use glam::{Vec2, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Warning};
use lumistack_scene::{LightKind, Material, Pixels, Scene};
use lumistack_usd::{LoadOptions, load};

use crate::common;

/// Loads a stage that has a picture next to it. Without a Python, reports the test as skipped and
/// returns `None`.
fn scene(text: &str) -> Option<(Scene, Vec<Warning>)> {
    common::python()?;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    std::fs::write(&path, format!("#usda 1.0\n{text}")).unwrap();
    let texels = vec![255, 0, 51, 255, 0, 102, 204, 128];
    let picture: image::RgbaImage = image::ImageBuffer::from_raw(2, 1, texels).unwrap();
    picture.save(folder.path().join("a.png")).unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let loaded = load(&path, &LoadOptions::default(), Task::quiet(&warnings, &cancel)).unwrap();
    Some((loaded.scene, warnings.take()))
}

fn material(network: &str) -> Option<(Scene, Material, Vec<Warning>)> {
    let text = format!(
        "def Plane \"p\" (prepend apiSchemas = [\"MaterialBindingAPI\"]) {{\n rel material:binding = </m>\n color3f[] primvars:displayColor = [(1, 0, 0)]\n }}\n\
         def Material \"m\" {{\n token outputs:surface.connect = </m/s.outputs:surface>\n {network}\n}}"
    );
    let (scene, warnings) = scene(&text)?;
    let material = scene.materials[scene.meshes[0].material].clone();
    Some((scene, material, warnings))
}

const SURFACE: &str = "uniform token info:id = \"UsdPreviewSurface\"\n token outputs:surface";

#[test]
fn networks_of_the_preview_surface_are_followed() {
    let network = format!(
        r#"
        float inputs:rough = 0.75
        def Shader "s" {{
            {SURFACE}
            color3f inputs:diffuseColor.connect = </m/tex.outputs:rgb>
            float inputs:metallic.connect = </m/tex.outputs:b>
            float inputs:roughness.connect = </m.inputs:rough>
        }}
        def Shader "tex" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./a.png@
            float4 inputs:scale = (0.5, 0.5, 0.5, 1)
            token inputs:sourceColorSpace = "sRGB"
            token inputs:wrapS = "clamp"
            float2 inputs:st.connect = </m/turn.outputs:result>
            float3 outputs:rgb
            float outputs:b
        }}
        def Shader "turn" {{
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = </m/reader.outputs:result>
            float inputs:rotation = 90
            float2 inputs:scale = (2, 3)
            float2 inputs:translation = (0.25, 0.5)
            float2 outputs:result
        }}
        def Shader "reader" {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "map1"
            float2 outputs:result
        }}"#
    );
    let Some((scene, material, warnings)) = material(&network) else { return };
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(material.base_color, Vec4::new(0.5, 0.5, 0.5, 1.0));
    assert_eq!((material.roughness, material.metallic), (0.75, 0.5));
    let base = material.base_color_texture.unwrap();
    // v of the scene is 1 − v of USD, so the point is (1, 1) in USD. It is scaled to (2, 3),
    // rotated to (−3, 2) and moved to (−2.75, 2.5). In the scene this is (−2.75, −1.5).
    let found = base.texture_from_mesh.transform_point2(Vec2::new(1.0, 0.0));
    assert!((found - Vec2::new(-2.75, -1.5)).length() < 1e-5, "{found}");
    assert_eq!(scene.textures[base.texture].wrap_u, lumistack_scene::Wrap::ClampToEdge);
}

#[test]
fn display_colours_are_read_where_a_reader_says_so() {
    let network = format!(
        r#"
        def Shader "s" {{
            {SURFACE}
            color3f inputs:diffuseColor.connect = </m/reader.outputs:result>
        }}
        def Shader "reader" {{
            uniform token info:id = "UsdPrimvarReader_float3"
            string inputs:varname = "displayColor"
            float3 outputs:result
        }}"#
    );
    let Some((scene, found, warnings)) = material(&network) else { return };
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(found.base_color, Vec4::ONE, "the colours of the vertices multiply white");
    assert_eq!(scene.meshes[0].colors, [Vec4::new(1.0, 0.0, 0.0, 1.0); 4]);
    // without a primvar reader in the shader, vertex colours have no effect
    let Some((scene, _, _)) = material(&format!("def Shader \"s\" {{ {SURFACE}\n }}")) else { return };
    assert!(scene.meshes[0].colors.is_empty());
}

#[test]
fn what_is_missing_is_said_and_a_surface_is_left() {
    let missing = format!(
        r#"
        def Shader "s" {{ {SURFACE}
            color3f inputs:diffuseColor.connect = </m/tex.outputs:rgb>
        }}
        def Shader "tex" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./gone.png@
            float4 inputs:fallback = (0.25, 0.5, 1, 1)
            float3 outputs:rgb
        }}"#
    );
    let Some((_, found, warnings)) = material(&missing) else { return };
    assert_eq!(found.base_color, Vec4::new(0.25, 0.5, 1.0, 1.0));
    assert!(warnings.len() == 1 && warnings[0].message.contains("gone.png"), "{warnings:?}");
    let unknown = "def Shader \"s\" { uniform token info:id = \"PxrDisney\"\n token outputs:surface\n }";
    let Some((_, found, warnings)) = material(unknown) else { return };
    assert_eq!(found.base_color, Vec4::new(1.0, 0.0, 0.0, 1.0), "the display colour");
    assert!(warnings.len() == 1 && warnings[0].message.contains("PxrDisney"), "{warnings:?}");
}

#[test]
fn materialx_nodes_become_scale_and_bias() {
    let network = r#"
        def Shader "s" {
            uniform token info:id = "ND_standard_surface_surfaceshader"
            float inputs:base = 1
            color3f inputs:base_color.connect = </m/dim.outputs:out>
            float inputs:specular_roughness.connect = </m/sum.outputs:out>
            token outputs:surface
        }
        def Shader "dim" {
            uniform token info:id = "ND_multiply_color3"
            color3f inputs:in1.connect = </m/tex.outputs:out>
            color3f inputs:in2 = (0.25, 0.5, 1)
            color3f outputs:out
        }
        def Shader "tex" {
            uniform token info:id = "ND_image_color3"
            asset inputs:file = @./a.png@ ( colorSpace = "srgb_texture" )
            color3f outputs:out
        }
        def Shader "sum" {
            uniform token info:id = "ND_add_float"
            float inputs:in1 = 0.5
            float inputs:in2 = 0.125
            float outputs:out
        }"#;
    let Some((_, found, warnings)) = material(network) else { return };
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(found.base_color, Vec4::new(0.25, 0.5, 1.0, 1.0));
    assert!(found.base_color_texture.is_some());
    assert_eq!(found.roughness, 0.625);
}

/// Other programs insert nodes between a normal map and the surface. The test checks that the map
/// still arrives at the surface through each kind of node.
#[test]
fn normal_maps_arrive_through_the_nodes_that_lie_behind_them() {
    const SHADERS: &str = r#"
        def Shader "map" {
            uniform token info:id = "ND_normalmap"
            float3 inputs:in.connect = </m/tex.outputs:out>
            float3 outputs:out
        }
        def Shader "tex" {
            uniform token info:id = "ND_image_vector3"
            asset inputs:file = @./a.png@ ( colorSpace = "raw" )
            float3 outputs:out
        }
        def Shader "parts" {
            uniform token info:id = "ND_separate3_vector3"
            float3 inputs:in.connect = </m/tex.outputs:out>
            float outputs:outx
            float outputs:outy
            float outputs:outz
        }
        def Shader "turned" {
            uniform token info:id = "ND_invert_float"
            float inputs:in.connect = </m/parts.outputs:outy>
            float outputs:out
        }
        def Shader "flipped" {
            uniform token info:id = "ND_combine3_vector3"
            float inputs:in1.connect = </m/parts.outputs:outx>
            float inputs:in2.connect = </m/turned.outputs:out>
            float inputs:in3.connect = </m/parts.outputs:outz>
            float3 outputs:out
        }"#;
    let through = |nodes: &str| {
        let surface = r#"
        def Shader "s" {
            uniform token info:id = "ND_standard_surface_surfaceshader"
            float3 inputs:normal.connect = </m/last.outputs:out>
            token outputs:surface
        }"#;
        let (scene, found, warnings) = material(&format!("{surface}\n{nodes}{SHADERS}"))?;
        assert!(warnings.is_empty(), "{warnings:?}");
        let texture = found.normal_texture.unwrap_or_else(|| panic!("no normal map after {nodes}"));
        Some(scene.images[scene.textures[texture.texture].image].pixels.clone())
    };
    let node = |id: &str, input: &str, more: &str| {
        format!(
            "def Shader \"last\" {{\n uniform token info:id = \"{id}\"\n float3 inputs:in.connect = </m/{input}.outputs:out>\n \
             {more}\n float3 outputs:out\n }}"
        )
    };
    let Some(plain) = through(&node("ND_normalmap", "tex", "")) else { return };
    assert_eq!(through(&node("ND_normalize_vector3", "map", "")), Some(plain.clone()));
    assert_eq!(
        through(&node("ND_transformnormal_vector3", "map", "string inputs:tospace = \"world\"")),
        Some(plain.clone())
    );
    // here the nodes decode the picture by arithmetic: 2 x − 1
    let ends = "float inputs:outlow = -1\n float inputs:outhigh = 1";
    let decoded = format!("{}\n{}", node("ND_normalize_vector3", "remapped", ""), {
        node("ND_remap_vector3FA", "tex", ends).replace("\"last\"", "\"remapped\"")
    });
    assert_eq!(through(&decoded), Some(plain.clone()));
    // a mix with the surface's own normal (0, 0, 1) sets the strength of the map
    let mixed = r#"def Shader "last" {
            uniform token info:id = "ND_mix_vector3"
            float3 inputs:fg.connect = </m/map.outputs:out>
            float3 inputs:bg = (0, 0, 1)
            float inputs:mix = 1
            float3 outputs:out
        }"#;
    assert_eq!(through(mixed), Some(plain.clone()));
    let half = through(&mixed.replace("mix = 1", "mix = 0.5")).unwrap();
    assert!(half != plain && half.len() == plain.len());
    let without_amount = through(&mixed.replace("float inputs:mix = 1", "")).unwrap();
    assert_eq!(without_amount, through(&mixed.replace("mix = 1", "mix = 0")).unwrap());
    // nodes that invert green reverse the y of the map's normals
    let flipped = through(&node("ND_normalmap", "flipped", "")).unwrap();
    let directions = |pixels: &Pixels| -> Vec<Vec3> {
        let texels: Vec<Vec3> = match pixels {
            Pixels::Rgba8(texels) => {
                texels.iter().map(|t| Vec3::from([t[0], t[1], t[2]].map(f32::from)) / 255.0).collect()
            }
            Pixels::Rgba16(texels) => {
                texels.iter().map(|t| Vec3::from([t[0], t[1], t[2]].map(f32::from)) / 65535.0).collect()
            }
            Pixels::RgbF32(texels) => texels.iter().map(|&texel| Vec3::from(texel)).collect(),
        };
        texels.into_iter().map(|texel| (2.0 * texel - 1.0).normalize()).collect()
    };
    for (a, b) in directions(&plain).into_iter().zip(directions(&flipped)) {
        assert!((a - b * Vec3::new(1.0, -1.0, 1.0)).length() < 0.01, "{a} {b}");
    }
}

/// The emission (8, 4, 2) comes from nodes whose inputs have several components, and from a range
/// that clamps its output.
#[test]
fn several_components_are_combined_and_ranges_are_clamped() {
    let emitted = |nodes: &str| {
        let surface = "def Shader \"s\" { uniform token info:id = \"UsdPreviewSurface\"\n \
            color3f inputs:emissiveColor.connect = </m/last.outputs:out>\n token outputs:surface\n }";
        let (_, found, warnings) = material(&format!("{surface}\n{nodes}"))?;
        assert!(warnings.is_empty(), "{warnings:?}");
        Some(found.emission)
    };
    let combined = |id: &str, inputs: &str, channels: &str| {
        format!(
            "def Shader \"all\" {{ uniform token info:id = \"{id}\"\n {inputs}\n float4 outputs:out\n }}\n\
             def Shader \"last\" {{ uniform token info:id = \"ND_swizzle_vector4_color3\"\n \
             float4 inputs:in.connect = </m/all.outputs:out>\n string inputs:channels = \"{channels}\"\n color3f outputs:out\n }}"
        )
    };
    let expected = Vec3::new(8.0, 4.0, 2.0);
    let three = "color3f inputs:in1 = (2, 4, 6)\n float inputs:in2 = 8";
    let Some(found) = emitted(&combined("ND_combine2_color4CF", three, "agr")) else { return };
    assert_eq!(found, expected);
    let two = "float2 inputs:in1 = (2, 4)\n float2 inputs:in2 = (6, 8)";
    assert_eq!(emitted(&combined("ND_combine2_vector4VV", two, "wyx")), Some(expected));
    let range = |more: &str| {
        format!(
            "def Shader \"last\" {{ uniform token info:id = \"ND_range_color3FA\"\n color3f inputs:in = (2, 0.5, 0.25)\n \
             float inputs:outhigh = 8\n {more}\n color3f outputs:out\n }}"
        )
    };
    assert_eq!(emitted(&range("")), Some(Vec3::new(16.0, 4.0, 2.0)));
    assert_eq!(emitted(&range("bool inputs:doclamp = 1")), Some(expected));
}

/// A surface that emits light has the same emission in every supported shader, for constants and
/// for textures.
#[test]
fn a_lamp_is_as_bright_in_every_syntax() {
    let shader = |id: &str, inputs: &str| {
        format!(
            "def Shader \"s\" {{ uniform token info:id = \"{id}\"\n {inputs}\n token outputs:surface\n }}\n\
             def Shader \"half\" {{ uniform token info:id = \"ND_image_float\"\n asset inputs:file = @./a.png@ ( colorSpace = \"raw\" )\n \
             float outputs:out\n }}\n\
             def Shader \"bright\" {{ uniform token info:id = \"ND_multiply_float\"\n float inputs:in1.connect = </m/half.outputs:out>\n \
             float inputs:in2 = 8\n float outputs:out\n }}\n\
             def Shader \"tinted\" {{ uniform token info:id = \"ND_multiply_color3\"\n color3f inputs:in1.connect = </m/half.outputs:out>\n \
             color3f inputs:in2 = (8, 4, 2)\n color3f outputs:out\n }}"
        )
    };
    // every shader states the emission (8, 4, 2) by constants
    let constant = [
        ("UsdPreviewSurface", "color3f inputs:emissiveColor = (8, 4, 2)"),
        ("ND_UsdPreviewSurface_surfaceshader", "color3f inputs:emissiveColor = (8, 4, 2)"),
        (
            "ND_standard_surface_surfaceshader",
            "color3f inputs:emission_color = (1, 0.5, 0.25)\n float inputs:emission = 8",
        ),
        (
            "ND_open_pbr_surface_surfaceshader",
            "color3f inputs:emission_color = (1, 0.5, 0.25)\n float inputs:emission_luminance = 8",
        ),
        ("ND_gltf_pbr_surfaceshader", "color3f inputs:emissive = (1, 0.5, 0.25)\n float inputs:emissive_strength = 8"),
        ("ND_surface_unlit", "color3f inputs:emission_color = (1, 0.5, 0.25)\n float inputs:emission = 8"),
    ];
    for (id, inputs) in constant {
        let Some((scene, found, warnings)) = material(&shader(id, inputs)) else { return };
        assert!(warnings.is_empty(), "{id}: {warnings:?}");
        assert_eq!(found.emission, Vec3::new(8.0, 4.0, 2.0), "{id}");
        assert!(scene.is_lit(), "{id}");
    }
    // every shader reads the same emission (8, 4, 2) from a picture
    let textured = [
        ("UsdPreviewSurface", "color3f inputs:emissiveColor.connect = </m/tinted.outputs:out>"),
        (
            "ND_standard_surface_surfaceshader",
            "color3f inputs:emission_color = (1, 0.5, 0.25)\n float inputs:emission.connect = </m/bright.outputs:out>",
        ),
        (
            "ND_open_pbr_surface_surfaceshader",
            "color3f inputs:emission_color = (1, 0.5, 0.25)\n float inputs:emission_luminance.connect = </m/bright.outputs:out>",
        ),
        (
            "ND_gltf_pbr_surfaceshader",
            "color3f inputs:emissive = (1, 0.5, 0.25)\n float inputs:emissive_strength.connect = </m/bright.outputs:out>",
        ),
        (
            "ND_surface_unlit",
            "color3f inputs:emission_color = (1, 0.5, 0.25)\n float inputs:emission.connect = </m/bright.outputs:out>",
        ),
    ];
    for (id, inputs) in textured {
        let Some((scene, found, warnings)) = material(&shader(id, inputs)) else { return };
        assert!(warnings.is_empty(), "{id}: {warnings:?}");
        assert_eq!(found.emission, Vec3::new(8.0, 4.0, 2.0), "{id}");
        assert!(found.emission_texture.is_some() && scene.is_lit(), "{id}");
    }
}

#[test]
fn curves_and_points_without_widths_take_a_share_of_their_spacing() {
    let hairs: Vec<String> = (0..100).map(|i| format!("({0}, 0, {1}), ({0}, 9, {1})", i % 10, i / 10)).collect();
    let text = format!(
        r#"
        def BasisCurves "hair" {{
            uniform token type = "linear"
            point3f[] points = [{}]
            int[] curveVertexCounts = [{}]
        }}
        def BasisCurves "alone" {{
            uniform token type = "linear"
            point3f[] points = [(0, 0, 50), (0, 1000, 50)]
            int[] curveVertexCounts = [2]
        }}
        def Points "dots" {{ point3f[] points = [(0, 0, -50), (2, 0, -50), (200, 0, -50), (202, 0, -50)]
        }}"#,
        hairs.join(", "),
        ["2"; 100].join(", ")
    );
    let Some((scene, warnings)) = scene(&text) else { return };
    let lowest = |place: &str| {
        let mesh = scene.meshes.iter().find(|mesh| mesh.place == place).unwrap();
        mesh.positions.iter().map(|p| p.x).fold(f32::INFINITY, f32::min)
    };
    // The spacing is 1. The bounds are 9 × 9 × 9, so their diagonal is 15.6. The width is limited
    // to 0.5 % of the diagonal.
    assert!((lowest("/hair") + 0.5 * 0.005 * 243f32.sqrt()).abs() < 1e-4, "{}", lowest("/hair"));
    assert!((lowest("/alone") + 0.5 * 0.005 * 1000.0).abs() < 1e-2, "{}", lowest("/alone"));
    assert!((lowest("/dots") + 0.5 * 0.75 * 2.0).abs() < 1e-3, "{}", lowest("/dots"));
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings.iter().all(|warning| warning.message.contains("no widths")), "{warnings:?}");
}

#[test]
fn curves_without_points_are_left_out_with_a_warning() {
    let text = r#"
        def BasisCurves "hair" {
            uniform token type = "linear"
            point3f[] points = [(0, 0, 0), (0, 5, 0), (1, 0, 0)]
            int[] curveVertexCounts = [2, 2]
            float[] widths = [0.5] (interpolation = "constant")
        }"#;
    let Some((scene, warnings)) = scene(text) else { return };
    let most = scene.meshes[0].positions.iter().fold(f32::NEG_INFINITY, |most, p| most.max(p.x));
    assert!(most < 0.5, "the second curve has only one point: {most}");
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(
        warnings[0].message.contains("expected counts with a sum of at most 3, the number of points, found 4"),
        "{warnings:?}"
    );
}

#[test]
fn lights_have_the_radiance_of_their_inputs() {
    let text = r#"
        def Plane "p" {}
        def SphereLight "a" (prepend apiSchemas = ["ShapingAPI"]) {
            float inputs:intensity = 3
            float inputs:exposure = 2
            color3f inputs:color = (1, 0.5, 0.25)
            float inputs:radius = 0.5
        }
        def RectLight "b" {
            float inputs:intensity = 1
            bool inputs:enableColorTemperature = 1
            float inputs:colorTemperature = 6500
        }
        def DistantLight "sun" { float inputs:intensity = 10
            float inputs:angle = 0
        }
        def DomeLight "sky" { float inputs:intensity = 0.5
        }"#;
    let Some((scene, warnings)) = scene(text) else { return };
    assert!(warnings.is_empty(), "{warnings:?}");
    let emission = |place: &str| {
        let mesh = scene.meshes.iter().find(|mesh| mesh.place == place).unwrap();
        scene.materials[mesh.material].emission
    };
    let sphere = emission("/a");
    // the mesh has a smaller area than the sphere, so its radiance is a little higher
    assert!((1.0..1.05).contains(&(sphere.x / 12.0)) && (sphere.x / sphere.z - 4.0).abs() < 1e-4, "{sphere}");
    let warm = emission("/b");
    assert!((warm - Vec3::ONE).abs().max_element() < 0.1, "6500 K is near white: {warm}");
    assert_eq!((scene.lights[0].intensity, scene.lights[0].kind), (Vec3::splat(10.0), LightKind::Directional));
    assert_eq!(scene.environment.unwrap().strength, Vec3::splat(0.5));
}

/// With `normalize`, the radiance of a mesh is divided by its area in the scene. This is the area
/// of all its subsets together, after the scale of each copy.
#[test]
fn mesh_lights_are_normalized_by_their_area_in_the_scene() {
    let lamp = |name: &str, more: &str| {
        format!(
            r#"def Mesh "{name}" (prepend apiSchemas = ["MeshLightAPI", "MaterialBindingAPI"]) {{
                point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)]
                int[] faceVertexCounts = [4, 4]
                int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 5, 2]
                uniform token subdivisionScheme = "none"
                float inputs:intensity = 8
                bool inputs:normalize = 1
                {more}
                def GeomSubset "right" {{
                    uniform token elementType = "face"
                    uniform token familyName = "materialBind"
                    int[] indices = [1]
                }}
            }}
            "#
        )
    };
    let scale = "float3 xformOp:scale = (2, 1, 1)\n uniform token[] xformOpOrder = [\"xformOp:scale\"]";
    let copies = r#"
            rel prototypes = </copies/small>
            int[] protoIndices = [0, 0, 0, 0]
            point3f[] positions = [(0, 0, 0), (9, 0, 0), (18, 0, 0), (27, 0, 0)]
            float3[] scales = [(1, 1, 1), (3, 3, 3), (1, 1, 1), (1, 2, 7)]"#;
    let text = format!("def PointInstancer \"copies\" {{ {copies}\n {} }}\n{}", lamp("small", ""), lamp("wide", scale));
    let Some((scene, warnings)) = scene(&text) else { return };
    assert!(warnings.is_empty(), "{warnings:?}");
    let mut found: Vec<(f32, bool, f32)> = Vec::new();
    for instance in &scene.instances {
        let mesh = &scene.meshes[instance.mesh];
        let place = instance.scene_from_mesh.translation.x;
        found.push((place, mesh.place.ends_with("wide"), scene.materials[mesh.material].emission.x));
    }
    found.sort_by(|a, b| a.partial_cmp(b).unwrap());
    // both parts of a mesh have one radiance
    let expected =
        [(0.0, false, 4.0), (0.0, true, 2.0), (9.0, false, 4.0 / 9.0), (18.0, false, 4.0), (27.0, false, 2.0)];
    assert_eq!(found.len(), 2 * expected.len(), "{found:?}");
    for (pair, expected) in found.chunks(2).zip(expected) {
        for part in pair {
            assert_eq!((part.0, part.1), (expected.0, expected.1));
            assert!((part.2 / expected.2 - 1.0).abs() < 1e-5, "{part:?} instead of {expected:?}");
        }
    }
    // the first and third copy share their meshes, and every mesh has an instance
    assert_eq!(scene.meshes.len(), 8);
}

#[test]
fn shapes_other_than_meshes_are_there() {
    let text = r#"
        def Sphere "ball" { double radius = 2
        }
        def Cylinder "can" { double radius = 1
            double height = 4
            uniform token axis = "X"
        }
        def BasisCurves "hair" {
            uniform token type = "linear"
            point3f[] points = [(0, 0, 0), (0, 5, 0), (1, 0, 0), (1, 5, 0)]
            int[] curveVertexCounts = [2, 2]
            float[] widths = [0.5] (interpolation = "constant")
        }
        def Points "dots" { point3f[] points = [(0, 0, 9), (0, 0, -9)]
            float[] widths = [1, 2]
        }
        def Mesh "smooth" {
            point3f[] points = [(-1, -1, -1), (1, -1, -1), (-1, 1, -1), (1, 1, -1), (-1, -1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, 1)]
            int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
            int[] faceVertexIndices = [0, 4, 6, 2, 1, 3, 7, 5, 0, 1, 5, 4, 2, 6, 7, 3, 0, 2, 3, 1, 4, 5, 7, 6]
        }"#;
    let Some((scene, warnings)) = scene(text) else { return };
    assert!(warnings.is_empty(), "{warnings:?}");
    let extent = |place: &str| {
        let mesh = scene.meshes.iter().find(|mesh| mesh.place == place).unwrap();
        mesh.positions.iter().fold(Vec3::ZERO, |most, p| most.max(p.abs()))
    };
    let near = |a: Vec3, b: Vec3| assert!((a - b).abs().max_element() < 1e-3, "{a} {b}");
    near(extent("/ball"), Vec3::splat(2.0));
    near(extent("/can"), Vec3::new(2.0, 1.0, 1.0));
    near(extent("/dots"), Vec3::new(1.0, 1.0, 10.0));
    assert!((extent("/hair").y - 5.0).abs() < 1e-5);
    // On the limit surface of a cube, the middle of a face is nearer to the centre than on the
    // cube, by the factor 68/81. Four levels turn 6 faces into 3072 triangles.
    near(extent("/smooth"), Vec3::splat(68.0 / 81.0));
    let smooth = scene.meshes.iter().find(|mesh| mesh.place == "/smooth").unwrap();
    assert_eq!((smooth.triangles.len(), smooth.positions.len()), (3072, 1538));
}
