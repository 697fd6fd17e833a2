//! The node hierarchy: the nodes that the scene shows, and their placements.
//!
//! scene_from_node = scene_from_parent · parent_from_node, with parent_from_node a matrix or
//! translation · rotation · scale (glTF 2.0, section 3.5). Products are computed in f64.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use serde_json::Value;

use crate::accessor::{Accessor, Format, Selection};
use crate::animation::NodePose;
use crate::document::Document;
use crate::error::Fault;
use crate::quote::quote;

use ComponentType::{F32, I8, I16};

/// The nodes of the scene that is loaded.
pub(crate) struct Nodes {
    /// JSON pointer to the scene, if the file has one.
    pub(crate) scene_place: Option<String>,
    /// Nodes of the scene, parents before children, without those that `KHR_node_visibility` hides.
    pub(crate) shown: Vec<usize>,
    /// Placement in the scene of every node of the file; the index is the node's number.
    pub(crate) scene_from_node: Vec<DAffine3>,
    /// Animated values, which replace a node's own values; the key is the node's number.
    pub(crate) poses: HashMap<usize, NodePose>,
}

impl Nodes {
    /// Returns the JSON pointer to the scene or, if the file has no scenes, to the list of nodes.
    pub(crate) fn place(&self) -> String {
        self.scene_place.clone().unwrap_or_else(|| "/nodes".to_owned())
    }
}

/// Reads the hierarchy of the default scene. That is the scene that the file chooses, or else its
/// first scene. A file without scenes shows all of its nodes.
pub(crate) fn load(document: &Document<'_>, poses: HashMap<usize, NodePose>) -> Result<Nodes, Fault> {
    let mut parents = parents(document)?;
    let root = &document.root;
    let scene = match root.scene {
        Some(scene) => Some((document.get(scene, "/scene")?, scene.value())),
        None => root.scenes.first().map(|scene| (scene, 0)),
    };
    // find the roots: the nodes that the scene lists, or all nodes without a parent if there is no
    // scene
    let mut roots = Vec::new();
    match scene {
        Some((scene, number)) => {
            let place = |i: usize| format!("/scenes/{number}/nodes/{i}");
            let mut listed = vec![false; root.nodes.len()];
            for (i, &node) in scene.nodes.iter().enumerate() {
                document.get(node, &place(i))?;
                if std::mem::replace(&mut listed[node.value()], true) {
                    let found =
                        format!("expected every node once, found node {} again; the node is shown once", node.value());
                    document.task.warn(place(i), found);
                } else {
                    roots.push((node.value(), place(i)));
                }
            }
            let mut known = vec![None; root.nodes.len()];
            roots.retain(|(node, place)| adopt(document, *node, place, &listed, &mut known, &mut parents));
        }
        None => {
            let orphans = (0..root.nodes.len()).filter(|&node| parents[node].is_none());
            roots.extend(orphans.map(|node| (node, String::new())));
        }
    }
    // walk through the visible nodes under the roots, in the file's order
    let scene_from_node = placements(document, &parents, &poses)?;
    let mut shown = Vec::new();
    let mut seen = vec![false; root.nodes.len()];
    let mut open: Vec<usize> = roots.into_iter().rev().map(|(node, _)| node).collect();
    while let Some(node) = open.pop() {
        let visible = format!("/nodes/{node}/extensions/KHR_node_visibility/visible");
        if document.json(&visible).and_then(Value::as_bool) == Some(false) || std::mem::replace(&mut seen[node], true) {
            continue;
        }
        shown.push(node);
        let children = children(&root.nodes[node]).iter().rev().map(json::Index::value);
        open.extend(children.filter(|&child| parents[child] == Some(node)));
    }
    let scene_place = scene.map(|(_, number)| format!("/scenes/{number}"));
    Ok(Nodes { scene_place, shown, scene_from_node, poses })
}

/// Returns true if a node that the scene lists becomes a root of the scene. A scene should not list
/// a node that has a parent, but many readers show such a node. If the scene shows an ancestor too,
/// the node stays with its parent. Otherwise it is shown without its parent. `known` keeps true for
/// each ancestor that the scene shows, and false for other ancestors that were searched.
fn adopt(
    document: &Document<'_>,
    node: usize,
    place: &str,
    listed: &[bool],
    known: &mut [Option<bool>],
    parents: &mut [Option<usize>],
) -> bool {
    let Some(parent) = parents[node] else { return true };
    let found = format!("expected a node without a parent, found node {node}, a child of node {parent}");
    let (mut path, mut at, mut shown) = (Vec::new(), Some(parent), false);
    while let Some(ancestor) = at {
        // a path with more nodes than the file has is a cycle, which is refused later
        if listed[ancestor] || path.len() > parents.len() {
            shown = true;
            break;
        }
        if let Some(known) = known[ancestor] {
            shown = known;
            break;
        }
        path.push(ancestor);
        at = parents[ancestor];
    }
    path.into_iter().for_each(|ancestor| known[ancestor] = Some(shown));
    if shown {
        document.task.warn(place, format!("{found}; node {node} stays a child of node {parent}"));
        return false;
    }
    document.task.warn(
        place,
        format!("{found}; the scene does not show node {parent}, so node {node} is shown without its parent"),
    );
    parents[node] = None;
    true
}

fn children(node: &json::Node) -> &[json::Index<json::Node>] {
    node.children.as_deref().unwrap_or_default()
}

/// Finds the parent of every node. A node with several parents gets the first, with a warning.
fn parents(document: &Document<'_>) -> Result<Vec<Option<usize>>, Fault> {
    let mut parents = vec![None; document.root.nodes.len()];
    for (parent, node) in document.root.nodes.iter().enumerate() {
        for (i, &child) in children(node).iter().enumerate() {
            let place = format!("/nodes/{parent}/children/{i}");
            document.get(child, &place)?;
            match parents[child.value()] {
                None => parents[child.value()] = Some(parent),
                Some(first) => {
                    let found = format!("node {}, which is a child of node {first}", child.value());
                    document.task.warn(
                        place,
                        format!("expected a node without another parent, found {found}; the node stays a child of node {first}"),
                    );
                }
            }
        }
    }
    Ok(parents)
}

/// Computes the placement of every node in the scene. A cycle of nodes is an error.
fn placements(
    document: &Document<'_>,
    parents: &[Option<usize>],
    poses: &HashMap<usize, NodePose>,
) -> Result<Vec<DAffine3>, Fault> {
    let nodes = &document.root.nodes;
    let mut placements: Vec<Option<DAffine3>> = vec![None; nodes.len()];
    for start in 0..nodes.len() {
        // Go up to the nearest ancestor whose placement is known. Then compute the placements of
        // the nodes on the path, from this ancestor down.
        let mut path = Vec::new();
        let mut at = Some(start);
        while let Some(node) = at.filter(|&node| placements[node].is_none()) {
            if path.len() >= nodes.len() {
                return Err(Fault::new(format!("/nodes/{start}"), "a tree of nodes", "a node among its own ancestors"));
            }
            path.push(node);
            at = parents[node];
        }
        let mut placement = at.and_then(|node| placements[node]).unwrap_or(DAffine3::IDENTITY);
        for node in path.into_iter().rev() {
            placement *= parent_from_node(document, &nodes[node], &format!("/nodes/{node}"), poses.get(&node))?;
            placements[node] = Some(placement);
        }
    }
    Ok(placements.into_iter().map(Option::unwrap_or_default).collect())
}

/// Largest accepted difference of a matrix's last row from 0 0 0 1.
const LAST_ROW_ROUNDING: f64 = 1e-5;

fn parent_from_node(
    document: &Document<'_>,
    node: &json::Node,
    place: &str,
    pose: Option<&NodePose>,
) -> Result<DAffine3, Fault> {
    let at_rest = match node.matrix {
        Some(matrix) => {
            let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
            // A product of matrices in f32 has rounding errors.
            if !matrix.row(3).abs_diff_eq(glam::DVec4::W, LAST_ROW_ROUNDING) {
                let place = format!("{place}/matrix");
                return Err(Fault::new(place, "a last row of 0 0 0 1", matrix.row(3)));
            }
            if node.translation.is_some() || node.rotation.is_some() || node.scale.is_some() {
                document.task.warn(place, "the node has a matrix; its translation, rotation and scale have no effect");
            }
            DAffine3::from_mat4(matrix)
        }
        None => {
            let vector = |value: Option<[f32; 3]>, default| value.map_or(default, |v| DVec3::from(v.map(f64::from)));
            let rotation = rotation(node.rotation.unwrap_or_default().0, || format!("{place}/rotation"))?;
            let parts = (vector(node.scale, DVec3::ONE), rotation, vector(node.translation, DVec3::ZERO));
            posed(pose, parts)
        }
    };
    let placement = match pose {
        // glTF forbids animations of a node with a matrix; here the matrix sets the values that
        // are not animated
        Some(_) if node.matrix.is_some() => posed(pose, at_rest.to_scale_rotation_translation()),
        _ => at_rest,
    };
    if placement.is_finite() { Ok(placement) } else { Err(Fault::new(place, "a finite placement", placement)) }
}

/// Makes a placement of scale, rotation and translation. Animated values replace the given ones.
fn posed(pose: Option<&NodePose>, (scale, rotation, translation): (DVec3, DQuat, DVec3)) -> DAffine3 {
    let moved = pose.cloned().unwrap_or_default();
    DAffine3::from_scale_rotation_translation(
        moved.scale.unwrap_or(scale),
        moved.rotation.unwrap_or(rotation),
        moved.translation.unwrap_or(translation),
    )
}

/// Makes a unit quaternion of four numbers. The vector of these numbers may have any length except
/// 0.
pub(crate) fn rotation(xyzw: [f32; 4], place: impl FnOnce() -> String) -> Result<DQuat, Fault> {
    let quaternion = DQuat::from_array(xyzw.map(f64::from));
    let length = quaternion.length();
    if length > 0.0 && length.is_finite() {
        return Ok(quaternion / length);
    }
    Err(Fault::new(place(), "a quaternion that is finite and not zero", format!("{xyzw:?}")))
}

const TRANSLATION: Format = Format { types: &[Type::Vec3], components: &[F32], text: "VEC3 of FLOAT" };
const ROTATION: Format =
    Format { types: &[Type::Vec4], components: &[F32, I8, I16], text: "VEC4 of FLOAT, BYTE or SHORT" };

/// Reads `EXT_mesh_gpu_instancing`: the placements of the copies of the node's mesh, in the node's
/// space. `None` without the extension.
pub(crate) fn copies(document: &Document<'_>, node: usize) -> Result<Option<Vec<DAffine3>>, Fault> {
    let place = format!("/nodes/{node}/extensions/EXT_mesh_gpu_instancing");
    if document.json(&place).is_none() {
        return Ok(None);
    }
    let open = |name: &str, format: &Format| -> Result<Option<Accessor<'_>>, Fault> {
        let place = format!("{place}/attributes/{name}");
        let Some(value) = document.json(&place) else { return Ok(None) };
        let index = value.as_u64().and_then(|index| u32::try_from(index).ok());
        let index = index.ok_or_else(|| Fault::new(&place, "an accessor's index", quote(Some(value))))?;
        Accessor::open(document, json::Index::new(index), &place, format).map(Some)
    };
    // an absent attribute has its default; present attributes must have the same count
    let translations = open("TRANSLATION", &TRANSLATION)?;
    let rotations = open("ROTATION", &ROTATION)?.map(Accessor::assume_normalized);
    let scales = open("SCALE", &TRANSLATION)?;
    let counts = [&translations, &rotations, &scales].map(|accessor| accessor.as_ref().map(|a| a.count));
    let Some(count) = counts.into_iter().flatten().next() else {
        return Err(Fault::new(
            format!("{place}/attributes"),
            "TRANSLATION, ROTATION or SCALE",
            quote(document.json(&place)),
        ));
    };
    if counts.into_iter().flatten().any(|other| other != count) {
        return Err(Fault::new(
            format!("{place}/attributes"),
            "equal counts of TRANSLATION, ROTATION and SCALE",
            counts.map(|count| count.map_or("none".to_owned(), |count| count.to_string())).join(", "),
        ));
    }
    // read the attributes, and combine them to one placement per copy
    document.spend(&place, count, size_of::<DAffine3>())?;
    let translations = vectors(document, translations)?;
    let scales = vectors(document, scales)?;
    let rotations = rotations.map(|accessor| accessor.finite::<4>(document, &Selection::All, 0.0)).transpose()?;
    let vector = |values: &Option<Vec<[f32; 3]>>, i: usize, default| {
        values.as_ref().map_or(default, |values| DVec3::from(values[i].map(f64::from)))
    };
    let copy = |i: usize| {
        let turned = rotations.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |rotations| rotations[i]);
        Ok(DAffine3::from_scale_rotation_translation(
            vector(&scales, i, DVec3::ONE),
            rotation(turned, || format!("{place}/attributes/ROTATION"))?,
            vector(&translations, i, DVec3::ZERO),
        ))
    };
    (0..count).map(copy).collect::<Result<_, _>>().map(Some)
}

fn vectors(document: &Document<'_>, accessor: Option<Accessor<'_>>) -> Result<Option<Vec<[f32; 3]>>, Fault> {
    accessor.map(|accessor| accessor.finite::<3>(document, &Selection::All, 0.0)).transpose()
}

/// Returns Lumistack's extras, `extras.lumistack`, of the object at `owner`. Warns of members that
/// are not in `known`.
pub(crate) fn extras<'a>(document: &'a Document<'_>, owner: &str, known: &[&str]) -> Option<&'a Value> {
    let place = format!("{owner}/extras/lumistack");
    let value = document.json(&place)?;
    for key in value.as_object().into_iter().flatten().map(|(key, _)| key) {
        if !known.contains(&key.as_str()) {
            document.task.warn(
                format!("{place}/{key}"),
                format!("the member is unknown and has no effect; known members: {}", known.join(", ")),
            );
        }
    }
    Some(value)
}
