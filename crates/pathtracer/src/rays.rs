//! Intersects rays with a tree of triangles, without a scene, for measurements.

use glam::Vec3;

use crate::bvh::{BEAM, Bvh, Input, Ray, Stack};

/// Largest number of rays of a beam, see [`Tree::hits_of_beam`].
pub const BEAM_RAYS: usize = BEAM;

/// A tree over triangles.
pub struct Tree(Bvh);

/// Working memory of traversals. The rays of one thread use it one after another.
pub struct Scratch(Stack);

impl Tree {
    /// Builds the tree that a scene of these triangles would have. There must be fewer than 2²⁹
    /// triangles.
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
        let flags = vec![0; triangles.len()];
        Self(Bvh::new(&Input { triangles, flags: &flags, loose: 0..triangles.len(), shared: &[], placements: &[] }))
    }

    /// Allocates the memory for the rays of one thread.
    pub fn scratch(&self) -> Scratch {
        Scratch(self.0.stack())
    }

    /// Returns the distance to the nearest triangle on the ray, in lengths of `direction`, and the
    /// index of that triangle. `None` if no triangle is nearer than `t_max`.
    #[inline]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, t_max: f32, scratch: &mut Scratch) -> Option<(f32, u32)> {
        let hit = self.0.nearest(&Ray { origin, direction, t_max }, &mut scratch.0, |_| true)?;
        Some((hit.t, hit.triangle))
    }

    /// Counts the rays that hit a triangle, among up to [`BEAM_RAYS`] rays of unlimited length
    /// (origin, direction). Rays that are close together share work.
    #[inline]
    pub fn hits_of_beam(&self, rays: impl ExactSizeIterator<Item = (Vec3, Vec3)>, scratch: &mut Scratch) -> usize {
        let count = rays.len();
        assert!(count <= BEAM, "expected at most {BEAM} rays in a beam, found {count}");
        let mut beam = [Ray::ANY; BEAM];
        for (ray, (origin, direction)) in beam.iter_mut().zip(rays) {
            (ray.origin, ray.direction) = (origin, direction);
        }
        let mut hits = [None; BEAM];
        self.0.nearest_of_beam(&beam[..count], &mut hits, &mut scratch.0, |_, _| true);
        hits.iter().flatten().count()
    }

    /// Returns true if the segment from `origin` to `origin + t_max · direction` hits no triangle.
    #[inline]
    pub fn is_open(&self, origin: Vec3, direction: Vec3, t_max: f32, scratch: &mut Scratch) -> bool {
        self.0.transmittance(&Ray { origin, direction, t_max }, &mut scratch.0, |_| Vec3::ZERO) == Vec3::ONE
    }

    /// Returns the size of the tree in bytes.
    pub fn bytes(&self) -> usize {
        self.0.bytes()
    }
}
