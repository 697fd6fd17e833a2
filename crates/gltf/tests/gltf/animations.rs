//! Tests of animations. They write small files, or take a file of other projects, and check the
//! scene at given times.

use crate::support::{Builder, F32, I8, I16, Memory, U8, U16, assets, load_choosing, load_file_choosing};
use glam::{Quat, Vec3};
use lumistack_gltf::LoadOptions;
use lumistack_scene::Scene;
use serde_json::{Value, json};

const TOLERANCE: f32 = 1e-5;

/// Returns two nodes with triangles; the mesh of node 0 has two morph targets that lift it by 1 and
/// by 10.
fn animated(animations: impl FnOnce(&mut Builder) -> Vec<Value>) -> Builder {
    let mut b = Builder::triangle();
    let one = b.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    let ten = b.floats("VEC3", &[0.0, 0.0, 10.0].repeat(3));
    b.set("/meshes/0/primitives/0/targets", json!([{"POSITION": one}, {"POSITION": ten}]));
    b.push("meshes", json!({"primitives": [{"attributes": {"POSITION": 0}}]}));
    b.push("nodes", json!({"mesh": 1, "translation": [0, 0, 9], "scale": [2, 2, 2]}));
    b.set("/scenes/0/nodes", json!([0, 1]));
    let list = animations(&mut b);
    b.set("/animations", json!(list));
    b
}

/// Returns an animation with one channel.
fn one_channel(node: usize, path: &str, interpolation: &str, input: usize, output: usize) -> Value {
    json!({"channels": [{"sampler": 0, "target": {"node": node, "path": path}}],
        "samplers": [{"input": input, "output": output, "interpolation": interpolation}]})
}

fn at(b: &Builder, time_s: f64) -> Scene {
    let (scene, warnings) = load_choosing(&b.glb(), &LoadOptions { time_s: Some(time_s), ..LoadOptions::default() });
    assert_eq!(warnings, Vec::<String>::new());
    scene.unwrap()
}

fn refusal(b: &Builder) -> String {
    load_choosing(&b.glb(), &LoadOptions { time_s: Some(0.5), ..LoadOptions::default() }).0.unwrap_err().to_string()
}

fn assert_near(found: Vec3, expected: Vec3) {
    assert!((found - expected).abs().max_element() < TOLERANCE, "expected {expected}, found {found}");
}

/// Returns the position of a point of an instance in the scene.
fn placed(scene: &Scene, instance: usize, point: Vec3) -> Vec3 {
    scene.instances[instance].scene_from_mesh.transform_point3(point)
}

#[test]
fn steps_and_lines_between_keys_and_holds_at_the_ends() {
    for (interpolation, expected) in
        [("LINEAR", [1.0, 1.0, 3.0, 5.0, 4.0, 3.0, 3.0]), ("STEP", [1.0, 1.0, 1.0, 5.0, 5.0, 3.0, 3.0])]
    {
        let b = animated(|b| {
            let input = b.floats("SCALAR", &[1.0, 2.0, 4.0]);
            let output = b.floats("VEC3", &[1.0, 0.0, -2.0, 5.0, 0.0, -10.0, 3.0, 0.0, -6.0]);
            vec![one_channel(1, "translation", interpolation, input, output)]
        });
        for (time_s, expected) in [0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0].into_iter().zip(expected) {
            // the scale of 2 is not animated and stays
            assert_near(placed(&at(&b, time_s), 1, Vec3::X), Vec3::new(expected + 2.0, 0.0, -2.0 * expected));
        }
    }
}

#[test]
fn splines_have_the_values_and_tangents_of_their_keys() {
    // x(t) = t³ − 2t² + 3 from t = 0.5 to 3; its Hermite spline is the cubic itself
    let value = |t: f32| t * t * t - 2.0 * t * t + 3.0;
    let slope = |t: f32| 3.0 * t * t - 4.0 * t;
    let keys = [0.5f32, 1.25, 3.0];
    let b = animated(|b| {
        let input = b.floats("SCALAR", &keys);
        let elements = keys.iter().flat_map(|&t| [slope(t), value(t), slope(t)]);
        let elements: Vec<f32> = elements.flat_map(|x| [x, 0.5 * x, 0.0]).collect();
        let output = b.floats("VEC3", &elements);
        vec![one_channel(1, "scale", "CUBICSPLINE", input, output)]
    });
    for step in 0..=20 {
        let t = 0.5 + 2.5 * step as f32 / 20.0;
        let expected = value(t);
        // the animated scale along y is half of the scale along x
        let size = at_scale(&b, f64::from(t));
        assert!((size.x - expected).abs() < 1e-4 && (size.y - 0.5 * expected).abs() < 1e-4, "{t}: {size} {expected}");
    }
}

/// Returns the scale of node 1 along each of its axes. A scale may be zero.
fn at_scale(b: &Builder, time_s: f64) -> Vec3 {
    let mut b = b.clone();
    // the position of a child shows the scale, even a scale of zero, which would hide a mesh
    let child = b.push("nodes", json!({"translation": [1, 1, 1]}));
    b.set("/nodes/1", json!({"children": [child]}));
    b.push("cameras", json!({"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}));
    let light = json!({"lights": [{"type": "point"}]});
    b.set("/extensions", json!({"KHR_lights_punctual": light}));
    b.set(&format!("/nodes/{child}/extensions"), json!({"KHR_lights_punctual": {"light": 0}}));
    at(&b, time_s).lights[0].position
}

#[test]
fn rotations_take_the_shorter_arc_at_constant_speed() {
    let quarter = Quat::from_rotation_z(std::f32::consts::FRAC_PI_2);
    // the quaternions q and −q, of any length, represent the same rotation
    for sign in [1.0, -1.0] {
        let b = animated(|b| {
            let input = b.floats("SCALAR", &[0.0, 2.0]);
            let values: Vec<f32> =
                Quat::IDENTITY.to_array().into_iter().chain(quarter.to_array().map(|v| 3.0 * sign * v)).collect();
            let output = b.floats("VEC4", &values);
            vec![one_channel(0, "rotation", "LINEAR", input, output)]
        });
        for step in 0..=8 {
            let angle = std::f32::consts::FRAC_PI_2 * step as f32 / 8.0;
            assert_near(placed(&at(&b, step as f64 / 4.0), 0, Vec3::X), Vec3::new(angle.cos(), angle.sin(), 0.0));
        }
    }
}

#[test]
fn rotations_come_in_every_width() {
    // The first key is no rotation, and the second is half a turn about z. At a time halfway
    // between the keys, the node has made a quarter turn.
    let cases: [(u32, Vec<u8>); 5] = [
        (F32, [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect()),
        (I8, vec![0, 0, 0, 127, 0, 0, 127, 0]),
        (U8, vec![0, 0, 0, 255, 0, 0, 255, 0]),
        (I16, [0i16, 0, 0, 32767, 0, 0, 32767, 0].iter().flat_map(|v| v.to_le_bytes()).collect()),
        (U16, [0u16, 0, 0, 65535, 0, 0, 65535, 0].iter().flat_map(|v| v.to_le_bytes()).collect()),
    ];
    for (component, bytes) in cases {
        let b = animated(|b| {
            let input = b.floats("SCALAR", &[0.0, 1.0]);
            let output = b.accessor(component, "VEC4", 2, &bytes);
            b.set(&format!("/accessors/{output}/normalized"), json!(component != F32));
            vec![one_channel(0, "rotation", "LINEAR", input, output)]
        });
        assert_near(placed(&at(&b, 0.5), 0, Vec3::X), Vec3::Y);
    }
}

#[test]
fn weights_move_morph_targets() {
    let mut b = animated(|b| {
        let input = b.floats("SCALAR", &[0.0, 1.0]);
        // the values are normalized, two for each key, since the mesh has two targets
        let output = b.accessor(U8, "SCALAR", 4, &[0, 255, 255, 51]);
        b.set(&format!("/accessors/{output}/normalized"), json!(true));
        vec![one_channel(0, "weights", "LINEAR", input, output)]
    });
    b.set("/nodes/0/weights", json!([0.5, 0.5]));
    for (time_s, expected) in [(0.0, 10.0), (0.25, 0.25 + 8.0), (1.0, 1.0 + 2.0)] {
        let scene = at(&b, time_s);
        assert_near(scene.meshes[scene.instances[0].mesh].positions[1], Vec3::new(1.0, 0.0, expected));
    }
    let (scene, warnings) = load_choosing(&b.glb(), &LoadOptions::default());
    assert_eq!(scene.unwrap().meshes[0].positions[0].z, 5.5);
    let expected = "test.gltf: /animations: the file is animated; its nodes keep their own values, since neither a time nor an animation is given";
    assert_eq!(warnings, [expected]);
}

#[test]
fn cubic_weights_have_three_groups_per_key() {
    let b = animated(|b| {
        let input = b.floats("SCALAR", &[0.0, 2.0]);
        // each key has in-tangents, values and out-tangents of two targets: the first weight rises
        // as 1.5 t² − 0.5 t³ (from 0 to 2), the second stays at 1
        let key = |value: [f32; 2]| [0.0, 0.0, value[0], value[1], 0.0, 0.0];
        let values: Vec<f32> = [key([0.0, 1.0]), key([2.0, 1.0])].concat();
        let output = b.floats("SCALAR", &values);
        vec![one_channel(0, "weights", "CUBICSPLINE", input, output)]
    });
    for time_s in [0.0, 0.5, 1.0, 1.75, 2.0] {
        let u = time_s / 2.0;
        let expected = 2.0 * (3.0 * u * u - 2.0 * u * u * u) + 10.0;
        let z = at(&b, time_s).meshes[0].positions[0].z;
        assert!((f64::from(z) - expected).abs() < 1e-5, "{time_s}: {z} {expected}");
    }
}

#[test]
fn outputs_may_be_sparse() {
    let b = animated(|b| {
        let input = b.floats("SCALAR", &[0.0, 1.0, 2.0]);
        let indices = b.view(&[1]);
        let values: Vec<u8> = [4.0f32, 0.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let values = b.view(&values);
        let output = b.push(
            "accessors",
            json!({"componentType": F32, "type": "VEC3", "count": 3, "sparse": {"count": 1,
                "indices": {"bufferView": indices, "componentType": U8}, "values": {"bufferView": values}}}),
        );
        vec![one_channel(0, "translation", "LINEAR", input, output)]
    });
    assert_near(placed(&at(&b, 0.75), 0, Vec3::ZERO), 3.0 * Vec3::X);
    assert_near(placed(&at(&b, 1.5), 0, Vec3::ZERO), 2.0 * Vec3::X);
}

/// Returns a file with at most three animations: the first two move different nodes, the third
/// moves the same node as the first.
fn several(count: usize) -> Builder {
    animated(|b| {
        let input = b.floats("SCALAR", &[0.0]);
        let mut list = Vec::new();
        for (node, x, name) in [(0, 1.0, "Hop"), (1, 2.0, "Jump"), (0, 3.0, "Leap")] {
            let output = b.floats("VEC3", &[x, 0.0, 0.0]);
            let mut animation = one_channel(node, "translation", "LINEAR", input, output);
            animation["name"] = json!(name);
            list.push(animation);
        }
        list.truncate(count);
        list
    })
}

#[test]
fn animations_are_chosen_by_name_or_number() {
    let b = several(3);
    let xs = |animation: &str, time_s: Option<f64>| {
        let options = LoadOptions { time_s, animation: Some(animation.into()), ..LoadOptions::default() };
        let (scene, warnings) = load_choosing(&b.glb(), &options);
        assert_eq!(warnings, Vec::<String>::new());
        scene.map(|scene| [0, 1].map(|i| placed(&scene, i, Vec3::ZERO).x)).map_err(|error| error.to_string())
    };
    assert_eq!(xs("Hop", Some(0.0)), Ok([1.0, 0.0]));
    // without a given time, the time is 0
    assert_eq!(xs("Jump", None), Ok([0.0, 2.0]));
    assert_eq!(xs("2", None), Ok([3.0, 0.0]));
    let expected =
        "test.gltf: expected the name or number of a scene animation (0 (Hop), 1 (Jump), 2 (Leap)), found Crawl";
    assert_eq!(xs("Crawl", None), Err(expected.into()));
}

#[test]
fn without_a_choice_animations_that_do_not_conflict_play_together() {
    let scene = at(&several(2), 0.0);
    assert_eq!([0, 1].map(|i| placed(&scene, i, Vec3::ZERO).x), [1.0, 2.0]);
    let options = LoadOptions { time_s: Some(0.0), ..LoadOptions::default() };
    let (scene, warnings) = load_choosing(&several(3).glb(), &options);
    assert_eq!([0, 1].map(|i| placed(scene.as_ref().unwrap(), i, Vec3::ZERO).x), [1.0, 0.0]);
    let expected = "test.gltf: /animations: two or more animations move the same property of a node; only the first of the file's animations is played. The animations are 0 (Hop), 1 (Jump), 2 (Leap)";
    assert_eq!(warnings, [expected]);
    // a time for a file without animations causes a warning
    let (_, warnings) = load_choosing(&Builder::triangle().glb(), &options);
    assert_eq!(warnings, ["test.gltf: /animations: the file has no animations; the time has no effect"]);
}

#[test]
fn a_matrix_stands_for_what_is_not_animated() {
    let mut b = several(1);
    b.set("/nodes/0/matrix", json!([0, 3, 0, 0, -3, 0, 0, 0, 0, 0, 3, 0, 7, 8, 9, 1]));
    let scene = at(&b, 0.0);
    assert_near(placed(&scene, 0, Vec3::X), Vec3::new(1.0, 3.0, 0.0));
}

#[test]
fn pointers_stand_still_with_a_warning() {
    let mut b = several(1);
    let pointer = json!({"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/nodes/0/scale"}}});
    b.set("/animations/0/channels", json!([{"sampler": 0, "target": pointer}]));
    b.set("/extensionsUsed", json!(["KHR_animation_pointer"]));
    let options = LoadOptions { time_s: Some(0.0), ..LoadOptions::default() };
    let (scene, warnings) = load_choosing(&b.glb(), &options);
    assert!(scene.is_ok());
    let expected = [
        "/extensionsUsed/0: KHR_animation_pointer is not supported and has no effect",
        "/animations/0/channels/0/target/path: \"pointer\" is not supported; the property keeps its value",
    ];
    assert_eq!(warnings, expected.map(|warning| format!("test.gltf: {warning}")));
}

#[test]
fn broken_animations_are_named() {
    let good = animated(|b| {
        let input = b.floats("SCALAR", &[0.0, 1.0]);
        let output = b.floats("VEC3", &[0.0; 6]);
        vec![one_channel(0, "translation", "LINEAR", input, output)]
    });
    at(&good, 0.5);
    let sampler = good.json["animations"][0]["samplers"][0].clone();
    let count = good.json["accessors"].as_array().unwrap().len();
    let cases: [(&str, Value, &str); 11] = [
        ("channels/0/sampler", json!(1), "/channels/0/sampler: expected an index below 1, found 1"),
        ("channels/0/target/node", json!(7), "/target/node: expected an index below 2, found 7"),
        ("channels/0/target", json!(null), "/channels/0/target: expected an object, found null"),
        ("channels", json!({}), "/animations/0/channels: expected a list, found {}"),
        ("samplers/0/interpolation", json!("BEZIER"), "expected LINEAR, STEP or CUBICSPLINE, found \"BEZIER\""),
        (
            "samplers/0/interpolation",
            json!("CUBICSPLINE"),
            "/output: expected 2 × 3 elements (keys of the input × elements per key), found 2",
        ),
        ("samplers/0/input", json!(99), "/samplers/0/input: expected an index below"),
        ("samplers/0/input", sampler["output"].clone(), "/samplers/0/input: expected SCALAR of FLOAT"),
        ("samplers/0/output", sampler["input"].clone(), "/samplers/0/output: expected VEC3 of FLOAT"),
        (
            "samplers/0/output",
            json!(1),
            "/output: expected 2 × 1 elements (keys of the input × elements per key), found 3",
        ),
        ("samplers/0/input", json!(count), "/input: expected times that increase, found 2 before 2"),
    ];
    for (field, value, expected) in cases {
        let mut b = good.clone();
        b.floats("SCALAR", &[1.0, 2.0, 2.0]);
        b.set(&format!("/animations/0/{field}"), value);
        let message = refusal(&b);
        assert!(message.contains(expected), "{field}: {message}");
    }
    let mut b = good.clone();
    let channel = b.json["animations"][0]["channels"][0].clone();
    b.set("/animations/0/channels", json!([channel, channel]));
    assert!(
        refusal(&b)
            .contains("/channels/1/target: expected one channel for each node and property, found a second channel")
    );
    let mut b = good;
    b.set("/animations/0/channels/0/target/path", json!("rotation"));
    let zeros = b.floats("VEC4", &[0.0; 8]);
    b.set("/animations/0/samplers/0/output", json!(zeros));
    assert!(refusal(&b).contains("/samplers/0/output: expected quaternions that are not zero"));
}

#[test]
fn contents_list_animations_and_variants() {
    let mut b = several(3);
    b.remove("/animations/1/name");
    let input = b.floats("SCALAR", &[0.5, 2.5]);
    let output = b.floats("VEC3", &[0.0; 6]);
    b.set("/animations/2/samplers/0", json!({"input": input, "output": output}));
    b.set("/extensions", json!({"KHR_materials_variants": {"variants": [{"name": "Ruby"}, {"name": "Topaz"}]}}));
    let (warnings, cancel) = (lumistack_core::Collector::default(), lumistack_core::Cancel::default());
    let task = lumistack_core::Task::quiet(&warnings, &cancel);
    let contents = lumistack_gltf::contents("test.gltf", &b.glb(), &Memory(Vec::new()), task).unwrap();
    assert_eq!(contents.animations, [("Hop".to_owned(), 0.0), ("1".to_owned(), 0.0), ("Leap".to_owned(), 2.5)]);
    assert_eq!(contents.variants, ["Ruby", "Topaz"]);
}

/// Expected coordinates of the fox's corners in an animation at a time: the smallest, the largest
/// and the mean. `data/fox.py` computes them with NumPy.
const FOX: [(&str, f64, [[f32; 3]; 3]); 4] = [
    ("Survey", 0.0, [[-29.8998, -0.1307, -84.3404], [11.5953, 74.6421, 56.6528], [-3.2666, 32.1693, -2.8316]]),
    ("Survey", 1.7, [[-11.5965, -0.1307, -84.9123], [18.5374, 77.7259, 67.4433], [1.3505, 32.7429, -1.7869]]),
    ("Walk", 0.3, [[-12.6409, -1.1132, -91.4482], [12.5445, 75.4747, 69.9818], [-0.0514, 34.3482, -1.1648]]),
    ("Run", 99.0, [[-14.6147, -1.2642, -91.1326], [14.6219, 74.5377, 72.1327], [-0.5363, 32.8418, 2.5769]]),
];

#[test]
fn the_fox_stands_where_numpy_puts_it() {
    let Some(folder) = assets("gltf") else { return };
    for (animation, time_s, [low, high, mean]) in FOX {
        let options = LoadOptions { time_s: Some(time_s), animation: Some(animation.into()), ..LoadOptions::default() };
        let scene = load_file_choosing(&folder.join("Fox/Fox.glb"), &options).0.unwrap();
        let mesh = &scene.meshes[0];
        let corners: Vec<Vec3> = mesh.triangles.as_flattened().iter().map(|&i| mesh.positions[i as usize]).collect();
        let bounds = scene.bounds();
        let sum: glam::DVec3 = corners.iter().map(|corner| corner.as_dvec3()).sum();
        let found = [bounds.min, bounds.max, (sum / corners.len() as f64).as_vec3()];
        for (found, expected) in found.into_iter().zip([low, high, mean]) {
            // the tolerance is small compared with the fox, which is 155 units long
            assert!(found.distance(expected.into()) < 2e-3, "{animation} at {time_s}: {found} {expected:?}");
        }
    }
}
