//! The data of the tree, and of rays and hits.

use std::ops::Range;

use glam::{Mat3, Vec3};
use lumistack_simd::Backend;

/// Number of values of a vector: the children of a node, or the triangles of a block.
pub(super) const WIDTH: usize = 8;
/// Marks a child reference as a leaf block.
pub(super) const LEAF: u32 = 1 << 31;
/// Marks a child reference, together with [`LEAF`], as an instance.
pub(super) const INSTANCE: u32 = 1 << 30;
/// Marks a child that does not exist. Its bounds are empty, so that no ray enters it. On a
/// traversal's stack this value marks the end of an instance.
pub(super) const EMPTY: u32 = u32::MAX;
/// Bits of a triangle reference that hold the triangle's index; all other bits are flags.
pub(super) const INDEX_MASK: u32 = (1 << 29) - 1;
/// Largest number of triangles that references can address. The triangles of a shared mesh are
/// included once, for any number of instances.
pub(crate) const MAX_TRIANGLES: usize = INDEX_MASK as usize;
/// The largest number of instances of shared trees.
pub(crate) const MAX_INSTANCES: usize = INSTANCE as usize - 1;
/// Marks a triangle that is invisible from behind.
pub(crate) const CULL_BACK: u32 = 1 << 29;
/// Marks a triangle whose alpha must be evaluated.
pub(crate) const ALPHA: u32 = 1 << 30;
/// Marks a triangle through which light passes tinted, without a change of direction.
pub(crate) const TINT: u32 = 1 << 31;
/// [`Hit::instance`] of a triangle that belongs to no shared tree.
pub(crate) const NO_INSTANCE: u32 = u32::MAX;

/// A ray or segment origin + t·direction, 0 < t < `t_max`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) origin: Vec3,
    pub(crate) direction: Vec3,
    pub(crate) t_max: f32,
}

impl Ray {
    /// A ray from the origin along z, as a placeholder.
    pub(crate) const ANY: Self = Self { origin: Vec3::ZERO, direction: Vec3::Z, t_max: f32::INFINITY };
}

/// A ray's intersection with a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    pub(crate) t: f32,
    pub(crate) triangle: u32,
    /// [`Placement::id`] of the instance, or [`NO_INSTANCE`].
    pub(crate) instance: u32,
    /// Weights of the three vertices; their sum is 1.
    pub(crate) barycentric: [f32; 3],
    /// True if the triangle shows its front: it winds counter-clockwise as seen from the ray's
    /// origin.
    pub(crate) front: bool,
    /// Flags of the triangle.
    pub(crate) flags: u32,
}

/// Input of [`Bvh::new`](super::Bvh::new).
pub(crate) struct Input<'a> {
    /// Corners of all triangles. The triangles in `loose` are in render space. The triangles of
    /// each range in `shared` are in the space of that mesh's tree.
    pub(crate) triangles: &'a [[Vec3; 3]],
    /// [`CULL_BACK`], [`ALPHA`] and [`TINT`] of every triangle.
    pub(crate) flags: &'a [u32],
    pub(crate) loose: Range<usize>,
    pub(crate) shared: &'a [Range<usize>],
    pub(crate) placements: &'a [Placement],
}

/// An instance of a shared tree.
pub(crate) struct Placement {
    /// Index into [`Input::shared`].
    pub(crate) shared: usize,
    /// Value of [`Hit::instance`] for hits of this instance.
    pub(crate) id: u32,
    pub(crate) render_from_tree: Mat3,
    pub(crate) tree_from_render: Mat3,
    /// Origin of the tree's space in render space.
    pub(crate) translation: Vec3,
}

/// Eight-wide tree over triangles.
pub(crate) struct Bvh {
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Vec<Block>,
    pub(super) instances: Vec<Placed>,
    pub(super) root: u32,
    /// Largest coordinate of the top tree's bounds.
    pub(super) extent: f32,
    /// Upper bound of the number of postponed children during traversal.
    pub(super) stack_depth: usize,
    pub(super) backend: Backend,
}

/// A node: the bounds of eight children, `[min_x, min_y, min_z, max_x, max_y, max_z]`, and the
/// children. Each row has one lane per child. The alignment keeps a node within four cache lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Node {
    pub(super) bounds: [[f32; WIDTH]; 6],
    pub(super) children: [u32; WIDTH],
}

/// Eight triangles, one per lane: `vertices[vertex][axis]`. Unused lanes are points, which no ray
/// hits. A block takes five cache lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Block {
    pub(super) vertices: [[[f32; WIDTH]; 3]; 3],
    pub(super) references: [u32; WIDTH],
}

/// A [`Placement`] with the root of its tree.
pub(super) struct Placed {
    pub(super) tree_from_render: Mat3,
    pub(super) translation: Vec3,
    pub(super) root: u32,
    pub(super) id: u32,
    /// Largest coordinate of the tree's bounds.
    pub(super) extent: f32,
}

impl Bvh {
    /// Returns the bytes of nodes, blocks and instances.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice())
            + size_of_val(self.blocks.as_slice())
            + size_of_val(self.instances.as_slice())
    }
}
