//! Skins: linear blend skinning, in the pose that the nodes have.
//!
//! p' = Σ w_j · G_j · B_j · p. p is a vertex in the mesh's space, and p' in the scene's space. For
//! each joint j of the vertex, w_j is the joint's weight. G_j is its global transform, and B_j its
//! inverse bind matrix (glTF 2.0, section 3.7.3). The placement of the node that has the mesh is
//! ignored.

use glam::{Affine3A, DAffine3, DMat4, Mat3A, Vec3A};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::Semantic;
use lumistack_scene::Mesh;

use crate::accessor::{Accessor, Format, Selection};
use crate::attributes::Attributes;
use crate::document::Document;
use crate::error::Fault;

use ComponentType::{F32, U8, U16};

const INVERSE_BIND: Format = Format { types: &[Type::Mat4], components: &[F32], text: "MAT4 of FLOAT" };
const JOINTS: Format =
    Format { types: &[Type::Vec4], components: &[U8, U16], text: "VEC4 of UNSIGNED_BYTE or UNSIGNED_SHORT" };
const WEIGHTS: Format = Format {
    types: &[Type::Vec4],
    components: &[F32, U8, U16],
    text: "VEC4 of FLOAT, UNSIGNED_BYTE or UNSIGNED_SHORT",
};

/// Matrices of a skin's joints, from the mesh's space to the scene's.
pub(crate) struct Pose {
    scene_from_bind: Vec<Affine3A>,
}

impl Pose {
    /// Reads the skin that the index at `used_at` refers to; `scene_from_node` holds the placement
    /// of every node.
    pub(crate) fn load(
        document: &Document<'_>,
        index: json::Index<json::Skin>,
        used_at: &str,
        scene_from_node: &[DAffine3],
    ) -> Result<Self, Fault> {
        let skin = document.get(index, used_at)?;
        let place = format!("/skins/{}", index.value());
        let mut scene_from_bind = Vec::with_capacity(skin.joints.len());
        for (i, &joint) in skin.joints.iter().enumerate() {
            document.get(joint, &format!("{place}/joints/{i}"))?;
            scene_from_bind.push(scene_from_node[joint.value()]);
        }
        if let Some(index) = skin.inverse_bind_matrices {
            let place = format!("{place}/inverseBindMatrices");
            let accessor = Accessor::open(document, index, &place, &INVERSE_BIND)?;
            if accessor.count < scene_from_bind.len() {
                let expected = format!("at least one matrix per joint ({})", scene_from_bind.len());
                return Err(Fault::new(place, expected, accessor.count));
            }
            let matrices = accessor.finite::<16>(document, &Selection::All, 0.0)?;
            for (joint, matrix) in scene_from_bind.iter_mut().zip(matrices) {
                *joint *= DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
            }
        }
        let scene_from_bind = scene_from_bind.iter().map(DAffine3::as_affine3a).collect();
        Ok(Self { scene_from_bind })
    }

    /// Deforms the mesh, and moves it to the scene's space.
    pub(crate) fn apply(
        &self,
        document: &Document<'_>,
        attributes: &Attributes<'_, '_>,
        mesh: &mut Mesh,
        selection: &Selection,
        count: usize,
    ) -> Result<(), Fault> {
        // for every vertex, sum the weighted joint matrices over all sets of joints
        let mut sums = vec![(Affine3A::ZERO, 0.0f32); mesh.positions.len()];
        let mut first_joints = Vec::new();
        for set in 0.. {
            let joints = attributes.open(Semantic::Joints(set), &JOINTS, Some(count))?;
            let weights = attributes.open(Semantic::Weights(set), &WEIGHTS, Some(count))?;
            let (Some(joints), Some(weights)) = (joints, weights) else { break };
            let joints = joints.integers::<4>(document, selection)?;
            let weights = weights.assume_normalized().finite::<4>(document, selection, 0.0)?;
            for ((sum, joints), weights) in sums.iter_mut().zip(&joints).zip(&weights) {
                for (&joint, &weight) in joints.iter().zip(weights) {
                    let Some(matrix) = self.scene_from_bind.get(joint as usize) else {
                        let place = format!("{}/attributes/JOINTS_{set}", mesh.place);
                        return Err(Fault::new(
                            place,
                            format!("joint indices below {}", self.scene_from_bind.len()),
                            joint,
                        ));
                    };
                    sum.0.matrix3 += matrix.matrix3 * weight;
                    sum.0.translation += matrix.translation * weight;
                    sum.1 += weight;
                }
            }
            if set == 0 {
                first_joints = joints;
            }
        }
        for (i, (matrix, weight)) in sums.into_iter().enumerate() {
            // divide by the sum of weights, which need not be 1; without weights a vertex moves
            // with its first joint
            let matrix = if weight > 0.0 {
                Affine3A { matrix3: matrix.matrix3 * weight.recip(), translation: matrix.translation / weight }
            } else {
                let joint = first_joints.get(i).map_or(0, |joints| joints[0] as usize);
                self.scene_from_bind.get(joint).copied().unwrap_or(Affine3A::IDENTITY)
            };
            mesh.positions[i] = matrix.transform_point3(mesh.positions[i]);
            if let Some(normal) = mesh.normals.get_mut(i) {
                *normal = cofactors(&matrix.matrix3) * *normal;
            }
            if let Some(tangent) = mesh.tangents.get_mut(i) {
                *tangent = (matrix.matrix3 * tangent.truncate()).extend(tangent.w);
            }
        }
        Ok(())
    }
}

/// Returns det(M) · M⁻ᵀ. This matrix maps normals, and exists even if M is singular.
fn cofactors(m: &Mat3A) -> Mat3A {
    let (x, y, z): (Vec3A, Vec3A, Vec3A) = (m.x_axis, m.y_axis, m.z_axis);
    Mat3A::from_cols(y.cross(z), z.cross(x), x.cross(y))
}

/// Returns true if a skin can deform the mesh. Otherwise the node places the mesh.
pub(crate) fn has_joints(mesh: &json::Mesh) -> bool {
    let joints = gltf::json::validation::Checked::Valid(Semantic::Joints(0));
    mesh.primitives.iter().any(|primitive| primitive.attributes.contains_key(&joints))
}
