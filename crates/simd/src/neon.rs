//! Four lanes of NEON.

use std::arch::aarch64::*;

use crate::half::float_from_half;
use crate::lanes::{Kernel, Lanes};

/// Four lanes of NEON.
#[derive(Clone, Copy, Debug)]
pub struct Neon(float32x4_t);

pub(crate) unsafe fn run<K: Kernel>(args: K::Args<'_>) -> K::Output {
    // SAFETY: the caller guarantees the instruction set, and arguments as the kernel demands
    unsafe { K::run::<Neon>(args) }
}

// SAFETY of every block below: every 64-bit ARM has NEON; the trait's callers guarantee the memory
#[allow(clippy::undocumented_unsafe_blocks, unused_unsafe, reason = "one reason for all, above")]
impl Lanes for Neon {
    type Mask = uint32x4_t;
    const COUNT: usize = 4;
    const REGISTERS: usize = 32;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self(unsafe { vdupq_n_f32(value) })
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        Self(unsafe { vld1q_f32(from) })
    }

    #[inline(always)]
    unsafe fn load_half(from: *const u16) -> Self {
        let values = unsafe { from.cast::<[u16; 4]>().read_unaligned() }.map(float_from_half);
        unsafe { Self::load(values.as_ptr()) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe { vst1q_f32(to, self.0) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        Self(unsafe { vaddq_f32(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        Self(unsafe { vsubq_f32(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        Self(unsafe { vmulq_f32(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        Self(unsafe { vdivq_f32(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        Self(unsafe { vminq_f32(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        Self(unsafe { vmaxq_f32(self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { vfmaq_f32(addend.0, self.0, factor.0) })
    }

    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { vfmsq_f32(addend.0, self.0, factor.0) })
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
        unsafe { vcleq_f32(self.0, other.0) }
    }

    #[inline(always)]
    unsafe fn below(self, other: Self) -> Self::Mask {
        unsafe { vcltq_f32(self.0, other.0) }
    }

    #[inline(always)]
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { vandq_u32(a, b) }
    }

    #[inline(always)]
    unsafe fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { vorrq_u32(a, b) }
    }

    #[inline(always)]
    unsafe fn where_else(self, mask: Self::Mask, other: Self) -> Self {
        Self(unsafe { vbslq_f32(mask, self.0, other.0) })
    }

    #[inline(always)]
    unsafe fn bits(mask: Self::Mask) -> u32 {
        unsafe { vaddvq_u32(vandq_u32(mask, vld1q_u32([1, 2, 4, 8].as_ptr()))) }
    }

    #[inline(always)]
    unsafe fn moved_up(self, before: Self) -> Self {
        Self(unsafe { vextq_f32::<3>(before.0, self.0) })
    }

    #[inline(always)]
    unsafe fn call<K: Kernel>(args: K::Args<'_>) -> K::Output {
        unsafe { run::<K>(args) }
    }
}
