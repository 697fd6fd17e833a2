//! Makes a scene from the bytes of a glTF file.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;

use glam::DAffine3;
use gltf::json;
use lumistack_core::{Task, Warning, Warnings};
use lumistack_scene::{Cloud, Instance, Material, PlacedCloud, Scene, SceneParts};

use crate::container::Container;
use crate::document::Document;
use crate::error::Fault;
use crate::material::Materials;
use crate::nodes::Nodes;
use crate::options::{LoadOptions, choose};
use crate::skin::Pose;
use crate::{
    AssetResolver, GltfError, animation, cause, extensions, lights_cameras, material, mesh, nodes, skin, splats,
    variants,
};

/// Loads a `.gltf` or `.glb` file.
///
/// `name` is the file's name in messages, and `bytes` is the file's content. `resolver` reads the
/// files to which the content refers. Only objects that the default scene uses are read.
///
/// # Errors
/// [`GltfError`] with the place in the file. The file may be broken, refer to a missing file, or
/// require an extension that is not supported. It may have no object that can be rendered. The task
/// may have been cancelled.
pub fn load(name: &str, bytes: &[u8], resolver: &dyn AssetResolver, task: Task<'_>) -> Result<Scene, GltfError> {
    load_with(name, bytes, resolver, &LoadOptions::default(), task)
}

/// Loads a file like [`load`], at a time of an animation, and in a variant of materials.
///
/// # Errors
/// The same errors as [`load`]. It is also an error if the file does not have the animation or the
/// variant.
pub fn load_with(
    name: &str,
    bytes: &[u8],
    resolver: &dyn AssetResolver,
    options: &LoadOptions,
    task: Task<'_>,
) -> Result<Scene, GltfError> {
    let warnings = InFile { name, inner: task.warnings };
    let task = Task { warnings: &warnings, ..task };
    load_scene(name, bytes, resolver, options, task).map_err(|fault| fault.in_file(name))
}

/// The animations and variants that a file offers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contents {
    /// Animations in the file's order: name, and time of the last key in seconds. An animation
    /// without a name has its number as name.
    pub animations: Vec<(String, f32)>,
    /// Names of the material variants in the file's order; a number replaces a missing name.
    pub variants: Vec<String>,
}

/// Lists the animations and variants of a file.
///
/// # Errors
/// The same errors as [`load`], for the objects that have to be read for the list.
pub fn contents(name: &str, bytes: &[u8], resolver: &dyn AssetResolver, task: Task<'_>) -> Result<Contents, GltfError> {
    let warnings = InFile { name, inner: task.warnings };
    let task = Task { warnings: &warnings, ..task };
    let list = || -> Result<Contents, Fault> {
        let document = Document::new(Container::open(bytes)?, resolver, &LoadOptions::default(), task);
        let named = |names: Vec<Option<&str>>| -> Vec<String> {
            names.iter().enumerate().map(|(i, name)| name.map_or_else(|| i.to_string(), str::to_owned)).collect()
        };
        let mut animations = Vec::new();
        for (number, name) in named(animation::names(&document)).into_iter().enumerate() {
            animations.push((name, animation::duration_s(&document, number)?));
        }
        Ok(Contents { animations, variants: named(variants::names(&document)) })
    };
    list().map_err(|fault| fault.in_file(name))
}

/// Passes warnings on, with the file's name in front of the place of each.
struct InFile<'a> {
    name: &'a str,
    inner: &'a dyn Warnings,
}

impl Warnings for InFile<'_> {
    fn warn(&self, warning: Warning) {
        self.inner.warn(Warning { place: format!("{}: {}", self.name, warning.place), message: warning.message });
    }
}

fn load_scene(
    name: &str,
    bytes: &[u8],
    resolver: &dyn AssetResolver,
    options: &LoadOptions,
    task: Task<'_>,
) -> Result<Scene, Fault> {
    let mut document = Document::new(Container::open(bytes)?, resolver, options, task);
    extensions::check(&document)?;
    if let Some(variant) = &options.variant {
        document.variant = Some(choose("material variant", variant, &variants::names(&document))?);
    }
    let document = document;
    // read only nodes that are shown, and the materials of their meshes
    let nodes = nodes::load(&document, animation::sample(&document, options)?)?;
    let mut materials = material::load(&document, &used_materials(&document, &nodes)?)?;
    let environment = lights_cameras::environment(&document, &nodes, &mut materials.images)?;
    let mut parts = SceneParts {
        name: name.to_owned(),
        lights: lights_cameras::lights(&document, &nodes)?,
        cameras: lights_cameras::cameras(&document, &nodes)?,
        environment,
        ..SceneParts::default()
    };
    place_meshes(&document, &nodes, &mut materials, &mut parts)?;
    if parts.instances.is_empty() && parts.placed_clouds.is_empty() {
        // without meshes and splats there is nothing to validate; [`cause`] finds the reason why
        // the scene is empty
        return Err(cause::nothing_to_show(&document, &nodes));
    }
    materials.images.decode(&document)?;
    let Materials { materials, textures, images, .. } = materials;
    (parts.materials, parts.textures, parts.images) = (materials, textures, images.decoded);
    task.cancel.check()?;
    let triangles: usize = parts.meshes.iter().map(|mesh| mesh.triangles.len()).sum();
    parts.validate(task).map_err(|mut error| {
        // For an error of the whole scene, the validator's place is the file's name, with which the
        // message begins anyway. Use the JSON pointer to the scene instead.
        if error.place == name {
            error.place = nodes.place();
            error.found = cause::no_area(&document, &error.found, triangles);
        }
        error.into()
    })
}

/// Returns, for each material, true if a mesh of the scene uses it.
fn used_materials(document: &Document<'_>, nodes: &Nodes) -> Result<Vec<bool>, Fault> {
    let mut used = vec![false; document.root.materials.len()];
    // thousands of nodes may share a mesh of thousands of primitives, so each mesh is searched once
    let mut seen = vec![false; document.root.meshes.len()];
    for &node in &nodes.shown {
        let Some(index) = document.root.nodes[node].mesh else { continue };
        let mesh = document.get(index, &format!("/nodes/{node}/mesh"))?;
        if std::mem::replace(&mut seen[index.value()], true) {
            continue;
        }
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("/meshes/{}/primitives/{i}", index.value());
            if let Some(material) = variants::material(document, primitive, &place)? {
                used[material.value()] = true;
            }
        }
    }
    Ok(used)
}

/// Reads each mesh of the scene, and places the mesh for each node that shows it. A node that
/// deforms the mesh by a skin or by morph weights gets its own copy; all other nodes share one.
fn place_meshes(
    document: &Document<'_>,
    nodes: &Nodes,
    materials: &mut Materials,
    parts: &mut SceneParts,
) -> Result<(), Fault> {
    // The key is the index of a mesh. If a node's skin or weights change the shape of the mesh, the
    // key also has the node's index.
    let mut loaded: HashMap<(usize, Option<usize>), Range<usize>> = HashMap::new();
    let mut loaded_splats: HashMap<usize, Vec<(usize, DAffine3)>> = HashMap::new();
    let mut default_material = None;
    for &number in &nodes.shown {
        let node = &document.root.nodes[number];
        let Some(index) = node.mesh else { continue };
        let mesh = document.get(index, &format!("/nodes/{number}/mesh"))?;
        // a skinned mesh is placed by its skin, not by its node
        let mut scene_from_node = nodes.scene_from_node[number];
        let mut pose = None;
        if let Some(skin) = node.skin {
            let place = format!("/nodes/{number}/skin");
            document.get(skin, &place)?;
            if skin::has_joints(mesh) {
                scene_from_node = DAffine3::IDENTITY;
                pose = Some(Pose::load(document, skin, &place, &nodes.scene_from_node)?);
            } else {
                document.task.warn(place, "the mesh has no joints; the skin has no effect");
            }
        }
        let animated_weights = nodes.poses.get(&number).and_then(|pose| pose.weights.as_deref());
        let weights = animated_weights.or(node.weights.as_deref());
        let own_shape = pose.is_some() || weights.is_some();
        // read the mesh once for each shape that it has
        let clouds = match loaded_splats.entry(index.value()) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(read_splats(document, mesh, index.value(), &mut parts.clouds)?),
        };
        let positions = match loaded.entry((index.value(), own_shape.then_some(number))) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => {
                let first = parts.meshes.len();
                let shape = Shape { weights, mesh, number: index.value(), pose };
                parts.meshes.extend(read_mesh(document, &shape, materials, &mut default_material)?);
                entry.insert(first..parts.meshes.len())
            }
        };
        // place the mesh once, or once per instance of EXT_mesh_gpu_instancing
        let copies = nodes::copies(document, number)?.unwrap_or_else(|| vec![DAffine3::IDENTITY]);
        let placed = (positions.len() + clouds.len()) * copies.len();
        document.spend(&format!("/nodes/{number}"), placed, size_of::<Instance>())?;
        for node_from_copy in copies {
            let scene_from_mesh = lights_cameras::affine(&(scene_from_node * node_from_copy));
            parts.instances.extend(positions.clone().map(|mesh| Instance { mesh, scene_from_mesh }));
            parts.placed_clouds.extend(clouds.iter().map(|(cloud, mesh_from_cloud)| PlacedCloud {
                cloud: *cloud,
                scene_from_cloud: lights_cameras::affine(&(scene_from_node * node_from_copy * *mesh_from_cloud)),
            }));
        }
    }
    Ok(())
}

/// Reads the primitives of a mesh that are splats. Returns the indices of their clouds, and the
/// placements of the clouds in the mesh.
fn read_splats(
    document: &Document<'_>,
    mesh: &json::Mesh,
    number: usize,
    clouds: &mut Vec<Cloud>,
) -> Result<Vec<(usize, DAffine3)>, Fault> {
    let mut found = Vec::new();
    for i in 0..mesh.primitives.len() {
        let place = format!("/meshes/{number}/primitives/{i}");
        if splats::is_splats(document, &place) {
            let splats = splats::load(document, &place)?;
            found.push((clouds.len(), splats.mesh_from_cloud));
            clouds.push(splats.cloud);
        }
    }
    Ok(found)
}

/// A mesh, with the weights and the skin that determine its shape. Each node with a skin or with
/// weights has its own shape; all other nodes that show the mesh share one shape.
struct Shape<'a> {
    /// Weights of morph targets that an animation or the node sets.
    weights: Option<&'a [f32]>,
    mesh: &'a json::Mesh,
    number: usize,
    pose: Option<Pose>,
}

/// Reads the primitives of a mesh that make triangles.
fn read_mesh(
    document: &Document<'_>,
    shape: &Shape<'_>,
    materials: &mut Materials,
    default_material: &mut Option<usize>,
) -> Result<Vec<lumistack_scene::Mesh>, Fault> {
    let Shape { weights, mesh, number, pose } = shape;
    let mut meshes = Vec::new();
    for (i, primitive) in mesh.primitives.iter().enumerate() {
        let place = format!("/meshes/{number}/primitives/{i}");
        if splats::is_splats(document, &place) {
            continue;
        }
        // all primitives without a material share one default material
        let material = match variants::material(document, primitive, &place)? {
            Some(material) => material.value(),
            None => *default_material.get_or_insert_with(|| {
                materials.materials.push(Material::default());
                materials.uv_sets.push([0, 1]);
                materials.materials.len() - 1
            }),
        };
        let request = mesh::Request {
            place,
            primitive,
            material,
            appearance: &materials.materials[material],
            uv_sets: materials.uv_sets[material],
            weights: weights.or(mesh.weights.as_deref()).unwrap_or_default(),
            pose: pose.as_ref(),
        };
        meshes.extend(mesh::load(document, &request)?);
    }
    Ok(meshes)
}
