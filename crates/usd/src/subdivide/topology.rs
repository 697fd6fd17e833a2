//! Adjacency of a polygon mesh's faces, edges and vertices, and their sharpness.

use std::ops::Range;

/// Stands for a corner that does not exist.
pub(super) const NONE: u32 = u32::MAX;

/// From this sharpness on, USD treats a crease as infinitely sharp.
const INFINITE: f32 = 10.0;

/// A list of numbers for each item.
#[derive(Clone, Debug, Default)]
pub(super) struct Lists {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Lists {
    /// Distributes the pairs (item, member) to the items' lists and keeps their order.
    fn new(count: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut starts = vec![0; count + 1];
        pairs.clone().for_each(|(item, _)| starts[item as usize + 1] += 1);
        for item in 0..count {
            starts[item + 1] += starts[item];
        }
        let mut members = vec![0; starts[count] as usize];
        let mut next = starts.clone();
        for (item, member) in pairs {
            members[next[item as usize] as usize] = member;
            next[item as usize] += 1;
        }
        Self { starts, members }
    }

    pub(super) fn of(&self, item: u32) -> &[u32] {
        &self.members[self.starts[item as usize] as usize..self.starts[item as usize + 1] as usize]
    }
}

/// An edge, and the corners at which it starts. The edge of a corner leads from the corner's vertex
/// to the vertex of the face's next corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) ends: [u32; 2],
    /// Two of the corners at which the edge starts. If it starts at one corner only, the second is
    /// [`NONE`].
    pub(super) corners: [u32; 2],
    /// True if the edge has exactly two faces that agree on the front side.
    pub(super) joined: bool,
    /// Sharpness: 0 is smooth; infinite if the edge is not joined.
    pub(super) sharpness: f32,
}

/// The faces, edges and vertices of a polygon mesh, without positions.
#[derive(Clone, Debug)]
pub(super) struct Topology {
    pub(super) vertex_count: usize,
    /// Index of the first corner of each face, then the number of all corners.
    starts: Vec<u32>,
    /// For each corner, the index of its vertex.
    pub(super) corners: Vec<u32>,
    pub(super) face_of_corner: Vec<u32>,
    /// For each corner, the index of the edge that leads to the face's next corner.
    pub(super) edge_of_corner: Vec<u32>,
    pub(super) edges: Vec<Edge>,
    corners_of_vertex: Lists,
    edges_of_vertex: Lists,
    /// Sharpness of each vertex; 0 is smooth.
    pub(super) vertex_sharpness: Vec<f32>,
}

/// The rule by which the child of a vertex is computed. It depends on the sharpness of the vertex
/// and of its edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rule {
    /// The vertex is smoothed, since at most one sharp edge ends at it.
    Smooth,
    /// The vertex moves along the crease of two sharp edges, which lead to these vertices.
    Crease([u32; 2]),
    /// The vertex keeps its position, for example since it is sharp or has more than two sharp
    /// edges.
    Corner,
}

/// Corners around a vertex, counter-clockwise. Each corner shares an edge with the next.
pub(super) struct Fan {
    pub(super) corners: Vec<u32>,
    /// True if the last corner shares an edge with the first, so that the fan surrounds the vertex.
    pub(super) closed: bool,
}

impl Topology {
    /// Builds a topology. All vertex indices of faces must be below `vertex_count`. `starts` is the
    /// field of the same name. A vertex that several separate fans share becomes infinitely sharp.
    pub(super) fn new(vertex_count: usize, starts: Vec<u32>, corners: Vec<u32>, vertex_sharpness: Vec<f32>) -> Self {
        let mut face_of_corner = vec![0; corners.len()];
        for face in 0..starts.len() - 1 {
            face_of_corner[starts[face] as usize..starts[face + 1] as usize].fill(face as u32);
        }
        let mut topology = Self {
            vertex_count,
            starts,
            face_of_corner,
            edge_of_corner: vec![0; corners.len()],
            edges: Vec::with_capacity(corners.len()),
            corners_of_vertex: Lists::new(
                vertex_count,
                corners.iter().zip(0..).map(|(&vertex, corner)| (vertex, corner)),
            ),
            edges_of_vertex: Lists::default(),
            corners,
            vertex_sharpness,
        };
        topology.find_edges();
        for vertex in 0..vertex_count as u32 {
            if topology.fans(vertex, |edge| !edge.joined).len() > 1 {
                topology.vertex_sharpness[vertex as usize] = f32::INFINITY;
            }
        }
        topology
    }

    fn find_edges(&mut self) {
        let mut sides: Vec<(u32, u32, u32)> = (0..self.corners.len() as u32)
            .map(|corner| {
                let (from, to) = self.ends(corner);
                (from.min(to), from.max(to), corner)
            })
            .collect();
        sides.sort_unstable();
        for group in sides.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (low, high, first) = group[0];
            let second = group.get(1).map_or(NONE, |side| side.2);
            let joined =
                group.len() == 2 && low != high && self.corners[first as usize] != self.corners[second as usize];
            let sharpness = if joined { 0.0 } else { f32::INFINITY };
            for side in group {
                self.edge_of_corner[side.2 as usize] = self.edges.len() as u32;
            }
            self.edges.push(Edge { ends: [low, high], corners: [first, second], joined, sharpness });
        }
        let pairs = self.edges.iter().zip(0..).flat_map(|(edge, index)| edge.ends.map(|end| (end, index)));
        self.edges_of_vertex = Lists::new(self.vertex_count, pairs);
    }

    pub(super) fn face_count(&self) -> usize {
        self.starts.len() - 1
    }

    pub(super) fn face(&self, face: u32) -> Range<usize> {
        self.starts[face as usize] as usize..self.starts[face as usize + 1] as usize
    }

    pub(super) fn face_vertices(&self, face: u32) -> &[u32] {
        &self.corners[self.face(face)]
    }

    /// Returns the next corner of the same face.
    pub(super) fn next(&self, corner: u32) -> u32 {
        let face = self.face(self.face_of_corner[corner as usize]);
        if corner as usize + 1 == face.end { face.start as u32 } else { corner + 1 }
    }

    /// Returns the previous corner of the same face.
    pub(super) fn previous(&self, corner: u32) -> u32 {
        let face = self.face(self.face_of_corner[corner as usize]);
        if corner as usize == face.start { face.end as u32 - 1 } else { corner - 1 }
    }

    /// Returns the vertices at both ends of the edge that starts at a corner.
    fn ends(&self, corner: u32) -> (u32, u32) {
        (self.corners[corner as usize], self.corners[self.next(corner) as usize])
    }

    pub(super) fn corners_at(&self, vertex: u32) -> &[u32] {
        self.corners_of_vertex.of(vertex)
    }

    pub(super) fn edges_at(&self, vertex: u32) -> impl Iterator<Item = &Edge> + Clone {
        self.edges_of_vertex.of(vertex).iter().map(|&edge| &self.edges[edge as usize])
    }

    pub(super) fn edge(&self, corner: u32) -> &Edge {
        &self.edges[self.edge_of_corner[corner as usize] as usize]
    }

    /// Returns true if a vertex is on an edge that does not join exactly two faces, as at the
    /// mesh's boundary.
    pub(super) fn is_boundary(&self, vertex: u32) -> bool {
        self.edges_at(vertex).any(|edge| !edge.joined)
    }

    /// Returns the edge between two vertices, or `None` if there is none.
    pub(super) fn edge_between(&mut self, a: u32, b: u32) -> Option<&mut Edge> {
        let ends = [a.min(b), a.max(b)];
        let found = self.edges_of_vertex.of(a).iter().copied().find(|&edge| self.edges[edge as usize].ends == ends)?;
        Some(&mut self.edges[found as usize])
    }

    /// Returns the rule of a vertex after `passed` further levels, each of which lowers the
    /// sharpness by 1.
    pub(super) fn rule(&self, vertex: u32, passed: f32) -> Rule {
        let sharp = |sharpness: f32| weaker(sharpness, passed) > 0.0;
        if sharp(self.vertex_sharpness[vertex as usize]) || self.corners_at(vertex).is_empty() {
            return Rule::Corner;
        }
        let (mut count, mut ends) = (0, [vertex; 2]);
        for edge in self.edges_at(vertex).filter(|edge| sharp(edge.sharpness)) {
            if let Some(end) = ends.get_mut(count) {
                *end = edge.ends[usize::from(edge.ends[0] == vertex)];
            }
            count += 1;
        }
        match count {
            0 | 1 if self.edges_at(vertex).count() > 1 => Rule::Smooth,
            2 => Rule::Crease(ends),
            _ => Rule::Corner,
        }
    }

    /// Returns the fans around a vertex. Fans are separated by gaps, and by edges for which
    /// `splits` is true.
    pub(super) fn fans(&self, vertex: u32, splits: impl Fn(&Edge) -> bool) -> Vec<Fan> {
        let corners = self.corners_at(vertex);
        let across = |edge: &Edge, corner: u32| {
            let other = if edge.corners[0] == corner { edge.corners[1] } else { edge.corners[0] };
            (edge.joined && !splits(edge)).then_some(other)
        };
        let clockwise = |corner: u32| Some(self.next(across(self.edge(corner), corner)?));
        let counter_clockwise = |corner: u32| {
            let before = self.previous(corner);
            across(self.edge(before), before)
        };
        // Collect each fan: go clockwise to its start, then counter-clockwise to its end.
        let mut seen: Vec<u32> = Vec::with_capacity(corners.len());
        let mut fans = Vec::new();
        for &corner in corners {
            if seen.contains(&corner) {
                continue;
            }
            let mut start = corner;
            let mut closed = false;
            for _ in corners {
                match clockwise(start) {
                    Some(other) if other == corner => {
                        closed = true;
                        break;
                    }
                    Some(other) => start = other,
                    None => break,
                }
            }
            if closed {
                start = corner;
            }
            let first = seen.len();
            let mut at = Some(start);
            while let Some(corner) = at.filter(|corner| !seen.contains(corner)) {
                seen.push(corner);
                at = counter_clockwise(corner);
            }
            fans.push(Fan { corners: seen[first..].to_vec(), closed });
        }
        fans
    }
}

/// Returns a sharpness after `passed` levels of refinement.
pub(super) fn weaker(sharpness: f32, passed: f32) -> f32 {
    if sharpness >= INFINITE { f32::INFINITY } else { (sharpness - passed).max(0.0) }
}
