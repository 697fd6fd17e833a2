//! Bounding volume hierarchy over world triangles: a four-wide tree with four triangles per leaf block.
//!
//! obvhs builds a binary tree by parallel locally-ordered clustering (Meister, Bittner 2018) and improves it by reinsertion (Meister,
//! Bittner 2018). That tree is collapsed greedily by surface area to four children, and any subtree of at most four triangles
//! becomes one block in structure-of-arrays form, so that both the slab test and the triangle test work on a whole vector.
//! Traversal is in [`traverse`].

mod traverse;

use glam::{Vec3, Vec3A, Vec4};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

pub(crate) use traverse::{Hit, Ray, Stack};

/// Children per node and triangles per leaf block.
const WIDTH: usize = 4;
/// Marks a child reference as a leaf block.
const LEAF: u32 = 1 << 31;
/// A child that does not exist. Its bounds are empty, so that no ray enters it.
const EMPTY: u32 = u32::MAX;
/// Bits of a triangle reference that hold its index; the others are flags.
const INDEX_MASK: u32 = (1 << 29) - 1;
/// The largest number of triangles that a reference can hold.
pub(crate) const MAX_TRIANGLES: usize = INDEX_MASK as usize;
/// The triangle is invisible from behind.
pub(crate) const CULL_BACK: u32 = 1 << 29;
/// The triangle has an alpha that must be asked for.
pub(crate) const ALPHA: u32 = 1 << 30;
/// Light passes through the triangle on its straight way, tinted.
pub(crate) const TINT: u32 = 1 << 31;

/// obvhs' figures for a slow, good build: nodes tried per reinsertion round, depth of the narrow search.
const REINSERTION_RATIO: f32 = 0.2;
const SEARCH_DEPTH: usize = 2;

/// Four-wide tree over triangles.
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    root: u32,
    /// Upper bound of the number of postponed children during traversal.
    stack_depth: usize,
}

/// Bounds of four children: `[min_x, min_y, min_z, max_x, max_y, max_z]`, one lane per child.
#[repr(C, align(16))]
struct Node {
    bounds: [Vec4; 6],
    children: [u32; WIDTH],
}

/// Four triangles, one per lane: `vertices[vertex][axis]`. Unused lanes are points, which no ray hits.
#[repr(C, align(16))]
struct Block {
    vertices: [[Vec4; 3]; 3],
    references: [u32; WIDTH],
}

impl Bvh {
    /// Builds the tree. `flags` gives [`CULL_BACK`], [`ALPHA`] and [`TINT`] of every triangle.
    pub(crate) fn build(triangles: &[[Vec3; 3]], flags: &[u32]) -> Self {
        debug_assert_eq!(triangles.len(), flags.len());
        let bounds: Vec<Aabb> = triangles.iter().map(|t| Aabb::from_points(&t.map(Vec3A::from))).collect();
        let mut binary = PlocBuilder::with_capacity(bounds.len()).build(
            PlocSearchDistance::High,
            &bounds,
            (0..bounds.len() as u32).collect(),
            SortPrecision::U128,
            SEARCH_DEPTH,
        );
        ReinsertionOptimizer::default().run(&mut binary, REINSERTION_RATIO, None);
        let mut collapse = Collapse {
            binary: &binary,
            counts: subtree_sizes(&binary),
            triangles,
            flags,
            nodes: Vec::new(),
            blocks: Vec::new(),
        };
        let (root, stack_depth) = collapse.run();
        Self { nodes: collapse.nodes, blocks: collapse.blocks, root, stack_depth }
    }
}

/// Number of triangles below every node of a binary tree.
fn subtree_sizes(binary: &Bvh2) -> Vec<u32> {
    let mut sizes = vec![0; binary.nodes.len()];
    let mut order = Vec::with_capacity(binary.nodes.len());
    let mut open = if binary.nodes.is_empty() { Vec::new() } else { vec![0u32] };
    while let Some(index) = open.pop() {
        order.push(index);
        let node = &binary.nodes[index as usize];
        if !node.is_leaf() {
            open.extend([node.first_index, node.first_index + 1]);
        }
    }
    for &index in order.iter().rev() {
        let node = &binary.nodes[index as usize];
        sizes[index as usize] = if node.is_leaf() {
            node.prim_count
        } else {
            sizes[node.first_index as usize] + sizes[node.first_index as usize + 1]
        };
    }
    sizes
}

struct Collapse<'a> {
    binary: &'a Bvh2,
    counts: Vec<u32>,
    triangles: &'a [[Vec3; 3]],
    flags: &'a [u32],
    nodes: Vec<Node>,
    blocks: Vec<Block>,
}

impl Collapse<'_> {
    /// Returns the root and the depth of the traversal stack. An own list of open nodes instead of recursion: obvhs' trees over
    /// hostile input may be deep.
    fn run(&mut self) -> (u32, usize) {
        if self.binary.nodes.is_empty() {
            return (EMPTY, 1);
        }
        if self.is_block(0) {
            return (self.add_block(0), 1);
        }
        let mut stack_depth = 1;
        // (binary node, own node to fill, postponed siblings on the way to it)
        let mut open = vec![(0u32, self.add_node(), 0usize)];
        while let Some((binary_index, node, postponed)) = open.pop() {
            let children = self.four_children(binary_index);
            let postponed = postponed + children.len() - 1;
            stack_depth = stack_depth.max(postponed + 1);
            for (lane, &child) in children.iter().enumerate() {
                let reference = if self.is_block(child) {
                    self.add_block(child)
                } else {
                    let index = self.add_node();
                    open.push((child, index, postponed));
                    index
                };
                let aabb = self.binary.nodes[child as usize].aabb();
                let own = &mut self.nodes[node as usize];
                own.children[lane] = reference;
                for axis in 0..3 {
                    own.bounds[axis][lane] = aabb.min[axis];
                    own.bounds[axis + 3][lane] = aabb.max[axis];
                }
            }
        }
        (0, stack_depth)
    }

    fn is_block(&self, binary_index: u32) -> bool {
        self.counts[binary_index as usize] as usize <= WIDTH || self.binary.nodes[binary_index as usize].is_leaf()
    }

    /// Opens the child of the largest area until there are four, or only blocks are left.
    fn four_children(&self, binary_index: u32) -> Vec<u32> {
        let first = self.binary.nodes[binary_index as usize].first_index;
        let mut children = vec![first, first + 1];
        while children.len() < WIDTH {
            let area = |&child: &u32| self.binary.nodes[child as usize].aabb().half_area();
            let largest = (0..children.len())
                .filter(|&i| !self.is_block(children[i]))
                .max_by(|&a, &b| area(&children[a]).total_cmp(&area(&children[b])));
            let Some(largest) = largest else { break };
            let first = self.binary.nodes[children[largest] as usize].first_index;
            children[largest] = first;
            children.push(first + 1);
        }
        children
    }

    fn add_node(&mut self) -> u32 {
        let mut bounds = [Vec4::INFINITY; 6];
        bounds[3..].fill(Vec4::NEG_INFINITY);
        self.nodes.push(Node { bounds, children: [EMPTY; WIDTH] });
        self.nodes.len() as u32 - 1
    }

    fn add_block(&mut self, binary_index: u32) -> u32 {
        let mut block = Block { vertices: [[Vec4::ZERO; 3]; 3], references: [0; WIDTH] };
        let mut lane = 0;
        let mut open = vec![binary_index];
        while let Some(index) = open.pop() {
            let node = &self.binary.nodes[index as usize];
            if !node.is_leaf() {
                open.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            for slot in node.first_index..node.first_index + node.prim_count {
                let triangle = self.binary.primitive_indices[slot as usize];
                for (vertex, position) in self.triangles[triangle as usize].iter().enumerate() {
                    for axis in 0..3 {
                        block.vertices[vertex][axis][lane] = position[axis];
                    }
                }
                block.references[lane] = triangle | self.flags[triangle as usize];
                lane += 1;
            }
        }
        self.blocks.push(block);
        (self.blocks.len() as u32 - 1) | LEAF
    }
}
