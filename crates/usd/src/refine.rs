//! Refines a subdivision surface: a polygon mesh, with its primvars.

use lumistack_core::Task;

use crate::package::{Array, MeshEntry, Package, Subdivision};
use crate::polygons::{Attribute, Interpolation, Polygons};
use crate::subdivide::{Boundary, Cage, FaceVarying, Refinement, Scheme, level_for};

/// Returns the refined mesh with its normals. Also returns, for each refined face, the index of the
/// file's face that contains it.
pub(crate) fn refined(
    package: &Package<'_>,
    entry: &MeshEntry,
    subdivision: &Subdivision,
    polygons: Polygons,
    task: Task<'_>,
) -> (Polygons, Vec<u32>) {
    let integers = |array: &Option<Array>| -> Vec<i32> {
        let read = array.as_ref().and_then(|array| package.integers(array, &entry.place).ok()).unwrap_or_default();
        read.into_iter().map(|value| i32::try_from(value).unwrap_or(-1)).collect()
    };
    let reals = |array: &Option<Array>| -> Vec<f32> {
        let read = array.as_ref().and_then(|array| package.reals::<1>(array, &entry.place).ok()).unwrap_or_default();
        read.into_flattened()
    };
    // Read the creases and rules. Arrays that cannot be read are treated as absent.
    let lists = [&subdivision.crease_indices, &subdivision.crease_lengths, &subdivision.corner_indices].map(integers);
    let [crease_indices, crease_lengths, corner_indices] = &lists;
    let sharpnesses = [&subdivision.crease_sharpnesses, &subdivision.corner_sharpnesses].map(reals);
    let [crease_sharpnesses, corner_sharpnesses] = &sharpnesses;
    let scheme = match subdivision.scheme.as_str() {
        "loop" => Scheme::Loop,
        "bilinear" => Scheme::Bilinear,
        _ => Scheme::CatmullClark,
    };
    if scheme == Scheme::Loop && polygons.counts.iter().any(|&count| count > 3) {
        task.warn(&entry.place, "the subdivision scheme loop is for triangles; faces with more corners are cut into triangles before the subdivision");
    }
    let cage = Cage {
        vertex_count: polygons.points.len(),
        face_vertex_counts: &polygons.counts,
        face_vertex_indices: &polygons.corners,
        hole_indices: &polygons.holes,
        crease_indices,
        crease_lengths,
        crease_sharpnesses,
        corner_indices,
        corner_sharpnesses,
        scheme,
        boundary: match subdivision.interpolate_boundary.as_str() {
            "none" => Boundary::None,
            "edgeOnly" => Boundary::EdgeOnly,
            _ => Boundary::EdgeAndCorner,
        },
        smooth_triangles: subdivision.triangle_rule == "smooth",
    };
    let rule = match subdivision.face_varying.as_str() {
        "none" => FaceVarying::None,
        "cornersOnly" => FaceVarying::CornersOnly,
        "cornersPlus2" => FaceVarying::CornersPlus2,
        "boundaries" => FaceVarying::Boundaries,
        "all" => FaceVarying::All,
        _ => FaceVarying::CornersPlus1,
    };
    // Refine the topology.
    let level = level_for(polygons.corners.len());
    let refinement = Refinement::new(&cage, level);
    let (mut counts, mut corners, mut parents) = (Vec::new(), Vec::new(), Vec::new());
    for (parent, face) in refinement.faces() {
        counts.push(face.len() as i32);
        corners.extend(face.iter().map(|&vertex| vertex as i32));
        parents.push(parent);
    }
    // Interpolate points and primvars on the refined mesh.
    let carrier = Carrier { refinement: &refinement, rule, parents: &parents, polygons: &polygons };
    let flat = polygons.points.as_flattened();
    let normals = refinement.normals(flat);
    let sign = if polygons.left_handed { -1.0 } else { 1.0 };
    let normals = Attribute {
        values: normals.values.as_chunks::<3>().0.iter().map(|normal| normal.map(|x| sign * x)).collect(),
        interpolation: Interpolation::FaceVarying,
        indices: Some(normals.indices),
    };
    let refined = Polygons {
        points: refinement.vertex(flat, 3).as_chunks::<3>().0.to_vec(),
        counts,
        corners,
        left_handed: polygons.left_handed,
        holes: Vec::new(),
        normals: Some(normals),
        uvs: polygons.uvs.each_ref().map(|uvs| uvs.as_ref().and_then(|uvs| carrier.carried(uvs))),
        colors: polygons.colors.as_ref().and_then(|colors| carrier.carried(colors)),
        opacities: polygons.opacities.as_ref().and_then(|opacities| carrier.carried(opacities)),
    };
    (refined, parents)
}

struct Carrier<'r> {
    refinement: &'r Refinement,
    rule: FaceVarying,
    parents: &'r [u32],
    polygons: &'r Polygons,
}

impl Carrier<'_> {
    /// Interpolates an attribute of the control mesh at the elements of the refined mesh.
    fn carried<const N: usize>(&self, attribute: &Attribute<N>) -> Option<Attribute<N>> {
        let interpolation = attribute.interpolation;
        let number = |element: usize| attribute.indices.as_ref().map_or(element as u32, |indices| indices[element]);
        let chunks = |values: Vec<f32>| values.as_chunks::<N>().0.to_vec();
        Some(match interpolation {
            Interpolation::Constant => attribute.clone(),
            Interpolation::Uniform => {
                let indices = self.parents.iter().map(|&face| number(face as usize)).collect();
                Attribute { values: attribute.values.clone(), interpolation, indices: Some(indices) }
            }
            Interpolation::Varying | Interpolation::Vertex => {
                let count = self.polygons.points.len();
                let each: Vec<[f32; N]> = (0..count).map(|point| attribute.values[number(point) as usize]).collect();
                let flat = each.as_flattened();
                let values = match interpolation {
                    Interpolation::Vertex => self.refinement.vertex(flat, N),
                    _ => self.refinement.varying(flat, N),
                };
                Attribute { values: chunks(values), interpolation, indices: None }
            }
            Interpolation::FaceVarying => {
                let indices: Vec<u32> = (0..self.polygons.corners.len()).map(number).collect();
                let found = self.refinement.face_varying(self.rule, attribute.values.as_flattened(), &indices, N)?;
                Attribute { values: chunks(found.values), interpolation, indices: Some(found.indices) }
            }
        })
    }
}
