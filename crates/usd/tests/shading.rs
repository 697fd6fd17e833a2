//! Shader networks and lights of stages, written for the test, through the user's OpenUSD: needs `LUMISTACK_PYTHON`, and is skipped without.

mod common;

use glam::{Vec2, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Warning};
use lumistack_scene::{LightKind, Material, Scene};
use lumistack_usd::{LoadOptions, load};

/// A scene of a stage and pictures beside it; `None` (with a message) without a Python.
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
    // (1, 1) is scaled to (2, 3), turned to (−3, 2), moved to (−2.75, 2.5); v points down here
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
    // and not where none does
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
    // the mesh lacks a little area, which its radiance makes up for
    assert!((1.0..1.05).contains(&(sphere.x / 12.0)) && (sphere.x / sphere.z - 4.0).abs() < 1e-4, "{sphere}");
    let warm = emission("/b");
    assert!((warm - Vec3::ONE).abs().max_element() < 0.1, "6500 K is near white: {warm}");
    assert_eq!((scene.lights[0].intensity, scene.lights[0].kind), (Vec3::splat(10.0), LightKind::Directional));
    assert_eq!(scene.environment.unwrap().strength, Vec3::splat(0.5));
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
    // the limit surface of a cube: the middle of a face at 68/81, four levels of 6 faces
    near(extent("/smooth"), Vec3::splat(68.0 / 81.0));
    let smooth = scene.meshes.iter().find(|mesh| mesh.place == "/smooth").unwrap();
    assert_eq!((smooth.triangles.len(), smooth.positions.len()), (3072, 1538));
}
