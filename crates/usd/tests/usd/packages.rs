//! Scene packages without Python: a valid package becomes a scene, and no damage to it can cause a
//! panic.

use lumistack_core::{Cancel, Collector, Task, seed};
use lumistack_scene::Scene;
use lumistack_usd::{Package, UsdError, scene_from_package};
use serde_json::{Value, json};

/// The arrays of a package, one after another as in a file.
#[derive(Default)]
struct Buffers {
    bytes: Vec<u8>,
    places: Vec<[usize; 2]>,
}

impl Buffers {
    fn add(&mut self, kind: &str, shape: &[usize], bytes: Vec<u8>) -> Value {
        self.places.push([self.bytes.len(), bytes.len()]);
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(64), 0);
        json!({ "buffer": self.places.len() - 1, "type": kind, "shape": shape })
    }

    fn floats(&mut self, width: usize, values: &[f32]) -> Value {
        self.add("f32", &[values.len() / width, width], values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    fn integers(&mut self, values: &[i32]) -> Value {
        self.add("i32", &[values.len()], values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    fn matrices(&mut self, translations: &[[f64; 3]]) -> Value {
        let rows = |[x, y, z]: &[f64; 3]| [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., *x, *y, *z, 1.];
        let values = translations.iter().flat_map(rows);
        self.add("f64", &[translations.len(), 4, 4], values.flat_map(f64::to_le_bytes).collect())
    }
}

/// Makes a package from a header and its arrays.
fn file(header: &Value, data: &[u8]) -> Vec<u8> {
    let text = header.to_string();
    let mut bytes = b"LUMIPKG1".to_vec();
    bytes.extend((text.len() as u64).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(64), 0);
    bytes.extend(data);
    bytes
}

/// Returns a header and its arrays: a mesh of two squares, one of which is a subset, and a camera.
/// An instancer has five copies, three of which are of this mesh. A second link doubles each copy.
fn sample() -> (Value, Vec<u8>) {
    let mut buffers = Buffers::default();
    let header = json!({
        "schema": "lumistack.scene-package", "version": 1, "name": "sample", "up_axis": "Z", "meters_per_unit": 0.01,
        "files": [], "warnings": [{"place": "/a", "message": "odd"}],
        "geometries": [{
            "kind": "mesh", "place": "/a",
            "points": buffers.floats(3, &[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0., 2., 0., 0., 2., 1., 0.]),
            "counts": buffers.integers(&[4, 4]),
            "indices": buffers.integers(&[0, 1, 2, 3, 1, 4, 5, 2]),
            "left_handed": true, "one_sided": true,
            "holes": buffers.integers(&[]),
            "primvars": [
                {"name": "st", "interpolation": "faceVarying", "values": buffers.floats(2, &[0., 0., 1., 0., 1., 1., 0., 1.]),
                 "indices": buffers.integers(&[0, 1, 2, 3, 0, 1, 2, 3])},
                {"name": "displayColor", "interpolation": "uniform", "values": buffers.floats(3, &[1., 0., 0., 0., 1., 0.])},
                {"name": "normals", "interpolation": "vertex", "values": buffers.floats(3, &[0.0, 0.0, 1.0].repeat(6))},
            ],
            "subsets": [{"place": "/a/right", "faces": buffers.integers(&[1])}],
            "light": {"radiance": [1.0, 1.0, 1.0], "normalize": true, "sync": "independent"},
        }],
        "instances": [{"geometry": 0, "materials": [null, null], "chain": [
            {"matrices": buffers.matrices(&[[0.; 3], [1.; 3], [2.; 3], [3.; 3], [4.; 3]]),
             "prototypes": buffers.integers(&[0, 1, 0, 1, 0]), "prototype": 0, "mask": buffers.integers(&[1; 5])},
            {"matrices": buffers.matrices(&[[0.; 3], [9.; 3]])},
        ]}],
        "materials": [], "images": [], "lights": [],
        "cameras": [{"place": "/c", "projection": "perspective", "focal_length": 50.0, "aperture": [36.0, 24.0],
            "aperture_offset": [0.0, 0.0], "focus_distance": 2.0,
            "matrix": [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 5., 1.]}],
        "buffers": buffers.places,
    });
    (header, buffers.bytes)
}

/// Loads a scene package; `None` if the file is not a scene package.
fn load(bytes: &[u8]) -> Option<Result<Scene, UsdError>> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let package = Package::parse(bytes).ok()?;
    Some(scene_from_package("sample", &package, Task::quiet(&warnings, &cancel)))
}

#[test]
fn a_package_becomes_a_scene() {
    let (header, data) = sample();
    let scene = load(&file(&header, &data)).unwrap().unwrap();
    assert_eq!((scene.meshes.len(), scene.instances.len(), scene.cameras.len()), (2, 12, 1));
    assert_eq!(scene.triangle_count(), 24);
    // z points up, so the two moves of 9 and 4 along z become 13 along y
    assert!((scene.bounds().max.y - 13.0).abs() < 1e-5, "{:?}", scene.bounds());
    assert_eq!(scene.cameras[0].focus_distance, Some(2.0));
}

/// A subset that was made for an older version of a mesh may list many faces that the mesh lacks.
#[test]
fn faces_that_a_mesh_lacks_are_one_warning() {
    let (mut header, mut data) = sample();
    let faces: Vec<i32> = (1..1000).chain([-4]).collect();
    header["buffers"].as_array_mut().unwrap().push(json!([data.len(), 4 * faces.len()]));
    data.extend(faces.iter().flat_map(|face| face.to_le_bytes()));
    let buffer = header["buffers"].as_array().unwrap().len() - 1;
    header["geometries"][0]["subsets"][0]["faces"] = json!({"buffer": buffer, "type": "i32", "shape": [faces.len()]});
    let bytes = file(&header, &data);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let package = Package::parse(&bytes).unwrap();
    let scene = scene_from_package("sample", &package, Task::quiet(&warnings, &cancel)).unwrap();
    assert_eq!(scene.meshes.len(), 2);
    let said: Vec<_> = warnings.take().into_iter().filter(|warning| warning.place.ends_with("/a/right")).collect();
    assert_eq!(said.len(), 1, "{said:?}");
    let expected = "expected indices of faces below 2, found others, such as 2; the subset is used without these faces (count: 999)";
    assert_eq!(said[0].message, expected);
}

/// Replaces every value of the header by wrong values, one replacement per package.
#[test]
fn numbers_that_lie_do_no_harm() {
    let (header, data) = sample();
    let mut places = Vec::new();
    pointers(&header, String::new(), &mut places);
    assert!(places.len() > 100);
    for place in &places {
        for lie in [
            json!(-1),
            json!(0),
            json!(7),
            json!(u64::MAX),
            json!(1e300),
            json!(null),
            json!("text"),
            json!([]),
            json!([1e9, 1e9]),
        ] {
            let mut changed = header.clone();
            *changed.pointer_mut(place).unwrap() = lie;
            // the result is a scene or an error; a panic would fail the test
            let _ = load(&file(&changed, &data));
        }
    }
}

fn pointers(value: &Value, place: String, places: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(key, inner)| pointers(inner, format!("{place}/{key}"), places))
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, inner)| pointers(inner, format!("{place}/{i}"), places));
        }
        _ => {}
    }
    if !place.is_empty() {
        places.push(place);
    }
}

/// Writes random bytes, or the bits of NaN, to random positions of the arrays.
#[test]
fn arrays_that_lie_do_no_harm() {
    let (header, data) = sample();
    let mut random = seed::Stream::new(7);
    for _ in 0..3000 {
        let mut changed = data.clone();
        for _ in 0..1 + random.next_u64() % 4 {
            let at = (random.next_u64() % data.len() as u64) as usize;
            let value = random.next_u64().to_le_bytes();
            let end = (at + 4).min(data.len());
            changed[at..end].copy_from_slice(match random.next_u64() % 3 {
                0 => &[0xff; 4][..end - at],
                1 => &[0, 0, 0xc0, 0x7f][..end - at],
                _ => &value[..end - at],
            });
        }
        let _ = load(&file(&header, &changed));
    }
}

/// A few bytes request more than 10^18 copies. The file is refused before any copy is made.
#[test]
fn copies_of_copies_are_counted_before_they_are_made() {
    let (mut header, data) = sample();
    let link = header["instances"][0]["chain"][1].clone();
    let chain = header["instances"][0]["chain"].as_array_mut().unwrap();
    chain.extend(vec![link; 60]);
    let error = load(&file(&header, &data)).unwrap().unwrap_err().to_string();
    assert!(error.starts_with("sample: /a: expected at most 67108864 instances and splat clouds"), "{error}");
}
