//! One level of refinement: the weights of each child vertex, and the topology of the children.
//!
//! Child vertices are numbered in this order: first the children of vertices, then of edges, then
//! of faces. In Loop's scheme faces have no child vertices.

use std::f64::consts::TAU;

use super::topology::{Edge, Rule, Topology, weaker};

/// Weight that the midpoint of a triangle has in the child vertex of one of its edges, if the mesh
/// has the triangle rule "smooth".
const SMOOTH_TRIANGLE_WEIGHT: f64 = 0.47;

/// Weights by which values of a level (the parents) give values of the next level (the children).
#[derive(Clone, Debug, Default)]
pub(super) struct Stencils {
    /// For each child, the index of its first entry in `parents` and `weights`; then the number of
    /// entries.
    starts: Vec<u32>,
    parents: Vec<u32>,
    weights: Vec<f32>,
}

impl Stencils {
    pub(super) fn with_capacity(children: usize) -> Self {
        let mut starts = Vec::with_capacity(children + 1);
        starts.push(0);
        Self { starts, parents: Vec::with_capacity(6 * children), weights: Vec::with_capacity(6 * children) }
    }

    pub(super) fn add(&mut self, parent: u32, weight: f64) {
        self.parents.push(parent);
        self.weights.push(weight as f32);
    }

    /// Adds the midpoint of a face, times `weight`, to the current child.
    fn add_face(&mut self, topology: &Topology, face: u32, weight: f64) {
        let vertices = topology.face_vertices(face);
        vertices.iter().for_each(|&vertex| self.add(vertex, weight / vertices.len() as f64));
    }

    /// Ends the current child, whose parents were added. The next call of [`add`](Self::add) begins
    /// a new child.
    pub(super) fn end(&mut self) {
        self.starts.push(self.parents.len() as u32);
    }

    /// Computes the children's values from the parents' values, with `width` numbers each.
    pub(super) fn apply(&self, values: &[f32], width: usize) -> Vec<f32> {
        let mut children = vec![0.0; (self.starts.len() - 1) * width];
        for (child, range) in children.chunks_exact_mut(width.max(1)).zip(self.starts.windows(2)) {
            for entry in range[0] as usize..range[1] as usize {
                let parent = &values[self.parents[entry] as usize * width..][..width];
                for (child, parent) in child.iter_mut().zip(parent) {
                    *child += self.weights[entry] * parent;
                }
            }
        }
        children
    }
}

/// Returns the stencils of one level of Catmull and Clark's scheme.
pub(super) fn catmull_clark(topology: &Topology, smooth_triangles: bool) -> Stencils {
    let children = topology.vertex_count + topology.edges.len() + topology.face_count();
    let mut stencils = Stencils::with_capacity(children);
    for vertex in 0..topology.vertex_count as u32 {
        child_vertex(&mut stencils, topology, vertex, |stencils, weight| {
            // A vertex with n neighbours has the weight (n − 2)/n in its child. Each neighbour and
            // each face's midpoint has 1/n².
            let corners = topology.corners_at(vertex);
            let n = topology.edges_at(vertex).count() as f64;
            stencils.add(vertex, weight * (n - 2.0) / n);
            for edge in topology.edges_at(vertex) {
                stencils.add(other_end(edge, vertex), weight / (n * n));
            }
            for &corner in corners {
                let face = topology.face_of_corner[corner as usize];
                stencils.add_face(topology, face, weight / (n * corners.len() as f64));
            }
        });
    }
    // Add the children of edges. On a crease, a child is the edge's midpoint. Elsewhere the child
    // is a weighted mean of the edge's ends and the midpoints of its two faces.
    for edge in &topology.edges {
        let crease = if edge.joined { f64::from(edge.sharpness.min(1.0)) } else { 1.0 };
        let faces = edge.corners.map(|corner| topology.face_of_corner.get(corner as usize));
        let mut at_ends = 0.5 * crease;
        if let ([Some(&first), Some(&second)], true) = (faces, crease < 1.0) {
            let face_weight = |face: u32| match topology.face_vertices(face).len() {
                3 if smooth_triangles => SMOOTH_TRIANGLE_WEIGHT,
                _ => 0.25,
            };
            let at_face = 0.5 * (face_weight(first) + face_weight(second));
            at_ends += (1.0 - crease) * 0.5 * (1.0 - 2.0 * at_face);
            [first, second].into_iter().for_each(|face| stencils.add_face(topology, face, (1.0 - crease) * at_face));
        }
        edge.ends.into_iter().for_each(|end| stencils.add(end, at_ends));
        stencils.end();
    }
    for face in 0..topology.face_count() as u32 {
        stencils.add_face(topology, face, 1.0);
        stencils.end();
    }
    stencils
}

/// Returns the stencils of one level of Loop's scheme, with the weights of Loop's thesis for
/// vertices that do not have six neighbours.
pub(super) fn loop_scheme(topology: &Topology) -> Stencils {
    let mut stencils = Stencils::with_capacity(topology.vertex_count + topology.edges.len());
    for vertex in 0..topology.vertex_count as u32 {
        child_vertex(&mut stencils, topology, vertex, |stencils, weight| {
            let count = topology.edges_at(vertex).count();
            let each = loop_weight(count);
            stencils.add(vertex, weight * (1.0 - count as f64 * each));
            topology.edges_at(vertex).for_each(|edge| stencils.add(other_end(edge, vertex), weight * each));
        });
    }
    for edge in &topology.edges {
        let crease = if edge.joined { f64::from(edge.sharpness.min(1.0)) } else { 1.0 };
        let mut at_ends = 0.5 * crease;
        if crease < 1.0 {
            at_ends += (1.0 - crease) * 0.375;
            for corner in edge.corners {
                let opposite = topology.corners[topology.previous(corner) as usize];
                stencils.add(opposite, (1.0 - crease) * 0.125);
            }
        }
        edge.ends.into_iter().for_each(|end| stencils.add(end, at_ends));
        stencils.end();
    }
    stencils
}

/// Returns the weight of each neighbour of a smooth vertex with `count` neighbours, for Loop's
/// scheme.
pub(super) fn loop_weight(count: usize) -> f64 {
    let beta = 0.375 + 0.25 * (TAU / count as f64).cos();
    (0.625 - beta * beta) / count as f64
}

/// Returns the stencils of one level without smoothing. New vertices are the midpoints of edges
/// and, except for triangles, the midpoints of faces.
pub(super) fn linear(topology: &Topology, triangles: bool) -> Stencils {
    let faces = if triangles { 0 } else { topology.face_count() };
    let mut stencils = Stencils::with_capacity(topology.vertex_count + topology.edges.len() + faces);
    for vertex in 0..topology.vertex_count as u32 {
        stencils.add(vertex, 1.0);
        stencils.end();
    }
    for edge in &topology.edges {
        edge.ends.into_iter().for_each(|end| stencils.add(end, 0.5));
        stencils.end();
    }
    for face in 0..faces as u32 {
        stencils.add_face(topology, face, 1.0);
        stencils.end();
    }
    stencils
}

pub(super) fn other_end(edge: &Edge, vertex: u32) -> u32 {
    edge.ends[usize::from(edge.ends[0] == vertex)]
}

/// Adds the child of a vertex. If a sharpness at the vertex falls to 0 within this level, the rules
/// of this level and of the next level are blended.
fn child_vertex(stencils: &mut Stencils, topology: &Topology, vertex: u32, smooth: impl Fn(&mut Stencils, f64)) {
    let mut add = |rule: Rule, weight: f64| match rule {
        Rule::Smooth => smooth(stencils, weight),
        Rule::Crease(ends) => {
            stencils.add(vertex, 0.75 * weight);
            ends.into_iter().for_each(|end| stencils.add(end, 0.125 * weight));
        }
        Rule::Corner => stencils.add(vertex, weight),
    };
    let (now, next) = (topology.rule(vertex, 0.0), topology.rule(vertex, 1.0));
    if now == next {
        add(now, 1.0);
    } else {
        let own = topology.vertex_sharpness[vertex as usize];
        let around = topology.edges_at(vertex).map(|edge| edge.sharpness);
        let ending =
            || around.clone().chain([own]).filter(|&sharpness| sharpness > 0.0 && weaker(sharpness, 1.0) == 0.0);
        let share = (ending().sum::<f32>() / (ending().count().max(1) as f32)).min(1.0);
        add(now, share.into());
        add(next, 1.0 - f64::from(share));
    }
    stencils.end();
}

/// Returns the topology of the next level and, for each of its faces, the index of the parent face.
pub(super) fn split(topology: &Topology, triangles: bool) -> (Topology, Vec<u32>) {
    let edge_child = |corner: u32| topology.vertex_count as u32 + topology.edge_of_corner[corner as usize];
    let face_child = |face: u32| (topology.vertex_count + topology.edges.len()) as u32 + face;
    let size = if triangles { 3 } else { 4 };
    // Cut each face into a quadrilateral per corner, or into four triangles.
    let mut corners = Vec::with_capacity(topology.corners.len() * size);
    let mut parents = Vec::with_capacity(topology.corners.len());
    for face in 0..topology.face_count() as u32 {
        for corner in topology.face(face).map(|corner| corner as u32) {
            let (vertex, before) = (topology.corners[corner as usize], topology.previous(corner));
            if triangles {
                corners.extend([vertex, edge_child(corner), edge_child(before)]);
            } else {
                corners.extend([vertex, edge_child(corner), face_child(face), edge_child(before)]);
            }
            parents.push(face);
        }
        if triangles {
            corners.extend(topology.face(face).map(|corner| edge_child(corner as u32)));
            parents.push(face);
        }
    }
    // Reduce the sharpness of vertices by one level.
    let added = topology.edges.len() + if triangles { 0 } else { topology.face_count() };
    let mut sharpness: Vec<f32> = topology.vertex_sharpness.iter().map(|&sharpness| weaker(sharpness, 1.0)).collect();
    sharpness.resize(topology.vertex_count + added, 0.0);
    let starts = (0..=parents.len()).map(|face| (face * size) as u32).collect();
    let mut finer = Topology::new(topology.vertex_count + added, starts, corners, sharpness);
    let first_edge_child = topology.vertex_count as u32;
    for edge in &mut finer.edges {
        // Each half of a parent's edge has the edge's sharpness, reduced by one level. One end of a
        // half is a vertex of the parent mesh (the lower index), the other is the edge's midpoint.
        let [low, high] = edge.ends;
        if edge.joined
            && low < first_edge_child
            && let Some(parent) = topology.edges.get((high - first_edge_child) as usize)
        {
            edge.sharpness = weaker(parent.sharpness, 1.0);
        }
    }
    (finer, parents)
}
