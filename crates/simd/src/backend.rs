//! Detects the machine's instruction sets once, and returns a kernel's function for each.

use std::fmt;
use std::sync::OnceLock;

use crate::lanes::{Function, Kernel, Lanes};
#[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
use crate::portable::Portable;

/// An instruction set that this machine has. Only detection makes values of this type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backend(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    /// Plain code, for every machine of the target; eight lanes. A WebAssembly module that is
    /// compiled with vectors always uses the vectors, so it does not have this set.
    #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
    Portable,
    /// AVX2 with FMA and F16C; eight lanes.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512F and VL; sixteen lanes.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// NEON, which every 64-bit ARM has; four lanes.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// 128-bit vectors of WebAssembly, a property of the whole module; four lanes.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    Simd128,
}

impl Backend {
    /// Returns all instruction sets that this machine has, the best last.
    pub fn available() -> &'static [Self] {
        static AVAILABLE: OnceLock<Vec<Backend>> = OnceLock::new();
        AVAILABLE.get_or_init(detect)
    }

    /// Returns the best instruction set that this machine has.
    pub fn best() -> Self {
        Self::available()[Self::available().len() - 1]
    }

    /// Returns the number of lanes of this instruction set's vectors.
    pub fn lanes(self) -> usize {
        match self.0 {
            #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
            Set::Portable => Portable::COUNT,
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => crate::x86::Avx2::COUNT,
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => crate::x86::Avx512::COUNT,
            #[cfg(target_arch = "aarch64")]
            Set::Neon => crate::neon::Neon::COUNT,
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Set::Simd128 => crate::wasm::Simd128::COUNT,
        }
    }

    /// Returns a kernel's function for this instruction set. The machine has the set, so the
    /// function is unsafe only because of the kernel's own demands on its arguments.
    pub fn function<K: Kernel>(self) -> Function<K> {
        match self.0 {
            #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
            Set::Portable => crate::portable::run::<K>,
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => crate::x86::avx2::<K>,
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => crate::x86::avx512::<K>,
            #[cfg(target_arch = "aarch64")]
            Set::Neon => crate::neon::run::<K>,
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Set::Simd128 => crate::wasm::run::<K>,
        }
    }

    /// Runs a kernel with vectors of exactly eight lanes, in the fastest way that this instruction
    /// set offers.
    ///
    /// # Safety
    /// The arguments are as the kernel demands.
    #[inline]
    pub unsafe fn call_eight<K: Kernel>(self, args: K::Args<'_>) -> K::Output {
        // SAFETY: a `Backend` exists only where the machine has its instruction set; the caller
        // guarantees the kernel's conditions
        unsafe {
            match self.0 {
                #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
                Set::Portable => K::run::<Portable>(args),
                #[cfg(target_arch = "x86_64")]
                Set::Avx2 | Set::Avx512 => crate::x86::avx2::<K>(args),
                #[cfg(target_arch = "aarch64")]
                Set::Neon => K::run::<crate::pair::Pair<crate::neon::Neon>>(args),
                #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
                Set::Simd128 => K::run::<crate::pair::Pair<crate::wasm::Simd128>>(args),
            }
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
            Set::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "AVX2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "AVX-512",
            #[cfg(target_arch = "aarch64")]
            Set::Neon => "NEON",
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Set::Simd128 => "simd128",
        })
    }
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
fn detect() -> Vec<Backend> {
    vec![Backend(Set::Simd128)]
}

#[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
fn detect() -> Vec<Backend> {
    #[cfg_attr(target_arch = "wasm32", allow(unused_mut, reason = "no other set exists without vectors"))]
    let mut found = vec![Backend(Set::Portable)];
    #[cfg(target_arch = "aarch64")]
    found.push(Backend(Set::Neon));
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2")
        && std::is_x86_feature_detected!("fma")
        && std::is_x86_feature_detected!("f16c")
    {
        found.push(Backend(Set::Avx2));
        if std::is_x86_feature_detected!("avx512f") && std::is_x86_feature_detected!("avx512vl") {
            found.push(Backend(Set::Avx512));
        }
    }
    found
}
