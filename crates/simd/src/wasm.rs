//! Four lanes of 128-bit vectors of WebAssembly. Its fixed-width set has no fused multiply-add.

use std::arch::wasm32::*;

use crate::half::float_from_half;
use crate::lanes::{Kernel, Lanes};

/// Four lanes of 128-bit vectors of WebAssembly. Its fixed-width set has no fused multiply-add.
#[derive(Clone, Copy, Debug)]
pub struct Simd128(v128);

pub(crate) unsafe fn run<K: Kernel>(args: K::Args<'_>) -> K::Output {
    // SAFETY: the caller guarantees the instruction set, and arguments as the kernel demands
    unsafe { K::run::<Simd128>(args) }
}

// SAFETY of every block below: the module is compiled for simd128; the trait's callers guarantee
// the memory
#[allow(clippy::undocumented_unsafe_blocks, unused_unsafe, reason = "one reason for all, above")]
impl Lanes for Simd128 {
    type Mask = v128;
    const COUNT: usize = 4;
    const REGISTERS: usize = 16;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self(unsafe { f32x4_splat(value) })
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        Self(unsafe { v128_load(from.cast()) })
    }

    #[inline(always)]
    unsafe fn load_half(from: *const u16) -> Self {
        let values = unsafe { from.cast::<[u16; 4]>().read_unaligned() }.map(float_from_half);
        unsafe { Self::load(values.as_ptr()) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe { v128_store(to.cast(), self.0) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        Self(unsafe { f32x4_add(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        Self(unsafe { f32x4_sub(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        Self(unsafe { f32x4_mul(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        Self(unsafe { f32x4_div(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        Self(unsafe { f32x4_pmin(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        Self(unsafe { f32x4_pmax(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { f32x4_add(f32x4_mul(self.0, factor.0), addend.0) })
    }

    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { f32x4_sub(addend.0, f32x4_mul(self.0, factor.0)) })
    }

    #[inline(always)]
    unsafe fn fused_mul_add(self, factor: Self, addend: Self) -> Self {
        unsafe { self.mul_add(factor, addend) }
    }

    #[inline(always)]
    unsafe fn fused_neg_mul_add(self, factor: Self, addend: Self) -> Self {
        unsafe { self.neg_mul_add(factor, addend) }
    }

    #[inline(always)]
    unsafe fn at_most(self, other: Self) -> Self::Mask {
        unsafe { f32x4_le(self.0, other.0) }
    }

    #[inline(always)]
    unsafe fn below(self, other: Self) -> Self::Mask {
        unsafe { f32x4_lt(self.0, other.0) }
    }

    #[inline(always)]
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { v128_and(a, b) }
    }

    #[inline(always)]
    unsafe fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { v128_or(a, b) }
    }

    #[inline(always)]
    unsafe fn where_else(self, mask: Self::Mask, other: Self) -> Self {
        Self(unsafe { v128_bitselect(self.0, other.0, mask) })
    }

    #[inline(always)]
    unsafe fn bits(mask: Self::Mask) -> u32 {
        u32::from(u32x4_bitmask(mask))
    }

    #[inline(always)]
    unsafe fn moved_up(self, before: Self) -> Self {
        Self(i32x4_shuffle::<3, 4, 5, 6>(before.0, self.0))
    }

    #[inline(always)]
    unsafe fn call<K: Kernel>(args: K::Args<'_>) -> K::Output {
        unsafe { run::<K>(args) }
    }
}
