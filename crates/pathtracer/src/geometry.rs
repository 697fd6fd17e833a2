//! The scene's triangles in render space, and what a ray finds where it meets one.
//!
//! Render space is the scene moved to the centre of its bounds and scaled by a power of two to a half diagonal of 1 to 2, so that
//! 32-bit rounding is the same for a scene of a micrometre and of a kilometre, wherever it stands.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Mat3, Vec2, Vec3, Vec4};
use lumistack_scene::{Material, Mesh, Scene};

use crate::bvh::Hit;

/// Rays leave a surface at this share of the largest coordinate of its triangle: about 16 times the rounding error of a point
/// interpolated from three vertices.
const OFFSET_SHARE: f32 = 4e-6;
/// Least cosine between the reflected direction and the geometric normal; see [`bend_normal`].
const LEAST_REFLECTED_COSINE: f32 = 0.01;

/// Maps the scene to render space: `scale · (point − centre)`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RenderSpace {
    pub(crate) centre: DVec3,
    pub(crate) scale: f64,
    /// Half the diagonal of the scene's bounds, in render space.
    pub(crate) radius: f32,
    /// Half the size of the bounds per axis, in render space.
    pub(crate) half_size: Vec3,
}

/// All placed triangles.
pub(crate) struct Geometry {
    scene: Arc<Scene>,
    pub(crate) space: RenderSpace,
    /// Corners in render space, wound counter-clockwise seen from the front.
    pub(crate) triangles: Vec<[Vec3; 3]>,
    /// Instance and triangle of its mesh.
    sources: Vec<(u32, u32)>,
    instances: Vec<PlacedInstance>,
}

struct PlacedInstance {
    /// Inverse transpose of the linear part, for normals.
    normal_matrix: Mat3,
    tangent_matrix: Mat3,
    mirrored: bool,
}

/// A point of a surface.
pub(crate) struct SurfacePoint<'a> {
    pub(crate) mesh: &'a Mesh,
    pub(crate) indices: [usize; 3],
    pub(crate) weights: [f32; 3],
    pub(crate) position: Vec3,
    /// On the front side.
    pub(crate) geometric_normal: Vec3,
    /// Doubled area in render space.
    pub(crate) doubled_area: f32,
    /// Distance by which a ray must start off the surface.
    pub(crate) offset: f32,
    instance: &'a PlacedInstance,
}

impl RenderSpace {
    fn new(scene: &Scene) -> Self {
        let bounds = scene.bounds();
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let half_size = 0.5 * (max - min);
        // a scene of one point cannot be: the validator keeps only triangles with area
        let scale = (-half_size.length().max(f64::MIN_POSITIVE).log2().floor()).exp2();
        Self {
            centre: 0.5 * (min + max),
            scale,
            radius: (scale * half_size.length()) as f32,
            half_size: (scale * half_size).as_vec3(),
        }
    }

    /// Maps a point of the scene.
    pub(crate) fn point(&self, point: DVec3) -> DVec3 {
        self.scale * (point - self.centre)
    }
}

impl Geometry {
    pub(crate) fn new(scene: Arc<Scene>) -> Self {
        let space = RenderSpace::new(&scene);
        let mut triangles = Vec::with_capacity(scene.triangle_count());
        let mut sources = Vec::with_capacity(scene.triangle_count());
        let mut instances = Vec::with_capacity(scene.instances.len());
        for (index, instance) in scene.instances.iter().enumerate() {
            let m = instance.scene_from_mesh.matrix3;
            let linear = DMat3::from_cols(m.x_axis.as_dvec3(), m.y_axis.as_dvec3(), m.z_axis.as_dvec3());
            let mirrored = linear.determinant() < 0.0;
            let render_from_mesh = DAffine3::from_mat3_translation(
                space.scale * linear,
                space.point(instance.scene_from_mesh.translation.as_dvec3()),
            );
            let mesh = &scene.meshes[instance.mesh];
            for (triangle, corners) in mesh.triangles.iter().enumerate() {
                let [a, b, c] =
                    corners.map(|i| render_from_mesh.transform_point3(mesh.positions[i as usize].as_dvec3()).as_vec3());
                triangles.push(if mirrored { [a, c, b] } else { [a, b, c] });
                sources.push((index as u32, triangle as u32));
            }
            let tangent_matrix = space.scale * linear;
            instances.push(PlacedInstance {
                normal_matrix: tangent_matrix.inverse().transpose().as_mat3(),
                tangent_matrix: tangent_matrix.as_mat3(),
                mirrored,
            });
        }
        Self { scene, space, triangles, sources, instances }
    }

    /// Index of the material of a triangle.
    pub(crate) fn material_index(&self, triangle: u32) -> usize {
        let (instance, _) = self.sources[triangle as usize];
        self.scene.meshes[self.scene.instances[instance as usize].mesh].material
    }

    /// Material of a triangle.
    pub(crate) fn material(&self, triangle: u32) -> &Material {
        &self.scene.materials[self.material_index(triangle)]
    }

    /// The point of a triangle with these vertex weights (in render-space winding).
    pub(crate) fn point(&self, triangle: u32, barycentric: [f32; 3]) -> SurfacePoint<'_> {
        let (instance_index, in_mesh) = self.sources[triangle as usize];
        let instance = &self.instances[instance_index as usize];
        let mesh = &self.scene.meshes[self.scene.instances[instance_index as usize].mesh];
        let mut indices = mesh.triangles[in_mesh as usize].map(|i| i as usize);
        if instance.mirrored {
            indices.swap(1, 2);
        }
        let [a, b, c] = self.triangles[triangle as usize];
        let [wa, wb, wc] = barycentric;
        let (ab, ac) = (b - a, c - a);
        let cross = ab.cross(ac);
        let doubled_area = cross.length();
        let largest = a.abs().max(b.abs()).max(c.abs()).max_element();
        SurfacePoint {
            mesh,
            indices,
            weights: barycentric,
            position: wa * a + wb * b + wc * c,
            geometric_normal: if doubled_area > 0.0 { cross / doubled_area } else { Vec3::Z },
            doubled_area,
            offset: OFFSET_SHARE * largest,
            instance,
        }
    }

    /// The point of a hit.
    pub(crate) fn hit_point(&self, hit: &Hit) -> SurfacePoint<'_> {
        self.point(hit.triangle, hit.barycentric)
    }
}

impl SurfacePoint<'_> {
    /// Texture coordinates of a set; (0, 0) where the mesh has none.
    pub(crate) fn uv(&self, set: usize) -> Vec2 {
        let uvs = &self.mesh.uvs[set];
        if uvs.is_empty() { Vec2::ZERO } else { (0..3).map(|k| self.weights[k] * uvs[self.indices[k]]).sum() }
    }

    /// Texture coordinates per render-space length: √(area in texture space / area).
    pub(crate) fn uv_per_length(&self, set: usize, determinant: f32) -> f32 {
        let uvs = &self.mesh.uvs[set];
        if uvs.is_empty() {
            return 0.0;
        }
        let [a, b, c] = self.indices.map(|i| uvs[i]);
        ((b - a).perp_dot(c - a) * determinant / self.doubled_area.max(f32::MIN_POSITIVE)).abs().sqrt()
    }

    /// Vertex colour; white where the mesh has none.
    pub(crate) fn color(&self) -> Vec4 {
        let colors = &self.mesh.colors;
        if colors.is_empty() { Vec4::ONE } else { (0..3).map(|k| self.weights[k] * colors[self.indices[k]]).sum() }
    }

    /// Interpolated normal on the front side; the geometric normal where interpolation fails or contradicts the winding.
    pub(crate) fn shading_normal(&self) -> Vec3 {
        let normals = &self.mesh.normals;
        let sum: Vec3 = (0..3).map(|k| self.weights[k] * normals[self.indices[k]]).sum();
        let normal = (self.instance.normal_matrix * sum).normalize_or(self.geometric_normal);
        if normal.dot(self.geometric_normal) > 0.0 { normal } else { self.geometric_normal }
    }

    /// `normal` turned by a tangent-space normal (glTF: x along u, y up in the picture). `None` without tangents.
    pub(crate) fn mapped_normal(&self, normal: Vec3, mapped: Vec3) -> Option<Vec3> {
        let tangents = &self.mesh.tangents;
        if tangents.is_empty() {
            return None;
        }
        let sum: Vec4 = (0..3).map(|k| self.weights[k] * tangents[self.indices[k]]).sum();
        let tangent = self.instance.tangent_matrix * sum.truncate();
        let tangent = (tangent - normal * normal.dot(tangent)).try_normalize()?;
        let handedness = if (sum.w < 0.0) != self.instance.mirrored { -1.0 } else { 1.0 };
        let bitangent = handedness * normal.cross(tangent);
        (mapped.x * tangent + mapped.y * bitangent + mapped.z * normal).try_normalize()
    }
}

/// Turns a shading normal just so far that the mirror direction of `to_viewer` stays above the surface (Keller et al. 2017, "The Iray
/// light transport simulation and rendering system", appendix): no black rims, and the viewer is always on its side. Both normals
/// are on the viewer's side of the surface.
pub(crate) fn bend_normal(shading: Vec3, geometric: Vec3, to_viewer: Vec3) -> Vec3 {
    let least = LEAST_REFLECTED_COSINE.min(0.9 * to_viewer.dot(geometric).max(0.0));
    let reflected = 2.0 * shading.dot(to_viewer) * shading - to_viewer;
    let cosine = reflected.dot(geometric);
    if cosine >= least && shading.dot(to_viewer) > 0.0 {
        return shading;
    }
    let raised = (reflected + (least - cosine).max(0.0) * geometric).normalize_or(geometric);
    (to_viewer + raised).normalize_or(geometric)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::seed::Stream;

    #[test]
    fn bent_normals_reflect_above_the_surface() {
        let mut stream = Stream::new(2);
        let mut random = || Vec3::new(stream.next_f32(), stream.next_f32(), stream.next_f32()) * 2.0 - 1.0;
        let mut bent = 0;
        for _ in 0..10_000 {
            let (geometric, mut shading, mut viewer) =
                (random().normalize_or(Vec3::Z), random().normalize_or(Vec3::Z), random().normalize_or(Vec3::Z));
            if viewer.dot(geometric) < 0.0 {
                viewer = -viewer;
            }
            if shading.dot(geometric) < 0.0 {
                shading = -shading;
            }
            let result = bend_normal(shading, geometric, viewer);
            let reflected = 2.0 * result.dot(viewer) * result - viewer;
            assert!(result.dot(viewer) > 0.0 && reflected.dot(geometric) > 0.0, "{geometric} {shading} {viewer}");
            bent += usize::from(result != shading);
        }
        assert!(bent > 1000 && bent < 9000, "{bent}");
        assert_eq!(
            bend_normal(Vec3::Z, Vec3::Z, Vec3::new(1.0, 0.0, 1e-4).normalize()),
            Vec3::Z,
            "grazing on a flat surface"
        );
    }
}
