//! Bounding volume hierarchy: an eight-wide tree with eight triangles per leaf block, and instances
//! that share a tree.
//!
//! obvhs builds a binary tree by parallel locally-ordered clustering and improves it by reinsertion
//! (both Meister, Bittner 2018). That tree is collapsed to eight children per node, with blocks of
//! at most eight triangles as leaves. Nodes and blocks are structures of arrays, so the slab test
//! and the triangle test each work on a whole vector. The surface area heuristic chooses the
//! subtrees that become nodes and blocks.
//!
//! ```text
//! top tree, render space ─▶ nodes ─▶ blocks                          loose triangles
//!                              └───▶ instances ─▶ nodes ─▶ blocks    a shared mesh: a tree in the
//!                                                                    mesh's own space
//! ```
//!
//! Nodes and blocks of all trees are in the same two arrays. [`build`] makes them, [`traverse`]
//! walks them for a ray and [`beam`] for rays that lie close together.

mod beam;
mod build;
mod plan;
mod traverse;
mod tree;

#[cfg(test)]
mod tests;

pub(crate) use beam::BEAM;
pub(crate) use traverse::Stack;
pub(crate) use tree::{
    ALPHA, Bvh, CULL_BACK, Hit, Input, MAX_INSTANCES, MAX_TRIANGLES, NO_INSTANCE, Placement, Ray, TINT,
};
