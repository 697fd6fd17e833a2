//! Traversal by a beam: the nearest hits of rays that start and run close together, as the samples of one pixel do.
//!
//! The rays' points at distance t lie in the box o₀ + t d₀ ..= o₁ + t d₁, where o and d are the least and greatest coordinates of their
//! origins and directions. That box meets a child's bounds b₀ ..= b₁ along an axis while
//!
//! ```text
//! o₁ + t d₁ ≥ b₀   and   o₀ + t d₀ ≤ b₁
//! ```
//!
//! and each of the two bounds t from below or from above, by the sign of d. So a node costs the beam as much as it costs a ray, and only blocks
//! are tested ray by ray. A beam that spreads over many blocks, as out of focus, is given up and its rays go on alone.

use super::lanes::{InstructionSet, Lanes, Portable, WIDTH};
use super::traverse::{SLAB_ROUNDING, SMALLEST_SLOPE, Shear, eight};
use super::{Bvh, CULL_BACK, EMPTY, Hit, LEAF, NO_INSTANCE, Node, Ray, Stack};

/// The most rays of a beam.
pub(crate) const BEAM: usize = 16;
/// Fewer rays are traced alone.
const FEWEST: usize = 3;
/// Blocks after which the rays go on alone; 10 made no difference.
const MOST_BLOCKS: usize = 6;

/// A bound of t for eight boxes: plane · inverse + shift, `row` being the planes in [`Node::bounds`].
#[derive(Clone, Copy)]
struct Bound<V> {
    row: usize,
    inverse: V,
    shift: V,
}

/// Bounds of t from below and from above.
struct Beam<V> {
    near: [Bound<V>; 6],
    near_count: usize,
    far: [Bound<V>; 6],
    far_count: usize,
}

impl Bvh {
    /// The nearest hit of each of at most [`BEAM`] rays without an end, as [`nearest`](Self::nearest) finds it; `accept` is told which ray
    /// asks, and may be asked twice.
    #[inline]
    pub(crate) fn nearest_of_beam(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>; BEAM],
        stack: &mut Stack,
        mut accept: impl FnMut(usize, &Hit) -> bool,
    ) {
        if rays.len() < FEWEST || !self.instances.is_empty() {
            for (index, ray) in rays.iter().enumerate() {
                hits[index] = self.nearest(ray, stack, |hit| accept(index, hit));
            }
            return;
        }
        // SAFETY: an `InstructionSet` is only made where the machine has it
        unsafe {
            match self.set {
                InstructionSet::Portable => self.beam_in::<Portable>(rays, hits, stack, accept),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx2 => self.beam_avx2(rays, hits, stack, accept),
                #[cfg(target_arch = "aarch64")]
                InstructionSet::Neon => self.beam_in::<super::lanes::neon::Neon>(rays, hits, stack, accept),
                #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
                InstructionSet::Simd128 => self.beam_in::<super::lanes::wasm::Simd128>(rays, hits, stack, accept),
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn beam_avx2(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>; BEAM],
        stack: &mut Stack,
        accept: impl FnMut(usize, &Hit) -> bool,
    ) {
        // SAFETY: passed on from the caller
        unsafe { self.beam_in::<super::lanes::x86::Avx2>(rays, hits, stack, accept) }
    }

    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    pub(super) unsafe fn beam_in<V: Lanes>(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>; BEAM],
        stack: &mut Stack,
        mut accept: impl FnMut(usize, &Hit) -> bool,
    ) {
        assert!(rays.len() <= BEAM, "a beam of {} rays", rays.len());
        *hits = [None; BEAM];
        if self.root == EMPTY || rays.is_empty() {
            return;
        }
        assert!(stack.0.len() > self.stack_depth, "a stack of another tree");
        let mut shears = [Shear::new(&rays[0]); BEAM];
        shears.iter_mut().zip(rays).skip(1).for_each(|(shear, ray)| *shear = Shear::new(ray));
        let mut nearest = [f32::INFINITY; BEAM];
        // of all rays
        let mut t_max = f32::INFINITY;
        // SAFETY: the caller has the instruction set. Child references point into the arrays they were made with, and no more than
        // `stack_depth` children are ever postponed, which `build` counts and the assertion above checks.
        unsafe {
            let beam = Beam::<V>::new(rays, self.extent);
            let postponed = stack.0.as_mut_ptr();
            let mut depth = 0;
            let mut blocks = 0;
            let mut current = self.root;
            // the nearest of the postponed that is not behind all hits
            macro_rules! pop {
                () => {
                    loop {
                        if depth == 0 {
                            return;
                        }
                        depth -= 1;
                        let next = *postponed.add(depth);
                        if f32::from_bits((next >> 32) as u32) < t_max {
                            current = next as u32;
                            break;
                        }
                    }
                };
            }
            loop {
                while current & LEAF == 0 {
                    let node = self.nodes.get_unchecked(current as usize);
                    let (t_near, mut entered) = beam.enters(node, t_max);
                    let t_near = t_near.store();
                    let base = depth;
                    while entered != 0 {
                        let lane = entered.trailing_zeros() as usize;
                        entered &= entered - 1;
                        let entry = u64::from(t_near[lane].to_bits()) << 32 | u64::from(node.children[lane]);
                        let mut slot = depth;
                        while slot > base && *postponed.add(slot - 1) < entry {
                            *postponed.add(slot) = *postponed.add(slot - 1);
                            slot -= 1;
                        }
                        *postponed.add(slot) = entry;
                        depth += 1;
                    }
                    pop!();
                }
                let block = self.blocks.get_unchecked((current & !LEAF) as usize);
                t_max = 0.0;
                for (index, shear) in shears.iter().enumerate().take(rays.len()) {
                    let (mut met, test) = shear.meets::<V>(block, nearest[index]);
                    if met != 0 {
                        let test = test.store();
                        while met != 0 {
                            let lane = met.trailing_zeros() as usize;
                            met &= met - 1;
                            if test.t[lane] < nearest[index] {
                                let hit = test.hit(lane, block.references[lane], NO_INSTANCE);
                                if hit.is_visible() && (hit.flags & !CULL_BACK == 0 || accept(index, &hit)) {
                                    nearest[index] = hit.t;
                                    hits[index] = Some(hit);
                                }
                            }
                        }
                    }
                    t_max = t_max.max(nearest[index]);
                }
                blocks += 1;
                pop!();
                if blocks == MOST_BLOCKS {
                    for (index, ray) in rays.iter().enumerate() {
                        let ray = Ray { t_max: nearest[index], ..*ray };
                        let hit = self.nearest_in::<V, false>(&ray, stack, |hit| accept(index, hit));
                        hits[index] = hit.or(hits[index]);
                    }
                    return;
                }
            }
        }
    }
}

// SAFETY of every block and function below: the callers have `V`'s instruction set
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Beam<V> {
    /// `extent`: largest coordinate of the tree's bounds.
    #[inline(always)]
    unsafe fn new(rays: &[Ray], extent: f32) -> Self {
        let (mut low, mut high) = ((rays[0].origin, rays[0].direction), (rays[0].origin, rays[0].direction));
        for ray in &rays[1..] {
            low = (low.0.min(ray.origin), low.1.min(ray.direction));
            high = (high.0.max(ray.origin), high.1.max(ray.direction));
        }
        let none = unsafe { Bound { row: 0, inverse: V::splat(0.0), shift: V::splat(0.0) } };
        let mut beam = Self { near: [none; 6], near_count: 0, far: [none; 6], far_count: 0 };
        for axis in 0..3 {
            // the low planes against the greatest ray, the high ones against the least
            let against = [(high.0[axis], high.1[axis]), (low.0[axis], low.1[axis])];
            for (side, (origin, direction)) in against.into_iter().enumerate() {
                let direction =
                    if direction.abs() < SMALLEST_SLOPE { SMALLEST_SLOPE.copysign(direction) } else { direction };
                let inverse = 1.0 / direction;
                let (shift, rounding) = (-origin * inverse, SLAB_ROUNDING * (origin.abs() + extent) * inverse.abs());
                let is_near = (inverse > 0.0) == (side == 0);
                let shift = if is_near { shift - rounding } else { shift + rounding };
                let bound = unsafe {
                    Bound { row: (axis + 3 * side) * WIDTH, inverse: V::splat(inverse), shift: V::splat(shift) }
                };
                if is_near {
                    beam.near[beam.near_count] = bound;
                    beam.near_count += 1;
                } else {
                    beam.far[beam.far_count] = bound;
                    beam.far_count += 1;
                }
            }
        }
        beam
    }

    /// Distances from which on some ray may be in eight boxes, and a bit per box that is entered before `t_max`.
    #[inline(always)]
    unsafe fn enters(&self, node: &Node, t_max: f32) -> (V, u32) {
        unsafe {
            let planes = node.bounds.as_flattened();
            let mut entry = V::splat(0.0);
            for bound in self.near.get_unchecked(..self.near_count) {
                entry = entry.max(V::load(eight(planes, bound.row)).mul_add(bound.inverse, bound.shift));
            }
            // children that do not exist are entered at infinity, and a beam that spreads to all sides never leaves
            let mut exit = V::splat(t_max.min(f32::MAX));
            for bound in self.far.get_unchecked(..self.far_count) {
                exit = exit.min(V::load(eight(planes, bound.row)).mul_add(bound.inverse, bound.shift));
            }
            (entry, V::bits(entry.at_most(exit)))
        }
    }
}
