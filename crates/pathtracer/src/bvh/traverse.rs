//! Traversal: nearest hit and transmittance along a segment.
//!
//! ```text
//! while something is postponed, take the last:
//!     node       test the ray against 8 boxes; go on with the nearest, postpone the others
//!     block      test the ray against 8 triangles
//!     instance   move the ray into the instance's space and go on with its tree
//! ```
//!
//! These details make the loop faster:
//!
//! * The signs of the ray's direction d select near and far planes, which saves min and max. The
//!   distance from the origin o to a plane at b is one fused multiply-add, b/d − o/d.
//! * The postponed children of a node are sorted by distance, the nearest last. They are dropped
//!   when a nearer hit is known. The loop for the transmittance does not sort, since its result
//!   does not depend on the order.
//! * The whole loop is one function compiled for the instruction set.
//! * A ray enters few nodes (FlightHelmet: 2.2 nodes and 1.0 blocks), so preparing the ray takes a
//!   notable part of the time. Values that only the test of a block needs therefore stay scalars.
//!   Trees without instances have a loop of their own, in which rays never change. These two
//!   measures together give a fifth to a third more rays per second.
//! * A block's test runs to its end even if the edge functions already exclude all its triangles. A
//!   branch there would be unpredictable; without it 4 to 9 % more scattered and shadow rays are
//!   traced per second.
//! * Only the nearest hit of a triangle without flags is converted to a [`Hit`], at the end (4 to
//!   12 % more rays per second).
//!
//! These variants were tried on FlightHelmet, on 15 copies of it (1.4 million triangles) and on
//! still-life. The machine was a Zen 4, with one pinned thread. Each percentage is from the fastest
//! of several rounds:
//!
//! * No branch on the number of children entered (none, one or two): 5 % slower, since a predicted
//!   branch waits for no data.
//! * A branch on the nearer of two children: 1 to 3 % slower.
//! * The triangle test prepared at a ray's first block: primary rays 5 % slower.
//! * Each shadow ray first tested against the block that stopped the previous shadow ray: 2 %
//!   slower, since most shadow rays reach the light.
//! * On 15 copies, no prefetch: 10 to 20 % slower. On 15 copies, prefetch of the postponed children
//!   alone: 0 to 10 % slower.
//! * Small pages instead of large ones: no difference on FlightHelmet.
//! * Boxes of large triangles cut further, by area or by priority (Karras, Aila 2013): up to 10 %
//!   more nodes per ray.
//!
//! The triangle test is the watertight one of Woop, Benthin, Wald 2013 ("Watertight ray/triangle
//! intersection", JCGT 2(1)). It shears the triangle into a space where the ray is the z axis, and
//! compares edge functions with zero. Shared edges give exactly opposite values, so a ray cannot
//! pass between two triangles. For this reason the edge functions use no fused multiply-add, which
//! rounds only one of the two products. With it, a·b − c·d would not be −(c·d − a·b). Boxes are
//! widened by the rounding of the slab test, see [`SLAB_ROUNDING`].

use std::marker::PhantomData;

use glam::Vec3;
use lumistack_simd::{Kernel, Lanes, prefetch};

use super::tree::{
    Block, Bvh, CULL_BACK, EMPTY, Hit, INDEX_MASK, INSTANCE, LEAF, NO_INSTANCE, Node, Placed, Ray, WIDTH,
};

/// In the slab test, a direction component of smaller magnitude is replaced by this value, so that
/// 0 · ∞ cannot occur.
pub(super) const SMALLEST_SLOPE: f32 = 1e-18;
/// Rounding of b/d − o/d as a fraction of (|o| + |b|)/|d|, with a plane's position b and the ray's
/// origin o and direction d. Each of 1/d, o/d and the result adds half an epsilon. Boxes of cut
/// triangles, whose corners are rounded, double the sum.
pub(super) const SLAB_ROUNDING: f32 = 4.0 * f32::EPSILON;

/// Reusable memory for postponed children. An entry has the distance in its high 32 bits and the
/// child in its low 32 bits, so that entries sort by distance.
pub(crate) struct Stack(pub(super) Vec<u64>);

/// Marks the end of an instance. On the stack this entry is below the children of the instance's
/// tree. Its distance reads as −∞, so it is never dropped.
const END_OF_INSTANCE: u64 = (f32::NEG_INFINITY.to_bits() as u64) << 32 | EMPTY as u64;

/// The axis of the direction's largest component. Three comparisons are the bits of the index, from
/// the lowest: |x| > |y|, |x| > |z|, |y| > |z|.
const LONGEST: [u8; 8] = [2, 2, 2, 0, 1, 2, 1, 0];
/// The two axes other than the longest axis a: entry 2a if the direction is positive along a, entry
/// 2a + 1 if it is negative. The two entries differ in order, which keeps the triangles' winding.
/// Padding to eight entries saves a range check of the three-bit index.
const OTHERS: [[u8; 2]; 8] = [[1, 2], [2, 1], [2, 0], [0, 2], [0, 1], [1, 0], [0, 0], [0, 0]];

/// A ray prepared for the slab test.
#[derive(Clone, Copy)]
struct Slabs<V> {
    inverse: [V; 3],
    /// −o/d (origin over direction), minus the rounding (`near_shift`) and plus the rounding
    /// (`far_shift`).
    near_shift: [V; 3],
    far_shift: [V; 3],
    /// Index of the near plane per axis in [`Node::bounds`].
    near: [usize; 3],
    far: [usize; 3],
}

/// A ray prepared for the triangle test. Its fields are scalars, which the test of a block converts
/// to vectors. So rays that reach no block pay little.
#[derive(Clone, Copy)]
pub(super) struct Shear {
    /// Rows of the axes in a block; the last is the axis of the direction's largest component.
    pub(super) axes: [usize; 3],
    /// The ray's origin, in the order of `axes`.
    origin: [f32; 3],
    shear: [f32; 3],
}

/// Results of the triangle test. A lane holds one of eight triangles for a single ray, or one of
/// eight rays for a beam.
pub(super) struct Test<V> {
    pub(super) t: V,
    pub(super) u: V,
    pub(super) v: V,
    pub(super) determinant: V,
}

/// The arrays that a traversal reads. The kernel keeps them in a local variable, and also a copy of
/// the ray. Otherwise the compiler would reload all data behind the kernel's arguments after every
/// write to the stack, since a write might overlap this data. Reloading costs 5 % of the time of
/// single rays and 2 to 3 % of the time of beams (FlightHelmet).
#[derive(Clone, Copy)]
pub(super) struct Arrays<'a> {
    pub(super) nodes: &'a [Node],
    pub(super) blocks: &'a [Block],
}

impl Arrays<'_> {
    /// Prefetches a child: waiting for its memory takes most of a ray's time. Sorting the siblings
    /// meanwhile hides a part of that wait.
    #[inline(always)]
    fn prefetch(&self, child: u32) {
        let base = if child & LEAF == 0 {
            self.nodes.as_ptr().wrapping_add(child as usize).cast::<u8>()
        } else {
            self.blocks.as_ptr().wrapping_add((child & !(LEAF | INSTANCE)) as usize).cast::<u8>()
        };
        prefetch(base);
        prefetch(base.wrapping_add(64));
        prefetch(base.wrapping_add(128));
        prefetch(base.wrapping_add(192));
        prefetch(base.wrapping_add(256));
    }
}

/// A triangle that a ray hits, with the results of the triangle test before their division.
#[derive(Clone, Copy)]
struct RawHit {
    u: f32,
    v: f32,
    determinant: f32,
    reference: u32,
    instance: u32,
}

impl Bvh {
    /// Allocates the memory for traversals of this tree.
    pub(crate) fn stack(&self) -> Stack {
        Stack(vec![0; self.stack_depth + 1])
    }

    /// Returns the nearest hit for which `accept` returns true. `accept` is called only for
    /// triangles with flags other than [`CULL_BACK`], in any order and at most once per triangle
    /// and instance.
    #[inline]
    pub(crate) fn nearest(&self, ray: &Ray, stack: &mut Stack, accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        let mut hit = None;
        self.find_nearest(ray, stack, accept, &mut hit);
        hit
    }

    /// Does the same as [`nearest`](Self::nearest), and writes the result to `found`. A returned
    /// value would be copied in larger pieces than it was written in, and a processor waits for
    /// such copies.
    #[inline]
    pub(crate) fn find_nearest(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        accept: impl FnMut(&Hit) -> bool,
        found: &mut Option<Hit>,
    ) {
        // SAFETY: the kernel makes no demands
        unsafe { self.backend.call_eight::<Nearest<_>>((self, ray, stack, accept, found)) }
    }

    /// Returns the product of `transmittance` over all triangles that the segment crosses, except
    /// the invisible backs of [`CULL_BACK`] triangles. `transmittance` is called only for triangles
    /// with flags other than [`CULL_BACK`], at most once for each triangle and instance. All other
    /// triangles are opaque. The traversal stops when the product is zero.
    #[inline]
    pub(crate) fn transmittance(&self, ray: &Ray, stack: &mut Stack, transmittance: impl FnMut(&Hit) -> Vec3) -> Vec3 {
        // SAFETY: the kernel makes no demands
        unsafe { self.backend.call_eight::<Transmittance<_>>((self, ray, stack, transmittance)) }
    }

    /// Returns the arrays that a traversal of this tree reads.
    #[inline(always)]
    pub(super) fn arrays(&self) -> Arrays<'_> {
        Arrays { nodes: &self.nodes, blocks: &self.blocks }
    }

    /// Computes the nearest accepted hit. If `INSTANCED` is false, the tree must have no instances,
    /// so the ray is never moved into another space.
    ///
    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    unsafe fn nearest_in<V: Lanes, const INSTANCED: bool>(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        if self.root == EMPTY {
            return None;
        }
        assert!(stack.0.len() > self.stack_depth, "expected a stack of this tree, found a smaller stack");
        // SAFETY: the caller has the instruction set. Child references point into the arrays they
        // were made with. No more than `stack_depth` children are ever postponed, which `build`
        // counts and the assertion above checks.
        unsafe {
            // a local copy makes the loop faster; the doc of [`Arrays`] states the reason
            let ray = &{ *ray };
            let mut slabs = Slabs::<V>::new(ray, self.extent);
            let mut shear = Shear::new(ray);
            let mut instance = NO_INSTANCE;
            let (arrays, postponed) = (self.arrays(), stack.0.as_mut_ptr());
            let mut depth = 0;
            // data of the nearest hit, which becomes a `Hit` once, at the end
            let mut nearest: Option<RawHit> = None;
            let mut t_max = ray.t_max;
            let mut current = self.root;
            // takes the next postponed child that is not farther than the nearest hit
            macro_rules! pop {
                () => {
                    loop {
                        if depth == 0 {
                            return nearest.map(|raw| raw.hit(t_max));
                        }
                        depth -= 1;
                        let entry = *postponed.add(depth);
                        if f32::from_bits((entry >> 32) as u32) < t_max {
                            current = entry as u32;
                            break;
                        }
                    }
                };
            }
            loop {
                // Nodes have a separate loop, so that registers hold only the inputs of the node
                // test.
                while current & LEAF == 0 {
                    let node = arrays.nodes.get_unchecked(current as usize);
                    let (t_near, mut hits) = slabs.enters(node, t_max);
                    if hits == 0 {
                        pop!();
                        continue;
                    }
                    let first = hits.trailing_zeros() as usize;
                    hits &= hits - 1;
                    current = *node.children.get_unchecked(first);
                    if hits == 0 {
                        continue;
                    }
                    let t_near: [f32; WIDTH] = t_near.to_array();
                    arrays.prefetch(current);
                    let one = u64::from(t_near.get_unchecked(first).to_bits()) << 32 | u64::from(current);
                    macro_rules! next {
                        () => {{
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            let child = *node.children.get_unchecked(lane);
                            arrays.prefetch(child);
                            u64::from(t_near.get_unchecked(lane).to_bits()) << 32 | u64::from(child)
                        }};
                    }
                    // which child is nearer is unpredictable, so two or three hit children are
                    // sorted without branches
                    let other = next!();
                    let (mut a, mut b) = (one.min(other), one.max(other));
                    if hits == 0 {
                        *postponed.add(depth) = b;
                        depth += 1;
                    } else {
                        let third = next!();
                        let c = b.max(third);
                        b = b.min(third);
                        (a, b) = (a.min(b), a.max(b));
                        *postponed.add(depth) = c;
                        *postponed.add(depth + 1) = b;
                        let base = depth;
                        depth += 2;
                        while hits != 0 {
                            let next = next!();
                            let entry = a.max(next);
                            a = a.min(next);
                            let mut slot = depth;
                            while slot > base && *postponed.add(slot - 1) < entry {
                                *postponed.add(slot) = *postponed.add(slot - 1);
                                slot -= 1;
                            }
                            *postponed.add(slot) = entry;
                            depth += 1;
                        }
                    }
                    current = a as u32;
                }
                if !INSTANCED || current & INSTANCE == 0 {
                    let block = arrays.blocks.get_unchecked((current & !LEAF) as usize);
                    let (mut hits, test) = shear.intersect::<V>(block, t_max);
                    if hits != 0 {
                        let test = test.store();
                        while hits != 0 {
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            let t = test.t[lane];
                            if t < t_max {
                                let raw = test.raw_hit(lane, block.references[lane], instance);
                                let agreed = raw.reference & !INDEX_MASK == 0 || {
                                    let hit = raw.hit(t);
                                    hit.is_visible() && (hit.flags & !CULL_BACK == 0 || accept(&hit))
                                };
                                if agreed {
                                    t_max = t;
                                    nearest = Some(raw);
                                }
                            }
                        }
                    }
                } else if current == EMPTY {
                    (slabs, shear) = (Slabs::new(ray, self.extent), Shear::new(ray));
                    instance = NO_INSTANCE;
                } else {
                    let placed = self.instances.get_unchecked((current & !(LEAF | INSTANCE)) as usize);
                    let tree_ray = placed.tree_ray(ray);
                    (slabs, shear) = (Slabs::new(&tree_ray, placed.extent), Shear::new(&tree_ray));
                    instance = placed.id;
                    *postponed.add(depth) = END_OF_INSTANCE;
                    depth += 1;
                    current = placed.root;
                    continue;
                }
                pop!();
            }
        }
    }

    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    unsafe fn transmittance_in<V: Lanes, const INSTANCED: bool>(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        mut transmittance: impl FnMut(&Hit) -> Vec3,
    ) -> Vec3 {
        let mut product = Vec3::ONE;
        if self.root == EMPTY {
            return product;
        }
        assert!(stack.0.len() > self.stack_depth, "expected a stack of this tree, found a smaller stack");
        // SAFETY: as in `nearest_in`
        unsafe {
            // a local copy makes the loop faster; the doc of [`Arrays`] states the reason
            let ray = &{ *ray };
            let mut slabs = Slabs::<V>::new(ray, self.extent);
            let mut shear = Shear::new(ray);
            let mut instance = NO_INSTANCE;
            let (arrays, postponed, t_max) = (self.arrays(), stack.0.as_mut_ptr(), ray.t_max);
            let mut depth = 0;
            let mut current = self.root;
            loop {
                while current & LEAF == 0 {
                    let node = arrays.nodes.get_unchecked(current as usize);
                    let (_, mut hits) = slabs.enters(node, t_max);
                    if hits == 0 {
                        if depth == 0 {
                            return product;
                        }
                        depth -= 1;
                        current = *postponed.add(depth) as u32;
                        continue;
                    }
                    // visit the children in any order, since the product of transmittances does not
                    // depend on it
                    current = *node.children.get_unchecked(hits.trailing_zeros() as usize);
                    hits &= hits - 1;
                    while hits != 0 {
                        let lane = hits.trailing_zeros() as usize;
                        hits &= hits - 1;
                        *postponed.add(depth) = u64::from(*node.children.get_unchecked(lane));
                        depth += 1;
                    }
                }
                if !INSTANCED || current & INSTANCE == 0 {
                    let block = arrays.blocks.get_unchecked((current & !LEAF) as usize);
                    let (mut hits, test) = shear.intersect::<V>(block, t_max);
                    if hits != 0 {
                        let test = test.store();
                        while hits != 0 {
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            let hit = test.hit(lane, block.references[lane], instance);
                            if hit.is_visible() {
                                // opaque triangles end the segment, and all other triangles dim the
                                // light
                                if hit.flags & !CULL_BACK == 0 {
                                    return Vec3::ZERO;
                                }
                                product *= transmittance(&hit);
                                if product == Vec3::ZERO {
                                    return product;
                                }
                            }
                        }
                    }
                } else if current == EMPTY {
                    (slabs, shear) = (Slabs::new(ray, self.extent), Shear::new(ray));
                    instance = NO_INSTANCE;
                } else {
                    let placed = self.instances.get_unchecked((current & !(LEAF | INSTANCE)) as usize);
                    let tree_ray = placed.tree_ray(ray);
                    (slabs, shear) = (Slabs::new(&tree_ray, placed.extent), Shear::new(&tree_ray));
                    instance = placed.id;
                    *postponed.add(depth) = u64::from(EMPTY);
                    depth += 1;
                    current = placed.root;
                    continue;
                }
                if depth == 0 {
                    return product;
                }
                depth -= 1;
                current = *postponed.add(depth) as u32;
            }
        }
    }
}

/// The kernel that [`Bvh::find_nearest`] runs. `F` is the type of that function's argument
/// `accept`.
pub(super) struct Nearest<F>(PhantomData<F>);

impl<F: FnMut(&Hit) -> bool> Kernel for Nearest<F> {
    type Args<'a> = (&'a Bvh, &'a Ray, &'a mut Stack, F, &'a mut Option<Hit>);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((bvh, ray, stack, accept, found): Self::Args<'_>) {
        // SAFETY: the caller guarantees that the machine has the instruction set
        unsafe {
            *found = if bvh.instances.is_empty() {
                bvh.nearest_in::<V, false>(ray, stack, accept)
            } else {
                bvh.nearest_in::<V, true>(ray, stack, accept)
            };
        }
    }
}

/// The kernel that [`Bvh::transmittance`] runs. `F` is the type of that function's argument
/// `transmittance`.
pub(super) struct Transmittance<F>(PhantomData<F>);

impl<F: FnMut(&Hit) -> Vec3> Kernel for Transmittance<F> {
    type Args<'a> = (&'a Bvh, &'a Ray, &'a mut Stack, F);
    type Output = Vec3;

    #[inline(always)]
    unsafe fn run<V: Lanes>((bvh, ray, stack, transmittance): Self::Args<'_>) -> Vec3 {
        // SAFETY: the caller guarantees that the machine has the instruction set
        unsafe {
            if bvh.instances.is_empty() {
                bvh.transmittance_in::<V, false>(ray, stack, transmittance)
            } else {
                bvh.transmittance_in::<V, true>(ray, stack, transmittance)
            }
        }
    }
}

impl Placed {
    /// Returns the ray in the tree's space. Each t gives the same point in both spaces.
    #[inline(always)]
    fn tree_ray(&self, ray: &Ray) -> Ray {
        // The subtraction comes first, since its result is exact close to the instance. If the
        // rotation came first, its rounding would move the hits.
        Ray {
            origin: self.tree_from_render * (ray.origin - self.translation),
            direction: self.tree_from_render * ray.direction,
            t_max: ray.t_max,
        }
    }
}

impl Hit {
    #[inline(always)]
    pub(super) fn is_visible(&self) -> bool {
        self.front || self.flags & CULL_BACK == 0
    }
}

// SAFETY of every block and function below: the callers have `V`'s instruction set
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Slabs<V> {
    /// Prepares a ray. `extent` is the largest coordinate of the tree's bounds.
    #[inline(always)]
    unsafe fn new(ray: &Ray, extent: f32) -> Self {
        let (d, o) = (ray.direction.to_array(), ray.origin.to_array());
        let inverse = d.map(|c| 1.0 / if c.abs() < SMALLEST_SLOPE { SMALLEST_SLOPE.copysign(c) } else { c });
        let shift: [f32; 3] = std::array::from_fn(|axis| -o[axis] * inverse[axis]);
        let rounding: [f32; 3] =
            std::array::from_fn(|axis| SLAB_ROUNDING * (o[axis].abs() + extent) * inverse[axis].abs());
        let sign = |axis: usize| (inverse[axis].to_bits() >> 31) as usize;
        let near = [3 * sign(0) * WIDTH, (1 + 3 * sign(1)) * WIDTH, (2 + 3 * sign(2)) * WIDTH];
        // Vector operations stay outside of closures. A closure would not have the instruction set,
        // so its vector operations would become calls.
        unsafe {
            Self {
                inverse: [V::splat(inverse[0]), V::splat(inverse[1]), V::splat(inverse[2])],
                near_shift: [
                    V::splat(shift[0] - rounding[0]),
                    V::splat(shift[1] - rounding[1]),
                    V::splat(shift[2] - rounding[2]),
                ],
                far_shift: [
                    V::splat(shift[0] + rounding[0]),
                    V::splat(shift[1] + rounding[1]),
                    V::splat(shift[2] + rounding[2]),
                ],
                near,
                far: [3 * WIDTH - near[0], 5 * WIDTH - near[1], 7 * WIDTH - near[2]],
            }
        }
    }

    /// Returns the distances along the ray to eight planes, one of each box, all perpendicular to
    /// `axis`. `row` is an entry of `near` or `far`.
    #[inline(always)]
    unsafe fn distance(&self, node: &Node, row: usize, axis: usize, shift: V) -> V {
        unsafe { V::from_array(eight(node.bounds.as_flattened(), row)).fused_mul_add(self.inverse[axis], shift) }
    }

    /// Returns the distances at which the ray enters eight boxes, and a bit per box that it enters
    /// before `t_max`.
    #[inline(always)]
    unsafe fn enters(&self, node: &Node, t_max: f32) -> (V, u32) {
        unsafe {
            let [near_x, near_y, near_z] = [
                self.distance(node, self.near[0], 0, self.near_shift[0]),
                self.distance(node, self.near[1], 1, self.near_shift[1]),
                self.distance(node, self.near[2], 2, self.near_shift[2]),
            ];
            let [far_x, far_y, far_z] = [
                self.distance(node, self.far[0], 0, self.far_shift[0]),
                self.distance(node, self.far[1], 1, self.far_shift[1]),
                self.distance(node, self.far[2], 2, self.far_shift[2]),
            ];
            let entry = near_x.max(near_y).max(near_z.max(V::splat(0.0)));
            let exit = far_x.min(far_y).min(far_z.min(V::splat(t_max)));
            (entry, V::bits(entry.at_most(exit)))
        }
    }
}

/// Returns eight successive values of `rows`, which has rows of eight values. `row` is the index of
/// the first value.
///
/// # Safety
/// `row` is the start of a row.
#[inline(always)]
pub(super) unsafe fn eight(rows: &[f32], row: usize) -> &[f32; WIDTH] {
    debug_assert!(row + WIDTH <= rows.len());
    // SAFETY: the row lies within the array
    unsafe { &*rows.as_ptr().add(row).cast() }
}

#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl Shear {
    #[inline(always)]
    pub(super) fn new(ray: &Ray) -> Self {
        let (d, o) = (ray.direction.to_array(), ray.origin.to_array());
        let magnitude = d.map(f32::abs);
        // A table avoids branches, which would be unpredictable: any axis may be the longest.
        let greater = |a: usize, b: usize| usize::from(magnitude[a] > magnitude[b]);
        let z = LONGEST[greater(0, 1) | greater(0, 2) << 1 | greater(1, 2) << 2];
        // a fourth element saves range checks of the two-bit index
        let (d, o) = ([d[0], d[1], d[2], 0.0], [o[0], o[1], o[2], 0.0]);
        let along = d[usize::from(z & 3)];
        let [x, y] = OTHERS[usize::from(2 * z + u8::from(along < 0.0)) & 7];
        let axes = [x, y, z].map(|axis| usize::from(axis & 3));
        let along = 1.0 / along;
        Self {
            axes: axes.map(|axis| axis * WIDTH),
            origin: axes.map(|axis| o[axis]),
            shear: [d[axes[0]] * along, d[axes[1]] * along, along],
        }
    }

    /// Returns true if the directions of `ray` and of this shear's ray have their largest component
    /// along the same axis, with the same sign.
    #[inline(always)]
    pub(super) fn has_axes_of(&self, ray: &Ray) -> bool {
        let direction = ray.direction.to_array();
        let [x, y, z] = self.axes.map(|row| direction[row / WIDTH]);
        // The test is strict, since `Shear::new` chooses the later of two equal components.
        z.abs() > x.abs().max(y.abs()) && (z < 0.0) == (self.shear[2] < 0.0)
    }

    /// Tests eight triangles; returns a bit per triangle that is hit at 0 < t < `t_max`.
    #[inline(always)]
    pub(super) unsafe fn intersect<V: Lanes>(&self, block: &Block, t_max: f32) -> (u32, Test<V>) {
        unsafe {
            let origin = [V::splat(self.origin[0]), V::splat(self.origin[1]), V::splat(self.origin[2])];
            let shear = [V::splat(self.shear[0]), V::splat(self.shear[1]), V::splat(self.shear[2])];
            let corners = Corners([
                Corners::corner(self.vertex(block, 0), &origin, &shear),
                Corners::corner(self.vertex(block, 1), &origin, &shear),
                Corners::corner(self.vertex(block, 2), &origin, &shear),
            ]);
            let edges = corners.edges();
            let t = corners.distance(&edges, shear[2]);
            let within = V::both(V::splat(0.0).below(t), t.below(V::splat(t_max)));
            let bits = V::bits(V::both(edges.inside, within));
            (bits, Test { t, u: edges.u, v: edges.v, determinant: edges.determinant })
        }
    }

    /// Returns the vertex number `vertex` of eight triangles, with its coordinates in the order of
    /// `axes`.
    #[inline(always)]
    unsafe fn vertex<V: Lanes>(&self, block: &Block, vertex: usize) -> [V; 3] {
        unsafe {
            let rows = block.vertices.get_unchecked(vertex).as_flattened();
            [
                V::from_array(eight(rows, self.axes[0])),
                V::from_array(eight(rows, self.axes[1])),
                V::from_array(eight(rows, self.axes[2])),
            ]
        }
    }
}

/// A triangle per lane, in the space where the lane's ray starts at the origin and is the z axis; z
/// is not scaled yet.
///
/// Single rays and beams are tested by the functions of this type, so their hits are equal bit for
/// bit.
pub(super) struct Corners<V>(pub(super) [[V; 3]; 3]);

/// Areas of one triangle per lane, as seen along the lane's ray. u, v and w are each twice the area
/// between an edge and the ray. A mask marks the triangles that the ray passes through.
pub(super) struct Edges<V: Lanes> {
    pub(super) u: V,
    pub(super) v: V,
    w: V,
    pub(super) determinant: V,
    pub(super) inside: V::Mask,
}

#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Corners<V> {
    /// Brings a vertex into the ray's space.
    #[inline(always)]
    pub(super) unsafe fn corner(vertex: [V; 3], origin: &[V; 3], shear: &[V; 3]) -> [V; 3] {
        unsafe {
            let [x, y, z] = [vertex[0].sub(origin[0]), vertex[1].sub(origin[1]), vertex[2].sub(origin[2])];
            [shear[0].fused_neg_mul_add(z, x), shear[1].fused_neg_mul_add(z, y), z]
        }
    }

    #[inline(always)]
    pub(super) unsafe fn edges(&self) -> Edges<V> {
        unsafe {
            let [[ax, ay, _], [bx, by, _], [cx, cy, _]] = self.0;
            let u = cx.mul(by).sub(cy.mul(bx));
            let v = ax.mul(cy).sub(ay.mul(cx));
            let w = bx.mul(ay).sub(by.mul(ax));
            let zero = V::splat(0.0);
            let low = u.min(v).min(w);
            let high = u.max(v).max(w);
            let determinant = u.add(v).add(w);
            let turned = V::either(determinant.below(zero), zero.below(determinant));
            let inside = V::both(V::either(zero.at_most(low), high.at_most(zero)), turned);
            Edges { u, v, w, determinant, inside }
        }
    }

    /// Returns the distance t of the intersection with the triangle's plane. `along` is the scale
    /// of z, which the corners lack.
    #[inline(always)]
    pub(super) unsafe fn distance(&self, edges: &Edges<V>, along: V) -> V {
        unsafe {
            let [[.., az], [.., bz], [.., cz]] = self.0;
            edges.w.fused_mul_add(cz, edges.v.fused_mul_add(bz, edges.u.mul(az))).mul(along).div(edges.determinant)
        }
    }
}

#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Test<V> {
    /// Returns the results as arrays of numbers.
    #[inline(always)]
    pub(super) unsafe fn store(self) -> Test<[f32; WIDTH]> {
        unsafe {
            Test {
                t: self.t.to_array(),
                u: self.u.to_array(),
                v: self.v.to_array(),
                determinant: self.determinant.to_array(),
            }
        }
    }
}

impl Test<[f32; WIDTH]> {
    /// Returns the results for one triangle.
    #[inline(always)]
    fn raw_hit(&self, lane: usize, reference: u32, instance: u32) -> RawHit {
        RawHit { u: self.u[lane], v: self.v[lane], determinant: self.determinant[lane], reference, instance }
    }

    #[inline(always)]
    pub(super) fn hit(&self, lane: usize, reference: u32, instance: u32) -> Hit {
        self.raw_hit(lane, reference, instance).hit(self.t[lane])
    }
}

impl RawHit {
    #[inline(always)]
    fn hit(&self, t: f32) -> Hit {
        let scale = 1.0 / self.determinant;
        let (u, v) = (self.u * scale, self.v * scale);
        Hit {
            t,
            triangle: self.reference & INDEX_MASK,
            instance: self.instance,
            barycentric: [u, v, 1.0 - u - v],
            // a mirroring instance mirrors the ray too, so the sign of the determinant keeps its
            // meaning
            front: self.determinant > 0.0,
            flags: self.reference & !INDEX_MASK,
        }
    }
}
