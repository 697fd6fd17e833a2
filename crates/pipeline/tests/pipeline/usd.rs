//! The same scene gives the same picture from glTF and from USD. The tests need `LUMISTACK_PYTHON`
//! to name a Python with usd-core, and are skipped without it.

use std::path::Path;
use std::process::Command;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::{Renderer, Settings};
use lumistack_pipeline::{ImporterJob, LightJob, PoseJob, Registry, load_scene};
use lumistack_scene::Window;
use lumistack_testkit::statistics::Mean;

/// Size of a picture, and edge of the square blocks whose means are compared, pixels.
const ROWS: usize = 40;
const COLS: usize = 64;
const BLOCK: usize = 8;
/// Number of pictures of each scene, each with another seed.
const PICTURES: u64 = 24;
/// False-alarm rate per block and channel. For a normal distribution it gives a limit of 6.5
/// standard errors. The real rate is higher, 5 in 10⁸: the difference of two means of 24 pictures
/// each follows Student's t with 46 degrees of freedom. There are 240 differences, so a false alarm
/// occurs in 1 of 80,000 runs.
const RATE: f64 = 8e-11;
/// Tolerance for rounding, relative to the light of a block. Flipping texture coordinates twice
/// rounds them.
const ROUNDING: f64 = 1e-5;

/// Renders the scene `file` with [`PICTURES`] seeds, the first of which is `first_seed`. Returns
/// the mean of each block and channel over these pictures.
fn blocks(file: &str, first_seed: u64) -> Vec<Mean> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/still-life").join(file);
    let registry = Registry::built_in().unwrap();
    let (pose, importer, light) = (PoseJob::default(), ImporterJob::default(), LightJob::default());
    let scene = load_scene(&path, &pose, &importer, &registry, &light, None, task).unwrap().scene;
    let pitch_mm = 5.0;
    let geometry =
        FieldGeometry { rows: ROWS, cols: COLS, pitch_mm, grid: ViewGrid::single(Projection::Oblique, [0.0, 0.0]) };
    let window = Window::from_camera(&scene.cameras[0], scene.bounds(), geometry.size_mm()).unwrap();
    let renderer = Renderer::new(scene, task).unwrap();
    let mut sums = vec![Vec::new(); (ROWS / BLOCK) * (COLS / BLOCK) * 3];
    for seed in first_seed..first_seed + PICTURES {
        let settings = Settings { samples: 8, seed, ..Settings::default() };
        let picture = renderer.render_view(&window, &geometry, [0, 0], &settings, task).unwrap();
        let mut means = vec![0.0; sums.len()];
        for (i, &value) in picture.data().iter().enumerate() {
            let (row, col, channel) = (i / 3 / COLS, i / 3 % COLS, i % 3);
            let block = row / BLOCK * (COLS / BLOCK) + col / BLOCK;
            means[3 * block + channel] += f64::from(value) / (BLOCK * BLOCK) as f64;
        }
        sums.iter_mut().zip(means).for_each(|(sums, mean)| sums.push(mean));
    }
    assert!(warnings.take().is_empty(), "{file}");
    sums.into_iter().map(Mean::of).collect()
}

/// Returns true if `LUMISTACK_PYTHON` names a Python that reads USD; otherwise prints a note.
pub(crate) fn has_usd() -> bool {
    let python = std::env::var_os("LUMISTACK_PYTHON").unwrap_or_default();
    let has = Command::new(python).args(["-c", "import pxr"]).output().is_ok_and(|output| output.status.success());
    if !has {
        lumistack_testkit::skip::skipped("LUMISTACK_PYTHON names no Python with usd-core");
    }
    has
}

/// A camera that sees the floor of the room from above.
const CAMERA: &str = r#"
def Camera "above"
{
    double3 xformOp:translate = (0, 5, 7)
    float xformOp:rotateX = -30
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
}
"#;

/// Returns a scene of a glowing panel above a dark floor. Both materials have a shader with this
/// `id`. `color` and `rough` are the names of inputs, and `glow` sets the emission of the panel.
fn lit_room(id: &str, color: &str, rough: &str, glow: &str) -> String {
    // A material has a shader, and a picture that may scale the shader's emission.
    let material = |name: &str, inputs: &str| {
        format!(
            r#"
def Material "{name}"
{{
    token outputs:surface.connect = </{name}/s.outputs:surface>
    def Shader "s"
    {{
        uniform token info:id = "{id}"
        {inputs}
        token outputs:surface
    }}
    def Shader "weight"
    {{
        uniform token info:id = "ND_multiply_float"
        float inputs:in1.connect = </{name}/picture.outputs:out>
        float inputs:in2 = 6
        float outputs:out
    }}
    def Shader "picture"
    {{
        uniform token info:id = "ND_image_float"
        asset inputs:file = @./white.png@
        float outputs:out
    }}
}}
"#
        )
    };
    // A square is horizontal; `half` is half of its edge.
    let square = |name: &str, half: f32, height: f32| {
        format!(
            r#"
def Mesh "{name}" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{{
    point3f[] points = [(-{half}, {height}, -{half}), ({half}, {height}, -{half}), ({half}, {height}, {half}), (-{half}, {height}, {half})]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [3, 2, 1, 0]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
        interpolation = "vertex"
    )
    uniform token subdivisionScheme = "none"
    rel material:binding = </{name}_look>
}}
"#
        )
    };
    let dark = format!("color3f inputs:{color} = (0.004, 0.004, 0.004)\nfloat inputs:{rough} = 0.5");
    [
        "#usda 1.0\n".to_owned(),
        CAMERA.to_owned(),
        square("floor", 2.0, 0.0),
        square("panel", 0.8, 2.5),
        material("floor_look", &dark),
        material("panel_look", &format!("color3f inputs:{color} = (0, 0, 0)\n{glow}")),
    ]
    .concat()
}

/// Scenes that differ only in the syntax of their materials have the same light.
#[test]
fn the_syntax_of_materials_does_not_decide_about_light() {
    if !has_usd() {
        return;
    }
    // For each shader: its id, the names of its inputs for colour and roughness, and the inputs
    // that make the panel glow.
    let preview = ("diffuseColor", "roughness");
    let standard = ("base_color", "specular_roughness");
    let twins = [
        ("UsdPreviewSurface", preview, "color3f inputs:emissiveColor = (6, 6, 6)"),
        ("ND_UsdPreviewSurface_surfaceshader", preview, "color3f inputs:emissiveColor = (6, 6, 6)"),
        (
            "ND_standard_surface_surfaceshader",
            standard,
            "color3f inputs:emission_color = (1, 1, 1)\nfloat inputs:emission = 6",
        ),
        (
            "ND_standard_surface_surfaceshader",
            standard,
            "color3f inputs:emission_color = (1, 1, 1)\nfloat inputs:emission.connect = </panel_look/weight.outputs:out>",
        ),
        ("ND_open_pbr_surface_surfaceshader", standard, "float inputs:emission_luminance = 6"),
        (
            "ND_open_pbr_surface_surfaceshader",
            standard,
            "float inputs:emission_luminance.connect = </panel_look/weight.outputs:out>",
        ),
        (
            "ND_gltf_pbr_surfaceshader",
            ("base_color", "roughness"),
            "color3f inputs:emissive = (1, 1, 1)\nfloat inputs:emissive_strength = 6",
        ),
    ];
    let folder = tempfile::tempdir().unwrap();
    image::GrayImage::from_pixel(2, 2, image::Luma([255])).save(folder.path().join("white.png")).unwrap();
    // The light tree must find the panel, in every syntax of the emission.
    for (number, (id, (color, rough), glow)) in twins.into_iter().enumerate() {
        let path = folder.path().join(format!("twin{number}.usda"));
        std::fs::write(&path, lit_room(id, color, rough, glow)).unwrap();
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let registry = Registry::built_in().unwrap();
        let (pose, importer, light) = (PoseJob::default(), ImporterJob::default(), LightJob::default());
        let task = Task::quiet(&warnings, &cancel);
        let scene = load_scene(&path, &pose, &importer, &registry, &light, None, task).unwrap().scene;
        assert!(scene.is_lit() && scene.environment.is_none(), "{id} {glow}: {:?}", warnings.take());
    }
}

#[test]
fn gltf_and_usd_give_the_same_picture() {
    if !has_usd() {
        return;
    }
    let gltf = blocks("still-life.gltf", 1);
    assert!(gltf.iter().all(|mean| mean.value > 0.0 && mean.standard_error < 0.2 * mean.value));
    for (file, seed) in [("still-life.usda", 1001), ("still-life.usdz", 2001)] {
        for (ours, theirs) in gltf.iter().zip(blocks(file, seed)) {
            ours.assert_same(theirs, ROUNDING, RATE);
        }
    }
}
