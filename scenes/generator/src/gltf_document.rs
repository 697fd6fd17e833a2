//! A glTF 2.0 document under construction: JSON arrays, one binary buffer, and the files to which
//! it refers.
//!
//! Source: Khronos glTF 2.0 specification, sections 3.6 (binary data) and 5 (properties). Every
//! accessor has a buffer view of its own, which is tightly packed and aligned to four bytes.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use crate::mesh::Mesh;
use crate::sky;
use crate::{GeneratorError, SceneFile};

const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Primitive mode of a triangle list.
pub(crate) const TRIANGLES: u32 = 4;
/// Primitive mode of a triangle strip.
pub(crate) const TRIANGLE_STRIP: u32 = 5;

/// Numbers in JSON are rounded to multiples of 1e-9, the inverse of this number. The last bits of a
/// sine or tangent differ between machines; after rounding, the text is the same on all machines.
const JSON_DECIMALS: f64 = 1e9;

/// Rounds a number for JSON to nine decimals.
pub(crate) fn rounded(value: f64) -> f64 {
    // adding zero turns -0 into 0
    (value * JSON_DECIMALS).round() / JSON_DECIMALS + 0.0
}

/// Content of a texture outside of 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wrap {
    /// The texture repeats.
    Repeat,
    /// The texels at the border continue.
    Clamp,
}

/// The document under construction. Its sections are in the order in which they are written.
#[derive(Debug)]
pub(crate) struct Document {
    name: &'static str,
    binary: Vec<u8>,
    sections: Map<String, Value>,
    lights: Vec<Value>,
    extensions: BTreeSet<&'static str>,
    root_nodes: Vec<usize>,
    files: Vec<SceneFile>,
}

impl Document {
    /// Makes an empty document; its files will be `name.gltf` and `name.bin`.
    pub(crate) fn new(name: &'static str) -> Self {
        let mut document = Self {
            name,
            binary: Vec::new(),
            sections: Map::new(),
            lights: Vec::new(),
            extensions: BTreeSet::new(),
            root_nodes: Vec::new(),
            files: Vec::new(),
        };
        // Add one sampler for each variant of `Wrap`, in their order. Both samplers filter linearly
        // with mipmaps.
        for wrap in [10497, 33071] {
            document.push("samplers", json!({ "magFilter": 9729, "minFilter": 9987, "wrapS": wrap, "wrapT": wrap }));
        }
        document
    }

    /// Adds an extension to `extensionsUsed`. The scenes have no entry in `extensionsRequired`.
    pub(crate) fn use_extension(&mut self, name: &'static str) {
        self.extensions.insert(name);
    }

    /// Adds a texture with an encoded image, whose file is written to the document's folder.
    pub(crate) fn add_texture(&mut self, file: SceneFile, wrap: Wrap) -> usize {
        let source = self.push("images", json!({ "uri": file.0 }));
        self.files.push(file);
        let sampler = if wrap == Wrap::Repeat { 0 } else { 1 };
        self.push("textures", json!({ "sampler": sampler, "source": source }))
    }

    /// Adds a material in glTF's form, and lists the extensions that it names.
    pub(crate) fn add_material(&mut self, material: Value) -> usize {
        for name in ["KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_transmission"] {
            if material["extensions"].get(name).is_some() {
                self.use_extension(name);
            }
        }
        self.push("materials", material)
    }

    /// Adds an accessor over tightly packed floats with `N` components and returns its index.
    pub(crate) fn add_floats<const N: usize>(&mut self, rows: &[[f32; N]], target: bool) -> usize {
        let bytes = rows.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        let view = self.add_view(bytes, target.then_some(ARRAY_BUFFER));
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let bound = |pick: fn(f32, f32) -> f32, start: f32| -> Vec<f64> {
            let row =
                rows.iter().fold([start; N], |bound, row| std::array::from_fn(|axis| pick(bound[axis], row[axis])));
            row.iter().map(|&value| f64::from(value)).collect()
        };
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": kind
        });
        if N == 3 {
            accessor["min"] = json!(bound(f32::min, f32::INFINITY));
            accessor["max"] = json!(bound(f32::max, f32::NEG_INFINITY));
        }
        self.push("accessors", accessor)
    }

    /// Adds an accessor over normalized 8-bit RGBA.
    pub(crate) fn add_bytes(&mut self, rows: &[[u8; 4]]) -> usize {
        let view = self.add_view(rows.concat(), Some(ARRAY_BUFFER));
        self.push(
            "accessors",
            json!({
                "bufferView": view, "componentType": UNSIGNED_BYTE, "normalized": true,
                "count": rows.len(), "type": "VEC4"
            }),
        )
    }

    /// Adds an accessor of indices. The indices have 16 bits if all are below 65535, otherwise 32.
    pub(crate) fn add_indices(&mut self, indices: &[u32]) -> usize {
        let (view, component) = self.add_index_view(indices, Some(ELEMENT_ARRAY_BUFFER));
        self.push(
            "accessors",
            json!({
                "bufferView": view, "componentType": component, "count": indices.len(), "type": "SCALAR"
            }),
        )
    }

    /// Adds a sparse VEC3 accessor with the values `rows`. Its buffer contains `base`, and its
    /// sparse entries are the rows that differ from `base`.
    pub(crate) fn add_sparse(&mut self, base: &[[f32; 3]], rows: &[[f32; 3]]) -> usize {
        let changed: Vec<u32> = (0u32..)
            .zip(base.iter().zip(rows))
            .filter(|(_, (before, after))| before != after)
            .map(|(index, _)| index)
            .collect();
        let values: Vec<u8> =
            changed.iter().flat_map(|&index| rows[index as usize]).flat_map(f32::to_le_bytes).collect();
        // glTF defines the bounds of a sparse accessor as the bounds of its final values, which are
        // `rows`.
        let accessor = self.add_floats(base, true);
        let (indices_view, component) = self.add_index_view(&changed, None);
        let values_view = self.add_view(values, None);
        let minimum =
            rows.iter().fold([f32::INFINITY; 3], |bound, row| std::array::from_fn(|axis| bound[axis].min(row[axis])));
        let maximum = rows
            .iter()
            .fold([f32::NEG_INFINITY; 3], |bound, row| std::array::from_fn(|axis| bound[axis].max(row[axis])));
        let entry = &mut self.sections["accessors"][accessor];
        entry["min"] = json!(minimum.map(f64::from));
        entry["max"] = json!(maximum.map(f64::from));
        entry["sparse"] = json!({
            "count": changed.len(),
            "indices": { "bufferView": indices_view, "componentType": component },
            "values": { "bufferView": values_view }
        });
        accessor
    }

    /// Returns a primitive with an indexed triangle list. Texture coordinates are omitted if the
    /// material has no texture.
    pub(crate) fn primitive(&mut self, mesh: &Mesh, material: usize) -> Value {
        let mut attributes = Map::new();
        let positions: Vec<_> = mesh.positions.iter().map(|p| p.as_vec3().to_array()).collect();
        let normals: Vec<_> = mesh.normals.iter().map(|n| n.as_vec3().to_array()).collect();
        let texcoords: Vec<_> = mesh.texcoords.iter().map(|t| t.as_vec2().to_array()).collect();
        attributes.insert("POSITION".into(), json!(self.add_floats(&positions, true)));
        attributes.insert("NORMAL".into(), json!(self.add_floats(&normals, true)));
        if has_texture(&self.sections["materials"][material]) {
            attributes.insert("TEXCOORD_0".into(), json!(self.add_floats(&texcoords, true)));
        }
        let indices = self.add_indices(&mesh.indices);
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }

    /// Adds a mesh of the given primitives.
    pub(crate) fn add_mesh(&mut self, name: &str, primitives: Vec<Value>) -> usize {
        self.push("meshes", json!({ "name": name, "primitives": primitives }))
    }

    /// Adds a mesh of one indexed triangle list.
    pub(crate) fn add_simple_mesh(&mut self, name: &str, mesh: &Mesh, material: usize) -> usize {
        let primitive = self.primitive(mesh, material);
        self.add_mesh(name, vec![primitive])
    }

    /// Adds a camera.
    pub(crate) fn add_camera(&mut self, camera: Value) -> usize {
        self.push("cameras", camera)
    }

    /// Adds a punctual light (KHR_lights_punctual) and returns the extension object for its node.
    pub(crate) fn add_light(&mut self, light: Value) -> Value {
        self.use_extension("KHR_lights_punctual");
        self.lights.push(light);
        json!({ "KHR_lights_punctual": { "light": self.lights.len() - 1 } })
    }

    /// Adds a node to the scene's top level.
    pub(crate) fn add_node(&mut self, node: Value) -> usize {
        let index = self.push("nodes", node);
        self.root_nodes.push(index);
        index
    }

    /// Adds a node that another node lists among its children.
    pub(crate) fn add_child_node(&mut self, node: Value) -> usize {
        self.push("nodes", node)
    }

    /// Adds a node without a transform, and its mesh, whose vertices are already in world axes.
    pub(crate) fn add_mesh_node(&mut self, name: &str, mesh: &Mesh, material: usize) -> usize {
        let mesh = self.add_simple_mesh(name, mesh, material);
        self.add_node(json!({ "name": name, "mesh": mesh }))
    }

    /// Returns the files of the document: JSON, buffer, textures, and the sky, which the scene's
    /// extras name.
    pub(crate) fn finish(mut self, sky: sky::Sky) -> Result<Vec<SceneFile>, GeneratorError> {
        let json_file = format!("{}.gltf", self.name);
        let binary_file = format!("{}.bin", self.name);
        let sky_file = "sky.hdr".to_string();
        // Write the sections in an order that is easy to read, and omit empty lists.
        let mut root = Map::new();
        root.insert(
            "asset".into(),
            json!({
                "version": "2.0",
                "generator": "lumistack-scene-generator",
                "copyright": "Lumistack authors, MIT OR Apache-2.0"
            }),
        );
        if !self.extensions.is_empty() {
            root.insert("extensionsUsed".into(), json!(self.extensions));
        }
        root.insert("scene".into(), json!(0));
        root.insert(
            "scenes".into(),
            json!([{
                "name": self.name,
                "nodes": self.root_nodes,
                "extras": { "lumistack": { "environment": { "image": sky_file, "strength": 1.0 } } }
            }]),
        );
        if !self.lights.is_empty() {
            root.insert("extensions".into(), json!({ "KHR_lights_punctual": { "lights": self.lights } }));
        }
        root.append(&mut self.sections);
        root.insert("buffers".into(), json!([{ "uri": binary_file, "byteLength": self.binary.len() }]));
        let mut text = serde_json::to_string_pretty(&Value::Object(root))
            .map_err(|source| GeneratorError::Serialize { file: json_file.clone(), source })?;
        text.push('\n');
        let mut files = vec![(json_file, text.into_bytes()), (binary_file, self.binary)];
        files.append(&mut self.files);
        files.push(sky.encode(sky_file)?);
        Ok(files)
    }

    fn add_index_view(&mut self, indices: &[u32], target: Option<u32>) -> (usize, u32) {
        let short: Option<Vec<u16>> = indices.iter().map(|&i| u16::try_from(i).ok()).collect();
        // glTF reserves the 16-bit index 65535 (primitive restart), so a list that contains 65535
        // has 32-bit indices.
        match short.filter(|values| !values.contains(&u16::MAX)) {
            Some(values) => {
                let bytes = values.into_iter().flat_map(u16::to_le_bytes).collect();
                (self.add_view(bytes, target), UNSIGNED_SHORT)
            }
            None => {
                let bytes = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
                (self.add_view(bytes, target), UNSIGNED_INT)
            }
        }
    }

    fn add_view(&mut self, bytes: Vec<u8>, target: Option<u32>) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.binary.extend(bytes);
        self.push("bufferViews", view)
    }

    fn push(&mut self, section: &str, value: Value) -> usize {
        let entry = self.sections.entry(section).or_insert_with(|| Value::Array(Vec::new()));
        let Value::Array(list) = entry else { unreachable!("sections are arrays") };
        list.push(value);
        list.len() - 1
    }
}

/// Returns true if a material, or a part of it, refers to a texture.
fn has_texture(value: &Value) -> bool {
    value
        .as_object()
        .is_some_and(|members| members.iter().any(|(key, member)| key.ends_with("Texture") || has_texture(member)))
}
