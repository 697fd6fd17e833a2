//! Vectors of `f32` over one tiny trait, and the instruction sets that carry them.
//!
//! A kernel is written once, generic over [`Lanes`]; [`dispatch`] calls it through a function per instruction set with the right
//! `target_feature`, into which it is inlined. The portable array is the scalar twin: it compiles everywhere.

/// An instruction set that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InstructionSet {
    /// What every machine of the target has.
    Portable,
    /// AVX2 with FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512F.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// NEON, which every 64-bit ARM has.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// 128-bit vectors of WebAssembly, a property of the whole module.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    Simd128,
}

impl InstructionSet {
    /// All that this machine has, the best last.
    pub(crate) fn available() -> Vec<Self> {
        #[cfg_attr(
            all(target_arch = "wasm32", not(target_feature = "simd128")),
            allow(unused_mut, reason = "there is no other without vectors")
        )]
        let mut sets = vec![Self::Portable];
        #[cfg(target_arch = "aarch64")]
        sets.push(Self::Neon);
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        sets.push(Self::Simd128);
        #[cfg(target_arch = "x86_64")]
        {
            if std::is_x86_feature_detected!("avx2")
                && std::is_x86_feature_detected!("fma")
                && std::is_x86_feature_detected!("f16c")
            {
                sets.push(Self::Avx2);
                if std::is_x86_feature_detected!("avx512f") && std::is_x86_feature_detected!("avx512vl") {
                    sets.push(Self::Avx512);
                }
            }
        }
        sets
    }

    /// The best that this machine has.
    pub(crate) fn detect() -> Self {
        *Self::available().last().unwrap_or(&Self::Portable)
    }
}

/// A vector of [`COUNT`](Self::COUNT) values.
///
/// # Safety
/// Every method may only run where the machine has the instruction set of the type; `load` and `store` need `COUNT` values at the pointer.
pub(crate) trait Lanes: Copy {
    /// Number of values; divides [`crate::factor::PAD`].
    const COUNT: usize;
    /// Number of vector registers.
    const REGISTERS: usize;
    unsafe fn splat(value: f32) -> Self;
    unsafe fn load(from: *const f32) -> Self;
    /// From IEEE half floats.
    unsafe fn load_half(from: *const u16) -> Self;
    unsafe fn store(self, to: *mut f32);
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    unsafe fn min(self, other: Self) -> Self;
    unsafe fn max(self, other: Self) -> Self;
    /// self · factor + addend.
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// addend − self · factor.
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self;
    /// `then` in lanes where self > limit, else `otherwise`.
    unsafe fn above(self, limit: Self, then: Self, otherwise: Self) -> Self;
    /// Asks for a cache line that will soon be read; may do nothing. Any address is allowed.
    #[inline(always)]
    unsafe fn prefetch<T>(_from: *const T) {}
    /// The same, but no nearer than the second-level cache.
    #[inline(always)]
    unsafe fn prefetch_far<T>(_from: *const T) {}
}

/// A computation that is compiled once per instruction set.
pub(crate) trait Kernel {
    type Output;

    /// Runs it; must be `#[inline(always)]`.
    ///
    /// # Safety
    /// The machine has `V`'s instruction set.
    unsafe fn run<V: Lanes>(self) -> Self::Output;
}

/// Runs a kernel with the vectors of an instruction set.
pub(crate) fn dispatch<K: Kernel>(set: InstructionSet, kernel: K) -> K::Output {
    // SAFETY: an `InstructionSet` is only made where the machine has it
    unsafe {
        match set {
            InstructionSet::Portable => kernel.run::<Portable>(),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx2 => x86::avx2(kernel),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512 => x86::avx512(kernel),
            #[cfg(target_arch = "aarch64")]
            InstructionSet::Neon => kernel.run::<neon::Neon>(),
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            InstructionSet::Simd128 => kernel.run::<wasm::Simd128>(),
        }
    }
}

/// Eight values that the compiler may turn into whatever the target has.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

impl Lanes for Portable {
    const COUNT: usize = 8;
    const REGISTERS: usize = 16;

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
        self.zip(other, f32::min)
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        self.zip(other, f32::max)
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        // without an FMA instruction f32::mul_add would be a library call
        Self(std::array::from_fn(|i| self.0[i] * factor.0[i] + addend.0[i]))
    }

    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(std::array::from_fn(|i| addend.0[i] - self.0[i] * factor.0[i]))
    }

    #[inline(always)]
    unsafe fn above(self, limit: Self, then: Self, otherwise: Self) -> Self {
        Self(std::array::from_fn(|i| if self.0[i] > limit.0[i] { then.0[i] } else { otherwise.0[i] }))
    }
}

/// A finite half float as `f32`, without branches: shifted into place, then scaled by 2^112 for the difference of the exponents' biases, which
/// makes subnormal numbers come out right too.
#[inline(always)]
pub(crate) fn float_from_half(half: u16) -> f32 {
    let bits = u32::from(half);
    let magnitude = f32::from_bits((bits & 0x7fff) << 13) * f32::from_bits((127 + 112) << 23);
    f32::from_bits(magnitude.to_bits() | (bits & 0x8000) << 16)
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    //! AVX2 with FMA and F16C, and AVX-512.

    use std::arch::x86_64::*;

    use super::{Kernel, Lanes};

    #[target_feature(enable = "avx2,fma,f16c")]
    pub(super) unsafe fn avx2<K: Kernel>(kernel: K) -> K::Output {
        // SAFETY: passed on from the caller
        unsafe { kernel.run::<Avx2>() }
    }

    #[target_feature(enable = "avx512f,avx512vl,avx2,fma,f16c")]
    pub(super) unsafe fn avx512<K: Kernel>(kernel: K) -> K::Output {
        // SAFETY: passed on from the caller
        unsafe { kernel.run::<Avx512>() }
    }

    macro_rules! lanes {
        ($name:ident, $vector:ty, $count:literal, $splat:ident, $load:ident, $half:expr, $store:ident, $add:ident, $sub:ident, $mul:ident,
         $div:ident, $min:ident, $max:ident, $fma:ident, $fnma:ident, $above:expr) => {
            #[derive(Clone, Copy)]
            pub(crate) struct $name($vector);

            // SAFETY of every block below: the trait's callers guarantee the instruction set and the memory
            #[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
            impl Lanes for $name {
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
                unsafe fn above(self, limit: Self, then: Self, otherwise: Self) -> Self {
                    Self(unsafe { $above(self.0, limit.0, then.0, otherwise.0) })
                }

                #[inline(always)]
                unsafe fn prefetch<T>(from: *const T) {
                    unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) }
                }

                #[inline(always)]
                unsafe fn prefetch_far<T>(from: *const T) {
                    unsafe { _mm_prefetch::<_MM_HINT_T1>(from.cast()) }
                }
            }
        };
    }

    lanes!(
        Avx2,
        __m256,
        8,
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
        |a, limit, then, otherwise| _mm256_blendv_ps(otherwise, then, _mm256_cmp_ps::<_CMP_GT_OQ>(a, limit))
    );
    lanes!(
        Avx512,
        __m512,
        16,
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
        |a, limit, then, otherwise| _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, limit), otherwise, then)
    );
}

#[cfg(target_arch = "aarch64")]
mod neon {
    //! NEON.

    use std::arch::aarch64::*;

    use super::{Lanes, float_from_half};

    #[derive(Clone, Copy)]
    pub(crate) struct Neon(float32x4_t);

    // SAFETY of every block below: every 64-bit ARM has NEON; the trait's callers guarantee the memory
    #[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
    impl Lanes for Neon {
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
            Self(unsafe { vld1q_f32(values.as_ptr()) })
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
            Self(unsafe { vminnmq_f32(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn max(self, other: Self) -> Self {
            Self(unsafe { vmaxnmq_f32(self.0, other.0) })
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
        unsafe fn above(self, limit: Self, then: Self, otherwise: Self) -> Self {
            Self(unsafe { vbslq_f32(vcgtq_f32(self.0, limit.0), then.0, otherwise.0) })
        }
    }
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod wasm {
    //! 128-bit vectors of WebAssembly; there is no fused multiply-add in the fixed-width set.

    use std::arch::wasm32::*;

    use super::{Lanes, float_from_half};

    #[derive(Clone, Copy)]
    pub(crate) struct Simd128(v128);

    // SAFETY of every block below: the module is compiled for simd128; the trait's callers guarantee the memory
    #[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
    impl Lanes for Simd128 {
        const COUNT: usize = 4;
        const REGISTERS: usize = 16;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            Self(f32x4_splat(value))
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            Self(unsafe { v128_load(from.cast()) })
        }

        #[inline(always)]
        unsafe fn load_half(from: *const u16) -> Self {
            let [a, b, c, d] = unsafe { from.cast::<[u16; 4]>().read_unaligned() }.map(float_from_half);
            Self(f32x4(a, b, c, d))
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            unsafe { v128_store(to.cast(), self.0) }
        }

        #[inline(always)]
        unsafe fn add(self, other: Self) -> Self {
            Self(f32x4_add(self.0, other.0))
        }

        #[inline(always)]
        unsafe fn sub(self, other: Self) -> Self {
            Self(f32x4_sub(self.0, other.0))
        }

        #[inline(always)]
        unsafe fn mul(self, other: Self) -> Self {
            Self(f32x4_mul(self.0, other.0))
        }

        #[inline(always)]
        unsafe fn div(self, other: Self) -> Self {
            Self(f32x4_div(self.0, other.0))
        }

        #[inline(always)]
        unsafe fn min(self, other: Self) -> Self {
            Self(f32x4_pmin(self.0, other.0))
        }

        #[inline(always)]
        unsafe fn max(self, other: Self) -> Self {
            Self(f32x4_pmax(self.0, other.0))
        }

        #[inline(always)]
        unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
            Self(f32x4_add(f32x4_mul(self.0, factor.0), addend.0))
        }

        #[inline(always)]
        unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
            Self(f32x4_sub(addend.0, f32x4_mul(self.0, factor.0)))
        }

        #[inline(always)]
        unsafe fn above(self, limit: Self, then: Self, otherwise: Self) -> Self {
            Self(v128_bitselect(then.0, otherwise.0, f32x4_gt(self.0, limit.0)))
        }
    }
}
