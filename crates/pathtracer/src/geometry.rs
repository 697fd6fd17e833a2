//! The scene's triangles, and what a ray finds where it meets one.
//!
//! Triangles of meshes that are placed once are kept in render space, as if the scene were one mesh. A mesh that is placed often is
//! kept once, in a space of its own around its centre, with a transform per instance, so that memory follows what is unique.
//!
//! Render space is the scene moved to the centre of its bounds and scaled by a power of two to a half diagonal of 1 to 2, so that
//! 32-bit rounding is the same for a scene of a micrometre and of a kilometre, wherever it stands.

use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Mat3, Vec2, Vec3, Vec4};
use lumistack_scene::{Bounds, Instance, Material, Mesh, Scene};

use crate::bvh::{Hit, NO_INSTANCE, Placement, in_large_pages};

/// Rays leave a surface at this share of the largest coordinate of its triangle: about 16 times the rounding error of a point
/// interpolated from three vertices.
const OFFSET_SHARE: f32 = 4e-6;
/// Scenes of up to this many triangles with instances counted share nothing (see [`Sharing::Auto`]): some 150 MB.
const FLATTENED: usize = 1 << 20;
/// Smaller meshes are not worth a tree of their own.
const LEAST_SHARED: usize = 16;
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

/// When meshes that are placed more than once share their triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sharing {
    /// In scenes of more than [`FLATTENED`] triangles with instances counted: rays are faster through one tree.
    Auto,
    /// Whenever it can be.
    #[cfg(test)]
    Always,
}

/// All triangles, each once.
pub(crate) struct Geometry {
    scene: Arc<Scene>,
    pub(crate) space: RenderSpace,
    /// Corners: first of the `loose` triangles, in render space, wound counter-clockwise seen from the front; then those of shared
    /// meshes in the spaces of their trees, wound as the mesh is.
    pub(crate) triangles: Vec<[Vec3; 3]>,
    pub(crate) loose: Range<usize>,
    /// Triangles of each shared mesh.
    pub(crate) shared: Vec<Range<usize>>,
    pub(crate) placements: Vec<Placement>,
    /// Instance and triangle of its mesh; for shared triangles any instance.
    sources: Vec<(u32, u32)>,
    instances: Vec<PlacedInstance>,
}

struct PlacedInstance {
    /// Inverse transpose of the linear part, for normals.
    normal_matrix: Mat3,
    tangent_matrix: Mat3,
    mirrored: bool,
    /// Index of the placement of a shared mesh, or [`NO_INSTANCE`].
    placement: u32,
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
        Self::around(scene.bounds())
    }

    fn around(bounds: Bounds) -> Self {
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
    pub(crate) fn new(scene: Arc<Scene>, sharing: Sharing) -> Self {
        let space = RenderSpace::new(&scene);
        let shares = shared_meshes(&scene, sharing);
        let mut geometry = Self {
            space,
            triangles: Vec::with_capacity(unique_triangles(&scene, sharing)),
            loose: 0..0,
            shared: Vec::new(),
            placements: Vec::new(),
            sources: Vec::with_capacity(unique_triangles(&scene, sharing)),
            instances: Vec::with_capacity(scene.instances.len()),
            scene: scene.clone(),
        };
        for (index, instance) in scene.instances.iter().enumerate() {
            let linear = linear(instance);
            let mirrored = linear.determinant() < 0.0;
            let tangent_matrix = space.scale * linear;
            let mesh = &scene.meshes[instance.mesh];
            if !shares[instance.mesh] {
                let origin = space.point(instance.scene_from_mesh.translation.as_dvec3());
                let render_from_mesh = DAffine3::from_mat3_translation(tangent_matrix, origin);
                geometry.add(mesh, index, mirrored, |p| render_from_mesh.transform_point3(p));
            }
            geometry.instances.push(PlacedInstance {
                normal_matrix: tangent_matrix.inverse().transpose().as_mat3(),
                tangent_matrix: tangent_matrix.as_mat3(),
                mirrored,
                placement: NO_INSTANCE,
            });
        }
        geometry.loose = 0..geometry.triangles.len();
        // per mesh: its tree and the map from the tree's space to the mesh
        let mut trees: Vec<Option<(usize, f64, DVec3)>> = vec![None; scene.meshes.len()];
        for (index, instance) in scene.instances.iter().enumerate() {
            if !shares[instance.mesh] {
                continue;
            }
            let (shared, scale, centre) = *trees[instance.mesh].get_or_insert_with(|| {
                let mesh = &scene.meshes[instance.mesh];
                let mut bounds = Bounds::EMPTY;
                mesh.triangles.iter().flatten().for_each(|&i| bounds.include(mesh.positions[i as usize]));
                let own = RenderSpace::around(bounds);
                let first = geometry.triangles.len();
                geometry.add(mesh, index, false, |p| own.point(p));
                geometry.shared.push(first..geometry.triangles.len());
                (geometry.shared.len() - 1, own.scale, own.centre)
            });
            let linear = linear(instance);
            let render_from_tree = (space.scale / scale) * linear;
            let origin = instance.scene_from_mesh.translation.as_dvec3() + linear * centre;
            geometry.instances[index].placement = geometry.placements.len() as u32;
            geometry.placements.push(Placement {
                shared,
                id: index as u32,
                render_from_tree: render_from_tree.as_mat3(),
                tree_from_render: render_from_tree.inverse().as_mat3(),
                translation: space.point(origin).as_vec3(),
            });
        }
        geometry.triangles = in_large_pages(geometry.triangles);
        geometry.sources = in_large_pages(geometry.sources);
        geometry
    }

    fn add(&mut self, mesh: &Mesh, instance: usize, mirrored: bool, place: impl Fn(DVec3) -> DVec3) {
        for (triangle, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|i| place(mesh.positions[i as usize].as_dvec3()).as_vec3());
            self.triangles.push(if mirrored { [a, c, b] } else { [a, b, c] });
            self.sources.push((instance as u32, triangle as u32));
        }
    }

    /// Bytes of what is kept per triangle and instance.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.triangles.as_slice())
            + size_of_val(self.sources.as_slice())
            + size_of_val(self.instances.as_slice())
            + size_of_val(self.placements.as_slice())
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

    /// The point of a triangle of no shared mesh with these vertex weights (in render-space winding).
    pub(crate) fn point(&self, triangle: u32, barycentric: [f32; 3]) -> SurfacePoint<'_> {
        let (instance, in_mesh) = self.sources[triangle as usize];
        let corners = self.triangles[triangle as usize];
        let largest = largest_coordinate(corners);
        self.point_of(instance, in_mesh, corners, barycentric, largest)
    }

    /// The point of a hit.
    #[inline]
    pub(crate) fn hit_point(&self, hit: &Hit) -> SurfacePoint<'_> {
        if hit.instance == NO_INSTANCE {
            return self.point(hit.triangle, hit.barycentric);
        }
        let (_, in_mesh) = self.sources[hit.triangle as usize];
        let instance = &self.instances[hit.instance as usize];
        let placement = &self.placements[instance.placement as usize];
        // positions are rounded as sums of this and of the instance's place
        let turned = self.triangles[hit.triangle as usize].map(|corner| placement.render_from_tree * corner);
        let [a, b, c] = turned.map(|corner| corner + placement.translation);
        let [wa, wb, wc] = hit.barycentric;
        let (corners, weights) = if instance.mirrored { ([a, c, b], [wa, wc, wb]) } else { ([a, b, c], [wa, wb, wc]) };
        let largest = largest_coordinate(corners) + largest_coordinate(turned);
        self.point_of(hit.instance, in_mesh, corners, weights, largest)
    }

    #[inline]
    fn point_of(
        &self,
        instance_index: u32,
        in_mesh: u32,
        [a, b, c]: [Vec3; 3],
        weights: [f32; 3],
        largest: f32,
    ) -> SurfacePoint<'_> {
        let instance = &self.instances[instance_index as usize];
        let mesh = &self.scene.meshes[self.scene.instances[instance_index as usize].mesh];
        let mut indices = mesh.triangles[in_mesh as usize].map(|i| i as usize);
        if instance.mirrored {
            indices.swap(1, 2);
        }
        let [wa, wb, wc] = weights;
        let cross = (b - a).cross(c - a);
        let doubled_area = cross.length();
        SurfacePoint {
            mesh,
            indices,
            weights,
            position: wa * a + wb * b + wc * c,
            geometric_normal: if doubled_area > 0.0 { cross / doubled_area } else { Vec3::Z },
            doubled_area,
            offset: OFFSET_SHARE * largest,
            instance,
        }
    }
}

fn largest_coordinate([a, b, c]: [Vec3; 3]) -> f32 {
    a.abs().max(b.abs()).max(c.abs()).max_element()
}

fn linear(instance: &Instance) -> DMat3 {
    let m = instance.scene_from_mesh.matrix3;
    DMat3::from_cols(m.x_axis.as_dvec3(), m.y_axis.as_dvec3(), m.z_axis.as_dvec3())
}

/// Which meshes are kept once however often they are placed. Emitting ones are not: each triangle that emits is a light of its own.
fn shared_meshes(scene: &Scene, sharing: Sharing) -> Vec<bool> {
    if sharing == Sharing::Auto && scene.triangle_count() <= FLATTENED {
        return vec![false; scene.meshes.len()];
    }
    let mut uses = vec![0usize; scene.meshes.len()];
    scene.instances.iter().for_each(|instance| uses[instance.mesh] += 1);
    let is_shared = |(mesh, &uses): (&Mesh, &usize)| {
        uses > 1 && mesh.triangles.len() >= LEAST_SHARED && !scene.materials[mesh.material].is_emissive()
    };
    scene.meshes.iter().zip(&uses).map(is_shared).collect()
}

/// Number of triangles that [`Geometry`] keeps.
pub(crate) fn unique_triangles(scene: &Scene, sharing: Sharing) -> usize {
    let shared = shared_meshes(scene, sharing);
    let mut seen = vec![false; shared.len()];
    let count = |instance: &Instance| {
        let counted = std::mem::replace(&mut seen[instance.mesh], true) && shared[instance.mesh];
        if counted { 0 } else { scene.meshes[instance.mesh].triangles.len() }
    };
    scene.instances.iter().map(count).sum()
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
