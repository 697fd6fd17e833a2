//! A strict reader of the generator's own output: glTF 2.0 with one buffer, floats for vertex data,
//! and triangle lists or strips.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat4, DQuat, DVec3};
use serde_json::Value;

/// Largest difference between 1 and the length of a unit vector, which is stored as 32-bit floats
/// or with nine decimals.
const UNIT_TOLERANCE: f64 = 1e-5;

/// A triangle in world axes.
pub(super) struct Triangle {
    /// Corners in metres.
    pub(super) corners: [DVec3; 3],
    /// True if the triangle's material emits.
    pub(super) emissive: bool,
}

impl Triangle {
    /// Returns the distance along a ray to its intersection with the triangle, in units of
    /// `direction` (Möller and Trumbore 1997). The ray may hit the front or the back.
    pub(super) fn hit(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let [a, b, c] = self.corners;
        let (ab, ac) = (b - a, c - a);
        let p = direction.cross(ac);
        let determinant = ab.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let from_a = origin - a;
        let q = from_a.cross(ab);
        let (u, v) = (from_a.dot(p) / determinant, direction.dot(q) / determinant);
        let t = ac.dot(q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
    }
}

/// A scene's files and its parsed document.
pub(super) struct Scene {
    files: BTreeMap<String, Vec<u8>>,
    document: Value,
}

impl Scene {
    pub(super) fn read(files: BTreeMap<String, Vec<u8>>, document: &str) -> Self {
        let document = serde_json::from_slice(&files[document]).expect("the document is JSON");
        Self { files, document }
    }

    /// Returns a top-level array of the document; empty if the document lacks it.
    pub(super) fn list(&self, section: &str) -> &[Value] {
        self.document[section].as_array().map_or(&[], Vec::as_slice)
    }

    /// Returns every primitive of every mesh.
    pub(super) fn primitives(&self) -> Vec<&Value> {
        self.list("meshes").iter().flat_map(|mesh| mesh["primitives"].as_array().expect("primitives")).collect()
    }

    /// Returns the camera node's transform.
    pub(super) fn camera_transform(&self) -> DMat4 {
        let mut found = None;
        self.visit(&mut |node, world| {
            if node.get("camera").is_some() {
                found = Some(world);
            }
        });
        found.expect("a camera node")
    }

    /// Returns all triangles under the default scene.
    pub(super) fn world_triangles(&self) -> Vec<Triangle> {
        let mut triangles = Vec::new();
        self.visit(&mut |node, world| {
            let Some(mesh) = node.get("mesh") else { return };
            for primitive in self.list("meshes")[index(mesh)]["primitives"].as_array().expect("primitives") {
                let material = &self.list("materials")[index(&primitive["material"])];
                let emissive = material.get("emissiveFactor").is_some();
                let points = self.floats(index(&primitive["attributes"]["POSITION"]), 3);
                for corners in self.corner_indices(primitive) {
                    let corners = corners.map(|k| world.transform_point3(DVec3::from_slice(&points[k as usize])));
                    triangles.push(Triangle { corners, emissive });
                }
            }
        });
        triangles
    }

    /// Checks extensions, buffers, files, primitives and nodes by rules of glTF 2.0. Also checks
    /// that every mesh and material is used. Panics at the first violation.
    pub(super) fn check_structure(&self) {
        assert_eq!(self.document["asset"]["version"], "2.0");
        assert!(self.document.get("extensionsRequired").is_none());
        self.check_extensions();
        self.check_buffers();
        self.check_files();
        for primitive in self.primitives() {
            self.check_primitive(primitive);
        }
        for node in self.list("nodes") {
            if let Some(rotation) = node.get("rotation") {
                let rotation: [f64; 4] = serde_json::from_value(rotation.clone()).expect("a quaternion");
                assert!((DQuat::from_array(rotation).length() - 1.0).abs() < UNIT_TOLERANCE, "{node}");
            }
        }
        // Every node has exactly one parent or is a root, and every mesh and material is used.
        let mut parents = vec![0; self.list("nodes").len()];
        let roots = self.document["scenes"][0]["nodes"].as_array().expect("a scene");
        let children = self.list("nodes").iter().filter_map(|node| node["children"].as_array()).flatten();
        roots.iter().chain(children).for_each(|child| parents[index(child)] += 1);
        assert!(parents.iter().all(|&count| count == 1), "{parents:?}");
        let meshes = self.list("nodes").iter().filter_map(|node| node.get("mesh")).map(index);
        assert_eq!(meshes.collect::<BTreeSet<_>>().len(), self.list("meshes").len());
        let materials = self.primitives().into_iter().map(|p| index(&p["material"]));
        assert_eq!(materials.collect::<BTreeSet<_>>().len(), self.list("materials").len());
    }

    fn check_extensions(&self) {
        fn collect<'a>(value: &'a Value, names: &mut BTreeSet<&'a str>) {
            match value {
                Value::Object(members) => {
                    for (key, member) in members {
                        if key == "extensions" {
                            names.extend(member.as_object().expect("an object").keys().map(String::as_str));
                        }
                        collect(member, names);
                    }
                }
                Value::Array(members) => members.iter().for_each(|member| collect(member, names)),
                _ => {}
            }
        }
        let mut found = BTreeSet::new();
        collect(&self.document, &mut found);
        let named: BTreeSet<_> = self.list("extensionsUsed").iter().filter_map(Value::as_str).collect();
        assert_eq!(found, named);
    }

    fn check_buffers(&self) {
        let length = index(&self.document["buffers"][0]["byteLength"]);
        assert_eq!(self.binary().len(), length);
        for view in self.list("bufferViews") {
            assert!(index(&view["byteOffset"]) + index(&view["byteLength"]) <= length, "{view}");
            assert_eq!(index(&view["byteOffset"]) % 4, 0, "{view}");
        }
        for accessor in self.list("accessors") {
            let width = components(accessor) * component_bytes(accessor);
            let view = &self.list("bufferViews")[index(&accessor["bufferView"])];
            assert_eq!(index(&accessor["count"]) * width, index(&view["byteLength"]), "{accessor}");
        }
    }

    /// Checks that the document names every other file, and that every picture can be decoded.
    fn check_files(&self) {
        let mut named: BTreeSet<String> = BTreeSet::new();
        let buffers = self.list("buffers").iter().chain(self.list("images"));
        named.extend(buffers.map(|entry| entry["uri"].as_str().expect("a URI").to_string()));
        let environment = &self.document["scenes"][0]["extras"]["lumistack"]["environment"];
        named.insert(environment["image"].as_str().expect("an environment").to_string());
        let present: BTreeSet<_> = self.files.keys().filter(|file| !file.ends_with(".gltf")).cloned().collect();
        assert_eq!(named, present);
        for file in named.iter().filter(|file| !file.ends_with(".bin")) {
            let picture = image::load_from_memory(&self.files[file]).unwrap_or_else(|e| panic!("{file}: {e}"));
            assert!(picture.width() >= 64 && picture.height() >= 32, "{file}");
        }
        for texture in self.list("textures") {
            assert!(index(&texture["source"]) < self.list("images").len());
            assert!(index(&texture["sampler"]) < self.list("samplers").len());
        }
    }

    fn check_primitive(&self, primitive: &Value) {
        let attributes = primitive["attributes"].as_object().expect("attributes");
        let position = index(&attributes["POSITION"]);
        let points = self.floats(position, 3);
        for (name, accessor) in attributes {
            let accessor = &self.list("accessors")[index(accessor)];
            assert_eq!(index(&accessor["count"]), points.len(), "{name}");
        }
        for axis in 0..3 {
            let low = points.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
            let high = points.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
            assert!(low.is_finite() && high.is_finite());
            let accessor = &self.list("accessors")[position];
            assert_eq!(accessor["min"][axis].as_f64(), Some(low));
            assert_eq!(accessor["max"][axis].as_f64(), Some(high));
        }
        for (name, size) in [("NORMAL", 3), ("TANGENT", 4)] {
            if let Some(accessor) = attributes.get(name) {
                for row in self.floats(index(accessor), size) {
                    assert!((DVec3::from_slice(&row).length() - 1.0).abs() < UNIT_TOLERANCE, "{name} {row:?}");
                }
            }
        }
        if let Some(accessor) = attributes.get("TEXCOORD_0") {
            assert!(self.floats(index(accessor), 2).iter().flatten().all(|t| t.is_finite()));
        }
        for corners in self.corner_indices(primitive) {
            assert!(corners.iter().all(|&k| (k as usize) < points.len()), "{corners:?}");
            let [a, b, c] = corners.map(|k| DVec3::from_slice(&points[k as usize]));
            assert!((b - a).cross(c - a).length() > 0.0, "a triangle without area at {a}");
        }
    }

    /// Returns the vertex numbers of every triangle.
    fn corner_indices(&self, primitive: &Value) -> Vec<[u32; 3]> {
        let order: Vec<u32> = match primitive.get("indices") {
            Some(accessor) => self.indices(index(accessor)),
            None => {
                let position = index(&primitive["attributes"]["POSITION"]);
                (0..index(&self.list("accessors")[position]["count"]) as u32).collect()
            }
        };
        match primitive["mode"].as_u64().unwrap_or(4) {
            4 => order.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect(),
            5 => (0..order.len() - 2).map(|k| [order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]]).collect(),
            mode => panic!("expected a primitive of mode 4 or 5, found mode {mode}"),
        }
    }

    fn floats(&self, accessor: usize, size: usize) -> Vec<Vec<f64>> {
        let accessor = &self.list("accessors")[accessor];
        assert_eq!((accessor["componentType"].as_u64(), components(accessor)), (Some(5126), size));
        let read = |view: &Value| -> Vec<Vec<f64>> {
            let values: Vec<f64> = self
                .view(view)
                .chunks_exact(4)
                .map(|bytes| f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])))
                .collect();
            values.chunks_exact(size).map(<[f64]>::to_vec).collect()
        };
        let mut rows = read(&accessor["bufferView"]);
        if let Some(sparse) = accessor.get("sparse") {
            let places = self.integers(&sparse["indices"]["bufferView"], &sparse["indices"]);
            assert_eq!(places.len(), index(&sparse["count"]));
            assert!(places.is_sorted_by(|a, b| a < b), "sparse indices must rise");
            for (place, row) in places.into_iter().zip(read(&sparse["values"]["bufferView"])) {
                rows[place as usize] = row;
            }
        }
        rows
    }

    fn indices(&self, accessor: usize) -> Vec<u32> {
        let accessor = &self.list("accessors")[accessor];
        self.integers(&accessor["bufferView"], accessor)
    }

    fn integers(&self, view: &Value, typed: &Value) -> Vec<u32> {
        let bytes = self.view(view);
        match component_bytes(typed) {
            2 => bytes.chunks_exact(2).map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect(),
            _ => bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
        }
    }

    fn view(&self, view: &Value) -> &[u8] {
        let view = &self.list("bufferViews")[index(view)];
        let start = index(&view["byteOffset"]);
        &self.binary()[start..start + index(&view["byteLength"])]
    }

    fn binary(&self) -> &[u8] {
        &self.files[self.document["buffers"][0]["uri"].as_str().expect("a URI")]
    }

    fn visit(&self, found: &mut impl FnMut(&Value, DMat4)) {
        let roots = self.document["scenes"][0]["nodes"].as_array().expect("a scene");
        let mut pending: Vec<_> = roots.iter().map(|root| (index(root), DMat4::IDENTITY)).collect();
        while let Some((number, parent)) = pending.pop() {
            let node = &self.list("nodes")[number];
            let vector = |key: &str, missing: DVec3| match node.get(key) {
                Some(value) => DVec3::from_array(serde_json::from_value(value.clone()).expect("three numbers")),
                None => missing,
            };
            let rotation = node.get("rotation").map_or(DQuat::IDENTITY, |value| {
                DQuat::from_array(serde_json::from_value(value.clone()).expect("four numbers"))
            });
            let (scale, translation) = (vector("scale", DVec3::ONE), vector("translation", DVec3::ZERO));
            let world = parent * DMat4::from_scale_rotation_translation(scale, rotation.normalize(), translation);
            found(node, world);
            let children = node["children"].as_array().into_iter().flatten();
            pending.extend(children.map(|child| (index(child), world)));
        }
    }
}

fn index(value: &Value) -> usize {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no index")) as usize
}

fn components(accessor: &Value) -> usize {
    match accessor["type"].as_str() {
        Some("SCALAR") => 1,
        Some("VEC2") => 2,
        Some("VEC3") => 3,
        Some("VEC4") => 4,
        other => panic!("accessor type {other:?}"),
    }
}

fn component_bytes(typed: &Value) -> usize {
    match typed["componentType"].as_u64() {
        Some(5121) => 1,
        Some(5123) => 2,
        Some(5125 | 5126) => 4,
        other => panic!("component type {other:?}"),
    }
}
