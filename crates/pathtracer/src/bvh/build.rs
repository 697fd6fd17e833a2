//! Builds the trees: binary trees by obvhs, collapsed to eight children per node.

use std::ops::Range;

use glam::{Vec3, Vec3A};
use lumistack_core::pages::in_large_pages;
use lumistack_simd::Backend;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use obvhs::splits::split_aabbs_preset;
use obvhs::triangle::Triangle;

use super::plan::Plan;
use super::tree::{Block, Bvh, EMPTY, INSTANCE, Input, LEAF, Node, Placed, WIDTH};

/// Fraction of the nodes that each round tries to reinsert: obvhs' value for a slow, good build. In
/// small trees, a round tries at least [`REINSERTED_AT_LEAST`] nodes, or all nodes, since that
/// takes little time.
///
/// Measured: if all nodes of the scene still-life are reinserted (0.04 s), 3 to 4 % more rays are
/// traced per second. All nodes of FlightHelmet (0.4 s) give 1 to 2 %. Half of the nodes of 15
/// copies of FlightHelmet (4 s more) also give 1 to 2 %.
const REINSERTION_RATIO: f32 = 0.2;
const REINSERTED_AT_LEAST: f32 = 20_000.0;
/// Number of first passes in which obvhs pairs only direct neighbours (its
/// `search_depth_threshold`).
const SEARCH_DEPTH: usize = 2;
/// Bounds of instances are widened by this fraction of their largest coordinate. The widening
/// covers the rounding of the bounds' corners, and of rays that are moved into an instance's space.
const INSTANCE_WIDENING: f32 = 2e-6;

/// One finished tree.
struct Tree {
    root: u32,
    stack_depth: usize,
    bounds: Aabb,
}

impl Bvh {
    /// Builds all trees.
    pub(crate) fn new(input: &Input<'_>) -> Self {
        debug_assert_eq!(input.triangles.len(), input.flags.len());
        let mut bvh = Self {
            nodes: Vec::new(),
            blocks: Vec::new(),
            instances: Vec::new(),
            root: EMPTY,
            extent: 0.0,
            stack_depth: 0,
            backend: Backend::best(),
        };
        // build a tree for each shared mesh, then a box for each of its instances
        let shared: Vec<Tree> = input.shared.iter().map(|range| bvh.add_tree(input, range.clone(), &[])).collect();
        let mut boxes = Vec::with_capacity(input.placements.len());
        for placement in input.placements {
            let tree = &shared[placement.shared];
            let place = |corner: Vec3| placement.render_from_tree * corner + placement.translation;
            boxes.push(bvh.placed_bounds(tree, place));
            bvh.instances.push(Placed {
                tree_from_render: placement.tree_from_render,
                translation: placement.translation,
                root: tree.root,
                id: placement.id,
                extent: extent(&tree.bounds),
            });
        }
        // build the top tree over loose triangles and instances
        let top = bvh.add_tree(input, input.loose.clone(), &boxes);
        bvh.root = top.root;
        bvh.extent = extent(&top.bounds);
        // a ray in an instance has one more entry on the stack, the mark of the instance's end,
        // besides the postponed children of both trees
        bvh.stack_depth = top.stack_depth + 1 + shared.iter().map(|tree| tree.stack_depth).max().unwrap_or(0);
        bvh.nodes.shrink_to_fit();
        bvh.nodes = in_large_pages(bvh.nodes);
        bvh.blocks.shrink_to_fit();
        bvh.blocks = in_large_pages(bvh.blocks);
        bvh
    }

    /// Returns the bounds of a placed tree: the union of its root's children, each placed by
    /// itself. The box of the whole tree would be larger after a rotation.
    fn placed_bounds(&self, tree: &Tree, place: impl Fn(Vec3) -> Vec3) -> Aabb {
        let mut bounds = Aabb::INVALID;
        let mut extend = |min: [f32; 3], max: [f32; 3]| {
            for corner in 0..8 {
                let pick = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
                bounds.extend(place(Vec3::new(pick(0), pick(1), pick(2))).into());
            }
        };
        if tree.root & LEAF == 0 {
            let node = &self.nodes[tree.root as usize];
            for lane in (0..WIDTH).filter(|&lane| node.children[lane] != EMPTY) {
                let at = |side: usize| [0, 1, 2].map(|axis| node.bounds[side + axis][lane]);
                extend(at(0), at(3));
            }
        } else {
            extend(tree.bounds.min.to_array(), tree.bounds.max.to_array());
        }
        let margin = Vec3A::splat(INSTANCE_WIDENING * extent(&bounds));
        Aabb::new(bounds.min - margin, bounds.max + margin)
    }

    /// Adds a tree over a range of triangles and over boxes of instances.
    fn add_tree(&mut self, input: &Input<'_>, range: Range<usize>, instances: &[Aabb]) -> Tree {
        let triangles = &input.triangles[range.clone()];
        let flags = &input.flags[range.clone()];
        // make the boxes of triangles and of instances; large triangles are cut into several boxes
        let mut boxes: Vec<Aabb> = triangles.iter().map(|t| Aabb::from_points(&t.map(Vec3A::from))).collect();
        let mut primitives: Vec<u32> = (0..boxes.len() as u32).collect();
        let bounds = boxes.iter().chain(instances).fold(Aabb::INVALID, |all, one| all.union(one));
        split_large(&mut boxes, &mut primitives, triangles, flags);
        boxes.extend(instances);
        primitives.extend((0..instances.len()).map(|i| (triangles.len() + i) as u32));
        // build a binary tree, improve it, and collapse it into wide nodes and blocks
        let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
            PlocSearchDistance::High,
            &boxes,
            (0..boxes.len() as u32).collect(),
            SortPrecision::U128,
            SEARCH_DEPTH,
        );
        let ratio = (REINSERTED_AT_LEAST / boxes.len() as f32).clamp(REINSERTION_RATIO, 1.0);
        drop(boxes);
        ReinsertionOptimizer::default().run(&mut binary, ratio, None);
        let mut collapse = Collapse {
            plan: Plan::new(&binary, &primitives, triangles.len()),
            binary: &binary,
            primitives: &primitives,
            triangles,
            flags,
            first: range.start as u32,
            nodes: &mut self.nodes,
            blocks: &mut self.blocks,
        };
        let (root, stack_depth) = collapse.run();
        Tree { root, stack_depth, bounds }
    }
}

/// Cuts the boxes of large triangles into smaller boxes. Only opaque triangles are cut, since a
/// traversal may test them twice without effect. The alpha or the tint of other triangles would be
/// evaluated twice.
fn split_large(boxes: &mut Vec<Aabb>, primitives: &mut Vec<u32>, triangles: &[[Vec3; 3]], flags: &[u32]) {
    if triangles.is_empty() {
        return;
    }
    let mut whole = (Vec::new(), Vec::new());
    let mut split = (Vec::new(), Vec::new());
    for (&aabb, &primitive) in boxes.iter().zip(primitives.iter()) {
        let into = if flags[primitive as usize] & !super::CULL_BACK == 0 { &mut split } else { &mut whole };
        into.0.push(aabb);
        into.1.push(primitive);
    }
    let areas = boxes.iter().map(Aabb::half_area);
    let mean = areas.clone().map(f64::from).sum::<f64>() / boxes.len() as f64;
    let largest = areas.fold(0.0, f32::max);
    let corners: Vec<Triangle> =
        triangles.iter().map(|t| Triangle { v0: t[0].into(), v1: t[1].into(), v2: t[2].into() }).collect();
    split_aabbs_preset(&mut split.0, &mut split.1, &corners, mean as f32, largest);
    *boxes = split.0;
    boxes.append(&mut whole.0);
    *primitives = split.1;
    primitives.append(&mut whole.1);
}

fn extent(bounds: &Aabb) -> f32 {
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    if largest.is_finite() { largest } else { 0.0 }
}

struct Collapse<'a> {
    binary: &'a Bvh2,
    plan: Plan,
    /// Per slot of the binary tree: the index of a triangle, or the number of triangles plus the
    /// index of an instance.
    primitives: &'a [u32],
    triangles: &'a [[Vec3; 3]],
    flags: &'a [u32],
    /// Index of the first of `triangles` among all triangles.
    first: u32,
    nodes: &'a mut Vec<Node>,
    blocks: &'a mut Vec<Block>,
}

impl Collapse<'_> {
    /// Adds the wide nodes and the blocks. Returns the root and the depth of the traversal stack. A
    /// list of open nodes replaces recursion, since obvhs' trees over hostile input may be deep.
    fn run(&mut self) -> (u32, usize) {
        if self.binary.nodes.is_empty() {
            return (EMPTY, 1);
        }
        if self.plan.is_end(0) {
            return (self.end(0), 1);
        }
        let mut stack_depth = 1;
        let root = self.add_node();
        // (binary node, wide node to fill, number of siblings that are postponed on the way to it)
        let mut open = vec![(0u32, root, 0usize)];
        while let Some((binary_index, node, postponed)) = open.pop() {
            // every postponed child needs an entry on the stack of a traversal
            let children = self.plan.children(self.binary, binary_index);
            let postponed = postponed + children.len() - 1;
            stack_depth = stack_depth.max(postponed + 1);
            for (lane, &child) in children.iter().enumerate() {
                let reference = if self.plan.is_end(child) {
                    self.end(child)
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
        (root, stack_depth)
    }

    fn add_node(&mut self) -> u32 {
        let mut bounds = [[f32::INFINITY; WIDTH]; 6];
        bounds[3..].fill([f32::NEG_INFINITY; WIDTH]);
        self.nodes.push(Node { bounds, children: [EMPTY; WIDTH] });
        self.nodes.len() as u32 - 1
    }

    fn end(&mut self, binary_index: u32) -> u32 {
        let node = &self.binary.nodes[binary_index as usize];
        if node.is_leaf() {
            let primitive = self.primitives[self.binary.primitive_indices[node.first_index as usize] as usize];
            if let Some(instance) = (primitive as usize).checked_sub(self.triangles.len()) {
                return instance as u32 | LEAF | INSTANCE;
            }
        }
        self.add_block(binary_index)
    }

    fn add_block(&mut self, binary_index: u32) -> u32 {
        let mut block = Block { vertices: [[[0.0; WIDTH]; 3]; 3], references: [0; WIDTH] };
        let mut lane = 0;
        let mut open = vec![binary_index];
        while let Some(index) = open.pop() {
            let node = &self.binary.nodes[index as usize];
            if !node.is_leaf() {
                open.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            for slot in node.first_index..node.first_index + node.prim_count {
                let triangle = self.primitives[self.binary.primitive_indices[slot as usize] as usize];
                let reference = (self.first + triangle) | self.flags[triangle as usize];
                // two boxes of one triangle may end in one block, which then holds the triangle
                // once
                if block.references[..lane].contains(&reference) {
                    continue;
                }
                for (vertex, position) in self.triangles[triangle as usize].iter().enumerate() {
                    for axis in 0..3 {
                        block.vertices[vertex][axis][lane] = position[axis];
                    }
                }
                block.references[lane] = reference;
                lane += 1;
            }
        }
        self.blocks.push(block);
        (self.blocks.len() as u32 - 1) | LEAF
    }
}
