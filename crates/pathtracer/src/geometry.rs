//! The scene's triangles, and the surface data at a hit.
//!
//! Most triangles are *loose*: each instance has its own copy in render space, as if the scene were
//! one mesh. In large scenes most meshes with several instances are *shared*. The triangles of a
//! shared mesh are kept once, in a space around the mesh's centre, with a transform per instance.
//! So the memory of a large scene depends mostly on its unique geometry.
//!
//! Render space is the scene, moved so that the centre of its bounds is the origin, and scaled by a
//! power of two. In render space the half diagonal of the bounds is 1 to 2. So 32-bit rounding is
//! relatively the same for scenes of any size and position.

use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Mat3, Vec2, Vec3, Vec4};
use lumistack_core::pages::in_large_pages;
use lumistack_scene::{Bounds, Instance, Material, Mesh, Scene};
use lumistack_simd::prefetch;

use crate::bvh::{Hit, NO_INSTANCE, Placement};

/// Rays start at this distance from a triangle, as a fraction of the triangle's largest coordinate.
/// The distance is about 16 times the rounding error of a point interpolated from three vertices.
const OFFSET_SHARE: f32 = 4e-6;
/// Scenes of up to this number of triangles, with all instances included, share no meshes (see
/// [`Sharing::Auto`]). The records of their triangles take at most 134 MB.
const FLATTENED: usize = 1 << 20;
/// Meshes of fewer triangles than this get no separate tree.
const LEAST_SHARED: usize = 16;
/// Smallest cosine between the reflected direction and the geometric normal; see [`bend_normal`].
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

/// Rule by which the instances of a mesh share its triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sharing {
    /// Instances share triangles in scenes of more than [`FLATTENED`] triangles, with all instances
    /// included. In smaller scenes one tree makes rays faster.
    Auto,
    /// Instances share triangles wherever possible.
    #[cfg(test)]
    Always,
}

/// The triangles of the scene, prepared for hits.
pub(crate) struct Geometry {
    scene: Arc<Scene>,
    pub(crate) space: RenderSpace,
    /// First the `loose` triangles, in render space, wound counter-clockwise as seen from the
    /// front. Then the triangles of shared meshes, each in the space of its tree, with the winding
    /// of the mesh.
    records: Vec<Record>,
    pub(crate) loose: Range<usize>,
    /// Triangles of each shared mesh.
    pub(crate) shared: Vec<Range<usize>>,
    pub(crate) placements: Vec<Placement>,
    instances: Vec<PlacedInstance>,
}

/// Data of a triangle for its hits, in two cache lines. Collecting it from the mesh's arrays would
/// read a dozen lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Record {
    corners: [Vec3; 3],
    /// Normals of the corners, in render space for loose triangles and in the mesh's space for
    /// shared triangles. They are interpolated, then normalized.
    normals: [Vec3; 3],
    /// Texture coordinates of set 0; zeros where the mesh has none.
    uvs: [Vec2; 3],
    geometric_normal: Vec3,
    /// Length in texture space (set 0) per length in the space of the corners: the root of the
    /// ratio of the areas.
    uv_per_length: f32,
    material: u32,
    /// Index of the instance; for shared triangles the first instance of their mesh.
    instance: u32,
    triangle_in_mesh: u32,
    /// Any of [`SWAPPED`], [`COLORED`] and [`FLAT`].
    flags: u32,
}

/// Marks a triangle of which two corners are exchanged, since the instance mirrors the mesh.
const SWAPPED: u32 = 1;
/// Marks a triangle of a mesh with vertex colours.
const COLORED: u32 = 2;
/// Marks a triangle whose vertex normals all equal the geometric normal.
const FLAT: u32 = 4;
/// Two normals are treated as equal if the cosine between them is larger than this.
const SAME_NORMAL: f32 = 1.0 - 1e-6;

struct PlacedInstance {
    /// Inverse transpose of `tangent_matrix`, for normals of shared meshes.
    normal_matrix: Mat3,
    tangent_matrix: Mat3,
    mirrored: bool,
    /// Index of the placement of a shared mesh, or [`NO_INSTANCE`].
    placement: u32,
}

/// A point of a surface.
pub(crate) struct SurfacePoint<'a> {
    geometry: &'a Geometry,
    record: &'a Record,
    /// The instance, for a shared triangle.
    placed: Option<&'a PlacedInstance>,
    weights: [f32; 3],
    pub(crate) position: Vec3,
    /// Geometric normal on the front side.
    pub(crate) geometric_normal: Vec3,
    /// Length in the space of the triangle's corners, divided by the same length in render space.
    shrinking: f32,
    /// Distance from the surface at which a ray must start.
    pub(crate) offset: f32,
}

impl RenderSpace {
    fn new(scene: &Scene) -> Self {
        Self::around(scene.bounds())
    }

    fn around(bounds: Bounds) -> Self {
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let half_size = 0.5 * (max - min);
        // the scene is larger than a point, since the validator keeps only triangles with area
        let scale = (-half_size.length().max(f64::MIN_POSITIVE).log2().floor()).exp2();
        Self {
            centre: 0.5 * (min + max),
            scale,
            radius: (scale * half_size.length()) as f32,
            half_size: (scale * half_size).as_vec3(),
        }
    }

    /// Maps a point of the scene to render space.
    pub(crate) fn point(&self, point: DVec3) -> DVec3 {
        self.scale * (point - self.centre)
    }
}

impl Geometry {
    pub(crate) fn new(scene: Arc<Scene>, sharing: Sharing) -> Self {
        let space = RenderSpace::new(&scene);
        let shares = shared_meshes(&scene, sharing);
        // Loose triangles are converted to render space, and every instance keeps its transform.
        let mut geometry = Self {
            space,
            records: Vec::with_capacity(unique_triangles(&scene, sharing)),
            loose: 0..0,
            shared: Vec::new(),
            placements: Vec::new(),
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
                let normal_matrix = tangent_matrix.inverse().transpose().as_mat3();
                geometry.add(mesh, index, mirrored, normal_matrix, |p| render_from_mesh.transform_point3(p));
            }
            geometry.instances.push(PlacedInstance {
                normal_matrix: tangent_matrix.inverse().transpose().as_mat3(),
                tangent_matrix: tangent_matrix.as_mat3(),
                mirrored,
                placement: NO_INSTANCE,
            });
        }
        geometry.loose = 0..geometry.records.len();
        // for each mesh: the index of its tree, and the scale and the centre of the tree's space
        let mut trees: Vec<Option<(usize, f64, DVec3)>> = vec![None; scene.meshes.len()];
        for (index, instance) in scene.instances.iter().enumerate() {
            if !shares[instance.mesh] {
                continue;
            }
            // the first instance of a shared mesh stores the mesh's triangles, moved so that the
            // mesh's centre is the origin
            let (shared, scale, centre) = *trees[instance.mesh].get_or_insert_with(|| {
                let mesh = &scene.meshes[instance.mesh];
                let mut bounds = Bounds::EMPTY;
                mesh.triangles.iter().flatten().for_each(|&i| bounds.include(mesh.positions[i as usize]));
                let own = RenderSpace::around(bounds);
                let first = geometry.records.len();
                geometry.add(mesh, index, false, Mat3::IDENTITY, |p| own.point(p));
                geometry.shared.push(first..geometry.records.len());
                (geometry.shared.len() - 1, own.scale, own.centre)
            });
            let linear = linear(instance);
            // place the instance: from the tree's space to render space
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
        geometry.records = in_large_pages(geometry.records);
        geometry
    }

    fn add(
        &mut self,
        mesh: &Mesh,
        instance: usize,
        mirrored: bool,
        normal_matrix: Mat3,
        place: impl Fn(DVec3) -> DVec3,
    ) {
        let colored = if mesh.colors.is_empty() { 0 } else { COLORED };
        for (triangle, corners) in mesh.triangles.iter().enumerate() {
            let mut indices = corners.map(|i| i as usize);
            if mirrored {
                indices.swap(1, 2);
            }
            let corners = indices.map(|i| place(mesh.positions[i].as_dvec3()).as_vec3());
            let (geometric_normal, doubled_area) = normal_and_doubled_area(corners);
            let normals = indices.map(|i| normal_matrix * mesh.normals[i]);
            let is_flat = |normal: Vec3| normal.normalize_or_zero().dot(geometric_normal) > SAME_NORMAL;
            let flat = if normals.into_iter().all(is_flat) { FLAT } else { 0 };
            let uvs = indices.map(|i| mesh.uvs[0].get(i).copied().unwrap_or_default());
            self.records.push(Record {
                corners,
                normals,
                uvs,
                geometric_normal,
                uv_per_length: uv_per_length(uvs, doubled_area),
                material: mesh.material as u32,
                instance: instance as u32,
                triangle_in_mesh: triangle as u32,
                flags: colored | flat | if mirrored { SWAPPED } else { 0 },
            });
        }
    }

    /// Returns the bytes of the records, instances and placements.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.records.as_slice())
            + size_of_val(self.instances.as_slice())
            + size_of_val(self.placements.as_slice())
    }

    /// Returns the number of triangles that are kept in memory.
    pub(crate) fn triangle_count(&self) -> usize {
        self.records.len()
    }

    /// Returns the area of a triangle. The area of a shared triangle is measured in the space of
    /// its tree.
    pub(crate) fn area(&self, triangle: u32) -> f32 {
        0.5 * normal_and_doubled_area(self.corners(triangle)).1
    }

    /// Returns the corners of a triangle. For a shared triangle they are in the space of its tree.
    pub(crate) fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.records[triangle as usize].corners
    }

    /// Returns the index of the material of a triangle.
    #[inline]
    pub(crate) fn material_index(&self, triangle: u32) -> usize {
        self.records[triangle as usize].material as usize
    }

    /// Returns the material of a triangle.
    pub(crate) fn material(&self, triangle: u32) -> &Material {
        &self.scene.materials[self.material_index(triangle)]
    }

    /// Prefetches the record of a triangle ahead of its hit.
    #[inline]
    pub(crate) fn prefetch(&self, triangle: u32) {
        let record = self.records.as_ptr().wrapping_add(triangle as usize).cast::<u8>();
        prefetch(record);
        prefetch(record.wrapping_add(64));
    }

    /// Returns the point of a loose triangle at which its three corners have the weights
    /// `barycentric`. The corners are in the order of the triangle's record.
    #[inline]
    pub(crate) fn point(&self, triangle: u32, barycentric: [f32; 3]) -> SurfacePoint<'_> {
        let record = &self.records[triangle as usize];
        SurfacePoint {
            geometry: self,
            record,
            placed: None,
            weights: barycentric,
            position: weighted(barycentric, record.corners),
            geometric_normal: record.geometric_normal,
            shrinking: 1.0,
            offset: OFFSET_SHARE * largest_coordinate(record.corners),
        }
    }

    /// Returns the point of a hit.
    #[inline]
    pub(crate) fn hit_point(&self, hit: &Hit) -> SurfacePoint<'_> {
        if hit.instance == NO_INSTANCE {
            return self.point(hit.triangle, hit.barycentric);
        }
        self.placed_point(hit)
    }

    fn placed_point(&self, hit: &Hit) -> SurfacePoint<'_> {
        let record = &self.records[hit.triangle as usize];
        let instance = &self.instances[hit.instance as usize];
        let placement = &self.placements[instance.placement as usize];
        // The position is a sum of two terms: a mean of the turned corners, and the instance's
        // translation. The offset covers the rounding error of the turned corners and of the sum.
        let turned = record.corners.map(|corner| placement.render_from_tree * corner);
        let corners = turned.map(|corner| corner + placement.translation);
        let (normal, doubled_area) = normal_and_doubled_area(corners);
        SurfacePoint {
            geometry: self,
            record,
            placed: Some(instance),
            weights: hit.barycentric,
            position: weighted(hit.barycentric, corners),
            // a mirrored triangle has the opposite winding
            geometric_normal: if instance.mirrored { -normal } else { normal },
            shrinking: (normal_and_doubled_area(record.corners).1 / doubled_area.max(f32::MIN_POSITIVE)).sqrt(),
            offset: OFFSET_SHARE * (largest_coordinate(corners) + largest_coordinate(turned)),
        }
    }
}

/// Returns the unit normal of the side from which the corners wind counter-clockwise, and twice the
/// area.
fn normal_and_doubled_area([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    let cross = (b - a).cross(c - a);
    let doubled_area = cross.length();
    (if doubled_area > 0.0 { cross / doubled_area } else { Vec3::Z }, doubled_area)
}

/// Returns √(area in texture space / area in the space of the corners).
fn uv_per_length([a, b, c]: [Vec2; 3], doubled_area: f32) -> f32 {
    ((b - a).perp_dot(c - a) / doubled_area.max(f32::MIN_POSITIVE)).abs().sqrt()
}

#[inline]
fn weighted<T: std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>>(weights: [f32; 3], [a, b, c]: [T; 3]) -> T {
    a * weights[0] + b * weights[1] + c * weights[2]
}

#[inline]
fn largest_coordinate([a, b, c]: [Vec3; 3]) -> f32 {
    a.abs().max(b.abs()).max(c.abs()).max_element()
}

fn linear(instance: &Instance) -> DMat3 {
    let m = instance.scene_from_mesh.matrix3;
    DMat3::from_cols(m.x_axis.as_dvec3(), m.y_axis.as_dvec3(), m.z_axis.as_dvec3())
}

/// Returns true for each mesh that is kept once for any number of placements. Emitting meshes are
/// not shared, since every placed triangle that emits is a separate light.
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

/// Returns the number of triangles that [`Geometry`] keeps.
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
    fn mesh(&self) -> &Mesh {
        &self.geometry.scene.meshes[self.geometry.scene.instances[self.record.instance as usize].mesh]
    }

    /// Interpolates an array of the mesh at this point, from the values at the triangle's corners.
    fn interpolated<T>(&self, values: &[T]) -> T
    where
        T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
    {
        let mut indices = self.mesh().triangles[self.record.triangle_in_mesh as usize].map(|i| i as usize);
        if self.record.flags & SWAPPED != 0 {
            indices.swap(1, 2);
        }
        weighted(self.weights, indices.map(|i| values[i]))
    }

    /// Returns the texture coordinates of a set; (0, 0) where the mesh has none.
    #[inline]
    pub(crate) fn uv(&self, set: usize) -> Vec2 {
        if set == 0 {
            return weighted(self.weights, self.record.uvs);
        }
        let uvs = &self.mesh().uvs[set];
        if uvs.is_empty() { Vec2::ZERO } else { self.interpolated(uvs) }
    }

    /// Returns the ratio of a length in texture space to the same length in render space.
    #[inline]
    pub(crate) fn uv_per_length(&self, set: usize) -> f32 {
        if set == 0 {
            return self.record.uv_per_length * self.shrinking;
        }
        let mesh = self.mesh();
        let uvs = mesh.triangles[self.record.triangle_in_mesh as usize]
            .map(|i| mesh.uvs[set].get(i as usize).copied().unwrap_or_default());
        uv_per_length(uvs, normal_and_doubled_area(self.record.corners).1) * self.shrinking
    }

    /// Returns true if all vertex normals equal the geometric normal.
    #[inline]
    pub(crate) fn is_flat(&self) -> bool {
        self.record.flags & FLAT != 0
    }

    /// Returns true if the mesh has vertex colours.
    pub(crate) fn is_colored(&self) -> bool {
        self.record.flags & COLORED != 0
    }

    /// Returns the vertex colour; white where the mesh has none.
    #[inline]
    pub(crate) fn color(&self) -> Vec4 {
        if self.is_colored() { self.interpolated(&self.mesh().colors) } else { Vec4::ONE }
    }

    /// Returns the interpolated normal on the front side. If interpolation fails or contradicts the
    /// winding, it is the geometric normal.
    #[inline]
    pub(crate) fn shading_normal(&self) -> Vec3 {
        let sum = weighted(self.weights, self.record.normals);
        let turned = self.placed.map_or(sum, |instance| instance.normal_matrix * sum);
        let normal = turned.normalize_or(self.geometric_normal);
        if normal.dot(self.geometric_normal) > 0.0 { normal } else { self.geometric_normal }
    }

    /// Returns the point, moved along normals onto a smooth surface through the corners. The point
    /// moves only to the front if `side` is 1, and only to the back if `side` is −1. The surface
    /// may bulge as far as each corner's tangent plane (Hanika 2021, "Hacking the shadow
    /// terminator", Ray Tracing Gems II).
    pub(crate) fn smooth_position(&self, side: f32) -> Vec3 {
        let bulge = |k: usize| {
            let (corner, normal) = match self.placed {
                None => (self.record.corners[k], self.record.normals[k]),
                Some(instance) => {
                    let placement = &self.geometry.placements[instance.placement as usize];
                    let corner = placement.render_from_tree * self.record.corners[k] + placement.translation;
                    (corner, instance.normal_matrix * self.record.normals[k])
                }
            };
            let normal = side * normal.normalize_or_zero();
            self.weights[k] * (corner - self.position).dot(normal).max(0.0) * normal
        };
        self.position + bulge(0) + bulge(1) + bulge(2)
    }

    /// Returns `normal`, turned by a tangent-space normal (glTF: x along u, y up in the picture).
    /// `None` if the mesh has no tangents, or if the tangent or the result has no direction.
    pub(crate) fn mapped_normal(&self, normal: Vec3, mapped: Vec3) -> Option<Vec3> {
        let tangents = &self.mesh().tangents;
        if tangents.is_empty() {
            return None;
        }
        let sum: Vec4 = self.interpolated(tangents);
        let instance = self.placed.unwrap_or(&self.geometry.instances[self.record.instance as usize]);
        let tangent = instance.tangent_matrix * sum.truncate();
        let tangent = (tangent - normal * normal.dot(tangent)).try_normalize()?;
        let handedness = if (sum.w < 0.0) != instance.mirrored { -1.0 } else { 1.0 };
        let bitangent = handedness * normal.cross(tangent);
        (mapped.x * tangent + mapped.y * bitangent + mapped.z * normal).try_normalize()
    }
}

/// Bends a shading normal by the smallest angle at which the mirror direction of `to_viewer` is
/// above the surface. So there are no black rims, and the normal is always on the viewer's side.
/// `shading` and `geometric` must be on the viewer's side of the surface. Source: Keller et al.
/// 2017, "The Iray light transport simulation and rendering system", appendix.
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
