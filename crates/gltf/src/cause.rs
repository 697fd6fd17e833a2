//! Finds the reason why a file has no visible triangle. The message states the element that the
//! scene's structure lacks. If data that the scene does not use has a defect, the message also
//! states the first defect.
//!
//! If a file is truncated, or its scene has lost its nodes, all data that the scene uses may be
//! valid. A defect in the unused data then helps to explain why the scene is empty. The unused data
//! is read within the memory limit that applies to scenes.

use std::collections::HashSet;

use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use lumistack_scene::Material;

use crate::accessor::{Accessor, Format};
use crate::document::Document;
use crate::error::Fault;
use crate::images::Images;
use crate::mesh;
use crate::nodes::Nodes;
use crate::skin::Pose;
use crate::{animation, lights_cameras, options};

/// The expected value in the message about a scene that shows neither a mesh nor splats.
const EXPECTED: &str = "at least one triangle with area";

/// Format that fits every accessor.
const ANY: Format = Format {
    types: &[Type::Scalar, Type::Vec2, Type::Vec3, Type::Vec4, Type::Mat2, Type::Mat3, Type::Mat4],
    components: &[
        ComponentType::I8,
        ComponentType::U8,
        ComponentType::I16,
        ComponentType::U16,
        ComponentType::U32,
        ComponentType::F32,
    ],
    text: "a type and a component type of glTF 2.0",
};

/// Returns the error of a file whose scene shows neither a mesh nor splats.
pub(crate) fn nothing_to_show(document: &Document<'_>, nodes: &Nodes) -> Fault {
    let found = format!("none: {}", structure(document, nodes));
    let defect = match defect(document, nodes) {
        Ok(()) => String::new(),
        Err(Fault::Malformed { place, expected, found }) => {
            format!("; data that the scene does not use has a defect: {place}: expected {expected}, found {found}")
        }
        Err(other) => return other,
    };
    Fault::new(nodes.place(), EXPECTED, format!("{found}{defect}"))
}

/// Returns `found`, the message about a scene whose triangles have no area, with two additions: the
/// number of triangles, and the first primitive that was left out.
pub(crate) fn no_area(document: &Document<'_>, found: &str, triangles: usize) -> String {
    let left_out = left_out(document).map(|reason| format!("; {reason}")).unwrap_or_default();
    match triangles {
        0 => format!("{found}: the meshes that are shown contain no triangles{left_out}"),
        1 => format!("{found}: the only triangle has no area{left_out}"),
        _ => format!("{found}: none of {triangles} triangles has an area{left_out}"),
    }
}

/// Returns the first primitive that was left out, with its reason, and the number of all primitives
/// that were left out.
fn left_out(document: &Document<'_>) -> Option<String> {
    let (first, count) = &*document.left_out.borrow();
    let first = first.as_ref()?;
    Some(if *count > 1 { format!("{first} ({count} primitives are left out in all)") } else { first.clone() })
}

/// Returns the reason why the scene shows no mesh, as found in the structure of the file.
fn structure(document: &Document<'_>, nodes: &Nodes) -> String {
    let root = &document.root;
    let meshes = root.meshes.len();
    let unseen = match meshes {
        0 => "the file has no meshes".to_owned(),
        1 => "no visible node has the file's mesh".to_owned(),
        _ => format!("no visible node has one of the file's {meshes} meshes"),
    };
    let listed = match &nodes.scene_place {
        Some(place) => document.json(&format!("{place}/nodes")).and_then(|nodes| nodes.as_array()).map_or(0, Vec::len),
        None => root.nodes.len(),
    };
    if root.nodes.is_empty() {
        return format!("the file has no nodes, and {unseen}");
    }
    if listed == 0 {
        return format!("the scene lists none of the file's nodes (count: {}), and {unseen}", root.nodes.len());
    }
    if nodes.shown.is_empty() {
        return format!("every node that the scene lists is hidden (KHR_node_visibility), and {unseen}");
    }
    let mut shown = nodes.shown.iter().filter_map(|&node| root.nodes[node].mesh).peekable();
    if shown.peek().is_none() {
        let count = nodes.shown.len();
        return format!("none of the scene's visible nodes (count: {count}) has a mesh; meshes in the file: {meshes}");
    }
    if let Some(mesh) = shown.find(|mesh| root.get(*mesh).is_some_and(|mesh| mesh.primitives.is_empty())) {
        return format!("/meshes/{} has no primitives", mesh.value());
    }
    left_out(document).unwrap_or_else(|| "no mesh has a copy to show".to_owned())
}

/// Reads the file's data, the meshes that the scene does not show, and all skins, cameras, nodes
/// and animations, up to the first defect.
fn defect(document: &Document<'_>, nodes: &Nodes) -> Result<(), Fault> {
    let root = &document.root;
    // Read the data first: buffers, views, accessors and images.
    let mut dataless = None;
    let mut note = |read: Result<(), Fault>| match read {
        // a buffer without data may be a placeholder, so report it only if there is no other defect
        Err(Fault::Malformed { place, expected, found }) if found == "none" && place.starts_with("/buffers/") => {
            dataless.get_or_insert(Fault::Malformed { place, expected, found });
            Ok(())
        }
        read => read,
    };
    for i in 0..root.buffers.len() {
        // a buffer without a URI may be a placeholder for an extension
        if root.buffers[i].uri.is_some() {
            document.buffer(json::Index::new(i as u32), &format!("/buffers/{i}"))?;
        }
    }
    for i in 0..root.buffer_views.len() {
        let place = format!("/bufferViews/{i}");
        document.get(root.buffer_views[i].buffer, &format!("{place}/buffer"))?;
        note(document.view(json::Index::new(i as u32), &place).map(drop))?;
    }
    for i in 0..root.accessors.len() {
        let index = json::Index::new(i as u32);
        note(Accessor::open(document, index, &format!("/accessors/{i}"), &ANY).map(drop))?;
    }
    let mut images = Images::default();
    for i in 0..root.images.len() {
        note(images.texture(document, json::Index::new(i as u32), &format!("/images/{i}")).map(drop))?;
    }
    // Then read the objects that use the data.
    let appearance = Material::default();
    let read: HashSet<usize> = nodes.shown.iter().filter_map(|&node| Some(root.nodes[node].mesh?.value())).collect();
    for (i, mesh) in root.meshes.iter().enumerate().filter(|(i, _)| !read.contains(i)) {
        for (j, primitive) in mesh.primitives.iter().enumerate() {
            let request = mesh::Request {
                place: format!("/meshes/{i}/primitives/{j}"),
                primitive,
                material: 0,
                appearance: &appearance,
                uv_sets: [0, 1],
                weights: mesh.weights.as_deref().unwrap_or_default(),
                pose: None,
            };
            note(mesh::load(document, &request).map(drop))?;
        }
    }
    for i in 0..root.skins.len() {
        let place = format!("/skins/{i}");
        note(Pose::load(document, json::Index::new(i as u32), &place, &nodes.scene_from_node).map(drop))?;
    }
    for (i, camera) in root.cameras.iter().enumerate() {
        lights_cameras::projection(document, camera, &format!("/cameras/{i}"))?;
    }
    for (i, node) in root.nodes.iter().enumerate() {
        if let Some(mesh) = node.mesh {
            document.get(mesh, &format!("/nodes/{i}/mesh"))?;
        }
        if let Some(skin) = node.skin {
            document.get(skin, &format!("/nodes/{i}/skin"))?;
        }
        if let Some(camera) = node.camera {
            document.get(camera, &format!("/nodes/{i}/camera"))?;
        }
    }
    for i in 0..animation::names(document).len() {
        let options = options::LoadOptions { time_s: Some(0.0), animation: Some(i.to_string()), ..Default::default() };
        note(animation::sample(document, &options).map(drop))?;
    }
    dataless.map_or(Ok(()), Err)
}
