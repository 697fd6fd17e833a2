//! Small stages, which the user's OpenUSD reads. The tests need `LUMISTACK_PYTHON` to name a Python
//! with usd-core, and are skipped without it.

use std::path::Path;

use glam::{Vec2, Vec3};
use lumistack_core::{Cancel, Collector, Task, Warning};
use lumistack_scene::{Projection, Scene};
use lumistack_usd::{LoadOptions, UsdError, contents, load};

use crate::common;

fn try_with(text: &str, options: &LoadOptions) -> (Result<Scene, UsdError>, Vec<Warning>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    write(&path, text);
    image::RgbaImage::new(1, 1).save(folder.path().join("rough.png")).unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let result = load(&path, options, Task::quiet(&warnings, &cancel)).map(|loaded| {
        assert!(loaded.files.contains(&std::fs::canonicalize(&path).unwrap()), "{:?}", loaded.files);
        loaded.scene
    });
    (result, warnings.take())
}

/// Writes a layer. USD's grammar requires a line break after every statement.
fn write(path: &Path, text: &str) {
    let text = text.replace('{', "{\n").replace('}', "\n}\n");
    std::fs::write(path, format!("#usda 1.0\n{text}\n")).unwrap();
}

fn scene_with(text: &str, options: &LoadOptions) -> Scene {
    let (scene, warnings) = try_with(text, options);
    assert!(warnings.is_empty(), "{warnings:?}");
    scene.unwrap()
}

fn scene(text: &str) -> Scene {
    scene_with(text, &LoadOptions::default())
}

const TRIANGLE: &str = r#"
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    uniform token subdivisionScheme = "none"
"#;

/// A blue material whose roughness comes from the picture `rough.png` next to the layer.
const BLUE: &str = r#"
def Material "blue" {
    token outputs:surface.connect = </blue/surface.outputs:surface>
    def Shader "surface" {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (0, 0, 1)
        float inputs:roughness.connect = </blue/picture.outputs:r>
        token outputs:surface
    }
    def Shader "picture" {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./rough.png@
        float2 inputs:st.connect = </blue/st.outputs:result>
        float outputs:r
    }
    def Shader "st" {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"#;

/// A path may contain brackets, which also separate a package from a file in it.
#[test]
fn scenes_in_folders_with_brackets_keep_their_files_and_pictures() {
    let Some(python) = common::python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = std::fs::canonicalize(folder.path()).unwrap().join("take[2");
    std::fs::create_dir(&folder).unwrap();
    let (path, package, picture) = (folder.join("scene].usda"), folder.join("scene[1].usdz"), folder.join("rough.png"));
    image::RgbaImage::new(3, 2).save(&picture).unwrap();
    write(&path, &[triangle_at("shown", 0.0, "rel material:binding = </blue>"), BLUE.into()].concat());
    let pack = "import sys; from pxr import Sdf, UsdUtils; assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(sys.argv[1]), sys.argv[2])";
    let packed = std::process::Command::new(python).args(["-c", pack]).arg(&path).arg(&package).status().unwrap();
    assert!(packed.success());
    for (path, files) in [(&path, vec![&path, &picture]), (&package, vec![&package])] {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let loaded = load(path, &LoadOptions::default(), Task::quiet(&warnings, &cancel)).unwrap();
        let warnings = warnings.take();
        assert!(warnings.is_empty(), "{warnings:?}");
        let size = |image: &lumistack_scene::Image| (image.width, image.height);
        assert_eq!(loaded.scene.images.iter().map(size).collect::<Vec<_>>(), [(3, 2)]);
        let mut found: Vec<_> = loaded.files.iter().collect();
        found.sort_by_key(|file| *file != path);
        assert_eq!(found, files);
    }
}

/// Returns the positions of the instances, sorted by x, then y, then z.
fn places(scene: &Scene) -> Vec<Vec3> {
    let mut places: Vec<Vec3> = scene.instances.iter().map(|i| i.scene_from_mesh.translation.into()).collect();
    places.sort_by(|a, b| a.to_array().partial_cmp(&b.to_array()).unwrap());
    places
}

fn triangle_at(name: &str, x: f32, more: &str) -> String {
    format!(
        "def Mesh \"{name}\" {{ {TRIANGLE}\n double3 xformOp:translate = ({x}, 0, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"]\n {more} }}\n"
    )
}

#[test]
fn what_is_hidden_or_no_render_geometry_is_left_out() {
    if common::python().is_none() {
        return;
    }
    let text = [
        triangle_at("shown", 1.0, ""),
        triangle_at("hidden", 2.0, "token visibility = \"invisible\""),
        triangle_at("proxy", 3.0, "uniform token purpose = \"proxy\""),
        triangle_at("guide", 4.0, "uniform token purpose = \"guide\""),
        triangle_at("render", 5.0, "uniform token purpose = \"render\""),
        format!("def Xform \"below\" {{ token visibility = \"invisible\"\n {} }}", triangle_at("a", 6.0, "")),
        format!(
            "def Xform \"proxies\" {{ uniform token purpose = \"proxy\"\n {} {} }}",
            triangle_at("a", 7.0, ""),
            triangle_at("b", 8.0, "uniform token purpose = \"render\"")
        ),
        format!("over \"over\" {{ {} }}", triangle_at("a", 9.0, "")),
        format!("class \"class\" {{ {} }}", triangle_at("a", 10.0, "")),
    ];
    let xs: Vec<f32> = places(&scene(&text.concat())).iter().map(|place| place.x).collect();
    assert_eq!(xs, [1.0, 5.0, 8.0]);
}

#[test]
fn z_up_is_turned_and_transforms_stack() {
    if common::python().is_none() {
        return;
    }
    let text = format!(
        "( upAxis = \"Z\" )\ndef Xform \"a\" {{ double3 xformOp:translate = (0, 0, 5)\n float xformOp:rotateZ = 90\n \
         uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:rotateZ\"]\n {} {} }}",
        triangle_at("b", 2.0, ""),
        "def Mesh \"reset\" { TRIANGLE uniform token[] xformOpOrder = [\"!resetXformStack!\"] }"
            .replace("TRIANGLE", TRIANGLE)
    );
    // (2, 0, 0) is rotated to (0, 2, 0), moved to (0, 2, 5), and z becomes y
    let found = places(&scene(&text));
    assert!((found[1] - Vec3::new(0.0, 5.0, -2.0)).length() < 1e-5 && found[0] == Vec3::ZERO, "{found:?}");
}

#[test]
fn instances_share_one_mesh_however_deep() {
    if common::python().is_none() {
        return;
    }
    let text = format!(
        "class Xform \"leaf\" {{ {} }}\n\
         class Xform \"branch\" {{\n\
         def Xform \"l\" (instanceable = true\n inherits = </leaf>) {{}}\n\
         def Xform \"r\" (instanceable = true\n inherits = </leaf>) {{ double3 xformOp:translate = (0, 10, 0)\n uniform token[] xformOpOrder = [\"xformOp:translate\"] }} }}\n\
         def Xform \"one\" (instanceable = true\n inherits = </branch>) {{}}\n\
         def Xform \"two\" (instanceable = true\n inherits = </branch>) {{ double3 xformOp:translate = (0, 0, 100)\n uniform token[] xformOpOrder = [\"xformOp:translate\"] }}",
        triangle_at("mesh", 1.0, "")
    );
    let scene = scene(&text);
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 4));
    let expected = [[1., 0., 0.], [1., 0., 100.], [1., 10., 0.], [1., 10., 100.]].map(Vec3::from);
    assert_eq!(places(&scene), expected);
}

#[test]
fn instances_take_materials_and_colours_from_above() {
    if common::python().is_none() {
        return;
    }
    let instance = |name: &str, more: &str| {
        format!("def Xform \"{name}\" (instanceable = true\n inherits = </leaf>) {{ {more} }}\n")
    };
    let red = "color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = \"constant\")";
    let text = [
        format!("class Xform \"leaf\" {{ {} }}", triangle_at("mesh", 1.0, "")),
        instance("plain", ""),
        instance("red", red),
        instance("also_red", red),
    ];
    let scene = scene(&text.concat());
    let mut colors: Vec<_> =
        scene.instances.iter().map(|i| scene.materials[scene.meshes[i.mesh].material].base_color.x).collect();
    colors.sort_by(f32::total_cmp);
    assert_eq!(colors, [0.18, 1.0, 1.0]);
    assert_eq!(scene.meshes.len(), 2);
}

#[test]
fn point_instancers_place_scale_turn_and_mask() {
    if common::python().is_none() {
        return;
    }
    let text = format!(
        "def PointInstancer \"p\" (inactiveIds = [13]) {{\n\
         rel prototypes = [</p/a>, </elsewhere/b>]\n int[] protoIndices = [0, 1, 0, 1, 0]\n\
         int64[] ids = [10, 11, 12, 13, 14]\n int64[] invisibleIds = [12]\n\
         point3f[] positions = [(0, 0, 0), (0, 1, 0), (0, 2, 0), (0, 3, 0), (0, 4, 0)]\n\
         float3[] scales = [(2, 2, 2), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1)]\n\
         quath[] orientations = [(1, 0, 0, 0), (0.7071, 0, 0, 0.7071), (1, 0, 0, 0), (1, 0, 0, 0), (1, 0, 0, 0)]\n\
         double3 xformOp:translate = (0, 0, 7)\n uniform token[] xformOpOrder = [\"xformOp:translate\"]\n {} }}\n\
         over \"elsewhere\" {{ {} }}",
        triangle_at("a", 1.0, ""),
        triangle_at("b", 1.0, "")
    );
    let scene = scene(&text);
    // id 10 is scaled, 11 is rotated by 90° about z, 12 is invisible, 13 is inactive, 14 is
    // unchanged
    let found = places(&scene);
    let expected = [[0., 2., 7.], [1., 4., 7.], [2., 0., 7.]].map(Vec3::from);
    assert!(found.len() == 3 && found.iter().zip(&expected).all(|(a, b)| (*a - *b).length() < 2e-3), "{found:?}");
    assert_eq!(scene.meshes.len(), 2);
}

/// Positions are interpolated between their samples at the time codes 12 and 36, and velocities are
/// ignored. Since the stage has no start time code, the time `None` reads the first sample.
#[test]
fn velocities_of_point_instancers_have_no_effect() {
    if common::python().is_none() {
        return;
    }
    let text = format!(
        "def PointInstancer \"p\" {{\n rel prototypes = </p/a>\n int[] protoIndices = [0, 0]\n\
         point3f[] positions.timeSamples = {{ 12: [(0, 0, 0), (10, 0, 0)], 36: [(2, 0, 0), (14, 0, 0)] }}\n\
         vector3f[] velocities.timeSamples = {{ 12: [(9, 9, 9), (9, 9, 9)], 36: [(9, 9, 9), (9, 9, 9)] }}\n\
         float3[] scales = [(1, 1, 1), (2, 2, 2)]\n {} }}",
        triangle_at("a", 1.0, "")
    );
    for (time_s, expected) in [(None, [1.0, 12.0]), (Some(1.0), [2.0, 14.0]), (Some(9.0), [3.0, 16.0])] {
        let scene = scene_with(&text, &LoadOptions { time_s, ..LoadOptions::default() });
        let expected = expected.map(|x| x * Vec3::X);
        assert_eq!(places(&scene), expected, "{time_s:?}");
    }
}

#[test]
fn nested_point_instancers_multiply() {
    if common::python().is_none() {
        return;
    }
    let text = format!(
        "def PointInstancer \"outer\" {{\n rel prototypes = </outer/inner>\n int[] protoIndices = [0, 0, 0]\n\
         point3f[] positions = [(0, 0, 0), (100, 0, 0), (200, 0, 0)]\n\
         def PointInstancer \"inner\" {{\n rel prototypes = </outer/inner/t>\n int[] protoIndices = [0, 0]\n\
         point3f[] positions = [(10, 0, 0), (20, 0, 0)]\n {} }} }}",
        triangle_at("t", 1.0, "")
    );
    let scene = scene(&text);
    let xs: Vec<f32> = places(&scene).iter().map(|place| place.x).collect();
    assert_eq!(xs, [11.0, 21.0, 111.0, 121.0, 211.0, 221.0]);
    assert_eq!(scene.meshes.len(), 1);
    let own = "def PointInstancer \"p\" { rel prototypes = </p>\n int[] protoIndices = [0]\n point3f[] positions = [(0, 0, 0)] }";
    let (scene, warnings) = try_with(&format!("{own}\n{}", triangle_at("t", 0.0, "")), &LoadOptions::default());
    assert_eq!(scene.unwrap().instances.len(), 1);
    assert!(warnings.iter().any(|warning| warning.message.contains("its own prototype")), "{warnings:?}");
}

#[test]
fn time_is_counted_from_the_first_time_code() {
    if common::python().is_none() {
        return;
    }
    let text = format!(
        "( startTimeCode = 101\n endTimeCode = 125\n timeCodesPerSecond = 24 )\ndef Mesh \"m\" {{ {TRIANGLE}\n \
         double3 xformOp:translate.timeSamples = {{ 101: (0, 0, 0), 125: (24, 0, 0) }}\n uniform token[] xformOpOrder = [\"xformOp:translate\"] }}"
    );
    for (time_s, x) in [(None, 0.0), (Some(0.0), 0.0), (Some(0.5), 12.0), (Some(9.0), 24.0), (Some(-1.0), 0.0)] {
        let scene = scene_with(&text, &LoadOptions { time_s, ..LoadOptions::default() });
        assert_eq!(places(&scene)[0].x, x, "{time_s:?}");
    }
}

/// Returns a leg of three joints as USD text, with `meshes` on it. The knee at (0, 1, 0) is rotated
/// by 90° about z.
fn leg(meshes: &str) -> String {
    let matrices = [0, 1, 2].map(|y| format!("((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, {y}, 0, 1))")).join(", ");
    let local = [0, 1, 1].map(|y| format!("((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, {y}, 0, 1))")).join(", ");
    let joints = "uniform token[] joints = [\"hip\", \"hip/knee\", \"hip/knee/foot\"]";
    format!(
        r#"
        def SkelRoot "Figure" {{
            def Skeleton "leg" (prepend apiSchemas = ["SkelBindingAPI"]) {{
                {joints}
                uniform matrix4d[] bindTransforms = [{matrices}]
                uniform matrix4d[] restTransforms = [{local}]
                rel skel:animationSource = </Figure/bent>
            }}
            def SkelAnimation "bent" {{
                {joints}
                quatf[] rotations = [(1, 0, 0, 0), (0.70710678, 0, 0, 0.70710678), (1, 0, 0, 0)]
                half3[] scales = [(1, 1, 1), (1, 1, 1), (1, 1, 1)]
                float3[] translations = [(0, 0, 0), (0, 1, 0), (0, 1, 0)]
            }}
            {meshes}
        }}"#
    )
}

/// Returns a triangle on the leg as USD text. Corner i follows the joint with index `indices[i]` in
/// the mesh's own list of joints.
fn on_leg(name: &str, joints: &str, indices: [usize; 3], interpolation: &str) -> String {
    format!(
        r#"def Mesh "{name}" (prepend apiSchemas = ["SkelBindingAPI"]) {{
            point3f[] points = [(0, 0, 0), (0, 2, 0), (1, 1, 0)]
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 2, 1]
            normal3f[] normals = [(1, 0, 0), (1, 0, 0), (0, 0, 1)] (
                interpolation = "{interpolation}"
            )
            uniform token subdivisionScheme = "none"
            rel skel:skeleton = </Figure/leg>
            uniform token[] skel:joints = [{joints}]
            int[] primvars:skel:jointIndices = [{}, {}, {}] (
                elementSize = 1
                interpolation = "vertex"
            )
            float[] primvars:skel:jointWeights = [1, 1, 1] (
                elementSize = 1
                interpolation = "vertex"
            )
        }}
        "#,
        indices[0], indices[1], indices[2]
    )
}

/// A mesh may list its own joints in its own order. Its authored normals are rotated with the
/// joints.
#[test]
fn meshes_with_joints_of_their_own_are_posed_with_their_normals() {
    if common::python().is_none() {
        return;
    }
    // the face has its corners in the order 0, 2, 1, so face-varying normals have that order too
    let both = [("vertex", [Vec3::X, Vec3::Y, Vec3::Z]), ("faceVarying", [Vec3::X, Vec3::Z, Vec3::Y])];
    for (interpolation, normals) in both {
        let scene = scene(&leg(&on_leg("shin", "\"hip/knee\", \"hip\"", [1, 0, 0], interpolation)));
        let mesh = &scene.meshes[0];
        let expected = [(Vec3::ZERO, normals[0]), (Vec3::NEG_X + Vec3::Y, normals[1]), (2.0 * Vec3::Y, normals[2])];
        for (position, normal) in expected {
            let near = mesh.positions.iter().position(|p| (*p - position).length() < 1e-5);
            let found = near.unwrap_or_else(|| panic!("{interpolation}: {position} in {:?}", mesh.positions));
            assert!(
                (mesh.normals[found] - normal).length() < 1e-4,
                "{interpolation}: {:?} {normal}",
                mesh.normals[found]
            );
        }
    }
}

/// A mesh with blend shapes keeps its authored normals, plus the weighted offsets of the blend
/// shapes. A joint at rest changes nothing.
#[test]
fn blend_shapes_move_points_and_authored_normals() {
    if common::python().is_none() {
        return;
    }
    let text = |interpolation: &str, normals: &str, joints: &str| {
        let face = TRIANGLE.replace("[0, 1, 2]", "[0, 2, 1]");
        format!(
            r#"
            def SkelRoot "Figure" (prepend apiSchemas = ["SkelBindingAPI"]) {{
                rel skel:skeleton = </Figure/still>
                def Skeleton "still" (prepend apiSchemas = ["SkelBindingAPI"]) {{
                    uniform token[] joints = ["one"]
                    uniform matrix4d[] bindTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]
                    uniform matrix4d[] restTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]
                    rel skel:animationSource = </Figure/smile>
                }}
                def SkelAnimation "smile" {{
                    uniform token[] joints = ["one"]
                    quatf[] rotations = [(1, 0, 0, 0)]
                    half3[] scales = [(1, 1, 1)]
                    float3[] translations = [(0, 0, 0)]
                    uniform token[] blendShapes = ["up", "plain"]
                    float[] blendShapeWeights = [0.5, 1]
                }}
                def Mesh "face" (prepend apiSchemas = ["SkelBindingAPI"]) {{
                    {face}
                    normal3f[] normals = {normals} (
                        interpolation = "{interpolation}"
                    )
                    {joints}
                    uniform token[] skel:blendShapes = ["up", "plain"]
                    rel skel:blendShapeTargets = [</Figure/face/up>, </Figure/face/plain>]
                    def BlendShape "up" {{
                        uniform vector3f[] offsets = [(0, 0, 2)]
                        uniform vector3f[] normalOffsets = [(0, 2, 0)]
                        uniform int[] pointIndices = [1]
                    }}
                    def BlendShape "plain" {{
                        uniform vector3f[] offsets = [(0, 0, 0), (0, 0, 0), (0, 0, 3)]
                    }}
                }}
            }}"#
        )
    };
    let joint = "int[] primvars:skel:jointIndices = [0] (\n elementSize = 1\n interpolation = \"constant\"\n)\n\
        float[] primvars:skel:jointWeights = [1] (\n elementSize = 1\n interpolation = \"constant\"\n)";
    let tilted = (Vec3::X + Vec3::Y).normalize();
    let each = "[(0, 1, 0), (1, 0, 0), (0, 0, 1)]";
    let cases = [
        ("vertex", each, "", [Vec3::Y, tilted, Vec3::Z]),
        ("vertex", each, joint, [Vec3::Y, tilted, Vec3::Z]),
        ("faceVarying", "[(0, 1, 0), (0, 0, 1), (1, 0, 0)]", "", [Vec3::Y, tilted, Vec3::Z]),
        ("uniform", "[(1, 0, 0)]", "", [Vec3::X; 3]),
    ];
    for (interpolation, normals, joints, expected) in cases {
        let scene = scene(&text(interpolation, normals, joints));
        let mesh = &scene.meshes[0];
        let points = [Vec3::ZERO, Vec3::new(1.0, 0.0, 1.0), Vec3::new(0.0, 1.0, 3.0)];
        for (position, normal) in points.into_iter().zip(expected) {
            let found = mesh.positions.iter().position(|p| (*p - position).length() < 1e-5);
            let found = found.unwrap_or_else(|| panic!("{interpolation}: {position} in {:?}", mesh.positions));
            let known = mesh.normals[found];
            assert!((known - normal).length() < 1e-5, "{interpolation} {joints}: {known} instead of {normal}");
        }
    }
}

#[test]
fn meshes_that_cannot_be_posed_keep_their_rest_pose_and_are_named() {
    if common::python().is_none() {
        return;
    }
    let meshes = [
        on_leg("posed", "\"hip\", \"hip/knee\"", [0, 1, 1], "vertex"),
        on_leg("astray", "\"hip\", \"hip/knee\"", [0, 1, 7], "vertex"),
        on_leg("stranger", "\"wing\"", [0, 0, 0], "vertex"),
    ];
    let (scene, warnings) = try_with(&leg(&meshes.concat()), &LoadOptions::default());
    let scene = scene.unwrap();
    let words =
        [("posed", None), ("astray", Some("cannot be posed")), ("stranger", Some("joints that its skeleton lacks"))];
    for (name, expected) in words {
        let is_posed = expected.is_none();
        let mesh = scene.meshes.iter().find(|mesh| mesh.place.ends_with(name)).expect(name);
        let tip = if is_posed { Vec3::new(-1.0, 1.0, 0.0) } else { Vec3::new(0.0, 2.0, 0.0) };
        let is_there = mesh.positions.iter().any(|position| (*position - tip).length() < 1e-5);
        assert!(is_there, "{name}: {:?}", mesh.positions);
        let said: Vec<&str> = warnings.iter().filter(|w| w.place.ends_with(name)).map(|w| w.message.as_str()).collect();
        assert_eq!(said.len(), usize::from(!is_posed), "{name}: {warnings:?}");
        assert!(said.iter().zip(expected).all(|(said, expected)| said.contains(expected)), "{name}: {said:?}");
    }
}

#[test]
fn variants_are_chosen_by_name_on_all_prims_or_one() {
    if common::python().is_none() {
        return;
    }
    let chair = |name: &str, z: f32| {
        format!(
            "def Xform \"{name}\" (variants = {{ string size = \"small\" }}\n prepend variantSets = \"size\") {{\n\
             double3 xformOp:translate = (0, 0, {z})\n uniform token[] xformOpOrder = [\"xformOp:translate\"]\n\
             variantSet \"size\" = {{ \"small\" {{ {} }} \"large\" {{ {} }} }} }}\n",
            triangle_at("m", 1.0, ""),
            triangle_at("m", 2.0, "")
        )
    };
    let text = chair("a", 0.0) + &chair("b", 5.0);
    let with = |variants: &[&str]| {
        let variants = variants.iter().map(|&text| text.to_owned()).collect();
        try_with(&text, &LoadOptions { variants, ..LoadOptions::default() }).0
    };
    let sizes = |variants: &[&str]| {
        let mut found = places(&with(variants).unwrap());
        found.sort_by(|a, b| a.z.total_cmp(&b.z));
        [found[0].x, found[1].x]
    };
    assert_eq!(sizes(&[]), [1.0, 1.0]);
    assert_eq!(sizes(&["size=large"]), [2.0, 2.0]);
    assert_eq!(sizes(&["/b{size=large}"]), [1.0, 2.0]);
    assert_eq!(sizes(&["size=large", "/b{size=small}"]), [2.0, 1.0]);
    for wrong in ["size=huge", "colour=red", "/c{size=large}", "nonsense"] {
        let error = with(&[wrong]).unwrap_err().to_string();
        assert!(
            error.contains("/a{size}: large, small") && error.ends_with(&format!("found the variant {wrong}")),
            "{error}"
        );
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    write(&path, &text);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let found = contents(&path, Task::quiet(&warnings, &cancel)).unwrap();
    assert_eq!((found.prims, found.meshes, found.points, found.variant_sets.len()), (4, 2, 6, 2));
    assert_eq!(found.variant_sets[0].choices, ["large", "small"]);
}

#[test]
fn animated_points_are_counted() {
    if common::python().is_none() {
        return;
    }
    let text = "#usda 1.0\n(\n startTimeCode = 3\n endTimeCode = 4\n)\ndef Mesh \"a\"\n{\n \
        point3f[] points.timeSamples = { 3: [(0, 0, 0), (1, 0, 0), (0, 1, 0)], 4: [] }\n}\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    write(&path, text);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let found = contents(&path, Task::quiet(&warnings, &cancel)).unwrap();
    assert_eq!((found.meshes, found.points), (1, 3));
}

#[test]
fn meshes_bring_their_primvars_orientation_and_subsets() {
    if common::python().is_none() {
        return;
    }
    let text = r#"
def Mesh "m" {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)]
    int[] faceVertexCounts = [4, 4]
    int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 5, 2]
    uniform token orientation = "leftHanded"
    uniform token subdivisionScheme = "none"
    uniform bool doubleSided = false
    normal3f[] normals = [(0, 0, -1)] (interpolation = "constant")
    color3f[] primvars:displayColor = [(1, 0, 0), (0, 0, 1)] (interpolation = "uniform")
    int[] primvars:displayColor:indices = [1, 0]
    float[] primvars:displayOpacity = [0.5]
    def GeomSubset "right" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [1]
        rel material:binding = </blue>
    }
}
"#;
    let text = &format!("{text}{BLUE}");
    let scene = scene(text);
    assert_eq!((scene.meshes.len(), scene.triangle_count()), (2, 4));
    for mesh in &scene.meshes {
        assert!(mesh.normals.iter().all(|normal| *normal == Vec3::NEG_Z));
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
            assert!((b - a).cross(c - a).z < 0.0);
        }
        assert!(!scene.materials[mesh.material].double_sided);
    }
    let plain = &scene.meshes[0];
    assert!(plain.colors.iter().all(|color| color.to_array() == [0.0, 0.0, 1.0, 0.5]), "{:?}", plain.colors);
    assert_eq!(scene.materials[scene.meshes[1].material].name, "blue");
    assert!(scene.meshes[1].positions.iter().all(|position| position.x >= 1.0));
}

#[test]
fn primvars_that_do_not_fit_are_left_out_with_a_warning() {
    if common::python().is_none() {
        return;
    }
    let text = triangle_at(
        "m",
        0.0,
        "texCoord2f[] primvars:st = [(0, 0)] (interpolation = \"vertex\")\n normal3f[] normals = [(0, 0, 1), (0, 0, 1)] (interpolation = \"vertex\")",
    );
    let (scene, warnings) = try_with(&text, &LoadOptions::default());
    assert_eq!(scene.unwrap().meshes[0].normals, [Vec3::Z; 3]);
    assert!(
        warnings.iter().any(|warning| warning.message.contains(
            "normals is left out, since it has a list of length 2, but its interpolation \"vertex\" needs length 3"
        )),
        "{warnings:?}"
    );
}

#[test]
fn broken_meshes_do_not_take_the_others_away() {
    if common::python().is_none() {
        return;
    }
    let broken = "def Mesh \"broken\" { point3f[] points = [(0, 0, 0)]\n int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2] }\n";
    let (scene, warnings) = try_with(&format!("{broken}{}", triangle_at("m", 0.0, "")), &LoadOptions::default());
    assert_eq!(scene.unwrap().instances.len(), 1);
    assert!(
        warnings.iter().any(|warning| warning
            .message
            .contains("expected the index of a point, below 1, found 1; the mesh is left out")),
        "{warnings:?}"
    );
    let (scene, _) = try_with(broken, &LoadOptions::default());
    assert!(scene.unwrap_err().to_string().contains("at least one triangle"));
}

#[test]
fn cameras_keep_their_angles_and_focus() {
    if common::python().is_none() {
        return;
    }
    let camera = |name: &str, more: &str| {
        format!(
            "def Camera \"{name}\" {{ float focalLength = 50\n float horizontalAperture = 36\n float verticalAperture = 24\n {more}\n \
             double3 xformOp:translate = (0, 0, 9)\n uniform token[] xformOpOrder = [\"xformOp:translate\"] }}\n"
        )
    };
    let text = [
        "( customLayerData = { dictionary cameraSettings = { string boundCamera = \"/second\" } } )\n".to_owned(),
        camera("first", "token projection = \"orthographic\""),
        camera("second", "float focusDistance = 4"),
        triangle_at("m", 0.0, ""),
    ];
    let scene = scene(&text.concat());
    let [second, first] = &scene.cameras[..] else { panic!("{:?}", scene.cameras) };
    assert_eq!((second.name.as_str(), first.name.as_str()), ("second", "first"));
    assert_eq!((second.focus_distance, first.focus_distance), (Some(4.0), None));
    assert_eq!(second.scene_from_camera.translation, glam::Vec3A::new(0.0, 0.0, 9.0));
    let Projection::Perspective { vertical_fov_rad, aspect } = second.projection else { panic!() };
    assert!((vertical_fov_rad - 2.0 * 0.24f32.atan()).abs() < 1e-6 && aspect == Some(1.5));
    let Projection::Orthographic { half_width, half_height } = first.projection else { panic!() };
    assert!((half_width - 1.8).abs() < 1e-6 && (half_height - 1.2).abs() < 1e-6);
}

#[test]
fn what_cannot_be_composed_is_a_warning_and_what_cannot_be_opened_an_error() {
    if common::python().is_none() {
        return;
    }
    let text = format!("def Xform \"gone\" (references = @missing.usda@) {{}}\n{}", triangle_at("m", 0.0, ""));
    let (scene, warnings) = try_with(&text, &LoadOptions::default());
    assert_eq!(scene.unwrap().instances.len(), 1);
    assert!(warnings.len() == 1 && warnings[0].place.ends_with("scene.usda: /gone"), "{warnings:?}");
    assert!(warnings[0].message.contains("missing.usda"), "{warnings:?}");
    let (scene, _) = try_with("def {", &LoadOptions::default());
    let error = scene.unwrap_err();
    assert!(matches!(error, UsdError::Refused { .. }) && error.to_string().contains("scene.usda"), "{error}");
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let error = load(Path::new("/no/such.usda"), &LoadOptions::default(), Task::quiet(&warnings, &cancel)).unwrap_err();
    assert!(error.to_string().starts_with("/no/such.usda: "), "{error}");
}

#[test]
fn texture_coordinates_point_down() {
    if common::python().is_none() {
        return;
    }
    let st = "texCoord2f[] primvars:st = [(0, 0), (1, 0), (0.25, 1)] (interpolation = \"faceVarying\")\n rel material:binding = </blue>";
    let with_material =
        triangle_at("m", 0.0, st).replace("\"m\"", "\"m\" (prepend apiSchemas = [\"MaterialBindingAPI\"])");
    let scene = scene(&(with_material + BLUE));
    assert_eq!(scene.meshes[0].uvs[0], [Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(0.25, 0.0)]);
}
