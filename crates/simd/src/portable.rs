//! Vectors as arrays of eight values, in scalar code, for all machines.

use std::array::from_fn;

use crate::half::float_from_half;
use crate::lanes::{Kernel, Lanes};

/// Eight values that the compiler may turn into any vectors of the target.
#[derive(Clone, Copy, Debug)]
pub struct Portable([f32; 8]);

pub(crate) unsafe fn run<K: Kernel>(args: K::Args<'_>) -> K::Output {
    // SAFETY: the caller guarantees arguments as the kernel demands; every machine runs scalar code
    unsafe { K::run::<Portable>(args) }
}

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(from_fn(|i| f(self.0[i], other.0[i])))
    }

    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        (0..8).map(|i| u32::from(f(self.0[i], other.0[i])) << i).sum()
    }
}

/// Returns a · b + c, rounded once. On WebAssembly product and sum are rounded separately, as in
/// its vectors.
#[inline(always)]
fn fused(a: f32, b: f32, c: f32) -> f32 {
    if cfg!(target_arch = "wasm32") { a * b + c } else { a.mul_add(b, c) }
}

impl Lanes for Portable {
    type Mask = u32;
    const COUNT: usize = 8;
    const REGISTERS: usize = 0;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 8])
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller guarantees eight values; the read is unaligned
        Self(unsafe { from.cast::<[f32; 8]>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn load_half(from: *const u16) -> Self {
        // SAFETY: the caller guarantees eight values; the read is unaligned
        let halves = unsafe { from.cast::<[u16; 8]>().read_unaligned() };
        Self(halves.map(float_from_half))
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller guarantees room for eight values; the write is unaligned
        unsafe { to.cast::<[f32; 8]>().write_unaligned(self.0) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }

    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        // Product and sum are separate, since without an FMA instruction `f32::mul_add` is a
        // library call.
        Self(from_fn(|i| self.0[i] * factor.0[i] + addend.0[i]))
    }

    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(from_fn(|i| addend.0[i] - self.0[i] * factor.0[i]))
    }

    #[inline(always)]
    unsafe fn fused_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(from_fn(|i| fused(self.0[i], factor.0[i], addend.0[i])))
    }

    #[inline(always)]
    unsafe fn fused_neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(from_fn(|i| fused(-self.0[i], factor.0[i], addend.0[i])))
    }

    #[inline(always)]
    unsafe fn at_most(self, other: Self) -> u32 {
        self.compare(other, |a, b| a <= b)
    }

    #[inline(always)]
    unsafe fn below(self, other: Self) -> u32 {
        self.compare(other, |a, b| a < b)
    }

    #[inline(always)]
    unsafe fn both(a: u32, b: u32) -> u32 {
        a & b
    }

    #[inline(always)]
    unsafe fn either(a: u32, b: u32) -> u32 {
        a | b
    }

    #[inline(always)]
    unsafe fn where_else(self, mask: u32, other: Self) -> Self {
        Self(from_fn(|i| if mask >> i & 1 == 0 { other.0[i] } else { self.0[i] }))
    }

    #[inline(always)]
    unsafe fn bits(mask: u32) -> u32 {
        mask
    }

    #[inline(always)]
    unsafe fn call<K: Kernel>(args: K::Args<'_>) -> K::Output {
        // SAFETY: the caller guarantees arguments as the kernel demands
        unsafe { run::<K>(args) }
    }
}
