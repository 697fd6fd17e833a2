//! AVX2 with FMA and F16C, and AVX-512.

use std::arch::x86_64::*;

use crate::lanes::{Kernel, Lanes};

/// Runs a kernel with AVX2, FMA and F16C. The machine has these features, since a backend of this
/// file exists only after their detection.
#[target_feature(enable = "avx2,fma,f16c")]
pub(crate) unsafe fn avx2<K: Kernel>(args: K::Args<'_>) -> K::Output {
    // SAFETY: the caller guarantees the instruction set, and arguments as the kernel demands
    unsafe { K::run::<Avx2>(args) }
}

#[target_feature(enable = "avx512f,avx512vl,avx2,fma,f16c")]
pub(crate) unsafe fn avx512<K: Kernel>(args: K::Args<'_>) -> K::Output {
    // SAFETY: the caller guarantees the instruction set, and arguments as the kernel demands
    unsafe { K::run::<Avx512>(args) }
}

macro_rules! lanes {
    ($name:ident($vector:ty, $mask:ty), $about:literal, $count:literal, $call:ident, $splat:ident, $load:ident, $half:expr, $store:ident, $add:ident,
     $sub:ident, $mul:ident, $div:ident, $min:ident, $max:ident, $fma:ident, $fnma:ident, $at_most:expr, $below:expr, $both:expr, $either:expr,
     $select:expr, $bits:expr, $moved_up:expr) => {
        #[doc = $about]
        #[derive(Clone, Copy, Debug)]
        pub struct $name($vector);

        // SAFETY of every block below: the trait's callers guarantee the instruction set and the
        // memory
        #[allow(
            clippy::undocumented_unsafe_blocks,
            unused_unsafe,
            reason = "one reason for all, above; operations on plain numbers are safe"
        )]
        impl Lanes for $name {
            type Mask = $mask;
            const COUNT: usize = $count;
            const REGISTERS: usize = 2 * $count;

            #[inline(always)]
            unsafe fn splat(value: f32) -> Self {
                Self(unsafe { $splat(value) })
            }

            #[inline(always)]
            unsafe fn load(from: *const f32) -> Self {
                Self(unsafe { $load(from) })
            }

            #[inline(always)]
            unsafe fn load_half(from: *const u16) -> Self {
                Self(unsafe { $half(from) })
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut f32) {
                unsafe { $store(to, self.0) }
            }

            #[inline(always)]
            unsafe fn add(self, other: Self) -> Self {
                Self(unsafe { $add(self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn sub(self, other: Self) -> Self {
                Self(unsafe { $sub(self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn mul(self, other: Self) -> Self {
                Self(unsafe { $mul(self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn div(self, other: Self) -> Self {
                Self(unsafe { $div(self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn min(self, other: Self) -> Self {
                Self(unsafe { $min(self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn max(self, other: Self) -> Self {
                Self(unsafe { $max(self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
                Self(unsafe { $fma(self.0, factor.0, addend.0) })
            }

            #[inline(always)]
            unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
                Self(unsafe { $fnma(self.0, factor.0, addend.0) })
            }

            #[inline(always)]
            unsafe fn fused_mul_add(self, factor: Self, addend: Self) -> Self {
                Self(unsafe { $fma(self.0, factor.0, addend.0) })
            }

            #[inline(always)]
            unsafe fn fused_neg_mul_add(self, factor: Self, addend: Self) -> Self {
                Self(unsafe { $fnma(self.0, factor.0, addend.0) })
            }

            #[inline(always)]
            unsafe fn at_most(self, other: Self) -> $mask {
                unsafe { $at_most(self.0, other.0) }
            }

            #[inline(always)]
            unsafe fn below(self, other: Self) -> $mask {
                unsafe { $below(self.0, other.0) }
            }

            #[inline(always)]
            unsafe fn both(a: $mask, b: $mask) -> $mask {
                unsafe { $both(a, b) }
            }

            #[inline(always)]
            unsafe fn either(a: $mask, b: $mask) -> $mask {
                unsafe { $either(a, b) }
            }

            #[inline(always)]
            unsafe fn where_else(self, mask: $mask, other: Self) -> Self {
                Self(unsafe { $select(mask, self.0, other.0) })
            }

            #[inline(always)]
            unsafe fn bits(mask: $mask) -> u32 {
                unsafe { $bits(mask) }
            }

            #[inline(always)]
            unsafe fn moved_up(self, before: Self) -> Self {
                Self(unsafe { $moved_up(self.0, before.0) })
            }

            #[inline(always)]
            unsafe fn call<K: Kernel>(args: K::Args<'_>) -> K::Output {
                unsafe { $call::<K>(args) }
            }
        }
    };
}

lanes!(
    Avx2(__m256, __m256),
    "Eight lanes of AVX2, FMA and F16C.",
    8,
    avx2,
    _mm256_set1_ps,
    _mm256_loadu_ps,
    |from: *const u16| _mm256_cvtph_ps(_mm_loadu_si128(from.cast())),
    _mm256_storeu_ps,
    _mm256_add_ps,
    _mm256_sub_ps,
    _mm256_mul_ps,
    _mm256_div_ps,
    _mm256_min_ps,
    _mm256_max_ps,
    _mm256_fmadd_ps,
    _mm256_fnmadd_ps,
    |a, b| _mm256_cmp_ps::<_CMP_LE_OQ>(a, b),
    |a, b| _mm256_cmp_ps::<_CMP_LT_OQ>(a, b),
    |a, b| _mm256_and_ps(a, b),
    |a, b| _mm256_or_ps(a, b),
    |mask, then, otherwise| _mm256_blendv_ps(otherwise, then, mask),
    |mask| _mm256_movemask_ps(mask) as u32,
    |lanes, before| {
        // join the upper half of `before` and the lower half of `lanes`
        let between = _mm256_castps_si256(_mm256_permute2f128_ps::<0x21>(before, lanes));
        _mm256_castsi256_ps(_mm256_alignr_epi8::<12>(_mm256_castps_si256(lanes), between))
    }
);
lanes!(
    Avx512(__m512, __mmask16),
    "Sixteen lanes of AVX-512F.",
    16,
    avx512,
    _mm512_set1_ps,
    _mm512_loadu_ps,
    |from: *const u16| _mm512_cvtph_ps(_mm256_loadu_si256(from.cast())),
    _mm512_storeu_ps,
    _mm512_add_ps,
    _mm512_sub_ps,
    _mm512_mul_ps,
    _mm512_div_ps,
    _mm512_min_ps,
    _mm512_max_ps,
    _mm512_fmadd_ps,
    _mm512_fnmadd_ps,
    |a, b| _mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b),
    |a, b| _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b),
    |a, b| a & b,
    |a, b| a | b,
    |mask, then, otherwise| _mm512_mask_blend_ps(mask, otherwise, then),
    u32::from,
    |lanes, before| _mm512_castsi512_ps(_mm512_alignr_epi32::<15>(
        _mm512_castps_si512(lanes),
        _mm512_castps_si512(before)
    ))
);
