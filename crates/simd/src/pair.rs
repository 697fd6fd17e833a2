//! Two vectors that act as one vector of twice as many lanes, for kernels that need a certain
//! number of lanes.

use crate::lanes::{Kernel, Lanes};

/// Two vectors that act as one vector of twice as many lanes.
#[derive(Clone, Copy, Debug)]
pub struct Pair<V>([V; 2]);

// SAFETY of every block below: the caller guarantees the conditions of both vectors. The second
// vector's elements follow the first's, from `V::COUNT` on.
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Pair<V> {
    #[inline(always)]
    unsafe fn zip(self, other: Self, f: unsafe fn(V, V) -> V) -> Self {
        unsafe { Self([f(self.0[0], other.0[0]), f(self.0[1], other.0[1])]) }
    }

    #[inline(always)]
    unsafe fn zip_three(self, other: Self, third: Self, f: unsafe fn(V, V, V) -> V) -> Self {
        unsafe { Self([f(self.0[0], other.0[0], third.0[0]), f(self.0[1], other.0[1], third.0[1])]) }
    }
}

// SAFETY of every block below: the caller guarantees the conditions of both vectors. The second
// vector's elements follow the first's, from `V::COUNT` on.
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl<V: Lanes> Lanes for Pair<V> {
    type Mask = [V::Mask; 2];
    const COUNT: usize = 2 * V::COUNT;
    const REGISTERS: usize = V::REGISTERS / 2;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        unsafe { Self([V::splat(value); 2]) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        unsafe { Self([V::load(from), V::load(from.add(V::COUNT))]) }
    }

    #[inline(always)]
    unsafe fn load_half(from: *const u16) -> Self {
        unsafe { Self([V::load_half(from), V::load_half(from.add(V::COUNT))]) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe {
            self.0[0].store(to);
            self.0[1].store(to.add(V::COUNT));
        }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        unsafe { self.zip(other, V::add) }
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        unsafe { self.zip(other, V::sub) }
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        unsafe { self.zip(other, V::mul) }
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        unsafe { self.zip(other, V::div) }
    }

    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        unsafe { self.zip(other, V::min) }
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        unsafe { self.zip(other, V::max) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        unsafe { self.zip_three(factor, addend, V::mul_add) }
    }

    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        unsafe { self.zip_three(factor, addend, V::neg_mul_add) }
    }

    #[inline(always)]
    unsafe fn fused_mul_add(self, factor: Self, addend: Self) -> Self {
        unsafe { self.zip_three(factor, addend, V::fused_mul_add) }
    }

    #[inline(always)]
    unsafe fn fused_neg_mul_add(self, factor: Self, addend: Self) -> Self {
        unsafe { self.zip_three(factor, addend, V::fused_neg_mul_add) }
    }

    #[inline(always)]
    unsafe fn at_most(self, other: Self) -> Self::Mask {
        unsafe { [self.0[0].at_most(other.0[0]), self.0[1].at_most(other.0[1])] }
    }

    #[inline(always)]
    unsafe fn below(self, other: Self) -> Self::Mask {
        unsafe { [self.0[0].below(other.0[0]), self.0[1].below(other.0[1])] }
    }

    #[inline(always)]
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { [V::both(a[0], b[0]), V::both(a[1], b[1])] }
    }

    #[inline(always)]
    unsafe fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { [V::either(a[0], b[0]), V::either(a[1], b[1])] }
    }

    #[inline(always)]
    unsafe fn where_else(self, mask: Self::Mask, other: Self) -> Self {
        unsafe { Self([self.0[0].where_else(mask[0], other.0[0]), self.0[1].where_else(mask[1], other.0[1])]) }
    }

    #[inline(always)]
    unsafe fn bits(mask: Self::Mask) -> u32 {
        unsafe { V::bits(mask[0]) | V::bits(mask[1]) << V::COUNT }
    }

    #[inline(always)]
    unsafe fn call<K: Kernel>(args: K::Args<'_>) -> K::Output {
        unsafe { K::run::<Self>(args) }
    }
}
