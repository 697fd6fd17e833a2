//! Makes a binary glTF document of triangle meshes.

use std::path::Path;

use lumistack_plugin::PluginError;
use lumistack_plugin::core::colour::srgb_decode;
use lumistack_plugin::serde_json::{self, Value, json};
use tobj::{Mesh, Model};

use crate::mtl::{Map, MtlMaterial};
use crate::paths::forward;
use crate::up::Up;

// glTF's numbers for component types and buffer targets:
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// The binary chunk with all arrays, and glTF's descriptions of the arrays.
#[derive(Default)]
struct Arrays {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Arrays {
    /// Adds an array whose elements are of the glTF type `kind`; returns the index of its accessor.
    fn add(
        &mut self,
        bytes: impl Iterator<Item = [u8; 4]>,
        kind: &str,
        component: u32,
        width: usize,
        target: u32,
    ) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes.flatten());
        let length = self.bytes.len() - start;
        self.views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": length, "target": target}));
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "componentType": component, "count": length / 4 / width, "type": kind
        }));
        self.accessors.len() - 1
    }

    fn floats(&mut self, values: &[f32], kind: &str, width: usize) -> usize {
        self.add(values.iter().map(|value| value.to_le_bytes()), kind, FLOAT, width, VERTICES)
    }
}

/// Makes the glTF document. All meshes are children of one node, which scales them, and turns the
/// file's upward axis to glTF's.
pub(crate) fn document(
    models: &[Model],
    materials: &[MtlMaterial],
    up: Up,
    scale: f64,
) -> Result<Vec<u8>, PluginError> {
    let mut arrays = Arrays::default();
    // Colours of vertices are 0 to 1 in most files, and 0 to 255 in some.
    let brightest =
        models.iter().flat_map(|model| &model.mesh.vertex_color).fold(0.0, |most: f32, code| most.max(*code));
    let white = if brightest > 1.0 { 255.0 } else { 1.0 };
    let meshes: Vec<Value> = models
        .iter()
        .map(|model| json!({"name": model.name, "primitives": [primitive(&mut arrays, &model.mesh, materials, white)]}))
        .collect();
    let mut nodes: Vec<Value> = models.iter().enumerate().map(|(i, m)| json!({"name": m.name, "mesh": i})).collect();
    // If z is up, a quarter turn about x turns z to y, the upward axis of glTF.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = if up == Up::Z { [-half, 0.0, 0.0, half] } else { [0.0, 0.0, 0.0, 1.0] };
    let children: Vec<usize> = (0..nodes.len()).collect();
    nodes.push(json!({"rotation": rotation, "scale": [scale, scale, scale], "children": children}));
    let mut root = json!({
        "asset": {"version": "2.0", "generator": concat!("lumistack obj ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [nodes.len() - 1]}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
        "buffers": [{"byteLength": arrays.bytes.len()}],
    });
    add_materials(&mut root, materials);
    glb(&root, arrays.bytes)
}

/// Makes a primitive of a mesh. `white` is the value of white in colours of vertices.
fn primitive(arrays: &mut Arrays, mesh: &Mesh, materials: &[MtlMaterial], white: f32) -> Value {
    let positions = arrays.floats(&mesh.positions, "VEC3", 3);
    let (min, max) = bounds(&mesh.positions);
    arrays.accessors[positions]["min"] = json!(min);
    arrays.accessors[positions]["max"] = json!(max);
    let mut attributes = json!({"POSITION": positions});
    if mesh.normals.len() == mesh.positions.len() {
        attributes["NORMAL"] = arrays.floats(&mesh.normals, "VEC3", 3).into();
    }
    if mesh.texcoords.len() / 2 == mesh.positions.len() / 3 && !mesh.texcoords.is_empty() {
        let downwards: Vec<f32> = mesh.texcoords.chunks_exact(2).flat_map(|uv| [uv[0], 1.0 - uv[1]]).collect();
        attributes["TEXCOORD_0"] = arrays.floats(&downwards, "VEC2", 2).into();
    }
    // A scan may have a texture, and the same colours at its vertices. glTF multiplies the two, so
    // vertex colours beside a texture are left out.
    let has_picture = mesh.material_id.and_then(|id| materials.get(id)).is_some_and(|one| one.diffuse_map.is_some());
    if mesh.vertex_color.len() == mesh.positions.len() && !has_picture {
        let linear: Vec<f32> =
            mesh.vertex_color.iter().map(|code| srgb_decode((code / white).clamp(0.0, 1.0))).collect();
        attributes["COLOR_0"] = arrays.floats(&linear, "VEC3", 3).into();
    }
    let indices = arrays.add(mesh.indices.iter().map(|i| i.to_le_bytes()), "SCALAR", UNSIGNED_INT, 1, INDICES);
    let mut primitive = json!({"attributes": attributes, "indices": indices});
    if let Some(material) = mesh.material_id.filter(|material| *material < materials.len()) {
        primitive["material"] = material.into();
    }
    primitive
}

fn bounds(positions: &[f32]) -> ([f32; 3], [f32; 3]) {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in positions.chunks_exact(3) {
        for axis in 0..3 {
            (min[axis], max[axis]) = (min[axis].min(position[axis]), max[axis].max(position[axis]));
        }
    }
    (min, max)
}

fn add_materials(root: &mut Value, materials: &[MtlMaterial]) {
    if materials.is_empty() {
        return;
    }
    let mut pictures = Pictures::default();
    let list: Vec<Value> = materials
        .iter()
        .map(|material| {
            // Without `Pr`, the roughness is computed from the Phong exponent `Ns`.
            let shiny = material.shininess.map(|ns| 1.0 - (ns / 1000.0).clamp(0.0, 1.0).sqrt());
            let [r, g, b] = material.diffuse.unwrap_or([0.8; 3]).map(|value| value.clamp(0.0, 1.0));
            let alpha = material.alpha.unwrap_or(1.0).clamp(0.0, 1.0);
            let mut surface = json!({
                "baseColorFactor": [r, g, b, alpha],
                "metallicFactor": material.metallic.unwrap_or(0.0).clamp(0.0, 1.0),
                "roughnessFactor": material.roughness.or(shiny).unwrap_or(1.0).clamp(0.0, 1.0),
            });
            if let Some(map) = &material.diffuse_map {
                surface["baseColorTexture"] = pictures.reference(map);
            }
            let mut material_json =
                json!({"name": material.name, "pbrMetallicRoughness": surface, "doubleSided": true});
            if let Some(emission) = material.emission.filter(|emission| *emission != [0.0; 3]) {
                emit(&mut material_json, emission);
            }
            if alpha < 1.0 {
                material_json["alphaMode"] = "BLEND".into();
            }
            material_json
        })
        .collect();
    // List the extensions that the document uses, as glTF demands.
    let emits = list.iter().any(|material| material["extensions"].is_object());
    let used = [(emits, EMISSIVE_STRENGTH), (pictures.transformed, TEXTURE_TRANSFORM)];
    let used: Vec<&str> = used.into_iter().filter_map(|(used, name)| used.then_some(name)).collect();
    if !used.is_empty() {
        root["extensionsUsed"] = json!(used);
    }
    root["materials"] = list.into();
    if !pictures.textures.is_empty() {
        (root["textures"], root["images"]) = (pictures.textures.into(), pictures.images.into());
        root["samplers"] = json!([{}, {"wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}]);
    }
}

/// The document's pictures and textures, without duplicates.
#[derive(Default)]
struct Pictures {
    images: Vec<Value>,
    textures: Vec<Value>,
    transformed: bool,
}

impl Pictures {
    /// Returns a material's reference to the texture of a map, and adds the texture if it is new.
    fn reference(&mut self, map: &Map) -> Value {
        fn place(list: &mut Vec<Value>, value: Value) -> usize {
            list.iter().position(|known| *known == value).unwrap_or_else(|| {
                list.push(value);
                list.len() - 1
            })
        }
        let source = place(&mut self.images, json!({"uri": percent_encoded(&forward(Path::new(&map.file)))}));
        let texture = json!({"source": source, "sampler": usize::from(map.clamp)});
        let mut reference = json!({"index": place(&mut self.textures, texture)});
        let ([s_u, s_v], [o_u, o_v]) = (map.scale, map.offset);
        if (map.scale, map.offset) != ([1.0; 2], [0.0; 2]) {
            self.transformed = true;
            // v points downwards in glTF but upwards in the map. With the map's scale s and offset
            // o, v becomes 1 − (s (1 − v) + o) = s v + (1 − s − o).
            let transform = json!({"scale": [s_u, s_v], "offset": [o_u, 1.0 - s_v - o_v]});
            reference["extensions"] = json!({TEXTURE_TRANSFORM: transform});
        }
        reference
    }
}

const TEXTURE_TRANSFORM: &str = "KHR_texture_transform";
/// glTF's number for the wrapping mode that repeats the picture's edge pixels.
const CLAMP_TO_EDGE: u32 = 33071;

const EMISSIVE_STRENGTH: &str = "KHR_materials_emissive_strength";

/// Sets the emission of a material. glTF limits emission factors to 0..1. Larger emission needs the
/// extension [`EMISSIVE_STRENGTH`].
fn emit(material: &mut Value, emission: [f32; 3]) {
    let most = emission.iter().fold(1.0f32, |most, value| most.max(*value));
    material["emissiveFactor"] = json!(emission.map(|value| (value / most).clamp(0.0, 1.0)));
    if most > 1.0 {
        material["extensions"] = json!({EMISSIVE_STRENGTH: {"emissiveStrength": most}});
    }
}

/// Encodes a path as a URI: all bytes but letters, digits and a few marks become `%XX`.
fn percent_encoded(path: &str) -> String {
    path.bytes()
        .map(|byte| match byte {
            b'/' | b'.' | b'-' | b'_' | b'~' => char::from(byte).to_string(),
            _ if byte.is_ascii_alphanumeric() => char::from(byte).to_string(),
            _ => format!("%{byte:02X}"),
        })
        .collect()
}

/// Writes a .glb file: the header, the JSON chunk and the binary chunk, each padded to a multiple
/// of 4 bytes.
fn glb(root: &Value, mut binary: Vec<u8>) -> Result<Vec<u8>, PluginError> {
    let mut text = serde_json::to_vec(root).map_err(|error| PluginError::failed("glTF", error))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = |n: usize| {
        u32::try_from(n)
            .map(u32::to_le_bytes)
            .map_err(|_| PluginError::Failed("expected meshes that take less than 4 GiB as GLB, found more".into()))
    };
    let mut bytes = Vec::with_capacity(28 + text.len() + binary.len());
    bytes.extend(b"glTF\x02\0\0\0");
    bytes.extend(length(28 + text.len() + binary.len())?);
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &binary)] {
        bytes.extend(length(chunk.len())?);
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    Ok(bytes)
}
