//! The tree alone, for measurements: rays against triangles, without a scene.

use glam::Vec3;

use crate::bvh::{BEAM, Bvh, Input, Ray, Stack};

/// The most rays of a beam.
pub const BEAM_RAYS: usize = BEAM;

/// A tree over triangles.
pub struct Tree(Bvh);

/// Memory that a thread's rays use one after the other.
pub struct Scratch(Stack);

impl Tree {
    /// Builds the tree that a scene of these triangles would have; fewer than 2²⁹.
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
        let flags = vec![0; triangles.len()];
        Self(Bvh::new(&Input { triangles, flags: &flags, loose: 0..triangles.len(), shared: &[], placements: &[] }))
    }

    /// Memory for the rays of one thread.
    pub fn scratch(&self) -> Scratch {
        Scratch(self.0.stack())
    }

    /// Returns the distance, in lengths of `direction`, and the index of the nearest triangle on
    /// the ray.
    #[inline]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, t_max: f32, scratch: &mut Scratch) -> Option<(f32, u32)> {
        let hit = self.0.nearest(&Ray { origin, direction, t_max }, &mut scratch.0, |_| true)?;
        Some((hit.t, hit.triangle))
    }

    /// Counts the rays that hit a triangle, among up to [`BEAM_RAYS`] origins and directions
    /// without an end. Rays that lie close together share work.
    #[inline]
    pub fn hits_of_beam(&self, rays: impl ExactSizeIterator<Item = (Vec3, Vec3)>, scratch: &mut Scratch) -> usize {
        let count = rays.len();
        assert!(count <= BEAM, "{count} rays in a beam of {BEAM}");
        let mut beam = [Ray::ANY; BEAM];
        for (ray, (origin, direction)) in beam.iter_mut().zip(rays) {
            (ray.origin, ray.direction) = (origin, direction);
        }
        let mut hits = [None; BEAM];
        self.0.nearest_of_beam(&beam[..count], &mut hits, &mut scratch.0, |_, _| true);
        hits.iter().flatten().count()
    }

    /// True if no triangle lies on the segment.
    #[inline]
    pub fn is_open(&self, origin: Vec3, direction: Vec3, t_max: f32, scratch: &mut Scratch) -> bool {
        self.0.transmittance(&Ray { origin, direction, t_max }, &mut scratch.0, |_| Vec3::ZERO) == Vec3::ONE
    }

    /// Bytes of the tree.
    pub fn bytes(&self) -> usize {
        self.0.bytes()
    }
}
