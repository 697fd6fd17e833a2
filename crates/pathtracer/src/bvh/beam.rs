//! Traversal by a beam: the nearest hits of rays that start and run close together, as the samples
//! of one pixel do.
//!
//! The rays' points at distance t lie in the box o₀ + t d₀ ..= o₁ + t d₁. Here o₀ and o₁ are the
//! least and the greatest coordinates of the rays' origins. The least and the greatest coordinates
//! of their directions are d₀ and d₁. The box of the rays' points overlaps a child's bounds b₀ ..=
//! b₁ along an axis while
//!
//! ```text
//! o₁ + t d₁ ≥ b₀   and   o₀ + t d₀ ≤ b₁
//! ```
//!
//! Each of the two inequalities bounds t from below or from above, by the sign of its d₁ or d₀. So
//! a node costs the beam as much as it costs a single ray.
//!
//! A block's eight triangles are tested against the beam as boxes too. The triangles that the beam
//! may hit, mostly one or two, are tested against all rays together, one ray per lane. Single rays
//! are tested with the same arithmetic, so the hits are equal bit for bit. The test requires that
//! the directions of all rays have their largest component along the same axis, with the same sign.
//! For neighbouring rays this is nearly always true. A beam that spreads over many blocks, for
//! example out of focus, is split into single rays.
//!
//! On the scene FlightHelmet, with 16 samples of a pixel, beams took 60 % of the time of single
//! rays. Beams that tested each block ray by ray took as long as single rays.

use std::marker::PhantomData;

use lumistack_simd::{Kernel, Lanes};

use super::traverse::{Corners, Edges, SLAB_ROUNDING, SMALLEST_SLOPE, Shear, Stack, Test, eight};
use super::tree::{Block, Bvh, CULL_BACK, EMPTY, Hit, INDEX_MASK, LEAF, NO_INSTANCE, Ray, WIDTH};

/// Largest number of rays of a beam.
pub(crate) const BEAM: usize = 16;
/// Number of vectors that hold one value of every ray, one ray per lane.
const VECTORS: usize = BEAM / WIDTH;
/// Fewer rays than this are traced one by one.
const FEWEST: usize = 3;
/// Number of blocks after which the rays of a beam are traced one by one. A limit of 6 is 3 %
/// slower in focus, a limit of 16 is 3 % slower out of focus (FlightHelmet).
const MOST_BLOCKS: usize = 10;

/// Eight bounds on the distance t, one per box: plane · inverse + shift. `row` is the index of the
/// first of the eight planes in [`Node::bounds`], read as one list.
#[derive(Clone, Copy)]
struct Bound<V> {
    row: usize,
    inverse: V,
    shift: V,
}

/// Bounds on the distances t at which a beam's rays may be inside a box: `near` from below, `far`
/// from above.
struct Beam<V> {
    near: [Bound<V>; 6],
    near_count: usize,
    far: [Bound<V>; 6],
    far_count: usize,
}

impl Bvh {
    /// Computes the nearest hits of at most [`BEAM`] rays of unlimited length, as
    /// [`nearest`](Self::nearest) does for one ray. `accept` gets the index of the ray, and may be
    /// called twice for a triangle.
    #[inline]
    pub(crate) fn nearest_of_beam(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>; BEAM],
        stack: &mut Stack,
        accept: impl FnMut(usize, &Hit) -> bool,
    ) {
        if rays.len() < FEWEST || !self.instances.is_empty() {
            *hits = [None; BEAM];
            return self.alone(rays, hits, stack, accept);
        }
        // SAFETY: the kernel makes no demands
        unsafe { self.backend.call_eight::<NearestOfBeam<_>>((self, rays, hits, stack, accept)) }
    }

    /// Traces the rays one by one. A ray with a hit in `hits` searches only for nearer hits.
    fn alone(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>; BEAM],
        stack: &mut Stack,
        mut accept: impl FnMut(usize, &Hit) -> bool,
    ) {
        for (index, (ray, hit)) in rays.iter().zip(hits).enumerate() {
            let ray = Ray { t_max: hit.map_or(ray.t_max, |hit| hit.t), ..*ray };
            *hit = self.nearest(&ray, stack, |hit| accept(index, hit)).or(*hit);
        }
    }

    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    unsafe fn beam_in<V: Lanes>(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>; BEAM],
        stack: &mut Stack,
        mut accept: impl FnMut(usize, &Hit) -> bool,
    ) {
        assert!(rays.len() <= BEAM, "expected at most {BEAM} rays in a beam, found {}", rays.len());
        *hits = [None; BEAM];
        if self.root == EMPTY || rays.is_empty() {
            return;
        }
        assert!(stack.0.len() > self.stack_depth, "expected a stack of this tree, found a smaller stack");
        let shear = Shear::new(&rays[0]);
        if !rays.iter().all(|ray| shear.has_axes_of(ray)) {
            return self.alone(rays, hits, stack, accept);
        }
        // the distance of the farthest of the nearest hits; infinite while a ray has no hit
        let mut t_max = f32::INFINITY;
        // SAFETY: the caller has the instruction set. Child references point into the arrays they
        // were made with. No more than `stack_depth` children are ever postponed, which `build`
        // counts and the assertion above checks.
        unsafe {
            let beam = Beam::<V>::new(rays, self.extent);
            let mut sheared = Sheared::<V>::new(rays, &shear);
            let (arrays, postponed) = (self.arrays(), stack.0.as_mut_ptr());
            *postponed = u64::from(self.root);
            let mut depth = 1;
            let mut blocks = 0;
            while depth > 0 {
                // take the last postponed child, and drop it if every ray has a nearer hit
                depth -= 1;
                let next = *postponed.add(depth);
                if f32::from_bits((next >> 32) as u32) >= t_max {
                    continue;
                }
                let current = next as u32;
                if current & LEAF == 0 {
                    let node = arrays.nodes.get_unchecked(current as usize);
                    // postpone the children that the beam enters, the nearest last, so that it is
                    // taken first
                    let (t_near, mut entered) = beam.enters(&node.bounds, t_max);
                    let t_near: [f32; WIDTH] = t_near.to_array();
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
                    continue;
                }
                blocks += 1;
                if blocks > MOST_BLOCKS {
                    sheared.write(hits);
                    return self.alone(rays, hits, stack, accept);
                }
                // test all rays against the triangles whose boxes the beam enters
                let block = arrays.blocks.get_unchecked((current & !LEAF) as usize);
                let (_, mut entered) = beam.enters(&bounds::<V>(block), t_max);
                let mut is_nearer = false;
                while entered != 0 {
                    let lane = entered.trailing_zeros() as usize;
                    entered &= entered - 1;
                    is_nearer |= sheared.intersect(block, lane, &mut accept);
                }
                if is_nearer {
                    t_max = sheared.farthest();
                }
            }
            sheared.write(hits);
        }
    }
}

/// The kernel that [`Bvh::nearest_of_beam`] runs for at least [`FEWEST`] rays, if the tree has no
/// instances. `F` is the type of that function's argument `accept`.
pub(super) struct NearestOfBeam<F>(PhantomData<F>);

impl<F: FnMut(usize, &Hit) -> bool> Kernel for NearestOfBeam<F> {
    type Args<'a> = (&'a Bvh, &'a [Ray], &'a mut [Option<Hit>; BEAM], &'a mut Stack, F);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((bvh, rays, hits, stack, accept): Self::Args<'_>) {
        // SAFETY: the caller guarantees that the machine has the instruction set
        unsafe { bvh.beam_in::<V>(rays, hits, stack, accept) }
    }
}

/// The rays of a beam prepared for the triangle test, one per lane, and the nearest hit of each.
/// The directions of all rays have their largest component along the same axis.
struct Sheared<V> {
    /// Rows of the axes in a block, see [`Shear::axes`].
    axes: [usize; 3],
    /// Number of rays.
    count: usize,
    /// Number of vectors that hold a ray.
    vectors: usize,
    /// Values of [`Shear::origin`] and [`Shear::shear`] for every ray.
    origin: [[V; 3]; VECTORS],
    shear: [[V; 3]; VECTORS],
    t: [V; VECTORS],
    u: [V; VECTORS],
    v: [V; VECTORS],
    determinant: [V; VECTORS],
    references: [u32; BEAM],
}

/// Returns the bounds of eight triangles, arranged like the bounds of a node's children.
///
/// # Safety
/// The machine has `V`'s instruction set.
#[inline(always)]
unsafe fn bounds<V: Lanes>(block: &Block) -> [[f32; WIDTH]; 6] {
    let mut bounds = [[0.0; WIDTH]; 6];
    for axis in 0..3 {
        // SAFETY: the caller has the instruction set
        unsafe {
            let [a, b, c] = [
                V::from_array(&block.vertices[0][axis]),
                V::from_array(&block.vertices[1][axis]),
                V::from_array(&block.vertices[2][axis]),
            ];
            bounds[axis] = a.min(b).min(c).to_array();
            bounds[axis + 3] = a.max(b).max(c).to_array();
        }
    }
    bounds
}

// SAFETY of every block and function below: the callers have `V`'s instruction set
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Sheared<V> {
    /// Prepares the rays for the triangle test. `shear` is the [`Shear`] of the first ray.
    #[inline(always)]
    unsafe fn new(rays: &[Ray], shear: &Shear) -> Self {
        // collect the rays' coordinates in the order of the shear's axes, the longest axis last
        let axes = shear.axes.map(|row| row / WIDTH);
        let (mut origins, mut directions) = ([[0.0; BEAM]; 3], [[1.0; BEAM]; 3]);
        for (index, ray) in rays.iter().enumerate() {
            let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
            for (row, &axis) in axes.iter().enumerate() {
                origins[row][index] = origin[axis];
                directions[row][index] = direction[axis];
            }
        }
        // lanes without a ray never hit
        let mut t_max = [-1.0; BEAM];
        t_max[..rays.len()].fill(f32::INFINITY);
        unsafe {
            let zero = V::splat(0.0);
            let mut sheared = Self {
                axes: shear.axes,
                count: rays.len(),
                vectors: rays.len().div_ceil(WIDTH),
                origin: [[zero; 3]; VECTORS],
                shear: [[zero; 3]; VECTORS],
                t: [zero; VECTORS],
                u: [zero; VECTORS],
                v: [zero; VECTORS],
                determinant: [zero; VECTORS],
                references: [0; BEAM],
            };
            for vector in 0..VECTORS {
                let at = vector * WIDTH;
                let [x, y, z] = [
                    V::from_array(eight(&directions[0], at)),
                    V::from_array(eight(&directions[1], at)),
                    V::from_array(eight(&directions[2], at)),
                ];
                // each lane has a shear that turns the lane's ray into the z axis
                let along = V::splat(1.0).div(z);
                sheared.shear[vector] = [x.mul(along), y.mul(along), along];
                sheared.origin[vector] = [
                    V::from_array(eight(&origins[0], at)),
                    V::from_array(eight(&origins[1], at)),
                    V::from_array(eight(&origins[2], at)),
                ];
                sheared.t[vector] = V::from_array(eight(&t_max, at));
            }
            sheared
        }
    }

    /// Returns a triangle's corners for each of eight rays, sheared so that the ray is the z axis.
    #[inline(always)]
    unsafe fn corners(&self, vector: usize, [a, b, c]: &[[f32; 3]; 3]) -> Corners<V> {
        unsafe {
            let [origin, shear] = [&self.origin[vector], &self.shear[vector]];
            Corners([
                Corners::corner([V::splat(a[0]), V::splat(a[1]), V::splat(a[2])], origin, shear),
                Corners::corner([V::splat(b[0]), V::splat(b[1]), V::splat(b[2])], origin, shear),
                Corners::corner([V::splat(c[0]), V::splat(c[1]), V::splat(c[2])], origin, shear),
            ])
        }
    }

    /// Tests all rays against one triangle. The arithmetic is the same as in the test of a single
    /// ray, so the hits are equal bit for bit. Returns true if the triangle becomes the nearest hit
    /// of any ray.
    #[inline(always)]
    unsafe fn intersect(&mut self, block: &Block, lane: usize, accept: &mut impl FnMut(usize, &Hit) -> bool) -> bool {
        unsafe {
            let vertex = |vertex: usize| {
                let rows = block.vertices[vertex].as_flattened();
                self.axes.map(|row| *rows.get_unchecked(row + lane))
            };
            // collect the triangle's corners in the order of the rays' axes
            let vertices = [vertex(0), vertex(1), vertex(2)];
            let reference = block.references[lane];
            let flags = reference & !INDEX_MASK;
            let zero = V::splat(0.0);
            let mut any = false;
            // test eight rays together, and keep the hits that are nearer than earlier hits
            for vector in 0..self.vectors {
                let corners = self.corners(vector, &vertices);
                let edges = corners.edges();
                if V::bits(edges.inside) == 0 {
                    continue;
                }
                let t = corners.distance(&edges, self.shear[vector][2]);
                let Edges { u, v, determinant, inside, .. } = edges;
                let within = V::both(zero.below(t), t.below(self.t[vector]));
                let mut nearer = V::both(inside, within);
                if flags & CULL_BACK != 0 {
                    nearer = V::both(nearer, zero.below(determinant));
                }
                let mut bits = V::bits(nearer);
                if bits == 0 {
                    continue;
                }
                // alpha and tint depend on the point, so `accept` decides for each ray
                if flags & !CULL_BACK != 0 {
                    let test = Test { t, u, v, determinant }.store();
                    let mut agreed = [0.0; WIDTH];
                    while bits != 0 {
                        let at = bits.trailing_zeros() as usize;
                        bits &= bits - 1;
                        let hit = test.hit(at, reference, NO_INSTANCE);
                        agreed[at] = f32::from(u8::from(accept(vector * WIDTH + at, &hit)));
                    }
                    nearer = V::both(nearer, zero.below(V::from_array(&agreed)));
                    bits = V::bits(nearer);
                }
                any |= bits != 0;
                self.t[vector] = t.where_else(nearer, self.t[vector]);
                self.u[vector] = u.where_else(nearer, self.u[vector]);
                self.v[vector] = v.where_else(nearer, self.v[vector]);
                self.determinant[vector] = determinant.where_else(nearer, self.determinant[vector]);
                while bits != 0 {
                    let at = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    self.references[vector * WIDTH + at] = reference;
                }
            }
            any
        }
    }

    /// Returns the distance of the farthest of the rays' nearest hits.
    #[inline(always)]
    unsafe fn farthest(&self) -> f32 {
        let mut farthest = self.t[0];
        unsafe {
            for &t in &self.t[1..] {
                farthest = farthest.max(t);
            }
            farthest.to_array::<WIDTH>().into_iter().fold(0.0, f32::max)
        }
    }

    /// Writes the nearest hits.
    #[inline(always)]
    unsafe fn write(&self, hits: &mut [Option<Hit>; BEAM]) {
        for vector in 0..self.vectors {
            let test = unsafe {
                Test { t: self.t[vector], u: self.u[vector], v: self.v[vector], determinant: self.determinant[vector] }
                    .store()
            };
            for lane in 0..WIDTH.min(self.count - vector * WIDTH) {
                let index = vector * WIDTH + lane;
                if test.t[lane] < f32::INFINITY {
                    hits[index] = Some(test.hit(lane, self.references[index], NO_INSTANCE));
                }
            }
        }
    }
}

#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Beam<V> {
    /// Prepares the bounds for a beam of `rays`. `extent` is the largest coordinate of the tree's
    /// bounds.
    #[inline(always)]
    unsafe fn new(rays: &[Ray], extent: f32) -> Self {
        // find the least and the greatest coordinates of all rays
        let (mut low, mut high) = ((rays[0].origin, rays[0].direction), (rays[0].origin, rays[0].direction));
        for ray in &rays[1..] {
            low = (low.0.min(ray.origin), low.1.min(ray.direction));
            high = (high.0.max(ray.origin), high.1.max(ray.direction));
        }
        let none = unsafe { Bound { row: 0, inverse: V::splat(0.0), shift: V::splat(0.0) } };
        let mut beam = Self { near: [none; 6], near_count: 0, far: [none; 6], far_count: 0 };
        for axis in 0..3 {
            // A box's low planes are compared with the greatest coordinates of the rays, and its
            // high planes with the least.
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

    /// Returns for each of eight boxes a distance before which no ray is inside the box. Also
    /// returns a bit per box, which is set if a ray may be inside the box before `t_max`.
    #[inline(always)]
    unsafe fn enters(&self, boxes: &[[f32; WIDTH]; 6], t_max: f32) -> (V, u32) {
        unsafe {
            let planes = boxes.as_flattened();
            let mut entry = V::splat(0.0);
            for bound in self.near.get_unchecked(..self.near_count) {
                entry = entry.max(V::from_array(eight(planes, bound.row)).fused_mul_add(bound.inverse, bound.shift));
            }
            // If t_max is unlimited and the rays spread to all sides, nothing else limits the exit.
            // A child that does not exist is entered at infinity, and the limit `f32::MAX` keeps it
            // out.
            let mut exit = V::splat(t_max.min(f32::MAX));
            for bound in self.far.get_unchecked(..self.far_count) {
                exit = exit.min(V::from_array(eight(planes, bound.row)).fused_mul_add(bound.inverse, bound.shift));
            }
            (entry, V::bits(entry.at_most(exit)))
        }
    }
}
