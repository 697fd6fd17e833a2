//! Loads and stores of vectors in slices.

use lumistack_simd::{Lanes, MAX_LANES};

/// The lanes of one vector, padded with zeros: the form in which functions of different instruction
/// sets exchange vectors.
pub(crate) type Vector = [f32; MAX_LANES];

/// Loads the vector that begins at `at`.
///
/// # Safety
/// The machine has `V`'s instruction set, and `at` + COUNT is at most the length.
#[inline(always)]
pub(crate) unsafe fn load<V: Lanes>(from: &[f32], at: usize) -> V {
    debug_assert!(at + V::COUNT <= from.len(), "{at} + {} > {}", V::COUNT, from.len());
    // SAFETY: the caller guarantees the range
    unsafe { V::load(from.as_ptr().add(at)) }
}

/// Stores a vector in `to`, from index `at` on.
///
/// # Safety
/// The machine has `V`'s instruction set, and `at` + COUNT is at most the length of `to`.
#[inline(always)]
pub(crate) unsafe fn store<V: Lanes>(vector: V, to: &mut [f32], at: usize) {
    debug_assert!(at + V::COUNT <= to.len(), "{at} + {} > {}", V::COUNT, to.len());
    // SAFETY: the caller guarantees the range
    unsafe { vector.store(to.as_mut_ptr().add(at)) }
}

/// Returns a vector with 1 in the lanes low..high and 0 in all other lanes.
///
/// # Safety
/// The machine has `V`'s instruction set; low and high are at most COUNT.
#[inline(always)]
// The table has zeros, ones and zeros. One window of the table masks one end of the vector, and the
// product of two windows masks both ends.
pub(crate) unsafe fn mask<V: Lanes>(low: usize, high: usize) -> V {
    static STEPS: [f32; 3 * MAX_LANES] = {
        let mut steps = [0.0; 3 * MAX_LANES];
        let mut i = MAX_LANES;
        while i < 2 * MAX_LANES {
            steps[i] = 1.0;
            i += 1;
        }
        steps
    };
    // SAFETY: low and high are at most V::COUNT ≤ MAX_LANES
    unsafe { load::<V>(&STEPS, MAX_LANES - low).mul(load::<V>(&STEPS, 2 * MAX_LANES - high)) }
}

/// Returns the sum of all lanes, in f64.
///
/// # Safety
/// The machine has `V`'s instruction set.
#[inline(always)]
pub(crate) unsafe fn sum<V: Lanes>(vector: V) -> f64 {
    let mut lanes = Vector::default();
    // SAFETY: a vector has at most MAX_LANES lanes
    unsafe { vector.store(lanes.as_mut_ptr()) };
    sum_of(&lanes[..V::COUNT])
}

/// Returns the sum of lanes, in f64; their number is a multiple of four.
///
/// The additions form four chains, since in a single chain each addition would wait for the
/// previous one.
pub(crate) fn sum_of(lanes: &[f32]) -> f64 {
    let mut sums = [0.0; 4];
    for part in lanes.as_chunks::<4>().0 {
        sums.iter_mut().zip(part).for_each(|(sum, &lane)| *sum += f64::from(lane));
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// Adds `other` to `sum` lane by lane.
pub(crate) fn add(sum: &mut Vector, other: &Vector) {
    sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
}
