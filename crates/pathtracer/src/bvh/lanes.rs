//! Eight values of `f32` at once over one tiny trait, and the instruction sets that carry them.
//!
//! The traversal is written once, generic over [`Lanes`]; [`super::traverse`] calls it through a function per instruction set with the
//! right `target_feature`, into which it is inlined. The portable array is the scalar twin: it compiles everywhere and gives the
//! same bits as AVX2 and NEON, since all three fuse [`Lanes::mul_add`] and [`Lanes::neg_mul_add`]. WebAssembly has no fused
//! instruction, so there these two round twice, and results may differ from other machines in the last bits.

/// Values per vector: children of a node, triangles of a block.
pub(crate) const WIDTH: usize = 8;

/// An instruction set that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InstructionSet {
    /// What every machine of the target has.
    #[cfg_attr(
        any(target_arch = "aarch64", all(target_arch = "wasm32", target_feature = "simd128")),
        allow(dead_code, reason = "every machine of these targets has better")
    )]
    Portable,
    /// AVX2 with FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// NEON, which every 64-bit ARM has.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// 128-bit vectors of WebAssembly, a property of the whole module.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    Simd128,
}

impl InstructionSet {
    /// The best that this machine has.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        #[cfg(target_arch = "aarch64")]
        return Self::Neon;
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        return Self::Simd128;
        #[cfg(not(any(target_arch = "aarch64", all(target_arch = "wasm32", target_feature = "simd128"))))]
        Self::Portable
    }
}

/// A vector of [`WIDTH`] values.
///
/// # Safety
/// Every method may only run where the machine has the instruction set of the type.
pub(crate) trait Lanes: Copy {
    /// A truth value per lane.
    type Mask: Copy;
    unsafe fn splat(value: f32) -> Self;
    unsafe fn load(from: &[f32; WIDTH]) -> Self;
    unsafe fn store(self) -> [f32; WIDTH];
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    /// Of numbers only; what it gives for NaN is open.
    unsafe fn min(self, other: Self) -> Self;
    /// As [`min`](Self::min).
    unsafe fn max(self, other: Self) -> Self;
    /// self · factor + addend.
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// addend − self · factor.
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self;
    /// self ≤ other.
    unsafe fn at_most(self, other: Self) -> Self::Mask;
    /// self < other.
    unsafe fn below(self, other: Self) -> Self::Mask;
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    unsafe fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// self where the mask is true, other elsewhere.
    unsafe fn where_else(self, mask: Self::Mask, other: Self) -> Self;
    /// One bit per lane, lane 0 lowest.
    unsafe fn bits(mask: Self::Mask) -> u32;
}

/// Eight values that the compiler may turn into whatever the target has.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; WIDTH]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }

    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        (0..WIDTH).map(|i| u32::from(f(self.0[i], other.0[i])) << i).sum()
    }
}

/// a · b + c with the rounding that the vectors of this target have.
#[inline(always)]
fn scalar_mul_add(a: f32, b: f32, c: f32) -> f32 {
    if cfg!(target_arch = "wasm32") { a * b + c } else { a.mul_add(b, c) }
}

impl Lanes for Portable {
    type Mask = u32;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; WIDTH])
    }

    #[inline(always)]
    unsafe fn load(from: &[f32; WIDTH]) -> Self {
        Self(*from)
    }

    #[inline(always)]
    unsafe fn store(self) -> [f32; WIDTH] {
        self.0
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
        Self(std::array::from_fn(|i| scalar_mul_add(self.0[i], factor.0[i], addend.0[i])))
    }

    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(std::array::from_fn(|i| scalar_mul_add(-self.0[i], factor.0[i], addend.0[i])))
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
        Self(std::array::from_fn(|i| if mask >> i & 1 == 0 { other.0[i] } else { self.0[i] }))
    }

    #[inline(always)]
    unsafe fn bits(mask: u32) -> u32 {
        mask
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) mod x86 {
    //! AVX2 with FMA.

    use std::arch::x86_64::*;

    use super::{Lanes, WIDTH};

    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(__m256);

    // SAFETY of every block below: the trait's callers guarantee the instruction set; loads and stores are of whole arrays, unaligned
    #[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
    impl Lanes for Avx2 {
        type Mask = __m256;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(value) })
        }

        #[inline(always)]
        unsafe fn load(from: &[f32; WIDTH]) -> Self {
            Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
        }

        #[inline(always)]
        unsafe fn store(self) -> [f32; WIDTH] {
            let mut values = [0.0; WIDTH];
            unsafe { _mm256_storeu_ps(values.as_mut_ptr(), self.0) };
            values
        }

        #[inline(always)]
        unsafe fn add(self, other: Self) -> Self {
            Self(unsafe { _mm256_add_ps(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn sub(self, other: Self) -> Self {
            Self(unsafe { _mm256_sub_ps(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn mul(self, other: Self) -> Self {
            Self(unsafe { _mm256_mul_ps(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn div(self, other: Self) -> Self {
            Self(unsafe { _mm256_div_ps(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn min(self, other: Self) -> Self {
            Self(unsafe { _mm256_min_ps(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn max(self, other: Self) -> Self {
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
            Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, addend.0) })
        }

        #[inline(always)]
        unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
            Self(unsafe { _mm256_fnmadd_ps(self.0, factor.0, addend.0) })
        }

        #[inline(always)]
        unsafe fn at_most(self, other: Self) -> __m256 {
            unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0) }
        }

        #[inline(always)]
        unsafe fn below(self, other: Self) -> __m256 {
            unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
        }

        #[inline(always)]
        unsafe fn both(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_and_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn either(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_or_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn where_else(self, mask: __m256, other: Self) -> Self {
            Self(unsafe { _mm256_blendv_ps(other.0, self.0, mask) })
        }

        #[inline(always)]
        unsafe fn bits(mask: __m256) -> u32 {
            unsafe { _mm256_movemask_ps(mask) as u32 }
        }
    }
}

/// Two halves of four lanes, for instruction sets with 128-bit vectors.
#[cfg(any(target_arch = "aarch64", all(target_arch = "wasm32", target_feature = "simd128")))]
macro_rules! halves {
    ($name:ident, $vector:ty, $mask:ty, $splat:expr, $load:expr, $store:expr, $add:expr, $sub:expr, $mul:expr, $div:expr, $min:expr,
     $max:expr, $fma:expr, $fnma:expr, $le:expr, $lt:expr, $and:expr, $or:expr, $select:expr, $bits:expr) => {
        #[derive(Clone, Copy)]
        pub(crate) struct $name([$vector; 2]);

        // SAFETY of every block below: the trait's callers guarantee the instruction set; loads and stores stay in their arrays
        #[allow(clippy::undocumented_unsafe_blocks, unused_unsafe, reason = "one reason for all, above")]
        impl Lanes for $name {
            type Mask = [$mask; 2];

            #[inline(always)]
            unsafe fn splat(value: f32) -> Self {
                Self(unsafe { [$splat(value); 2] })
            }

            #[inline(always)]
            unsafe fn load(from: &[f32; WIDTH]) -> Self {
                Self(unsafe { [$load(from.as_ptr()), $load(from.as_ptr().add(4))] })
            }

            #[inline(always)]
            unsafe fn store(self) -> [f32; WIDTH] {
                let mut values = [0.0; WIDTH];
                unsafe {
                    $store(values.as_mut_ptr(), self.0[0]);
                    $store(values.as_mut_ptr().add(4), self.0[1]);
                }
                values
            }

            #[inline(always)]
            unsafe fn add(self, other: Self) -> Self {
                Self(unsafe { [$add(self.0[0], other.0[0]), $add(self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn sub(self, other: Self) -> Self {
                Self(unsafe { [$sub(self.0[0], other.0[0]), $sub(self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn mul(self, other: Self) -> Self {
                Self(unsafe { [$mul(self.0[0], other.0[0]), $mul(self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn div(self, other: Self) -> Self {
                Self(unsafe { [$div(self.0[0], other.0[0]), $div(self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn min(self, other: Self) -> Self {
                Self(unsafe { [$min(self.0[0], other.0[0]), $min(self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn max(self, other: Self) -> Self {
                Self(unsafe { [$max(self.0[0], other.0[0]), $max(self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
                Self(unsafe { [$fma(self.0[0], factor.0[0], addend.0[0]), $fma(self.0[1], factor.0[1], addend.0[1])] })
            }

            #[inline(always)]
            unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
                Self(unsafe {
                    [$fnma(self.0[0], factor.0[0], addend.0[0]), $fnma(self.0[1], factor.0[1], addend.0[1])]
                })
            }

            #[inline(always)]
            unsafe fn at_most(self, other: Self) -> Self::Mask {
                unsafe { [$le(self.0[0], other.0[0]), $le(self.0[1], other.0[1])] }
            }

            #[inline(always)]
            unsafe fn below(self, other: Self) -> Self::Mask {
                unsafe { [$lt(self.0[0], other.0[0]), $lt(self.0[1], other.0[1])] }
            }

            #[inline(always)]
            unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
                unsafe { [$and(a[0], b[0]), $and(a[1], b[1])] }
            }

            #[inline(always)]
            unsafe fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask {
                unsafe { [$or(a[0], b[0]), $or(a[1], b[1])] }
            }

            #[inline(always)]
            unsafe fn where_else(self, mask: Self::Mask, other: Self) -> Self {
                Self(unsafe { [$select(mask[0], self.0[0], other.0[0]), $select(mask[1], self.0[1], other.0[1])] })
            }

            #[inline(always)]
            unsafe fn bits(mask: Self::Mask) -> u32 {
                unsafe { $bits(mask[0]) | ($bits(mask[1]) << 4) }
            }
        }
    };
}

#[cfg(target_arch = "aarch64")]
pub(crate) mod neon {
    //! NEON.

    use std::arch::aarch64::*;

    use super::{Lanes, WIDTH};

    /// One bit per lane.
    #[inline(always)]
    fn bits(mask: uint32x4_t) -> u32 {
        // SAFETY: every 64-bit ARM has NEON; the array holds four values
        unsafe { vaddvq_u32(vandq_u32(mask, vld1q_u32([1, 2, 4, 8].as_ptr()))) }
    }

    halves!(
        Neon,
        float32x4_t,
        uint32x4_t,
        vdupq_n_f32,
        vld1q_f32,
        vst1q_f32,
        vaddq_f32,
        vsubq_f32,
        vmulq_f32,
        vdivq_f32,
        vminq_f32,
        vmaxq_f32,
        |a, b, c| vfmaq_f32(c, a, b),
        |a, b, c| vfmsq_f32(c, a, b),
        vcleq_f32,
        vcltq_f32,
        vandq_u32,
        vorrq_u32,
        vbslq_f32,
        bits
    );
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub(crate) mod wasm {
    //! 128-bit vectors of WebAssembly; there is no fused multiply-add in the fixed-width set.

    use std::arch::wasm32::*;

    use super::{Lanes, WIDTH};

    halves!(
        Simd128,
        v128,
        v128,
        f32x4_splat,
        |from: *const f32| v128_load(from.cast()),
        |to: *mut f32, value| v128_store(to.cast(), value),
        f32x4_add,
        f32x4_sub,
        f32x4_mul,
        f32x4_div,
        f32x4_pmin,
        f32x4_pmax,
        |a, b, c| f32x4_add(f32x4_mul(a, b), c),
        |a, b, c| f32x4_sub(c, f32x4_mul(a, b)),
        f32x4_le,
        f32x4_lt,
        v128_and,
        v128_or,
        |mask, a, b| v128_bitselect(a, b, mask),
        |mask| u32::from(u32x4_bitmask(mask))
    );
}
