//! Traversal: nearest hit and transmittance along a segment.
//!
//! ```text
//! while something is postponed, nearest first:
//!     node       test the ray against 8 boxes; go on with the nearest, postpone the others
//!     block      test the ray against 8 triangles
//!     instance   move the ray into the instance's space and go on with its tree
//! ```
//!
//! Departures from the simple version: near and far planes are picked by the ray's signs, not by min and max; distances are one fused
//! multiply-add, b/d − o/d; what is postponed is kept sorted with its distance and dropped when a nearer hit is known; the whole loop
//! is one function compiled for the instruction set. An unsorted loop serves where any hit will do.
//!
//! Tried on FlightHelmet and not to be told from this by a measurement that scattered by 10 to 30 %: no prefetch or that of the nearest child alone, trees collapsed
//! by dynamic programming over surface area with blocks at 0.6 to 2.5 nodes, boxes of large triangles left whole, all nodes reinserted.
//!
//! The triangle test is the watertight one of Woop, Benthin, Wald 2013 ("Watertight ray/triangle intersection", JCGT 2(1)): shear
//! the triangle into a space where the ray is the z axis and compare edge functions with zero. Shared edges give exactly opposite
//! values, so a ray cannot pass between two triangles. The edge functions therefore must not be fused: a·b − c·d with one product
//! rounded and the other not is not the opposite of c·d − a·b. Boxes are widened by the rounding of the slab test, see
//! [`SLAB_ROUNDING`].

use glam::Vec3;

use super::lanes::{InstructionSet, Lanes, Portable, WIDTH};
use super::{Block, Bvh, CULL_BACK, EMPTY, Hit, INDEX_MASK, INSTANCE, LEAF, NO_INSTANCE, Node, Ray};

/// Direction components below this are replaced by it in the slab test, so that 0 · ∞ cannot occur.
const SMALLEST_SLOPE: f32 = 1e-18;
/// Rounding of b/d − o/d as a share of (|o| + |b|)/|d|: half an epsilon each for 1/d, o/d and the result, and as much again for boxes
/// of cut triangles, whose corners are rounded.
const SLAB_ROUNDING: f32 = 4.0 * f32::EPSILON;

/// Reusable memory for postponed children: the distance's bits above, the child below, so that numbers sort as distances do.
pub(crate) struct Stack(Vec<u64>);

/// Above the last entry of an instance; read as a distance it is −∞, so that it is never dropped.
const END_OF_INSTANCE: u64 = (f32::NEG_INFINITY.to_bits() as u64) << 32 | EMPTY as u64;

/// The longest axis, by whether x is longer than y, x than z and y than z, one bit each.
const LONGEST: [usize; 8] = [2, 2, 2, 0, 1, 2, 1, 0];
/// The axes that follow an axis when the ray runs up it and when it runs down it: exchanged, which keeps the winding.
const OTHERS: [[usize; 2]; 6] = [[1, 2], [2, 1], [2, 0], [0, 2], [0, 1], [1, 0]];

/// A ray prepared for the slab and triangle tests.
#[derive(Clone, Copy)]
struct Prepared<V> {
    inverse: [V; 3],
    /// −o/d, less and plus the rounding.
    near_shift: [V; 3],
    far_shift: [V; 3],
    /// Index of the near and the far plane per axis in [`Node::bounds`].
    near: [usize; 3],
    far: [usize; 3],
    /// Axes of the triangle test: the last is the one along which the ray is longest.
    axes: [usize; 3],
    /// Origin along these axes.
    origin: [V; 3],
    shear: [V; 3],
}

/// Result of the triangle test, one lane per triangle.
struct Test<V> {
    t: V,
    u: V,
    v: V,
    determinant: V,
}

impl Bvh {
    /// Memory for traversals of this tree.
    pub(crate) fn stack(&self) -> Stack {
        Stack(vec![0; self.stack_depth + 1])
    }

    /// The nearest hit that `accept` agrees to. It is asked only for triangles with flags other than [`CULL_BACK`], in any order and
    /// at most once per triangle and instance.
    #[inline]
    pub(crate) fn nearest(&self, ray: &Ray, stack: &mut Stack, accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        // SAFETY: an `InstructionSet` is only made where the machine has it
        unsafe {
            match self.set {
                InstructionSet::Portable => self.nearest_in::<Portable>(ray, stack, accept),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx2 => self.nearest_avx2(ray, stack, accept),
                #[cfg(target_arch = "aarch64")]
                InstructionSet::Neon => self.nearest_in::<super::lanes::neon::Neon>(ray, stack, accept),
                #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
                InstructionSet::Simd128 => self.nearest_in::<super::lanes::wasm::Simd128>(ray, stack, accept),
            }
        }
    }

    /// Product of `transmittance` over all triangles that the segment crosses; it is asked only for triangles with flags other than
    /// [`CULL_BACK`], at most once each; the others are opaque. Stops at zero.
    #[inline]
    pub(crate) fn transmittance(&self, ray: &Ray, stack: &mut Stack, transmittance: impl FnMut(&Hit) -> Vec3) -> Vec3 {
        // SAFETY: an `InstructionSet` is only made where the machine has it
        unsafe {
            match self.set {
                InstructionSet::Portable => self.transmittance_in::<Portable>(ray, stack, transmittance),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx2 => self.transmittance_avx2(ray, stack, transmittance),
                #[cfg(target_arch = "aarch64")]
                InstructionSet::Neon => self.transmittance_in::<super::lanes::neon::Neon>(ray, stack, transmittance),
                #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
                InstructionSet::Simd128 => {
                    self.transmittance_in::<super::lanes::wasm::Simd128>(ray, stack, transmittance)
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn nearest_avx2(&self, ray: &Ray, stack: &mut Stack, accept: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        // SAFETY: passed on from the caller
        unsafe { self.nearest_in::<super::lanes::x86::Avx2>(ray, stack, accept) }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn transmittance_avx2(&self, ray: &Ray, stack: &mut Stack, transmittance: impl FnMut(&Hit) -> Vec3) -> Vec3 {
        // SAFETY: passed on from the caller
        unsafe { self.transmittance_in::<super::lanes::x86::Avx2>(ray, stack, transmittance) }
    }

    /// Asks for a child's memory, which a ray waits for more than for anything else; sorting its siblings hides a part of that.
    #[inline(always)]
    fn prefetch(&self, child: u32) {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let base = if child & LEAF == 0 {
                self.nodes.as_ptr().wrapping_add(child as usize).cast::<i8>()
            } else {
                self.blocks.as_ptr().wrapping_add((child & !(LEAF | INSTANCE)) as usize).cast::<i8>()
            };
            // SAFETY: a prefetch may name any address, and every x86-64 has the instruction
            unsafe {
                _mm_prefetch::<_MM_HINT_T0>(base);
                _mm_prefetch::<_MM_HINT_T0>(base.wrapping_add(64));
                _mm_prefetch::<_MM_HINT_T0>(base.wrapping_add(128));
                _mm_prefetch::<_MM_HINT_T0>(base.wrapping_add(192));
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = child;
    }

    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    pub(super) unsafe fn nearest_in<V: Lanes>(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        mut accept: impl FnMut(&Hit) -> bool,
    ) -> Option<Hit> {
        if self.root == EMPTY {
            return None;
        }
        assert!(stack.0.len() > self.stack_depth, "a stack of another tree");
        // SAFETY: the caller has the instruction set. Child references point into the arrays they were made with, and no more than
        // `stack_depth` children are ever postponed, which `build` counts and the assertion above checks.
        unsafe {
            let mut prepared = Prepared::<V>::new(ray, self.extent);
            let mut instance = NO_INSTANCE;
            let postponed = stack.0.as_mut_ptr();
            let mut depth = 0;
            let mut nearest: Option<Hit> = None;
            let mut t_max = ray.t_max;
            let mut current = self.root;
            // the next of the postponed that is not behind the nearest hit
            macro_rules! pop {
                () => {
                    loop {
                        if depth == 0 {
                            return nearest;
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
                // a loop of its own, so that what nodes need stays in registers rather than what blocks need
                while current & LEAF == 0 {
                    let node = self.nodes.get_unchecked(current as usize);
                    let (t_near, mut hits) = prepared.enters(node, t_max);
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
                    let t_near = t_near.store();
                    self.prefetch(current);
                    let one = u64::from(t_near.get_unchecked(first).to_bits()) << 32 | u64::from(current);
                    macro_rules! next {
                        () => {{
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            let child = *node.children.get_unchecked(lane);
                            self.prefetch(child);
                            u64::from(t_near.get_unchecked(lane).to_bits()) << 32 | u64::from(child)
                        }};
                    }
                    // which child is nearer is a coin toss: two and three are sorted without branches
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
                if current & INSTANCE == 0 {
                    let block = self.blocks.get_unchecked((current & !LEAF) as usize);
                    let (mut hits, test) = prepared.meets(block, t_max);
                    if hits != 0 {
                        let test = Test {
                            t: test.t.store(),
                            u: test.u.store(),
                            v: test.v.store(),
                            determinant: test.determinant.store(),
                        };
                        while hits != 0 {
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            if test.t[lane] < t_max {
                                let hit = test.hit(lane, block.references[lane], instance);
                                if hit.is_visible() && (hit.flags & !CULL_BACK == 0 || accept(&hit)) {
                                    t_max = hit.t;
                                    nearest = Some(hit);
                                }
                            }
                        }
                    }
                } else if current == EMPTY {
                    prepared = Prepared::new(ray, self.extent);
                    instance = NO_INSTANCE;
                } else {
                    let placed = self.instances.get_unchecked((current & !(LEAF | INSTANCE)) as usize);
                    prepared = Prepared::new(&placed.tree_ray(ray), placed.extent);
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
    pub(super) unsafe fn transmittance_in<V: Lanes>(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        mut transmittance: impl FnMut(&Hit) -> Vec3,
    ) -> Vec3 {
        let mut product = Vec3::ONE;
        if self.root == EMPTY {
            return product;
        }
        assert!(stack.0.len() > self.stack_depth, "a stack of another tree");
        // SAFETY: as in `nearest_in`
        unsafe {
            let mut prepared = Prepared::<V>::new(ray, self.extent);
            let mut instance = NO_INSTANCE;
            let postponed = stack.0.as_mut_ptr();
            let mut depth = 0;
            let mut current = self.root;
            loop {
                while current & LEAF == 0 {
                    let node = self.nodes.get_unchecked(current as usize);
                    let (_, mut hits) = prepared.enters(node, ray.t_max);
                    if hits == 0 {
                        if depth == 0 {
                            return product;
                        }
                        depth -= 1;
                        current = *postponed.add(depth) as u32;
                        continue;
                    }
                    current = *node.children.get_unchecked(hits.trailing_zeros() as usize);
                    hits &= hits - 1;
                    while hits != 0 {
                        let lane = hits.trailing_zeros() as usize;
                        hits &= hits - 1;
                        *postponed.add(depth) = u64::from(*node.children.get_unchecked(lane));
                        depth += 1;
                    }
                }
                if current & INSTANCE == 0 {
                    let block = self.blocks.get_unchecked((current & !LEAF) as usize);
                    let (mut hits, test) = prepared.meets(block, ray.t_max);
                    if hits != 0 {
                        let test = Test {
                            t: test.t.store(),
                            u: test.u.store(),
                            v: test.v.store(),
                            determinant: test.determinant.store(),
                        };
                        while hits != 0 {
                            let lane = hits.trailing_zeros() as usize;
                            hits &= hits - 1;
                            let hit = test.hit(lane, block.references[lane], instance);
                            if hit.is_visible() {
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
                    prepared = Prepared::new(ray, self.extent);
                    instance = NO_INSTANCE;
                } else {
                    let placed = self.instances.get_unchecked((current & !(LEAF | INSTANCE)) as usize);
                    prepared = Prepared::new(&placed.tree_ray(ray), placed.extent);
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

impl super::Placed {
    /// The same points at the same t in the space of the tree.
    #[inline(always)]
    fn tree_ray(&self, ray: &Ray) -> Ray {
        // the difference first: it is exact where rounding would hurt, close to the instance
        Ray {
            origin: self.tree_from_render * (ray.origin - self.translation),
            direction: self.tree_from_render * ray.direction,
            t_max: ray.t_max,
        }
    }
}

impl Hit {
    #[inline(always)]
    fn is_visible(&self) -> bool {
        self.front || self.flags & CULL_BACK == 0
    }
}

// SAFETY of every block and function below: the callers have `V`'s instruction set
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Prepared<V> {
    /// `extent`: largest coordinate of the tree's bounds.
    #[inline(always)]
    unsafe fn new(ray: &Ray, extent: f32) -> Self {
        let d = ray.direction.to_array();
        let o = ray.origin.to_array();
        let magnitude = d.map(f32::abs);
        // looked up: which axis is the longest is another coin toss
        let greater = |a: usize, b: usize| usize::from(magnitude[a] > magnitude[b]);
        let z = LONGEST[greater(0, 1) | greater(0, 2) << 1 | greater(1, 2) << 2];
        let [x, y] = OTHERS[2 * z + usize::from(d[z] < 0.0)];
        let inverse = d.map(|c| 1.0 / if c.abs() < SMALLEST_SLOPE { SMALLEST_SLOPE.copysign(c) } else { c });
        let shift: [f32; 3] = std::array::from_fn(|axis| -o[axis] * inverse[axis]);
        let rounding: [f32; 3] =
            std::array::from_fn(|axis| SLAB_ROUNDING * (o[axis].abs() + extent) * inverse[axis].abs());
        let near: [usize; 3] = std::array::from_fn(|axis| if inverse[axis] < 0.0 { axis + 3 } else { axis });
        let along_z = 1.0 / d[z];
        // written out: a closure would not have the instruction set, and the vector operations in it would become calls
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
                far: near.map(|plane| if plane < 3 { plane + 3 } else { plane - 3 }),
                axes: [x, y, z],
                origin: [V::splat(o[x]), V::splat(o[y]), V::splat(o[z])],
                shear: [V::splat(d[x] * along_z), V::splat(d[y] * along_z), V::splat(along_z)],
            }
        }
    }

    /// Distances to the near plane of an axis of eight boxes.
    #[inline(always)]
    unsafe fn near(&self, node: &Node, axis: usize) -> V {
        unsafe {
            V::load(node.bounds.get_unchecked(self.near[axis])).mul_add(self.inverse[axis], self.near_shift[axis])
        }
    }

    /// As [`near`](Self::near), the far plane.
    #[inline(always)]
    unsafe fn far(&self, node: &Node, axis: usize) -> V {
        unsafe { V::load(node.bounds.get_unchecked(self.far[axis])).mul_add(self.inverse[axis], self.far_shift[axis]) }
    }

    /// A vertex of eight triangles in the space where the ray starts at the origin and is the z axis; z is not scaled yet.
    #[inline(always)]
    unsafe fn sheared(&self, block: &Block, vertex: usize) -> (V, V, V) {
        unsafe {
            let axes = &block.vertices[vertex];
            let x = V::load(axes.get_unchecked(self.axes[0])).sub(self.origin[0]);
            let y = V::load(axes.get_unchecked(self.axes[1])).sub(self.origin[1]);
            let z = V::load(axes.get_unchecked(self.axes[2])).sub(self.origin[2]);
            (self.shear[0].neg_mul_add(z, x), self.shear[1].neg_mul_add(z, y), z)
        }
    }

    /// Distances at which the ray enters eight boxes, and a bit per box that it enters before `t_max`.
    #[inline(always)]
    unsafe fn enters(&self, node: &Node, t_max: f32) -> (V, u32) {
        unsafe {
            let entry = self.near(node, 0).max(self.near(node, 1)).max(self.near(node, 2).max(V::splat(0.0)));
            let exit = self.far(node, 0).min(self.far(node, 1)).min(self.far(node, 2).min(V::splat(t_max)));
            (entry, V::bits(entry.at_most(exit)))
        }
    }

    /// Tests eight triangles; a bit per triangle that is met at 0 < t < `t_max`.
    #[inline(always)]
    unsafe fn meets(&self, block: &Block, t_max: f32) -> (u32, Test<V>) {
        unsafe {
            let (ax, ay, az) = self.sheared(block, 0);
            let (bx, by, bz) = self.sheared(block, 1);
            let (cx, cy, cz) = self.sheared(block, 2);
            let u = cx.mul(by).sub(cy.mul(bx));
            let v = ax.mul(cy).sub(ay.mul(cx));
            let w = bx.mul(ay).sub(by.mul(ax));
            let zero = V::splat(0.0);
            let low = u.min(v).min(w);
            let high = u.max(v).max(w);
            let determinant = u.add(v).add(w);
            let turned = V::either(determinant.below(zero), zero.below(determinant));
            let inside = V::both(V::either(zero.at_most(low), high.at_most(zero)), turned);
            if V::bits(inside) == 0 {
                return (0, Test { t: zero, u, v, determinant });
            }
            let t = w.mul_add(cz, v.mul_add(bz, u.mul(az))).mul(self.shear[2]).div(determinant);
            let within = V::both(zero.below(t), t.below(V::splat(t_max)));
            (V::bits(V::both(inside, within)), Test { t, u, v, determinant })
        }
    }
}

impl Test<[f32; WIDTH]> {
    #[inline(always)]
    fn hit(&self, lane: usize, reference: u32, instance: u32) -> Hit {
        let scale = 1.0 / self.determinant[lane];
        let (u, v) = (self.u[lane] * scale, self.v[lane] * scale);
        Hit {
            t: self.t[lane],
            triangle: reference & INDEX_MASK,
            instance,
            barycentric: [u, v, 1.0 - u - v],
            // a mirroring instance mirrors ray and triangle alike
            front: self.determinant[lane] > 0.0,
            flags: reference & !INDEX_MASK,
        }
    }
}
