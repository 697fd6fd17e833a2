//! Subdivision surfaces: Catmull–Clark, Loop and bilinear, with semi-sharp creases and corners,
//! boundaries, holes and face-varying data.
//!
//! A level is a sparse linear map ([`Stencils`]) from the values at its vertices to the values of
//! the next level. It depends on the topology alone, so all vertex data share its weights.
//! Refinement is uniform, and each level reduces sharpness by 1 (DeRose, Kass, Truong 1998). A
//! fractional sharpness blends two rules. The last level is projected to the limit surface, and the
//! normals are perpendicular to its exact tangent planes.
//!
//! Face-varying data are vertex data of a second mesh, which has the faces of the control mesh.
//! Each of its vertices is a distinct value at a vertex of the control mesh. At a seam, two
//! neighbouring faces have different values, so seams are boundaries of the second mesh.
//!
//! Source: the rules of OpenSubdiv 3 to which UsdGeomMesh refers (interpolateBoundary,
//! faceVaryingLinearInterpolation, triangleSubdivisionRule). Limits and tangents: Halstead, Kass,
//! DeRose 1993 and Biermann, Levin, Zorin 2000.

mod limit;
mod scheme;
mod stencils;
mod topology;

use std::collections::HashSet;
use std::ops::Range;

use glam::Vec3;

pub(crate) use self::scheme::Scheme;
use self::stencils::Stencils;
use self::topology::Topology;

/// Rules for the boundary of a mesh (`interpolateBoundary`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Boundary {
    /// Faces at the boundary are left out.
    None,
    /// The boundary is a smooth curve.
    EdgeOnly,
    /// The boundary is a smooth curve, but vertices with only one face keep their positions.
    #[default]
    EdgeAndCorner,
}

/// Rules that state where face-varying data are not smoothed (`faceVaryingLinearInterpolation`). A
/// seam is an edge whose two faces have different values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum FaceVarying {
    /// Data are smoothed everywhere, also along seams and at corners.
    None,
    /// A value at a vertex is not smoothed if only one face has this value at the vertex.
    CornersOnly,
    /// As `CornersOnly`. Also, no value is smoothed at a vertex with three or more values.
    #[default]
    CornersPlus1,
    /// As `CornersPlus1`. Also, values are not smoothed at the end of a seam, or if one of two
    /// values at a vertex belongs to a single face.
    CornersPlus2,
    /// Values at seams are not smoothed.
    Boundaries,
    /// No value is smoothed.
    All,
}

/// A control mesh and its rules, named as in UsdGeomMesh. Faces with fewer than three vertices, or
/// with vertices that do not exist, are left out. Creases and corners with vertices that do
/// not exist are ignored.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Cage<'a> {
    pub(crate) vertex_count: usize,
    pub(crate) face_vertex_counts: &'a [i32],
    pub(crate) face_vertex_indices: &'a [i32],
    pub(crate) hole_indices: &'a [i32],
    pub(crate) crease_indices: &'a [i32],
    pub(crate) crease_lengths: &'a [i32],
    /// The list has one sharpness per crease, or one per edge of a crease.
    pub(crate) crease_sharpnesses: &'a [f32],
    pub(crate) corner_indices: &'a [i32],
    pub(crate) corner_sharpnesses: &'a [f32],
    pub(crate) scheme: Scheme,
    pub(crate) boundary: Boundary,
    /// True if `triangleSubdivisionRule` is "smooth".
    pub(crate) smooth_triangles: bool,
}

/// Number of times that most meshes are refined.
const LEVEL: u32 = 2;
/// Largest number of triangles after [`LEVEL`] levels. A denser mesh is already smooth, so it is
/// refined by fewer levels.
const MOST_TRIANGLES: usize = 200_000;
/// Number of levels for a mesh of few faces, whose outline would still show corners after [`LEVEL`]
/// levels.
const SPARSE_LEVEL: u32 = 4;
/// Largest number of triangles after the refinement, for a mesh that is refined by more than
/// [`LEVEL`] levels.
const SPARSE_TRIANGLES: usize = 8_000;

/// Returns the number of levels for a mesh whose faces have `corner_count` corners in total.
pub(crate) fn level_for(corner_count: usize) -> u32 {
    let usual = affordable_level(corner_count, LEVEL, MOST_TRIANGLES);
    usual.max(affordable_level(corner_count, SPARSE_LEVEL, SPARSE_TRIANGLES))
}

/// Returns the largest number of levels, up to `wanted`, that gives at most `most_triangles`
/// triangles.
fn affordable_level(corner_count: usize, wanted: u32, most_triangles: usize) -> u32 {
    // each corner becomes a quadrilateral of two triangles; each further level cuts a quadrilateral
    // into four
    (1..=wanted).rev().find(|&level| corner_count.saturating_mul(2 << (2 * (level - 1))) <= most_triangles).unwrap_or(0)
}

/// A refined mesh. Its methods interpolate values of the control mesh.
pub(crate) struct Refinement {
    cage: Topology,
    /// For each corner of `cage`, the index of the same corner among the faces of the input.
    source_corners: Vec<u32>,
    source_corner_count: usize,
    scheme: Scheme,
    smooth_triangles: bool,
    level: u32,
    levels: Vec<Stencils>,
    /// The topology of the last level, whose vertices are not yet projected to the limit surface.
    finest: Topology,
    /// For each face of `finest`, the index of the input's face that contains it; `None` in holes.
    sources: Vec<Option<u32>>,
}

/// A list of values. Each corner of [`Refinement::faces`] has the index of its value in the list.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Indexed {
    /// The values, each with as many numbers as the input's values.
    pub(crate) values: Vec<f32>,
    pub(crate) indices: Vec<u32>,
}

impl Refinement {
    /// Refines the topology of the control mesh `level` times.
    pub(crate) fn new(cage: &Cage<'_>, level: u32) -> Self {
        let polygons = Polygons::new(cage);
        // Set the sharpness of vertices and edges.
        let mut sharpness = vec![0.0; cage.vertex_count];
        for (&vertex, &value) in cage.corner_indices.iter().zip(cage.corner_sharpnesses) {
            if let Some(sharpness) = usize::try_from(vertex).ok().and_then(|vertex| sharpness.get_mut(vertex)) {
                *sharpness = if value.is_nan() { 0.0 } else { value.max(0.0) };
            }
        }
        let mut topology = Topology::new(cage.vertex_count, polygons.starts, polygons.corners, sharpness);
        crease(&mut topology, cage);
        if cage.boundary == Boundary::EdgeAndCorner {
            for vertex in 0..cage.vertex_count as u32 {
                if topology.corners_at(vertex).len() == 1 {
                    topology.vertex_sharpness[vertex as usize] = f32::INFINITY;
                }
            }
        }
        // Mark holes: the mesh's holes, and faces at the boundary under the rule `Boundary::None`.
        // They affect their neighbours, and are left out at the end.
        let mut sources: Vec<Option<u32>> = polygons.sources.into_iter().map(Some).collect();
        let holes: HashSet<u32> = cage.hole_indices.iter().filter_map(|&face| u32::try_from(face).ok()).collect();
        for (face, source) in (0..).zip(&mut sources) {
            let open = cage.boundary == Boundary::None
                && topology.face_vertices(face).iter().any(|&vertex| topology.is_boundary(vertex));
            if open || source.is_some_and(|source| holes.contains(&source)) {
                *source = None;
            }
        }
        let source_corners = polygons.source_corners;
        let (levels, finest, parents) = refine(&topology, cage.scheme, cage.smooth_triangles, level);
        Self {
            cage: topology,
            source_corners,
            source_corner_count: cage.face_vertex_indices.len(),
            scheme: cage.scheme,
            smooth_triangles: cage.smooth_triangles,
            level,
            levels,
            finest,
            sources: parents.into_iter().map(|parent| sources[parent as usize]).collect(),
        }
    }

    /// Returns the indices of the last level's faces that are not in holes.
    fn shown(&self) -> impl Iterator<Item = u32> + Clone {
        (0..self.finest.face_count() as u32).filter(|&face| self.sources[face as usize].is_some())
    }

    /// Returns, for each refined face outside of holes, the index of the input's face that contains
    /// it, and the refined face's vertices.
    pub(crate) fn faces(&self) -> impl Iterator<Item = (u32, &[u32])> {
        self.shown().filter_map(|face| Some((self.sources[face as usize]?, self.finest.face_vertices(face))))
    }

    /// Interpolates data of "vertex" primvars, with `width` numbers per vertex, at the refined
    /// vertices on the limit surface.
    pub(crate) fn vertex(&self, values: &[f32], width: usize) -> Vec<f32> {
        let refined = self.refine_values(&self.levels, values, width);
        self.limit(&self.finest).map_or(refined.clone(), |limit| limit.apply(&refined, width))
    }

    /// Interpolates data of "varying" primvars, which are not smoothed.
    pub(crate) fn varying(&self, values: &[f32], width: usize) -> Vec<f32> {
        if self.scheme == Scheme::Bilinear {
            return self.vertex(values, width);
        }
        let (levels, ..) = refine_linearly(&self.cage, self.scheme, self.level);
        self.refine_values(&levels, values, width)
    }

    /// Interpolates data of "faceVarying" primvars. `indices` has the index of a value per corner
    /// of the input. Equal values at a vertex are joined. `None` if `indices` does not fit the mesh
    /// or the values.
    pub(crate) fn face_varying(
        &self,
        rule: FaceVarying,
        values: &[f32],
        indices: &[u32],
        width: usize,
    ) -> Option<Indexed> {
        let count = values.len() / width.max(1);
        if indices.len() != self.source_corner_count || indices.iter().any(|&index| index as usize >= count) {
            return None;
        }
        let value = |index: u32| &values[index as usize * width..][..width];
        // Group equal values at each vertex, in the order of vertices, so that the numbering is
        // reproducible.
        let mut groups: Vec<u32> = Vec::new();
        let mut corners = vec![0; self.cage.corners.len()];
        let mut groups_of_vertex = vec![0..0; self.cage.vertex_count];
        for vertex in 0..self.cage.vertex_count as u32 {
            let first = groups.len();
            for &corner in self.cage.corners_at(vertex) {
                let index = indices[self.source_corners[corner as usize] as usize];
                let known = groups[first..].iter().position(|&group| group == index || value(group) == value(index));
                let group = known.map_or(groups.len(), |position| first + position);
                if group == groups.len() {
                    groups.push(index);
                }
                corners[corner as usize] = group as u32;
            }
            groups_of_vertex[vertex as usize] = first..groups.len();
        }
        // Build the topology of the face-varying data: one vertex per group, with the sharpness of
        // the control mesh.
        let starts = (0..=self.cage.face_count() as u32).map(|face| match face as usize == self.cage.face_count() {
            true => corners.len() as u32,
            false => self.cage.face(face).start as u32,
        });
        let starts = starts.collect();
        let mut sharpness = vec![0.0; groups.len()];
        for (vertex, range) in groups_of_vertex.iter().enumerate() {
            // with the rule `None`, data are smoothed also at a boundary corner, which the mesh
            // keeps sharp
            let given = self.cage.vertex_sharpness[vertex];
            let lone = self.cage.corners_at(vertex as u32).len() == 1;
            sharpness[range.clone()].fill(if lone && rule == FaceVarying::None { 0.0 } else { given });
        }
        let mut topology = Topology::new(groups.len(), starts, corners, sharpness);
        for corner in 0..topology.corners.len() {
            let given = self.cage.edge(corner as u32).sharpness;
            let edge = topology.edge_of_corner[corner] as usize;
            topology.edges[edge].sharpness = topology.edges[edge].sharpness.max(given);
        }
        for (vertex, range) in (0..).zip(groups_of_vertex) {
            pin(&mut topology, rule, range.start as u32..range.end as u32, !self.cage.is_boundary(vertex));
        }
        // Refine this topology, and project its vertices to the limit.
        let (levels, finest, _) = match rule {
            FaceVarying::All => refine_linearly(&topology, self.scheme, self.level),
            _ => refine(&topology, self.scheme, self.smooth_triangles, self.level),
        };
        let cage_values: Vec<f32> = groups.iter().flat_map(|&index| value(index)).copied().collect();
        let mut refined = self.refine_values(&levels, &cage_values, width);
        if rule != FaceVarying::All
            && let Some(limit) = self.limit(&finest)
        {
            refined = limit.apply(&refined, width);
        }
        let indices = self.shown().flat_map(|face| finest.face_vertices(face)).copied().collect();
        Some(Indexed { values: refined, indices })
    }

    /// Returns the unit normals of the surface with these control points. A vertex has one normal
    /// for each smooth region around it.
    pub(crate) fn normals(&self, points: &[f32]) -> Indexed {
        let control = vectors(&self.refine_values(&self.levels, points, 3));
        let surface = vectors(&self.vertex(points, 3));
        let (values, indices) = limit::normals(&self.finest, self.scheme, self.level, &control, &surface);
        let values = values.into_iter().flat_map(|normal| normal.to_array()).collect();
        let indices = self.shown().flat_map(|face| self.finest.face(face)).map(|corner| indices[corner]).collect();
        Indexed { values, indices }
    }

    fn refine_values(&self, levels: &[Stencils], values: &[f32], width: usize) -> Vec<f32> {
        levels.iter().fold(values.to_vec(), |values, stencils| stencils.apply(&values, width))
    }

    /// Returns the projection to the limit surface; `None` at level 0 and for bilinear surfaces,
    /// where it does not apply.
    fn limit(&self, finest: &Topology) -> Option<Stencils> {
        (self.level > 0 && self.scheme != Scheme::Bilinear).then(|| limit::positions(finest, self.scheme))
    }
}

fn vectors(values: &[f32]) -> Vec<Vec3> {
    values.as_chunks::<3>().0.iter().map(|&value| Vec3::from(value)).collect()
}

/// The polygons of a control mesh that have at least three vertices, all of which exist. For Loop's
/// scheme they are cut into triangles.
struct Polygons {
    starts: Vec<u32>,
    corners: Vec<u32>,
    source_corners: Vec<u32>,
    sources: Vec<u32>,
}

impl Polygons {
    fn new(cage: &Cage<'_>) -> Self {
        let mut this = Self { starts: vec![0], corners: Vec::new(), source_corners: Vec::new(), sources: Vec::new() };
        let mut first = 0usize;
        for (face, &count) in cage.face_vertex_counts.iter().enumerate() {
            let count = usize::try_from(count).unwrap_or(0);
            let Some(indices) = cage.face_vertex_indices.get(first..first.saturating_add(count)) else { break };
            let valid = |&index: &i32| usize::try_from(index).is_ok_and(|index| index < cage.vertex_count);
            if count >= 3 && indices.iter().all(valid) {
                let mut add = |corners: &[usize]| {
                    this.corners.extend(corners.iter().map(|&corner| indices[corner] as u32));
                    this.source_corners.extend(corners.iter().map(|&corner| (first + corner) as u32));
                    this.starts.push(this.corners.len() as u32);
                    this.sources.push(face as u32);
                };
                if cage.scheme == Scheme::Loop {
                    (1..count - 1).for_each(|corner| add(&[0, corner, corner + 1]));
                } else {
                    add(&(0..count).collect::<Vec<_>>());
                }
            }
            first += count;
        }
        this
    }
}

/// Sets the sharpness of edges that the control mesh lists as creases.
fn crease(topology: &mut Topology, cage: &Cage<'_>) {
    let per_crease = cage.crease_sharpnesses.len() == cage.crease_lengths.len();
    let (mut first, mut edge) = (0usize, 0usize);
    for (number, &length) in cage.crease_lengths.iter().enumerate() {
        let length = usize::try_from(length).unwrap_or(0);
        let Some(vertices) = cage.crease_indices.get(first..first.saturating_add(length)) else { break };
        for pair in vertices.windows(2) {
            let sharpness = cage.crease_sharpnesses.get(if per_crease { number } else { edge });
            edge += 1;
            let [Ok(a), Ok(b)] = [pair[0], pair[1]].map(u32::try_from) else { continue };
            let exist = a.max(b) < cage.vertex_count as u32;
            if let (Some(&sharpness), true) = (sharpness, exist)
                && let Some(edge) = topology.edge_between(a, b)
                && edge.joined
                && !sharpness.is_nan()
            {
                edge.sharpness = sharpness.max(0.0);
            }
        }
        first += length;
    }
}

/// Makes face-varying values at a vertex infinitely sharp if the rule requires it. `inside` is true
/// if the vertex is inside the mesh, not on its boundary.
fn pin(topology: &mut Topology, rule: FaceVarying, values: Range<u32>, inside: bool) {
    let lone = |value: u32| topology.corners_at(value).len() == 1;
    let at_seam = |value: u32| topology.is_boundary(value);
    let many = values.len() >= 3;
    let cornered = values.len() == 2 && values.clone().any(lone);
    // a seam ends at a vertex inside the mesh if the vertex has only one value and this value is on
    // a seam
    let ends = |value: u32| inside && values.len() == 1 && at_seam(value);
    let pinned: Vec<u32> = values
        .clone()
        .filter(|&value| match rule {
            FaceVarying::None | FaceVarying::All => false,
            FaceVarying::CornersOnly => lone(value),
            FaceVarying::CornersPlus1 => lone(value) || many,
            FaceVarying::CornersPlus2 => lone(value) || many || cornered || ends(value),
            FaceVarying::Boundaries => at_seam(value),
        })
        .collect();
    pinned.into_iter().for_each(|value| topology.vertex_sharpness[value as usize] = f32::INFINITY);
}

/// Refines a mesh. Returns the stencils of each level, and the topology of the last level. Also
/// returns, for each face of the last level, the index of the input's face that contains it.
fn refine(cage: &Topology, scheme: Scheme, smooth_triangles: bool, level: u32) -> (Vec<Stencils>, Topology, Vec<u32>) {
    let mut topology = cage.clone();
    let mut parents: Vec<u32> = (0..cage.face_count() as u32).collect();
    let mut levels = Vec::new();
    for _ in 0..level {
        let triangles = scheme == Scheme::Loop;
        levels.push(match scheme {
            Scheme::CatmullClark => stencils::catmull_clark(&topology, smooth_triangles),
            Scheme::Loop => stencils::loop_scheme(&topology),
            Scheme::Bilinear => stencils::linear(&topology, false),
        });
        let (finer, parent) = stencils::split(&topology, triangles);
        parents = parent.into_iter().map(|face| parents[face as usize]).collect();
        topology = finer;
    }
    (levels, topology, parents)
}

/// Refines a mesh without smoothing. Returns the stencils of each level, the topology of the last
/// level, and an empty list in place of the faces' parents.
fn refine_linearly(cage: &Topology, scheme: Scheme, level: u32) -> (Vec<Stencils>, Topology, Vec<u32>) {
    let triangles = scheme == Scheme::Loop;
    let mut topology = cage.clone();
    let mut levels = Vec::new();
    for _ in 0..level {
        levels.push(stencils::linear(&topology, triangles));
        topology = stencils::split(&topology, triangles).0;
    }
    (levels, topology, Vec::new())
}

#[cfg(test)]
mod tests;
