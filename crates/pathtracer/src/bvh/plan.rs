//! Chooses the subtrees of a binary tree that become nodes and blocks.
//!
//! The choice minimizes the expected cost of a ray (Ylitie, Karras, Laine 2017, "Efficient
//! incoherent ray traversal on GPUs through compressed wide BVHs", section 3). A node costs its
//! surface area, and so does a block. C(n, j) is the least cost of the subtree n if it becomes at
//! most j children of a node. `first` and `second` are the two children of n in the binary tree.
//!
//! ```text
//! cost of a subtree as one child: the less of
//!     area(n)                                                   as a block, if n fits into one
//!     area(n) + min over k of C(first, k) + C(second, 8 − k)    as a node
//! as up to j children
//!     C(n, j) = min over k of C(first, k) + C(second, j − k), or C(n, j − 1)
//! ```

use obvhs::bvh2::Bvh2;

use super::tree::WIDTH;

/// For each subtree of the binary tree, the best ways to become at most j children of a wide node,
/// j = 1..8. Entry j − 1 states how many of the j children come from the subtree's first child. All
/// others come from its second child. The entry is [`FEWER`] if fewer children are as good.
///
/// With j = 1 the subtree becomes a single child: a wide node, a block or an instance. For a wide
/// node, entry 0 states how many of the node's own eight children come from the first child.
/// Otherwise entry 0 is [`END`].
pub(super) struct Plan(Vec<[u8; WIDTH]>);

/// Marks a subtree that is a block or an instance.
const END: u8 = u8::MAX;
/// Marks a subtree that is no better with this many children than with one child fewer.
const FEWER: u8 = 0;

impl Plan {
    /// Makes the plan of a binary tree. `primitives` has an index for every slot of the tree. An
    /// index smaller than `triangles` is a triangle, any other index is an instance.
    pub(super) fn new(binary: &Bvh2, primitives: &[u32], triangles: usize) -> Self {
        let mut plan = vec![[END; WIDTH]; binary.nodes.len()];
        let mut order = Vec::with_capacity(binary.nodes.len());
        let mut open = if binary.nodes.is_empty() { Vec::new() } else { vec![0u32] };
        while let Some(index) = open.pop() {
            order.push(index);
            let node = &binary.nodes[index as usize];
            if !node.is_leaf() {
                open.extend([node.first_index, node.first_index + 1]);
            }
        }
        // A stack with (number of triangles, costs) of the finished subtrees whose parents are not
        // finished. A second child is directly above the first child of the same parent.
        let mut finished: Vec<(u32, [f32; WIDTH])> = Vec::new();
        for &index in order.iter().rev() {
            let node = &binary.nodes[index as usize];
            let area = node.aabb().half_area();
            if node.is_leaf() {
                let slot = binary.primitive_indices[node.first_index as usize];
                let is_instance = primitives[slot as usize] as usize >= triangles;
                finished.push((if is_instance { WIDTH as u32 + 1 } else { node.prim_count }, [area; WIDTH]));
                continue;
            }
            let (Some((second_weight, second)), Some((first_weight, first))) = (finished.pop(), finished.pop()) else {
                unreachable!("children come before their parents")
            };
            let weight = first_weight.saturating_add(second_weight);
            let mut costs = [f32::INFINITY; WIDTH];
            let shares = &mut plan[index as usize];
            for count in 2..=WIDTH {
                for share in 1..count {
                    let cost = first[share - 1] + second[count - share - 1];
                    // the first value is taken in any case, since areas may be infinite
                    if share == 1 || cost < costs[count - 1] {
                        (costs[count - 1], shares[count - 1]) = (cost, share as u8);
                    }
                }
            }
            let as_node = area + costs[WIDTH - 1];
            if weight as usize <= WIDTH && area <= as_node {
                (costs[0], shares[0]) = (area, END);
            } else {
                (costs[0], shares[0]) = (as_node, shares[WIDTH - 1]);
            }
            for count in 1..WIDTH {
                if costs[count - 1] <= costs[count] {
                    (costs[count], shares[count]) = (costs[count - 1], FEWER);
                }
            }
            finished.push((weight, costs));
        }
        Self(plan)
    }

    /// Returns true if a subtree becomes a block or an instance.
    pub(super) fn is_end(&self, index: u32) -> bool {
        self.0[index as usize][0] == END
    }

    /// Returns the children of the node that a subtree becomes.
    pub(super) fn children(&self, binary: &Bvh2, index: u32) -> Vec<u32> {
        let mut children = Vec::with_capacity(WIDTH);
        let (first, share) = (binary.nodes[index as usize].first_index, usize::from(self.0[index as usize][0]));
        self.gather(binary, first, share, &mut children);
        self.gather(binary, first + 1, WIDTH - share, &mut children);
        children
    }

    /// Adds the children that a subtree becomes: at most `count`, which is at most eight.
    fn gather(&self, binary: &Bvh2, index: u32, mut count: usize, children: &mut Vec<u32>) {
        let (node, shares) = (&binary.nodes[index as usize], &self.0[index as usize]);
        while count > 1 && shares[count - 1] == FEWER {
            count -= 1;
        }
        if count == 1 || node.is_leaf() {
            children.push(index);
            return;
        }
        let share = usize::from(shares[count - 1]);
        self.gather(binary, node.first_index, share, children);
        self.gather(binary, node.first_index + 1, count - share, children);
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;
    use lumistack_core::seed::Stream;
    use obvhs::aabb::Aabb;
    use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

    use super::*;

    fn area(binary: &Bvh2, index: u32) -> f64 {
        binary.nodes[index as usize].aabb().half_area().into()
    }

    fn first(binary: &Bvh2, index: u32) -> Option<u32> {
        let node = &binary.nodes[index as usize];
        (!node.is_leaf()).then_some(node.first_index)
    }

    /// Returns the number of triangles in a subtree; `None` if the subtree contains an instance.
    fn weight(binary: &Bvh2, index: u32, triangles: usize) -> Option<usize> {
        match first(binary, index) {
            Some(first) => Some(weight(binary, first, triangles)? + weight(binary, first + 1, triangles)?),
            None => {
                let slot = binary.nodes[index as usize].first_index as usize;
                ((binary.primitive_indices[slot] as usize) < triangles).then_some(1)
            }
        }
    }

    /// Returns all ways to cut a subtree into at most eight subtrees.
    fn cuts(binary: &Bvh2, index: u32) -> Vec<Vec<u32>> {
        let mut all = vec![vec![index]];
        if let Some(first) = first(binary, index) {
            let seconds = cuts(binary, first + 1);
            for a in cuts(binary, first) {
                all.extend(seconds.iter().filter(|b| a.len() + b.len() <= WIDTH).map(|b| [a.as_slice(), b].concat()));
            }
        }
        all
    }

    /// Returns the smallest cost of a subtree as one child, found by trying all cuts.
    fn least(binary: &Bvh2, index: u32, triangles: usize, known: &mut Vec<Option<f64>>) -> f64 {
        if let Some(cost) = known[index as usize] {
            return cost;
        }
        let mut cost = f64::INFINITY;
        if first(binary, index).is_none() || weight(binary, index, triangles).is_some_and(|count| count <= WIDTH) {
            cost = area(binary, index);
        }
        for cut in cuts(binary, index).into_iter().filter(|cut| cut.len() > 1) {
            let children: f64 = cut.iter().map(|&child| least(binary, child, triangles, known)).sum();
            cost = cost.min(area(binary, index) + children);
        }
        known[index as usize] = Some(cost);
        cost
    }

    fn planned(plan: &Plan, binary: &Bvh2, index: u32, triangles: usize) -> f64 {
        if plan.is_end(index) {
            assert!(first(binary, index).is_none() || weight(binary, index, triangles).unwrap() <= WIDTH);
            return area(binary, index);
        }
        let children = plan.children(binary, index);
        assert!((2..=WIDTH).contains(&children.len()));
        area(binary, index) + children.iter().map(|&child| planned(plan, binary, child, triangles)).sum::<f64>()
    }

    /// Returns a binary tree over boxes of very different sizes.
    fn tree(count: usize, scale: f32, stream: &mut Stream) -> Bvh2 {
        let mut point = |size: f32| Vec3A::new(stream.next_f32(), stream.next_f32(), stream.next_f32()) * size;
        let boxes: Vec<Aabb> = (0..count)
            .map(|i| {
                let (min, size) = (point(4.0), point(0.1 + (i % 7) as f32 * 0.2));
                Aabb::new(min * scale, (min + size) * scale)
            })
            .collect();
        let slots = (0..count as u32).collect();
        PlocBuilder::new().build(PlocSearchDistance::High, &boxes, slots, SortPrecision::U128, 0)
    }

    #[test]
    fn no_other_way_costs_less() {
        let mut stream = Stream::new(3);
        for (count, instances) in [(2, 0), (8, 0), (9, 0), (9, 9), (12, 2), (17, 0), (20, 3), (24, 0), (24, 1)] {
            let binary = tree(count, 1.0, &mut stream);
            let slots: Vec<u32> = (0..count as u32).collect();
            let triangles = count - instances;
            let plan = Plan::new(&binary, &slots, triangles);
            let least = least(&binary, 0, triangles, &mut vec![None; binary.nodes.len()]);
            let cost = planned(&plan, &binary, 0, triangles);
            assert!((cost - least).abs() < 1e-5 * least, "{count} boxes: {cost}, least {least}");
        }
    }

    #[test]
    fn areas_too_large_for_numbers_end() {
        let binary = tree(50, 1e30, &mut Stream::new(5));
        assert!(area(&binary, 0).is_infinite());
        let slots: Vec<u32> = (0..50).collect();
        planned(&Plan::new(&binary, &slots, 50), &binary, 0, 50);
    }
}
