//! Bounding volume hierarchy: an eight-wide tree with eight triangles per leaf block, and instances
//! that share a tree.
//!
//! obvhs builds a binary tree by parallel locally-ordered clustering (Meister, Bittner 2018) and
//! improves it by reinsertion (Meister, Bittner 2018). That tree is collapsed to eight children,
//! and subtrees of at most eight triangles to blocks in structure-of-arrays form, so that both the
//! slab test and the triangle test work on a whole vector; which subtrees is chosen by the surface
//! area heuristic.
//!
//! ```text
//! top tree, render space ─▶ nodes ─▶ blocks            triangles of meshes that are placed once
//!                              └───▶ instances ─▶ nodes ─▶ blocks     one tree per mesh that is placed often, in a space of its own
//! ```
//!
//! Nodes and blocks of all trees lie in the same two arrays. [`build`] makes them, [`traverse`]
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
